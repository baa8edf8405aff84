"""Tests of tactile frames that have times: when and how exactly they are played."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile.arrays import Floats, Singles
from tactile.display.display import load_display
from tactile.playback.block_rendering import SamplePlayback
from tactile.playback.commands import AddFrames
from tactile.playback.frame_player import FramePlayer
from tactile.playback.frame_stream import FrameBuffer
from tactile.playback.mixer import BlockInput, Mixer

DRIVE = 8000.0
BLOCK = 16
TONES = np.array([20.0, 155.0, 1000.0])
"""Frequency on each contactor [Hz]."""
HOLD, FADE, ENDING = 30e-3, 25e-3, 5e-3
"""Times for which the last frame is held, and in which a stream fades and ends [s]."""


def tones(time: Floats) -> Floats:
    """Return the signal at times, (S, N)."""
    return np.asarray(np.sin(2 * np.pi * TONES * np.asarray(time)[:, None]))


@dataclass
class Source:
    """Sound card whose periods come one after the other, and a display that plays them.

    Attributes
    ----------
    rate : nominal rate of the frames [Hz]
    period : number of frames that come at once
    pace : their rate by the clock of the display [Hz]
    delay : time from a frame to its sample [s]
    arrival : time by which each period comes later than its first frame, by the time of that [s]
    jitter : error of the time of each period, likewise [s]
    """

    rate: float = 48_000.0
    period: int = 128
    pace: float = 48_000.0
    delay: float = 20e-3
    arrival: Callable[[float], float] = lambda time: 0.0
    jitter: Callable[[float], float] = lambda time: 0.0
    player: FramePlayer = field(default_factory=lambda: FramePlayer(DRIVE, len(TONES)))
    dropped: int = 0
    late: int = 0
    number: int = 0
    """Number of the first frame of the next period."""

    def played(
        self, begin: float, end: float, signal: Callable[[Floats], Floats] = tones
    ) -> Singles:
        """Play blocks from a time to another; return their shear."""
        parts = []
        for block in range(round(begin * DRIVE / BLOCK), round(end * DRIVE / BLOCK)):
            now = block * BLOCK / DRIVE
            self._send(now - self.delay / 2, signal)  # blocks are rendered ahead of their time
            self.player.next_time = now
            shear = self.player.take(BLOCK)
            self.dropped, self.player.dropped = self.dropped + self.player.dropped, 0
            parts.append(np.zeros((BLOCK, len(TONES)), np.float32) if shear is None else shear)
        return np.concatenate(parts)

    def _send(self, now: float, signal: Callable[[Floats], Floats]) -> None:
        while (time := self.number / self.pace) + self.arrival(time) <= now:
            frames = signal(time + np.arange(self.period) / self.pace).astype(np.float32)
            at = time + self.delay + self.jitter(time)
            dropped, late = self.player.add(frames, self.rate, latest=False, time=at)
            self.dropped, self.late = self.dropped + dropped, self.late + late
            self.number += self.period


def response(played: Floats | Singles, begin: float) -> tuple[Floats, Floats]:
    """Return the level [dB] and the phase [degrees] of each tone, from a time on."""
    time = begin + np.arange(len(played)) / DRIVE
    level, phase = [], []
    for tone, column in zip(TONES, played.T, strict=True):
        turns = 2 * np.pi * tone * time
        basis = np.stack([np.sin(turns), np.cos(turns)], axis=1)
        (sine, cosine), *_ = np.linalg.lstsq(basis, column, rcond=None)
        level.append(20 * math.log10(math.hypot(sine, cosine)))
        phase.append(math.degrees(math.atan2(cosine, sine)))
    return np.array(level), np.array(phase)


@pytest.mark.parametrize(("rate", "period"), [(48_000.0, 128), (44_100.0, 64), (8000.0, 37)])
@pytest.mark.parametrize("drift", [-2e-4, 0.0, 1e-4])
def test_each_frame_is_played_at_its_time(rate: float, period: int, drift: float) -> None:
    """Level and phase agree with those of the source, whose periods come up to 6 ms late."""
    rng = np.random.default_rng(4)
    source = Source(
        rate, period, rate * (1 + drift),
        arrival=lambda time: rng.uniform(0, 6e-3), jitter=lambda time: rng.uniform(-1e-5, 1e-5),
    )  # fmt: skip
    source.played(0, 3)
    played = source.played(3, 4)
    level, phase = response(played, 3 - source.delay)
    np.testing.assert_allclose(level, 0, atol=0.05)
    np.testing.assert_allclose(phase, 0, atol=1)  # 3 µs of 1 kHz
    assert (source.dropped, source.late) == (0, 0)


def test_frames_that_are_late_are_dropped_and_the_others_remain_in_time() -> None:
    """A period that comes 5 ms after its time is held, and so are those behind it."""
    source = Source(arrival=lambda time: max(0.515 - time, 0) if time > 0.5 else 0.0)
    source.played(0, 0.6)
    assert source.late > 0
    assert 0 < source.dropped < 48_000 * 10e-3
    level, phase = response(source.played(0.6, 1), 0.6 - source.delay)
    np.testing.assert_allclose(level, 0, atol=0.05)
    np.testing.assert_allclose(phase, 0, atol=0.5)


def test_a_frame_that_is_missing_is_held() -> None:
    source = Source(arrival=lambda time: 12e-3 if 0.5 < time < 0.51 else 0.0)
    played = source.played(0, 1, lambda time: np.minimum(time, 0.5)[:, None] * np.ones(3))
    np.testing.assert_allclose(played[int(0.55 * DRIVE) :], 0.5, atol=1e-3)
    assert np.abs(np.diff(played[int(0.1 * DRIVE) :], axis=0)).max() < 2e-3


@pytest.mark.parametrize("step", [-5e-3, 1.5e-3, 0.2])
def test_times_that_leap_let_the_signal_fade_out_and_in(step: float) -> None:
    """No sample is far from that before it, and the frames are in time afterwards."""
    source = Source(jitter=lambda time: step if time >= 0.5 else 0.0)
    played = source.played(0, 0.95, lambda time: np.ones((len(time), 3)))
    assert source.late == 1
    if step > HOLD + FADE:  # it is held and fades after its last frame
        quiet = played[int((0.53 + HOLD + FADE) * DRIVE) : int((0.5 + step) * DRIVE)]
        assert not quiet.any()
    assert np.abs(np.diff(played, axis=0)).max() < 1.2 / (ENDING * DRIVE)
    np.testing.assert_allclose(played[-100:], 1, atol=5e-3)
    _, phase = response(source.played(0.95, 1.95)[2000:], 1.2 - source.delay - step)
    np.testing.assert_allclose(phase, 0, atol=0.5)


@pytest.mark.parametrize(("step", "dropped"), [(2e-3, 0), (-20e-3, 960)])
def test_a_stream_plays_until_the_one_in_its_place_begins(step: float, dropped: int) -> None:
    """Frames that wait for 100 ms are not thrown away, and those that are, are counted."""
    source = Source(delay=0.2, jitter=lambda time: step if time >= 0.5 else 0.0)
    played = source.played(0, 1.2, lambda time: np.ones((len(time), 3)))
    quiet = np.flatnonzero(played[int(0.3 * DRIVE) :, 0] < 0.5)
    assert len(quiet) < 1.2 * FADE * DRIVE
    assert source.late == 1
    assert abs(source.dropped - dropped) <= BLOCK / DRIVE * source.rate


def test_frames_that_are_not_played_because_a_clock_leapt_are_counted() -> None:
    source = Source(delay=0.2)
    source.played(0, 0.5)
    source.played(0.55, 1.0)
    assert source.late == 1
    assert source.dropped == pytest.approx(0.15 * source.rate, rel=0.05)


@pytest.mark.parametrize(
    ("contactors", "rate", "period", "delay"),
    [(24, 48e3, 128, 0.9), (24, 192e3, 1024, 0.5), (64, 48e3, 8192, 0.5), (64, 192e3, 512, 0.1)],
)
def test_there_is_room_for_all_frames_that_wait(
    contactors: int, rate: float, period: int, delay: float
) -> None:
    source = Source(rate, period, rate, delay, player=FramePlayer(DRIVE, contactors))
    sent = 0
    for block in range(round((delay + 0.3) * DRIVE / BLOCK)):
        now = block * BLOCK / DRIVE
        while sent / rate <= now:
            ones = np.ones((period, contactors), np.float32)
            assert source.player.add(ones, rate, latest=False, time=sent / rate + delay) == (
                0,
                False,
            )
            sent += period
        source.player.next_time = now
        shear = source.player.take(BLOCK)
    assert shear is not None
    np.testing.assert_allclose(shear, 1, atol=5e-3)


def test_a_clock_of_the_display_that_leaps_lets_the_signal_fade_out_and_in() -> None:
    """Playback that was held up goes on with the block that is due then."""
    source = Source()
    ones: Callable[[Floats], Floats] = lambda time: np.ones((len(time), 3))  # noqa: E731
    before, after = source.played(0, 0.5, ones), source.played(0.7, 1.0, ones)
    played = np.concatenate([before, after])
    assert source.late == 1
    assert np.abs(np.diff(played, axis=0)).max() < 1.2 / (ENDING * DRIVE)
    np.testing.assert_allclose(played[-100:], 1, atol=5e-3)


def test_frames_that_all_come_after_their_time_are_dropped_and_nothing_sounds() -> None:
    source = Source(arrival=lambda time: 30e-3)
    played = source.played(0, 1, lambda time: np.ones((len(time), 3)))
    assert not played[BLOCK:].any()  # the first period came before any block was due
    assert source.dropped > 0.9 * source.number
    assert source.late > 0


def test_a_source_that_ends_is_silent_within_a_tenth_of_a_second_and_can_begin_anew() -> None:
    source = Source()
    ones: Callable[[Floats], Floats] = lambda time: np.ones((len(time), 3))  # noqa: E731
    source.played(0, 0.5, ones)
    source.arrival = lambda time: math.inf
    ending = source.played(0.5, 0.7)
    assert ending[: int((source.delay / 2 + HOLD - 5e-3) * DRIVE)].min() > 0.9
    assert not ending[int(0.1 * DRIVE) :].any()
    assert source.player.work(BLOCK) == 0
    source.arrival, source.number = lambda time: 0.0, int(0.7 * source.pace)
    again = source.played(0.7, 1.0, ones)
    np.testing.assert_allclose(again[-100:], 1, atol=5e-3)
    assert np.abs(np.diff(again, axis=0)).max() < 2 / (FADE * DRIVE) + 4e-3


def test_of_frames_that_are_partly_late_the_others_are_in_time() -> None:
    """A stream begins with those of its first frames whose time has not passed."""
    player = FramePlayer(DRIVE, len(TONES))
    player.next_time = 1.0
    frames = tones(np.arange(4800) / 48_000).astype(np.float32)
    assert player.add(frames, 48_000.0, latest=False, time=0.99001) == (480, True)
    played = np.concatenate([np.asarray(player.take(BLOCK)) for _ in range(45)])[
        int(FADE * DRIVE) :
    ]
    time = 9.99e-3 + np.arange(int(FADE * DRIVE), 45 * BLOCK) / DRIVE
    np.testing.assert_allclose(played[:, :2], tones(time)[:, :2], atol=0.02)


def test_frames_of_long_ago_are_not_made_up_for() -> None:
    """Add frames before it is known when a sample is put out."""
    player = FramePlayer(DRIVE, 3)
    player.add(np.ones((100, 3), np.float32), 48_000.0, latest=False, time=0.0)
    player.next_time = 1e7
    for _ in range(4):
        shear = player.take(BLOCK)
        assert shear is not None
        assert np.abs(shear).max() < 0.1


def test_a_block_may_be_read_in_parts() -> None:
    """Another stimulus that begins within a block cuts it in two."""
    whole, cut = FramePlayer(DRIVE, 3), FramePlayer(DRIVE, 3)
    frames = tones(np.arange(4800) / 48_000).astype(np.float32)
    played = []
    for player, parts in ((whole, [16]), (cut, [5, 11])):
        player.next_time = 0.0
        player.add(frames, 48_000.0, latest=False, time=5e-3)
        shears = [player.take(count) for _ in range(30) for count in parts]
        played.append(np.concatenate([np.asarray(shear) for shear in shears]))
    begun = int((5e-3 + FADE) * DRIVE) + BLOCK
    np.testing.assert_allclose(played[1][begun:], played[0][begun:], atol=1e-4)


@pytest.mark.parametrize("first", ["timed", "queue"])
def test_a_stream_of_another_kind_takes_over_without_a_step(first: str) -> None:
    player = FramePlayer(DRIVE, 1)
    parts = []
    for k in range(150):
        now = k * BLOCK / DRIVE
        player.next_time = now
        kind, value = (first, 1) if k < 50 else ({"timed", "queue"} - {first}, -1)
        time = now + 5e-3 if "timed" in kind else None
        player.add(np.full((2, 1), value, np.float32), 1000.0, latest=False, time=time)
        shear = player.take(BLOCK)
        assert shear is not None
        parts.append(shear)
    played = np.concatenate(parts)
    assert np.abs(np.diff(played[100:], axis=0)).max() < 0.25
    np.testing.assert_allclose(played[-1], -1, atol=0.01)


def test_a_mixer_plays_frames_at_their_times_by_the_clock_of_the_amplifier() -> None:
    """The clock of the amplifier is fast by 2e-4, and a second program comes later, and late."""
    display = load_display("reference-24")
    count, fast = len(display.contactors), DRIVE * (1 + 2e-4)
    mixer = Mixer(display, DRIVE, None, gain=1.0, worn=True)
    times, shear = [], []
    for k in range(1000):
        due = 100.0 + k * BLOCK / fast
        sent = due + 20e-3
        if k % 2 == 0:  # the clock of the source is that of the amplifier
            tone = tones(sent + np.arange(200) / 50_000 * DRIVE / fast)[:, :1]
            frames = (1e-6 * tone).astype(np.float32).repeat(count, axis=1)
            mixer.apply(AddFrames(1, frames, 50_000.0, False, sent))
        if k == 500:
            late = due - 1.5e-3  # the next block is put out 2 ms later
            mixer.apply(AddFrames(2, np.zeros((50, count), np.float32), 50_000.0, False, late))
            assert mixer.dropped_frames == 50
        mixer.render(BlockInput(k, k * BLOCK, False, due, due, ()))
        assert isinstance(mixer.rendering, SamplePlayback)
        times.append(due + (np.arange(BLOCK) - mixer.rendering.timed) / fast)
        shear.append(mixer.rendering.trace[:, -1])
    assert mixer.frame_gaps == 1
    later = slice(len(times) // 2, None)
    expected = 1e-6 * tones(np.concatenate(times[later]))[:, 0]
    np.testing.assert_allclose(np.concatenate(shear[later]), expected, atol=2e-8)


@given(st.lists(st.tuples(st.integers(0, 700), st.integers(-5, 900), st.integers(1, 600))))
def test_a_buffer_returns_the_frames_that_came(steps: list[tuple[int, int, int]]) -> None:
    """Compare it with an array of all frames; what was read before is read no more."""
    buffer, came, oldest = FrameBuffer(1), np.zeros((0, 1), np.float32), -5
    for added, first, count in steps:
        new = 1 + np.arange(len(came), len(came) + added, dtype=np.float32)[:, None]
        buffer.add(new)
        came = np.concatenate([came, new])
        oldest = min(max(oldest, first), len(came))
        expected = np.zeros((count, 1), np.float32)
        inside = np.arange(max(oldest, 0), min(oldest + count, len(came)))
        expected[inside - oldest] = came[inside]
        np.testing.assert_array_equal(buffer.read(oldest, count), expected)
    assert buffer.end == len(came)


def test_frames_too_far_ahead_have_no_room() -> None:
    player = FramePlayer(DRIVE, 3)
    player.next_time = 0.0
    ones = np.ones((48_000, 3), np.float32)
    assert player.add(ones, 48_000.0, latest=False, time=30.0) == (0, False)
    player.take(BLOCK)
    dropped, _ = player.add(ones, 48_000.0, latest=False, time=31.0)
    assert dropped == len(ones)
    shear = player.take(BLOCK)
    assert shear is not None
    assert not shear.any()


STEPS = st.lists(
    st.tuples(
        st.integers(0, 200), st.sampled_from([100.0, 1000.0, 48_000.0, 192_000.0]),
        st.sampled_from(["latest", "queue", "timed"]), st.floats(-0.1, 2.0), st.booleans(),
        st.sampled_from([0.0, 0.0, 0.0, 4e-3, 10.0]),
    ),
    max_size=60,
)  # fmt: skip


@settings(deadline=None)
@given(STEPS)
def test_whatever_comes_stays_near_what_was_sent(
    steps: list[tuple[int, float, str, float, bool, float]],
) -> None:
    """Values within −1 … 1 overshoot by no more than the sum of the weights of a kernel."""
    player, rng, now = FramePlayer(DRIVE, 3), np.random.default_rng(0), 0.0
    for count, rate, kind, ahead, skips, leap in steps:
        if count:
            values = rng.uniform(-1, 1, (count, 3)).astype(np.float32)
            time = now + ahead if kind == "timed" else None
            dropped, _ = player.add(values, rate, latest=kind == "latest", time=time)
            assert 0 <= dropped <= count
        now += BLOCK / DRIVE + leap
        player.next_time = now
        if skips:
            player.skip(BLOCK)
            continue
        shear = player.take(BLOCK)
        if shear is not None:
            assert shear.shape == (BLOCK, 3)
            assert np.abs(shear).max() < 4
