"""Other people's optimizers behind one face: pymoo's NSGA-II for fronts, scipy's for one objective.

Both are handed a function that scores a whole population at once: what is to be lowered, and by how
much limits are missed (above 0). They know nothing of benders.

NSGA-II (Deb et al. 2002, doi 10.1109/4235.996017) sorts by dominance, feasible designs first, and
thins what is crowded; its population is larger than what it breeds at a time, so that it keeps the
front that it has found. One objective goes to differential evolution (Storn & Price 1997, doi
10.1023/A:1008202821328), then to Nelder and Mead's simplex, which needs no slope: the smallest of
many frequencies has kinks.
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
"""From designs (N, D) to what is lowered (N, O) and what limits are missed by (N, L)."""

LARGE = 1e30
"""Stands for what is infinite or has no value: optimizers want numbers."""
POPULATION, OFFSPRING, GENERATIONS = 128, 64, 60
"""Of fronts."""
ASIDE = 1e-3
"""Weight of the other objectives at the end of a front."""
BEST_GENERATIONS, BEST_POPULATION = 100, 15
"""Of one objective; the population is so many for each number that varies."""
POLISH = 1e-6
"""Share of the bounds to which the simplex goes."""


@dataclass(frozen=True)
class Search:
    """What an optimizer found.

    Attributes
    ----------
    designs : (N, D); where no design meets the limits, the one that misses them least
    history : what was lowered, (K, O) of the best of each generation that meet the limits
    evaluations : designs that were scored
    optimizer : by which
    """

    designs: Floats
    history: list[Floats]
    evaluations: int
    optimizer: str


def find_front(
    score: Score, low: Floats, high: Floats, seed: int, progress: Callable[[int, int], None]
) -> Search:
    """Return designs between bounds (D,) that none dominates.

    Raises
    ------
    InputError
        Where pymoo is missing.
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
        asked = algorithm.ask()
        f, g = score(asked.get("X"))
        evaluations += len(f)
        algorithm.evaluator.eval(StaticProblem(problem, F=f, G=g), asked)
        algorithm.tell(infills=asked)
        best = algorithm.opt
        history.append(best.get("F")[best.get("FEAS").ravel()])
        progress(len(history), GENERATIONS)
    name = "NSGA-II of pymoo, its ends by Nelder-Mead of scipy"
    return Search(algorithm.opt.get("X"), history, evaluations, name)


def first_population(score: Score, low: Floats, high: Floats, seed: int) -> tuple[Floats, int]:
    """Return points (N, D) that fill the bounds, the ends of the front among them, and the count.

    The ends are what a population reaches last. Each is the least of one objective and a thousandth
    of the others, in spans of the points that meet the limits, by Nelder and Mead from the best of
    these; where none does there are no ends.
    """
    points = qmc.scale(qmc.Sobol(len(low), rng=seed).random(POPULATION), low, high)
    lowered, missed = score(points)
    meets = ~np.any(missed > 0, axis=1)
    evaluations = len(points)
    if not meets.any():
        return points, evaluations
    span = np.ptp(lowered[meets], axis=0)
    scale = 1 / np.where(span > 0, span, 1.0)
    for k in range(lowered.shape[1]):
        weights = scale * np.where(np.arange(len(scale)) == k, 1.0, ASIDE)
        best, taken = _least(score, weights, points[meets], low, high)
        points[-1 - k] = best
        evaluations += taken
    return points, evaluations


def _least(
    score: Score, weights: Floats, designs: Floats, low: Floats, high: Floats
) -> tuple[Floats, int]:
    """Return the design (D,) of the least weighted sum, beginning from the best of some."""
    evaluations = 0

    def cost(shares: Floats) -> Floats:
        nonlocal evaluations
        f, g = score(low + np.atleast_2d(shares) * (high - low))
        evaluations += len(f)
        missed = np.maximum(g, 0).sum(axis=1)
        return np.where(missed > 0, LARGE * missed, f @ weights)

    shares = (designs - low) / (high - low)
    costs = cost(shares)
    first = shares[costs.argmin()]
    fine = _simplex(cost, first, float(costs.min()))
    return low + (fine.x if fine.fun <= costs.min() else first) * (high - low), evaluations


def find_best(
    score: Score, low: Floats, high: Floats, seed: int, progress: Callable[[int, int], None]
) -> Search:
    """Return the design between bounds (D,) that lowers one objective most."""
    history: list[Floats] = []
    evaluations = 0

    def cost(shares: Floats) -> Floats:
        nonlocal evaluations
        f, g = score(low + np.atleast_2d(shares) * (high - low))
        evaluations += len(f)
        missed = np.maximum(g, 0).sum(axis=1)
        return np.where(missed > 0, LARGE * missed, f[:, 0])

    def note(intermediate_result: OptimizeResult) -> None:
        history.append(np.array([[float(intermediate_result.fun)]]))
        progress(len(history), BEST_GENERATIONS)

    def at_once(shares: Floats, /, *_: Any) -> Any:
        return cost(shares.T)

    unit = Bounds(np.zeros(len(low)), np.ones(len(low)))
    rough = differential_evolution(
        at_once,
        unit,
        popsize=BEST_POPULATION,
        maxiter=BEST_GENERATIONS,
        init="sobol",
        tol=1e-4,
        updating="deferred",
        vectorized=True,
        polish=False,
        rng=seed,
        callback=note,
    )
    best = _polished(cost, rough)
    history.append(np.array([[float(best.fun)]]))
    name = "differential evolution and Nelder-Mead of scipy"
    return Search((low + best.x * (high - low))[None], history, evaluations, name)


def _polished(cost: Callable[[Floats], Floats], rough: OptimizeResult) -> Any:
    """Return what Nelder and Mead's simplex makes of a minimum, or that itself."""
    fine = _simplex(cost, rough.x, float(rough.fun))
    return fine if fine.fun <= rough.fun else rough


def _simplex(cost: Callable[[Floats], Floats], first: Floats, value: float) -> Any:
    """Let Nelder and Mead's simplex lower a cost between 0 and 1, from a point and its cost."""

    def one(shares: Floats, /, *_: Any) -> float:
        return float(cost(shares)[0])

    return minimize(
        one,
        first,
        method="Nelder-Mead",
        bounds=Bounds(np.zeros(len(first)), np.ones(len(first))),
        options={"xatol": POLISH, "fatol": 1e-12 * abs(value)},
    )


def hypervolume(history: list[Floats], front: Floats) -> Floats:
    """Return what each generation dominates, as a share of a box around the final front.

    Parameters
    ----------
    history : (K, O) of each generation, what is lowered
    front : (N, O); the box reaches from its best to a tenth beyond its worst
    """
    from pymoo.indicators.hv import HV

    best, worst = front.min(axis=0), front.max(axis=0)
    span = np.where(worst > best, worst - best, 1.0)
    corner = np.full(front.shape[1], 1.1)
    volume = HV(ref_point=corner)
    found = [volume((f - best) / span) if len(f) else 0.0 for f in history]
    return np.asarray(np.array(found, np.float64) / corner.prod())
