"""Band-limited interpolation of samples that come at one rate and are read at another."""

import functools
import math

import numpy as np

from tactile.arrays import Floats, Singles

PHASES = 1 << 20
"""Number of phases between two samples at which equidistant reading may begin; the error is that of
a time shift of 5e-7 samples, −110 dB at the highest frequency."""
REMEMBERED = 64
"""Number of phases whose weights are remembered: at 8 kHz, reading blocks of 16 samples repeats
after 1 block from 1, 2, 4 or 48 kHz, after 5 from 44.1 kHz and after 20 from 11.025 kHz."""


@functools.cache
def _table(zeros: int, shape: float) -> tuple[Floats, Floats]:
    """Return distances [zeros] and the windowed sinc at them; linear between them, to 4e-6."""
    apart = np.linspace(0, zeros, 512 * zeros + 1)
    window = np.i0(shape * np.sqrt(1 - (apart / zeros) ** 2)) / np.i0(shape)
    return apart, np.sinc(apart) * window


class SincInterpolation:
    """Weights of samples for reading them at times between them, or at a lower rate.

    The interpolation is y(t) = Σ x[k] c sinc(c (t − k)) w(c (t − k)), where c is the lower of both
    rates over the rate of the samples, and w Kaiser's window over some zeros of the sinc on either
    side. (soxr, a library that interpolates better, holds 12 to 140 ms back when it streams.)

    Parameters
    ----------
    sample_rate : float
        Rate of the samples [Hz].
    read_rate : float
        Rate at which they are read [Hz].
    zeros : int
        Length of the window on either side, in zeros of the sinc.
    shape : float
        Shape β of Kaiser's window.

    Attributes
    ----------
    reach : int
        Number of samples on either side that a value depends on.
    """

    def __init__(self, sample_rate: float, read_rate: float, *, zeros: int, shape: float) -> None:
        self._cut = min(1.0, read_rate / sample_rate)
        self._table = _table(zeros, shape)
        self.reach = math.ceil(zeros / self._cut)
        self._near = np.arange(1 - self.reach, self.reach + 1)
        self._remembered: dict[tuple[int, float, int], tuple[int, Singles]] = {}

    def weights(self, time: Floats) -> tuple[int, Singles]:
        """Return the weights of the samples around some times.

        Parameters
        ----------
        time : (S,) array of float
            Ascending times [samples].

        Returns
        -------
        first : int
            Number of the first sample that has a weight.
        weights : (S, R) array of float32
            Weights of this sample and those after it, for each time.
        """
        samples = np.floor(time).astype(np.intp)[:, None] + self._near
        first = int(samples[0, 0])
        weights = np.zeros((len(time), int(samples[-1, -1]) + 1 - first), np.float32)
        apart = np.abs(time[:, None] - samples) * self._cut
        values = self._cut * np.interp(apart, *self._table)
        weights[np.arange(len(time))[:, None], samples - first] = values
        return first, weights

    def remembers(self, at: float, step: float, count: int) -> bool:
        """Tell whether the weights around equidistant times are remembered.

        Parameters
        ----------
        at : float
            First time [samples].
        step : float
            Distance of the times [samples].
        count : int
            Number of times, S.

        Returns
        -------
        bool
            Whether `equidistant_weights` need not compute them.
        """
        return (round(at * PHASES) % PHASES, step, count) in self._remembered

    def equidistant_weights(self, at: float, step: float, count: int) -> tuple[int, Singles]:
        """Return the weights of the samples around equidistant times.

        They are the same for each block that begins at the same phase, which is remembered.

        Parameters
        ----------
        at : float
            First time [samples].
        step : float
            Distance of the times [samples].
        count : int
            Number of times, S.

        Returns
        -------
        first : int
            Number of the first sample that has a weight.
        weights : (S, R) array of float32
            Weights of this sample and those after it, for each time.
        """
        whole, phase = divmod(round(at * PHASES), PHASES)
        key = phase, step, count
        if key not in self._remembered:
            if len(self._remembered) >= REMEMBERED:
                del self._remembered[next(iter(self._remembered))]
            times = np.asarray(phase / PHASES + step * np.arange(count), np.float64)
            self._remembered[key] = self.weights(times)
        first, weights = self._remembered[key]
        return whole + first, weights
