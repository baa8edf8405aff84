"""A bus whose amplifiers speak the protocol: a session on a wire, kept alive by one thread.

The thread waits for what comes, sends what is due at absolute host times, and connects again, with
back-off, when the wire breaks. Whoever writes is held back until the samples' time has come less
the lead; that loop, and no other, feeds the watchdog. On a modeled wire there is no thread: who
waits turns the model's clock.
"""

import logging
import math
import secrets
import threading
from collections.abc import Callable, Sequence

from firmware_protocol import messages as m
from firmware_protocol.messages import Message
from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DriveBlock, DriveFrame, FrameCapability, Wiring
from tactile.bus.budget import Plan
from tactile.bus.link.peer import Peer
from tactile.bus.link.phases import SessionPhase, Want
from tactile.bus.link.session import LinkSession
from tactile.bus.wire import Wire, WireError
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, BusStateError, InputError

logger = logging.getLogger("tactile.bus")

OPENING = 2.0
"""s in which an amplifier must have answered, and its clock be known."""
STARTING, ENDING = 2.0, 0.5
"""s that start and stop take at most."""
ASKING = 0.2
"""s in which a request is answered: three tries, and the link's own time (assumed)."""
IDLE = 20e-3
"""s that the thread sleeps at most: how late a silent amplifier may be noticed."""
SLICE = 20e-3
"""s that who writes sleeps at most, between signs of life."""
FIRST_RETRY, LONGEST_RETRY = 0.05, 1.0
"""s after which a broken wire is connected again; doubled each time in vain."""


class LinkBus(Bus):
    """Amplifiers on a link.

    Parameters
    ----------
    wiring : what they drive; its sample rate is replaced by the plan's
    connect : opens the wire, also when it broke
    choose : makes the plan from the amplifiers' CAPS; may raise InputError
    nodes : of the amplifiers, in the order of channels; all that answer, if not given
    rearm : whether to arm again what went to 0 V because the link broke
    lead : by which samples go ahead [s], for who knows what comes; None for the least that will do
    clock : of a modeled wire, which turns when its `receive` waits; None for real time

    Attributes
    ----------
    plan : what is sent

    Raises
    ------
    InputError
        Where the display asks for more than amplifiers or link can give.
    BusError
        Where nothing answers as an amplifier should.
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
    ) -> None:
        super().__init__(wiring, clock or MONOTONIC)
        self._connect = connect
        self._changed = threading.Condition()
        self._wire: Wire | None = connect()
        self._retry, self._retry_at = FIRST_RETRY, math.inf
        self._broken = self._ending = False
        self._failure = ""
        self._waits_until = -math.inf
        self._session = LinkSession(
            wiring, token=secrets.randbelow(0xFFFF) + 1, choose=choose, counters=self.counters,
            nodes=nodes, rearm=rearm, lead=lead,
        )  # fmt: skip
        self._session.connected(self._clock.now())
        self._thread: threading.Thread | None = None
        if clock is None:
            self._thread = threading.Thread(target=self._run, name="tactile-link", daemon=True)
            self._thread.start()
        try:
            self._open()
        except BaseException:
            self._let_go()
            raise

    def _open(self) -> None:
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
        self.plan = session.plan
        self.wiring = session.wiring
        if self.plan.carriers:
            self.frames = FrameCapability(self.plan.carriers, self.plan.frame_rate)

    def _silence(self) -> str:
        """Return what to make of no answer."""
        counters = self._wire.counters if self._wire is not None else m.Status()
        strange = getattr(counters, "malformed", 0) + getattr(counters, "crc_errors", 0)
        if strange:
            return (
                f"what comes is no packet of the protocol ({strange} so far): another bit rate, "
                "or another device"
            )
        return "nothing answers HELLO: is the amplifier powered, and is this its link?"

    @property
    def status(self) -> BusStatus:
        """How it stands now."""
        with self._changed:
            session, wire = self._session, self._wire
            up = wire is not None and session.phase.value > SessionPhase.CLOCK.value
            warning = wire.warning if wire is not None else ""
            detail = session.trouble or warning or session.fragments.warning
            state = self.state
            playing = state == "running" and session.known_to_run(self._clock.now())
            return BusStatus(state, "up" if up else "down", detail, playing)

    def _has_fallen(self) -> bool:
        session = self._session
        if session.phase is SessionPhase.RUN and session.want is Want.RUN:
            return False
        with self._changed:
            return session.gives_up(self._clock.now())

    @property
    def lead(self) -> float:
        """By which samples are sent before they are put out [s]."""
        return self._session.stream.lead if self._session.stream is not None else 0.0

    @property
    def ahead(self) -> float:
        """The lead, and the time that a packet, or a frame, takes on the wire [s]."""
        return self._session.stream.ahead if self._session.stream is not None else 0.0

    def due(self, position: int) -> float:
        """Return when a position is put out, by the first amplifier's clock [s]."""
        assert self._session.stream is not None
        return self._session.stream.due(position)

    # The thread

    def _run(self) -> None:
        try:
            while not self._ending:
                self._turn(self._clock.now() + IDLE)
        except BaseException as error:
            self._break(f"internal error: {error!r}")
            raise

    def _turn(self, until: float) -> None:
        """Wait for what comes until a host time at the latest, and do what is to be done."""
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
                why = self._failure or self._session.lost(now)
                if self._session.phase is not phase or self._session.tripped:
                    self._noticed()
            if why:
                raise WireError(why)
        except OSError as error:
            self._break(str(error))

    def _pump(self) -> None:
        """Send what is to be sent; the lock is held.

        Where that fails the thread is told, which alone may let go of a wire.
        """
        wire = self._wire
        if wire is not None and not wire.busy:
            try:
                self._session.poll(self._clock.now(), wire)
            except OSError as error:
                self._failure = str(error)

    def _noticed(self) -> None:
        """Act on a new phase; the lock is held."""
        if self._session.tripped:
            self._states.trip()
        if self._broken and self._session.phase.value >= SessionPhase.READY.value:
            self._broken, self._retry = False, FIRST_RETRY
            self.counters.reconnects += 1
            logger.info("link is up again")
        self._changed.notify_all()

    def _break(self, why: str) -> None:
        """Let go of a wire that broke."""
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
        now = self._clock.now()
        if now < self._retry_at:
            self._rest(min(until, self._retry_at) - now)
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

    def _rest(self, seconds: float) -> None:
        """Let time pass without a wire."""
        if self._thread is None:
            self._clock.sleep(seconds)
        else:
            with self._changed:
                self._changed.wait(seconds)

    # Who calls

    def _wait(self, ready: Callable[[], object], seconds: float) -> bool:
        """Wait until something is so; tell whether it is, within so many seconds."""
        end = self._clock.now() + seconds
        while not ready():
            left = end - self._clock.now()
            if left <= 0:
                return False
            if self._thread is None:
                self._turn(end)
            else:
                with self._changed:
                    if not ready():
                        self._changed.wait(min(left, IDLE))
        return True

    def _sleep(self, until: float) -> None:
        """Wait until a host time, with signs of life."""
        while (left := until - self._clock.now()) > 0:
            if self._thread is None:
                self._turn(min(until, self._clock.now() + SLICE))
            else:
                self._clock.sleep(min(left, SLICE))
            with self._changed:
                self._session.alive(self._clock.now())

    def _start(self, position: int) -> None:
        if self.frames is not None and not len(self._session.carriers):
            raise BusStateError("start: the bus takes frames; tune it to their carriers first")
        with self._changed:
            if self._wire is None:
                raise BusError(f"start: the link is down: {self._session.trouble}")
            self._session.run(position)
            self._pump()
        session = self._session

        def started() -> object:
            session.alive(self._clock.now())
            return session.phase is SessionPhase.RUN or session.want is not Want.RUN

        if not self._wait(started, STARTING):
            session.end(self._clock.now(), quick=True)
            raise BusError(f"start: the amplifier does not start; {session.trouble}")
        if session.want is not Want.RUN:
            raise BusError(f"start: {session.refusal or session.trouble}")

    def _write(self, block: DriveBlock) -> None:
        stream, size = self._session.stream, self.plan.packet_samples
        assert stream is not None
        for k in range(0, len(block.volts), size):
            position, volts = block.position + k, block.volts[k : k + size]
            self._sleep(stream.due(position) - stream.ahead)
            with self._changed:
                self._session.alive(self._clock.now())
                if self._session.phase is SessionPhase.RUN:
                    stream.add(position, volts)
                    self._pump()
                else:
                    self.counters.dropped_samples += len(volts)
            self._wake()

    def _drop(self, position: int, count: int) -> None:
        stream = self._session.stream
        assert stream is not None
        self._sleep(stream.due(position + count) - stream.ahead)
        self.counters.dropped_samples += count

    def _tune(self, carriers: Floats) -> None:
        if not 0 < len(carriers) <= self.plan.carriers:
            raise InputError(f"tune: {len(carriers)} carriers; 1 … {self.plan.carriers}")
        self._session.carriers = carriers.copy()

    def write_frame(self, frame: DriveFrame) -> None:
        """Play a frame, with a column per carrier."""
        shape, carriers = frame.volts.shape, len(self._session.carriers)
        if self.state == "running" and len(shape) == 2 and carriers and shape[1] != carriers:
            raise InputError(f"write_frame: {shape[1]} carriers, not {carriers}")
        super().write_frame(frame)

    def _write_frame(self, frame: DriveFrame) -> None:
        stream, carriers = self._session.stream, self._session.carriers
        assert stream is not None
        self._sleep(stream.due(frame.position - self.plan.packet_samples) - stream.ahead)
        with self._changed:
            self._session.alive(self._clock.now())
            if self._session.phase is SessionPhase.RUN:
                stream.add_frame(frame.position, frame.volts, carriers)
                self._pump()
            else:
                self.counters.dropped_samples += 1
        self._wake()

    # Besides playing

    @property
    def peers(self) -> Sequence[Peer]:
        """The amplifiers, in the order of channels."""
        return self._session.peers

    def ask(self, message: Message, node: int) -> Message | None:
        """Request something (GET, SET, IDENTIFY) of an amplifier, idle or running.

        Returns
        -------
        Message or None
            Its answer, also one that refuses; None where there is none.
        """
        with self._changed:
            aside = next(peer.aside for peer in self.peers if peer.host.node == node)
            aside.ask(message)
            self._pump()
        self._wait(lambda: aside.answer is not None, ASKING)
        return aside.answer

    def sensed(self) -> list[tuple[Peer, m.Sense]]:
        """Return what amplifiers measured since the last call; the newest, where that is long."""
        with self._changed:
            taken = [(peer, sense) for peer in self.peers for sense in peer.aside.senses]
            for peer in self.peers:
                peer.aside.senses.clear()
        return taken

    def _wake(self) -> None:
        """Let the thread look at what has changed, if it would do so too late."""
        wire = self._wire
        if wire is not None and self._session.deadline < self._waits_until:
            wire.wake()

    def _stop(self) -> None:
        stream = self._session.stream
        if stream is not None and self._session.phase is SessionPhase.RUN:
            with self._changed:
                end = stream.hold()
                self._pump()
            self._wake()
            self._sleep(stream.due(end))
        self._end(quick=False)

    def _abort(self) -> None:
        self._end(quick=True)

    def _end(self, *, quick: bool) -> None:
        with self._changed:
            self._session.end(self._clock.now(), quick=quick)
            self._pump()
        self._wait(lambda: self._session.phase in RESTING, ENDING)

    def _estop(self) -> None:
        with self._changed:
            packet = self._session.estop(self._clock.now())
            wire = self._wire
            if wire is not None:
                try:
                    wire.urge(packet)
                except OSError as error:
                    self._failure = str(error)
                self._pump()

    def _clear(self) -> None:
        session = self._session
        with self._changed:
            if self._wire is None:
                raise BusError(f"clear: the link is down: {session.trouble}")
            losses = self.counters.disconnects
            session.clear(self._clock.now())
            self._pump()

        def ended() -> object:
            return (
                session.phase is SessionPhase.READY or session.refusal or session.want is Want.ESTOP
            )

        self._wait(ended, STARTING)
        if session.refusal:
            raise BusError(f"clear: {session.refusal}")
        if session.phase is not SessionPhase.READY or session.latched:
            was_lost = self.counters.disconnects > losses
            why = "the link was lost meanwhile" if was_lost else session.trouble or "no answer"
            self._estop()
            raise BusError(f"clear: {why}; it stays e-stopped")

    def _close(self) -> None:
        with self._changed:
            self._session.leave()
        self._wake()
        self._wait(lambda: self._session.phase in (SessionPhase.GONE, SessionPhase.DOWN), ENDING)
        self._let_go()

    def _let_go(self) -> None:
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


RESTING = (SessionPhase.READY, SessionPhase.DOWN, SessionPhase.GONE, SessionPhase.ESTOP)
