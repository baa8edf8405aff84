"""Reports of the times at which stimuli were put out.

A sample has a time before it is put out, by the clock of the amplifier. Whether it was put out is
known a little later, when the amplifier has reported.
"""

import bisect
import math
from dataclasses import dataclass, field

from tactile.bus.base import Bus
from tactile.playback.commands import OnsetReport
from tactile.playback.schedule import StimulusOutcome

CONFIRMED = 0.3
"""Time after which an amplifier has reported what it did not put out: it is asked for STATUS every
0.25 s [s]."""
NOT_CONFIRMED = "the amplifier has not confirmed its marker"
"""Reason of a stimulus whose marker was lost, or took the place of another one."""


@dataclass
class _Awaited:
    """Stimulus that began in a block that was written.

    Attributes
    ----------
    onset : StimulusOutcome
        The stimulus.
    due : float
        Time at which its first sample is put out [s].
    uncertainty : float
        Half of the interval around it that holds the true time [s].
    unplayed : int
        Number of samples that were not put out when it was written.
    codes : set of int
        Codes that the marker lines have taken with its first sample.
    """

    onset: StimulusOutcome
    due: float
    uncertainty: float
    unplayed: int
    codes: set[int] = field(default_factory=set)


class OnsetReports:
    """Reports on stimuli, each as soon as it is known what became of it.

    Parameters
    ----------
    bus : Bus
        Bus that they play on.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus, self._awaited = bus, list[_Awaited]()
        self._reports: list[OnsetReport] = []

    @property
    def waiting(self) -> bool:
        """Whether there are stimuli of which it is not known what became of them."""
        return bool(self._awaited)

    def add(self, onset: StimulusOutcome, unplayed: int) -> None:
        """Add a stimulus that began, or was dropped.

        Parameters
        ----------
        onset : StimulusOutcome
            The stimulus.
        unplayed : int
            Number of samples that have not been put out so far.
        """
        if onset.position is None:
            self._report(onset, math.nan, math.nan, onset.reason)
        else:
            at, bus = onset.position, self._bus
            new = _Awaited(onset, bus.due(at), bus.due_uncertainty(at), unplayed)
            bisect.insort(self._awaited, new, key=lambda awaited: awaited.due)

    def look(self, now: float, unplayed: int, *, running: bool) -> None:
        """Report what is known by now.

        Parameters
        ----------
        now : float
            Time in the host's clock [s].
        unplayed : int
            Number of samples that have not been put out so far.
        running : bool
            Whether the bus plays.
        """
        self._take_marks()
        while self._awaited and self._awaited[0].due + CONFIRMED < now:
            self._confirm(self._awaited.pop(0), unplayed)
        if not running:
            first = bisect.bisect_right(self._awaited, now, key=lambda awaited: awaited.due)
            for one in self._awaited[first:]:
                self._report(one.onset, math.nan, math.nan, "playback ended before it")
            del self._awaited[first:]

    def settle(self, now: float, unplayed: int) -> None:
        """Report on all stimuli, because positions are going to begin anew.

        Parameters
        ----------
        now : float
            Time in the host's clock [s].
        unplayed : int
            Number of samples that have not been put out so far.
        """
        self.look(now, unplayed, running=False)
        for one in self._awaited:
            self._confirm(one, unplayed)
        self._awaited.clear()

    def _take_marks(self) -> None:
        """Take what the amplifier has reported of its marker lines; what is not awaited is past."""
        for mark in self._bus.take_marks():
            for one in self._awaited:
                if one.onset.position == mark.position:
                    one.codes.add(mark.code)

    def _confirm(self, one: _Awaited, unplayed: int) -> None:
        """Report the time of a stimulus, which samples that were not put out make less certain."""
        lost, marker = max(unplayed - one.unplayed, 0), one.onset.marker
        reasons = [one.onset.reason]
        if lost and not one.onset.reason:
            reasons.append(f"{lost} samples around it were not put out")
        if marker and marker not in one.codes:
            marker = 0
            reasons.append(NOT_CONFIRMED)
        uncertainty = one.uncertainty + lost / self._bus.wiring.sample_rate
        # no clock while samples are lost: the amplifier could not be reached
        due = math.nan if lost and math.isnan(uncertainty) else one.due
        self._report(one.onset, due, uncertainty, "; ".join(filter(None, reasons)), marker)

    def _report(
        self,
        onset: StimulusOutcome,
        time: float,
        uncertainty: float,
        reason: str,
        marker: int = 0,
    ) -> None:
        self._reports.append(
            OnsetReport(onset.number, onset.client, time, uncertainty, reason, marker)
        )

    def take(self) -> list[OnsetReport]:
        """Return the reports since the last call.

        Returns
        -------
        list of OnsetReport
            Reports.
        """
        reports, self._reports = self._reports, []
        return reports
