"""Bus whose amplifiers speak the protocol: a session on a wire, which one thread serves.

The thread waits for packets, sends what is due at absolute host times, and connects again, with
exponential back-off, when the wire breaks. `LinkBus.write` waits until the samples are due, less
the lead; that loop, and no other, feeds the watchdog of the amplifiers.

Callers and the thread change the session under one reentrant lock, `_changed`, which is held while
sending and never while waiting for packets. Only the thread receives, and closes a wire that broke.
On a modeled wire there is no thread: whoever waits advances the clock of the model.
"""

import logging
import math
import secrets
import threading
from collections.abc import Callable, Sequence
from typing import Literal

from firmware_protocol import messages as m
from firmware_protocol.messages import Message
from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DriveBlock, DriveFrame, FrameCapability, Wiring
from tactile.bus.budget import Plan
from tactile.bus.guards import GuardSettings
from tactile.bus.link.peer import Peer
from tactile.bus.link.phases import Goal, SessionPhase
from tactile.bus.link.session import LinkSession
from tactile.bus.link.stream import LinkBusCounters
from tactile.bus.wire import Wire, WireError
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, BusStateError, InputError

logger = logging.getLogger("tactile.bus")

OPENING = 2.0
"""Maximum time in which amplifiers have to answer and their clocks to become known [s]."""
STARTING, ENDING = 2.0, 0.5
"""Maximum times to wait for a start or the clear of an e-stop, and for the end of playing [s]."""
ANSWERING = 0.2
"""Maximum time to wait for the answer to a request: three attempts, and the time on the link
(assumed) [s]."""
IDLE = 20e-3
"""Maximum time for which the thread waits, and by which it notices a silent amplifier late [s]."""
SLICE = 20e-3
"""Maximum time for which a caller that writes sleeps between signs of life [s]."""
FIRST_RETRY, LONGEST_RETRY = 0.05, 1.0
"""Shortest and longest time until a broken wire is connected again; it doubles after each failure
[s]."""


class LinkBus(Bus):
    """Bus whose amplifiers speak the protocol, on one link.

    The constructor waits until the amplifiers are ready, for `OPENING` at most.

    `estop` sends its packet before it returns, unless there is no wire, also in a signal handler
    that interrupts a thread which is sending.

    Parameters
    ----------
    wiring : Wiring
        Properties of the display that the amplifiers drive; its sample rate is replaced by that of
        the plan.
    connect : callable
        Function that opens the wire. It is called here, and by the thread after the wire broke; it
        may raise OSError.
    choose : callable
        Function that makes the plan from the CAPS of the amplifiers; it may raise InputError.
    nodes : sequence of int
        Nodes of the amplifiers in the order of the channels; all that answer, in rising order, if
        empty.
    rearm : bool
        Whether to arm amplifiers again that went to 0 V by themselves, as when the link broke.
    lead : float or None
        Time by which samples are sent before they are put out [s], for a caller that knows early
        what comes; None for one that adapts to underruns.
    clock : Clock or None
        Clock of a modeled wire, which advances while its `receive` waits; None for real time.
    correlation_ms : int
        Length of the windows of correlated currents that are asked for [ms]; 0 for none.

    Attributes
    ----------
    plan : Plan
        How the drive is sent.

    Raises
    ------
    InputError
        If the display asks for more than the amplifiers or the link can give.
    BusError
        If the wire cannot be opened, no amplifier answers, or one refuses a request.
    """

    on_host_death = "ramps"

    def __init__(
        self,
        wiring: Wiring,
        connect: Callable[[], Wire],
        choose: Callable[[Sequence[m.Caps]], Plan],
        *,
        nodes: Sequence[int] = (),
        rearm: bool = False,
        lead: float | None = None,
        clock: Clock | None = None,
        correlation_ms: int = 0,
    ) -> None:
        super().__init__(wiring, clock or MONOTONIC)
        self._correlation_ms = correlation_ms
        self.counters: LinkBusCounters = LinkBusCounters()
        self._connect = connect
        self._changed = threading.Condition()  # the lock, which is notified of a new phase
        self._wire: Wire | None = connect()
        """Open wire; None while there is none. Only the thread takes it away."""
        self._retry, self._retry_at = FIRST_RETRY, math.inf
        self._broken = self._ending = False
        self._failure = ""
        """Reason of a wire that broke in the hands of a caller; the thread acts on it."""
        self._first: int | None = None
        """Position of the latest start; None before the first one."""
        self._unplayed_before = 0
        """Number of positions that had not been put out when it began."""
        self._waits_until = -math.inf
        """Host time up to which the thread waits in `receive` [s]."""
        self._session = LinkSession(
            wiring, token=secrets.randbelow(0xFFFF) + 1, choose=choose, counters=self.counters,
            nodes=nodes, rearm=rearm, lead=lead, windows=self._windows,
            correlation_ms=correlation_ms,
        )  # fmt: skip
        self._session.connected(self._clock.now())
        self._thread: threading.Thread | None = None
        if clock is None:
            self._thread = threading.Thread(target=self._run, name="tactile-link", daemon=True)
            self._thread.start()
        try:
            self._open()
        except BaseException:
            self._release()
            raise

    def _open(self) -> None:
        """Wait until the session is ready, and take over its plan; raise if it does not get ready.

        The error tells why: the display asks for too much, a refusal, or no answer.
        """
        session = self._session
        ready = self._wait(lambda: session.phase is SessionPhase.READY or session.refusal, OPENING)
        if session.plan is None or not ready or session.refusal:
            if session.error is not None:
                raise session.error
            reason = session.refusal or session.trouble or self._silence()
            raise BusError(reason)
        for peer in session.peers:
            if peer.unguarded:
                logger.warning(
                    "node %d can put out %g V and has no e-stop input (SPEC.md, 6.3)",
                    peer.host.node, peer.caps.full_scale_uv * 1e-6,
                )  # fmt: skip
            if peer.caps.schema != m.SCHEMA_CRC:
                logger.warning(
                    "node %d has the messages of version %d.%d (schema 0x%08X), this host those of "
                    "%d.%d (0x%08X); a field that either lacks reads as 0",
                    peer.host.node, peer.caps.major, peer.caps.minor, peer.caps.schema,
                    m.MAJOR, m.MINOR, m.SCHEMA_CRC,
                )  # fmt: skip
        self.plan = session.plan
        self.wiring = session.wiring
        if self.plan.carriers:
            self.frames = FrameCapability(self.plan.carriers, self.plan.frame_rate)

    def _silence(self) -> str:
        """Return the likely reason why no amplifier answers."""
        counters = self._wire.counters if self._wire is not None else m.Status()
        invalid = getattr(counters, "malformed", 0) + getattr(counters, "crc_errors", 0)
        if invalid:
            return (
                f"what comes is no packet of the protocol ({invalid} so far): another bit rate, "
                "or another device"
            )
        if self._session.phase is SessionPhase.CLOCK:
            return self._clock_trouble()
        return "nothing answers HELLO: is the amplifier powered, and is this its link?"

    def _clock_trouble(self) -> str:
        """Return why the clock of an amplifier did not become known in time."""
        peer = min(self._session.peers, key=lambda peer: peer.locked)
        node, clock = peer.host.node, peer.clock
        if clock is None or not clock.rejected:
            return f"node {node} answers HELLO, but too few TIMEs (SPEC.md, 7.2)"
        return (
            f"node {node}: {clock.rejected} of its TIME_REPLYs do not fit a clock of "
            f"{clock.tick_hz:.0f} Hz, which is tick_hz of its CAPS; correct its firmware"
        )

    @property
    def status(self) -> BusStatus:
        """Status of the bus now; it waits for nothing but the lock."""
        with self._changed:
            session, wire = self._session, self._wire
            up = wire is not None and session.phase.value > SessionPhase.CLOCK.value
            warning = wire.warning if wire is not None else ""
            no_credit = session.stream.no_credit if session.stream is not None else ""
            detail = session.trouble or no_credit or warning or session.fragments.warning
            state = self.state
            playing = state == "running" and session.known_to_run(self._clock.now())
            link: Literal["up", "down"] = "up" if up else "down"
            return BusStatus(state, link, detail, playing, session.last_fault)

    @property
    def unplayed(self) -> int:
        """Number of samples or frames that were not put out as written, as far as it is known.

        Amplifiers report what they put out. What they do not confirm before their link is lost
        counts as not put out, and of several amplifiers the one that lost most counts.
        """
        positions = self._unplayed_before + self._unplayed_now
        if self.frames is None:
            return max(super().unplayed, positions)
        late = max(peer.late for peer in self._session.peers)
        return max(super().unplayed, late, math.ceil(positions / self.plan.packet_samples))

    @property
    def _unplayed_now(self) -> int:
        """Number of positions since the latest start that were not put out, as far as known."""
        with self._changed:
            stream, running = self._session.stream, self._session.phase is SessionPhase.RUN
            if stream is None or self._first is None:
                return 0
            written = self._next - (self.frames is not None)  # a frame is for its end
            return stream.unplayed(self._first, max(written, self._first), running=running)

    @property
    def _cause(self) -> str:
        return self._session.trouble if self._session.tripped else ""

    def _has_fallen(self) -> bool:
        session = self._session
        if session.phase is SessionPhase.RUN and session.goal is Goal.RUN:
            return False
        with self._changed:
            return session.gives_up(self._clock.now())

    @property
    def correlates(self) -> bool:
        """Whether an amplifier measures currents, and was asked for their correlations."""
        return self._correlation_ms > 0 and any(peer.measures for peer in self._session.peers)

    @property
    def guards(self) -> bool:
        """Whether an amplifier has guards, and was asked for the correlations that they need."""
        return self._correlation_ms > 0 and any(peer.guards for peer in self._session.peers)

    def _set_guards(self, settings: GuardSettings) -> None:
        with self._changed:
            self._session.set_guards(settings)
            self._pump()
        self._wake()

    @property
    def marker_lines(self) -> int:
        """Number of marker lines of the first amplifier that has any; 0 if none has."""
        stream = self._session.stream
        marker = stream.marker if stream is not None else None
        return marker.caps.marker_lines if marker is not None else 0

    def _mark(self, position: int, code: int) -> None:
        assert self._session.stream is not None
        with self._changed:
            self._session.stream.mark(position, code)

    @property
    def lead(self) -> float:
        """Time by which samples are sent before they are put out [s]."""
        return self._session.stream.lead if self._session.stream is not None else 0.0

    @property
    def ahead(self) -> float:
        """Time by which samples have to be written before they are put out [s].

        It is the sum of the lead, the time that a packet or a frame takes on the wire, and the time
        that several amplifiers need to follow one clock.
        """
        return self._session.stream.ahead if self._session.stream is not None else 0.0

    def due(self, position: int) -> float:
        """Return the time at which a position is put out, by the clock of the first amplifier.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Time of the host's monotonic clock [s].
        """
        assert self._session.stream is not None
        return self._session.stream.due(position)

    def due_uncertainty(self, position: int) -> float:
        """Return half of an interval around `due` that holds the true time.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Half of the interval; NaN while the amplifier cannot be reached [s].
        """
        assert self._session.stream is not None
        with self._changed:  # the thread adds to the clock meanwhile
            return self._session.stream.due_uncertainty(position)

    # The thread

    def _run(self) -> None:
        """Serve the wire until the bus is closed; the body of the thread."""
        try:
            while not self._ending:
                self._turn(self._clock.now() + IDLE)
        except BaseException as error:
            self._break(f"internal error: {error!r}")
            raise

    def _turn(self, until: float) -> None:
        """Wait for packets, until a host time at the latest, and let the session act on them.

        It connects again if there is no wire, and closes a wire that broke. The thread calls it, or
        whoever waits on a modeled wire; the lock is not held.
        """
        try:
            wire = self._wire
            if wire is None:
                self._connect_again(until)
                return
            if not wire.busy:
                until = min(until, self._session.deadline)
            self._waits_until = until
            packets = wire.receive(until)
            with self._changed:
                phase, now = self._session.phase, self._clock.now()
                self._session.receive(packets, now, wire.counters.fragments_dropped)
                self._pump()
                reason = self._failure or self._session.lost(now)
                if self._session.phase is not phase or self._session.tripped:
                    self._on_phase_change()
            self._session.notes.write()
            if reason:
                raise WireError(reason)
        except OSError as error:
            self._break(str(error))

    def _pump(self) -> None:
        """Send what is to be sent now; the lock is held.

        A failure is left to the thread, which alone may close a wire that broke.
        """
        wire = self._wire
        if wire is not None and not wire.busy:
            try:
                self._session.poll(self._clock.now(), wire)
            except OSError as error:
                self._failure = str(error)

    def _on_phase_change(self) -> None:
        """Act on a new phase, or on an amplifier that is latched; the lock is held."""
        if self._session.tripped:
            self._states.trip()
        if self._broken and self._session.phase.value >= SessionPhase.READY.value:
            self._broken, self._retry = False, FIRST_RETRY
            self.counters.reconnects += 1
            logger.info("link is up again")
        self._changed.notify_all()

    def _break(self, why: str) -> None:
        """Close a wire that broke, and set the time to connect again."""
        with self._changed:
            wire, self._wire = self._wire, None
            if wire is None:
                return
            now, self._failure = self._clock.now(), ""
            wire.close()
            if not self._broken:
                self.counters.disconnects += 1
                logger.warning("link lost: %s", why)
            self._broken = True
            self._retry_at = now + self._retry
            self._retry = min(2 * self._retry, LONGEST_RETRY)
            self._session.disconnected(now, why)
            self._changed.notify_all()

    def _connect_again(self, until: float) -> None:
        """Open a new wire if it is time to; else wait, until a host time at the latest."""
        now = self._clock.now()
        if now < self._retry_at:
            self._pause(min(until, self._retry_at) - now)
            return
        try:
            wire = self._connect()
        except OSError as error:
            self._session.trouble = str(error)
            self._retry_at = self._clock.now() + self._retry
            self._retry = min(2 * self._retry, LONGEST_RETRY)
            return
        with self._changed:
            self._wire = wire
            self._session.connected(self._clock.now())

    def _pause(self, seconds: float) -> None:
        """Wait for some time without a wire, or until something changes."""
        if self._thread is None:
            self._clock.sleep(seconds)
        else:
            with self._changed:
                self._changed.wait(seconds)

    # Who calls

    def _wait(self, ready: Callable[[], object], seconds: float) -> bool:
        """Wait until a condition holds, for some time at most; return whether it holds.

        The lock is not held; ``ready`` is called with and without it.
        """
        end = self._clock.now() + seconds
        while not ready():
            remaining = end - self._clock.now()
            if remaining <= 0:
                return False
            if self._thread is None:
                self._turn(end)
            else:
                with self._changed:
                    if not ready():
                        self._changed.wait(min(remaining, IDLE))
        return True

    def _sleep(self, until: float) -> None:
        """Wait until a host time, and feed the watchdog meanwhile: the caller renders."""
        while (remaining := until - self._clock.now()) > 0:
            if self._thread is None:
                self._turn(min(until, self._clock.now() + SLICE))
            else:
                self._clock.sleep(min(remaining, SLICE))
            with self._changed:
                self._session.feed_watchdog(self._clock.now())

    def _start(self, position: int) -> None:
        """Begin playing; wait until all amplifiers have acknowledged, for `STARTING` at most."""
        if self.frames is not None and not len(self._session.carriers):
            raise BusStateError("start: the bus takes frames; tune it to their carriers first")
        with self._changed:
            if self._wire is None:
                raise BusError(f"start: the link is down: {self._session.trouble}")
            self._unplayed_before += self._unplayed_now
            for peer in self._session.peers:
                peer.ledger.clear()
            self._first = self._next = position
            self._session.run(position)
            self._pump()
        session = self._session

        def started() -> object:
            session.feed_watchdog(self._clock.now())
            return session.phase is SessionPhase.RUN or session.goal is not Goal.RUN

        if not self._wait(started, STARTING):
            session.end(self._clock.now(), quick=True)
            raise BusError(f"start: the amplifier does not start; {session.trouble}")
        if session.goal is not Goal.RUN:
            raise BusError(f"start: {session.refusal or session.trouble}")

    def _write(self, block: DriveBlock) -> None:
        """Pass samples on, packet by packet, each when it is due less `ahead`.

        While the session does not play, they are dropped and counted at the same pace.
        """
        stream, size = self._session.stream, self.plan.packet_samples
        assert stream is not None
        for k in range(0, len(block.volts), size):
            position, volts = block.position + k, block.volts[k : k + size]
            self._sleep(stream.due(position) - stream.ahead)
            with self._changed:
                self._session.feed_watchdog(self._clock.now())
                if self._session.phase is SessionPhase.RUN:
                    stream.add(position, volts)
                    self._pump()
                else:
                    self.counters.dropped_samples += len(volts)
            self._wake()

    def _drop(self, position: int, count: int) -> None:
        """Count samples that are not played, and wait until they would have been due."""
        stream = self._session.stream
        assert stream is not None
        self._sleep(stream.due(position + count) - stream.ahead)
        self.counters.dropped_samples += count

    def _tune(self, carriers: Floats) -> None:
        """Set the carriers, which go to the amplifiers with the next start."""
        if not 0 < len(carriers) <= self.plan.carriers:
            raise InputError(f"tune: {len(carriers)} carriers; 1 … {self.plan.carriers}")
        self._session.carriers = carriers.copy()

    def write_frame(self, frame: DriveFrame) -> None:
        """Play a frame; wait until it is due, less `ahead`.

        Parameters
        ----------
        frame : DriveFrame
            Envelopes at one position, one column per carrier of `tune`.

        Raises
        ------
        BusStateError
            If the bus is closed, takes blocks, or is idle because it was never started or was
            stopped. It is not raised after an e-stop, or when the amplifier fell to 0 V by itself.
        InputError
            If the frame does not have one row per channel and one column per carrier.
        """
        shape, carriers = frame.volts.shape, len(self._session.carriers)
        if self.state == "running" and len(shape) == 2 and carriers and shape[1] != carriers:
            raise InputError(f"write_frame: {shape[1]} carriers, not {carriers}")
        super().write_frame(frame)

    def _write_frame(self, frame: DriveFrame) -> None:
        """Pass a frame on a spacing and `ahead` before its position, or drop and count it."""
        stream, carriers = self._session.stream, self._session.carriers
        assert stream is not None
        self._sleep(stream.due(frame.position - self.plan.packet_samples) - stream.ahead)
        with self._changed:
            self._session.feed_watchdog(self._clock.now())
            if self._session.phase is SessionPhase.RUN:
                stream.add_frame(frame.position, frame.volts, carriers)
                self._pump()
            else:
                self.counters.dropped_samples += 1
        self._wake()

    # Besides playing

    @property
    def peers(self) -> Sequence[Peer]:
        """Amplifiers in the order of channels."""
        return self._session.peers

    def peer(self, node: int) -> Peer:
        """Return an amplifier.

        Parameters
        ----------
        node : int
            Its address.

        Returns
        -------
        Peer
            The one of `peers` with that address.

        Raises
        ------
        InputError
            If there is none.
        """
        for peer in self.peers:
            if peer.host.node == node:
                return peer
        nodes = ", ".join(str(peer.host.node) for peer in self.peers)
        raise InputError(f"node {node}: the amplifiers of this bus have {nodes}")

    def request(self, message: Message, node: int) -> Message | None:
        """Make a request (GET, SET, IDENTIFY) of an amplifier, and wait for its answer.

        It may be called while the bus is idle or running, by one thread at a time, and waits for
        `ANSWERING` at most.

        Parameters
        ----------
        message : Message
            Request.
        node : int
            Address of one of `peers`.

        Returns
        -------
        Message or None
            Answer, which may be a refusal; None if none came.

        Raises
        ------
        InputError
            If no amplifier has that node.
        """
        with self._changed:
            queries = self.peer(node).queries
            queries.request(message)
            self._pump()
        self._wait(lambda: queries.answer is not None, ANSWERING)
        return queries.answer

    def take_senses(self) -> list[tuple[Peer, m.Sense]]:
        """Return the readings that have come since the last call.

        Returns
        -------
        list of tuple of Peer and Sense
            Amplifiers and their readings, the newest `SENSES` of each amplifier at most.
        """
        with self._changed:
            senses = [(peer, sense) for peer in self.peers for sense in peer.queries.senses]
            for peer in self.peers:
                peer.queries.senses.clear()
        return senses

    def _wake(self) -> None:
        """Wake the thread if something is due before the time up to which it waits."""
        wire = self._wire
        if wire is not None and self._session.deadline < self._waits_until:
            wire.wake()

    def _stop(self) -> None:
        """Hold the last sample, wait until it is put out, and ramp to 0 V within the fade."""
        stream = self._session.stream
        if stream is not None and self._session.phase is SessionPhase.RUN:
            with self._changed:
                end = stream.hold()
                self._pump()
            self._wake()
            self._sleep(stream.due(end))
        self._end(quick=False)

    def _abort(self) -> None:
        """Ramp to 0 V at the slew limit at once."""
        self._end(quick=True)

    def _end(self, *, quick: bool) -> None:
        """Ramp to 0 V; wait until all amplifiers report that they rest, for `ENDING` at most."""
        with self._changed:
            self._session.end(self._clock.now(), quick=quick)
            self._pump()
        self._wait(lambda: self._session.phase in RESTING, ENDING)

    def _estop(self) -> None:
        """Send ESTOP ahead of everything; the session repeats it until amplifiers report it.

        Without a wire it is sent as soon as there is one again.
        """
        with self._changed:
            packet = self._session.estop(self._clock.now())
            wire = self._wire
            if wire is not None:
                try:
                    wire.send_urgent(packet)
                except OSError as error:
                    self._failure = str(error)
                self._pump()

    def _clear(self) -> None:
        """End an e-stop; wait until all amplifiers are ready, for `STARTING` at most.

        If they do not get ready in time, the e-stop is sent again. An amplifier that refuses stays
        e-stopped.
        """
        session = self._session
        with self._changed:
            if self._wire is None:
                raise BusError(f"clear: the link is down: {session.trouble}")
            losses = self.counters.disconnects
            session.clear(self._clock.now())
            self._pump()

        def ended() -> object:
            return (
                session.phase is SessionPhase.READY or session.refusal or session.goal is Goal.ESTOP
            )

        self._wait(ended, STARTING)
        if session.refusal:
            raise BusError(f"clear: {session.refusal}")
        if session.phase is not SessionPhase.READY or session.latched:
            was_lost = self.counters.disconnects > losses
            reason = "the link was lost meanwhile" if was_lost else session.trouble or "no answer"
            self._estop()
            raise BusError(f"clear: {reason}; it stays e-stopped")

    def _close(self) -> None:
        """Disarm, waiting for `ENDING` at most; then end the thread and close the wire."""
        with self._changed:
            self._session.finish()
        self._wake()
        self._wait(lambda: self._session.phase in (SessionPhase.ENDED, SessionPhase.DOWN), ENDING)
        self._release()

    def _release(self) -> None:
        """End the thread and close the wire."""
        self._ending = True
        wire = self._wire
        if wire is not None:
            wire.wake()
        with self._changed:
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        if self._wire is not None:
            self._wire.close()
            self._wire = None


RESTING = (SessionPhase.READY, SessionPhase.DOWN, SessionPhase.ENDED, SessionPhase.ESTOP)
"""Phases in which a stop has nothing more to wait for."""
