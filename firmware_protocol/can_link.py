"""Packets on CAN and CAN FD: identifiers, prompt frames and fragments (section 3.2 of SPEC.md)."""

from firmware_protocol.fragments import Cutter, Reassembler
from firmware_protocol.messages import (
    CAN_PREFIX,
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
"""Largest payload of a CAN frame and of a CAN FD frame [bytes]."""
FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Payload sizes that a frame can have (ISO 11898-1) [bytes]."""
BASE = 0x7FF
"""Mask of the 11-bit identifier."""
PROMPT = (Sync.TYPE, Start.TYPE, Heartbeat.TYPE)
"""Messages that may travel in prompt frames of class PROMPT."""
PROMPT_START = 7
"""Length of START in a prompt frame, which is all of it but its time [bytes]."""
HOST_FRAGMENTS = (CanClass.STREAM, CanClass.REQUEST)
"""Classes in which the host sends fragments."""
AMPLIFIER_FRAGMENTS = (CanClass.RESPONSE, CanClass.BULK)
"""Classes in which the amplifier sends fragments."""

Frame = tuple[int, bytes]
"""Identifier and data of a CAN frame."""


class CanEncoder:
    """Encoder of packets into CAN frames.

    Parameters
    ----------
    from_amplifier : bool
        Direction of the frames.
    fd : bool
        Whether frames have up to 64 bytes (CAN FD).
    extended : bool
        Whether identifiers have 29 bits.
    """

    def __init__(self, *, from_amplifier: bool, fd: bool, extended: bool = False) -> None:
        self._direction = int(from_amplifier)
        self._prefix = CAN_PREFIX if extended else 0
        self._cutter = Cutter(FD if fd else CLASSIC)

    def frames(self, packet: Packet) -> list[Frame]:
        """Encode a packet.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Returns
        -------
        list of Frame
            One prompt frame or all fragments, in the order of transmission.
        """
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
    """Pad data with zeros to the next length that CAN FD has.

    Parameters
    ----------
    data : bytes
        Up to 64 bytes.

    Returns
    -------
    bytes
        Padded data.
    """
    return data.ljust(next(size for size in FD_SIZES if size >= len(data)), b"\0")


class CanDecoder:
    """Decoder of CAN frames into packets.

    Parameters
    ----------
    from_amplifier : bool
        Direction of the frames that are decoded.
    extended : bool
        Whether identifiers have 29 bits. The caller must leave out those of the other length.
    limit : int
        Largest packet [bytes].
    counters : LinkCounters, optional
        Counters to count in; own ones by default.
    node : int or None
        Node whose frames, besides those to all nodes, are decoded; None for every node.
    tick_hz : int
        Frequency of the clock that gives the time of reception [Hz].

    Attributes
    ----------
    node : int or None
        The parameter of the same name, which may be changed.
    counters : LinkCounters
        Counters of received packets and of errors.
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
        self._reassembler = Reassembler(limit, self.counters, tick_hz)

    def feed(self, identifier: int, data: bytes, now: int) -> list[Packet]:
        """Decode a received frame.

        Parameters
        ----------
        identifier : int
            Identifier of the frame.
        data : bytes
            Payload of the frame.
        now : int
            Time of reception [ticks].

        Returns
        -------
        list of Packet
            The packet that the frame completes, if any.
        """
        if identifier & ~BASE != self._prefix:
            return []
        kind, node = (identifier & BASE) >> 8, identifier >> 1 & 0x7F
        if identifier & 1 != self._direction or (self.node not in (None, node) and node):
            return []
        if kind in self._fragments:
            padded = len(data) > CLASSIC
            packet = self._reassembler.feed(identifier, data, now, padded=padded)
        else:
            packet = self._prompt(kind, node, data)
        return [] if packet is None else [packet]

    def _prompt(self, kind: int, node: int, data: bytes) -> Packet | None:
        """Return the packet of a prompt frame, or None if it is ignored or counted as an error."""
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
        """Count and return the packet of a prompt frame."""
        self.counters.packets += 1
        return Packet(kind, bytes(payload[:8]), node=node)
