"""Playback loop of one display: it renders each block as late as possible.

Each block is rendered for the time at which it will be put out, from the finger's position
predicted for that time, as late as the bus allows. The content of a block follows the mixing rule
of `tactile.messages`: the textures of the client to which the finger belongs, and the waves of all
clients.

The loop never raises because of what it receives and never waits for a sender; what it could not do
is counted. After a delay it continues with the block that is due by then, and fades in.
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
from tactile.playback.outcome import share_put_out
from tactile.playback.shared_memory import (
    PlaybackCounters,
    PlaybackMemory,
    PlaybackReport,
    State,
)
from tactile.playback.voice import ClientState, Voice
from tactile.playback.waves import TURN, affordable
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.rendering.renderer import Ramp, Renderer
from tactile.rendering.spectrum import FrameLimiter, SpectrumRenderer, band_carriers
from tactile.rendering.stroke import Motion
from tactile.tracking.tracker import ContactTracker

BLOCK = 16
"""Length of a block [samples]: 2 ms at 8 kHz."""
MARGIN = 0.5e-3
"""Time for rendering a block before the bus wants it [s] (measured: 0.2 ms for 24 contactors)."""
LATENESS = 0.9
"""Delay from which on a block is skipped because it would be late, as a part of the bus's
``ahead``."""
HELD_UP = 20e-3
"""Delay from which on a block is skipped on a bus that is never late [s]."""
IN_AIR = 10 ** (-34 / 20)
"""Gain of waves while nothing touches the display: an unloaded bimorph rings up by 34 dB
(docs/guide/physics.md)."""
REPORTED = 5
"""Number of blocks from one report of shear and drive to the next."""
SMOOTHED = 0.02
"""Weight of a block's latency in the exponential mean."""


def state_of(status: BusStatus) -> State:
    """Return the state of playback: armed only while the amplifier is known to play.

    Parameters
    ----------
    status : BusStatus
        Status of the bus.

    Returns
    -------
    State
        "disarmed", "armed" or "estopped".
    """
    if status.state == "estopped":
        return "estopped"
    return "armed" if status.playing else "disarmed"


class SamplePlayback:
    """Rendering for a bus that takes blocks of samples.

    Parameters
    ----------
    display : Display
        Display to render for.
    bus : Bus
        Bus to write to.

    Attributes
    ----------
    spacing : int
        Length of a block [samples].
    lag : int
        Delay of the output behind the input that it is rendered from [samples].
    first : int
        Position in a block of the first sample in which a new contact can be noticed [samples].
    shear : (N,) array of float
        Last commanded shear [m].
    drive : (N,) array of float
        Last drive [V].
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
        """Cross-fade to other textures.

        Parameters
        ----------
        layers : sequence of (RealizedLayer, float)
            Textures, each with its gain; textures for frames are ignored.
        """
        self._renderer.play([(t, gain) for t, gain in layers if isinstance(t, RealizedLayer)])

    def fade_in(self) -> None:
        """Let the shear rise from 0."""
        self._renderer.fade_in()

    def due(self, position: int) -> Floats:
        """Return the times for which a block is rendered.

        Parameters
        ----------
        position : int
            Position of the block [samples].

        Returns
        -------
        (S,) array of float
            Times in the host's clock [s].
        """
        rate = self._bus.wiring.sample_rate
        return np.asarray(self._bus.due(position + self.lag) + np.arange(BLOCK) / rate)

    def write_time(self, position: int) -> float:
        """Return the time at which the bus wants a block.

        Parameters
        ----------
        position : int
            Position of the block [samples].

        Returns
        -------
        float
            Time in the host's clock [s].
        """
        return self._bus.due(position) - self._bus.ahead

    def write(self, position: int, place: Floats, force: Floats, waves: Singles | None) -> None:
        """Render a block and write it to the bus.

        Parameters
        ----------
        position : int
            Position of the block [samples].
        place : (S, 2) array of float
            Positions of the finger [m].
        force : (S,) array of float
            Normal forces [N].
        waves : (S, N) array of float32 or None
            Shear to add [m].
        """
        drive, shear = self._renderer.block(place, force, waveform=waves, shear=True)
        self._bus.write(DriveBlock(position, self._display.to_channels(drive)))
        self.drive, self.shear = drive[-1], shear[-1]

    def warm_up(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is allocated.

        Parameters
        ----------
        texture : RealizedLayer or SpectrumRenderer
            Texture to use; one for frames is ignored.
        """
        if isinstance(texture, RealizedLayer):
            motion = Motion(self._bus.wiring.sample_rate)
            stroke = motion(motion.rows(np.zeros((BLOCK, 2)), np.zeros(BLOCK)))
            assert stroke is not None
            texture(stroke)

    def flush(self) -> None:
        """Prepare for a start: render silence until the filters hold nothing played before."""
        nothing = np.zeros((4 * BLOCK, 2))
        for _ in range(4):
            self._renderer.block(nothing, nothing[:, 0])

    @property
    def limited(self) -> int:
        """Number of samples that were turned down."""
        return self._renderer.limiter.limited_samples


class FramePlayback:
    """Rendering for a bus that takes spectrum frames, which have no room for waves.

    All textures have the same carriers; their frames are added and then limited.

    Parameters
    ----------
    display : Display
        Display to render for.
    bus : Bus
        Bus to write to.

    Attributes
    ----------
    spacing : int
        Distance between frames [samples].
    lag : int
        Delay of the output behind the input that it is rendered from [samples].
    first : int
        Position in a stretch of the first sample in which a new contact can be noticed [samples].
    shear : (N,) array of float
        Commanded shear, which is not computed and stays 0 [m].
    drive : (N,) array of float
        Largest drive that the last frame can give [V].
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
        """Change to other textures from the next frame on, to which the envelopes ramp.

        Parameters
        ----------
        layers : sequence of (SpectrumRenderer, float)
            Textures, each with its gain; textures for samples are ignored.
        """
        self._playing = [(t, gain) for t, gain in layers if isinstance(t, SpectrumRenderer)]

    def fade_in(self) -> None:
        """Begin with a frame of 0 V."""
        self._rise = 0.0

    def due(self, position: int) -> Floats:
        """Return the times of a stretch that ends with the next frame.

        Parameters
        ----------
        position : int
            Position of the stretch [samples].

        Returns
        -------
        (S,) array of float
            Times in the host's clock; the last is that of the frame [s].
        """
        end = self._bus.due(position + self.spacing)
        steps = np.arange(self.spacing // BLOCK)[::-1]
        return np.asarray(end - steps * (BLOCK / self._rate))

    def write_time(self, position: int) -> float:
        """Return the time at which the bus wants the frame at the end of a stretch.

        Parameters
        ----------
        position : int
            Position of the stretch [samples].

        Returns
        -------
        float
            Time in the host's clock [s].
        """
        return self._bus.due(position) - self._bus.ahead

    def write(self, position: int, place: Floats, force: Floats, waves: Singles | None) -> None:
        """Render the frame at the end of a stretch and write it to the bus.

        Parameters
        ----------
        position : int
            Position of the stretch [samples].
        place : (S, 2) array of float
            Positions of the finger [m].
        force : (S,) array of float
            Normal forces [N].
        waves : (S, N) array of float32 or None
            Ignored.
        """
        frame_position = position + self.spacing
        step = min(8, len(place) - 1)
        velocity = (place[-1] - place[-1 - step]) * self._rate / (BLOCK * max(step, 1))
        lines = np.zeros((self._display.channels, len(self._carriers)), np.complex128)
        total = np.zeros((len(self._display.contactors), len(self._carriers)), np.complex128)
        for texture, gain in self._playing:
            texture.sample = frame_position
            total += gain * self._rise * texture.unlimited(place[-1], velocity, float(force[-1]))
        total = self._limiter(total)
        lines[self._display.channel] = total
        self._bus.write_frame(DriveFrame(frame_position, lines))
        self._rise = 1.0
        self.drive = np.asarray(np.abs(total).sum(axis=1))

    def warm_up(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is allocated.

        Parameters
        ----------
        texture : RealizedLayer or SpectrumRenderer
            Texture to use; one for samples is ignored.
        """
        if isinstance(texture, SpectrumRenderer):
            texture.unlimited(np.zeros(2), np.zeros(2), 0.0)

    def flush(self) -> None:
        """Set the idle bus to the carriers; nothing of what was played before can sound later."""
        self._bus.tune(self._carriers)

    @property
    def limited(self) -> int:
        """Number of frames that were turned down."""
        return self._limiter.limited_frames


@dataclass
class PlaybackLoop:
    """Loop that plays one display on its bus.

    Parameters
    ----------
    display : Display
        Display to play.
    bus : Bus
        Bus of the display.
    memory : PlaybackMemory
        Memory shared with the server.
    gain : float
        Gain of the display, on top of that of each client.
    worn : bool
        Whether the finger stays on the display although it touches nothing.
    clock : Clock
        Clock of the host, in which blocks are due.

    Attributes
    ----------
    textures : dict of int to RealizedLayer or SpectrumRenderer
        Textures that are ready, by number.
    voices : dict of int to Voice
        Voice of each client.
    rendering : SamplePlayback or FramePlayback
        Rendering for the kind of link.
    position : int
        Position of the next block [samples].
    tracker : ContactTracker
        Tracker of the finger.
    report : PlaybackReport
        Report to the server.
    """

    display: Display
    bus: Bus
    memory: PlaybackMemory
    gain: float = 1.0
    worn: bool = False
    clock: Clock = MONOTONIC
    textures: dict[int, RealizedLayer | SpectrumRenderer] = field(default_factory=dict)
    voices: dict[int, Voice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rendering = SamplePlayback if self.bus.frames is None else FramePlayback
        self.rendering: SamplePlayback | FramePlayback = rendering(self.display, self.bus)
        ContactTracker().at(np.zeros(BLOCK), 0.0)  # the first call is slow: make it before playing
        self.tracker = ContactTracker()
        self.report = PlaybackReport(sample_rate=self.bus.wiring.sample_rate)
        self._rate = self.bus.wiring.sample_rate
        self.position = self._client = self._skipped = self._dropped_waves = 0
        self._unplayed_before = 0
        """Number of samples that had not been put out when playing began."""
        step = 1 / (self.display.limits.fade * self._rate)
        self._air = Ramp(step, 1.0 if self.worn else IN_AIR)
        self._touching = self.worn

    # Orders of the server

    def keep(self, number: int, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Keep a texture ready under a number, and prepare it for its first block.

        Parameters
        ----------
        number : int
            Number of the texture.
        texture : RealizedLayer or SpectrumRenderer
            Texture realized for the display.
        """
        self.textures[number] = texture
        self.rendering.warm_up(texture)

    def voice(self, client: int) -> Voice:
        """Return the voice of a client, which is created if there is none.

        Parameters
        ----------
        client : int
            Number of the client.

        Returns
        -------
        Voice
            Voice of the client.
        """
        if client not in self.voices:
            self.voices[client] = Voice(self._rate, len(self.display.contactors))
        return self.voices[client]

    def forget(self, client: int) -> None:
        """Fade out everything that a client plays.

        Parameters
        ----------
        client : int
            Number of the client.
        """
        voice = self.voices.get(client)
        if voice is not None:
            voice.queue.clear()
            voice.effect.begin(None)
            voice.state.layers, voice.has_left = (), True
            self.refresh(client)

    def refresh(self, client: int) -> None:
        """Play the textures that a client has selected, if the finger belongs to it.

        Parameters
        ----------
        client : int
            Number of the client.
        """
        if client != self._client:
            return
        state = self.voices[client].state if client in self.voices else ClientState()
        layers, gain = state.layers if state.sounds else (), self.gain * state.gain
        self.rendering.play([(self.textures[n], g * gain) for n, g in layers if n in self.textures])

    def arm(self) -> None:
        """Start the bus, at 0 V and in silence: no earlier wave continues.

        Raises
        ------
        BusError
            If the amplifier does not start.
        """
        self.bus.stop()
        self.rendering.flush()
        self.rendering.fade_in()
        for voice in self.voices.values():
            voice.silence()
        self.position, self._unplayed_before = 0, self._unplayed
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
        self.clock.sleep(self.rendering.write_time(self.position) - MARGIN - self.clock.now())
        now = self.clock.now()
        if not self.running:
            return
        self._catch_up(now)
        arrival = self._take_contacts()
        times = self.rendering.due(self.position)
        place, force = self.tracker.at(times, now)
        waves = self._waves(len(times))
        position = self.position
        self.position += self.rendering.spacing
        try:
            self.rendering.write(position, place, force, waves)
        except BusStateError:
            if self.running:
                raise
            return  # an e-stop or a fault came since the state was read: nothing to play
        if arrival is not None:
            due = self.bus.due(position + self.rendering.first)
            self.report.latency += SMOOTHED * (due - arrival - self.report.latency)
        self.report.blocks += 1
        self.report.position = float(place[-1, 0]), float(place[-1, 1])
        self.report.normal_force = float(force[-1])
        if self.report.blocks % REPORTED == 0:
            self.write_report()

    def _catch_up(self, now: float) -> None:
        """Continue with the block that is due now, if the loop was delayed."""
        late = now - self.rendering.write_time(self.position)
        if late > (LATENESS * self.bus.ahead or HELD_UP):
            spacing = self.rendering.spacing
            count = math.ceil(late * self._rate / spacing) * spacing
            self.position += count
            self._skipped += count
            self.rendering.fade_in()

    def _take_contacts(self) -> float | None:
        """Pass contacts to the tracker; return when the newest of them arrived [s]."""
        arrival = None
        for client, sample in self.memory.contacts():
            self.tracker.add(sample)
            arrival = sample.arrival
            if client != self._client:
                self._client = client
                self.refresh(client)
        return arrival

    def _waves(self, count: int) -> Singles | None:
        """Return the sum of all clients' waves (S, N) [m] that a block has time for."""
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
                scaled = wave * np.float32(voice.state.gain * self.gain)
                total = scaled if total is None else total + scaled
            elif voice.has_left and client not in work:
                del self.voices[client]
        if total is None:
            return None
        return self._air(np.broadcast_to(total, (count, len(self.display.contactors))))

    @property
    def _unplayed(self) -> int:
        """Number of samples that were not put out since the bus was opened.

        A bus that takes frames counts frames, and none for a position that was left out.
        """
        if self.bus.frames is None:
            return self.bus.unplayed
        return self.bus.unplayed * self.rendering.spacing + self._skipped

    def write_report(self) -> None:
        """Write the state of playback to the shared memory."""
        r, status = self.report, self.bus.status
        r.time = self.clock.now()
        r.state = state_of(status)
        r.link, r.detail, r.running = status.link, status.detail, self.running
        r.touching, r.client = self.tracker.touching, self._client
        r.put_out_share = share_put_out(self.position, self._unplayed - self._unplayed_before)
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
