"""Figures of a study: responses, a map over length and frequency, a criterion, fronts, tolerances.

All functions take a labeled data set as `tactile.study.sweep.solve_study` makes it. Names and units
are read from its attributes (`tactile.study.plots.labels`).
"""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.show.plots.style import BLUE, GRAY, RED, name_ends, new_figure, plain
from tactile.study.findings import FREQUENCY, SCENARIO, in_decibels, range_of, sign_of
from tactile.study.plots.labels import (
    CurveSelection,
    axis_of,
    banded,
    label,
    lines_of,
    over_frequency,
    range_phrase,
    share_phrase,
    variable_of,
)
from tactile.study.ranges import SHARE, Range, overlap, within

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Ends = list[tuple[float, str, str]]
"""Values, names and colors at the right ends of lines."""

WIDTH = 1.8
"""Width of lines [points]."""
MAP_COLORS = "cividis"
"""Color map of even lightness that is also readable by the color-blind.

See Nuñez et al. 2018, PLoS ONE 13:e0199239.
"""
STEP = 3.0
"""Step between the contours of a map [dB]."""
DEEPEST = 30.0
"""Range of levels below the highest that a map distinguishes [dB]; antinodes are much deeper."""
BAND = (5.0, 50.0, 95.0)
"""Percentiles of the scenarios at the lower end, the line and the upper end of a band."""
WORST = 4.0
"""Ratio to the best at which a criterion of which less is better leaves the figure."""


# Responses


def response_phase_figure(data: "xarray.Dataset", variable: str) -> "Figure":
    """Draw magnitude above phase over frequency, with one line for each design.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study that keeps the response.
    variable : str
        Complex variable of ``data`` over ``frequency_hz``, such as ``displacement_um_per_v``.

    Returns
    -------
    matplotlib.figure.Figure
        Figure.

    Raises
    ------
    InputError
        If matplotlib is missing, there is no such variable, or it has more than six lines.
    """
    values = over_frequency(data, variable)
    frequency = values[FREQUENCY].values
    figure = new_figure(7.0, 5.6)
    size, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    ends: tuple[Ends, Ends] = ([], [])
    for line in lines_of(values, (FREQUENCY,)):
        turn = np.degrees(np.unwrap(np.angle(line.values.values)))
        sizes = np.abs(line.values.values)
        for axes, drawn, end in ((size, sizes, ends[0]), (phase, turn, ends[1])):
            axes.plot(frequency, drawn, **_line_style(line))
            end.append((float(drawn[-1]), line.name, line.color))
    size.set(yscale="log", ylabel=_vertical_label(values, 34))
    phase.set(ylabel="phase [°]")
    _scale_frequency(phase, frequency)
    _quarter_turns(phase)
    size.yaxis.set_major_formatter("{x:g}")
    for axes, end in zip((size, phase), ends, strict=True):
        plain(axes)
        _name_lines(axes, end)
    return figure


def _line_style(line: CurveSelection) -> dict[str, Any]:
    """Return the style of a line as keyword arguments of matplotlib."""
    return {"color": line.color, "linestyle": line.dashes, "linewidth": WIDTH}


def _vertical_label(values: "xarray.DataArray", width: int) -> str:
    """Return the label of a vertical axis, broken into lines of a given number of letters."""
    return textwrap.fill(label(values), width)


def _scale_frequency(axes: "Axes", frequency: Floats) -> None:
    """Use a logarithmic frequency axis if it spans more than three octaves and has no 0 Hz."""
    if frequency[0] > 0 and frequency[-1] / frequency[0] > 8:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlim=(float(frequency[0]), float(frequency[-1])), xlabel="frequency [Hz]")


def _quarter_turns(axes: "Axes") -> None:
    """Set limits and ticks of a phase axis at multiples of 90°."""
    from matplotlib.ticker import MultipleLocator

    low, high = axes.get_ylim()
    axes.set_ylim(90 * np.floor(low / 90 + 0.1) - 5, 90 * np.ceil(high / 90 - 0.1) + 5)
    axes.yaxis.set_major_locator(MultipleLocator(90))


def _name_lines(axes: "Axes", ends: Ends) -> None:
    """Write the names of lines next to their ends, if there is more than one."""
    if len(ends) > 1:
        name_ends(axes, ends)


# Map over an axis and frequency


def length_map_figure(
    data: "xarray.Dataset",
    variable: str = "displacement_um_per_v",
    *,
    axis: str | None = None,
    share: float = SHARE,
) -> "Figure":
    """Draw the level over an axis and frequency under each finger, and the good range below.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study that keeps the response.
    variable : str
        Variable of ``data`` over ``frequency_hz``.
    axis : str, optional
        Axis to draw along; by default the first that has numbers, such as ``length_mm``.
    share : float
        Share of the best that is good enough, of the smallest magnitude in the band.

    Returns
    -------
    matplotlib.figure.Figure
        Figure with one column for each finger.

    Raises
    ------
    InputError
        If matplotlib is missing, there is no such variable or axis, or there are too many lines.
    """
    values = over_frequency(data, variable)
    along = axis_of(values, axis)
    values = values.sortby(along)
    lines = lines_of(values, (along, FREQUENCY))
    figure = new_figure(1.6 + 3.4 * len(lines), 5.8)
    grid = figure.subplots(
        2, len(lines), sharex=True, sharey="row", height_ratios=(5, 3), squeeze=False
    )
    levels = _levels(np.abs(values.values))
    for line, (above, below) in zip(lines, grid.T, strict=True):
        good, smallest = _smallest(data, line, along, share)
        image = _map(above, line, along, levels)
        above.set_title(line.name, fontsize=11, color=line.color)
        below.plot(values[along].values, smallest, color=line.color, linewidth=WIDTH)
        _mark_range(above, below, good, line, share, str(values[along].attrs.get("units", "")))
        below.set(xlabel=label(values[along]))
        plain(below)
    unit = str(values.attrs.get("units", ""))
    figure.colorbar(
        image, ax=grid[0].tolist(), label=f"level [dB re 1 {unit}]", ticks=levels[::2],
        extend="min",
    )  # fmt: skip
    grid[0, 0].set_ylabel("frequency [Hz]")
    grid[1, 0].set(ylabel=f"smallest in\nthe band [{unit}]", ylim=(0, None))
    return figure


def _levels(size: Floats) -> Floats:
    """Return the contour levels of all maps [dB], ascending; the color scale spans them."""
    top = STEP * np.ceil(20 * np.log10(size.max()) / STEP)
    with np.errstate(divide="ignore"):
        bottom = STEP * np.floor(20 * np.log10(size.min()) / STEP)
    return np.arange(max(bottom, top - DEEPEST), top + STEP / 2, STEP)


def _smallest(
    data: "xarray.Dataset", line: CurveSelection, along: str, share: float
) -> tuple[Range, Floats]:
    """Return the good range of an axis, and the smallest magnitude in the band along it."""
    smallest = np.abs(banded(data, line.values).transpose(along, FREQUENCY).values).min(axis=1)
    return within(line.values[along].values, smallest, share=share), smallest


def _map(axes: "Axes", line: CurveSelection, along: str, levels: Floats) -> Any:
    """Draw levels over an axis and frequency, with contours."""
    size = np.abs(line.values.transpose(FREQUENCY, along).values)
    with np.errstate(divide="ignore"):
        level = np.maximum(20 * np.log10(size), levels[0] - STEP)
    x, f = line.values[along].values, line.values[FREQUENCY].values
    image = axes.pcolormesh(
        x, f, level, cmap=MAP_COLORS, vmin=levels[0], vmax=levels[-1], shading="gouraud",
        rasterized=True,
    )  # fmt: skip
    curves = axes.contour(x, f, level, levels[1:], colors="white", linewidths=0.6, linestyles="-")
    axes.clabel(curves, levels[2::2], fmt="%g", fontsize=7)
    _scale_frequency(axes, f)
    axes.set(xlim=(x[0], x[-1]), ylim=(f[0], f[-1]), xlabel="")
    return image


def _mark_range(
    above: "Axes", below: "Axes", good: Range, line: CurveSelection, share: float, unit: str
) -> None:
    """Mark the ends of a range in a map, and shade and describe it in the curve below."""
    for end in (good.low, good.high):
        above.axvline(end, color="black", linewidth=1.4)
        above.axvline(end, color="white", linewidth=1.2, linestyle=(0, (4, 3)))
    below.axvspan(good.low, good.high, color=line.color, alpha=0.18, linewidth=0)
    below.axhline(share * good.value, color=GRAY, linewidth=0.8, linestyle=(0, (1, 1.5)))
    text = f"{100 * share:g} % of the best:\n{good.low:.3g} … {good.high:.3g} {unit}"
    place: dict[str, Any] = {
        "transform": below.transAxes,
        "ha": "right",
        "va": "top",
        "fontsize": 8,
    }
    below.text(0.98, 0.96, text, color=line.color, **place)


# A criterion along an axis


def criterion_figure(
    data: "xarray.Dataset", variable: str, *, axis: str | None = None, share: float = SHARE
) -> "Figure":
    """Draw a criterion along an axis under each finger, with good ranges and their overlap.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    variable : str
        Criterion of ``data``, such as ``smallest_displacement_um_per_v``.
    axis : str, optional
        Axis to draw along; by default the first that has numbers.
    share : float
        Share of the best that is good enough.

    Returns
    -------
    matplotlib.figure.Figure
        Figure.

    Raises
    ------
    InputError
        If matplotlib is missing, there is no such variable or axis, or there are too many lines.
    """
    values = variable_of(data, variable)
    along = axis_of(values, axis)
    values = values.sortby(along)
    figure = new_figure(7.0, 4.8)
    axes = figure.subplots()
    x, unit, sign = values[along].values, str(values[along].attrs.get("units", "")), sign_of(values)
    ranges: list[Range] = []
    for line in lines_of(values, (along,)):
        text = line.name
        if sign:
            good = range_of(line.values, share)
            ranges.append(good)
            text = f"{line.name}  {range_phrase(good, unit)}".strip()
            _shade(axes, x, line, good)
        axes.plot(x, line.values.values, **_line_style(line), label=text)
    _overlap(axes, ranges, unit)
    axes.set(xlabel=label(values[along]), ylabel=_vertical_label(values, 44), xlim=(x[0], x[-1]))
    if sign:
        best = max(good.value for good in ranges)
        is_open = sign > 0 or in_decibels(values)
        axes.set_ylim(0, None if is_open else min(axes.get_ylim()[1], WORST * best))
    plain(axes)
    if axes.get_legend_handles_labels()[1]:
        title = share_phrase(share, values) if sign else None
        figure.legend(loc="outside upper left", frameon=False, fontsize=9, title=title,
                      alignment="left", title_fontsize=9)  # fmt: skip
    return figure


def _shade(axes: "Axes", x: Floats, line: CurveSelection, good: Range) -> None:
    """Shade the area below a line where it is good enough."""
    inside = np.concatenate([[good.low], x[(x > good.low) & (x < good.high)], [good.high]])
    height = np.interp(inside, x, line.values.values)
    axes.fill_between(inside, height, color=line.color, alpha=0.22, linewidth=0)


def _overlap(axes: "Axes", ranges: list[Range], unit: str) -> None:
    """Mark the overlap of all ranges."""
    shared = overlap(ranges) if len(ranges) > 1 else None
    if shared is None:
        return
    text = f"all of them  {shared[0]:.3g} … {shared[1]:.3g} {unit}"
    axes.axvspan(
        *shared, facecolor="none", edgecolor="#b0b0b0", hatch="///", linewidth=0, zorder=0,
        label=text,
    )  # fmt: skip


# Fronts


def pareto_figure(
    front: "xarray.Dataset",
    objectives: Sequence[str],
    *,
    recommended: int | None = None,
) -> "Figure":
    """Draw a Pareto front over two objectives, with a third as color.

    Parameters
    ----------
    front : xarray.Dataset
        Designs that no other dominates, along one dimension.
    objectives : sequence of str
        Two or three variables of ``front``, with the attributes ``units`` and ``long_name``.
    recommended : int, optional
        Position along the front of the recommended design, which is marked.

    Returns
    -------
    matplotlib.figure.Figure
        Figure.

    Raises
    ------
    InputError
        If matplotlib or a variable is missing, or the objectives are not two or three.
    """
    if len(objectives) not in (2, 3):
        raise InputError(f"{len(objectives)} objectives: a front is drawn over two or three")
    x, y, *third = (variable_of(front, name) for name in objectives)
    figure = new_figure(7.0, 4.8)
    axes = figure.subplots()
    if third:
        dots = axes.scatter(x, y, c=third[0].values, cmap=MAP_COLORS, s=42, linewidths=0.5,
                            edgecolors="#444444", label="front", zorder=3)  # fmt: skip
        figure.colorbar(dots, label=_vertical_label(third[0], 44) + _direction(third[0]))
    else:
        order = np.argsort(x.values)
        reached = "steps-pre" if sign_of(x) > 0 else "steps-post"
        axes.plot(x.values[order], y.values[order], "o-", color=BLUE, markersize=5, label="front",
                  drawstyle=reached, linewidth=1.0)  # fmt: skip
    if recommended is not None:
        _mark_recommended(axes, x, y, recommended)
    axes.set(xlabel=label(x) + _direction(x), ylabel=_vertical_label(y, 44) + _direction(y))
    plain(axes)
    axes.margins(0.06)
    figure.legend(loc="outside upper left", ncols=3, frameon=False, fontsize=9)
    return figure


def _direction(values: "xarray.DataArray") -> str:
    """Return the end of a label that tells which direction is better."""
    return {1: "\n(more is better →)", -1: "\n(← less is better)", 0: ""}[sign_of(values)]


def _mark_recommended(
    axes: "Axes", x: "xarray.DataArray", y: "xarray.DataArray", place: int
) -> None:
    """Mark the recommended design of a front."""
    at, up = float(x.values[place]), float(y.values[place])
    units = [str(v.attrs.get("units", "")) for v in (x, y)]
    text = f"recommended: {at:.3g} {units[0]}, {up:.3g} {units[1]}"
    axes.plot(at, up, "*", color=RED, markersize=17, markeredgecolor="white", label=text, zorder=4,
              linestyle="none")  # fmt: skip


# Tolerances


def tolerance_figure(data: "xarray.Dataset", variable: str, *, axis: str | None = None) -> "Figure":
    """Draw the median over scenarios and the band of 90 % of them, along an axis or frequency.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study with scenarios.
    variable : str
        Variable of ``data``. Of a response, the magnitude is drawn over frequency.
    axis : str, optional
        Axis to draw a criterion along; by default the first that has numbers.

    Returns
    -------
    matplotlib.figure.Figure
        Figure.

    Raises
    ------
    InputError
        If matplotlib is missing, there is no such variable or axis, there are too many lines, or
        the study has no scenarios.
    """
    values = variable_of(data, variable)
    if SCENARIO not in values.dims:
        raise InputError(f"{variable}: has no scenarios; give the study some")
    along = FREQUENCY if FREQUENCY in values.dims else axis_of(values, axis)
    values = values.sortby(along)
    figure = new_figure(7.0, 4.4)
    axes = figure.subplots()
    x = values[along].values
    ends: Ends = []
    for line in lines_of(values, (along, SCENARIO)):
        size = np.abs(line.values.transpose(SCENARIO, along).values)
        low, middle, high = np.percentile(size, BAND, axis=0)
        axes.fill_between(x, low, high, color=line.color, alpha=0.22, linewidth=0)
        axes.plot(x, middle, **_line_style(line))
        ends.append((float(middle[-1]), line.name, line.color))
    axes.set(xlabel=label(values[along]), ylabel=_vertical_label(values, 40), ylim=(0, None))
    if along == FREQUENCY:
        _scale_frequency(axes, x)
    else:
        axes.set_xlim(x[0], x[-1])
    count = values.sizes[SCENARIO]
    text = f"line: median, band: {BAND[0]:g} … {BAND[2]:g} % of {count} scenarios"
    axes.set_title(text, fontsize=9, loc="left", color=GRAY)
    plain(axes)
    _name_lines(axes, ends)
    return figure
