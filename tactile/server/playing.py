"""One display in the server: its playback process, its textures, and the owner of its finger.

A playback process that dies is started again, with back-off, and told what its clients had. It is
armed again only if the configuration says so. What an amplifier does meanwhile is left to its own
watchdog.

High voltage belongs to the clients that armed: `Playing.owners` holds their numbers. An e-stop is
written to the latch, which playback watches, and waits for nothing.
"""

import asyncio
import logging
import math
from collections import defaultdict
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

from tactile.errors import BusError
from tactile.estop.latch import Latch
from tactile.messages import (
    ArmDisplay,
    BeginAt,
    ClearEstop,
    DisarmDisplay,
    DisplayDescription,
    EventMessage,
    Layer,
    OnsetMessage,
)
from tactile.playback import commands
from tactile.playback.commands import DeviceOpened, News, Order, OrderAnswer, PlaybackSetup
from tactile.playback.shared_memory import PlaybackMemory, PlaybackReport
from tactile.playback.voice import ClientState
from tactile.server.children import Child
from tactile.server.config import (
    Configuration,
    DisplayConfig,
    calibration_of,
    load_configured,
)
from tactile.server.description import describe
from tactile.server.finger import FingerOwnership
from tactile.server.owners import CONFIGURATION, Owners
from tactile.server.preparation_queue import PreparationQueue
from tactile.server.preparing import Preparation, order_number
from tactile.server.session_recording import SessionRecording
from tactile.server.stimuli import Stimuli
from tactile.server.tasks import start_task
from tactile.server.texture_store import TextureStore
from tactile.tracking.finger_sample import FingerSample

log = logging.getLogger("tactile.playback")

OPENING = 40.0
"""Time within which a device must open [s]; an audio card may take 20 s."""
ANSWER = 5.0
"""Time within which an order must be carried out [s]; starting a bus takes 2 s."""
ENDING = 1.0
"""Maximum time for fading and disarming [s]."""
FIRST_RETRY, LONGEST_RETRY = 0.5, 10.0
"""Shortest and longest pause before playback is started again [s]."""
PLAYBACK_SILENCE = 4.0
"""Time without a report after which playback is considered to hang [s]."""
NO_CURRENTS = (
    "finger.follow = true: the device measures no currents; it plays for the finger of the display"
)
"""Line about a device that cannot be played as the configuration says."""
MOST_FRAME_ORDERS = 64
"""Maximum number of messages of tactile frames of one client that wait for playback, which carries
out 8 orders in each block."""
TOO_FAST = "playback does not keep up with its orders"
"""Reason why tactile frames are dropped."""
SERVER = 0
"""Number of the client in whose place the server itself has textures prepared anew."""


def hangs(now: float, reported: float, open_time: float) -> bool:
    """Decide whether a playback process hangs: it was silent for longer than `PLAYBACK_SILENCE`.

    A process that has just opened its device may not have reported yet.

    Parameters
    ----------
    now : float
        Present time [s].
    reported : float
        Time of the latest report [s].
    open_time : float
        Time at which the device was opened [s].

    Returns
    -------
    bool
        Whether the process hangs.
    """
    return now - max(reported, open_time) > PLAYBACK_SILENCE


class Playing:
    """Display that is played by a process.

    Parameters
    ----------
    config : DisplayConfig
        Configuration of the display.
    latch : Latch
        E-stop latch of the display, which outlives this object.
    preparation_queue : PreparationQueue
        Queue that prepares textures.
    post : callable
        Function that is called with each `EventMessage` or `OnsetMessage`, and with the number of
        the client that it is for, None for all.
    whole : Configuration
        Configuration of the server: where sessions are recorded, and whether the finger is
        followed.

    Attributes
    ----------
    config : DisplayConfig
        Configuration of the display.
    display : Display
        The display, with the limits of the configuration.
    latch : Latch
        E-stop latch of the display.
    memory : PlaybackMemory
        Memory that is shared with the playback process.
    how : DeviceOpened
        How the device plays.
    states : dict of int to ClientState
        States of the clients, by number.
    finger : FingerOwnership
        Owner of the finger.
    owners : Owners
        Owners of the high voltage.
    lost : bool
        Whether playback does not run: its device is not open yet, or its process died.
    session : SessionRecording
        Recording of what is played.
    stimuli : Stimuli
        Stimuli that begin at a time.
    child : Child or None
        Playback process.
    failure : str
        Reason why playback could not be started again; empty if it runs.
    """

    def __init__(
        self,
        config: DisplayConfig,
        latch: Latch,
        preparation_queue: PreparationQueue,
        post: Callable[[EventMessage | OnsetMessage, int | None], None],
        whole: Configuration,
    ) -> None:
        self.config = config
        self.display, source = load_configured(config)
        self.session = SessionRecording(config, self.display, source, whole.record)
        self._calibration = calibration_of(whole, self.display)
        self._loop = asyncio.get_running_loop()
        self.latch = latch
        self.memory = PlaybackMemory.create(len(self.display.contactors))
        self.how = DeviceOpened()
        self.states: dict[int, ClientState] = {}
        self.finger = FingerOwnership()
        self.lost = True
        self.failure = ""
        self._post = post
        self.child: Child | None = None
        self._pending: dict[int, asyncio.Future[tuple[float, ...]]] = {}
        self._waiting_frames: defaultdict[int, set[int]] = defaultdict(set)
        """Numbers of each client's orders of tactile frames that playback has not carried out."""
        self.stimuli = Stimuli(config.name, post)
        self._number = 0
        self._device_opened: asyncio.Future[DeviceOpened] | None = None
        self._since = 0.0
        self._texture_store = TextureStore(
            self.display, preparation_queue, keep=self._keep_texture, drop=self._drop_texture,
            selected=self._selected, largest=self.config.levels == "largest",
        )  # fmt: skip
        self.owners = Owners()
        self._estops = self._dropped_frames = 0
        self._supervisor: asyncio.Task[None] | None = None
        self._ended = asyncio.Event()

    # Process

    async def start(self) -> None:
        """Open the device, and arm it if the configuration says so and no e-stop holds.

        Raises
        ------
        BusError
            If the device cannot be opened.
        """
        await self._open()
        name = self.config.name
        if self.latch.holds:
            log.warning("%s: e-stop %d holds, %s", name, self.latch.holds, self.latch.reason)
        elif self.config.arm_on_start:
            try:
                await self.arm(CONFIGURATION)
            except BusError as error:
                log.error("%s: not armed at the start: %s", name, error)
        self.keep_open()

    def keep_open(self) -> None:
        """Start supervision: from now on, playback is started again whenever it is lost."""
        self._supervisor = start_task(self._supervise())

    async def _open(self) -> None:
        """Start a playback process and wait until it has opened the device."""
        config, loop = self.config, asyncio.get_running_loop()
        log.info("%s: opening %s", config.name, config.device)
        ring = self.session.renew()
        shared = self.memory.descriptor, self.latch.descriptor, ring.descriptor if ring else None
        inherited = tuple(descriptor for descriptor in shared if descriptor is not None)
        self._device_opened = loop.create_future()

        def on_message(what: Any) -> None:
            if self.child is child:  # ignore a process that was killed
                self._receive(what)

        child = self.child = Child("tactile.playback.process", on_message, inherited)
        child.send(
            PlaybackSetup(
                self.display, config.device, config.rearm, config.sample_rate_hz,
                config.accept_unsafe_hold, config.gain, config.worn, self.memory.handle,
                self.latch.handle, ring.handle if ring else "", self._calibration,
            )
        )  # fmt: skip
        try:
            async with asyncio.timeout(OPENING):
                self.how = await asyncio.shield(self._device_opened)
        except TimeoutError:
            self.how = DeviceOpened(why_not=f"not open after {OPENING:g} s")
        if self.how.why_not:
            child.kill()
            raise BusError(f"display {config.name}: {self.how.why_not}")
        self.session.begin(self.how)
        self.lost, self._since = False, self._loop.time()
        for refused in self.how.real_time:
            log.warning("%s: %s", config.name, refused)
        if self._calibration and not self.how.follows:
            log.warning("%s: %s", config.name, NO_CURRENTS)
        log.info("%s: %s plays at %g Hz", config.name, config.device, self.how.sample_rate)

    def _receive(self, what: Any) -> None:
        """Take a message of the process; None means that the process has ended."""
        if isinstance(what, DeviceOpened):
            if self._device_opened is not None and not self._device_opened.done():
                self._device_opened.set_result(what)
        elif isinstance(what, OrderAnswer):
            for waiting in self._waiting_frames.values():
                waiting.discard(what.number)
            future = self._pending.pop(what.number, None)
            if future is not None and not future.done():
                if what.failure:
                    future.set_exception(BusError(what.failure))
                else:
                    future.set_result(what.value)
        elif isinstance(what, list):
            for report in what:
                self.stimuli.report(report)
        elif isinstance(what, News):
            self._announce(what.kind, what.detail, contactors=what.contactors)
        else:
            self._process_ended()

    def _process_ended(self) -> None:
        """Fail everything that waits for the process, and announce that it is lost."""
        if self._device_opened is not None and not self._device_opened.done():
            self._device_opened.set_result(
                DeviceOpened(why_not="playback ended while it opened the device")
            )
        for future in self._pending.values():
            if not future.done():
                future.set_exception(BusError("playback was lost"))
        self._pending.clear()
        self._waiting_frames.clear()
        self.stimuli.lose("playback was lost")
        if not self.lost and not self._ended.is_set():
            self.lost = True
            self._announce("lost", "playback died; it is started again")

    def _announce(
        self, kind: str, detail: str, *, estop: int = 0, contactors: tuple[int, ...] = ()
    ) -> None:
        """Log an event and pass it on to the clients; touches are too many for the log."""
        level = logging.DEBUG if contactors else logging.INFO
        log.log(level, "%s: %s", self.config.name, f"{kind} {detail}".rstrip())
        self.session.add_news(News(kind, detail, contactors))
        self._post(
            EventMessage(
                display=self.config.name, kind=kind, detail=detail, estop=estop,
                contactors=contactors,
            ),
            None,
        )  # fmt: skip

    async def _supervise(self) -> None:
        """Start playback again whenever it dies or hangs."""
        retry = FIRST_RETRY
        while not self._ended.is_set():
            await asyncio.sleep(0.1)
            reported, now = self.memory.report().time, self._loop.time()
            if self.child is not None and not self.lost and hangs(now, reported, self._since):
                log.error("%s: playback hangs", self.config.name)
                self.child.kill()
                self._process_ended()
            if not self.lost:
                retry = FIRST_RETRY
                continue
            try:
                await self._restart()
            except Exception as error:  # of any kind: a display must never be given up silently
                self.failure = str(error) or type(error).__name__
                self.lost = True
                expected = isinstance(error, BusError | OSError)
                log.error(
                    "%s: %s; again in %g s", self.config.name, self.failure, retry,
                    exc_info=None if expected else error,
                )  # fmt: skip
                await asyncio.sleep(retry)
                retry = min(2 * retry, LONGEST_RETRY)

    async def _restart(self) -> None:
        """Open the device again, restore what clients had, and arm for the owners if allowed."""
        if self.child is not None:
            self.child.kill()
        if not self.config.rearm:
            self.owners.clients.clear()
        with self.owners.arm():
            await self._open()
            self.failure = ""
            await self.renew()
            if self.owners.clients and not self.latch.holds:
                await self.request(ArmDisplay(display=self.config.name))
            else:
                self._announce("disarmed", "playback is back, and disarmed")

    async def end(self) -> None:
        """Fade out, disarm, and end the process; an e-stop can be latched until `close`."""
        self._ended.set()
        if self._supervisor is not None:
            self._supervisor.cancel()
        if self.child is not None:
            await self.child.end(ENDING)
        self.session.leave()

    def close(self) -> None:
        """Release the memory that was shared with the process, after its end."""
        self.memory.close()

    # Orders

    async def request(self, order: Order) -> tuple[float, ...]:
        """Send an order to playback and wait for its answer.

        Parameters
        ----------
        order : Order
            What playback is to do.

        Returns
        -------
        tuple of float
            Values of the answer, which depend on the order.

        Raises
        ------
        BusError
            If the order cannot be carried out, with the reason.
        """
        future: asyncio.Future[tuple[float, ...]] = asyncio.get_running_loop().create_future()
        number = None
        try:
            if self.child is None or self.lost:
                raise BusError(self.failure or "playback was lost")
            number = self._send(self.child, order)
            self._pending[number] = future
            async with asyncio.timeout(ANSWER):
                return await future
        except BusError:
            self.stimuli.forget(order)
            raise
        except TimeoutError:
            raise BusError(f"playback did not answer in {ANSWER:g} s") from None
        finally:
            if number is not None:
                self._pending.pop(number, None)

    def _send(self, child: Child, order: Order) -> int:
        """Send an order to playback, and return its number.

        Raises
        ------
        BusError
            If too many orders wait.
        """
        self._number += 1
        self.session.add_order(self._number, order)
        child.send((self._number, order))
        return self._number

    def add_frames(self, frames: commands.AddFrames, begin: BeginAt | None = None) -> None:
        """Add tactile frames, without waiting; they are counted if they cannot be played now.

        Parameters
        ----------
        frames : AddFrames
            Frames of a client.
        begin : BeginAt or None
            Time at which the first of them is to be played, in a stream of its own.
        """
        self.state_of(frames.client)
        waiting = self._waiting_frames[frames.client]
        order = self.stimuli.timed(frames, begin)
        reason = "" if self.state == "armed" else "the display was not armed"
        if self.child is None or len(waiting) >= MOST_FRAME_ORDERS:
            reason = reason or TOO_FAST
        if not reason and self.child is not None:
            try:
                waiting.add(self._send(self.child, order))
            except BusError:
                reason = TOO_FAST
        if reason:
            self._dropped_frames += len(frames.frames)
            self.stimuli.miss(order, reason)

    # High voltage

    async def arm(self, client: int) -> None:
        """Arm for a client, which owns high voltage from then on.

        Parameters
        ----------
        client : int
            Number of the client.

        Raises
        ------
        BusError
            If the amplifier does not start, or an e-stop holds.
        """
        self.owners.clients.add(client)
        with self.owners.arm():
            try:
                await self.request(ArmDisplay(display=self.config.name))
            except BusError:
                self.owners.clients.discard(client)
                raise

    async def disarm(self) -> None:
        """Fade out and switch high voltage off, whoever owns it.

        Raises
        ------
        BusError
            If playback does not answer.
        """
        self.owners.clients.clear()
        if not self.lost:
            await self.request(DisarmDisplay(display=self.config.name))

    async def give_up(self, client: int) -> None:
        """Take away a client's share of high voltage; switch it off if nobody else has one.

        Parameters
        ----------
        client : int
            Number of the client.

        Raises
        ------
        BusError
            If playback does not answer.
        """
        if client in self.owners.clients:
            self.owners.clients.discard(client)
            if not self.owners.clients:
                await self.disarm()

    def estop(self, reason: str) -> int:
        """Latch an e-stop, which playback watches, without waiting for anything.

        Parameters
        ----------
        reason : str
            Who asked for it, in one line.

        Returns
        -------
        int
            Number of the e-stop, which a clear must name.
        """
        self.owners.clients.clear()
        return self.latch.trip(reason)

    def announce_estop(self) -> bool:
        """Announce an e-stop that has not been announced yet.

        Returns
        -------
        bool
            Whether there was one.
        """
        number = self.latch.number
        if number == self._estops:
            return False
        self._estops = number
        if self.latch.holds:
            self.owners.clients.clear()
            self._announce("estopped", self.latch.reason, estop=number)
        return True

    async def clear(self, estop: int) -> None:
        """End the e-stop with a number; do nothing if no e-stop holds.

        Parameters
        ----------
        estop : int
            Number of the e-stop.

        Raises
        ------
        BusError
            If the device refuses it, or a newer e-stop holds.
        """
        if not self.latch.holds:
            return
        await self.request(ClearEstop(display=self.config.name, estop=estop))
        self.latch.clear(estop)
        self._announce("cleared", f"e-stop {estop} was cleared", estop=estop)

    def is_ownerless(self, now: float) -> bool:
        """Check whether high voltage has belonged to nobody for too long.

        Parameters
        ----------
        now : float
            Time of the event loop [s].

        Returns
        -------
        bool
            Whether high voltage must be switched off.
        """
        running = self.lost or self.report.running
        return self.owners.check(now, running=running, armed=self.state == "armed")

    async def take_voltage(self) -> None:
        """Switch off high voltage that belongs to nobody."""
        log.error(
            "%s: high voltage belonged to no program; it is switched off",
            self.config.name,
        )
        await self.disarm()

    async def save_latch(self) -> None:
        """Write the latch to the disk, so that it survives a power failure; a failure is logged."""
        try:
            await asyncio.to_thread(self.latch.save)
        except (OSError, ValueError) as error:
            log.error("%s: the e-stop latch was not saved: %s", self.config.name, error)

    async def select(self, client: int, layers: Sequence[Layer]) -> None:
        """Prepare a client's textures and play them.

        Parameters
        ----------
        client : int
            Number of the client.
        layers : sequence of Layer
            Textures to superimpose.

        Raises
        ------
        TooManyPreparationsError
            If the client waits for as many textures as it may.
        BusError
            If a texture cannot be prepared, or there is no room for it.
        """
        state = self.state_of(client)
        with self._texture_store.held() as held:
            selection = []
            for layer in layers:
                key = layer.texture, layer.seed
                number = await self._texture_store.texture(client, key, self.how)
                held.add(number)
                selection.append((number, layer.gain))
            state.layers = tuple(selection)
        await self.apply_state(client)

    def state_of(self, client: int) -> ClientState:
        """Return what a client plays, which is nothing as yet for a new one.

        Parameters
        ----------
        client : int
            Number of the client.

        Returns
        -------
        ClientState
            State of the client; changes take effect with `apply_state`.
        """
        return self.states.setdefault(client, ClientState())

    async def apply_state(self, client: int) -> None:
        """Have playback play what a client's state says.

        Parameters
        ----------
        client : int
            Number of the client.

        Raises
        ------
        BusError
            If playback does not answer.
        """
        await self.request(commands.SetState(client, replace(self.state_of(client))))

    def _keep_texture(self, prepared: Preparation) -> None:
        if self.child is None or self.lost:
            raise BusError("playback was lost")
        if prepared.description is not None:
            self.session.add_order(order_number(prepared.number), prepared.description)
        self.child.send(prepared.order)

    async def _drop_texture(self, number: int) -> None:
        await self.request(commands.DropTexture(number))

    def _selected(self) -> set[int]:
        return {n for state in self.states.values() for n, _ in state.layers}

    async def renew(self) -> None:
        """Prepare the selected textures anew, as their files may have changed, and play them."""
        old, self._texture_store.ready = self._texture_store.ready, {}
        numbers, selected = dict[int, int](), self._selected()
        with self._texture_store.held() as held:
            for key, (n, _) in old.items():
                if n in selected:
                    try:
                        numbers[n] = await self._texture_store.texture(SERVER, key, self.how)
                        held.add(numbers[n])
                    except BusError as error:
                        log.error("%s: %s", self.config.name, error)
            for state in self.states.values():
                state.layers = tuple((numbers.get(n, n), gain) for n, gain in state.layers)
        for client in list(self.states):
            await self.apply_state(client)
        for n, _ in old.values():
            await self._drop_texture(n)

    def add_sample(self, client: int, sample: FingerSample) -> None:
        """Add a sample of the finger, if that belongs to its client or to nobody.

        Parameters
        ----------
        client : int
            Number of the client.
        sample : FingerSample
            Sample of the client's finger.
        """
        if self.finger.take(client, sample):
            self.memory.write_contact(client, sample)

    async def leave(self, client: int) -> None:
        """Lift a client's finger, fade what it plays, and give up its high voltage.

        Parameters
        ----------
        client : int
            Number of the client.
        """
        self._texture_store.leave(client)
        self._waiting_frames.pop(client, None)
        lifted = self.finger.lifted(client, self._loop.time())
        if lifted is not None:
            self.add_sample(client, lifted)
        work: list[Awaitable[object]] = [self.give_up(client)]
        if self.states.pop(client, None) is not None and not self.lost:
            work.append(self.request(commands.ForgetClient(client)))
        await asyncio.gather(*work)

    # State

    @property
    def report(self) -> PlaybackReport:
        """Latest report of playback."""
        return self.memory.report()

    @property
    def counters(self) -> dict[str, int]:
        """Counters of playback, with the tactile frames that did not reach it."""
        counters = self.report.counters
        dropped = counters.get("dropped_frames", 0) + self._dropped_frames
        return counters | {"dropped_frames": dropped}

    @property
    def state(self) -> Literal["disarmed", "armed", "estopped", "lost"]:
        """State of the display: "estopped" while an e-stop holds, else what playback reports."""
        if self.lost:
            return "lost"
        return "estopped" if self.latch.holds else self.report.state

    @property
    def alive(self) -> bool:
        """Whether the playback process runs and reports."""
        if self.lost or self.child is None or not self.child.alive:
            return False
        return self._loop.time() - self.report.time < PLAYBACK_SILENCE

    @property
    def info(self) -> DisplayDescription:
        """Description of the display for clients."""
        renders = 16 / self.how.sample_rate if self.how.sample_rate else 0.0
        latency = self.report.latency
        if math.isnan(latency):
            latency = self.how.ahead + renders
        return describe(self.config.name, self.display, self.how, latency=latency, latch=self.latch)
