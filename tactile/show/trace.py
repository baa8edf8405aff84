"""Last second of a signal as a band of Braille dots."""

import numpy as np

from tactile.arrays import Floats

SPAN, BINS = 1.0, 250
"""Duration of the trace [s], and number of bins that it is divided into."""
BRAILLE = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of the dots of a Braille character, 4 × 2 (Unicode block U+2800)."""


class TraceBins:
    """Lowest and highest value of one signal in each bin of the last second."""

    def __init__(self) -> None:
        self._bins = np.full((2, BINS), np.nan)
        self._last: int | None = None

    def add(self, values: Floats, end: float, step: float) -> None:
        """Add values of the signal.

        Parameters
        ----------
        values : (S,) array of float
            Values at constant intervals.
        end : float
            Time of the last value [s].
        step : float
            Interval between values [s].
        """
        time = end - step * np.arange(len(values) - 1, -1, -1)
        number = np.floor(time * (BINS / SPAN) + 1e-6).astype(np.int64)
        newest = int(number[-1])
        if self._last is None or not 0 <= newest - self._last < BINS:
            self._bins[:] = np.nan
            self._last = newest
        self._bins[:, np.arange(self._last + 1, newest + 1) % BINS] = np.nan
        self._last, recent = newest, number > newest - BINS
        np.fmin.at(self._bins[0], number[recent] % BINS, values[recent])
        np.fmax.at(self._bins[1], number[recent] % BINS, values[recent])

    def envelope(self, count: int) -> tuple[Floats, Floats]:
        """Return the lowest and highest values over the last second.

        Parameters
        ----------
        count : int
            Number of intervals to divide the second into.

        Returns
        -------
        low : (count,) array of float
            Lowest value in each interval, oldest first; NaN where there is none.
        high : (count,) array of float
            Highest value in each interval.
        """
        low, high = np.roll(self._bins, -1 - (self._last or 0) % BINS, axis=1)
        start = np.arange(count) * BINS // count
        return np.fmin.reduceat(low, start), np.fmax.reduceat(high, start)


def braille(low: Floats, high: Floats, lines: int) -> list[str]:
    """Draw the band between two signals.

    Parameters
    ----------
    low : (2W,) array of float
        Lower edge of the band, −1 … 1; NaN where it is unknown.
    high : (2W,) array of float
        Upper edge of the band.
    lines : int
        Height of the picture [lines].

    Returns
    -------
    list of str
        Lines of W characters, from the top.
    """
    top, bottom = ((1 - side) / 2 * (4 * lines - 1) for side in (high, low))
    before_top, before_bottom = (np.concatenate([side[:1], side[:-1]]) for side in (top, bottom))
    top, bottom = np.fmin(top, before_bottom), np.fmax(bottom, before_top)
    known = np.isfinite(low)
    row = np.arange(4 * lines)[:, None]
    dots = (row >= np.rint(top)) & (row <= np.rint(bottom)) & known
    cells = dots.reshape(lines, 4, -1, 2) * BRAILLE[:, None]
    codes = 0x2800 + cells.sum(axis=(1, 3))
    return ["".join(map(chr, line)) for line in codes.tolist()]
