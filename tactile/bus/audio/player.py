"""The end of ``audio:`` that holds the card: a program of its own, started by `audio_bus`.

PortAudio hangs for good on closing a stream whose sound server has died, also at the exit of its
program, and has crashed where there is no device; behind a process that can be killed neither
reaches the host. It also plays on while the host computes, and outlives it: when the host is gone
its input ends, and what plays fades.

The last stage of the amplifier, which a card knows nothing of, is a `Board` that PortAudio's
callback owns alone and whose sample clock is the card's. What the host says lies in a deque until
the next callback; nothing waits for a lock.

Messages are pickled: tuples come by the standard input, `StreamOpened`, `Told`, `Failed` and arrays
go by the standard output.
"""

import gc
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import IO, Any, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.messages import HEARTBEAT_MS, SampleFormat, State
from tactile.arrays import Floats
from tactile.bus.audio.devices import choose, default_output, imported, outputs, rate_of
from tactile.bus.base import Wiring
from tactile.bus.board import REASON, SESSION, Board, config_of
from tactile.clock import MONOTONIC
from tactile.errors import BusError, TactileError

Phase = Literal["rest", "waiting", "playing", "ending"]

LEAD = 8e-3
"""s of drive that wait beside one buffer of the card's."""
FIRST = 3.0
"""s for a card to ask for its first buffer."""
LEAVE = 0.3
"""s to be at 0 V after the host is gone, and for the card to play that; then the program ends."""
TOLD = 5e-3
"""s between answers to samples."""
PACKET = 65535
"""Bytes: the longest that the protocol can tell, for a line in memory has no reason to be short."""
BACKLOG = 1000
"""Messages that wait for the card; a host that minds its lead has a tenth of it there."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """What is to be opened.

    Attributes
    ----------
    device : part of its name, or its number; empty for the default one
    channels : to open, at least the wiring's; the others stay at 0
    sample_rate : [Hz], None for the card's own
    wiring : what the card drives, its sample rate yet to be said
    full_scale : volts of drive at digital full scale [V]
    """

    device: str
    channels: int
    sample_rate: float | None
    wiring: Wiring
    full_scale: float


class StreamOpened(NamedTuple):
    """A stream runs.

    Attributes
    ----------
    device : its name and sound system
    wiring : with the sample rate
    latency : of the card's buffers as PortAudio tells it, one of them at least [s]
    """

    device: str
    wiring: Wiring
    latency: float


class Failed(NamedTuple):
    """It cannot be opened: the class of the error, and what it says."""

    kind: str
    text: str


class Told(NamedTuple):
    """How it stands.

    Attributes
    ----------
    answered : the number of the host's message that this answers
    phase : of what plays
    waiting : messages that the card has not taken
    position : played next
    lead : samples that may wait
    underruns, xruns : of the amplifier; of the card while it was not at rest
    late_blocks, dropped_samples : as in `Counters`
    load : share of a core that the callback takes, the mean while it was not at rest
    age : since the card asked for its last buffer [s]
    refused : why the amplifier did not clear its e-stop
    fault : why the callback gave up, else empty
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
    """Volts (S, C) from a position on, and which of the host's blocks they are of."""

    position: int
    block: int
    volts: Floats


class CardOutput:
    """What the card plays: PortAudio's callback.

    Parameters
    ----------
    wiring, full_scale : as in an `Order`

    Attributes
    ----------
    inbox : messages to be taken at the next buffer
    phase : at "rest" the card plays 0 V and the amplifier's clock stands; "waiting" for drive
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
        config = replace(config_of(wiring, wiring.channels, 1), packet_limit=PACKET)
        self._board = Board(config, SampleFormat.PCM16)
        self._wiring, self._full_scale = wiring, full_scale
        self._rate = round(wiring.sample_rate)
        self._longest = self._rate * HEARTBEAT_MS // 2000
        self._queue: deque[CardBlock] = deque()
        self._end = self._waited = self._late = 0
        self._go = self._stopping = False
        self._last = self._held = np.zeros(wiring.channels)
        self._kept: deque[Floats] = deque()
        self._kept_samples = 0

    @property
    def lead(self) -> int:
        """Samples that may wait."""
        return round(LEAD * self._rate) + self.frames

    @property
    def underruns(self) -> int:
        """Times the amplifier had nothing to play."""
        return self._board.amplifier.counters.underruns

    @property
    def output(self) -> Floats:
        """Volts put out (S, C), the last second of what was not rest [V]."""
        return np.concatenate([np.zeros((0, self._wiring.channels)), *list(self._kept)])

    def __call__(self, out: NDArray[np.float32], frames: int, clock: object, flags: Any) -> None:
        """Fill a buffer (frames, channels of the card)."""
        self.called, begun = MONOTONIC.now(), time.thread_time()
        self.frames = max(self.frames, frames)
        out[:] = 0
        try:
            volts = self._broken(frames) if self.fault else self._next(frames)
        except Exception as error:
            self.fault = f"{type(error).__name__}: {error}"
            volts = self._broken(frames)
        if volts is None:
            return
        out[:, : volts.shape[1]] = volts / self._full_scale
        self._last = volts[-1]
        self.xruns += bool(flags and flags.output_underflow)
        self.busy += time.thread_time() - begun
        self.played += frames / self._rate

    def _broken(self, frames: int) -> Floats:
        """Go to 0 V at the slew limit, whatever the amplifier in memory does."""
        self.phase = "rest"
        fall = self._wiring.slew / self._rate * np.arange(1, frames + 1)[:, None]
        return np.asarray(np.sign(self._last) * np.maximum(np.abs(self._last) - fall, 0))

    def _next(self, frames: int) -> Floats | None:
        while self.inbox:
            kind, *rest = self.inbox[0]
            self._handlers[kind](*rest)
            self.inbox.popleft()
        if self.phase == "rest":
            return None
        parts, done = [], 0
        while done < frames:
            parts.append(self._part(min(frames - done, self._longest)))
            done += len(parts[-1])
        return np.concatenate(parts)

    # What the host says

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
        self._board.request(m.Estop(REASON))
        self._leave()

    def _leave(self) -> None:
        """Drop what is queued, and play what the amplifier still puts out."""
        self._queue.clear()
        self.phase = "ending" if self.phase in ("playing", "ending") else "rest"

    def _on_clear(self) -> None:
        self.refused = ""
        if self._board.amplifier.state == State.ESTOP:
            try:
                self._board.clear()
            except BusError as error:
                self.refused = str(error)

    # What is played

    def _part(self, count: int) -> Floats:
        """Return up to ``count`` further samples (S, C) [V]."""
        if self.phase == "waiting" and self._ready(count):
            self._board.start(self.position, self._rate)
            self.phase = "playing"
        if self.phase == "playing" and self._stopping and self.position >= self._end:
            self._fade()
        if self.phase == "playing":
            return self._playing(count)
        if self.phase == "ending":
            return self._ending(count)
        return np.zeros((count, self._wiring.channels))

    def _fade(self) -> None:
        """Fade from where it is; with samples to hold, for to miss each of them costs more."""
        count = round(self._wiring.fade * self._rate) + 1
        self._board.send(self.position, np.tile(self._held, (count, 1)))
        self._board.request(m.Stop(SESSION, quick=False))
        self.phase = "ending"

    def _ready(self, count: int) -> bool:
        """Return whether to begin: there is enough, or no more is to be waited for."""
        if self._go or self._stopping or self._waited >= self.lead:
            return True
        self._waited += count if self._queue else 0
        return False

    def _playing(self, count: int) -> Floats:
        if self._stopping:
            count = min(count, self._end - self.position)
        self._feed()
        volts = self._board.play(count)
        self.position += count
        self._keep(volts)
        return volts

    def _feed(self) -> None:
        """Hand on what the amplifier has room for, in as few packets as can be."""
        limit = self.position + self._board.amplifier.config.fifo
        run: list[Floats] = []
        begin = end = 0
        while self._queue and self._queue[0].position < limit:
            position, block, volts = self._in_time(self._queue.popleft())
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

    def _in_time(self, samples: CardBlock) -> CardBlock:
        """Return what is not late yet, and count what is."""
        late = min(max(self.position - samples.position, 0), len(samples.volts))
        if late:
            self.dropped_samples += late
            self.late_blocks += samples.block != self._late
            self._late = samples.block
        return CardBlock(samples.position + late, samples.block, samples.volts[late:])

    def _ending(self, count: int) -> Floats:
        volts = self._board.play(count)
        moving = np.flatnonzero(volts.any(axis=1))
        ended = int(moving[-1]) + 2 if len(moving) else 1
        self._keep(volts[:ended])
        if self._board.amplifier.state != State.RAMPDOWN and not volts[-1].any():
            self.phase = "rest"
        return volts

    def _keep(self, volts: Floats) -> None:
        self._kept.append(volts)
        self._kept_samples += len(volts)
        while self._kept_samples - len(self._kept[0]) >= self._rate:
            self._kept_samples -= len(self._kept.popleft())


def open_stream(order: Order) -> tuple[CardOutput, Any, StreamOpened]:
    """Open what is ordered, and return it once the card asks for drive."""
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


def told(output: CardOutput, answered: int) -> Told:
    """Return how it stands."""
    return Told(
        answered, output.phase, len(output.inbox), output.position, output.lead,
        output.underruns, output.xruns,
        output.late_blocks, output.dropped_samples, output.busy / max(output.played, 1e-9),
        MONOTONIC.now() - output.called, output.refused, output.fault,
    )  # fmt: skip


def serve(output: CardOutput, inward: IO[bytes], outward: IO[bytes]) -> None:
    """Do what the host says until it closes its end."""
    last = 0.0
    while True:
        try:
            number, kind, *rest = pickle.load(inward)
        except (EOFError, OSError, pickle.UnpicklingError):
            break
        if kind == "output":
            send(outward, output.output)
        elif kind != "ask":
            output.inbox.append((kind, *rest))
        if kind != "samples" or MONOTONIC.now() - last > TOLD:
            send(outward, told(output, number))
            last = MONOTONIC.now()
    output.inbox.append(("stop",))
    end = MONOTONIC.now() + LEAVE
    while (output.inbox or output.phase != "rest") and MONOTONIC.now() < end:
        MONOTONIC.sleep(1e-3)


def send(outward: IO[bytes], message: object) -> None:
    """Tell the host, if it is there."""
    try:
        pickle.dump(message, outward, protocol=5)
        outward.flush()
    except OSError:
        return


def leave(stream: Any) -> NoReturn:
    """End the program, in good order unless PortAudio hangs."""
    limit = threading.Timer(LEAVE, os._exit, [1])
    limit.daemon = True
    limit.start()
    if stream is not None:
        stream.close()
    if "sounddevice" in sys.modules:
        sys.modules["sounddevice"]._terminate()
    os._exit(0)


def main() -> None:
    """Open the card that the first message orders and serve it, or list those that there are."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    inward, outward = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.setswitchinterval(5e-4)
    order = pickle.load(inward)
    try:
        if order is None:
            sd = imported()
            send(outward, (outputs(sd), default_output(sd)))
            leave(None)
        output, stream, opened = open_stream(order)
    except TactileError as error:
        send(outward, Failed(type(error).__name__, str(error)))
        leave(None)
    gc.collect()
    gc.freeze()
    gc.disable()
    send(outward, opened)
    serve(output, inward, outward)
    MONOTONIC.sleep(min(opened.latency, LEAVE))
    leave(stream)
