"""``show`` and ``sheet``: what they print and write, and that a mistake is one line."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import httpx
import numpy as np
import pytest
from cli_rig import Command, assert_mistake
from rich.console import Console
from rich.segment import Segment

from tactile.display.display import load_display
from tactile.show.live import palette
from tactile.show.still import (
    TextureScreen,
    grating_lines,
    marked_bar,
    screen_lines,
    surface_lines,
)
from tactile.show.views import View, view_texture
from tactile.texture.surface import load_texture

PATIENCE = 120.0
"""Longest wait for a program [s]."""


@cache
def seen(name: str, speed: float = 0.08) -> View:
    return view_texture(load_texture(name), load_display("reference-24"), speed=speed)


def text(lines: list[list[Segment]]) -> list[str]:
    return ["".join(segment.text for segment in line) for line in lines]


# The terminal


def test_without_color_the_surface_is_height_and_the_spectrum_bars(command: Command) -> None:
    result = command("show", "wood-oak")
    assert (result.code, result.err) == (0, "")
    assert "\x1b" not in result.out
    lines = result.out.splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[0].split(maxsplit=1) == [
        "tactile", "wood-oak on reference-24, 80 mm/s, 0.5 N, gain 1",
    ]  # fmt: skip
    assert lines[3].startswith("surface, 8 × 8 mm, stroke →")
    assert "spectrum at 80 mm/s, µm peak per third octave" in lines[3]
    surface = [line[:40] for line in lines[4:24]]
    assert {sign for line in surface for sign in line} <= set(" ▁▂▃▄▅▆▇█")
    assert lines[24].startswith("−4 µm ▁")
    (felt,) = [line for line in lines if line[43:].startswith("   250 ")]
    micro, decibels = felt.split()[-4], felt.split()[-2]
    assert float(micro) == pytest.approx(seen("wood-oak").spectrum.total[24] * 1e6, abs=0.005)
    assert float(decibels) == pytest.approx(20 * np.log10(float(micro) / (0.45 * 0.1)), abs=0.6)
    commanded = seen("wood-oak").commanded
    assert lines[-3].startswith(f"vibration {commanded.vibration_um_rms:.2f} µm rms  ·  drag ")
    assert lines[-2].startswith("felt: 14 dB above threshold at 250 Hz  ·  wood")
    assert lines[-1].startswith("source: Level: reference")


def test_heights_and_colors_are_the_means_of_the_surface() -> None:
    y, x = np.meshgrid(*[(np.arange(240) + 0.5) / 240] * 2, indexing="ij")
    ramp = (x + 2 * y - 1.5) * 2e-6
    plain = text(surface_lines(ramp, 40, color=False))
    level = np.array([[" ▁▂▃▄▅▆▇█".index(sign) for sign in line] for line in plain[:20]])
    cells = ramp[::-1].reshape(20, 12, 40, 6).mean(axis=(1, 3)) / 3e-6
    np.testing.assert_array_equal(level, np.rint((cells + 1) / 2 * 7) + 1)
    assert plain[-1].startswith("−3 µm ")
    colored = surface_lines(ramp, 40, color=True)
    assert len(colored) == 21
    first, last = colored[0][0].style, colored[19][-1].style
    assert first is not None
    assert last is not None
    cells = ramp[::-1].reshape(40, 6, 40, 6).mean(axis=(1, 3)) / 3e-6
    shades = np.rint((cells + 1) / 2 * 64).astype(int)
    assert (first.color, first.bgcolor) == (
        palette()[shades[0, 0]], palette()[shades[1, 0]]
    )  # fmt: skip
    assert last.bgcolor in (palette()[shades[39, 39]], None)


def test_a_bar_has_a_mark_where_it_is_felt() -> None:
    style = marked_bar(0.0, 0.0, 4, Console().get_style("none"))[0].style
    assert style is not None
    assert text([marked_bar(0.5, 0.75, 8, style)]) == ["████  │ "]
    assert text([marked_bar(0.5, 0.25, 8, style)]) == ["██│█    "]
    assert text([marked_bar(1.7, 1.7, 8, style)]) == ["███████│"]
    assert text([marked_bar(0.55, 0.99, 8, style)]) == ["████▍  │"]


def test_bars_and_marks_are_where_levels_and_threshold_are() -> None:
    view = seen("plastic-acrylic-ribbed")
    lines = text(screen_lines(view, 110, color=False))
    rows = [line[43:] for line in lines if line.endswith("dB")]
    assert len(rows) > 8
    length = 110 - 43 - 27
    for row in rows:
        bar, micro = row[7 : 7 + length], float(row.split()[-4])
        per_character = np.log(1e4) / length
        bars = sum(sign != " " for sign in bar.replace("│", "█" if "│█" in bar else " "))
        assert bars == pytest.approx(np.log(max(micro, 0.01) / 0.01) / per_character, abs=1.6)
        excess = float(row.split()[-2].replace("−", "-"))
        just = micro / 10 ** (excess / 20)
        assert bar.index("│") == pytest.approx(np.log(just / 0.01) / per_character, abs=1.6)
    (gratings,) = [line for line in lines if "gratings:" in line]
    assert gratings[43:].startswith("gratings: 1.7 µm at 47.3 Hz, 0.6 µm at 94.7 Hz")


@pytest.mark.parametrize("width", [200, 110, 84, 83, 60, 40, 24])
def test_it_fits_terminals_of_any_width(width: int) -> None:
    for color in (False, True):
        lines = text(screen_lines(seen("plastic-acrylic-ribbed"), width, color=color))
        assert max(map(len, lines)) <= width
        assert any("spectrum" in line for line in lines)


def test_color_is_drawn_where_the_terminal_has_it() -> None:
    console = Console(width=100, force_terminal=True, color_system="truecolor")
    with console.capture() as drawn:
        console.print(TextureScreen(seen("wood-oak")))
    assert "▀" in drawn.get()
    assert "\x1b[38;2" in drawn.get()


def test_gratings_are_told_as_far_as_a_line_goes() -> None:
    frequency, micro = np.array([50.0, 100.0, 150.0]), np.array([0.5, 2.0, 1.0])
    assert text(grating_lines(frequency, micro, 60)) == [
        "gratings: 2 µm at 100 Hz, 1 µm at 150 Hz, 0.5 µm at 50 Hz"
    ]
    assert text(grating_lines(frequency, micro, 42)) == ["gratings: 2 µm at 100 Hz, 1 µm at 150 Hz"]
    assert grating_lines(frequency[:0], micro[:0], 60) == []


# Figures and files


def test_figures_for_machines(command: Command) -> None:
    result = command("show", "wood-oak", "--json", "--speed-mm-s", 40)
    assert result.code == 0
    figures = json.loads(result.out)
    assert (figures["name"], figures["category"], figures["provenance"]) == (
        "wood-oak",
        "wood",
        "authored",
    )
    assert (figures["speed_mm_s"], figures["static_friction"]) == (40.0, 0.5)
    columns = ("third_octave_hz", "third_octave_um", "threshold_um", "attainable_um")
    assert len({len(figures[name]) for name in columns}) == 1
    table = zip(*(figures[name] for name in columns), strict=True)
    felt = [f for f, level, least, _ in table if level >= least]
    assert figures["felt_hz"] == felt
    assert felt


@pytest.mark.ci
def test_a_picture_is_written(command: Command) -> None:
    result = command("show", "wood-oak", "--plot", "oak.png")
    assert (result.code, result.out, result.err) == (0, "drawn: oak.png\n", "")
    assert Path("oak.png").read_bytes().startswith(b"\x89PNG")


def test_a_sheet_of_one_category_is_written(command: Command) -> None:
    result = command("sheet", "glass.svg", "--category", "glass")
    assert (result.code, result.out) == (0, "drawn: glass.svg, 3 textures\n")
    drawn = Path("glass.svg").read_text("utf-8")
    assert "acid-etched" in drawn
    assert "calf" not in drawn


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["show", "wood-oka"], "no texture 'wood-oka'; did you mean 'wood-oak'?"),
        (["show", "wood-oak", "--display", "reference-23"], "did you mean 'reference-24'?"),
        (["show", "wood-oak", "--speed-mm-s", "0"], "--speed-mm-s 0: must be between 5 and 1000"),
        (["show", "wood-oak", "--live", "--json"], "--json cannot be used with --live"),
        (["show", "wood-oka", "--live"], "no texture 'wood-oka'; did you mean 'wood-oak'?"),
        (["show", "wood-oak", "--live", "--display", "reference-23"],
         "did you mean 'reference-24'?"),
        (["show", "wood-oak", "--plot", "a.gif"], "a.gif: must end in .png, .svg, .pdf"),
        (["show", "wood-oak", "--plot", "no/a.png"], "no/a.png: No such file or directory"),
        (["sheet", "no/a.png"], "no/a.png: No such file or directory"),
        (["sheet", "a.png", "--category", "wod"],
         "no category 'wod'; did you mean 'wood'?"),
        (["sheet", "a.png", "--speed-mm-s", "2000"], "--speed-mm-s 2000: must be between 5 and"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(arguments: list[str], said: str, command: Command) -> None:
    assert_mistake(command(*arguments), said)
    assert not list(Path().iterdir())


@pytest.mark.parametrize("arguments", [["show", "wood-oak", "--plot", "a.png"], ["sheet", "a.png"]])
def test_without_matplotlib_it_is_told_before_anything_is_computed(
    arguments: list[str], command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)

    def computed(*_: object) -> None:
        raise AssertionError("a texture was loaded")

    monkeypatch.setattr("tactile.texture.surface.load_texture", computed)
    result = command(*arguments)
    assert (result.code, result.out) == (2, "")
    wanted = "tactile: a figure needs matplotlib: pip install 'tactile-display[plot]'"
    assert result.err.startswith(wanted)
    assert result.err.endswith("or in a checkout pip install '.[plot]'\n")


@pytest.mark.ci
def test_in_a_terminal_it_needs_no_matplotlib(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert command("show", "wood-oak").code == 0


@pytest.mark.ci
def test_live_opens_the_page_with_the_texture(tmp_path: Path) -> None:
    """Run the command as a user does, with a browser that notes the address that it is to open."""
    opened = tmp_path / "opened"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    browser.chmod(0o700)
    folders = {"STATE_DIRECTORY": str(tmp_path / "state"), "RUNTIME_DIRECTORY": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-m", "tactile", "show", "wood-oak", "--live"],
        stdout=subprocess.PIPE, text=True, env=os.environ | folders | {"BROWSER": str(browser)},
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            url = line.split()[0]
            assert "shows wood-oak on a simulated display" in line
            assert url.endswith("/#texture=wood-oak")
            assert 'data-testid="pad"' in httpx.get(url, timeout=PATIENCE).text
            end = time.monotonic() + PATIENCE
            while not opened.exists() and time.monotonic() < end:
                time.sleep(0.05)
            assert opened.read_text("utf-8") == f"{url}\n"
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()
