"""Samples of a finger, as clients send them, and the result of tracking them."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from benchmarks import tracking as bench
from tactile.arrays import Floats
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

RATE = 8000.0
LATENCY = 0.012
BLOCK = 16
ROUNDING = 1e-12
"""Rounding error of a few operations on places of 0.5 m in double precision [m]."""

needs_slide = pytest.mark.skipif(not bench.SLIDE.exists(), reason="needs the recorded slide")


class Run:
    """A tracker whose samples arrive as they are taken, in blocks; all that came out of it."""

    def __init__(self, *, block: int = BLOCK, rate: float = RATE) -> None:
        self.tracker = ContactTracker()
        self.now = 0.0
        self._ahead = LATENCY + np.arange(block) / rate
        self._step, self._count = block / rate, 0
        self._parts: list[tuple[Floats, Floats, Floats]] = []

    def block(self) -> None:
        times = self.now + self._ahead
        self._parts.append((times, *self.tracker.at(times, self.now)))
        self._count += 1
        self.now = self._count * self._step

    def until(self, end: float) -> "Run":
        while self.now < end - 1e-9:
            self.block()
        return self

    def samples(self, rows: Iterable[tuple[float, ...]]) -> "Run":
        """Play while samples (time, x, y, force) come, each when it was taken."""
        for time, x, y, force in rows:
            self.until(time)
            self.tracker.add(FingerSample(time, time, x, y, force))
        return self

    @property
    def times(self) -> Floats:
        return np.concatenate([part[0] for part in self._parts])

    @property
    def place(self) -> Floats:
        return np.concatenate([part[1] for part in self._parts])

    @property
    def force(self) -> Floats:
        return np.concatenate([part[2] for part in self._parts])


def stroke(
    speed: float, begin: float, end: float, *, at: float = 0.0, force: float = 0.5, rate: float = 90
) -> list[tuple[float, float, float, float]]:
    """Return samples of a steady stroke along x, that is at ``at`` at time 0."""
    times = np.arange(math.ceil(begin * rate), math.ceil(end * rate)) / rate
    return [(t, at + speed * t, 0.0, force) for t in times.tolist()]


def speeds(place: Floats, rate: float = RATE) -> Floats:
    return np.asarray(np.hypot(*np.diff(place, axis=0).T) * rate)
