"""The equalizer's drive makes a response follow the shear, as closely as the filter states.

Responses here have closed forms: a pure delay, a first-order low-pass, a resonator of quality 55
as the bimorph has in air. What the filter does to them is worked out in double precision from its
taps; what the stream does is compared with a convolution.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats, Singles
from tactile.rendering.equalizer import (
    DELAYS,
    TAPS,
    Equalizer,
    FollowingEqualizer,
    InverseFilter,
    attainable,
    design,
    fit_taps,
    inverse,
    roll_off,
)

FREQUENCY: Floats = np.arange(0, 1251, 10, dtype=np.float64)
HEARD: NDArray[np.bool_] = (FREQUENCY >= 10) & (FREQUENCY <= 1000)
PER_VOLT = 1e-6
"""Response far above that which lets full drive reach the smallest shear [m/V]."""
VOLTAGE = 100.0
SMALLEST_SHEAR = 0.1e-6
"""Smallest peak shear that skin feels at best (250 Hz; Verrillo and Bolanowski) [m]."""
TOLERANCE = 6e-3
"""Relative error for which no longer delay is tried: 0.05 dB and 0.35°."""


def late(frequency: Floats, delay: float) -> Complex:
    return np.asarray(np.exp(-2j * np.pi * frequency * delay), np.complex128)


def low_pass(frequency: Floats, corner: float) -> Complex:
    return np.asarray(1 / (1 + 1j * frequency / corner), np.complex128)


def resonator(frequency: Floats, resonance: float, quality: float = 55.0) -> Complex:
    ratio = frequency / resonance
    return np.asarray(1 / (1 - ratio**2 + 1j * ratio / quality), np.complex128)


def taps_of(found: InverseFilter) -> Floats:
    """Return the taps of every kind (L, C, T)."""
    return np.asarray(np.einsum("cr,lrt->lct", found.mix, found.taps))


def played(taps: Floats, frequency: Floats, rate: float, delay: int) -> Complex:
    """Return the response (..., F) of taps (..., T), less the delay."""
    turn = np.exp(-2j * np.pi / rate * np.outer(np.arange(taps.shape[-1]) - delay, frequency))
    return np.asarray(taps @ turn)


# The inverse


@pytest.mark.parametrize("voltage", [1.0, 100.0])
def test_the_inverse_is_exact_where_full_drive_gives_the_smallest_shear(voltage: float) -> None:
    """1/H, to rounding, down to |H| V = 0.1 µm."""
    phase = np.linspace(-np.pi, np.pi, 41)
    response = np.geomspace(1.000001 * SMALLEST_SHEAR / voltage, 1e-3, 41) * np.exp(1j * phase)
    np.testing.assert_allclose(inverse(response, voltage) * response, 1, rtol=1e-14)


@pytest.mark.parametrize("voltage", [1.0, 100.0])
def test_beyond_it_the_inverse_is_bounded_and_keeps_its_phase(voltage: float) -> None:
    """Full drive commands 0.1 µm and no more: |G| × 0.1 µm = V; a response of nothing gives 0."""
    phase = np.linspace(-3, 3, 31)
    response = np.geomspace(1e-30, 0.999999 * SMALLEST_SHEAR / voltage, 31) * np.exp(1j * phase)
    gain = inverse(response, voltage)
    np.testing.assert_allclose(np.abs(gain) * SMALLEST_SHEAR, voltage, rtol=1e-14)
    np.testing.assert_allclose(np.angle(gain), -phase, atol=1e-14)
    assert inverse(np.zeros(3, np.complex128), voltage) == pytest.approx(0)


def test_the_inverse_keeps_the_shape_of_its_responses() -> None:
    response = np.ones((2, 3, 4), np.complex128)
    assert inverse(response, 1.0).shape == (2, 3, 4)


def test_what_full_drive_attains_is_response_times_voltage() -> None:
    response = 2e-6 * resonator(FREQUENCY, 500)
    assert attainable(response, 70.0) == pytest.approx(140e-6 * np.abs(resonator(FREQUENCY, 500)))
    exact = attainable(response, 70.0) >= SMALLEST_SHEAR
    needed = np.abs(inverse(response, 70.0)) * attainable(response, 70.0)
    assert np.all(exact)
    np.testing.assert_allclose(needed, 70.0, rtol=1e-14)


def test_shear_is_commanded_in_full_to_1000_hz_and_not_at_all_from_1250_hz() -> None:
    """The taper is half a cosine: one half in the middle, and nowhere a jump."""
    frequency = np.arange(0, 2000.5, 0.5)
    weight = roll_off(frequency)
    assert np.all(weight[frequency <= 1000] == 1)
    assert np.all(weight[frequency >= 1250] == 0)
    assert roll_off(np.array([1125.0, 1062.5])) == pytest.approx([0.5, 0.5 + math.sqrt(0.125)])
    assert np.all(np.diff(weight) <= 0)
    assert np.abs(np.diff(weight)).max() < np.pi / 2 / 250 * 0.5 * 1.01
    assert np.array_equal(roll_off(-frequency), weight)


# The filter

RESPONSES = {
    "a delay of 0.5 ms": lambda f: late(f, 0.5e-3),
    "a delay of 3 ms": lambda f: late(f, 3e-3),
    "a delay of 10 ms": lambda f: late(f, 10e-3),
    "a first order at 100 Hz": lambda f: low_pass(f, 100),
    "a first order at 1000 Hz": lambda f: low_pass(f, 1000),
    "a resonator at 930 Hz": lambda f: resonator(f, 930),
    "a resonator at 700 Hz": lambda f: resonator(f, 700),
    "a resonator beyond the band": lambda f: resonator(f, 1105),
    "a late resonator": lambda f: resonator(f, 600) * late(f, 0.3e-3),
}


@pytest.mark.ci
@pytest.mark.parametrize("rate", [8000.0, 12_500.0])
@pytest.mark.parametrize("name", RESPONSES)
def test_filter_times_response_is_one_within_the_stated_error(name: str, rate: float) -> None:
    """The error holds at the response's frequencies; 20 % more between, for peaks from 12 Hz wide.

    All of these are ones that a filter can invert: the stated error is below the tolerance.
    """
    found = design(PER_VOLT * RESPONSES[name](FREQUENCY)[None, None], VOLTAGE, rate)
    assert 0 < found.error <= TOLERANCE
    for frequency, more in ((FREQUENCY[HEARD], 1 + 1e-6), (np.arange(10, 1000.5, 0.5), 1.2)):
        shear = played(taps_of(found), frequency, rate, found.delay)[0, 0]
        shear = shear * PER_VOLT * RESPONSES[name](frequency)
        assert np.abs(shear - 1).max() <= found.error * more
    assert found.taps.shape == (1, 1, found.taps.shape[-1])
    assert found.taps.shape[-1] in TAPS
    assert found.delay in DELAYS


def test_a_filter_is_within_its_error_of_the_bounded_inverse() -> None:
    """The bound counts where 1 V cannot give 0.1 µm; and drive stays near it."""
    response = 1e-6 * low_pass(FREQUENCY, 30) ** 2
    found = design(response[None, None], 1.0, 8000.0)
    bounded = inverse(response, 1.0)[HEARD]
    assert np.abs(bounded * response[HEARD]).min() < 0.01
    gain = played(taps_of(found), FREQUENCY[HEARD], 8000.0, found.delay)[0, 0]
    assert np.abs(gain / bounded - 1).max() <= found.error * (1 + 1e-6)
    assert np.abs(gain).max() * SMALLEST_SHEAR <= 1.0 * (1 + found.error)


@pytest.mark.parametrize("name", RESPONSES)
def test_a_filter_is_held_down_beyond_the_band(name: str) -> None:
    """The gain from 2 kHz on is at most 6 dB above the largest in the band.

    Unheld, the taps of a least-squares fit to a third of the spectrum grow without bound.
    """
    found = design(PER_VOLT * RESPONSES[name](FREQUENCY)[None, None], VOLTAGE, 8000.0)
    beyond = played(taps_of(found), np.arange(2000, 4001, 10.0), 8000.0, found.delay)
    in_band = played(taps_of(found), FREQUENCY, 8000.0, found.delay)
    assert np.abs(beyond).max() < 2 * np.abs(in_band).max()


def test_the_first_delay_that_is_good_enough_is_taken() -> None:
    """The delay is 1 ms for a prompt response, and no less than the response's own delay.

    Eight samples are just good enough for 1.05 ms, with 5.5e-3, and not for 1.057 ms, with 6.5e-3.
    """
    delays = ((0.0, 8), (0.5e-3, 8), (1.05e-3, 8), (1.057e-3, 12), (3e-3, 24), (10e-3, 80))
    for delay, least in delays:
        found = design(PER_VOLT * late(FREQUENCY, delay)[None, None], VOLTAGE, 8000.0)
        assert found.delay >= least
        assert found.error <= TOLERANCE
        assert found.delay == 8 or delay > 0.5e-3
        for shorter in (d for d in DELAYS if d < found.delay):
            gain = inverse(PER_VOLT * late(FREQUENCY, delay)[None], VOLTAGE)
            assert fit_taps(gain, 8000.0, found.taps.shape[-1], shorter)[1] > TOLERANCE


@pytest.mark.parametrize(
    "response",
    [
        resonator(FREQUENCY, 40),
        late(FREQUENCY, 25e-3),
        1 / resonator(FREQUENCY, 500),
    ],
    ids=["a resonator at 40 Hz", "a delay of 25 ms", "an antiresonance"],
)
def test_where_no_filter_is_good_enough_none_halves_the_error_of_the_one_taken(
    response: Complex,
) -> None:
    gain = inverse(PER_VOLT * response[None], VOLTAGE)
    errors = [fit_taps(gain, 8000.0, t, d)[1] for t in TAPS for d in DELAYS if d < t]
    found = design(PER_VOLT * response[None, None], VOLTAGE, 8000.0)
    assert min(errors) > TOLERANCE
    assert min(errors) >= found.error / 2 * (1 - 1e-6)
    assert found.error <= errors[0] * (1 + 1e-6)


def test_contactors_that_differ_by_a_factor_share_a_filter() -> None:
    """Four kinds of two shapes need two filters; every kind within the stated error of its own."""
    one, two = resonator(FREQUENCY, 930), low_pass(FREQUENCY, 400)
    kinds = PER_VOLT * np.stack([one, two, -0.5 * one, 1.2 * two])
    found = design(np.stack([kinds, 0.7 * kinds]), VOLTAGE, 8000.0)
    assert found.taps.shape[:2] == (2, 2)
    assert found.mix.shape == (4, 2)
    shear = played(taps_of(found), FREQUENCY, 8000.0, found.delay) * np.stack([kinds, 0.7 * kinds])
    assert np.abs(shear[..., HEARD] - 1).max() <= found.error * 1.01
    taps = taps_of(found)
    np.testing.assert_allclose(taps[1] * 0.7, taps[0], atol=1e-9 * np.abs(taps).max())


@pytest.mark.parametrize(("size", "detuned"), [(1.0, 0.1), (0.1, 0.75), (0.01, 6.5)])
def test_the_stated_error_holds_for_kinds_that_nearly_share_a_filter(
    size: float, detuned: float
) -> None:
    """Two resonators a little apart, and a contactor that moves as much, 20 dB or 40 dB less.

    10 % more, for what shared filters may leave out.
    """
    kinds = PER_VOLT * np.stack(
        [
            resonator(FREQUENCY, 930),
            resonator(FREQUENCY, 930 + detuned),
            size * late(FREQUENCY, 0.3e-3),
        ]
    )
    found = design(kinds[None], 1000.0, 8000.0)
    shear = played(taps_of(found), FREQUENCY, 8000.0, found.delay) * kinds
    assert np.abs(shear[..., HEARD] - 1).max() <= found.error * 1.1


def test_each_kind_alone_gives_the_same_columns_as_the_mixture() -> None:
    """Four kinds, three of them of their own, under three loads that change each in its own way.

    All want the same taps and delay, so that fits kind by kind are the fit of all of them; shared
    filters may leave out 1e-4. The shear has noise in every contactor, and a force that moves.
    """
    loads, forces = ([930, 700, 720, 910], [700, 900, 710, 920], [720, 910, 930, 700]), (0.1, 1, 3)
    sizes = np.array([1.0, -0.4, 2.5, 1.3])[:, None]
    shapes = np.array([[resonator(FREQUENCY, at) for at in row] for row in loads], np.complex128)
    response: Complex = PER_VOLT * np.array([1.0, 0.8, 0.5])[:, None, None] * sizes * shapes
    mixture = design(response, VOLTAGE, 8000.0)
    kind = np.array([3, 0, 2, 1], np.intp)
    shear, force = shear_of(300), 1.6 + 1.6 * np.sin(np.arange(300) / 40)
    volts = Equalizer(mixture, kind=kind, polarity=POLARITY, forces=forces)(shear, force)
    errors = []
    for contactor, one in enumerate(kind):
        alone = design(response[:, one : one + 1], VOLTAGE, 8000.0)
        assert alone.delay == mixture.delay
        errors.append(alone.error)
        device = Equalizer(alone, kind=np.zeros(4, np.intp), polarity=POLARITY, forces=forces)
        expected = device(shear, force)[:, contactor]
        np.testing.assert_allclose(
            volts[:, contactor], expected, atol=2e-4 * np.abs(expected).max()
        )
    assert mixture.error == pytest.approx(max(errors), rel=0.05)


@pytest.mark.parametrize("rate", [2500.0, 2800.0])
def test_at_the_lowest_rates_the_stated_error_is_of_the_whole_band(rate: float) -> None:
    """The band goes to 1000 Hz, although half of the sample rate is hardly above it."""
    response = PER_VOLT * resonator(FREQUENCY, 930)
    found = design(response[None, None], VOLTAGE, rate)
    shear = played(taps_of(found), FREQUENCY[HEARD], rate, found.delay)[0, 0] * response[HEARD]
    assert np.abs(shear - 1).max() == pytest.approx(found.error, rel=1e-6)


# The stream

SHAPES = [resonator(FREQUENCY, 930), low_pass(FREQUENCY, 300), resonator(FREQUENCY, 700)]
ONE = design(PER_VOLT * SHAPES[0][None, None], VOLTAGE, 8000.0)
MANY = design(PER_VOLT * np.stack([[1.0 * s for s in SHAPES], [0.5 * s for s in SHAPES[::-1]]]),
              VOLTAGE, 8000.0)  # fmt: skip
KIND = np.array([2, 0, 1, 0], np.intp)
POLARITY = np.array([1.0, -1.0, 1.0, 1.0])
FORCES = (0.2, 0.8)


def shear_of(count: int, seed: int = 0) -> Singles:
    """Return noise of 1 µm for four contactors (S, 4)."""
    return np.random.default_rng(seed).normal(0, 1e-6, (count, 4)).astype(np.float32)


def equalizer(found: InverseFilter) -> Equalizer:
    if found is ONE:
        return Equalizer(found, kind=np.zeros(4, np.intp), polarity=np.ones(4), forces=(1.0,))
    return Equalizer(found, kind=KIND, polarity=POLARITY, forces=FORCES)


def convolved(found: InverseFilter, shear: Singles, force: Floats) -> Floats:
    """Return what a stream must be, contactor by contactor, in double precision."""
    taps, volts = taps_of(found), np.zeros(shear.shape)
    for i in range(4):
        rested = np.concatenate([np.full(taps.shape[-1] - 1, shear[0, i]), shear[:, i]])
        if found is ONE:
            volts[:, i] = np.convolve(rested, taps[0, 0], "valid")
            continue
        low, high = (np.convolve(rested, taps[k, KIND[i]], "valid") for k in (0, 1))
        share = np.clip((force - FORCES[0]) / (FORCES[1] - FORCES[0]), 0, 1)
        volts[:, i] = POLARITY[i] * ((1 - share) * low + share * high)
    return volts


def rounding(found: InverseFilter, shear: Singles) -> float:
    """Return 1e-6 of the largest sum that can be met: 16 roundings to single precision."""
    return 1e-6 * float(np.abs(taps_of(found)).sum(axis=-1).max() * np.abs(shear).max())


@settings(max_examples=40)
@given(many=st.booleans(), sizes=st.lists(st.integers(1, 64), min_size=1, max_size=30))
def test_a_stream_is_the_convolution_with_the_taps_however_it_is_cut(
    many: bool, sizes: list[int]
) -> None:
    """Finger forces go from below the table to above it, and change all the time."""
    found = MANY if many else ONE
    cuts = np.cumsum([0, *sizes])
    shear = shear_of(int(cuts[-1]), len(sizes))
    force = 0.5 + 0.7 * np.sin(np.arange(len(shear)) / 9)
    device = equalizer(found)
    volts = [device(shear[a:b], force[a:b]) for a, b in pairwise(cuts)]
    assert all(block.dtype == np.float32 for block in volts)
    assert np.concatenate(volts) == pytest.approx(
        convolved(found, shear, force), abs=rounding(found, shear)
    )


def test_an_empty_block_is_an_empty_block_and_changes_nothing() -> None:
    for found in (ONE, MANY):
        device, shear = equalizer(found), shear_of(20)
        force, nothing = np.full(20, 0.5), np.zeros(0)
        assert device(shear[:0], nothing).shape == (0, 4)
        volts = device(shear, force)
        assert device(shear[:0], nothing).shape == (0, 4)
        assert volts == pytest.approx(convolved(found, shear, force), abs=rounding(found, shear))


def test_a_finger_that_rests_before_the_stream_begins_gives_no_transient() -> None:
    """The voltage is at once that of the constant shear, the sum of the taps times it."""
    shear = np.full((30, 4), 2e-6, np.float32)
    volts = equalizer(ONE)(shear, np.ones(30))
    assert volts == pytest.approx(2e-6 * taps_of(ONE).sum(), rel=1e-5)


@pytest.mark.parametrize("frequency", [20.0, 250.0, 930.0])
def test_a_sinusoid_comes_out_inverted_and_as_late_as_the_filter_states(frequency: float) -> None:
    """Volts = inverse × shear, ``delay`` samples later; within the filter's error and rounding."""
    n = np.arange(3600)
    shear = np.repeat(1e-6 * np.sin(2 * np.pi * frequency * n / 8000)[:, None], 4, axis=1)
    device = equalizer(ONE)
    parts = np.array_split(shear.astype(np.float32), 60)
    volts = np.concatenate([device(part, np.ones(len(part))) for part in parts])
    phasor = 2 / 3200 * np.exp(-2j * np.pi * frequency * n[400:] / 8000) @ volts[400:]
    gain = inverse(PER_VOLT * resonator(np.array([frequency]), 930), VOLTAGE)[0]
    expected = -1e-6j * gain * np.exp(-2j * np.pi * frequency * ONE.delay / 8000)
    assert ONE.delay == 8
    assert np.abs(phasor / expected - 1).max() < ONE.error + 1e-4


def test_polarity_turns_the_sign_and_nothing_else() -> None:
    shear, force = shear_of(50), np.full(50, 0.4)
    plus = Equalizer(MANY, kind=KIND, polarity=np.ones(4), forces=FORCES)(shear, force)
    minus = Equalizer(MANY, kind=KIND, polarity=-np.ones(4), forces=FORCES)(shear, force)
    mixed = Equalizer(MANY, kind=KIND, polarity=POLARITY, forces=FORCES)(shear, force)
    np.testing.assert_array_equal(minus, -plus)
    np.testing.assert_array_equal(mixed, plus * POLARITY.astype(np.float32))


@pytest.mark.parametrize(
    ("force", "share"), [(0.0, 0.0), (0.2, 0.0), (0.35, 0.25), (0.5, 0.5), (0.8, 1.0), (9.0, 1.0)]
)
def test_filters_run_straight_between_the_forces_of_the_table(force: float, share: float) -> None:
    """Filters are held beyond the ends of the table."""
    shear = shear_of(64)
    ends = []
    for k in (0, 1):
        alone = InverseFilter(MANY.taps[k : k + 1], MANY.mix, MANY.delay, MANY.error)
        device = Equalizer(alone, kind=KIND, polarity=POLARITY, forces=(1.0,))
        ends.append(device(shear, np.full(64, force)))
    volts = equalizer(MANY)(shear, np.full(64, force))
    expected = (1 - share) * ends[0] + share * ends[1]
    np.testing.assert_allclose(volts, expected, atol=rounding(MANY, shear))


def test_shared_filters_play_what_each_kind_s_own_filter_would() -> None:
    """The same taps, kind by kind: within the 1e-4 that sharing may leave out."""
    shear, force = shear_of(200), np.full(200, 0.2)
    volts = equalizer(MANY)(shear, force)
    taps = taps_of(MANY)
    for i, kind in enumerate(KIND):
        own = InverseFilter(taps[:1, kind : kind + 1], np.ones((1, 1)), MANY.delay, MANY.error)
        device = Equalizer(own, kind=np.zeros(4, np.intp), polarity=np.ones(4), forces=(1.0,))
        expected = device(shear, force)[:, i] * POLARITY[i]
        np.testing.assert_allclose(volts[:, i], expected, atol=100 * rounding(MANY, shear))


# Filters of their own


def following_case(seed: int = 0) -> tuple[Floats, Floats, Singles]:
    """Return two sets of filters (5, 32) and a shear (300, 5)."""
    rng = np.random.default_rng(seed)
    before, after = rng.standard_normal((2, 5, 32))
    return before, after, rng.standard_normal((300, 5)).astype(np.float32)


def by_column(taps: Floats, shear: Singles) -> Floats:
    """Return each column convolved with its filter, which rests at the first sample before."""
    line = np.concatenate([np.repeat(shear[:1], taps.shape[1] - 1, axis=0), shear])
    columns = zip(line.T.astype(np.float64), taps, strict=True)
    return np.array([np.convolve(x, h, "valid") for x, h in columns]).T


def test_each_contactor_has_its_filter() -> None:
    """Compare with convolutions in double precision."""
    taps, _, shear = following_case()
    volts = FollowingEqualizer(taps)(shear, np.zeros(300))
    np.testing.assert_allclose(volts, by_column(taps, shear), atol=1e-4)


@pytest.mark.parametrize("sizes", [(1, 7, 64, 3, 225), (100, 200), (150, 150)])
def test_following_does_not_depend_on_blocks(sizes: tuple[int, ...]) -> None:
    """Divide the stream within and beside a cross-fade."""
    before, after, shear = following_case()
    streams = []
    for parts in ((300,), sizes):
        follower = FollowingEqualizer(before)
        follower.replace(after, 200)
        ends = np.cumsum(parts)
        pieces = [shear[end - size : end] for end, size in zip(ends, parts, strict=True)]
        streams.append(np.concatenate([follower(piece, np.zeros(len(piece))) for piece in pieces]))
    np.testing.assert_allclose(streams[1], streams[0], atol=2e-5)


def test_cross_fade_leads_from_one_filter_to_the_other() -> None:
    """Compare with the mixture of both convolutions, half a cosine long."""
    before, after, shear = following_case()
    follower = FollowingEqualizer(before)
    follower.replace(after, 200)
    share = (1 - np.cos(np.pi * np.minimum(np.arange(1, 301) / 200, 1))) / 2
    mixed = (
        by_column(before, shear) * (1 - share[:, None]) + by_column(after, shear) * share[:, None]
    )
    np.testing.assert_allclose(follower(shear, np.zeros(300)), mixed, atol=1e-4)


def test_change_during_a_cross_fade_does_not_jump() -> None:
    """Replace the filters in the middle of a cross-fade of constant shear."""
    before, after, _ = following_case()
    follower = FollowingEqualizer(before)
    constant = np.ones((100, 5), np.float32)
    follower.replace(after, 200)
    first = follower(constant, np.zeros(100))
    follower.replace(before, 200)
    second = follower(constant, np.zeros(100))
    largest = np.abs(after.sum(axis=1) - before.sum(axis=1)) * np.pi / 2 / 200
    assert np.all(np.abs(second[0] - first[-1]) <= largest * 1.05)


def test_filters_of_another_number_are_refused() -> None:
    """Replace the filters of five contactors by those of one."""
    before, after, _ = following_case()
    with pytest.raises(ValueError, match=r"taps of shape \(1, 32\): must be \(5, 32\) as before"):
        FollowingEqualizer(before).replace(after[:1], 200)
