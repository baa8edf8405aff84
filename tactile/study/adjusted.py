"""Common results of the fits of a load and of a bimorph: constants, misfit and notes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.study.log_fit import LogFit, interval, unknown_directions
from tactile.study.measurement import Measurement

WIDE = 2.0
"""Factor to either side up to which an interval may be wide for its constant to count as known."""
NOISY = 0.3
"""Residual, relative to the response, above which a note is given (assumed)."""
SHAPED = 4.0
"""Number of standard deviations above which the correlation of neighboring residuals gives a note.

At this value, 3e-5 of fits to pure noise give a false note.
"""
SMALLEST_SHAPED = 0.05
"""Misfit below which its shape does not matter (assumed) [dB rms]."""


@dataclass(frozen=True)
class Constant:
    """A fitted constant, in the unit of its name.

    Attributes
    ----------
    name : str
        Name as in a display file.
    start : float
        Value before the fit.
    value : float
        Fitted value.
    low : float
        Lower end of the 95 % confidence interval; of a negative constant the end nearer to zero.
    high : float
        Upper end of the 95 % confidence interval; of a negative constant the end farther from zero.
    """

    name: str
    start: float
    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether the interval is no wider than a factor `WIDE` to either side."""
        return abs(self.high) <= WIDE * abs(self.value) and abs(self.value) <= WIDE * abs(self.low)


@dataclass(frozen=True)
class Comparison:
    """A measurement next to its fit.

    Attributes
    ----------
    measurement : Measurement
        Measured response at F frequencies.
    predicted : (F,) array of complex
        Response of the fit [SI].
    started : (F,) array of complex
        Response of the start [SI].
    band_db : (F,) array of float
        Half the 95 % confidence band of the predicted magnitude [dB].
    band_deg : (F,) array of float
        Half the 95 % confidence band of the predicted phase [°].
    """

    measurement: Measurement
    predicted: Complex
    started: Complex
    band_db: Floats
    band_deg: Floats

    @property
    def noise(self) -> float:
        """Median of the complex misfit, relative to the response."""
        return float(np.median(np.abs(self.predicted / self.measurement.value - 1)))

    @property
    def misfit_db(self) -> Floats:
        """Ratio of prediction to measurement (F,) [dB]."""
        return decibel(self.predicted / self.measurement.value)

    @property
    def rms_db(self) -> float:
        """Root mean square of ``misfit_db`` [dB]."""
        return rms(self.misfit_db)

    @property
    def worst_db(self) -> float:
        """Largest absolute value of ``misfit_db`` [dB]."""
        return float(np.abs(self.misfit_db).max())

    @property
    def start_rms_db(self) -> float:
        """Root mean square of the misfit of the start [dB]."""
        return rms(decibel(self.started / self.measurement.value))


def decibel(ratio: Complex) -> Floats:
    """Convert a ratio to decibels.

    Parameters
    ----------
    ratio : ndarray of complex
        Ratio of two responses.

    Returns
    -------
    ndarray of float
        Level of its magnitude [dB].
    """
    return np.asarray(20 * np.log10(np.abs(ratio)), np.float64)


def rms(values: Floats) -> float:
    """Compute the root mean square.

    Parameters
    ----------
    values : ndarray of float
        Values.

    Returns
    -------
    float
        Root mean square, in the unit of the values.
    """
    return float(np.sqrt(np.mean(values**2)))


def constants_of(
    fit: LogFit, names: Sequence[str], start: Floats, signs: Floats, inverse: Sequence[bool]
) -> tuple[Constant, ...]:
    """Return the constants of a fit with their intervals.

    Parameters
    ----------
    fit : LogFit
        Fit of p logarithms.
    names : sequence of str
        Names of the p constants.
    start : (p,) array of float
        Logarithms before the fit.
    signs : (p,) array of float
        Signs of the constants: 1, or −1 for a negative one.
    inverse : sequence of bool
        Whether each constant has no effect at infinity rather than at zero.

    Returns
    -------
    tuple of Constant
        Constants with 95 % confidence intervals.
    """
    constants = []
    for k, name in enumerate(names):
        half = fit.half_width * math.sqrt(fit.covariance[k, k])
        low, high = interval(float(fit.logs[k]), half, inverse=inverse[k])
        sign = float(signs[k])
        ends = sorted((sign * low, sign * high), key=abs)
        value = sign * math.exp(fit.logs[k])
        constants.append(Constant(name, sign * math.exp(start[k]), value, *ends))
    return tuple(constants)


def identifiability_notes(fit: LogFit, constants: Sequence[Constant]) -> list[str]:
    """Return a note for each constant, or combination of constants, that is not identifiable.

    A note is given for each principal axis of the covariance along which the 95 % interval is wider
    than a factor `WIDE`.

    Parameters
    ----------
    fit : LogFit
        Fit of the constants.
    constants : sequence of Constant
        Constants of the fit, in its order.

    Returns
    -------
    list of str
        Sentences, those on single constants first.
    """
    notes, alone = [], set()
    for axis in unknown_directions(fit, WIDE):
        part = [(c, turn) for c, turn in zip(constants, axis.tolist(), strict=True) if turn]
        part.sort(key=lambda entry: -abs(entry[1]))
        if len(part) == 1:
            alone.add(part[0][0].name)
            continue
        moves = ", ".join(f"{c.name} × {WIDE**turn:.2g}" for c, turn in part)
        names = " and ".join(c.name for c, _ in part)
        notes.append(f"{names} cannot be told apart: {moves} together change less than the noise")
    return [_unknown_constant(c) for c in constants if c.name in alone] + notes


def _unknown_constant(c: Constant) -> str:
    """Return a note on a single constant that is not identifiable."""
    if c.low == 0:
        return f"{c.name} cannot be told from 0: at most {c.high:.3g}"
    if math.isinf(c.high):
        return f"{c.name} cannot be told from infinite: at least {c.low:.3g}"
    return f"{c.name} is known to no better than {c.low:.3g} … {c.high:.3g}"


def misfit_notes(comparison: Comparison) -> list[str]:
    """Return notes on a misfit that is large, or that is not noise.

    Parameters
    ----------
    comparison : Comparison
        Measurement and fit.

    Returns
    -------
    list of str
        Sentences; none if the misfit is small noise.
    """
    notes, name = [], comparison.measurement.name
    residual = comparison.predicted / comparison.measurement.value - 1
    if comparison.noise > NOISY:
        notes.append(
            f"{name}: half of its points are off by more than {comparison.noise:.0%}: most of it "
            "is noise, or not of this bimorph"
        )
    if len(residual) >= 8 and comparison.rms_db > SMALLEST_SHAPED:
        direction = residual / np.maximum(np.abs(residual), 1e-300)
        correlation = float(np.mean((direction[1:] / direction[:-1]).real))
        if correlation * math.sqrt(2 * len(residual)) > SHAPED:
            notes.append(
                f"{name}: the misfit ({comparison.rms_db:.2g} dB rms) runs on from point to "
                "point: the model lacks something, and the intervals are too narrow"
            )
    return notes
