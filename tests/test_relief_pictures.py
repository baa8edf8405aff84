"""Pictures of relief are read with their scale, or refused in one line; and the command."""

import json
import math
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from relief_rig import Image, along, field, plane_wave

from tactile.cli.app import app
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor as descriptors
from tactile.texture.picture import read_height

# Pictures


SCALES: dict[str, Any] = {"um_per_level": 0.5, "mm_per_pixel": 0.02}
RAMP = (np.arange(96 * 80) % 199 + 20).reshape(96, 80)


def save(path: Path, array: NDArray[Any], mode: str | None = None, **more: Any) -> Path:
    image = Image.fromarray(array)
    (image if mode is None else image.convert(mode)).save(path, **more)
    return path


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_gray_of_8_and_16_bits_becomes_meters(kind: type, tmp_path: Path) -> None:
    relief = read_height(save(tmp_path / "a.png", RAMP.astype(kind)), **SCALES)
    assert relief.height == pytest.approx(RAMP * 0.5e-6, rel=1e-12)
    assert relief.pixel == pytest.approx(20e-6)
    assert relief.notes == ()


def test_colors_become_luminance_and_that_is_said(tmp_path: Path) -> None:
    color = np.zeros((80, 80, 3), np.uint8)
    color[:, :40, 1], color[:, 40:, 2] = 100, 200
    relief = read_height(save(tmp_path / "a.png", color), **SCALES)
    assert relief.height[0, [0, -1]] == pytest.approx([58.7 * 0.5e-6, 22.8 * 0.5e-6])
    assert "luminance" in relief.notes[0]


def test_clipping_is_told(tmp_path: Path) -> None:
    clipped = np.where(RAMP < 30, 0, RAMP).astype(np.uint8)
    (note,) = read_height(save(tmp_path / "a.png", clipped), **SCALES).notes
    assert note.startswith("clipped: 5.1% of the pixels are at gray 0")


def huge(path: Path) -> None:
    """Write a PNG that says it has 60000 × 60000 pixels."""
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    chunk = b"IHDR" + header
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
        + struct.pack(">I", 0) + b"IDAT" + struct.pack(">I", zlib.crc32(b"IDAT"))
    )  # fmt: skip


def truncated(path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (100, 100))
    save(path, noise.astype(np.uint8))
    path.write_bytes(path.read_bytes()[:2000])


def animated(path: Path) -> None:
    frames = [Image.fromarray((RAMP + i).astype(np.uint8)) for i in range(2)]
    frames[0].save(path, save_all=True, append_images=frames[1:])


def transparent(path: Path) -> None:
    save(path, np.dstack([RAMP] * 3 + [RAMP]).astype(np.uint8))


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda p: p.write_bytes(b""), "not a PNG; export"),
        (lambda p: p.write_bytes(b"GIF89a, but called a PNG"), "not a PNG; export"),
        (lambda p: p.write_bytes(b"\x89PNG\r\n\x1a\n" + b"\0" * 40), "cannot be read"),
        (lambda p: save(p, RAMP.astype(np.uint8), format="JPEG"), "not a PNG"),
        (truncated, "cannot be read: .*truncated"),
        (animated, "is animated: must be one picture"),
        (transparent, "has transparent pixels"),
        (lambda p: save(p, RAMP.astype(np.uint8), "P"), "a palette: must be an 8- or 16-bit gray"),
        (lambda p: save(p, RAMP.astype(np.uint8), "1"), "black and white only"),
        (lambda p: save(p, np.full((80, 80), 7, np.uint8)), "every pixel is 7: a flat picture"),
        (lambda p: save(p, RAMP[:50].astype(np.uint8)), "80 × 50 pixels: at least 64 a side"),
        (lambda p: save(p, np.zeros((64, 5000), np.uint8)), "5000 × 64 pixels: at most 4096"),
        (huge, "60000 × 60000|too large"),
    ],
)
def test_a_picture_that_cannot_be_used_is_one_clear_line(
    make: Callable[[Path], object], problem: str, tmp_path: Path
) -> None:
    make(tmp_path / "a.png")
    with pytest.raises(InputError, match=problem) as caught:
        read_height(tmp_path / "a.png", **SCALES)
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "a.png") in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, 1e9])
@pytest.mark.parametrize("name", SCALES)
def test_a_scale_outside_its_limits_is_refused(name: str, value: float, tmp_path: Path) -> None:
    option = "--" + name.replace("_", "-")
    with pytest.raises(InputError, match=f"^{option} {value:g}: must be ".replace("+", r"\+")):
        read_height(tmp_path / "a.png", **SCALES | {name: value})


def test_a_photograph_without_a_scale_is_refused_and_told_what_would_do(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"--um-per-level is needed: gray is no height.*photograph"
    ):
        read_height(tmp_path / "a.png", um_per_level=None, mm_per_pixel=0.02)
    with pytest.raises(NotFoundError, match=r"a\.png: no such file"):
        read_height(tmp_path / "a.png", **SCALES)


def test_without_pillow_one_line_tells_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("PIL")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(InputError) as caught:
        read_height(tmp_path / "a.png", **SCALES)
    expected = "a picture needs Pillow: pip install 'tactile-display[picture]'"
    assert str(caught.value).startswith(expected)


# Command


def relief_command(*arguments: object) -> int:
    return int(app([str(a) for a in ("relief", *arguments)], standalone_mode=False) or 0)


def test_the_command_writes_a_texture_that_can_be_played_and_tells_what_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    height = field(8, along(0, 15), 3e-6) + plane_wave(1.25e-3, 0, 3e-6)
    gray = np.round((height - height.min()) / 10e-9).astype(np.uint16)
    picture, output = save(tmp_path / "board.png", gray), tmp_path / "my-board.toml"
    scales = ("--um-per-level", 0.01, "--mm-per-pixel", 0.0535, "--category", "wood")
    relief_command(picture, "-o", output, *scales, "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["periodic"][0]["wavelength_mm"] == pytest.approx(1.25, rel=0.01)
    assert facts["direction_spread_deg"] == pytest.approx(15, rel=0.25)
    assert len(facts["band_error_db"]) == 16
    written = descriptors.load(output)
    assert written.texture.id == "my-board"
    assert written.texture.provenance == "fitted"
    for word in ("board.png", "0.01 µm per gray level", "0.0535 mm", "factor of 2", "Assumed"):
        assert word in written.texture.source
    with pytest.raises(InputError, match="already exists; --force overwrites it"):
        relief_command(picture, "-o", output, *scales)
    relief_command(picture, "-o", output, *scales, "--force")
    told = capsys.readouterr().out
    shown = f"every {written.periodic[0].wavelength_mm:.4g} mm across"
    for word in (shown, "accurate to a factor of 2", "Bands along a stroke"):
        assert word in " ".join(told.split())


def test_the_command_writes_a_map_of_the_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    height = field(8, along(0, 15), 3e-6)
    gray = np.round((height - height.min()) / 10e-9).astype(np.uint16)
    picture, output = save(tmp_path / "board.png", gray), tmp_path / "my-board.toml"
    scales = ("--um-per-level", 0.01, "--mm-per-pixel", 0.0535, "--category", "wood")
    relief_command(picture, "-o", output, *scales, "--map", "--json")
    facts, played = json.loads(capsys.readouterr().out), descriptors.load(output).map
    assert played is not None
    assert facts["map"]["columns"] == played.columns
    assert 16 < facts["map"]["width_mm"] < 19
    relief_command(picture, "-o", output, *scales, "--map", "--force")
    size = f"× {played.height_mm:.3g} mm in {played.columns} × {played.rows} pixels"
    assert size in " ".join(capsys.readouterr().out.split())
