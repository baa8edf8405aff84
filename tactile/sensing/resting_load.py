"""Loads of fingers that rest, from all windows of a measurement at once.

In contrast to the `estimator`, which follows loads that change while textures play, the load is
taken to be the same in all windows. It is the maximum a posteriori estimate of the same states with
the same prior, and its covariance is that of the posterior there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.sensing.correlation import LAGS, SumWindow
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import FARTHEST, prior_of
from tactile.sensing.population import CONSTANTS, Population
from tactile.sensing.whitening import STATES, WhitenedSums

MODEL_ERROR = 0.016
"""Error of the model of the current, relative to it. It is larger than that of the estimator, since
errors of the baseline are the same in all windows and do not average out. It was chosen such that
at each frequency two stated deviations hold for at least 80 % of the loads of the benchmark's
plant."""
FIRST_ERROR = 0.05
"""The same in the first iterations, with which the estimate finds the way from far off."""
ITERATIONS = 16
"""Number of iterations with each of both errors; with half of them one load of 320 was missed."""
LARGEST_STEP = 1.0
"""Largest change of a state in an iteration."""
EXPLAINED = 0.6
"""Mean square of the whitened residual up to which a load explains the current. It is 0.2 on the
benchmark's plant, and never above 0.4."""
LEAST_WINDOWS = 5
"""Number of valid windows that a contactor needs, half of those of a measurement."""


@dataclass(frozen=True)
class MeasuredLoads:
    """Loads of N contactors.

    Attributes
    ----------
    windows : (N,) array of int
        Number of valid windows. With fewer than `LEAST_WINDOWS` the load is not known.
    touching : (N,) array of bool
        Whether a finger explains the current better than air does, or air does not explain it.
    logarithms : (N, 4) array of float
        Logarithms of k0 [N/m], d0 [N s/m], k1 [N/m] and d1 [N s/m].
    covariance : (N, 4, 4) array of float
        Their posterior covariance.
    inconsistency : (N,) array of float
        Mean square of the whitened residual under the finger, or in air where none touches.
    """

    windows: NDArray[np.intp]
    touching: NDArray[np.bool_]
    logarithms: Floats
    covariance: Floats
    inconsistency: Floats

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Whether enough windows came, (N,) array of bool."""
        return self.windows >= LEAST_WINDOWS

    @property
    def explained(self) -> NDArray[np.bool_]:
        """Whether load or air explain the current, (N,) array of bool."""
        return self.measured & (self.inconsistency <= EXPLAINED)


def measure_loads(
    model: CurrentModel,
    population: Population,
    windows: Sequence[SumWindow],
    *,
    noise: float,
    others: Sequence[Floats] | None = None,
) -> MeasuredLoads:
    """Estimate the loads that explain some windows.

    Parameters
    ----------
    model : CurrentModel
        Current that the N contactors draw.
    population : Population
        Fingers that are to be expected.
    windows : sequence of SumWindow
        Windows, at least one.
    noise : float
        Standard deviation of a sample of the measured current [A].
    others : sequence of (N, R) array of float, optional
        What other contactors add to the current in each window, as weights of the model's shared
        filters; by default nothing.

    Returns
    -------
    MeasuredLoads
        Loads of all contactors.
    """
    used = [window.valid & np.isfinite(window.sums).all(axis=1) for window in windows]
    mean, prior = prior_of(population)
    coarse, fine = (
        WhitenedSums.joined(_alone(model, windows, noise, error, others), used)
        for error in (FIRST_ERROR, MODEL_ERROR)
    )
    state = np.tile(mean, (len(model.electrical), 1))
    for whitened in (coarse, fine):
        state, covariance = _improved(whitened, model, state, mean, prior)
    departure, count = state - mean, np.sum(used, axis=0)
    sums = np.maximum(count * LAGS, 1)
    squares = np.sum(fine.residual(model, state) ** 2, axis=1)
    unlikely = np.einsum("na,ab,nb->n", departure, np.linalg.inv(prior), departure)
    air, drift = _in_air(fine, prior)
    touching = (squares + unlikely < air + drift) | (air > EXPLAINED * sums)
    return MeasuredLoads(
        count,
        touching,
        state[:, :CONSTANTS],
        covariance[:, :CONSTANTS, :CONSTANTS],
        np.where(touching, squares, air) / sums,
    )


def _alone(
    model: CurrentModel,
    windows: Sequence[SumWindow],
    noise: float,
    error: float,
    others: Sequence[Floats] | None,
) -> list[WhitenedSums]:
    """Return whitened windows without what other contactors add to them."""
    whitened = [WhitenedSums.of(model, window, noise, error) for window in windows]
    if others is None:
        return whitened
    return [
        replace(part, measured=part.measured - (part.shared @ added[..., None])[..., 0])
        for part, added in zip(whitened, others, strict=True)
    ]


def _in_air(whitened: WhitenedSums, prior: Floats) -> tuple[Floats, Floats]:
    """Return the squares of what air leaves (N,), and of the drift of the capacitance it needs."""
    variance = np.full(len(whitened.measured), prior[CONSTANTS, CONSTANTS])
    fit = whitened.in_air(0 * variance, variance)
    return np.sum(fit.residual**2, axis=1), fit.drift**2 / variance


def _improved(
    whitened: WhitenedSums, model: CurrentModel, state: Floats, mean: Floats, prior: Floats
) -> tuple[Floats, Floats]:
    """Return a state (N, STATES) after `ITERATIONS`, and its covariance (N, STATES, STATES)."""
    information, reach = np.linalg.inv(prior), FARTHEST * np.sqrt(np.diag(prior))
    hessian = np.empty((len(state), STATES, STATES))
    for _ in range(ITERATIONS):
        residual, slope = whitened.linearized(model, state)
        across = slope.transpose(0, 2, 1)
        hessian = across @ slope + information
        pull = across @ residual[..., None] + information @ (mean - state)[..., None]
        move = np.linalg.solve(hessian, pull)[..., 0]
        state = state + np.clip(move, -LARGEST_STEP, LARGEST_STEP)
        state = mean + np.clip(state - mean, -reach, reach)
    return state, np.asarray(np.linalg.inv(hessian), np.float64)
