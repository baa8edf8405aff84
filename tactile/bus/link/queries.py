"""Requests to an amplifier outside of the course of its session: GET, SET, IDENTIFY, and SENSE.

The session, idle or running, does not wait for these answers and does not end by a refusal. There
is one request at a time, which is sent three times at most (SPEC.md, 5). The module has no I/O and
no clock.
"""

import math
from collections import deque

from firmware_protocol import messages as m
from firmware_protocol.host import AmplifierHost
from firmware_protocol.messages import Message
from firmware_protocol.packet import Packet

RETRY, TRIES = 50e-3, 3
"""Interval between the attempts of a request [s], and their number (SPEC.md, 5)."""
SENSES = 256
"""Maximum number of packets of readings that are kept until they are taken, the newest ones; with
one every 10 ms these are 2.5 s."""


class Queries:
    """Requests to one amplifier outside of the course of its session, and its readings.

    It has no lock; `LinkBus` calls it under its own.

    Parameters
    ----------
    host : AmplifierHost
        Host's side of the session, which makes the packets.

    Attributes
    ----------
    answer : Message or None
        Answer to the latest request; None if it has not come, and also after the last attempt.
    senses : deque of Sense
        Readings that nobody has taken yet.
    """

    def __init__(self, host: AmplifierHost) -> None:
        self._host = host
        self.answer: Message | None = None
        self.senses: deque[m.Sense] = deque(maxlen=SENSES)
        self._request: Packet | None = None
        self._tries_left, self._next_try = 0, math.inf

    def request(self, message: Message) -> None:
        """Make a request, in place of one that was not answered yet.

        Parameters
        ----------
        message : Message
            Request, which `poll` sends.
        """
        self._request, self.answer = self._host.request(message), None
        self._tries_left, self._next_try = TRIES, -math.inf

    def forget(self) -> None:
        """Drop the request and its answer."""
        self._request, self.answer, self._next_try = None, None, math.inf

    def poll(self, now: float) -> list[Packet]:
        """Return what is to be sent now.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        list of Packet
            The request, if an attempt is due.
        """
        if self._request is None or now < self._next_try:
            return []
        self._tries_left -= 1
        self._next_try = now + RETRY if self._tries_left else math.inf
        return [self._request]

    def receive(self, message: Message) -> None:
        """Take a message of the amplifier: an answer, a reading, or one of no concern.

        Parameters
        ----------
        message : Message
            Message of the amplifier.
        """
        if isinstance(message, m.Sense):
            self.senses.append(message)
        elif self._request is not None and _answers(message, self._request):
            self._request, self.answer, self._next_try = None, message, math.inf

    @property
    def deadline(self) -> float:
        """Host time at which `poll` has something to send, -inf for now and inf for never [s]."""
        return self._next_try


def _answers(message: Message, request: Packet) -> bool:
    """Return whether a message answers a request."""
    if isinstance(message, m.Ack | m.Nak):
        return (message.type, message.seq) == (request.type, request.seq)
    if isinstance(message, m.Value) and request.type == m.Get.TYPE:
        get = m.Get.unpack(request.payload)
        return get is not None and get.parameter == message.parameter
    return False
