"""Packets: type, flags, node, seq, payload and CRC-32 (section 2 of SPEC.md).

Nothing here raises an exception on data from the wire: what is not a packet is counted and dropped.
"""

from dataclasses import dataclass
from struct import Struct
from zlib import crc32

from firmware_protocol.messages import MAJOR, PACKET_MAX, Flag, Message

HEADER = Struct("<4B")
"""Layout of the header."""
CRC = Struct("<I")
"""Layout of the CRC-32."""
SMALLEST = HEADER.size + CRC.size
"""Length of a packet without payload [bytes]."""
VERSION_FLAGS = MAJOR << 6
"""Flags with the major version."""
TURN = 1 << 32
"""Value at which a u32 wraps, such as a position or a counter."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet without its CRC-32.

    Attributes
    ----------
    type : int
        Type of the message.
    payload : bytes
        Payload.
    flags : int
        Major version and bits of `Flag`.
    node : int
        Address of the amplifier, 0 for all.
    seq : int
        Sequence number of the sender, modulo 256.
    """

    type: int
    payload: bytes
    flags: int = VERSION_FLAGS
    node: int = 0
    seq: int = 0

    @classmethod
    def of(cls, message: Message, *, node: int = 0, seq: int = 0, ask: bool = False) -> "Packet":
        """Create the packet of a message.

        Parameters
        ----------
        message : Message
            Message to pack.
        node : int
            Address of the amplifier, 0 for all.
        seq : int
            Sequence number, of which the low byte is used.
        ask : bool
            Whether to request an answer.

        Returns
        -------
        Packet
            The packet.
        """
        flags = VERSION_FLAGS | (Flag.ACK_REQUEST if ask else 0)
        return cls(message.TYPE, message.pack(), flags, node, seq & 0xFF)


@dataclass
class LinkCounters:
    """Counters of a receiver before it examines the meaning of a packet (section 12)."""

    packets: int = 0
    crc_errors: int = 0
    malformed: int = 0
    oversized: int = 0
    fragments_dropped: int = 0
    unknown_type: int = 0


def encode_packet(packet: Packet) -> bytes:
    """Encode a packet with its CRC-32.

    Parameters
    ----------
    packet : Packet
        Packet to encode.

    Returns
    -------
    bytes
        Encoded packet.
    """
    head = HEADER.pack(packet.type, packet.flags, packet.node, packet.seq) + packet.payload
    return head + CRC.pack(crc32(head))


def decode_packet(
    data: bytes, counters: LinkCounters | None = None, limit: int = PACKET_MAX
) -> Packet | None:
    """Decode a packet and check its CRC-32.

    Parameters
    ----------
    data : bytes
        Encoded packet.
    counters : LinkCounters, optional
        Counters to count in.
    limit : int
        Largest packet [bytes].

    Returns
    -------
    Packet or None
        The packet; None if it is not valid, which is counted.
    """
    counters = LinkCounters() if counters is None else counters
    if len(data) < SMALLEST:
        counters.malformed += 1
    elif len(data) > limit:
        counters.oversized += 1
    elif crc32(memoryview(data)[:-4]) != CRC.unpack_from(data, len(data) - 4)[0]:
        counters.crc_errors += 1
    else:
        counters.packets += 1
        kind, flags, node, seq = HEADER.unpack_from(data)
        return Packet(kind, bytes(data[4:-4]), flags, node, seq)
    return None
