"""What a display plays, as a function of what arrives: textures, waves, contacts and times.

A `Mixer` reads no clock and knows no bus. All that depends on time or chance reaches it as orders
of the server, as the command to be silent before playing begins, and as the `BlockInput` of each
block. Who passes the same to another mixer gets the same drive, bit for bit, unless the filters
follow the finger (`finger_following`).

The content of a block follows the mixing rule of `tactile.messages`: the textures of the client to
which the finger belongs, and the waves of all clients.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tactile.arrays import Singles
from tactile.bus.base import DriveBlock, DriveFrame, FrameCapability
from tactile.display.display import Display
from tactile.errors import BusStateError
from tactile.playback import commands
from tactile.playback.block_rendering import BLOCK, FramePlayback, SamplePlayback
from tactile.playback.schedule import (
    MOST_SCHEDULED,
    MOST_VALUES,
    Begin,
    QueuedStimulus,
    Schedule,
    StimulusOutcome,
)
from tactile.playback.voice import ClientState, Voice
from tactile.playback.waves import TURN, affordable
from tactile.rendering.equalizer import EqualizerLike
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.renderer import Ramp
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

IN_AIR = 10 ** (-34 / 20)
"""Gain of waves while nothing touches the display: an unloaded bimorph rings up by 34 dB
(docs/guide/physics.md)."""
BEGINS_WORK, BEGINS_WORK_IN_BLOCK = 60_000, 6000
"""Largest work of beginning stimuli in one block, which is 64 at the same time, and how much of it
is regained in each block; in units of `tactile.playback.waves`."""
NO_TIME = "the block in which it began had no time for it"
"""Reason of a stimulus that was silent at first."""
UNTOUCHED = "no finger touched the display"
"""Reason of a stimulus that was weaker, or not felt."""
FADING = "playback faded in then, as it does at its beginning and after a gap"
"""Reason of a stimulus that was weaker at first."""
NOTHING: Mapping[int, Sequence[Begin]] = {}
"""Value of what begins in a block in which nothing does."""
MixerOrder = (
    commands.KeepTexture | commands.DropTexture | commands.SetState | commands.AppendSamples
    | commands.AddFrames | commands.BeginEffect | commands.PlayAt | commands.EndWaves
    | commands.ForgetClient
)  # fmt: skip
"""Order that changes what is rendered."""


@dataclass(frozen=True)
class BlockInput:
    """All that a block is rendered from besides orders.

    Attributes
    ----------
    number : int
        Number of blocks that were played before.
    position : int
        Position of the block [samples].
    skipped : bool
        Whether positions before it were skipped, so that it fades in.
    now : float
        Time at which it is rendered, in the host's clock [s].
    due : float
        Time at which the sample that `SamplePlayback.timed` names is put out [s].
    contacts : tuple of (int, FingerSample)
        Contacts that arrived since the block before, each with the number of its client.
    """

    number: int
    position: int
    skipped: bool
    now: float
    due: float
    contacts: tuple[tuple[int, FingerSample], ...]


class Mixer:
    """Renderer of all that clients play on one display.

    Parameters
    ----------
    display : Display
        Display to play.
    sample_rate : float
        Sample rate of the drive [Hz].
    frames : FrameCapability or None
        Frames that the link takes; None for a link that takes samples.
    gain : float
        Gain of the display, on top of that of each client.
    worn : bool
        Whether the finger stays on the display although it touches nothing.
    inverse : EqualizerLike, optional
        What turns shear into volts on a link that takes samples, as in `Renderer`.

    Attributes
    ----------
    display : Display
        Display to play.
    textures : dict of int to RealizedLayer or SpectrumRenderer
        Textures that are ready, by number.
    voices : dict of int to Voice
        Voice of each client.
    schedule : Schedule
        Stimuli that wait for their time.
    onsets : list of StimulusOutcome
        What became of stimuli that were to begin by the end of the last block; whoever reports them
        takes them out.
    rendering : SamplePlayback or FramePlayback
        Rendering for the kind of link.
    tracker : ContactTracker
        Tracker of the finger.
    place : (S, 2) array of float
        Positions of the finger that the last block was rendered for [m].
    force : (S,) array of float
        Normal forces that the last block was rendered for [N].
    dropped_waves : int
        Number of blocks of a client's waves, and of transients, for which there was no time.
    dropped_frames : int
        Number of tactile frames that were not played.
    frame_gaps : int
        Number of times that tactile frames came too late, so that the one before them was held.
    """

    def __init__(
        self,
        display: Display,
        sample_rate: float,
        frames: FrameCapability | None,
        *,
        gain: float,
        worn: bool,
        inverse: EqualizerLike | None = None,
    ) -> None:
        self.display, self.gain, self.worn = display, gain, worn
        self.textures: dict[int, RealizedLayer | SpectrumRenderer] = {}
        self.voices: dict[int, Voice] = {}
        self.schedule = Schedule()
        self.onsets: list[StimulusOutcome] = []
        self._queued: list[QueuedStimulus] = []
        self.rendering: SamplePlayback | FramePlayback = (
            SamplePlayback(display, sample_rate, inverse)
            if frames is None
            else FramePlayback(display, sample_rate, frames)
        )
        ContactTracker().at(np.zeros(BLOCK), 0.0)  # the first call is slow: make it before playing
        self.tracker = ContactTracker()
        self.place, self.force = np.zeros((1, 2)), np.zeros(1)
        self.dropped_waves = self.dropped_frames = self.frame_gaps = self._client = 0
        self._begins_work = BEGINS_WORK
        self._rate = sample_rate
        self._next_time = math.nan
        """Time at which the first sample of the next block is put out [s]."""
        step = 1 / (display.limits.fade * sample_rate)
        self._air = Ramp(step, 1.0 if worn else IN_AIR)
        self._touching = worn

    # Orders

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
            self.voices[client].frames.next_time = self._next_time
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
            voice.end_waves()
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

    def apply(self, order: MixerOrder) -> tuple[float, ...]:
        """Execute an order.

        Parameters
        ----------
        order : MixerOrder
            Order to execute.

        Returns
        -------
        tuple of float
            Result of the order.
        """
        match order:
            case commands.KeepTexture():
                self.keep(order.number, order.texture)
            case commands.DropTexture():
                self.textures.pop(order.number, None)
            case commands.SetState():
                self.voice(order.client).state = order.state
                self.refresh(order.client)
            case commands.BeginEffect():
                self.voice(order.client).effect.begin(order.curve)
            case commands.AppendSamples():
                return self._append(order)
            case commands.AddFrames():
                self._add_frames(order)
            case commands.PlayAt():
                return self._schedule_order(order)
            case commands.EndWaves():
                self.voice(order.client).end_waves()
                self._drop("it was stopped", order.client)
            case commands.ForgetClient():
                self._drop("its program has left", order.client)
                self.forget(order.client)
        return ()

    def _append(self, order: commands.AppendSamples) -> tuple[float, ...]:
        """Queue samples; return how many were taken, and the time of those that wait [s]."""
        waves = self.voice(order.client).queue
        if not order.append:
            self._clear(order)
        taken = waves.append(order.samples, order.sample_rate, order.contactors, order.longest)
        return float(taken), waves.waiting(order.contactors)

    def _clear(self, order: commands.AppendSamples, begins: int = 0) -> None:
        """Drop what waits for the contactors of an order, which begins at a position."""
        self.voice(order.client).queue.clear(order.contactors)
        for one in list(self._queued):
            replaced = one.order.client == order.client and one.waits_for(order.contactors)
            if replaced and one.position >= begins:
                self._queued.remove(one)
                self._miss([one.order], "another waveform took its place")

    def _add_frames(self, order: commands.AddFrames, *, exactly: bool = False) -> None:
        """Play tactile frames, unless the client has stopped what it plays."""
        voice, late = self.voice(order.client), False
        dropped = len(order.frames)
        joins = not exactly and order.time is None
        taken = self.schedule.extend(order) if joins else None
        if taken is not None:
            dropped -= taken
        elif voice.state.sounds:
            dropped, late = voice.frames.add(
                order.frames, order.frame_rate,
                latest=order.latest, exactly=exactly, time=order.time,
            )  # fmt: skip
        self.dropped_frames += dropped
        self.frame_gaps += late

    def _schedule_order(self, scheduled: commands.PlayAt) -> tuple[float, ...]:
        """Let a stimulus wait for its time; return the number of its samples or frames."""
        order, taken = scheduled.order, self.schedule.add(scheduled)
        if taken is None:
            taken = 0
            reason = (
                f"{MOST_SCHEDULED} stimuli of this program wait for their time, or {MOST_VALUES} "
                "values of them; send them later"
            )
            if not isinstance(order, commands.AddFrames):
                raise BusStateError(reason)
            self._miss([scheduled], reason)  # nobody waits for the answer to frames
        if isinstance(order, commands.AddFrames):
            self.dropped_frames += len(order.frames) - taken
        if isinstance(order, commands.AppendSamples):
            return float(taken), taken / order.sample_rate
        return ()

    def _miss(self, dropped: list[commands.PlayAt], reason: str) -> None:
        """Report stimuli that are not played."""
        self.onsets += [
            StimulusOutcome(order.number, order.client, None, reason) for order in dropped
        ]

    def _drop(self, reason: str, client: int | None = None) -> None:
        """Drop the stimuli of a client that have not begun, or those of all."""
        queued = [one for one in self._queued if client in (None, one.order.client)]
        self._queued = [one for one in self._queued if client not in (None, one.order.client)]
        self._miss(self.schedule.drop(client) + [one.order for one in queued], reason)

    def drop_scheduled(self) -> None:
        """Drop all stimuli that have not begun, because nothing plays."""
        self._drop("the display was not armed")

    def _begin(self, begin: Begin, start: int, reason: str) -> None:
        """Begin a stimulus at the next sample of its voice, in a block that starts at a position.

        The reason says what is wrong with that sample, if anything.
        """
        scheduled = begin.order
        if begin.late:
            reason = f"late by {1e3 * begin.late:.6g} ms"
        busy = self._busy(scheduled.order)
        if busy:
            reason = f"its contactors were free {1e3 * busy:.6g} ms later"
        if reason and scheduled.drop_late:
            self._miss([scheduled], reason)
            return
        wait = 0.0
        match scheduled.order:
            case commands.AppendSamples() as order:
                wait, missing = self._append_exactly(order, start + begin.offset)
                if missing:
                    reason = f"{missing} samples had no room"
                if missing == len(order.samples):
                    self._miss([scheduled], reason)
                    return
            case commands.BeginEffect() as order:
                self.voice(order.client).effect.begin(order.curve)
            case commands.AddFrames() as order:
                self._add_frames(order, exactly=True)
                if not self.voice(order.client).state.sounds:
                    self._miss([scheduled], "the program has stopped what it plays")
                    return
        at = start + begin.offset + round(wait * self._rate)
        self._queued.append(QueuedStimulus(scheduled, at, reason))

    def _busy(
        self, order: commands.AppendSamples | commands.BeginEffect | commands.AddFrames
    ) -> float:
        """Return the time that samples have to wait for others of their client [s]."""
        if isinstance(order, commands.AppendSamples) and order.append:
            return self.voice(order.client).queue.waiting(order.contactors)
        return 0.0

    def _append_exactly(self, order: commands.AppendSamples, begins: int) -> tuple[float, int]:
        """Play samples at the next sample, a position, if nothing waits for their contactors.

        Return the time until they begin [s], and the number of samples that do not fit.
        """
        queue = self.voice(order.client).queue
        if not order.append:
            self._clear(order, begins)
        taken = queue.append(
            order.samples, order.sample_rate, order.contactors, order.longest, exactly=True
        )
        wait = queue.waiting(order.contactors) - taken / order.sample_rate
        return wait, len(order.samples) - taken

    def silence(self) -> None:
        """Drop all waves and fade in, before playing begins: no earlier wave continues."""
        self.rendering.restart()
        self._drop("the display was armed anew")
        for voice in self.voices.values():
            voice.silence()

    # Rendering

    def render(self, block: BlockInput) -> DriveBlock | DriveFrame:
        """Render a block.

        Parameters
        ----------
        block : BlockInput
            What the block is rendered from.

        Returns
        -------
        DriveBlock or DriveFrame
            Drive of all channels.
        """
        if block.skipped:
            self.rendering.fade_in()
        for client, sample in block.contacts:
            self.tracker.add(sample)
            if client != self._client:
                self._client = client
                self.refresh(client)
        times = self.rendering.times(block.due)
        self.place, self.force = self.tracker.at(times, block.now)
        begins = self._take_scheduled(float(times[0]), len(times))
        start = block.position + self.rendering.timed
        for voice in self.voices.values():
            voice.frames.next_time = float(times[0])
        self._next_time = float(times[0]) + len(times) / self._rate
        waves = self._waves(len(times), block.number, begins, start)
        self._take_begun(start + len(times))
        return self.rendering.render(block.position, self.place, self.force, waves)

    def _take_begun(self, end: int) -> None:
        """Note the stimuli that begin before a position, which are played then."""
        self.onsets += [one.outcome for one in self._queued if one.position < end]
        self._queued = [one for one in self._queued if one.position >= end]

    def _take_scheduled(self, first: float, count: int) -> dict[int, list[Begin]]:
        """Return the stimuli that begin in a block, by client, whose voice there is then."""
        self._begins_work = min(self._begins_work + BEGINS_WORK_IN_BLOCK, BEGINS_WORK)
        begins, used = self.schedule.take(
            first, count, self._rate, self._begins_work, lambda c: self.voice(c).work(count)
        )
        self._begins_work -= used
        for client in begins:
            self.voice(client)
        return begins

    def _waves(
        self,
        count: int,
        number: int,
        begins: Mapping[int, Sequence[Begin]] = NOTHING,
        start: int = 0,
    ) -> Singles | None:
        """Return the sum of all clients' waves (S, N) [m] that block ``number`` has time for."""
        touching = self.worn or self.tracker.touching
        if touching != self._touching:
            self._touching = touching
            self._air.to(1.0 if touching else IN_AIR)
        work = {c: amount for c, voice in self.voices.items() if (amount := voice.work(count))}
        chosen = affordable(work, number // TURN)
        total: Singles | None = None
        for client, voice in list(self.voices.items()):
            dropped = client in work and client not in chosen
            self.dropped_waves += dropped + voice.effect.dropped
            voice.effect.dropped = 0
            self.dropped_frames += voice.frames.dropped
            voice.frames.dropped = 0
            reason = NO_TIME if dropped else FADING if self.rendering.fading else ""
            reason = reason or ("" if touching else UNTOUCHED)
            own = [
                (begin.offset, partial(self._begin, begin, start, reason))
                for begin in begins.get(client, ())
            ]
            wave = voice.skip(count, own) if dropped else voice.take(count, own)
            if wave is not None:
                scaled = wave * np.float32(voice.state.gain * self.gain)
                total = scaled if total is None else total + scaled
            elif voice.has_left and client not in work:
                del self.voices[client]
        if total is None:
            return None
        return self._air(np.broadcast_to(total, (count, len(self.display.contactors))))
