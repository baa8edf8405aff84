"""The contract that every bus keeps.

A bus is opened idle. `start` tells the sample position that playing begins with, `write` hands on
blocks that each carry their position, `stop` ramps to 0 V within the fade, `abort` goes there at
the slew limit. Both may be called at any time and any number of times; leaving a ``with`` block
calls one of them, so that no program ends with volts on a finger. `estop` overtakes whatever is
queued, takes high voltage away and holds until a person decides to `clear` it.

What arrives wrong is counted, not raised: a gap in positions, samples sent twice, volts beyond what
the amplifier allows. Only a call that its caller's own mistake made wrong raises: a `write` to a
bus that nobody started. A link that fails does not raise: `status` tells the truth about it, what
could not be sent is counted, and the driver connects again. Neither does an e-stop from another
thread, or an amplifier that went to 0 V by itself and is not armed again: the state becomes
"estopped" or "idle", and what is written from then on is dropped and counted, at the pace of a bus
that has one, until `stop` or `abort` says that no more comes.

Any thread may call anything, a signal handler `estop`. Calls but `write` and `estop` go one at a
time. An e-stop waits for none of them and wins against all: e-stops are counted, and the bus is
"estopped" until a `clear` that began after the latest of them has ended. What a driver does for
another call may so come after what it did for an e-stop. `_stop` and `_abort` then must change
nothing; after `_start` and `_clear` the driver's `_estop` is called once more.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from types import TracebackType
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bus.states import BusState, States
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, BusStateError, InputError

HostDeath = Literal["ramps", "zero", "holds", "unknown"]

RATE = 8000.0
"""Hz, of the drive where neither caller nor link asks for another."""


@dataclass(frozen=True)
class DriveBlock:
    """Drive samples for all channels.

    Attributes
    ----------
    position : of the first sample, counted from the start of playing
    volts : (S, C) [V], a column per channel
    """

    position: int
    volts: Floats


@dataclass(frozen=True)
class DriveFrame:
    """The drive at one position, as envelopes of carriers.

    Attributes
    ----------
    position : counted from the start of playing
    volts : (C, P) complex [V], a row per channel; the drive is Re Σ_p Z_p exp 2πj f_p t with t the
        time of the position
    """

    position: int
    volts: NDArray[np.complex128]


@dataclass(frozen=True)
class FrameCapability:
    """What a bus takes in place of blocks: ``carriers`` at most, at ``rate`` frames a second."""

    carriers: int
    rate: float


class LimitsLike(Protocol):
    """What a display may never exceed, in SI units."""

    @property
    def voltage(self) -> float: ...  # noqa: D102
    @property
    def fade(self) -> float: ...  # noqa: D102


class AmplifierLike(Protocol):
    """How an audio card's outputs are wired to it; no other bus asks."""

    @property
    def audio_full_scale(self) -> float | None: ...  # noqa: D102
    @property
    def ac_coupling(self) -> float: ...  # noqa: D102


class DisplayLike(Protocol):
    """What a bus asks of the display it is opened for."""

    @property
    def channels(self) -> int: ...  # noqa: D102
    @property
    def slew(self) -> float: ...  # noqa: D102
    @property
    def limits(self) -> LimitsLike: ...  # noqa: D102
    @property
    def amplifier(self) -> AmplifierLike: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """What an amplifier must know of the display it drives.

    Parameters
    ----------
    channels : C, drive lines
    sample_rate : [Hz]
    voltage : largest magnitude [V]
    slew : largest rate [V/s]
    fade : length of the ordinary ramp [s]
    """

    channels: int
    sample_rate: float
    voltage: float
    slew: float
    fade: float

    @classmethod
    def of(cls, display: DisplayLike, sample_rate: float) -> "Wiring":
        """Return that of a display."""
        return cls(
            channels=display.channels,
            sample_rate=sample_rate,
            voltage=display.limits.voltage,
            slew=display.slew,
            fade=display.limits.fade,
        )


@dataclass
class BusCounters:
    """What a bus counts since it was opened; a frame is a block of one sample.

    Attributes
    ----------
    blocks, samples : taken
    lost_samples : positions that no block carried; bridged by a straight line, or a fade out and in
    repeated_samples : positions that were sent before, dropped
    invalid_samples : values that were not finite, played as 0 V
    clipped_samples : values beyond the amplifier's own voltage limit
    underruns : times the amplifier had nothing to play, and faded
    late_blocks : not all of which came before it was due
    dropped_samples : not sent, for they were late already, the link was down, or the bus was
        e-stopped
    disconnects, reconnects : of the link
    """

    blocks: int = 0
    samples: int = 0
    lost_samples: int = 0
    repeated_samples: int = 0
    invalid_samples: int = 0
    clipped_samples: int = 0
    underruns: int = 0
    late_blocks: int = 0
    dropped_samples: int = 0
    disconnects: int = 0
    reconnects: int = 0

    def common(self) -> dict[str, int]:
        """Return the counters that every bus has, by name."""
        return {f.name: int(getattr(self, f.name)) for f in fields(BusCounters)}

    def faults(self) -> dict[str, int]:
        """Return the counters that should be zero and are not."""
        counted = {f.name: int(getattr(self, f.name)) for f in fields(self)}
        return {k: n for k, n in counted.items() if n and k not in ("blocks", "samples")}


@dataclass(frozen=True)
class BusStatus:
    """How it stands.

    Attributes
    ----------
    state : of the bus
    link : whether the amplifier can be reached
    detail : one line on what is wrong; empty where nothing is
    playing : whether the amplifier is known to play. A bus that arms again by itself stays
        "running" while its link is down or its amplifier at 0 V, but does not play.
    """

    state: BusState
    link: Literal["up", "down"] = "up"
    detail: str = ""
    playing: bool = False


class Bus(ABC):
    """A link to an amplifier; see the module's docstring for the contract.

    Attributes
    ----------
    wiring : the `Wiring` it was opened for
    counters : the `BusCounters`
    frames : what it takes in place of blocks; None where it takes blocks
    on_host_death : what the amplifier does when the host goes silent
    paced : whether `write` waits until it is time; otherwise it takes what it gets
    """

    on_host_death: ClassVar[HostDeath]
    paced: ClassVar[bool] = True
    frames: FrameCapability | None = None

    def __init__(self, wiring: Wiring, clock: Clock = MONOTONIC) -> None:
        self.wiring = wiring
        self._clock = clock
        self.counters = BusCounters()
        self._next = 0
        self._anchor = 0, 0.0
        self._states = States()
        self._call_lock = threading.RLock()  # held by start, stop, abort, clear and close

    @property
    def state(self) -> BusState:
        """What it does: "idle", "running", "estopped" or "closed"."""
        if self._states.running and self._has_fallen():
            self._states.fall()
        return self._states.now

    @property
    def estops(self) -> int:
        """Number of e-stops since it was opened, those of the amplifier among them."""
        return self._states.estops

    @property
    def status(self) -> BusStatus:
        """How it stands now."""
        state = self.state
        return BusStatus(state, playing=state == "running")

    def start(self, position: int = 0) -> None:
        """Begin playing with the sample at ``position``.

        Raises
        ------
        BusStateError
            Unless idle, or where an e-stop came meanwhile.
        BusError
            Where the amplifier does not start.
        """
        with self._call_lock, self._before_estops("start") as estops:
            if self.state != "idle":
                way = "clear" if self.state == "estopped" else "stop"
                raise BusStateError(f"start: the bus is {self.state}, not idle; {way} it first")
            self._next = position
            self._start(position)
            self._anchor = position, self._clock.now() + self.ahead
            self._states.begin(estops)

    @property
    def ahead(self) -> float:
        """By which samples are to be written before they are put out [s]."""
        return 0.0

    def due(self, position: int) -> float:
        """Return when a position is put out, on the host's monotonic clock [s], as far as known.

        A bus that knows its amplifier's clock tells by that. Others count from the start, those
        that hold back who writes from where that was last.
        """
        at, when = self._anchor
        return when + (position - at) / self.wiring.sample_rate

    def write(self, block: DriveBlock) -> None:
        """Play a block.

        Raises
        ------
        BusStateError
            Where it is closed, or idle for nobody started it, or takes frames.
        InputError
            Where the block does not have a column per channel.
        """
        if self.frames is not None:
            raise BusStateError("write: the bus takes frames; write_frame")
        plays = self._may_play("write")
        if block.volts.ndim != 2 or block.volts.shape[1] != self.wiring.channels:
            raise InputError(
                f"write: block of shape {block.volts.shape}, needs (S, {self.wiring.channels})"
            )
        if not plays:
            self._drop(block.position, len(block.volts))
            return
        gap = block.position - self._next
        volts = block.volts
        if gap < 0:
            self.counters.repeated_samples += min(-gap, len(volts))
            volts, gap = volts[-gap:], 0
        self.counters.lost_samples += gap
        self.counters.blocks += 1
        self.counters.samples += len(volts)
        self._next += gap + len(volts)
        if len(volts):
            self._write(DriveBlock(self._next - len(volts), self._allowed(volts)))
            if self.paced:
                self._anchor = self._next - len(volts), self._clock.now() + self.ahead

    def tune(self, carriers: Floats) -> None:
        """Set the carriers (P,) [Hz] of the frames to come.

        Raises
        ------
        BusStateError
            Unless idle, and a bus that takes frames.
        """
        if self.frames is None or self.state != "idle":
            takes = "blocks" if self.frames is None else "frames"
            raise BusStateError(f"tune: the bus is {self.state} and takes {takes}")
        self._tune(carriers)

    def write_frame(self, frame: DriveFrame) -> None:
        """Play a frame: from the last one to it the envelopes run straight.

        Raises
        ------
        BusStateError
            Where it is closed, or idle for nobody started it, or takes blocks.
        InputError
            Where it does not have a row per channel.
        """
        if self.frames is None:
            raise BusStateError("write_frame: the bus takes blocks; write")
        plays = self._may_play("write_frame")
        if frame.volts.ndim != 2 or len(frame.volts) != self.wiring.channels:
            raise InputError(
                f"write_frame: shape {frame.volts.shape}, needs ({self.wiring.channels}, P)"
            )
        if not plays:
            self._drop(frame.position, 1)
            return
        if frame.position < self._next:
            self.counters.repeated_samples += 1
            return
        self.counters.blocks += 1
        self.counters.samples += 1
        self._next = frame.position + 1
        bad = ~np.isfinite(frame.volts)
        self.counters.invalid_samples += int(bad.sum())
        self._write_frame(DriveFrame(frame.position, np.where(bad, 0.0, frame.volts)))

    def _may_play(self, call: str) -> bool:
        """Tell whether the driver plays what is written; raise where nobody may write."""
        state = self.state
        if state == "running":
            return True
        if state == "estopped" or (state == "idle" and self._states.interrupted):
            return False
        raise BusStateError(f"{call}: the bus is {state}, not running; start it first")

    def _drop(self, position: int, count: int) -> None:
        """Count samples from a position on that nobody plays, and wait as if they were played."""
        self.counters.dropped_samples += count
        if self.paced:
            self._clock.sleep(count / self.wiring.sample_rate)

    def _tune(self, carriers: Floats) -> None:
        raise NotImplementedError

    def _write_frame(self, frame: DriveFrame) -> None:
        raise NotImplementedError

    def _allowed(self, volts: Floats) -> Floats:
        limit = self.wiring.voltage
        if np.abs(volts).max(initial=0.0) <= limit:
            return volts
        bad = ~np.isfinite(volts)
        volts = np.where(bad, 0.0, volts)
        self.counters.invalid_samples += int(bad.sum())
        self.counters.clipped_samples += int(np.count_nonzero(np.abs(volts) > limit))
        return np.clip(volts, -limit, limit)

    def stop(self) -> None:
        """Ramp to 0 V within the fade and be idle; nothing to do unless running."""
        with self._call_lock:
            if self._states.rest():
                self._stop()

    def abort(self) -> None:
        """Go to 0 V at the slew limit and be idle; nothing to do unless running."""
        with self._call_lock:
            if self._states.rest():
                self._abort()

    def estop(self) -> None:
        """Go to 0 V at the slew limit before anything that is queued, high voltage off, and stay.

        May be called from any thread, in any state; only a `clear` that begins later ends it.
        """
        if self._states.estop():
            try:
                self._estop()
            finally:
                self._states.end_estop()

    def clear(self) -> None:
        """End the e-stops there have been and be idle, where a person has decided so.

        There is nothing to do unless e-stopped.

        Raises
        ------
        BusStateError
            Where another e-stop is under way, or came meanwhile: it holds.
        BusError
            Where the amplifier refuses it or does not answer: it stays e-stopped.
        """
        with self._call_lock, self._before_estops("clear") as estops:
            if self.state != "estopped":
                return
            if self._states.estop_under_way:
                raise BusStateError("clear: an e-stop is under way; clear it when it has ended")
            self._clear()
            self._states.clear(estops)

    def close(self) -> None:
        """Stop, and let go of the device; the bus cannot be used again."""
        with self._call_lock:
            if self.state != "closed":
                self.stop()
                self._close()
                self._states.close()

    @contextmanager
    def _before_estops(self, call: str) -> Iterator[int]:
        """Let a call be as if it had come before each e-stop that comes while it lasts.

        Yields how many e-stops there were before.
        """
        before, reason = self._states.estops, None
        try:
            yield before
        except BusError as error:
            if self._states.estops == before:
                raise
            reason = error
        finally:
            if self._states.estops != before:
                self._estop()
        if self._states.estops != before:
            why = f"{call}: the bus was e-stopped meanwhile; clear it first"
            raise BusStateError(why) from reason

    def _has_fallen(self) -> bool:
        """Tell, while running, whether the amplifier is at 0 V for good, and not by a call."""
        return False

    def __enter__(self) -> "Bus":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is not None:
                self.abort()
        finally:
            self.close()

    @abstractmethod
    def _start(self, position: int) -> None: ...

    @abstractmethod
    def _write(self, block: DriveBlock) -> None:
        """Play a block that begins where the last ended or later, and is within the limit."""

    @abstractmethod
    def _stop(self) -> None:
        """Ramp to 0 V; change nothing after an `_estop`."""

    @abstractmethod
    def _abort(self) -> None:
        """Go to 0 V at the slew limit; change nothing after an `_estop`."""

    @abstractmethod
    def _estop(self) -> None:
        """Go to 0 V and stay, from any thread and without waiting for another call."""

    @abstractmethod
    def _clear(self) -> None: ...

    def _close(self) -> None:  # noqa: B027
        """Let go of the device."""
