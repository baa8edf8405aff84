"""Drive of the calibration in air: a few tones at a time, so that lag sums tell them apart.

Lag sums of a window (`correlation`) hold at most `LAGS` numbers, and tones that are near each other
hardly differ in them. The lines are therefore played in segments of a few lines that are far apart,
one after the other with a cross-fade, and those windows are used that lie in the steady part of a
segment. Few tones have low peaks too, so that each is strong. Below `SLOW`, where the voltage
limits the current, each line is played alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.sensing.bender import Bender, Deviations

BAND = (10.0, 2900.0)
"""Lowest and highest line [Hz]."""
HIGHEST = 0.42
"""Highest line as a part of the sample rate; above it, reconstruction filters differ (assumed)."""
WIDE, NEAR = 22, 40
"""Numbers of lines over the band and around the resonance."""
SURROUNDINGS = 0.15
"""Distance from the expected resonance, relative to it, up to which the lines are dense: the
stiffness may depart by 30 %."""
SLOW = 150.0
"""Frequency below which lines are played alone [Hz]."""
TOGETHER = 3
"""Number of lines of the other segments; with four, lag sums of 16 bits lose a third of what the
current says of them (measured on the benders of the benchmark)."""
DURATION, FADE = 0.3, 0.025
"""Time from the begin of a segment to that of the next one, and of their cross-fade [s]."""
SETTLING, SLOW_SETTLING = 0.1, 0.025
"""Time after the fade in which the free vibration decays, to less than 1 % of the default bender's;
slow lines hardly excite it [s]."""
LARGEST = 20.0
"""Largest magnitude at the electrodes: small signals, far from hysteresis (assumed) [V]."""
FILLING = 0.8
"""Part of the converter's range that the current may fill, and of the slew limit the drive, since
cross-fades add to it."""
STIFFNESSES = np.linspace(0.7, 1.4, 57)
"""Factors of the stiffness for which the current is predicted, so that no resonance clips."""
CORNER = 250.0
"""Frequency below which the voltage is not increased any more in favor of slow lines [Hz]."""
TRIALS = 40
"""Number of sets of random phases that are tried for each segment."""
FEWEST = 3
"""Number of windows of a segment that are needed at least."""


@dataclass(frozen=True, kw_only=True)
class MeasuringLimits:
    """Limits of the calibration's drive.

    Attributes
    ----------
    current : float
        Largest current that can be measured, the range of the converter [A].
    voltage : float
        Largest magnitude of the drive [V].
    slew : float
        Largest rate of change of the drive [V/s].
    """

    current: float
    voltage: float
    slew: float


@dataclass(frozen=True)
class ToneSegment:
    """Lines that are played at the same time.

    Attributes
    ----------
    lines : (K,) array of float
        Frequencies [Hz].
    first, end : int
        Position of the first sample of the steady part, and of the first one after it.
    """

    lines: Floats
    first: int
    end: int


@dataclass(frozen=True)
class CalibrationPlan:
    """Drive of the calibration, the same for all channels.

    Attributes
    ----------
    sample_rate : float
        Sample rate [Hz].
    window : int
        Length of the windows of lag sums [samples].
    limits : MeasuringLimits
        Limits that the drive keeps.
    segments : tuple of ToneSegment
        Segments in the order in which they are played.
    drive : (S,) array of float
        Drive, which begins and ends at 0 V [V].
    """

    sample_rate: float
    window: int
    limits: MeasuringLimits
    segments: tuple[ToneSegment, ...]
    drive: Floats

    @property
    def lines(self) -> Floats:
        """Frequencies of all lines, ascending, (F,) array of float [Hz]."""
        return np.sort(np.concatenate([segment.lines for segment in self.segments]))

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self.drive) / self.sample_rate


def calibration_lines(resonance: float, highest: float = BAND[1]) -> Floats:
    """Choose the lines: evenly over log f, and densely around the resonance.

    Parameters
    ----------
    resonance : float
        Expected resonance in air [Hz].
    highest : float
        Highest line [Hz].

    Returns
    -------
    (F,) array of float
        Frequencies, ascending [Hz].
    """
    wide = np.geomspace(BAND[0], highest, WIDE)
    ends = resonance * (1 - SURROUNDINGS), resonance * (1 + SURROUNDINGS)
    near = np.linspace(*ends, NEAR)
    outside = (wide < ends[0]) | (wide > ends[1])
    return np.sort(np.concatenate([wide[outside], near[near <= highest]]))


def plan_calibration(
    bender: Bender, sample_rate: float, limits: MeasuringLimits, *, window: int
) -> CalibrationPlan:
    """Plan the calibration of benders of a design.

    Parameters
    ----------
    bender : Bender
        The design.
    sample_rate : float
        Sample rate [Hz].
    limits : MeasuringLimits
        Limits of the drive.
    window : int
        Length of the windows of lag sums [samples].

    Returns
    -------
    CalibrationPlan
        Drive and segments.

    Raises
    ------
    InputError
        If the windows are too long for the segments.
    """
    lines = calibration_lines(bender.resonance, min(BAND[1], HIGHEST * sample_rate))
    slow, fast = lines[lines < SLOW], lines[lines >= SLOW]
    count = -(-len(fast) // TOGETHER)
    groups = [*slow[:, None], *(fast[first::count] for first in range(count))]
    length, fade = round(DURATION * sample_rate), round(FADE * sample_rate)
    rise = (1 - np.cos(np.pi * (np.arange(fade) + 0.5) / fade)) / 2
    drive = np.zeros(len(groups) * length + fade)
    segments, rng = [], np.random.default_rng(0)
    for number, group in enumerate(groups):
        tones = _tones(group, length + fade, sample_rate, bender, limits, rng)
        tones[:fade] *= rise
        tones[-fade:] *= rise[::-1]
        begin = number * length
        drive[begin : begin + len(tones)] += tones
        settled = round((SLOW_SETTLING if group[0] < SLOW else SETTLING) * sample_rate)
        segments.append(ToneSegment(group, begin + fade + settled, begin + length))
    shortest = min(segment.end - segment.first for segment in segments)
    if not 0 < window <= shortest // (FEWEST + 1):  # one more, since they begin anywhere
        raise InputError(
            f"windows of {1e3 * window / sample_rate:g} ms: must be at most "
            f"{1e3 * (shortest // (FEWEST + 1)) / sample_rate:.0f} ms for the calibration"
        )
    return CalibrationPlan(sample_rate, window, limits, tuple(segments), drive)


def _tones(
    lines: Floats, samples: int, sample_rate: float, bender: Bender, limits: MeasuringLimits,
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Return the sum of some lines (S,), whose currents are alike but for slow lines [V]."""
    gain = bender.electrode_voltage(lines)
    per_volt = 2j * np.pi * lines * gain * _charges(lines, bender)
    floor = 2 * np.pi * CORNER * bender.capacitance * np.abs(gain)
    amplitude = 1 / np.maximum(np.abs(per_volt).max(axis=0), floor)
    return strongest(lines, amplitude, samples, sample_rate, bender, limits, rng)


def strongest(
    lines: Floats, amplitude: Floats, samples: int, sample_rate: float, bender: Bender,
    limits: MeasuringLimits, rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Compute a sum of tones with low peaks, as large as the limits allow.

    Parameters
    ----------
    lines : (K,) array of float
        Frequencies [Hz].
    amplitude : (K,) array of float
        Amplitudes, in relation to each other.
    samples : int
        Number of samples, S.
    sample_rate : float
        Sample rate [Hz].
    bender : Bender
        The design; benders that are stiffer and softer keep the limits too, in air and held.
    limits : MeasuringLimits
        Limits of the drive; the electrodes have `LARGEST` besides.
    rng : Generator
        Source of the phases, of which the best of `TRIALS` sets is taken.

    Returns
    -------
    (S,) array of float
        Drive [V].
    """
    gain = bender.electrode_voltage(lines)
    per_volt = 2j * np.pi * lines * gain * _charges(lines, bender)
    turns = amplitude * np.exp(2j * np.pi / sample_rate * np.outer(np.arange(samples), lines))
    coarse = per_volt[:: len(per_volt) // 8]
    phases = np.exp(2j * np.pi * rng.random((TRIALS, len(lines))))
    tried = [_largest(turns * phase, coarse, gain, sample_rate, limits) for phase in phases]
    chosen = turns * phases[int(np.argmin(tried))]
    return np.asarray(
        chosen.real.sum(axis=1) / _largest(chosen, per_volt, gain, sample_rate, limits)
    )


def _charges(lines: Floats, bender: Bender) -> Complex:
    """Return the charge (E, F) per volt at the electrodes of benders of `STIFFNESSES` [C/V]."""
    one = np.ones(len(STIFFNESSES))
    force, stiffness = bender.at(lines, Deviations(STIFFNESSES, one, one))
    return np.asarray(bender.capacitance + force**2 / stiffness)


def _largest(
    turning: Complex, per_volt: Complex, gain: Complex, sample_rate: float, limits: MeasuringLimits
) -> float:
    """Return the largest share of a limit that tones (S, K) reach, of currents (E, K) per volt."""
    volts = turning.real.sum(axis=1)
    shares = (
        np.abs(volts).max() / limits.voltage,
        np.abs((turning @ gain).real).max() / LARGEST,
        np.abs(np.diff(volts)).max() * sample_rate / (FILLING * limits.slew),
        np.abs((turning @ per_volt.T).real).max() / (FILLING * limits.current),
    )
    return float(max(shares))


def segments_of(plan: CalibrationPlan, positions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Find the segments in whose steady parts windows lie.

    Parameters
    ----------
    plan : CalibrationPlan
        Plan.
    positions : (W,) array of int
        Positions of the first samples of the windows, from the first sample of the drive on.

    Returns
    -------
    (W,) array of int
        Numbers of the segments; −1 for windows that lie in none.
    """
    first = np.array([segment.first for segment in plan.segments])
    end = np.array([segment.end for segment in plan.segments])
    inside = (first <= positions[:, None]) & (positions[:, None] + plan.window <= end)
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
