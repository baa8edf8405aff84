"""What pictures of a study read from its data set: variables, axes, lines, labels.

Every combination of the axes that a picture does not lay along a side of its own (``load`` above
all) is a line, told apart by color and by dashes.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.errors import InputError
from tactile.files import nearest
from tactile.show.plots.style import COLORS
from tactile.study.findings import FINGER, FREQUENCY, in_decibels, number_axes, sign_of
from tactile.study.ranges import Range

if TYPE_CHECKING:
    import xarray

DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.2)))
FINGER_LOOK = {"low finger": 0, "high finger": 1, "in air": 2}
"""Places among colors and dashes that the paper's fingers keep from picture to picture."""


@dataclass(frozen=True)
class CurveSelection:
    """One combination of the axes that have no side of their own.

    Attributes
    ----------
    name : what sets it apart, as "low finger" or "free length 20 mm"
    values : what is drawn
    color, dashes : its look
    """

    name: str
    values: "xarray.DataArray"
    color: str
    dashes: Any


def variable_of(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Return a variable, or raise InputError with the nearest that there is."""
    if name not in data.data_vars:
        known = [str(entry) for entry in data.data_vars]
        raise InputError(f"no variable {name!r} in the study; {nearest(name, known)}")
    return data[name]


def axis_of(values: "xarray.DataArray", axis: str | None) -> str:
    """Return the axis to lay along a side: the one asked for, or the first that has numbers.

    Raises
    ------
    InputError
        Where there is none.
    """
    numbers = number_axes(values)
    if axis is None and numbers:
        return numbers[0]
    if axis is None or axis not in numbers:
        raise InputError(
            f"{values.name}: has no axis {axis or 'of two or more numbers'!s} to be drawn along; "
            f"there are: {', '.join(numbers) or 'none'}"
        )
    return axis


def lines_of(values: "xarray.DataArray", kept: Sequence[str]) -> list[CurveSelection]:
    """Return one line for each combination of the axes that are not kept.

    Raises
    ------
    InputError
        Where they are more than there are colors.
    """
    others = [str(d) for d in values.dims if d not in kept]
    count = int(np.prod([values.sizes[d] for d in others], dtype=int))
    if count > len(COLORS):
        raise InputError(
            f"{values.name}: {count} lines over {', '.join(others)}; at most {len(COLORS)} are "
            "drawn: fix an axis, or give it fewer values"
        )
    parts, names = [], []
    for places in product(*(range(values.sizes[d]) for d in others)):
        parts.append(values.isel(dict(zip(others, places, strict=True))))
        told = [told_of(values[d], at) for d, at in zip(others, places, strict=True)]
        names.append(", ".join(words for words in told if words))
    known = set(names) <= set(FINGER_LOOK)
    looks = [FINGER_LOOK[name] for name in names] if known else range(count)
    return [
        CurveSelection(name, part, COLORS[k], DASHES[k % len(DASHES)])
        for name, part, k in zip(names, parts, looks, strict=True)
    ]


def told_of(axis: "xarray.DataArray", at: int) -> str:
    """Return what a place on an axis is called; nothing where a number has no other."""
    value = axis.values[at]
    if axis.name == FINGER:
        return "in air" if str(value) == "none" else f"{value} finger"
    if axis.size == 1:
        return ""
    if axis.dtype.kind not in "fiu":
        return str(value)
    unit = str(axis.attrs.get("units", ""))
    name = str(axis.attrs.get("long_name", axis.name))
    return f"{name} {value:g} {'' if unit == '1' else unit}".rstrip()


def label(values: "xarray.DataArray") -> str:
    """Return what an axis is of, with its unit."""
    name = str(values.attrs.get("long_name", values.name))
    if "band" in values.attrs:
        name = name.replace("the band", str(values.attrs["band"]))
    unit = str(values.attrs.get("units", ""))
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def banded(data: "xarray.Dataset", values: "xarray.DataArray") -> "xarray.DataArray":
    """Return a variable at the frequencies in the study's band, all of them where it has none."""
    low, high = json.loads(data.attrs.get("conditions", "{}")).get("band") or (0.0, np.inf)
    f = values[FREQUENCY]
    return values.isel({FREQUENCY: np.flatnonzero((f >= low) & (f <= high))})


def over_frequency(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Return a response of the study, or raise InputError."""
    values = variable_of(data, name)
    if FREQUENCY not in values.dims:
        raise InputError(f"{name}: is no response over frequency; keep one in the study")
    return values


def told_share(share: float, values: "xarray.DataArray") -> str:
    """Return in words what of a criterion is good enough."""
    if in_decibels(values):
        return f"within {20 * np.log10(1 / share):.3g} dB of the best"
    if sign_of(values) < 0:
        return f"at most {100 / share:.4g} % of the best"
    return f"at least {100 * share:.4g} % of the best"


def told_range(good: Range, unit: str) -> str:
    """Return a range in words, its best value too."""
    cut = ", cut by the axis" if good.is_cut else ""
    return f"{good.low:.3g} … {good.high:.3g} {unit} (best {good.best:.3g}{cut})"
