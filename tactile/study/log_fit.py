"""Positive constants of a model, fitted to complex responses, and how well they become known.

The fit runs over the logarithms of the constants. It begins with the complex logarithm of model
over measurement, which forgives a poor start, and ends with differences weighted by the noise.
How much noise there is, as a share of the response and as a floor, is found from what the model
leaves over; so weak a response as the noise's floor then counts for little.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

Floats: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Model: TypeAlias = Callable[[Floats], Complex]
"""Responses (N, F) of constants whose logarithms are (N, p)."""

STEP = 1e-4
"""Of a logarithm in a central difference: its error is 2e-9 of the third derivative."""
PRIOR = 1 / math.log(10)
"""Weight of a logarithm's distance from the start: a factor of ten counts as one point that is off
by the noise. It only holds what the measurement says nothing of (assumed)."""
FIRST_NOISE = 0.01
"""Of the response, before it is known (assumed)."""
LEAST_NOISE = 1e-4
"""Of the response: no measurement of a bimorph is better (assumed). Without it rounding would be
taken for structure."""
REWEIGHTED = 2
"""Times that the noise is found anew: the third changes constants by less than 1 % of their
interval (measured)."""
MOST_STEPS = 50
"""Of a fit; only constants that the measurement says nothing of need as many (measured)."""
CONFIDENCE = 0.95
UNKNOWN = 1.0
"""Half-width of a logarithm's interval above which one in the constant itself is given: it holds
zero, and the response is straighter in a constant that does little than in its logarithm."""


@dataclass(frozen=True)
class LogFit:
    """A fit of p logarithms to F complex points.

    Attributes
    ----------
    logs : (p,) fitted
    covariance : (p, p) of them, by the variance of what is left over, at least `LEAST_NOISE`
    axes, deviation : (p, p) rows and (p,): uncorrelated directions, the least known last, and the
        standard deviation along each
    predicted : (F,) the model
    spread : (F,) standard deviation of the complex noise, of the measurement's unit
    half_width : of a 95 % interval, in standard deviations (Student's t)
    bic : the Bayesian information criterion, up to a constant of the measurement
    """

    logs: Floats
    covariance: Floats
    axes: Floats
    deviation: Floats
    predicted: Complex
    spread: Floats
    half_width: float
    bic: float


def fit_logs(
    model: Model,
    measured: Complex,
    start: Floats,
    bounds: tuple[Floats, Floats],
    groups: Sequence[slice],
) -> LogFit:
    """Fit the logarithms of constants.

    Parameters
    ----------
    model : of the constants
    measured : (F,) complex, nowhere zero
    start, bounds : (p,) logarithms
    groups : of points that share their noise, all of them together

    Returns
    -------
    LogFit
    """
    low, high = bounds
    begin = np.clip(start, low + 1e-9, high - 1e-9)

    def solve(at: Floats, spread: Floats | None) -> Floats:
        def residual(logs: Floats) -> Floats:
            now = model(logs[None])[0]
            left = np.log(now / measured) if spread is None else (now - measured) / spread
            hold = PRIOR * (FIRST_NOISE if spread is None else 1.0)
            return np.concatenate([left.real, left.imag, hold * (logs - begin)])

        def slope(logs: Floats) -> Floats:
            change = model_slope(model, logs)
            scaled = change / (model(logs[None])[0] if spread is None else spread)
            hold = PRIOR * (FIRST_NOISE if spread is None else 1.0)
            return np.vstack([scaled.real.T, scaled.imag.T, hold * np.eye(len(logs))])

        found = least_squares(residual, at, slope, bounds=(low, high), max_nfev=MOST_STEPS)
        return np.clip(found.x, low + 1e-9, high - 1e-9)

    logs = solve(begin, None)
    for _ in range(REWEIGHTED):
        spread = noise_spread(measured, model(logs[None])[0], groups)
        logs = solve(logs, spread)
    return _judged(model, measured, logs, spread)


def model_slope(model: Model, logs: Floats) -> Complex:
    """Return the change (p, F) of a model by each logarithm."""
    step = STEP * np.eye(len(logs))
    around = model(np.concatenate([logs + step, logs - step]))
    return np.asarray((around[: len(logs)] - around[len(logs) :]) / (2 * STEP))


def noise_spread(measured: Complex, predicted: Complex, groups: Sequence[slice]) -> Floats:
    """Return the standard deviation (F,) of complex noise: a share of the response, and a floor.

    The most likely of v = a² (|m|² + ρ) in each group, over a row of ρ; a² is then the mean of
    |y − m|²/(|m|² + ρ). Not below `LEAST_NOISE`.
    """
    spread = np.empty(len(measured))
    for group in groups:
        power = np.abs(predicted[group]) ** 2
        left = np.abs(measured[group] - predicted[group]) ** 2
        row = np.concatenate([[0.0], np.geomspace(1e-2 * power.min(), 1e2 * power.max(), 40)])
        shape = power + row[:, None]
        scale = np.mean(left / shape, axis=1)
        unlikely = np.mean(np.log(shape), axis=1) + np.log(np.maximum(scale, 1e-300))
        best = int(unlikely.argmin())
        spread[group] = np.sqrt(np.maximum(scale[best] * shape[best], LEAST_NOISE**2 * power))
    return spread


def _judged(model: Model, measured: Complex, logs: Floats, spread: Floats) -> LogFit:
    predicted = model(logs[None])[0]
    left = (predicted - measured) / spread
    slope = model_slope(model, logs) / spread
    jacobian = np.concatenate([slope.real.T, slope.imag.T])
    count, constants = jacobian.shape
    freedom = max(count - constants, 1)
    _, strength, axes = np.linalg.svd(jacobian, full_matrices=False)
    strength = np.maximum(strength, 1e-9 * strength[0])
    variance = max(np.sum(np.abs(left) ** 2) / freedom, 1 / 2)
    deviation = math.sqrt(variance) / strength
    unlikely = 2 * np.sum(np.log(spread**2) + np.abs(left) ** 2)
    return LogFit(
        logs=logs,
        covariance=(axes.T * deviation**2) @ axes,
        axes=axes,
        deviation=deviation,
        predicted=predicted,
        spread=spread,
        half_width=float(stdtrit(freedom, (1 + CONFIDENCE) / 2)),
        bic=float(unlikely + constants * math.log(count)),
    )


def interval(logarithm: float, half: float, *, inverse: bool = False) -> tuple[float, float]:
    """Return the ends of a constant's 95 % interval.

    Parameters
    ----------
    logarithm, half : the constant's, and half the width of its interval
    inverse : whether infinity, not zero, is where the constant does nothing, as of a quality factor

    Returns
    -------
    low, high : where the logarithm is unknown (above `UNKNOWN`), that of the constant itself, or
        of its inverse, from zero up
    """
    value = math.exp(logarithm)
    if half <= UNKNOWN:
        return value * math.exp(-half), value * math.exp(half)
    return (value / (1 + half), math.inf) if inverse else (0.0, value * (1 + half))


def response_spread(model: Model, fit: LogFit) -> tuple[Floats, Floats]:
    """Return half the 95 % band of a model's response about the fit.

    Parameters
    ----------
    model : of the fitted constants, at any F frequencies
    fit : what was fitted

    Returns
    -------
    magnitude : (F,) [dB]
    phase : (F,) [°]
    """
    slope = model_slope(model, fit.logs) / model(fit.logs[None])[0]

    def half(change: Floats) -> Floats:
        variance = np.einsum("pf,pq,qf->f", change, fit.covariance, change)
        return np.asarray(fit.half_width * np.sqrt(np.maximum(variance, 0)))

    return half(slope.real) * 20 / math.log(10), np.degrees(half(slope.imag))


def unknown_directions(fit: LogFit, factor: float) -> list[Floats]:
    """Return directions (p,) in the logarithms along which the 95 % interval exceeds a factor.

    Each is scaled so that its largest entry is 1; entries below 0.2 are left out as zero.
    """
    found = []
    for axis, deviation in zip(fit.axes[::-1], fit.deviation[::-1], strict=True):
        if fit.half_width * deviation * np.abs(axis).max() > math.log(factor):
            scaled = axis / axis[np.abs(axis).argmax()]
            found.append(np.where(np.abs(scaled) < 0.2, 0.0, scaled))
    return found
