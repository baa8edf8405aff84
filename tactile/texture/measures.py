"""What a descriptor's numbers mean, as measurements of strokes: bands, kurtosis and AM depth.

A fit measures recordings with these, and the benchmarks measure what is rendered with the same.
Every signal is tangential displacement on an even grid of **positions** along a straight stroke,
one stroke (S,) or several of one texture (R, S). All is measured within the 16 bands: what a hand
adds below, or a sensor's noise above, does not count. Lines belong to ``[[periodic]]`` and rare
features to ``[[events]]``; both are to be taken off before kurtosis and modulation of the
``[stochastic]`` part are measured.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, detrend, sosfiltfilt
from scipy.signal.windows import tukey
from scipy.special import hyp2f1

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.bands import third_octaves

CENTERS = 10 ** (np.arange(-6, 10) / 10) * 1e3
"""Of the 16 third octaves, exact (IEC 61260-1) [cycles/m]; a file may round them."""
SEGMENT = 20
"""Periods of the lowest band, of a spectrum: 80 mm of 0.25 cycles/mm. Under a Hann window a line is
50 cycles/m wide there, the lowest band 58."""
SHORTEST = 10
"""Periods of the lowest band: a shorter stroke cannot tell the lowest bands apart."""
END = 2
"""Periods of the lowest band at either end that filters spoil."""
QUIET = 1e-5
"""Of the strongest third octave's power: one that is weaker is not brought up to it."""
HIGHEST_CORNER = 1e3
"""cycles/m up to which modulation is sought, as far as a descriptor goes."""


def band_spectrum(signal: Floats, step: float, *, center: Floats = CENTERS) -> Floats:
    """Return the level of each band.

    Welch's method: segments of 20 periods of the lowest band (a shorter stroke is one), half
    overlapping, each without its straight trend and under a Hann window; power between a band's
    edges, bins on an edge shared, over its width.

    Parameters
    ----------
    signal : (..., S) tangential displacement [m]
    step : between samples [m]
    center : (16,) of the bands [cycles/m]

    Returns
    -------
    (..., 16) ndarray
        One-sided power spectral density in dB re 1 µm²·mm.

    Raises
    ------
    InputError
        Where the stroke is shorter than 10 periods of the lowest band, or too coarsely
        sampled for the highest.
    """
    signal = _checked(signal, step, center)
    size = min(signal.shape[-1], round(SEGMENT / (center[0] * step)))
    window = np.hanning(size + 1)[:-1]
    starts = range(0, signal.shape[-1] - size + 1, max(size // 2, 1))
    density = np.mean([_periodogram(signal[..., k : k + size], window) for k in starts], axis=0)
    return 10 * np.log10(np.maximum(_band_means(density * step * 1e15, size * step, center), 1e-30))


def _checked(signal: Floats, step: float, center: Floats) -> Floats:
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
    """Return the mean of a density (..., F) at multiples of 1/length over each band (..., 16)."""
    total = np.cumsum(density, axis=-1)
    ends = (np.arange(density.shape[-1]) + 0.5) / length
    edges = third_octaves(center)
    upto = np.apply_along_axis(lambda row: np.interp(edges, ends, row), -1, total) / length
    return np.asarray(np.diff(upto, axis=-1) / np.diff(edges))


def excess_kurtosis(signal: Floats, step: float, *, center: Floats = CENTERS) -> float:
    """Return ⟨u⁴⟩/⟨u²⟩² − 3 of displacement within the bands.

    The signal is band-passed by a Butterworth filter of order 4, forth and back, between the
    outer edges of the bands; two periods of the lowest band at
    either end are left out. Each stroke is brought to an rms of
    one, so that a level that differs from stroke to stroke is no kurtosis.

    Parameters
    ----------
    signal : (S,) or (R, S) displacement without lines and rare features [m]
    step : between samples [m]
    center : (16,) of the bands [cycles/m]

    Raises
    ------
    InputError
        As `band_spectrum`.
    """
    signal = _checked(signal, step, center)
    edges = third_octaves(center)
    top = min(edges[-1], 0.499 / step)
    band = butter(4, (edges[0], top), "bandpass", fs=1 / step, output="sos")
    inner = _inner(sosfiltfilt(band, detrend(signal, axis=-1), axis=-1), step, center)
    unit = inner / np.sqrt(np.mean(inner**2, axis=-1, keepdims=True))
    return float(np.mean(unit**4) - 3)


def _inner(signal: Floats, step: float, center: Floats) -> Floats:
    spoiled = round(END / (center[0] * step))
    return signal[..., spoiled : signal.shape[-1] - spoiled]


def am_depth(signal: Floats, step: float, corner: float, *, center: Floats = CENTERS) -> float:
    """Return the standard deviation over the mean of the envelope's part below a corner.

    The envelope is the magnitude of the analytic signal of displacement whose third octaves are
    first brought to equal power, so that every band tells alike how strong the surface is here.
    A normal process has an envelope of its own, which varies without any modulation; what of
    that falls below the corner is known in closed form and subtracted.

    Parameters
    ----------
    signal : (S,) or (R, S) displacement without lines and rare features [m]
    step : between samples [m]
    corner : the descriptor's ``am_corner_per_mm`` [cycles/m]
    center : (16,) of the bands [cycles/m]

    Raises
    ------
    InputError
        As `band_spectrum`.

    Notes
    -----
    With e the envelope that modulates and ρ that of the process, independent, r = e ρ. Below the
    corner var(r)/⟨r⟩² = d² + (1 + d²) d₀², d₀² the share of ρ alone: the transform of
    ₂F₁(−½, −½; 1; k²) − 1, the covariance of a normal process's envelope over its mean squared
    (Rice 1944; Middleton 1960), k the magnitude of its analytic autocorrelation.
    """
    frequency, found, own = _modulation(signal, step, center)
    low = (frequency > 0) & (frequency <= corner)
    measured, chance = found[low].sum(), own[low].sum()
    return float(np.sqrt(max((measured - chance) / (1 + chance), 0.0)))


def am_corner(signal: Floats, step: float, *, center: Floats = CENTERS) -> float:
    """Return the spatial frequency up to which the envelope is modulated [cycles/m].

    A modulation that is even up to its corner is taken: with C(f) its power up to f, in excess of
    a normal process's own, and V(f) the sum of the latter's squares, as which its chance grows,
    the corner is where C²/V is largest. NaN where nothing is modulated. Read from one stroke of
    a few of the corner's periods, or a modulation below 0.1, it is a guess.

    Parameters
    ----------
    signal : (S,) or (R, S) displacement without lines and rare features [m]
    step : between samples [m]
    center : (16,) of the bands [cycles/m]

    Raises
    ------
    InputError
        As `band_spectrum`.
    """
    frequency, found, own = _modulation(signal, step, center)
    sought = (frequency > 0) & (frequency <= HIGHEST_CORNER)
    excess = np.maximum(np.cumsum((found - own)[sought]), 0)
    if not excess.any():
        return float("nan")
    return float(frequency[sought][np.argmax(excess**2 / np.cumsum(own[sought] ** 2))])


def _modulation(signal: Floats, step: float, center: Floats) -> tuple[Floats, Floats, Floats]:
    """Return frequencies [cycles/m] and the power there of an envelope over its mean squared.

    Measured, the mean over strokes, and of a normal process of the same spectrum.
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
    found = np.asarray(bins.mean(axis=0))
    alike = np.abs(_analytic(power, count)) ** 2
    own = np.fft.rfft(hyp2f1(-0.5, -0.5, 1, alike / alike[0]) - 1).real * 2 / count
    at = np.asarray(np.fft.rfftfreq(inner, step))
    return at, found, np.interp(at, frequency, np.maximum(own, 0)) * count / inner


def _analytic(spectrum: NDArray[np.inexact], count: int) -> NDArray[np.complex128]:
    """Return the signal (..., count) of the positive frequencies of a spectrum (..., F)."""
    wide = np.zeros((*spectrum.shape[:-1], count), np.complex128)
    wide[..., : spectrum.shape[-1]] = spectrum
    return np.asarray(np.fft.ifft(wide, axis=-1))


def _equalization(frequency: Floats, levels: Floats, center: Floats) -> tuple[Floats, Floats]:
    """Return the gain that brings third octaves to equal power, and the spectrum it leaves.

    Levels run straight between centers over the logarithm of frequency, and are held beyond them.
    """
    edges = third_octaves(center)
    inside = (frequency >= edges[0]) & (frequency <= edges[-1])
    safe = np.where(inside, frequency, 1.0)
    octave = 10 ** (np.interp(np.log(safe), np.log(center), levels) / 10) * safe
    strongest = np.where(inside, octave, 0.0).max()
    gain = np.where(inside, 1 / np.sqrt(np.maximum(octave, QUIET * strongest)), 0.0)
    return gain, gain**2 * octave / safe
