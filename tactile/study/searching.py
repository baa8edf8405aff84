"""Common interface to the optimizers: pymoo's NSGA-II for fronts, scipy's for a single objective.

Both take a function that scores a whole population at once. It returns the objectives, which are
minimized, and by how much each constraint is violated (above 0). The optimizers know nothing of
benders.

NSGA-II (Deb et al. 2002, doi 10.1109/4235.996017) sorts by dominance, feasible designs first, and
thins crowded regions. Its population is larger than the offspring of a generation, so that it keeps
the front found so far. A single objective is minimized by differential evolution (Storn & Price
1997, doi 10.1023/A:1008202821328) and then by the simplex of Nelder and Mead, which needs no
derivative: the smallest response over many frequencies has kinks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution, minimize
from scipy.stats import qmc

from tactile.arrays import Floats
from tactile.study.extras import study_extra

Score = Callable[[Floats], tuple[Floats, Floats]]
"""Function from designs (N, D) to objectives (N, O) and violations of the constraints (N, L)."""

LARGE = 1e30
"""Substitute for values that are infinite or missing, since optimizers need numbers."""
POPULATION, OFFSPRING, GENERATIONS = 128, 64, 60
"""Size of the population, offspring of a generation, and number of generations for fronts."""
OTHERS = 1e-3
"""Weight of the other objectives in the search for an end of the front."""
BEST_GENERATIONS, BEST_POPULATION = 100, 15
"""Number of generations for one objective, and its population for each number that varies."""
POLISH = 1e-6
"""Precision of the simplex, relative to the width of the bounds."""


@dataclass(frozen=True)
class Search:
    """Result of an optimizer.

    Attributes
    ----------
    designs : (N, D) array of float
        Designs found; if none meets the constraints, the design with the smallest violation.
    history : list of (K, O) array of float
        Minimized objectives of the best feasible designs of each generation.
    evaluations : int
        Number of designs that were scored.
    optimizer : str
        Name of the optimizer.
    """

    designs: Floats
    history: list[Floats]
    evaluations: int
    optimizer: str


def find_front(
    score: Score, low: Floats, high: Floats, seed: int, progress: Callable[[int, int], None]
) -> Search:
    """Find the designs between bounds that no other dominates.

    Parameters
    ----------
    score : callable
        Function from designs (N, D) to objectives (N, O) and violations (N, L).
    low : (D,) array of float
        Lower bounds.
    high : (D,) array of float
        Upper bounds.
    seed : int
        Seed of the search.
    progress : callable
        Called with the number of finished generations and the number of all.

    Returns
    -------
    Search
        Pareto front.

    Raises
    ------
    InputError
        If pymoo is missing.
    """
    with study_extra("a front of several objectives"):
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.problem import Problem
        from pymoo.problems.static import StaticProblem
    start, evaluations = first_population(score, low, high, seed)
    f, g = score(start[:1])
    problem = Problem(n_var=len(low), n_obj=f.shape[1], n_ieq_constr=g.shape[1], xl=low, xu=high)
    algorithm = NSGA2(
        pop_size=POPULATION,
        n_offsprings=OFFSPRING,
        sampling=start,
    )
    algorithm.setup(problem, termination=("n_gen", GENERATIONS), seed=seed)
    history: list[Floats] = []
    while algorithm.has_next():
        offspring = algorithm.ask()
        f, g = score(offspring.get("X"))
        evaluations += len(f)
        algorithm.evaluator.eval(StaticProblem(problem, F=f, G=g), offspring)
        algorithm.tell(infills=offspring)
        best = algorithm.opt
        history.append(best.get("F")[best.get("FEAS").ravel()])
        progress(len(history), GENERATIONS)
    name = "NSGA-II of pymoo, its ends by Nelder-Mead of scipy"
    return Search(algorithm.opt.get("X"), history, evaluations, name)


def first_population(score: Score, low: Floats, high: Floats, seed: int) -> tuple[Floats, int]:
    """Return designs that fill the bounds, including the ends of the front.

    The ends are what a population reaches last. Each end minimizes one objective plus a thousandth
    of the others, in units of their span over the feasible designs, by the simplex of Nelder and
    Mead from the best of these. Without a feasible design there are no ends.

    Parameters
    ----------
    score : callable
        Function from designs (N, D) to objectives (N, O) and violations (N, L).
    low : (D,) array of float
        Lower bounds.
    high : (D,) array of float
        Upper bounds.
    seed : int
        Seed of the Sobol points.

    Returns
    -------
    points : (N, D) array of float
        Designs.
    evaluations : int
        Number of designs that were scored.
    """
    points = qmc.scale(qmc.Sobol(len(low), rng=seed).random(POPULATION), low, high)
    lowered, violations = score(points)
    feasible = ~np.any(violations > 0, axis=1)
    evaluations = len(points)
    if not feasible.any():
        return points, evaluations
    span = np.ptp(lowered[feasible], axis=0)
    scale = 1 / np.where(span > 0, span, 1.0)
    for k in range(lowered.shape[1]):
        weights = scale * np.where(np.arange(len(scale)) == k, 1.0, OTHERS)
        best, count = _minimize_weighted(score, weights, points[feasible], low, high)
        points[-1 - k] = best
        evaluations += count
    return points, evaluations


class _Cost:
    """Weighted sum of objectives as a function of shares (N, D) of the way from bound to bound."""

    def __init__(self, score: Score, weights: Floats, low: Floats, high: Floats) -> None:
        self._score, self._weights, self._low, self._high = score, weights, low, high
        self.evaluations = 0

    def design(self, shares: Floats) -> Floats:
        """Return the designs at shares (..., D)."""
        return self._low + shares * (self._high - self._low)

    def __call__(self, shares: Floats) -> Floats:
        """Return the costs (N,); those of designs that violate constraints are above all others."""
        f, g = self._score(self.design(np.atleast_2d(shares)))
        self.evaluations += len(f)
        violation = np.maximum(g, 0).sum(axis=1)
        return np.where(violation > 0, LARGE * violation, f @ self._weights)


def _minimize_weighted(
    score: Score, weights: Floats, designs: Floats, low: Floats, high: Floats
) -> tuple[Floats, int]:
    """Return the design (D,) with the smallest weighted sum, from the best of some designs."""
    cost = _Cost(score, weights, low, high)
    shares = (designs - low) / (high - low)
    costs = cost(shares)
    first = shares[costs.argmin()]
    fine = _simplex(cost, first, float(costs.min()))
    return cost.design(fine.x if fine.fun <= costs.min() else first), cost.evaluations


def find_best(
    score: Score, low: Floats, high: Floats, seed: int, progress: Callable[[int, int], None]
) -> Search:
    """Find the design between bounds that minimizes one objective.

    Parameters
    ----------
    score : callable
        Function from designs (N, D) to objectives (N, 1) and violations (N, L).
    low : (D,) array of float
        Lower bounds.
    high : (D,) array of float
        Upper bounds.
    seed : int
        Seed of the search.
    progress : callable
        Called with the number of finished generations and the number of all.

    Returns
    -------
    Search
        Best design; its history has one value for each generation.
    """
    history: list[Floats] = []
    cost = _Cost(score, np.ones(1), low, high)

    def record(intermediate_result: OptimizeResult) -> None:
        history.append(np.array([[float(intermediate_result.fun)]]))
        progress(len(history), BEST_GENERATIONS)

    def population_cost(shares: Floats, /, *_: Any) -> Any:
        return cost(shares.T)

    unit = Bounds(np.zeros(len(low)), np.ones(len(low)))
    rough = differential_evolution(
        population_cost,
        unit,
        popsize=BEST_POPULATION,
        maxiter=BEST_GENERATIONS,
        init="sobol",
        tol=1e-4,
        updating="deferred",
        vectorized=True,
        polish=False,
        rng=seed,
        callback=record,
    )
    fine = _simplex(cost, rough.x, float(rough.fun))
    best = fine if fine.fun <= rough.fun else rough
    history.append(np.array([[float(best.fun)]]))
    name = "differential evolution and Nelder-Mead of scipy"
    return Search(cost.design(best.x)[None], history, cost.evaluations, name)


def _simplex(cost: Callable[[Floats], Floats], first: Floats, value: float) -> Any:
    """Minimize a cost over the unit cube by Nelder and Mead's simplex, from a given point."""

    def scalar_cost(shares: Floats, /, *_: Any) -> float:
        return float(cost(shares)[0])

    return minimize(
        scalar_cost,
        first,
        method="Nelder-Mead",
        bounds=Bounds(np.zeros(len(first)), np.ones(len(first))),
        options={"xatol": POLISH, "fatol": 1e-12 * abs(value)},
    )


def hypervolume(history: list[Floats], front: Floats) -> Floats:
    """Compute the hypervolume that each generation dominates, relative to a box around the front.

    Parameters
    ----------
    history : list of (K, O) array of float
        Minimized objectives of each generation.
    front : (N, O) array of float
        Objectives of the final front. The box reaches from its best to a tenth beyond its worst.

    Returns
    -------
    (G,) array of float
        Share of the box for each generation, 0 to 1.
    """
    from pymoo.indicators.hv import HV

    best, worst = front.min(axis=0), front.max(axis=0)
    span = np.where(worst > best, worst - best, 1.0)
    corner = np.full(front.shape[1], 1.1)
    volume = HV(ref_point=corner)
    volumes = [volume((f - best) / span) if len(f) else 0.0 for f in history]
    return np.asarray(np.array(volumes, np.float64) / corner.prod())
