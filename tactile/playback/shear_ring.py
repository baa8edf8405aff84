"""Ring of the shear of all contactors in memory that two processes share.

The writer never waits. Readers take the newer half only, as the rest may be overwritten meanwhile.
"""

import mmap
import struct

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats, Singles

LENGTH = 4096
"""Length of a ring: half a second at 8 kHz [samples]."""
NUMBER = struct.Struct("<Q")
"""Format of a count in shared memory."""


class ShearRing:
    """Newest samples of the shear of all contactors.

    Parameters
    ----------
    memory : mmap.mmap
        Shared memory.
    offset : int
        Offset of the number of samples in the memory [bytes].
    rows : (LENGTH, N) array of float32
        Samples, in the same memory [m].
    """

    def __init__(self, memory: mmap.mmap, offset: int, rows: Singles) -> None:
        self._memory, self._offset, self._rows = memory, offset, rows

    @property
    def count(self) -> int:
        """Number of samples that were added."""
        return int(NUMBER.unpack_from(self._memory, self._offset)[0])

    def add(self, shear: Floats) -> None:
        """Add samples.

        Parameters
        ----------
        shear : (S, N) array of float
            Shear [m]; of more than `LENGTH` samples only the last ones are kept.
        """
        count = self.count
        newest = shear[-LENGTH:]
        begin = (count + len(shear) - len(newest)) % LENGTH
        before_end = newest[: LENGTH - begin]
        self._rows[begin : begin + len(before_end)] = before_end
        self._rows[: len(newest) - len(before_end)] = newest[len(before_end) :]
        NUMBER.pack_into(self._memory, self._offset, count + len(shear))

    def since(self, contactor: int, first: int) -> tuple[int, NDArray[np.float32]]:
        """Return the shear of a contactor since a sample.

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
        shear : (S,) array of float32
            Shear [m].
        """
        count = self.count
        first = max(min(first, count), count - LENGTH // 2)
        return first, self._rows[np.arange(first, count) % LENGTH, contactor]

    def close(self) -> None:
        """Release the memory."""
        self._rows = np.zeros((0, 0), np.float32)
