"""One display as the server sees it: its playback process, textures made ready, whose finger it is.

Playback that dies is started again, with back-off, and told what its clients had; it is armed again
only where the configuration says so. What an amplifier does meanwhile is its own watchdog's part.

High voltage belongs to those who armed: `Playing.owners` holds their numbers. An e-stop is written
to the latch, which playback watches, and waits for nothing.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from tactile.errors import BusError
from tactile.estop.latch import Latch
from tactile.messages import DisplayDescription, EventMessage, Layer
from tactile.playback import commands
from tactile.playback.commands import Answer, DeviceOpened, News, Order, Setup
from tactile.playback.shared_memory import PlaybackReport, Shared, Touch
from tactile.server.children import Child
from tactile.server.config import DisplayConfig, load_configured
from tactile.server.description import describe
from tactile.server.finger import FingerOwnership
from tactile.server.owners import CONFIGURATION, Owners
from tactile.server.shelf import Shelf
from tactile.server.tasks import watched
from tactile.server.workbench import Workbench

log = logging.getLogger("tactile.playback")

OPENING = 40.0
"""s in which a device must be open; an audio card may take 20."""
ANSWER = 5.0
"""s in which an order is done; to start a bus takes 2."""
ENDING = 1.0
"""s that fading and disarming take at most."""
FIRST_RETRY, LONGEST_RETRY = 0.5, 10.0
STILL = 4.0
"""s without a report after which playback hangs."""
SERVER = 0
"""The client for whom the server itself has textures made anew."""


def hangs(now: float, reported: float, opened: float) -> bool:
    """Return whether playback hangs: long after it was opened, and no report for long [s].

    One that was opened a moment ago may not have reported yet.
    """
    return now - max(reported, opened) > STILL


@dataclass
class ClientState:
    """What a client has on a display."""

    layers: tuple[tuple[int, float], ...] = ()
    gain: float = 1.0
    sounds: bool = True


class Playing:
    """A display that is played.

    Parameters
    ----------
    config : of the display
    latch : its e-stop latch, which outlives it
    workbench : makes textures ready
    tell : called with each `EventMessage`
    """

    def __init__(
        self,
        config: DisplayConfig,
        latch: Latch,
        workbench: Workbench,
        tell: Callable[[EventMessage], None],
    ) -> None:
        self.config, self.display = config, load_configured(config)
        self._loop = asyncio.get_running_loop()
        self.latch = latch
        self.memory = Shared.create(len(self.display.contactors))
        self.how = DeviceOpened()
        self.parts: dict[int, ClientState] = {}
        self.finger = FingerOwnership()
        self.lost = True
        self.failure = ""
        self._tell = tell
        self._child: Child | None = None
        self._asked: dict[int, asyncio.Future[tuple[float, ...]]] = {}
        self._number = 0
        self._opened: asyncio.Future[DeviceOpened] | None = None
        self._since = 0.0
        self._shelf = Shelf(
            self.display, workbench, keep=self._keep_texture, drop=self._drop_texture,
            selected=self._selected,
        )  # fmt: skip
        self.owners = Owners()
        self._estops = 0
        self._keeper: asyncio.Task[None] | None = None
        self._ended = asyncio.Event()

    # The process

    async def start(self) -> None:
        """Open the device, and arm it where the configuration says so and no e-stop holds.

        Raises
        ------
        BusError
            Where it cannot be opened.
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
        """See to it from now on that it is open."""
        self._keeper = watched(asyncio.create_task(self._keep()))

    async def _open(self) -> None:
        config, loop = self.config, asyncio.get_running_loop()
        shared = self.memory.descriptor, self.latch.descriptor
        inherited = tuple(one for one in shared if one is not None)
        self._opened = loop.create_future()

        def heard(what: Any) -> None:
            if self._child is child:  # and not one that was killed before it
                self._heard(what)

        child = self._child = Child("tactile.playback.process", heard, inherited)
        child.tell(
            Setup(
                self.display, config.device, config.rearm, config.sample_rate_hz,
                config.accept_unsafe_hold, config.gain, config.worn, self.memory.handle,
                self.latch.handle,
            )
        )  # fmt: skip
        try:
            async with asyncio.timeout(OPENING):
                self.how = await asyncio.shield(self._opened)
        except TimeoutError:
            self.how = DeviceOpened(why_not=f"not open after {OPENING:g} s")
        if self.how.why_not:
            child.kill()
            raise BusError(f"display {config.name}: {self.how.why_not}")
        self.lost, self._since = False, self._loop.time()
        for refused in self.how.real_time:
            log.warning("%s: %s", config.name, refused)
        log.info("%s: %s plays at %g Hz", config.name, config.device, self.how.sample_rate)

    def _heard(self, what: Any) -> None:
        if isinstance(what, DeviceOpened):
            if self._opened is not None and not self._opened.done():
                self._opened.set_result(what)
        elif isinstance(what, Answer):
            future = self._asked.pop(what.number, None)
            if future is not None and not future.done():
                if what.failure:
                    future.set_exception(BusError(what.failure))
                else:
                    future.set_result(what.value)
        elif isinstance(what, News):
            self._say(what.kind, what.detail)
        else:
            self._gone()

    def _gone(self) -> None:
        """See that the process is no more, and that nobody waits for it."""
        if self._opened is not None and not self._opened.done():
            self._opened.set_result(
                DeviceOpened(why_not="playback ended while it opened the device")
            )
        for future in self._asked.values():
            if not future.done():
                future.set_exception(BusError("playback was lost"))
        self._asked.clear()
        if not self.lost and not self._ended.is_set():
            self.lost = True
            self._say("lost", "playback died; it is started again")

    def _say(self, kind: str, detail: str, *, estop: int = 0) -> None:
        log.info("%s: %s %s", self.config.name, kind, detail)
        self._tell(EventMessage(display=self.config.name, kind=kind, detail=detail, estop=estop))

    async def _keep(self) -> None:
        """Start playback again, whenever it dies or hangs."""
        retry = FIRST_RETRY
        while not self._ended.is_set():
            await asyncio.sleep(0.1)
            reported, now = self.memory.report().time, self._loop.time()
            if self._child is not None and not self.lost and hangs(now, reported, self._since):
                log.error("%s: playback hangs", self.config.name)
                self._child.kill()
                self._gone()
            if not self.lost:
                retry = FIRST_RETRY
                continue
            try:
                await self._again()
            except Exception as error:  # whatever it was: a display is never given up in silence
                self.failure = str(error) or type(error).__name__
                self.lost = True
                expected = isinstance(error, BusError | OSError)
                log.error(
                    "%s: %s; again in %g s", self.config.name, self.failure, retry,
                    exc_info=None if expected else error,
                )  # fmt: skip
                await asyncio.sleep(retry)
                retry = min(2 * retry, LONGEST_RETRY)

    async def _again(self) -> None:
        """Open once more, tell what clients had, and arm for those that had, if it may."""
        if self._child is not None:
            self._child.kill()
        if not self.config.rearm:
            self.owners.clients.clear()
        with self.owners.arm():
            await self._open()
            self.failure = ""
            await self.renew()
            for client, part in list(self.parts.items()):
                await self.ask(commands.Scale(client, part.gain, part.sounds))
            if self.owners.clients and not self.latch.holds:
                await self.ask(commands.StartBus())
            else:
                self._say("disarmed", "playback is back, and disarmed")

    async def end(self) -> None:
        """Fade out, disarm, end the process; an e-stop is latched until `close`."""
        self._ended.set()
        if self._keeper is not None:
            self._keeper.cancel()
        if self._child is not None:
            await self._child.end(ENDING)

    def close(self) -> None:
        """Let go of what was shared with the process, after its end."""
        self.memory.close()

    # What it is told

    async def ask(self, order: Order, *, within: float = ANSWER) -> tuple[float, ...]:
        """Have an order obeyed.

        Raises
        ------
        BusError
            Where it cannot be, with the reason.
        """
        if self._child is None or self.lost:
            raise BusError(self.failure or "playback was lost")
        self._number += 1
        number = self._number
        future: asyncio.Future[tuple[float, ...]] = asyncio.get_running_loop().create_future()
        self._asked[number] = future
        self._child.tell((number, order))
        try:
            async with asyncio.timeout(within):
                return await future
        except TimeoutError:
            raise BusError(f"playback did not answer in {within:g} s") from None
        finally:
            self._asked.pop(number, None)

    # High voltage

    async def arm(self, client: int) -> None:
        """Arm for a client, to whom high voltage belongs from now on.

        Raises
        ------
        BusError
            Where the amplifier does not start, or an e-stop holds.
        """
        self.owners.clients.add(client)
        with self.owners.arm():
            try:
                await self.ask(commands.StartBus())
            except BusError:
                self.owners.clients.discard(client)
                raise

    async def disarm(self) -> None:
        """Fade out, and switch high voltage off, whoever it belongs to.

        Raises
        ------
        BusError
            Where playback does not answer.
        """
        self.owners.clients.clear()
        if not self.lost:
            await self.ask(commands.StopBus())

    async def give_up(self, client: int) -> None:
        """Take away a client's share of high voltage; switch it off where nobody else has one.

        Raises
        ------
        BusError
            Where playback does not answer.
        """
        if client in self.owners.clients:
            self.owners.clients.discard(client)
            if not self.owners.clients:
                await self.disarm()

    def estop(self, reason: str) -> int:
        """Latch an e-stop, which playback watches; wait for nothing.

        Parameters
        ----------
        reason : who asked for it, in one line

        Returns
        -------
        int
            The number of the e-stop, which a clear must name.
        """
        self.owners.clients.clear()
        return self.latch.trip(reason)

    def notice_estop(self) -> bool:
        """Tell clients of an e-stop that was not told yet; return whether there was one."""
        number = self.latch.number
        if number == self._estops:
            return False
        self._estops = number
        if self.latch.holds:
            self.owners.clients.clear()
            self._say("estopped", self.latch.reason, estop=number)
        return True

    async def clear(self, estop: int) -> None:
        """End the e-stop with a number; nothing to do where it was ended before.

        Raises
        ------
        BusError
            Where the device refuses it, or a newer e-stop holds.
        """
        if not self.latch.holds:
            return
        await self.ask(commands.ClearDevice(estop))
        self.latch.clear(estop)
        self._say("cleared", f"e-stop {estop} was cleared", estop=estop)

    def is_ownerless(self, now: float) -> bool:
        """Return whether high voltage has belonged to nobody for too long; ``now`` in s."""
        running = self.lost or self.report.running
        return self.owners.look(now, running=running, armed=self.state == "armed")

    async def take_voltage(self) -> None:
        """Switch off high voltage that belongs to nobody."""
        log.error("%s: high voltage belonged to nobody; it is switched off", self.config.name)
        await self.disarm()

    async def save_latch(self) -> None:
        """Have the latch on the disk, so that it outlives the machine's power."""
        try:
            await asyncio.to_thread(self.latch.save)
        except (OSError, ValueError) as error:
            log.error("%s: the e-stop latch was not saved: %s", self.config.name, error)

    async def select(self, client: int, layers: Sequence[Layer]) -> None:
        """Have a client's textures made ready, and play them.

        Raises
        ------
        TooManyDrawingsError
            Where the client waits for as many textures as it may.
        BusError
            Where one cannot be made ready, or there is no room for it.
        """
        part = self.parts.setdefault(client, ClientState())
        with self._shelf.held() as held:
            chosen = []
            for layer in layers:
                number = await self.texture(client, layer.texture, layer.seed)
                held.add(number)
                chosen.append((number, layer.gain))
            part.layers = tuple(chosen)
        await self.ask(commands.SelectTextures(client, part.layers))

    async def texture(self, client: int, name: str, seed: int) -> int:
        """Return the number of a texture that is ready.

        Raises
        ------
        TooManyDrawingsError
            Where the client waits for as many as it may.
        BusError
            Where it cannot be made ready, or there is no room for it.
        """
        return await self._shelf.texture(client, (name, seed), self.how)

    def cancel_drawings(self, client: int) -> None:
        """Make no more ready for a client that has left, but for what others wait for too."""
        self._shelf.leave(client)

    def _keep_texture(self, order: bytes) -> None:
        if self._child is None or self.lost:
            raise BusError("playback was lost")
        self._child.tell(order)

    async def _drop_texture(self, number: int) -> None:
        await self.ask(commands.Drop(number))

    def _selected(self) -> set[int]:
        return {n for part in self.parts.values() for n, _ in part.layers}

    async def renew(self) -> None:
        """Have what is selected made anew, from files that may have changed, and play that."""
        old, self._shelf.ready = self._shelf.ready, {}
        numbers, selected = dict[int, int](), self._selected()
        with self._shelf.held() as held:
            for key, (n, _) in old.items():
                if n in selected:
                    try:
                        numbers[n] = await self.texture(SERVER, *key)
                        held.add(numbers[n])
                    except BusError as error:
                        log.error("%s: %s", self.config.name, error)
            for part in self.parts.values():
                part.layers = tuple((numbers.get(n, n), gain) for n, gain in part.layers)
        for client, part in list(self.parts.items()):
            await self.ask(commands.SelectTextures(client, part.layers))
        for n, _ in old.values():
            await self._drop_texture(n)

    def touch(self, client: int, touch: Touch) -> None:
        """Take a contact, where the finger is the client's, or nobody's."""
        if self.finger.take(client, touch):
            self.memory.write_contact(touch)

    async def leave(self, client: int) -> None:
        """Lift a client's finger, and let what it plays fade."""
        self.cancel_drawings(client)
        lifted = self.finger.lifted(client, self._loop.time())
        if lifted is not None:
            self.touch(client, lifted)
        work = [self.give_up(client)]
        if self.parts.pop(client, None) is not None and not self.lost:
            work.append(self._forget(client))
        await asyncio.gather(*work)

    async def _forget(self, client: int) -> None:
        await self.ask(commands.Forget(client))

    # How it stands

    @property
    def report(self) -> PlaybackReport:
        """The latest of playback."""
        return self.memory.report()

    @property
    def state(self) -> Literal["disarmed", "armed", "estopped", "lost"]:
        """How it stands: as playback reports of its amplifier, unless an e-stop holds."""
        if self.lost:
            return "lost"
        return "estopped" if self.latch.holds else self.report.state

    @property
    def alive(self) -> bool:
        """Whether playback lives and gets on."""
        if self.lost or self._child is None or not self._child.alive:
            return False
        return self._loop.time() - self.report.time < STILL

    @property
    def child(self) -> Child | None:
        """The process."""
        return self._child

    @property
    def info(self) -> DisplayDescription:
        """What clients are told."""
        renders = 16 / self.how.sample_rate if self.how.sample_rate else 0.0
        latency = self.report.latency or self.how.latency + renders
        return describe(self.config.name, self.display, self.how, latency=latency, latch=self.latch)
