"""Client of the host: what its commands do, and what it holds.

Names in a message select among what exists; none of them reaches the file system. The rule of
mixing and the roles are described in `tactile.messages`.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile import messages as m
from tactile.clock import loop_time
from tactile.errors import BusError
from tactile.messages import (
    Answer,
    Command,
    Contact,
    EventMessage,
    Failure,
    Streamed,
    TactileFrames,
    TelemetryMessage,
    kind_of,
)
from tactile.playback import commands
from tactile.playback.ending import ENDING
from tactile.playback.frame_stream import FADE, HOLD
from tactile.playback.schedule import MOST_SCHEDULED
from tactile.playback.waveforms import LONGEST
from tactile.playback.waves import Curve
from tactile.rendering.surface_picture import SurfaceSection
from tactile.server.decoding import failed, hint
from tactile.server.effects import LONGEST_EFFECT, SAMPLE_RATE
from tactile.server.playing import Playing
from tactile.server.tasks import start_task
from tactile.server.telemetry import SamplesReader, ShearReader, known, snapshot
from tactile.server.texture_store import TooManyPreparationsError
from tactile.tracking.clock_map import ClockMap
from tactile.tracking.finger_sample import FingerSample

if TYPE_CHECKING:
    from tactile.server.host import Host

OUTBOX = 64
"""Number of messages that wait for a client from which on telemetry is dropped."""
MOST_AT_ONCE = 8
"""Maximum number of messages of telemetry that follow one another at once, since the samples of all
contactors do not fit into one."""
Posted = EventMessage | m.OnsetMessage | TelemetryMessage
"""Message that a client gets without a request."""
SILENT = "the program gave no sign of life; its waveforms and effects were faded"
"""Detail of the event "silent"."""
NO_WAVEFORMS = "the link takes spectrum frames, which carry textures and no waveforms"
"""Reason why waveforms, effects and tactile frames are refused on such a link."""
PLAY: frozenset[m.Role] = frozenset({"play"})
"""Roles that allow playing."""
ARM: frozenset[m.Role] = frozenset({"arm"})
"""Roles that allow arming and clearing an e-stop."""
STOP: frozenset[m.Role] = ARM | {"stop"}
"""Roles that allow disarming."""
OPEN: frozenset[m.Role] = frozenset()
"""No roles: the command is open to every client."""


class Client:
    """Client of the host, whatever transport connects it.

    Parameters
    ----------
    host : Host
        Host that the client belongs to.
    number : int
        Number of the client, unique in the host.
    name : str
        Name of the program.
    roles : frozenset of Role
        What the client may do, as described in `tactile.messages`.

    Attributes
    ----------
    number : int
        Number of the client.
    name : str
        Name of the program.
    roles : frozenset of Role
        What the client may do.
    outbox : asyncio.Queue of EventMessage, OnsetMessage or TelemetryMessage
        Messages for the client; of too many, the oldest telemetry is dropped.
    """

    def __init__(self, host: "Host", number: int, name: str, *, roles: frozenset[m.Role]) -> None:
        self.number, self.name, self._host, self.roles = number, name, host, roles
        self._sounds_until = -math.inf
        self._has_left = False
        self.outbox: asyncio.Queue[Posted] = asyncio.Queue(OUTBOX + MOST_SCHEDULED)
        self._clocks: dict[str, ClockMap] = {}
        self._telemetry: dict[str, asyncio.Task[None]] = {}
        self._traced: dict[str, tuple[int | None, tuple[ShearReader, ShearReader]]] = {}
        self._sampled: dict[str, SamplesReader] = {}

    def post(self, what: Posted) -> None:
        """Put a message in the outbox, in place of the oldest telemetry if that is too much.

        Without telemetry, there is room for a report on each stimulus; then the oldest is dropped.

        Parameters
        ----------
        what : EventMessage, OnsetMessage or TelemetryMessage
            Message for the client.
        """
        if self.outbox.qsize() >= OUTBOX:
            queued = [self.outbox.get_nowait() for _ in range(self.outbox.qsize())]
            telemetry = [k for k, item in enumerate(queued) if isinstance(item, TelemetryMessage)]
            full = len(queued) == self.outbox.maxsize
            oldest = telemetry[0] if telemetry else 0 if full else None
            for k, item in enumerate(queued):
                if k != oldest:
                    self.outbox.put_nowait(item)
        self.outbox.put_nowait(what)

    def watches(self, display: str) -> bool:
        """Return whether the client gets telemetry of a display.

        Parameters
        ----------
        display : str
            Name of the display.

        Returns
        -------
        bool
            Whether it has subscribed.
        """
        return display in self._telemetry

    def observes(self, display: str) -> bool:
        """Return whether the client gets all that is played on a display.

        Parameters
        ----------
        display : str
            Name of the display.

        Returns
        -------
        bool
            Whether it has subscribed to telemetry with samples.
        """
        return display in self._telemetry and display in self._sampled

    @property
    def sounds(self) -> bool:
        """Whether the client has waveforms or effects that may still sound."""
        return loop_time() < self._sounds_until

    @property
    def holds_voltage(self) -> bool:
        """Whether the client armed a display whose high voltage is on."""
        return any(self.number in playing.owners.clients for playing in self._host.playing.values())

    def quiet(self) -> None:
        """Fade the client's waveforms and effects, because it gives no sign of life."""
        self._sounds_until = -math.inf
        for playing in self._host.playing.values():
            if self.number in playing.states:
                self._host.run(partial(playing.request, commands.EndWaves(self.number)))
                self.post(EventMessage(display=playing.config.name, kind="silent", detail=SILENT))

    def give_up(self) -> None:
        """Give up the client's share of high voltage, because it gives no sign of life."""
        for playing in self._host.playing.values():
            self._host.run(partial(playing.give_up, self.number))

    def close(self) -> None:
        """Lift the client's finger and fade what it plays; may be called repeatedly.

        From then on, only requests that make displays safe are carried out.
        """
        self._has_left = True
        for task in self._telemetry.values():
            task.cancel()
        self._telemetry.clear()
        self._host.drop(self)

    def stream(self, message: Streamed, arrival: float) -> Failure | None:
        """Take a message that is part of a stream.

        Parameters
        ----------
        message : Contact or TactileFrames
            Message of the client.
        arrival : float
            Time of arrival on the monotonic clock [s].

        Returns
        -------
        Failure or None
            What is wrong with it.
        """
        playing = self._host.playing.get(message.display)
        if playing is None:
            return self._unknown_display(message.display)
        if not PLAY & self.roles:
            return self._refusal(message, PLAY)
        if isinstance(message, TactileFrames):
            failure = self._frames(playing, message)
            if failure is not None and message.begin is not None:
                playing.stimuli.refuse(self.number, message.begin, failure.message)
            return failure
        self._contact(playing, message, arrival)
        return None

    def _contact(self, playing: Playing, message: Contact, arrival: float) -> None:
        when = arrival
        if message.time_us is not None:
            clock = self._clocks.setdefault(message.display, ClockMap())
            when = clock(message.time_us * 1e-6, arrival)
        x, y = message.position_mm
        velocity = None
        if message.velocity_mm_s is not None:
            vx, vy = message.velocity_mm_s
            velocity = vx * 1e-3, vy * 1e-3
        sample = FingerSample(when, arrival, x * 1e-3, y * 1e-3, message.normal_force_n, velocity)
        playing.add_sample(self.number, sample)

    def _frames(self, playing: Playing, message: TactileFrames) -> Failure | None:
        if playing.how.carriers:
            return failed("unsupported", NO_WAVEFORMS, field="display")
        values = _unit_values(message.frames, m.MOST_FRAME_VALUES, "frames")
        if isinstance(values, Failure):
            return values
        contactors = len(playing.display.contactors)
        if len(values) % contactors:
            text = f"{len(values)} values are no whole number of frames for {contactors} contactors"
            return failed("invalid_field", text, field="frames")
        failure = self._begin_failure(playing, message.begin) or _time_failure(message)
        if failure:
            return failure
        if self._has_left or not len(values):
            return None
        shear = np.float32(message.amplitude_um * 1e-6) * values.reshape(-1, contactors)
        time = None if message.time_us is None else message.time_us * 1e-6
        frames = commands.AddFrames(self.number, shear, message.frame_rate_hz, message.latest, time)
        playing.add_frames(frames, message.begin)
        seconds = len(shear) / message.frame_rate_hz
        # frames that continue a stream that waits for its time sound with it, a second at most
        seconds = (LONGEST if message.begin else seconds) + HOLD + FADE
        if message.time_us is None:
            self._sound(seconds, message.begin)
        else:
            self._sound(seconds, m.BeginAt(at_us=message.time_us))
        return None

    def _sound(self, seconds: float, begin: m.BeginAt | None) -> None:
        """Take note that something sounds for a time, from now or from when it is to begin."""
        from_now = 0.0 if begin is None else max(begin.at_us * 1e-6 - loop_time(), 0.0)
        self._sounds_until = max(self._sounds_until, loop_time() + from_now + seconds)

    @staticmethod
    def _begin_failure(playing: Playing, begin: m.BeginAt | None) -> Failure | None:
        """Return what is wrong with the time at which something is to begin, or its marker."""
        if begin is None:
            return None
        if failure := _far_failure(begin.at_us, "begin.at_us", m.FARTHEST):
            return failure
        lines = playing.how.marker_lines
        if begin.marker >> lines:
            text = (
                f"code {begin.marker}; must be below {1 << lines}, as the amplifier has {lines} "
                f"marker line{'' if lines == 1 else 's'}"
            )
            return failed("invalid_field", text, field="begin.marker")
        return None

    async def request(self, command: Command) -> Answer:
        """Carry out a request.

        Parameters
        ----------
        command : Command
            Message of the client other than `ClientHello`, which its connection answers.

        Returns
        -------
        Answer
            Answer to the request, a `Failure` if it could not be carried out.
        """
        try:
            return await self._answer(command)
        except BusError as error:
            return Failure(code="unavailable", message=str(error))

    async def _answer(self, command: Command) -> Answer:
        if isinstance(command, m.Ping):
            return m.Pong(time_us=command.time_us, server_time_us=int(loop_time() * 1e6))
        if isinstance(command, m.ListTextures):
            return m.Textures(textures=self._host.textures())
        if isinstance(command, m.ListEffects):
            return m.Effects(effects=tuple(e.info for e in self._host.effects.values()))
        if isinstance(command, m.EStop):
            return self._estop(command)
        if isinstance(command, m.DrawTexture):
            return await self._draw(command)
        assert not isinstance(command, m.ClientHello)
        playing = self._host.playing.get(command.display)
        if playing is None:
            return self._unknown_display(command.display)
        if isinstance(command, Streamed):
            return self.stream(command, loop_time()) or m.Done()
        if self._has_left and not isinstance(command, m.DisarmDisplay):
            return failed("unavailable", "the connection has ended")
        needed, action = self._ACTIONS[type(command)]
        if needed and not needed & self.roles:
            return self._refusal(command, needed)
        return await action(self, playing, command)

    def _unknown_display(self, name: str) -> Failure:
        known = hint(name, list(self._host.playing))
        return Failure(
            code="unknown_display", message=f"no display {name!r}; {known}", field="display"
        )

    def _refusal(self, command: Command, needed: frozenset[m.Role]) -> Failure:
        """Return why a command is refused, and what would allow it."""
        required = " or ".join(repr(role) for role in sorted(needed))
        has = ", ".join(repr(role) for role in sorted(self.roles)) or "none"
        return Failure(
            code="unauthorized",
            message=f"{kind_of(command)} needs the role {required}, this connection has {has}; "
            "its token gets roles from [[token]] in the configuration",
        )

    def _estop(self, command: m.EStop) -> Answer:
        """Latch the e-stop, without waiting for anything."""
        if command.display is not None and command.display not in self._host.playing:
            return self._unknown_display(command.display)
        reason = f"by the program {self.name!r}"
        return m.Done(
            estops={
                name: playing.estop(reason)
                for name, playing in self._host.playing.items()
                if command.display in (None, name)
            }
        )

    def _unknown_texture(self, name: str, field: str) -> Failure | None:
        """Return the failure that names a texture which does not exist, None if it does."""
        known = sorted(texture.name for texture in self._host.textures())
        if name in known:
            return None
        text = f"no texture {name!r}; {hint(name, known)}"
        return failed("unknown_texture", text, field=field)

    async def _draw(self, command: m.DrawTexture) -> Answer:
        failure = self._unknown_texture(command.texture, "texture")
        if failure is not None:
            return failure
        columns, rows = command.columns, command.rows
        if columns * rows > m.MOST_PIXELS:
            text = f"{columns} × {rows} pixels, but {m.MOST_PIXELS} is the largest number"
            return failed("invalid_field", text, field="columns")
        corner = command.left_mm * 1e-3, command.bottom_mm * 1e-3
        section = SurfaceSection(*corner, command.pixel_mm * 1e-3, columns, rows)
        picture = await self._host.draw(self.number, command.texture, command.seed, section)
        return m.TexturePicture(
            lowest_um=picture.lowest * 1e6,
            highest_um=picture.highest * 1e6,
            pixels=picture.pixels.tobytes(),
        )

    async def _select(self, playing: Playing, command: m.Select) -> Answer:
        for k, layer in enumerate(command.layers):
            failure = self._unknown_texture(layer.texture, f"layers[{k}].texture")
            if failure is not None:
                return failure
        try:
            await playing.select(self.number, command.layers)
        except TooManyPreparationsError as error:
            return Failure(code="busy", message=str(error), field="layers")
        return m.Done()

    async def _apply_state(self, playing: Playing) -> Answer:
        """Have playback play what the client's state says."""
        await playing.apply_state(self.number)
        return m.Done()

    async def _resume(self, playing: Playing, command: m.Resume) -> Answer:
        playing.state_of(self.number).sounds = True
        return await self._apply_state(playing)

    async def _stop(self, playing: Playing, command: m.StopPlaying) -> Answer:
        playing.state_of(self.number).sounds = False
        await playing.request(commands.EndWaves(self.number))
        return await self._apply_state(playing)

    async def _gain(self, playing: Playing, command: m.SetGain) -> Answer:
        playing.state_of(self.number).gain = command.gain
        return await self._apply_state(playing)

    def _waveform_refusal(self, playing: Playing) -> Failure | None:
        """Return why a display cannot play waveforms now, None if it can."""
        if playing.how.carriers:
            return failed("unsupported", NO_WAVEFORMS, field="display")
        if playing.latch.holds:
            return self._estop_failure(playing)
        if playing.state == "armed":
            return None
        return failed("not_armed", "disarmed; arm it first", field="display")

    async def _append(self, playing: Playing, command: m.Append) -> Answer:
        failure = self._waveform_refusal(playing)
        if failure is not None:
            return failure
        contactors = len(playing.display.contactors)
        if max(command.contactors, default=0) >= contactors:
            text = f"contactor {max(command.contactors)} is not below {contactors}"
            return failed("invalid_field", text, field="contactors")
        samples = _unit_values(command.samples, m.MOST_SAMPLES, "samples")
        if isinstance(samples, Failure):
            return samples
        playing.state_of(self.number)
        if failure := self._begin_failure(playing, command.begin):
            return failure
        order = commands.AppendSamples(
            self.number, np.float32(command.amplitude_um * 1e-6) * samples,
            command.sample_rate_hz, command.contactors, command.append,
        )  # fmt: skip
        consumed, queued = await playing.request(playing.stimuli.timed(order, command.begin))
        self._sound(queued + ENDING, command.begin)
        return m.AppendedReply(samples_consumed=int(consumed), buffered_ms=1e3 * queued)

    async def _effect(self, playing: Playing, command: m.PlayEffect) -> Answer:
        failure = self._waveform_refusal(playing)
        if failure is not None:
            return failure
        playing.state_of(self.number)
        curve = Curve(
            command.amplitude_um * 1e-6,
            _point_rows([(p.time_ms, p.value) for p in command.amplitude], 2),
            _point_rows([(p.time_ms, p.frequency_hz) for p in command.frequency], 2),
            _point_rows([(t.time_ms, t.value, t.frequency_hz) for t in command.transients], 3),
            command.stream,
        )
        for name, rows in (("amplitude", curve.amplitude), ("frequency", curve.frequency)):
            if np.any(np.diff(rows[:, 0]) < 0):
                return failed("invalid_field", "times must not descend", field=name)
        if failure := self._begin_failure(playing, command.begin):
            return failure
        order = playing.stimuli.timed(commands.BeginEffect(self.number, curve), command.begin)
        await playing.request(order)
        self._sound(curve.end + ENDING, command.begin)
        return m.Done()

    async def _named_effect(self, playing: Playing, command: m.PlayNamedEffect) -> Answer:
        effect = self._host.effects.get(command.effect)
        if effect is None:
            near = hint(command.effect, sorted(self._host.effects))
            return failed("unknown_effect", f"no effect {command.effect!r}; {near}", field="effect")
        failure = self._waveform_refusal(playing)
        if failure is not None:
            return failure
        playing.state_of(self.number)
        if failure := self._begin_failure(playing, command.begin):
            return failure
        order = commands.AppendSamples(
            self.number, np.float32(command.gain) * effect.shear, SAMPLE_RATE, (),
            append=False, longest=LONGEST_EFFECT,
        )  # fmt: skip
        _, queued = await playing.request(playing.stimuli.timed(order, command.begin))
        self._sound(queued + ENDING, command.begin)
        return m.Done()

    @staticmethod
    def _estop_failure(playing: Playing) -> Failure:
        """Return the failure of a request while an e-stop holds."""
        latch = playing.latch
        return Failure(
            code="estopped",
            message=f"e-stop {latch.holds} holds, {latch.reason}; clear that one, then arm",
            field="display",
        )

    async def _arm(self, playing: Playing, command: m.ArmDisplay) -> Answer:
        if playing.latch.holds:
            return self._estop_failure(playing)
        await playing.arm(self.number)
        return m.Done()

    async def _disarm(self, playing: Playing, command: m.DisarmDisplay) -> Answer:
        await playing.disarm()
        return m.Done()

    async def _clear(self, playing: Playing, command: m.ClearEstop) -> Answer:
        latch = playing.latch
        if command.estop > latch.number:
            latest = f"the latest of {playing.config.name!r} is {latch.number}"
            text = f"there has been no e-stop {command.estop}; {latest}"
            return failed("invalid_field", text, field="estop")
        if latch.holds and command.estop != latch.holds:
            return Failure(
                code="estopped", field="estop",
                message=f"e-stop {latch.holds} holds, {latch.reason}: it is newer than "
                f"{command.estop}; a clear must name it",
            )  # fmt: skip
        await playing.clear(command.estop)
        return m.Done()

    async def _subscribe(self, playing: Playing, command: m.Subscribe) -> Answer:
        name, contactors = command.display, len(playing.display.contactors)
        if command.contactor is not None and command.contactor >= contactors:
            text = f"contactor {command.contactor} is not below {contactors}"
            return failed("invalid_field", text, field="contactor")
        before = self._telemetry.pop(name, None)
        if before is not None:
            before.cancel()
        else:
            for readers in (self._traced, self._sampled):
                readers.pop(name, None)  # what was played since an earlier one has ended is old
        if not command.samples:
            self._sampled.pop(name, None)
        elif name not in self._sampled:
            self._sampled[name] = SamplesReader(playing.memory)
        if command.rate_hz > 0:
            sending = self._send_telemetry(name, 1 / command.rate_hz, command.contactor)
            self._telemetry[name] = start_task(sending)
        return m.Done()

    def _shear_readers(self, name: str, contactor: int | None) -> tuple[ShearReader, ShearReader]:
        """Return what reads the shears of a contactor; a new rate of telemetry makes no gap."""
        before, readers = self._traced.get(name, (None, (ShearReader(), ShearReader())))
        if before != contactor:
            readers = ShearReader(), ShearReader()
        self._traced[name] = contactor, readers
        return readers

    async def _send_telemetry(self, name: str, interval: float, contactor: int | None) -> None:
        commanded, played = self._shear_readers(name, contactor)
        sampled, at_once = self._sampled.get(name), 0
        while (playing := self._host.playing.get(name)) is not None:
            trace = shear = None
            if contactor is not None and not playing.how.carriers:
                rate, memory = playing.how.sample_rate, playing.memory
                trace = commanded.read(memory.commanded, contactor, rate)
                if memory.played.count:
                    shear = played.read(memory.played, contactor, rate)
            samples = None if sampled is None else sampled.read(playing.memory, playing.how)
            self.post(snapshot(playing, trace, shear, samples))
            at_once += 1
            more = sampled is not None and sampled.is_behind and at_once < MOST_AT_ONCE
            at_once = at_once if more else 0
            await asyncio.sleep(0.0 if more else interval)

    async def _stats(self, playing: Playing, command: m.GetStats) -> Answer:
        r, latch = playing.report, playing.latch
        return m.StatsReply(
            display=playing.config.name,
            state=playing.state,
            link="up" if r.link == "up" and not playing.lost else "down",
            detail=playing.failure or (latch.reason if latch.holds else r.detail),
            touching=r.touching,
            owner=playing.finger.client == self.number,
            latency_ms=known(1e3 * r.latency),
            counters=playing.counters,
            estop=latch.holds,
            put_out_share=known(r.put_out_share),
            lead_ms=1e3 * playing.how.ahead if playing.how.sample_rate else None,
        )

    _ACTIONS: dict[type, tuple[frozenset[m.Role], Callable[..., Awaitable[Answer]]]] = {  # noqa: RUF012
        m.Select: (PLAY, _select),
        m.Resume: (PLAY, _resume),
        m.StopPlaying: (PLAY, _stop),
        m.SetGain: (PLAY, _gain),
        m.Append: (PLAY, _append),
        m.PlayEffect: (PLAY, _effect),
        m.PlayNamedEffect: (PLAY, _named_effect),
        m.ArmDisplay: (ARM, _arm),
        m.ClearEstop: (ARM, _clear),
        m.DisarmDisplay: (STOP, _disarm),
        m.Subscribe: (OPEN, _subscribe),
        m.GetStats: (OPEN, _stats),
    }
    """Roles of which a client needs one for a command, and the method that carries it out."""


def _point_rows(points: list[tuple[float, ...]], width: int) -> NDArray[np.float64]:
    """Return points as an array, with their times converted from milliseconds to seconds."""
    rows = np.array(points, np.float64).reshape(-1, width)
    rows[:, 0] *= 1e-3
    return rows


def _far_failure(time_us: int, field: str, farthest: float) -> Failure | None:
    """Return a failure if the time in a field of a message is too far ahead."""
    ahead = time_us * 1e-6 - loop_time()
    if ahead <= farthest:
        return None
    text = f"{ahead:.6g} s ahead; at most {farthest:g} s"
    return failed("invalid_field", text, field=field)


def _time_failure(message: TactileFrames) -> Failure | None:
    """Return what is wrong with the time of tactile frames."""
    if message.time_us is None:
        return None
    if message.latest or message.begin is not None:
        text = "is for frames that are all played at their times: neither latest nor begin fits it"
        return failed("invalid_field", text, field="time_us")
    return _far_failure(message.time_us, "time_us", LONGEST)


def _unit_values(
    values: tuple[float, ...] | bytes, most: int, field: str
) -> NDArray[np.float32] | Failure:
    """Return the values from −1 to 1 in a field of a message, or what is wrong with them."""
    if not isinstance(values, bytes):
        return np.array(values, np.float32)  # each was checked when the message was decoded
    whole = len(values) // 4
    numbers = np.frombuffer(values[: 4 * whole], "<f4")
    if whole * 4 != len(values) or whole > most:
        return failed("invalid_field", f"needs float32, at most {most} of them", field=field)
    if not (np.abs(numbers) <= 1).all():
        return failed("invalid_field", "must be −1 … 1 throughout", field=field)
    return numbers
