"""Recommendation of one design of a Pareto front: its knee, and what it costs against each end.

With each objective scaled to 0 at its best along the front and 1 at its worst, the knee lies
farthest from the line (of three objectives, the plane) through the ends: beyond it, little more of
one objective costs much of another (Das 1999, doi 10.1007/s001580050111). A front that is nearly
straight has no knee, and none of its designs is recommended.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tactile.arrays import Floats
from tactile.study.criteria import CRITERIA, variable
from tactile.study.parameters import PARAMETERS

if TYPE_CHECKING:
    import xarray


ALIKE = 0.005
"""Relative difference below which two values are not worth comparing."""


LEAST_BULGE = 0.1
"""Bulge of a front from which on it has a knee (assumed): two objectives are then better there by
5 % of their ranges than in proportion, and fronts of the search scatter by less."""


@dataclass(frozen=True)
class Recommendation:
    """A recommended design, or the reason why there is none.

    Attributes
    ----------
    place : int or None
        Position along ``design``; None if no design is to be preferred.
    words : str
        Description of the design, and what it costs against each end of the front.
    """

    place: int | None
    words: str


def lowered(front: "xarray.Dataset") -> Floats:
    """Return the objectives of a front, scaled and with their sign changed so that less is better.

    Parameters
    ----------
    front : xarray.Dataset
        Pareto front of `tactile.study.optimizing.find_designs`.

    Returns
    -------
    (N, O) array of float
        Objectives, each 0 at its best along the front and 1 at its worst.
    """
    columns = []
    for name in front.attrs["objectives"].split():
        values = -CRITERIA[front[name].attrs["criterion"]].sign * front[name].values
        span = values.max() - values.min()
        columns.append((values - values.min()) / (span if span > 0 else 1.0))
    return np.stack(columns, axis=-1)


def bulges(scaled: Floats) -> Floats:
    """Compute how far designs lie beyond the plane through the ends of a front.

    Parameters
    ----------
    scaled : (N, O) array of float
        Objectives as `lowered` returns them.

    Returns
    -------
    (N,) array of float
        Distance from the plane in units of that of the ideal point, whose objectives are all 0:
        0 in the plane, 1 at the ideal point. All are 0 if the ends have no such plane.
    """
    ends = scaled[[_end(scaled, column) for column in range(scaled.shape[1])]]
    if np.linalg.matrix_rank(ends) < len(ends):
        return np.zeros(len(scaled))
    return np.asarray(1 - scaled @ np.linalg.solve(ends, np.ones(len(ends))))


def _end(scaled: Floats, column: int) -> int:
    """Return the position of the best design in one objective, of several the best in all."""
    return int(np.lexsort((scaled.sum(axis=1), scaled[:, column]))[0])


def recommend(front: "xarray.Dataset") -> Recommendation:
    """Recommend the knee of a front, if there is one; see the module's docstring.

    Parameters
    ----------
    front : xarray.Dataset
        Pareto front of `tactile.study.optimizing.find_designs`.

    Returns
    -------
    Recommendation
        Knee of the front, with a description; of a front of one design, that design.
    """
    scaled = lowered(front)
    names = front.attrs["objectives"].split()
    ends = [_end(scaled, column) for column in range(len(names))]
    if len({*ends}) == 1:
        words = "Nothing else within the bounds is better in anything that was asked for."
        return Recommendation(ends[0], f"{_described(front, ends[0])} {words}")
    bulge = bulges(scaled)
    place = int(bulge.argmax())
    if bulge[place] < LEAST_BULGE:
        lines = ["No design is recommended: along the front, the objectives change in proportion."]
        lines += [
            f"Best in {_criterion_name(front, name)} is {_described(front, end)}"
            for name, end in zip(names, ends, strict=True)
        ]
        return Recommendation(None, " ".join(lines))
    lines = [_described(front, place)]
    for name, end in zip(names, ends, strict=True):
        if end == place:
            lines.append(f"It is itself the best in {_criterion_name(front, name)}.")
            continue
        differences = [_compare(front, other, place, end) for other in names]
        lines.append(
            f"Against the best in {_criterion_name(front, name)} ({_design(front, end)}) it has "
            f"{_join([words for words in differences if words])}."
        )
    return Recommendation(place, " ".join(lines))


def _described(front: "xarray.Dataset", place: int) -> str:
    """Return a design and its objectives, as a sentence."""
    return f"{_design(front, place)}: {_objectives_of(front, place)}."


def _design(front: "xarray.Dataset", place: int) -> str:
    """Return the values of a design, such as "length 21.3 mm and width 2 mm"."""
    return _join(
        [
            f"{PARAMETERS[str(name)].means} {float(front[name][place]):.3g} "
            f"{PARAMETERS[str(name)].unit}".removesuffix(" 1")
            for name in front.coords
            if name in PARAMETERS
        ]
    )


def _objectives_of(front: "xarray.Dataset", place: int) -> str:
    """Return a design's objectives; a robust one is followed by its value for the middle finger."""
    values = []
    for name in front.attrs["objectives"].split():
        of = front[name].attrs
        value, nominal = float(front[name][place]), front[variable(of["criterion"])]
        words = f"{_criterion_name(front, name)} {value:.3g} {of['units']}"
        if name.startswith("robust_"):
            words += f" ({float(nominal[place]):.3g} {of['units']} in the middle)"
        values.append(words)
    return _join(values)


def _criterion_name(front: "xarray.Dataset", name: str) -> str:
    """Return the name of an objective's criterion in words."""
    return str(front[name].attrs["criterion"]).replace("_", " ")


def _compare(front: "xarray.Dataset", name: str, place: int, end: int) -> str:
    """Return how an objective compares with that at an end of the front, or "" if alike."""
    value, other = float(front[name][place]), float(front[name][end])
    what, unit = _criterion_name(front, name), front[name].attrs["units"]
    if unit == "dB" or other <= 0:
        difference = value - other
        return f"{abs(difference):.3g} {unit} {_more(difference)} {what}" if difference else ""
    ratio = value / other
    if abs(ratio - 1) < ALIKE:
        return ""
    if ratio >= 2:
        return f"{ratio:.3g} times the {what}"
    return f"{abs(ratio - 1):.0%} {_more(ratio - 1)} {what}"


def _more(difference: float) -> str:
    return "more" if difference > 0 else "less"


def _join(words: list[str]) -> str:
    """Return words as a list in a sentence."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
