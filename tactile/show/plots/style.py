"""Common parts of the figures: files, colors, axes, labels of lines, figures without global state.

Colors are those of Okabe and Ito, which can be told apart with color vision deficiency; lines are
labeled where they are drawn. matplotlib is imported only when something is drawn; if it is missing,
the error says how to install it.
"""

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactile.errors import InputError, missing_extra
from tactile.texture.perception import THRESHOLD, THRESHOLD_SPREAD_DB, detection_threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")
"""Suffixes of files that a figure can be saved to."""
DPI = 150
"""Resolution of saved figures [dots per inch]."""
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors of Okabe and Ito (2008), without yellow, which is too pale on white."""
BLUE, RED, GRAY = COLORS[0], COLORS[1], "#666666"
"""Colors of the main line, of its counterpart, and of secondary text."""
THRESHOLD_NAME = f"tangential detection threshold ± {THRESHOLD_SPREAD_DB:g} dB"
"""Label of the detection threshold."""
NAME_HEIGHT = 0.07
"""Distance kept between the labels of lines, as a part of the height of the axes."""


def tag(axes: "Axes", place: float, text: str, color: str) -> None:
    """Write a label at the top of the axes.

    Parameters
    ----------
    axes : Axes
        Axes to write in.
    place : float
        Distance from the left edge, as a part of the width of the axes.
    text : str
        Text of the label.
    color : str
        Color of the label.
    """
    label = axes.text(
        place, 0.97, text, transform=axes.transAxes, color=color, va="top", fontsize=9
    )
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0})


def name_ends(axes: "Axes", ends: list[tuple[float, str, str]]) -> None:
    """Write labels beside the right ends of lines, and keep them apart.

    Parameters
    ----------
    axes : Axes
        Axes to write in.
    ends : list of (float, str, str)
        Last value, label and color of each line.
    """
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
    """Draw the detection threshold of tangential motion up to 1 kHz.

    The axes are frequency [Hz] and peak displacement [µm].

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    bold : float
        Factor on the widths of lines.
    """
    frequency = THRESHOLD[:, 0]
    micro = detection_threshold(frequency) * 1e6
    spread = 10 ** (THRESHOLD_SPREAD_DB / 20)
    axes.fill_between(frequency, micro / spread, micro * spread, color="#e4e4e4", linewidth=0)
    axes.plot(frequency, micro, color=GRAY, linewidth=1.2 * bold, linestyle="--")


def plain(axes: "Axes", *, grid: bool = True) -> None:
    """Remove the top and right spines, and draw a pale grid.

    Parameters
    ----------
    axes : Axes
        Axes to change.
    grid : bool
        Whether to draw a grid.
    """
    axes.spines[["top", "right"]].set_visible(False)
    if grid:
        axes.grid(color="#e8e8e8", linewidth=0.6)
        axes.set_axisbelow(True)


def new_figure(width: float, height: float) -> "Figure":
    """Create an empty figure that is not registered in any global state.

    Parameters
    ----------
    width : float
        Width [inch].
    height : float
        Height [inch].

    Returns
    -------
    Figure
        Empty figure.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise missing_extra("a figure", "matplotlib", "plot") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: "Figure", left: float, bottom: float, width: float, height: float) -> "Axes":
    """Add axes at a place of a figure.

    Parameters
    ----------
    figure : Figure
        Figure to add to.
    left, bottom : float
        Lower left corner of the axes [inch].
    width, height : float
        Size of the axes [inch].

    Returns
    -------
    Axes
        New axes.
    """
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def check_file(path: str | Path) -> None:
    """Reject a file that cannot become a figure; `save` does so too, after all is computed.

    Parameters
    ----------
    path : str or Path
        File to write.

    Raises
    ------
    InputError
        If its suffix or folder is wrong, or matplotlib is missing.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: must end in {', '.join(SUFFIXES)}")
    if not Path(path).parent.is_dir():
        raise InputError(f"{path}: No such file or directory")
    new_figure(1.0, 1.0)


def save(figure: "Figure", path: str | Path) -> None:
    """Write a figure to a file.

    Parameters
    ----------
    figure : Figure
        Figure to save.
    path : str or Path
        File to write, a .png, .svg or .pdf.

    Raises
    ------
    InputError
        If the file has another suffix or cannot be written.
    """
    check_file(path)
    try:
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def drawn(figure: "Figure") -> bytes:
    """Return a figure as SVG, with the same bytes for the same figure.

    Parameters
    ----------
    figure : Figure
        Figure to draw.

    Returns
    -------
    bytes
        Contents of an SVG file.
    """
    from matplotlib import rc_context

    file = io.BytesIO()
    with rc_context({"svg.hashsalt": "tactile"}):
        figure.savefig(file, format="svg", dpi=DPI, metadata={"Date": None})
    return file.getvalue()
