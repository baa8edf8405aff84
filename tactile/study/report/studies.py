"""Sections of a report on a study, and on a Pareto front of designs.

They give the axes, the best designs, ranges and where fingers agree, maps, tolerances, and the
provenance of the data. Everything is read from the data set and its attributes.
"""

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.actuator.materials import VACUUM_PERMITTIVITY
from tactile.errors import InputError
from tactile.show.plots import drawn
from tactile.study.findings import (
    FINGER,
    FREQUENCY,
    SCENARIO,
    WORST,
    agreed,
    best_designs,
    number_axes,
    range_of,
    reached,
    sign_of,
)
from tactile.study.plots import (
    criterion_figure,
    length_map_figure,
    pareto_figure,
    response_phase_figure,
    tolerance_figure,
)
from tactile.study.plots.labels import (
    finger_name,
    label,
    lines_of,
    position_name,
    range_phrase,
    share_phrase,
)
from tactile.study.ranges import SHARE, overlap
from tactile.study.report.page import Picture, Section, Table

if TYPE_CHECKING:
    import xarray

MOST_DESIGNS = 40
"""Largest number of designs of a front in a table; more are sampled evenly."""
DESIGN_ATTRIBUTES = ("base", "fixed", "fingers", "conditions", "bounds", "limits")
"""Attributes that hold values as JSON."""
UNITS = {
    **dict.fromkeys(
        ("width", "length", "clamped_length", "piezo_height", "shim_height"), ("mm", 1e-3)
    ),
    **dict.fromkeys(("s11E", "s55E", "s11", "s55"), ("µm²/N", 1e-12)),
    "d31": ("pm/V", 1e-12), "eps33T": ("ε0", VACUUM_PERMITTIVITY), "density": ("kg/m³", 1.0),
    "k0": ("N/m", 1.0), "d0": ("N s/m", 1.0), "branches": ("[N/m, N s/m] each", 1.0),
    "band": ("Hz", 1.0), "voltage": ("V", 1.0), "field": ("V/mm", 1e3), "current": ("mA", 1e-3),
    "amplitude": ("µm", 1e-6),
}  # fmt: skip
"""Unit in which a report gives a constant, and its size in SI; all other values are numbers or have
their unit in their name."""


def study_report(data: "xarray.Dataset", *, share: float = SHARE) -> list[Section]:
    """Return the sections of a report on a study.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of `solve_study` or `load_study`.
    share : float
        Share of the best that is good enough.

    Returns
    -------
    list of Section
        Sections in order.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    judged = [str(name) for name, values in data.data_vars.items() if "criterion" in values.attrs]
    curves = [str(name) for name, values in data.data_vars.items() if FREQUENCY in values.dims]
    sections = [Section("What was asked", (_axes_table(data),))]
    ranked = [name for name in judged if sign_of(data[name])]
    if ranked:
        sections.append(
            Section("The best", tuple(filter(None, (_best(data, ranked), _agreed_sentence(data)))))
        )
    sections += [_criterion(data, name, share) for name in judged]
    sections += [_response(data, name, share) for name in curves]
    if SCENARIO in data.dims:
        sections += [_tolerance(data, name) for name in (*judged, *curves)]
    return [s for s in sections if s.content] + provenance_sections(data)


def front_report(front: "xarray.Dataset", *, recommended: int | None = None) -> list[Section]:
    """Return the sections of a report on a front.

    Parameters
    ----------
    front : xarray.Dataset
        Designs along ``design``. Its attribute ``objectives`` names one to three of its variables,
        separated by spaces.
    recommended : int, optional
        Position along the front of the recommended design, which is marked.

    Returns
    -------
    list of Section
        Sections in order.

    Raises
    ------
    InputError
        If matplotlib or the objectives are missing.
    """
    objectives = str(front.attrs.get("objectives", "")).split()
    if not objectives:
        raise InputError("this data set names no objectives: it is no front of designs")
    content: list[str | Picture | Table] = []
    if len(objectives) > 1:
        figure = pareto_figure(front, objectives, recommended=recommended)
        labels = ", ".join(label(front[name]) for name in objectives)
        words = "Designs that no other found beats in every objective"
        content.append(Picture(drawn(figure), f"{words}: {labels}", f"{words}: {labels}."))
    content.append(_designs(front, recommended))
    return [Section("The front", tuple(content)), *provenance_sections(front)]


# Axes, and the best designs


def _axes_table(data: "xarray.Dataset") -> Table:
    """Return a table of the axes of a study."""
    rows = []
    for name in data.dims:
        axis = data[name]
        if name == SCENARIO:
            rows.append(("scenarios", f"{axis.size}", "fingers and tolerances, drawn at random"))
        elif axis.dtype.kind in "fiu":
            rows.append((label(axis), f"{axis.size}", f"{axis.min():.4g} … {axis.max():.4g}"))
        else:
            rows.append((label(axis), f"{axis.size}", ", ".join(map(str, axis.values))))
    designs = int(np.prod([n for d, n in data.sizes.items() if d not in (FREQUENCY, SCENARIO)]))
    return Table(("axis", "values", "which"), tuple(rows), f"{designs} designs in all.")


def _best(data: "xarray.Dataset", names: list[str]) -> Table:
    """Return a table of the best of each criterion under each finger, and of its design."""
    rows = []
    for name in names:
        for best in best_designs(reached(data[name])):
            if best["finger"] == "all":
                continue
            design = ", ".join(f"{d} = {_cell(x)}" for d, x in best["at"].items() if d != FINGER)
            words = label(data[name]).split(" [")[0], finger_name(best["finger"])
            rows.append((*words, f"{best['value']:.4g} {best['unit']}", design))
    robust = (
        f"With scenarios: what {1 - WORST:.0%} of them attain." if SCENARIO in data.dims else ""
    )
    return Table(("criterion", "finger", "best", "design"), tuple(rows), robust)


def _agreed_sentence(data: "xarray.Dataset") -> str:
    """Return a sentence on the design that suits all fingers best."""
    place = chosen_design(data)
    design = ", ".join(position_name(data[d], k) for d, k in place.items())
    return f"By the first criterion this suits the fingers best: {design}." if design else ""


def _profiles(values: "xarray.DataArray") -> Mapping[str, "xarray.DataArray"]:
    """Return a criterion along each axis of numbers, at its best over all others but the finger."""
    profiles = {}
    for axis in number_axes(values):
        others = [d for d in values.dims if d not in (FINGER, axis)]
        best = values.min if sign_of(values) < 0 else values.max
        profiles[axis] = best(others, keep_attrs=True).rename(values.name)
    return profiles


def chosen_design(data: "xarray.Dataset") -> dict[str, int]:
    """Return the design that suits all fingers best by the first criterion that has a better side.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.

    Returns
    -------
    dict of str to int
        Position on each axis of numbers; the middle if there is no such criterion.
    """
    for values in data.data_vars.values():
        if sign := sign_of(values):
            axes = number_axes(values)
            attained = reached(values)
            size = (agreed(attained) if FINGER in attained.dims else attained * sign).transpose(
                *axes, ...
            )
            worst = size.min([d for d in size.dims if d not in axes])
            if axes and bool(np.isfinite(worst).any()):
                return {str(d): int(k) for d, k in worst.argmax(axes).items()}
    return {axis: data.sizes[axis] // 2 for axis in number_axes(data)}


# Pictures


def _picture_or_reason(draw: Callable[[], Any], alternative: str, caption: str) -> Picture | str:
    """Return an image, or the reason why there is none."""
    try:
        return Picture(drawn(draw()), alternative, caption)
    except InputError as error:
        return f"Not drawn: {error}"


def _criterion(data: "xarray.Dataset", name: str, share: float) -> Section:
    """Return a section on a criterion along each axis, with the good range under each finger."""
    values = reached(data[name])
    content: list[str | Picture | Table] = []
    for axis, profile in _profiles(values).items():
        others = len([d for d in values.dims if d not in (FINGER, axis) and values.sizes[d] > 1])
        words = f"{label(values)} along {label(values[axis])}"
        extreme = "best" if sign_of(values) else "largest"
        caption = f"{words}, the {extreme} over all other axes." if others else f"{words}."
        part = profile.to_dataset(name=name)
        draw = partial(criterion_figure, part, name, axis=axis, share=share)
        content.append(_picture_or_reason(draw, words, caption))
        if sign_of(values):
            content.append(_ranges(profile, axis, share, is_all=not others))
    return Section(_sentence(label(values).split(" [")[0]), tuple(content))


def _ranges(profile: "xarray.DataArray", axis: str, share: float, *, is_all: bool) -> Table:
    """Return a table of the good range under each finger, and of their overlap.

    The overlap is only given where there is no other axis, along which each finger might have a
    best value of its own.
    """
    profile = profile.sortby(axis)
    unit = str(profile[axis].attrs.get("units", ""))
    lines = lines_of(profile, (axis,))
    ranges = [range_of(line.values, share) for line in lines]
    rows = [
        (line.name or "all", range_phrase(r, unit)) for line, r in zip(lines, ranges, strict=True)
    ]
    if len(ranges) > 1 and is_all:
        shared = overlap(ranges)
        text = "nothing" if shared is None else f"{shared[0]:.3g} … {shared[1]:.3g} {unit}"
        rows.append(("shared by all", text))
    text = profile[axis].attrs.get("long_name", axis)
    heads = ("finger", f"{text}, {share_phrase(share, profile)}")
    return Table(heads, tuple(rows))


def _response(data: "xarray.Dataset", name: str, share: float) -> Section:
    """Return a section with maps of a response over each axis of numbers, or its curves."""
    values = data[name]
    title = _sentence(label(values).split(" [")[0])
    if SCENARIO in values.dims:
        return Section(title, ())
    content = []
    for axis in number_axes(values):
        part, at = _slice(data, name, axis)
        words = f"{label(values)} over {label(values[axis])} and frequency{at}"
        caption = f"Level of the {words}; below, the smallest in the band and what is good enough."
        draw = partial(length_map_figure, part, name, axis=axis, share=share)
        content.append(_picture_or_reason(draw, words, caption))
    if not content:
        words = f"Size and phase of the {label(values)}"
        draw = partial(response_phase_figure, data, name)
        content = [_picture_or_reason(draw, words, f"{words}.")]
    return Section(title, tuple(content))


def _slice(data: "xarray.Dataset", name: str, axis: str = "") -> tuple["xarray.Dataset", str]:
    """Return a variable along one axis, at the chosen design, with a note on that design."""
    values = data[name]
    place = {d: k for d, k in chosen_design(data).items() if d in values.dims and d != axis}
    place = {d: k for d, k in place.items() if values.sizes[d] > 1}
    position = ", ".join(position_name(values[d], k) for d, k in place.items())
    return data[[name]].isel(place), f", at {position}" if position else ""


def _tolerance(data: "xarray.Dataset", name: str) -> Section:
    """Return a section on the spread over scenarios, along each axis or for one design."""
    values = data[name]
    if SCENARIO not in values.dims:
        return Section("", ())
    content = []
    for axis in [""] if FREQUENCY in values.dims else number_axes(values):
        part, at = _slice(data, name, axis)
        words = f"Median and 5 to 95 % of the scenarios: {label(values)}{at}"
        draw = partial(tolerance_figure, part, name, axis=axis or None)
        content.append(_picture_or_reason(draw, words, f"{words}."))
    return Section(f"Tolerance of the {label(values).split(' [')[0]}", tuple(content))


def _sentence(words: str) -> str:
    """Return words with a capital letter at the beginning."""
    return words[:1].upper() + words[1:]


# Fronts and provenance


def _designs(front: "xarray.Dataset", recommended: int | None) -> Table:
    """Return a table of the designs of a front."""
    columns = [
        name for name in (*front.coords, *front.data_vars) if front[name].dims == ("design",)
    ]
    size = front.sizes["design"]
    chosen = np.unique(np.linspace(0, size - 1, min(size, MOST_DESIGNS)).round().astype(int))
    if recommended is not None:
        chosen = np.union1d(chosen, [recommended])
    rows = tuple(
        (
            f"{k + 1}" + (" (recommended)" if k == recommended else ""),
            *(_cell(front[c].values[k]) for c in columns),
        )
        for k in chosen
    )
    caption = "" if len(chosen) == size else f"{len(chosen)} of {size} designs."
    return Table(("design", *(label(front[c]) for c in columns)), rows, caption)


def _cell(value: Any) -> str:
    """Return the text of a cell."""
    return f"{value:.4g}" if isinstance(value, float | int | np.number) else str(value)


def provenance_sections(data: "xarray.Dataset") -> list[Section]:
    """Return sections on the provenance of a data set and the values of what was not varied.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study or a front.

    Returns
    -------
    list of Section
        Sections in order.
    """
    plain = [(k, str(v)) for k, v in data.attrs.items() if k not in DESIGN_ATTRIBUTES]
    rows = tuple(
        (f"{name}: {path}" if path else name, *value)
        for name in DESIGN_ATTRIBUTES
        if name in data.attrs
        for path, *value in _leaves(json.loads(data.attrs[name]))
    )
    table = Table(("parameter", "value", "unit"), rows)
    sections = [Section("Parameters", (table,))] if rows else []
    return [
        *sections,
        Section("Provenance", (Table(("attribute", "value"), tuple(map(_row, plain))),)),
    ]


def _row(pair: tuple[Any, str]) -> tuple[str, ...]:
    """Return an attribute as a row of a table."""
    return str(pair[0]).replace("_", " "), pair[1]


def _leaves(value: Any, path: str = "") -> list[tuple[str, str, str]]:
    """Return the numbers and words within JSON, each with its path and its unit."""
    if isinstance(value, dict):
        return [
            leaf for key, part in value.items() for leaf in _leaves(part, f"{path} {key}".strip())
        ]
    unit, size = UNITS.get(path.rpartition(" ")[2], ("", 1.0))
    if isinstance(value, float | int) and not isinstance(value, bool):
        return [(path, f"{value / size:.6g}", unit)]
    if isinstance(value, list) and size != 1.0:
        value = [part / size for part in value]
    return [(path, json.dumps(value, ensure_ascii=False).strip('"'), unit)]
