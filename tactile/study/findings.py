"""Summary of a study in a few figures: the best designs, good ranges, and what fingers share.

Everything is computed from the data set, so that a stored study gives the same summary again. Where
scenarios were drawn, a design counts by what all but the worst 5 % of them reach. This is Weibull's
quantile, which is right on average even for few draws.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.errors import InputError
from tactile.study.criteria import CRITERIA
from tactile.study.ranges import SHARE, Range, check_share, overlap, shares, within
from tactile.study.sweep import LARGEST

if TYPE_CHECKING:
    import xarray

WORST = 0.05
"""Share of scenarios that a design may fail."""
MOST_RANGES = 24
"""Number of ranges above which only those at the best values of the other axes are given."""
FINGER, SCENARIO, FREQUENCY = "load", "scenario", "frequency_hz"
"""Names of the axes that have a meaning of their own."""

Figures = dict[str, Any]
"""Summary as plain data, by name."""


def summarize(data: "xarray.Dataset", *, share: float = SHARE) -> Figures:
    """Summarize a study as plain data.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of `solve_study` or `load_study`.
    share : float
        Share of the best value that is good enough, above 0 and below 1.

    Returns
    -------
    dict
        ``designs`` and ``scenarios`` (their numbers), ``axes`` (values of each), ``share``,
        ``best`` (criterion, unit, value, at, and the finger that it holds for), ``ranges``
        (criterion, unit, along, at, low, high, best, value, is_cut), ``overlaps`` (criterion,
        along, at, low, high; None where there is none), ``spans`` (criterion, unit, low, high) of
        criteria that are neither good nor bad, and ``figures``, all criteria at the first best
        design.

    Raises
    ------
    InputError
        If the data set is too large to be summarized in memory, or the share is out of range.
    """
    check_share(share)
    judged = {str(n): v for n, v in data.data_vars.items() if v.attrs.get("criterion") in CRITERIA}
    if sum(v.size for v in judged.values()) * 8 > LARGEST:
        raise InputError("the study is too large to be summed up in memory; open it with xarray")
    summary: Figures = {
        "designs": int(np.prod([data.sizes[name] for name in _axes(data)], dtype=float)),
        "scenarios": data.sizes.get(SCENARIO, 0),
        "axes": {name: data[name].values.tolist() for name in _axes(data)},
        "share": share,
        "best": [],
        "ranges": [],
        "overlaps": [],
        "spans": [],
        "figures": {},
    }
    attained = {name: reached(v) for name, v in judged.items()}
    for values in attained.values():
        summary["best"] += best_designs(values)
        ranges = list(_ranges(values, share))
        summary["ranges"] += [_range_entry(values, at, one) for at, one in ranges]
        summary["overlaps"] += _overlaps(values, ranges)
        summary["spans"] += _span(values)
    if summary["best"]:
        first = summary["best"][0]["at"]
        summary["figures"] = {
            name: {
                "value": float(v.sel(first)),
                "unit": v.attrs["units"],
                "means": v.attrs["long_name"],
            }
            for name, v in attained.items()
        }
    return summary


def _span(values: "xarray.DataArray") -> list[Figures]:
    """Return the lowest and highest value of a criterion that is neither good nor bad."""
    if sign_of(values) or not bool(values.notnull().any()):
        return []
    labels = {"criterion": values.attrs["criterion"], "unit": values.attrs["units"]}
    return [labels | {"low": float(values.min()), "high": float(values.max())}]


def _axes(data: "xarray.Dataset | xarray.DataArray") -> list[str]:
    """Return the axes other than frequency and scenarios."""
    return [str(d) for d in data.dims if d not in (SCENARIO, FREQUENCY)]


def number_axes(values: "xarray.DataArray | xarray.Dataset") -> list[str]:
    """Return the axes of two or more numbers, other than frequency and scenarios.

    Parameters
    ----------
    values : xarray.DataArray or xarray.Dataset
        Values with axes.

    Returns
    -------
    list of str
        Names of the axes.
    """
    return [d for d in _axes(values) if values.sizes[d] > 1 and values[d].dtype.kind in "fiu"]


def sign_of(values: "xarray.DataArray") -> int:
    """Return whether more or less of a variable is better.

    Parameters
    ----------
    values : xarray.DataArray
        Variable of a study.

    Returns
    -------
    int
        1 if more is better, −1 if less is, 0 if neither is or it is no criterion.
    """
    criterion = CRITERIA.get(str(values.attrs.get("criterion", "")))
    return 0 if criterion is None else criterion.sign


def range_of(values: "xarray.DataArray", share: float) -> Range:
    """Return the range of an axis in which a criterion is within a share of its best; see `within`.

    Parameters
    ----------
    values : xarray.DataArray
        Values of a criterion along a single axis.
    share : float
        Share of the best value that is good enough.

    Returns
    -------
    Range
        Range around the best.
    """
    (axis,) = values.dims
    return within(
        values[axis].values,
        values.values,
        share=share,
        sign=sign_of(values),
        in_db=in_decibels(values),
    )


def reached(values: "xarray.DataArray") -> "xarray.DataArray":
    """Return what all but the worst scenarios reach.

    Parameters
    ----------
    values : xarray.DataArray
        Values of a criterion.

    Returns
    -------
    xarray.DataArray
        Quantile over the scenarios; the median of a criterion that is neither good nor bad. Without
        scenarios, the values as they are.
    """
    values = values.load()
    if SCENARIO not in values.dims:
        return values
    share = {1: WORST, -1: 1 - WORST, 0: 0.5}[sign_of(values)]
    quantile = values.quantile(share, SCENARIO, method="weibull", keep_attrs=True, skipna=False)
    return quantile.drop_vars("quantile")


def best_designs(values: "xarray.DataArray") -> list[Figures]:
    """Return the best design for each finger, and the one that suits all fingers best.

    Parameters
    ----------
    values : xarray.DataArray
        Values of a criterion.

    Returns
    -------
    list of dict
        ``criterion``, ``unit``, ``value``, ``finger`` (a name, "all", or None where there is no
        axis of fingers) and ``at`` (value on each axis). None for a criterion that is neither good
        nor bad, and for a finger under which no value is finite.
    """
    sign = sign_of(values)
    if not sign or not bool(np.isfinite(values).any()):
        return []
    cases: list[tuple[str | None, xarray.DataArray]] = [(None, values)]
    if FINGER in values.dims:
        cases = [(str(name), values.sel({FINGER: name})) for name in values[FINGER].values]
        if len(cases) > 1:
            cases.append(("all", agreed(values)))
    return [
        _best_of(case, finger, 1 if finger == "all" else sign)
        for finger, case in cases
        if bool(np.isfinite(case).any())
    ]


def agreed(values: "xarray.DataArray") -> "xarray.DataArray":
    """Return the share of its own best that each design leaves the finger that it suits least.

    The criterion's own smallest value over the fingers would be that of the stiffest finger alone,
    since fingers are far apart.

    Parameters
    ----------
    values : xarray.DataArray
        Values of a criterion with an axis of fingers.

    Returns
    -------
    xarray.DataArray
        Smallest share over the fingers [%].
    """
    size = values.copy(data=shares(values.values, sign=sign_of(values), in_db=in_decibels(values)))
    rest = [d for d in size.dims if d != FINGER]
    worst = (size / size.max(rest)).min(FINGER, skipna=False) * 100
    return worst.assign_attrs({**values.attrs, "units": "% of each finger's own best"})


def in_decibels(values: "xarray.DataArray") -> bool:
    """Tell whether a criterion is a level, of which differences and not ratios matter.

    Parameters
    ----------
    values : xarray.DataArray
        Values of a criterion.

    Returns
    -------
    bool
        Whether the unit is dB.
    """
    return bool(values.attrs.get("units") == "dB")


def _best_of(values: "xarray.DataArray", finger: str | None, sign: int) -> Figures:
    """Return the best design among the values for one finger."""
    place = np.unravel_index(np.nanargmax(values.values * sign), values.shape)
    at = {str(d): values[d].values[i].item() for d, i in zip(values.dims, place, strict=True)}
    if finger not in (None, "all"):
        at[FINGER] = finger
    return {
        "criterion": values.attrs["criterion"],
        "unit": values.attrs["units"],
        "value": float(values.values[place]),
        "finger": finger,
        "at": at,
    }


def _range_axis(values: "xarray.DataArray") -> str | None:
    """Return the first axis of two or more ascending numbers, or None."""
    ascending = (d for d in number_axes(values) if np.all(np.diff(values[d].values) > 0))
    return next(ascending, None)


def _ranges(values: "xarray.DataArray", share: float) -> Iterator[tuple[Figures, Range]]:
    """Yield the range along the first axis of numbers at each combination of the other axes."""
    along = _range_axis(values)
    if along is None or not sign_of(values):
        return
    others = [name for name in _axes(values) if name != along]
    places: Sequence[Figures] = [
        dict(zip(others, chosen, strict=True))
        for chosen in itertools.product(*(values[name].values.tolist() for name in others))
    ]
    if len(places) > MOST_RANGES:
        places = [
            {k: v for k, v in b["at"].items() if k != along}
            for b in best_designs(values) if b["finger"] != "all"
        ]  # fmt: skip
    for at in places:
        line = values.sel(at)
        if bool(np.isfinite(line).any()):
            yield at, range_of(line, share)


def _range_entry(values: "xarray.DataArray", at: Figures, one: Range) -> Figures:
    """Return a range as plain data."""
    return {
        "criterion": values.attrs["criterion"],
        "unit": values.attrs["units"],
        "along": _range_axis(values),
        "at": at,
        "low": one.low,
        "high": one.high,
        "best": one.best,
        "value": one.value,
        "is_cut": one.is_cut,
    }


def _overlaps(values: "xarray.DataArray", ranges: list[tuple[Figures, Range]]) -> Iterator[Figures]:
    """Yield the overlap of all fingers' ranges at each combination of the other axes."""
    if FINGER not in values.dims or values.sizes[FINGER] < 2:
        return
    groups: dict[tuple[Any, ...], list[Range]] = {}
    for at, each in ranges:
        rest = tuple((name, value) for name, value in at.items() if name != FINGER)
        groups.setdefault(rest, []).append(each)
    for rest, several in groups.items():
        if len(several) == values.sizes[FINGER]:
            shared = overlap(several)
            low, high = (None, None) if shared is None else shared
            yield {
                "criterion": values.attrs["criterion"],
                "along": _range_axis(values),
                "at": dict(rest),
                "low": low,
                "high": high,
            }
