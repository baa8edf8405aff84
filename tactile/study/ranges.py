"""Ranges of a parameter that are good enough, and where several fingers agree on one.

The paper's question was which lengths keep the smallest amplitude within some percent of the best;
`within` answers it of any criterion along any axis, `overlap` says what all fingers share.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError

SHARE = 0.85
"""Of the best that is good enough, unless told otherwise: the paper's."""


@dataclass(frozen=True)
class Range:
    """A stretch of an axis, in its unit.

    Attributes
    ----------
    low, high : its ends
    best : where the criterion is best
    value : the criterion there
    is_cut : whether an end is that of the axis, so that the range may reach further
    """

    low: float
    high: float
    best: float
    value: float
    is_cut: bool


def within(
    along: Floats, values: Floats, *, share: float, sign: int = 1, in_db: bool = False
) -> Range:
    """Return the range around the best in which a criterion stays within a share of the best.

    Parameters
    ----------
    along : (N,) ascending values of the axis
    values : (N,) of the criterion, above zero
    share : 0.85 asks for 85 % of the best where more is better, for 1/0.85 of it where less is
    sign : 1 where more is better, −1 where less is
    in_db : whether values are levels, of which 0.85 is 1.4 dB; they need not be above zero

    Raises
    ------
    InputError
        Where the axis does not ascend, fewer than two values are given, or the share is not
        between 0 and 1.

    Notes
    -----
    Between the axis' values the criterion runs straight. Where several stretches are good enough it
    is the one with the best.
    """
    along, values = np.asarray(along, np.float64), np.asarray(values, np.float64)
    if along.size < 2 or np.any(np.diff(along) <= 0):
        raise InputError("a range needs an axis of two or more ascending numbers")
    check_share(share)
    size = shares(values, sign=sign, in_db=in_db)
    best = int(np.nanargmax(size))
    level = share * size[best]
    ends = [_crossing(along[side], size[side], level) for side in _sides(best)]
    return Range(
        low=ends[0][0],
        high=ends[1][0],
        best=float(along[best]),
        value=float(values[best]),
        is_cut=ends[0][1] or ends[1][1],
    )


def check_share(share: float) -> None:
    """Raise InputError where a share of the best cannot be."""
    if not 0 < share < 1:
        raise InputError(f"share = {share:g}: must be above 0 and below 1, as {SHARE:g}")


def shares(values: Floats, *, sign: int, in_db: bool) -> Floats:
    """Return what is in proportion to how good values are."""
    size = 10 ** (values / 20) if in_db else values
    return size if sign > 0 else 1 / size


def _sides(best: int) -> tuple[slice, slice]:
    """Return the way from the best down to the first value, and that up to the last."""
    return slice(best, None, -1), slice(best, None)


def _crossing(along: Floats, size: Floats, level: float) -> tuple[float, bool]:
    """Return where the size first falls below a level, and whether it never does."""
    below = ~(size >= level)
    if not below.any():
        return float(along[-1]), True
    at = int(below.argmax())
    rise = (level - size[at]) / (size[at - 1] - size[at])
    if not np.isfinite(rise):
        rise = 1.0
    return float(along[at] + rise * (along[at - 1] - along[at])), False


def overlap(ranges: list[Range]) -> tuple[float, float] | None:
    """Return what all ranges share, or None where there is nothing."""
    low, high = max(r.low for r in ranges), min(r.high for r in ranges)
    return (low, high) if low <= high else None
