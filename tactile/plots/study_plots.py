"""Pictures of a study: responses, a map over length and frequency, a criterion, fronts, tolerances.

All take a labeled data set as `tactile.study.sweep.solve_study` makes it; names and units are read
from its attributes. Every combination of the axes that a picture does not lay along a side of its
own (``load`` above all) is drawn as a line, told apart by color and by dashes.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError
from tactile.files import nearest
from tactile.plots.style import COLORS, GRAY, check_file, name_ends, new_figure, plain, save
from tactile.study.criteria import CRITERIA
from tactile.study.ranges import Range, overlap, within

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

FREQUENCY = "frequency_hz"
SCENARIO = "scenario"
SHARE = 0.85
"""Of the best that is good enough, unless told otherwise: the paper's."""
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.2)))
WIDTH = 1.8
"""Points."""
MAP_COLORS = "cividis"
"""Even in lightness and the same to the color-blind (Nuñez et al. 2018, 10.1371/journal.pone.0199239)."""
BAND = (5.0, 50.0, 95.0)
"""Percent of scenarios below the lower end, the line and the upper end of a tolerance band."""


@dataclass(frozen=True)
class Line:
    """One combination of the axes that have no side of their own.

    Attributes
    ----------
    name : what sets it apart, as "low" or "free length 20 mm"
    values : what is drawn
    color, dashes : its look
    """

    name: str
    values: "xarray.DataArray"
    color: str
    dashes: Any


# Reading a data set


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
    numbers = [
        str(d)
        for d in values.dims
        if d not in (FREQUENCY, SCENARIO) and values.sizes[d] > 1 and values[d].dtype.kind in "fiu"
    ]
    if axis is None and numbers:
        return numbers[0]
    if axis is None or axis not in numbers:
        raise InputError(
            f"{values.name}: has no axis {axis or 'of two or more numbers'!s} to be drawn along; "
            f"there are: {', '.join(numbers) or 'none'}"
        )
    return axis


def lines_of(values: "xarray.DataArray", kept: Sequence[str]) -> list[Line]:
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
    found = []
    for k, places in enumerate(product(*(range(values.sizes[d]) for d in others))):
        part = values.isel(dict(zip(others, places, strict=True)))
        told = [told_of(values[d], at) for d, at in zip(others, places, strict=True)]
        name = ", ".join(words for words in told if words)
        found.append(Line(name, part, COLORS[k], DASHES[k % len(DASHES)]))
    return found


def told_of(axis: "xarray.DataArray", at: int) -> str:
    """Return what a place on an axis is called; nothing where the axis has no other."""
    value = axis.values[at]
    if axis.size == 1:
        return ""
    if axis.dtype.kind not in "fiu":
        return str(value)
    unit = str(axis.attrs.get("units", ""))
    return f"{axis.attrs.get('long_name', axis.name)} {value:g} {unit if unit != '1' else ''}"


def label(values: "xarray.DataArray") -> str:
    """Return what an axis is of, with its unit."""
    name = str(values.attrs.get("long_name", values.name))
    if "band" in values.attrs:
        name = name.replace("the band", str(values.attrs["band"]))
    unit = str(values.attrs.get("units", ""))
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def sign_of(values: "xarray.DataArray") -> int:
    """Return 1 where more is better, −1 where less is, 0 where neither is known to be."""
    criterion = CRITERIA.get(str(values.attrs.get("criterion", "")))
    return 0 if criterion is None else criterion.sign


def banded(data: "xarray.Dataset", values: "xarray.DataArray") -> "xarray.DataArray":
    """Return a variable at the frequencies in the study's band, all of them where it has none."""
    low, high = json.loads(data.attrs.get("conditions", "{}")).get("band") or (0.0, np.inf)
    f = values[FREQUENCY]
    return values.isel({FREQUENCY: np.flatnonzero((f >= low) & (f <= high))})


# Responses


def plot_response_phase(path: str | Path, data: "xarray.Dataset", variable: str) -> None:
    """Draw size and phase of responses over frequency, and save them.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    data : of a study that keeps the response
    variable : of ``data``, complex over ``frequency_hz``, as ``displacement_um_per_v``

    Raises
    ------
    InputError
        Where matplotlib is missing, the file cannot be written, there is no such variable, or it
        has more than six lines.
    """
    check_file(path)
    save(response_phase_figure(data, variable), path)


def response_phase_figure(data: "xarray.Dataset", variable: str) -> "Figure":
    """Return size above phase, one line for each design; see `plot_response_phase`."""
    values = _over_frequency(data, variable)
    figure = new_figure(7.0, 5.6)
    size, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    ends: list[list[tuple[float, str, str]]] = [[], []]
    for line in lines_of(values, (FREQUENCY,)):
        y = line.values.values
        turn = np.degrees(np.unwrap(np.angle(y)))
        look = {"color": line.color, "linestyle": line.dashes, "linewidth": WIDTH}
        for axes, drawn, end in ((size, np.abs(y), ends[0]), (phase, turn, ends[1])):
            axes.plot(values[FREQUENCY].values, drawn, **look)
            end.append((float(drawn[-1]), line.name, line.color))
    size.set(yscale="log", ylabel=label(values))
    phase.set(ylabel="phase [°]", xlabel="frequency [Hz]")
    _frequency_axis(phase, values[FREQUENCY].values)
    _finish_response(size, phase, ends)
    return figure


def _over_frequency(data: "xarray.Dataset", variable: str) -> "xarray.DataArray":
    values = variable_of(data, variable)
    if FREQUENCY not in values.dims:
        raise InputError(f"{variable}: is no response over frequency; keep one in the study")
    return values


def _frequency_axis(axes: "Axes", frequency: Floats) -> None:
    """Scale a frequency axis by its octaves where it has more than three and no 0 Hz."""
    axes.set_xlim(float(frequency[0]), float(frequency[-1]))
    if frequency[0] > 0 and frequency[-1] / frequency[0] > 8:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")


def _finish_response(size: "Axes", phase: "Axes", ends: list[list[tuple[float, str, str]]]) -> None:
    from matplotlib.ticker import MultipleLocator

    phase.yaxis.set_major_locator(MultipleLocator(90))
    size.yaxis.set_major_formatter("{x:g}")
    for axes, end in zip((size, phase), ends, strict=True):
        plain(axes)
        if len(end) > 1:
            name_ends(axes, end)


# Map over an axis and frequency


def plot_length_map(
    path: str | Path,
    data: "xarray.Dataset",
    variable: str = "displacement_um_per_v",
    *,
    axis: str | None = None,
    share: float = SHARE,
    in_db: bool = True,
) -> None:
    """Draw the level over an axis and frequency under each finger, and what is good enough.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    data : of a study that keeps the response
    variable : of ``data``, over ``frequency_hz``
    axis : along which it is drawn; the first of numbers where it is None, as ``length_mm``
    share : of the best smallest size in the band that is good enough
    in_db : the level in dB re one unit, else the size in the unit

    Raises
    ------
    InputError
        As `plot_response_phase`, and where there is no such axis.
    """
    check_file(path)
    save(length_map_figure(data, variable, axis=axis, share=share, in_db=in_db), path)


def length_map_figure(
    data: "xarray.Dataset",
    variable: str = "displacement_um_per_v",
    *,
    axis: str | None = None,
    share: float = SHARE,
    in_db: bool = True,
) -> "Figure":
    """Return a map for each finger above its smallest size; see `plot_length_map`."""
    values = _over_frequency(data, variable)
    along = axis_of(values, axis)
    lines = lines_of(values, (along, FREQUENCY))
    figure = new_figure(1.2 + 3.6 * len(lines), 5.8)
    grid = figure.subplots(
        2, len(lines), sharex=True, sharey="row", height_ratios=(5, 3), squeeze=False
    )
    size = np.abs(values.values)
    shown = 20 * np.log10(size) if in_db else size
    ends = float(np.floor(shown.min())), float(np.ceil(shown.max()))
    for column, line in enumerate(lines):
        top, below = grid[0, column], grid[1, column]
        drawn = np.abs(line.values.transpose(FREQUENCY, along).values)
        level = 20 * np.log10(drawn) if in_db else drawn
        x, f = values[along].values, values[FREQUENCY].values
        image = top.pcolormesh(
            x, f, level, cmap=MAP_COLORS, vmin=ends[0], vmax=ends[1], rasterized=True,
            shading="gouraud",
        )  # fmt: skip
        top.set_title(line.name)
        smallest = np.abs(banded(data, line.values)).min(FREQUENCY).values
        below.plot(x, smallest, color=line.color, linewidth=WIDTH)
        good = within(x, smallest, share=share)
        below.axvspan(good.low, good.high, color=line.color, alpha=0.2, linewidth=0)
        below.set(xlabel=label(values[along]))
    unit = str(values.attrs.get("units", ""))
    figure.colorbar(image, ax=grid[0].tolist(), label=f"dB re 1 {unit}" if in_db else label(values))
    grid[0, 0].set_ylabel("frequency [Hz]")
    grid[1, 0].set_ylabel(f"smallest [{unit}]")
    return figure


# A criterion along an axis


def plot_criterion(
    path: str | Path,
    data: "xarray.Dataset",
    variable: str,
    *,
    axis: str | None = None,
    share: float = SHARE,
) -> None:
    """Draw a criterion along an axis under each finger, what is good enough, and what all share.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    data : of a study
    variable : of ``data``, a criterion, as ``smallest_displacement_um_per_v``
    axis : along which it is drawn; the first of numbers where it is None
    share : of the best that is good enough

    Raises
    ------
    InputError
        As `plot_length_map`.
    """
    check_file(path)
    save(criterion_figure(data, variable, axis=axis, share=share), path)


def criterion_figure(
    data: "xarray.Dataset", variable: str, *, axis: str | None = None, share: float = SHARE
) -> "Figure":
    """Return a line for each finger, its range shaded; see `plot_criterion`."""
    values = variable_of(data, variable)
    along = axis_of(values, axis)
    figure = new_figure(7.0, 4.2)
    axes = figure.subplots()
    x = values[along].values
    ranges: list[Range] = []
    ends = []
    for line in lines_of(values, (along,)):
        y = line.values.values
        axes.plot(x, y, color=line.color, linestyle=line.dashes, linewidth=WIDTH)
        ends.append((float(y[-1]), line.name, line.color))
        if sign := sign_of(values):
            good = within(x, y, share=share, sign=sign)
            ranges.append(good)
            axes.axvspan(good.low, good.high, color=line.color, alpha=0.15, linewidth=0)
    shared = overlap(ranges) if len(ranges) > 1 else None
    if shared is not None:
        axes.axvspan(*shared, facecolor="none", edgecolor=GRAY, hatch="//", linewidth=0)
    axes.set(xlabel=label(values[along]), ylabel=label(values))
    plain(axes)
    name_ends(axes, ends)
    return figure


# Fronts


def plot_pareto(
    path: str | Path,
    front: "xarray.Dataset",
    objectives: Sequence[str],
    *,
    cloud: "xarray.Dataset | None" = None,
    knee: int | None = None,
) -> None:
    """Draw a Pareto front over two objectives, a third as color, and save it.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    front : designs that none beats, along one dimension
    objectives : two or three variables of ``front``, with ``units`` and ``long_name``
    cloud : other feasible designs, with the same variables
    knee : place along the front of the design to mark

    Raises
    ------
    InputError
        Where matplotlib is missing, the file cannot be written, a variable is missing, or the
        objectives are not two or three.
    """
    check_file(path)
    save(pareto_figure(front, objectives, cloud=cloud, knee=knee), path)


def pareto_figure(
    front: "xarray.Dataset",
    objectives: Sequence[str],
    *,
    cloud: "xarray.Dataset | None" = None,
    knee: int | None = None,
) -> "Figure":
    """Return a front over two objectives; see `plot_pareto`."""
    if len(objectives) not in (2, 3):
        raise InputError(f"{len(objectives)} objectives: a front is drawn over two or three")
    x, y, *third = (variable_of(front, name) for name in objectives)
    figure = new_figure(7.0, 4.6)
    axes = figure.subplots()
    if cloud is not None:
        axes.plot(
            np.ravel(variable_of(cloud, objectives[0])), np.ravel(variable_of(cloud, objectives[1])),
            ".", color="#c8c8c8", markersize=3,
        )  # fmt: skip
    if third:
        dots = axes.scatter(x, y, c=third[0].values, cmap=MAP_COLORS, s=36, edgecolors="black")
        figure.colorbar(dots, label=label(third[0]))
    else:
        order = np.argsort(x.values)
        axes.plot(x.values[order], y.values[order], "o-", color=COLORS[0])
    if knee is not None:
        axes.plot(x.values[knee], y.values[knee], "*", color=COLORS[1], markersize=16)
    axes.set(xlabel=label(x), ylabel=label(y))
    plain(axes)
    return figure


# Tolerances


def plot_tolerance(
    path: str | Path, data: "xarray.Dataset", variable: str, *, axis: str | None = None
) -> None:
    """Draw the median over scenarios and where 90 % of them are, along an axis or frequency.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    data : of a study with scenarios
    variable : of ``data``; of a response the size is drawn over frequency
    axis : along which a criterion is drawn; the first of numbers where it is None

    Raises
    ------
    InputError
        As `plot_length_map`, and where the study has no scenarios.
    """
    check_file(path)
    save(tolerance_figure(data, variable, axis=axis), path)


def tolerance_figure(data: "xarray.Dataset", variable: str, *, axis: str | None = None) -> "Figure":
    """Return median and band over scenarios; see `plot_tolerance`."""
    values = variable_of(data, variable)
    if SCENARIO not in values.dims:
        raise InputError(f"{variable}: has no scenarios; give the study some")
    along = FREQUENCY if FREQUENCY in values.dims else axis_of(values, axis)
    figure = new_figure(7.0, 4.2)
    axes = figure.subplots()
    x, ends = values[along].values, []
    for line in lines_of(values, (along, SCENARIO)):
        size = np.abs(line.values.transpose(SCENARIO, along).values)
        low, middle, high = np.percentile(size, BAND, axis=0)
        axes.fill_between(x, low, high, color=line.color, alpha=0.25, linewidth=0)
        axes.plot(x, middle, color=line.color, linestyle=line.dashes, linewidth=WIDTH)
        ends.append((float(middle[-1]), line.name, line.color))
    axes.set(xlabel=label(values[along]), ylabel=label(values))
    plain(axes)
    name_ends(axes, ends)
    return figure
