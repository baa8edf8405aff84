"""The contract that every bus keeps.

Playing
    A bus is idle when it is opened. `Bus.start` sets the sample position with which playing
    begins, and `Bus.write` passes on blocks, each of which carries its position. `Bus.stop` ramps
    to 0 V within the fade, `Bus.abort` goes to 0 V at the slew limit; both may be called at any
    time and any number of times. Leaving a ``with`` block calls one of them, so that no program
    ends with voltage on a finger. `Bus.estop` overtakes everything that is queued, switches high
    voltage off and holds until a person decides to call `Bus.clear`.

Errors
    Faults of the data are counted in `BusCounters` and never raised: gaps between positions,
    samples that are sent twice, voltages beyond the limit. Only a mistake of the caller raises,
    such as a `Bus.write` to a bus that was never started. A link that fails does not make
    `Bus.write` raise: `Bus.status` reports it, the samples that could not be sent are counted, and
    the driver connects again. An e-stop from another thread does not make it raise either, nor
    does an amplifier that went to 0 V by itself and is not armed again: the state becomes
    "estopped" or "idle", and blocks that are written from then on are dropped and counted, at the
    pace of the bus if it has one, until the caller ends playing with `Bus.stop` or `Bus.abort`.

Currents
    Amplifiers may measure the currents of their channels. A bus whose `Bus.correlates` is true
    delivers them by `Bus.take_correlations`, correlated with the drive in windows that follow each
    other from `Bus.start` to `Bus.stop` without a gap; on other buses that returns nothing. Nobody
    has to take them: only the newest are kept, and what is dropped or wrong is counted in
    `Bus.correlation_counters`.

Guards
    Amplifiers may turn a channel down by themselves when its current is not the one that the caller
    expects under the finger. On a bus whose `Bus.guards` is true the caller passes what it expects
    to `Bus.set_guards`, again for each estimate of the load, and learns from
    `Bus.take_guard_reports` from which position on a channel was turned down or came back. Settings
    never delay the drive: on a link that has no time for them the newest ones wait. Nothing is sent
    before the first window of currents since `Bus.start`, and what still waits is forgotten when
    playing begins or ends, at an e-stop, and when the link breaks. On other buses settings do
    nothing.

Marks
    An amplifier may have marker lines for a recorder of another maker. On a bus with `marker_lines`
    the caller passes a code and a position to `Bus.mark` before it writes the block with that
    position, and learns from `Bus.take_marks` that the lines have taken the code with that sample.
    A mark never delays the drive, is shown only with a sample that was written, and is forgotten
    when playing begins or ends, at an e-stop, and when the link breaks. On other buses marks do
    nothing.

Threads
    Any thread may call any method, and a signal handler may call `Bus.estop`. `Bus.start`,
    `Bus.stop`, `Bus.abort`, `Bus.clear` and `Bus.close` exclude each other by a lock. The other
    methods do not take it: blocks and marks are written by one thread at a time. An e-stop waits
    for none of these calls and wins against all of them: e-stops are counted, and the bus is
    "estopped" until a `Bus.clear` that began after the latest e-stop has returned.

Drivers
    What a driver does for another call may therefore come after what it did for an e-stop. Its
    `_stop` and `_abort` must then change nothing. After a `_start` or `_clear` during which an
    e-stop came, `Bus` calls its `_estop` once more.
"""

import math
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
from tactile.bus.correlations import CorrelationCounters, CorrelationWindow, MeasurementQueue
from tactile.bus.guards import GuardReport, GuardSettings
from tactile.bus.marks import MarkReport
from tactile.bus.states import BusState, States
from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, BusStateError, InputError

HostDeath = Literal["ramps", "zero", "holds", "unknown"]
"""Behavior of an amplifier when the host goes silent: it ramps to 0 V, drops to 0 V at once, holds
its last voltage, or nobody knows."""

RATE = 8000.0
"""Sample rate of the drive unless the caller or the link asks for another [Hz]."""


@dataclass(frozen=True)
class DriveBlock:
    """Block of drive samples for all channels.

    Attributes
    ----------
    position : int
        Position of the first sample, counted in samples on the scale that `Bus.start` begins.
    volts : (S, C) array of float
        Drive voltage, one column per channel [V].

    Examples
    --------
    Ten milliseconds of silence for 24 channels, and the position of the block that follows:

    >>> import numpy as np
    >>> import tactile
    >>> block = tactile.DriveBlock(position=160, volts=np.zeros((80, 24)))
    >>> block.position + len(block.volts)
    240
    """

    position: int
    volts: Floats


@dataclass(frozen=True)
class DriveFrame:
    """Drive at one position, as the complex envelopes of carriers.

    Attributes
    ----------
    position : int
        Position in samples, on the scale that `Bus.start` begins.
    volts : (C, P) array of complex
        Envelopes Z, one row per channel and one column per carrier [V]. The drive of a channel is
        Re Σ_p Z_p exp(2πj f_p t), where t is the time of the position.
    """

    position: int
    volts: NDArray[np.complex128]


@dataclass(frozen=True)
class FrameCapability:
    """Capability of a bus that takes frames in place of blocks.

    Attributes
    ----------
    carriers : int
        Maximum number of carriers per frame.
    rate : float
        Rate of the frames [1/s].
    """

    carriers: int
    rate: float


class LimitsLike(Protocol):
    """Limits of a display that a bus needs."""

    @property
    def voltage(self) -> float:
        """Largest magnitude of the drive [V]."""

    @property
    def fade(self) -> float:
        """Length of the ordinary ramp to 0 V [s]."""


class AmplifierLike(Protocol):
    """Amplifier of a display as the audio bus needs to know it; no other bus does."""

    @property
    def audio_full_scale(self) -> float | None:
        """Drive voltage at digital full scale of an audio card [V]; None if unknown."""

    @property
    def ac_coupling(self) -> float:
        """Corner frequency of the high-pass of an audio card's outputs [Hz]; 0 if DC coupled."""


class DisplayLike(Protocol):
    """Properties of a display that a bus needs to be opened for it."""

    @property
    def channels(self) -> int:
        """Number of drive lines."""

    @property
    def slew(self) -> float:
        """Largest rate of change of the drive [V/s]."""

    @property
    def limits(self) -> LimitsLike:
        """Limits of voltage and fade."""

    @property
    def amplifier(self) -> AmplifierLike:
        """Amplifier that drives the display."""


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Properties of a display that its amplifier must know.

    Parameters
    ----------
    channels : int
        Number of drive lines, C.
    sample_rate : float
        Sample rate of the drive [Hz].
    voltage : float
        Largest magnitude of the drive [V].
    slew : float
        Largest rate of change of the drive [V/s].
    fade : float
        Length of the ordinary ramp to 0 V [s].
    """

    channels: int
    sample_rate: float
    voltage: float
    slew: float
    fade: float

    @classmethod
    def of(cls, display: DisplayLike, sample_rate: float) -> "Wiring":
        """Return the wiring of a display.

        Parameters
        ----------
        display : DisplayLike
            Display that the amplifier drives.
        sample_rate : float
            Sample rate of the drive [Hz].

        Returns
        -------
        Wiring
            Channels and limits of the display, with that sample rate.
        """
        return cls(
            channels=display.channels,
            sample_rate=sample_rate,
            voltage=display.limits.voltage,
            slew=display.slew,
            fade=display.limits.fade,
        )


@dataclass
class BusCounters:
    """Events that a bus has counted since it was opened; a frame counts as a block of one sample.

    Attributes
    ----------
    blocks, samples : int
        Blocks and samples that were accepted.
    lost_samples : int
        Positions that no block carried. The amplifier bridges them by a straight line, or fades
        out and in again.
    repeated_samples : int
        Samples whose positions had been written before; they are dropped.
    invalid_samples : int
        Values that were not finite; they are played as 0 V.
    clipped_samples : int
        Values beyond the voltage limit of the `Wiring`; they are clipped to it.
    underruns : int
        Times at which the amplifier had nothing to play and faded.
    late_blocks : int
        Blocks that did not arrive completely before they were due.
    dropped_samples : int
        Samples that were not sent, because they were late already, the link was down, or the bus
        was e-stopped.
    disconnects, reconnects : int
        Times at which the link was lost, and at which it came back.
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
        """Return the counters that every bus has.

        Returns
        -------
        dict of str to int
            Value of each counter of this class, without those of subclasses, by its name.
        """
        return {f.name: int(getattr(self, f.name)) for f in fields(BusCounters)}

    def faults(self) -> dict[str, int]:
        """Return the counters that should be zero and are not.

        Returns
        -------
        dict of str to int
            Value of each such counter by its name.
        """
        counted = {f.name: int(getattr(self, f.name)) for f in fields(self)}
        return {k: n for k, n in counted.items() if n and k not in ("blocks", "samples")}


@dataclass(frozen=True)
class BusStatus:
    """Status of a bus at one instant.

    Attributes
    ----------
    state : BusState
        State of the bus.
    link : {"up", "down"}
        Whether the amplifier can be reached.
    detail : str
        One line on what is wrong; empty if nothing is.
    playing : bool
        Whether the amplifier is known to play. A bus that arms its amplifier again by itself stays
        "running" while its link is down or its amplifier is at 0 V, but does not play.
    last_fault : str
        One line on the latest fault that kept samples from being put out, also after it has
        passed: the cause that the amplifier reported, or the loss of the link. Empty if there was
        none since the bus was opened.
    """

    state: BusState
    link: Literal["up", "down"] = "up"
    detail: str = ""
    playing: bool = False
    last_fault: str = ""


class Bus(ABC):
    """Link to an amplifier; the docstring of the module has the contract.

    Parameters
    ----------
    wiring : Wiring
        Properties of the display that the amplifier drives.
    clock : Clock
        Clock by which the bus waits.

    Attributes
    ----------
    wiring : Wiring
        Properties of the display, with the sample rate that the bus plays.
    counters : BusCounters
        Events that were counted since the bus was opened.
    frames : FrameCapability or None
        What the bus takes in place of blocks; None if it takes blocks.
    on_host_death : HostDeath
        What the amplifier does when the host goes silent.
    paced : bool
        Whether `write` waits until the samples are due; if not, it accepts them at once.
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
        self._windows = MeasurementQueue()
        self._states = States()
        self._call_lock = threading.RLock()  # held by start, stop, abort, clear and close

    @property
    def state(self) -> BusState:
        """State of the bus; "idle" also once an amplifier went to 0 V by itself for good."""
        if self._states.running and self._has_fallen():
            self._states.fall()
        return self._states.now

    @property
    def estops(self) -> int:
        """Number of e-stops since the bus was opened, including those of the amplifier itself."""
        return self._states.estops

    @property
    def next_position(self) -> int:
        """Position after what was written last, whether or not it was dropped."""
        return self._next

    @property
    def unplayed(self) -> int:
        """Number of samples or frames that were not put out as written, as far as it is known.

        It counts from the opening of the bus, and includes positions that no block carried.
        """
        return self.counters.lost_samples + self.counters.dropped_samples

    @property
    def status(self) -> BusStatus:
        """Status of the bus now."""
        state = self.state
        return BusStatus(state, playing=state == "running")

    @property
    def correlates(self) -> bool:
        """Whether amplifiers measure currents, and were asked for their correlations."""
        return False

    @property
    def correlation_counters(self) -> CorrelationCounters:
        """Windows and reports that came, were dropped, and were wrong, since the bus was opened."""
        return self._windows.counters

    def take_correlations(self) -> list[CorrelationWindow]:
        """Return the windows of correlated currents that have come since the last call.

        They are of the drive as it was played, of the windows that are complete. The drive is what
        was written only as long as `BusCounters` counts no fault and the amplifier limits nothing.

        Returns
        -------
        list of CorrelationWindow
            Windows, for each channel in the order of their positions; the newest `MOST_WINDOWS` of
            `correlations`. Empty for a bus that does not correlate.
        """
        return self._windows.take()

    @property
    def guards(self) -> bool:
        """Whether an amplifier has guards, and was asked for the correlations that they need."""
        return False

    def set_guards(self, settings: GuardSettings) -> None:
        """Tell the guards of amplifiers what to expect; return at once.

        It does nothing unless the bus is running and has `guards`, for amplifiers without guards,
        and for those of which no window has come since `start`, since the range of their currents
        is not known. No amplifier confirms settings, and a link may lose them: a caller sets them
        anew with each estimate, within 50 ms.

        Where settings of a channel still wait to be sent, these take their place. A release that
        waits stays, unless the amplifier has reported a newer trip of the channel meanwhile.

        Parameters
        ----------
        settings : GuardSettings
            Settings of channels of the display. Those of a channel that are not finite are left
            out, so that its earlier ones stay in force.
        """
        if self.guards and self.state == "running":
            self._set_guards(settings)

    def take_guard_reports(self) -> list[GuardReport]:
        """Return what guards have reported since the last call.

        A report is here before the first window of currents that its amplifier sent after it. Who
        takes the windows first and then the reports thus has a report for each of them.

        Returns
        -------
        list of GuardReport
            Reports in the order in which they came; the newest `MOST_WINDOWS` of `correlations`.
            Empty for a bus without `guards`.
        """
        return self._windows.take_reports()

    @property
    def marker_lines(self) -> int:
        """Number of marker lines of the amplifier that shows marks; 0 if none has any.

        Of several amplifiers the first one with marker lines shows them, as a recorder needs one.
        """
        return 0

    def mark(self, position: int, code: int) -> None:
        """Show a code on the marker lines with the sample of a position; return at once.

        The code stays for `MARK_LENGTH` of `marks`, unless another one follows, and also if playing
        ends. Call it before the block or the frame with the position is written, from the thread
        that writes. It does nothing unless the bus is running, for a code that the `marker_lines`
        cannot show, and for a position that has been written. A mark is lost with the samples that
        it goes with, and where more than eight wait: it is shown when `take_marks` says so.

        Parameters
        ----------
        position : int
            Position of the sample, from `next_position` on.
        code : int
            Code, of which bit k is the level of line k; 1 … 2 to the power of `marker_lines`, less
            1.
        """
        fits = 0 < code < 1 << self.marker_lines and position >= self._next
        if fits and self.state == "running":
            self._mark(position, code)

    def take_marks(self) -> list[MarkReport]:
        """Return which marks have been shown since the last call.

        Returns
        -------
        list of MarkReport
            Marks in the order in which the amplifier has reported them, the newest `MOST_WINDOWS`
            of `correlations`. Empty for a bus without `marker_lines`.
        """
        return self._windows.take_marks()

    def start(self, position: int = 0) -> None:
        """Begin playing; return when the amplifier has started.

        Parameters
        ----------
        position : int
            Position of the first sample that will be written.

        Raises
        ------
        BusStateError
            If the bus is not idle, takes frames and was not tuned, or an e-stop came meanwhile.
        BusError
            If the amplifier does not start.
        """
        with self._call_lock, self._before_estops("start") as estops:
            if self.state != "idle":
                way = "clear" if self.state == "estopped" else "stop"
                cause = f" ({self._cause})" if way == "clear" and self._cause else ""
                raise BusStateError(
                    f"start: the bus is {self.state}{cause}, not idle; {way} it first"
                )
            self._start(position)
            self._next = position
            self._anchor = position, self._clock.now() + self.ahead
            self._states.begin(estops)

    @property
    def ahead(self) -> float:
        """Time by which samples have to be written before they are put out [s]."""
        return 0.0

    def due(self, position: int) -> float:
        """Return the time at which the sample at a position is put out, as far as it is known.

        A bus that knows the clock of its amplifier computes the time from that. Other buses count
        from the start, and paced ones from the block that was written last.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Time of the host's monotonic clock [s].
        """
        at, when = self._anchor
        return when + (position - at) / self.wiring.sample_rate

    def due_uncertainty(self, position: int) -> float:
        """Return half of an interval around `due` that holds the true time.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Half of the interval; NaN if it is not known [s].
        """
        return math.nan

    def write(self, block: DriveBlock) -> None:
        """Play a block; a paced bus waits until its samples are due, less `ahead`.

        Parameters
        ----------
        block : DriveBlock
            Samples that follow those of the last block. Positions that are skipped or repeated are
            counted, values that are not finite become 0 V, and others are clipped to the limit.

        Raises
        ------
        BusStateError
            If the bus is closed, takes frames, or is idle because it was never started or was
            stopped. It is not raised after an e-stop, or when the amplifier fell to 0 V by itself.
        InputError
            If the block does not have one column per channel.
        """
        if self.frames is not None:
            raise BusStateError("write: the bus takes frames; write_frame")
        plays = self._may_play("write")
        if block.volts.ndim != 2 or block.volts.shape[1] != self.wiring.channels:
            raise InputError(
                f"write: block of shape {block.volts.shape}, needs (S, {self.wiring.channels})"
            )
        if not plays:
            self._next = max(self._next, block.position + len(block.volts))
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
        """Set the carriers of the frames to come.

        Parameters
        ----------
        carriers : (P,) array of float
            Frequencies of the carriers [Hz].

        Raises
        ------
        BusStateError
            If the bus is not idle or takes blocks.
        InputError
            If there is no carrier, or more than `frames` allows.
        """
        if self.frames is None or self.state != "idle":
            takes = "blocks" if self.frames is None else "frames"
            raise BusStateError(f"tune: the bus is {self.state} and takes {takes}")
        self._tune(carriers)

    def write_frame(self, frame: DriveFrame) -> None:
        """Play a frame; envelopes are interpolated linearly from the last frame to this one.

        Parameters
        ----------
        frame : DriveFrame
            Envelopes at one position. A position that is not after the last frame is counted and
            dropped; values that are not finite become 0 V.

        Raises
        ------
        BusStateError
            If the bus is closed, takes blocks, or is idle because it was never started or was
            stopped. It is not raised after an e-stop, or when the amplifier fell to 0 V by itself.
        InputError
            If the frame does not have one row per channel.
        """
        if self.frames is None:
            raise BusStateError("write_frame: the bus takes blocks; write")
        plays = self._may_play("write_frame")
        if frame.volts.ndim != 2 or len(frame.volts) != self.wiring.channels:
            raise InputError(
                f"write_frame: shape {frame.volts.shape}, needs ({self.wiring.channels}, P)"
            )
        if not plays:
            self._next = max(self._next, frame.position + 1)
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
        """Return whether the driver plays what is written; raise if nobody may write now."""
        state = self.state
        if state == "running":
            return True
        if state == "estopped" or (state == "idle" and self._states.interrupted):
            return False
        raise BusStateError(f"{call}: the bus is {state}, not running; start it first")

    def _drop(self, position: int, count: int) -> None:
        """Count samples that are not played, and wait as long as playing them would take."""
        self.counters.dropped_samples += count
        if self.paced:
            self._clock.sleep(count / self.wiring.sample_rate)

    def _tune(self, carriers: Floats) -> None:
        """Set the carriers; only a bus that takes frames has them."""
        raise NotImplementedError

    def _write_frame(self, frame: DriveFrame) -> None:
        """Play a frame after the last one whose values are finite."""
        raise NotImplementedError

    def _allowed(self, volts: Floats) -> Floats:
        """Return samples within the voltage limit, and count those that were not."""
        limit = self.wiring.voltage
        if np.abs(volts).max(initial=0.0) <= limit:
            return volts
        bad = ~np.isfinite(volts)
        volts = np.where(bad, 0.0, volts)
        self.counters.invalid_samples += int(bad.sum())
        self.counters.clipped_samples += int(np.count_nonzero(np.abs(volts) > limit))
        return np.clip(volts, -limit, limit)

    def stop(self) -> None:
        """Ramp to 0 V within the fade and become idle; do nothing unless the bus is running."""
        with self._call_lock:
            if self._states.rest():
                self._stop()

    def abort(self) -> None:
        """Go to 0 V at the slew limit and become idle; do nothing unless the bus is running."""
        with self._call_lock:
            if self._states.rest():
                self._abort()

    def estop(self) -> None:
        """Go to 0 V at the slew limit ahead of everything queued, switch high voltage off and stay.

        It may be called from any thread, in any state, and waits for no other call; a closed bus
        ignores it. Only a `clear` that begins later ends it.
        """
        if self._states.estop():
            try:
                self._estop()
            finally:
                self._states.end_estop()

    def clear(self) -> None:
        """End all e-stops so far and become idle; do nothing unless the bus is e-stopped.

        Call it only when a person has decided so.

        Raises
        ------
        BusStateError
            If another e-stop is under way or came meanwhile; that e-stop holds.
        BusError
            If the amplifier refuses or does not answer; the bus stays e-stopped.
        """
        with self._call_lock, self._before_estops("clear") as estops:
            if self.state != "estopped":
                return
            if self._states.estop_under_way:
                raise BusStateError("clear: an e-stop is under way; clear it when it has ended")
            self._clear()
            self._states.clear(estops)

    def close(self) -> None:
        """Stop and release the device; the bus cannot be used again."""
        with self._call_lock:
            if self.state != "closed":
                self.stop()
                self._close()
                self._states.close()

    @contextmanager
    def _before_estops(self, call: str) -> Iterator[int]:
        """Make a call take effect as if it had ended before each e-stop that comes during it.

        Yield the number of e-stops before the call. If there are more at its end, repeat the
        driver's e-stop and raise BusStateError in place of the driver's own error.
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

    @property
    def _cause(self) -> str:
        """Reason for which an amplifier stopped by itself, if the driver knows it; else empty."""
        return ""

    def _has_fallen(self) -> bool:
        """Return whether a running bus has an amplifier that went to 0 V by itself, for good."""
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
    def _start(self, position: int) -> None:
        """Begin playing at a position; `_estop` is called again if one came meanwhile."""

    @abstractmethod
    def _write(self, block: DriveBlock) -> None:
        """Play a block that begins where the last one ended, or later, and is within the limit."""

    @abstractmethod
    def _stop(self) -> None:
        """Ramp to 0 V within the fade; change nothing after an `_estop`."""

    @abstractmethod
    def _abort(self) -> None:
        """Go to 0 V at the slew limit; change nothing after an `_estop`."""

    @abstractmethod
    def _estop(self) -> None:
        """Go to 0 V and stay there; called from any thread, it waits for no other call."""

    @abstractmethod
    def _clear(self) -> None:
        """End an e-stop; `_estop` is called again if another one came meanwhile."""

    def _set_guards(self, settings: GuardSettings) -> None:  # noqa: B027
        """Pass settings on to amplifiers with guards; wait for nothing, and raise nothing."""

    def _mark(self, position: int, code: int) -> None:  # noqa: B027
        """Show a code that fits the lines with a sample; wait for nothing, and raise nothing."""

    def _close(self) -> None:  # noqa: B027
        """Release the device."""
