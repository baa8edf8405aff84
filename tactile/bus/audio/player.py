"""Audio player: the separate program that holds the audio card of an ``audio:`` bus.

`audio_bus` starts it. PortAudio can hang forever when it closes a stream whose sound server has
died, also at the exit of its program, and has crashed where there was no device. In a separate
process, which can be killed, neither affects the host. The player also keeps playing while the host
computes, and outlives it: when the host dies, the player's input ends and the playback fades out.

An audio card has no limits, fades or e-stop. The last stage of the amplifier is therefore a `Board`
that only PortAudio's callback uses, and whose sample clock is that of the card. Messages of the
host lie in a deque until the next callback takes them, so that nothing waits for a lock.

Messages are pickled. Tuples arrive at the standard input; `StreamOpened`, `PlayerStatus`, `Failed`
and arrays leave by the standard output.
"""

import gc
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import IO, Any, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.host import BY_HOST
from firmware_protocol.messages import HEARTBEAT_MS, SampleFormat, State
from tactile.arrays import Floats
from tactile.bus.audio.devices import choose, default_output, imported, outputs, rate_of
from tactile.bus.base import Wiring
from tactile.bus.board import SESSION, Board, config_of
from tactile.bus.output import OutputRecord
from tactile.clock import MONOTONIC
from tactile.errors import BusError, TactileError
from tactile.processes import pipes_of_parent, received, send

Phase = Literal["rest", "waiting", "playing", "ending"]

LEAD = 8e-3
"""Duration of the drive that is queued, in addition to one buffer of the card [s]."""
FIRST = 3.0
"""Time limit for a card to request its first buffer [s]."""
LEAVE = 0.3
"""Time limit to reach 0 V after the host has gone, and for the card to play that [s].

The program ends afterwards.
"""
REPORT_INTERVAL = 5e-3
"""Least interval between reports in reply to samples [s]."""
BACKLOG = 1000
"""Largest number of messages that wait for the card.

A host that observes the lead needs about a tenth of it.
"""


@dataclass(frozen=True, kw_only=True)
class Order:
    """Description of the stream to be opened.

    Attributes
    ----------
    device : str
        Part of the device's name, or its number; empty for the default device.
    channels : int
        Number of channels to open, at least that of the wiring; the others stay at 0.
    sample_rate : float or None
        Requested sample rate [Hz]; None for the card's default.
    wiring : Wiring
        What the card drives. Its sample rate is replaced by that of the stream.
    full_scale : float
        Drive voltage at digital full scale [V].
    """

    device: str
    channels: int
    sample_rate: float | None
    wiring: Wiring
    full_scale: float


class StreamOpened(NamedTuple):
    """Message: the stream has been opened and the card requests drive.

    Attributes
    ----------
    device : str
        Name of the device and of its sound system.
    wiring : Wiring
        What the card drives, with the sample rate of the stream.
    latency : float
        Latency of the card's buffers as PortAudio reports it, at least one buffer [s].
    """

    device: str
    wiring: Wiring
    latency: float


class Failed(NamedTuple):
    """Message: the stream could not be opened.

    Attributes
    ----------
    kind : str
        Name of the error's class.
    text : str
        Error message.
    """

    kind: str
    text: str


class PlayerStatus(NamedTuple):
    """Message: state of the player.

    Attributes
    ----------
    answered : int
        Number of the host's message that this one answers.
    phase : str
        What is played: "rest", "waiting", "playing" or "ending".
    waiting : int
        Number of messages that the callback has not taken.
    position : int
        Position of the sample that is played next.
    lead : int
        Number of samples that may be queued.
    underruns : int
        Number of times that the amplifier had nothing to play.
    xruns : int
        Number of underflows of the card's output while it was not at rest.
    late_blocks, dropped_samples : int
        Counters as in `BusCounters`.
    load : float
        Mean share of a core that the callback uses while the output is not at rest.
    age : float
        Time since the card requested its last buffer [s].
    refused : str
        Reason why the amplifier did not clear its e-stop; empty if it did.
    fault : str
        Reason why the callback gave up; empty if it works.
    """

    answered: int
    phase: Phase
    waiting: int
    position: int
    lead: int
    underruns: int
    xruns: int
    late_blocks: int
    dropped_samples: int
    load: float
    age: float
    refused: str
    fault: str


class CardBlock(NamedTuple):
    """Samples that wait in the player.

    Attributes
    ----------
    position : int
        Position of the first sample.
    block : int
        Number of the host's block that the samples belong to.
    volts : (S, C) array of float
        Drive voltages [V].
    """

    position: int
    block: int
    volts: Floats


class CardOutput:
    """Callback of PortAudio: the samples that the card plays.

    Parameters
    ----------
    wiring : Wiring
        What the card drives.
    full_scale : float
        Drive voltage at digital full scale [V].

    Attributes
    ----------
    inbox : deque of tuple
        Messages that the callback takes before it fills its next buffer.
    phase : str
        "rest" while the card plays 0 V and the amplifier's clock stands still, "waiting" until
        enough drive is queued, "playing", or "ending" while the amplifier goes to 0 V.
    position : int
        Position of the sample that is played next.
    frames : int
        Length of the longest buffer so far [samples].
    xruns, late_blocks, dropped_samples : int
        Counters as in `PlayerStatus`.
    called : float
        Time of the latest call [s].
    refused, fault : str
        Reasons as in `PlayerStatus`.
    busy : float
        Processor time of the callback while the output was not at rest [s].
    played : float
        Duration of what was played while the output was not at rest [s].
    """

    def __init__(self, wiring: Wiring, full_scale: float) -> None:
        self.inbox: deque[tuple[Any, ...]] = deque(maxlen=BACKLOG)
        self._handlers: dict[str, Callable[..., None]] = {
            "start": self._on_start,
            "samples": self._on_samples,
            "go": self._on_go,
            "stop": self._on_stop,
            "abort": self._on_abort,
            "estop": self._on_estop,
            "clear": self._on_clear,
        }
        self.phase: Phase = "rest"
        self.position = self.frames = self.xruns = self.late_blocks = self.dropped_samples = 0
        self.called, self.refused, self.fault = MONOTONIC.now(), "", ""
        self.busy = self.played = 0.0
        self._board = Board(config_of(wiring, wiring.channels, 1), SampleFormat.PCM16)
        self._wiring, self._full_scale = wiring, full_scale
        self._rate = round(wiring.sample_rate)
        self._longest = self._rate * HEARTBEAT_MS // 2000
        self._queue: deque[CardBlock] = deque()
        self._end = self._waited = self._late_block = 0
        self._go = self._stopping = False
        self._last = self._held = np.zeros(wiring.channels)
        self._record = OutputRecord(wiring.channels, self._rate)

    @property
    def lead(self) -> int:
        """Number of samples that may be queued."""
        return round(LEAD * self._rate) + self.frames

    @property
    def underruns(self) -> int:
        """Number of times that the amplifier had nothing to play."""
        return self._board.amplifier.counters.underruns

    @property
    def output(self) -> Floats:
        """Drive voltages of the last second outside of rest, array (S, C) [V]."""
        return self._record.volts

    def __call__(self, out: NDArray[np.float32], frames: int, clock: object, flags: Any) -> None:
        """Fill a buffer ``out`` of shape (frames, channels of the card)."""
        self.called, begun = MONOTONIC.now(), time.thread_time()
        self.frames = max(self.frames, frames)
        out[:] = 0
        try:
            volts = self._emergency_ramp(frames) if self.fault else self._next_buffer(frames)
        except Exception as error:
            self.fault = f"{type(error).__name__}: {error}"
            volts = self._emergency_ramp(frames)
        if volts is None:
            return
        out[:, : volts.shape[1]] = volts / self._full_scale
        self._last = volts[-1]
        self.xruns += bool(flags and flags.output_underflow)
        self.busy += time.thread_time() - begun
        self.played += frames / self._rate

    def _emergency_ramp(self, frames: int) -> Floats:
        """Return a ramp to 0 V at the slew limit, independent of the amplifier in memory."""
        self.phase = "rest"
        fall = self._wiring.slew / self._rate * np.arange(1, frames + 1)[:, None]
        return np.asarray(np.sign(self._last) * np.maximum(np.abs(self._last) - fall, 0))

    def _next_buffer(self, frames: int) -> Floats | None:
        """Take the messages and return the next samples (S, C) [V], None at rest."""
        while self.inbox:
            kind, *rest = self.inbox[0]
            self._handlers[kind](*rest)
            self.inbox.popleft()
        if self.phase == "rest":
            return None
        parts, done = [], 0
        while done < frames:
            parts.append(self._next_part(min(frames - done, self._longest)))
            done += len(parts[-1])
        return np.concatenate(parts)

    # Messages of the host

    def _on_start(self, position: int) -> None:
        self.phase, self.position, self._end = "waiting", position, position
        self._queue.clear()
        self._held = np.zeros(self._wiring.channels)
        self._waited, self._go, self._stopping = 0, False, False

    def _on_samples(self, position: int, block: int, volts: Floats) -> None:
        if self.phase in ("waiting", "playing"):
            self._queue.append(CardBlock(position, block, volts))
            self._end = position + len(volts)

    def _on_go(self) -> None:
        self._go = True

    def _on_stop(self) -> None:
        self._stopping = True
        if self.phase == "waiting" and not self._queue:
            self.phase = "rest"

    def _on_abort(self) -> None:
        if self.phase == "playing":
            self._board.request(m.Stop(SESSION, quick=True))
        self._leave()

    def _on_estop(self) -> None:
        self._board.request(m.Estop(BY_HOST))
        self._leave()

    def _leave(self) -> None:
        """Discard the queue, and play what the amplifier still puts out."""
        self._queue.clear()
        self.phase = "ending" if self.phase in ("playing", "ending") else "rest"

    def _on_clear(self) -> None:
        self.refused = ""
        if self._board.amplifier.state == State.ESTOP:
            try:
                self._board.clear()
            except BusError as error:
                self.refused = str(error)

    # Playback

    def _next_part(self, count: int) -> Floats:
        """Return up to ``count`` further samples (S, C) [V]."""
        if self.phase == "waiting" and self._may_begin(count):
            self._board.start(self.position, self._rate)
            self.phase = "playing"
        if self.phase == "playing" and self._stopping and self.position >= self._end:
            self._fade()
        if self.phase == "playing":
            return self._play(count)
        if self.phase == "ending":
            return self._play_ending(count)
        return np.zeros((count, self._wiring.channels))

    def _fade(self) -> None:
        """Start the fade.

        Samples that hold the last voltage are sent first, because the amplifier needs more time to
        bridge each missing sample.
        """
        count = round(self._wiring.fade * self._rate) + 1
        self._board.send(self.position, np.tile(self._held, (count, 1)))
        self._board.request(m.Stop(SESSION, quick=False))
        self.phase = "ending"

    def _may_begin(self, count: int) -> bool:
        """Return whether to begin: enough drive has come, or there is no more to wait for."""
        if self._go or self._stopping or self._waited >= self.lead:
            return True
        self._waited += count if self._queue else 0
        return False

    def _play(self, count: int) -> Floats:
        if self._stopping:
            count = min(count, self._end - self.position)
        self._feed_amplifier()
        volts = self._board.play(count)
        self.position += count
        self._record.add(volts)
        return volts

    def _feed_amplifier(self) -> None:
        """Pass on what the amplifier has room for, in as few packets as possible."""
        limit = self.position + self._board.amplifier.config.fifo
        run: list[Floats] = []
        begin = end = 0
        while self._queue and self._queue[0].position < limit:
            position, block, volts = self._without_late(self._queue.popleft())
            if len(volts) > limit - position:
                self._queue.appendleft(CardBlock(limit, block, volts[limit - position :]))
                volts = volts[: limit - position]
            if not len(volts):
                continue
            if run and position != end:
                self._board.send(begin, np.concatenate(run))
                run = []
            begin = begin if run else position
            run.append(volts)
            end, self._held = position + len(volts), volts[-1]
        if run:
            self._board.send(begin, np.concatenate(run))

    def _without_late(self, samples: CardBlock) -> CardBlock:
        """Remove and count the samples that are too late."""
        late = min(max(self.position - samples.position, 0), len(samples.volts))
        if late:
            self.dropped_samples += late
            self.late_blocks += samples.block != self._late_block
            self._late_block = samples.block
        return CardBlock(samples.position + late, samples.block, samples.volts[late:])

    def _play_ending(self, count: int) -> Floats:
        """Return the samples until the output is at rest."""
        volts = self._board.play(count)
        moving = np.flatnonzero(volts.any(axis=1))
        ended = int(moving[-1]) + 2 if len(moving) else 1
        self._record.add(volts[:ended])
        if self._board.amplifier.state != State.RAMPDOWN and not volts[-1].any():
            self.phase = "rest"
        return volts


def open_stream(order: Order) -> tuple[CardOutput, Any, StreamOpened]:
    """Open a stream, and wait until the card requests drive.

    Parameters
    ----------
    order : Order
        Description of the stream.

    Returns
    -------
    output : CardOutput
        Callback of the stream.
    stream : sounddevice.OutputStream
        The running stream.
    opened : StreamOpened
        Message for the host.

    Raises
    ------
    InputError
        If the order cannot be met, or the device is not found.
    BusError
        If PortAudio does not open the stream, or the card requests nothing within `FIRST`.
    """
    sd = imported()
    device = choose(outputs(sd), order.device, default_output(sd))
    rate = rate_of(sd, device, order.channels, order.sample_rate)
    wiring = replace(order.wiring, sample_rate=float(rate))
    output = CardOutput(wiring, order.full_scale)
    try:
        stream = sd.OutputStream(
            device=device.number, channels=order.channels, samplerate=wiring.sample_rate,
            blocksize=0, latency="low", dtype="float32", callback=output,
            clip_off=True, dither_off=True,
        )  # fmt: skip
        stream.start()
    except sd.PortAudioError as error:
        raise BusError(f"audio: {device.name!r}: {error}; close what else plays on it") from error
    begun = MONOTONIC.now()
    while not output.frames:
        if MONOTONIC.now() - begun > FIRST:
            raise BusError(f"audio: {device.name!r} opened, but does not play; is it suspended?")
        MONOTONIC.sleep(1e-3)
    latency = max(float(stream.latency), output.frames / wiring.sample_rate)
    return output, stream, StreamOpened(f"{device.name}, {device.api}", wiring, latency)


# The program


def status_of(output: CardOutput, answered: int) -> PlayerStatus:
    """Return the state of the player as a message.

    Parameters
    ----------
    output : CardOutput
        Callback of the stream.
    answered : int
        Number of the host's message that is answered.

    Returns
    -------
    PlayerStatus
        State of the player.
    """
    return PlayerStatus(
        answered, output.phase, len(output.inbox), output.position, output.lead,
        output.underruns, output.xruns,
        output.late_blocks, output.dropped_samples, output.busy / max(output.played, 1e-9),
        MONOTONIC.now() - output.called, output.refused, output.fault,
    )  # fmt: skip


def serve(output: CardOutput, inward: IO[bytes], outward: IO[bytes]) -> None:
    """Carry out the host's messages until the host closes its end, then stop.

    Parameters
    ----------
    output : CardOutput
        Callback of the stream.
    inward, outward : binary file
        Messages from the host and to the host.
    """
    last = 0.0
    for number, kind, *rest in received(inward):
        if kind == "output":
            reply(outward, output.output)
        elif kind != "status":
            output.inbox.append((kind, *rest))
        if kind != "samples" or MONOTONIC.now() - last > REPORT_INTERVAL:
            reply(outward, status_of(output, number))
            last = MONOTONIC.now()
    output.inbox.append(("stop",))
    end = MONOTONIC.now() + LEAVE
    while (output.inbox or output.phase != "rest") and MONOTONIC.now() < end:
        MONOTONIC.sleep(1e-3)


def reply(outward: IO[bytes], message: object) -> None:
    """Send a message to the host; do nothing if the host has gone.

    Parameters
    ----------
    outward : binary file
        Messages to the host.
    message : object
        Message, which is pickled.
    """
    with suppress(OSError):
        send(outward, message)


def leave(stream: Any) -> NoReturn:
    """End the program, by force if PortAudio hangs.

    Parameters
    ----------
    stream : sounddevice.OutputStream or None
        Stream to be closed.
    """
    limit = threading.Timer(LEAVE, os._exit, [1])
    limit.daemon = True
    limit.start()
    if stream is not None:
        stream.close()
    if "sounddevice" in sys.modules:
        sys.modules["sounddevice"]._terminate()
    os._exit(0)


def main() -> None:
    """Open the card that the first message describes and serve it, or list the devices for None."""
    inward, outward = pipes_of_parent()
    sys.setswitchinterval(5e-4)
    order = next(received(inward), None)
    try:
        if order is None:
            sd = imported()
            reply(outward, (outputs(sd), default_output(sd)))
            leave(None)
        output, stream, opened = open_stream(order)
    except TactileError as error:
        reply(outward, Failed(type(error).__name__, str(error)))
        leave(None)
    gc.collect()
    gc.freeze()
    gc.disable()
    reply(outward, opened)
    serve(output, inward, outward)
    MONOTONIC.sleep(min(opened.latency, LEAVE))
    leave(stream)
