"""The clock of LSL beside this program's monotonic clock."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from tactile.arrays import Floats
from tactile.clock import MONOTONIC, Clock

READINGS = 100
"""Number of times that both clocks are read; the reading with the shortest interval counts."""

Times = TypeVar("Times", float, Floats)


@dataclass(frozen=True)
class LslClock:
    """The clock of LSL, by which recorders align streams.

    Attributes
    ----------
    offset : float
        Clock of LSL less the monotonic clock [s].
    uncertainty : float
        Half of the interval around the offset that holds the true one [s].
    """

    offset: float
    uncertainty: float

    def to_lsl(self, time: Times) -> Times:
        """Return times on the clock of LSL.

        Parameters
        ----------
        time : float or array of float
            Times on the monotonic clock [s].

        Returns
        -------
        float or array of float
            Times on the clock of LSL [s].
        """
        return time + self.offset

    def to_monotonic(self, time: Times) -> Times:
        """Return times on the monotonic clock.

        Parameters
        ----------
        time : float or array of float
            Times on the clock of LSL [s].

        Returns
        -------
        float or array of float
            Times on the monotonic clock [s].
        """
        return time - self.offset


def measure_clock(local_clock: Callable[[], float], clock: Clock = MONOTONIC) -> LslClock:
    """Measure the clock of LSL against the monotonic clock.

    Both are the same clock on Linux, so that an offset that may be 0 is 0.

    Parameters
    ----------
    local_clock : Callable
        Function that returns the time of LSL [s].
    clock : Clock
        Monotonic clock of this program.

    Returns
    -------
    LslClock
        Clock of LSL.
    """
    best = LslClock(0.0, float("inf"))
    for _ in range(READINGS):
        before = clock.now()
        time = local_clock()
        after = clock.now()
        if (after - before) / 2 < best.uncertainty:
            best = LslClock(time - (before + after) / 2, (after - before) / 2)
    if abs(best.offset) <= best.uncertainty:
        return LslClock(0.0, best.uncertainty)
    return best
