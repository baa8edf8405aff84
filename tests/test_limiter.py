"""Nothing that leaves the limiter exceeds its limits, and what needs no limit leaves untouched.

The property tests feed it whatever floating-point numbers can be, cut in any way;
the rest shows that it turns down rather than clips, and counts what it does. Limits are
compared exactly, without a tolerance: the limiter keeps a relative 1e-9 from them for rounding.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tactile.arrays import Floats
from tactile.display.display import DriveLimits
from tactile.rendering.limiter import Limiter

RATE = 8000.0
ANYTHING = settings(max_examples=200)
AGAIN_ALL = 32_000
"""Samples, 4 s: 40 time constants of the release, after which a gain is 1 within rounding."""


def limiter(voltage: float = 100.0, step: float = 40.0, channels: int = 1) -> Limiter:
    return Limiter(voltage, step, sample_rate=RATE, channels=channels)


def played(device: Limiter, events: Iterable[Floats]) -> Floats:
    """Play blocks; return all that came out."""
    out = []
    for event in events:
        out.append(device(event))
        assert out[-1].shape == event.shape
    return np.concatenate(out) if out else np.zeros((0, 1))


def assert_within(out: Floats, voltage: float, step: float) -> None:
    """Compare every sample and every step, that from the initial 0 V included, exactly."""
    assert np.all(np.isfinite(out))
    assert np.all(np.abs(out) <= voltage)
    line = np.concatenate([np.zeros((1, out.shape[1])), out]).astype(np.longdouble)
    assert np.all(np.abs(np.diff(line, axis=0)) <= np.longdouble(step))


def sine(frequency: float, amplitude: float, seconds: float) -> Floats:
    n = np.arange(round(seconds * RATE))
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency * n / RATE)[:, None])


# Whatever comes in

TROUBLE = st.floats() | st.sampled_from(
    [math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -5e-324, 1e9, -1e9, 0.0, -0.0, 100.0]
)


def _walk(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    return np.cumsum(rng.normal(0, size / 10, shape), axis=0)


def _alternating(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    return size * (-1.0) ** np.add.outer(np.arange(shape[0]), np.arange(shape[1]))


def _noise(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    return rng.uniform(-size, size, shape)


def _constant(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    return np.full(shape, size)


def _bursts(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    return np.where(rng.uniform(size=shape) < 0.05, size, 0.0)


def _holes(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Floats:
    trouble = rng.choice([math.nan, math.inf, -math.inf, 1e308, 5e-324], shape)
    return np.where(rng.uniform(size=shape) < 0.1, trouble, rng.uniform(-size, size, shape))


PATTERNS: list[Callable[[np.random.Generator, tuple[int, int], float], Floats]] = [
    _walk, _alternating, _noise, _constant, _bursts, _holes,
]  # fmt: skip


@st.composite
def streams(draw: st.DrawFn) -> tuple[float, float, int, list[Floats]]:
    """Return voltage, step, channels and what to play."""
    voltage = draw(st.sampled_from([100.0, 1.0, 0.3, 1000.0]) | st.floats(1e-3, 1e3))
    step = voltage * draw(st.sampled_from([0.9, 0.05, 3.0, 2.0]) | st.floats(1e-4, 4))
    channels = draw(st.integers(1, 3))

    def block(values: list[float]) -> Floats:
        return np.resize(np.array(values, np.float64), (len(values) // channels, channels))

    def pattern(choice: int, seed: int, size: int, over: float) -> Floats:
        rng = np.random.default_rng(seed)
        return PATTERNS[choice](rng, (size, channels), over * voltage)

    some = st.lists(TROUBLE, max_size=24).map(block)
    scale = st.sampled_from([0.5, 1.0, 3.0, 100.0, 1e-6]) | st.floats(0, 10)
    kinds = st.integers(0, len(PATTERNS) - 1)
    patterns = st.builds(pattern, kinds, st.integers(0, 99), st.integers(0, 400), scale)
    return voltage, step, channels, draw(st.lists(some | patterns, max_size=12))


@pytest.mark.ci
@ANYTHING
@given(stream=streams())
def test_whatever_comes_in_what_leaves_is_within_both_limits(
    stream: tuple[float, float, int, list[Floats]],
) -> None:
    voltage, step, channels, events = stream
    device = limiter(voltage, step, channels)
    out = played(device, [np.zeros((0, channels)), *events, np.zeros((9, channels))])
    assert_within(out, voltage, step)


@settings(ANYTHING, max_examples=60)
@given(seed=st.integers(0, 2**31), step=st.sampled_from([2.0, 40.0, 150.0, 250.0]))
def test_limits_hold_from_block_to_block(seed: int, step: float) -> None:
    """1500 samples of changing patterns in blocks of 0 … 60."""
    rng = np.random.default_rng(seed)
    events: list[Floats] = []
    for _ in range(50):
        make = PATTERNS[rng.integers(len(PATTERNS))]
        size = 100 * float(rng.choice([0.2, 0.49, 1.0, 2.0, 30.0]))
        events.append(make(rng, (int(rng.integers(0, 61)), 2), size))
    assert_within(played(limiter(step=step, channels=2), events), 100.0, step)


@pytest.mark.parametrize("over", [1.0, 1e3, 1e300])
def test_limits_hold_over_long_blocks(over: float) -> None:
    """10000 samples at once."""
    volts = np.random.default_rng(1).normal(0, 100, (10_000, 2))
    volts[3000:7000] *= over
    assert_within(limiter(channels=2)(volts), 100.0, 40.0)


@pytest.mark.ci
def test_limits_hold_over_a_minute_and_a_half_at_once() -> None:
    volts = np.random.default_rng(2).normal(0, 20, (700_000, 1))
    volts[::100_000] *= 50
    assert_within(limiter()(volts), 100.0, 40.0)


@pytest.mark.parametrize(
    ("kind", "most"),
    [(np.float32, 3.4e38), (np.float16, 65504.0), (np.int32, 2**31 - 1)],
)
def test_any_type_of_number_is_limited(kind: type[np.float32], most: float) -> None:
    """The highest that each can hold included."""
    volts = np.random.default_rng(1).uniform(-300, 300, (500, 2)).astype(kind)
    volts[100] = most
    assert_within(limiter(channels=2)(volts), 100.0, 40.0)


def test_what_its_caller_does_to_a_block_changes_neither_limits_nor_what_follows() -> None:
    """A block that was handed out is the caller's: scaled, cleared or used again."""
    for size in (60.0, 15.0):
        kept, device, other = [], limiter(step=40.0), limiter(step=40.0)
        volts = size * np.sin(np.arange(300.0))[:, None]
        for part in np.split(volts, 30):
            block = device(part)
            kept.append(block.copy())
            block[:] = 1e6
        assert_within(np.concatenate(kept), 100.0, 40.0)
        np.testing.assert_allclose(np.concatenate(kept), other(volts), rtol=1e-12)


def test_what_its_caller_does_to_a_block_that_it_gave_changes_nothing() -> None:
    device, volts = limiter(), np.full((20, 1), 15.0)
    device(volts)
    volts[:] = 1e6
    assert device(np.full((8, 1), 15.0)).max() == 15.0


# Where no limit is near


@pytest.mark.parametrize(
    ("voltage", "step", "size"),
    [(100.0, 40.0, 19.9), (100.0, 250.0, 99.9), (100.0, 25.0, 99.0), (1.0, 0.3, 0.9)],
    ids=["both far", "steps allow anything", "steps are near", "small"],
)
def test_what_is_within_both_limits_leaves_bit_for_bit_eight_samples_later(
    voltage: float, step: float, size: float
) -> None:
    """Sums of sinusoids at 150 and 280 Hz: no step above 0.22 of the peak."""
    n = np.arange(5000)
    wave = 0.5 * np.sin(2 * np.pi * 150 * n / RATE) + 0.5 * np.sin(2 * np.pi * 280 * n / RATE)
    volts = size * np.stack([wave, -(wave**3), wave * 1e-12], axis=1)
    assert np.abs(np.diff(volts, axis=0)).max() < step
    device = limiter(voltage, step, 3)
    out = np.concatenate([device(part) for part in np.array_split(volts, 77)])
    assert device.delay == 8
    assert np.array_equal(out[8:], volts[:-8])
    assert not np.any(out[:8])
    assert (device.limited_samples, device.guarded_samples, device.invalid_samples) == (0, 0, 0)


@pytest.mark.parametrize("share", [1 - 1e-6, 1 + 1e-3])
def test_a_voltage_is_turned_down_only_beyond_its_limit(share: float) -> None:
    volts = sine(100, 100 * share, 0.2)
    device = limiter(step=1e3)
    out = device(volts)
    assert np.array_equal(out[8:], volts[:-8]) == (share < 1)
    assert (device.limited_samples > 0) == (share > 1)
    assert np.abs(out).max() == pytest.approx(100, rel=2e-6)


@pytest.mark.parametrize("share", [1 - 1e-6, 1 + 1e-3])
def test_a_step_is_turned_down_only_beyond_its_limit(share: float) -> None:
    """The drive goes up by one step and, much later, down."""
    volts = np.zeros((400, 1))
    volts[100:] = 40.0 * share
    device = limiter()
    out = device(volts)
    assert np.array_equal(out[8:], volts[:-8]) == (share < 1)
    assert (device.limited_samples > 0) == (share > 1)
    assert np.abs(np.diff(out[:, 0])).max() == pytest.approx(40, rel=2e-6)


# How it turns down


@pytest.mark.parametrize(
    ("frequency", "over", "voltage", "step"),
    [
        (125, 2.0, 100.0, 1e3),
        (250, 1.3, 100.0, 1e3),
        (250, 3.0, 100.0, 1e3),
        (930, 8.0, 100.0, 1e3),
        (250, 3.0, 100.0, 10.0),
        (500, 4.0, 1e3, 30.0),
    ],
)
def test_a_sinusoid_over_a_limit_stays_a_sinusoid_at_the_limit(
    frequency: float, over: float, voltage: float, step: float
) -> None:
    """The gain recovers between crests, 1/(2f) apart, by at most (over − 1)(1 − e^(−1/(2fτ))).

    That sawtooth at 2f puts 1/(2π) of itself into the third harmonic and less into others: −40 dB
    at 125 Hz and twice the limit. Clipping at twice the limit would make −15 dB.
    """
    steepest = 2 * math.sin(math.pi * frequency / RATE)
    limit = min(voltage, step / steepest)
    volts = sine(frequency, over * limit, 4.0)
    device = limiter(voltage, step)
    out = device(volts)[-8000:, 0]
    spectrum = np.abs(np.fft.rfft(out)) ** 2
    tone = spectrum[round(frequency)]
    ripple = (over - 1) * (1 - math.exp(-1 / (2 * frequency * 0.1)))
    assert (spectrum.sum() - tone) / tone < 1e-4
    assert (spectrum.sum() - tone) / tone < max(1.5 * (ripple / (2 * math.pi)) ** 2, 1e-9)
    assert math.sqrt(tone) / 4000 == pytest.approx(limit, rel=0.02 + ripple / 2)


def test_the_guard_never_acts_on_a_drive_without_jumps() -> None:
    """The module says so. A drive of 150 V at 250 Hz moves by up to 29 V a sample, smoothly."""
    device = limiter(step=1e3)
    device(sine(250, 150, 1.0))
    assert device.limited_samples > 0
    assert device.guarded_samples == 0


def test_channels_keep_their_ratios_and_a_quiet_one_its_shape() -> None:
    """The gain is common: the tactile image keeps its shape."""
    loud = sine(110, 350, 0.5)
    share = np.array([[1.0, -0.25, 1e-3]])
    out = limiter(channels=3)(loud * share)
    np.testing.assert_allclose(out, out[:, :1] * share, rtol=1e-12, atol=1e-12)
    assert np.abs(out[:, 0]).max() == pytest.approx(100, rel=1e-3)


def test_channels_keep_their_ratios_where_the_guard_acts() -> None:
    """A jump of full scale to the other side goes in steps of the limit, all channels alike."""
    share = np.array([[1.0, -0.5, 0.1]])
    volts = 90 * np.concatenate([np.ones((100, 1)), -np.ones((100, 1))]) * share
    device = limiter(step=30.0, channels=3)
    out = device(volts)
    assert device.guarded_samples > 0
    np.testing.assert_allclose(out, out[:, :1] * share, atol=1e-9)


@pytest.mark.parametrize("over", [1.5, 4.0])
def test_the_gain_is_down_in_time_and_recovers_within_its_time_constant(over: float) -> None:
    """1 − g falls as e^(−t/0.1 s) from where it was 8 to 16 samples after the last loud one."""
    quiet, loud = np.full(1000, 30.0), np.full(200, 100.0 * over)
    volts = np.concatenate([quiet, loud, np.full(AGAIN_ALL, 30.0)])
    device = limiter(step=1e4)
    out = device(volts[:, None])[:, 0]
    gain = out[8:] / volts[:-8]
    assert np.all(gain[:992] == 1)
    assert np.all(np.diff(gain[:1000]) <= 0)
    np.testing.assert_allclose(gain[1000:1190], 1 / over, rtol=1e-6)
    assert np.all(np.diff(gain[1200:]) >= 0)
    for k in (1300, 2000, 2800, 6000):
        early, late = (math.exp(-(k - 1200 - after) / 800) for after in (-16, 16))
        assert (1 - 1 / over) * early <= 1 - gain[k] <= (1 - 1 / over) * late
    assert np.all(gain[-100:] == 1)


def test_a_pause_does_not_let_the_gain_recover_sooner() -> None:
    """Silence is within both limits at any gain: what follows it is turned down as without it."""
    loud, pause, quiet = np.full(200, 400.0), np.zeros(160), np.full(160, 30.0)
    device = limiter(step=1e4)
    parts = [device(part[:, None]) for part in (loud, *np.split(pause, 5), quiet, np.zeros(8))]
    gain = np.concatenate(parts)[8 + 360 :, 0] / 30.0
    for k in (0, 80, 159):
        early, late = (math.exp(-(k + 160 - after) / 800) for after in (-16, 16))
        assert 0.75 * early <= 1 - gain[k] <= 0.75 * late


def test_after_the_gain_has_recovered_drive_leaves_bit_for_bit_again() -> None:
    device = limiter(step=60.0)
    device(np.concatenate([sine(90, 500, 0.1), sine(90, 25, AGAIN_ALL / RATE)]))
    volts = sine(130, 25, 0.5)
    assert np.array_equal(device(volts)[8:], volts[:-8])


def test_drive_leaves_bit_for_bit_after_a_pause_of_twenty_time_constants() -> None:
    """The gain is 1 within 2e-9 then, and taken for 1; before the pause it was not."""
    loud, quiet = np.full((200, 1), 400.0), np.full((400, 1), 30.1)
    device = limiter(step=1e4)
    device(np.concatenate([loud, quiet, np.zeros((8, 1))]))
    assert not np.array_equal(device(np.concatenate([quiet, np.zeros((8, 1))]))[8:], quiet)
    for _ in range(20):
        device(np.zeros((800, 1)))
    assert np.array_equal(device(np.concatenate([quiet, np.zeros((8, 1))]))[8:], quiet)


def test_a_jump_is_reached_within_the_look_ahead_and_not_smeared() -> None:
    """Steps of 40 V from 0 to 90 V: nothing before the jump, then all of a step at once."""
    volts = np.zeros((100, 1))
    volts[50:] = 90.0
    out = limiter()(volts)[:, 0]
    assert not np.any(out[:58])
    assert out[58] == pytest.approx(40, rel=1e-6)
    assert np.all(np.diff(out[58:]) > 0)


# How the stream is cut


@pytest.mark.ci
@settings(ANYTHING, max_examples=30)
@given(seed=st.integers(0, 10_000), sizes=st.lists(st.integers(0, 700), min_size=1, max_size=8))
@example(seed=0, sizes=[1])
@example(seed=1, sizes=[0, 8, 9])
def test_what_leaves_does_not_depend_on_how_the_stream_is_cut(seed: int, sizes: list[int]) -> None:
    """Outputs agree within rounding."""
    rng = np.random.default_rng(seed)
    volts = _walk(rng, (3000, 2), 60.0) + 40 * (rng.uniform(size=(3000, 2)) < 0.002)
    volts[rng.integers(3000, size=3), 0] = math.nan

    def cut(sizes: list[int]) -> tuple[Floats, Limiter]:
        device, events, at, k = limiter(channels=2), list[Floats](), 0, 0
        while at < 3000:
            size = min(max(sizes[k % len(sizes)], k % 2), 3000 - at)
            events.append(volts[at : at + size])
            at, k = at + size, k + 1
        return played(device, events), device

    (one, first), (two, second) = cut([3000]), cut(sizes)
    np.testing.assert_allclose(two, one, atol=1e-9)
    assert first.invalid_samples == second.invalid_samples == 3
    assert first.limited_samples == second.limited_samples
    assert first.guarded_samples == second.guarded_samples


# Counters


@pytest.mark.parametrize("size", [1, 7, 5000])
def test_invalid_values_are_counted_one_by_one_and_played_as_silence(size: int) -> None:
    volts = np.full((60, 3), 5.0)
    volts[10, 0], volts[10, 1], volts[30, 2] = math.nan, math.inf, -math.inf
    volts[31, 2], volts[50, 0], volts[51, 0] = 1e308, 1e9, -1e9
    device = limiter(channels=3)
    out = played(device, [volts[k : k + size] for k in range(0, 60, size)])
    assert device.invalid_samples == 6
    assert (device.limited_samples, device.guarded_samples) == (0, 0)
    bad = ~(np.abs(volts) < 1e9)
    np.testing.assert_array_equal(out[8:], np.where(bad, 0.0, volts)[:-8])


def test_limited_samples_are_those_whose_gain_is_below_one() -> None:
    """The gain of a constant can be read off every sample."""
    volts = np.full((9000, 2), 30.0)
    volts[3000:3100, 1] = 250.0
    device = limiter(channels=2, step=1e3)
    out = np.concatenate([device(part) for part in np.array_split(volts, 41)])
    gain = out[8:, 0] / volts[:-8, 0]
    assert device.limited_samples == np.count_nonzero(gain < 1 - 1e-6)
    assert 100 < device.limited_samples < 6008
    assert device.guarded_samples == 0


def test_guarded_samples_are_those_that_went_only_a_step() -> None:
    """The way from 80 V to −80 V by 30 V a sample takes six samples; the last has what remains."""
    volts = np.concatenate([np.full((200, 1), 80.0), np.full((200, 1), -80.0)])
    device = limiter(step=30.0)
    device(volts[:200])
    before = device.guarded_samples
    out = np.concatenate([device(volts[200:]), device(volts[-9:])])
    steps = np.abs(np.diff(out[:, 0]))
    assert device.guarded_samples - before == np.count_nonzero(steps > 30 * (1 - 1e-6))


@pytest.mark.parametrize(
    ("slew", "current", "capacitance", "rate", "step"),
    [
        (0.7e6, math.inf, 12.8e-9, 8000.0, 87.5),  # 0.7 V/µs for 125 µs
        (0.7e6, 10e-3, 12.8e-9, 8000.0, 87.5),  # 10 mA give 0.78 V/µs: slew is the less
        (0.7e6, 1e-3, 12.5e-9, 8000.0, 10.0),  # 1 mA into 12.5 nF: 80 V/ms
        (1e3, 1.0, 1e-9, 100.0, 10.0),
    ],
)
def test_the_step_is_what_slew_rate_or_current_allow_in_a_sample(
    slew: float, current: float, capacitance: float, rate: float, step: float
) -> None:
    limits = DriveLimits(voltage=100.0, slew=slew, current=current)
    assert limits.step(rate, capacitance) == pytest.approx(step, rel=1e-12)


@pytest.mark.parametrize("name", ["voltage", "slew", "current", "fade"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, -math.inf])
def test_limits_that_are_none_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        DriveLimits(**({"voltage": 100.0} | {name: value}))


@pytest.mark.parametrize("name", ["voltage", "slew", "fade"])
def test_only_the_current_may_be_unlimited(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        DriveLimits(**({"voltage": 100.0} | {name: math.inf}))
    assert DriveLimits(voltage=100.0).current == math.inf
