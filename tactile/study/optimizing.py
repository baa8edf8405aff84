"""The best designs within bounds: what none beats in everything that is asked for at once.

A `Task` names what may vary (bounds), what is wanted (one to three criteria; their sign says
whether more or less is better) and what must hold (limits on criteria). With scenarios every design
meets all fingers and tolerances, and counts for what a share of them attains at least: with 0.9
the quantile of 10 % where more is better, of 90 % where less is; a limit holds for as many.

`find_designs` solves it with a library's optimizers (`tactile.study.searching`), a whole population
at a time, into a labeled array along ``design``; `tactile.study.recommending` picks one.
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
from tactile.study.parameters import FINGERS, PARAMETERS, specimen
from tactile.study.scenarios import Scenarios
from tactile.study.searching import LARGE, Search, find_best, find_front, hypervolume
from tactile.study.sweep import PIECE_POINTS, Study, in_band, provenance, response_of, values_of

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
"""Is told how many generations of how many are done."""

FREQUENCIES = 32
"""Over a band, evenly, where nobody says which; `find_designs` measures what they miss."""
FINER = 4
"""Times as many frequencies, between those of the search, judge what it found once more."""
MOST_OBJECTIVES = 3
"""NSGA-II sorts by dominance, which among more objectives hardly ranks anything."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What is to be found.

    Attributes
    ----------
    bounds : lowest and highest value of each number that may vary, in the unit of its name
    objectives : one to three names of `CRITERIA`
    fixed : values of further parameters
    limits : lowest and highest value of criteria, in their units; infinite where there is none
    conditions : band and limits of drive
    frequency : ascending (F,) [Hz]; `FREQUENCIES` of them over the band by default
    scenarios : fingers and tolerances, or None for the one that is fixed
    unseen : more of them, which judge once more what was found by the others; or None
    share : of the scenarios that attain at least what a design counts for
    fingers : what ``load`` may name
    base : what nobody varies
    seed : same seed, same designs

    Raises
    ------
    InputError
        For bounds that are reversed, infinite or outside the parameter's own; for what is given
        twice or unknown, and where a bender within the bounds cannot be built.
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
        _check_wishes(self)
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
        """Objectives, then what else is limited."""
        return tuple(dict.fromkeys((*self.objectives, *self.limits)))

    @property
    def variables(self) -> list[str]:
        """Names of what the objectives are judged by, in the data set."""
        return [self.judged_by(name) for name in self.objectives]

    def judged_by(self, criterion: str) -> str:
        """Return the name of what a criterion is judged by, in the data set."""
        return variable(criterion) if self.scenarios is None else f"robust_{variable(criterion)}"


def _check_bounds(task: Task) -> None:
    """Raise InputError for bounds between which nothing can be sought."""
    if not task.bounds:
        raise InputError("nothing may vary: give bounds, as length_mm=8:40")
    for name, (low, high) in task.bounds.items():
        if name in task.fixed:
            raise InputError(f"{name}: is fixed and has bounds; give one of them")
        if name not in PARAMETERS:
            raise InputError(f"no number {name!r} to bound; {nearest(name, list(PARAMETERS))}")
        if not -math.inf < low < high < math.inf:
            raise InputError(f"{name} = {low:g}:{high:g}: bounds must be finite and ascend")
    for name, value in task.fixed.items():
        if np.ndim(value):
            raise InputError(f"{name}: {np.size(value)} values are fixed; give one, or bounds")
    drawn = {} if task.scenarios is None else task.scenarios.values
    if task.unseen is not None and drawn.keys() != task.unseen.values.keys():
        raise InputError("unseen: must draw what the scenarios of the search do")
    if "load" in task.fixed and "firmness" in drawn:
        raise InputError(
            f"load = {task.fixed['load']!r}: the scenarios draw the finger; leave out one of them"
        )


def _check_wishes(task: Task) -> None:
    """Raise InputError for objectives and limits that cannot be asked for."""
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
    """Return a study of the ends of all bounds: what can be asked there, can be in between."""
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
    designs : (N, D) values of the numbers that have bounds, in their order and units

    Returns
    -------
    dict of ndarray
        (N, S) of each criterion, in its unit; S is 1 without scenarios. NaN where it has none.
    """
    count = 1 if task.scenarios is None else task.scenarios.count
    size = max(1, PIECE_POINTS // (count * max(1, np.size(task.frequency))))
    study = corners(task)
    common = {
        name: value if np.ndim(value) == 0 else np.ravel(value)
        for name, value in values_of(study, tuple(slice(0, n) for n in study.shape)).items()
        if name not in task.bounds
    }
    found = {name: np.empty((len(designs), count)) for name in task.criteria}
    for at in range(0, len(designs), size):
        part = slice(at, at + size)
        for name, values in _judge_piece(task, common, designs[part]).items():
            found[name][part] = values
    return found


def _judge_piece(task: Task, common: dict[str, Any], designs: Floats) -> dict[str, Floats]:
    """Return what `judge` does, of designs (N, D) that are solved at once."""
    values = dict(common)
    factors = {} if task.scenarios is None else task.scenarios.factors
    for name, column in zip(task.bounds, designs.T, strict=True):
        values[name] = column[:, None] * np.asarray(factors.get(name, 1.0))
    made = specimen(values, base=task.base, fingers=task.fingers)
    response = response_of(made, task.frequency)
    solved = Solved(made, response, task.conditions)
    return numbers_of(task.criteria, solved)


def attained(values: Floats, share: float, sign: int) -> Floats:
    """Return (N,) what a share of the scenarios attains at least, of (N, S).

    Where more is better (``sign`` 1) it is the quantile 1 − share, else the quantile ``share``.
    """
    held = np.clip(values, -LARGE, LARGE)
    wanted = 1 - share if sign > 0 else share
    return np.asarray(np.quantile(held, wanted, axis=-1, method="weibull"))


def scores(task: Task, designs: Floats) -> tuple[Floats, Floats]:
    """Return what an optimizer lowers (N, O), and by what share limits are missed (N, 2 L).

    Limits come as lowest and highest; what is at most 0 is met.
    """
    found = judge(task, designs)
    lowered = [
        -CRITERIA[name].sign * attained(found[name], task.share, CRITERIA[name].sign)
        for name in task.objectives
    ]
    missed = []
    for name, ends in task.limits.items():
        for sign, end in zip((1, -1), ends, strict=True):
            over = np.full(len(designs), -1.0)
            if math.isfinite(end):
                reached = attained(found[name], task.share, sign)
                over = sign * (end - reached) / (abs(end) or 1.0)
            missed.append(over)
    columns = np.stack([*lowered, *missed], axis=-1)
    columns = np.clip(np.nan_to_num(columns, nan=LARGE), -LARGE, LARGE)
    return columns[:, : len(lowered)], columns[:, len(lowered) :]


def find_designs(task: Task, progress: Progress = lambda done, total: None) -> "xarray.Dataset":
    """Find the designs that none beats in all objectives, or the best of a single one.

    Parameters
    ----------
    task : what is to be found
    progress : is told of each generation

    Returns
    -------
    xarray.Dataset
        Along ``design``, the best of the first objective first: values of the parameters, and each
        criterion twice with scenarios: of the middle finger and parts as drawn, and as
        ``robust_…`` what the share attains. Along ``generation`` the ``hypervolume`` of what was
        found so far (share of the box between best and worst of the front, a tenth wider), or the
        ``best`` of a single objective. Attributes: how it came to be, ``objectives``, the number of
        ``evaluations``, and ``sampling_error``: the largest relative change of an objective or
        limited criterion when four times as many frequencies judge the same designs. With
        ``unseen`` scenarios also ``unseen_loss``: the largest share by which one of them is worse
        there, since what was found is the best for the fingers that the search saw.

    Raises
    ------
    InputError
        Where no design meets the limits (with the nearest), or a library is missing.
    """
    low, high = np.array(list(task.bounds.values()), np.float64).T
    seek = find_best if len(task.objectives) == 1 else find_front
    search = seek(lambda x: scores(task, x), low, high, task.seed, progress)
    lowered, missed = scores(task, search.designs)
    if np.any(missed > 0):
        raise InputError(_unmet(task, search.designs[0], missed[0]))
    kept = np.all(np.abs(lowered) < LARGE, axis=1)
    if not kept.any():
        raise InputError(f"{task.objectives[0]}: has no finite value found within the bounds")
    designs, lowered = search.designs[kept], lowered[kept]
    order = np.lexsort(lowered.T[::-1])
    return _labeled(task, search, designs[order], lowered[order])


def _unmet(task: Task, design: Floats, missed: Floats) -> str:
    """Return the line that says which limit the nearest design misses, and by how much."""
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
    """Return the task with `FINER` steps of frequency for each."""
    f = np.asarray(task.frequency)
    steps = np.arange(FINER * (f.size - 1) + 1) / FINER
    return replace(task, frequency=np.interp(steps, np.arange(f.size), f))


def sampling_error(task: Task, designs: Floats) -> float:
    """Return the largest relative change of what designs count for on `finer` frequencies."""
    if not np.size(task.frequency):
        return 0.0
    few, many = _counted(task, designs), _counted(finer(task), designs)
    return max(
        float((np.abs(few[name] - b) / np.maximum(np.abs(b), _least(b))).max())
        for name, b in many.items()
    )


def unseen_loss(task: Task, unseen: Scenarios, designs: Floats) -> float:
    """Return by what share designs count for less, at most, in scenarios that had no part in it."""
    seen, other = _counted(task, designs), _counted(replace(task, scenarios=unseen), designs)
    return max(
        float((_sign(task, name) * (a - other[name]) / np.maximum(np.abs(a), _least(a))).max())
        for name, a in seen.items()
    )


def _least(values: Floats) -> float:
    """Return what a change is measured by at least: a thousandth of the largest."""
    return 1e-3 * float(np.abs(values).max()) or 1.0


def _counted(task: Task, designs: Floats) -> dict[str, Floats]:
    """Return what designs (N, D) count for (N,), of each criterion."""
    return {
        name: attained(values, task.share, _sign(task, name))
        for name, values in judge(task, designs).items()
    }


def _sign(task: Task, name: str) -> int:
    """Return 1 where more of a criterion is better, or has a lowest value; else −1."""
    low = task.limits.get(name, (-math.inf, math.inf))[0]
    return CRITERIA[name].sign or (1 if low > -math.inf else -1)


def middle(task: Task) -> Task:
    """Return the task without scenarios: the middle of what they draw, parts as they are drawn."""
    if task.scenarios is None:
        return task
    drawn = {name: float(np.median(array)) for name, array in task.scenarios.values.items()}
    return replace(task, scenarios=None, unseen=None, fixed={**task.fixed, **drawn})


def _labeled(task: Task, search: Search, designs: Floats, lowered: Floats) -> "xarray.Dataset":
    """Return designs (N, D) and what they are judged by, with labels and how they came to be."""
    import xarray

    data = xarray.Dataset(attrs=_provenance(task, search, designs))
    for name, column in zip(task.bounds, designs.T, strict=True):
        p = PARAMETERS[name]
        data = data.assign_coords(
            {name: ("design", column, {"units": p.unit, "long_name": p.means})}
        )
    for name, values in judge(middle(task), designs).items():
        data[variable(name)] = ("design", values[:, 0], _told(name))
    if task.scenarios is not None:
        for name, values in _counted(task, designs).items():
            labels = _told(name) | {
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


def _told(name: str) -> dict[str, str]:
    c = CRITERIA[name]
    return {"units": c.unit, "long_name": c.means, "criterion": name}


def _provenance(task: Task, search: Search, designs: Floats) -> dict[str, Any]:
    """Return how the designs came to be, as attributes."""
    limits = {
        name: [None if math.isinf(end) else end for end in ends]
        for name, ends in task.limits.items()
    }
    found = {
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
        found |= {"scenarios": task.scenarios.count, "share": task.share}
        drawn = {**task.scenarios.values, **task.scenarios.factors}
        spread = {name: [float(np.mean(x)), float(np.std(x))] for name, x in drawn.items()}
        found["drawn"] = json.dumps(spread)
    if task.unseen is not None:
        found["unseen_loss"] = unseen_loss(task, task.unseen, designs)
    return found
