"""Windows of currents are put together with the drive of their samples, or are left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim_rig import CHANNEL, HIGH, RATE, noise, opened, shuffled

from tactile.arrays import Floats
from tactile.bus.base import DriveBlock
from tactile.bus.correlations import CorrelationWindow
from tactile.bus.guards import GuardSettings
from tactile.display.display import Display
from tactile.playback.sum_windows import DOUBTED, SWINGING, PlayedWindow, SumWindows
from tactile.sensing.correlation import AFTER, EARLIER, MARGIN
from tactile.sim import SimulatedDisplay

pytestmark = pytest.mark.usefixtures("plant")
LENGTH = 80
VOLTS = noise(12800)[:, CHANNEL] / 20
"""Drive of the contactors [V]."""
ROUNDED = 3 * 100 / 32767
"""Largest difference of a step that comes from codes: a sample is rounded, and cut off after its
gain, which together is less than 1.5 codes of ±100 V [V]."""


@pytest.fixture
def display(tmp_path: Path) -> Display:
    return shuffled(tmp_path, HIGH)


class Stream:
    """A simulated display that plays noise, and the windows that come."""

    def __init__(self, display: Display, first: int = 0, keep: str = "second") -> None:
        self.bus: SimulatedDisplay = opened(display, f"sim:?correlation_ms=10&keep={keep}")
        self.display, self.first, self.at = display, first, 0
        self.windows = SumWindows(display, self.bus)
        self.bus.start(first)

    def write(self, factor: float = 1.0) -> None:
        """Write a block."""
        block, at = factor * VOLTS[self.at : self.at + 64], self.first + self.at
        self.bus.write(DriveBlock(at, self.display.to_channels(block)))
        self.windows.wrote(at, block)
        self.at += 64

    def play(self, count: int) -> list[PlayedWindow]:
        """Write blocks, and return the windows that came meanwhile."""
        found = []
        for _ in range(count):
            self.write()
            found += self.windows.take()
        return found

    def played(self, count: int) -> list[CorrelationWindow]:
        """Write blocks, and return what came without passing it on."""
        for _ in range(count):
            self.write()
        return self.bus.take_correlations()

    def give(self, *parts: CorrelationWindow) -> list[PlayedWindow]:
        for part in parts:
            self.bus._windows.add(part)
        return self.windows.take()


def split(part: CorrelationWindow, row: int) -> tuple[CorrelationWindow, CorrelationWindow]:
    """Return a window in two parts, as amplifiers with few channels send them."""
    rows = {name: getattr(part, name) for name in ("flags", "sums", "rounding", "energy")}
    above = replace(part, **{name: value[:row] for name, value in rows.items()})
    below = {name: value[row:] for name, value in rows.items()}
    return above, replace(part, first_channel=part.first_channel + row, **below)


@pytest.mark.parametrize("first", [0, 12345])
def test_steps_are_those_of_the_drive_around_the_window(display: Display, first: int) -> None:
    """Drive before the stream is 0 V, and the last window waits for the drive after it."""
    stream = Stream(display, first)
    found = stream.play(40)
    whole = np.vstack([np.zeros((EARLIER + AFTER + 1, 4)), VOLTS])
    steps = np.diff(whole, axis=0).T
    assert [w.position - first for w in found] == list(range(0, LENGTH * len(found), LENGTH))
    assert len(found) >= 28
    for w in found:
        begin = w.position - first
        mine = steps[:, begin : begin + EARLIER + AFTER + LENGTH + MARGIN]
        np.testing.assert_array_equal(np.hstack([w.window.earlier, w.window.steps]), mine)
        assert w.window.valid.all()
        assert not w.clipped.any()
        assert (w.end, w.window.samples) == (w.position + LENGTH, LENGTH)
        assert w.current_range == pytest.approx(2.5e-3)


def test_sums_are_in_the_order_of_the_contactors(display: Display) -> None:
    """Each contactor has the sums of its own channel, also if they come in parts."""
    expected = Stream(display).play(6)[0]
    parts = Stream(display)
    raw = parts.played(6)
    found = parts.give(*split(raw[0], 2))
    np.testing.assert_array_equal(found[0].window.sums, expected.window.sums)
    np.testing.assert_array_equal(found[0].window.sums, raw[0].sums[CHANNEL])
    np.testing.assert_array_equal(found[0].window.resolution, 2 * raw[0].rounding[CHANNEL])


def test_a_window_of_which_a_part_is_missing_is_dropped(display: Display) -> None:
    """The next one is whole; of the first only the channels 0 and 1 came."""
    stream = Stream(display)
    raw = stream.played(10)
    assert stream.give(split(raw[0], 2)[0]) == []
    assert [w.position for w in stream.give(raw[1])] == [LENGTH]
    assert stream.windows.dropped == 1


def test_a_window_that_comes_too_late_is_dropped(display: Display) -> None:
    """The drive of 0.5 s and of what a window needs before it is kept, and no more."""
    stream = Stream(display)
    raw = stream.played(10)
    for k in range(100):
        stream.windows.wrote(stream.at + 64 * k, np.zeros((64, 4)))
    assert stream.give(raw[0]) == []
    assert stream.windows.dropped == 1
    assert len(stream.windows._drive) == EARLIER + AFTER + 1 + RATE / 2


def test_windows_before_the_stream_are_left_out(display: Display) -> None:
    stream = Stream(display, 1000)
    raw = stream.played(10)
    assert stream.give(replace(raw[0], position=920)) == []
    assert [w.position for w in stream.give(raw[0])] == [1000]


def test_a_clipped_current_is_not_valid(display: Display) -> None:
    stream = Stream(display)
    raw = stream.played(10)
    flags = raw[0].flags.copy()
    flags[CHANNEL[2]] = 1
    (found,) = stream.give(replace(raw[0], flags=flags))
    assert found.window.valid.tolist() == [True, True, False, True]
    assert found.clipped.tolist() == [False, False, True, False]


def test_after_a_disturbance_windows_are_doubted_for_a_while(display: Display) -> None:
    """Samples that the amplifier limited or bridged were not what was written."""
    stream = Stream(display)
    assert all(w.window.valid.all() for w in stream.play(10))
    stream.write(1000.0)
    later = stream.play(39)
    begin, end = 11 * 64 + DOUBTED * RATE, 14 * 64 + DOUBTED * RATE
    assert not any(w.window.valid.any() for w in later if w.end <= begin)
    assert all(w.window.valid.all() for w in later if w.end > end)
    assert later[-1].end > end


# What guards hold down


def wrong(*, release: bool = False) -> GuardSettings:
    """Return settings by which the guards of contactors 1 and 3 trip at once, or are released."""
    channels = np.sort(CHANNEL)
    some = np.isin(channels, np.array(CHANNEL)[[1, 3]])
    taps, none = np.zeros((4, 13)), np.zeros(4)
    return GuardSettings(
        channels, some & (not release), some & release, np.zeros((4, 2)), taps, taps, none, 0.0,
        none + 1.0,
    )  # fmt: skip


def around(stream: Stream, w: PlayedWindow) -> Floats:
    """Return the steps (N, S) of what the bus has recorded around a window."""
    put_out = stream.bus.output[:, CHANNEL]
    whole = np.vstack([np.zeros((EARLIER + AFTER + 1, 4)), put_out])
    steps = np.diff(whole, axis=0).T
    return steps[:, w.position : w.position + EARLIER + AFTER + LENGTH + MARGIN]


@pytest.fixture
def held(display: Display) -> Stream:
    """Stream of which two contactors have been turned down."""
    stream = Stream(display, keep="all")
    stream.play(10)
    stream.bus.set_guards(wrong())
    return stream


def test_steps_are_those_of_what_guards_have_let_through(held: Stream) -> None:
    """Compare with the recorded output: from the trip, while turned down, and after the release."""
    found = held.play(40)
    assert held.windows.gains.tripped.tolist() == [False, True, False, True]
    held.bus.set_guards(wrong(release=True))
    found += held.play(40)
    assert not held.windows.gains.tripped.any()
    assert held.windows.gains.trips.tolist() == [0, 1, 0, 1]
    quiet = 0
    for w in found:
        mine, expected = np.hstack([w.window.earlier, w.window.steps]), around(held, w)
        quiet += int(np.abs(expected[1, -LENGTH:]).max() < 0.1 * np.abs(expected[0]).max())
        if w.window.valid.all():
            np.testing.assert_allclose(mine, expected, atol=ROUNDED)
    assert quiet > 10, "contactors were turned down for a while"
    invalid = [~w.window.valid for w in found if not w.window.valid.all()]
    assert all(bad.tolist() == [False, True, False, True] for bad in invalid)
    trip = int(held.windows.gains.latest[1])
    doubted = [w for w in found if w.end > trip and w.position < trip + SWINGING * RATE]
    assert len(invalid) == len(doubted) > 2


def test_a_report_that_is_lost_costs_only_the_windows_around_the_trip(
    held: Stream, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The flag of a window tells of the trip; steps are exact again when windows are valid."""
    monkeypatch.setattr(held.bus, "take_guard_reports", list)
    found = held.play(80)
    assert held.windows.gains.tripped.tolist() == [False, True, False, True]
    assert not all(w.window.valid.all() for w in found)
    history = EARLIER + AFTER + LENGTH
    late = [w for w in found if w.position > held.windows.gains.latest[1] + history]
    assert len(late) > 10
    for w in late:
        assert w.window.valid.all()
        mine, expected = np.hstack([w.window.earlier, w.window.steps]), around(held, w)
        np.testing.assert_allclose(mine, expected, atol=ROUNDED)
    # and of the release
    held.bus.set_guards(wrong(release=True))
    held.play(80)
    assert not held.windows.gains.tripped.any()


def test_another_stream_begins_with_full_gains(held: Stream) -> None:
    held.play(20)
    assert held.windows.gains.tripped.any()
    held.windows.restart()
    assert not held.windows.gains.tripped.any()
