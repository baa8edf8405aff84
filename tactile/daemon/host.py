"""The host: all displays, and what each client may do with them, whatever it is connected by.

A transport (WebSocket, OSC, or a program in the same process) hands decoded messages on to a
`Client` and takes events from its ``outbox``. Names in a message choose among what there is; none
reaches the file system. The rule of mixing is in `tactile.daemon.messages`.
"""

import asyncio
import itertools
import logging
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile.daemon import messages as m
from tactile.daemon import orders
from tactile.daemon.config import Config, load_config
from tactile.daemon.messages import Answer, Command, Contact, Event, Failure, Telemetry
from tactile.daemon.playing import Part, Playing, Workbench
from tactile.daemon.shared import Touch
from tactile.daemon.waves import Curve
from tactile.errors import BusError, InputError
from tactile.files import nearest
from tactile.rendering.clock_map import ClockMap
from tactile.texture import descriptor

log = logging.getLogger("tactile.host")

OUTBOX = 64
"""Events and telemetry that wait for a client."""


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


class Host:
    """All displays of a daemon.

    Parameters
    ----------
    config : which
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._workbench = Workbench()
        self._clients: dict[int, Client] = {}
        self._numbers = itertools.count(1)
        self._textures: dict[str, m.TextureInfo] = {}
        self._beaten: dict[str, tuple[int, float]] = {}
        self._closed = False
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
        try:
            for config in self._config.display:
                playing = Playing(config, self._workbench, self._tell)
                self.playing[config.name] = playing
                await playing.start()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Fade out, disarm and end all of it; idempotent."""
        if self._closed:
            return
        self._closed = True
        for task in self.tasks:
            task.cancel()
        playing, self.playing = self.playing, {}
        await asyncio.gather(*(one.close() for one in playing.values()))
        await self._workbench.close()

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
        after = [
            before.pop(one) if one in before else Playing(one, self._workbench, self._tell)
            for one in config.display
        ]
        self._config, self._textures = config, shipped_textures()
        await asyncio.gather(*(playing.close() for playing in before.values()))
        self.playing = {playing.config.name: playing for playing in after}
        failures = []
        for playing in after:
            new = playing.child is None
            try:
                await (playing.start() if new else playing.renew())
            except BusError as error:
                failures.append(str(error))
                if new:
                    playing.keep_open()
            self._tell(Event(display=playing.config.name, kind="textures"))
        if failures:
            raise BusError("; ".join(failures))

    # What there is

    @property
    def displays(self) -> tuple[m.DisplayInfo, ...]:
        """What there is to play on."""
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
            alone = not any("arm" in other.roles for other in self._clients.values())
            for playing in self.playing.values():
                self.run(partial(playing.leave, client.number))
                if "arm" in client.roles and alone and not playing.config.arm_on_start:
                    self.run(playing.rest)

    def run(self, work: Callable[[], Awaitable[None]]) -> None:
        """Have something done that nobody waits for."""

        async def done() -> None:
            with suppress(BusError):
                await work()

        task = asyncio.get_running_loop().create_task(done())
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def _tell(self, event: Event) -> None:
        for client in self._clients.values():
            client.post(event)

    def healthy(self) -> bool:
        """Return whether every playback lives and gets on."""
        return not self._closed and all(playing.alive for playing in self.playing.values())

    def beat(self) -> bool:
        """Return whether every playback got on since the last call: blocks, or reports at rest."""
        before = self._beaten
        self._beaten = {
            name: (r.blocks, r.time)
            for name, playing in self.playing.items()
            for r in [playing.report]
        }
        return self.healthy() and all(
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
                "armed": float(r.state == "armed"),
                "estopped": float(r.state == "estopped"),
                "link_up": float(r.link == "up"),
                "touching": float(r.touching),
                "playback_alive": float(playing.alive),
                "latency_seconds": r.latency,
            }
        return found


class Client:
    """A connection, as the host knows it.

    Attributes
    ----------
    outbox : events and telemetry for it; full, the oldest telemetry goes
    roles : what it may do, as of `tactile.daemon.messages`
    sounds : whether it has waveforms or effects that may still sound
    holds_voltage : whether it armed a display whose high voltage is on
    """

    def __init__(self, host: Host, number: int, name: str, *, roles: frozenset[m.Role]) -> None:
        self.number, self.name, self._host, self.roles = number, name, host, roles
        self.sounds = self.holds_voltage = False
        self.outbox: asyncio.Queue[Event | Telemetry] = asyncio.Queue(OUTBOX)
        self._clocks: dict[str, ClockMap] = {}
        self._telemetry: dict[str, asyncio.Task[None]] = {}

    def post(self, what: Event | Telemetry) -> None:
        """Put something in the outbox, if there is room."""
        if self.outbox.full():
            kept = [self.outbox.get_nowait() for _ in range(self.outbox.qsize())]
            oldest = next((k for k, one in enumerate(kept) if isinstance(one, Telemetry)), 0)
            for k, one in enumerate(kept):
                if k != oldest:
                    self.outbox.put_nowait(one)
        self.outbox.put_nowait(what)

    def quiet(self) -> None:
        """Fade its waveforms and effects, since it gives no sign of life."""

    def give_up(self) -> None:
        """Give up its share of high voltage, since it gives no sign of life."""

    def close(self) -> None:
        """Lift the finger, let all fade; idempotent."""
        for task in self._telemetry.values():
            task.cancel()
        self._telemetry.clear()
        self._host.drop(self)

    def contact(self, message: Contact, arrival: float) -> Failure | None:
        """Take where the finger is; ``arrival`` is on the monotonic clock [s]."""
        playing = self._host.playing.get(message.display)
        if playing is None:
            return self._no_display(message.display)
        when = arrival
        if message.time_us is not None:
            clock = self._clocks.setdefault(message.display, ClockMap())
            when = clock(message.time_us * 1e-6, arrival)
        x, y = message.position_mm
        vx, vy = message.velocity_mm_s or (0.0, 0.0)
        playing.touch(
            self.number,
            Touch(
                self.number, when, arrival, x * 1e-3, y * 1e-3, vx * 1e-3, vy * 1e-3,
                message.normal_force_n, message.velocity_mm_s is not None,
            ),
        )  # fmt: skip
        return None

    async def request(self, command: Command) -> Answer:
        """Carry out a command; what is wrong with it is the answer."""
        try:
            return await self._answer(command)
        except BusError as error:
            return Failure(code="unavailable", message=str(error))

    async def _answer(self, command: Command) -> Answer:
        if isinstance(command, m.Ping):
            return m.Pong(time_us=command.time_us, server_time_us=time.monotonic_ns() // 1000)
        if isinstance(command, m.ListTextures):
            return m.Textures(textures=self._host.textures())
        if isinstance(command, m.EStop):
            return await self._estop(command)
        if isinstance(command, m.Hello):
            return Failure(code="malformed", message="hello was said already")
        playing = self._host.playing.get(command.display)
        if playing is None:
            return self._no_display(command.display)
        if isinstance(command, Contact):
            return self.contact(command, time.monotonic()) or m.Done()
        return await self._ACTIONS[type(command)](self, playing, command)

    def _no_display(self, name: str) -> Failure:
        known = nearest(name, list(self._host.playing))
        return Failure(
            code="unknown_display", message=f"no display {name!r}; {known}", field="display"
        )

    async def _estop(self, command: m.EStop) -> Answer:
        if command.display is not None and command.display not in self._host.playing:
            return self._no_display(command.display)
        chosen = [
            playing
            for name, playing in self._host.playing.items()
            if command.display in (None, name)
        ]
        for playing in chosen:
            playing.memory.ask_estop()
        await asyncio.gather(*(playing.estop() for playing in chosen))
        return m.Done()

    def _part(self, playing: Playing) -> Part:
        return playing.parts.setdefault(self.number, Part())

    async def _select(self, playing: Playing, command: m.Select) -> Answer:
        known = {texture.name for texture in self._host.textures()}
        for k, layer in enumerate(command.layers):
            if layer.texture not in known:
                near = nearest(layer.texture, sorted(known))
                return Failure(
                    code="unknown_texture", field=f"layers[{k}].texture",
                    message=f"no texture {layer.texture!r}; {near}",
                )  # fmt: skip
        part = self._part(playing)
        part.layers = tuple(
            [(await playing.texture(one.texture, one.seed), one.gain) for one in command.layers]
        )
        await playing.ask(orders.Select(self.number, part.layers))
        return m.Done()

    async def _scaled(self, playing: Playing) -> Answer:
        part = self._part(playing)
        await playing.ask(orders.Scale(self.number, part.gain, part.sounds))
        return m.Done()

    async def _play(self, playing: Playing, command: m.Play) -> Answer:
        self._part(playing).sounds = True
        return await self._scaled(playing)

    async def _stop(self, playing: Playing, command: m.Stop) -> Answer:
        self._part(playing).sounds = False
        await playing.ask(orders.Silence(self.number))
        return await self._scaled(playing)

    async def _gain(self, playing: Playing, command: m.Gain) -> Answer:
        self._part(playing).gain = command.gain
        return await self._scaled(playing)

    def _cannot_wave(self, playing: Playing) -> Failure | None:
        if playing.how.carriers:
            return Failure(
                code="unsupported", field="display",
                message="the link takes spectrum frames, which carry textures and no waveforms",
            )  # fmt: skip
        state = playing.report.state
        if state == "armed":
            return None
        if state == "estopped":
            return Failure(code="estopped", message="e-stopped; clear, then arm", field="display")
        return Failure(code="not_armed", message="disarmed; arm it first", field="display")

    async def _append(self, playing: Playing, command: m.Append) -> Answer:
        failure = self._cannot_wave(playing)
        if failure is not None:
            return failure
        contactors = len(playing.display.contactors)
        if max(command.contactors, default=0) >= contactors:
            return Failure(
                code="invalid_field", field="contactors",
                message=f"contactor {max(command.contactors)} is not below {contactors}",
            )  # fmt: skip
        if isinstance(command.samples, bytes):
            whole = len(command.samples) // 4
            samples = np.frombuffer(command.samples[: 4 * whole], "<f4")
            if whole * 4 != len(command.samples) or whole > m.MOST_SAMPLES:
                return Failure(
                    code="invalid_field", field="samples",
                    message=f"needs float32, at most {m.MOST_SAMPLES} of them",
                )  # fmt: skip
            if not (np.abs(samples) <= 1).all():
                return Failure(
                    code="invalid_field", field="samples", message="must be −1 … 1 throughout"
                )
        else:
            samples = np.array(command.samples, np.float32)
        self._part(playing)
        taken, waiting = await playing.ask(
            orders.Wave(
                self.number, np.float32(command.amplitude_um * 1e-6) * samples,
                command.sample_rate_hz, command.contactors, command.append,
            )
        )  # fmt: skip
        return m.Appended(samples_consumed=int(taken), buffered_ms=1e3 * waiting)

    async def _effect(self, playing: Playing, command: m.Effect) -> Answer:
        failure = self._cannot_wave(playing)
        if failure is not None:
            return failure
        self._part(playing)
        curve = Curve(
            command.amplitude_um * 1e-6,
            _rows([(p.time_ms, p.value) for p in command.amplitude], 2),
            _rows([(p.time_ms, p.frequency_hz) for p in command.frequency], 2),
            _rows([(t.time_ms, t.value, t.frequency_hz) for t in command.transients], 3),
            command.stream,
        )
        for name, rows in (("amplitude", curve.amplitude), ("frequency", curve.frequency)):
            if np.any(np.diff(rows[:, 0]) < 0):
                return Failure(code="invalid_field", field=name, message="times must not descend")
        await playing.ask(orders.Shape(self.number, curve))
        return m.Done()

    def _may_not(self) -> Failure | None:
        if "arm" in self.roles:
            return None
        return Failure(code="unauthorized", message="this connection may not arm")

    async def _arm(self, playing: Playing, command: m.Arm) -> Answer:
        refused = self._may_not()
        if refused is not None:
            return refused
        if playing.report.state == "estopped":
            return Failure(code="estopped", message="e-stopped; clear it first", field="display")
        await playing.ask(orders.Arm())
        return m.Done()

    async def _disarm(self, playing: Playing, command: m.Disarm) -> Answer:
        await playing.ask(orders.Disarm())
        return m.Done()

    async def _clear(self, playing: Playing, command: m.Clear) -> Answer:
        refused = self._may_not()
        if refused is not None:
            return refused
        await playing.ask(orders.Clear())
        return m.Done()

    async def _subscribe(self, playing: Playing, command: m.Subscribe) -> Answer:
        name = command.display
        before = self._telemetry.pop(name, None)
        if before is not None:
            before.cancel()
        if command.rate_hz > 0:
            task = asyncio.create_task(self._send_telemetry(name, 1 / command.rate_hz))
            self._telemetry[name] = task
        return m.Done()

    async def _send_telemetry(self, name: str, interval: float) -> None:
        while (playing := self._host.playing.get(name)) is not None:
            self.post(snapshot(playing))
            await asyncio.sleep(interval)

    async def _stats(self, playing: Playing, command: m.GetStats) -> Answer:
        r = playing.report
        return m.Stats(
            display=playing.config.name,
            state="lost" if playing.lost else r.state,  # type: ignore[arg-type]
            link="up" if r.link == "up" and not playing.lost else "down",
            detail=playing.failure or r.detail,
            touching=r.touching,
            owner=playing.finger.client == self.number,
            latency_ms=1e3 * r.latency,
            counters=r.counters,
        )

    _ACTIONS: dict[type, Callable[..., Awaitable[Answer]]] = {  # noqa: RUF012
        m.Select: _select, m.Play: _play, m.Stop: _stop, m.Gain: _gain, m.Append: _append,
        m.Effect: _effect, m.Arm: _arm, m.Disarm: _disarm, m.Clear: _clear,
        m.Subscribe: _subscribe, m.GetStats: _stats,
    }  # fmt: skip


def _rows(points: list[tuple[float, ...]], width: int) -> NDArray[np.float64]:
    """Return points as an array, their times in seconds."""
    rows = np.array(points, np.float64).reshape(-1, width)
    rows[:, 0] *= 1e-3
    return rows


def snapshot(playing: Playing) -> Telemetry:
    """Return what a display does now."""
    r = playing.report
    return Telemetry(
        display=playing.config.name,
        time_us=round(r.time * 1e6),
        state="lost" if playing.lost else r.state,
        position_mm=(r.position[0] * 1e3, r.position[1] * 1e3),
        velocity_mm_s=(r.velocity[0] * 1e3, r.velocity[1] * 1e3),
        normal_force_n=r.normal_force,
        shear_um=tuple((playing.memory.shear * 1e6).tolist()),
        drive_v=tuple(playing.memory.drive.tolist()),
        counters=r.counters,
    )
