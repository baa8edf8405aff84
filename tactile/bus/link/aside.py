"""What is asked of an amplifier beside its session's course: GET, SET, IDENTIFY, and its SENSE.

A session goes its way meanwhile, idle or running: it neither waits for these answers nor ends by a
refusal. One request at a time, three times at most (SPEC.md, 5). No I/O and no clock.
"""

import math
from collections import deque

from firmware_protocol import messages as m
from firmware_protocol.host import AmplifierHost
from firmware_protocol.messages import Message
from firmware_protocol.packet import Packet

RETRY, TRIES = 50e-3, 3
"""s between the tries of a request, and how many there are (SPEC.md, 5)."""
SENSES = 256
"""Packets of readings that are kept until somebody takes them, the newest: 2.5 s of one each
10 ms."""


class Aside:
    """Requests and readings of one amplifier.

    Parameters
    ----------
    host : the protocol's host

    Attributes
    ----------
    answer : to the latest request; None before it is there
    senses : what was measured, and nobody has taken
    """

    def __init__(self, host: AmplifierHost) -> None:
        self._host = host
        self.answer: Message | None = None
        self.senses: deque[m.Sense] = deque(maxlen=SENSES)
        self._asked: Packet | None = None
        self._left, self._again = 0, math.inf

    def ask(self, message: Message) -> None:
        """Request something in place of what was not answered yet."""
        self._asked, self.answer = self._host.ask(message), None
        self._left, self._again = TRIES, -math.inf

    def poll(self, now: float) -> list[Packet]:
        """Return what is to be sent now."""
        if self._asked is None or now < self._again:
            return []
        self._left -= 1
        self._again = now + RETRY if self._left else math.inf
        return [self._asked]

    def receive(self, message: Message) -> None:
        """Take what the amplifier sent."""
        if isinstance(message, m.Sense):
            self.senses.append(message)
        elif self._asked is not None and _answers(message, self._asked):
            self._asked, self.answer, self._again = None, message, math.inf

    @property
    def deadline(self) -> float:
        """Host time at which `poll` has something to send [s]."""
        return self._again


def _answers(message: Message, asked: Packet) -> bool:
    if isinstance(message, m.Ack | m.Nak):
        return (message.type, message.seq) == (asked.type, asked.seq)
    if isinstance(message, m.Value) and asked.type == m.Get.TYPE:
        get = m.Get.unpack(asked.payload)
        return get is not None and get.parameter == message.parameter
    return False
