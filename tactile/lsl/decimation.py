"""Decimation of samples that come in pieces, by a filter of linear phase."""

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from tactile.arrays import Floats, Singles
from tactile.lsl.continuity import JUMP

PASSBAND, STOPBAND = 0.4, 0.5
"""Upper edge of the passband, and lower edge of the stopband, as shares of the new rate."""
RIPPLE_DB, ATTENUATION_DB = 0.1, 80.0
"""Largest deviation in the passband, and least attenuation in the stopband [dB]."""
DESIGN_DB = 82.0
"""Attenuation for which the filter is designed, as Kaiser's formula is an approximation [dB]."""


class Decimator:
    """Decimator of a signal of several channels, with the times of its samples.

    A sample that is kept has the time of the input sample in the middle of the filter, so that the
    filter delays nothing. Kept are those whose number is a multiple of the factor. Where samples
    are missing, or the time jumps by `JUMP` or more, the filter begins anew: samples nearer than
    half of its length to such a gap are left out.

    Parameters
    ----------
    factor : int
        Rate of the input divided by that of the output, at least 2.
    sample_rate : float
        Rate of the input [Hz].
    channels : int
        Number of channels.

    Attributes
    ----------
    half_length : int
        Number of samples on either side of the middle of the filter.
    """

    def __init__(self, factor: int, sample_rate: float, channels: int) -> None:
        self._factor, self._period = factor, 1 / sample_rate
        width = 2 * (STOPBAND - PASSBAND) / factor  # of half of the rate, as scipy counts
        length, beta = signal.kaiserord(DESIGN_DB, width)
        self.half_length = length // 2
        cutoff = (STOPBAND + PASSBAND) / factor
        self._taps: Floats = signal.firwin(
            2 * self.half_length + 1, cutoff, window=("kaiser", beta)
        )
        self._times = np.zeros(0)
        self._values = np.zeros((0, channels))
        self._next = 0

    def push(self, first: int, times: Floats, values: Singles) -> tuple[Floats, Floats]:
        """Take samples that follow one another, and return those of the output that are known now.

        Parameters
        ----------
        first : int
            Number of the first sample.
        times : (S,) array
            Time of each sample [s].
        values : (S, C) array
            Samples of each channel.

        Returns
        -------
        times : (K,) array
            Times of the samples of the output [s].
        values : (K, C) array
            Samples of the output.
        """
        jumps = np.abs(np.diff(times) - self._period) >= JUMP
        edges = [0, *(np.flatnonzero(jumps) + 1).tolist(), len(times)]
        parts = [
            self._push_run(first + low, times[low:high], values[low:high])
            for low, high in pairwise(edges)
            if low < high
        ]
        kept_times = [self._times[:0], *(part[0] for part in parts)]
        return np.concatenate(kept_times), np.concatenate(
            [self._values[:0], *(part[1] for part in parts)]
        )

    def _push_run(self, first: int, times: Floats, values: Singles) -> tuple[Floats, Floats]:
        """Take samples without a gap among them."""
        if not self._continues(first, float(times[0])):
            self._times, self._values = self._times[:0], self._values[:0]
        self._times = np.concatenate((self._times, times))
        self._values = np.concatenate((self._values, values))
        self._next = first + len(times)
        start = self._next - len(self._times)
        middle = -(-(start + self.half_length) // self._factor) * self._factor
        count = (self._next - 1 - self.half_length - middle) // self._factor + 1
        if count <= 0:
            return self._times[:0], self._values[:0]
        offset = middle - self.half_length - start
        windows = sliding_window_view(self._values, len(self._taps), axis=0)[offset :: self._factor]
        kept = windows[:count] @ self._taps
        kept_times = self._times[offset + self.half_length :: self._factor][:count].copy()
        used = offset + count * self._factor
        self._times, self._values = self._times[used:], self._values[used:]
        return kept_times, kept

    def _continues(self, first: int, time: float) -> bool:
        """Return whether a sample follows those that were taken last."""
        if first != self._next or not len(self._times):
            return False
        return abs(time - float(self._times[-1]) - self._period) < JUMP
