"""What fits of a load and of a bimorph have in common: constants, misfit, and plain sentences."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.study.log_fit import LogFit, interval, unknown_directions
from tactile.study.measurement import Measurement

WIDE = 2.0
"""Factor to either side by which an interval may be wide before its constant counts as unknown."""
NOISY = 0.3
"""Share of the response above which what a fit leaves over is called out (assumed)."""
SHAPED = 4.0
"""Standard deviations by which neighboring points' misfits agree more than noise would: 3e-5 of
fits to noise are called out for nothing."""
SMALLEST_SHAPED = 0.05
"""dB rms of misfit below which its shape does not matter (assumed)."""


@dataclass(frozen=True)
class Constant:
    """A fitted constant, in the unit that its name tells.

    Attributes
    ----------
    name : as in a display file
    start, value : before and after the fit
    low, high : ends of the 95 % interval
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
    """A measurement beside the fit.

    Attributes
    ----------
    measurement : (F,) points
    predicted, started : (F,) complex, by the fit and by the start [SI]
    band_db, band_deg : (F,) half the 95 % band of the prediction
    """

    measurement: Measurement
    predicted: Complex
    started: Complex
    band_db: Floats
    band_deg: Floats

    @property
    def noise(self) -> float:
        """Median of the complex misfit over the response."""
        return float(np.median(np.abs(self.predicted / self.measurement.value - 1)))

    @property
    def misfit_db(self) -> Floats:
        """Prediction over measurement (F,) [dB]."""
        return decibel(self.predicted / self.measurement.value)

    @property
    def rms_db(self) -> float:
        """Rms of ``misfit_db``."""
        return rms(self.misfit_db)

    @property
    def worst_db(self) -> float:
        """Largest size of ``misfit_db``."""
        return float(np.abs(self.misfit_db).max())

    @property
    def start_rms_db(self) -> float:
        """Rms misfit of the start."""
        return rms(decibel(self.started / self.measurement.value))


def decibel(ratio: Complex) -> Floats:
    """Return a ratio in dB."""
    return np.asarray(20 * np.log10(np.abs(ratio)), np.float64)


def rms(values: Floats) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def constants_of(
    fit: LogFit, names: Sequence[str], start: Floats, signs: Floats, inverse: Sequence[bool]
) -> tuple[Constant, ...]:
    """Return the constants of a fit.

    Parameters
    ----------
    fit : of p logarithms
    names : of the constants
    start : (p,) logarithms before the fit
    signs : (p,) −1 for a negative constant
    inverse : whether a constant does nothing at infinity rather than at zero
    """
    found = []
    for k, name in enumerate(names):
        half = fit.half_width * math.sqrt(fit.covariance[k, k])
        low, high = interval(float(fit.logs[k]), half, inverse=inverse[k])
        sign = float(signs[k])
        ends = sorted((sign * low, sign * high), key=abs)
        value = sign * math.exp(fit.logs[k])
        found.append(Constant(name, sign * math.exp(start[k]), value, *ends))
    return tuple(found)


def what_is_unknown(fit: LogFit, constants: Sequence[Constant]) -> list[str]:
    """Return a sentence for each constant, or combination of them, that is not identifiable.

    That is each principal axis of the covariance along which the 95 % interval is wider than a
    factor `WIDE`.
    """
    said, alone = [], set()
    for axis in unknown_directions(fit, WIDE):
        part = [(c, turn) for c, turn in zip(constants, axis.tolist(), strict=True) if turn]
        part.sort(key=lambda entry: -abs(entry[1]))
        if len(part) == 1:
            alone.add(part[0][0].name)
            continue
        moves = ", ".join(f"{c.name} × {WIDE**turn:.2g}" for c, turn in part)
        names = " and ".join(c.name for c, _ in part)
        said.append(f"{names} cannot be told apart: {moves} together change less than the noise")
    return [_of_one(c) for c in constants if c.name in alone] + said


def _of_one(c: Constant) -> str:
    if c.low == 0:
        return f"{c.name} cannot be told from 0: at most {c.high:.3g}"
    if math.isinf(c.high):
        return f"{c.name} cannot be told from infinite: at least {c.low:.3g}"
    return f"{c.name} is known to no better than {c.low:.3g} … {c.high:.3g}"


def what_is_left(comparison: Comparison) -> list[str]:
    """Return sentences about a misfit that is large, or that is not noise."""
    said, name = [], comparison.measurement.name
    left = comparison.predicted / comparison.measurement.value - 1
    if comparison.noise > NOISY:
        said.append(
            f"{name}: half of its points are off by more than {comparison.noise:.0%}: most of it "
            "is noise, or not of this bimorph"
        )
    if len(left) >= 8 and comparison.rms_db > SMALLEST_SHAPED:
        turn = left / np.maximum(np.abs(left), 1e-300)
        together = float(np.mean((turn[1:] / turn[:-1]).real))
        if together * math.sqrt(2 * len(left)) > SHAPED:
            said.append(
                f"{name}: the misfit ({comparison.rms_db:.2g} dB rms) runs on from point to "
                "point: the model lacks something, and the intervals are too narrow"
            )
    return said
