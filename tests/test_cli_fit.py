"""The command ``fit``: files in, a texture that loads out, a report, and mistakes in one line."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command, assert_mistake
from scipy.io import wavfile
from slides import Surface, slide

from tactile.texture.descriptor import load

FULL_SCALE = 50.0


@pytest.fixture
def fit(tmp_path: Path, command: Command) -> Command:
    """Return what runs this command, in a folder with slides of ribs at four speeds."""
    ribs = Surface(level_db=-20, wavelength_mm=2.6, harmonics_um=(4.0,))
    for k, speed in enumerate((0.02, 0.03, 0.05, 0.06)):
        signal = slide(ribs, speed, seed=k).signal / FULL_SCALE
        wavfile.write(tmp_path / f"{k}.wav", 10000, np.round(signal * 32767).astype(np.int16))
    return partial(command, "fit")


FILES = ["0.wav", "1.wav", "2.wav", "3.wav"]
SPEEDS = [word for v in (20, 30, 50, 60) for word in ("--speed-mm-s", v)]
TOLD = [*FILES, *SPEEDS, "--full-scale", FULL_SCALE, "--category", "textile"]


def test_a_fit_is_a_texture_that_loads_with_its_report(fit: Command, tmp_path: Path) -> None:
    code, out, err = fit(*TOLD, "-o", "corduroy-blue.toml", "--source", "made up")
    assert (code, err.strip()) == (0, "")
    texture = load(tmp_path / "corduroy-blue.toml")
    assert texture.texture.category == "textile"
    assert texture.texture.provenance == "fitted"
    assert texture.periodic[0].wavelength_mm == pytest.approx(2.6, rel=0.005)
    for words in ("2.6 mm", "this texture", "autoregressive, order 8", "white noise", "written:"):
        assert words in out
    text = (tmp_path / "corduroy-blue.toml").read_text()
    assert text.startswith("# Fitted to 0.wav at 20 mm/s, ")
    assert "# normal force not told: 0.5 N assumed" in text


@pytest.mark.ci
def test_json_and_a_picture(fit: Command, tmp_path: Path) -> None:
    code, out, _ = fit(*TOLD, "-o", "ribs.toml", "--json", "--plot", "ribs.png")
    assert code == 0

    def refuse(name: str) -> Any:
        raise AssertionError(f"{name} is no JSON")

    told = json.loads(out, parse_constant=refuse)
    assert set(told["held_out"]) == {
        "this texture", "the recordings themselves", "autoregressive, order 8", "white noise",
    }  # fmt: skip
    assert told["descriptor"]["periodic"][0]["wavelength_mm"] == pytest.approx(2.6, rel=0.005)
    assert len(told["frequency_per_mm"]) == len(told["isotropic_loss_db"]) == 24
    assert len(told["held_out_frequency_per_mm"]) == len(told["held_out_level_db"]) == 16
    assert (tmp_path / "ribs.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["0.wav", "-o", "a.toml"], "0.wav: speed is missing; give --speed-mm-s, or a column"),
        (["9.wav", "-o", "a.toml", "--speed-mm-s", 20], "9.wav: no such file"),
        (["0.wav", "-o", "a.txt", "--speed-mm-s", 20], "a.txt: must end in .toml"),
        (
            ["0.wav", "-o", "A b.toml", "--speed-mm-s", 20],
            "consists of lower-case letters, digits and hyphens",
        ),
        ([*TOLD, "-o", "a.toml", "--category", "textil"], "did you mean 'textile'?"),
        ([*TOLD, "-o", "a.toml", "--quantity", "speed"], "--quantity 'speed': there is: accel"),
        (
            [*FILES, "--speed-mm-s", 20, "--speed-mm-s", 30, "-o", "a.toml"],
            "--speed-mm-s is given 2 times for 4 recordings; give it once for all, or once for "
            "each",
        ),
        (
            [*TOLD, "-o", "a.toml", "--normal-force-n", -1],
            "--normal-force-n -1: must be greater than 0",
        ),
        ([*TOLD, "-o", "a.toml", "--plot", "a.txt"], "a.txt: must end in .png, .svg, .pdf"),
        ([*TOLD, "-o", "missing/a.toml"], "no folder missing"),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(
    fit: Command, tmp_path: Path, arguments: list[object], message: str
) -> None:
    assert_mistake(fit(*arguments), message)
    assert list(tmp_path.glob("**/*.toml")) == []


def test_a_file_that_is_there_is_kept_unless_told_otherwise(fit: Command, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("mine")
    code, _, err = fit(*TOLD, "-o", "a.toml")
    assert code == 2
    assert "already exists; --force overwrites it" in err
    assert (tmp_path / "a.toml").read_text() == "mine"
