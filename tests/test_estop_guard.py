"""The e-stop of a device that a program drives without a server."""

import logging
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from bringup_rig import Served
from c_amplifier_rig import ESTOPPED
from cli_rig import Command

import tactile
from tactile.bringup import bringup
from tactile.bringup.bringup import bring_up
from tactile.bus.base import Bus
from tactile.bus.simulated.mock_bus import MockBus
from tactile.devices import open_bus
from tactile.display.display import Display, load_display
from tactile.errors import BusError, InputError
from tactile.estop.latch import Latch
from tactile.estop.process import bind
from tactile.estop.request import request_estop
from tactile.paths import estop_sockets, state_folder
from tactile.playback import estop_guard, runs
from tactile.playback.estop_guard import clear_device, guarded
from tactile.playback.trajectory_playback import PlayedBlock

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs locks of files")

MOCK = "mock:"
HELD = r"mock:: e-stop 1 holds, by tactile estop.*tactile clear --device mock: ends it"
PATIENCE = 60.0
"""Time until a test gives up [s]; nothing that is tested depends on it."""


@pytest.fixture
def bus(display: Display) -> Iterator[Bus]:
    with open_bus(MOCK, display) as bus:
        yield bus


def wait_until_estopped(bus: Bus) -> None:
    """Wait for what follows the answer to an e-stop."""
    deadline = time.monotonic() + PATIENCE
    while bus.state != "estopped":
        assert time.monotonic() < deadline
        time.sleep(0.001)


def estop(bus: Bus) -> None:
    """Do what `tactile estop` does, and wait until it has been done."""
    (answer,) = request_estop(within=PATIENCE)
    assert answer.estops == {MOCK: 1}
    wait_until_estopped(bus)


def use(bus: Bus, work: Callable[[], object], device: str = MOCK) -> None:
    with guarded(bus, device):
        work()


def opened_by(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[Bus]:
    """Return a list of the buses that a module will open."""
    buses = list[Bus]()

    def open_it(*arguments: Any, **options: Any) -> Bus:
        buses.append(open_bus(*arguments, **options))
        return buses[-1]

    monkeypatch.setattr(module, "open_bus", open_it)
    return buses


def not_reached() -> None:
    pytest.fail("an e-stop holds, or another program has the latch")


def held(device: str = MOCK) -> int:
    with closing(Latch.open(device, state_folder())) as latch:
        return latch.holds


def trip(device: str = MOCK) -> None:
    with closing(Latch.open(device, state_folder())) as latch:
        latch.trip("by a person")


def choose_that(number: int, reason: str) -> int:
    return number


def chosen(estop: int, number: int, reason: str) -> int:
    return estop


def cleared(display: Display, choose: Callable[[int, str], int] = choose_that) -> int:
    return clear_device(MOCK, display, choose, accept_unsafe_hold=False)


@pytest.mark.parametrize("begun", [False, True])
def test_tactile_estop_stops_a_bus_that_starts_no_more(
    bus: Bus, display: Display, *, begun: bool
) -> None:

    def play() -> None:
        if begun:
            bus.start()
        estop(bus)
        bus.start()

    with pytest.raises(BusError, match=HELD) as caught:
        use(bus, play)
    assert "the bus is estopped" in str(caught.value.__cause__)
    assert estop_sockets() == []
    assert "tactile-estop" not in {one.name for one in threading.enumerate()}
    for url in (MOCK, "mock:?keep=all"):
        with open_bus(url, display) as other, pytest.raises(BusError, match="e-stop 1 holds"):
            use(other, not_reached, url)
    assert cleared(display) == 2, "its second: that of the URL with an option was taken over"
    assert cleared(display) == 0
    with open_bus(MOCK, display) as other:
        use(other, other.start)


def test_a_run_ends_with_the_e_stop(display: Display, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = list[PlayedBlock]()

    def watch(block: PlayedBlock, renderer: object) -> None:
        blocks.append(block)
        if len(blocks) == 5:
            estop(buses[0])

    buses = opened_by(runs, monkeypatch)
    oak, line = tactile.load_texture("wood-oak"), tactile.Trajectory.line(speed=0.08, duration=60.0)
    outcome = runs.run(display, oak, line, device=MOCK, watch=watch).outcome
    assert outcome.ending == "failed"
    assert re.search(HELD, outcome.cause)
    assert outcome.put_out_samples <= 6 * 64
    assert len(blocks) == 5
    with pytest.raises(BusError, match=HELD):  # nothing was put out, and so it is an error
        runs.run(display, oak, line, device=MOCK)
    assert buses[0].state == "closed"


def test_a_bring_up_ends_with_the_e_stop(monkeypatch: pytest.MonkeyPatch) -> None:

    def progress(done: int, total: int) -> None:
        if done == 2:
            estop(buses[0])

    buses = opened_by(bringup, monkeypatch)
    with pytest.raises(BusError, match=HELD):
        bring_up(MOCK, "reference-24", progress=progress)


def test_an_e_stop_of_the_amplifier_gets_a_number(bus: Bus, display: Display) -> None:

    def play() -> None:
        bus.estop()
        bus.start()

    for work in (play, not_reached):
        with pytest.raises(BusError, match=r"e-stop 1 holds, by the amplifier, 20"):
            use(bus, work)
    assert cleared(display) == 1


def test_another_error_stays_what_it_was(bus: Bus) -> None:
    def play() -> None:
        raise BusError("the link is down")

    with pytest.raises(BusError, match=r"^the link is down$"):
        use(bus, play)
    assert held() == 0
    assert estop_sockets() == []


def test_what_has_no_voltage_has_no_e_stop(display: Display) -> None:
    with open_bus("sim:", display) as bus, guarded(bus, "sim:"):
        assert request_estop() == []
    assert not state_folder().exists()


def test_only_the_e_stop_that_is_named_is_cleared(display: Display) -> None:
    trip()
    trip()
    for other in (1, 3):
        why = rf"^clear: e-stop 2 of mock: holds, not {other}: by a person"
        with pytest.raises(InputError, match=why):
            cleared(display, choose=partial(chosen, other))
    assert held() == 2
    assert cleared(display) == 2
    assert held() == 0


def test_an_e_stop_of_the_amplifier_while_a_person_is_asked_holds(
    display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    def choose(number: int, reason: str) -> int:
        buses[0].estop()
        return number

    buses = opened_by(estop_guard, monkeypatch)
    trip()
    with pytest.raises(InputError, match=r"^clear: e-stop 2 of mock: holds, not 1: by the ampl"):
        cleared(display, choose)
    assert held() == 2


def test_what_the_amplifier_refuses_to_clear_holds(
    display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Bus) -> None:
        raise BusError("the input is pressed")

    trip()
    monkeypatch.setattr(MockBus, "clear", refuse)
    with pytest.raises(BusError, match="the input is pressed"):
        cleared(display)
    assert held() == 1


def test_a_program_that_cannot_listen_says_so_and_plays(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(name: str) -> tuple[socket.socket, str]:
        raise OSError("No space left on device")

    monkeypatch.setattr(estop_guard, "bind", fail)
    with caplog.at_level(logging.WARNING), guarded(bus, MOCK):
        bus.start()
    assert caplog.messages == ["tactile estop does not reach this program: No space left on device"]


def test_an_e_stop_that_fails_is_told_and_the_next_is_taken(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The e-stop is latched nonetheless."""
    stop = MockBus._estop

    def fail(self: MockBus) -> None:
        monkeypatch.setattr(MockBus, "_estop", stop)
        raise BusError("the cable is out")

    monkeypatch.setattr(MockBus, "_estop", fail)

    def play() -> None:
        for number in (1, 2):
            (answer,) = request_estop(within=PATIENCE)
            assert answer.estops == {MOCK: number}
        wait_until_estopped(bus)

    with pytest.raises(BusError, match="e-stop 2 holds"):
        use(bus, play)
    assert [one for one in caplog.messages if "cable" in one] == [
        "e-stop of mock:: the cable is out"
    ]


def test_a_program_that_plays_keeps_others_from_the_latch(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactile.estop.latch.LOCK_WITHIN", -1.0)
    with guarded(bus, MOCK), pytest.raises(BusError, match="another"):
        use(bus, not_reached)


def test_the_commands_stop_and_clear_a_device(
    command: Command, bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    patient = partial(request_estop, within=PATIENCE)
    monkeypatch.setattr("tactile.cli.estop_command.request_estop", patient)

    def play() -> None:
        left, _ = bind("of-a-program-that-was-killed")
        left.close()
        result = command("estop")
        assert (result.code, result.err) == (0, "")
        assert result.out == "mock:: e-stop 1 is latched; tactile clear --device mock: ends it\n"

    with pytest.raises(BusError, match=HELD):
        use(bus, play)
    result = command("play", "wood-oak", "--seconds", "0.1", "--device", MOCK)
    assert result.code == 2
    assert "e-stop 1 holds, by tactile estop" in result.err
    result = command("clear", "--device", MOCK, "--estop", 1, "--json")
    assert result.json == {"display": MOCK, "cleared": 1}
    assert command("clear", "--device", MOCK).out == "no e-stop holds\n"
    assert command("play", "wood-oak", "--seconds", "0.1", "--device", MOCK).code == 0
    result = command("estop")
    assert (result.code, result.err) == (
        1, "no tactile program that can be stopped is running on this machine\n"
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--device", MOCK, "--url", "ws://127.0.0.1:1"], "--url cannot be used with --device"),
        (["--device", MOCK, "--estop", "0"], "greater than or equal to 1"),
        (["--device", MOCK, "--json"], "give the number of the e-stop with --estop"),
        (["nobody", "--device", MOCK], "nobody"),
        (["--device", "serial:///dev/ttyNONE"], "ttyNONE"),
    ],
)
def test_what_cannot_be_cleared_is_one_line(
    command: Command, arguments: list[str], why: str
) -> None:
    result = command("clear", *arguments)
    assert result.code == 2
    assert result.out == ""
    assert why in result.err


@pytest.mark.realtime
def test_the_c_amplifier_is_stopped_and_cleared(serve: Callable[..., Served], four: Path) -> None:
    """The amplifier has a latch of its own, which the next program meets and a clear ends."""
    served, shown = serve(), load_display(four)

    with open_bus(served.url, shown) as link:

        def play() -> None:
            link.start()
            (answer,) = request_estop(within=PATIENCE)
            assert answer.estops == {served.url: 1}
            wait_until_estopped(link)

        with pytest.raises(BusError, match="e-stop 1 holds"):
            use(link, play, served.url)
    for file in state_folder().glob("*.estop"):
        os.remove(file)
    with pytest.raises(BusError, match="e-stop 1 holds, node 1 was e-stopped"):
        bring_up(served.url, four)
    assert clear_device(served.url, shown, choose_that, accept_unsafe_hold=False) == 1
    with open_bus(served.url, shown) as link:
        use(link, link.start, served.url)
    states, _ = served.rows()
    assert np.any(states[:, 0] == ESTOPPED)
    assert states[-1, 0] != ESTOPPED
