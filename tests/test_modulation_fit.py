"""A fit finds what ribs do to fine vibration, and finds none where there are none.

Strokes are Gaussian noise times exp(a cos 2πx/λ), drawn over place and read over time.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import i0, i1

from tactile.arrays import Floats
from tactile.texture.descriptor import About, Descriptor
from tactile.texture.fitting import describe, measure_slides
from tactile.texture.modulation_fit import find_modulations
from tactile.texture.recorded_slide import Recorded

ABOUT = About(
    id="ribs", category="test", description="", provenance="fitted", source="a test",
    license="CC0-1.0",
)  # fmt: skip
RATE, STEP = 8000.0, 8e-6
SPEEDS = 0.02, 0.05
HEIGHT = 0.6
"""Amplitude a of the exponent, and the depth that it makes."""
DEPTH = float(2 * i1(HEIGHT) / i0(HEIGHT))


def noise(rng: np.random.Generator, size: int) -> Floats:
    """Return normal noise of 1 µm rms that falls by 6 dB per octave from 0.2 cycles/mm on."""
    frequency = np.fft.rfftfreq(size, STEP)
    spectrum = rng.standard_normal((2, len(frequency)))
    shape = np.where(frequency > 200, 1 / np.maximum(frequency, 1), 0)
    signal = np.fft.irfft((spectrum[0] + 1j * spectrum[1]) * shape, size)
    return np.asarray(1e-6 * signal / signal.std())


def slides(
    wavelength: float = 0.0, hertz: float = 0.0, wander: float = 0.0, seed: int = 0
) -> list[Recorded]:
    """Return slides of 3 s over ribs [m], or under a machine that modulates in time [Hz]."""
    rng, recordings = np.random.default_rng(seed), []
    time = np.arange(round(3 * RATE)) / RATE
    for k, mean in enumerate(SPEEDS):
        speed = mean * (1 + wander * np.sin(4 * time + k))
        place = np.cumsum(speed) / RATE
        turn = 2 * np.pi * (place / wavelength if wavelength else hertz * time) + k
        plain = noise(rng, round(1.1 * mean * 3 / STEP))
        signal = np.interp(place, STEP * np.arange(len(plain)), plain)
        envelope = np.exp(HEIGHT * np.cos(turn) * bool(wavelength or hertz))
        recordings.append(
            Recorded(
                name=f"{k}", signal=signal * envelope, quantity="displacement", sample_rate=RATE,
                speed=speed,
            )
        )  # fmt: skip
    return recordings


def fitted(recordings: list[Recorded]) -> Descriptor:
    return describe(measure_slides(recordings), ABOUT).descriptor


@pytest.mark.parametrize("wander", [pytest.param(0.0, marks=pytest.mark.ci), 0.05])
def test_ribs_are_fitted_with_their_wavelength_and_depth(wander: float) -> None:
    """Depths err by 0.02 for 1200 cycles of bandwidth times length or more."""
    (ribs,) = fitted(slides(1.5e-3, wander=wander)).modulation
    assert ribs.wavelength_mm == pytest.approx(1.5, rel=0.005)
    assert ribs.depth == pytest.approx(DEPTH, abs=0.06)


@pytest.mark.ci
def test_what_ribs_add_counts_neither_as_kurtosis_nor_as_random_envelope() -> None:
    """Alone, the ribs bring an excess kurtosis of 3 I₀(4a)/I₀(2a)² − 3 = 1.7."""
    assert 3 * i0(4 * HEIGHT) / i0(2 * HEIGHT) ** 2 - 3 == pytest.approx(1.7, abs=0.05)
    stochastic = fitted(slides(1.5e-3)).stochastic
    assert stochastic is not None
    assert stochastic.excess_kurtosis < 0.4
    assert stochastic.am_depth < 0.1


@pytest.mark.ci
def test_a_machine_that_modulates_at_one_frequency_in_time_makes_no_ribs() -> None:
    assert fitted(slides(hertz=30.0)).modulation == ()


@pytest.mark.ci
def test_ribs_at_a_single_speed_are_not_told_from_a_machine() -> None:
    first, other = slides(1.5e-3)
    one_speed = [first, replace(slides(1.5e-3, seed=1)[0], name="again")]
    assert fitted(one_speed).modulation == ()
    assert len(fitted([first, other]).modulation) == 1


@pytest.mark.ci
def test_noise_has_no_ribs() -> None:
    """None of 30 pairs of strokes has any: the rate is below 10 % with 95 % confidence (0.9^30)."""
    for seed in range(30):
        assert fitted(slides(seed=seed)).modulation == ()


def test_a_stroke_too_short_for_what_the_fastest_one_can_tell_has_no_ribs() -> None:
    """Ten periods in 21 mm are 480 cycles/m; at 1 m/s a line must be below 100."""
    rng, center = np.random.default_rng(0), 1e3 * 10 ** (np.arange(16) / 10)
    strokes = [noise(rng, 2600), noise(rng, 60_000)]
    assert find_modulations(strokes, STEP, np.array([0.005, 1.0]), center) == []
