"""A session with the amplifiers of one link, from HELLO to DISARM: what to say, and when.

No waiting and no clock: whoever holds the wire hands over what came to `receive`, and lets `poll`
send. It goes from phase to phase toward what is wanted of it; a phase ends when all amplifiers
have answered what it asked. What goes wrong is told by `trouble` and, where it ends what was
wanted, by `refusal`; nothing raises.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.host import refusal
from firmware_protocol.messages import HEARTBEAT_MS, MAJOR, Message, Mode, NakCode, State
from firmware_protocol.packet import Packet
from tactile.arrays import Floats
from tactile.bus.base import BusCounters, Wiring
from tactile.bus.budget import Plan, check_limits
from tactile.bus.link.aside import RETRY
from tactile.bus.link.peer import Peer
from tactile.bus.link.phases import SessionPhase, Want
from tactile.bus.link.stopped import INPUT_OPEN, open_input, why_stopped
from tactile.bus.link.stream import LinkStream
from tactile.bus.wire import FragmentWatch, Wire
from tactile.errors import InputError

SEARCH = 0.06
"""s in which amplifiers answer a HELLO to all; asked again while none did."""
AHEAD = 30e-3
"""s from START to the first sample."""
SILENCE = 0.25
"""s without a word from an amplifier, which sends PULSE every 10 ms, after which it is lost."""
GIVEN_UP = 0.1
"""s since the last word from amplifiers, after which they are not taken to play any more."""
QUEUED = 50e-3
"""s of packets on their way to the wire, beyond which no HEARTBEAT is sent (SPEC.md, 14)."""
HELD = 2e-3
"""s of packets that may wait for the wire while another is given to it."""
REASON = 1
"""Of an ESTOP, as STATUS tells it: a host's."""
LATCHED = (State.ESTOP, State.FAULT)
MOVING = (State.RUNNING, State.RAMPDOWN)


AGAIN: dict[int, SessionPhase] = {
    NakCode.TIME: SessionPhase.START,
    NakCode.NOT_ARMED: SessionPhase.ARM,
}
"""Where a START that came too late, or after the watchdog, goes on."""


class LinkSession:
    """What is said on one link.

    Parameters
    ----------
    wiring : what the amplifiers drive; its sample rate is replaced by the plan's
    token : session on the wire, 1 … 65535
    choose : makes the plan from the amplifiers' CAPS, once; may raise InputError
    counters : of the bus
    nodes : of the amplifiers, in the order of channels; all that answer, if not given
    rearm : whether it may arm again what went to 0 V by itself
    lead : by which samples go ahead [s]; None for one that goes with underruns

    Attributes
    ----------
    phase, want, peers, plan : as they are now
    stream : there once the plan is
    trouble : one line on what is wrong; empty where nothing is
    refusal : why what was wanted last cannot be; empty where it can
    error : of a display that asks for more than there is
    fragments : what is amiss though it plays on
    tripped : an amplifier is in ESTOP or FAULT though nobody here asked for it
    """

    def __init__(
        self,
        wiring: Wiring,
        *,
        token: int,
        choose: Callable[[Sequence[m.Caps]], Plan],
        counters: BusCounters,
        nodes: Sequence[int] = (),
        rearm: bool = False,
        lead: float | None = None,
    ) -> None:
        self.wiring, self.token, self.rearm, self._lead = wiring, token, rearm, lead
        self.peers = [Peer(token, node) for node in nodes]
        self.plan: Plan | None = None
        self.stream: LinkStream | None = None
        self.phase, self.want = SessionPhase.DOWN, Want.READY
        self.trouble = self.refusal = ""
        self.fragments = FragmentWatch()
        self.error: InputError | None = None
        self.tripped = False
        self.carriers: Floats = np.zeros(0)
        self._choose, self._counters = choose, counters
        self._found: dict[int, m.Caps] = {}
        self._until = self._wire_free = self._known_to_run = -math.inf
        self._first: int | None = None
        self._quick = self._owes_heartbeat = self._gave_up = False
        self._heartbeat = -math.inf
        self._seq = 0
        self._endings: dict[SessionPhase, Callable[[float], None]] = {
            SessionPhase.GREET: self._after_greet,
            SessionPhase.CLOCK: self._after_clock,
            SessionPhase.HALT: self._after_halt,
            SessionPhase.LIMIT: self._after_limit,
            SessionPhase.READY: self._after_ready,
            SessionPhase.ARM: self._after_arm,
            SessionPhase.START: self._after_start,
            SessionPhase.RUN: self._after_run,
            SessionPhase.END: self._after_end,
            SessionPhase.ESTOP: self._after_estop,
            SessionPhase.TRIPS: self._after_trips,
            SessionPhase.CLEAR: self._after_clear,
            SessionPhase.DISARM: self._after_disarm,
        }

    # What is wanted

    def connected(self, now: float) -> None:
        """Begin anew on a wire that was just opened."""
        self._wire_free = now
        self._found.clear()
        for peer in self.peers:
            peer.reconnected()
        self._enter(SessionPhase.GREET if self.peers else SessionPhase.SEARCH, now)

    def disconnected(self, now: float, why: str) -> None:
        """Take the wire as gone."""
        self.trouble = why
        if self.stream is not None:
            self.stream.freeze(now)
        if any(peer.forgot for peer in self.peers):
            self._known_to_run = -math.inf
        elif self.phase is SessionPhase.RUN:
            self._known_to_run = min(peer.heard for peer in self.peers)
        self.phase = SessionPhase.DOWN
        if self.want is Want.RUN and self._first is not None:
            self.want, self.refusal = Want.READY, why

    def run(self, position: int) -> None:
        """Play from a position on; nothing to do in an e-stop."""
        if self.want is Want.ESTOP:
            return
        self._first, self.want, self.refusal, self.trouble = position, Want.RUN, "", ""
        self._gave_up = False
        self.fragments.warning = ""

    def end(self, now: float, *, quick: bool) -> None:
        """Ramp to 0 V; nothing to do in an e-stop."""
        if self.want is Want.ESTOP:
            return
        self.want, self._quick = Want.READY, quick
        if self.stream is not None:
            self.stream.clear(wanted=True)
        if self.phase in (SessionPhase.ARM, SessionPhase.START, SessionPhase.RUN):
            self._enter(SessionPhase.END, now)

    def estop(self, now: float) -> Packet:
        """Stop for good; return the packet that is to overtake all others."""
        self.want, self.refusal, self._gave_up = Want.ESTOP, "", False
        if self.stream is not None:
            self.stream.clear(wanted=True)
        if self.phase not in (SessionPhase.DOWN, SessionPhase.SEARCH):
            self._enter(SessionPhase.ESTOP, now)
        return self._to_all(m.Estop(REASON))

    def clear(self, now: float) -> None:
        """End an e-stop or a fault."""
        self.want, self.refusal, self.tripped, self._gave_up = Want.READY, "", False, False
        if self.phase is not SessionPhase.DOWN:
            self._enter(SessionPhase.TRIPS, now)

    def gives_up(self, now: float) -> bool:
        """Decide whether what was played is over; tell whether it takes a `run` to play again."""
        goes_on = self.phase is SessionPhase.RUN or self.rearm or self._first is not None
        if self.want is Want.RUN and not goes_on and now > self._known_to_run + GIVEN_UP:
            self._give_up(self.trouble)
        return self.want is not Want.RUN

    def known_to_run(self, now: float) -> bool:
        """Tell whether all amplifiers play, as they said not long ago."""
        return self.phase is SessionPhase.RUN and all(
            peer.state is State.RUNNING and now <= peer.heard + GIVEN_UP for peer in self.peers
        )

    @property
    def latched(self) -> list[Peer]:
        """Amplifiers that are in ESTOP or FAULT, as far as they have said."""
        return [peer for peer in self.peers if peer.state in LATCHED]

    def leave(self) -> None:
        """Disarm, once ready."""
        self.want = Want.GONE

    def alive(self, now: float) -> None:
        """Tell that the loop that renders is alive: it is who feeds the watchdog."""
        self._owes_heartbeat |= now - self._heartbeat >= HEARTBEAT_MS * 1e-3

    # What comes and goes

    def receive(self, packets: list[Packet], now: float, dropped: int) -> None:
        """Take what came, and how many fragments the wire has dropped so far."""
        known = {peer.host.node: peer for peer in self.peers}
        for packet in packets:
            if packet.flags >> 6 != MAJOR:
                self.refusal = (
                    f"node {packet.node} speaks version {packet.flags >> 6} of the protocol, "
                    f"this host {MAJOR}; update the older of the two"
                )
            elif packet.node in known:
                known[packet.node].receive(packet, now)
            elif self.phase is SessionPhase.SEARCH and packet.type == m.Caps.TYPE and packet.node:
                caps = m.Caps.unpack(packet.payload)
                if caps is not None:
                    self._found[packet.node] = caps
        if self.stream is not None:
            self.stream.control(now, running=self.phase is SessionPhase.RUN)
        told = [peer.host.status for peer in self.peers if peer.host.status is not None]
        self.fragments.look(dropped + sum(status.fragments_dropped for status in told), now)

    def poll(self, now: float, wire: Wire) -> None:
        """Hand to the wire what is to be sent now."""
        self._advance(now)
        out = []
        if self.phase is SessionPhase.SEARCH and self._due(now, SEARCH):
            out.append(self._to_all(m.Hello(0, m.MAJOR, m.MINOR, m.SCHEMA_CRC)))
        heard = self.phase.value > SessionPhase.GREET.value
        if heard and self._owes_heartbeat and max(self._wire_free - now, wire.waited()) < QUEUED:
            self._owes_heartbeat, self._heartbeat = False, now
            out.append(self._to_all(m.Heartbeat(self.token)))
        for peer in self.peers:
            out += peer.poll(now)
        self._send(out, now, wire)
        if self.phase is SessionPhase.RUN and self.stream is not None:
            while now >= self._wire_free - HELD and (part := self.stream.take(now)):
                self._send(part, now, wire)

    def _send(self, packets: list[Packet], now: float, wire: Wire) -> None:
        for packet in packets:
            self._wire_free = max(self._wire_free, now) + wire.send(packet)

    @property
    def deadline(self) -> float:
        """Host time at which `poll` is next to be called, if nothing comes before [s]."""
        stream = math.inf
        if self.phase is SessionPhase.RUN and self.stream is not None:
            stream = max(self.stream.deadline, self._wire_free - HELD)
        return min([peer.deadline for peer in self.peers] + [self._until, stream])

    def lost(self, now: float) -> str:
        """Return why the link is to be taken as broken; empty where it is not."""
        if any(peer.lost for peer in self.peers):
            return "the amplifier does not answer"
        if self.phase.value > SessionPhase.GREET.value and self.phase is not SessionPhase.GONE:
            for peer in self.peers:
                if peer.forgot:
                    return f"node {peer.host.node} was reset: {peer.forgot}"
            silent = [peer.host.node for peer in self.peers if now - peer.heard > SILENCE]
            if silent:
                return f"node {silent[0]} has been silent for {SILENCE * 1e3:.0f} ms"
        return ""

    def _to_all(self, message: Message) -> Packet:
        self._seq = (self._seq + 1) & 0xFF
        return Packet.of(message, seq=self._seq)

    def _due(self, now: float, interval: float) -> bool:
        """Tell whether it is time, and set the next."""
        if now < self._until:
            return False
        self._until = now + interval
        return True

    # Phases

    def _enter(self, phase: SessionPhase, now: float) -> None:
        """Begin a phase: ask what it asks."""
        self.phase, self._until = phase, math.inf
        if phase is SessionPhase.SEARCH:
            self._until = now
        requests: dict[SessionPhase, Callable[[], list[Message]]] = {
            SessionPhase.GREET: self._greeting,
            SessionPhase.HALT: lambda: [m.Stop(self.token, 1)],
            SessionPhase.ARM: self._arming,
            SessionPhase.END: lambda: [m.Stop(self.token, int(self._quick)), m.Poll()],
            SessionPhase.ESTOP: lambda: [m.Estop(REASON), m.Poll()],
            SessionPhase.TRIPS: lambda: [m.Poll()],
            SessionPhase.DISARM: lambda: [m.Disarm(self.token)],
        }
        asked = requests.get(phase)
        for peer in self.peers:
            if phase is SessionPhase.LIMIT:
                peer.ask(self._limits(peer.caps))
            elif phase is SessionPhase.CLEAR:
                status = peer.host.status or m.Status()
                peer.ask(m.ClearFault(self.token, status.trips))
            else:
                peer.ask(*(asked() if asked is not None else []))
        if phase is SessionPhase.START:
            self._starting(now)

    def _greeting(self) -> list[Message]:
        hello = m.Hello(self.token, m.MAJOR, m.MINOR, m.SCHEMA_CRC)
        return [*([m.Estop(REASON)] if self.want is Want.ESTOP else []), hello, m.Poll()]

    def _arming(self) -> list[Message]:
        assert self.plan is not None
        rate = round(self.plan.sample_rate)
        if not self.plan.carriers:
            return [m.Arm(self.token, Mode.PCM, rate)]
        increments = spectrum.increments(self.carriers, rate)
        carriers = m.Carriers(self.token, len(increments), increments.astype("<u4").tobytes())
        return [carriers, m.Arm(self.token, Mode.SPECTRUM, rate)]

    def _limits(self, caps: m.Caps) -> m.Limits:
        """Return the display's limits: no more than the amplifier's, which `_fits` has seen to."""
        w = self.wiring
        return m.Limits(
            self.token,
            min(int(w.voltage * 1e6), caps.voltage_limit_uv),
            min(int(w.slew), caps.slew_limit_v_per_s),
            min(max(round(w.fade * 1e6), 1), caps.fade_limit_us),
        )

    def _starting(self, now: float) -> None:
        assert self.stream is not None
        time = now + AHEAD
        position = self.stream.position_at(time) if self._first is None else self._first
        if self._first is None:
            time = self.stream.due(position)
        starts = self.stream.begin(position, time, fade_in=self._first is None)
        for peer, start in zip(self.peers, starts, strict=True):
            peer.ask(start)

    def _advance(self, now: float) -> None:
        """Leave the phases whose time has come."""
        before = None
        while before is not self.phase:
            before = self.phase
            if self.phase is SessionPhase.SEARCH:
                if self._found and now >= self._until:
                    self.peers = [Peer(self.token, node) for node in sorted(self._found)]
                    self._enter(SessionPhase.GREET, now)
            elif any(peer.lost for peer in self.peers):
                return  # `lost` says so, and the wire is let go of
            elif self.phase not in (SessionPhase.DOWN, SessionPhase.GONE) and all(
                p.idle for p in self.peers
            ):
                refused = [p.refused for p in self.peers if p.refused is not None]
                if refused:
                    self._refused(refused[0], now)
                else:
                    self._endings[self.phase](now)

    def _refused(self, nak: m.Nak, now: float) -> None:
        """Act on what an amplifier would not do; one that was reset is seen to by `lost`."""
        if nak.code == NakCode.SESSION:
            return
        if self.phase is SessionPhase.GREET and nak.code == NakCode.BUSY:
            self.trouble = "another host holds the amplifier"
            self._wait(SessionPhase.GREET, now)
        elif self.phase is SessionPhase.START and nak.code in AGAIN:
            self._enter(AGAIN[nak.code], now)
        elif self.phase is SessionPhase.CLEAR and nak.code == NakCode.STATE:
            self._wait(SessionPhase.TRIPS, now)
        else:
            self.refusal = INPUT_OPEN if nak.code == NakCode.INPUT_OPEN else refusal(nak)
            if self.want is Want.RUN:
                self.want = Want.READY
            self._enter(SessionPhase.DISARM if self.want is Want.GONE else SessionPhase.READY, now)

    def _wait(self, phase: SessionPhase, now: float) -> None:
        """Enter a phase again after a while."""
        if self._until == math.inf:
            self._until = now + RETRY
        elif now >= self._until:
            self._enter(phase, now)

    def _after_greet(self, now: float) -> None:
        for peer in self.peers:
            peer.greeted()
        if self.plan is None:
            try:
                self._fit([peer.caps for peer in self.peers])
            except InputError as error:
                self.refusal, self.error = str(error), error
                self._enter(SessionPhase.GONE, now)
                return
        self._enter(SessionPhase.CLOCK, now)

    def _fit(self, caps: Sequence[m.Caps]) -> None:
        """See that the display's demands are within what the amplifiers can; make the plan."""
        check_limits(self.wiring, caps)
        self.plan = self._choose(caps)
        self.wiring = replace(self.wiring, sample_rate=float(self.plan.sample_rate))
        w = self.wiring
        self.stream = LinkStream(self.peers, self.plan, w.channels, self._counters, self._lead)

    def _after_clock(self, now: float) -> None:
        if not all(peer.locked for peer in self.peers):
            return
        states = [peer.state for peer in self.peers]
        resumed = not self.gives_up(now) and self._first is None
        if resumed and self.stream is not None and set(states) == {State.RUNNING}:
            self.stream.resume()
            self.trouble = ""
            self._enter(SessionPhase.RUN, now)
        elif any(state in MOVING for state in states):
            self._enter(SessionPhase.HALT, now)
        else:
            self._enter(SessionPhase.LIMIT, now)

    def _after_halt(self, now: float) -> None:
        if not self._moving:
            self._enter(SessionPhase.LIMIT, now)

    def _after_limit(self, now: float) -> None:
        self.trouble = ""
        if self._gave_up or (self.want is Want.RUN and self._first is None and not self.rearm):
            self._give_up("the link was lost and is back")
        self._enter(SessionPhase.READY, now)

    def _after_ready(self, now: float) -> None:
        latched = self.latched
        if self.want is Want.ESTOP:
            self._enter(SessionPhase.ESTOP, now)
        elif self.want is Want.GONE:
            self._enter(SessionPhase.DISARM, now)
        elif latched:
            if not self.tripped:
                self.tripped = True
                for peer in latched:
                    peer.ask(m.Poll())
            self.trouble = open_input(self.peers, now) or why_stopped(latched[0])
            if self.want is Want.RUN:
                self.want, self.refusal = Want.READY, self.trouble
        elif self.want is Want.RUN:
            self._enter(SessionPhase.ARM, now)

    def _after_arm(self, now: float) -> None:
        self._enter(SessionPhase.START, now)

    def _after_start(self, now: float) -> None:
        for peer in self.peers:
            peer.assume(State.RUNNING)
        self._first, self.trouble = None, ""
        self._enter(SessionPhase.RUN, now)

    def _after_run(self, now: float) -> None:
        fallen = [peer for peer in self.peers if peer.state is not State.RUNNING]
        if not fallen:
            return
        if self.stream is not None:
            self.stream.freeze(now)
        self.trouble = why_stopped(fallen[0])
        if any(peer.state in LATCHED for peer in fallen):
            self.tripped = True
        elif not self.rearm:
            self._give_up(self.trouble)
        self._quick = False
        self._enter(SessionPhase.END, now)

    def _give_up(self, why: str) -> None:
        self.want, self._gave_up = Want.READY, True
        self.trouble = f"{why}; not armed again, since nobody said so: start again, or rearm=true"

    def _after_end(self, now: float) -> None:
        if not self._moving:
            if self.stream is not None:
                self.stream.freeze(now)
            self._enter(SessionPhase.READY, now)

    def _after_estop(self, now: float) -> None:
        if self.want is Want.GONE:
            self._enter(SessionPhase.DISARM, now)
        elif any(peer.state is not State.ESTOP for peer in self.peers):
            self._enter(SessionPhase.ESTOP, now)
        else:
            self.trouble = open_input(self.peers, now)

    def _after_trips(self, now: float) -> None:
        self._enter(SessionPhase.CLEAR, now)

    def _after_clear(self, now: float) -> None:
        self._enter(SessionPhase.GREET, now)

    def _after_disarm(self, now: float) -> None:
        if not self._moving:
            self._enter(SessionPhase.GONE, now)

    @property
    def _moving(self) -> bool:
        return any(peer.state in MOVING for peer in self.peers)
