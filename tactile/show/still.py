"""A texture in a terminal: its surface in half blocks, its spectrum as bars against what is felt.

`TextureScreen` is printed with ``rich``, over ssh as well. Each pixel of the surface is the mean of
its place. Bars are logarithmic; each has a mark where its third octave begins to be felt.
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
    HEIGHTS,
    LABEL,
    LEVELS,
    PARTS,
    TITLE,
    VALUE,
    Line,
    Raster,
    color_lines,
    height_lines,
    nice,
    palette,
)
from tactile.show.views import CENTER, PIXELS, SIDE, View, facts, just_felt, shown_bands

COLUMNS = (40, 24, 12)
"""Characters that a surface may be wide; each divides its pixels, as half of it does."""
BESIDE = 84
"""Characters from which the spectrum stands beside the surface."""
BAR_LEVELS = (0.01, 100.0)
"""µm from one end of a bar to the other, unless something is stronger."""
NAMED, TOLD = 7, 20
"""Characters before and behind a bar."""
LONGEST_BAR = 60
MARK = "│"
FELT, HIDDEN = Style.parse("#2bb5a0"), Style.parse("#7a8ca5")
"""Of the bar of a third octave that is felt, and of one that is not."""


@dataclass(frozen=True)
class TextureScreen:
    """A view of a texture, laid out for the console that it is printed on."""

    view: View

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        color = console.color_system is not None and not console.no_color
        for line in screen_lines(self.view, options.max_width, color=color):
            yield from line
            yield Segment.line()


def screen_lines(view: View, width: int, *, color: bool) -> list[Line]:
    """Return the lines of a texture's picture, at most ``width`` characters each."""
    columns = next((c for c in COLUMNS if c <= width), COLUMNS[-1])
    left = [
        [Segment(f"surface, {SIDE * 1e3:g} × {SIDE * 1e3:g} mm, stroke →", TITLE)],
        *surface_lines(view.surface, columns, color=color),
    ]
    beside = width >= BESIDE
    right = spectrum_lines(view, width - columns - 3 if beside else width)
    body = [*left, [], *right]
    if beside:
        pairs: Iterator[tuple[Line, Line]]
        pairs = itertools.zip_longest(left, right, fillvalue=[])
        body = [[*Segment.adjust_line_length(a, columns + 3), *b] for a, b in pairs]
    about = view.texture.descriptor.texture.description
    name = f" {view.display.name} · {view.texture.name}"
    told = [[Segment(line, LABEL)] for line in facts(view, max(width - 10, 20))]
    lines = [[Segment(" tactile ", BADGE), Segment(name, TITLE)], [Segment(about)], [], *body, []]
    return [Segment.adjust_line_length(line, width, pad=False) for line in [*lines, *told]]


def surface_lines(surface: Floats, columns: int, *, color: bool) -> list[Line]:
    """Draw displacement (P, P) [m], y upward, in so many characters, above its scale."""
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
    low, high = f"−{end:g} µm ", f" +{end:g} µm"
    length = max(columns - len(low) - len(high), 0)
    sweep = np.linspace(0, 1, length)
    ramp = [Segment("▀", Style(color=palette()[round(k * (LEVELS - 1))])) for k in sweep]
    if not color:
        ramp = [Segment(HEIGHTS[round(k * 7) + 1]) for k in sweep]
    return [*lines, [Segment(low, LABEL), *ramp, Segment(high, LABEL)]]


def spectrum_lines(view: View, width: int) -> list[Line]:
    """Draw each third octave as a bar [µm], logarithmic, with a mark where it is felt from."""
    s, shown = view.spectrum, shown_bands(view.spectrum)
    low = BAR_LEVELS[0]
    high = max(BAR_LEVELS[1], nice(float(s.total.max(initial=1e-9)) * 1e6))
    length = int(np.clip(width - NAMED - TOLD, 8, LONGEST_BAR))
    head = f"spectrum at {view.speed * 1e3:g} mm/s, µm peak per third octave"
    scale = f"{low:g}".ljust(length - len(f"{high:g}")) + f"{high:g} µm, {MARK} just felt"
    lines: list[Line] = [[Segment(head, TITLE)], [Segment(f"{'Hz':>6} {scale}", LABEL)]]
    for band in shown:
        micro, least = s.total[band] * 1e6, float(just_felt(CENTER[band])) * 1e6
        excess = s.excess_db[band]
        style = FELT if excess >= 0 else HIDDEN
        part, mark = (math.log(max(v / low, 1.0)) / math.log(high / low) for v in (micro, least))
        told = f" {micro:7.2f} µm " + (f"{excess:+4.0f} dB" if excess > -100 else "")
        lines.append(
            [
                Segment(f"{float(f'{CENTER[band]:.3g}'):6g} ", LABEL),
                *marked_bar(part, mark, length, style),
                Segment(told.replace("-", "−"), VALUE if excess >= 0 else LABEL),
            ]
        )
    if not len(shown):
        lines.append([Segment("nothing up to 1 kHz", LABEL)])
    return lines + grating_lines(s.grating_frequency, s.grating_peak * 1e6, width)


def marked_bar(part: float, mark: float, length: int, style: Style) -> Line:
    """Draw a part, 0 … 1, of a bar of so many characters, and a mark at another part of it."""
    whole, rest = divmod(round(min(part, 1.0) * 8 * length), 8)
    bar = ("█" * whole + PARTS[rest] * (rest > 0)).ljust(length)[:length]
    at = min(int(mark * length), length - 1)
    return [Segment(bar[:at], style), Segment(MARK, VALUE), Segment(bar[at + 1 :], style)]


def grating_lines(frequency: Floats, micro: Floats, width: int) -> list[Line]:
    """Tell the strongest harmonics of gratings, as many as fit a line."""
    if not len(frequency):
        return []
    told = "gratings"
    for k in np.argsort(-micro):
        more = (
            f"{told}{':' if told == 'gratings' else ','} {micro[k]:.2g} µm at {frequency[k]:.3g} Hz"
        )
        if len(more) > width:
            break
        told = more
    return [[Segment(told, LABEL)]]
