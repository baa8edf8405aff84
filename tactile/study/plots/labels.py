"""Common parts of the figures of a study: variables, axes, lines and labels, from the data set.

Every combination of the axes that a figure does not draw along one of its own (above all ``load``)
is a line, distinguished by color and dashes.
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
"""Dash patterns of lines."""
FINGER_LOOK = {"low finger": 0, "high finger": 1, "in air": 2}
"""Indices of color and dashes that the paper's fingers have in every figure."""


@dataclass(frozen=True)
class CurveSelection:
    """One combination of the axes that are not drawn along an axis of the figure.

    Attributes
    ----------
    name : str
        Distinguishing name, such as "low finger" or "free length 20 mm".
    values : xarray.DataArray
        Values to draw.
    color : str
        Color of the line.
    dashes : str or tuple
        Dash pattern of the line, as matplotlib takes it.
    """

    name: str
    values: "xarray.DataArray"
    color: str
    dashes: Any


def variable_of(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Return a variable of a data set.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    name : str
        Name of the variable.

    Returns
    -------
    xarray.DataArray
        Variable.

    Raises
    ------
    InputError
        If there is no such variable; the message gives the nearest name.
    """
    if name not in data.data_vars:
        known = [str(entry) for entry in data.data_vars]
        raise InputError(f"no variable {name!r} in the study; {nearest(name, known)}")
    return data[name]


def axis_of(values: "xarray.DataArray", axis: str | None) -> str:
    """Return the axis to draw along: the requested one, or the first that has numbers.

    Parameters
    ----------
    values : xarray.DataArray
        Values to draw.
    axis : str or None
        Requested axis.

    Returns
    -------
    str
        Name of the axis.

    Raises
    ------
    InputError
        If there is no such axis of two or more numbers.
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


def lines_of(values: "xarray.DataArray", along: Sequence[str]) -> list[CurveSelection]:
    """Return one line for each combination of the other axes.

    Parameters
    ----------
    values : xarray.DataArray
        Values to draw.
    along : sequence of str
        Names of the axes that each line keeps.

    Returns
    -------
    list of CurveSelection
        Lines with names and styles.

    Raises
    ------
    InputError
        If there are more lines than colors.
    """
    others = [str(d) for d in values.dims if d not in along]
    count = int(np.prod([values.sizes[d] for d in others], dtype=int))
    if count > len(COLORS):
        raise InputError(
            f"{values.name}: {count} lines over {', '.join(others)}; at most {len(COLORS)} are "
            "drawn: fix an axis, or give it fewer values"
        )
    parts, names = [], []
    for places in product(*(range(values.sizes[d]) for d in others)):
        parts.append(values.isel(dict(zip(others, places, strict=True))))
        labels = [position_name(values[d], at) for d, at in zip(others, places, strict=True)]
        names.append(", ".join(words for words in labels if words))
    is_paper = set(names) <= set(FINGER_LOOK)
    looks = [FINGER_LOOK[name] for name in names] if is_paper else range(count)
    return [
        CurveSelection(name, part, COLORS[k], DASHES[k % len(DASHES)])
        for name, part, k in zip(names, parts, looks, strict=True)
    ]


def position_name(axis: "xarray.DataArray", at: int) -> str:
    """Return the name of a position on an axis.

    Parameters
    ----------
    axis : xarray.DataArray
        Values of the axis.
    at : int
        Position.

    Returns
    -------
    str
        Name, such as "low finger" or "free length 20 mm"; empty for an axis with a single position,
        except that of the finger.
    """
    value = axis.values[at]
    if axis.name == FINGER:
        return finger_name(str(value))
    if axis.size == 1:
        return ""
    if axis.dtype.kind not in "fiu":
        return str(value)
    unit = str(axis.attrs.get("units", ""))
    name = str(axis.attrs.get("long_name", axis.name))
    return f"{name} {value:g} {'' if unit == '1' else unit}".rstrip()


def finger_name(load: str | None) -> str:
    """Return the name of a finger in figures and reports.

    Parameters
    ----------
    load : str or None
        Name of the finger load.

    Returns
    -------
    str
        Name, such as "low finger" or "in air"; empty for None.
    """
    if load is None:
        return ""
    return "in air" if load == "none" else f"{load} finger"


def label(values: "xarray.DataArray") -> str:
    """Return the label of an axis, with its unit in brackets.

    Parameters
    ----------
    values : xarray.DataArray
        Values along the axis.

    Returns
    -------
    str
        Label, such as "free length [mm]".
    """
    name = str(values.attrs.get("long_name", values.name))
    if "band" in values.attrs:
        name = name.replace("the band", str(values.attrs["band"]))
    unit = str(values.attrs.get("units", ""))
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def banded(data: "xarray.Dataset", values: "xarray.DataArray") -> "xarray.DataArray":
    """Return a variable at the frequencies in the study's band.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    values : xarray.DataArray
        Variable over frequency.

    Returns
    -------
    xarray.DataArray
        Variable in the band; at all frequencies if the study has no band.
    """
    low, high = json.loads(data.attrs.get("conditions", "{}")).get("band") or (0.0, np.inf)
    f = values[FREQUENCY]
    return values.isel({FREQUENCY: np.flatnonzero((f >= low) & (f <= high))})


def over_frequency(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Return a response of a study.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    name : str
        Name of the variable.

    Returns
    -------
    xarray.DataArray
        Response over frequency.

    Raises
    ------
    InputError
        If there is no such variable, or it is not over frequency.
    """
    values = variable_of(data, name)
    if FREQUENCY not in values.dims:
        raise InputError(f"{name}: is not a response over frequency; keep one in the study")
    return values


def share_phrase(share: float, values: "xarray.DataArray") -> str:
    """Return in words which values of a criterion are good enough.

    Parameters
    ----------
    share : float
        Share of the best that is good enough.
    values : xarray.DataArray
        Values of the criterion.

    Returns
    -------
    str
        Description, such as "at least 85 % of the best".
    """
    if in_decibels(values):
        return f"within {20 * np.log10(1 / share):.3g} dB of the best"
    if sign_of(values) < 0:
        return f"at most {100 / share:.4g} % of the best"
    return f"at least {100 * share:.4g} % of the best"


def range_phrase(good: Range, unit: str) -> str:
    """Return a range in words, with its best value.

    Parameters
    ----------
    good : Range
        Range.
    unit : str
        Unit of the axis.

    Returns
    -------
    str
        Description, such as "18 … 27 mm (best 22)".
    """
    cut = ", cut by the axis" if good.is_cut else ""
    return f"{good.low:.3g} … {good.high:.3g} {unit} (best {good.best:.3g}{cut})"
