"""Ring of the blocks that playback has handed to its bus, in memory that two processes share.

It holds when each block is put out, and the finger that it was rendered for; its samples are in a
`SampleRing`. The writer never waits. Readers take the newer half only, as the rest may be
overwritten meanwhile.
"""

import mmap
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.playback.block_rendering import BLOCK
from tactile.playback.sample_ring import LENGTH, NUMBER

BLOCKS = LENGTH // BLOCK
"""Length of the ring, as much as the rings of samples hold [blocks]."""
ROW = np.dtype(
    [("first", "u8"), ("due", "f8"), ("uncertainty", "f8"), ("finger_due", "f8"),
     ("position", "f8", 2), ("velocity", "f8", 2), ("normal_force", "f8"), ("touching", "f8")]
)  # fmt: skip
"""Form of a row: the attributes of a `BlockRecord`."""


@dataclass(frozen=True)
class BlockRecord:
    """Block that was handed to the bus.

    Attributes
    ----------
    first : int
        Number of its first sample, of all that were handed over.
    due : float
        Time at which its first sample is put out, in the host's clock [s].
    uncertainty : float
        Half of the interval around ``due`` that holds the true time; NaN if it is not known [s].
    finger_due : float
        Time for which the finger is given [s].
    position : tuple of 2 floats
        Position of the finger [m].
    velocity : tuple of 2 floats
        Velocity of the finger [m/s].
    normal_force : float
        Normal force of the finger [N].
    touching : bool
        Whether the finger touches the surface.
    """

    first: int
    due: float
    uncertainty: float
    finger_due: float
    position: tuple[float, float]
    velocity: tuple[float, float]
    normal_force: float
    touching: bool


class BlockRing:
    """Newest blocks that were handed to the bus.

    Parameters
    ----------
    memory : mmap.mmap
        Shared memory.
    count_offset, rows_offset : int
        Offsets of the number of blocks and of the rows in the memory [bytes].
    """

    def __init__(self, memory: mmap.mmap, count_offset: int, rows_offset: int) -> None:
        self._memory, self._offset = memory, count_offset
        self._rows = np.frombuffer(memory, ROW, BLOCKS, rows_offset)

    @property
    def count(self) -> int:
        """Number of blocks that were added."""
        return int(NUMBER.unpack_from(self._memory, self._offset)[0])

    def add(self, block: BlockRecord) -> None:
        """Add a block, after its samples were added to their rings.

        Parameters
        ----------
        block : BlockRecord
            The block.
        """
        count = self.count
        self._rows[count % BLOCKS] = tuple(vars(block).values())
        NUMBER.pack_into(self._memory, self._offset, count + 1)

    def since(self, index: int, most: int) -> tuple[int, NDArray[np.void]]:
        """Return the blocks since one of them.

        Parameters
        ----------
        index : int
            Index of the first block, of all that were added.
        most : int
            Maximum number of blocks.

        Returns
        -------
        first : int
            Index of the first block that is returned, later if it is not there any more.
        blocks : (B,) array of `ROW`
            Copy of the blocks.
        """
        count = self.count
        first = max(min(index, count), count - BLOCKS // 2)
        return first, self._rows[np.arange(first, min(count, first + most)) % BLOCKS]

    def close(self) -> None:
        """Release the memory."""
        self._rows = np.zeros(0, ROW)
