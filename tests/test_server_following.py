"""Server that follows the finger: what its configuration allows, and what clients are told.

All of it is real but time and the boundaries of processes (`virtual_server`); the display and its
currents are simulated.
"""

import asyncio
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from following_rig import pair
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.client import wire
from tactile.server.client import Client, Posted
from tactile.server.config import Configuration, DisplayConfig, FingerConfig
from tactile.server.metrics import Metrics

NAME = "left"
LIFTS = "sim:?finger=mid&liftoff=0.3&retouch=0.5"
Files = tuple[Path, Path]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of a display of two contactors and of its calibration."""
    return pair(tmp_path_factory.mktemp("two"))[1:]


@pytest.fixture
def world() -> Iterator[World]:
    with virtual_world(lambda playback, volts: None) as made:
        yield made


def configured(files: Files, device: str, *, path: Path | None = None) -> Configuration:
    """Return a configuration that follows, by default with the calibration's file."""
    finger = FingerConfig(follow=True, calibration=None if path else str(files[1]))
    display = DisplayConfig(name=NAME, display=str(files[0]), device=device, sample_rate_hz=8000.0)
    return Configuration(display=(display,), finger=finger, path=path)


def started(world: World, config: Configuration) -> tuple[Client, Client]:
    """Start a server, and return two of its clients."""
    assert world.start(config)
    assert world.host is not None
    one, two = (world.host.connect(name, roles=m.ALL_ROLES) for name in ("one", "two"))
    return one, two


def ask(world: World, client: Client, command: m.Command) -> None:
    assert isinstance(world.run(client.request(command)), m.Done)


def heard(client: Client) -> list[Posted]:
    return [client.outbox.get_nowait() for _ in range(client.outbox.qsize())]


def test_who_has_telemetry_hears_of_touches_in_order(world: World, files: Files) -> None:
    """A finger lifts and comes back; a client without telemetry only hears that it was armed.

    Each change stands between telemetry from before and after it.
    """
    one, two = started(world, configured(files, LIFTS))
    ask(world, one, m.Subscribe(display=NAME, rate_hz=50))
    ask(world, one, m.ArmDisplay(display=NAME))
    world.run(asyncio.sleep(0.8))
    told = heard(one)
    touching = [x.finger.touching if x.finger else () for x in told if hasattr(x, "finger")]
    events = [x for x in told if isinstance(x, m.EventMessage) and x.contactors]
    assert [(e.kind, e.contactors) for e in events] == [("lifted", (0, 1)), ("touched", (0, 1))]
    assert all(e.display == NAME for e in events)
    states = [key for key, _ in zip(touching, [*touching[1:], None], strict=True) if key != _]
    assert states == [(), (True, True), (False, False), (True, True)]
    assert [x.kind for x in heard(two) if isinstance(x, m.EventMessage)] == ["armed"]


def test_telemetry_tells_what_playback_found(world: World, files: Files) -> None:
    """Telemetry, metrics and the description agree with the loop in the playback process."""
    one, _ = started(world, configured(files, "sim:?finger=mid"))
    assert world.host is not None
    assert [info.follows for info in world.host.displays] == [True]
    ask(world, one, m.ArmDisplay(display=NAME))
    world.run(asyncio.sleep(0.5))
    ask(world, one, m.Subscribe(display=NAME, rate_hz=50))
    world.run(asyncio.sleep(0.0))
    (said,) = [x for x in heard(one) if isinstance(x, m.TelemetryMessage)]
    (playback,) = world.playbacks()
    assert playback.program is not None
    following = playback.program._player.following
    assert following is not None
    assert following.loads is not None
    assert said.finger is not None
    assert said.finger.touching == tuple(following.loads.touching.tolist()) == (True, True)
    assert said.finger.explained == (True, True)
    deviation = following.loads.deviation
    np.testing.assert_allclose(said.finger.equalizer_error_db, deviation, rtol=1e-6)
    assert following.finger is not None
    np.testing.assert_allclose(said.finger.stiffness_n_m, following.finger.stiffness, rtol=1e-6)
    inside = wire.from_message(wire.Telemetry, said).finger
    assert inside is not None
    assert (inside.touching, inside.stiffness) == (said.finger.touching, said.finger.stiffness_n_m)
    assert said.counters["finger_windows"] >= 15
    metrics = Metrics(world.host).text().decode()
    line = f'tactile_finger_windows_total{{display="{NAME}"}} {said.counters["finger_windows"]}.0'
    assert line in metrics
    for name in ("dropped_finger_windows", "touched_contactors", "unexplained_loads"):
        assert f'tactile_{name}_total{{display="{NAME}"}} 0.0' in metrics


def test_an_e_stop_ends_what_is_told(world: World, files: Files) -> None:
    one, _ = started(world, configured(files, "sim:?finger=mid"))
    ask(world, one, m.ArmDisplay(display=NAME))
    world.run(asyncio.sleep(0.3))
    ask(world, one, m.EStop())
    world.run(asyncio.sleep(0.1))
    ask(world, one, m.Subscribe(display=NAME, rate_hz=50))
    world.run(asyncio.sleep(0.0))
    (said,) = [x for x in heard(one) if isinstance(x, m.TelemetryMessage)]
    assert (said.state, said.finger) == ("estopped", None)


def test_a_device_without_currents_is_said_once(
    world: World, files: Files, caplog: pytest.LogCaptureFixture
) -> None:
    """Play for the finger of the display, which clients see from the description."""
    with caplog.at_level(logging.WARNING, "tactile"):
        one, _ = started(world, configured(files, "mock:"))
        ask(world, one, m.ArmDisplay(display=NAME))
        world.run(asyncio.sleep(0.2))
    warned = [r.getMessage() for r in caplog.records if "currents" in r.getMessage()]
    assert warned == [
        "left: finger.follow = true: the device measures no currents; it plays for the finger of "
        "the display"
    ]
    assert world.host is not None
    assert [info.follows for info in world.host.displays] == [False]


def test_without_the_table_nothing_follows(world: World, files: Files) -> None:
    display = DisplayConfig(name=NAME, display=str(files[0]), device="sim:?finger=mid")
    started(world, Configuration(display=(display,)))
    (playback,) = world.playbacks()
    assert playback.program is not None
    assert playback.program._player.following is None
    assert not playback.bus.correlates


def test_the_calibration_is_that_of_the_displays_name_beside_the_file(
    world: World, files: Files
) -> None:
    """Find it there; where it is not, the server does not start."""
    config = configured(files, "sim:?finger=mid", path=files[1].parent / "tactile.toml")
    started(world, config)
    world.stop()
    assert not world.start(configured(files, "sim:", path=Path("elsewhere") / "tactile.toml"))
