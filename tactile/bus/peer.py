"""One amplifier as its host knows it: what it was asked, what it answered, what its clock shows.

No I/O and no clock of its own. Requests go one at a time, each three times at most (SPEC.md, 5);
probes of the clock go as the estimator wants them (7.2).
"""

import math
from collections import deque
from dataclasses import replace

from firmware_protocol import messages as m
from firmware_protocol.clock import ClockEstimator
from firmware_protocol.host import Host
from firmware_protocol.messages import Message, State
from firmware_protocol.packet import TURN, Packet
from firmware_protocol.player import distance

RETRY, TRIES = 50e-3, 3
"""s between the tries of a request, and how many there are (SPEC.md, 5)."""
ANSWERS: dict[int, type[Message]] = {m.Hello.TYPE: m.Caps, m.Poll.TYPE: m.Status}
"""What answers a request; ACK the others."""
TIME_LENGTH = m.TimeReply.HEAD.size
"""To which TIME is padded, so that both ways take as long (SPEC.md, 7.2)."""
POLL_INTERVAL = 0.25
"""s between STATUSes while it plays."""
SKIPPED = 1 << 20
"""Positions between all that was sent before a START and what comes after it (SPEC.md, 8.1)."""


class Peer:
    """An amplifier.

    Parameters
    ----------
    session, node : as on the wire

    Attributes
    ----------
    host : the protocol's host
    clock : estimate of its clock; None before the first CAPS
    heard : host time of the last packet from it [s]
    refused : the NAK that ended the last requests
    lost : whether a request was not answered
    underruns : counted since this host knows it
    begun : tick of the latest START
    """

    def __init__(self, session: int, node: int) -> None:
        self.host = Host(session, node)
        self.clock: ClockEstimator | None = None
        self.heard = -math.inf
        self.refused: m.Nak | None = None
        self.lost = False
        self.underruns = 0
        self._underruns: int | None = None
        self._sent = self._origin = self._first = self.begun = 0
        self._requests: deque[Message] = deque()
        self._asked: Packet | None = None
        self._tries, self._again = 0, math.inf
        self._probes: dict[int, float] = {}
        self._status_due = math.inf
        self._told: int | None = None

    # Requests

    def ask(self, *messages: Message) -> None:
        """Request things, one after the other, in place of what was not answered yet."""
        self._requests = deque(messages)
        self._asked, self.refused, self.lost = None, None, False

    @property
    def idle(self) -> bool:
        """Whether everything was answered."""
        return self._asked is None and not self._requests

    @property
    def caps(self) -> m.Caps:
        """What it said that it can."""
        assert self.host.caps is not None
        return self.host.caps

    @property
    def state(self) -> State | None:
        """Its state by the latest PULSE or STATUS."""
        return None if self._told is None else State(self._told)

    def assume(self, state: State) -> None:
        """Take it to be in a state, since it did what leads there."""
        self._told = state

    def receive(self, packet: Packet, now: float) -> None:
        """Take a packet that is this amplifier's."""
        message = self.host.receive(packet)
        if message is None:
            return
        self.heard = now
        asked = self._asked
        if isinstance(message, m.Pulse | m.Status):
            self._tell(message)
        elif isinstance(message, m.TimeReply):
            self._measure(message, now)
        if asked is None:
            return
        if isinstance(message, m.Nak):
            if (message.type, message.seq) == (asked.type, asked.seq):
                self._requests.clear()
                self._asked, self.refused = None, message
        elif isinstance(message, m.Ack):
            if (message.type, message.seq) == (asked.type, asked.seq):
                self._asked = None
        elif isinstance(message, ANSWERS.get(asked.type, m.Ack)):
            self._asked = None

    def _tell(self, message: m.Pulse | m.Status) -> None:
        known = message.state in set(State)
        self._told = message.state if known else self._told
        if isinstance(message, m.Pulse):
            if self._underruns is not None:
                self.underruns += (message.underruns - self._underruns) & 0xFF
            self._underruns = message.underruns

    def poll(self, now: float) -> list[Packet]:
        """Return what is to be sent now."""
        out = []
        if self._asked is None and self._requests:
            self._asked = self.host.ask(self._requests.popleft())
            self._tries, self._again = 0, now
        if self._asked is not None and now >= self._again:
            if self._tries == TRIES:
                self._requests.clear()
                self._asked, self.lost = None, True
            else:
                self._tries, self._again = self._tries + 1, now + RETRY
                out.append(self._asked)
        if self.clock is not None and self.clock.probe_due(now):
            out.append(self._probe(now))
        if now >= self._status_due:
            self._status_due = now + POLL_INTERVAL
            out.append(self.host.tell(m.Poll()))
        return out

    @property
    def deadline(self) -> float:
        """Host time at which `poll` has something to send [s], if nothing comes before."""
        probe = math.inf if self.clock is None else self.clock.next_probe
        if self._asked is None:
            return -math.inf if self._requests else min(probe, self._status_due)
        return min(probe, self._again, self._status_due)

    # Clock

    def greeted(self) -> None:
        """Begin, or go on, to follow its clock, after CAPS."""
        if self.clock is None or self.clock.tick_hz != self.caps.tick_hz:
            self.clock = ClockEstimator(self.caps.tick_hz)
        self._probes.clear()
        self._underruns = None

    def _probe(self, now: float) -> Packet:
        stamp = int(now * 1e9)
        self._probes[stamp] = now
        while len(self._probes) > TRIES:
            del self._probes[next(iter(self._probes))]
        packet = self.host.tell(m.Time(stamp))
        return replace(packet, payload=packet.payload.ljust(TIME_LENGTH, b"\0"))

    def _measure(self, reply: m.TimeReply, now: float) -> None:
        sent = self._probes.pop(reply.host_time, None)
        if sent is not None and self.clock is not None:
            self.clock.add(sent, reply.received, reply.sent, now)

    @property
    def locked(self) -> bool:
        """Whether its clock is known well enough to start by."""
        return self.clock is not None and self.clock.locked

    # Stream

    def start(self, position: int, time: float) -> m.Start:
        """Return the START that plays a position at a host time [s]; what follows refers to it."""
        assert self.clock is not None
        begin = self._sent + SKIPPED
        self._origin, self._sent = begin - position, begin
        self._first, self.begun = position, self.clock.ticks_at(time)
        self._status_due = time
        return m.Start(self.host.session, begin % TURN, 0, self.begun)

    def due(self, position: int, rate: float) -> float:
        """Return the host time at which a position is put out [s]."""
        assert self.clock is not None
        ticks = round((position - self._first) * self.clock.tick_hz / rate)
        return self.clock.host_time_at(self.begun + ticks)

    def wire_position(self, position: int, count: int) -> int:
        """Return what a position is on the wire, unwrapped; ``count`` from it on count as sent."""
        at = position + self._origin
        self._sent = max(self._sent, at + count)
        return at

    def wire_end(self, position: int) -> int:
        """Return what a position is on the wire."""
        return (position + self._origin) % TURN

    def has_credit(self, end: int) -> bool:
        """Tell whether the amplifier takes what ends before a wire position."""
        pulse = self.host.pulse
        return pulse is None or distance(end, pulse.credit_position) <= 0

    def rest(self) -> None:
        """Ask for no more STATUS."""
        self._status_due = math.inf
