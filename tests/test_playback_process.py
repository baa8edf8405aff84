"""Tests of the playback process, which watches the latch and the server's signs of life.

The loop is turned by hand and time is passed in; the bus is the mock amplifier.
"""

import pickle
import queue
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile import messages as m
from tactile.bus.base import Wiring
from tactile.bus.simulated.mock_bus import MockBus
from tactile.clock import ModelClock
from tactile.display.display import Display
from tactile.estop.latch import Latch, LatchWriter
from tactile.playback import commands
from tactile.playback.commands import Order, OrderAnswer
from tactile.playback.loop import PlaybackLoop
from tactile.playback.process import Message, Program
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.waves import Curve
from tactile.processes import ChildProcess, send

RATE = 8000.0
NAME = "left"
ARM, DISARM = m.ArmDisplay(display=NAME), m.DisarmDisplay(display=NAME)
BLOCK = 16
ME = 1
WATCH = 5e-3
"""Interval between looks at the latch and the server [s]."""
SILENCE = 0.15
"""Time without a heartbeat after which all fades and is disarmed, as docs/guide/server.md says
[s]."""


@dataclass
class Stage:
    """A program whose loop a test turns, the server's end of all that both map, and the clock."""

    program: Program
    player: PlaybackLoop
    bus: MockBus
    memory: PlaybackMemory
    latch: Latch
    said: list[Message]
    _number: int = 0

    def order(self, order: Order) -> OrderAnswer:
        """Have an order obeyed, and return the answer."""
        self._number += 1
        self.program.take(*pickle.loads(pickle.dumps((self._number, order))))
        self.program.turn()
        answers = [what for what in self.said if isinstance(what, OrderAnswer)]
        assert answers[-1].number == self._number
        return answers[-1]

    def play(self, seconds: float, *, beats: bool = True) -> NDArray[np.float64]:
        """Play, with or without heartbeats of the server; return what was put out (S, C) [V]."""
        before = len(self.bus.output)
        for _ in range(round(seconds / WATCH)):
            if beats:
                self.memory.beat()
            self.program.look_at_server(WATCH)
            self.program.look_at_latch()
            for _ in range(round(WATCH * RATE / BLOCK)):
                self.program.turn()
        return self.bus.output[before:]

    def sound(self) -> None:
        """Begin an effect of a minute."""
        curve = Curve(
            2e-6,
            np.array([[0.0, 1.0], [60.0, 1.0]]),
            np.array([[0.0, 200.0]]),
            np.zeros((0, 3)),
            stream=False,
        )
        assert not self.order(commands.BeginEffect(ME, curve)).failure


@pytest.fixture
def stage(display: Display) -> Iterator[Stage]:
    memory = PlaybackMemory.create(len(display.contactors))
    latch = Latch.open("sim:", Path())
    clock = ModelClock()
    bus = MockBus(Wiring.of(display, RATE), keep="all", clock=clock)
    shared = PlaybackMemory(memory.handle, len(display.contactors))
    player = PlaybackLoop(display, bus, shared, worn=True, clock=clock)
    said: list[Message] = []
    program = Program(player, Latch(latch.handle, LatchWriter.PLAYBACK), said.append)
    yield Stage(program, player, bus, memory, latch, said)
    bus.close()
    memory.close()


@pytest.fixture
def playing(stage: Stage) -> Stage:
    """Return a stage on which an effect sounds."""
    stage.play(WATCH)
    assert not stage.order(ARM).failure
    stage.sound()
    assert stage.play(0.1).any()
    return stage


def test_who_arms_what_is_armed_silences_nobody(playing: Stage) -> None:
    assert not playing.order(ARM).failure
    assert playing.play(0.05).any()


def test_without_heartbeats_all_fades_and_is_disarmed(playing: Stage, display: Display) -> None:
    before = playing.play(SILENCE - WATCH, beats=False)
    assert before[-BLOCK:].any(), "it plays on for as long as a server may be late"
    after = playing.play(0.1, beats=False)
    assert not after[round((2 * WATCH + display.limits.fade) * RATE) :].any()
    assert np.abs(np.diff(after, axis=0)).max() <= playing.bus.wiring.slew / RATE
    assert playing.bus.state == "idle"
    assert playing.memory.report().state == "disarmed"


def test_what_was_faded_does_not_come_back_with_the_server(playing: Stage) -> None:
    playing.play(0.3, beats=False)
    assert not playing.play(0.3).any(), "nobody armed it"
    assert not playing.order(ARM).failure
    assert not playing.play(0.3).any(), "the effect is gone"


def test_a_silent_server_arms_nothing(stage: Stage) -> None:
    stage.play(0.3, beats=False)
    assert "silent" in stage.order(ARM).failure
    stage.play(WATCH)
    assert not stage.order(ARM).failure


def test_time_in_which_playback_stood_still_is_not_the_servers_silence(playing: Stage) -> None:
    """The whole machine may have stood still, and the server gave no heartbeat either."""
    playing.program.look_at_server(10.0)
    period = round(RATE / 200)
    out = np.abs(playing.play(SILENCE - 3 * WATCH, beats=False))
    assert out[-period:].max() == pytest.approx(out[:period].max(), rel=1e-3), "nothing fades"


@pytest.mark.parametrize("writer", list(LatchWriter))
def test_whoever_trips_the_latch_the_output_falls_and_stays_at_0(
    playing: Stage, writer: LatchWriter
) -> None:
    number = Latch(playing.latch.handle, writer).trip("by a test")
    after = playing.play(0.1)
    assert not after[round(0.01 * RATE) :].any()
    assert playing.bus.state == "estopped"
    assert f"e-stop {number} holds" in playing.order(ARM).failure
    assert not playing.play(0.1).any()


def test_a_clear_must_name_the_e_stop_that_holds(playing: Stage) -> None:
    playing.latch.trip("first")
    playing.latch.trip("second")
    playing.play(0.05)
    assert "e-stop 2 holds, not 1" in playing.order(m.ClearEstop(display=NAME, estop=1)).failure
    assert playing.order(m.ClearEstop(display=NAME, estop=2)) == OrderAnswer(playing._number)
    assert "e-stop 2 holds" in playing.order(ARM).failure, "the server has not said so"
    playing.latch.clear(2)
    assert not playing.order(ARM).failure


def test_an_e_stop_while_another_is_cleared_holds(
    playing: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    playing.latch.trip("first")
    playing.play(0.05)
    clear = playing.bus.clear

    def interrupted() -> None:
        clear()
        playing.latch.trip("second, while the amplifier was cleared")

    monkeypatch.setattr(playing.bus, "clear", interrupted)
    assert "e-stop 2 holds, not 1" in playing.order(m.ClearEstop(display=NAME, estop=1)).failure
    playing.play(0.05)
    assert playing.bus.state == "estopped"
    assert playing.latch.holds == 2


def test_an_e_stop_of_the_amplifier_is_latched_with_a_number(playing: Stage) -> None:
    playing.bus.estop()
    playing.play(0.05)
    assert playing.latch.holds == 1
    assert "by the amplifier" in playing.latch.reason
    playing.play(0.5)
    assert playing.latch.number == 1, "it is one e-stop, however long it lasts"
    assert not playing.order(m.ClearEstop(display=NAME, estop=1)).failure
    playing.latch.clear(1)
    assert not playing.order(ARM).failure


def test_an_e_stop_of_an_amplifier_that_is_e_stopped_has_a_number_of_its_own(
    playing: Stage,
) -> None:
    """A clear of the first would otherwise end the second, which came a moment before."""
    playing.latch.trip("by a program")
    playing.play(0.05)
    playing.bus.estop()
    assert "e-stop 2 holds, not 1" in playing.order(m.ClearEstop(display=NAME, estop=1)).failure
    playing.play(0.05)
    assert playing.latch.number == 2
    assert not playing.order(m.ClearEstop(display=NAME, estop=2)).failure


def test_a_new_playback_finds_the_latch_of_the_one_before(stage: Stage, display: Display) -> None:
    stage.latch.trip("while there was no playback")
    stage.play(0.05)
    assert stage.bus.state == "estopped"
    assert "e-stop 1 holds" in stage.order(ARM).failure


def test_an_amplifier_that_is_still_e_stopped_is_no_new_e_stop(
    stage: Stage, display: Display
) -> None:
    """A playback that is started again finds both: the latch, and the amplifier's own."""
    stage.latch.trip("before playback died")
    stage.bus.estop()
    stage.program = Program(
        stage.player, Latch(stage.latch.handle, LatchWriter.PLAYBACK), stage.said.append
    )
    stage.play(0.05)
    assert stage.latch.number == 1


def test_an_order_that_fails_is_answered_and_the_loop_goes_on(
    playing: Stage, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def broken() -> None:
        raise ZeroDivisionError("nobody expected that")

    monkeypatch.setattr(playing.player, "disarm", broken)
    assert "nobody expected that" in playing.order(DISARM).failure
    assert "ZeroDivisionError" in capfd.readouterr().err
    assert playing.play(0.05).any()


@pytest.mark.ci
def test_a_device_with_a_time_of_its_own_is_refused(display: Display) -> None:
    """Check a device that was armed and silent, since its time stood still during waits."""
    answers: queue.Queue[Any] = queue.Queue()
    process = ChildProcess("tactile.playback.process", answers.put)
    try:
        setup = commands.PlaybackSetup(
            display, "mock:?link=serial", False, None, False, 1.0, False, "", ""
        )
        send(process._pipe, setup)
        opened = answers.get(timeout=120.0)
    finally:
        process.kill()
    assert opened.why_not.startswith("mock:?link=serial: the modeled link has a time of its own")


def test_a_watch_that_fails_ends_playback_and_with_it_what_plays(
    playing: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The amplifier's watchdog does the rest; the server starts playback again."""

    def broken() -> None:
        raise OSError("the device is gone")

    monkeypatch.setattr(playing.bus, "estop", broken)
    playing.latch.trip("by a test")
    with pytest.raises(OSError, match="the device is gone"):
        playing.program.watch()
    assert playing.program._ended


def turn_while(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, orders: list[tuple[int, Order]]
) -> list[int]:
    """Do a turn in which orders come while playback waits; return what was answered by then."""
    sleep = stage.player.clock.sleep

    def arrive(seconds: float) -> None:
        sleep(seconds)
        if seconds > 0:
            for number, order in orders:
                stage.program.take(number, order)

    with monkeypatch.context() as patch:
        patch.setattr(stage.player.clock, "sleep", arrive)
        stage.program.turn()
    return [one.number for one in stage.said if isinstance(one, OrderAnswer)]


def test_frames_that_come_while_playback_waits_are_in_the_very_next_block(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop that comes then waits for its turn, so that nothing delays the block."""
    stage.play(WATCH)
    assert not stage.order(ARM).failure
    stage.play(0.1)  # until what plays has faded in
    frames = np.full((1, len(stage.player.display.contactors)), 1e-6, np.float32)
    newest = commands.AddFrames(ME, frames, 1000.0, latest=True)
    assert turn_while(stage, monkeypatch, [(101, newest), (102, commands.EndWaves(ME))])[-1] == 101
    stage.program.turn()
    assert stage.player.rendering.shear == pytest.approx(1e-6, rel=1e-3)  # a block later
    numbers = [one.number for one in stage.said if isinstance(one, OrderAnswer)]
    assert numbers[-1] == 102


def test_frames_that_follow_those_with_a_time_are_not_carried_out_before_them(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only so do they continue the stream that waits for its time."""
    stage.play(WATCH)
    assert not stage.order(ARM).failure
    stage.play(0.1)
    frames = np.full((40, len(stage.player.display.contactors)), 1e-6, np.float32)
    part = commands.AddFrames(ME, frames, 1000.0, latest=False)
    due = stage.bus.due(stage.player.position) + 0.2
    timed = commands.PlayAt(1, ME, due, True, part)
    assert turn_while(stage, monkeypatch, [(101, timed), (102, part)])[-2:] == [101, 102]
    assert not stage.play(0.15).any()
    assert stage.play(0.6).any()
    (reports,) = [one for one in stage.said if isinstance(one, list)]
    assert [(report.number, report.reason) for report in reports] == [(1, "")]


@pytest.mark.parametrize("armed", [False, True])
def test_no_more_messages_of_frames_than_of_other_orders_are_taken_in_a_turn(
    stage: Stage, armed: bool
) -> None:
    stage.play(WATCH)
    if armed:
        assert not stage.order(ARM).failure
    frames = np.zeros((1, len(stage.player.display.contactors)), np.float32)
    before = len(stage.said)
    for number in range(200, 220):
        stage.program.take(number, commands.AddFrames(ME, frames, 1000.0, latest=True))
    turns = []
    for _ in range(3):
        stage.program.turn()
        turns.append(len([one for one in stage.said[before:] if isinstance(one, OrderAnswer)]))
    assert turns == [8, 16, 20]


@pytest.mark.parametrize("end", [commands.EndWaves(ME), commands.ForgetClient(ME)])
def test_frames_that_came_before_what_ends_them_are_not_carried_out_after_it(
    stage: Stage, end: Order
) -> None:
    """Frames wait in a queue of their own, in which those of others keep their order."""
    stage.play(WATCH)
    assert not stage.order(ARM).failure
    stage.play(0.1)
    frames = np.full((40, len(stage.player.display.contactors)), 1e-6, np.float32)
    mine = commands.AddFrames(ME, frames, 1000.0, latest=False)
    yours = commands.AddFrames(2, frames[:1], 1000.0, latest=True)
    due = stage.bus.due(stage.player.position) + 0.2
    stage.program.take(101, commands.PlayAt(1, ME, due, False, mine))
    stage.program.take(102, yours)
    stage.program.take(103, yours)
    stage.program.take(104, end)
    stage.program.turn()
    numbers = [one.number for one in stage.said if isinstance(one, OrderAnswer)]
    assert numbers[-4:] == [101, 104, 102, 103]
    stage.play(0.6)
    (reports,) = [one for one in stage.said if isinstance(one, list)]
    (report,) = reports
    assert report.reason in ("it was stopped", "its program has left")
