"""Tests of how the server handles a playback that dies or hangs, on the virtual clock."""

import asyncio
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_server import PlaybackProcess, World, small_display, virtual_world

from tactile import messages as m
from tactile.bus.base import Bus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback import process as playback_process
from tactile.playback.commands import PlaybackSetup
from tactile.server import texture_store
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig
from tactile.server.playing import hangs

NAME = "left"
BACK = 2.0
"""Longest time until a playback that died plays again [s]: 0.5 s, and what opening takes."""


@pytest.fixture
def peaks() -> list[float]:
    """Highest voltages that the amplifier has put out, of one piece after the other [V]."""
    return []


@pytest.fixture
def world(peaks: list[float]) -> Iterator[World]:
    with virtual_world(lambda playback, volts: peaks.append(np.abs(volts).max())) as made:
        yield made


@pytest.fixture
def serve(world: World, tmp_path: Path) -> Callable[..., Client]:
    """Start a server with one display, and connect a client to it."""

    def start(device: str = "mock:", **options: Any) -> Client:
        display = DisplayConfig(
            name=NAME, display=small_display(tmp_path), device=device, sample_rate_hz=2500.0,
            **options,
        )  # fmt: skip
        assert world.start(Configuration(display=(display,)))
        assert world.host is not None
        world.run(asyncio.sleep(0.2))
        return world.host.connect("app", roles=m.ALL_ROLES)

    return start


def test_playback_hangs_that_long_says_nothing_but_not_before_it_could() -> None:
    """One that was opened a moment ago has reported nothing yet: its last report is of time 0."""
    assert not hangs(100.0, 0.0, 99.9)
    still = 4.0  # s, many times what the machine of docs/benchmarks.md ever stood still for
    assert not hangs(100.0 + still, 100.0, 50.0)
    assert hangs(100.0 + still + 0.1, 0.0, 100.0)
    assert hangs(100.0 + still + 0.1, 100.0, 50.0)


def health_of(world: World) -> tuple[bool, bool, float]:
    """Return what /healthz, the system's watchdog and the figures say of the display."""
    assert world.host is not None
    world.host.beat()
    world.run(asyncio.sleep(0.3))
    said = world.host.figures()[NAME]["playback_alive"]
    return world.host.healthy(), world.host.beat(), said


def playback_of(world: World) -> PlaybackProcess:
    (playback,) = world.playbacks()
    return playback


def events_of(client: Client) -> list[tuple[str, str]]:
    found = []
    while not client.outbox.empty():
        event = client.outbox.get_nowait()
        if isinstance(event, m.EventMessage):
            found.append((event.kind, event.detail))
    return found


def test_a_server_whose_playback_died_is_not_healthy_until_it_plays_again(
    world: World, serve: Callable[..., Client]
) -> None:
    serve()
    assert health_of(world) == (True, True, 1.0)
    playback_of(world).kill()
    assert world.host is not None
    assert not world.host.healthy(), "at once, before anybody has looked"
    assert world.host.figures()[NAME]["playback_alive"] == 0.0
    playing = world.host.playing[NAME]
    while playing.child is None or not playing.child.alive:
        world.run(asyncio.sleep(0.001))
    assert playing.lost, "the process is there, and opens the device"
    assert not world.host.healthy()
    world.run(asyncio.sleep(BACK))
    assert health_of(world) == (True, True, 1.0)


def test_a_playback_that_hangs_is_seen_by_the_watchdog_and_started_again(
    world: World, serve: Callable[..., Client]
) -> None:
    serve()
    world.run(asyncio.sleep(0.05))  # so that the limit falls between two looks of the supervisor
    hung = playback_of(world)
    hung.hang(60.0)
    assert hung.alive
    assert not health_of(world)[1]
    assert world.host is not None
    said = []
    while hung.alive:
        said.append(world.host.figures()[NAME]["playback_alive"])
        world.run(asyncio.sleep(0.01))
    assert said[0] == 1.0
    assert said[-1] == 0.0
    world.run(asyncio.sleep(BACK))
    assert health_of(world) == (True, True, 1.0)


@pytest.mark.parametrize("rearm", [True, False])
def test_who_had_armed_is_told_whether_it_is_armed_again(
    world: World, serve: Callable[..., Client], rearm: bool
) -> None:
    client = serve(rearm=rearm)
    assert isinstance(world.run(client.request(m.ArmDisplay(display=NAME))), m.Done)
    events_of(client)
    playback_of(world).kill()
    world.run(asyncio.sleep(BACK))
    assert world.host is not None
    assert world.host.playing[NAME].state == ("armed" if rearm else "disarmed")
    events = events_of(client)
    assert ("lost", "playback died; it is started again") in events
    back = ("disarmed", "playback is back, and disarmed")
    assert (back in events) is not rearm


def test_all_clients_are_told_of_an_estop_and_that_it_was_cleared(
    world: World, serve: Callable[..., Client]
) -> None:
    presser = serve()
    assert world.host is not None
    other = world.host.connect("other", roles=m.ALL_ROLES)
    assert isinstance(world.run(presser.request(m.EStop(display=NAME))), m.Done)
    world.run(asyncio.sleep(0.5))
    ((kind, reason),) = events_of(other)
    assert (kind, "app" in reason) == ("estopped", True)
    assert isinstance(world.run(presser.request(m.ClearEstop(display=NAME, estop=1))), m.Done)
    world.run(asyncio.sleep(0.5))
    assert ("cleared", "e-stop 1 was cleared") in events_of(other)


def test_what_a_client_plays_fades_when_it_leaves_though_another_has_armed(
    world: World, serve: Callable[..., Client], peaks: list[float]
) -> None:
    """An effect of 5 s, of which 1 s is played."""
    stays = serve()
    assert world.host is not None
    leaves = world.host.connect("other", roles=m.ALL_ROLES)
    for client in (stays, leaves):
        assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()
    curve = (m.Point(0.0, 1.0), m.Point(5000.0, 1.0))
    effect = m.PlayEffect(display=NAME, amplitude_um=5.0, amplitude=curve)
    assert world.run(leaves.request(effect)) == m.Done()
    world.run(asyncio.sleep(1.0))
    assert max(peaks[-10:]) > 0.0

    async def left() -> None:
        leaves.close()
        await asyncio.sleep(0.5)

    world.run(left())
    peaks.clear()
    world.run(asyncio.sleep(0.5))
    assert world.host.playing[NAME].state == "armed"
    assert max(peaks) == 0.0


def test_each_texture_of_a_selection_is_felt(
    world: World, serve: Callable[..., Client], peaks: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The store keeps no more than one texture that nobody has selected."""
    monkeypatch.setattr(texture_store, "MOST_TEXTURES", 1)
    client = serve(worn=True)
    layers = (m.Layer(texture="wood-oak"), m.Layer(texture="leather-calf"))
    assert world.run(client.request(m.Select(display=NAME, layers=layers))) == m.Done()
    assert world.host is not None
    ready = world.host.playing[NAME]._texture_store.ready
    assert [name for name, _ in ready] == ["wood-oak", "leather-calf"]
    assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()
    for k in range(30):
        place = (0.5 * k, 0.0)
        touch = m.Contact(
            display=NAME, position_mm=place, normal_force_n=1.0, velocity_mm_s=(50.0, 0.0)
        )
        assert client.stream(touch, world.clock.now()) is None
        world.run(asyncio.sleep(0.01))
    assert max(peaks) > 1.0


def test_who_has_disarmed_owns_no_high_voltage_that_another_switches_on_at_once(
    world: World, serve: Callable[..., Client]
) -> None:
    stays = serve()
    assert world.host is not None
    leaves = world.host.connect("other", roles=m.ALL_ROLES)

    async def hand_over() -> None:
        assert await stays.request(m.ArmDisplay(display=NAME)) == m.Done()
        assert await stays.request(m.DisarmDisplay(display=NAME)) == m.Done()
        assert await leaves.request(m.ArmDisplay(display=NAME)) == m.Done()
        leaves.close()

    world.run(hand_over())
    world.run(asyncio.sleep(0.5))
    assert world.host.playing[NAME].state == "disarmed"


def test_who_leaves_while_playback_is_lost_asks_nothing_of_it(
    world: World, serve: Callable[..., Client]
) -> None:
    client = serve()
    layers = (m.Layer(texture="wood-oak"),)
    assert world.run(client.request(m.Select(display=NAME, layers=layers))) == m.Done()
    playback_of(world).kill()
    world.run(asyncio.sleep(0.01))
    assert world.host is not None
    assert world.host.playing[NAME].lost

    async def leave() -> None:
        client.close()

    world.run(leave())
    world.run(asyncio.sleep(BACK))
    assert world.errors.all == []


def test_a_server_that_ends_says_of_no_playback_that_it_was_lost(
    world: World, serve: Callable[..., Client]
) -> None:
    client = serve()
    world.stop()
    assert "lost" not in {kind for kind, _ in events_of(client)}


@pytest.mark.parametrize(
    ("device", "opened"),
    [
        ("serial:///dev/x", "serial:///dev/x?rearm=true"),
        ("serial:///dev/x?baud=9600", "serial:///dev/x?baud=9600&rearm=true"),
        ("can:virtual/x?rearm=false", "can:virtual/x?rearm=false"),
        ("mock:?link=can", "mock:?link=can&rearm=true"),
        ("sim:", "sim:"),
    ],
)
def test_a_link_is_opened_so_that_it_arms_again_where_that_is_configured(
    world: World, serve: Callable[..., Client], monkeypatch: pytest.MonkeyPatch, device: str,
    opened: str,
) -> None:  # fmt: skip
    devices: list[str] = []

    def open_in_memory(url: str, display: Display, **options: Any) -> Bus:
        devices.append(url)
        return open_bus("mock:", display, **options)

    monkeypatch.setattr(playback_process, "open_bus", open_in_memory)
    serve(device, rearm=True)
    assert devices == [opened]
    playback_of(world).kill()
    world.run(asyncio.sleep(BACK))
    assert devices == [opened] * 2


def test_a_device_that_stays_away_is_opened_less_and_less_often(
    world: World, serve: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wait is 0.5 s after the first try in vain, twice as long each time, 10 s in the end."""
    serve()
    tries: list[float] = []

    def open_nothing(setup: PlaybackSetup) -> Any:
        tries.append(world.clock.now())
        raise BusError("it is not plugged in")

    monkeypatch.setattr(playback_process, "open_device", open_nothing)
    playback_of(world).kill()
    world.run(asyncio.sleep(50.0))
    pauses = [b - a for a, b in pairwise(tries)]
    assert pauses[:8] == pytest.approx([0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 10.0], abs=0.2)


def test_the_latency_told_before_any_contact_is_that_of_a_block(
    world: World, serve: Callable[..., Client]
) -> None:
    """16 samples at 2.5 kHz; amplifiers in memory put out at once what is written."""
    serve()
    assert world.host is not None
    assert world.host.playing[NAME].info.latency_ms == pytest.approx(6.4)
