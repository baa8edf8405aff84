"""Tests of the measurement of bands, kurtosis and AM depth with signals of known numbers.

Sines, white noise and log-normally modulated normal noise have closed forms; noise here is drawn
in the frequency domain and shares nothing with waves or surfaces. Where a sample is random its
tolerance is four standard errors or more.
"""

import math

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import measures

STEP = 50e-6
LONG = 32_000
"""Number of samples of a stroke, 1.6 m."""
EXACT = 10 ** (np.arange(-6, 10) / 10)
"""Centers [cycles/mm]; a third octave is 10^±0.05 wide on either side (IEC 61260-1)."""
WIDTH = EXACT * (10**0.05 - 10**-0.05)


def rough(rows: int, seed: int, slope: float = -1.0, count: int = LONG) -> Floats:
    """Return normal noise (rows, count) of rms 1 µm, amplitude as frequency^slope from 0.22/mm."""
    frequency = np.fft.rfftfreq(count, STEP * 1e3)
    weight = np.where(frequency > 0.22, np.maximum(frequency, 0.01) ** slope, 0.0)
    white = np.random.default_rng(seed).standard_normal((rows, count))
    noise = np.fft.irfft(np.fft.rfft(white) * weight, count)
    return np.asarray(1e-6 * noise / noise.std())


def modulator(rows: int, seed: int, variance: float, corner: float) -> Floats:
    """Return log-normal factors exp(g), g normal and even up to a corner [cycles/mm]."""
    frequency = np.fft.rfftfreq(LONG, STEP * 1e3)
    white = np.random.default_rng(seed).standard_normal((rows, LONG))
    g = np.fft.irfft(np.fft.rfft(white) * (frequency <= corner), LONG)
    return np.asarray(np.exp(g / g.std() * math.sqrt(variance)))


# Bands


@pytest.mark.parametrize("band", range(16))
def test_the_power_of_a_sine_is_in_its_band_alone(band: int) -> None:
    """The power is a²/2 over the width; 20 dB less in the lowest neighbors, else nothing."""
    place = np.arange(LONG) * STEP * 1e3
    level = measures.band_spectrum(3e-6 * np.sin(2 * np.pi * EXACT[band] * place + 1), STEP)
    assert level.shape == (16,)
    assert level[band] == pytest.approx(10 * math.log10(4.5 / WIDTH[band]), abs=0.1)
    others = np.delete(level, band)
    assert others.max() < level[band] - 20
    assert np.sum(others > level[band] - 60) <= 2


def test_white_noise_has_its_density_in_every_band() -> None:
    """2 σ² step; 40 rows of 1.6 m hold n = 7400 values in the lowest band: 4 √(2/n) = 0.24 dB."""
    noise = 1e-6 * np.random.default_rng(1).standard_normal((40, LONG))
    level = measures.band_spectrum(noise, STEP)
    assert level.shape == (40, 16)
    mean = 10 * np.log10(np.mean(10 ** (level / 10), axis=0))
    np.testing.assert_allclose(mean, 10 * math.log10(2 * STEP * 1e3), atol=0.24)


def test_a_drift_of_the_whole_stroke_is_in_no_band() -> None:
    """5 mm along the shortest stroke, slightly bent: thousands of times what the skin does."""
    place = np.linspace(0, 1, 800)
    drift = 5e-3 * (place + 1e-3 * place**2)
    plain = measures.band_spectrum(rough(1, 2)[0, :800], STEP)
    drifting = measures.band_spectrum(rough(1, 2)[0, :800] + drift, STEP)
    np.testing.assert_allclose(drifting, plain, atol=0.2)


def test_other_centers_move_the_bands() -> None:
    place = np.arange(LONG) * STEP * 1e3
    tone = 1e-6 * np.sin(2 * np.pi * 0.5 * place)
    assert np.argmax(measures.band_spectrum(tone, STEP)) == 3
    assert np.argmax(measures.band_spectrum(tone, STEP, center=measures.CENTERS / 2)) == 6


def test_a_short_a_coarse_and_a_broken_stroke_are_refused() -> None:
    for work in (measures.band_spectrum, measures.excess_kurtosis, measures.am_corner):
        with pytest.raises(InputError, match=r"stroke of 30 mm: .* at least 40 mm"):
            work(np.zeros(600), STEP)
        with pytest.raises(InputError, match=r"step = 100 µm: .* need at most 56.1 µm"):
            work(np.zeros(LONG), 1e-4)
        with pytest.raises(InputError, match="not finite"):
            work(np.full(LONG, np.nan), STEP)
        for step in (0.0, -STEP, math.nan):
            with pytest.raises(InputError, match=f"step = {step * 1e6:g} µm"):
                work(np.zeros(LONG), step)


def test_a_stroke_of_just_ten_periods_of_the_lowest_band_is_long_enough() -> None:
    """Ten periods of 0.25 cycles/mm are 40 mm; rounding does not count."""
    center = 250 * 10 ** (np.arange(16) / 10)
    stroke = rough(1, 19, count=800)[0]
    assert np.all(np.isfinite(measures.band_spectrum(stroke, STEP, center=center)))
    with pytest.raises(InputError, match="needs at least 40 mm"):
        measures.band_spectrum(stroke[:-1], STEP, center=center)


# Kurtosis


def test_a_sine_has_the_kurtosis_of_a_sine_and_noise_none() -> None:
    """−3/2; √(24/n) with n = 2 per band of 8.7 cycles/mm … at least 1 per mm of the noise."""
    place = np.arange(LONG) * STEP * 1e3
    assert measures.excess_kurtosis(np.sin(5 * place), STEP) == pytest.approx(-1.5, abs=0.01)
    assert measures.excess_kurtosis(rough(20, 3), STEP) == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize("variance", [0.02, 0.1, 0.2])
def test_log_normal_noise_has_the_kurtosis_of_the_closed_form(variance: float) -> None:
    """3 (exp(4s) − 1), of a modulation slow against the bands."""
    varied = rough(16, 4, slope=-0.5) * modulator(16, 5, variance, 0.05)
    wanted = 3 * math.expm1(4 * variance)
    assert measures.excess_kurtosis(varied, STEP) == pytest.approx(wanted, rel=0.12, abs=0.03)


def test_what_lies_outside_the_bands_has_no_part_in_kurtosis() -> None:
    place = np.arange(LONG) * STEP * 1e3
    hand = 1e-5 * np.sin(2 * np.pi * 0.02 * place)
    sensor = 1e-5 * np.sin(2 * np.pi * 9.9 * place) * (place > 1000)
    plain = rough(4, 6)
    wanted = measures.excess_kurtosis(plain, STEP)
    assert measures.excess_kurtosis(plain + hand, STEP) == pytest.approx(wanted, abs=0.05)
    assert abs(measures.excess_kurtosis(plain + sensor / 10, STEP) - wanted) < 0.2


def test_a_level_that_differs_from_stroke_to_stroke_is_neither_kurtosis_nor_depth() -> None:
    plain = rough(20, 7)
    louder = plain * np.geomspace(0.2, 5, 20)[:, None]
    for work in (measures.excess_kurtosis, lambda x, step: measures.am_depth(x, step, 100.0)):
        assert work(louder, STEP) == pytest.approx(work(plain, STEP), abs=0.03)


# Amplitude modulation


@pytest.mark.parametrize(
    ("slope", "corner"), [(-1.5, 0.05), (-1.5, 0.3), (-0.5, 0.1), (0.0, 0.05), (0.0, 0.3)]
)
def test_noise_alone_has_no_depth(slope: float, corner: float) -> None:
    """The depth would be 0.1 … 0.3 if what the noise's own envelope makes were not subtracted."""
    assert measures.am_depth(rough(20, 8, slope), STEP, corner * 1e3) < 0.04


@pytest.mark.parametrize(
    ("depth", "corner"), [(0.1, 0.1), (0.2, 0.3), (0.3, 0.05), (0.3, 0.1), (0.5, 0.1)]
)
def test_log_normal_noise_has_the_depth_and_corner_of_the_closed_form(
    depth: float, corner: float
) -> None:
    """√(exp(s) − 1); a share of exp(g) lies beyond the corner of g, 5 % of 0.5."""
    variance = math.log1p(depth**2)
    varied = rough(16, 9) * modulator(16, 10, variance, corner)
    assert measures.am_depth(varied, STEP, corner * 1e3) == pytest.approx(depth, abs=0.04)
    assert measures.am_corner(varied, STEP) == pytest.approx(corner * 1e3, rel=0.15)


def test_depth_does_not_hang_on_the_spectrum() -> None:
    """The third octaves are brought to equal power first."""
    factor = modulator(20, 11, math.log1p(0.3**2), 0.1)
    steep, flat = (
        measures.am_depth(rough(20, 12, slope) * factor, STEP, 100.0) for slope in (-2.0, 0.0)
    )
    assert steep == pytest.approx(flat, abs=0.02)


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.2), (9.1, 10.0)])
def test_what_lies_outside_the_bands_has_no_part_in_depth(low: float, high: float) -> None:
    """A hand that is not modulated, or a sensor: as strong as the surface in all of its bands."""
    surface = rough(8, 14, -0.5) * modulator(8, 15, math.log1p(0.4**2), 0.1)
    frequency = np.fft.rfftfreq(LONG, STEP * 1e3)
    white = np.random.default_rng(16).standard_normal((8, LONG))
    inside = (frequency > low) & (frequency < high)
    other = np.fft.irfft(np.fft.rfft(white) * inside, LONG)
    other *= surface.std() / other.std()
    wanted = measures.am_depth(surface, STEP, 100.0)
    assert wanted == pytest.approx(0.4, abs=0.05)
    assert measures.am_depth(surface + other, STEP, 100.0) == pytest.approx(wanted, abs=0.02)
    wanted = measures.am_corner(surface, STEP)
    assert measures.am_corner(surface + other, STEP) == pytest.approx(wanted, rel=0.1)


def test_depth_is_the_same_however_much_of_chance_lies_below_the_corner() -> None:
    """A modulation below 0.05 cycles/mm, read with corners far above it."""
    varied = rough(20, 17) * modulator(20, 18, math.log1p(0.4**2), 0.05)
    narrow, wide = (measures.am_depth(varied, STEP, corner) for corner in (100.0, 2000.0))
    assert narrow == pytest.approx(0.4, abs=0.04)
    assert wide == pytest.approx(narrow, abs=0.02)


def test_noise_alone_has_no_corner_to_speak_of() -> None:
    """The corner is NaN or a guess; the depth at it stays that of chance."""
    corner = measures.am_corner(rough(20, 13), STEP)
    assert math.isnan(corner) or measures.am_depth(rough(20, 13), STEP, corner) < 0.08
