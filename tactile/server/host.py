"""Host of all displays, and what each client may do with them, whatever transport connects it.

A transport (WebSocket, OSC, or a program in the same process) passes decoded messages to a `Client`
and takes events from its ``outbox``. Names in a message select among what exists; none of them
reaches the file system. The rule of mixing is described in `tactile.messages`.
"""

import asyncio
import itertools
import logging
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

from msgspec import structs

from tactile import messages as m
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, InputError
from tactile.estop.latch import Latch, inherit_estops
from tactile.messages import EventMessage
from tactile.paths import state_folder
from tactile.rendering.surface_picture import SurfacePicture, SurfaceSection
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, load_config, load_configured
from tactile.server.effects import StoredEffect, load_effects
from tactile.server.estop_desk import EstopDesk
from tactile.server.playing import Playing
from tactile.server.preparation_queue import PreparationQueue
from tactile.server.session_recording import LEAVING, prepare_folder
from tactile.server.tasks import start_task
from tactile.texture import descriptor

log = logging.getLogger("tactile.host")

BEAT = 25e-3
"""Interval of the heartbeats that playback waits for [s]."""


def shipped_textures() -> dict[str, m.TextureInfo]:
    """Return the textures that can be selected; a file that cannot be used is only logged.

    Returns
    -------
    dict of str to TextureInfo
        Descriptions by name of the texture.
    """
    textures = {}
    for name in descriptor.textures():
        try:
            header = descriptor.load(name).texture
        except InputError as error:
            log.error("%s", error)
            continue
        textures[name] = m.TextureInfo(
            name=name, category=header.category, description=header.description,
            provenance=header.provenance,
        )  # fmt: skip
    return textures


async def _latches(
    configs: Sequence[DisplayConfig], left: dict[str, Latch], clock: Clock
) -> dict[DisplayConfig, Latch]:
    """Return the latch of each display, opened or, if its device is in ``left``, moved from there.

    Raises
    ------
    TactileError
        If a latch cannot be opened; those that were opened before it are closed again.
    """
    folder = state_folder()
    latches, handed = dict[DisplayConfig, Latch](), dict[DisplayConfig, Latch]()
    try:
        for config in configs:
            if config.device in left:
                handed[config] = left.pop(config.device)
            else:
                open_latch = partial(Latch.open, config.device, folder, clock=clock)
                latches[config] = await asyncio.to_thread(open_latch)
    except BaseException:
        for latch in latches.values():
            latch.close()
        raise
    return latches | handed


class Host:
    """All displays of a server.

    Parameters
    ----------
    config : Configuration
        Configuration of the displays.
    clock : Clock
        Clock for waiting for files; everything else uses the clock of the event loop.

    Attributes
    ----------
    playing : dict of str to Playing
        Displays by name, in the order of the configuration.
    effects : dict of str to StoredEffect
        Effects that clients play by name.
    tasks : set of asyncio.Task
        Tasks that nobody waits for.
    """

    def __init__(self, config: Configuration, *, clock: Clock = MONOTONIC) -> None:
        self._config, self._clock = config, clock
        self._preparation_queue = PreparationQueue()
        self._clients: dict[int, Client] = {}
        self._numbers = itertools.count(1)
        self._textures: dict[str, m.TextureInfo] = {}
        self._last_progress: dict[str, tuple[int, float]] = {}
        self._closed = False
        self._desk = EstopDesk()
        self._beating: asyncio.Task[None] | None = None
        self.playing: dict[str, Playing] = {}
        self.effects: dict[str, StoredEffect] = {}
        self.tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Open all displays.

        Raises
        ------
        TactileError
            If a display cannot be opened; none is open then.
        """
        self._textures = shipped_textures()
        self.effects = await asyncio.to_thread(load_effects, self._config.server.effects)
        await asyncio.to_thread(prepare_folder, self._config.record.folder)
        self._preparation_queue.begin()
        self._beating = start_task(self._beat())
        try:
            for config in self._config.display:
                load_configured(config)
            latches = await _latches(self._config.display, {}, self._clock)
            for config, latch in latches.items():
                self.playing[config.name] = Playing(
                    config, latch, self._preparation_queue, self._post, self._config
                )
            await self._desk.start({name: playing.latch for name, playing in self.playing.items()})
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
        """Send heartbeats to playback for as long as this event loop runs, and watch the latches.

        Without heartbeats playback fades and disarms, because no program could stop it then.
        """
        while True:
            now = asyncio.get_running_loop().time()
            for playing in list(self.playing.values()):
                playing.memory.beat()
                if playing.announce_estop():
                    self.run(playing.save_latch)
                if playing.is_ownerless(now):
                    self.run(playing.take_voltage)
            await asyncio.sleep(BEAT)

    async def close(self) -> None:
        """Fade out, disarm and end all displays; may be called repeatedly."""
        if self._closed:
            return
        self._closed = True
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*(playing.end() for playing in self.playing.values()))
        await asyncio.gather(self._desk.close(), self._preparation_queue.close())
        if self._beating is not None:
            self._beating.cancel()
        for playing in self.playing.values():
            playing.close()
            playing.latch.close()
        recorders = {task for playing in self.playing.values() for task in playing.session.endings}
        if recorders:
            await asyncio.wait(recorders, timeout=LEAVING)
        self.playing = {}

    async def reload(self) -> None:
        """Read textures and configuration again.

        Displays whose configuration has changed are opened anew. The others play on, and the
        textures that are selected on them are prepared anew.

        Raises
        ------
        TactileError
            If the configuration cannot be used, in which case nothing changes; or if a device
            cannot be opened, which is then tried again and again.
        """
        config = self._config if self._config.path is None else load_config(self._config.path)
        before = {playing.config: playing for playing in self.playing.values()}
        new = [entry for entry in config.display if entry not in before]
        for entry in new:
            load_configured(entry)
        textures = await asyncio.to_thread(shipped_textures)  # takes longer than a heartbeat
        effects = await asyncio.to_thread(load_effects, config.server.effects)
        await asyncio.to_thread(prepare_folder, config.record.folder)
        after = {entry.name: before.pop(entry) for entry in config.display if entry in before}
        left = {playing.config.device: playing.latch for playing in before.values()}
        latches = await _latches(new, left, self._clock)
        self._config, self._textures, self.effects = config, textures, effects
        await asyncio.gather(*(playing.end() for playing in before.values()))
        for entry, latch in latches.items():
            after[entry.name] = Playing(
                entry, latch, self._preparation_queue, self._post, self._config
            )
        self.playing = {entry.name: after[entry.name] for entry in config.display}
        for playing in before.values():
            playing.close()
            if playing.latch not in latches.values():
                playing.latch.close()
        if new or before:
            await self._desk.start({name: entry.latch for name, entry in self.playing.items()})
            await self._inherit(latches)  # after the last e-stop of the e-stop process before
        failures = []
        for playing in self.playing.values():
            begins = playing.child is None
            try:
                await (playing.start() if begins else playing.renew())
            except BusError as error:
                failures.append(str(error))
                if begins:
                    playing.keep_open()
            self._broadcast(EventMessage(display=playing.config.name, kind="textures"))
        if failures:
            raise BusError("; ".join(failures))

    # Displays, textures and clients

    @property
    def displays(self) -> tuple[m.DisplayDescription, ...]:
        """Displays that can be played on."""
        return tuple(playing.info for playing in self.playing.values())

    def state(self, display: str) -> str:
        """Return the state of a display that can be played on.

        Parameters
        ----------
        display : str
            Name of the display.

        Returns
        -------
        str
            State as in `tactile.messages.StatsReply`.
        """
        return self.playing[display].state

    def textures(self) -> tuple[m.TextureInfo, ...]:
        """Return the textures that can be selected.

        Returns
        -------
        tuple of TextureInfo
            Descriptions of the textures.
        """
        return tuple(self._textures.values())

    async def draw(
        self, client: int, texture: str, seed: int, section: SurfaceSection
    ) -> SurfacePicture:
        """Draw the surface of a texture.

        Parameters
        ----------
        client : int
            Number of the client that waits for the picture.
        texture : str
            Name of one of the `textures`.
        seed : int
            Seed of the realization.
        section : SurfaceSection
            What to draw of the surface.

        Returns
        -------
        SurfacePicture
            The picture.

        Raises
        ------
        BusError
            If the texture cannot be drawn.
        """
        return await self._preparation_queue.draw(client, texture, seed, section)

    def connect(self, name: str, *, roles: frozenset[m.Role]) -> "Client":
        """Add a client.

        Parameters
        ----------
        name : str
            Name of the client.
        roles : frozenset of Role
            What the client may do.

        Returns
        -------
        Client
            The new client.
        """
        client = Client(self, next(self._numbers), name, roles=roles)
        self._clients[client.number] = client
        return client

    def drop(self, client: "Client") -> None:
        """Remove a client: its finger is lifted, and what it plays fades.

        Parameters
        ----------
        client : Client
            Client that leaves; one that was removed before is ignored.
        """
        if self._clients.pop(client.number, None) is not None and not self._closed:
            for playing in self.playing.values():
                self.run(partial(playing.leave, client.number))

    def run(self, work: Callable[[], Awaitable[object]]) -> None:
        """Run work in the background; all displays are disarmed if it fails unexpectedly.

        Parameters
        ----------
        work : callable
            Function that returns the awaitable to run. A `BusError` of it is only logged.
        """

        async def done() -> None:
            try:
                await work()
            except BusError as error:  # playback is lost, so that there is nothing left to do
                log.warning("%s", error)

        start_task(done(), self.degrade, among=self.tasks)

    def degrade(self, error: BaseException) -> None:
        """Disarm all displays after an unexpected failure.

        Parameters
        ----------
        error : BaseException
            The failure.
        """
        for playing in self.playing.values():
            if playing.owners.clients:
                self.run(playing.disarm)

    def _post(self, message: EventMessage | m.OnsetMessage, client: int | None) -> None:
        """Post a message to a client, or an event to all; onsets also to those that observe."""
        if isinstance(message, EventMessage):
            self._broadcast(message)
            return
        if client in self._clients:
            self._clients[client].post(message)
        for number, observer in self._clients.items():
            if number != client and observer.observes(message.display):
                observer.post(structs.replace(message, client=client))

    def _broadcast(self, event: EventMessage) -> None:
        """Post an event to all clients; touches only to those with telemetry of the display."""
        for client in self._clients.values():
            if not event.contactors or client.watches(event.display):
                client.post(event)

    def healthy(self) -> bool:
        """Return whether every display plays and `tactile estop` reaches the server.

        Returns
        -------
        bool
            Whether the server is healthy.
        """
        return self._is_alive() and bool(self._desk.address)

    def _is_alive(self) -> bool:
        """Return whether heartbeats are sent and every playback process is alive."""
        beats = self._beating is not None and not self._beating.done()
        return (
            beats and not self._closed and all(playing.alive for playing in self.playing.values())
        )

    def beat(self) -> bool:
        """Return whether playback has made progress since the last call.

        Progress of an armed display is a new block, that of any other a new report.

        Returns
        -------
        bool
            Whether every display has made progress.
        """
        before = self._last_progress
        self._last_progress = {
            name: (r.blocks, r.time)
            for name, playing in self.playing.items()
            for r in [playing.report]
        }
        return self._is_alive() and all(
            before.get(name) != now
            if self.playing[name].report.state != "armed"
            else before.get(name, (-1, 0.0))[0] != now[0]
            for name, now in self._last_progress.items()
        )

    def figures(self) -> dict[str, dict[str, float]]:
        """Return counters and states for metrics.

        Returns
        -------
        dict of str to dict of str to float
            Values by name, for each display.
        """
        figures = {}
        for name, playing in self.playing.items():
            r = playing.report
            figures[name] = {f"{k}_total": float(v) for k, v in playing.counters.items()} | {
                "armed": float(playing.state == "armed"),
                "estopped": float(playing.latch.holds > 0),
                "link_up": float(r.link == "up"),
                "touching": float(r.touching),
                "playback_alive": float(playing.alive),
                "latency_seconds": r.latency,
                "put_out_share": r.put_out_share,
                **playing.session.figures(),
            }
        return figures
