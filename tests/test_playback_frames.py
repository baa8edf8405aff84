"""Tests of streams of tactile frames: what is played when, and what happens to a late source."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile.arrays import Floats, Singles
from tactile.playback.frame_player import FramePlayer
from tactile.playback.frame_stream import FrameStream, LatestFrames, QueuedFrames

DRIVE = 8000.0
RATE = 1000.0
BLOCK = 16
N = 3
LOOK_AHEAD, EARLY = 4, 1e-3
"""Frames after a frame that its signal depends on, and time by which they are to be early [s]."""
HOLD, FADE, ENDING = 30e-3, 25e-3, 5e-3
"""Times for which the last frame is held, and in which it or a stopped stream fades [s]."""
DELAY = LOOK_AHEAD / RATE + EARLY + BLOCK / DRIVE
"""Time from a frame that comes to the middle of what it plays [s]."""


def field(time: Floats) -> Floats:
    """Return a signal of sinusoids up to 300 Hz, another one for each contactor, (S, N)."""
    rng = np.random.default_rng(5)
    frequency = rng.uniform(5, 300, (20, N))
    phase = rng.uniform(0, 2 * np.pi, (20, N))
    turns = 2 * np.pi * frequency * np.asarray(time)[:, None, None] + phase
    return np.asarray(np.sin(turns).sum(axis=1) / 10)


def frame(number: int) -> Singles:
    return np.asarray(field(np.array([number / RATE])), np.float32)


def played_live(
    stream: FrameStream,
    seconds: float,
    *,
    pace: float = RATE,
    arrival: Callable[[int], float] = lambda number: 0.0,
) -> tuple[Floats, int]:
    """Play what comes at a pace, frame by frame, each later than it is due by `arrival`.

    Return the shear from the first frame on, and the number of frames that came late.
    """
    parts, late, number = [], 0, 0
    for block in range(int(seconds * DRIVE / BLOCK)):
        now = block * BLOCK / DRIVE
        while number / pace + arrival(number) <= now:
            late += stream.is_late
            assert stream.add(frame(number)) == 1
            number += 1
        parts.append(stream.take(BLOCK))
    return np.concatenate(parts).astype(np.float64), late


def fidelity(played: Floats, begin: float, end: float, pace: float = RATE) -> tuple[float, float]:
    """Return the level of the signal over the error [dB] and the delay that fits best [s]."""
    time = np.arange(int(begin * DRIVE), int(end * DRIVE)) / DRIVE
    part = played[int(begin * DRIVE) : int(end * DRIVE)]

    def error(delay: float) -> float:
        return float(np.mean((part - field((time - delay) * pace / RATE)) ** 2))

    near = min(np.arange(0, 0.04, 1 / DRIVE).tolist(), key=error)
    best = min((near + np.linspace(-1, 1, 201) / DRIVE).tolist(), key=error)
    return 10 * math.log10(np.mean(part**2) / error(best)), best


def test_queued_frames_are_the_signal_that_they_sample() -> None:
    """A source in time is heard to 50 dB, a block, four frames and a millisecond later."""
    played, late = played_live(QueuedFrames(RATE, DRIVE, N), 0.5)
    level, delay = fidelity(played, 0.05, 0.45)
    assert level > 50
    assert delay == pytest.approx(DELAY, abs=0.2e-3)
    assert late == 0


@pytest.mark.parametrize("rate", [100.0, 4000.0, 8000.0, 22050.0])
def test_any_rate_of_frames_is_resampled(rate: float) -> None:
    """All frames come at once, as a program sends them that has a recording."""
    stream = QueuedFrames(rate, DRIVE, 1)
    tone = np.sin(2 * np.pi * 20 * np.arange(int(0.9 * rate)) / rate).astype(np.float32)
    assert stream.add(tone[:, None]) == len(tone)
    played = np.concatenate([stream.take(BLOCK) for _ in range(400)])[:, 0]
    reach = max(LOOK_AHEAD / rate, LOOK_AHEAD / DRIVE)
    reach = math.ceil(reach * rate) / rate
    time = np.arange(len(played)) / DRIVE - reach - EARLY - BLOCK / DRIVE
    inside = (time > 0.1) & (time < 0.7)
    error = played[inside] - np.sin(2 * np.pi * 20 * time[inside])
    assert np.abs(error).max() < 4e-3


@pytest.mark.parametrize("drift", [-2e-4, -1e-4, 1e-4, 2e-4])
def test_a_stream_follows_the_clock_of_its_source(drift: float) -> None:
    """Half a minute of a source that is too fast or too slow has no gap and is never much later."""
    pace = RATE * (1 + drift)
    played, late = played_live(QueuedFrames(RATE, DRIVE, N), 30.0, pace=pace)
    assert late == 0
    level, delay = fidelity(played, 29.6, 29.9, pace)
    assert level > 40
    assert delay == pytest.approx(DELAY, abs=1e-3)


def test_an_uneven_source_is_played_later_and_then_without_gaps() -> None:
    """Every 50th frame comes 6 ms late: the first of them makes a gap, those after it do not."""

    def arrival(number: int) -> float:
        return 6e-3 if number % 50 == 49 else 0.0

    played, late = played_live(QueuedFrames(RATE, DRIVE, N), 2.0, arrival=arrival)
    assert late == 1
    level, delay = fidelity(played, 1.7, 1.9)
    assert level > 30  # the pace differs by 2e-4 while it approaches what is early enough
    assert DELAY + 4e-3 < delay < DELAY + 7e-3


def test_a_source_that_is_even_again_is_played_in_time_again() -> None:
    """One frame comes 20 ms late: the delay that remains is gone after some seconds."""

    def arrival(number: int) -> float:
        return 20e-3 if number == 100 else 0.0

    played, late = played_live(QueuedFrames(RATE, DRIVE, N), 15.0, arrival=arrival)
    assert late == 1
    assert fidelity(played, 0.3, 0.4)[1] > DELAY + 15e-3
    assert fidelity(played, 14.5, 14.9)[1] == pytest.approx(DELAY, abs=1e-3)


@pytest.mark.parametrize("latest", [False, True])
def test_a_source_that_stops_is_held_then_faded_within_a_tenth_of_a_second(latest: bool) -> None:
    player = FramePlayer(DRIVE, N)
    ones = np.ones((1, N), np.float32)
    parts = []
    for k in range(200):
        if k < 100:
            for _ in range(2):
                player.add(ones, RATE, latest=latest)
        shear = player.take(BLOCK)
        parts.append(np.zeros((BLOCK, N), np.float32) if shear is None else shear)
    played: Singles = np.concatenate(parts)
    last = 100 * BLOCK
    np.testing.assert_allclose(played[last : last + int(HOLD * DRIVE) - BLOCK], 1, atol=4e-3)
    assert not played[last + int(0.1 * DRIVE) :].any()
    assert np.abs(np.diff(played[400:], axis=0)).max() < 2 / (FADE * DRIVE) + 4e-3
    assert player.work(BLOCK) == 0


@pytest.mark.parametrize("latest", [False, True])
def test_a_source_that_comes_back_rises_again_and_is_late_once(latest: bool) -> None:
    player = FramePlayer(DRIVE, N)
    ones = np.ones((2, N), np.float32)
    late, shear = 0, None
    for k in range(150):
        if not 50 <= k < 72:  # 44 ms without frames
            late += player.add(ones, RATE, latest=latest)[1]
        shear = player.take(BLOCK)
        assert shear is not None
        assert np.abs(shear).max() < 1.2
        assert np.abs(shear).min() > 0.2 or k < 10, "it rises from where it was"
    assert shear is not None
    np.testing.assert_allclose(shear, 1, atol=4e-3)
    assert late == 1


def test_the_newest_frame_is_reached_in_a_straight_line_within_a_period() -> None:
    stream = LatestFrames(RATE, DRIVE, 2)
    stream.add(np.array([[9, 9], [1, -2]], np.float32))
    first = stream.take(BLOCK)
    way = np.minimum(np.arange(1, BLOCK + 1) / 8, 1)
    np.testing.assert_allclose(first, np.outer(way, [1, -2]), atol=1e-6)
    stream.add(np.array([[3, 0]], np.float32))
    second = stream.take(4) - np.array([1, -2])
    np.testing.assert_allclose(second, np.outer(way[:4], [2, 2]), atol=1e-6)
    stream.add(np.array([[0, 0]], np.float32))
    third = stream.take(BLOCK) - np.array([2, -1])
    np.testing.assert_allclose(third, np.outer(way, [-2, 1]), atol=1e-6)


def test_no_more_than_a_second_waits() -> None:
    player = FramePlayer(DRIVE, N)
    dropped, _ = player.add(np.zeros((1500, N), np.float32), RATE, latest=False)
    assert 490 < dropped <= 510
    for _ in range(50):
        player.take(BLOCK)
    dropped, _ = player.add(np.zeros((300, N), np.float32), RATE, latest=False)
    assert dropped == pytest.approx(200, abs=5)


def test_a_stream_of_another_kind_takes_over_without_a_step() -> None:
    player = FramePlayer(DRIVE, N)
    parts = []
    for k in range(90):
        value = np.full((2, N), 1 if k < 30 else -1, np.float32)
        player.add(value, RATE if k < 60 else RATE / 2, latest=k < 30)
        shear = player.take(BLOCK)
        assert shear is not None
        parts.append(shear)
    played = np.concatenate(parts)
    assert np.abs(np.diff(played, axis=0)).max() < 0.25
    np.testing.assert_allclose(played[-1], -1, atol=0.01)


def test_frames_that_are_stopped_fade_at_once() -> None:
    player = FramePlayer(DRIVE, N)
    for _ in range(30):
        player.add(np.ones((2, N), np.float32), RATE, latest=True)
        player.take(BLOCK)
    player.end()
    ending = [player.take(BLOCK) for _ in range(4)]
    played = np.concatenate([part for part in ending if part is not None])
    ramp = 1 - np.arange(1, len(played) + 1) / (ENDING * DRIVE)
    np.testing.assert_allclose(played[:, 0], np.maximum(ramp, 0), atol=1e-6)
    assert player.take(BLOCK) is None


@given(
    st.lists(
        st.tuples(
            st.integers(0, 40), st.sampled_from([100.0, 1000.0, 48_000.0]), st.booleans(),
            st.booleans(),
        ),
        max_size=60,
    )
)  # fmt: skip
def test_whatever_comes_stays_near_what_was_sent(
    steps: list[tuple[int, float, bool, bool]],
) -> None:
    """Values within −1 … 1 overshoot by no more than the sum of the weights of a kernel."""
    player = FramePlayer(DRIVE, N)
    rng = np.random.default_rng(0)
    for count, rate, latest, skips in steps:
        if count:
            values = rng.uniform(-1, 1, (count, N)).astype(np.float32)
            dropped, _ = player.add(values, rate, latest=latest)
            assert 0 <= dropped <= count
        if skips:
            player.skip(BLOCK)
            continue
        shear = player.take(BLOCK)
        if shear is not None:
            assert shear.shape == (BLOCK, N)
            assert np.abs(shear).max() < 4
