"""Features of vibration that tell a rendered stroke from a recorded one, in six families.

No feature uses the bands of a fit: third octaves lie at exact powers of 10^0.1 Hz, octaves at their
edges. A stroke is brought to one sample rate and one frequency band, and cut into windows that
overlap by half. Envelopes are taken of the whole stroke, so that windows have no ends in them.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, resample_poly, sosfiltfilt

from tactile.arrays import Complex, Floats
from tactile.texture.recorded_slide import Recorded

ORDER = 6
"""Order of the band-pass filter, which runs forward and backward."""
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9, 0.99)
"""Shares of samples whose magnitudes describe the distribution of amplitudes."""
SLOW = 1 / 16
"""Duration over which envelopes are averaged before they are compared across bands [s]."""
LAGS = (0.025, 0.05, 0.1, 0.2)
"""Edges of the ranges of lags in which autocorrelation is searched for its peak [s]."""
MODULATIONS: Floats = np.exp2(np.arange(7.0))
"""Centers of the octaves of modulation [Hz]."""
Families = dict[str, Floats]
"""Features (W, F) of W windows, by the name of their family."""


@dataclass(frozen=True)
class Analysis:
    """Sample rate, band and windows of an analysis.

    Attributes
    ----------
    rate : float
        Sample rate [Hz].
    first, last : int
        Numbers of the lowest and the highest third octave. Number k is centered at 10^(k/10) Hz.
    window : float
        Duration of a window [s].
    """

    rate: float
    first: int
    last: int
    window: float

    @property
    def thirds(self) -> Floats:
        """Edges of the third octaves, (K + 1,) array [Hz]."""
        return np.asarray(10 ** (np.arange(self.first - 0.5, self.last + 1) / 10))

    @property
    def octaves(self) -> Floats:
        """Edges of the octaves, (O + 1,) array [Hz]."""
        return self.thirds[::3]

    @property
    def modulations(self) -> Floats:
        """Centers of the octaves of modulation that a window resolves, (M,) array [Hz]."""
        return MODULATIONS[self.window * MODULATIONS >= 1.5]

    def signal(self, recorded: Recorded) -> Floats:
        """Bring a stroke to the sample rate and the band.

        Parameters
        ----------
        recorded : Recorded
            Recorded or rendered stroke.

        Returns
        -------
        (S,) array of float
            Signal in the unit of the stroke.
        """
        band = butter(ORDER, self.thirds[[0, -1]], "bandpass", fs=self.rate, output="sos")
        return np.asarray(sosfiltfilt(band, resampled(recorded, self.rate)))

    def windows(self, signal: Floats) -> Floats:
        """Cut the last axis (..., S) into windows (W, ..., n) that overlap by half.

        Parameters
        ----------
        signal : (..., S) array of float
            Signals that are at least as long as a window.

        Returns
        -------
        (W, ..., n) array of float
            Windows.
        """
        size = round(self.window * self.rate)
        return np.moveaxis(sliding_window_view(signal, size, -1)[..., :: size // 2, :], -2, 0)

    def features(self, signal: Floats) -> Families:
        """Compute the features of all windows.

        Parameters
        ----------
        signal : (S,) array of float
            Stroke as `signal` returns it.

        Returns
        -------
        dict of (W, F) array
            Features by family: "level", "thirds" (without level), "fine" (spectrum within third
            octaves), "distribution" (of amplitudes), "modulation" and "across" (correlation between
            the envelopes of bands).
        """
        parts = self.windows(signal)
        octaves = np.stack([band_passed(signal, self.rate, *e) for e in self._octave_edges()])
        envelope = self.windows(np.abs(octaves))
        level = self.third_octaves(parts)
        return {
            "level": level.mean(axis=1, keepdims=True),
            "thirds": level - level.mean(axis=1, keepdims=True),
            "fine": np.hstack([self.roughness(parts), self._periodicity(parts)]),
            "distribution": np.hstack([amplitudes(parts), peakedness(self.windows(octaves.real))]),
            "modulation": self.modulation(envelope).reshape(len(parts), -1),
            "across": self._across(envelope),
        }

    def third_octaves(self, parts: Floats) -> Floats:
        """Compute the levels of windows in third octaves.

        Parameters
        ----------
        parts : (W, n) array of float
            Windows.

        Returns
        -------
        (W, K) array of float
            Mean spectral densities [dB].
        """
        power, band = self._periodogram(parts)
        means = [power[:, band == k].mean(axis=1) for k in range(len(self.thirds) - 1)]
        return np.asarray(10 * np.log10(np.stack(means, axis=1)))

    def roughness(self, parts: Floats) -> Floats:
        """Compute the standard deviations of periodograms within third octaves.

        Parameters
        ----------
        parts : (W, n) array of float
            Windows.

        Returns
        -------
        (W, K) array of float
            Standard deviations over frequency of the density in dB, whose trend over each third
            octave is taken off: 5.6 dB for Gaussian noise.
        """
        power, band = self._periodogram(parts)
        level = 10 * np.log10(power)
        rough = []
        for k in range(len(self.thirds) - 1):
            bins = level[:, band == k]
            rest = bins - bins.mean(axis=1, keepdims=True)
            slope = np.arange(bins.shape[1]) - (bins.shape[1] - 1) / 2
            rest -= np.outer(rest @ slope / (slope @ slope), slope)
            rough.append(np.sqrt((rest**2).sum(axis=1) / (bins.shape[1] - 2)))
        return np.stack(rough, axis=1)

    def modulation(self, envelope: Floats) -> Floats:
        """Compute the spectra of envelopes relative to their means, in octaves of modulation.

        Parameters
        ----------
        envelope : (W, O, n) array of float
            Envelopes.

        Returns
        -------
        (W, O, M) array of float
            Density of the modulation [dB re 1/Hz].
        """
        size = envelope.shape[-1]
        window = np.hanning(size)
        swing = envelope / envelope.mean(axis=-1, keepdims=True) - 1
        power = np.abs(np.fft.rfft(swing * window)) ** 2 * 2 / (self.rate * np.sum(window**2))
        frequency = np.fft.rfftfreq(size, 1 / self.rate)
        inside = [np.abs(np.log2(np.maximum(frequency, 1e-9) / c)) < 0.5 for c in self.modulations]
        means = [power[..., bins].mean(axis=-1) for bins in inside]
        return np.asarray(10 * np.log10(np.stack(means, axis=-1)))

    def _octave_edges(self) -> list[tuple[float, float]]:
        """Return the lower and the upper edge of each octave [Hz]."""
        return list(pairwise(self.octaves))

    def _periodogram(self, parts: Floats) -> tuple[Floats, NDArray[np.intp]]:
        """Return the periodograms (W, F) of windows and the number of each bin's band (F,)."""
        frequency = np.fft.rfftfreq(parts.shape[1], 1 / self.rate)
        window = np.hanning(parts.shape[1])
        power = np.abs(np.fft.rfft(parts * window)) ** 2 * 2 / (self.rate * np.sum(window**2))
        return power, np.digitize(frequency, self.thirds) - 1

    def _periodicity(self, parts: Floats) -> Floats:
        """Return the largest autocorrelation of windows (W, 3) in the ranges of `LAGS`."""
        size = parts.shape[1]
        plain = np.fft.irfft(np.abs(np.fft.rfft(parts, 2 * size)) ** 2)[:, :size]
        unbiased = plain / plain[:, :1] / (1 - np.arange(size) / size)
        edges = np.rint(np.array(LAGS) * self.rate).astype(int)
        peaks = [np.abs(unbiased[:, a:b]).max(axis=1) for a, b in pairwise(edges)]
        return np.stack(peaks, axis=1)

    def _across(self, envelope: Floats) -> Floats:
        """Return the correlations (W, P) of pairs of octaves' envelopes, all and slow ones."""
        slow = uniform_filter1d(envelope, round(SLOW * self.rate), axis=-1)
        correlations = []
        for kind in (envelope, slow):
            swing = kind - kind.mean(axis=-1, keepdims=True)
            swing /= np.sqrt(np.mean(swing**2, axis=-1, keepdims=True))
            for one, other in combinations(range(envelope.shape[1]), 2):
                correlations.append(np.mean(swing[:, one] * swing[:, other], axis=-1))
        return np.stack(correlations, axis=1)


FABRIC = Analysis(rate=2000.0, first=18, last=27, window=0.4)
"""Analysis of fabrics, 56–562 Hz: the accelerometer's recordings hold the finger's own motion below
and nothing that a finger feels above."""
SKIN = Analysis(rate=2200.0, first=14, last=29, window=1.0)
"""Analysis of the whole band that a texture has, 22–891 Hz."""
WHOLE = replace(SKIN, window=3.0)
"""The same for strokes of 3 s as a whole."""


def resampled(recorded: Recorded, rate: float) -> Floats:
    """Bring a stroke to another sample rate, without its mean.

    Parameters
    ----------
    recorded : Recorded
        Recorded or rendered stroke.
    rate : float
        Sample rate [Hz].

    Returns
    -------
    (S,) array of float
        Signal.
    """
    ratio = Fraction(rate / recorded.sample_rate).limit_denominator(1000)
    plain = recorded.signal - recorded.signal.mean()
    return np.asarray(resample_poly(plain, ratio.numerator, ratio.denominator))


def band_passed(signal: Floats, rate: float, low: float, high: float) -> Complex:
    """Compute the analytic signal of a frequency band.

    Parameters
    ----------
    signal : (S,) array of float
        Signal.
    rate : float
        Sample rate [Hz].
    low, high : float
        Edges of the band [Hz].

    Returns
    -------
    (S,) array of complex
        Analytic signal, whose magnitude is the envelope.
    """
    frequency = np.fft.fftfreq(len(signal), 1 / rate)
    return np.fft.ifft(np.fft.fft(signal) * 2 * ((frequency >= low) & (frequency < high)))


def amplitudes(parts: Floats) -> Floats:
    """Compute statistics of the amplitudes of windows.

    Parameters
    ----------
    parts : (W, n) array of float
        Windows.

    Returns
    -------
    (W, 2 + Q) array of float
        Excess kurtosis, skewness, and the quantiles of the magnitude relative to its rms.
    """
    unit = parts / np.sqrt(np.mean(parts**2, axis=1, keepdims=True))
    quantiles = np.quantile(np.abs(unit), QUANTILES, axis=1).T
    return np.column_stack([peakedness(parts), np.mean(unit**3, axis=1), quantiles])


def peakedness(signal: Floats) -> Floats:
    """Compute the excess kurtosis over the last axis of signals whose mean is 0.

    Parameters
    ----------
    signal : (..., S) array of float
        Signals.

    Returns
    -------
    (...) array of float
        Excess kurtosis, 0 for Gaussian noise.
    """
    power = signal**2
    return np.asarray(np.mean(power**2, axis=-1) / np.mean(power, axis=-1) ** 2 - 3)
