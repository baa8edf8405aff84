"""Optimization of a design within bounds: the designs that no other dominates.

A `Task` names what may vary (bounds), the objectives (one to three criteria, whose sign says
whether more or less is better) and the constraints (limits on criteria). With scenarios, every
design is judged with all fingers and tolerances, and counts for what a given share of them attains
at least: with 0.9, the quantile of 10 % where more is better and of 90 % where less is. A
constraint has to hold for the same share.

`find_designs` solves a task with the optimizers of a library (`tactile.study.searching`), a whole
population at a time, and returns a labeled array along ``design``.
`tactile.study.recommending` picks one of them.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.criteria import CRITERIA, Conditions, Solved, numbers_of, variable
from tactile.study.extras import study_extra
from tactile.study.parameters import FINGERS, PARAMETERS, specimen
from tactile.study.scenarios import Scenarios
from tactile.study.searching import LARGE, Search, find_best, find_front, hypervolume
from tactile.study.sweep import PIECE_POINTS, Study, in_band, provenance, response_of, values_of

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
"""Callback that receives the number of finished generations and the number of all."""

FREQUENCIES = 32
"""Default number of frequencies, evenly spaced over the band; `find_designs` measures the error."""
FINER = 4
"""Factor by which the frequency grid is refined to judge the resulting designs once more."""
MOST_OBJECTIVES = 3
"""Largest number of objectives.

NSGA-II sorts by dominance, which hardly ranks anything among more objectives.
"""


@dataclass(frozen=True, kw_only=True)
class Task:
    """An optimization problem.

    Attributes
    ----------
    bounds : mapping of str to (float, float)
        Lowest and highest value of each number that may vary, in the unit of its name.
    objectives : tuple of str
        One to three names of `CRITERIA`.
    fixed : mapping of str to object
        Values of further parameters.
    limits : mapping of str to (float, float)
        Lowest and highest value of criteria, in their units; infinite where there is none.
    conditions : Conditions
        Band, and limits of the drive.
    frequency : (F,) array of float
        Ascending frequencies [Hz]; by default `FREQUENCIES` of them over the band.
    scenarios : Scenarios or None
        Fingers and tolerances, or None for the one finger that is fixed.
    unseen : Scenarios or None
        Further scenarios, in which the designs that were found with the others are judged once
        more.
    share : float
        Share of the scenarios that attain at least what a design counts for.
    fingers : mapping of str to FingerLoad
        Finger loads that the parameter ``load`` may name.
    base : Bimorph
        Design that supplies everything that is neither varied nor fixed.
    seed : int
        Seed of the search. The same seed gives the same designs.

    Raises
    ------
    InputError
        If bounds are reversed, infinite or outside the parameter's own limits, something is given
        twice or unknown, or a bender within the bounds cannot be built.
    """

    bounds: Mapping[str, tuple[float, float]]
    objectives: tuple[str, ...]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    frequency: ArrayLike = ()
    scenarios: Scenarios | None = None
    unseen: Scenarios | None = None
    share: float = 0.9
    fingers: Mapping[str, FingerLoad] = field(default_factory=lambda: FINGERS)
    base: Bimorph = field(default_factory=Bimorph)
    seed: int = 0

    def __post_init__(self) -> None:
        _check_bounds(self)
        _check_objectives(self)
        frequency = np.asarray(self.frequency, np.float64)
        band = self.conditions.band
        if band is not None and any(CRITERIA[name].needs_band for name in self.criteria):
            frequency = frequency if frequency.size else np.linspace(*band, FREQUENCIES)
        object.__setattr__(self, "frequency", frequency)
        study = corners(self)
        object.__setattr__(self, "frequency", frequency[in_band(study)])
        whole = tuple(slice(0, size) for size in study.shape)
        specimen(values_of(study, whole), base=self.base, fingers=self.fingers)

    @property
    def criteria(self) -> tuple[str, ...]:
        """Names of the objectives, followed by those of the other constrained criteria."""
        return tuple(dict.fromkeys((*self.objectives, *self.limits)))

    @property
    def variables(self) -> list[str]:
        """Names of the variables of the data set that the objectives are judged by."""
        return [self.judged_by(name) for name in self.objectives]

    def judged_by(self, criterion: str) -> str:
        """Return the name of the variable of the data set that a criterion is judged by.

        Parameters
        ----------
        criterion : str
            Name of `CRITERIA`.

        Returns
        -------
        str
            Name of the variable, with the prefix ``robust_`` if the task has scenarios.
        """
        return variable(criterion) if self.scenarios is None else f"robust_{variable(criterion)}"


def _check_bounds(task: Task) -> None:
    """Raise InputError for bounds within which no search is possible."""
    if not task.bounds:
        raise InputError("nothing may vary: give bounds, as length_mm=8:40")
    for name, (low, high) in task.bounds.items():
        if name in task.fixed:
            raise InputError(f"{name}: is fixed and has bounds; give one of them")
        if name not in PARAMETERS:
            raise InputError(f"no numerical parameter {name!r}; {nearest(name, list(PARAMETERS))}")
        if not -math.inf < low < high < math.inf:
            raise InputError(f"{name} = {low:g}:{high:g}: bounds must be finite and ascend")
    for name, value in task.fixed.items():
        if np.ndim(value):
            raise InputError(f"{name}: {np.size(value)} values are fixed; give one, or bounds")
    drawn = {} if task.scenarios is None else task.scenarios.values
    if task.unseen is not None and drawn.keys() != task.unseen.values.keys():
        raise InputError("unseen: must vary the same parameters as the scenarios of the search")
    if "load" in task.fixed and "firmness" in drawn:
        raise InputError(
            f"load = {task.fixed['load']!r}: the scenarios draw the finger; leave out one of them"
        )


def _check_objectives(task: Task) -> None:
    """Raise InputError for objectives and constraints that are not possible."""
    if not 1 <= len(task.objectives) <= MOST_OBJECTIVES:
        raise InputError(
            f"{len(task.objectives)} objectives: must be 1 … {MOST_OBJECTIVES}; "
            "others can be limits"
        )
    for what, names in (("objective", task.objectives), ("limit", tuple(task.limits))):
        for name in names:
            if name not in CRITERIA:
                raise InputError(f"no criterion {name!r} as {what}; "
                                 f"{nearest(name, list(CRITERIA))}")  # fmt: skip
            if names.count(name) > 1:
                raise InputError(f"{what} {name}: is given twice")
    for name in task.objectives:
        if not CRITERIA[name].sign:
            raise InputError(f"objective {name}: neither more nor less is better; limit it instead")
    for name, (low, high) in task.limits.items():
        if not low < high or low == -high == -math.inf:
            raise InputError(
                f"limit {name} = {low:g}:{high:g}: must ascend, with one end finite at least"
            )
    if not 0 < task.share < 1:
        raise InputError(f"share = {task.share:g}: must be above 0 and below 1, as 0.9")
    if task.seed < 0:
        raise InputError(f"seed = {task.seed}: must be 0 or above")


def corners(task: Task) -> Study:
    """Return the study of the ends of all bounds.

    What is valid at the ends of all bounds is valid in between, so that this study checks a task.

    Parameters
    ----------
    task : Task
        Optimization problem.

    Returns
    -------
    Study
        Study with one axis of two values for each parameter that may vary.
    """
    return Study(
        axes={name: np.array(ends, np.float64) for name, ends in task.bounds.items()},
        frequency=task.frequency,
        fixed=task.fixed,
        criteria=task.criteria,
        scenarios=task.scenarios,
        conditions=task.conditions,
        fingers=task.fingers,
        base=task.base,
    )


def judge(task: Task, designs: Floats) -> dict[str, Floats]:
    """Judge designs in all scenarios, in pieces that stay in a processor's cache.

    Parameters
    ----------
    task : Task
        Optimization problem.
    designs : (N, D) array of float
        Values of the numbers that have bounds, in their order and units.

    Returns
    -------
    dict of str to (N, S) array of float
        Values of each criterion in its unit; S is 1 without scenarios. NaN where there is no value.
    """
    count = 1 if task.scenarios is None else task.scenarios.count
    size = max(1, PIECE_POINTS // (count * max(1, np.size(task.frequency))))
    study = corners(task)
    common = {
        name: value if np.ndim(value) == 0 else np.ravel(value)
        for name, value in values_of(study, tuple(slice(0, n) for n in study.shape)).items()
        if name not in task.bounds
    }
    results = {name: np.empty((len(designs), count)) for name in task.criteria}
    for at in range(0, len(designs), size):
        part = slice(at, at + size)
        for name, values in _judge_piece(task, common, designs[part]).items():
            results[name][part] = values
    return results


def _judge_piece(task: Task, common: dict[str, Any], designs: Floats) -> dict[str, Floats]:
    """Judge designs (N, D) that are solved at once; see `judge`."""
    values = dict(common)
    factors = {} if task.scenarios is None else task.scenarios.factors
    for name, column in zip(task.bounds, designs.T, strict=True):
        values[name] = column[:, None] * np.asarray(factors.get(name, 1.0))
    specimens = specimen(values, base=task.base, fingers=task.fingers)
    response = response_of(specimens, task.frequency)
    solved = Solved(specimens, response, task.conditions)
    return numbers_of(task.criteria, solved)


def attained(values: Floats, share: float, sign: int) -> Floats:
    """Compute the value that a share of the scenarios attains at least.

    Where more is better (``sign`` 1) this is the quantile 1 − share, otherwise the quantile
    ``share``.

    Parameters
    ----------
    values : (N, S) array of float
        Values of a criterion for N designs in S scenarios.
    share : float
        Share of the scenarios, above 0 and below 1.
    sign : int
        1 where more is better, otherwise −1.

    Returns
    -------
    (N,) array of float
        Attained values, in the unit of the criterion.
    """
    clipped = np.clip(values, -LARGE, LARGE)
    quantile = 1 - share if sign > 0 else share
    return np.asarray(np.quantile(clipped, quantile, axis=-1, method="weibull"))


def scores(task: Task, designs: Floats) -> tuple[Floats, Floats]:
    """Score designs for an optimizer that minimizes.

    Parameters
    ----------
    task : Task
        Optimization problem.
    designs : (N, D) array of float
        Values of the numbers that have bounds, in their order and units.

    Returns
    -------
    lowered : (N, O) array of float
        Objectives, with their sign changed so that less is better.
    missed : (N, 2 L) array of float
        Relative violation of each constraint, its lowest value before its highest; at most 0 where
        the constraint is met.
    """
    results = judge(task, designs)
    lowered = [
        -CRITERIA[name].sign * attained(results[name], task.share, CRITERIA[name].sign)
        for name in task.objectives
    ]
    missed = []
    for name, ends in task.limits.items():
        for sign, end in zip((1, -1), ends, strict=True):
            over = np.full(len(designs), -1.0)
            if math.isfinite(end):
                reached = attained(results[name], task.share, sign)
                over = sign * (end - reached) / (abs(end) or 1.0)
            missed.append(over)
    columns = np.stack([*lowered, *missed], axis=-1)
    columns = np.clip(np.nan_to_num(columns, nan=LARGE), -LARGE, LARGE)
    return columns[:, : len(lowered)], columns[:, len(lowered) :]


def find_designs(task: Task, progress: Progress = lambda done, total: None) -> "xarray.Dataset":
    """Find the designs that no other dominates, or the best design for a single objective.

    Parameters
    ----------
    task : Task
        Optimization problem.
    progress : callable
        Called with the number of finished generations and the number of all.

    Returns
    -------
    xarray.Dataset
        Along ``design``, the best in the first objective first: values of the parameters and of
        each criterion. With scenarios each criterion is there twice: for the middle finger and
        nominal parts, and as ``robust_…`` what the share attains. Along ``generation``: the
        ``hypervolume`` of the designs found so far (share of the box between best and worst of the
        front, a tenth wider), or the ``best`` value of a single objective. Attributes: the
        provenance, ``objectives``, the number of ``evaluations``, and ``sampling_error``, the
        largest relative change of an objective or constrained criterion when the same designs are
        judged at four times as many frequencies. With ``unseen`` scenarios also ``unseen_loss``,
        the largest share by which one of these is worse there; a loss is to be expected, since the
        designs are the best for the fingers of the search.

    Raises
    ------
    InputError
        If no design meets the constraints (the message gives the nearest), no design has finite
        values, or a library is missing.
    """
    with study_extra("an optimization"):  # before the search, not after it
        import xarray  # noqa: F401
    low, high = np.array(list(task.bounds.values()), np.float64).T
    seek = find_best if len(task.objectives) == 1 else find_front
    search = seek(lambda x: scores(task, x), low, high, task.seed, progress)
    lowered, missed = scores(task, search.designs)
    if np.any(missed > 0):
        raise InputError(_unmet_message(task, search.designs[0], missed[0]))
    finite = np.all(np.abs(lowered) < LARGE, axis=1)
    if not finite.any():
        raise InputError(f"{task.objectives[0]}: no finite value was found within the bounds")
    designs, lowered = search.designs[finite], lowered[finite]
    order = np.lexsort(lowered.T[::-1])
    return _labeled(task, search, designs[order], lowered[order])


def _unmet_message(task: Task, design: Floats, missed: Floats) -> str:
    """Return a message on the constraint that the nearest design misses, and by how much."""
    worst = int(missed.argmax())
    name = list(task.limits)[worst // 2]
    sign, mark = ((1, "≥"), (-1, "≤"))[worst % 2]
    reached = float(attained(judge(task, design[None])[name], task.share, sign)[0])
    unit, end = CRITERIA[name].unit, task.limits[name][worst % 2]
    where = ", ".join(f"{p} = {x:.4g}" for p, x in zip(task.bounds, design, strict=True))
    what = "it" if len(task.limits) == 1 else "all limits"
    return (
        f"limit {name} {mark} {end:g} {unit}: no design within the bounds meets {what}; the "
        f"nearest has {reached:.4g} {unit} ({where})"
    )


def finer(task: Task) -> Task:
    """Return the task on a grid of `FINER` frequency steps for each one.

    Parameters
    ----------
    task : Task
        Optimization problem.

    Returns
    -------
    Task
        Same problem at more frequencies.
    """
    f = np.asarray(task.frequency)
    steps = np.arange(FINER * (f.size - 1) + 1) / FINER
    return replace(task, frequency=np.interp(steps, np.arange(f.size), f))


def sampling_error(task: Task, designs: Floats) -> float:
    """Compute the largest relative change of criteria on the frequency grid of `finer`.

    Parameters
    ----------
    task : Task
        Optimization problem.
    designs : (N, D) array of float
        Designs to judge.

    Returns
    -------
    float
        Relative change; 0 without frequencies.
    """
    if not np.size(task.frequency):
        return 0.0
    few, many = _attained_values(task, designs), _attained_values(finer(task), designs)
    return max(
        float((np.abs(few[name] - b) / np.maximum(np.abs(b), _smallest_scale(b))).max())
        for name, b in many.items()
    )


def unseen_loss(task: Task, unseen: Scenarios, designs: Floats) -> float:
    """Compute by what share designs are worse, at most, in scenarios that the search did not use.

    Parameters
    ----------
    task : Task
        Optimization problem.
    unseen : Scenarios
        Scenarios that the search did not use.
    designs : (N, D) array of float
        Designs to judge.

    Returns
    -------
    float
        Largest relative loss of a criterion; negative if all are better.
    """
    seen, other = (
        _attained_values(task, designs),
        _attained_values(replace(task, scenarios=unseen), designs),
    )
    return max(
        float(
            (
                _sign(task, name) * (a - other[name]) / np.maximum(np.abs(a), _smallest_scale(a))
            ).max()
        )
        for name, a in seen.items()
    )


def _smallest_scale(values: Floats) -> float:
    """Return the smallest scale of a relative change: a thousandth of the largest value, or 1."""
    return 1e-3 * float(np.abs(values).max()) or 1.0


def _attained_values(task: Task, designs: Floats) -> dict[str, Floats]:
    """Return the attained values (N,) of each criterion for designs (N, D)."""
    return {
        name: attained(values, task.share, _sign(task, name))
        for name, values in judge(task, designs).items()
    }


def _sign(task: Task, name: str) -> int:
    """Return the sign of a criterion; of a neutral one, 1 if it has a lowest value, else −1."""
    low = task.limits.get(name, (-math.inf, math.inf))[0]
    return CRITERIA[name].sign or (1 if low > -math.inf else -1)


def middle(task: Task) -> Task:
    """Return the task without scenarios: the median of the drawn values, and nominal parts.

    Parameters
    ----------
    task : Task
        Optimization problem.

    Returns
    -------
    Task
        Problem with the medians of the drawn values as fixed values.
    """
    if task.scenarios is None:
        return task
    drawn = {name: float(np.median(array)) for name, array in task.scenarios.values.items()}
    return replace(task, scenarios=None, unseen=None, fixed={**task.fixed, **drawn})


def _labeled(task: Task, search: Search, designs: Floats, lowered: Floats) -> "xarray.Dataset":
    """Return designs (N, D) and their criteria as a data set with labels and provenance."""
    import xarray

    data = xarray.Dataset(attrs=_provenance(task, search, designs))
    for name, column in zip(task.bounds, designs.T, strict=True):
        p = PARAMETERS[name]
        data = data.assign_coords(
            {name: ("design", column, {"units": p.unit, "long_name": p.means})}
        )
    for name, values in judge(middle(task), designs).items():
        data[variable(name)] = ("design", values[:, 0], _labels_of(name))
    if task.scenarios is not None:
        for name, values in _attained_values(task, designs).items():
            labels = _labels_of(name) | {
                "long_name": f"{CRITERIA[name].means}, which {task.share:.0%} attain"
            }
            data[task.judged_by(name)] = ("design", values, labels)
    if len(task.objectives) > 1:
        labels = {"units": "1", "long_name": "share of the box of the front"}
        data["hypervolume"] = ("generation", hypervolume(search.history, lowered), labels)
    else:
        least = np.array([f.min() for f in search.history])
        best = -CRITERIA[task.objectives[0]].sign * np.where(
            np.abs(least) < LARGE / 1e6, least, np.nan
        )
        data["best"] = ("generation", best, {"units": CRITERIA[task.objectives[0]].unit})
    return data


def _labels_of(name: str) -> dict[str, str]:
    """Return the attributes of a criterion's variable."""
    c = CRITERIA[name]
    return {"units": c.unit, "long_name": c.means, "criterion": name}


def _provenance(task: Task, search: Search, designs: Floats) -> dict[str, Any]:
    """Return the provenance of the designs as attributes."""
    limits = {
        name: [None if math.isinf(end) else end for end in ends]
        for name, ends in task.limits.items()
    }
    attributes = {
        **provenance(corners(task)),
        "title": f"Bimorph with the best {' and '.join(task.objectives)}",
        "bounds": json.dumps({name: list(ends) for name, ends in task.bounds.items()}),
        "objectives": " ".join(task.variables),
        "limits": json.dumps(limits),
        "frequencies": int(np.size(task.frequency)),
        "seed": task.seed,
        "optimizer": search.optimizer,
        "evaluations": search.evaluations,
        "sampling_error": sampling_error(task, designs),
    }
    if task.scenarios is not None:
        attributes |= {"scenarios": task.scenarios.count, "share": task.share}
        sampled = {**task.scenarios.values, **task.scenarios.factors}
        spread = {name: [float(np.mean(x)), float(np.std(x))] for name, x in sampled.items()}
        attributes["drawn"] = json.dumps(spread)
    if task.unseen is not None:
        attributes["unseen_loss"] = unseen_loss(task, task.unseen, designs)
    return attributes
