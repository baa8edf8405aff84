"""Packets on I²C: raw transfers, and SMBus fragments (section 3.3 of SPEC.md).

The amplifier is the target. What it has to say waits in a queue until the host reads it.
"""

from collections import deque

from firmware_protocol.fragments import LENGTH, Cutter, Reassembler
from firmware_protocol.messages import FRAGMENT_TIMEOUT_MS, PACKET_MAX
from firmware_protocol.packet import LinkCounters, Packet, decode_packet

DEFAULT_LIMIT = 255
WRITE_COMMAND, READ_COMMAND = 0x54, 0x55
SMBUS_BLOCK = 32
NOTHING = b"\0"
WAITING = 16
"""Packets that wait for a reader at most; further ones are refused."""


class I2cTarget:
    """The amplifier's end of raw transfers.

    Parameters
    ----------
    limit : largest packet [bytes]
    counters : to count in
    """

    def __init__(self, limit: int = DEFAULT_LIMIT, counters: LinkCounters | None = None) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self._limit = limit
        self._waiting: deque[bytes] = deque()

    def write(self, data: bytes) -> list[Packet]:
        """Return the packet, if any, of a write transfer."""
        found = decode_packet(data, self.counters, self._limit)
        return [] if found is None else [found]

    def put(self, packet: bytes) -> bool:
        """Let a packet's bytes wait for the host; False where too many wait."""
        if len(self._waiting) == WAITING:
            return False
        self._waiting.append(packet)
        return True

    def read(self, size: int) -> bytes:
        """Return the bytes of a read transfer; a packet not read to its end stays."""
        if not self._waiting:
            return bytes(size)
        data = LENGTH.pack(len(self._waiting[0])) + self._waiting[0]
        if size >= len(data):
            self._waiting.popleft()
        return data[:size].ljust(size, b"\0")


def decode_read(data: bytes, counters: LinkCounters | None = None) -> Packet | None:
    """Return, on the host, the packet of a read transfer; None also where nothing waits."""
    length = LENGTH.unpack_from(data)[0] if len(data) >= LENGTH.size else 0
    if not length:
        return None
    return decode_packet(data[LENGTH.size : LENGTH.size + length], counters)


class SmbusTarget:
    """The amplifier's end of block writes and block reads.

    Parameters
    ----------
    limit, counters : as of `I2cTarget`
    tick_hz : of the time of reception
    """

    def __init__(
        self,
        limit: int = DEFAULT_LIMIT,
        counters: LinkCounters | None = None,
        tick_hz: int = 1_000_000,
    ) -> None:
        self.counters = LinkCounters() if counters is None else counters
        timeout = -(FRAGMENT_TIMEOUT_MS * tick_hz // -1000)
        self._reassembler = Reassembler(min(limit, PACKET_MAX), self.counters, timeout)
        self._cutter = Cutter(SMBUS_BLOCK)
        self._waiting: deque[list[bytes]] = deque()

    def write(self, block: bytes, now: int) -> list[Packet]:
        """Return the packet, if any, that a block write completes."""
        found = self._reassembler.feed(WRITE_COMMAND, block, now)
        return [] if found is None else [found]

    def put(self, packet: bytes) -> bool:
        """Let a packet's bytes wait for the host; False where too many wait."""
        if len(self._waiting) == WAITING:
            return False
        self._waiting.append(list(self._cutter.fragments(READ_COMMAND, packet)))
        return True

    def read(self) -> bytes:
        """Return the block of a block read."""
        if not self._waiting:
            return NOTHING
        block = self._waiting[0].pop(0)
        if not self._waiting[0]:
            self._waiting.popleft()
        return block
