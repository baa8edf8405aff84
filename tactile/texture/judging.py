"""Assessment of a fit on recordings that were held out, beside references for comparison.

The recordings are halved (a single recording in time), a texture is fitted to one half, realized
and slid over, and its bands from 25 to 800 Hz at the reference speed are compared with those of the
other half. Three references stand beside it: the ceiling, which compares the halves themselves; a
floor, white noise of the same power; and an autoregressive model of order 8 of the same half, as
other systems use it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz

from tactile.arrays import Floats
from tactile.texture import measures
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import About, Laws, Stochastic
from tactile.texture.fitting import Fit, RecordingMeasures, describe, measure_slides
from tactile.texture.power_laws import level_shift
from tactile.texture.recorded_slide import Recorded
from tactile.texture.slide_strokes import INTEGRATIONS
from tactile.texture.surface import (
    PARTIALS,
    Partials,
    Surface,
    density_of,
    envelope,
    envelope_scale,
    scatter,
    stochastic_waves,
)

ORDER = 8
"""Order of the autoregressive model."""
PERIODS, STROKES = 200, 24
"""Length of a rendered stroke in periods of the lowest band, and number of strokes. They leave a
random error of 0.15 dB in the lowest band."""
POINTS = 1 << 14
"""Length of the Fourier transform for the spectrum of the autoregressive model."""


@dataclass(frozen=True)
class Candidate:
    """A spectrum compared with the one that was held out.

    Attributes
    ----------
    level : (C,) array of float
        Levels of the spectrum [dB re 1 µm²·mm].
    rms_db : float
        Log-spectral distance, the rms difference over bands [dB].
    absolute_db : float
        Mean absolute difference over bands [dB].
    bias_db : float
        Mean difference over bands, positive if the spectrum lies above [dB].
    """

    level: Floats
    rms_db: float
    absolute_db: float
    bias_db: float


@dataclass(frozen=True)
class Verdict:
    """Prediction of one half of the recordings by a fit to the other half.

    Attributes
    ----------
    center : (C,) array of float
        Centers of the bands that are compared, 25–800 Hz at the reference speed [cycles/m].
    held_out : (C,) array of float
        Levels of the half that was not fitted [dB re 1 µm²·mm].
    rendering : Candidate
        Strokes over the texture that was fitted.
    ceiling : Candidate
        The half that was fitted, as it was recorded.
    white : Candidate
        White noise of the power of the rendering.
    autoregressive : Candidate
        Autoregressive model of order 8.
    """

    center: Floats
    held_out: Floats
    rendering: Candidate
    ceiling: Candidate
    white: Candidate
    autoregressive: Candidate


def beside(level: Floats, held_out: Floats) -> Candidate:
    """Compare levels with those held out, over the bands that both have.

    Parameters
    ----------
    level : (C,) array of float
        Levels, NaN where unknown [dB].
    held_out : (C,) array of float
        Levels held out, NaN where unknown [dB].

    Returns
    -------
    Candidate
        Levels with their distances.
    """
    error = (level - held_out)[np.isfinite(level - held_out)]
    rms, absolute = np.sqrt(np.mean(error**2)), np.mean(np.abs(error))
    return Candidate(level, float(rms), float(absolute), float(error.mean()))


def halves(recordings: Sequence[Recorded]) -> list[Recorded]:
    """Return the recordings, a single one cut in two in the middle of its time.

    Parameters
    ----------
    recordings : sequence of Recorded
        One or more recordings.

    Returns
    -------
    list of Recorded
        Two or more recordings.
    """
    if len(recordings) > 1:
        return list(recordings)
    recording, middle = recordings[0], len(recordings[0].signal) // 2
    return [_cut(recording, slice(None, middle)), _cut(recording, slice(middle, None))]


def _cut(whole: Recorded, part: slice) -> Recorded:
    """Return a part of a recording."""

    def cut(side: Floats | None) -> Floats | None:
        return None if side is None else side[part]

    return replace(
        whole,
        signal=whole.signal[part],
        speed=whole.speed[part],
        normal_force=cut(whole.normal_force),
        tangential_force=cut(whole.tangential_force),
    )


def fit_texture(
    recordings: Sequence[Recorded],
    about: About,
    *,
    noise: Recorded | None = None,
    reference_speed: float | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[Fit, Verdict]:
    """Fit a texture to recordings of it, and judge such a fit on recordings held out.

    Parameters
    ----------
    recordings : sequence of Recorded
        Slides over one surface, at one or several speeds and forces.
    about : About
        Identity and provenance for the descriptor.
    noise : Recorded or None
        Recording of the same sensor with nothing sliding.
    reference_speed : float or None
        Speed at which the texture holds [m/s], by default the geometric mean of the recordings.
    progress : callable
        Function that is called with the name of each step.

    Returns
    -------
    fit : Fit
        Texture fitted to all recordings.
    verdict : Verdict
        Assessment of a fit to half of them.

    Raises
    ------
    InputError
        If the recordings differ in quantity or calibration, are not steady, or cover too little.
    """
    measured = measure_slides(
        recordings, noise=noise, reference_speed=reference_speed, progress=progress
    )
    fit = describe(measured, about, progress)
    if len(recordings) == 1:
        measured = measure_slides(
            halves(recordings), noise=noise, reference_speed=measured.reference, progress=progress
        )
    progress("judging")
    return fit, judge(measured, about)


def judge(measured: RecordingMeasures, about: About) -> Verdict:
    """Fit every other recording and compare with the rest.

    Parameters
    ----------
    measured : RecordingMeasures
        Measurements of two or more recordings.
    about : About
        Identity and provenance of the texture.

    Returns
    -------
    Verdict
        Comparison with the recordings that were not fitted.

    Raises
    ------
    InputError
        If no texture can be made of the recordings, as in `describe`.
    """
    rows = range(len(measured.slides))
    return predict(measured.part(rows[::2]), measured.part(rows[1::2]), about)


def predict(seen: RecordingMeasures, unseen: RecordingMeasures, about: About) -> Verdict:
    """Fit one part of the recordings and compare with another, each at its own speed and force.

    Bands of 25–800 Hz at the reference speed are compared as the mean level over recordings,
    brought to the reference speed and force by the laws that were fitted to the first part. The
    renderer applies the same laws, so that the error is that of strokes rendered at the speeds and
    forces of the second part.

    Parameters
    ----------
    seen : RecordingMeasures
        Measurements to fit.
    unseen : RecordingMeasures
        Measurements to compare with.
    about : About
        Identity and provenance of the texture.

    Returns
    -------
    Verdict
        Comparison with the second part.

    Raises
    ------
    InputError
        If no texture can be made of the first part, as in `describe`.
    """
    fit = describe(seen, about)
    stochastic, laws = fit.descriptor.stochastic, fit.descriptor.laws
    assert stochastic is not None

    def at_reference(part: RecordingMeasures) -> Floats:
        law = level_shift(laws, fit.descriptor.reference, part.speed, part.force)
        return np.asarray((part.level - law[:, None]).mean(axis=0)[part.core])

    center, seen_level, held_out = seen.center[seen.core], at_reference(seen), at_reference(unseen)
    anchor = np.nanmean(np.asarray(stochastic.level_db)[seen.core] - seen_level)
    held_out = held_out + anchor
    rendered = rendered_levels(stochastic, center)
    return Verdict(
        center=center,
        held_out=held_out,
        rendering=beside(rendered, held_out),
        ceiling=beside(seen_level + anchor, held_out),
        white=beside(_white(rendered, center), held_out),
        autoregressive=beside(_autoregressive(seen, rendered), held_out),
    )


def rendered_levels(stochastic: Stochastic, center: Floats) -> Floats:
    """Measure the band levels of strokes over a realized surface.

    Parameters
    ----------
    stochastic : Stochastic
        Random part of a texture.
    center : (C,) array of float
        Band centers [cycles/m].

    Returns
    -------
    (C,) array of float
        Levels of the mean power over strokes [dB re 1 µm²·mm].
    """
    strokes, step = rendered_strokes(stochastic, center)
    levels = measures.band_spectrum(strokes, step, center=center)
    return np.asarray(10 * np.log10(np.mean(10 ** (levels / 10), axis=0)))


def rendered_strokes(stochastic: Stochastic, center: Floats) -> tuple[Floats, float]:
    """Render strokes along the direction of a surface, each at another place.

    Parameters
    ----------
    stochastic : Stochastic
        Random part of a texture.
    center : (C,) array of float
        Band centers, which set the length and the sampling of strokes [cycles/m].

    Returns
    -------
    strokes : (R, S) array of float
        Displacement [m].
    step : float
        Distance between samples [m].
    """
    vectors, amplitude = stochastic_waves(stochastic, PARTIALS)
    density = density_of(vectors, amplitude, stochastic, Laws())
    step = 1 / (2.56 * third_octaves(center)[-1])
    turn = np.radians(stochastic.direction_deg)
    way = np.outer(
        step * np.arange(round(PERIODS / center[0] / step)), [np.cos(turn), np.sin(turn)]
    )
    rng = np.random.default_rng(0)
    waves = Partials(vectors, amplitude, rng.uniform(0, 2 * np.pi, len(amplitude)))
    slow, none = envelope(stochastic, rng), scatter((), Surface.tile, rng)
    surface = Surface(waves, slow, *none, density=density)

    def stroke() -> Floats:
        place = rng.uniform(-1, 1, 2) + way
        return surface.random_part(place) * envelope_scale(slow) * np.exp(slow.at(place))

    return np.stack([stroke() for _ in range(STROKES)]), float(step)


def _white(levels: Floats, center: Floats) -> Floats:
    """Return the levels (C,) of white noise of the same power as given levels."""
    width = np.diff(third_octaves(center))
    power = np.sum(10 ** (levels / 10) * width) / width.sum()
    return np.full(len(levels), 10 * np.log10(power))


def _autoregressive(seen: RecordingMeasures, levels: Floats) -> Floats:
    """Return the bands (C,) of an autoregressive model of the recordings, with given mean level.

    The Yule-Walker equations are solved for the autocorrelation of the recorded quantity over
    place.
    """
    recorded = seen.slides[0].recorded.quantity
    steps = [u for slide in seen.slides for u in slide.strokes]
    frequency = np.fft.rfftfreq(POINTS, seen.step)
    spectra = [np.abs(np.fft.rfft(u * np.hanning(len(u)), POINTS * 8)[::8]) ** 2 for u in steps]
    weight = np.maximum(frequency, frequency[1]) ** (2 * INTEGRATIONS[recorded])
    autocorrelation = np.fft.irfft(np.mean(spectra, axis=0) * weight)[: ORDER + 1]
    model = solve_toeplitz(autocorrelation[:ORDER], autocorrelation[1:])
    turn = np.exp(-2j * np.pi * np.outer(frequency * seen.step, np.arange(1, ORDER + 1)))
    density = 1 / np.abs(1 - turn @ model) ** 2 / weight
    edges = third_octaves(seen.center[seen.core])
    band = np.digitize(frequency, edges) - 1
    mean = np.array([10 * np.log10(density[band == k].mean()) for k in range(len(levels))])
    return np.asarray(mean + np.mean(levels - mean))
