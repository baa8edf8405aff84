"""One amplifier as its host knows it: what it was asked, what it answered, what its clock shows.

No I/O and no clock of its own. Requests go one at a time, each three times at most (SPEC.md, 5);
probes of the clock go as the estimator wants them (7.2).
"""

import math
from collections import deque
from dataclasses import replace

from firmware_protocol import messages as m
from firmware_protocol.clock import ClockEstimator
from firmware_protocol.host import AmplifierHost
from firmware_protocol.messages import UNGUARDED_MOST_UV, Feature, Input, Message, State
from firmware_protocol.packet import TURN, Packet
from firmware_protocol.player import distance
from tactile.bus.link.aside import RETRY, TRIES, Aside

ANSWERS: dict[int, type[Message]] = {m.Hello.TYPE: m.Caps, m.Poll.TYPE: m.Status}
"""What answers a request; ACK the others."""
TIME_LENGTH = m.TimeReply.HEAD.size
"""To which TIME is padded, so that both ways take as long (SPEC.md, 7.2)."""
POLL_INTERVAL = 0.25
"""s between STATUSes while it plays, or its e-stop input is open."""
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
    underruns, late : counted since this host knows it: underruns, and samples that came too late
    begun : tick of the latest START
    aside : what is asked besides, and what it measured
    """

    def __init__(self, session: int, node: int) -> None:
        self.host = AmplifierHost(session, node)
        self.clock: ClockEstimator | None = None
        self.heard = -math.inf
        self.refused: m.Nak | None = None
        self.lost = False
        self.underruns = self.late = 0
        self._late: int | None = None
        self._counted: int | None = None
        self._told_all = self._restarted = False
        self._hurry = math.inf
        self._sent = self._origin = self._first = self.begun = 0
        self._requests: deque[Message] = deque()
        self._asked: Packet | None = None
        self._tries, self._again = 0, math.inf
        self.aside = Aside(self.host)
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

    @property
    def input_open(self) -> bool:
        """Whether its e-stop input was open by the latest STATUS."""
        status = self.host.status
        return status is not None and bool(status.inputs & Input.ESTOP_OPEN)

    @property
    def unguarded(self) -> bool:
        """Whether it can put out more than 60 V and has no e-stop input (SPEC.md, 13)."""
        guarded = self.caps.features & Feature.ESTOP_INPUT
        return self.caps.full_scale_uv > UNGUARDED_MOST_UV and not guarded

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
        self.aside.receive(message)
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
        if isinstance(message, m.Status):
            self._count(message.underruns, message.late_samples)
            self._told_all = True
        elif self._told_all and self._counted is not None:
            self._count(self._counted + ((message.underruns - self._counted) & 0xFF), self._late)

    def _count(self, underruns: int, late: int | None) -> None:
        """Take its counters, which begin anew after a reset."""
        self.underruns += _since(underruns, self._counted)
        self._counted = underruns
        if late is not None:
            self.late += _since(late, self._late)
            self._late = late

    @property
    def forgot(self) -> str:
        """What shows that it was reset, and no longer knows this host; empty where nothing does."""
        refused, status = self.refused, self.host.status
        if self._restarted:
            return "its clock began anew"
        if refused is not None and refused.code == m.NakCode.SESSION:
            return "it refused what is of this session"
        if self._told_all and status is not None and status.session != self.host.session:
            return f"its session is {status.session}, not {self.host.session}"
        return ""

    def poll(self, now: float) -> list[Packet]:
        """Return what is to be sent now."""
        out = []
        while self._asked is None and self._requests:
            message = self._requests.popleft()
            if isinstance(message, m.Estop):  # on CAN never answered: STATUS shows it
                out.append(self.host.tell(message))
                continue
            self._asked = self.host.ask(message)
            self._tries, self._again = 0, now
        if self._asked is not None and now >= self._again:
            if self._tries == TRIES:
                self._requests.clear()
                self._asked, self.lost = None, True
            else:
                self._tries, self._again = self._tries + 1, now + RETRY
                out.append(self._asked)
        out += self.aside.poll(now)
        if self.clock is not None and (self.clock.probe_due(now) or now >= self._hurry):
            self._hurry = math.inf if self._hurry == math.inf else now + RETRY
            out.append(self._probe(now))
        if now >= self._status_due:
            self._status_due = now + POLL_INTERVAL
            out.append(self.host.tell(m.Poll()))
        return out

    @property
    def deadline(self) -> float:
        """Host time at which `poll` has something to send [s], if nothing comes before."""
        probe = math.inf if self.clock is None else min(self.clock.next_probe, self._hurry)
        first = min(probe, self._status_due, self.aside.deadline)
        if self._asked is None:
            return -math.inf if self._requests else first
        return min(first, self._again)

    # Clock

    def greeted(self) -> None:
        """Begin, or go on, to follow its clock, after CAPS."""
        if self.clock is None or self.clock.tick_hz != self.caps.tick_hz:
            self.clock = ClockEstimator(self.caps.tick_hz)
        self._probes.clear()
        self._hurry = -math.inf

    def reconnected(self) -> None:
        """Take nothing that it said before for what it is now."""
        self._told_all, self._told, self.host.pulse = False, None, None
        self._restarted = False

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
            before = self.clock.restarts
            if self.clock.add(sent, reply.received, reply.sent, now):
                self._restarted |= self.clock.restarts > before and self._hurry == math.inf
                self._hurry = math.inf

    @property
    def locked(self) -> bool:
        """Whether its clock is known well enough to start by, since it was greeted as well."""
        return self.clock is not None and self.clock.locked and self._hurry == math.inf

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

    def watch(self, now: float) -> None:
        """Ask for STATUS from now on, as while it plays."""
        self._status_due = min(self._status_due, now + POLL_INTERVAL)

    def rest(self) -> None:
        """Ask for no more STATUS."""
        self._status_due = math.inf


def _since(count: int, last: int | None) -> int:
    """Return by how much a counter has risen since it was seen last; it may have begun anew."""
    if last is None:
        return 0
    return count - last if count >= last else count
