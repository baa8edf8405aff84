"""Ring of samples of all contactors in memory that two processes share.

The writer never waits. Readers take the newer half only, as the rest may be overwritten meanwhile.
"""

import mmap
import struct

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats, Singles

LENGTH = 1 << 14
"""Length of a ring: 2 s at 8 kHz, 0.3 s at 48 kHz [samples]."""
NUMBER = struct.Struct("<Q")
"""Format of a count in shared memory."""


class SampleRing:
    """Newest samples of the shear or the drive of all contactors.

    Parameters
    ----------
    memory : mmap.mmap
        Shared memory.
    offset : int
        Offset of the number of samples in the memory [bytes].
    rows : (LENGTH, N) array of float32
        Samples, in the same memory [m or V].
    """

    def __init__(self, memory: mmap.mmap, offset: int, rows: Singles) -> None:
        self._memory, self._offset, self._rows = memory, offset, rows

    @property
    def count(self) -> int:
        """Number of samples that were added."""
        return int(NUMBER.unpack_from(self._memory, self._offset)[0])

    def add(self, samples: Floats, first: int | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        samples : (S, N) array of float
            Samples [m or V]; of more than `LENGTH` only the last ones are kept.
        first : int, optional
            Number of the first sample, by default that after the last one. A ring that is written
            together with another one takes its numbers, as a kill between both lets them differ.
        """
        count = self.count if first is None else first
        newest = samples[-LENGTH:]
        begin = (count + len(samples) - len(newest)) % LENGTH
        before_end = newest[: LENGTH - begin]
        self._rows[begin : begin + len(before_end)] = before_end
        self._rows[: len(newest) - len(before_end)] = newest[len(before_end) :]
        NUMBER.pack_into(self._memory, self._offset, count + len(samples))

    def since(self, contactor: int, first: int) -> tuple[int, NDArray[np.float32]]:
        """Return the samples of a contactor since one of them.

        Parameters
        ----------
        contactor : int
            Index of the contactor.
        first : int
            Number of the first sample.

        Returns
        -------
        first : int
            Number of the first sample that is returned, later if there are too many, and earlier if
            the ring began anew.
        samples : (S,) array of float32
            Samples [m or V].
        """
        count = self.count
        first = max(min(first, count), count - LENGTH // 2)
        return first, self._rows[np.arange(first, count) % LENGTH, contactor]

    def between(self, first: int, end: int) -> NDArray[np.float32]:
        """Return samples of all contactors, of which the newest half may be read.

        Parameters
        ----------
        first, end : int
            Number of the first sample, and of that after the last.

        Returns
        -------
        (S, N) array of float32
            Copy of the samples [m or V].
        """
        return self._rows[np.arange(first, end) % LENGTH]

    def close(self) -> None:
        """Release the memory."""
        self._rows = np.zeros((0, 0), np.float32)
