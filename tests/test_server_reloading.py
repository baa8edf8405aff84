"""A configuration that is loaded again, and e-stops that hold over that and over a restart."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.bus.registry import register_bus
from tactile.bus.simulated.modeled_bus import MockOptions
from tactile.errors import BusError, InputError
from tactile.server.config import load_config
from tactile.server.host import Host


class VirtualServer:
    """A server on a virtual clock, with a configuration in a file.

    Parameters
    ----------
    world : world of the server
    path : path of its configuration
    """

    def __init__(self, world: World, path: Path) -> None:
        self.world, self._path = world, path

    def start(self, **devices: str) -> Host:
        """Start with displays of these devices."""
        self.write(1.0, **devices)
        assert self.world.start(load_config(self._path))
        return self.host

    @property
    def host(self) -> Host:
        assert self.world.host is not None
        return self.world.host

    def write(self, gain: float, /, **devices: str) -> None:
        """Write a configuration: displays by their names, with their devices."""
        self._path.write_text(
            "".join(
                f'[[display]]\nname = "{name}"\ndevice = "{device}"\ngain = {gain}\n'
                for name, device in devices.items()
            )
        )

    def break_configuration(self) -> None:
        """Write a configuration that cannot be read."""
        self._path.write_text("[[display]]\nname = 3\n")

    def reload(self) -> None:
        """Load the configuration again."""
        self.world.run(self.host.reload())


@pytest.fixture
def server(tmp_path: Path) -> Iterator[VirtualServer]:
    with virtual_world(lambda playback, volts: None) as world:
        register_bus("sim", world.open_bus, MockOptions)
        yield VirtualServer(world, tmp_path / "tactile.toml")
        assert world.errors.all == []


def test_reloading_opens_a_device_anew_whose_e_stop_still_holds(server: VirtualServer) -> None:
    playing = server.start(right="mock:").playing["right"]
    number = playing.estop("by a test")
    server.write(0.5, right="mock:")
    server.reload()
    anew = server.host.playing["right"]
    assert anew is not playing
    assert anew.config.gain == 0.5
    assert anew.latch.holds == number


@pytest.mark.parametrize("how", ["reload", "restart"])
def test_editing_an_option_of_a_device_ends_no_e_stop(server: VirtualServer, how: str) -> None:
    server.start(right="mock:").playing["right"].estop("by a test")
    if how == "reload":
        server.write(1.0, right="mock:?format=pcm12")
        server.reload()
    else:
        server.world.stop()
        server.start(right="mock:?format=pcm12")
    playing = server.host.playing["right"]
    assert playing.config.device == "mock:?format=pcm12"
    assert playing.latch.holds
    assert playing.latch.reason.startswith("by a test")


def test_reloading_two_displays_of_one_device_keeps_both(server: VirtualServer) -> None:
    """Two simulated displays have the same URL, and a latch each."""
    host = server.start(a="sim:", b="sim:")
    server.write(0.5, a="sim:", b="sim:")
    server.reload()
    assert {name: one.config.gain for name, one in host.playing.items()} == {"a": 0.5, "b": 0.5}
    host.playing["a"].estop("by a test")
    assert host.playing["b"].latch.holds == 0


def test_an_e_stop_while_the_server_ends_is_latched(server: VirtualServer) -> None:
    client = server.start(right="mock:").connect("test", roles=m.ALL_ROLES)
    process = server.world.server
    assert process is not None

    async def estop_while_it_ends() -> m.Answer:
        ending = asyncio.create_task(process.opened.aclose())
        await asyncio.sleep(0)
        answer = await client.request(m.EStop())
        assert not ending.done()
        await ending
        return answer

    assert server.world.run(estop_while_it_ends()) == m.Done(estops={"right": 1})
    server.world.stop()
    assert server.start(right="mock:").playing["right"].latch.holds == 1


def test_reloading_opens_what_changed_and_tries_what_cannot_be_opened(
    server: VirtualServer,
) -> None:
    host = server.start(left="sim:", right="sim:")
    kept = host.playing["left"]
    server.write(1.0, left="sim:", right="nonsense")
    with pytest.raises(BusError, match="right"):
        server.reload()
    assert host.playing["left"] is kept
    assert not host.healthy()
    server.break_configuration()
    with pytest.raises(InputError):
        server.reload()
    assert set(host.playing) == {"left", "right"}
    server.write(1.0, left="sim:")
    server.reload()
    assert list(host.playing.values()) == [kept]
    server.world.clock.advance(1.0)
    assert host.healthy()
    server.world.stop()
    assert not host.healthy()
