"""The host: all displays, and what each client may do with them, whatever it is connected by.

A transport (WebSocket, OSC, or a program in the same process) hands decoded messages on to a
`Client` and takes events from its ``outbox``. Names in a message choose among what there is; none
reaches the file system. The rule of mixing is in `tactile.messages`.
"""

import asyncio
import itertools
import logging
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

from tactile import messages as m
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, InputError
from tactile.estop.latch import Latch, inherit_estops
from tactile.messages import EventMessage
from tactile.paths import state_folder
from tactile.server.client import Client
from tactile.server.config import DaemonConfig, DisplayConfig, load_config, load_configured
from tactile.server.estop_desk import EstopDesk
from tactile.server.playing import Playing
from tactile.server.tasks import watched
from tactile.server.workbench import Workbench
from tactile.texture import descriptor

log = logging.getLogger("tactile.host")

BEAT = 25e-3
"""Time between the heartbeats that playback waits for [s]."""


def shipped_textures() -> dict[str, m.TextureInfo]:
    """Return what there is to select, by name; a file that cannot be used is only logged."""
    found = {}
    for name in descriptor.textures():
        try:
            about = descriptor.load(name).texture
        except InputError as error:
            log.error("%s", error)
            continue
        found[name] = m.TextureInfo(
            name=name, category=about.category, description=about.description,
            provenance=about.provenance,
        )  # fmt: skip
    return found


async def _latches(
    configs: Sequence[DisplayConfig], left: dict[str, Latch], clock: Clock
) -> dict[DisplayConfig, Latch]:
    """Return the latch of each display; those that are ``left`` are taken by device, and removed.

    Raises
    ------
    TactileError
        Where one cannot be had; none is open then, and all is left as it was.
    """
    folder = state_folder()
    opened, handed = dict[DisplayConfig, Latch](), dict[DisplayConfig, Latch]()
    try:
        for one in configs:
            if one.device in left:
                handed[one] = left.pop(one.device)
            else:
                open_latch = partial(Latch.open, one.device, folder, clock=clock)
                opened[one] = await asyncio.to_thread(open_latch)
    except BaseException:
        for latch in opened.values():
            latch.close()
        raise
    return opened | handed


class Host:
    """All displays of a daemon.

    Parameters
    ----------
    config : which
    clock : by which it waits for files; all else goes by the event loop's
    """

    def __init__(self, config: DaemonConfig, *, clock: Clock = MONOTONIC) -> None:
        self._config, self._clock = config, clock
        self._workbench = Workbench()
        self._clients: dict[int, Client] = {}
        self._numbers = itertools.count(1)
        self._textures: dict[str, m.TextureInfo] = {}
        self._beaten: dict[str, tuple[int, float]] = {}
        self._closed = False
        self._desk = EstopDesk()
        self._beating: asyncio.Task[None] | None = None
        self.playing: dict[str, Playing] = {}
        self.tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Open all displays.

        Raises
        ------
        TactileError
            Where one cannot be; none is open then.
        """
        self._textures = shipped_textures()
        self._workbench.begin()
        self._beating = watched(asyncio.create_task(self._beat()))
        try:
            for config in self._config.display:
                load_configured(config)
            latches = await _latches(self._config.display, {}, self._clock)
            for config, latch in latches.items():
                self.playing[config.name] = Playing(config, latch, self._workbench, self._tell)
            await self._desk.start({name: one.latch for name, one in self.playing.items()})
            await self._inherit(latches)
            for playing in self.playing.values():
                await playing.start()
        except BaseException:
            await self.close()
            raise

    async def _inherit(self, latches: dict[DisplayConfig, Latch]) -> None:
        """Let displays whose device had another URL before keep their e-stop."""
        heirs = {config.device: latch for config, latch in latches.items()}
        used = [playing.config.device for playing in self.playing.values()]
        take_over = partial(inherit_estops, heirs, used, state_folder(), clock=self._clock)
        await asyncio.to_thread(take_over)

    async def _beat(self) -> None:
        """Give playback signs of life for as long as this event loop runs, and see to the latches.

        Playback falls silent and disarms where they stay away: no program could stop it then.
        """
        while True:
            now = asyncio.get_running_loop().time()
            for playing in list(self.playing.values()):
                playing.memory.beat()
                if playing.notice_estop():
                    self.run(playing.save_latch)
                if playing.is_ownerless(now):
                    self.run(playing.take_voltage)
            await asyncio.sleep(BEAT)

    async def close(self) -> None:
        """Fade out, disarm and end all of it; idempotent."""
        if self._closed:
            return
        self._closed = True
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*(one.end() for one in self.playing.values()))
        await asyncio.gather(self._desk.close(), self._workbench.close())
        if self._beating is not None:
            self._beating.cancel()
        for playing in self.playing.values():
            playing.close()
            playing.latch.close()
        self.playing = {}

    async def reload(self) -> None:
        """Read textures and configuration again.

        Displays that are configured otherwise are opened anew, the others play on, with what is
        selected made anew.

        Raises
        ------
        TactileError
            For a configuration that cannot be used; all stays as it was then. For a device that
            cannot be opened; it is tried again and again.
        """
        config = self._config if self._config.path is None else load_config(self._config.path)
        before = {playing.config: playing for playing in self.playing.values()}
        new = [one for one in config.display if one not in before]
        for one in new:
            load_configured(one)
        textures = await asyncio.to_thread(shipped_textures)  # which takes longer than a heartbeat
        after = {one.name: before.pop(one) for one in config.display if one in before}
        left = {playing.config.device: playing.latch for playing in before.values()}
        latches = await _latches(new, left, self._clock)
        self._config, self._textures = config, textures
        await asyncio.gather(*(playing.end() for playing in before.values()))
        for one, latch in latches.items():
            after[one.name] = Playing(one, latch, self._workbench, self._tell)
        self.playing = {one.name: after[one.name] for one in config.display}
        for playing in before.values():
            playing.close()
            if playing.latch not in latches.values():
                playing.latch.close()
        if new or before:
            await self._desk.start({name: one.latch for name, one in self.playing.items()})
            await self._inherit(latches)  # after the last e-stop that the desk took before
        failures = []
        for playing in self.playing.values():
            begins = playing.child is None
            try:
                await (playing.start() if begins else playing.renew())
            except BusError as error:
                failures.append(str(error))
                if begins:
                    playing.keep_open()
            self._tell(EventMessage(display=playing.config.name, kind="textures"))
        if failures:
            raise BusError("; ".join(failures))

    # What there is

    @property
    def displays(self) -> tuple[m.DisplayDescription, ...]:
        """Displays that there are to play on."""
        return tuple(playing.info for playing in self.playing.values())

    def textures(self) -> tuple[m.TextureInfo, ...]:
        """Return what there is to select."""
        return tuple(self._textures.values())

    def connect(self, name: str, *, roles: frozenset[m.Role]) -> "Client":
        """Return a new client, which may do what its roles allow."""
        client = Client(self, next(self._numbers), name, roles=roles)
        self._clients[client.number] = client
        return client

    def drop(self, client: "Client") -> None:
        """Forget a client: its finger lifts, what it plays fades."""
        if self._clients.pop(client.number, None) is not None and not self._closed:
            for playing in self.playing.values():
                self.run(partial(playing.leave, client.number))

    def run(self, work: Callable[[], Awaitable[object]]) -> None:
        """Have something done that nobody waits for; all displays are disarmed where it fails."""

        async def done() -> None:
            try:
                await work()
            except BusError as error:  # playback is lost, and with it what was to be done
                log.warning("%s", error)

        task = watched(asyncio.create_task(done()), self.degrade)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def degrade(self, error: BaseException) -> None:
        """Disarm all displays after a failure that nobody expected."""
        for playing in self.playing.values():
            if playing.owners.clients:
                self.run(playing.disarm)

    def _tell(self, event: EventMessage) -> None:
        for client in self._clients.values():
            client.post(event)

    def healthy(self) -> bool:
        """Return whether every playback lives and gets on, and `tactile estop` reaches it."""
        return self._lives() and bool(self._desk.address)

    def _lives(self) -> bool:
        beats = self._beating is not None and not self._beating.done()
        return beats and not self._closed and all(one.alive for one in self.playing.values())

    def beat(self) -> bool:
        """Return whether every playback got on since the last call: blocks, or reports at rest."""
        before = self._beaten
        self._beaten = {
            name: (r.blocks, r.time)
            for name, playing in self.playing.items()
            for r in [playing.report]
        }
        return self._lives() and all(
            before.get(name) != now
            if self.playing[name].report.state != "armed"
            else before.get(name, (-1, 0.0))[0] != now[0]
            for name, now in self._beaten.items()
        )

    def figures(self) -> dict[str, dict[str, float]]:
        """Return counters and states by display."""
        found = {}
        for name, playing in self.playing.items():
            r = playing.report
            found[name] = {f"{k}_total": float(v) for k, v in r.counters.items()} | {
                "armed": float(playing.state == "armed"),
                "estopped": float(playing.latch.holds > 0),
                "link_up": float(r.link == "up"),
                "touching": float(r.touching),
                "playback_alive": float(playing.alive),
                "latency_seconds": r.latency,
            }
        return found
