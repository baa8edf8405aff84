"""One amplifier as its host knows it: requests, answers, counters, clock and positions.

The module has no I/O and no clock of its own. Requests are sent one at a time, each three times at
most (SPEC.md, 5), and clock probes when the estimator asks for them (7.2).
"""

import math
from collections import deque
from dataclasses import replace

from firmware_protocol import messages as m
from firmware_protocol.clock import ClockEstimator
from firmware_protocol.host import SKIPPED, AmplifierHost
from firmware_protocol.messages import UNGUARDED_MOST_UV, Feature, Input, Message, State
from firmware_protocol.packet import TURN, Packet
from firmware_protocol.player import distance
from tactile.bus.link.ledger import OutputLedger, rise
from tactile.bus.link.queries import RETRY, TRIES, Queries

ANSWERS: dict[int, type[Message]] = {m.Hello.TYPE: m.Caps, m.Poll.TYPE: m.Status}
"""Answers to requests that ACK does not answer, by the type of the request."""
TIME_LENGTH = m.TimeReply.HEAD.size
"""Length to which TIME is padded, so that both directions take equally long (SPEC.md, 7.2)
[bytes]."""
OLDEST = 0.25
"""Longest time for which a report may have been on its way, that after which a silent amplifier
counts as lost [s]."""
POLL_INTERVAL = 0.25
"""Interval of requests for STATUS while an amplifier plays, or its e-stop input is open [s]."""


class Peer:
    """One amplifier of a session.

    It has no lock; `LinkBus` calls it under its own.

    Parameters
    ----------
    session : int
        Session token, 1 … 65535.
    node : int
        Address of the amplifier, 1 … 127.

    Attributes
    ----------
    host : AmplifierHost
        Host's side of the protocol, which makes packets and keeps the latest answers.
    clock : ClockEstimator or None
        Estimate of the amplifier's clock; None before the first CAPS.
    last_received : float
        Host time of the last packet from the amplifier [s].
    refused : Nak or None
        Refusal that ended the last requests; None if there was none.
    lost : bool
        Whether a request was not answered in three attempts.
    underruns : int
        Number of underruns since this host has known the amplifier.
    late : int
        Number of samples that were too late for the amplifier, since then.
    credit_faults : int
        Number of PULSEs with a credit that cannot be right, since then.
    disturbed : int
        Number of samples that were bridged, not there in time, or limited, since then.
    ledger : OutputLedger
        Count of the positions that the amplifier has put out.
    begun : int
        Tick of the amplifier's clock at which the latest START plays.
    taken : bool
        Whether the amplifier has taken the session token.
    queries : Queries
        Requests outside of the course of the session, and readings.
    settings : Queries
        Request that sets the length of the windows of CORRELATION.
    """

    def __init__(self, session: int, node: int) -> None:
        self.host = AmplifierHost(session, node)
        self.clock: ClockEstimator | None = None
        self.last_received = -math.inf
        self.refused: m.Nak | None = None
        self.lost = self.taken = False
        self.underruns = self.late = self.credit_faults = self.disturbed = 0
        self.ledger = OutputLedger()
        self._late_seen: int | None = None
        """Latest value of the amplifier's counter of late samples."""
        self._disturbed_seen: int | None = None
        """Latest sum of its counters of lost and limited samples."""
        self._underruns_seen: int | None = None
        """Latest value of its counter of underruns."""
        self._outdated_until = -math.inf
        """Host time up to which reports may be older than `OLDEST` [s]."""
        self._status_seen = self._restarted = False
        """Whether a STATUS has come since the wire was opened, and whether the clock began anew."""
        self._greeting_probe = math.inf
        """Host time of the next probe of a greeting; inf once one has been answered [s]."""
        self._sent_end = self._origin = self._start_position = self.begun = 0
        """Unwrapped wire position after all that was sent; wire position of position 0; position
        of the latest START; and its tick."""
        self._rate = 0.0
        """Sample rate of the latest START; 0 before the first one [Hz]."""
        self._requests: deque[Message] = deque()
        self._request: Packet | None = None
        """Request that waits for its answer."""
        self._tries, self._next_try = 0, math.inf
        self.queries, self.settings = Queries(self.host), Queries(self.host)
        self._probes: dict[int, float] = {}
        """Host times of probes without an answer by their stamps [s]."""
        self._status_due = math.inf
        self._state: int | None = None
        """State by the latest PULSE or STATUS."""

    # Requests

    def request(self, *messages: Message) -> None:
        """Make requests, one after the other, in place of those not answered yet.

        Parameters
        ----------
        *messages : Message
            Requests, which `poll` sends; none to drop those not answered yet.
        """
        self._requests = deque(messages)
        self._request, self.refused, self.lost = None, None, False

    @property
    def idle(self) -> bool:
        """Whether all requests were answered, or ended by a refusal or by `lost`."""
        return self._request is None and not self._requests

    @property
    def caps(self) -> m.Caps:
        """Capabilities of the amplifier; they are known once it was greeted."""
        assert self.host.caps is not None
        return self.host.caps

    @property
    def state(self) -> State | None:
        """State of the amplifier by its latest PULSE or STATUS; None if neither has come."""
        return None if self._state is None else State(self._state)

    @property
    def input_open(self) -> bool:
        """Whether the e-stop input was open by the latest STATUS."""
        status = self.host.status
        return status is not None and bool(status.inputs & Input.ESTOP_OPEN)

    @property
    def unguarded(self) -> bool:
        """Whether the amplifier exceeds 60 V and has no e-stop input, to warn of (SPEC.md, 13)."""
        guarded = self.caps.features & Feature.ESTOP_INPUT
        return self.caps.full_scale_uv > UNGUARDED_MOST_UV and not guarded

    def assume(self, state: State) -> None:
        """Assume a state, because the amplifier acknowledged a request that leads to it.

        Parameters
        ----------
        state : State
            State until the next PULSE or STATUS.
        """
        self._state = state

    def receive(self, packet: Packet, now: float) -> None:
        """Take a packet of this amplifier.

        Parameters
        ----------
        packet : Packet
            Packet from the node of the amplifier.
        now : float
            Host time of its reception [s].
        """
        message = self.host.receive(packet)
        if message is None:
            return
        if now > self.last_received + OLDEST:  # what waited for a host that was held up is older
            self._outdated_until = now + OLDEST
        self.last_received = now
        request = self._request
        if isinstance(message, m.Pulse | m.Status):
            self._update(message)
            self._report(message, now)
        elif isinstance(message, m.TimeReply):
            self._add_exchange(message, now)
        elif isinstance(message, m.Caps) and message.session == self.host.session:
            self.taken = True
        self.queries.receive(message)
        self.settings.receive(message)
        if request is None:
            return
        if isinstance(message, m.Nak):
            if (message.type, message.seq) == (request.type, request.seq):
                self._requests.clear()
                self._request, self.refused = None, message
        elif isinstance(message, m.Ack):
            if (message.type, message.seq) == (request.type, request.seq):
                self._request = None
        elif isinstance(message, m.Caps) and message.session != self.host.session:
            return  # it may be a late answer to the HELLO that searched
        elif isinstance(message, ANSWERS.get(request.type, m.Ack)):
            self._request = None

    def _update(self, message: m.Pulse | m.Status) -> None:
        """Take state and counters of a PULSE or STATUS.

        PULSE has the low byte of the underruns only, which is of use after a STATUS has given all.
        """
        known = message.state in set(State)
        self._state = message.state if known else self._state
        if isinstance(message, m.Status):
            self._add_counts(message.underruns, message.late_samples)
            disturbed = message.lost_samples + message.limited_samples
            self.disturbed += rise(disturbed, self._disturbed_seen)
            self._disturbed_seen = disturbed
            self._status_seen = True
        elif self._status_seen and self._underruns_seen is not None:
            self._add_counts(
                self._underruns_seen + ((message.underruns - self._underruns_seen) & 0xFF),
                self._late_seen,
            )

    def _report(self, message: m.Pulse | m.Status, now: float) -> None:
        """Pass a report on to the ledger, with its position if that can be one since START.

        A report from before START has any position, and so has a wrong credit, which is counted.
        """
        if isinstance(message, m.Status):
            self.ledger.count_lost(message.lost_samples)
        if not self._rate:
            return
        fifo = self.caps.fifo_samples
        if isinstance(message, m.Status):
            position = message.position
        else:
            position = (message.credit_position - fifo) % TURN
        ahead = distance(position, self._position_at(now))
        if -fifo - OLDEST * self._rate <= ahead <= fifo:
            self.ledger.report(message, position, now)
        elif (
            isinstance(message, m.Pulse)
            and message.state == State.RUNNING
            and now > self._outdated_until
        ):
            self.credit_faults += 1
            self.ledger.report_running(now)

    def _position_at(self, now: float) -> int:
        """Return the wire position that is put out next, by the clock, modulo 2³²."""
        return (self.reached(now) + self._origin) % TURN

    def reached(self, now: float) -> int:
        """Return the position that is put out next, by the clock.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        int
            Position on the scale of what is written.
        """
        assert self.clock is not None
        ticks = max(self.clock.ticks_at(now) - self.begun, 0)
        return self._start_position + math.ceil(ticks * self._rate / self.clock.tick_hz)

    def position_of(self, wire: int, now: float) -> int:
        """Return the position of a wire position that the amplifier has put out lately.

        Parameters
        ----------
        wire : int
            Position on the wire, modulo 2³², since the latest START or before it.
        now : float
            Host time [s].

        Returns
        -------
        int
            Position on the scale of what is written.
        """
        reached = self.reached(now)
        return reached + distance(wire, (reached + self._origin) % TURN)

    def _add_counts(self, underruns: int, late: int | None) -> None:
        """Add what the amplifier's counters have risen by; they begin anew after a reset."""
        self.underruns += rise(underruns, self._underruns_seen)
        self._underruns_seen = underruns
        if late is not None:
            self.late += rise(late, self._late_seen)
            self._late_seen = late

    @property
    def reset_evidence(self) -> str:
        """Evidence that the amplifier was reset or lost this session, one line; empty if none."""
        refused, status = self.refused, self.host.status
        if self._restarted:
            return "its clock began anew"
        if refused is not None and refused.code == m.NakCode.SESSION:
            return "it refused what is of this session"
        if self.taken and self._status_seen and status and status.session != self.host.session:
            return f"its session is {status.session}, not {self.host.session}"
        return ""

    def poll(self, now: float) -> list[Packet]:
        """Return what is to be sent now: requests, clock probes and requests for STATUS.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        list of Packet
            Packets in the order in which to send them.
        """
        out = []
        while self._request is None and self._requests:
            message = self._requests.popleft()
            # On CAN an ESTOP is never answered; STATUS shows whether it was carried out.
            if isinstance(message, m.Estop):
                out.append(self.host.packet(message))
                continue
            self._request = self.host.request(message)
            self._tries, self._next_try = 0, now
        if self._request is not None and now >= self._next_try:
            if self._tries == TRIES:
                self._requests.clear()
                self._request, self.lost = None, True
            else:
                self._tries, self._next_try = self._tries + 1, now + RETRY
                out.append(self._request)
        out += [*self.queries.poll(now), *self.settings.poll(now)]
        if self.clock is not None and (self.clock.probe_due(now) or now >= self._greeting_probe):
            self._greeting_probe = math.inf if self._greeting_probe == math.inf else now + RETRY
            out.append(self._probe(now))
        if now >= self._status_due:
            self._status_due = now + POLL_INTERVAL
            out.append(self.host.packet(m.Poll()))
        return out

    @property
    def deadline(self) -> float:
        """Host time at which `poll` has something to send, if nothing is received before [s]."""
        probe = math.inf if self.clock is None else min(self.clock.next_probe, self._greeting_probe)
        first = min(probe, self._status_due, self.queries.deadline, self.settings.deadline)
        if self._request is None:
            return -math.inf if self._requests else first
        return min(first, self._next_try)

    # Currents

    @property
    def measures(self) -> bool:
        """Whether the amplifier has agreed to send windows of correlated currents."""
        return isinstance(self.settings.answer, m.Ack)

    @property
    def guards(self) -> bool:
        """Whether the amplifier sends windows of correlated currents and has guards."""
        return self.measures and bool(self.caps.features & Feature.GUARDS)

    def ask_for_windows(self, milliseconds: int) -> None:
        """Ask for windows of CORRELATION, if the amplifier has the feature.

        Parameters
        ----------
        milliseconds : int
            Length of a window [ms].
        """
        if self.caps.features & Feature.CORRELATES:
            setting = m.Set(self.host.session, m.Parameter.CORRELATION_MS, milliseconds)
            self.settings.request(setting)

    # Clock

    def greeted(self) -> None:
        """Begin to estimate the clock after CAPS, or continue if the clock is the same."""
        if self.clock is None or self.clock.tick_hz != self.caps.tick_hz:
            self.clock = ClockEstimator(self.caps.tick_hz)
        self._probes.clear()
        self._greeting_probe = -math.inf

    def renew(self, session: int) -> None:
        """Go on with another session token, which the next HELLO brings to the amplifier.

        Parameters
        ----------
        session : int
            Session token, 1 … 65535.
        """
        self.host.session, self.taken = session, False

    def reconnected(self) -> None:
        """Forget the reported state, because the wire was opened again."""
        self._status_seen, self._state, self.host.pulse = False, None, None
        self._restarted = False

    def _probe(self, now: float) -> Packet:
        """Return a clock probe, TIME with the host time in ns."""
        stamp = int(now * 1e9)
        self._probes[stamp] = now
        while len(self._probes) > TRIES:
            del self._probes[next(iter(self._probes))]
        packet = self.host.packet(m.Time(stamp))
        return replace(packet, payload=packet.payload.ljust(TIME_LENGTH, b"\0"))

    def _add_exchange(self, reply: m.TimeReply, now: float) -> None:
        """Add an exchange of timestamps to the estimate, if its probe is known."""
        sent = self._probes.pop(reply.host_time, None)
        if sent is not None and self.clock is not None:
            before = self.clock.restarts
            if self.clock.add(sent, reply.received, reply.sent, now):
                self._restarted |= self.clock.restarts > before and self._greeting_probe == math.inf
                self._greeting_probe = math.inf

    @property
    def locked(self) -> bool:
        """Whether the clock is known well enough to start by, with an exchange since `greeted`."""
        return self.clock is not None and self.clock.locked and self._greeting_probe == math.inf

    # Stream

    def start(self, position: int, time: float, rate: float) -> m.Start:
        """Return the START that plays a position at a host time; later calls refer to it.

        Parameters
        ----------
        position : int
            Position that is put out first.
        time : float
            Host time at which it is put out [s].
        rate : float
            Sample rate [Hz].

        Returns
        -------
        Start
            Message with the wire position and the tick of the amplifier's clock.
        """
        assert self.clock is not None
        begin = self._sent_end + SKIPPED
        self._origin, self._sent_end, self._rate = begin - position, begin, rate
        self._start_position, self.begun = position, self.clock.ticks_at(time)
        self.ledger.start(begin, time)
        self._status_due = time
        return m.Start(self.host.session, begin % TURN, 0, self.begun)

    def due(self, position: int) -> float:
        """Return the host time at which a position is put out.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Host time by the estimate of the amplifier's clock [s].
        """
        assert self.clock is not None
        return self.clock.host_time_at(self._tick_of(position))

    def due_uncertainty(self, position: int) -> float:
        """Return half of an interval around `due` that holds the true time.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Half of the interval; infinite before the first exchange of times [s].
        """
        assert self.clock is not None
        return self.clock.uncertainty_at(self._tick_of(position))

    def _tick_of(self, position: int) -> int:
        """Return the time of the amplifier at which a position is put out [ticks]."""
        assert self.clock is not None
        ticks = round((position - self._start_position) * self.clock.tick_hz / self._rate)
        return self.begun + ticks

    def unplayed(self, first: int, written: int, held: int, *, running: bool) -> int:
        """Return how many positions since playing began are not known to have been put out.

        Parameters
        ----------
        first, written : int
            Position with which playing began, and position after what was written.
        held : int
            Number of positions after that which have something to play.
        running : bool
            Whether positions that have not passed yet may still be put out.

        Returns
        -------
        int
            Number of positions.
        """
        ledger = self.ledger
        if running and ledger.running:
            written = min(written, self._start_position + ledger.passed)
        return written - first - ledger.put_out(written - self._start_position, held)

    def wire_position(self, position: int, count: int) -> int:
        """Return a position on the wire, and record that samples from it on are sent.

        Parameters
        ----------
        position : int
            Position of the first sample.
        count : int
            Number of samples.

        Returns
        -------
        int
            Position on the wire, not wrapped to 32 bits.
        """
        at = position + self._origin
        self._sent_end = max(self._sent_end, at + count)
        return at

    def wire_end(self, position: int) -> int:
        """Return a position on the wire without recording anything.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        int
            Position on the wire, modulo 2³².
        """
        return (position + self._origin) % TURN

    def has_credit(self, end: int) -> bool:
        """Return whether the amplifier has room for samples.

        Parameters
        ----------
        end : int
            Wire position after the samples.

        Returns
        -------
        bool
            Whether they are within the credit of the latest PULSE, or there was none yet.
        """
        pulse = self.host.pulse
        return pulse is None or distance(end, pulse.credit_position) <= 0

    def no_credit(self, end: int, now: float) -> str:
        """Describe the credit of an amplifier that has no room for samples.

        Parameters
        ----------
        end : int
            Wire position after the samples.
        now : float
            Host time [s].

        Returns
        -------
        str
            Node, position of the credit, and positions that the stream and, by the clock, the
            buffer of the amplifier have come to, one line.
        """
        assert self.host.pulse is not None
        buffered = (self._position_at(now) + self.caps.fifo_samples) % TURN
        return (
            f"node {self.host.node} gives no credit: it says position "
            f"{self.host.pulse.credit_position}, the stream is at {end % TURN}, and its buffer "
            f"ends at {buffered} by its clock"
        )

    def watch(self, now: float) -> None:
        """Begin to ask for STATUS each `POLL_INTERVAL`, as while the amplifier plays.

        Parameters
        ----------
        now : float
            Host time [s].
        """
        self._status_due = min(self._status_due, now + POLL_INTERVAL)

    def rest(self) -> None:
        """Ask for STATUS no more."""
        self._status_due = math.inf
