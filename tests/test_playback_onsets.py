"""Tests of stimuli that begin at a time: with which sample, and what is reported otherwise."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile.bus.base import Wiring
from tactile.bus.marks import MarkReport
from tactile.bus.simulated.mock_bus import MockBus
from tactile.clock import ModelClock
from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.block_rendering import SamplePlayback
from tactile.playback.commands import (
    AddFrames,
    AppendSamples,
    BeginEffect,
    EndWaves,
    ForgetClient,
    PlayAt,
    SetState,
)
from tactile.playback.loop import PlaybackLoop
from tactile.playback.mixer import BEGINS_WORK, FADING, UNTOUCHED
from tactile.playback.onset_reports import NOT_CONFIRMED, OnsetReports
from tactile.playback.schedule import (
    BEGIN_WORK,
    CUT_WORK,
    MOST_SCHEDULED,
    MOST_VALUES,
    VALUES,
    Schedule,
    StimulusOutcome,
)
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.voice import ClientState
from tactile.playback.waves import Curve

Stimulus = AppendSamples | AddFrames | BeginEffect
RATE = 8000.0
BLOCK = 16
ME, YOU = 1, 2


@dataclass
class Stage:
    """A player on the mock amplifier, in its own time."""

    player: PlaybackLoop
    bus: MockBus
    shear: list[NDArray[np.float64]] = field(default_factory=list)
    """Commanded shear of each block since playing began, (S, N) [m]."""

    def rest(self, seconds: float) -> None:
        for _ in range(int(seconds * RATE / BLOCK)):
            self.player.step()
            assert isinstance(self.player.rendering, SamplePlayback)
            self.shear.append(self.player.rendering.trace)


@pytest.fixture
def stage(display: Display) -> Iterator[Stage]:
    """Yield a stage on which nothing plays, after it has faded in."""
    memory, clock = PlaybackMemory.create(len(display.contactors)), ModelClock()
    bus = MockBus(Wiring.of(display, RATE), clock=clock)
    player = PlaybackLoop(display, bus, memory, worn=True, clock=clock)
    player.arm()
    built = Stage(player, bus)
    built.rest(0.1)
    yield built
    bus.close()
    memory.close()


def waveform(
    rate: float = 1000.0, *, contactors: tuple[int, ...] = (3,), seconds: float = 0.05
) -> AppendSamples:
    return AppendSamples(ME, np.full(int(seconds * rate), 1e-6, np.float32), rate, contactors, True)


def effect() -> BeginEffect:
    points = np.array([[0.0, 1.0], [0.05, 1.0]])
    return BeginEffect(ME, Curve(1e-6, points, np.array([[0.0, 200.0]]), np.zeros((0, 3)), False))


def frames() -> AddFrames:
    return AddFrames(ME, np.full((50, 24), 1e-6, np.float32), 1000.0, False)


def commanded(stage: Stage, contactor: int = 3) -> NDArray[np.float64]:
    """Return the commanded shear of a contactor since playing began, sample by sample [m]."""
    return np.concatenate(stage.shear)[:, contactor]


def schedule(
    stage: Stage,
    stimulus: Stimulus,
    time: float,
    number: int = 1,
    *,
    drop_late: bool = True,
    marker: int = 0,
) -> None:
    stage.player.apply(PlayAt(number, ME, time, drop_late, stimulus, marker))


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.7])
@pytest.mark.parametrize("offset", [0, 5, 15])
@pytest.mark.parametrize(
    "stimulus",
    [waveform(), waveform(8000.0), waveform(11025.0), effect(), frames()],
    ids=["1 kHz", "8 kHz", "11 kHz", "effect", "frames"],
)
def test_a_stimulus_begins_with_the_sample_that_is_nearest_to_its_time(
    stage: Stage, stimulus: Stimulus, offset: int, fraction: float
) -> None:
    position = stage.player.position + 10 * BLOCK + offset
    due = stage.bus.due(position) + fraction / RATE
    schedule(stage, stimulus, due)
    stage.rest(0.06)
    (onset,) = stage.player.onsets
    expected = position + round(fraction)
    assert onset == StimulusOutcome(1, ME, expected)
    shear = commanded(stage)
    begun = int(np.flatnonzero(np.abs(shear[:-BLOCK]) > 1e-9)[0])
    # a sine is 0 at first, and begins to be noticed a sample later
    assert begun - expected in ((0, 1) if isinstance(stimulus, BeginEffect) else (0,))


def test_stimuli_of_the_same_time_begin_with_the_same_sample_on_all_contactors(
    stage: Stage,
) -> None:
    time = stage.bus.due(stage.player.position + 100)
    for k in range(24):
        schedule(stage, waveform(contactors=(k,)), time, k)
    stage.rest(0.05)
    assert {onset.position for onset in stage.player.onsets} == {stage.player.onsets[0].position}
    begun = {int(np.flatnonzero(commanded(stage, k))[0]) for k in range(24)}
    assert begun == {stage.player.onsets[0].position}


@pytest.mark.parametrize("drop_late", [False, True])
def test_a_time_that_has_passed_is_reported_and_the_stimulus_dropped_or_played(
    stage: Stage, drop_late: bool
) -> None:
    late = stage.bus.due(stage.player.position) - 0.05
    schedule(stage, waveform(), late, drop_late=drop_late)
    stage.rest(0.05)
    (onset,) = stage.player.onsets
    assert (onset.position is None) == drop_late
    assert onset.reason.startswith("late by 5")
    assert commanded(stage).any() != drop_late


@pytest.mark.parametrize("rate", [RATE, 1200.0])
@pytest.mark.parametrize("drop_late", [False, True])
def test_contactors_that_play_something_else_make_a_stimulus_late(
    stage: Stage, drop_late: bool, rate: float
) -> None:
    stage.player.apply(AppendSamples(ME, np.full(4006, 1e-6, np.float32), RATE, (3,), True))
    stage.rest(0.4)
    louder = AppendSamples(ME, np.full(400, 2e-6, np.float32), rate, (3,), True)
    schedule(stage, louder, stage.bus.due(stage.player.position + 160), drop_late=drop_late)
    stage.rest(0.2)
    (onset,) = stage.player.onsets
    begun = np.flatnonzero(commanded(stage) > 1.5e-6)
    assert onset.position == (None if drop_late else begun[0])
    assert "free" in onset.reason
    assert commanded(stage).max() < 2.5e-6, "not before the samples of another rate have ended"


@pytest.mark.parametrize("stimulus", [dataclasses.replace(waveform(RATE), append=False), frames()])
def test_a_stimulus_takes_the_place_of_what_plays(stage: Stage, stimulus: Stimulus) -> None:
    """A waveform that is not appended, and frames, which are a stream of their own."""
    before = np.full((400, 24), 3e-6, np.float32)
    if isinstance(stimulus, AddFrames):
        stage.player.apply(AddFrames(ME, before, 1000.0, False))
    else:
        stage.player.apply(AppendSamples(ME, before[:, 0], 1000.0, (3,), True))
    stage.rest(0.2)
    start = stage.player.position + 160
    schedule(stage, stimulus, stage.bus.due(start))
    stage.rest(0.3)
    assert stage.player.onsets == [StimulusOutcome(1, ME, start)]
    shear = commanded(stage)
    assert shear[start - 1] == pytest.approx(3e-6, rel=0.01)
    assert shear[start + 300 : start + 390] == pytest.approx(1e-6, rel=0.01)
    assert not shear[start + 900 :].any()


def test_samples_for_which_there_is_no_room_at_their_time_are_reported(stage: Stage) -> None:
    stage.player.apply(waveform(RATE, seconds=0.98))
    start = stage.player.position + stage.player.rendering.timed
    schedule(stage, waveform(RATE), stage.bus.due(start), drop_late=False)
    stage.rest(0.9)
    assert stage.player.onsets == [], "its contactors are not free yet"
    stage.rest(0.1)
    assert stage.player.onsets == [StimulusOutcome(1, ME, start + 7840, "240 samples had no room")]


def test_what_is_too_long_to_wait_is_taken_in_part_at_once(stage: Stage) -> None:
    """No more is taken than has room when it begins, and what is not is said and counted."""
    due = stage.bus.due(stage.player.position + 160)
    long = waveform(RATE, seconds=1.5)
    assert stage.player.apply(PlayAt(1, ME, due, True, long)) == (8000.0, 1.0)
    many = AddFrames(ME, np.full((500, 24), 1e-6, np.float32), 100.0, False)
    stage.player.apply(PlayAt(2, ME, due, True, many))
    assert stage.player.dropped_frames == 400
    stage.rest(0.1)
    assert {onset.reason for onset in stage.player.onsets} == {""}
    assert stage.player.dropped_frames == 400


def test_a_stimulus_that_finds_no_room_at_all_has_no_onset(stage: Stage) -> None:
    stage.player.apply(waveform(RATE, seconds=1.0))
    start = stage.player.position + stage.player.rendering.timed
    schedule(stage, waveform(RATE), stage.bus.due(start), drop_late=False)
    stage.rest(0.1)
    assert stage.player.onsets == [StimulusOutcome(1, ME, None, "400 samples had no room")]


def test_waveforms_of_one_rate_that_began_between_each_other_are_continued_without_a_gap(
    stage: Stage,
) -> None:
    start = stage.player.position + 160
    for number, contactor in enumerate((3, 4)):
        due = stage.bus.due(start + 4 * number)  # half of a sample at 1 kHz
        schedule(stage, waveform(contactors=(contactor,)), due, number)
    stage.rest(0.04)
    for contactor in (3, 4):
        stage.player.apply(waveform(contactors=(contactor,)))
    stage.rest(0.2)
    for contactor, begun in ((3, start), (4, start + 4)):
        shear = commanded(stage, contactor)
        assert shear[begun + 100 : begun + 700] == pytest.approx(1e-6, rel=0.01)


def test_a_stimulus_is_late_if_its_sample_was_in_the_block_before(stage: Stage) -> None:
    start = stage.player.position + stage.player.rendering.timed
    schedule(stage, waveform(RATE), stage.bus.due(start - 2), drop_late=False)
    schedule(stage, waveform(RATE, contactors=(4,)), stage.bus.due(start - 0.6), 2)  # type: ignore[arg-type]
    stage.rest(0.1)
    assert stage.player.onsets == [
        StimulusOutcome(1, ME, start, "late by 0.25 ms"),
        StimulusOutcome(2, ME, start),
    ], "the estimate of the clock may have moved by that between two blocks"


def test_a_block_that_is_cut_costs_the_work_of_its_client_again(stage: Stage) -> None:
    waiting = Schedule()
    for number, offset in enumerate((0, 5, 5)):
        waiting.add(PlayAt(number, ME, offset / RATE, True, waveform(RATE)))
    begins, used = waiting.take(0.0, BLOCK, RATE, BEGINS_WORK, lambda client: 1000)
    assert [begin.offset for begin in begins[ME]] == [0, 5, 5]
    assert used == 3 * (BEGIN_WORK + 400 // VALUES) + 1000 + 2 * CUT_WORK


def test_what_is_stopped_disarmed_or_never_armed_is_reported(stage: Stage) -> None:
    time = stage.bus.due(stage.player.position) + 1.0
    schedule(stage, waveform(), time, 1)
    stage.player.apply(EndWaves(YOU))
    assert stage.player.onsets == []
    stage.player.apply(EndWaves(ME))
    schedule(stage, waveform(), time, 2)
    stage.player.arm()
    schedule(stage, waveform(), time, 3)
    stage.player.disarm()
    assert [onset.number for onset in stage.player.onsets] == [2]
    assert not stage.player.running
    reports = stage.player.report_onsets()
    assert [report.number for report in reports] == [1, 2, 3]
    assert all(math.isnan(report.time) for report in reports)


def test_no_more_stimuli_wait_than_there_is_room_for(stage: Stage) -> None:
    time = stage.bus.due(stage.player.position) + 1.0
    for number in range(MOST_SCHEDULED):
        schedule(stage, waveform(), time, number)
    with pytest.raises(BusError, match="64 stimuli of this program wait"):
        schedule(stage, waveform(), time, 99)


def test_the_time_of_an_onset_is_reported_once_the_amplifier_has_reported(stage: Stage) -> None:
    time = stage.bus.due(stage.player.position + 100) + 0.3 / RATE
    schedule(stage, waveform(), time)
    stage.rest(0.2)
    assert stage.player.report_onsets() == []
    stage.rest(0.4)
    (report,) = stage.player.report_onsets()
    assert (report.number, report.client, report.reason) == (1, ME, "")
    assert abs(report.time - time) <= 0.5 / RATE
    assert report.uncertainty == 0
    assert stage.player.report_onsets() == []


def test_an_onset_of_which_samples_were_lost_is_less_certain_by_these(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    schedule(stage, waveform(), stage.bus.due(stage.player.position + 100))
    stage.rest(0.1)
    assert stage.player.report_onsets() == []
    unplayed = stage.bus.unplayed
    monkeypatch.setattr(MockBus, "unplayed", property(lambda bus: unplayed + 40))
    stage.rest(0.5)
    (report,) = stage.player.report_onsets()
    assert report.uncertainty == pytest.approx(40 / RATE)
    assert report.reason == "40 samples around it were not put out"


@pytest.mark.parametrize("lost", [0, 40])
def test_a_stimulus_that_was_written_to_a_lost_link_has_no_time(stage: Stage, lost: int) -> None:
    """A sound card has no clock either, but loses nothing."""
    reports, at = OnsetReports(stage.bus), stage.player.position
    with pytest.MonkeyPatch.context() as unplugged:
        unplugged.setattr(MockBus, "due_uncertainty", lambda bus, position: math.nan)
        reports.add(StimulusOutcome(1, ME, at), 0)
    reports.look(stage.bus.due(at) + 0.31, lost, running=True)
    (report,) = reports.take()
    assert math.isnan(report.time) == bool(lost)
    assert math.isnan(report.uncertainty)
    assert report.reason == ("40 samples around it were not put out" if lost else "")


def test_a_stimulus_that_an_estop_prevents_is_reported_at_once(stage: Stage) -> None:
    schedule(stage, waveform(), stage.bus.due(stage.player.position + 1600))
    stage.rest(0.1)
    stage.bus.estop()
    (report,) = stage.player.report_onsets()
    assert (report.number, report.reason) == (1, "the display was not armed")
    assert math.isnan(report.time)


def test_a_stimulus_that_was_written_and_not_put_out_is_reported(stage: Stage) -> None:
    reports = OnsetReports(stage.bus)
    reports.add(StimulusOutcome(7, ME, stage.player.position + 100), 0)
    now = stage.player.clock.now()
    reports.look(now, 0, running=True)
    assert reports.take() == []
    reports.look(now, 0, running=False)
    (report,) = reports.take()
    assert (report.number, report.reason) == (7, "playback ended before it")
    assert not reports.waiting


@pytest.mark.parametrize("apart", [5, 100])
def test_stimuli_begin_by_their_times_whatever_the_order_in_which_they_came(
    stage: Stage, apart: int
) -> None:
    start = stage.player.position + 160
    schedule(stage, waveform(8000.0), stage.bus.due(start + apart), 1)
    schedule(stage, waveform(8000.0, contactors=(4,)), stage.bus.due(start), 2)
    stage.rest(0.1)
    first, second = stage.player.onsets
    assert first == StimulusOutcome(2, ME, start)
    assert second == StimulusOutcome(1, ME, start + apart)


def test_what_is_appended_plays_now_while_a_waveform_waits_for_its_time(stage: Stage) -> None:
    start = stage.player.position + 1600
    schedule(stage, waveform(RATE), stage.bus.due(start))
    now = stage.player.position + stage.player.rendering.timed
    stage.player.apply(waveform(RATE))
    stage.rest(0.4)
    sounds = np.abs(commanded(stage)) > 0.9e-6
    assert sounds[now + 10 : now + 390].all()
    assert not sounds[now + 410 : start].any()
    assert sounds[start + 10 : start + 390].all()
    assert not sounds[start + 410 :].any()


def test_frames_continue_the_last_stream_that_waits(stage: Stage) -> None:
    start = stage.player.position + 160
    schedule(stage, frames(), stage.bus.due(start), 1)
    schedule(stage, frames(), stage.bus.due(start + 1600), 2)
    stage.player.apply(frames())
    stage.rest(0.5)
    sounds = np.abs(commanded(stage)) > 0.9e-6
    assert not sounds[start + 900 : start + 1590].any()
    assert sounds[start + 1650 : start + 2350].all(), "twice as long"


def test_a_program_that_has_many_stimuli_does_not_make_that_of_another_late(stage: Stage) -> None:
    start = stage.player.position + 160
    for client in (3, 4):
        for k in range(MOST_SCHEDULED):
            order = dataclasses.replace(waveform(8000.0, contactors=(k % 24,)), client=client)
            order = dataclasses.replace(order, append=False)
            stage.player.apply(PlayAt(k, client, stage.bus.due(start), False, order))
    other = dataclasses.replace(waveform(8000.0), client=YOU)
    stage.player.apply(PlayAt(99, YOU, stage.bus.due(start + 1), False, other))
    stage.rest(0.1)
    assert StimulusOutcome(99, YOU, start + 1) in stage.player.onsets
    assert len([onset for onset in stage.player.onsets if onset.reason]) > 50


def test_a_program_that_has_no_more_time_in_a_block_leaves_it_to_others(stage: Stage) -> None:
    waiting = Schedule()
    waiting.add(PlayAt(1, ME, 0.0, True, waveform(RATE)))
    waiting.add(PlayAt(2, YOU, 0.0, True, dataclasses.replace(effect(), client=YOU)))
    begins, used = waiting.take(0.0, BLOCK, RATE, BEGIN_WORK, lambda client: 0)
    assert (list(begins), used) == ([YOU], BEGIN_WORK), "an effect moves fewer values"


def test_onsets_are_reported_in_the_order_of_their_times(stage: Stage) -> None:
    reports = OnsetReports(stage.bus)
    begun = stage.player.position
    for number, position in enumerate((begun + 8000, begun + 100)):
        reports.add(StimulusOutcome(number, ME, position), 0)
    reports.look(stage.bus.due(begun + 100) + 0.31, 0, running=True)
    (report,) = reports.take()
    assert (report.number, reports.waiting) == (1, True)
    reports.look(stage.bus.due(begun + 8000) + 0.31, 0, running=True)
    (report,) = reports.take()
    assert (report.number, reports.waiting) == (0, False)


def test_frames_that_come_later_continue_a_stream_that_waits_for_its_time(stage: Stage) -> None:
    start = stage.player.position + 800
    schedule(stage, frames(), stage.bus.due(start))
    twice = AddFrames(ME, np.full((50, 24), 2e-6, np.float32), 1000.0, False)
    stage.player.apply(twice)
    stage.rest(0.3)
    shear = commanded(stage)
    assert not shear[:start].any()
    np.testing.assert_allclose(shear[start + 100 : start + 300], 1e-6, rtol=0.01)
    np.testing.assert_allclose(shear[start + 500 : start + 700], 2e-6, rtol=0.01)
    assert stage.player.dropped_frames == 0


def test_stimuli_that_a_block_has_no_time_to_begin_begin_in_the_next_one_and_are_late(
    stage: Stage,
) -> None:
    """Four clients have 24 of one time each, of which a block begins 74, of each as many."""
    start = stage.player.position + 160
    time = stage.bus.due(start)
    for client in range(4):
        for k in range(24):
            order = dataclasses.replace(waveform(8000.0, contactors=(k,)), client=client)
            stage.player.apply(PlayAt(100 * client + k, client, time, k == 23, order))
    stage.rest(0.1)
    onsets = {onset.number: onset for onset in stage.player.onsets}
    assert len(onsets) == 4 * 24
    exact = [onset for onset in onsets.values() if onset.position == start]
    assert len(exact) == BEGINS_WORK // (BEGIN_WORK + 400 // VALUES) == 74
    assert {onset.reason for onset in exact} == {""}
    shares = [sum(onset.client == client for onset in exact) for client in range(4)]
    assert sorted(shares) == [18, 18, 19, 19]
    for onset in onsets.values():
        if onset.position is None:
            assert onset.reason.startswith("late by")
        elif onset.position != start:
            assert onset.reason == f"late by {(onset.position - start) // 8} ms"
    dropped = {onset.number for onset in onsets.values() if onset.position is None}
    assert dropped == {23, 123, 223, 323}


@pytest.mark.parametrize("rate", [1000.0, 8000.0, 11025.0, 44100.0])
def test_24_contactors_begin_at_24_times_within_their_sample(stage: Stage, rate: float) -> None:
    """All of them play at the same time, and there is time for them."""
    starts = stage.player.position + 160 + 37 * np.arange(24)
    for k, start in enumerate(starts):
        schedule(stage, waveform(rate, contactors=(k,), seconds=0.3), stage.bus.due(int(start)), k)
    stage.rest(0.5)
    assert [onset.position for onset in stage.player.onsets] == starts.tolist()
    begun = [int(np.flatnonzero(commanded(stage, k))[0]) for k in range(24)]
    assert begun == starts.tolist()
    assert stage.player.dropped_waves == 0


def test_a_stimulus_that_is_silent_at_first_for_want_of_time_says_so(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.player.apply(AppendSamples(ME, np.full(4000, 1e-6, np.float32), RATE, (5,), True))
    stage.rest(0.1)
    monkeypatch.setattr("tactile.playback.waves.BLOCK_WORK", 1)
    schedule(stage, waveform(), stage.bus.due(stage.player.position + 100))
    stage.rest(0.1)
    (onset,) = stage.player.onsets
    assert "no time" in onset.reason


def test_what_waits_for_its_time_is_bounded(stage: Stage) -> None:
    """A second of frames waits for one beginning, and `MOST_VALUES` for all of them."""
    waiting, due = stage.player.schedule, stage.bus.due(stage.player.position) + 10
    assert waiting.add(PlayAt(1, ME, due, False, frames())) == 50
    taken = [waiting.extend(frames()) for _ in range(25)]
    assert taken == [50] * 19 + [0] * 6
    (begin,) = waiting.take(due, BLOCK, RATE, BEGINS_WORK, lambda client: 0)[0][ME]
    assert isinstance(begin.order.order, AddFrames)
    assert begin.order.order.frames.shape == (1000, 24)
    large = AddFrames(YOU, np.zeros((MOST_VALUES // 24, 24), np.float32), 1e6, False)
    for number in (2, 3):
        assert waiting.add(PlayAt(number, YOU, due, False, large)) == (1 << 18) // 24
    assert waiting.add(PlayAt(4, YOU, due, False, large)) is None
    assert waiting.extend(large) == 0


def test_what_a_program_that_leaves_has_scheduled_is_reported_and_not_played(stage: Stage) -> None:
    """The server forgets with the report whom it was for."""
    schedule(stage, waveform(), stage.bus.due(stage.player.position + 160))
    stage.player.apply(ForgetClient(ME))
    stage.rest(0.1)
    (onset,) = stage.player.onsets
    assert (onset.position, onset.reason) == (None, "its program has left")
    assert not commanded(stage).any()


def test_frames_for_which_there_is_no_room_are_reported_and_counted(stage: Stage) -> None:
    time = stage.bus.due(stage.player.position) + 1.0
    for number in range(MOST_SCHEDULED):
        schedule(stage, waveform(), time, number)
    schedule(stage, frames(), time, 99)
    (onset,) = stage.player.onsets
    assert (onset.number, onset.position) == (99, None)
    assert onset.reason.endswith("send them later")
    assert stage.player.dropped_frames == 50


def test_frames_of_a_program_that_has_stopped_what_it_plays_have_no_onset(stage: Stage) -> None:
    stage.player.apply(SetState(ME, ClientState(sounds=False)))
    schedule(stage, frames(), stage.bus.due(stage.player.position + 160), drop_late=False)
    stage.rest(0.1)
    (onset,) = stage.player.onsets
    assert (onset.position, onset.reason) == (None, "the program has stopped what it plays")
    assert stage.player.dropped_frames == 50
    assert not commanded(stage).any()


@pytest.mark.parametrize("drop_late", [False, True])
def test_a_stimulus_that_begins_while_playback_fades_in_after_a_gap_says_so(
    stage: Stage, drop_late: bool
) -> None:
    stage.player.clock.sleep(0.1)  # the machine stands still
    start = stage.player.position + 800 + 64
    schedule(stage, waveform(8000.0), stage.bus.due(start), 1, drop_late=drop_late)
    schedule(stage, waveform(8000.0, contactors=(4,)), stage.bus.due(start + 1600), 2)
    stage.rest(0.5)
    faded, whole = stage.player.onsets
    assert faded == StimulusOutcome(1, ME, None if drop_late else start, FADING)
    assert whole == StimulusOutcome(2, ME, start + 1600)


@pytest.mark.parametrize("stimulus", [waveform(), waveform(11025.0), effect(), frames()])
@pytest.mark.parametrize("offset", [0, 5, 15])
def test_the_marker_lines_take_the_code_of_a_stimulus_with_its_first_sample(
    stage: Stage, stimulus: Stimulus, offset: int
) -> None:
    position = stage.player.position + 10 * BLOCK + offset
    schedule(stage, stimulus, stage.bus.due(position), marker=0x85)
    stage.rest(0.45)
    lines = stage.bus.lines
    assert np.flatnonzero(lines).tolist() == list(range(position, position + 80)), "for 10 ms"
    assert set(lines.tolist()) == {0, 0x85}
    (report,) = stage.player.report_onsets()
    assert (report.marker, report.reason) == (0x85, "")


def test_a_stimulus_that_waits_for_its_contactors_is_marked_when_it_begins(stage: Stage) -> None:
    stage.player.apply(AppendSamples(ME, np.full(1600, 1e-6, np.float32), RATE, (3,), True))
    time = stage.bus.due(stage.player.position + 160)
    schedule(stage, waveform(RATE), time, drop_late=False, marker=1)
    stage.rest(0.3)
    (onset,) = stage.player.onsets
    assert onset.position is not None
    assert np.flatnonzero(stage.bus.lines)[0] == onset.position
    assert "free" in onset.reason


def test_a_stimulus_that_is_dropped_or_has_no_marker_shows_none(stage: Stage) -> None:
    schedule(stage, waveform(), stage.bus.due(stage.player.position) - 0.05, 1, marker=3)
    schedule(stage, effect(), stage.bus.due(stage.player.position + 160), 2)
    stage.rest(0.45)
    assert not stage.bus.lines.any()
    reports = {report.number: report for report in stage.player.report_onsets()}
    assert (reports[1].marker, reports[2].marker, reports[2].reason) == (0, 0, "")


def test_of_two_stimuli_that_begin_with_the_same_sample_one_marker_is_shown(stage: Stage) -> None:
    """The lines have one code at a time; what was not shown is reported."""
    time = stage.bus.due(stage.player.position + 160)
    schedule(stage, waveform(contactors=(3,)), time, 1, marker=1)
    schedule(stage, waveform(contactors=(4,)), time, 2, marker=2)
    schedule(stage, waveform(contactors=(5,)), time, 3, marker=2)
    stage.rest(0.45)
    shown = {
        report.number: (report.marker, report.reason) for report in stage.player.report_onsets()
    }
    hidden = (0, NOT_CONFIRMED)
    assert shown == {1: hidden, 2: (2, ""), 3: (2, "")}


def test_markers_that_the_amplifier_does_not_confirm_are_reported_and_not_kept(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = [stage.player.position + 160, stage.player.position + 1600]
    taken = MockBus.take_marks

    def without_some(bus: MockBus) -> list[MarkReport]:
        return [mark for mark in taken(bus) if mark.position not in lost]

    monkeypatch.setattr(MockBus, "take_marks", without_some)
    for number, position in enumerate([*lost, stage.player.position + 3200]):
        schedule(stage, waveform(), stage.bus.due(position), number, marker=4)
    shown = []
    for _ in range(9):
        stage.rest(0.1)
        shown += [report.marker for report in stage.player.report_onsets()]
    assert shown == [0, 0, 4]
    assert not stage.bus.take_marks()


def test_markers_of_before_are_not_those_of_stimuli_after_the_display_was_armed_anew(
    stage: Stage,
) -> None:
    """Positions begin at 0 again, and so may those of marks."""
    first = stage.player.position + 160
    schedule(stage, waveform(), stage.bus.due(first), 1, marker=5)
    schedule(stage, waveform(), stage.bus.due(first + 800), 2)
    stage.rest(0.15)
    schedule(stage, waveform(), stage.bus.due(stage.player.position + 8000), 3, marker=6)
    stage.player.arm()
    reports = {report.number: report for report in stage.player.report_onsets()}
    assert (reports[1].marker, reports[1].reason) == (5, "")
    assert (reports[2].marker, reports[2].reason) == (0, "")
    assert (reports[3].marker, reports[3].reason) == (0, "the display was armed anew")
    stage.rest(0.05)
    again = [(first, 6), (first, 7), (400, 8)]
    for number, (position, code) in enumerate(again, 4):
        wave = waveform(contactors=(number,))
        schedule(stage, wave, stage.bus.due(position), number, drop_late=False, marker=code)
    stage.rest(0.6)
    reports = {report.number: report for report in stage.player.report_onsets()}
    assert [reports[k].marker for k in (4, 5)] == [0, 7]
    assert reports[6].marker == 8


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (EndWaves(ME), "it was stopped"),
        (ForgetClient(ME), "its program has left"),
        (dataclasses.replace(waveform(RATE), append=False), "another waveform took its place"),
    ],
)
def test_a_stimulus_that_waits_and_is_dropped_is_neither_marked_nor_reported_as_begun(
    stage: Stage, end: EndWaves | ForgetClient | AppendSamples, reason: str
) -> None:
    stage.player.apply(AppendSamples(ME, np.full(4000, 1e-6, np.float32), RATE, (3,), True))
    time = stage.bus.due(stage.player.position + 160)
    schedule(stage, waveform(RATE), time, drop_late=False, marker=1)
    stage.rest(0.1)
    assert stage.player.onsets == []
    stage.player.apply(end)
    assert stage.player.onsets == [StimulusOutcome(1, ME, None, reason)]
    stage.rest(0.6)
    assert not stage.bus.lines.any()


def test_a_waveform_of_other_contactors_does_not_take_the_place_of_one_that_waits(
    stage: Stage,
) -> None:
    stage.player.apply(AppendSamples(ME, np.full(1600, 1e-6, np.float32), RATE, (3,), True))
    time = stage.bus.due(stage.player.position + 160)
    schedule(stage, waveform(RATE), time, drop_late=False, marker=1)
    stage.rest(0.1)
    stage.player.apply(dataclasses.replace(waveform(RATE, contactors=(4,)), append=False))
    stage.rest(0.2)
    (onset,) = stage.player.onsets
    assert np.flatnonzero(stage.bus.lines)[0] == onset.position


def test_a_waveform_that_another_one_of_the_same_block_cut_short_has_begun(stage: Stage) -> None:
    start = (stage.player.position // BLOCK + 10) * BLOCK
    schedule(stage, waveform(RATE), stage.bus.due(start + 1), 1, marker=1)
    shorter = dataclasses.replace(waveform(RATE), append=False)
    schedule(stage, shorter, stage.bus.due(start + 9), 2, marker=2)
    stage.rest(0.45)
    reports = {report.number: report for report in stage.player.report_onsets()}
    assert [reports[k].marker for k in (1, 2)] == [1, 2]
    changes = np.flatnonzero(np.diff(stage.bus.lines.astype(int))) + 1
    assert changes.tolist() == [start + 1, start + 9, start + 89]


@pytest.mark.parametrize("drop_late", [False, True])
def test_a_stimulus_that_no_finger_feels_says_so(display: Display, drop_late: bool) -> None:
    memory, clock = PlaybackMemory.create(len(display.contactors)), ModelClock()
    bus = MockBus(Wiring.of(display, RATE), clock=clock)
    player = PlaybackLoop(display, bus, memory, clock=clock)
    player.arm()
    stage = Stage(player, bus)
    stage.rest(0.1)
    schedule(stage, waveform(), bus.due(player.position + 160), drop_late=drop_late, marker=1)
    stage.rest(0.1)
    (onset,) = player.onsets
    assert onset.reason == UNTOUCHED
    assert (onset.position is None) == drop_late == (not bus.lines.any())
    bus.close()
    memory.close()


def test_an_effect_that_begins_with_a_waveform_is_not_replaced_by_it(stage: Stage) -> None:
    time = stage.bus.due(stage.player.position + 160)
    schedule(stage, effect(), time, 1)
    schedule(stage, dataclasses.replace(waveform(), append=False), time, 2)
    stage.rest(0.1)
    assert {onset.position is None for onset in stage.player.onsets} == {False}
