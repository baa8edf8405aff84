"""Picture of a texture in a terminal: its surface, and its spectrum against the threshold.

`TextureScreen` is printed with ``rich``, which works over ssh as well. Each pixel of the surface is
the mean of its area. Bars are logarithmic, and each has a mark at the threshold of its third
octave.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style

from tactile.arrays import Floats
from tactile.show.live import (
    BADGE,
    LABEL,
    PARTS,
    TITLE,
    VALUE,
    Line,
    Raster,
    color_lines,
    height_lines,
    nice,
    scale_line,
)
from tactile.show.views import (
    NOMINAL,
    PIXELS,
    SIDE,
    StrokeSpectrum,
    View,
    facts,
    shown_bands,
)

COLUMNS = (40, 24, 12)
"""Widths that a surface may have [characters]; each divides the number of its pixels, as half of it
does."""
BESIDE = 84
"""Width from which the spectrum stands beside the surface [characters]."""
BAR_LEVELS = (0.01, 100.0)
"""Ends of a bar [µm], unless something is stronger."""
NAME_WIDTH, VALUE_WIDTH = 7, 20
"""Widths before and behind a bar [characters]."""
LONGEST_BAR = 60
"""Largest width of a bar [characters]."""
MARK = "│"
"""Character that marks the threshold on a bar."""
PERCEIVED, HIDDEN = Style.parse("#2bb5a0"), Style.parse("#7a8ca5")
"""Styles of the bar of a third octave that is felt, and of one that is not."""


@dataclass(frozen=True)
class TextureScreen:
    """View of a texture, laid out for the console that it is printed on.

    Attributes
    ----------
    view : View
        View to draw.
    """

    view: View

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        color = console.color_system is not None and not console.no_color
        for line in screen_lines(self.view, options.max_width, color=color):
            yield from line
            yield Segment.line()


def screen_lines(view: View, width: int, *, color: bool) -> list[Line]:
    """Draw a texture.

    Parameters
    ----------
    view : View
        View to draw.
    width : int
        Largest width [characters].
    color : bool
        Whether to draw the surface in color.

    Returns
    -------
    list of Line
        Lines of the picture.
    """
    columns = next((c for c in COLUMNS if c <= width), COLUMNS[-1])
    left = [
        [Segment(f"surface, {SIDE * 1e3:g} × {SIDE * 1e3:g} mm, stroke →", TITLE)],
        *surface_lines(view.surface, columns, color=color),
    ]
    beside = width >= BESIDE
    head = f"spectrum at {view.speed * 1e3:g} mm/s, µm peak per third octave"
    right = spectrum_lines(view.spectrum, head, width - columns - 3 if beside else width)
    body = [*left, [], *right]
    if beside:
        pairs: Iterator[tuple[Line, Line]]
        pairs = itertools.zip_longest(left, right, fillvalue=[])
        body = [[*Segment.adjust_line_length(a, columns + 3), *b] for a, b in pairs]
    about = view.texture.descriptor.texture.description
    name = f" {view.texture.name} on {view.conditions}"
    fact_lines = [[Segment(line, LABEL)] for line in facts(view, max(width - 10, 20))]
    lines = [[Segment(" tactile ", BADGE), Segment(name, TITLE)], [Segment(about)], [], *body, []]
    return [Segment.adjust_line_length(line, width, pad=False) for line in [*lines, *fact_lines]]


def surface_lines(surface: Floats, columns: int, *, color: bool) -> list[Line]:
    """Draw the displacement of a surface above its scale.

    Parameters
    ----------
    surface : (P, P) array of float
        Displacement as y by x, both ascending [m].
    columns : int
        Width, a divisor of P [characters].
    color : bool
        Whether to draw in color.

    Returns
    -------
    list of Line
        Lines of the picture, y upward.
    """
    rows = columns if color else columns // 2
    cells = surface[::-1].reshape(rows, PIXELS // rows, columns, PIXELS // columns).mean((1, 3))
    micro = cells.ravel() * 1e6
    end = nice(max(float(np.abs(micro).max()), 1e-3))
    number = np.arange(micro.size)
    raster = Raster(
        number, np.ones_like(number), number.reshape(rows, columns),
        np.zeros((rows, columns), np.intp), 1,
    )  # fmt: skip
    lines = (color_lines if color else height_lines)(raster, micro / end)
    return [*lines, scale_line(end, columns, columns, color=color)]


def spectrum_lines(s: StrokeSpectrum, head: str, width: int) -> list[Line]:
    """Draw each third octave as a logarithmic bar, with a mark at its threshold.

    Parameters
    ----------
    s : StrokeSpectrum
        Spectrum to draw.
    head : str
        Heading.
    width : int
        Largest width [characters].

    Returns
    -------
    list of Line
        Lines of the picture.
    """
    bands = shown_bands(s)
    low = BAR_LEVELS[0]
    high = max(BAR_LEVELS[1], nice(float(s.total.max(initial=1e-9)) * 1e6))
    length = int(np.clip(width - NAME_WIDTH - VALUE_WIDTH, 8, LONGEST_BAR))
    scale = f"{low:g}".ljust(length - len(f"{high:g}")) + f"{high:g} µm, {MARK} just felt"
    lines: list[Line] = [[Segment(head, TITLE)], [Segment(f"{'Hz':>6} {scale}", LABEL)]]
    for band in bands:
        micro, least = s.total[band] * 1e6, s.threshold[band] * 1e6
        excess = s.level[band]
        style = PERCEIVED if excess >= 0 else HIDDEN
        part, mark = (math.log(max(v / low, 1.0)) / math.log(high / low) for v in (micro, least))
        label = f" {micro:7.2f} µm " + (f"{excess:+4.0f} dB" if excess > -100 else "")
        lines.append(
            [
                Segment(f"{NOMINAL[band]:6g} ", LABEL),
                *marked_bar(part, mark, length, style),
                Segment(label.replace("-", "−"), VALUE if excess >= 0 else LABEL),
            ]
        )
    if not len(bands):
        lines.append([Segment("nothing up to 1 kHz", LABEL)])
    return lines + grating_lines(s.grating_frequency, s.grating_peak * 1e6, width)


def marked_bar(part: float, mark: float, length: int, style: Style) -> Line:
    """Draw a bar with a mark.

    Parameters
    ----------
    part : float
        Part of the bar that is filled, 0 … 1.
    mark : float
        Part of the bar at which the mark is.
    length : int
        Width of the bar [characters].
    style : Style
        Style of the bar.

    Returns
    -------
    Line
        Bar with its mark.
    """
    whole, rest = divmod(round(min(part, 1.0) * 8 * length), 8)
    bar = ("█" * whole + PARTS[rest] * (rest > 0)).ljust(length)[:length]
    at = min(int(mark * length), length - 1)
    return [Segment(bar[:at], style), Segment(MARK, VALUE), Segment(bar[at + 1 :], style)]


def grating_lines(frequency: Floats, micro: Floats, width: int) -> list[Line]:
    """List the strongest harmonics of gratings, as many as fit in a line.

    Parameters
    ----------
    frequency : (H,) array of float
        Frequencies [Hz].
    micro : (H,) array of float
        Peaks [µm].
    width : int
        Largest width [characters].

    Returns
    -------
    list of Line
        One line, or none without gratings.
    """
    if not len(frequency):
        return []
    text = "gratings"
    for k in np.argsort(-micro):
        longer = (
            f"{text}{':' if text == 'gratings' else ','} {micro[k]:.2g} µm at {frequency[k]:.3g} Hz"
        )
        if len(longer) > width:
            break
        text = longer
    return [[Segment(text, LABEL)]]
