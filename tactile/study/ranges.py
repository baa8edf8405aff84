"""Ranges of a parameter that are good enough, and their overlap for several fingers.

The paper's question was which lengths keep the smallest amplitude within some percent of the best.
`within` answers it for any criterion along any axis; `overlap` gives what all fingers share.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError

SHARE = 0.85
"""Default share of the best value that is good enough: that of the paper."""


@dataclass(frozen=True)
class Range:
    """A range of an axis, in the axis' unit.

    Attributes
    ----------
    low : float
        Lower end.
    high : float
        Upper end.
    best : float
        Position at which the criterion is best.
    value : float
        Best value of the criterion, in its unit.
    is_cut : bool
        Whether an end is that of the axis, so that the range may reach further.
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
    along : (N,) array of float
        Ascending values of the axis.
    values : (N,) array of float
        Values of the criterion, above zero.
    share : float
        Share of the best that is good enough: 0.85 stands for 85 % of the best where more is
        better, and for 1/0.85 of it where less is.
    sign : int
        1 if more is better, −1 if less is.
    in_db : bool
        Whether the values are levels, of which 0.85 is 1.4 dB; they need not be above zero.

    Returns
    -------
    Range
        Range around the best.

    Raises
    ------
    InputError
        If the axis does not ascend, fewer than two values are given, or the share is not between 0
        and 1.

    Notes ----- The criterion is interpolated linearly between the values of the axis. If several
    ranges are good enough, the one that holds the best is returned.
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
    """Check a share of the best.

    Parameters
    ----------
    share : float
        Share, above 0 and below 1.

    Raises
    ------
    InputError
        If the share is out of range.
    """
    if not 0 < share < 1:
        raise InputError(f"share = {share:g}: must be above 0 and below 1, as {SHARE:g}")


def shares(values: Floats, *, sign: int, in_db: bool) -> Floats:
    """Return numbers in proportion to how good values are.

    Parameters
    ----------
    values : ndarray of float
        Values of a criterion.
    sign : int
        1 if more is better, −1 if less is.
    in_db : bool
        Whether the values are levels.

    Returns
    -------
    ndarray of float
        Linear values if more is better, otherwise their inverse.
    """
    size = 10 ** (values / 20) if in_db else values
    return size if sign > 0 else 1 / size


def _sides(best: int) -> tuple[slice, slice]:
    """Return the slices from the best down to the first value, and up to the last."""
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
    """Return the overlap of all ranges.

    Parameters
    ----------
    ranges : list of Range
        Ranges of one axis; at least one.

    Returns
    -------
    (float, float) or None
        Ends of the overlap, or None if there is none.
    """
    low, high = max(r.low for r in ranges), min(r.high for r in ranges)
    return (low, high) if low <= high else None
