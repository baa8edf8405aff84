"""Measurement of the hysteresis in air: a slow tone whose amplitude rises in levels.

The tone has one period in each window, so that the harmonics of the current drop out of its lag
sums and leave the admittance of the fundamental. Far below the resonance the charge is in
proportion to the effective voltage, and the admittance changes with the amplitude only as that
does: of weights w_j of play operators, whose own fundamentals are p_j, it is Y (1 + Σ w_j p_j).
This is linear in 1/Y and in the weights, none of which is negative (least squares of Lawson &
Hanson 1974). After the highest level the tone fades out slowly, which leaves no polarization.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tactile.arrays import Complex, Floats
from tactile.sensing.admittance import AirWindows
from tactile.sensing.calibration import FILLING, MeasuringLimits
from tactile.sensing.correlation import LAGS
from tactile.sensing.hysteresis import HysteresisStream, PlayModel

PLAYS, LEVELS = 48, 12
"""Numbers of play operators and of levels."""
DENSER = 1.5
"""Exponent of radii and levels, which are denser towards small drives, where most textures are."""
RISE, SETTLING, STEADY = 2, 2, 6
"""Numbers of periods in which the tone rises to a level, settles, and is measured."""
FADE = 20
"""Number of periods in which the tone fades out."""
SMOOTHNESS = 80.0
"""Weight of the evenness of the weights' density against errors of the effective voltage [V]."""
SMALLEST = 5e-4
"""Width of a loop below which it is not told from none, for the noise of the converter."""
UNKNOWN = "hysteresis not known: no usable current, or one beyond the range of the converter,"
"""Begin of a fault."""
STRONGER = 2.0
"""Factor by which hysteresis may increase the current at most (assumed)."""


@dataclass(frozen=True)
class LoopPlan:
    """Drive that measures the hysteresis, the same for all channels.

    Attributes
    ----------
    window : int
        Length of the windows of lag sums, one period of the tone [samples].
    levels : (L,) array of float
        Amplitudes [V].
    first, end : (L,) array of int
        Position of the first sample of each steady part, and of the first one after it.
    drive : (S,) array of float
        Drive, which begins and ends at 0 V [V].
    """

    window: int
    levels: Floats
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    drive: Floats


def _denser(highest: float, count: int) -> Floats:
    """Return numbers up to a highest one, which are denser towards 0."""
    return np.asarray(highest * (np.arange(1, count + 1) / count) ** DENSER)


def plan_loops(
    capacitance: float, sample_rate: float, limits: MeasuringLimits, *, window: int
) -> LoopPlan:
    """Plan the measurement of the hysteresis.

    Parameters
    ----------
    capacitance : float
        Largest capacitance of a bender [F].
    sample_rate : float
        Sample rate [Hz].
    limits : MeasuringLimits
        Limits of the drive.
    window : int
        Length of the windows of lag sums [samples].

    Returns
    -------
    LoopPlan
        Drive and levels.
    """
    omega = 2 * np.pi * sample_rate / window
    current, slew = (
        FILLING * limits.current / (omega * capacitance * STRONGER),
        FILLING * limits.slew / omega,
    )
    levels = _denser(min(limits.voltage, current, slew), LEVELS)
    rise = (1 - np.cos(np.pi * (np.arange(RISE * window) + 0.5) / (RISE * window))) / 2
    held = np.ones((SETTLING + STEADY) * window)
    steps = np.diff(levels, prepend=0.0)
    parts = [
        np.concatenate([low + step * rise, (low + step) * held])
        for low, step in zip(levels - steps, steps, strict=True)
    ]
    envelope = np.concatenate([*parts, levels[-1] * np.linspace(1, 0, FADE * window)])
    end = np.arange(1, LEVELS + 1, dtype=np.int64) * len(parts[0])
    tone = np.sin(2 * np.pi * np.arange(len(envelope)) / window)
    return LoopPlan(window, levels, end - STEADY * window, end, envelope * tone)


def fit_hysteresis(plan: LoopPlan, windows: AirWindows) -> PlayModel:
    """Fit the hysteresis of each channel.

    Parameters
    ----------
    plan : LoopPlan
        What was played.
    windows : AirWindows
        What came back from N channels.

    Returns
    -------
    PlayModel
        Model of each channel, all of whose weights are 0 where `loop_faults` names a fault.
    """
    radii = _denser(plan.levels[-1], PLAYS + 1)[:-1]
    played = HysteresisStream(PlayModel(radii[:, None], np.ones((PLAYS, 1))))
    effective = played(np.repeat(plan.drive[:, None], PLAYS, axis=1)) - plan.drive[:, None]
    turn = np.exp(-2j * np.pi / plan.window * np.arange(len(plan.drive)))
    tones = [
        2j / (e - f) * (turn[f:e] @ effective[f:e])
        for f, e in zip(plan.first, plan.end, strict=True)
    ]
    share = np.asarray(np.array(tones) / plan.levels[:, None], np.complex128)
    weights = np.array(
        [_weights(row, plan.levels, share, radii) for row in _admittances(plan, windows)]
    )
    fitted = PlayModel(np.tile(radii, (len(weights), 1)), weights)
    weights[fitted.loop_width(plan.levels[-1]) < SMALLEST] = 0
    return fitted


def loop_faults(plan: LoopPlan, windows: AirWindows) -> tuple[str, ...]:
    """Name the channels whose hysteresis is not known.

    Parameters
    ----------
    plan : LoopPlan
        What was played.
    windows : AirWindows
        What came back from N channels.

    Returns
    -------
    tuple of N str
        Why the hysteresis of each channel is not known; empty where it is.
    """
    faults = []
    for row in np.isnan(_admittances(plan, windows)):
        level = f"{plan.levels[np.argmax(row)]:.0f} V"
        faults.append(f"{UNKNOWN} at {level}" if row.any() else "")
    return tuple(faults)


def _admittances(plan: LoopPlan, windows: AirWindows) -> Complex:
    """Return the admittance (N, L) at each level [S]; NaN where no window was usable.

    With the amplitudes I of the current and D of the steps, a window of S samples has the sums
    S/2 Re(I D* exp(jωl)).
    """
    phase = 2 * np.pi / plan.window * np.arange(LAGS)
    solve = np.linalg.pinv(np.stack([np.cos(phase), -np.sin(phase)], axis=1))
    step = 1 - np.exp(-2j * np.pi / plan.window)
    admittances = np.full((len(plan.levels), windows.sums.shape[1]), np.nan, np.complex128)
    for level, (amplitude, first, end) in enumerate(
        zip(plan.levels, plan.first, plan.end, strict=True)
    ):
        inside = (windows.positions >= first) & (windows.positions + plan.window <= end)
        usable = inside[:, None] & windows.valid & ~windows.clipped
        sums = np.where(usable[..., None], windows.sums, 0).sum(axis=0)
        real, imaginary = solve @ sums.T
        count = usable.sum(axis=0)
        power = plan.window / 2 * amplitude**2 * np.conj(step) * np.maximum(count, 1)
        row = (real + 1j * imaginary) / power
        admittances[level] = np.where(count > 0, row, np.nan)
    return admittances.T


def _weights(admittance: Complex, levels: Floats, share: Complex, radii: Floats) -> Floats:
    """Return the weights (R,) of play operators whose fundamentals have shares (L, R) of the tone.

    The columns of 1/Y have both signs, since only the weights must not be negative.
    """
    known = np.isfinite(admittance)
    if not known.all():
        return np.zeros(share.shape[1])
    relative = admittance / admittance[0]
    columns = [relative, 1j * relative, -relative, -1j * relative]
    left = levels[:, None] * np.concatenate([np.stack(columns, axis=1), -share], axis=1)
    density = np.diag(np.mean(np.diff(radii, prepend=0)) / np.diff(radii, prepend=0))
    even = np.zeros((len(radii) - 2, left.shape[1]))
    even[:, len(columns) :] = SMOOTHNESS * np.diff(density, 2, axis=0)
    right = np.concatenate([levels, np.zeros(len(levels) + len(even))])
    solved, _ = nnls(np.concatenate([left.real, left.imag, even]), right)
    return np.asarray(solved[len(columns) :])
