"""Correlations of the channels' currents with the drive, as amplifiers that measure send them.

An amplifier sends them window by window (SPEC.md, 16). `WindowDecoder` checks the messages of one
amplifier and converts them to SI units; `MeasurementQueue` keeps the windows of a bus, and what its
guards and marker lines report, until somebody takes them. What is wrong is counted and never
raised.
"""

import threading
from collections import deque
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.correlation import decode
from firmware_protocol.messages import FULL_SCALE_CODE, Window
from firmware_protocol.packet import TURN
from firmware_protocol.player import distance
from tactile.arrays import Floats
from tactile.bus.guards import GuardReport
from tactile.bus.marks import MarkReport

MOST_WINDOWS = 1024
"""Maximum numbers of windows and of reports that wait to be taken, the newest ones; of 24 channels
and 25 ms these are 13 s."""

Item = TypeVar("Item")
"""Type of what waits in a queue."""


@dataclass(frozen=True, eq=False)
class CorrelationWindow:
    """Currents of some channels in one window, correlated with the drive that was played.

    Attributes
    ----------
    position : int
        Position of the first sample, on the scale that `Bus.start` begins.
    samples : int
        Number of samples.
    first_channel : int
        Channel of the display to which the first of the N rows belongs.
    flags : (N,) array of int
        Bits of `firmware_protocol.messages.Window`.
    sums : (N, 16) array of float
        Correlations Σ i[n] (u[n − l] − u[n − l − 1]) of the current i and the played drive u, over
        the samples n of the window, by the lag l = 0 … 15 [A V].
    rounding : (N,) array of float
        Largest error of the sums that comes from their transmission [A V].
    energy : (N,) array of float
        Σ i² over the samples of the window, within 0.1 % [A²].
    current_range : float
        Current at the end of the range [A].
    """

    position: int
    samples: int
    first_channel: int
    flags: NDArray[np.uint8]
    sums: Floats
    rounding: Floats
    energy: Floats
    current_range: float

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """Channels whose current reached an end of the range, (N,) array of bool."""
        return np.asarray((self.flags & Window.CLIPPED) != 0)

    @property
    def held(self) -> NDArray[np.bool_]:
        """Channels that a guard held down in a part of the window, (N,) array of bool."""
        return np.asarray((self.flags & Window.GUARDED) != 0)


@dataclass
class CorrelationCounters:
    """Events of windows and reports that a bus has counted since it was opened.

    Attributes
    ----------
    windows : int
        Windows that came, in as many parts as the amplifiers sent.
    dropped : int
        Windows that nobody took in time.
    faults : int
        Messages that cannot be right, and windows that overlap others.
    gaps : int
        Windows before which others are missing.
    disturbed : int
        Samples that the amplifiers limited or bridged, or had not in time, as far as they have
        reported: where this rises, the drive of the windows was not what was written. On a link
        amplifiers report each quarter of a second.
    reports : int
        Reports of guards that came.
    dropped_reports : int
        Reports that nobody took in time.
    """

    windows: int = 0
    dropped: int = 0
    faults: int = 0
    gaps: int = 0
    disturbed: int = 0
    reports: int = 0
    dropped_reports: int = 0


class MeasurementQueue:
    """Windows and reports of a bus that wait to be taken; any thread may add and take.

    Attributes
    ----------
    counters : CorrelationCounters
        Events since the bus was opened.
    """

    def __init__(self) -> None:
        self.counters = CorrelationCounters()
        self._windows: deque[CorrelationWindow] = deque()
        self._reports: deque[GuardReport] = deque()
        self._marks: deque[MarkReport] = deque()
        self._lock = threading.Lock()

    def add(self, item: CorrelationWindow | GuardReport | MarkReport) -> None:
        """Add a window or a report, in place of the oldest one if there are too many.

        Parameters
        ----------
        item : CorrelationWindow, GuardReport or MarkReport
            Window or report that has come.
        """
        counters = self.counters
        with self._lock:
            if isinstance(item, MarkReport):
                _kept_newest(self._marks, item)
            elif isinstance(item, GuardReport):
                counters.reports += 1
                counters.dropped_reports += _kept_newest(self._reports, item)
            else:
                counters.windows += 1
                counters.dropped += _kept_newest(self._windows, item)

    def take(self) -> list[CorrelationWindow]:
        """Remove and return the windows.

        Returns
        -------
        list of CorrelationWindow
            Windows in the order in which they came.
        """
        with self._lock:
            return _emptied(self._windows)

    def take_reports(self) -> list[GuardReport]:
        """Remove and return the reports of guards.

        Returns
        -------
        list of GuardReport
            Reports in the order in which they came.
        """
        with self._lock:
            return _emptied(self._reports)

    def take_marks(self) -> list[MarkReport]:
        """Remove and return the reports of marks that were shown.

        Returns
        -------
        list of MarkReport
            Reports in the order in which they came.
        """
        with self._lock:
            return _emptied(self._marks)


def _kept_newest(queue: deque[Item], item: Item) -> bool:
    """Append to a queue; return whether the oldest item was dropped for it."""
    queue.append(item)
    if len(queue) <= MOST_WINDOWS:
        return False
    queue.popleft()
    return True


def _emptied(queue: deque[Item]) -> list[Item]:
    """Empty a queue, and return what was in it."""
    items = list(queue)
    queue.clear()
    return items


class WindowDecoder:
    """Decoder of the windows of one amplifier since a START.

    Parameters
    ----------
    counters : CorrelationCounters
        Counters of the bus.
    begin : int
        Wire position of the START.

    Attributes
    ----------
    range_ua : int
        Range of the current in the latest window [µA]; 0 before the first one.
    """

    def __init__(self, counters: CorrelationCounters, begin: int) -> None:
        self._counters, self._begin = counters, begin
        self.range_ua = 0
        self._next: dict[int, int] = {}
        """Wire position at which the next window of each channel begins."""

    def decode(
        self, message: m.Correlation, caps: m.Caps, position: int, first_channel: int
    ) -> CorrelationWindow | None:
        """Decode a message.

        Parameters
        ----------
        message : Correlation
            Message of the amplifier.
        caps : Caps
            Its capabilities.
        position : int
            Position of the window on the scale of the bus.
        first_channel : int
            First channel of the amplifier on the display.

        Returns
        -------
        CorrelationWindow or None
            The window; None if it cannot be right, which is counted.
        """
        entries = decode(message)
        end = message.first_channel + message.channels
        if entries is None or end > caps.channels or not self._follows(message):
            self._counters.faults += 1
            return None
        self.range_ua = message.range_ua
        amperes = message.range_ua * 1e-6 / FULL_SCALE_CODE
        volts = caps.full_scale_uv * 1e-6 / FULL_SCALE_CODE
        return CorrelationWindow(
            position=position,
            samples=message.samples,
            first_channel=first_channel + message.first_channel,
            flags=entries.flags,
            sums=np.asarray(entries.sums * (amperes * volts)),
            rounding=entries.rounding * (amperes * volts),
            energy=np.asarray(entries.energy * amperes**2),
            current_range=message.range_ua * 1e-6,
        )

    def _follows(self, message: m.Correlation) -> bool:
        """Return whether a window begins where the last one of its channels ended, or later."""
        channels = range(message.first_channel, message.first_channel + message.channels)
        ends = {self._next.get(channel, self._begin) for channel in channels}
        ahead = [distance(message.position, end) for end in ends]
        if min(ahead) < 0:
            return False
        self._counters.gaps += max(ahead) > 0
        end = (message.position + message.samples) % TURN
        self._next.update(dict.fromkeys(channels, end))
        return True
