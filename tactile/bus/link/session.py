"""Session with the amplifiers of one link, from HELLO to DISARM: what to send, and when.

The session does not wait and has no clock. The owner of the wire passes what was received to
`LinkSession.receive`, and calls `LinkSession.poll` to send. The session moves from phase to phase
toward its goal; a phase ends when all amplifiers have answered its requests. Failures
are reported by `trouble` and, if they end the goal, by `refusal`. Nothing raises but the
wire, in `LinkSession.poll`.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.capabilities import caps_fault
from firmware_protocol.host import BY_HOST, refusal
from firmware_protocol.messages import (
    HEARTBEAT_MS,
    MAJOR,
    WATCHDOG_MS,
    Message,
    Mode,
    NakCode,
    State,
)
from firmware_protocol.packet import Packet
from tactile.arrays import Floats
from tactile.bus.amplifier_guards import AmplifierGuards
from tactile.bus.base import Wiring
from tactile.bus.budget import Plan, check_limits, guard_group
from tactile.bus.correlations import MeasurementQueue, WindowDecoder
from tactile.bus.guards import GuardSettings
from tactile.bus.link.notes import LinkNotes
from tactile.bus.link.peer import Peer
from tactile.bus.link.phases import Goal, SessionPhase
from tactile.bus.link.queries import RETRY
from tactile.bus.link.stopped import INPUT_OPEN, STOPPED_AGAIN, open_input, why_stopped
from tactile.bus.link.stream import LinkBusCounters, LinkStream
from tactile.bus.wire import FragmentWatch, Wire
from tactile.errors import InputError

SEARCH = 0.06
"""Time in which amplifiers answer a HELLO to all nodes; it is repeated while none does [s]."""
AHEAD = 30e-3
"""Time from START to the first sample [s]."""
SILENCE = 0.25
"""Time without a packet from an amplifier, which sends PULSE every 10 ms, after which the link
counts as lost [s]."""
GIVEN_UP = 0.1
"""Time since the last packet from an amplifier after which it is not known to play [s]."""
QUEUED = 50e-3
"""Time of packets on their way to the wire beyond which no HEARTBEAT is sent, since one that waits
for longer would keep an amplifier playing for too long after the host (SPEC.md, 14) [s]."""
YIELDS = 2e-3 * WATCHDOG_MS
"""Time since the last HEARTBEAT after which no earlier token of this session holds an amplifier
(SPEC.md, 6.1), with as much again for the way there and back [s]."""
HELD = 2e-3
"""Time that packets given to the wire may still take when the next one is given to it [s]."""
LATCHED = (State.ESTOP, State.FAULT)
"""States that only CLEAR_FAULT ends."""
MOVING = (State.RUNNING, State.RAMPDOWN)
"""States in which an amplifier plays or ramps to 0 V."""


RETRY_PHASES: dict[int, SessionPhase] = {
    NakCode.TIME: SessionPhase.START,
    NakCode.NOT_ARMED: SessionPhase.ARM,
}
"""Phase in which a START is tried again that came too late, or after the watchdog, by its NAK."""


class LinkSession:
    """Session with the amplifiers of one link.

    It has no lock; `LinkBus` calls it under its own. No method waits.

    Parameters
    ----------
    wiring : Wiring
        Properties of the display that the amplifiers drive; its sample rate is replaced by that of
        the plan.
    token : int
        First session token on the wire, 1 … 65535; `clear` takes another.
    choose : callable
        Function that makes the plan from the CAPS of the amplifiers; it is called once and may
        raise InputError.
    counters : LinkBusCounters
        Counters of the bus.
    nodes : sequence of int
        Nodes of the amplifiers in the order of the channels; all that answer, in rising order, if
        empty.
    rearm : bool
        Whether it may arm an amplifier again that went to 0 V by itself.
    lead : float or None
        Time by which samples are sent before they are put out [s]; None for one that adapts to
        underruns.
    windows : MeasurementQueue or None
        Queue that takes the windows of CORRELATION and what GUARDED and MARKED report; by default
        one of its own.
    correlation_ms : int
        Length of the windows that amplifiers are asked for, as far as they correlate [ms]; 0 for
        none.

    Attributes
    ----------
    phase : SessionPhase
        Present phase.
    goal : Goal
        State that the session works toward.
    peers : list of Peer
        Amplifiers in the order of channels; empty until they have been found.
    plan : Plan or None
        How the drive is sent; None until the capabilities of the amplifiers are known.
    stream : LinkStream or None
        Samples that wait to be sent; None as long as there is no plan.
    carriers : (P,) array of float
        Frequencies of the carriers of frames [Hz]; empty until they are set.
    trouble : str
        One line on what is wrong; empty if nothing is.
    last_fault : str
        One line on the latest fault while the goal was to play, as in `BusStatus`.
    refusal : str
        Reason why the last goal cannot be reached; empty if it can.
    error : InputError or None
        Error of a display that asks for more than the amplifiers or the link can give.
    fragments : FragmentWatch
        Warning about fragments that are lost while the session goes on.
    notes : LinkNotes
        Lines for the log, which the owner writes.
    tripped : bool
        Whether an amplifier is in ESTOP or FAULT although this host did not ask for it.
    """

    def __init__(
        self,
        wiring: Wiring,
        *,
        token: int,
        choose: Callable[[Sequence[m.Caps]], Plan],
        counters: LinkBusCounters,
        nodes: Sequence[int] = (),
        rearm: bool = False,
        lead: float | None = None,
        windows: MeasurementQueue | None = None,
        correlation_ms: int = 0,
    ) -> None:
        self.wiring, self.token, self.rearm, self._lead = wiring, token, rearm, lead
        self._windows, self._correlation_ms = windows or MeasurementQueue(), correlation_ms
        self._decoders, self._guards = dict[int, WindowDecoder](), dict[int, AmplifierGuards]()
        self.peers = [Peer(token, node) for node in nodes]
        self.plan: Plan | None = None
        self.stream: LinkStream | None = None
        self.phase, self.goal = SessionPhase.DOWN, Goal.READY
        self.trouble = self.refusal = self.last_fault = ""
        self.fragments, self.notes, self._trips = FragmentWatch(), LinkNotes(), dict[int, int]()
        self.error: InputError | None = None
        self.carriers: Floats = np.zeros(0)
        self._choose, self._counters = choose, counters
        self._caps: dict[int, m.Caps] = {}
        """Capabilities of the amplifiers that answered in SEARCH, by their nodes."""
        # Host times: of the next step of the phase; at which the wire will have sent what it was
        # given; and at which all amplifiers of a link that was lost were last known to play.
        self._until = self._wire_free = self._known_to_run = -math.inf
        self._first: int | None = None
        """Position that START is to play first; None once it has been acknowledged."""
        self.tripped = self._quick = self._owes_heartbeat = self._gave_up = self._clears = False
        self._heartbeat = -math.inf
        """Host time of the last HEARTBEAT [s]."""
        self._seq = self._guard_turn = 0  # the number of GUARDs, by which amplifiers take turns
        self._fallen: Peer | None = None
        """Amplifier because of which playing ended; None after a start."""
        self._endings: dict[SessionPhase, Callable[[float], None]] = {
            SessionPhase.GREET: self._after_greet,
            SessionPhase.CLOCK: self._after_clock,
            SessionPhase.HALT: self._after_halt,
            SessionPhase.LIMIT: self._after_limit,
            SessionPhase.READY: self._after_ready,
            SessionPhase.ARM: lambda now: self._enter(SessionPhase.START, now),
            SessionPhase.START: self._after_start,
            SessionPhase.RUN: self._after_run,
            SessionPhase.END: self._after_end,
            SessionPhase.ESTOP: self._after_estop,
            SessionPhase.TRIPS: self._after_trips,
            SessionPhase.CLEAR: lambda now: self._enter(SessionPhase.GREET, now),
            SessionPhase.DISARM: self._after_disarm,
        }

    # Goals

    def connected(self, now: float) -> None:
        """Begin on a wire that was just opened.

        Parameters
        ----------
        now : float
            Host time [s].
        """
        self._wire_free = now
        self._caps.clear()
        for peer in self.peers:
            peer.reconnected()
        self._enter(SessionPhase.GREET if self.peers else SessionPhase.SEARCH, now)

    def disconnected(self, now: float, why: str) -> None:
        """Take note that there is no wire any more.

        A start that has not been acknowledged is given up; a stream that plays is not.

        Parameters
        ----------
        now : float
            Host time [s].
        why : str
            Reason, one line.
        """
        self._report_fault(why)
        if self.stream is not None:
            self.stream.freeze(now)
        if any(peer.reset_evidence for peer in self.peers):
            self._known_to_run = -math.inf
        elif self.phase is SessionPhase.RUN:
            self._known_to_run = min(peer.last_received for peer in self.peers)
        self.phase, self._clears = SessionPhase.DOWN, False
        self._forget_guards()
        if self.goal is Goal.RUN and self._first is not None:
            self.goal, self.refusal = Goal.READY, why

    def run(self, position: int) -> None:
        """Work toward playing; do nothing in an e-stop.

        Parameters
        ----------
        position : int
            Position that is put out first.
        """
        if self.goal is Goal.ESTOP:
            return
        self._first, self.goal, self.refusal, self.trouble = position, Goal.RUN, "", ""
        self._gave_up, self._fallen = False, None
        self.fragments.warning = ""

    def end(self, now: float, *, quick: bool) -> None:
        """Work toward 0 V, and drop what waits to be sent; do nothing in an e-stop.

        Parameters
        ----------
        now : float
            Host time [s].
        quick : bool
            Whether to ramp at the slew limit, and not within the fade.
        """
        if self.goal is Goal.ESTOP:
            return
        self.goal, self._quick = Goal.READY, quick
        if self.stream is not None:
            self.stream.clear(now)
        if self.phase in (SessionPhase.ARM, SessionPhase.START, SessionPhase.RUN):
            self._enter(SessionPhase.END, now)

    def estop(self, now: float) -> Packet:
        """Work toward an e-stop, which only `clear` ends, and drop what waits to be sent.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        Packet
            ESTOP to all nodes, which the caller has to send ahead of everything else.
        """
        self.goal, self.refusal, self._gave_up = Goal.ESTOP, "", False
        if self.stream is not None:
            self.stream.clear(now)
        if self.phase not in (SessionPhase.DOWN, SessionPhase.SEARCH):
            self._enter(SessionPhase.ESTOP, now)
        return self._to_all(m.Estop(BY_HOST))

    def clear(self, now: float) -> None:
        """Work toward the end of an e-stop or a fault.

        Parameters
        ----------
        now : float
            Host time [s].
        """
        self.goal, self.refusal, self.tripped, self._gave_up = Goal.READY, "", False, False
        self._renew()
        # CLEAR_FAULT follows once all amplifiers have taken the new token. It names the trips of
        # now, so that it ends no e-stop that comes until then.
        if self.phase not in (SessionPhase.DOWN, SessionPhase.SEARCH):
            self._clears = True
            self._enter(SessionPhase.TRIPS, now)

    def _renew(self) -> None:
        """Take another token: what was sent with the earlier ones is refused (SPEC.md, 6.1)."""
        self.token = self.token % 0xFFFF + 1
        for peer in self.peers:
            peer.renew(self.token)

    def gives_up(self, now: float) -> bool:
        """Decide whether playing that was interrupted is given up.

        Without leave to rearm, it is given up when the amplifiers have not been known to play for
        `GIVEN_UP`.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        bool
            Whether only `run` makes the amplifiers play again.
        """
        goes_on = self.phase is SessionPhase.RUN or self.rearm or self._first is not None
        if self.goal is Goal.RUN and not goes_on and now > self._known_to_run + GIVEN_UP:
            self._give_up(self.trouble)
        return self.goal is not Goal.RUN

    def known_to_run(self, now: float) -> bool:
        """Return whether all amplifiers are known to play.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        bool
            Whether each has reported RUNNING, and sent a packet within `GIVEN_UP`.
        """
        return self.phase is SessionPhase.RUN and all(
            peer.state is State.RUNNING and now <= peer.last_received + GIVEN_UP
            for peer in self.peers
        )

    @property
    def latched(self) -> list[Peer]:
        """Amplifiers that are in ESTOP or FAULT by their latest reports."""
        return [peer for peer in self.peers if peer.state in LATCHED]

    def finish(self) -> None:
        """Work toward the end of the session: disarm as soon as nothing plays."""
        self.goal = Goal.ENDED

    def feed_watchdog(self, now: float) -> None:
        """Record that the loop that renders is alive; it alone feeds the watchdog.

        Parameters
        ----------
        now : float
            Host time [s].
        """
        self._owes_heartbeat |= now - self._heartbeat >= HEARTBEAT_MS * 1e-3

    # What comes and goes

    def receive(self, packets: list[Packet], now: float, dropped: int) -> None:
        """Take what was received.

        Parameters
        ----------
        packets : list of Packet
            Packets in the order in which they came; may be empty.
        now : float
            Host time [s].
        dropped : int
            Number of fragments that the wire has dropped so far.
        """
        known = {peer.host.node: peer for peer in self.peers}
        for packet in packets:
            if packet.flags >> 6 != MAJOR:
                self.refusal = (
                    f"node {packet.node} speaks version {packet.flags >> 6} of the protocol, "
                    f"this host {MAJOR}; update the older of the two"
                )
            elif packet.node in known:
                known[packet.node].receive(packet, now)
                if packet.type == m.Log.TYPE and (log := m.Log.unpack(packet.payload)) is not None:
                    self.notes.add_log(packet.node, log, now)
                elif packet.type == m.Correlation.TYPE:
                    self._add_window(known[packet.node], packet, now)
                elif packet.type == m.Guarded.TYPE:
                    self._add_report(known[packet.node], packet, now)
                elif packet.type == m.Marked.TYPE:
                    self._add_mark(known[packet.node], packet)
            elif self.peers and packet.type in (m.Pulse.TYPE, m.Status.TYPE):
                self.notes.add_stranger(packet.node, known, now)
            elif self.phase is SessionPhase.SEARCH and packet.type == m.Caps.TYPE and packet.node:
                caps = m.Caps.unpack(packet.payload)
                if caps is not None:
                    self._caps[packet.node] = caps
        if self.stream is not None:
            self._control(self.stream, now)
        self._windows.counters.disturbed = sum(peer.disturbed for peer in self.peers)
        reports = [peer.host.status for peer in self.peers if peer.host.status is not None]
        self.fragments.update(dropped + sum(status.fragments_dropped for status in reports), now)

    def _add_window(self, peer: Peer, packet: Packet, now: float) -> None:
        """Pass a window of CORRELATION on; one that nobody asked for, or before START, is wrong."""
        message = m.Correlation.unpack(packet.payload)
        decoder = self._decoders.get(peer.host.node)
        if message is None or decoder is None or not self._correlation_ms:
            self._windows.counters.faults += 1
            return
        position = peer.position_of(message.position, now)
        window = decoder.decode(message, peer.caps, position, self._first_channel(peer))
        if window is not None:
            self._windows.add(window)

    def _first_channel(self, peer: Peer) -> int:
        """Return the channel of the display to which the first one of an amplifier belongs."""
        return sum(each.caps.channels for each in self.peers[: self.peers.index(peer)])

    def _add_report(self, peer: Peer, packet: Packet, now: float) -> None:
        """Pass what guards report on; what comes before the first START is of no concern."""
        message, guards = m.Guarded.unpack(packet.payload), self._guards.get(peer.host.node)
        if guards is None:
            return
        if message is None or not self._correlation_ms:
            self._windows.counters.faults += 1
            return
        position = peer.position_of(message.position, now)
        report = guards.decode(message, position, peer.reached(now))
        if report is not None:
            self._windows.add(report)

    def _add_mark(self, peer: Peer, packet: Packet) -> None:
        """Pass on that a mark was shown, if it is one of the stream."""
        message = m.Marked.unpack(packet.payload)
        if message is None or self.stream is None:
            return
        report = self.stream.marked(peer, message)
        if report is not None:
            self._windows.add(report)

    def set_guards(self, settings: GuardSettings) -> None:
        """Let settings of guards wait until the stream leaves the wire time for them.

        Only settings that come while the amplifiers play are kept, for those with guards.

        Parameters
        ----------
        settings : GuardSettings
            Settings of channels of the display.
        """
        if self.phase is not SessionPhase.RUN:
            return
        for peer in self.peers:
            guards = self._guards.get(peer.host.node)
            if guards is not None and peer.guards:
                guards.set(settings, self._decoders[peer.host.node].range_ua)

    def _control(self, stream: LinkStream, now: float) -> None:
        """Let the stream count what was reported, and note the first credit that is wrong."""
        before = self._counters.credit_faults
        stream.control(now, running=self.phase is SessionPhase.RUN)
        if self._counters.credit_faults and not before:
            peer = max(self.peers, key=lambda peer: peer.credit_faults)
            self.notes.add(
                logging.WARNING,
                f"node {peer.host.node}: the credit_position of its PULSE is more than "
                f"fifo_samples ({peer.caps.fifo_samples}) from that by its clock (SPEC.md, 8.1); "
                "correct its firmware",
                now,
            )

    def poll(self, now: float, wire: Wire) -> None:
        """Move on to the next phases, and send what is to be sent now.

        Parameters
        ----------
        now : float
            Host time [s].
        wire : Wire
            Wire that is not busy.

        Raises
        ------
        OSError
            If the wire is broken.
        """
        self._advance(now)
        out = []
        if self.phase is SessionPhase.SEARCH and self._due(now, SEARCH):
            out.append(self._to_all(m.Hello(0, m.MAJOR, m.MINOR, m.SCHEMA_CRC)))
        greeted = self.phase.value > SessionPhase.GREET.value
        if greeted and self._owes_heartbeat and max(self._wire_free - now, wire.waited()) < QUEUED:
            self._owes_heartbeat, self._heartbeat = False, now
            out.append(self._to_all(m.Heartbeat(self.token)))
        for peer in self.peers:
            out += peer.poll(now)
        self._send(out, now, wire)
        if self.phase is SessionPhase.RUN and self.stream is not None:
            while now >= self._wire_free - HELD and (part := self.stream.take(now)):
                self._send(part, now, wire)
            if self.stream.no_credit:
                self.last_fault = self.stream.no_credit
            self._send_guards(now, wire)

    def _send_guards(self, now: float, wire: Wire) -> None:
        """Send settings of guards, which nobody confirms, after all else, packet by packet."""
        most = guard_group(wire.link) if self._guards_wait else 0
        while self._guards_wait and now >= self._wire_free - HELD and not wire.busy:
            self._send(self._next_guard(most), now, wire)

    @property
    def _guards_wait(self) -> bool:
        """Whether settings of guards wait; an e-stop, also in a signal handler, ends that."""
        return any(guards.waits for guards in self._guards.values())

    def _forget_guards(self) -> None:
        """Drop the settings of guards that wait."""
        for guards in self._guards.values():
            guards.forget()

    def _next_guard(self, most: int) -> list[Packet]:
        """Return a GUARD to the next amplifier for which one waits."""
        for turn in range(self._guard_turn, self._guard_turn + len(self.peers)):
            peer = self.peers[turn % len(self.peers)]
            guards = self._guards.get(peer.host.node)
            if guards is not None and (message := guards.take(self.token, most)):
                self._guard_turn = turn + 1
                return [peer.host.packet(message)]
        return []

    def _send(self, packets: list[Packet], now: float, wire: Wire) -> None:
        """Send packets, and note when the wire will have sent them."""
        for packet in packets:
            self._wire_free = max(self._wire_free, now) + wire.send(packet)

    @property
    def deadline(self) -> float:
        """Host time at which `poll` is to be called next, if nothing is received before [s]."""
        stream = math.inf
        if self.phase is SessionPhase.RUN and self.stream is not None:
            first = -math.inf if self._guards_wait else self.stream.deadline
            stream = max(first, self._wire_free - HELD)
        return min([peer.deadline for peer in self.peers] + [self._until, stream])

    def lost(self, now: float) -> str:
        """Return why the link counts as broken.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        str
            Reason, one line; empty if the link works.
        """
        if any(peer.lost for peer in self.peers):
            foreign = self._caps_fault() if self.phase is SessionPhase.GREET else ""
            return foreign or "the amplifier does not answer"
        if self.phase.value > SessionPhase.GREET.value and self.phase is not SessionPhase.ENDED:
            for peer in self.peers:
                if peer.reset_evidence:
                    return f"node {peer.host.node} was reset: {peer.reset_evidence}"
            silent = [peer.host.node for peer in self.peers if now - peer.last_received > SILENCE]
            if silent:
                return f"node {silent[0]} has been silent for {SILENCE * 1e3:.0f} ms"
        return ""

    def _to_all(self, message: Message) -> Packet:
        """Return the packet of a message to all nodes."""
        self._seq = (self._seq + 1) & 0xFF
        return Packet.of(message, seq=self._seq)

    def _due(self, now: float, interval: float) -> bool:
        """Return whether the time of the phase's next step has come; if so, set the one after."""
        if now < self._until:
            return False
        self._until = now + interval
        return True

    # Phases

    def _enter(self, phase: SessionPhase, now: float) -> None:
        """Begin a phase: make its requests to all amplifiers."""
        self.phase, self._until = phase, math.inf
        self._forget_guards()
        if phase is SessionPhase.SEARCH:
            self._until = now
        requests: dict[SessionPhase, Callable[[], list[Message]]] = {
            SessionPhase.GREET: self._greeting,
            SessionPhase.HALT: lambda: [m.Stop(self.token, 1)],
            SessionPhase.ARM: self._arming,
            SessionPhase.END: lambda: [m.Stop(self.token, int(self._quick)), m.Poll()],
            SessionPhase.ESTOP: lambda: [m.Estop(BY_HOST), m.Poll()],
            SessionPhase.TRIPS: lambda: [m.Poll()],
            SessionPhase.DISARM: lambda: [m.Disarm(self.token)],
        }
        messages = requests.get(phase)
        for peer in self.peers:
            if phase is SessionPhase.LIMIT:
                peer.request(self._limits(peer.caps))
            elif phase is SessionPhase.CLEAR:
                peer.request(m.ClearFault(self.token, self._trips[peer.host.node]))
            else:
                peer.request(*(messages() if messages is not None else []))
        if phase is SessionPhase.START:
            self._starting(now)
        elif phase is SessionPhase.ARM:
            self._ask_for_windows()

    def _ask_for_windows(self) -> None:
        """Ask amplifiers for windows of CORRELATION that have not answered that yet."""
        for peer in self.peers:
            if self._correlation_ms and peer.settings.answer is None:
                peer.ask_for_windows(self._correlation_ms)

    def _greeting(self) -> list[Message]:
        """Return the requests that take an amplifier; first of all ESTOP, if that is the goal."""
        hello = m.Hello(self.token, m.MAJOR, m.MINOR, m.SCHEMA_CRC)
        return [*([m.Estop(BY_HOST)] if self.goal is Goal.ESTOP else []), hello, m.Poll()]

    def _arming(self) -> list[Message]:
        """Return the requests that switch high voltage on, and set the carriers of frames."""
        assert self.plan is not None
        rate = round(self.plan.sample_rate)
        if not self.plan.carriers:
            return [m.Arm(self.token, Mode.PCM, rate)]
        increments = spectrum.increments(self.carriers, rate)
        carriers = m.Carriers(self.token, len(increments), increments.astype("<u4").tobytes())
        return [carriers, m.Arm(self.token, Mode.SPECTRUM, rate)]

    def _limits(self, caps: m.Caps) -> m.Limits:
        """Return the limits of the display, none of which is above that of the amplifier.

        `check_limits` refuses a display whose voltage or slew limit is higher. A longer fade is cut
        to that of the amplifier.
        """
        wiring = self.wiring
        return m.Limits(
            self.token,
            min(int(wiring.voltage * 1e6), caps.voltage_limit_uv),
            min(int(wiring.slew), caps.slew_limit_v_per_s),
            min(max(round(wiring.fade * 1e6), 1), caps.fade_limit_us),
        )

    def _starting(self, now: float) -> None:
        """Request START of all amplifiers, at a position that is due soon if playing goes on."""
        assert self.stream is not None
        time = now + AHEAD
        position = self.stream.position_at(time) if self._first is None else self._first
        if self._first is None:
            time = self.stream.due(position)
        starts = self.stream.begin(position, time, fade_in=self._first is None)
        self._decoders = {
            peer.host.node: WindowDecoder(self._windows.counters, start.position)
            for peer, start in zip(self.peers, starts, strict=False)
        }
        self._guards = {
            peer.host.node: AmplifierGuards(
                self._windows.counters, peer.caps, self._first_channel(peer), position
            )
            for peer in self.peers
        }
        for peer, start in zip(self.peers, starts, strict=True):
            peer.request(start)

    def _advance(self, now: float) -> None:
        """End each phase whose requests have been answered, until one has not."""
        previous = None
        while previous is not self.phase:
            previous = self.phase
            if self.phase is SessionPhase.SEARCH:
                if self._caps and now >= self._until:
                    self.peers = [Peer(self.token, node) for node in sorted(self._caps)]
                    self._enter(SessionPhase.GREET, now)
            elif any(peer.lost for peer in self.peers):
                return  # `lost` reports it, and the owner closes the wire
            elif self.phase not in (SessionPhase.DOWN, SessionPhase.ENDED) and all(
                p.idle for p in self.peers
            ):
                refused = [p.refused for p in self.peers if p.refused is not None]
                if refused:
                    self._refused(refused[0], now)
                else:
                    self._endings[self.phase](now)

    def _refused(self, nak: m.Nak, now: float) -> None:
        """Act on a refusal; that of an amplifier that was reset is reported by `lost`."""
        if nak.code == NakCode.SESSION:
            return
        if self.phase is SessionPhase.GREET and nak.code == NakCode.BUSY:
            if now > self._heartbeat + YIELDS:
                self.trouble = "another host holds the amplifier"
            self._wait(SessionPhase.GREET, now)
        elif self.phase is SessionPhase.START and nak.code in RETRY_PHASES:
            self._enter(RETRY_PHASES[nak.code], now)
        else:
            reasons: dict[int, str] = {NakCode.INPUT_OPEN: INPUT_OPEN}
            if self.phase is SessionPhase.CLEAR:  # HELLO was taken, so that the output is at 0 V
                reasons[NakCode.STATE] = STOPPED_AGAIN
            self.refusal = reasons.get(nak.code) or refusal(nak)
            if self.goal is Goal.RUN:
                self.goal, self.last_fault = Goal.READY, self.refusal
            self._enter(SessionPhase.DISARM if self.goal is Goal.ENDED else SessionPhase.READY, now)

    def _wait(self, phase: SessionPhase, now: float) -> None:
        """Enter a phase after `RETRY`; it is called repeatedly until then."""
        if self._until == math.inf:
            self._until = now + RETRY
        elif now >= self._until:
            self._enter(phase, now)

    def _after_greet(self, now: float) -> None:
        """Take the amplifiers if their CAPS is right; else ask again, or refuse at the opening."""
        if fault := self._caps_fault():
            self._report_fault(fault)
            if self.plan is None:
                self.refusal = fault
            self._wait(SessionPhase.GREET, now)
            return
        for peer in self.peers:
            peer.greeted()
            peer.settings.forget()
        self._ask_for_windows()
        if self.plan is None:
            try:
                self._fit([peer.caps for peer in self.peers])
            except InputError as error:
                self.refusal, self.error = str(error), error
                self._enter(SessionPhase.ENDED, now)
                return
        self._enter(SessionPhase.CLEAR if self._clears else SessionPhase.CLOCK, now)
        self._clears = False

    def _caps_fault(self) -> str:
        """Return what is wrong with the CAPS of an amplifier, one line; empty if nothing is."""
        for peer in self.peers:
            if peer.host.caps is not None and (fault := caps_fault(peer.host.caps, self.token)):
                return f"node {peer.host.node}: {fault}"
        return ""

    def _fit(self, caps: Sequence[m.Caps]) -> None:
        """Make the plan and the stream; raise InputError if the display asks for too much."""
        check_limits(self.wiring, caps)
        self.plan = self._choose(caps)
        self.wiring = replace(self.wiring, sample_rate=float(self.plan.sample_rate))
        wiring = self.wiring
        self.stream = LinkStream(self.peers, self.plan, wiring.channels, self._counters, self._lead)

    def _after_clock(self, now: float) -> None:
        """Resume playing if all amplifiers played on while the link was lost; else stop them."""
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
        if self._gave_up or (self.goal is Goal.RUN and self._first is None and not self.rearm):
            self._give_up("the link was lost and is back")
        self._enter(SessionPhase.READY, now)

    def _after_ready(self, now: float) -> None:
        """Leave READY for the goal; do not play while an amplifier is latched."""
        latched = self.latched
        if self.goal is Goal.ESTOP:
            self._enter(SessionPhase.ESTOP, now)
        elif self.goal is Goal.ENDED:
            self._enter(SessionPhase.DISARM, now)
        elif latched:
            if not self.tripped:
                self.tripped = True
                for peer in latched:
                    peer.request(m.Poll())
            self.trouble = open_input(self.peers, now) or why_stopped(latched[0])
            if self._fallen in latched:  # STATUS names the cause, and comes after the state
                self.last_fault = why_stopped(self._fallen)
            if self.goal is Goal.RUN:
                self.goal, self.refusal = Goal.READY, self.trouble
        elif self.goal is Goal.RUN:
            self._enter(SessionPhase.ARM, now)

    def _after_start(self, now: float) -> None:
        for peer in self.peers:
            peer.assume(State.RUNNING)
        self._first, self.trouble = None, ""
        self._enter(SessionPhase.RUN, now)

    def _after_run(self, now: float) -> None:
        """End playing on all amplifiers when one does not run any more."""
        fallen = [peer for peer in self.peers if peer.state is not State.RUNNING]
        if not fallen:
            return
        if self.stream is not None:
            self.stream.freeze(now)
        self._fallen = next((peer for peer in fallen if peer.state in LATCHED), fallen[0])
        self._report_fault(why_stopped(self._fallen))
        if self._fallen.state in LATCHED:
            self.tripped = True
        elif not self.rearm:
            self._give_up(self.trouble)
        self._quick = False
        self._enter(SessionPhase.END, now)

    def _report_fault(self, why: str) -> None:
        """Report what is wrong, which lets no samples be put out if the goal is to play."""
        self.trouble = why
        if self.goal is Goal.RUN:
            self.last_fault = why

    def _give_up(self, why: str) -> None:
        """Work toward READY in place of playing, since rearming is not allowed."""
        self.goal, self._gave_up = Goal.READY, True
        self.trouble = f"{why}; not armed again, since nobody said so: start again, or rearm=true"

    def _after_end(self, now: float) -> None:
        if not self._moving:
            if self.stream is not None:
                self.stream.freeze(now)
            self._enter(SessionPhase.READY, now)

    def _after_trips(self, now: float) -> None:
        """Keep the trips that CLEAR_FAULT will name, and take the amplifiers anew."""
        statuses = {peer.host.node: peer.host.status for peer in self.peers}
        self._trips = {node: status.trips for node, status in statuses.items() if status}
        self._enter(SessionPhase.GREET, now)

    def _after_estop(self, now: float) -> None:
        """Repeat ESTOP until all amplifiers report it; leave the phase only to disarm."""
        if self.goal is Goal.ENDED:
            taken = all(peer.taken for peer in self.peers)
            self._enter(SessionPhase.DISARM if taken else SessionPhase.ENDED, now)
        elif any(peer.state is not State.ESTOP for peer in self.peers):
            self._enter(SessionPhase.ESTOP, now)
        else:
            self.trouble = open_input(self.peers, now)

    def _after_disarm(self, now: float) -> None:
        if not self._moving:
            self._enter(SessionPhase.ENDED, now)

    @property
    def _moving(self) -> bool:
        """Whether an amplifier plays or ramps by its latest report."""
        return any(peer.state in MOVING for peer in self.peers)
