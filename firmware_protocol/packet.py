"""Packets: type, flags, node, seq, payload and CRC-32 (section 2 of SPEC.md).

Nothing here raises on wire data: what is no packet is counted and dropped.
"""

from dataclasses import dataclass
from struct import Struct
from zlib import crc32

from firmware_protocol.messages import MAJOR, PACKET_MAX, Flag, Message

HEADER = Struct("<4B")
CRC = Struct("<I")
SMALLEST = HEADER.size + CRC.size
VERSION_FLAGS = MAJOR << 6
TURN = 1 << 32
"""At which a u32 wraps: positions and counters."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet without its CRC-32.

    Attributes
    ----------
    type : of the message
    payload : bytes
    flags : major version and bits of `Flag`
    node : the amplifier's address, 0 for all
    seq : the sender's count, modulo 256
    """

    type: int
    payload: bytes
    flags: int = VERSION_FLAGS
    node: int = 0
    seq: int = 0

    @classmethod
    def of(cls, message: Message, *, node: int = 0, seq: int = 0, ask: bool = False) -> "Packet":
        """Return the packet of a message; ``ask`` for an answer to it."""
        flags = VERSION_FLAGS | (Flag.ACK_REQUEST if ask else 0)
        return cls(message.TYPE, message.pack(), flags, node, seq & 0xFF)


@dataclass
class LinkCounters:
    """What a receiver counts before it looks at a packet's meaning (section 12)."""

    packets: int = 0
    crc_errors: int = 0
    malformed: int = 0
    oversized: int = 0
    fragments_dropped: int = 0
    unknown_type: int = 0


def encode_packet(packet: Packet) -> bytes:
    """Return a packet's bytes, CRC-32 included."""
    head = HEADER.pack(packet.type, packet.flags, packet.node, packet.seq) + packet.payload
    return head + CRC.pack(crc32(head))


def decode_packet(
    data: bytes, counters: LinkCounters | None = None, limit: int = PACKET_MAX
) -> Packet | None:
    """Return the packet that bytes are, or None where they are none, counted."""
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
