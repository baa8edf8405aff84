"""Playback of one display: the loop that renders each block as late as it may, and its voices.

Each block is rendered for the time at which it will be put out, from the finger's place predicted
to that time, as late before it as the bus allows. What the block is made of is the mixing rule of
`tactile.messages`: the textures of the client whose finger it is, and all clients' waves.

The loop never raises for what it is told and never waits for who tells it; what it could not do is
counted. Where it is held up it goes on at what is due by then, fading in.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tactile.arrays import Floats, Singles
from tactile.bus.base import Bus, BusStatus, DriveBlock, DriveFrame
from tactile.clock import MONOTONIC, Clock
from tactile.display.display import Display
from tactile.errors import BusStateError
from tactile.playback.shared_memory import (
    BlockTrace,
    PlaybackCounters,
    PlaybackReport,
    Shared,
    State,
)
from tactile.playback.waves import TURN, Voice, affordable
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.rendering.renderer import Ramp, Renderer
from tactile.rendering.spectrum import FrameLimiter, SpectrumRenderer, band_carriers
from tactile.rendering.stroke import Motion
from tactile.tracking.tracker import ContactTracker

BLOCK = 16
"""Samples: 2 ms at 8 kHz."""
MARGIN = 0.5e-3
"""s for rendering a block, before the bus wants it (measured: 0.2 ms for 24 contactors)."""
LATENESS = 0.9
"""Of the bus's ``ahead``; a block that is later than that is skipped, for it would be late."""
HELD_UP = 20e-3
"""s after which one is skipped on a bus that is never late."""
IN_AIR = 10 ** (-34 / 20)
"""Of waves while nothing touches: an unloaded bimorph rings up by 34 dB (physics.md)."""
REPORTED = 5
"""Blocks from report to report of shear and drive."""
SMOOTHED = 0.02
"""Weight of a block's latency in the mean."""


def state_of(status: BusStatus) -> State:
    """Return the state of playback: armed only while the amplifier is known to play."""
    if status.state == "estopped":
        return "estopped"
    return "armed" if status.playing else "disarmed"


class SamplePlayback:
    """Renders on a bus that takes blocks.

    Attributes
    ----------
    spacing : samples of a block
    lag : samples by which what is put out lags what is rendered for it
    first : samples after a block's first at which a contact can first be noticed in it
    """

    spacing = BLOCK
    first = LOOK_AHEAD

    def __init__(self, display: Display, bus: Bus) -> None:
        self._display, self._bus = display, bus
        rate = bus.wiring.sample_rate
        self._renderer = Renderer(display, None, sample_rate=rate)
        self.lag = self._renderer.delay
        self.shear = self.drive = np.zeros(len(display.contactors))

    def play(self, layers: Sequence[tuple[RealizedLayer | SpectrumRenderer, float]]) -> None:
        """Go over to other textures, each with its gain."""
        self._renderer.play([(t, gain) for t, gain in layers if isinstance(t, RealizedLayer)])

    def fade_in(self) -> None:
        """Rise from nothing."""
        self._renderer.fade_in()

    def due(self, position: int) -> Floats:
        """Return the times for which a block is rendered (S,) [s]."""
        rate = self._bus.wiring.sample_rate
        return np.asarray(self._bus.due(position + self.lag) + np.arange(BLOCK) / rate)

    def asked(self, position: int) -> float:
        """Return when the bus wants a block [s]."""
        return self._bus.due(position) - self._bus.ahead

    def write(self, position: int, place: Floats, force: Floats, waves: Singles | None) -> None:
        """Render a block and play it."""
        drive, shear = self._renderer.block(place, force, waveform=waves, shear=True)
        self._bus.write(DriveBlock(position, self._display.to_channels(drive)))
        self.drive, self.shear = drive[-1], shear[-1]

    def touch(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is there."""
        if isinstance(texture, RealizedLayer):
            motion = Motion(self._bus.wiring.sample_rate)
            stroke = motion(motion.taken(np.zeros((BLOCK, 2)), np.zeros(BLOCK)))
            assert stroke is not None
            texture(stroke)

    def flush(self) -> None:
        """Be ready to start: let nothing of what was played before be heard."""
        nothing = np.zeros((4 * BLOCK, 2))
        for _ in range(4):
            self._renderer.block(nothing, nothing[:, 0])

    @property
    def limited(self) -> int:
        """Samples that were turned down."""
        return self._renderer.limiter.limited_samples


class FramePlayback:
    """Renders on a bus that takes spectrum frames; waves find no room on it.

    Textures have carriers in common; their frames are added and then limited.
    """

    lag = first = 0

    def __init__(self, display: Display, bus: Bus) -> None:
        assert bus.frames is not None
        self._display, self._bus = display, bus
        self._rate = bus.wiring.sample_rate
        self.spacing = round(self._rate / bus.frames.rate)
        self._playing: list[tuple[SpectrumRenderer, float]] = []
        rate = self._rate / self.spacing
        self._carriers = band_carriers(bus.frames.carriers, rate, self._rate)
        self._limiter = FrameLimiter(display, self._carriers, rate)
        self._rise = 0.0
        self.shear = self.drive = np.zeros(len(display.contactors))

    def play(self, layers: Sequence[tuple[RealizedLayer | SpectrumRenderer, float]]) -> None:
        """Go over to other textures from the next frame on, between which envelopes ramp."""
        self._playing = [(t, gain) for t, gain in layers if isinstance(t, SpectrumRenderer)]

    def fade_in(self) -> None:
        """Begin with a frame of nothing."""
        self._rise = 0.0

    def due(self, position: int) -> Floats:
        """Return the times on the way to the next frame (S,) [s], its own the last."""
        end = self._bus.due(position + self.spacing)
        steps = np.arange(self.spacing // BLOCK)[::-1]
        return np.asarray(end - steps * (BLOCK / self._rate))

    def asked(self, position: int) -> float:
        """Return when the bus wants the frame at the end of a stretch [s]."""
        return self._bus.due(position) - self._bus.ahead

    def write(self, position: int, place: Floats, force: Floats, waves: Singles | None) -> None:
        """Render the frame at the end of a stretch and play it."""
        at = position + self.spacing
        step = min(8, len(place) - 1)
        velocity = (place[-1] - place[-1 - step]) * self._rate / (BLOCK * max(step, 1))
        lines = np.zeros((self._display.channels, len(self._carriers)), np.complex128)
        total = np.zeros((len(self._display.contactors), len(self._carriers)), np.complex128)
        for texture, gain in self._playing:
            texture.sample = at
            total += gain * self._rise * texture.unlimited(place[-1], velocity, float(force[-1]))
        total = self._limiter(total)
        lines[self._display.channel] = total
        self._bus.write_frame(DriveFrame(at, lines))
        self._rise = 1.0
        self.drive = np.asarray(np.abs(total).sum(axis=1))

    def touch(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is there."""
        if isinstance(texture, SpectrumRenderer):
            texture.unlimited(np.zeros(2), np.zeros(2), 0.0)

    def flush(self) -> None:
        """Set the idle bus to the carriers; there is nothing that would be heard later."""
        self._bus.tune(self._carriers)

    @property
    def limited(self) -> int:
        """Frames that were turned down."""
        return self._limiter.limited_frames


@dataclass
class PlaybackLoop:
    """Plays one display on its bus.

    Parameters
    ----------
    display, bus, memory : what plays, on what, and what it shares with the server
    gain : of the display, over that of each client
    worn : whether the finger stays on the display though it touches nothing
    clock : the host's, by which blocks are due
    """

    display: Display
    bus: Bus
    memory: Shared
    gain: float = 1.0
    worn: bool = False
    clock: Clock = MONOTONIC
    textures: dict[int, RealizedLayer | SpectrumRenderer] = field(default_factory=dict)
    voices: dict[int, Voice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rendering = SamplePlayback if self.bus.frames is None else FramePlayback
        self.rendering: SamplePlayback | FramePlayback = rendering(self.display, self.bus)
        ContactTracker().at(np.zeros(BLOCK), 0.0)  # what is used first takes long
        self.tracker = ContactTracker()
        self.report = PlaybackReport(sample_rate=self.bus.wiring.sample_rate)
        self._rate = self.bus.wiring.sample_rate
        self._client = self._position = self._skipped = self._dropped_waves = 0
        step = 1 / (self.display.limits.fade * self._rate)
        self._air = Ramp(step, 1.0 if self.worn else IN_AIR)
        self._touching = self.worn

    # What the server tells

    def keep(self, number: int, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Have a texture ready under a number, also for its first block."""
        self.textures[number] = texture
        self.rendering.touch(texture)

    def voice(self, client: int) -> Voice:
        """Return a client's voice."""
        if client not in self.voices:
            self.voices[client] = Voice(self._rate, len(self.display.contactors))
        return self.voices[client]

    def forget(self, client: int) -> None:
        """Fade out all that is a client's."""
        voice = self.voices.get(client)
        if voice is not None:
            voice.queue.clear()
            voice.effect.begin(None)
            voice.layers, voice.gone = (), True
            self.refresh(client)

    def refresh(self, client: int) -> None:
        """Play what the client has selected, where the finger is its."""
        if client != self._client:
            return
        voice = self.voices.get(client)
        layers = voice.layers if voice is not None and voice.sounds else ()
        gain = self.gain * (voice.gain if voice is not None else 0.0)
        self.rendering.play([(self.textures[n], g * gain) for n, g in layers if n in self.textures])

    def arm(self) -> None:
        """Start the bus, at 0 V and in silence: no wave of before goes on.

        Raises
        ------
        BusError
            Where the amplifier does not start.
        """
        self.bus.stop()
        self.rendering.flush()
        self.rendering.fade_in()
        for voice in self.voices.values():
            voice.silence()
        self._position = 0
        self.bus.start()
        self.write_report()

    def disarm(self) -> None:
        """Fade out and stop the bus."""
        self.bus.stop()
        self.write_report()

    # The loop

    @property
    def running(self) -> bool:
        """Whether there are blocks to play."""
        return self.bus.state == "running"

    def step(self) -> None:
        """Wait until it is time for a block, render it and play it."""
        self.clock.sleep(self.rendering.asked(self._position) - MARGIN - self.clock.now())
        now = self.clock.now()
        if not self.running:
            return
        self._catch_up(now)
        arrival = self._take_contacts()
        times = self.rendering.due(self._position)
        place, force = self.tracker.at(times, now)
        waves = self._waves(len(times))
        position = self._position
        self._position += self.rendering.spacing
        try:
            self.rendering.write(position, place, force, waves)
        except BusStateError:
            if self.running:
                raise
            return  # an e-stop or a fault came since the look at the bus: nothing to play
        due = self.bus.due(position + self.rendering.first)
        self.memory.write_trace(BlockTrace(position, self.memory.contacts_read, now, due))
        if arrival is not None:
            self.report.latency += SMOOTHED * (due - arrival - self.report.latency)
        self.report.blocks += 1
        self.report.position = float(place[-1, 0]), float(place[-1, 1])
        self.report.normal_force = float(force[-1])
        if self.report.blocks % REPORTED == 0:
            self.write_report()

    def _catch_up(self, now: float) -> None:
        """Where it was held up, go on at what is due by now."""
        late = now - self.rendering.asked(self._position)
        if late > (LATENESS * self.bus.ahead or HELD_UP):
            spacing = self.rendering.spacing
            count = math.ceil(late * self._rate / spacing) * spacing
            self._position += count
            self._skipped += count
            self.rendering.fade_in()

    def _take_contacts(self) -> float | None:
        """Hand contacts on to the tracker; return when the newest of them came [s]."""
        arrival = None
        for touch in self.memory.contacts():
            velocity = (touch.vx, touch.vy) if touch.has_velocity else None
            self.tracker.add(
                touch.time, (touch.x, touch.y), touch.normal_force, velocity, arrival=touch.arrival
            )
            arrival = touch.arrival
            if touch.client != self._client:
                self._client = touch.client
                self.refresh(touch.client)
        return arrival

    def _waves(self, count: int) -> Singles | None:
        """Return the sum of all clients' waves (S, N) [m], of those that a block has time for."""
        touching = self.worn or self.tracker.touching
        if touching != self._touching:
            self._touching = touching
            self._air.to(1.0 if touching else IN_AIR)
        work = {c: amount for c, voice in self.voices.items() if (amount := voice.work(count))}
        chosen = affordable(work, self.report.blocks // TURN)
        total: Singles | None = None
        for client, voice in list(self.voices.items()):
            dropped = client in work and client not in chosen
            self._dropped_waves += dropped + voice.effect.dropped
            voice.effect.dropped = 0
            wave = voice.skip(count) if dropped else voice.take(count)
            if wave is not None:
                scaled = wave * np.float32(voice.gain * self.gain)
                total = scaled if total is None else total + scaled
            elif voice.gone and client not in work:
                del self.voices[client]
        if total is None:
            return None
        return self._air(np.broadcast_to(total, (count, len(self.display.contactors))))

    def write_report(self) -> None:
        """Tell how it stands."""
        r, status = self.report, self.bus.status
        r.time = self.clock.now()
        r.state = state_of(status)
        r.link, r.detail, r.running = status.link, status.detail, self.running
        r.touching, r.client = self.tracker.touching, self._client
        r.velocity = float(self.tracker.velocity[0]), float(self.tracker.velocity[1])
        r.counters = vars(
            PlaybackCounters(
                **self.bus.counters.common(),
                limited_samples=self.rendering.limited,
                lost_contacts=self.memory.lost_contacts,
                skipped_samples=self._skipped,
                dropped_waves=self._dropped_waves,
                late_contacts=self.tracker.late,
                invalid_contacts=self.tracker.invalid,
            )
        )
        self.memory.write_report(r)
        self.memory.shear[:], self.memory.drive[:] = self.rendering.shear, self.rendering.drive
