"""Live picture in a terminal: tactile image, drive, shear of one contactor, and status.

`LivePicture` takes what is played; ``rich.live.Live(picture, refresh_per_second=15)`` draws it.
Every contactor is a rectangle of characters at its place, seen from above with y upward. The
smallest pitch along x and along y makes a cell, so that contactors of an irregular layout stay
apart. If the terminal is too small, a cell is the mean of its contactors. Colored cells are drawn
with half blocks, two to a character; without color a cell is filled to a height instead.

Friction stretches the skin under all contactors alike, by more than most textures move it, so that
the image would be all of one color. The image therefore shows what changes along the path: the mean
of each contactor over the last `WAY` is subtracted. The trace shows the whole shear.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.color import Color
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.show.trace import TraceBins, braille

Indices = NDArray[np.intp]
"""Array of indices."""
Line = list[Segment]
"""Line of a picture, as styled pieces of text."""

DECAY = 2.0
"""Time in which the image's scale falls to 1/e once the contactors move less [s]."""
WAY = 5e-3
"""Path of the finger over which the mean forgets all but 1/e (assumed) [m]. Waves of 4 mm, the
longest that bands describe, keep 99 % of their height; stretch is gone after a few times this
path."""
SMALLEST_SCALE = 0.1
"""Smallest end of a scale, the lowest detection threshold (250 Hz), so that less does not look like
much [µm]."""
STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Ends that a scale may have, times a power of ten."""
TALLEST, LOWEST_SIDE, TRACE_LINES = 39, 18, 6
"""Lines of the whole picture at most, of drive with trace at least, and of the trace with its
frame."""
TWO_COLUMNS, ONE_LINE = 64, 100
"""Widths from which drive and trace stand beside the image, and the status takes one line
[characters]."""
LARGEST_CELL, SMALLEST_LEGEND = 14, 30
"""Largest width of a cell, and smallest width of the legend [characters]."""
SMALLEST_BAR, SMALLEST_FIELD, ROW_LABEL, ROW_PEAK = 4, 11, 6, 6
"""Smallest width of a bar with a space, and of a label with its bar; widths of label and value of a
row of bars [characters]."""
NEAR = 1e-6
"""Rounding error that a bar at the limit may have, as a fraction of the limit."""

LEVELS = 65
"""Number of colors of the palette."""
DIVERGING = "#083096 #2166d2 #5496ec #a0c8f6 #f2f2f2 #fabca2 #f07456 #d8282c #a80016"
"""Colors from the most negative shear to the most positive, evenly spaced."""
HEIGHTS = " ▁▂▃▄▅▆▇█"
"""Characters that are filled from below, by eighths."""
PARTS = " ▏▎▍▌▋▊▉"
"""Characters that are filled from the left, by eighths."""

LABEL = FRAME = Style.parse("bright_black")
VALUE = TITLE = Style.parse("bold")
BADGE = Style.parse("bold reverse")
ALARM = Style.parse("bold bright_red")
TRACE = Style.parse("bright_cyan")
TRACK = Style.parse("on #303030")
CALM, WARM, FULL = (Style.parse(f"{c} on #303030") for c in ("#2bb5a0", "#e6a817", "#e5383b"))
"""Styles of a bar below 80 % of the limit, above it, and at the limit."""


def pitch(places: Floats) -> tuple[float, float]:
    """Compute the smallest distances of contactors along x and along y.

    Each pair counts for the axis along which it is farther apart, so that no two contactors are
    closer than the pitch along both. A single line has one pitch for both axes, a single contactor
    1 mm.

    Parameters
    ----------
    places : (N, 2) array of float
        Places of the contactors [m].

    Returns
    -------
    tuple of 2 floats
        Pitch along x and along y [m].
    """
    gap = np.abs(places[:, None] - places)
    beside = gap[..., 0] >= gap[..., 1]
    above = ~beside
    np.fill_diagonal(beside, False)
    x = float(gap[..., 0].min(initial=math.inf, where=beside))
    y = float(gap[..., 1].min(initial=math.inf, where=above))
    if math.isinf(x) and math.isinf(y):
        return 1e-3, 1e-3
    return y if math.isinf(x) else x, x if math.isinf(y) else y


def _rows(places: Floats) -> list[tuple[str, Indices]]:
    """Return y [mm] and the contactors of each row from the top, each row from left to right."""
    number = np.rint((places[:, 1].max() - places[:, 1]) / pitch(places)[1])
    order = np.lexsort((places[:, 0], number))
    rows = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    return [(f"{places[row, 1].mean() * 1e3:.1f}".replace("-", "−"), row) for row in rows]


@dataclass(frozen=True)
class Raster:
    """Contactors as cells of pixels.

    Attributes
    ----------
    group : (N,) array of int
        Cell of each contactor.
    size : (G,) array of int
        Number of contactors that each cell stands for.
    member : (rows, columns) array of int
        Cell at each pixel, −1 for none; the top row is the first.
    depth : (rows, columns) array of int
        Number of pixels of the same cell below each pixel.
    height : int
        Height of a cell [pixels].
    """

    group: Indices
    size: Indices
    member: Indices
    depth: Indices
    height: int

    def mean(self, values: Floats) -> Floats:
        """Average over the contactors of each cell.

        Parameters
        ----------
        values : (N,) array of float
            Value of each contactor.

        Returns
        -------
        (G,) array of float
            Mean of each cell.
        """
        return np.asarray(np.bincount(self.group, values) / self.size)


def rasterize(places: Floats, columns: int, rows: int, aspect: float = 1.0) -> Raster:
    """Place contactors in a raster, as large as they fit.

    Parameters
    ----------
    places : (N, 2) array of float
        Places of the contactors [m].
    columns : int
        Largest number of pixels across.
    rows : int
        Largest number of pixels down.
    aspect : float
        Height of a pixel over its width.

    Returns
    -------
    Raster
        Cells of the contactors.
    """
    unit = np.array(pitch(places))
    low = places.min(axis=0)
    count = (places.max(axis=0) - low) / unit + 1
    room, shape = np.array([columns, rows]), np.array([1.0, aspect])
    scale = min(np.min(room * shape / (count * unit)), LARGEST_CELL / unit.max())
    cell = np.minimum(np.rint(scale * unit / shape), np.floor(room / count + 1e-6))
    cell = np.maximum(cell, 1).astype(np.intp)
    share = np.ceil(count / room - 1e-6)
    at = np.floor((places - low) / (unit * share) * cell + 1e-6).astype(np.intp)
    _, first, group, size = np.unique(
        at, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    (width, height), (right, top) = cell, at.max(axis=0) + cell
    member = np.full((top, right), -1)
    depth = np.zeros((top, right), np.intp)
    gap = width > 2
    drawn_width, drawn_height = width - gap, height - (gap and height > 2)
    for index, (x, y) in enumerate(at[first]):
        block = slice(top - y - drawn_height, top - y), slice(x, x + drawn_width)
        member[block] = index
        depth[block] = np.arange(drawn_height)[::-1, None]
    return Raster(group.ravel(), size, member, depth, int(drawn_height))


@lru_cache(maxsize=1)
def palette() -> tuple[Color, ...]:
    """Return the colors of `LEVELS` shears from the most negative to the most positive.

    Returns
    -------
    tuple of Color
        Colors, evenly spaced in shear.
    """
    colors = [Color.parse(color).get_truecolor() for color in DIVERGING.split()]
    stops = np.linspace(0, LEVELS - 1, len(colors))
    table = [np.interp(np.arange(LEVELS), stops, side) for side in np.transpose(colors)]
    return tuple(Color.from_rgb(*map(round, rgb)) for rgb in np.transpose(table))


@lru_cache(maxsize=(LEVELS + 1) ** 2)
def _half_blocks(top: int, bottom: int) -> tuple[str, Style]:
    """Return character and style of two pixels, upper and lower: levels from 1 up, 0 for none."""
    upper, lower = (palette()[k - 1] if k else None for k in (top, bottom))
    if upper is None:
        return (" ", Style.null()) if lower is None else ("▄", Style(color=lower))
    if top == bottom:
        return "█", Style(color=upper)
    return "▀", Style(color=upper, bgcolor=lower)


def color_lines(raster: Raster, part: Floats) -> list[Line]:
    """Draw the shear of cells as their color.

    Parameters
    ----------
    raster : Raster
        Cells to draw.
    part : (G,) array of float
        Shear of each cell as a part of the scale, −1 … 1.

    Returns
    -------
    list of Line
        Lines of the picture.
    """
    level = np.rint((np.clip(part, -1, 1) + 1) / 2 * (LEVELS - 1)).astype(np.intp)
    codes = np.where(raster.member < 0, 0, level[raster.member] + 1)
    codes = np.pad(codes, ((0, len(codes) % 2), (0, 0)))
    lines: list[Line] = []
    pairs = codes[0::2] * (LEVELS + 1) + codes[1::2]
    for k, pair in enumerate(pairs):
        if k and np.array_equal(pair, pairs[k - 1]):
            lines.append(lines[-1])
            continue
        lines.append([])
        for code, run in itertools.groupby(pair.tolist()):
            sign, style = _half_blocks(*divmod(code, LEVELS + 1))
            lines[-1].append(Segment(sign * len(list(run)), style))
    return lines


def height_lines(raster: Raster, part: Floats) -> list[Line]:
    """Draw the shear of cells as the height to which they are filled.

    Parameters
    ----------
    raster : Raster
        Cells to draw.
    part : (G,) array of float
        Shear of each cell as a part of the scale, −1 … 1.

    Returns
    -------
    list of Line
        Lines of the picture.
    """
    eighths = np.rint((np.clip(part, -1, 1) + 1) / 2 * (8 * raster.height - 1)) + 1
    fill = np.clip(eighths[raster.member] - 8 * raster.depth, 0, 8) * (raster.member >= 0)
    return [[Segment("".join(HEIGHTS[k] for k in row))] for row in fill.astype(np.intp).tolist()]


def scale_line(end: float, width: int, longest: int, *, color: bool) -> Line:
    """Draw the scale of colors or heights between its ends.

    Parameters
    ----------
    end : float
        End of the symmetric scale [µm].
    width : int
        Largest width with the labels of the ends [characters].
    longest : int
        Largest width of the colors or heights [characters].
    color : bool
        Whether to draw in color.

    Returns
    -------
    Line
        Scale with its labels.
    """
    low, high = f"−{end:g} µm ", f" +{end:g} µm"
    sweep = np.linspace(0, 1, max(min(width - len(low) - len(high), longest), 0))
    ramp = [Segment("▀", Style(color=palette()[round(k * (LEVELS - 1))])) for k in sweep]
    if not color:
        ramp = [Segment(HEIGHTS[round(k * 7) + 1]) for k in sweep]
    return [Segment(low, LABEL), *ramp, Segment(high, LABEL)]


def _bar(part: float, width: int, color: bool) -> Line:
    """Draw a part, 0 … 1, as a bar and a space in ``width`` characters; it is full only at 1."""
    width, part = width - 1, min(part + NEAR, 1.0) if part > 0 else 0.0
    eighths = int(part * 8 * width)
    whole, rest = divmod(max(eighths, int(part > 0)), 8)
    style = FULL if part >= 1 else WARM if part >= 0.8 else CALM
    filled = "█" * whole + (PARTS[rest] if rest else "")
    empty = width - len(filled)
    track = Segment(" " * empty, TRACK) if color else Segment("·" * empty, LABEL)
    return [Segment(filled, style), track, Segment(" ")]


def _flow(
    peaks: list[tuple[str, float]], limit: float, width: int, lines: int, color: bool
) -> list[Line]:
    """Return labels with bars and values [V], arranged in columns."""
    columns = -(-len(peaks) // lines)
    each, label = width // columns, max(len(name) for name, _ in peaks) + 1
    value_width = ROW_PEAK if each >= 2 * SMALLEST_FIELD else 0
    bars: list[Line] = [[] for _ in range(-(-len(peaks) // columns))]
    for k, (name, volt) in enumerate(peaks):
        line = bars[k % len(bars)]
        line.append(Segment(f"{name:>{label - 1}} ", LABEL))
        line.extend(_bar(volt / limit, each - label - value_width, color))
        if value_width:
            line.append(Segment(f"{volt:{value_width - 3}.0f} V ", VALUE))
    return bars


def _panel(title: str, body: list[Line], width: int, height: int) -> list[Line]:
    """Frame lines in ``width`` × ``height`` characters, borders included."""
    title = title[: width - 5]
    left, right = Segment("│ ", FRAME), Segment(" │", FRAME)
    rest = "─" * (width - 5 - len(title))
    top = [Segment("╭─ ", FRAME), Segment(title, TITLE), Segment(f" {rest}╮", FRAME)]
    inside = [*body, *([[]] * height)][: height - 2]
    framed = ([left, *Segment.adjust_line_length(line, width - 4), right] for line in inside)
    return [top, *framed, [Segment(f"╰{'─' * (width - 2)}╯", FRAME)]]


def nice(value: float) -> float:
    """Round up to the next round number.

    Parameters
    ----------
    value : float
        Number to round, above 0.

    Returns
    -------
    float
        Smallest of `STEPS`, times a power of ten, that is not below the value.
    """
    power = 10.0 ** math.floor(math.log10(value))
    return next((s * power for s in STEPS if s * power >= value * (1 - 1e-9)), 10 * power)


@dataclass(frozen=True)
class _State:
    """Content of the last update, in the units that are drawn."""

    time_s: float
    place_mm: tuple[float, float]
    speed_mm_s: float
    normal_force_n: float
    image_um: Floats
    drive_v: Floats
    limited_samples: int
    stretch_um: Floats
    peak_um: float = SMALLEST_SCALE


class LivePicture:
    """Picture of what a display plays, for a terminal.

    Parameters
    ----------
    display : Display
        Display that plays.
    texture : str
        Name of what is played.
    width : int or None
        Largest width of the picture; that of the terminal for None [characters].
    sample_rate : float
        Sample rate of the blocks given to `update` [Hz].

    Attributes
    ----------
    texture : str
        Name of what is played; may be changed.
    name : str
        Name of the display.
    places : (N, 2) array of float
        Places of the contactors [m].
    limit : float
        Voltage limit of the drive [V].
    width : int or None
        Largest width of the picture [characters].
    contactor : int
        Contactor whose shear is traced, the one nearest to the middle.
    rows : list of (str, array of int)
        y [mm] and the contactors of each row, from the top.
    trace : TraceBins
        Shear of that contactor in the last second [µm].
    state : _State
        Content of the last update.
    finger : str
        What is known of a finger that is followed; empty if none is.
    """

    def __init__(
        self, display: Display, *, texture: str, width: int | None = None, sample_rate: float = 8e3
    ) -> None:
        self.texture, self.name = texture, display.name
        self.places, self.limit = display.contactors, display.limits.voltage
        self.width, self._step = width, 1 / sample_rate
        self.rows = _rows(self.places)
        middle = (self.places.min(axis=0) + self.places.max(axis=0)) / 2
        self.contactor = int(np.argmin(np.linalg.norm(self.places - middle, axis=1)))
        self.trace = TraceBins()
        nothing = np.zeros(len(self.places))
        self.state = _State(0.0, (0.0, 0.0), 0.0, 0.0, nothing, nothing, 0, nothing)
        self.finger = ""
        self._rasters: dict[tuple[int, int, bool], Raster] = {}

    def follow(
        self, touching: NDArray[np.bool_], deviation: Floats, guarded: NDArray[np.bool_]
    ) -> None:
        """Show what is known of a finger that is followed.

        Parameters
        ----------
        touching : (N,) array of bool
            Whether a finger is on the contactor.
        deviation : (N,) array of float
            Standard deviation of the level of its shear [dB].
        guarded : (N,) array of bool
            Whether a guard has turned the contactor down.
        """
        self.finger = f"on {np.count_nonzero(touching)} of {len(touching)}"
        if touching.any():
            self.finger += f" ± {np.median(deviation[touching]):.1f} dB"
        if guarded.any():
            self.finger += f", {np.count_nonzero(guarded)} guarded"

    def update(
        self,
        time_s: float,
        position: Sequence[float] | Floats,
        speed: float,
        normal_force: float,
        shear: ArrayLike,
        drive: ArrayLike,
        limited_samples: int,
    ) -> None:
        """Add what was played since the last update.

        Parameters
        ----------
        time_s : float
            Time of the last sample; if it steps back, the trace starts anew [s].
        position : (2,) sequence of float
            Position of the finger [m].
        speed : float
            Speed of the finger [m/s].
        normal_force : float
            Normal force of the finger [N].
        shear : (S, N) array_like of float
            Shear; the image shows the last sample, less the mean over the path before [m].
        drive : (S, N) array_like of float
            Drive [V].
        limited_samples : int
            Number of samples that the limiter has turned down so far.
        """
        moved = np.nan_to_num(np.asarray(shear, np.float64), posinf=0.0, neginf=0.0) * 1e6
        volts = np.nan_to_num(np.asarray(drive, np.float64))
        old = self.state
        faded = old.peak_um * math.exp(-max(time_s - old.time_s, 0.0) / DECAY)
        image, peaks, stretch = old.image_um, old.drive_v, old.stretch_um
        if normal_force <= 0 or time_s < old.time_s:
            stretch = np.zeros_like(stretch)
        if len(moved):
            image, peaks = moved[-1] - stretch, np.abs(volts).max(axis=0)
            remaining = math.exp(-abs(speed) * len(moved) * self._step / WAY)
            stretch = remaining * stretch + (1 - remaining) * moved.mean(axis=0)
            self.trace.add(moved[:, self.contactor], time_s, self._step)
        self.state = _State(
            time_s,
            place_mm=(float(position[0]) * 1e3, float(position[1]) * 1e3),
            speed_mm_s=speed * 1e3,
            normal_force_n=normal_force,
            image_um=image,
            drive_v=peaks,
            limited_samples=limited_samples,
            stretch_um=stretch,
            peak_um=max(float(np.abs(image).max()), faded, SMALLEST_SCALE),
        )

    def __rich__(self) -> "Frame":
        return Frame(self)

    def raster(self, columns: int, lines: int, color: bool) -> Raster:
        """Return the raster of the contactors for a size.

        Parameters
        ----------
        columns : int
            Width [characters].
        lines : int
            Height [lines].
        color : bool
            Whether cells are drawn in color, with two pixels to a character.

        Returns
        -------
        Raster
            Cells of the contactors.
        """
        key = columns, lines, color
        if key not in self._rasters:
            rows, aspect = (2 * lines, 1.0) if color else (lines, 2.0)
            self._rasters[key] = rasterize(self.places, columns, rows, aspect)
        return self._rasters[key]


class Frame:
    """Present state of a `LivePicture`, laid out for the console that it is drawn on.

    Parameters
    ----------
    picture : LivePicture
        Picture to draw.
    """

    def __init__(self, picture: LivePicture) -> None:
        self._picture, self._state = picture, picture.state

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(self._picture.width or options.max_width, options.max_width)
        height = min(options.height or options.max_height - 1, TALLEST)
        color = console.color_system is not None and not console.no_color
        for line in self._lines(width, height, color):
            yield from line
            yield Segment.line()

    def _lines(self, width: int, height: int, color: bool) -> list[Line]:
        """Return the lines of the picture."""
        status = self._status(width)
        room, wide = max(height - 1 - len(status), 6), width >= TWO_COLUMNS
        most = (width * 9 // 20 if wide else width) - 4
        raster = self._picture.raster(most, room - 4, color)
        inner = max(raster.member.shape[1], SMALLEST_LEGEND) if wide else most
        image = self._image(raster, inner, color)
        tall = max(len(image) + 2, min(room, LOWEST_SIDE)) if wide else len(image) + 2
        title = "tactile image" if raster.size.max() == 1 else "tactile image, cells averaged"
        above: list[Line] = [[]] * ((tall - 2 - len(image)) // 2)
        body = _panel(title, above + image, inner + 4, tall)
        if wide:
            side = self._side(width - inner - 4, tall, color)
            body = [left + right for left, right in zip(body, side, strict=True)]
        name = f" {self._picture.name} · {self._picture.texture}"
        header = [Segment(" tactile ", BADGE), Segment(name, TITLE)]
        around = (Segment.adjust_line_length(line, width) for line in (header, *status))
        return [next(around), *body, *around]

    def _image(self, raster: Raster, width: int, color: bool) -> list[Line]:
        """Return the tactile image above its legend, centered in ``width`` characters."""
        scale = nice(self._state.peak_um)
        part = raster.mean(self._state.image_um) / scale
        cells = color_lines(raster, part) if color else height_lines(raster, part)
        margin = Segment(" " * ((width - raster.member.shape[1]) // 2))
        legend = scale_line(scale, width, raster.member.shape[1], color=color)
        before = Segment(" " * ((width - Segment.get_line_length(legend)) // 2))
        return [*([margin, *line] for line in cells), [], [before, *legend]]

    def _side(self, width: int, height: int, color: bool) -> list[Line]:
        """Return the panels of drive and trace, one above the other."""
        inner, room = width - 4, height - 4
        title, bars = self._drive(inner, max(room - TRACE_LINES, 1), color)
        trace = self._trace(inner, max(room - len(bars), 2))
        of = f"contactor {self._picture.contactor}, shear in µm"
        return [
            *_panel(title, bars, width, len(bars) + 2),
            *_panel(of, trace, width, height - len(bars) - 2),
        ]

    def _drive(self, width: int, lines: int, color: bool) -> tuple[str, list[Line]]:
        """Return title and bars of the drive: one bar per contactor, or per row."""
        rows, limit = self._picture.rows, self._picture.limit
        most, full = max(len(row) for _, row in rows), f"full bar {limit:g} V"
        each = (width - ROW_LABEL - ROW_PEAK) // most
        if each >= SMALLEST_BAR and len(rows) <= lines:
            parts = self._state.drive_v / limit
            bars = [
                [
                    Segment(f"{y:>{ROW_LABEL - 1}} ", LABEL),
                    *(part for k in row for part in _bar(parts[k], each, color)),
                    Segment(" " * (each * (most - len(row)))),
                    Segment(f"{parts[row].max() * limit:{ROW_PEAK - 2}.0f} V", VALUE),
                ]
                for y, row in rows
            ]
            spaced = [line for bar in bars for line in (bar, [])][:-1]
            return f"drive by row (y in mm), {full}", spaced if len(spaced) <= lines else bars
        title, peaks = self._groups(lines * (width // SMALLEST_FIELD))
        return f"drive by {title}, {full}", _flow(peaks, limit, width, lines, color)

    def _groups(self, most: int) -> tuple[str, list[tuple[str, float]]]:
        """Return what the bars stand for, and at most ``most`` labels and peaks [V]."""
        volts, rows = self._state.drive_v, self._picture.rows
        if len(volts) <= most:
            return "contactor", [(str(k), float(volt)) for k, volt in enumerate(volts)]
        merged = -(-len(rows) // most)
        joined = [rows[k : k + merged] for k in range(0, len(rows), merged)]
        peaks = [(part[0][0], max(float(volts[row].max()) for _, row in part)) for part in joined]
        return "row (y in mm)", peaks

    def _trace(self, width: int, lines: int) -> list[Line]:
        """Return the trace of one contactor with its scale."""
        labels = 5
        low, high = self._picture.trace.envelope(2 * (width - labels - 1))
        peak = np.fmax.reduce(np.fmax(high, -low), initial=SMALLEST_SCALE)
        scale = nice(float(peak))
        rows = braille(low / scale, high / scale, lines - 1)
        names = [""] * len(rows)
        names[len(rows) // 2] = "0"
        names[-1], names[0] = f"−{scale:g}", f"+{scale:g}"
        axis = " " * labels + " −1 s" + "now".rjust(width - labels - 5)
        named = zip(names, rows, strict=True)
        curve = [[Segment(f"{name:>{labels}} ", LABEL), Segment(row, TRACE)] for name, row in named]
        return [*curve, [Segment(axis, LABEL)]]

    def _status(self, width: int) -> list[Line]:
        """Return one line of values, or two in a narrow terminal."""
        s, limit = self._state, self._picture.limit
        x, y = s.place_mm
        drive = float(s.drive_v.max(initial=0.0))
        fields = [
            ("", f"{s.time_s:6.2f} s", VALUE),
            ("place", f"{x:5.1f} {y:5.1f} mm", VALUE),
            ("", f"{s.speed_mm_s:4.0f} mm/s", VALUE),
            ("force", f"{s.normal_force_n:4.2f} N", VALUE),
            ("drive", f"{drive:5.1f} of {limit:g} V", VALUE if drive < limit else ALARM),
            ("limited", f"{s.limited_samples:d}", ALARM if s.limited_samples else VALUE),
        ]
        if self._picture.finger:
            fields.append(("finger", self._picture.finger, VALUE))
        pairs = [
            [Segment(f" {name} " if name else "", LABEL), Segment(f"{value} ", style)]
            for name, value, style in fields
        ]
        fits = width >= ONE_LINE and not self._picture.finger
        lines = [pairs] if fits else [pairs[:3], pairs[3:]]
        return [list(itertools.chain(*line)) for line in lines]
