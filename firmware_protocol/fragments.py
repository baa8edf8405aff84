"""Fragments of packets for links with short frames, CAN and SMBus (section 3.2 of SPEC.md).

The first byte of each fragment holds start, end, toggle and transfer id; in the first fragment the
length of the packet follows. A fragment that is lost, repeated, reordered or late costs its packet
and is counted.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from struct import Struct

from firmware_protocol.messages import FRAGMENT_TIMEOUT_MS, PACKET_MAX
from firmware_protocol.packet import SMALLEST, LinkCounters, Packet, decode_packet

START, END, TOGGLE, TRANSFER = 0x80, 0x40, 0x20, 0x1F
"""Bits of the first byte: start of transfer, end of transfer, toggle, and mask of the transfer
id."""
LENGTH = Struct("<H")
"""Layout of the packet's length in the first fragment."""
TRANSFERS = 4
"""Largest number of transfers that are reassembled at a time."""


class Cutter:
    """Divider of packets into fragments, with a transfer id that counts per identifier.

    Parameters
    ----------
    size : int
        Size of a frame [bytes].
    """

    def __init__(self, size: int) -> None:
        self._room = size - 1
        self._transfers: Counter[int] = Counter()

    def fragments(self, identifier: int, packet: bytes) -> Iterator[bytes]:
        """Divide a packet into fragments.

        Parameters
        ----------
        identifier : int
            Identifier of the frames, which selects the counter of the transfer id.
        packet : bytes
            Encoded packet.

        Yields
        ------
        bytes
            One fragment after the other.
        """
        transfer = self._transfers[identifier] & TRANSFER
        self._transfers[identifier] += 1
        body = LENGTH.pack(len(packet)) + packet
        for start in range(0, len(body), self._room):
            head = transfer | (TOGGLE if start // self._room % 2 else 0)
            head |= 0 if start else START
            head |= END if start + self._room >= len(body) else 0
            yield bytes([head]) + body[start : start + self._room]


@dataclass
class _Transfer:
    """Transfer that is being reassembled."""

    begun: int
    length: int
    toggle: int = 0
    data: bytearray = field(default_factory=bytearray)


class Reassembler:
    """Reassembler of fragments into packets.

    Parameters
    ----------
    limit : int
        Largest packet [bytes].
    counters : LinkCounters
        Counters to count in.
    tick_hz : int
        Frequency of the clock that gives the time of reception [Hz].
    """

    def __init__(self, limit: int, counters: LinkCounters, tick_hz: int = 1_000_000) -> None:
        self._limit, self._counters = min(limit, PACKET_MAX), counters
        self._timeout = -(FRAGMENT_TIMEOUT_MS * tick_hz // -1000)
        self._transfers: dict[tuple[int, int], _Transfer] = {}

    def feed(
        self, identifier: int, fragment: bytes, now: int, *, padded: bool = False
    ) -> Packet | None:
        """Add a received fragment.

        Parameters
        ----------
        identifier : int
            Identifier of the frame.
        fragment : bytes
            Content of the frame.
        now : int
            Time of reception [ticks].
        padded : bool
            Whether the last fragment may have padding after the packet.

        Returns
        -------
        Packet or None
            The packet that the fragment completes, if any.
        """
        self._drop_expired(now)
        if not fragment:
            self._counters.fragments_dropped += 1
            return None
        head, key = fragment[0], (identifier, fragment[0] & TRANSFER)
        data = fragment[1:]
        if head & START:
            if not self._begin(key, head, data, now):
                return None
            data = data[LENGTH.size :]
        transfer = self._transfers.get(key)
        if transfer is None:
            self._counters.fragments_dropped += 1
            return None
        if not head & START:
            transfer.toggle ^= TOGGLE
            if head & TOGGLE != transfer.toggle:
                self._drop(key)
                return None
        transfer.data += data
        missing, ends = transfer.length - len(transfer.data), bool(head & END)
        if (ends and missing > 0) or (missing < 0 and not (ends and padded)):
            self._drop(key)
        elif ends:
            del self._transfers[key]
            packet = bytes(transfer.data[: transfer.length])
            return decode_packet(packet, self._counters, self._limit)
        return None

    def _begin(self, key: tuple[int, int], head: int, data: bytes, now: int) -> bool:
        """Begin a transfer if a start fragment is valid, and return whether it is."""
        if head & TOGGLE or len(data) < LENGTH.size:
            self._counters.fragments_dropped += 1
            return False
        if key in self._transfers:
            self._drop(key)
        length = LENGTH.unpack_from(data)[0]
        if not SMALLEST <= length <= self._limit:
            self._counters.fragments_dropped += 1
            return False
        if len(self._transfers) == TRANSFERS:
            self._drop(next(iter(self._transfers)))
        self._transfers[key] = _Transfer(now, length)
        return True

    def _drop_expired(self, now: int) -> None:
        """Drop the transfers that have timed out."""
        for key in [k for k, t in self._transfers.items() if now - t.begun >= self._timeout]:
            self._drop(key)

    def _drop(self, key: tuple[int, int]) -> None:
        """Drop a transfer and count it."""
        del self._transfers[key]
        self._counters.fragments_dropped += 1
