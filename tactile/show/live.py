"""The live picture in a terminal: tactile image, drive, one contactor's shear, status.

`LivePicture` takes what is played; ``rich.live.Live(picture, refresh_per_second=15)`` draws it.
Every contactor is a rectangle of characters at its place, seen from above with y upward: the
smallest pitch along x and along y makes a cell, so that contactors of an irregular layout stay
apart. Where the terminal is too small, a cell is the mean of its contactors. Colored cells are
drawn with half blocks, two to a character; without color a cell fills with height instead.

Friction stretches the skin under all contactors alike, by more than most textures move it, and one
color all over would be all that is seen. The image is therefore of what changes along the way: each
contactor's mean over the last `WAY` is taken off. The trace has the whole.
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
Line = list[Segment]

DECAY = 2.0
"""Seconds in which the image's scale falls to 1/e once the contactors move less."""
WAY = 5e-3
"""m of the finger's way after which a mean has forgotten all but 1/e (assumed): waves of 4 mm, the
longest that bands describe, keep 99 % of their height; stretch is gone after a few ways."""
SMALLEST_SCALE = 0.1
"""µm; what skin feels at best (250 Hz), so that less is not made to look like much."""
STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Ends that a scale may have, times powers of ten."""
TALLEST, LOWEST_SIDE, TRACE_LINES = 39, 18, 6
"""Lines of the whole, of drive with trace, and of the trace with its frame."""
TWO_COLUMNS, ONE_LINE = 64, 100
"""Characters from which drive and trace stand beside the image, and the status in one line."""
LARGEST_CELL, SMALLEST_LEGEND = 14, 30
"""Characters."""
SMALLEST_BAR, SMALLEST_FIELD, ROW_LABEL, ROW_PEAK = 4, 11, 6, 6
"""Characters of a bar with a space, of a label with its bar, and around a row of bars."""
NEAR = 1e-6
"""Of the limit: rounding that a bar at the limit may have."""

LEVELS = 65
DIVERGING = "#083096 #2166d2 #5496ec #a0c8f6 #f2f2f2 #fabca2 #f07456 #d8282c #a80016"
"""Colors from the most negative shear to the most positive, evenly spaced."""
HEIGHTS = " ▁▂▃▄▅▆▇█"
PARTS = " ▏▎▍▌▋▊▉"

LABEL = FRAME = Style.parse("bright_black")
VALUE = TITLE = Style.parse("bold")
BADGE = Style.parse("bold reverse")
ALARM = Style.parse("bold bright_red")
TRACE = Style.parse("bright_cyan")
TRACK = Style.parse("on #303030")
CALM, WARM, FULL = (Style.parse(f"{c} on #303030") for c in ("#2bb5a0", "#e6a817", "#e5383b"))
"""Of a bar below 80 % of the limit, above it, and at the limit."""


def pitch(places: Floats) -> tuple[float, float]:
    """Return the smallest distances along x and along y [m] of contactors at places (N, 2) [m].

    Each pair counts for the axis along which it is farther apart, so that no two contactors are
    closer than the pitch along both. A single line has one pitch, a single contactor 1 mm.
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
    """Return y [mm] and the contactors of each row from the top, those from left to right."""
    number = np.rint((places[:, 1].max() - places[:, 1]) / pitch(places)[1])
    order = np.lexsort((places[:, 0], number))
    rows = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    return [(f"{places[row, 1].mean() * 1e3:.1f}".replace("-", "−"), row) for row in rows]


@dataclass(frozen=True)
class Raster:
    """Contactors as cells of pixels.

    Attributes
    ----------
    group : (N,) the cell of each contactor
    size : (G,) how many contactors each cell stands for
    member : (rows, columns) the cell at a pixel, −1 for none; the top row first
    depth : (rows, columns) how many pixels of its cell are below a pixel
    height : pixels of a cell from bottom to top
    """

    group: Indices
    size: Indices
    member: Indices
    depth: Indices
    height: int

    def mean(self, values: Floats) -> Floats:
        """Return (G,) means over the contactors of each cell."""
        return np.asarray(np.bincount(self.group, values) / self.size)


def rasterize(places: Floats, columns: int, rows: int, aspect: float = 1.0) -> Raster:
    """Place contactors at (N, 2) [m] in ``columns`` × ``rows`` pixels, as large as they fit.

    ``aspect`` is the height of a pixel over its width.
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
    """Return the colors of `LEVELS` shears from the most negative to the most positive."""
    colors = [Color.parse(color).get_truecolor() for color in DIVERGING.split()]
    stops = np.linspace(0, LEVELS - 1, len(colors))
    table = [np.interp(np.arange(LEVELS), stops, side) for side in np.transpose(colors)]
    return tuple(Color.from_rgb(*map(round, rgb)) for rgb in np.transpose(table))


@lru_cache(maxsize=(LEVELS + 1) ** 2)
def _half_blocks(top: int, bottom: int) -> tuple[str, Style]:
    """Return what draws two pixels in one character: levels from 1 up, 0 for none."""
    upper, lower = (palette()[k - 1] if k else None for k in (top, bottom))
    if upper is None:
        return (" ", Style.null()) if lower is None else ("▄", Style(color=lower))
    if top == bottom:
        return "█", Style(color=upper)
    return "▀", Style(color=upper, bgcolor=lower)


def color_lines(raster: Raster, part: Floats) -> list[Line]:
    """Draw a cell's shear, −1 … 1 of the scale (G,), as its color."""
    level = np.rint((np.clip(part, -1, 1) + 1) / 2 * (LEVELS - 1)).astype(np.intp)
    shown = np.where(raster.member < 0, 0, level[raster.member] + 1)
    shown = np.pad(shown, ((0, len(shown) % 2), (0, 0)))
    lines: list[Line] = []
    pairs = shown[0::2] * (LEVELS + 1) + shown[1::2]
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
    """Draw a cell's shear, −1 … 1 of the scale (G,), as the height to which it is filled."""
    eighths = np.rint((np.clip(part, -1, 1) + 1) / 2 * (8 * raster.height - 1)) + 1
    fill = np.clip(eighths[raster.member] - 8 * raster.depth, 0, 8) * (raster.member >= 0)
    return [[Segment("".join(HEIGHTS[k] for k in row))] for row in fill.astype(np.intp).tolist()]


def _bar(part: float, width: int, color: bool) -> Line:
    """Draw a part, 0 … 1, of a bar and a space in ``width`` characters; only at 1 is it full."""
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
    """Return labels with bars and values [V], down the columns."""
    columns = -(-len(peaks) // lines)
    each, label = width // columns, max(len(name) for name, _ in peaks) + 1
    told = ROW_PEAK if each >= 2 * SMALLEST_FIELD else 0
    bars: list[Line] = [[] for _ in range(-(-len(peaks) // columns))]
    for k, (name, volt) in enumerate(peaks):
        line = bars[k % len(bars)]
        line.append(Segment(f"{name:>{label - 1}} ", LABEL))
        line.extend(_bar(volt / limit, each - label - told, color))
        if told:
            line.append(Segment(f"{volt:{told - 3}.0f} V ", VALUE))
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
    """Return the next round number from ``value`` up."""
    power = 10.0 ** math.floor(math.log10(value))
    return next((s * power for s in STEPS if s * power >= value * (1 - 1e-9)), 10 * power)


@dataclass(frozen=True)
class _State:
    """What the last update said, in the units that are shown."""

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
    """What a display plays, as a picture in a terminal.

    Parameters
    ----------
    display : the array that plays
    texture : name of what is played
    width : characters to use at most; those of the terminal for None
    sample_rate : of the blocks given to `update` [Hz]

    Attributes
    ----------
    texture : name of what is played; may be changed
    contactor : whose shear is traced, the one nearest to the middle
    rows : y [mm] and the contactors of each row, from the top
    trace : the last second of that contactor
    state : what the last update said
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
        self._rasters: dict[tuple[int, int, bool], Raster] = {}

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
        """Take what was played since the last update.

        Parameters
        ----------
        time_s : of the last sample [s]; where it steps back the trace begins anew
        position : (2,) of the finger [m]
        speed : of the finger [m/s]
        normal_force : of the finger [N]
        shear : (S, N) [m]; the image shows the last sample, less the mean over the way before
        drive : (S, N) [V]
        limited_samples : how many samples the limiter has turned down so far
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
            kept = math.exp(-abs(speed) * len(moved) * self._step / WAY)
            stretch = kept * stretch + (1 - kept) * moved.mean(axis=0)
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
        """Return the contactors' cells in so many characters and lines."""
        key = columns, lines, color
        if key not in self._rasters:
            rows, aspect = (2 * lines, 1.0) if color else (lines, 2.0)
            self._rasters[key] = rasterize(self.places, columns, rows, aspect)
        return self._rasters[key]


class Frame:
    """A `LivePicture` as it is now, laid out for the console that it is drawn on."""

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
        """Return the picture's lines."""
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
        low, high = f"−{scale:g} µm ", f" +{scale:g} µm"
        length = max(min(width - len(low) - len(high), raster.member.shape[1]), 0)
        sweep = np.linspace(0, 1, length)
        ramp = [Segment("▀", Style(color=palette()[round(k * (LEVELS - 1))])) for k in sweep]
        if not color:
            ramp = [Segment(HEIGHTS[round(k * 7) + 1]) for k in sweep]
        before = Segment(" " * ((width - len(low) - len(high) - length) // 2))
        legend = [before, Segment(low, LABEL), *ramp, Segment(high, LABEL)]
        return [*([margin, *line] for line in cells), [], legend]

    def _side(self, width: int, height: int, color: bool) -> list[Line]:
        """Return drive above trace."""
        inner, room = width - 4, height - 4
        title, bars = self._drive(inner, max(room - TRACE_LINES, 1), color)
        trace = self._trace(inner, max(room - len(bars), 2))
        of = f"contactor {self._picture.contactor}, shear in µm"
        return [
            *_panel(title, bars, width, len(bars) + 2),
            *_panel(of, trace, width, height - len(bars) - 2),
        ]

    def _drive(self, width: int, lines: int, color: bool) -> tuple[str, list[Line]]:
        """Return the title and the bars of the drive: each contactor's, or each row's."""
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
        """Return what the bars stand for, and at most so many labels and peaks [V]."""
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
        """Return one line of values, two where the terminal is narrow."""
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
        pairs = [
            [Segment(f" {name} " if name else "", LABEL), Segment(f"{value} ", style)]
            for name, value, style in fields
        ]
        lines = [pairs] if width >= ONE_LINE else [pairs[:3], pairs[3:]]
        return [list(itertools.chain(*line)) for line in lines]
