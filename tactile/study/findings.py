"""What a study says, in a few figures: the best designs, good ranges, and what fingers share.

All of it is read from the data set, so that a stored study says the same again. Where scenarios
were drawn, a design counts by what all but the worst 5 % of them reach: Weibull's quantile, of
which few draws are right on average.
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
"""Beyond which ranges are told of the best of the other axes alone."""
FINGER, SCENARIO, FREQUENCY = "load", "scenario", "frequency_hz"
"""Axes that have a meaning of their own."""

Figures = dict[str, Any]


def summarize(data: "xarray.Dataset", *, share: float = SHARE) -> Figures:
    """Return what a study says, as plain data.

    Parameters
    ----------
    data : of `solve_study` or `load_study`
    share : of the best that is good enough

    Returns
    -------
    dict
        ``designs``, ``axes`` (values of each), ``best`` (criterion, unit, value, at, for which
        finger), ``ranges`` (criterion, along, at, low, high, best, value, is_cut), ``overlaps``
        (criterion, along, at, low, high; null where there is none), ``spans`` (criterion, unit,
        low, high) of what is neither good nor bad, and ``figures``, all criteria of the first best
        design.

    Raises
    ------
    InputError
        Where it is too large to be looked through in memory, or the share is not between 0 and 1.
    """
    check_share(share)
    judged = {str(n): v for n, v in data.data_vars.items() if v.attrs.get("criterion") in CRITERIA}
    if sum(v.size for v in judged.values()) * 8 > LARGEST:
        raise InputError("the study is too large to be summed up in memory; open it with xarray")
    found: Figures = {
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
        found["best"] += _best(values)
        ranges = list(_ranges(values, share))
        found["ranges"] += [_told(values, at, one) for at, one in ranges]
        found["overlaps"] += _overlaps(values, ranges)
        found["spans"] += _span(values)
    if found["best"]:
        first = found["best"][0]["at"]
        found["figures"] = {
            name: {
                "value": float(v.sel(first)),
                "unit": v.attrs["units"],
                "means": v.attrs["long_name"],
            }
            for name, v in attained.items()
        }
    return found


def _span(values: "xarray.DataArray") -> list[Figures]:
    """Return from where to where a criterion goes of which neither more nor less is better."""
    if sign_of(values) or not bool(values.notnull().any()):
        return []
    told = {"criterion": values.attrs["criterion"], "unit": values.attrs["units"]}
    return [told | {"low": float(values.min()), "high": float(values.max())}]


def _axes(data: "xarray.Dataset | xarray.DataArray") -> list[str]:
    return [str(d) for d in data.dims if d not in (SCENARIO, FREQUENCY)]


def number_axes(values: "xarray.DataArray | xarray.Dataset") -> list[str]:
    """Return the axes of two or more numbers, frequency and scenarios apart."""
    return [d for d in _axes(values) if values.sizes[d] > 1 and values[d].dtype.kind in "fiu"]


def sign_of(values: "xarray.DataArray") -> int:
    """Return 1 where more is better, −1 where less is, 0 where neither is known to be."""
    criterion = CRITERIA.get(str(values.attrs.get("criterion", "")))
    return 0 if criterion is None else criterion.sign


def range_of(values: "xarray.DataArray", share: float) -> Range:
    """Return what of its one axis is within a share of a criterion's best; see `within`."""
    (axis,) = values.dims
    return within(
        values[axis].values,
        values.values,
        share=share,
        sign=sign_of(values),
        in_db=in_decibels(values),
    )


def reached(values: "xarray.DataArray") -> "xarray.DataArray":
    """Return what all but the worst scenarios reach; the median of what is neither good nor bad."""
    values = values.load()
    if SCENARIO not in values.dims:
        return values
    share = {1: WORST, -1: 1 - WORST, 0: 0.5}[sign_of(values)]
    found = values.quantile(share, SCENARIO, method="weibull", keep_attrs=True, skipna=False)
    return found.drop_vars("quantile")


def _best(values: "xarray.DataArray") -> list[Figures]:
    """Return the best design for each finger, and the one that suits all of them best."""
    sign = sign_of(values)
    if not sign or not bool(np.isfinite(values).any()):
        return []
    cases: list[tuple[str | None, xarray.DataArray]] = [(None, values)]
    if FINGER in values.dims:
        cases = [(str(name), values.sel({FINGER: name})) for name in values[FINGER].values]
        if len(cases) > 1:
            cases.append(("all", agreed(values)))
    return [
        _best_of(one, finger, 1 if finger == "all" else sign)
        for finger, one in cases
        if bool(np.isfinite(one).any())
    ]


def agreed(values: "xarray.DataArray") -> "xarray.DataArray":
    """Return how much of its own best each design leaves the finger that it suits least [%].

    Fingers are far apart, so that the smallest of all would be that of the stiffest one alone.
    """
    size = values.copy(data=shares(values.values, sign=sign_of(values), in_db=in_decibels(values)))
    rest = [d for d in size.dims if d != FINGER]
    worst = (size / size.max(rest)).min(FINGER, skipna=False) * 100
    return worst.assign_attrs({**values.attrs, "units": "% of each finger's own best"})


def in_decibels(values: "xarray.DataArray") -> bool:
    """Tell whether a criterion is a level, of which differences matter and not ratios."""
    return bool(values.attrs.get("units") == "dB")


def _best_of(values: "xarray.DataArray", finger: str | None, sign: int) -> Figures:
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


def _along(values: "xarray.DataArray") -> str | None:
    """Return the first axis of two or more ascending numbers."""
    ascending = (d for d in number_axes(values) if np.all(np.diff(values[d].values) > 0))
    return next(ascending, None)


def _ranges(values: "xarray.DataArray", share: float) -> Iterator[tuple[Figures, Range]]:
    """Yield the range along the first axis of numbers, for each of what the other axes say."""
    along = _along(values)
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
            for b in _best(values) if b["finger"] != "all"
        ]  # fmt: skip
    for at in places:
        line = values.sel(at)
        if bool(np.isfinite(line).any()):
            yield at, range_of(line, share)


def _told(values: "xarray.DataArray", at: Figures, one: Range) -> Figures:
    return {
        "criterion": values.attrs["criterion"],
        "unit": values.attrs["units"],
        "along": _along(values),
        "at": at,
        "low": one.low,
        "high": one.high,
        "best": one.best,
        "value": one.value,
        "is_cut": one.is_cut,
    }


def _overlaps(values: "xarray.DataArray", ranges: list[tuple[Figures, Range]]) -> Iterator[Figures]:
    """Yield what the ranges of all fingers share, for each of what the other axes say."""
    if FINGER not in values.dims or values.sizes[FINGER] < 2:
        return
    groups: dict[tuple[Any, ...], list[Range]] = {}
    for at, one in ranges:
        rest = tuple((name, value) for name, value in at.items() if name != FINGER)
        groups.setdefault(rest, []).append(one)
    for rest, several in groups.items():
        if len(several) == values.sizes[FINGER]:
            shared = overlap(several)
            low, high = (None, None) if shared is None else shared
            yield {
                "criterion": values.attrs["criterion"],
                "along": _along(values),
                "at": dict(rest),
                "low": low,
                "high": high,
            }
