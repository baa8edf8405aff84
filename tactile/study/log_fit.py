"""Fit of a model's positive constants to complex responses, with the uncertainty of the constants.

The fit runs over the logarithms of the constants. It begins with the complex logarithm of model
over measurement, which tolerates a poor start, and ends with differences weighted by the noise.
The noise has a part in proportion to the response and a floor, both estimated from the residuals;
responses as weak as the floor then count for little.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from tactile.arrays import Complex, Floats

Model: TypeAlias = Callable[[Floats], Complex]
"""Function from logarithms of constants (N, p) to responses (N, F)."""

STEP = 1e-4
"""Step of a logarithm in a central difference: its error is 2e-9 of the third derivative."""
PRIOR = 1 / math.log(10)
"""Weight of a logarithm's distance from the start.

A factor of ten counts as much as one point that is off by the noise. The prior only holds constants
that the measurement says nothing about (assumed).
"""
FIRST_NOISE = 0.01
"""Noise before it has been estimated, relative to the response (assumed)."""
LEAST_NOISE = 1e-4
"""Smallest noise, relative to the response: no measurement of a bimorph is better (assumed).

Without this limit, rounding would be taken for structure.
"""
REWEIGHTED = 2
"""Number of times that the noise is estimated.

A third time changes constants by less than 1 % of their interval (measured).
"""
MOST_STEPS = 50
"""Largest number of steps of a fit.

Only constants that the measurement says nothing about need as many (measured).
"""
CONFIDENCE = 0.95
"""Confidence level of all intervals."""
UNKNOWN = 1.0
"""Half-width of a logarithm's interval above which the interval of the constant itself is given.

That interval includes zero. The response is closer to linear in a constant of little influence
than in its logarithm.
"""


@dataclass(frozen=True)
class LogFit:
    """Fit of p logarithms of constants to F complex points.

    Attributes
    ----------
    logs : (p,) array of float
        Fitted logarithms.
    covariance : (p, p) array of float
        Covariance of the logarithms, from the variance of the residuals or `LEAST_NOISE`, whichever
        is larger.
    axes : (p, p) array of float
        Uncorrelated directions in its rows, the least known last.
    deviation : (p,) array of float
        Standard deviation along each direction.
    predicted : (F,) array of complex
        Response of the model.
    spread : (F,) array of float
        Standard deviation of the complex noise, in the unit of the measurement.
    half_width : float
        Half-width of a 95 % confidence interval, in standard deviations (Student's t).
    bic : float
        Bayesian information criterion, up to a constant of the measurement.
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
    """Fit the logarithms of a model's constants.

    Parameters
    ----------
    model : callable
        Function from logarithms of constants (N, p) to responses (N, F).
    measured : (F,) array of complex
        Measured response, nowhere zero.
    start : (p,) array of float
        Logarithms at the start.
    bounds : ((p,) array of float, (p,) array of float)
        Lowest and highest logarithms.
    groups : sequence of slice
        Groups of points that share their noise; together they are all points.

    Returns
    -------
    LogFit
        Fitted logarithms and their uncertainty.
    """
    low, high = bounds
    begin = np.clip(start, low + 1e-9, high - 1e-9)

    def solve(at: Floats, spread: Floats | None) -> Floats:
        def residual(logs: Floats) -> Floats:
            now = model(logs[None])[0]
            error = np.log(now / measured) if spread is None else (now - measured) / spread
            hold = PRIOR * (FIRST_NOISE if spread is None else 1.0)
            return np.concatenate([error.real, error.imag, hold * (logs - begin)])

        def slope(logs: Floats) -> Floats:
            change = model_slope(model, logs)
            scaled = change / (model(logs[None])[0] if spread is None else spread)
            hold = PRIOR * (FIRST_NOISE if spread is None else 1.0)
            return np.vstack([scaled.real.T, scaled.imag.T, hold * np.eye(len(logs))])

        solution = least_squares(residual, at, slope, bounds=(low, high), max_nfev=MOST_STEPS)
        return np.clip(solution.x, low + 1e-9, high - 1e-9)

    logs = solve(begin, None)
    for _ in range(REWEIGHTED):
        spread = noise_spread(measured, model(logs[None])[0], groups)
        logs = solve(logs, spread)
    return _with_uncertainty(model, measured, logs, spread)


def model_slope(model: Model, logs: Floats) -> Complex:
    """Compute the derivative of a model with respect to each logarithm.

    Parameters
    ----------
    model : callable
        Function from logarithms of constants (N, p) to responses (N, F).
    logs : (p,) array of float
        Logarithms at which the derivative is taken.

    Returns
    -------
    (p, F) array of complex
        Derivatives, by central differences.
    """
    step = STEP * np.eye(len(logs))
    around = model(np.concatenate([logs + step, logs - step]))
    return np.asarray((around[: len(logs)] - around[len(logs) :]) / (2 * STEP))


def noise_spread(measured: Complex, predicted: Complex, groups: Sequence[slice]) -> Floats:
    """Estimate the standard deviation of complex noise: a share of the response, and a floor.

    Of the variances v = a² (|m|² + ρ), the most likely in each group is chosen over a row of ρ; a²
    is then the mean of |y − m|²/(|m|² + ρ).

    Parameters
    ----------
    measured : (F,) array of complex
        Measured response y.
    predicted : (F,) array of complex
        Response m of the model.
    groups : sequence of slice
        Groups of points that share their noise.

    Returns
    -------
    (F,) array of float
        Standard deviation, in the unit of the response; at least `LEAST_NOISE` of the response.
    """
    spread = np.empty(len(measured))
    for group in groups:
        power = np.abs(predicted[group]) ** 2
        error = np.abs(measured[group] - predicted[group]) ** 2
        row = np.concatenate([[0.0], np.geomspace(1e-2 * power.min(), 1e2 * power.max(), 40)])
        shape = power + row[:, None]
        scale = np.mean(error / shape, axis=1)
        cost = np.mean(np.log(shape), axis=1) + np.log(np.maximum(scale, 1e-300))
        best = int(cost.argmin())
        spread[group] = np.sqrt(np.maximum(scale[best] * shape[best], LEAST_NOISE**2 * power))
    return spread


def _with_uncertainty(model: Model, measured: Complex, logs: Floats, spread: Floats) -> LogFit:
    """Return the fit with its covariance, intervals and information criterion."""
    predicted = model(logs[None])[0]
    residual = (predicted - measured) / spread
    slope = model_slope(model, logs) / spread
    jacobian = np.concatenate([slope.real.T, slope.imag.T])
    count, constants = jacobian.shape
    freedom = max(count - constants, 1)
    _, strength, axes = np.linalg.svd(jacobian, full_matrices=False)
    strength = np.maximum(strength, 1e-9 * strength[0])
    variance = max(np.sum(np.abs(residual) ** 2) / freedom, 1 / 2)
    deviation = math.sqrt(variance) / strength
    cost = 2 * np.sum(np.log(spread**2) + np.abs(residual) ** 2)
    return LogFit(
        logs=logs,
        covariance=(axes.T * deviation**2) @ axes,
        axes=axes,
        deviation=deviation,
        predicted=predicted,
        spread=spread,
        half_width=float(stdtrit(freedom, (1 + CONFIDENCE) / 2)),
        bic=float(cost + constants * math.log(count)),
    )


def interval(logarithm: float, half: float, *, inverse: bool = False) -> tuple[float, float]:
    """Compute the ends of a constant's 95 % confidence interval.

    Parameters
    ----------
    logarithm : float
        Logarithm of the constant.
    half : float
        Half the width of the logarithm's interval.
    inverse : bool
        Whether a constant, such as a quality factor, has no effect at infinity instead of at zero.

    Returns
    -------
    low, high : float
        Ends of the interval. If the logarithm is unknown (``half`` above `UNKNOWN`), the interval
        is that of the constant itself and begins at zero; with ``inverse`` it is that of the
        inverse, so that its upper end is infinite.
    """
    value = math.exp(logarithm)
    if half <= UNKNOWN:
        return value * math.exp(-half), value * math.exp(half)
    return (value / (1 + half), math.inf) if inverse else (0.0, value * (1 + half))


def response_spread(model: Model, fit: LogFit) -> tuple[Floats, Floats]:
    """Compute half the 95 % confidence band of a model's response about the fit.

    Parameters
    ----------
    model : callable
        Function from logarithms of the fitted constants (N, p) to responses (N, F) at any
        frequencies.
    fit : LogFit
        Fitted constants.

    Returns
    -------
    magnitude : (F,) array of float
        Half the band of the magnitude [dB].
    phase : (F,) array of float
        Half the band of the phase [°].
    """
    slope = model_slope(model, fit.logs) / model(fit.logs[None])[0]

    def half(change: Floats) -> Floats:
        variance = np.einsum("pf,pq,qf->f", change, fit.covariance, change)
        return np.asarray(fit.half_width * np.sqrt(np.maximum(variance, 0)))

    return half(slope.real) * 20 / math.log(10), np.degrees(half(slope.imag))


def unknown_directions(fit: LogFit, factor: float) -> list[Floats]:
    """Return the directions in the logarithms along which the 95 % interval exceeds a factor.

    Parameters
    ----------
    fit : LogFit
        Fitted constants.
    factor : float
        Largest factor, to either side, at which a direction counts as known.

    Returns
    -------
    list of (p,) array of float
        Directions, each scaled so that its largest entry is 1. Entries below 0.2 are set to zero.
    """
    directions = []
    for axis, deviation in zip(fit.axes[::-1], fit.deviation[::-1], strict=True):
        if fit.half_width * deviation * np.abs(axis).max() > math.log(factor):
            scaled = axis / axis[np.abs(axis).argmax()]
            directions.append(np.where(np.abs(scaled) < 0.2, 0.0, scaled))
    return directions
