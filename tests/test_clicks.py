"""Clicks are found in noise, removed, and described by events on which strokes meet the same ones.

Noise falls by 12 dB per octave of density, as displacement under a BioTac does.
"""

from dataclasses import replace

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.texture.clicks import Clicks, find_clicks, quiet_levels
from tactile.texture.descriptor import About, Events, Stochastic
from tactile.texture.event_power import FWHM
from tactile.texture.fitting import describe, measure_slides
from tactile.texture.measures import excess_kurtosis
from tactile.texture.recorded_slide import Recorded
from tactile.texture.surface import envelope, envelope_scale

CENTER = 1e3 * 10 ** (np.arange(1, 17) / 10)
STEP, SIZE, STROKES = 8.7e-6, 6500, 6
LENGTH = SIZE * STEP
ABOUT = About(
    id="clicks", category="test", description="", provenance="fitted", source="a test",
    license="CC0-1.0",
)  # fmt: skip


def noise(rng: np.random.Generator) -> Floats:
    """Return strokes (6, S) of normal noise of 1 µm rms."""
    frequency = np.fft.rfftfreq(SIZE, STEP)
    size = (STROKES, len(frequency))
    spectrum = rng.standard_normal(size) + 1j * rng.standard_normal(size)
    shape = np.where(frequency > 900, 1 / np.maximum(frequency, 1), 0)
    signal = np.fft.irfft(spectrum * shape, SIZE)
    return np.asarray(1e-6 * signal / signal.std())


def met(kind: Events, rng: np.random.Generator) -> Floats:
    """Return what a stroke meets of events that are scattered at random, summed one by one."""
    sigma, place, total = kind.width_mm * 1e-3 / FWHM, np.arange(SIZE) * STEP, np.zeros(SIZE)
    for _ in range(rng.poisson(kind.density_per_mm2 * 1e6 * LENGTH * 10 * sigma)):
        spread = np.exp(kind.amplitude_sd * rng.standard_normal()) * rng.choice([-1, 1])
        along, beside = (place - rng.uniform(0, LENGTH)) / sigma, rng.uniform(-5, 5)
        bump = np.exp(-(along**2 + beside**2) / 2)
        total += kind.amplitude_um * 1e-6 * spread * bump
    return total


def found_in(strokes: Floats) -> tuple[Clicks | None, list[Floats]]:
    return find_clicks(list(strokes), STEP, CENTER, [range(STROKES)])


def test_the_level_between_clicks_is_that_of_the_noise() -> None:
    """White noise of 1 µm rms has 2 step µm²·mm; clicks of 20 µm add up to 1.3 dB to it.

    Without them it is known within 0.4 dB in each band.
    """
    strokes = 1e-6 * np.random.default_rng(2).standard_normal((STROKES, SIZE))
    strokes[:, 1500:6000:1500] += 2e-5
    level = quiet_levels(list(strokes), STEP, CENTER)
    assert np.abs(level - 10 * np.log10(2 * STEP * 1e3)).max() < 2


def test_clicks_are_found_with_their_heights_and_removed() -> None:
    """The noise changes a height of 20 µm by 1 µm."""
    rng = np.random.default_rng(1)
    plain = noise(rng)
    along = (np.arange(SIZE) * STEP - 0.5 * LENGTH) * FWHM / 0.15e-3
    found, rest = found_in(plain + 20e-6 * np.exp(-(along**2) / 2))
    assert found is not None
    assert found.shape == "pulse"
    assert found.width == pytest.approx(0.15e-3)
    assert [len(heights) for heights in found.heights] == [1] * STROKES
    np.testing.assert_allclose(np.concatenate(found.heights), 20e-6, rtol=0.2)
    for left, before in zip(rest, plain, strict=True):
        assert np.abs(left - before).max() < 5e-6


def test_a_stroke_whose_clicks_hide_each_other_does_not_hide_those_of_others() -> None:
    """Four clicks within 4 mm raise what counts as the noise around them, and most stay."""
    strokes = noise(np.random.default_rng(5))
    for k, stroke in enumerate(strokes):
        for place in (0.4, 0.42, 0.44, 0.46) if k == 0 else (0.2 + 0.1 * k,):
            along = (np.arange(SIZE) * STEP - place * LENGTH) * FWHM / 0.225e-3
            stroke += (40e-6 if k == 0 else 20e-6) * np.exp(-(along**2) / 2)
    found, rest = found_in(strokes)
    assert found is not None
    assert found.shape == "pulse"
    assert found.width == pytest.approx(0.225e-3)
    assert len(found.heights[0]) < 4
    assert excess_kurtosis(rest[0], STEP, center=CENTER) > 10
    seen = [np.abs(heights - 20e-6).min(initial=np.inf) for heights in found.heights[1:]]
    assert np.count_nonzero(np.array(seen) < 4e-6) >= 4


def test_bands_too_fine_for_the_narrowest_clicks_have_none() -> None:
    """Periods of the lowest band, 0.13 mm, are less than two of the narrowest clicks, 0.1 mm."""
    strokes = noise(np.random.default_rng(2))
    strokes[:, 3000:3020] += 50e-6
    found, rest = find_clicks(list(strokes), STEP, CENTER[8:], [range(STROKES)])
    assert found is None
    np.testing.assert_array_equal(rest, strokes)


def test_strokes_with_too_few_clicks_are_left_as_they_are() -> None:
    strokes = noise(np.random.default_rng(2))
    strokes[0, 3000:3020] += 50e-6
    found, rest = found_in(strokes)
    assert found is None
    np.testing.assert_array_equal(rest, strokes)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("depth", "kurtosis", "corner"), [(0, 0, 0.1), (0.3, 1.2, 0.1), (0.2, 3, 0.3), (0.3, 10, 0.1)]
)
def test_normal_noise_has_no_clicks_under_any_usual_envelope(
    depth: float, kurtosis: float, corner: float
) -> None:
    """None of 30 fits has a false alarm: the rate is below 10 % with 95 % confidence (0.9^30)."""
    stochastic = Stochastic(
        frequency_per_mm=tuple(CENTER * 1e-3), level_db=(0.0,) * 16, am_depth=depth,
        excess_kurtosis=kurtosis, am_corner_per_mm=corner,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    for _ in range(30):
        strokes = noise(rng)
        for stroke in strokes:
            waves = envelope(stochastic, rng)
            place = np.arange(SIZE)[:, None] * np.array([STEP, 0.0])
            stroke *= envelope_scale(waves) * np.exp(waves.at(place))
        assert found_in(strokes)[0] is None


def test_events_bring_the_power_and_the_fourth_moment_of_the_clicks_they_describe() -> None:
    """Heights A exp(−r²/2σ²) of 4·10⁴ events with the peak 10 µm exp(0.4 n), drawn at random.

    The fourth moment errs by 3 %, the spread by a step of 0.025; the density follows by 10 %.
    """
    rng, sigma = np.random.default_rng(4), 0.2e-3 / FWHM
    peaks = 10e-6 * np.exp(0.4 * rng.standard_normal(40_000))
    heights = peaks * np.exp(-(rng.uniform(-5, 5, len(peaks)) ** 2) / 2)
    density, seen = 0.2e6, 4e-6
    length = len(peaks) / (density * 10 * sigma)
    found = Clicks(
        "pulse", 0.2e-3, (heights[heights > seen],), np.array([seen]), np.array([length])
    )
    kind = found.events(np.ones(1))
    assert kind is not None
    assert kind.density_per_mm2 == pytest.approx(0.2, rel=0.15)
    assert kind.amplitude_um == pytest.approx(10, rel=0.1)
    assert kind.amplitude_sd == pytest.approx(0.4, abs=0.05)
    twice = found.events(np.full(1, 2.0))
    assert twice is not None
    assert twice.amplitude_um == pytest.approx(2 * kind.amplitude_um, rel=0.01)
    assert replace(found, heights=(heights[:4],)).events(np.ones(1)) is None


def slides(strokes: Floats) -> list[Recorded]:
    """Return strokes as recordings at 20 mm/s."""
    rate = 0.02 / STEP
    return [
        Recorded(
            name=f"{k}", signal=u, quantity="displacement", sample_rate=rate,
            speed=np.full(len(u), 0.02),
        )
        for k, u in enumerate(strokes)
    ]  # fmt: skip


@pytest.mark.ci
def test_a_fit_writes_events_instead_of_a_kurtosis() -> None:
    """What remains without the clicks has less than 0.3 of the kurtosis.

    Within the bands, a pulse of 0.15 mm and an edge of 0.15 or 0.225 mm look much alike, so that
    the shape is left open here.
    """
    rng = np.random.default_rng(5)
    kind = Events(density_per_mm2=0.4, amplitude_um=20, amplitude_sd=0.4, width_mm=0.15)
    plain = noise(rng)
    spiky = plain + np.array([met(kind, rng) for _ in range(STROKES)])
    measured = measure_slides(slides(spiky))
    assert measured.clicks is not None
    assert measured.part([0, 2]).clicks is not None
    fitted = describe(measured, ABOUT).descriptor
    (event,) = fitted.events
    assert 0.1 <= event.width_mm <= 0.23
    assert fitted.stochastic is not None
    assert fitted.stochastic.excess_kurtosis < 0.3 * excess_kurtosis(spiky, STEP, center=CENTER)
    even = describe(measure_slides(slides(plain)), ABOUT).descriptor
    assert even.events == ()
