"""One design of a front in plain words: the knee, and what it costs against each end.

With each objective scaled to 0 at its best along the front and 1 at its worst, the knee lies
farthest from the line (of three objectives, the plane) between the ends: beyond it, little more of
one objective costs much of another (Das 1999, doi 10.1007/s001580050111).
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
"""Relative difference that is not worth a word."""


@dataclass(frozen=True)
class Recommendation:
    """A design that is recommended.

    Attributes
    ----------
    place : along ``design``
    words : what it is, and what it costs against each end
    """

    place: int
    words: str


def lowered(front: "xarray.Dataset") -> Floats:
    """Return objectives (N, O) of a front so that less is better, each 0 … 1 along it."""
    columns = []
    for name in front.attrs["objectives"].split():
        values = -CRITERIA[front[name].attrs["criterion"]].sign * front[name].values
        span = values.max() - values.min()
        columns.append((values - values.min()) / (span if span > 0 else 1.0))
    return np.stack(columns, axis=-1)


def recommend(front: "xarray.Dataset") -> Recommendation:
    """Return the knee of a front and a sentence about it; see the module's docstring.

    Parameters
    ----------
    front : as `tactile.study.optimizing.find_designs` returns it
    """
    scaled = lowered(front)
    place = int(scaled.sum(axis=1).argmin())
    lines = [f"{_design(front, place)}: {_reached(front, place)}."]
    if scaled.shape[1] == 1 or len(scaled) == 1:
        lines.append("Nothing else within the bounds is better in anything that was asked for.")
        return Recommendation(place, " ".join(lines))
    names = front.attrs["objectives"].split()
    for column, name in enumerate(names):
        end = int(np.lexsort((scaled.sum(axis=1), scaled[:, column]))[0])
        if end == place:
            lines.append(f"It is itself the best in {_spoken(front, name)}.")
            continue
        told = [_against(front, other, place, end) for other in names]
        lines.append(
            f"Against the best in {_spoken(front, name)} ({_design(front, end)}) it has "
            f"{_joined([words for words in told if words])}."
        )
    return Recommendation(place, " ".join(lines))


def _design(front: "xarray.Dataset", place: int) -> str:
    """Return the values of a design, as "length 21.3 mm and width 2 mm"."""
    return _joined(
        [
            f"{PARAMETERS[str(name)].means} {float(front[name][place]):.3g} "
            f"{PARAMETERS[str(name)].unit}".removesuffix(" 1")
            for name in front.coords
            if name in PARAMETERS
        ]
    )


def _reached(front: "xarray.Dataset", place: int) -> str:
    """Return what a design counts for in each objective, beside it the middle finger's."""
    told = []
    for name in front.attrs["objectives"].split():
        of = front[name].attrs
        value, nominal = float(front[name][place]), front[variable(of["criterion"])]
        words = f"{_spoken(front, name)} {value:.3g} {of['units']}"
        if name.startswith("robust_"):
            words += f" ({float(nominal[place]):.3g} {of['units']} in the middle)"
        told.append(words)
    return _joined(told)


def _spoken(front: "xarray.Dataset", name: str) -> str:
    return str(front[name].attrs["criterion"]).replace("_", " ")


def _against(front: "xarray.Dataset", name: str, place: int, end: int) -> str:
    """Return how an objective compares with an end's, or "" where it is alike."""
    value, other = float(front[name][place]), float(front[name][end])
    what, unit = _spoken(front, name), front[name].attrs["units"]
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


def _joined(words: list[str]) -> str:
    """Return words as a list in a sentence."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
