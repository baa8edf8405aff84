"""The host's side of a session: packets out, answers in (sections 4 to 8 of SPEC.md).

No I/O and no clock: whoever holds the link sends what `ask` and `tell` return and hands over what
came to `receive`.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol import samples
from firmware_protocol.messages import FULL_SCALE_CODE, Message, NakCode, SampleFormat, State
from firmware_protocol.packet import SMALLEST, TURN, Packet

MOST_SAMPLES = 255
"""Of a packet, per channel."""
ANSWERS = 64
"""Answers that are kept until they are asked for."""


class AmplifierHost:
    """A host that holds one amplifier.

    Parameters
    ----------
    session : token, 1 … 65535
    node : address of the amplifier

    Attributes
    ----------
    caps, status, pulse : the latest of each; None before the first
    unexpected : packets that no amplifier sends, of another one or of another version
    """

    def __init__(self, session: int, node: int) -> None:
        self.session, self.node = session, node
        self.caps: m.Caps | None = None
        self.status: m.Status | None = None
        self.pulse: m.Pulse | None = None
        self.unexpected = 0
        self._seq = 0
        self._answers: dict[tuple[int, int], Message] = {}

    def tell(self, message: Message) -> Packet:
        """Return the packet of a message that wants no answer."""
        return self._packet(message, ask=False)

    def ask(self, message: Message) -> Packet:
        """Return the packet of a request; its answer comes with `answer`."""
        return self._packet(message, ask=True)

    def _packet(self, message: Message, *, ask: bool) -> Packet:
        packet = Packet.of(message, node=self.node, seq=self._seq, ask=ask)
        self._answers.pop((packet.type, packet.seq), None)
        self._seq = (self._seq + 1) & 0xFF
        return packet

    def receive(self, packet: Packet) -> Message | None:
        """Take a packet of the amplifier; return its message, None where it is none of its."""
        kind = m.MESSAGES.get(packet.type)
        foreign = packet.node != self.node or packet.flags >> 6 != m.MAJOR
        if foreign or kind is None or packet.type < m.Ack.TYPE:
            self.unexpected += 1
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
        """Return the ACK or NAK of a request, None while there is none."""
        return self._answers.pop((request.type, request.seq), None)


def refusal(nak: m.Nak) -> str:
    """Return what a NAK says, as one line."""
    kind = m.MESSAGES.get(nak.type)
    what = kind.__name__ if kind else f"message {nak.type}"
    code = NakCode(nak.code).name if nak.code in set(NakCode) else f"code {nak.code}"
    state = State(nak.state).name if nak.state in set(State) else f"state {nak.state}"
    return f"the amplifier refused {what}: {code} (detail {nak.detail}) in state {state}"


def codes_of(volts: NDArray[np.float64], full_scale: float) -> NDArray[np.int16]:
    """Return finite volts within ±``full_scale`` [V] as sample codes."""
    return np.rint(volts * (FULL_SCALE_CODE / full_scale)).astype(np.int16)


def _even(total: int, most: int) -> int:
    """Return the size of as few and as even groups as ``most`` each allows."""
    return -(total // -max(-(total // -most), 1))


def pcm(
    position: int, codes: NDArray[np.int16], *, session: int, sample_format: int, packet_limit: int
) -> Iterator[m.Pcm]:
    """Yield the messages of a block: as few as the packet limit allows.

    Those of BFP8 are cut by channels first, since each cut in time costs every channel an exponent.

    Parameters
    ----------
    position : of its first sample
    codes : (S, C)
    session, sample_format : as on the wire
    packet_limit : of CAPS [bytes]
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
            part = codes[start : start + count, first : first + group]
            data = samples.encode(sample_format, part)
            at = (position + start) % TURN
            yield m.Pcm(at, session, first, part.shape[1], sample_format, len(part), data)
