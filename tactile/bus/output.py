"""Record of what an amplifier in memory has put out."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats


class OutputRecord:
    """Drive voltages that were put out, and codes on the marker lines, the latest ones.

    Parameters
    ----------
    channels : int
        Number of channels, C.
    kept : float
        Number of samples that are kept at least, as far as there are so many; infinite for all.

    Attributes
    ----------
    total : int
        Number of samples so far, whether kept or not.
    """

    def __init__(self, channels: int, kept: float) -> None:
        self._pieces: deque[Floats] = deque([np.zeros((0, channels))])
        self._lines: deque[NDArray[np.uint8]] = deque([np.zeros(0, np.uint8)])
        self._limit = kept
        self._count = self.total = 0

    def add(self, volts: Floats, lines: NDArray[np.uint8] | None = None) -> None:
        """Keep samples, and discard the oldest ones beyond the limit.

        Parameters
        ----------
        volts : (S, C) array of float
            Samples that were put out [V].
        lines : (S,) array of int, optional
            Codes on the marker lines; by default 0.
        """
        self._pieces.append(volts)
        self._lines.append(np.zeros(len(volts), np.uint8) if lines is None else lines)
        self.total += len(volts)
        self._count += len(volts)
        while self._count - len(self._pieces[0]) >= self._limit:
            self._count -= len(self._pieces.popleft())
            self._lines.popleft()

    @property
    def volts(self) -> Floats:
        """Kept samples, array (S, C) [V]."""
        return np.concatenate(list(self._pieces))

    @property
    def lines(self) -> NDArray[np.uint8]:
        """Codes on the marker lines during the kept samples, array (S,)."""
        return np.concatenate(list(self._lines))
