"""Tests of the cost of waves, and that shortcuts give the same as their formulas."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.playback.voice import Voice
from tactile.playback.waveforms import WaveformQueue
from tactile.playback.waves import Curve, EffectPlayer, affordable

RATE = 8000.0
N = 3
BLOCK = 16
ENDING, HOLD = 5e-3, 50e-3
"""Time in which an effect that is replaced or ends falls to nothing, and time for which a streamed
one is held after its last point (messages.py) [s]."""
PLAIN, PERIODS = 160.0, 2.0
"""Frequency of an effect without one [Hz], and number of periods that a transient lasts."""
MOST_TRANSIENTS, MOST_SEGMENTS = 16, 128
"""Largest number of transients that sound at once, which is 1280 taps of 160 Hz per second, and of
segments that wait, one for each 8 ms of a second."""
SETS = (0, 1), (1, 2)
"""Contactors of segments that wait for each other."""
BLOCK_WORK = 12_000
"""Units of 30 ns for the waves of a block: 0.36 of its 2 ms."""
Take = tuple[int, Curve | None]


def random_curve(rng: np.random.Generator, *, transients: int = 30) -> Curve:
    """Return a curve of up to half a second, in which few transients meet."""

    def points(most: int, largest: float) -> Floats:
        times = np.sort(rng.uniform(0, 0.4, int(rng.integers(0, most))))
        return np.column_stack([times, rng.uniform(0, largest, len(times))])

    count = int(rng.integers(0, transients))
    taps = np.column_stack(
        [rng.uniform(0, 0.4, count), rng.uniform(0, 1, count), rng.uniform(60, 1000, count)]
    )
    stream = bool(rng.integers(2))
    return Curve(5e-6, points(20, 1.0), points(20, 500.0), taps, stream)


@dataclass
class Formula:
    """Curves one sample after the other, every transient at each of them."""

    begun: int = 0
    curve: Curve | None = None
    phase: float = 0.0
    last: float = 0.0
    before: float = 0.0

    def sample(self, position: int) -> float:
        if self.curve is None:
            return 0.0
        curve, t = self.curve, (position - self.begun) / RATE
        size = 0.0
        if len(curve.amplitude):
            end = curve.amplitude[-1, 0] + HOLD * curve.stream
            fade = min(max(1 - (t - end) / ENDING, 0), 1)
            size = curve.size * float(np.interp(t, *curve.amplitude.T)) * fade
        new = min(t / ENDING, 1)
        self.last = self.before * (1 - new) + size * new
        f = float(np.interp(t, *curve.frequency.T)) if len(curve.frequency) else PLAIN
        self.phase += f / RATE
        wave = self.last * math.sin(2 * math.pi * self.phase)
        for begin, value, frequency in curve.transients:
            way = (t - begin) * frequency / PERIODS
            if 0 <= way < 1:
                fall = (1 + math.cos(math.pi * way)) / 2
                wave += curve.size * value * fall * math.sin(2 * math.pi * frequency * (t - begin))
        return wave

    def begin(self, position: int, curve: Curve) -> None:
        self.begun, self.curve, self.before = position, curve, self.last


def played(takes: list[Take]) -> Floats:
    """Play blocks of any sizes, each after a curve has begun where one is named."""
    effect, parts = EffectPlayer(RATE), []
    for count, curve in takes:
        if curve is not None:
            effect.begin(curve)
        wave = effect.take(count)
        parts.append(np.zeros(count) if wave is None else wave[:, 0])
    return np.concatenate(parts).astype(np.float64)


def by_formula(takes: list[Take]) -> Floats:
    formula, out, position = Formula(), [], 0
    for count, curve in takes:
        if curve is not None:
            formula.begin(position, curve)
        out += [formula.sample(position + k) for k in range(count)]
        position += count
    return np.array(out)


@given(st.integers(0, 2**32), st.lists(st.integers(1, 64), min_size=1, max_size=100))
def test_an_effect_is_its_formula_however_blocks_are_cut(seed: int, counts: list[int]) -> None:
    """A second curve takes over while the first one plays."""
    rng = np.random.default_rng(seed)
    first, second = random_curve(rng), random_curve(rng)
    counts = counts[: 1 + int(0.8 * len(counts))]
    middle = len(counts) // 2
    if sum(counts[:middle]) / RATE > first.end:
        second = first
        middle = 0
    takes: list[Take] = [(count, None) for count in counts]
    takes[0] = counts[0], first
    takes[middle] = counts[middle], second
    assert first.dropped == second.dropped == 0
    np.testing.assert_allclose(played(takes), by_formula(takes), atol=1e-11)


def test_a_whole_effect_is_its_formula_and_does_not_depend_on_the_block() -> None:
    for seed in range(5):
        curve = random_curve(np.random.default_rng(seed))
        wanted = by_formula([(4000, curve)])
        for size in (1, 7, 16, 400):
            takes: list[Take] = [(size, None)] * (4000 // size)
            takes[0] = size, curve
            got = played(takes)
            np.testing.assert_allclose(got, wanted[: len(got)], atol=1e-11)


@given(st.integers(0, 2**32), st.sampled_from([100.0, 1000.0, 8000.0, 11025.0, 48000.0]))
def test_a_waveform_is_its_formula_however_it_comes_and_goes(seed: int, rate: float) -> None:
    """The reference sums windowed sincs sample by sample, to the table's 4e-6 of each."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, 200).astype(np.float32)
    queue = WaveformQueue(RATE, N)
    parts: list[NDArray[np.float32]] = []
    cuts = np.sort(rng.integers(0, 200, 3))
    for part in np.split(x, cuts):
        queue.append(part, rate, (1,))
    total = int(200 * RATE / rate)
    while sum(len(part) for part in parts) < min(total, 400):
        out = queue.take(int(rng.integers(1, 64)))
        assert out is not None
        parts.append(out)
    got = np.concatenate(parts)
    cut = min(1.0, RATE / rate)
    apart = (np.arange(len(got))[:, None] * rate / RATE - np.arange(200)) * cut
    window = np.i0(7.0 * np.sqrt(np.clip(1 - (apart / 8) ** 2, 0, 1))) / np.i0(7.0)
    wanted = (np.sinc(apart) * np.where(np.abs(apart) < 8, window, 0)) @ x * cut
    inside = np.arange(len(got)) < total
    np.testing.assert_allclose(got[inside, 1], wanted[inside], atol=2e-5)
    assert not got[:, [0, 2]].any()


def test_transients_that_are_far_off_take_no_work() -> None:
    """500 in a minute, of 100 ms each: one or none sounds at a time."""
    times = np.linspace(0, 60, 500)
    taps = np.column_stack([times, np.ones(500), np.full(500, 20.0)])
    effect, plain = EffectPlayer(RATE), EffectPlayer(RATE)
    effect.begin(Curve(1e-6, np.zeros((0, 2)), np.zeros((0, 2)), taps, stream=False))
    plain.begin(Curve(1e-6, np.array([[60.0, 1.0]]), np.zeros((0, 2)), taps[:0], stream=False))
    for _ in range(2000):
        assert effect.work(BLOCK) <= plain.work(BLOCK) + 4 * BLOCK
        effect.skip(BLOCK)
        plain.skip(BLOCK)


@given(st.integers(0, 2**32), st.integers(0, 500))
def test_only_so_many_transients_sound_at_once_and_the_others_are_counted(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    taps = np.column_stack(
        [rng.uniform(0, 0.3, count), rng.uniform(0, 1, count), rng.uniform(20, 1000, count)]
    )
    curve = Curve(1e-6, np.zeros((0, 2)), np.zeros((0, 2)), taps, stream=False)
    begins, ends = curve.transients[:, 0], curve.transients[:, 0] + 2 / curve.transients[:, 2]
    for begin in begins:
        assert np.count_nonzero((begins <= begin) & (ends > begin)) <= MOST_TRANSIENTS
    assert curve.dropped + len(curve.transients) == count
    assert len(curve.transients) >= min(count, MOST_TRANSIENTS)
    effect = EffectPlayer(RATE)
    effect.begin(curve)
    assert effect.dropped == curve.dropped


def test_all_transients_at_one_time_are_those_that_may_sound() -> None:
    taps = np.tile([0.01, 1.0, 100.0], (500, 1))
    curve = Curve(1e-9, np.zeros((0, 2)), np.zeros((0, 2)), taps, stream=False)
    assert (len(curve.transients), curve.dropped) == (MOST_TRANSIENTS, 500 - MOST_TRANSIENTS)
    one = Curve(1e-9, np.zeros((0, 2)), np.zeros((0, 2)), taps[:1], stream=False)
    many, single = played([(400, curve)]), played([(400, one)])
    np.testing.assert_allclose(many, MOST_TRANSIENTS * single, atol=1e-14)


# Waveforms


def test_segments_are_bounded_and_one_more_is_not_taken_until_some_were_played() -> None:
    queue = WaveformQueue(RATE, N)
    one, most = np.ones(1, np.float32), MOST_SEGMENTS + N
    taken = [queue.append(one, RATE, SETS[k % 2]) for k in range(most)]
    assert taken == [1] * most
    assert queue.append(one, RATE, (2,)) == 0
    assert queue.append(one, RATE, SETS[(most - 1) % 2]) == 1, "after the last one"
    queue.take(2 * BLOCK)
    assert queue.append(one, RATE, (2,)) == 1


def test_the_work_of_a_block_grows_with_its_segments_and_its_rate() -> None:
    def work(rate: float, cut: int) -> int:
        queue = WaveformQueue(RATE, N)
        for k in range(0, 96, cut):
            queue.append(np.ones(cut, np.float32), rate, SETS[k // cut % 2])
        return queue.work(BLOCK)

    assert work(RATE, 96) < work(48_000.0, 96) < work(48_000.0, 48) <= 2 * work(48_000.0, 96)
    assert work(48_000.0, 1) > BLOCK_WORK, "a segment each sample"


@pytest.mark.parametrize("rates", [(1000.0,), (8000.0,), (48_000.0,), (48_000.0, 1000.0)])
def test_there_is_time_for_a_waveform_on_each_of_64_contactors(rates: tuple[float, ...]) -> None:
    queue = WaveformQueue(RATE, 64)
    for k in range(64):
        assert queue.append(np.ones(100, np.float32), rates[k % len(rates)], (k,)) == 100
    assert queue.work(BLOCK) <= BLOCK_WORK


def test_segments_that_are_not_near_a_block_take_no_time() -> None:
    """There are as many segments as may wait, of 6 ms each."""
    queue, samples = WaveformQueue(RATE, N), np.ones(48, np.float32)
    count = 0
    while queue.append(samples, RATE, SETS[count % 2]) == len(samples):
        count += 1
    assert count >= MOST_SEGMENTS
    for _ in range(300):
        assert queue.work(BLOCK) <= BLOCK_WORK / 4
        assert queue.take(BLOCK) is not None


def test_memory_is_bounded_by_what_waits() -> None:
    queue = WaveformQueue(RATE, N)
    for _ in range(2000):
        queue.append(np.zeros(4000, np.float32), 48_000.0, ())
        queue.take(BLOCK)
        (grid,) = queue._grids
        (segment,) = grid.segments
        assert len(segment._data) <= 2 * (48_000 + 4000 + grid._reach)


@given(st.integers(0, 2**32), st.integers(1, 300))
def test_what_is_skipped_goes_on_in_time(seed: int, blocks: int) -> None:
    """Waves after a silence are where they would be without it, but for an effect's phase."""
    rng = np.random.default_rng(seed)
    queues = WaveformQueue(RATE, N), WaveformQueue(RATE, N)
    for k in range(int(rng.integers(1, 9))):
        x = rng.uniform(-1, 1, int(rng.integers(1, 700))).astype(np.float32)
        for queue in queues:
            queue.append(x, 1000.0 * (1 + k % 3), (k % N,))
    for _ in range(blocks):
        queues[0].take(BLOCK)
        queues[1].skip(BLOCK)
    assert queues[0].waiting() == queues[1].waiting()
    one, other = (queue.take(BLOCK) for queue in queues)
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        np.testing.assert_array_equal(one, other)


# All clients


@given(
    st.dictionaries(st.integers(1, 1000), st.integers(1, 2 * BLOCK_WORK), max_size=80),
    st.integers(0, 10**6),
)
def test_what_is_played_never_exceeds_the_budget_and_leaves_no_room(
    work: dict[int, int], turn: int
) -> None:
    chosen = affordable(work, turn)
    left = BLOCK_WORK - sum(work[client] for client in chosen)
    assert left >= 0
    assert all(work[client] > left for client in work.keys() - chosen)


def test_every_client_has_its_turn() -> None:
    work = dict.fromkeys(range(1, 61), BLOCK_WORK // 4)
    chosen = [affordable(work, turn) for turn in range(60)]
    assert all(len(one) == 4 for one in chosen)
    assert {client: sum(client in one for one in chosen) for client in work} == dict.fromkeys(
        work, 4
    )
    assert all(len(one & other) == 3 for one, other in itertools.pairwise(chosen))


def test_waves_fade_where_they_are_dropped_and_where_they_come_back() -> None:
    """A held 1 µm: no step is above that of the ramps, and between them there is nothing."""
    voice = Voice(RATE, N)
    voice.queue.append(np.full(4000, 1e-6, np.float32), RATE, ())
    parts: list[Floats] = []
    for block in range(30):
        wave = voice.skip(BLOCK) if 10 <= block < 20 else voice.take(BLOCK)
        parts.append(np.zeros((BLOCK, N)) if wave is None else wave.astype(np.float64))
    played = np.concatenate(parts)[BLOCK:]
    assert np.abs(np.diff(played, axis=0)).max() <= 1.001e-6 / BLOCK
    assert not played[10 * BLOCK : 19 * BLOCK].any()
    np.testing.assert_allclose(played[20 * BLOCK :], 1e-6, rtol=1e-5)
