"""Host side of a session: packets out, answers in (sections 4 to 8 of SPEC.md).

It has neither I/O nor a clock: the owner of the link sends the packets that `packet` and
`request` return, and passes received packets to `receive`.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol import samples
from firmware_protocol.messages import FULL_SCALE_CODE, Message, NakCode, SampleFormat, State
from firmware_protocol.packet import SMALLEST, TURN, Packet

MOST_SAMPLES = 255
"""Largest number of samples per channel in a packet."""
SKIPPED = 1 << 20
"""Distance between all positions sent before a START and those after it (section 8.1)."""
BY_HOST = 1
"""Reason of an ESTOP by a host, as STATUS reports it."""
ANSWERS = 64
"""Largest number of answers that are stored until they are requested."""


class AmplifierHost:
    """Host of one amplifier.

    Parameters
    ----------
    session : int
        Session token, 1 … 65535.
    node : int
        Address of the amplifier.

    Attributes
    ----------
    session, node : int
        The parameters of the same names.
    caps : Caps or None
        Latest CAPS; None before the first.
    status : Status or None
        Latest STATUS; None before the first.
    pulse : Pulse or None
        Latest PULSE; None before the first.
    """

    def __init__(self, session: int, node: int) -> None:
        self.session, self.node = session, node
        self.caps: m.Caps | None = None
        self.status: m.Status | None = None
        self.pulse: m.Pulse | None = None
        self._seq = 0
        self._answers: dict[tuple[int, int], Message] = {}

    def packet(self, message: Message) -> Packet:
        """Encode a message that requests no answer.

        Parameters
        ----------
        message : Message
            Message to the amplifier.

        Returns
        -------
        Packet
            Packet to send.
        """
        return self._packet(message, ask=False)

    def request(self, message: Message) -> Packet:
        """Encode a request; `answer` returns its answer.

        Parameters
        ----------
        message : Message
            Message to the amplifier.

        Returns
        -------
        Packet
            Packet to send.
        """
        return self._packet(message, ask=True)

    def _packet(self, message: Message, *, ask: bool) -> Packet:
        """Encode a message with the next sequence number, and forget an old answer to it."""
        packet = Packet.of(message, node=self.node, seq=self._seq, ask=ask)
        self._answers.pop((packet.type, packet.seq), None)
        self._seq = (self._seq + 1) & 0xFF
        return packet

    def receive(self, packet: Packet) -> Message | None:
        """Process a packet from the amplifier.

        Parameters
        ----------
        packet : Packet
            Received packet.

        Returns
        -------
        Message or None
            Its message; None if the packet is not one of the amplifier's or cannot be decoded.
        """
        kind = m.MESSAGES.get(packet.type)
        foreign = packet.node != self.node or packet.flags >> 6 != m.MAJOR
        if foreign or kind is None or packet.type < m.Ack.TYPE:
            return None
        message = kind.unpack(packet.payload)
        if isinstance(message, m.Caps):
            self.caps = message
        elif isinstance(message, m.Status):
            self.status = message
        elif isinstance(message, m.Pulse):
            self.pulse = message
        elif isinstance(message, m.Ack | m.Nak):
            self._answers[message.type, message.seq] = message
            if len(self._answers) > ANSWERS:
                del self._answers[next(iter(self._answers))]
        return message

    def answer(self, request: Packet) -> Message | None:
        """Return the answer to a request, and forget it.

        Parameters
        ----------
        request : Packet
            Packet that `request` returned.

        Returns
        -------
        Message or None
            The ACK or NAK; None if there is none yet.
        """
        return self._answers.pop((request.type, request.seq), None)


def refusal(nak: m.Nak) -> str:
    """Describe a NAK in one line.

    Parameters
    ----------
    nak : Nak
        Refusal of a request.

    Returns
    -------
    str
        Refused message, code, detail and state.
    """
    kind = m.MESSAGES.get(nak.type)
    what = kind.__name__ if kind else f"message {nak.type}"
    code = NakCode(nak.code).name if nak.code in set(NakCode) else f"code {nak.code}"
    state = State(nak.state).name if nak.state in set(State) else f"state {nak.state}"
    return f"the amplifier refused {what}: {code} (detail {nak.detail}) in state {state}"


def codes_of(volts: NDArray[np.float64], full_scale: float) -> NDArray[np.int16]:
    """Convert a voltage to sample codes.

    Parameters
    ----------
    volts : array of float
        Finite voltages [V]; those beyond ±``full_scale`` are clipped to it.
    full_scale : float
        Voltage of the largest sample code, more than 0 [V].

    Returns
    -------
    array of int
        Sample codes.
    """
    codes = np.rint(volts * (FULL_SCALE_CODE / full_scale))
    return np.clip(codes, -FULL_SCALE_CODE, FULL_SCALE_CODE).astype(np.int16)


def _even(total: int, most: int) -> int:
    """Return the size of groups that are as few and as even as ``most`` per group allows."""
    return -(total // -max(-(total // -most), 1))


def pcm(
    position: int, codes: NDArray[np.int16], *, session: int, sample_format: int, packet_limit: int
) -> Iterator[m.Pcm]:
    """Divide a block of samples into as few messages as the packet limit allows.

    Blocks in BFP8 are divided by channels first, since each division in time costs every channel an
    exponent.

    Parameters
    ----------
    position : int
        Position of the first sample.
    codes : (S, C) array of int
        Sample codes.
    session : int
        Session token.
    sample_format : int
        Sample format.
    packet_limit : int
        Largest packet, from CAPS [bytes].

    Yields
    ------
    Pcm
        Messages that together carry the block.
    """
    room = packet_limit - SMALLEST - m.Pcm.HEAD.size
    total, channels = codes.shape
    group, count = channels, min(MOST_SAMPLES, total)
    if sample_format == SampleFormat.BFP8:
        group = _even(channels, max(room // max(samples.size(sample_format, count, 1), 1), 1))
    while samples.size(sample_format, 1, group) > room:
        group = -(group // -2)
    while samples.size(sample_format, count, group) > room:
        count = min(count - 1, count * room // samples.size(sample_format, count, group))
    for start in range(0, total, count):
        for first in range(0, channels, group):
            piece = codes[start : start + count, first : first + group]
            data = samples.encode(sample_format, piece)
            at = (position + start) % TURN
            yield m.Pcm(at, session, first, piece.shape[1], sample_format, len(piece), data)
