"""Packets on a serial line: COBS and a 0x00 after each (section 3.1 of SPEC.md)."""

from cobs import cobs

from firmware_protocol.messages import PACKET_MAX
from firmware_protocol.packet import LinkCounters, Packet, decode_packet

DELIMITER = b"\0"
COBS_RUN = 254


def encode_frame(packet: bytes) -> bytes:
    """Return the bytes on the line of a packet's bytes."""
    return bytes(cobs.encode(packet)) + DELIMITER


def coded_limit(limit: int) -> int:
    """Return the most COBS bytes that a packet of ``limit`` bytes takes."""
    return limit + limit // COBS_RUN + 1


class SerialDecoder:
    """Finds the packets in a stream of bytes, however it is cut.

    Parameters
    ----------
    limit : largest packet [bytes]; memory never exceeds it
    counters : to count in
    """

    def __init__(self, limit: int = PACKET_MAX, counters: LinkCounters | None = None) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self._limit, self._longest = limit, coded_limit(limit)
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that end in further bytes."""
        *frames, rest = (self._rest + data).split(DELIMITER)
        packets = [packet for frame in frames if (packet := self._packet(frame)) is not None]
        if self._skipping or len(rest) > self._longest:
            self.counters.oversized += not self._skipping
            self._skipping, rest = True, b""
        self._rest = rest
        return packets

    def _packet(self, frame: bytes) -> Packet | None:
        if self._skipping:
            self._skipping = False
        elif len(frame) > self._longest:
            self.counters.oversized += 1
        elif frame:
            try:
                return decode_packet(cobs.decode(frame), self.counters, self._limit)
            except cobs.DecodeError:
                self.counters.malformed += 1
        return None
