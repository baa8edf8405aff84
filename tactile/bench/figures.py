"""Measured figures with their goals, and a stopwatch."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tactile.bench.metronome import STEP, beating
from tactile.bus.link.stream import LEAD, LONGEST_LEAD, MOST_LEAD

RATE = 8000.0
"""Sample rate of every drive that is measured [Hz]."""


@dataclass(frozen=True)
class Figure:
    """One measured number, or the reason why it cannot be measured here.

    Attributes
    ----------
    name : str
        Name of the figure.
    value : float
        Measured value; NaN if it cannot be measured here.
    unit : str
        Unit of the value.
    goal : str
        Goal as text; empty if there is none.
    reached : bool or None
        Whether the goal was reached; None if there is none.
    reason : str
        Why the value cannot be measured here; empty if it was.
    """

    name: str
    value: float
    unit: str
    goal: str = ""
    reached: bool | None = None
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the figure as plain data.

        Returns
        -------
        dict
            Attributes by name; a value of NaN is None, because JSON has no NaN.
        """
        return asdict(self) | {"value": None if math.isnan(self.value) else self.value}


def at_most(name: str, value: float, unit: str, limit: float | None) -> Figure:
    """Create a figure whose goal is not to exceed a limit.

    Parameters
    ----------
    name : str
        Name of the figure.
    value : float
        Measured value.
    unit : str
        Unit of value and limit.
    limit : float or None
        Largest value that reaches the goal; None for a figure without a goal.

    Returns
    -------
    Figure
        Figure with its goal.
    """
    if limit is None:
        return Figure(name, value, unit)
    return Figure(name, value, unit, f"≤ {limit:g}", bool(value <= limit))


def at_least(name: str, value: float, unit: str, limit: float | None) -> Figure:
    """Create a figure whose goal is to reach a limit.

    Parameters
    ----------
    name : str
        Name of the figure.
    value : float
        Measured value.
    unit : str
        Unit of value and limit.
    limit : float or None
        Smallest value that reaches the goal; None for a figure without a goal.

    Returns
    -------
    Figure
        Figure with its goal.
    """
    if limit is None:
        return Figure(name, value, unit)
    return Figure(name, value, unit, f"≥ {limit:g}", bool(value >= limit))


def not_measured(name: str, reason: str) -> Figure:
    """Create a figure that stands for what cannot be measured here.

    Parameters
    ----------
    name : str
        Name of the figure, or the beginning of the names of several.
    reason : str
        Why it cannot be measured, and what would do.

    Returns
    -------
    Figure
        Figure without a value.
    """
    return Figure(name, math.nan, "", reason=reason)


def beside_machine(name: str, measured: Iterator[Figure]) -> Iterator[Figure]:
    """Measure how late bare loops wake, one on each processor, while other figures are measured.

    Parameters
    ----------
    name : str
        Prefix of the names of the figures that are added.
    measured : iterator of Figure
        Figures; their measurement takes place as they are consumed.

    Yields
    ------
    Figure
        First the given figures, then percentiles and maximum of the lateness of the loops [ms], and
        how many of 10 000 blocks would be lost at each lead time that a link may have.
    """
    with beating() as steps:
        yield from measured
    lateness = 1e3 * STEP * np.array(steps)
    for part in (50, 99, 99.9):
        yield Figure(f"{name}.machine.p{part:g}", float(np.percentile(lateness, part)), "ms")
    yield Figure(f"{name}.machine.most", float(lateness.max()), "ms")
    for lead in 1e3 * np.array((LEAD, MOST_LEAD, LONGEST_LEAD)):
        missed = 1e4 * float(np.mean(lateness > lead))
        yield Figure(f"{name}.machine.later_than_{lead:g}_ms", missed, "of 10 000")


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Time a function several times, after one run that is not timed.

    Parameters
    ----------
    work : callable
        Function to time.
    repeats : int
        Number of timed runs.

    Returns
    -------
    float
        Shortest duration of a run [s].
    """
    work()
    shortest = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        shortest = min(shortest, time.perf_counter() - start)
    return shortest
