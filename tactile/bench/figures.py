"""A figure with its goal, and a stopwatch."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tactile.bench.metronome import STEP, beating
from tactile.bus.link.stream import LEAD, LONGEST_LEAD, MOST_LEAD

RATE = 8000.0
"""Hz of every drive that is measured."""
HANDFUL = (
    "abrasive-p120",
    "foam-reticulated-30ppi",
    "glass-ribbed",
    "leather-calf",
    "metal-knurled-rge08",
    "paper-laid",
    "plastic-acrylic-ribbed",
    "rubber-crumb",
    "stone-granite-flamed",
    "textile-corduroy",
    "wood-oak",
)
"""Shipped textures that stand for all where each takes seconds: one of each category, gratings and
sparse events among them. The figures keep their names as the library grows."""


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes
    ----------
    name, value, unit : what was measured
    goal : as text; empty where there is none
    reached : None where there is no goal
    """

    name: str
    value: float
    unit: str
    goal: str = ""
    reached: bool | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


def at_most(name: str, value: float, unit: str, limit: float) -> Figure:
    """Return a figure that must not exceed a limit."""
    return Figure(name, value, unit, f"≤ {limit:g}", bool(value <= limit))


def at_least(name: str, value: float, unit: str, limit: float) -> Figure:
    """Return a figure that must reach a limit."""
    return Figure(name, value, unit, f"≥ {limit:g}", bool(value >= limit))


def beside_machine(name: str, measured: Iterator[Figure]) -> Iterator[Figure]:
    """Yield what is measured, then by how much bare loops woke late beside it, one a processor."""
    with beating() as steps:
        yield from measured
    late = 1e3 * STEP * np.array(steps)
    for part in (50, 99, 99.9):
        yield Figure(f"{name}.machine.p{part:g}", float(np.percentile(late, part)), "ms")
    yield Figure(f"{name}.machine.most", float(late.max()), "ms")
    for lead in 1e3 * np.array((LEAD, MOST_LEAD, LONGEST_LEAD)):
        missed = 1e4 * float(np.mean(late > lead))
        yield Figure(f"{name}.machine.later_than_{lead:g}_ms", missed, "of 10 000")


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Return the shortest of several timings [s]."""
    work()
    found = math.inf
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - begun)
    return found
