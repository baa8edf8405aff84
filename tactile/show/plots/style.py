"""What the figures share: files, colors, axes, names of lines, and a figure without global state.

Colors are those of Okabe and Ito, which the color-blind tell apart; lines are named where they are
drawn. matplotlib is imported when something is drawn, and is told to be installed where it is not.
"""

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactile.errors import InputError
from tactile.texture.perception import THRESHOLD, THRESHOLD_SPREAD_DB, detection_threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")
DPI = 150
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito 2008, yellow left out since it fades on white."""
BLUE, RED, GRAY = COLORS[0], COLORS[1], "#666666"
THRESHOLD_NAME = f"tangential detection threshold ± {THRESHOLD_SPREAD_DB:g} dB"
NAME_HEIGHT = 0.07
"""Of the axes: distance kept between the names of lines."""


def tag(axes: "Axes", place: float, text: str, color: str) -> None:
    """Write a name into the top of the axes, ``place`` of its width from the left."""
    label = axes.text(
        place, 0.97, text, transform=axes.transAxes, color=color, va="top", fontsize=9
    )
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0})


def name_ends(axes: "Axes", ends: list[tuple[float, str, str]]) -> None:
    """Write names beside the right ends (value, name, color) of lines, kept apart."""
    low, high = axes.get_ylim()
    if axes.get_yscale() == "log":
        low, high = np.log10(low), np.log10(high)
        ends = [(float(np.log10(value)), name, color) for value, name, color in ends]
    ends = sorted(ends)
    place = np.array([(value - low) / (high - low) for value, _, _ in ends])
    for _ in range(100):
        push = np.maximum(NAME_HEIGHT - np.diff(place), 0) / 2
        place[:-1] -= push
        place[1:] += push
    for at, (_, name, color) in zip(place.tolist(), ends, strict=True):
        axes.text(1.01, at, name, transform=axes.transAxes, color=color, va="center")


def draw_threshold(axes: "Axes", *, bold: float = 1.0) -> None:
    """Draw what motion along the skin must have to be felt, up to 1 kHz [Hz], [µm peak]."""
    frequency = THRESHOLD[:, 0]
    micro = detection_threshold(frequency) * 1e6
    spread = 10 ** (THRESHOLD_SPREAD_DB / 20)
    axes.fill_between(frequency, micro / spread, micro * spread, color="#e4e4e4", linewidth=0)
    axes.plot(frequency, micro, color=GRAY, linewidth=1.2 * bold, linestyle="--")


def plain(axes: "Axes", *, grid: bool = True) -> None:
    """Leave out what carries no information."""
    axes.spines[["top", "right"]].set_visible(False)
    if grid:
        axes.grid(color="#e8e8e8", linewidth=0.6)
        axes.set_axisbelow(True)


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure [inch] that no global state knows of."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("a figure needs matplotlib; pip install 'tactile-display[plot]'") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: "Figure", left: float, bottom: float, width: float, height: float) -> "Axes":
    """Return axes at a place [inch] of the figure."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def check_file(path: str | Path) -> None:
    """Refuse a file that cannot be a figure before anything is computed for it.

    Raises
    ------
    InputError
        Where its name or folder is wrong, or matplotlib is missing.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: must end in {', '.join(SUFFIXES)}")
    if not Path(path).parent.is_dir():
        raise InputError(f"{path}: No such file or directory")
    new_figure(1.0, 1.0)


def save(figure: "Figure", path: str | Path) -> None:
    """Write a figure to its file.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    try:
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def drawn(figure: "Figure") -> bytes:
    """Return a figure as SVG, the same bytes for the same figure."""
    from matplotlib import rc_context

    file = io.BytesIO()
    with rc_context({"svg.hashsalt": "tactile"}):
        figure.savefig(file, format="svg", dpi=DPI, metadata={"Date": None})
    return file.getvalue()
