"""Windows of correlated currents, as a bus delivers them, together with the drive of their samples.

Amplifiers send windows in parts, by channels. `SumWindows` keeps the drive that was written, puts
the parts of a window together in the order of the contactors, and passes a window on as soon as all
of it has come and the drive shortly after it is known. The drive is that which was played: what
guards have held down is taken into account. With it goes the effective voltage, by the hysteresis
of the contactors.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.bus.correlations import CorrelationWindow
from tactile.bus.guard_gains import GuardGains
from tactile.display.display import Display
from tactile.sensing.correlation import AFTER, EARLIER, LAGS, MARGIN, SumWindow, during
from tactile.sensing.hysteresis import EffectiveVoltage, PlayModel

KEPT = 0.5
"""Time for which the drive is kept; a window that comes later is dropped [s]."""
GATHERED = 25e-3
"""Time after which drive is added to the array of what is kept, since that is copied then [s]."""
HISTORY = EARLIER + AFTER + 1
"""Number of samples of drive before a window that are needed."""
DOUBTED = 0.25
"""Time after a disturbance of the drive for which windows are not valid: amplifiers report how many
samples they limited, bridged or lacked each quarter of a second [s]."""
SWINGING = 25e-3
"""Time after a guard has tripped for which windows are not valid for the contactor, since its tip
swings as neither a finger nor air lets it [s]."""


@dataclass(frozen=True)
class PlayedWindow:
    """Window of all contactors.

    Attributes
    ----------
    position, end : int
        Position of its first sample, and of the first one after it.
    window : SumWindow
        Sums and drive. They are valid where the current was within the range and the drive is
        known.
    clipped : (N,) array of bool
        Whether the current was beyond the range.
    current_range : float
        Current at the end of the range [A].
    """

    position: int
    end: int
    window: SumWindow
    clipped: NDArray[np.bool_]
    current_range: float


@dataclass
class _Parts:
    """Parts of a window that have come."""

    samples: int
    current_range: float
    sums: Floats
    rounding: Floats
    clipped: NDArray[np.bool_]
    held: NDArray[np.bool_]
    """Whether a guard held each contactor down."""
    missing: NDArray[np.bool_]


class SumWindows:
    """Windows of a bus as the estimator of loads takes them.

    Parameters
    ----------
    display : Display
        Display whose N contactors the bus drives.
    bus : Bus
        Bus that correlates.
    hysteresis : PlayModel, optional
        Hysteresis of the contactors; none by default, as before it has been measured.

    Attributes
    ----------
    dropped : int
        Number of windows that were dropped, because a part of them or their drive was missing.
    gains : GuardGains
        Gains with which guards hold contactors down.
    """

    def __init__(self, display: Display, bus: Bus, hysteresis: PlayModel | None = None) -> None:
        self._display, self._bus = display, bus
        self._rate = bus.wiring.sample_rate
        self._begin: int | None = None
        """Position of the first sample of the stream."""
        self._drive = np.zeros((HISTORY, len(display.contactors)))
        """Drive up to the latest position."""
        self._end = 0
        """Position after the latest sample of the drive."""
        self._written: list[Floats] = []
        """Latest drive, which is added to the rest when there is a whole `GATHERED` of it."""
        self._gathered = 0
        """Position after the latest sample that was added to the rest."""
        self._effective = EffectiveVoltage(hysteresis or PlayModel.none(self._drive.shape[1]))
        self._parts: dict[int, _Parts] = {}
        self._ready: deque[tuple[int, _Parts]] = deque()
        self._disturbed, self._doubted_until = self._disturbances(), -1
        self.gains = GuardGains(len(display.contactors), round(self._rate))
        self.dropped = 0

    def wrote(self, position: int, drive: Floats) -> None:
        """Note drive that has been written.

        Parameters
        ----------
        position : int
            Position of the first sample. If others are missing before it, the windows of what
            played before are dropped, and those after it are doubted for a while.
        drive : (S, N) array of float
            Drive of each contactor [V].
        """
        if self._begin is None:
            self._begin = self._end = self._gathered = position
        elif position != self._end:
            self.restart()
            self._begin = position + HISTORY
            self._end = self._gathered = position
            self._doubted_until = position + round(DOUBTED * self._rate)
        self._written.append(drive)
        self._end = position + len(drive)
        if self._end - self._gathered >= GATHERED * self._rate:
            self._gather()

    def restart(self) -> None:
        """Begin with another stream, before which the drive is 0 V."""
        self.dropped += len(self._parts) + len(self._ready)
        self._begin, self._drive = None, np.zeros((HISTORY, len(self._display.contactors)))
        self._written.clear()
        self._effective.restart()
        self._parts.clear()
        self._ready.clear()
        self.gains.restart()
        self._disturbed, self._doubted_until = self._disturbances(), -1

    def _gather(self) -> None:
        """Add the latest drive to the rest, of which the oldest is dropped."""
        kept = HISTORY + round(KEPT * self._rate)
        self._drive = np.concatenate([self._drive, *self._written])[-kept:]
        self._gathered = self._end
        self._written.clear()

    def take(self) -> list[PlayedWindow]:
        """Return the windows that are complete.

        Returns
        -------
        list of PlayedWindow
            Windows in order.
        """
        for part in self._bus.take_correlations():
            self._add(part)
        for report in self._bus.take_guard_reports():  # which come before the windows they change
            row, has = self._rows(report.first_channel, len(report.tripped))
            tripped = np.zeros(len(row), np.bool_)
            tripped[has] = report.tripped[row[has]]
            self.gains.report(report.position, has, tripped)
        self._note_disturbances()
        windows = []
        while self._ready and self._ready[0][0] + self._ready[0][1].samples + MARGIN <= self._end:
            position, parts = self._ready.popleft()
            drive = self._played(position, parts)
            if drive is None:
                self.dropped += 1
                continue
            voltage = self._effective.follow(position - HISTORY, drive)
            steps, played = np.diff(voltage, axis=0).T, np.diff(drive, axis=0).T
            end = position + parts.samples
            valid = ~parts.clipped & (end > self._doubted_until)
            swinging = (end > self.gains.latest) & (
                position < self.gains.latest + SWINGING * self._rate
            )
            valid &= ~swinging
            window = SumWindow(
                parts.sums, during(played[:, EARLIER:]), steps[:, EARLIER:],
                2 * parts.rounding, valid, steps[:, :EARLIER],
            )  # fmt: skip
            windows.append(PlayedWindow(position, end, window, parts.clipped, parts.current_range))
        return windows

    def _add(self, part: CorrelationWindow) -> None:
        """Add a part of a window; windows before it that are not complete never will be."""
        if self._begin is None or part.position < self._begin:
            return
        count = len(self._display.contactors)
        for position in [p for p in self._parts if p < part.position]:
            del self._parts[position]
            self.dropped += 1
        parts = self._parts.get(part.position)
        if parts is None:
            parts = _Parts(
                part.samples, part.current_range, np.zeros((count, LAGS)), np.zeros(count),
                np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.ones(count, np.bool_),
            )  # fmt: skip
            self._parts[part.position] = parts
        row, has = self._rows(part.first_channel, len(part.sums))
        parts.sums[has], parts.rounding[has] = part.sums[row[has]], part.rounding[row[has]]
        parts.clipped[has], parts.held[has] = part.clipped[row[has]], part.held[row[has]]
        parts.missing &= ~has
        if not parts.missing.any():
            self._ready.append((part.position, self._parts.pop(part.position)))

    def _rows(self, first: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return the row of each contactor among some channels, and whether it is one of them."""
        row = self._display.channel - first
        return row, (row >= 0) & (row < count)

    def _played(self, position: int, parts: _Parts) -> Floats | None:
        """Return the drive around a window (S, N); None if it is not known any more [V]."""
        self._gather()
        begin = len(self._drive) - (self._end - position) - HISTORY
        if begin < 0:
            return None
        count = HISTORY + parts.samples + MARGIN
        drive = self._drive[begin : begin + count]
        gains = self.gains.gains(position - HISTORY, count)
        if self.gains.correct(position, parts.samples, parts.held):
            gains = self.gains.gains(position - HISTORY, count)
        if gains is not None:
            drive = drive * gains
        return drive

    def _disturbances(self) -> int:
        """Return how often the drive was not what was written, as far as it is known."""
        bus = self._bus
        return bus.correlation_counters.disturbed + bus.unplayed + bus.counters.clipped_samples

    def _note_disturbances(self) -> None:
        """Doubt the windows from now on for a while if the drive was disturbed."""
        disturbed = self._disturbances()
        if disturbed != self._disturbed:
            self._disturbed = disturbed
            self._doubted_until = self._end + round(DOUBTED * self._rate)
