"""Packets on CAN and CAN FD: identifiers, prompt frames and fragments (section 3.2 of SPEC.md)."""

from firmware_protocol.fragments import Cutter, Reassembler
from firmware_protocol.messages import (
    CAN_PREFIX,
    FRAGMENT_TIMEOUT_MS,
    MESSAGES,
    PACKET_MAX,
    CanClass,
    Estop,
    Flag,
    Heartbeat,
    Pulse,
    Start,
    Sync,
)
from firmware_protocol.packet import LinkCounters, Packet, encode_packet

CLASSIC, FD = 8, 64
FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""That a frame can have (ISO 11898-1)."""
BASE = 0x7FF
PROMPT = (Sync.TYPE, Start.TYPE, Heartbeat.TYPE)
PROMPT_START = 7
"""Bytes of START in a prompt frame: all but its time."""
HOST_FRAGMENTS = (CanClass.STREAM, CanClass.REQUEST)
AMPLIFIER_FRAGMENTS = (CanClass.RESPONSE, CanClass.BULK)

Frame = tuple[int, bytes]
"""Identifier and data."""


class CanEncoder:
    """Makes CAN frames of packets.

    Parameters
    ----------
    from_amplifier : direction
    fd : frames of up to 64 bytes
    extended : 29-bit identifiers
    """

    def __init__(self, *, from_amplifier: bool, fd: bool, extended: bool = False) -> None:
        self._direction = int(from_amplifier)
        self._prefix = CAN_PREFIX if extended else 0
        self._cutter = Cutter(FD if fd else CLASSIC)

    def frames(self, packet: Packet) -> list[Frame]:
        """Return a packet's frames."""
        kind = MESSAGES[packet.type].CAN
        asks = packet.flags & Flag.ACK_REQUEST
        if packet.type == Start.TYPE and not asks and not any(packet.payload[PROMPT_START:]):
            kind = CanClass.PROMPT
        identifier = self._prefix | kind << 8 | packet.node << 1 | self._direction
        if kind in (CanClass.ESTOP, CanClass.PULSE):
            return [(identifier, packet.payload)]
        if kind == CanClass.PROMPT:
            return [(identifier, bytes([packet.type]) + packet.payload[:PROMPT_START])]
        data = encode_packet(packet)
        return [(identifier, padded(f)) for f in self._cutter.fragments(identifier, data)]


def padded(data: bytes) -> bytes:
    """Return data filled up with zeros to a length that CAN FD has."""
    return data.ljust(next(size for size in FD_SIZES if size >= len(data)), b"\0")


class CanDecoder:
    """Finds the packets in CAN frames.

    Parameters
    ----------
    from_amplifier : direction that is listened to
    extended : 29-bit identifiers; those of the other length are the caller's to leave out
    limit : largest packet [bytes]
    counters : to count in
    tick_hz : of the time of reception

    Attributes
    ----------
    node : whose frames, and those to all, are looked at; None for everyone's
    """

    def __init__(
        self,
        *,
        from_amplifier: bool,
        extended: bool = False,
        limit: int = PACKET_MAX,
        counters: LinkCounters | None = None,
        node: int | None = None,
        tick_hz: int = 1_000_000,
    ) -> None:
        self.counters = LinkCounters() if counters is None else counters
        self.node = node
        self._direction = int(from_amplifier)
        self._fragments = AMPLIFIER_FRAGMENTS if from_amplifier else HOST_FRAGMENTS
        self._prefix = CAN_PREFIX if extended else 0
        timeout = -(FRAGMENT_TIMEOUT_MS * tick_hz // -1000)
        self._reassembler = Reassembler(limit, self.counters, timeout)

    def feed(self, identifier: int, data: bytes, now: int) -> list[Packet]:
        """Return the packet, if any, that a frame received at a tick completes."""
        if identifier & ~BASE != self._prefix:
            return []
        kind, node = (identifier & BASE) >> 8, identifier >> 1 & 0x7F
        if identifier & 1 != self._direction or (self.node not in (None, node) and node):
            return []
        if kind in self._fragments:
            padded = len(data) > CLASSIC
            found = self._reassembler.feed(identifier, data, now, padded=padded)
        else:
            found = self._prompt(kind, node, data)
        return [] if found is None else [found]

    def _prompt(self, kind: int, node: int, data: bytes) -> Packet | None:
        if self._direction:
            return self._counted(Pulse.TYPE, node, data) if kind == CanClass.PULSE else None
        if kind == CanClass.ESTOP:
            return self._counted(Estop.TYPE, node, data)
        if kind != CanClass.PROMPT:
            return None
        if not data:
            self.counters.malformed += 1
        elif data[0] not in PROMPT:
            self.counters.unknown_type += 1
        else:
            return self._counted(data[0], node, data[1 : 1 + PROMPT_START])
        return None

    def _counted(self, kind: int, node: int, payload: bytes) -> Packet:
        self.counters.packets += 1
        return Packet(kind, bytes(payload[:8]), node=node)
