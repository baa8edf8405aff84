"""Packets on I²C: raw transfers and SMBus fragments (section 3.3 of SPEC.md).

The amplifier is the target. Its packets wait in a queue until the host reads them.
"""

from collections import deque

from firmware_protocol.fragments import LENGTH, Cutter, Reassembler
from firmware_protocol.packet import LinkCounters, Packet, decode_packet

DEFAULT_LIMIT = 255
"""Default of the largest packet [bytes]."""
WRITE_COMMAND, READ_COMMAND = 0x54, 0x55
"""SMBus commands of block writes and block reads."""
SMBUS_BLOCK = 32
"""Largest SMBus block [bytes]."""
NOTHING = b"\0"
"""SMBus block that is read when nothing waits."""
WAITING = 16
"""Largest number of packets that wait for a reader; further ones are refused."""


class Target:
    """Amplifier's end of the bus, with the packets that wait until the host reads them.

    Parameters
    ----------
    counters : LinkCounters or None
        Counters to count in; own ones if None.

    Attributes
    ----------
    counters : LinkCounters
        Counters of received packets and of errors.
    """

    def __init__(self, counters: LinkCounters | None) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self._waiting: deque[bytes] = deque()

    def put(self, packet: bytes) -> bool:
        """Queue a packet for the host.

        Parameters
        ----------
        packet : bytes
            Encoded packet.

        Returns
        -------
        bool
            False if the queue is full.
        """
        if len(self._waiting) == WAITING:
            return False
        self._waiting.append(packet)
        return True


class I2cTarget(Target):
    """Amplifier's end of raw transfers.

    Parameters
    ----------
    limit : int
        Largest packet [bytes].
    counters : LinkCounters, optional
        Counters to count in; own ones by default.
    """

    def __init__(self, limit: int = DEFAULT_LIMIT, counters: LinkCounters | None = None) -> None:
        super().__init__(counters)
        self._limit = limit

    def write(self, data: bytes) -> list[Packet]:
        """Decode a write transfer.

        Parameters
        ----------
        data : bytes
            Data of the transfer.

        Returns
        -------
        list of Packet
            The packet of the transfer, if it is valid.
        """
        packet = decode_packet(data, self.counters, self._limit)
        return [] if packet is None else [packet]

    def read(self, size: int) -> bytes:
        """Answer a read transfer; a packet that is not read to its end stays in the queue.

        Parameters
        ----------
        size : int
            Number of bytes that the host reads.

        Returns
        -------
        bytes
            Length and bytes of the first packet, padded with zeros.
        """
        if not self._waiting:
            return bytes(size)
        data = LENGTH.pack(len(self._waiting[0])) + self._waiting[0]
        if size >= len(data):
            self._waiting.popleft()
        return data[:size].ljust(size, b"\0")


def decode_read(data: bytes, counters: LinkCounters | None = None) -> Packet | None:
    """Decode a read transfer on the host.

    Parameters
    ----------
    data : bytes
        Data of the transfer.
    counters : LinkCounters, optional
        Counters to count in.

    Returns
    -------
    Packet or None
        The packet; None if it is not valid or if nothing waited.
    """
    length = LENGTH.unpack_from(data)[0] if len(data) >= LENGTH.size else 0
    if not length:
        return None
    return decode_packet(data[LENGTH.size : LENGTH.size + length], counters)


class SmbusTarget(Target):
    """Amplifier's end of SMBus block writes and block reads.

    Parameters
    ----------
    limit : int
        Largest packet [bytes].
    counters : LinkCounters, optional
        Counters to count in; own ones by default.
    tick_hz : int
        Frequency of the clock that gives the time of reception [Hz].
    """

    def __init__(
        self,
        limit: int = DEFAULT_LIMIT,
        counters: LinkCounters | None = None,
        tick_hz: int = 1_000_000,
    ) -> None:
        super().__init__(counters)
        self._reassembler = Reassembler(limit, self.counters, tick_hz)
        self._cutter = Cutter(SMBUS_BLOCK)
        self._blocks: deque[bytes] = deque()
        """Fragments of the first packet that wait."""

    def write(self, block: bytes, now: int) -> list[Packet]:
        """Decode a block write.

        Parameters
        ----------
        block : bytes
            Data of the block.
        now : int
            Time of reception [ticks].

        Returns
        -------
        list of Packet
            The packet that the block completes, if any.
        """
        packet = self._reassembler.feed(WRITE_COMMAND, block, now)
        return [] if packet is None else [packet]

    def read(self) -> bytes:
        """Answer a block read.

        Returns
        -------
        bytes
            Next fragment, or `NOTHING` if nothing waits.
        """
        if not self._waiting:
            return NOTHING
        if not self._blocks:
            self._blocks += self._cutter.fragments(READ_COMMAND, self._waiting[0])
        if len(self._blocks) == 1:
            self._waiting.popleft()
        return self._blocks.popleft()
