"""Tests of the live picture: its contents, and that it fits."""

import io
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.live import Live
from rich.segment import Segment

from tactile.arrays import Floats
from tactile.display.display import Display, load_display
from tactile.show import live as terminal
from tactile.show.live import LivePicture, nice, pitch, rasterize
from tactile.show.trace import TraceBins, braille

Pixels = dict[tuple[int, int], tuple[int, int, int]]

SMALL, LARGE = load_display("reference-24"), load_display("reference-64")
BLOCK = 64


def placed(places: Floats) -> Display:
    """Return a display whose contactors stand elsewhere."""
    return replace(SMALL, contactors=places, name=f"placed-{len(places)}")


def grid(columns: int, rows: int) -> Floats:
    x, y = np.meshgrid(np.arange(columns) * 2.5e-3, np.arange(rows) * 3.5e-3)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def hexagonal(columns: int, rows: int) -> Floats:
    places = grid(columns, rows)
    places[:, 0] += np.where(np.rint(places[:, 1] / 3.5e-3) % 2 == 1, 1.25e-3, 0)
    return places


def scattered(count: int) -> Floats:
    rng, places = np.random.default_rng(5), np.zeros((0, 2))
    while len(places) < count:
        place = rng.uniform(0, 30e-3, 2)
        if np.all(np.abs(places - place).max(axis=1, initial=0) > 3e-3):
            places = np.vstack([places, place])
    return places


DISPLAYS = {
    "24": SMALL,
    "64": LARGE,
    "1024": placed(grid(32, 32)),
    "hexagonal": placed(hexagonal(7, 6)),
    "scattered": placed(scattered(20)),
    "line": placed(grid(1, 9)),
    "one": placed(grid(1, 1)),
}


def shown(
    display: Display,
    *,
    shear_um: Floats | None = None,
    drive: Floats | None = None,
    limited: int = 0,
) -> LivePicture:
    """Return a picture after one block in which nothing changes."""
    nothing = np.zeros(len(display.contactors))
    picture = LivePicture(display, texture="wood-oak")
    picture.update(
        12.5,
        (0.0432, -0.0101),
        0.08,
        0.55,
        np.tile(nothing if shear_um is None else shear_um, (BLOCK, 1)) * 1e-6,
        np.tile(nothing if drive is None else drive, (BLOCK, 1)),
        limited,
    )
    return picture


def drawn(
    picture: LivePicture, *, width: int = 100, height: int = 25, color: bool = True
) -> list[list[Segment]]:
    """Return the lines as rich draws them."""
    console = Console(
        file=io.StringIO(),
        force_terminal=True,
        width=width,
        height=height,
        color_system="truecolor" if color else None,
    )
    lines = console.render_lines(picture, pad=False)
    return lines[:-1] if not lines[-1] else lines


def text(lines: list[list[Segment]]) -> list[str]:
    return ["".join(segment.text for segment in line) for line in lines]


def legend(page: list[str]) -> int:
    """Return which line is the legend of the image."""
    return next(k for k, line in enumerate(page) if re.search(r"−[\d.]+ µm ", line))


def pixels(lines: list[list[Segment]]) -> Pixels:
    """Return the colors of the image by column and half line, upward."""
    found: Pixels = {}
    page = text(lines)
    for k in range(2, legend(page)):
        frame, signs = page[k].index("│", 1), [(s.style, c) for s in lines[k] for c in s.text]
        for column, (style, sign) in enumerate(signs[:frame]):
            for half, (front, back) in enumerate((("█▀", "▄"), ("█▄", "▀"))):
                if style is not None and sign in front + back:
                    color = style.color if sign in front else style.bgcolor
                    if color is not None and color.triplet is not None:
                        found[column, -2 * k - half] = color.triplet
    return found


def place_of(cell: list[tuple[int, int]], every: Pixels) -> Floats:
    """Return the middle of a cell, 0 … 1 over all cells' left, right, bottom and top."""
    all_cells, mine = np.array(list(every)), np.array(cell)
    low, high = all_cells.min(axis=0), all_cells.max(axis=0)
    return np.asarray((mine.mean(axis=0) - low) / (high - low))


@pytest.mark.parametrize("name", ["24", "64", "hexagonal", "scattered"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("contactor", [0, 5, 13, -1])
def test_the_largest_shear_is_the_deepest_cell_at_its_place(
    name: str, sign: int, contactor: int
) -> None:
    display = DISPLAYS[name]
    shear = sign * np.linspace(-0.5, 0.5, len(display.contactors))
    shear[contactor] = sign * 3.0
    colors = pixels(drawn(shown(display, shear_um=shear)))
    redness = {at: sign * (rgb[0] - rgb[2]) - 0.5 * rgb[1] for at, rgb in colors.items()}
    most = max(redness.values())
    cell = [at for at, value in redness.items() if value == most]
    places = display.contactors - display.contactors.min(axis=0)
    wanted = places[contactor] / np.ptp(display.contactors, axis=0)
    # a cell's middle is off its contactor's place by at most half a cell of at least four
    assert np.abs(place_of(cell, colors) - wanted).max() < 0.15
    assert 0 < len(cell) < len(colors) / len(places) * 1.5


def test_positive_is_red_negative_blue_and_zero_white() -> None:
    shear = np.zeros(24)
    shear[0], shear[23] = 4.0, -4.0
    colors = pixels(drawn(shown(SMALL, shear_um=shear)))
    low = colors[min(colors, key=lambda at: (at[1], at[0]))]
    high = colors[max(colors, key=lambda at: (at[1], at[0]))]
    assert low[0] > 120 > 60 > low[2]
    assert high[2] > 120 > 60 > high[0]
    assert sorted(set(colors.values())) == sorted({low, high, (242, 242, 242)})


def stroked(stretch_um: float, millimeters: int, *, force: float = 0.5) -> LivePicture:
    """Return a picture after a stroke at 80 mm/s over waves of 4 mm, on a skin that is stretched.

    The waves are 1 µm high and run along x.
    """
    picture, speed = LivePicture(SMALL, texture="waves"), 0.08
    step = speed / 8000
    for k in range(round(millimeters * 1e-3 / (BLOCK * step))):
        way = step * np.arange(k * BLOCK, (k + 1) * BLOCK)[:, None]
        waves = np.cos(2 * np.pi * (way + SMALL.contactors[:, 0]) / 4e-3)
        place = (float(way[-1, 0]), 0.0)
        shear = (waves + stretch_um) * 1e-6
        picture.update(way[-1, 0] / speed, place, speed, force, shear, 0 * shear, 0)
    return picture


@pytest.mark.parametrize("stretch_um", [-5.0, 12.0])
def test_a_stretch_of_all_contactors_changes_no_cell(stretch_um: float) -> None:
    evenly, stretched = stroked(0.0, 60), stroked(stretch_um, 60)
    colors = pixels(drawn(evenly))
    scale = 0.1  # µm, what skin feels at best
    for picture in (evenly, stretched):  # what the first ways showed has decayed
        picture.state = replace(
            picture.state, peak_um=max(abs(picture.state.image_um).max(), scale)
        )
    assert pixels(drawn(stretched)) == pixels(drawn(evenly))
    assert len(set(colors.values())) > 3, "waves are seen"


def test_waves_of_4_mm_keep_their_height_beside_a_stretch() -> None:
    picture = stroked(-5.0, 60)
    x, way = SMALL.contactors[:, 0], picture.state.place_mm[0] * 1e-3
    waves = np.cos(2 * np.pi * (way + x) / 4e-3)
    # a low-pass of first order over 5 mm lets 4 / (2π 5) = 13 % of the waves into the mean
    assert picture.state.image_um == pytest.approx(waves, abs=0.14)


def test_a_finger_that_rests_keeps_its_image_and_one_that_left_has_no_stretch() -> None:
    picture, still = stroked(-5.0, 60), np.zeros((BLOCK, len(SMALL.contactors)))
    shear = np.tile((picture.state.image_um + picture.state.stretch_um) * 1e-6, (BLOCK, 1))
    picture.update(1.0, (0.06, 0.0), 0.0, 0.5, shear, still, 0)
    before = picture.state.image_um
    for k in range(250):
        picture.update(1.0 + 8e-3 * k, (0.06, 0.0), 0.0, 0.5, shear, still, 0)
    assert np.array_equal(picture.state.image_um, before)
    picture.update(4.0, (0.06, 0.0), 0.0, 0.0, still, still, 0)
    assert not picture.state.image_um.any()


def test_every_contactor_of_an_irregular_layout_has_a_cell_of_its_own() -> None:
    for places in (scattered(20), hexagonal(7, 6), grid(6, 4)):
        raster = rasterize(places, 60, 60)
        area = np.bincount(raster.member[raster.member >= 0])
        assert len(area) == len(places)
        assert len(set(area.tolist())) == 1
        assert raster.size.tolist() == [1] * len(places)


def test_a_cell_is_placed_as_its_contactor_stands() -> None:
    places = scattered(20)
    raster = rasterize(places, 200, 200)
    at = np.array([np.argwhere(raster.member == k).mean(axis=0) for k in raster.group])
    across = np.corrcoef(at[:, 1], places[:, 0])[0, 1]
    up = np.corrcoef(-at[:, 0], places[:, 1])[0, 1]
    assert min(across, up) > 0.999


def test_pitch() -> None:
    assert pitch(grid(6, 4)) == pytest.approx((2.5e-3, 3.5e-3))
    assert pitch(hexagonal(6, 4)) == pytest.approx((2.5e-3, 3.5e-3))
    assert pitch(grid(1, 5)) == pytest.approx((3.5e-3, 3.5e-3))
    assert pitch(grid(5, 1)) == pytest.approx((2.5e-3, 2.5e-3))
    assert pitch(grid(1, 1)) == (1e-3, 1e-3)


def test_where_cells_do_not_fit_they_are_means() -> None:
    places = grid(32, 32)
    raster = rasterize(places, 20, 16)
    assert raster.member.shape[0] <= 16
    assert raster.member.shape[1] <= 20
    assert raster.size.sum() == 1024
    assert raster.size.max() == 4
    values = np.random.default_rng(1).normal(size=1024)
    mean = raster.mean(values)
    for cell in (0, 37, len(mean) - 1):
        assert mean[cell] == pytest.approx(values[raster.group == cell].mean())
    assert "cells averaged" in "".join(text(drawn(shown(DISPLAYS["1024"]), height=14)))


@pytest.mark.parametrize("name", DISPLAYS)
@pytest.mark.parametrize("color", [True, False])
@pytest.mark.parametrize("size", [(100, 40), (100, 25), (80, 24), (64, 16), (63, 24), (40, 12)])
def test_the_picture_fits(name: str, color: bool, size: tuple[int, int]) -> None:
    display = DISPLAYS[name]
    count = len(display.contactors)
    picture = shown(
        display, shear_um=np.linspace(-123, 123, count), drive=np.linspace(-99, 99, count)
    )
    console = Console(
        file=io.StringIO(),
        force_terminal=True,
        width=size[0],
        height=size[1],
        color_system="truecolor" if color else None,
    )
    # before rich crops, so that nothing is lost
    frame = picture.__rich__()
    lines = list(Segment.split_lines(frame.__rich_console__(console, console.options)))  # type: ignore[arg-type]
    assert len(lines) < size[1]
    assert max(Segment.get_line_length(line) for line in lines) <= size[0]
    frames = [line for line in text(lines) if line.endswith(("│", "╮", "╯"))]
    assert {len(line) for line in frames} == {size[0]}


def test_the_width_is_the_smaller_of_what_was_asked_for_and_the_terminals() -> None:
    for asked, width in ((70, 70), (200, 100)):
        picture = LivePicture(SMALL, texture="wood-oak", width=asked)
        assert max(len(line) for line in text(drawn(picture))) == width


def side(page: list[str]) -> list[str]:
    """Return the lines in the frames beside the image."""
    return [line.split("│")[-2] for line in page if line.count("│") == 4]


def bars(picture: LivePicture, *, width: int = 100) -> list[list[str]]:
    """Return the bars of each row without color, from the top."""
    sides = side(text(drawn(picture, width=width, color=False)))
    return [line.split()[1:-2] for line in sides if line.rstrip().endswith(" V")]


@pytest.mark.parametrize("display", [SMALL, LARGE])
@pytest.mark.parametrize("volts", [100.0, -100.0, float(np.float32(100.0)) - 1e-5])
def test_a_bar_at_the_limit_is_full(display: Display, volts: float) -> None:
    columns = len(np.unique(display.contactors[:, 0]))
    drive = np.full(len(display.contactors), 0.99 * volts)
    drive[columns + 2] = volts
    rows = bars(shown(display, drive=drive))
    full = [(y, x) for y, row in enumerate(rows) for x, bar in enumerate(row) if set(bar) == {"█"}]
    assert full == [(len(rows) - 2, 2)]


def test_bars_grow_with_the_peak_of_the_block() -> None:
    picture = shown(SMALL)
    drive = np.zeros((BLOCK, 24))
    drive[7] = np.linspace(0, -90, 24)
    picture.update(12.6, (0, 0), 0, 0, np.zeros((BLOCK, 24)), drive, 0)
    length = [bar.count("█") for row in reversed(bars(picture)) for bar in row]
    assert length == sorted(length)
    assert length[0] == 0
    assert length[-1] == int(0.9 * len(bars(picture)[0][0]))
    assert "drive  90.0 of 100 V" in text(drawn(picture))[-1]


def test_an_idle_bar_is_empty_and_a_little_drive_is_seen() -> None:
    drive = np.zeros(24)
    drive[0] = 0.01
    rows = bars(shown(SMALL, drive=drive))
    assert rows[-1][0].startswith("▏")
    assert {sign for row in rows for bar in row for sign in bar} == {"▏", "·"}


def test_many_contactors_share_a_bar_per_row() -> None:
    drive = np.zeros(1024)
    drive[3 * 32 + 17] = 77.0
    picture = shown(DISPLAYS["1024"], drive=drive)
    for width, height in ((100, 40), (80, 24)):
        page = text(drawn(picture, width=width, height=height, color=False))
        assert any("drive by row (y in mm)" in line for line in page)
        (line,) = [line for line in side(page) if "█" in line]
        # row 3 stands at 10.5 mm, where it shares a bar with the row above it: at 14.0 mm
        assert "10.5 █" in line or "14.0 █" in line


def test_without_color_height_tells_shear_and_nothing_is_colored() -> None:
    shear = np.linspace(-3, 3, 64)
    picture = shown(LARGE, shear_um=shear)
    out = io.StringIO()
    Console(file=out, force_terminal=True, width=100, height=40, color_system=None).print(picture)
    assert "38;" not in out.getvalue()
    image = [line[2:40] for line in text(drawn(picture, height=40, color=False))[2:-1]]
    blocks = "".join(image)
    assert set("▁▂▃▄▅▆▇█") <= set(blocks)
    raster = picture.raster(41, 33, False)
    filled = terminal.height_lines(raster, raster.mean(shear) / 3)
    size = [0.0] * 64
    for y, line in enumerate(text(filled)):
        for x, sign in enumerate(line):
            if raster.member[y, x] >= 0:
                size[raster.member[y, x]] += " ▁▂▃▄▅▆▇█".index(sign)
    by_contactor = [size[k] for k in raster.group]
    assert by_contactor == sorted(by_contactor)
    assert by_contactor[0] < 0.1 * by_contactor[-1]


def test_no_color_is_heeded() -> None:
    console = Console(
        file=io.StringIO(), force_terminal=True, width=100, color_system="truecolor", no_color=True
    )
    page = text(console.render_lines(shown(SMALL, shear_um=np.linspace(-3, 3, 24)), pad=False))
    assert "▃" in "".join(page)


def test_the_scale_holds_the_largest_shear_and_decays_slowly() -> None:
    shear = np.zeros(24)
    shear[4] = -2.4
    picture = shown(SMALL, shear_um=shear)

    def scale(after: float, micro: float) -> str:
        block = np.full((BLOCK, 24), micro * 1e-6)
        picture.update(12.5 + after, (0, 0), 0, 0, block, np.zeros((BLOCK, 24)), 0)
        page = text(drawn(picture))
        return page[legend(page)]

    assert "−3 µm" in scale(0.0, 2.4)
    assert "+3 µm" in scale(0.0, 2.4)
    assert "+3 µm" in scale(0.2, 0.5)
    assert "+1.5 µm" in scale(1.0, 0.5)
    assert "+0.5 µm" in scale(30.0, 0.5)
    assert "+0.1 µm" in scale(90.0, 0.0)
    assert "+8 µm" in scale(90.1, 7.7)


def test_nice() -> None:
    values = [0.1, 0.11, 0.99, 1.0, 2.4, 7.7, 8.1, 123.0]
    assert [nice(v) for v in values] == pytest.approx([0.1, 0.15, 1, 1, 3, 8, 10, 150])


def test_the_trace_keeps_one_second() -> None:
    trace, rate = TraceBins(), 8000.0
    for k in range(300):
        t = (np.arange(BLOCK) + k * BLOCK) / rate
        trace.add(np.sin(2 * np.pi * 2 * t) * np.exp(-t), float(t[-1]), 1 / rate)
    low, high = trace.envelope(50)
    start = t[-1] - 1
    middle = start + (np.arange(50) + 0.5) / 50
    wanted = np.sin(2 * np.pi * 2 * middle) * np.exp(-middle)
    # a fiftieth of a second and a bin of 4 ms: at most 0.024 s at 12.6/s × exp(−1.4)
    assert np.abs((low + high) / 2 - wanted).max() < 0.07
    assert np.all(high > low)


def test_the_trace_begins_anew_where_time_steps_back() -> None:
    trace = TraceBins()
    trace.add(np.full(800, 5.0), 7.0, 1 / 8000)
    trace.add(np.full(800, 1.0), 3.0, 1 / 8000)
    low, high = trace.envelope(250)
    assert np.isnan(low[:-26]).all()
    assert low[-25:].tolist() == high[-25:].tolist() == [1.0] * 25


def test_a_gap_in_the_trace_stays_empty() -> None:
    trace = TraceBins()
    trace.add(np.full(800, 5.0), 7.0, 1 / 8000)
    trace.add(np.full(800, 5.0), 7.5, 1 / 8000)
    known = np.isfinite(trace.envelope(250)[0])
    assert known.sum() == pytest.approx(50, abs=2)
    assert not known[130:220].any()


def test_braille() -> None:
    flat = np.zeros(4)
    assert braille(flat + 1, flat + 1, 2) == ["⠉⠉", "⠀⠀"]
    assert braille(flat - 1, flat - 1, 2) == ["⠀⠀", "⣀⣀"]
    assert braille(flat - 1, flat + 1, 1) == ["⣿⣿"]
    assert braille(flat + np.nan, flat + np.nan, 1) == ["⠀⠀"]


def test_the_trace_is_of_the_contactor_in_the_middle() -> None:
    for name in ("24", "64", "scattered"):
        picture = LivePicture(DISPLAYS[name], texture="wood-oak")
        places = DISPLAYS[name].contactors
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        assert np.linalg.norm(places[picture.contactor] - middle) < 6e-3
        assert f"contactor {picture.contactor}, shear in µm" in "".join(text(drawn(picture)))


def test_status() -> None:
    page = text(drawn(shown(SMALL, limited=17)))
    assert page[0].startswith(" tactile  reference-24 · wood-oak")
    for part in ("12.50 s", "place  43.2 -10.1 mm", "80 mm/s", "force 0.55 N", "limited 17"):
        assert part in page[-1]
    narrow = text(drawn(shown(SMALL, limited=17), width=80))
    assert "12.50 s" in narrow[-2]
    assert "limited 17" in narrow[-1]


def test_a_finger_that_is_followed_is_told_beside_the_values() -> None:
    """Deviations are the median of the contactors that a finger touches."""
    picture = shown(SMALL, limited=17)
    count = len(SMALL.contactors)
    touching, deviation = np.arange(count) < 2, np.full(count, 9.0)
    deviation[:2] = 0.4, 0.6
    none = np.zeros(count, np.bool_)
    picture.follow(touching, deviation, none)
    for width in (80, 140):
        assert (
            f"limited 17  finger on 2 of {count} ± 0.5 dB" in text(drawn(picture, width=width))[-1]
        )
    picture.follow(none, deviation, none)
    assert text(drawn(picture))[-1].rstrip().endswith(f"finger on 0 of {count}")
    picture.follow(none, deviation, touching)
    assert text(drawn(picture))[-1].rstrip().endswith(f"finger on 0 of {count}, 2 guarded")


def test_empty_blocks_and_what_is_not_finite_are_endured() -> None:
    picture = shown(SMALL, shear_um=np.full(24, 2.0), drive=np.full(24, 50.0))
    picture.update(13.0, (0, 0), 0, 0, np.zeros((0, 24)), np.zeros((0, 24)), 0)
    assert picture.state.image_um.max() == pytest.approx(2.0)
    assert picture.state.drive_v.max() == 50.0
    broken = np.full((BLOCK, 24), np.nan)
    broken[:, 3] = np.inf
    picture.update(13.1, (0, 0), 0, 0, broken, np.zeros((BLOCK, 24)), 0)
    assert picture.state.image_um.tolist() == [0.0] * 24
    drawn(picture)


def test_live_draws_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw twice on a terminal that can; rich draws once where TERM is dumb."""
    monkeypatch.setenv("TERM", "xterm")
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=100, height=30, color_system="truecolor")
    picture = shown(LARGE, shear_um=np.linspace(-3, 3, 64))
    with Live(picture, console=console, auto_refresh=False) as live:
        picture.update(99.0, (0, 0), 0, 0, np.ones((8, 64)) * 1e-6, np.zeros((8, 64)), 0)
        live.refresh()
    assert "12.50 s" in out.getvalue()
    assert "99.00 s" in out.getvalue()
    assert "…" not in out.getvalue()


def test_it_is_cheap() -> None:
    """Update and render of 64 contactors call 17,000 functions, 3 ms; no more than 20,000."""
    console = Console(
        file=io.StringIO(), force_terminal=True, width=100, height=40, color_system="truecolor"
    )
    rng, picture = np.random.default_rng(3), shown(LARGE)
    shear, drive = rng.normal(size=(2, 533, 64)) * np.array([1e-6, 10.0])[:, None, None]
    for k in range(2):  # the first time rich fills its caches
        calls = 0

        def count(frame: object, event: str, argument: object) -> None:
            nonlocal calls
            calls += event in ("call", "c_call")

        sys.setprofile(count)
        try:
            picture.update(13 + k / 15, (0, 0), 0.08, 0.5, shear, drive, 0)
            console.print(picture)
        finally:
            sys.setprofile(None)
    assert calls < 20_000
