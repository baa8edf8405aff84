"""E-stops win against every other call of a bus, whenever and from whichever thread they come.

The interleavings are made, not hoped for: a driver e-stops its own bus at a chosen point of another
call, from that thread or from another. Its model of an amplifier is as bad as a driver may be: what
it was told last is what it does, latched or not.
"""

import threading
from collections.abc import Callable

import numpy as np
import pytest

from firmware_protocol.messages import State
from tactile.bus.base import Bus, DriveBlock, Wiring
from tactile.bus.simulated.mock_bus import MockBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, BusStateError

WIRING = Wiring(channels=2, sample_rate=8000.0, voltage=100.0, slew=0.7e6, fade=20e-3)
BLOCK = np.full((16, 2), 5.0)
ROUNDS = 300
PATIENCE = 60.0
"""Longest time that a thread may take [s]."""


class Hooked(Bus):
    """A driver that calls back, before and after what it does.

    Attributes
    ----------
    hooks : functions to call, once each, by their place: "before _start" and so on
    plays, latched : state of the amplifier
    """

    on_host_death = "ramps"
    paced = False

    def __init__(self) -> None:
        super().__init__(WIRING)
        self.hooks: dict[str, Callable[[], object]] = {}
        self.plays = self.latched = False
        self.written = 0

    def _do(self, name: str, plays: bool, latched: bool | None = None) -> None:
        self.hooks.pop(f"before {name}", lambda: None)()
        self.plays = plays
        self.latched = self.latched if latched is None else latched
        self.hooks.pop(f"after {name}", lambda: None)()

    def _start(self, position: int) -> None:
        self._do("_start", plays=True)

    def _write(self, block: DriveBlock) -> None:
        self.hooks.pop("in _write", lambda: None)()
        self.written += len(block.volts)

    def _stop(self) -> None:
        self._do("_stop", plays=False)

    def _abort(self) -> None:
        self._do("_abort", plays=False)

    def _estop(self) -> None:
        self._do("_estop", plays=False, latched=True)

    def _clear(self) -> None:
        self._do("_clear", plays=False, latched=False)


def here(call: Callable[[], None]) -> None:
    """Call something, as a signal handler does that interrupts the thread."""
    call()


def elsewhere(call: Callable[[], None]) -> None:
    """Call something from another thread, and wait for it."""
    thread = threading.Thread(target=call)
    thread.start()
    thread.join(PATIENCE)
    assert not thread.is_alive(), "an e-stop waits for the call that it overtakes"


WHERE = pytest.mark.parametrize("run", [here, elsewhere])
WHEN = pytest.mark.parametrize("when", ["before", "after"])


def assert_latched(bus: Hooked) -> None:
    """See that it is e-stopped, as its amplifier is, until it is cleared, and plays again then."""
    assert {bus.state, bus.status.state} == {"estopped"}
    assert (bus.plays, bus.latched) == (False, True)
    with pytest.raises(BusStateError, match="clear it first"):
        bus.start()
    assert (bus.plays, bus.latched) == (False, True)
    bus.clear()
    assert (bus.state, bus.latched) == ("idle", False)
    bus.start()
    assert (bus.state, bus.status.playing, bus.plays) == ("running", True, True)
    bus.stop()
    assert bus.state == "idle"


@WHERE
@WHEN
@pytest.mark.parametrize("call", ["stop", "abort"])
def test_an_estop_during_an_end_holds(run: Callable[..., None], when: str, call: str) -> None:
    bus = Hooked()
    bus.start()
    bus.hooks[f"{when} _{call}"] = lambda: run(bus.estop)
    getattr(bus, call)()
    assert_latched(bus)


@WHERE
@WHEN
def test_an_estop_during_a_start_holds_and_the_start_raises(
    run: Callable[..., None], when: str
) -> None:
    bus = Hooked()
    bus.hooks[f"{when} _start"] = lambda: run(bus.estop)
    with pytest.raises(BusStateError, match="start: the bus was e-stopped meanwhile; clear it"):
        bus.start()
    assert_latched(bus)


def test_an_estop_when_a_start_has_all_but_ended_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Hooked()
    begin = bus._states.begin

    def begin_late(estops: int) -> None:
        elsewhere(bus.estop)
        begin(estops)

    monkeypatch.setattr(bus._states, "begin", begin_late)
    with pytest.raises(BusStateError, match="e-stopped meanwhile"):
        bus.start()
    monkeypatch.undo()
    assert_latched(bus)


def test_a_start_that_fails_by_an_estop_says_both() -> None:
    bus = Hooked()

    def fail() -> None:
        bus.estop()
        raise BusError("start: it does not start")

    bus.hooks["after _start"] = fail
    with pytest.raises(BusStateError, match="e-stopped meanwhile") as caught:
        bus.start()
    assert str(caught.value.__cause__) == "start: it does not start"
    assert_latched(bus)


@WHERE
@WHEN
def test_an_estop_during_a_clear_holds_and_the_clear_raises(
    run: Callable[..., None], when: str
) -> None:
    bus = Hooked()
    bus.estop()
    bus.hooks[f"{when} _clear"] = lambda: run(bus.estop)
    with pytest.raises(BusStateError, match="clear: the bus was e-stopped meanwhile"):
        bus.clear()
    assert_latched(bus)


def test_a_clear_does_not_end_an_estop_that_has_not_come_to_its_end() -> None:
    bus, failed = Hooked(), []

    def clear() -> None:
        try:
            bus.clear()
        except BusStateError as error:
            failed.append(str(error))

    bus.start()
    bus.hooks["before _estop"] = lambda: elsewhere(clear)
    bus.estop()
    assert failed == ["clear: an e-stop is under way; clear it when it has ended"]
    assert_latched(bus)


def test_two_estops_at_once_are_ended_by_one_clear() -> None:
    bus = Hooked()
    bus.start()
    bus.hooks["before _estop"] = lambda: elsewhere(bus.estop)
    bus.estop()
    assert_latched(bus)


def test_an_estop_whose_driver_fails_is_one_all_the_same() -> None:
    bus = Hooked()

    def fail() -> None:
        raise OSError("gone")

    bus.hooks["after _estop"] = fail
    with pytest.raises(OSError, match="gone"):
        bus.estop()
    assert_latched(bus)


def test_an_estop_does_not_wait_for_a_start_that_takes_long_and_a_clear_does() -> None:
    bus, entered, release = Hooked(), threading.Event(), threading.Event()
    failed: list[str] = []

    def start() -> None:
        try:
            bus.start()
        except BusStateError as error:
            failed.append(str(error))

    def take_long() -> None:
        entered.set()
        assert release.wait(PATIENCE)

    bus.hooks["before _start"] = take_long
    starter = threading.Thread(target=start)
    starter.start()
    assert entered.wait(PATIENCE)
    bus.estop()
    assert bus.state == "estopped"
    assert failed == []
    clearer = threading.Thread(target=bus.clear)
    clearer.start()
    release.set()
    starter.join(PATIENCE)
    clearer.join(PATIENCE)
    assert failed == ["start: the bus was e-stopped meanwhile; clear it first"]
    assert (bus.state, bus.plays, bus.latched) == ("idle", False, False)


@WHERE
@WHEN
def test_an_estop_during_a_close_leaves_it_closed_and_at_0_volts(
    run: Callable[..., None], when: str
) -> None:
    bus = Hooked()
    bus.start()
    bus.hooks[f"{when} _stop"] = lambda: run(bus.estop)
    bus.close()
    assert bus.state == "closed"
    assert (bus.plays, bus.latched) == (False, True)
    bus.clear()
    assert bus.state == "closed"


# Writing


def test_a_write_after_anothers_estop_is_dropped_and_counted_until_a_stop() -> None:
    bus = Hooked()
    bus.start()
    bus.write(DriveBlock(0, BLOCK))
    elsewhere(bus.estop)
    bus.write(DriveBlock(16, BLOCK))
    assert (bus.written, bus.counters.faults()) == (16, {"dropped_samples": 16})
    bus.clear()
    bus.write(DriveBlock(32, BLOCK))
    assert (bus.written, bus.counters.dropped_samples) == (16, 32)
    bus.stop()
    with pytest.raises(BusStateError, match="write: the bus is idle, not running; start it first"):
        bus.write(DriveBlock(48, BLOCK))
    assert bus.counters.dropped_samples == 32


def test_an_estop_within_a_write_does_not_raise() -> None:
    bus = Hooked()
    bus.start()
    bus.hooks["in _write"] = lambda: elsewhere(bus.estop)
    bus.write(DriveBlock(0, BLOCK))
    assert_latched(bus)


# The mock


class LateMock(MockBus):
    """A mock whose `_stop` comes after an e-stop that came after the call of `stop`."""

    def _stop(self) -> None:
        elsewhere(self.estop)
        super()._stop()


def test_the_mock_ends_in_an_estop_as_well_and_is_not_stuck() -> None:
    bus = LateMock(WIRING)
    bus.start()
    bus.write(DriveBlock(0, BLOCK))
    bus.stop()
    assert bus.state == "estopped"
    assert {board.amplifier.state for board in bus.boards} == {State.ESTOP}
    assert not bus.output[-1].any()
    bus.clear()
    bus.start()
    assert bus.boards[0].amplifier.state == State.RUNNING


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("url", ["mock:", "sim:"])
def test_whatever_runs_beside_it_an_estop_holds(url: str, display: Display) -> None:
    """Threads meet in many rounds in any order; none of these orders may undo an e-stop."""
    bus = open_bus(url, display)
    assert isinstance(bus, MockBus)
    block, failed = np.full((16, 24), 5.0), []

    def play() -> None:
        try:
            for _ in range(2):
                bus.start()
                bus.write(DriveBlock(0, block))
                bus.stop()
        except BusStateError:
            assert bus.state == "estopped"
        except BaseException as error:
            failed.append(error)

    for _ in range(ROUNDS):
        threads = [threading.Thread(target=one) for one in (play, bus.estop)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        assert failed == []
        assert {bus.state} == {"estopped"}
        assert all(board.amplifier.state == State.ESTOP for board in bus.boards)
        assert not bus.output[-1:].any()
        bus.clear()
        assert bus.state == "idle"
    bus.start()
    assert bus.state == "running"
    bus.close()
