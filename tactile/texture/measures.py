"""Definitions of the numbers of a descriptor as measurements of strokes: bands, kurtosis, AM depth.

A fit applies these functions to recordings, and the benchmarks apply the same ones to what is
rendered. Every signal is tangential displacement on an even grid of **positions** along a straight
stroke, either one stroke (S,) or several over one texture (R, S). Everything is measured within
given bands: what a hand adds below them, or the noise of a sensor above them, does not count. Lines
belong to ``[[periodic]]`` and rare features to ``[[events]]``. Both are to be removed before the
kurtosis and modulation of the ``[stochastic]`` part are measured.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import butter, detrend, sosfiltfilt
from scipy.signal.windows import tukey
from scipy.special import hyp2f1

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.bands import third_octaves

CENTERS = 10 ** (np.arange(-6, 10) / 10) * 1e3
"""Exact centers of the 16 third octaves of the shipped textures (IEC 61260-1), which a file may
round [cycles/m]."""
SEGMENT = 20
"""Length of a segment of a spectrum, in periods of the lowest band: 80 mm for 0.25 cycles/mm. Under
a Hann window a line is then 50 cycles/m wide, and the lowest band 58."""
SHORTEST = 10
"""Smallest length of a stroke, in periods of the lowest band. A shorter one cannot tell the lowest
bands apart."""
END = 2
"""Length at either end that filters distort and that is left out, in periods of the lowest band."""
QUIET = 1e-5
"""Power relative to the strongest third octave below which a third octave is not raised to it."""
HIGHEST_CORNER = 1e3
"""Highest spatial frequency at which modulation is searched, as far as a descriptor goes
[cycles/m]."""


def band_spectrum(signal: Floats, step: float, *, center: Floats = CENTERS) -> Floats:
    """Compute the level of each band.

    Parameters
    ----------
    signal : (..., S) array of float
        Tangential displacement [m].
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    (..., B) array of float
        One-sided power spectral density [dB re 1 µm²·mm].

    Raises
    ------
    InputError
        If the stroke is shorter than 10 periods of the lowest band, sampled too coarsely for the
        highest, or not finite.

    Notes
    -----
    Welch's method is used with segments of 20 periods of the lowest band, half overlapping; a
    shorter stroke is one segment. Each segment is detrended linearly and multiplied by a Hann
    window. The level is the power between the edges of a band divided by its width, where bins on
    an edge are shared.
    """
    signal = _checked(signal, step, center)
    size = min(signal.shape[-1], round(SEGMENT / (center[0] * step)))
    window = np.hanning(size + 1)[:-1]
    segments = sliding_window_view(signal, size, axis=-1)[..., :: max(size // 2, 1), :]
    density = _periodogram(segments, window).mean(axis=-2)
    return 10 * np.log10(np.maximum(_band_means(density * step * 1e15, size * step, center), 1e-30))


def _checked(signal: Floats, step: float, center: Floats) -> Floats:
    """Return the signal as float64, or raise `InputError` if it cannot be measured."""
    signal = np.asarray(signal, np.float64)
    top = float(third_octaves(center)[-1])
    if not 0 < step <= 1 / (2 * top):
        raise InputError(
            f"step = {step * 1e6:g} µm: bands to {top * 1e-3:.3g} cycles/mm need at most "
            f"{0.5e6 / top:.3g} µm; sample faster or slide slower"
        )
    length, shortest = signal.shape[-1] * step, SHORTEST / float(center[0])
    if length < shortest * (1 - 1e-9):
        raise InputError(
            f"stroke of {length * 1e3:.3g} mm: the lowest band needs at least "
            f"{shortest * 1e3:.2g} mm; slide farther"
        )
    if not np.isfinite(signal).all():
        raise InputError("stroke: holds a number that is not finite")
    return signal


def _periodogram(part: Floats, window: Floats) -> Floats:
    """Return the one-sided power per cycle per sample (..., F)."""
    spectrum = np.fft.rfft(detrend(part, axis=-1) * window, axis=-1)
    return np.asarray(2 * np.abs(spectrum) ** 2 / np.sum(window**2))


def _band_means(density: Floats, length: float, center: Floats) -> Floats:
    """Return the mean of a density (..., F) at multiples of 1/length over each band (..., B)."""
    total = np.cumsum(density, axis=-1)
    ends = (np.arange(density.shape[-1]) + 0.5) / length
    edges = third_octaves(center)
    upto = np.apply_along_axis(lambda row: np.interp(edges, ends, row), -1, total) / length
    return np.asarray(np.diff(upto, axis=-1) / np.diff(edges))


def excess_kurtosis(signal: Floats, step: float, *, center: Floats = CENTERS) -> float:
    """Compute the excess kurtosis ⟨u⁴⟩/⟨u²⟩² − 3 of displacement within the bands.

    The signal is band-passed between the outer edges of the bands by a Butterworth filter of order
    4, forward and backward, and two periods of the lowest band are left out at either end. Each
    stroke is scaled to an rms of one, so that a level that differs from stroke to stroke does not
    count as kurtosis.

    Parameters
    ----------
    signal : (S,) or (R, S) array of float
        Displacement without lines and rare features [m].
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    float
        Excess kurtosis, 0 for a Gaussian signal.

    Raises
    ------
    InputError
        If the signal cannot be measured, as in `band_spectrum`.
    """
    signal = _checked(signal, step, center)
    edges = third_octaves(center)
    top = min(edges[-1], 0.499 / step)
    band = butter(4, (edges[0], top), "bandpass", fs=1 / step, output="sos")
    inner = _inner(sosfiltfilt(band, detrend(signal, axis=-1), axis=-1), step, center)
    unit = inner / np.sqrt(np.mean(inner**2, axis=-1, keepdims=True))
    return float(np.mean(unit**4) - 3)


def _inner(signal: Floats, step: float, center: Floats) -> Floats:
    """Return the signal without the ends that filters distort."""
    spoiled = round(END / (center[0] * step))
    return signal[..., spoiled : signal.shape[-1] - spoiled]


def am_depth(signal: Floats, step: float, corner: float, *, center: Floats = CENTERS) -> float:
    """Compute the depth of the amplitude modulation below a corner.

    The depth is the standard deviation over the mean of that part of the envelope. The envelope is
    the magnitude of the analytic signal of a displacement whose third octaves are first scaled to
    equal power, so that every band tells equally how strong the surface is at a place. The envelope
    of a normal process varies without any modulation; the part of that variation below the corner
    is known in closed form and is subtracted.

    Parameters
    ----------
    signal : (S,) or (R, S) array of float
        Displacement without lines and rare features [m].
    step : float
        Distance between samples [m].
    corner : float
        Highest spatial frequency of the modulation [cycles/m], ``am_corner_per_mm`` of the
        descriptor.
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    float
        Modulation depth, 0 without modulation.

    Raises
    ------
    InputError
        If the signal cannot be measured, as in `band_spectrum`.

    Notes
    -----
    The envelope is r = e ρ, with the modulation e and the independent envelope ρ of the process.
    Below the corner var(r)/⟨r⟩² = d² + (1 + d²) d₀², where d₀² is the share of ρ alone. It follows
    from the transform of ₂F₁(−½, −½; 1; k²) − 1, the covariance of the envelope of a normal process
    over its mean squared (Rice 1944; Middleton 1960), where k is the magnitude of its analytic
    autocorrelation.
    """
    frequency, envelope_power, normal_power = _modulation(signal, step, center)
    low = (frequency > 0) & (frequency <= corner)
    measured, chance = envelope_power[low].sum(), normal_power[low].sum()
    return float(np.sqrt(max((measured - chance) / (1 + chance), 0.0)))


def am_corner(signal: Floats, step: float, *, center: Floats = CENTERS) -> float:
    """Estimate the highest spatial frequency of the amplitude modulation.

    Measured on a single stroke of a few periods of the corner, or for a modulation below 0.1, the
    result is a guess.

    Parameters
    ----------
    signal : (S,) or (R, S) array of float
        Displacement without lines and rare features [m].
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    float
        Corner of the modulation, NaN without modulation [cycles/m].

    Raises
    ------
    InputError
        If the signal cannot be measured, as in `band_spectrum`.

    Notes
    -----
    The spectrum of the modulation is taken as flat up to its corner. With C(f) the power of the
    envelope up to f in excess of that of a normal process, and V(f) the sum of the squares of the
    latter, which grows as the variance of C by chance, the corner is where C²/V is largest.
    """
    frequency, envelope_power, normal_power = _modulation(signal, step, center)
    searched = (frequency > 0) & (frequency <= HIGHEST_CORNER)
    excess = np.maximum(np.cumsum((envelope_power - normal_power)[searched]), 0)
    if not excess.any():
        return float("nan")
    return float(frequency[searched][np.argmax(excess**2 / np.cumsum(normal_power[searched] ** 2))])


def _modulation(signal: Floats, step: float, center: Floats) -> tuple[Floats, Floats, Floats]:
    """Return frequencies [cycles/m] and the power of the envelope there, over its mean squared.

    The power is returned twice: measured, as the mean over strokes, and that of a normal process of
    the same spectrum.
    """
    signal = np.atleast_2d(_checked(signal, step, center))
    count = signal.shape[-1]
    mean_power = np.mean(10 ** (band_spectrum(signal, step, center=center) / 10), axis=0)
    levels = np.asarray(10 * np.log10(mean_power))
    frequency = np.asarray(np.fft.rfftfreq(count, step))
    gain, power = _equalization(frequency, levels, center)
    ends = tukey(count, min(2 * END / (center[0] * count * step), 1.0))
    spectrum = np.asarray(np.fft.rfft(detrend(signal, axis=-1) * ends, axis=-1) * gain)
    envelope = _inner(np.abs(_analytic(spectrum, count)), step, center)
    envelope = envelope / envelope.mean(axis=-1, keepdims=True) - 1
    inner = envelope.shape[-1]
    bins = 2 * np.abs(np.fft.rfft(envelope, axis=-1) / inner) ** 2
    measured_power = np.asarray(bins.mean(axis=0))
    correlation = np.abs(_analytic(power, count)) ** 2
    normal_power = (
        np.fft.rfft(hyp2f1(-0.5, -0.5, 1, correlation / correlation[0]) - 1).real * 2 / count
    )
    envelope_frequency = np.asarray(np.fft.rfftfreq(inner, step))
    return (
        envelope_frequency,
        measured_power,
        np.interp(envelope_frequency, frequency, np.maximum(normal_power, 0)) * count / inner,
    )


def _analytic(spectrum: NDArray[np.inexact], count: int) -> NDArray[np.complex128]:
    """Return the signal (..., count) of the positive frequencies of a spectrum (..., F)."""
    wide = np.zeros((*spectrum.shape[:-1], count), np.complex128)
    wide[..., : spectrum.shape[-1]] = spectrum
    return np.asarray(np.fft.ifft(wide, axis=-1))


def _equalization(frequency: Floats, levels: Floats, center: Floats) -> tuple[Floats, Floats]:
    """Return the gain that brings third octaves to equal power, and the power spectrum it leaves.

    Levels are interpolated linearly between centers over the logarithm of frequency, and held
    beyond.
    """
    edges = third_octaves(center)
    inside = (frequency >= edges[0]) & (frequency <= edges[-1])
    safe = np.where(inside, frequency, 1.0)
    octave = 10 ** (np.interp(np.log(safe), np.log(center), levels) / 10) * safe
    strongest = np.where(inside, octave, 0.0).max()
    gain = np.where(inside, 1 / np.sqrt(np.maximum(octave, QUIET * strongest)), 0.0)
    return gain, gain**2 * octave / safe
