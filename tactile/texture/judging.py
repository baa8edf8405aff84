"""How well a fit does on recordings that it has not seen, beside what could be hoped for.

The recordings are halved (one recording: in time), a texture is fitted to one half, realized and
slid over, and its 16 bands are compared with those of the other half. Beside it stand the ceiling,
the halves themselves compared; a floor, white noise of the same power; and an autoregressive model
of order 8, as other systems use, of the same half.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz

from tactile.arrays import Floats
from tactile.texture import measures
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import About, Stochastic
from tactile.texture.fitting import Fit, RecordingMeasures, describe, measure_slides
from tactile.texture.recorded_slide import Recorded
from tactile.texture.slide_strokes import INTEGRATIONS
from tactile.texture.surface import Partials, envelope, stochastic_waves

ORDER = 8
WAVES = 384
PERIODS, STROKES = 200, 6
"""Of the lowest band, that are slid over, and how often: 0.3 dB of chance in the lowest band."""
POINTS = 1 << 14
"""Of an autoregressive model's spectrum."""


@dataclass(frozen=True)
class Candidate:
    """A spectrum beside the held-out one.

    Attributes
    ----------
    level : (16,) dB re 1 µm²·mm
    rms_db, absolute_db, bias_db : its log-spectral distance (rms over bands), its mean absolute
        one, and by how much it lies above
    """

    level: Floats
    rms_db: float
    absolute_db: float
    bias_db: float


@dataclass(frozen=True)
class Verdict:
    """What a fit to one half says of the other.

    Attributes
    ----------
    held_out : (16,) levels of the other half, dB re 1 µm²·mm
    rendering : a stroke over the texture that was fitted
    ceiling : the half that was fitted to, as it was recorded
    white, autoregressive : noise, and a model of order 8
    """

    held_out: Floats
    rendering: Candidate
    ceiling: Candidate
    white: Candidate
    autoregressive: Candidate


def beside(level: Floats, held_out: Floats) -> Candidate:
    """Return how far levels (16,) are from those held out, over the bands that both know."""
    error = (level - held_out)[np.isfinite(level - held_out)]
    rms, absolute = np.sqrt(np.mean(error**2)), np.mean(np.abs(error))
    return Candidate(level, float(rms), float(absolute), float(error.mean()))


def halves(recordings: Sequence[Recorded]) -> list[Recorded]:
    """Return two or more recordings: one alone is cut in the middle."""
    if len(recordings) > 1:
        return list(recordings)
    whole, middle = recordings[0], len(recordings[0].signal) // 2
    return [_cut(whole, slice(None, middle)), _cut(whole, slice(middle, None))]


def _cut(whole: Recorded, part: slice) -> Recorded:
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
    recordings : slides of one surface, at one or several speeds and forces
    about : what the descriptor says of itself
    noise : the same sensor with nothing sliding
    reference_speed : at which the texture is to be true and its bands lie at 25–800 Hz [m/s];
        the recordings' geometric mean by default
    progress : called with the name of each step

    Raises
    ------
    InputError
        Where recordings do not go together, are not steady, or cover too little.
    """
    found = measure_slides(
        recordings, noise=noise, reference_speed=reference_speed, progress=progress
    )
    fit = describe(found, about, progress)
    if len(recordings) == 1:
        found = measure_slides(
            halves(recordings), noise=noise, reference_speed=found.reference, progress=progress
        )
    progress("judging")
    return fit, judge(found, about)


def judge(found: RecordingMeasures, about: About) -> Verdict:
    """Fit every other recording and compare with the rest.

    Parameters
    ----------
    found : of two or more recordings
    about : of the texture

    Raises
    ------
    InputError
        As `describe`.
    """
    rows = range(len(found.slides))
    return predict(found.part(rows[::2]), found.part(rows[1::2]), about)


def predict(seen: RecordingMeasures, unseen: RecordingMeasures, about: About) -> Verdict:
    """Fit one part of the recordings and compare with another, each at its own speed and force.

    Parameters
    ----------
    seen, unseen : the parts; bands are compared as the mean over recordings of the level, brought
        to the reference speed and force by the laws that were fitted to what was seen
    about : of the texture

    Raises
    ------
    InputError
        As `describe`.
    """
    fit = describe(seen, about)
    stochastic, laws = fit.descriptor.stochastic, fit.descriptor.laws
    assert stochastic is not None

    def at_reference(part: RecordingMeasures) -> Floats:
        law = laws.speed_exponent * np.log10(part.speed / seen.reference)
        law += laws.force_exponent * np.log10(part.force / fit.descriptor.reference.normal_force_n)
        return np.asarray((part.level - 20 * law[:, None]).mean(axis=0))

    one, other = at_reference(seen), at_reference(unseen)
    anchor = np.nanmean(np.asarray(stochastic.level_db) - one)
    other = other + anchor
    rendered = rendered_levels(stochastic, seen.center)
    return Verdict(
        held_out=other,
        rendering=beside(rendered, other),
        ceiling=beside(one + anchor, other),
        white=beside(_white(rendered, seen.center), other),
        autoregressive=beside(_autoregressive(seen, rendered), other),
    )


def rendered_levels(stochastic: Stochastic, center: Floats) -> Floats:
    """Return the levels (16,) of strokes over a realized surface."""
    strokes, step = rendered_strokes(stochastic, center)
    levels = measures.band_spectrum(strokes, step, center=center)
    return np.asarray(10 * np.log10(np.mean(10 ** (levels / 10), axis=0)))


def rendered_strokes(stochastic: Stochastic, center: Floats) -> tuple[Floats, float]:
    """Return strokes (R, S) [m] along a surface's direction, each elsewhere, and their step [m]."""
    vectors, amplitude = stochastic_waves(stochastic, WAVES)
    step = 1 / (2.56 * third_octaves(center)[-1])
    turn = np.radians(stochastic.direction_deg)
    ahead = step * np.array([np.cos(turn), np.sin(turn)])
    count = round(PERIODS / center[0] / step)

    def stroke(seed: int) -> Floats:
        rng = np.random.default_rng(seed)
        waves = Partials(vectors, amplitude, rng.uniform(0, 2 * np.pi, len(amplitude)))
        slow = envelope(stochastic, rng)
        swell = np.exp(slow.along(ahead, count) - np.sum(slow.amplitude**2) / 2)
        return np.asarray(waves.along(ahead, count) * swell)

    return np.stack([stroke(seed) for seed in range(STROKES)]), float(step)


def _white(levels: Floats, center: Floats) -> Floats:
    """Return white noise of the power that levels (16,) have."""
    width = np.diff(third_octaves(center))
    power = np.sum(10 ** (levels / 10) * width) / width.sum()
    return np.full(len(levels), 10 * np.log10(power))


def _autoregressive(seen: RecordingMeasures, levels: Floats) -> Floats:
    """Return the bands (16,) of an autoregressive model of what was recorded, power as levels'.

    Yule and Walker's equations on the autocorrelation of the recorded quantity over place.
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
    edges = third_octaves(seen.center)
    band = np.digitize(frequency, edges) - 1
    mean = np.array([10 * np.log10(density[band == k].mean()) for k in range(len(levels))])
    return np.asarray(mean + np.mean(levels - mean))
