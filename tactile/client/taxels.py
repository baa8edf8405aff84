"""Mapping of a grid of taxels to the contactors of a display, without numpy.

Each contactor gets the mean of the grid over the area that is nearer to it than to any other
contactor (its Voronoi cell), in which each taxel counts by its area in the cell.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import chain, pairwise, starmap
from operator import mul
from typing import Any, NamedTuple

from tactile.client.wire import Pair, excerpt, to_index, to_items, to_number
from tactile.errors import InputError

Polygon = list[Pair]
"""Corners of a convex polygon, in order."""
MOST_TAXELS = 1 << 16
"""Maximum number of taxels of a grid, whose weights take a second (assumed to be enough)."""
LONE = 1e-3
"""Side of the default extent for a display of one contactor [m]; any would do."""


class Extent(NamedTuple):
    """Rectangle in the plane of a display.

    Attributes
    ----------
    left, bottom, right, top : float
        Sides of the rectangle [m].
    """

    left: float
    bottom: float
    right: float
    top: float

    @property
    def corners(self) -> Polygon:
        """Corners of the rectangle, counterclockwise."""
        left, bottom, right, top = self
        return [(left, bottom), (right, bottom), (right, top), (left, top)]


def default_extent(contactors: Sequence[Pair]) -> Extent:
    """Return the rectangle around all contactors, wider by half of their smallest distance.

    Parameters
    ----------
    contactors : (N, 2) sequence of float
        Positions of the contactors [m].

    Returns
    -------
    Extent
        Rectangle. If the contactors are on a square grid, each has a square of it.
    """
    pairs = ((a, b) for k, a in enumerate(contactors) for b in contactors[:k])
    half = min(starmap(math.dist, pairs), default=LONE) / 2
    x, y = zip(*contactors, strict=True)
    return Extent(min(x) - half, min(y) - half, max(x) + half, max(y) + half)


def to_extent(extent: Iterable[float]) -> Extent:
    """Return an extent as a program gives it.

    Parameters
    ----------
    extent : (4,) iterable of float
        Left, bottom, right and top side [m].

    Returns
    -------
    Extent
        The rectangle.

    Raises
    ------
    InputError
        If it is no rectangle.
    """
    sides = [to_number(side, "extent [m]") for side in to_items(extent, "extent", 4)]
    if len(sides) != 4 or sides[0] >= sides[2] or sides[1] >= sides[3]:
        raise InputError(f"extent: {excerpt(sides)} must be left < right and bottom < top [m]")
    return Extent(*sides)


def _clipped(polygon: Polygon, a: float, b: float, c: float) -> Polygon:
    """Return the part of a polygon in which a x + b y ≤ c (Sutherland and Hodgman 1974)."""
    out: Polygon = []
    for (x0, y0), (x1, y1) in pairwise([*polygon[-1:], *polygon]):
        before, after = a * x0 + b * y0 - c, a * x1 + b * y1 - c
        if before * after < 0:
            way = before / (before - after)
            out.append((x0 + way * (x1 - x0), y0 + way * (y1 - y0)))
        if after <= 0:
            out.append((x1, y1))
    return out


def _within(polygon: Polygon, extent: Extent) -> Polygon:
    """Return the part of a polygon in a rectangle."""
    polygon = _clipped(_clipped(polygon, -1, 0, -extent.left), 1, 0, extent.right)
    return _clipped(_clipped(polygon, 0, -1, -extent.bottom), 0, 1, extent.top)


def _area(polygon: Polygon) -> float:
    """Return the area of a polygon whose corners are counterclockwise."""
    sides = pairwise([*polygon[-1:], *polygon])
    return sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in sides) / 2


def _cell(contactors: Sequence[Pair], k: int, extent: Extent) -> Polygon:
    """Return the part of the extent that is nearer to a contactor than to any other."""
    polygon, (x, y) = extent.corners, contactors[k]
    for u, v in (*contactors[:k], *contactors[k + 1 :]):
        a, b = u - x, v - y
        polygon = _clipped(polygon, a, b, (a * (u + x) + b * (v + y)) / 2)
    return polygon


class TaxelGrid:
    """A grid of taxels over a display.

    Parameters
    ----------
    rows, columns : int
        Number of rows, from the largest y to the smallest, and of columns, from the smallest x.
    contactors : (N, 2) sequence of float
        Positions of the contactors [m].
    extent : Extent
        Rectangle that the grid covers.

    Attributes
    ----------
    taxels : int
        Number of taxels.
    weights : list of list of (int, float)
        For each contactor, the number of each taxel that counts, row by row, and its weight. The
        weights of a contactor add up to 1; one whose cell is beyond the grid has none.

    Raises
    ------
    InputError
        If there is no taxel, or there are too many.

    Examples
    --------
    Two rows of three taxels over two contactors, of which each has half of the middle column:

    >>> contactors = [(0.0, 0.0), (2e-3, 0.0)]
    >>> grid = TaxelGrid(2, 3, contactors, Extent(-1e-3, -1e-3, 3e-3, 1e-3))
    >>> [round(value, 3) for value in grid.frame([0.3, 0.6, 0.9, 0.3, 0.6, 0.9])]
    [0.4, 0.8]
    """

    def __init__(self, rows: int, columns: int, contactors: Sequence[Pair], extent: Extent) -> None:
        if rows < 1 or columns < 1:
            raise InputError(f"grid: {rows} × {columns} taxels are none")
        if rows * columns > MOST_TAXELS:
            raise InputError(f"grid: {rows} × {columns} taxels are more than {MOST_TAXELS}")
        self._size, self._extent = (rows, columns), extent
        self.taxels = rows * columns
        self.weights = [self._weights(_cell(contactors, k, extent)) for k in range(len(contactors))]
        self._sums = [
            ([taxel for taxel, _ in weights], [share for _, share in weights])
            for weights in self.weights
        ]

    def _weights(self, cell: Polygon) -> list[tuple[int, float]]:
        """Return the taxels of a cell, with their shares of its area."""
        if len(cell) < 3:
            return []
        left, bottom, right, top = self._extent
        rows, columns = self._size
        width, height = (right - left) / columns, (top - bottom) / rows
        x, y = zip(*cell, strict=True)
        areas = []
        for row in _indices(top - max(y), top - min(y), height, rows):
            upper = top - row * height
            for column in _indices(min(x) - left, max(x) - left, width, columns):
                start = left + column * width
                taxel = Extent(start, upper - height, start + width, upper)
                areas.append((row * columns + column, _area(_within(cell, taxel))))
        whole = sum(area for _, area in areas)
        return [(taxel, area / whole) for taxel, area in areas if area > 1e-9 * whole]

    def frame(self, values: Sequence[float]) -> list[float]:
        """Return the value of each contactor.

        Parameters
        ----------
        values : (rows × columns,) sequence of float
            Values of the taxels, row by row.

        Returns
        -------
        list of float
            Mean over the cell of each contactor; 0 beyond the grid.
        """
        return [
            sum(map(mul, map(values.__getitem__, taxels), shares)) for taxels, shares in self._sums
        ]


def _indices(low: float, high: float, step: float, count: int) -> range:
    """Return the numbers of the intervals of a length that a range [low, high] touches."""
    return range(max(math.floor(low / step), 0), min(math.ceil(high / step), count))


def to_grid(grid: Any, contactors: Sequence[Pair], extent: Iterable[float] | None) -> TaxelGrid:
    """Return a grid as a program describes it.

    Parameters
    ----------
    grid : (2,) sequence of int
        Number of rows and of columns.
    contactors : (N, 2) sequence of float
        Positions of the contactors [m].
    extent : (4,) iterable of float or None
        Left, bottom, right and top side of the grid [m]; None for `default_extent`.

    Returns
    -------
    TaxelGrid
        The grid.

    Raises
    ------
    InputError
        If it is no grid.
    """
    size = [to_index(number, "grid") for number in to_items(grid, "grid", 2)]
    if len(size) != 2:
        raise InputError(f"grid: {excerpt(size)} must be the number of rows and of columns")
    rows, columns = size
    area = default_extent(contactors) if extent is None else to_extent(extent)
    return TaxelGrid(rows, columns, contactors, area)


def flattened(values: Any) -> list[float]:
    """Return the values of an image as one list.

    Parameters
    ----------
    values : sequence of float or of sequences of float, or buffer
        Values, in one sequence or row by row, in any array of one or two dimensions.

    Returns
    -------
    list of float
        Values, row by row.

    Raises
    ------
    InputError
        If they are no sequence of numbers or rows.
    """
    try:
        items: Any = memoryview(values).tolist()
    except (TypeError, ValueError, NotImplementedError):
        items = values
    numbers: list[float] = list(to_items(items, "frame"))
    if numbers and not isinstance(numbers[0], int | float):
        try:
            return list(chain.from_iterable(numbers))
        except TypeError:
            raise InputError(f"frame: {excerpt(values)} is no image of numbers") from None
    return numbers
