"""Ring of records in shared memory, by which playback tells a recorder what it rendered from.

Playback writes and never waits: a record that does not fit is left out, and their number is the
next record once there is room again. Another process reads, as often as it likes.
"""

import zlib
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from tactile.bus.base import DriveBlock, DriveFrame
from tactile.playback.mixer import BlockInput
from tactile.playback.sample_ring import NUMBER
from tactile.playback.shared_memory import SharedFile

RECORDS = 1 << 15
"""Length of the ring [records]: 40 s of 500 blocks and 250 contacts a second."""
DUE_PLACES = 7
"""Decimal places of the time at which a block is due [s]: 0.1 µs. A double as an integer of these
steps and back is the same up to 2⁵¹ steps, 7 years after the host was started; with steps of 1 ns
it is for 48 days."""
RECORD = np.dtype(
    [("kind", "u1"), ("flag", "u1"), ("empty", "u2"), ("digest", "u4"), ("number", "i8"),
     ("values", "f8", 7)]
)  # fmt: skip
"""Form of a record. The number is that of a block, of the client of a contact, of an order, or of
lost records."""
AT_WRITTEN, AT_READ, AT_LOST = 0, 8, 16
"""Offsets of the numbers of records that were written, read and left out [bytes]."""
AT_RECORDS = 64
"""Offset of the ring [bytes]."""
SIZE = AT_RECORDS + RECORDS * RECORD.itemsize
"""Size of the memory [bytes]."""
_NOTHING = (0.0,) * 7
"""Values of a record that has none."""


class Kind(IntEnum):
    """Kind of a record."""

    BLOCK = 1
    CONTACT = 2
    ORDER = 3
    SILENCE = 4
    LOST = 5


def next_digest(digest: int, drive: DriveBlock | DriveFrame) -> int:
    """Return the digest of all blocks up to one, which almost any change of them changes.

    Parameters
    ----------
    digest : int
        Digest of the blocks before; 0 if there are none.
    drive : DriveBlock or DriveFrame
        Next block.

    Returns
    -------
    int
        CRC-32 of the bits of all drive values so far.
    """
    return zlib.crc32(np.ascontiguousarray(drive.volts).data, digest)


class SessionRing(SharedFile):
    """Ring of records, mapped into the process; one process writes and one reads.

    Parameters
    ----------
    handle : str
        Handle of the memory, from the process that created it.
    """

    def __init__(self, handle: str) -> None:
        super().__init__(handle, SIZE)
        self._rows = np.frombuffer(self._map, RECORD, RECORDS, AT_RECORDS)
        self._lost_before = self._digest = 0

    @classmethod
    def create(cls) -> "SessionRing":
        """Create an empty ring.

        Returns
        -------
        SessionRing
            New ring.
        """
        return cls(cls.new_file(SIZE))

    def close(self) -> None:
        """Release the memory, as `SharedFile.close` does."""
        self._rows = np.zeros(0, RECORD)
        super().close()

    def _count(self, offset: int) -> int:
        return int(NUMBER.unpack_from(self._map, offset)[0])

    @property
    def written(self) -> int:
        """Number of records that were written."""
        return self._count(AT_WRITTEN)

    @property
    def lost(self) -> int:
        """Number of records that were left out because the ring was full."""
        return self._count(AT_LOST)

    # Playback

    def add_block(self, block: BlockInput, drive: DriveBlock | DriveFrame) -> None:
        """Add a block with its contacts.

        Parameters
        ----------
        block : BlockInput
            What the block was rendered from.
        drive : DriveBlock or DriveFrame
            What was rendered.
        """
        self._digest = next_digest(self._digest, drive)
        rows: list[tuple[object, ...]] = []
        for client, (time, arrival, x, y, force, velocity) in block.contacts:
            known = velocity is not None
            values = time, arrival, x, y, force, *(velocity or (0.0, 0.0))
            rows.append((Kind.CONTACT, known, 0, 0, client, values))
        values = float(block.position), block.now, block.due, 0.0, 0.0, 0.0, 0.0
        self._add(*rows, (Kind.BLOCK, block.skipped, 0, self._digest, block.number, values))

    def add_order(self, number: int) -> None:
        """Add the execution of an order.

        Parameters
        ----------
        number : int
            Number of the order.
        """
        self._add((Kind.ORDER, 0, 0, 0, number, _NOTHING))

    def add_silence(self) -> None:
        """Add that all waves were dropped before playing began."""
        self._add((Kind.SILENCE, 0, 0, 0, 0, _NOTHING))

    def _add(self, *rows: tuple[object, ...]) -> None:
        """Add records if there is room for all, after one about those that were lost."""
        written = self._count(AT_WRITTEN)
        lost = self.lost
        missing = lost - self._lost_before
        if written + len(rows) + (missing > 0) - self._count(AT_READ) > RECORDS:
            NUMBER.pack_into(self._map, AT_LOST, lost + len(rows))
            return
        if missing:
            self._rows[written % RECORDS] = (Kind.LOST, 0, 0, 0, missing, _NOTHING)
            self._lost_before = lost
            written += 1
        for k, row in enumerate(rows, written):
            self._rows[k % RECORDS] = row
        NUMBER.pack_into(self._map, AT_WRITTEN, written + len(rows))

    # Recorder

    def take(self) -> NDArray[np.void]:
        """Return the records that came since the last call.

        Returns
        -------
        (R,) array of `RECORD`
            Copy of the records, in their order.
        """
        read, written = self._count(AT_READ), self._count(AT_WRITTEN)
        rows = self._rows[np.arange(read, written) % RECORDS]
        NUMBER.pack_into(self._map, AT_READ, written)
        return rows
