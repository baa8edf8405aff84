"""Packets on a serial line: COBS, with a 0x00 after each packet (section 3.1 of SPEC.md)."""

from cobs import cobs

from firmware_protocol.messages import PACKET_MAX
from firmware_protocol.packet import LinkCounters, Packet, decode_packet

DELIMITER = b"\0"
"""Byte that ends a frame."""
COBS_RUN = 254
"""Number of bytes for which COBS needs one byte of overhead [bytes]."""


def encode_frame(packet: bytes) -> bytes:
    """Encode a packet for the line.

    Parameters
    ----------
    packet : bytes
        Encoded packet.

    Returns
    -------
    bytes
        COBS frame with its delimiter.
    """
    return bytes(cobs.encode(packet)) + DELIMITER


def coded_limit(limit: int) -> int:
    """Compute the largest length of a COBS frame.

    Parameters
    ----------
    limit : int
        Largest packet [bytes].

    Returns
    -------
    int
        Length without the delimiter [bytes].
    """
    return limit + limit // COBS_RUN + 1


class SerialDecoder:
    """Decoder of a byte stream into packets, however the stream is divided.

    Parameters
    ----------
    limit : int
        Largest packet [bytes]; it bounds the memory of the decoder.
    counters : LinkCounters, optional
        Counters to count in; own ones by default.
    """

    def __init__(self, limit: int = PACKET_MAX, counters: LinkCounters | None = None) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self._limit, self._longest = limit, coded_limit(limit)
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[Packet]:
        """Decode further bytes.

        Parameters
        ----------
        data : bytes
            Bytes from the line.

        Returns
        -------
        list of Packet
            The packets that end in these bytes.
        """
        *frames, rest = (self._rest + data).split(DELIMITER)
        packets = [packet for frame in frames if (packet := self._packet(frame)) is not None]
        if self._skipping or len(rest) > self._longest:
            self.counters.oversized += not self._skipping
            self._skipping, rest = True, b""
        self._rest = rest
        return packets

    def _packet(self, frame: bytes) -> Packet | None:
        """Return the packet of a frame, or None if it is not valid, empty or skipped."""
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
