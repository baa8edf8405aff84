"""The host of a scenario: it brings an amplifier to rest, plays the steps, and collects answers.

The same rig drives a live amplifier and, on a `ReferenceWire`, the one that decides what applies.
"""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_protocol import messages as m
from firmware_protocol.layout import Message
from firmware_protocol.machine import DEFAULT_RATE, POWERED
from firmware_protocol.messages import (
    EstopReason,
    Feature,
    LogLevel,
    NakCode,
    Parameter,
    State,
)
from firmware_protocol.packet import TURN, Packet
from tactile.bus.conform.scenarios import (
    COUNTERS,
    Answer,
    Fields,
    Scenario,
    Translation,
    is_compared,
)
from tactile.bus.wire import Wire
from tactile.clock import Clock
from tactile.errors import BusError

PATIENCE = 0.5
"""Time for which an answer is waited for [s]."""
TRIES, AGAIN = 3, 0.25
"""Number of times that a request of the rig itself is sent, and the time for each [s]."""
AT_REST = 1.5
"""Time in which an amplifier must be at rest after STOP and DISARM, or after its watchdog [s]."""
FREE = m.WATCHDOG_MS * 1e-3
"""Time after HEARTBEAT and ARM in which no other session is taken [s]."""
LATCHED = (State.ESTOP, State.FAULT)
"""States that only CLEAR_FAULT ends."""
PULSE_MS = 10
"""Value of the parameter PULSE_MS at power-up [ms]."""
INTERVAL = 5e-3
"""Interval between requests that are repeated until the amplifier is at rest [s]."""

Received = tuple[Packet, Message]
"""Packet of the amplifier and its message."""


class SilenceError(BusError):
    """An amplifier that does not answer."""


class DisturbedError(BusError):
    """An amplifier that somebody else stopped or took, or that does not come to rest."""


@dataclass
class Trace:
    """What an amplifier did in a scenario.

    Attributes
    ----------
    answers : list of Answer
        All messages that are compared, in the words of the vector.
    status : dict of str to int or str
        Fields of STATUS after the last step; empty if none came.
    late : float
        Longest time by which a step came later than its vector says [s].
    """

    answers: list[Answer] = field(default_factory=list)
    status: Fields = field(default_factory=dict)
    late: float = 0.0


class Rig:
    """Host of one amplifier that plays scenarios.

    Parameters
    ----------
    wire : Wire
        Open wire to the amplifier.
    clock : Clock
        Clock by which the wire waits.
    seed : int
        Seed of the session tokens.
    patience : float
        Time for which an answer in a scenario is waited for [s].

    Attributes
    ----------
    node, home : int
        Present node of the amplifier, and that at the beginning; 0 until it has answered.
    caps : Caps
        Its latest CAPS.
    """

    def __init__(
        self, wire: Wire, clock: Clock, *, seed: int = 0, patience: float = PATIENCE
    ) -> None:
        self.wire, self.clock, self._patience = wire, clock, patience
        self.node = self.home = 0
        self.caps = m.Caps()
        self._random = random.Random(seed)
        self._inbox: deque[Received] = deque()
        self._seq = 0
        self._ours: set[int] = set()
        """Tokens of the sessions that this rig and its scenarios took."""
        self._trips, self._estops = 0, 0
        """Trips in the latest STATUS at rest, and the ESTOPs that were sent since."""
        self._tick, self._tick_at = 0, 0.0
        """Tick of the amplifier at a time of the clock."""

    # Packets

    def _take(self, until: float) -> None:
        """Receive once, and keep what is to be looked at."""
        for packet in self.wire.receive(until):
            kind = m.MESSAGES.get(packet.type)
            if kind is None or packet.type < m.Ack.TYPE or packet.flags >> 6 != m.MAJOR:
                continue
            message = kind.unpack(packet.payload)
            if message is not None and is_compared(message):
                self._inbox.append((packet, message))

    def wait(self, until: float) -> None:
        """Receive until a time.

        Parameters
        ----------
        until : float
            Time of the clock [s].
        """
        while self.clock.now() < until:
            self._take(until)

    def _collect(self, count: int, patience: float) -> list[Received]:
        """Wait for a number of messages, or for as long as the patience lasts."""
        received: list[Received] = []
        deadline = self.clock.now() + patience
        self._take(self.clock.now())
        while True:
            while self._inbox and len(received) < count:
                received.append(self._inbox.popleft())
            if len(received) == count or self.clock.now() >= deadline:
                return received
            self._take(deadline)

    def request(self, message: Message, *, node: int | None = None) -> Received:
        """Send a request until it is answered.

        Parameters
        ----------
        message : Message
            Request.
        node : int, optional
            Node; by default that of the amplifier.

        Returns
        -------
        tuple of Packet and Message
            Its answer.

        Raises
        ------
        SilenceError
            If none comes.
        """
        self._seq = (self._seq + 1) & 0xFF
        node = self.node if node is None else node
        packet = Packet.of(message, node=node, seq=self._seq, ask=True)
        for _ in range(TRIES):
            self._take(self.clock.now())
            self._inbox.clear()
            self.wire.send(packet)
            deadline = self.clock.now() + AGAIN
            while received := self._collect(1, deadline - self.clock.now()):
                if _answers(received[0][1], packet):
                    return received[0]
        raise SilenceError(self._silence(message))

    def _silence(self, message: Message) -> str:
        """Return what is wrong with an amplifier that does not answer."""
        what = type(message).__name__.upper()
        counters = self.wire.counters
        broken = counters.crc_errors + counters.malformed + counters.oversized
        if broken:
            return f"no valid answer to {what}: {broken} packets that came were damaged"
        return f"no answer to {what} within {TRIES * AGAIN:g} s"

    # Rest

    def find(self) -> None:
        """Find the amplifier on the link.

        Raises
        ------
        SilenceError
            If none answers.
        DisturbedError
            If several do; scenarios address all nodes.
        """
        packet, caps = self.request(m.Hello(0, m.MAJOR, m.MINOR, m.SCHEMA_CRC), node=0)
        received = self._collect(0xFF, 2 * INTERVAL)
        nodes = {packet.node, *(p.node for p, each in received if isinstance(each, m.Caps))}
        if len(nodes) > 1:
            numbers = ", ".join(map(str, sorted(nodes)))
            raise DisturbedError(f"nodes {numbers} answer: leave one amplifier on the link")
        assert isinstance(caps, m.Caps)
        self.node, self.caps = packet.node, caps
        self.home = self.home or self.node

    def poll(self) -> m.Status:
        """Return the present STATUS."""
        _, status = self.request(m.Poll())
        assert isinstance(status, m.Status)
        return status

    def take(self) -> int:
        """Take a session with a new token.

        Returns
        -------
        int
            The token.

        Raises
        ------
        DisturbedError
            If the amplifier refuses it for a second.
        """
        token = self._random.choice([t for t in range(0x8000, 0x8100) if t != self.caps.session])
        deadline = self.clock.now() + AT_REST
        while True:
            _, answer = self.request(m.Hello(token, m.MAJOR, m.MINOR, m.SCHEMA_CRC))
            if isinstance(answer, m.Caps):
                self.caps = answer
                self._ours.add(token)
                return token
            if self.clock.now() >= deadline:
                why = NakCode(answer.code).name if isinstance(answer, m.Nak) else str(answer)
                raise DisturbedError(f"it refuses a new session for {AT_REST:g} s: {why}")
            self.wait(self.clock.now() + INTERVAL)

    def stop(self) -> None:
        """Stop what plays and switch the high voltage off, if the session is one of the rig's."""
        self.find()
        session = self.poll().session
        if session in self._ours:
            self.request(m.Stop(session, 1))
            self.request(m.Disarm(session))

    def emergency(self, reason: int) -> None:
        """Send an ESTOP that `rest` may clear, to which CAN has no answer.

        Parameters
        ----------
        reason : int
            Its reason, which STATUS tells.
        """
        self._estops += 1
        self.wire.send(Packet.of(m.Estop(reason), node=self.node))

    def rest(self, *, rate: int = DEFAULT_RATE) -> None:
        """Bring the amplifier to rest: IDLE at 0 V, in a new session, as at power-up otherwise.

        Parameters
        ----------
        rate : int
            Sample rate that it has afterwards [Hz], within those that it has.

        Raises
        ------
        SilenceError
            If it does not answer.
        DisturbedError
            If it does not come to rest, or somebody else stopped or took it.
        """
        session = self.halt()
        rate = min(max(rate, self.caps.rate_min_hz), self.caps.rate_max_hz)
        self.request(m.Arm(session, m.Mode.PCM, rate))
        self.request(m.Disarm(session))
        self.wait(self.clock.now() + FREE)
        self.take()

    def halt(self) -> int:
        """Bring the amplifier to IDLE at 0 V, with the parameters of power-up, without ARM.

        Returns
        -------
        int
            Token of its session.

        Raises
        ------
        SilenceError, DisturbedError
            As `rest` does.
        """
        self.stop()
        status = self._settled()
        if status.session not in self._ours:
            if status.session and self._ours:
                raise DisturbedError("another host has taken the amplifier")
            self.take()
            status = self._settled()
        if status.state in LATCHED:
            self._clear(status)
        self._restore(status.session)
        return status.session

    def _settled(self) -> m.Status:
        """Return the STATUS at which the amplifier has come to rest."""
        deadline = self.clock.now() + AT_REST
        while (status := self.poll()).state in POWERED and status.session in {*self._ours, 0}:
            if self.clock.now() >= deadline:
                raise DisturbedError(
                    f"it stays in {State(status.state).name} after STOP and DISARM, and its "
                    "watchdog does not expire"
                )
            self.wait(self.clock.now() + INTERVAL)
        return status

    def _clear(self, status: m.Status) -> None:
        """Clear an e-stop, if all its trips are ESTOPs that the rig sent."""
        strange = (status.trips - self._trips) % TURN > self._estops
        if strange or status.fault or status.estop_reason == EstopReason.INPUT:
            raise DisturbedError(
                f"it is in {State(status.state).name}, and not because of an ESTOP of this test "
                f"(reason {status.estop_reason}, fault {status.fault}): check why, then run "
                "tactile clear"
            )
        deadline = self.clock.now() + AT_REST
        while isinstance(self.request(m.ClearFault(status.session, status.trips))[1], m.Nak):
            if self.clock.now() >= deadline:
                raise DisturbedError("it refuses CLEAR_FAULT with the trips of its own STATUS")
            self.wait(self.clock.now() + INTERVAL)

    def _restore(self, session: int) -> None:
        """Give the parameters their values at power-up."""
        if self.node != self.home:
            self.request(m.Set(session, Parameter.NODE, self.home))
            self.node = self.home
        self.request(m.Set(session, Parameter.PULSE_MS, PULSE_MS))
        self.request(m.Set(session, Parameter.LOG_LEVEL, LogLevel.WARNING))
        if self.caps.features & Feature.SENSES:
            self.request(m.Set(session, Parameter.SENSE_MS, 0))

    def translation(self, scenario: Scenario) -> Translation:
        """Return the words of a scenario for the amplifier as it is now.

        Parameters
        ----------
        scenario : Scenario
            Scenario that follows.

        Returns
        -------
        Translation
            Its words.
        """
        uptime = self.request(m.Get(Parameter.UPTIME_S))[1]
        time = self.request(m.Time(0))[1]
        assert isinstance(time, m.TimeReply)
        self._tick, self._tick_at = time.sent, self.clock.now()
        status = self.poll()
        self._trips, self._estops = status.trips, 0
        return Translation(
            scenario.node, self.home, scenario.tick_hz, self.caps.tick_hz,
            {name: getattr(status, name) for name in COUNTERS},
            uptime.value if isinstance(uptime, m.Value) else 0,
        )  # fmt: skip

    # Scenarios

    def play(
        self, scenario: Scenario, words: Translation, stretch: Callable[[float], float]
    ) -> Trace:
        """Play a scenario, each step when the one before it was answered and its time has passed.

        Parameters
        ----------
        scenario : Scenario
            Scenario to play.
        words : Translation
            Its words for the amplifier.
        stretch : callable
            Function that takes the time since the step before in the vector and returns by how much
            longer to wait, both in seconds.

        Returns
        -------
        Trace
            What the amplifier did.
        """
        self._ours |= scenario.sessions
        self._inbox.clear()
        trace, sent, before = Trace(), self.clock.now(), 0.0
        for step in scenario.steps:
            due = sent + step.time - before
            self.wait(due)
            tick = self._tick + round((self.clock.now() - self._tick_at) * self.caps.tick_hz)
            self.wait(self.clock.now() + stretch(step.time - before))
            before, sent = step.time, self.clock.now()
            if step.packet is not None:
                self._estops += step.packet.type == m.Estop.TYPE
                sent += self.wire.send(words.outgoing(step, tick))
            received = self._collect(len(step.answers), self._patience)
            trace.answers += [words.incoming(*each) for each in received]
            if len(received) < len(step.answers):
                break  # it has failed, and the steps that follow would come too late
            trace.late = max(trace.late, self.clock.now() - due)
        self._finish(trace, words, sent + stretch(0.0))
        return trace

    def _finish(self, trace: Trace, words: Translation, at: float) -> None:
        """Poll after the last step; whatever comes before that answer belongs to the trace."""
        at = max(at, self.clock.now())
        self.wait(at)
        last = [a.node for a in trace.answers if a.node is not None][-1:]
        node = words.swapped(last[0]) if last else self.home
        self.wire.send(Packet.of(m.Poll(), node=node, seq=0xFF, ask=True))
        while received := self._collect(1, self._patience):
            answer = words.incoming(*received[0])
            if answer.message == "STATUS":
                trace.status = answer.fields
                trace.late = max(trace.late, self.clock.now() - at)
                return
            trace.answers.append(answer)


def _answers(message: Message, request: Packet) -> bool:
    """Return whether a message answers a request."""
    if isinstance(message, m.Ack | m.Nak):
        return (message.type, message.seq) == (request.type, request.seq)
    return type(message) is ANSWERS.get(request.type)


ANSWERS: dict[int, type[Message]] = {
    m.Hello.TYPE: m.Caps, m.Time.TYPE: m.TimeReply, m.Get.TYPE: m.Value, m.Poll.TYPE: m.Status,
}  # fmt: skip
"""Answer of each request that does not have ACK, by its type."""
