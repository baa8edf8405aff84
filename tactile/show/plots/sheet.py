"""Figure of many textures: a tile of each one's surface and a strip of its spectrum.

Tiles are sorted by category. A category has one color scale, written above its tiles, so that a
strong texture looks strong beside others of its kind; the strips share one scale throughout.
"""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tactile.show.plots.style import GRAY, axes_at, new_figure
from tactile.show.plots.texture import DIVERGING, color_end, draw_spectrum
from tactile.show.views import TILE_SIDE, Tile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 9
"""Largest number of tiles in a row."""
TILE, STRIP = 1.3, 0.42
"""Side of a tile, and height of a strip [inch]."""
RULE, GAP = 0.18, 0.12
"""Distances from the top of a category to its line, and from there to its tiles [inch]."""
CELL_WIDTH, CELL_HEIGHT = TILE + 0.16, RULE + GAP + TILE + 0.36 + STRIP + 0.3
"""Width and height of a tile with its strip, labels and gaps [inch]."""
MARGIN, HEAD, FOOT = 0.3, 0.75, 0.75
"""Margins at the sides, at the top and at the bottom [inch]."""
BAND = (10.0, 1000.0)
"""Range of frequencies of a strip [Hz]."""
LEVELS = (0.01, 100.0)
"""Range of levels of a strip [µm]."""


def sheet_figure(tiles: Sequence[Tile], *, conditions: str) -> "Figure":
    """Draw a sheet of textures, sorted by category and name.

    Parameters
    ----------
    tiles : sequence of Tile
        Tiles from `tactile.show.views.tile`, in any order.
    conditions : str
        Display and stroke for which the tiles were computed.

    Returns
    -------
    Figure
        Figure with one tile and one strip per texture.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    ordered = sorted(tiles, key=lambda one: (one.category, one.name))
    columns = min(COLUMNS, max(len(ordered), 4))
    rows = -(-len(ordered) // columns)
    size = 2 * MARGIN + columns * CELL_WIDTH, HEAD + FOOT + rows * CELL_HEIGHT
    figure = new_figure(*size)
    figure.set_layout_engine("none")
    _write(figure, MARGIN, size[1] - 0.3, f"{len(ordered)} textures", 15, weight="bold")
    ends = category_ends(ordered)
    for k, tile in enumerate(ordered):
        row, column = divmod(k, columns)
        left = MARGIN + column * CELL_WIDTH
        top = size[1] - HEAD - row * CELL_HEIGHT
        if not column or ordered[k - 1].category != tile.category:
            last = (row + 1) * columns
            count = sum(other.category == tile.category for other in ordered[k:last])
            continued = k > 0 and ordered[k - 1].category == tile.category
            _category(figure, left, top, count, tile.category, ends[tile.category], continued)
        _draw(figure, left, top - RULE - GAP, tile, ends[tile.category])
    _legend(figure, conditions)
    return figure


def category_ends(tiles: Sequence[Tile]) -> dict[str, float]:
    """Compute the end of each category's color scale, that of its strongest texture.

    Parameters
    ----------
    tiles : sequence of Tile
        Tiles of all categories.

    Returns
    -------
    dict of str to float
        End of the color scale by category [m].
    """
    ends: dict[str, float] = {}
    for tile in tiles:
        ends[tile.category] = max(ends.get(tile.category, 0.0), color_end(tile.surface))
    return ends


def _category(
    figure: "Figure", left: float, top: float, count: int, name: str, end: float, continued: bool
) -> None:
    """Write a category over its tiles in a row, with the scale of its colors."""
    from matplotlib.lines import Line2D

    across, up = figure.get_size_inches()
    right = left + count * CELL_WIDTH - (CELL_WIDTH - TILE)
    y = top - RULE
    line = Line2D([left / across, right / across], [y / up, y / up], color="black", linewidth=1.0)
    figure.add_artist(line)
    _write(figure, left, y + 0.13, f"{name} …" if continued else name, 10, weight="bold")
    scale = f"± {end * 1e6:.2g} µm"
    _write(figure, right, y + 0.13, scale, 8, ha="right", color=GRAY)


def _draw(figure: "Figure", left: float, top: float, one: Tile, end: float) -> None:
    """Draw a tile with its name, and the strip of its spectrum below."""
    surface = axes_at(figure, left, top - TILE, TILE, TILE)
    surface.imshow(one.surface, DIVERGING, vmin=-end, vmax=end, origin="lower")
    surface.set(xticks=[], yticks=[])
    name = one.name.removeprefix(f"{one.category}-")
    size = 9 if len(name) <= 17 else 9 * 17 / len(name)
    _write(figure, left, top - TILE - 0.11, name, size)
    felt = one.figures.level_db_sl
    level = "" if felt is None else f", {felt:+.0f} dB".replace("-", "−")
    text = f"{one.figures.vibration_um_rms:.2f} µm rms{level}"
    _write(figure, left, top - TILE - 0.26, text, 8, color=GRAY)
    strip = axes_at(figure, left, top - TILE - 0.36 - STRIP, TILE, STRIP)
    draw_spectrum(strip, one.spectrum, bold=0.6)
    strip.set(xlim=BAND, ylim=LEVELS)
    strip.tick_params(which="both", bottom=False, left=False, labelbottom=False, labelleft=False)
    for axes in (surface, strip):
        axes.spines[:].set(color="#999999", linewidth=0.5)


def _legend(figure: "Figure", conditions: str) -> None:
    """Explain tiles and strips at the bottom of the figure."""
    side = TILE_SIDE * 1e3
    width = int((figure.get_figwidth() - 2 * MARGIN) * 14.5)
    text = (
        f"Commanded on {conditions}. Numbers: vibration in 20–1000 Hz; sensation level of the "
        "third octave farthest above threshold. Tiles: tangential displacement over "
        f"{side:g} × {side:g} mm; red is shear along the stroke (left to right), blue against "
        "it; one scale per category. Strips: peak of each third octave, "
        f"{LEVELS[0]:g} to {LEVELS[1]:g} µm over {BAND[0]:g} to {BAND[1]:g} Hz, both logarithmic: "
        "blue the surface, green sparse events, stems gratings, against the tangential "
        "detection threshold (dashed, gray)."
    )
    _write(figure, MARGIN, 0.38, textwrap.fill(text, width), 9, color="#333333")


def _write(figure: "Figure", x: float, y: float, text: str, size: float, **how: Any) -> None:
    """Write text at a place [inch] of the figure, centered vertically."""
    across, up = figure.get_size_inches()
    figure.text(x / across, y / up, text, fontsize=size, va="center", **how)
