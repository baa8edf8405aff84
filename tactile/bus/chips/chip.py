"""What the chips have in common: codes that wait, what a chip took last, ramps of codes.

A chip plays by its own clock, which runs within `occupancy.TOLERANCE` of 8000 Hz. How full its FIFO
is must be known at any time within bounds, so that it is never written beyond what fits; each kind
of chip says how.
"""

import errno
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tactile.arrays import Floats
from tactile.bus.base import BusCounters
from tactile.bus.chips.adapter import ChipTarget
from tactile.bus.chips.occupancy import RATE
from tactile.clock import Clock

TRIES = 4
"""Of a transfer that does no harm when repeated, before it counts as failed."""
BURST = 32
"""Samples of an ordinary write, 4 ms; the most that a BOS1921 takes at once."""


LEAST = 16
"""Samples that are worth a write of their own."""


@dataclass
class ChipCounters(BusCounters):
    """What a bus of chips counts besides.

    Attributes
    ----------
    bus_errors : transfers that failed, most of them repeated in time
    stalls : times a FIFO ran empty for the host was late; the last voltage was held meanwhile
    held_samples : at most so many were held while a FIFO was let run empty to measure its clock
    replayed_samples : at most so many were played twice, after a burst that failed half-way
    unknown_voltages : times a chip held one of several voltages, and was led to 0 V from the
        middle of them
    stretched_samples : inserted or left out by stretching blocks for chips that are not the first
    """

    bus_errors: int = 0
    stalls: int = 0
    held_samples: int = 0
    replayed_samples: int = 0
    unknown_voltages: int = 0
    stretched_samples: int = 0


class LostError(OSError):
    """Where the output is no longer known, so that playing may only begin anew from 0 V."""


def codes_of(volts: Floats, volts_per_code: float, most: int) -> list[int]:
    """Return volts as the nearest codes, within ±``most``."""
    nearest = np.clip(np.rint(volts / volts_per_code), -most, most)
    return [int(code) for code in nearest]


def ramp_codes(start: int, step: int) -> list[int]:
    """Return the codes after ``start`` to 0, each within ``step`` of the last; 0 for none."""
    away = abs(start)
    sign = 1 if start > 0 else -1
    return [sign * code for code in range(away - step, 0, -step)] + [0]


def stretch(before: float, volts: Floats, count: int) -> Floats:
    """Return ``count`` samples over the same time as ``volts``; the same where as many.

    Straight lines between samples, so that neither voltage nor slew grows. At 1 kHz a sample
    half-way is 0.7 dB low (cos π/8), at 250 Hz 0.04 dB.

    Parameters
    ----------
    before : the sample before the block [V]
    volts : (S,) [V]
    count : of the result
    """
    if count == len(volts):
        return volts
    places = np.arange(1, count + 1) * (len(volts) / max(count, 1))
    given = np.concatenate([[before], volts])
    return np.asarray(np.interp(places, np.arange(len(given)), given), np.float64)


class Chip(ABC):
    """One chip; touched by the thread that writes alone.

    Parameters
    ----------
    target : where it is
    time : the clock
    counters : shared with the bus
    volts_per_code : [V]
    most : largest code
    step : largest change of the code in a sample

    Attributes
    ----------
    pending : codes that it has not taken
    last : code that it took last
    unsure : whether it is unknown how much of the last burst it took
    """

    kind: ClassVar[str]
    lead: ClassVar[int]
    """Samples in the FIFO, at most."""

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters,
        *, volts_per_code: float, most: int, step: int,
    ) -> None:  # fmt: skip
        self.target, self.clock, self.counters = target, clock, counters
        self.volts_per_code, self.most, self.step = volts_per_code, most, step
        self.pending: list[int] = []
        self.last = 0
        self.unsure = False
        self._before = 0.0

    @property
    def name(self) -> str:
        """What it is and where."""
        return f"{self.kind} at {self.target.name}"

    def _ask(self, data: bytes, size: int) -> bytes:
        """Write bytes, then read; again where that fails."""
        for _ in range(TRIES - 1):
            try:
                return self.target.read(data, size)
            except OSError:
                self.counters.bus_errors += 1
        return self.target.read(data, size)

    def _tell(self, data: bytes) -> None:
        """Write bytes that may be written twice; again where that fails."""
        for _ in range(TRIES - 1):
            try:
                return self.target.write(data)
            except OSError:
                self.counters.bus_errors += 1
        return self.target.write(data)

    def put(self, volts: Floats, count: int) -> None:
        """Take a block (S,) [V] as ``count`` samples, to be written by `flush`."""
        self.counters.stretched_samples += abs(count - len(volts))
        wanted = stretch(self._before, volts, count)
        self.pending += codes_of(wanted, self.volts_per_code, self.most)
        self._before = float(volts[-1])

    def flush(self) -> None:
        """Write what is pending and fits; raises OSError where the chip does not take it."""
        if self.unsure:
            self.resolve()
        burst = self.pending[: min(self.room(), BURST)] if self.pending else []
        while burst:
            self._burst(burst)
            burst = self.pending[: min(self.room_at(self.clock.now()), BURST)]
            if len(burst) < min(LEAST, len(self.pending)):
                return

    def _took(self, count: int) -> None:
        if count:
            self.last = self.pending[count - 1]
            del self.pending[:count]

    def cut(self) -> None:
        """Go to 0 V at the slew limit from what the chip took last; drop what is pending."""
        if self.unsure:
            self.resolve()
        self.pending = [*ramp_codes(self.last, self.step), 0]
        self._before = 0.0

    def silence(self) -> None:
        """Drop what is pending; the output is at 0 V."""
        self.pending, self.last, self.unsure, self._before = [], 0, False, 0.0

    def wanted(self) -> int:
        """Return how many samples should be put next."""
        return max(0, self.room() - len(self.pending))

    def due(self) -> float:
        """Return when it can take the next burst [s]."""
        now = self.clock.now()
        return now + max(0, min(len(self.pending) or BURST, BURST) - self.room_at(now)) / RATE

    def room(self) -> int:
        """Return how many samples fit now, for certain, within `lead`; may read from the chip."""
        return self.room_at(self.clock.now())

    @abstractmethod
    def room_at(self, now: float) -> int:
        """Return how many samples fit at a time [s] for certain, by what is known already."""

    @abstractmethod
    def fill(self) -> int:
        """Return how many samples are in the FIFO for certain."""

    @property
    @abstractmethod
    def lost_at(self) -> float:
        """When the output will no longer be known, unless something is written [s]."""

    @abstractmethod
    def identify(self) -> None:
        """Raise BusError where it is another chip, OSError where it does not answer."""

    @abstractmethod
    def wake(self) -> None:
        """Set up, and be at 0 V; raises OSError, BusError where it is another chip."""

    def calibrate(self) -> None:  # noqa: B027
        """Learn the clock's rate at 0 V, where that must be."""

    def warm(self) -> None:  # noqa: B027
        """Let it start up at 0 V, where that takes time; `ready` waits for the end."""

    def ready(self) -> None:  # noqa: B027
        """Wait until it plays what is written at once."""

    @abstractmethod
    def _burst(self, codes: Sequence[int]) -> None:
        """Write what comes first of `pending` into the FIFO, and take it from there."""

    @abstractmethod
    def resolve(self) -> None:
        """Find out what the chip took of a burst that failed, or raise LostError."""

    @abstractmethod
    def quiet(self) -> bool:
        """Return whether all has been played."""

    @abstractmethod
    def rest(self) -> None:
        """Switch high voltage off, verified; only at 0 V."""

    @abstractmethod
    def reset(self) -> None:
        """Switch off at any voltage: the last resort."""


def was_taken_nothing(error: OSError) -> bool:
    """Return whether a failed write has certainly left nothing in the chip.

    ENXIO is the address that was not acknowledged (Linux, Documentation/i2c/fault-codes.rst); some
    adapters say EREMOTEIO for every refusal, which tells nothing.
    """
    return error.errno == errno.ENXIO
