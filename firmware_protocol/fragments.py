"""Fragments of packets for links with short frames, CAN and SMBus (section 3.2 of SPEC.md).

The first byte of each says start, end, toggle and transfer id; the first fragment goes on with the
packet's length. Whatever is lost, repeated, reordered or late costs its packet and is counted.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from struct import Struct

from firmware_protocol.messages import PACKET_MAX
from firmware_protocol.packet import SMALLEST, LinkCounters, Packet, decode_packet

START, END, TOGGLE, TRANSFER = 0x80, 0x40, 0x20, 0x1F
LENGTH = Struct("<H")
TRANSFERS = 4
"""That are reassembled at a time."""


class Cutter:
    """Cuts packets into fragments, with a transfer id that counts per identifier.

    Parameters
    ----------
    size : of a frame [bytes]
    """

    def __init__(self, size: int) -> None:
        self._room = size - 1
        self._transfers: Counter[int] = Counter()

    def fragments(self, identifier: int, packet: bytes) -> Iterator[bytes]:
        """Yield the fragments of a packet's bytes."""
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
    begun: int
    length: int
    toggle: int = 0
    data: bytearray = field(default_factory=bytearray)


class Reassembler:
    """Puts fragments together again.

    Parameters
    ----------
    limit : largest packet [bytes]
    counters : to count in
    timeout : of a transfer, in the unit that ``now`` has
    """

    def __init__(self, limit: int, counters: LinkCounters, timeout: int) -> None:
        self._limit, self._counters = min(limit, PACKET_MAX), counters
        self._timeout = timeout
        self._transfers: dict[tuple[int, int], _Transfer] = {}

    def feed(
        self, identifier: int, fragment: bytes, now: int, *, padded: bool = False
    ) -> Packet | None:
        """Return the packet that a fragment completes, if any; one ``padded`` may hold more."""
        self._forget_old(now)
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
        """Begin a transfer, if that is what a start fragment does."""
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

    def _forget_old(self, now: int) -> None:
        for key in [k for k, t in self._transfers.items() if now - t.begun >= self._timeout]:
            self._drop(key)

    def _drop(self, key: tuple[int, int]) -> None:
        del self._transfers[key]
        self._counters.fragments_dropped += 1
