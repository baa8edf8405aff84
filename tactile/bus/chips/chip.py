"""Common part of all chips: queued codes, the code that a chip took last, and ramps of codes.

A chip plays by its own clock, which runs within `occupancy.TOLERANCE` of 8000 Hz. Bounds of the
fill of its FIFO must be known at any time, so that no more is written than fits. Each kind of chip
determines them in its own way.
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
"""Number of attempts at a transfer that may safely be repeated, before it counts as failed."""
BURST = 32
"""Length of an ordinary write, 4 ms, which is the most that a BOS1921 takes at once [samples]."""


LEAST = 16
"""Shortest write that is worth a transfer of its own [samples]."""


@dataclass
class ChipCounters(BusCounters):
    """Counters of a bus of chips, in addition to those of every bus.

    Attributes
    ----------
    bus_errors : int
        Number of transfers that failed, most of which were repeated in time.
    stalls : int
        Number of times that a FIFO ran empty because the host was late; the last voltage was held
        meanwhile.
    held_samples : int
        Upper bound of the samples for which the last voltage was held while a FIFO was allowed to
        run empty to measure its clock.
    replayed_samples : int
        Upper bound of the samples that were played twice, after a burst that failed midway.
    unknown_voltages : int
        Number of times that a chip held one of several possible voltages, and was led to 0 V from
        the middle of them.
    stretched_samples : int
        Number of samples that were inserted or removed when blocks were stretched for chips other
        than the first.
    """

    bus_errors: int = 0
    stalls: int = 0
    held_samples: int = 0
    replayed_samples: int = 0
    unknown_voltages: int = 0
    stretched_samples: int = 0


class LostError(OSError):
    """Error for an output whose voltage is no longer known, so that playing must restart at 0 V."""


def codes_of(volts: Floats, volts_per_code: float, most: int) -> list[int]:
    """Convert voltages to the nearest codes.

    Parameters
    ----------
    volts : (S,) array of float
        Voltages [V].
    volts_per_code : float
        Voltage of one code [V].
    most : int
        Largest magnitude of a code.

    Returns
    -------
    list of int
        Codes within ±``most``.
    """
    nearest = np.clip(np.rint(volts / volts_per_code), -most, most)
    return [int(code) for code in nearest]


def ramp_codes(start: int, step: int) -> list[int]:
    """Return the codes of a ramp to 0 at a limited slew.

    Parameters
    ----------
    start : int
        Code before the ramp.
    step : int
        Largest change of the code in a sample.

    Returns
    -------
    list of int
        Codes after ``start``, of which the last is 0.
    """
    magnitude = abs(start)
    sign = 1 if start > 0 else -1
    return [sign * code for code in range(magnitude - step, 0, -step)] + [0]


def stretch(before: float, volts: Floats, count: int) -> Floats:
    """Resample a block to another number of samples over the same time.

    Samples are interpolated linearly, so that neither voltage nor slew increases. At 1 kHz a sample
    midway between two others is 0.7 dB too small (cos π/8), at 250 Hz 0.04 dB.

    Parameters
    ----------
    before : float
        Sample before the block [V].
    volts : (S,) array of float
        Samples of the block [V].
    count : int
        Number of samples of the result.

    Returns
    -------
    (count,) array of float
        Samples [V]; ``volts`` itself if ``count`` equals S.
    """
    if count == len(volts):
        return volts
    positions = np.arange(1, count + 1) * (len(volts) / max(count, 1))
    extended = np.concatenate([[before], volts])
    return np.asarray(np.interp(positions, np.arange(len(extended)), extended), np.float64)


class Chip(ABC):
    """One chip; only the thread that writes to the chips may use it.

    Parameters
    ----------
    target : ChipTarget
        I2C target of the chip.
    clock : Clock
        Clock of the host.
    counters : ChipCounters
        Counters, which are shared with the bus.
    volts_per_code : float
        Voltage of one code [V].
    most : int
        Largest magnitude of a code.
    step : float
        Largest change of the voltage in a sample [V].

    Attributes
    ----------
    kind : str
        Name of the kind of chip.
    default_address : int
        Its I2C address, unless it is set to another one.
    fastest : int
        Highest clock of the I2C bus [Hz].
    lead : int
        Largest number of samples in the FIFO.
    step : int
        Largest change of the code in a sample, at least 1.
    pending : list of int
        Codes that the chip has not taken.
    last : int
        Code that the chip took last.
    unsure : bool
        Whether it is unknown how much of the last burst the chip took.
    """

    kind: ClassVar[str]
    default_address: ClassVar[int]
    fastest: ClassVar[int]
    lead: ClassVar[int]

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters,
        *, volts_per_code: float, most: int, step: float,
    ) -> None:  # fmt: skip
        self.target, self.clock, self.counters = target, clock, counters
        self.volts_per_code, self.most = volts_per_code, most
        self.step = max(1, int(step / volts_per_code))
        self.pending: list[int] = []
        self.last = 0
        self.unsure = False
        self._previous = 0.0

    @property
    def name(self) -> str:
        """Kind and address of the chip."""
        return f"{self.kind} at {self.target.name}"

    def _read(self, data: bytes, size: int) -> bytes:
        """Write bytes, then read; repeat that if it fails."""
        for _ in range(TRIES - 1):
            try:
                return self.target.read(data, size)
            except OSError:
                self.counters.bus_errors += 1
        return self.target.read(data, size)

    def _write(self, data: bytes) -> None:
        """Write bytes that may be written twice; repeat that if it fails."""
        for _ in range(TRIES - 1):
            try:
                return self.target.write(data)
            except OSError:
                self.counters.bus_errors += 1
        return self.target.write(data)

    def put(self, volts: Floats, count: int) -> None:
        """Queue a block of samples, which `flush` writes.

        Parameters
        ----------
        volts : (S,) array of float
            Samples [V].
        count : int
            Number of samples to which the block is stretched.
        """
        self.counters.stretched_samples += abs(count - len(volts))
        samples = stretch(self._previous, volts, count)
        self.pending += codes_of(samples, self.volts_per_code, self.most)
        self._previous = float(volts[-1])

    def flush(self) -> None:
        """Write the pending samples that fit.

        Raises
        ------
        OSError
            If the chip does not take them.
        """
        if self.unsure:
            self.resolve()
        burst = self.pending[: min(self.room(), BURST)] if self.pending else []
        while burst:
            self._burst(burst)
            burst = self.pending[: min(self.room_at(self.clock.now()), BURST)]
            if len(burst) < min(LEAST, len(self.pending)):
                return

    def _mark_taken(self, count: int) -> None:
        """Remove the first pending samples, which the chip has taken."""
        if count:
            self.last = self.pending[count - 1]
            del self.pending[:count]

    def cut(self) -> None:
        """Replace the pending samples by a ramp to 0 V from the sample that the chip took last."""
        if self.unsure:
            self.resolve()
        self.pending = [*ramp_codes(self.last, self.step), 0]
        self._previous = 0.0

    def silence(self) -> None:
        """Discard the pending samples; the output is at 0 V."""
        self.pending, self.last, self.unsure, self._previous = [], 0, False, 0.0

    def demand(self) -> int:
        """Return how many samples should be put next.

        Returns
        -------
        int
            Number of samples.
        """
        return max(0, self.room() - len(self.pending))

    def due(self) -> float:
        """Return when the chip can take the next burst.

        Returns
        -------
        float
            Time on the host's clock [s].
        """
        now = self.clock.now()
        return now + max(0, min(len(self.pending) or BURST, BURST) - self.room_at(now)) / RATE

    def room(self) -> int:
        """Return how many samples certainly fit now within `lead`; may read from the chip.

        Returns
        -------
        int
            Number of samples.
        """
        return self.room_at(self.clock.now())

    @abstractmethod
    def room_at(self, now: float) -> int:
        """Return how many samples certainly fit at a given time, without reading from the chip.

        Parameters
        ----------
        now : float
            Time on the host's clock [s].

        Returns
        -------
        int
            Number of samples.
        """

    @abstractmethod
    def fill(self) -> int:
        """Return how many samples are certainly in the FIFO.

        Returns
        -------
        int
            Number of samples.
        """

    @property
    @abstractmethod
    def lost_at(self) -> float:
        """Time from which the output is no longer known unless something is written [s]."""

    @abstractmethod
    def identify(self) -> None:
        """Check that the chip is of this kind.

        Raises
        ------
        BusError
            If it is another chip.
        OSError
            If it does not answer.
        """

    @abstractmethod
    def wake(self) -> None:
        """Set up the chip at 0 V.

        Raises
        ------
        BusError
            If it is another chip.
        OSError
            If it does not answer.
        """

    def calibrate(self) -> None:  # noqa: B027
        """Measure the rate of the chip's clock at 0 V, if that is necessary."""

    def warm(self) -> None:  # noqa: B027
        """Start up the chip at 0 V, if that takes time; `ready` waits until it has."""

    def ready(self) -> None:  # noqa: B027
        """Wait until the chip plays immediately what is written."""

    @abstractmethod
    def _burst(self, codes: Sequence[int]) -> None:
        """Write the first samples of `pending` into the FIFO, and remove them from there."""

    @abstractmethod
    def resolve(self) -> None:
        """Determine how much the chip took of a burst that failed.

        Raises
        ------
        LostError
            If that cannot be determined.
        """

    @abstractmethod
    def quiet(self) -> bool:
        """Return whether everything has been played.

        Returns
        -------
        bool
            Whether the FIFO is empty.
        """

    @abstractmethod
    def rest(self) -> None:
        """Switch the high voltage off and verify that; the output must be at 0 V."""

    @abstractmethod
    def reset(self) -> None:
        """Switch the output off at any voltage, as the last resort."""


def was_not_acknowledged(error: OSError) -> bool:
    """Return whether a failed write has certainly left nothing in the chip.

    ENXIO means that the address was not acknowledged (Linux, Documentation/i2c/fault-codes.rst).
    Some adapters report EREMOTEIO for every refusal, which says nothing.

    Parameters
    ----------
    error : OSError
        Error of the write.

    Returns
    -------
    bool
        Whether nothing was taken.
    """
    return error.errno == errno.ENXIO
