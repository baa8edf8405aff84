"""A texture from a picture of relief: what is known of the relief is found again in the texture.

Height maps are synthetic, with closed forms for wavelength, direction, amplitude and spectrum;
bands along a stroke are also compared with one-dimensional periodograms of the picture's own rows
and of the realized surface, which share no code with the two-dimensional ones. Pictures are 384
pixels of 53.5 µm: 20.5 mm, five periods of the coarsest band.
"""

import json
import math
import struct
import sys
import zlib
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.signal import welch

from tactile.cli import main
from tactile.cli.app import app
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor as descriptors
from tactile.texture import skin
from tactile.texture.descriptor_file import write
from tactile.texture.gratings import take_lines
from tactile.texture.picture import HeightMap, read_height
from tactile.texture.relief import (
    CENTERS,
    EDGES,
    leveled,
    orientation_of,
    spectrum_of,
    stroke_levels,
    unsteadiness_of,
)
from tactile.texture.relief_texture import Relief, texture_of
from tactile.texture.surface import load_texture

Image = pytest.importorskip("PIL.Image")

Floats = NDArray[np.float64]

COUNT, PIXEL, LEVEL = 384, 53.5e-6, 10e-9
X, Y = np.meshgrid(
    (np.arange(COUNT) - (COUNT - 1) / 2) * PIXEL, (np.arange(COUNT) - (COUNT - 1) / 2) * -PIXEL
)
"""Places of the pixels as seen: y up."""


def plane_wave(wavelength: float, degrees: float, amplitude: float, phase: float = 0.0) -> Floats:
    turn = math.radians(degrees)
    along = X * math.cos(turn) + Y * math.sin(turn)
    return np.asarray(amplitude * np.cos(2 * np.pi * along / wavelength + phase))


def field(seed: int, shape: Callable[[Floats, Floats], Floats], rms: float = 2e-6) -> Floats:
    """Return a Gaussian field whose amplitude spectrum is shape(wave number, direction).

    Cut from one of twice the size, so that it does not repeat.
    """
    count = 2 * COUNT
    y, x = np.meshgrid(-np.fft.fftfreq(count, PIXEL), np.fft.rfftfreq(count, PIXEL), indexing="ij")
    number = np.hypot(x, y)
    number[0, 0] = np.inf
    field = irfft2(white(seed) * shape(number, np.arctan2(y, x)), (count, count))
    return np.asarray(field[:COUNT, :COUNT] * (rms / field.std()))


@lru_cache
def white(seed: int) -> NDArray[np.complex128]:
    noise = np.random.default_rng(seed).standard_normal((2 * COUNT, 2 * COUNT))
    return np.asarray(rfft2(noise))


def isotropic(number: Floats, direction: Floats) -> Floats:
    return np.asarray((number**2 + 500.0**2) ** -0.75)


def along(degrees: float, spread: float) -> Callable[[Floats, Floats], Floats]:
    """Return a falling spectrum whose directions are normally distributed."""

    def shape(number: Floats, direction: Floats) -> Floats:
        off = (direction - math.radians(degrees) + np.pi / 2) % np.pi - np.pi / 2
        return np.asarray(number**-1.2 * np.exp(-0.25 * (off / math.radians(spread)) ** 2))

    return shape


def made(height: Floats, pixel: float = PIXEL, level: float = LEVEL) -> Relief:
    """Return the texture of heights, rounded to gray levels as a picture would."""
    relief = HeightMap(np.round(height / level) * level, pixel, level)
    return texture_of(relief, name="some-relief", category="test", picture="some.png")


def bands_of(result: Relief) -> Floats:
    assert result.descriptor.stochastic is not None
    return np.array(result.descriptor.stochastic.level_db)


# Gratings


@pytest.mark.parametrize(
    ("wavelength_mm", "degrees", "amplitude_um"),
    [
        (2.56, 0.0, 5.0),
        (0.3, -62.0, 0.5),
        pytest.param(1.0, 90.0, 2.0, marks=pytest.mark.ci),
        pytest.param(1.7, 37.0, 5.0, marks=pytest.mark.ci),
        pytest.param(0.13, 12.0, 0.1, marks=pytest.mark.ci),
    ],
)
def test_a_grating_is_found_with_its_wavelength_direction_and_amplitude(
    wavelength_mm: float, degrees: float, amplitude_um: float
) -> None:
    """2.56 mm are eight periods. 1 %, 1° and 2 %, on a ground of fifth its rms."""
    noise = field(1, isotropic, amplitude_um * 0.14e-6)
    wave = plane_wave(wavelength_mm * 1e-3, degrees, amplitude_um * 1e-6)
    (part,) = made(wave + noise).descriptor.periodic
    assert part.wavelength_mm == pytest.approx(wavelength_mm, rel=0.01)
    assert abs((part.direction_deg - degrees + 90) % 180 - 90) < 1
    assert list(part.harmonics_um) == pytest.approx([amplitude_um * skin.GAIN], rel=0.02)


def test_harmonics_are_gathered_into_one_grating_with_their_phases() -> None:
    """The second is missing; phases count from the middle of the picture."""
    height = plane_wave(2e-3, 20, 4e-6, 0.5) + plane_wave(2e-3 / 3, 20, 1e-6, -1.0)
    result = made(height)
    (part,) = result.descriptor.periodic
    assert np.array(part.harmonics_um) / skin.GAIN == pytest.approx([4, 0, 1], rel=0.02)
    assert part.phases_deg[0] == pytest.approx(math.degrees(0.5), abs=1)
    assert part.phases_deg[2] == pytest.approx(math.degrees(-1.0), abs=3)
    assert result.descriptor.stochastic is None
    assert "only rounding" in " ".join(result.notes)


@pytest.mark.ci
def test_a_weave_is_two_gratings() -> None:
    parts = made(plane_wave(0.5e-3, 0, 4e-6) + plane_wave(0.7e-3, 90, 2e-6)).descriptor.periodic
    assert [p.wavelength_mm for p in parts] == pytest.approx([0.5, 0.7], rel=0.01)


@pytest.mark.parametrize(
    "shape", [isotropic, along(25, 12), pytest.param(along(0, 5), marks=pytest.mark.ci)]
)
def test_a_random_field_has_no_gratings(shape: Callable[[Floats, Floats], Floats]) -> None:
    for seed in range(2):
        height, _ = leveled(field(seed, shape)[::-1])
        lines, left = take_lines(height, PIXEL, finest=EDGES[-1], least=LEVEL / 2)
        assert lines == []
        assert np.array_equal(left, height)


# Bands and directions


def test_bands_of_an_isotropic_field_are_those_of_its_closed_form() -> None:
    """C(q) = A (q² + q0²)^(−3/2) has the stroke spectrum 4 A N/((f² + q0²) √(f² + q0² + N²)).

    N is where the pixels end the spectrum. Mean over five fields within 1 dB.
    """
    seeds, end, knee = range(5), 0.5 / PIXEL, 500.0
    measured = np.mean(
        [stroke_levels(spectrum_of(field(seed, isotropic), PIXEL), None) for seed in seeds], axis=0
    )
    fine = np.fft.fftfreq(2 * COUNT, PIXEL)
    square = np.hypot(*np.meshgrid(fine, fine)) ** 2 + knee**2
    square[0, 0] = np.inf
    cell = (fine[1] - fine[0]) ** 2
    scale = (2e-6) ** 2 / np.sum(square**-1.5 * cell)
    f = np.array([np.linspace(a, b, 50) for a, b in pairwise(EDGES)])
    known = 4 * scale * end / ((f**2 + knee**2) * np.sqrt(f**2 + knee**2 + end**2))
    assert measured == pytest.approx(10 * np.log10(known.mean(axis=1) * 1e15), abs=1.0)


@pytest.mark.ci
def test_an_isotropic_field_makes_an_isotropic_texture_that_a_surface_can_have(
    tmp_path: Path,
) -> None:
    result = made(field(3, isotropic))
    write(result.descriptor, tmp_path / "some-relief.toml", result.comments)
    assert result.descriptor.stochastic is not None
    assert result.descriptor.stochastic.direction_spread_deg is None
    assert result.descriptor.stochastic.excess_kurtosis < 0.3
    assert result.descriptor.stochastic.am_depth < 0.1
    texture = load_texture(tmp_path / "some-relief.toml")
    assert np.sqrt(np.mean(texture.band_error_db**2)) < 1.5


@pytest.mark.parametrize(
    ("degrees", "spread"),
    [(-40, 15), *(pytest.param(*p, marks=pytest.mark.ci) for p in ((0, 8), (90, 25), (70, 40)))],
)
def test_a_directional_field_has_its_direction_and_spread(degrees: float, spread: float) -> None:
    """Spread within 20 %, direction within 3°, as the mean of three fields."""
    found = [
        orientation_of(spectrum_of(field(seed, along(degrees, spread))[::-1], PIXEL))
        for seed in range(3)
    ]
    off = [(math.degrees(o.direction) - degrees + 90) % 180 - 90 for o in found]
    assert abs(np.mean(off)) < 3
    spreads = [math.degrees(o.spread) for o in found if o.spread is not None]
    assert len(spreads) == 3
    assert np.mean(spreads) == pytest.approx(spread, rel=0.2)


def stroke_density(signal: Floats) -> Floats:
    """Return the 16 band levels [dB re 1 m² m] of strokes (..., N), by one-dimensional means."""
    f, density = welch(signal, 1 / PIXEL, "hann", COUNT, detrend=False)
    mean = density.reshape(-1, len(f)).mean(axis=0)
    fine = np.linspace(EDGES[:-1], EDGES[1:], 20)
    return np.asarray(10 * np.log10(np.interp(fine, f, mean).mean(axis=0)))


@pytest.mark.ci
def test_the_realized_texture_has_the_spectrum_of_the_pictures_own_rows(tmp_path: Path) -> None:
    """Rows are strokes along x: their periodogram times the gain is that of the surface.

    Also beside a grating, which both have. As the mean of three fields 1 dB rms and 3 dB in a
    band: a row has five periods of the coarsest band, and waves are 384. The ground has nothing
    coarser than the bands, which would leak into the rows.
    """
    differences = []
    for seed in (5, 6, 7):
        ground = field(seed, lambda n, turn: along(0, 12)(n, turn) * (n > EDGES[0]), 4e-6)
        result = made(ground + plane_wave(1.3e-3, 0, 3e-6))
        target = tmp_path / "some-relief.toml"
        write(result.descriptor, target, result.comments, force=True)
        partials = load_texture(target).realize(1).partials
        place = np.arange(2**12) * PIXEL
        strokes = partials.at(np.stack([place, 0 * place], axis=1))
        rows = ground - ground.mean() + plane_wave(1.3e-3, 0, 3e-6)
        differences.append(stroke_density(strokes) - stroke_density(rows * skin.GAIN))
    difference = np.mean(differences, axis=0)
    assert np.sqrt(np.mean(difference**2)) < 1
    assert np.max(np.abs(difference)) < 3


# Laws


def test_twice_the_height_is_6_db_and_twice_the_amplitude() -> None:
    height = field(2, along(30, 15), 1e-6) + plane_wave(1.1e-3, 30, 2e-6)
    one, two = made(height), made(2 * height, level=2 * LEVEL)
    assert bands_of(two) - bands_of(one) == pytest.approx(np.full(16, 20 * math.log10(2)), abs=0.05)
    assert two.descriptor.periodic[0].harmonics_um[0] == pytest.approx(
        2 * one.descriptor.periodic[0].harmonics_um[0], rel=0.01
    )


def test_twice_the_pixel_is_twice_the_wavelength_and_the_spectrum_moves_three_bands() -> None:
    """P(f) of h(x/2) is 2 P(2 f): three bands lower and 3 dB more."""
    height = field(4, isotropic, 1e-6) + plane_wave(1.0e-3, 50, 1e-6)
    one, two = made(height, PIXEL / 2), made(height, PIXEL)
    ratio = two.descriptor.periodic[0].wavelength_mm / one.descriptor.periodic[0].wavelength_mm
    assert ratio == pytest.approx(2, rel=1e-3)
    moved = bands_of(two)[:-3] - bands_of(one)[3:]
    assert moved == pytest.approx(np.full(13, 10 * math.log10(2)), abs=0.6)


def test_a_quarter_turn_of_the_picture_turns_directions_by_90() -> None:
    height = field(6, along(20, 15)) + plane_wave(0.9e-3, -35, 3e-6)
    for result, turn in ((made(height), 0), (made(np.rot90(height)), 90)):
        random, (part,) = result.descriptor.stochastic, result.descriptor.periodic
        assert random is not None
        assert abs((random.direction_deg - turn - 20 + 90) % 180 - 90) < 4
        assert abs((part.direction_deg - turn + 35 + 90) % 180 - 90) < 1


def test_the_spectrum_adds_up_to_the_variance() -> None:
    height = plane_wave(1e-3, 10, 3e-6) + plane_wave(0.4e-3, 80, 1e-6)
    for shape in ((COUNT, COUNT), (300, 351)):
        cut = height[: shape[0], : shape[1]]
        assert spectrum_of(cut, PIXEL).power.sum() == pytest.approx(5e-12, rel=0.01)


def test_a_tilt_is_taken_out_and_curvature_is_told() -> None:
    """x² + y² over ± a sags by 2 a² from corner to middle."""
    ripple = plane_wave(0.4e-3, 30, 1e-6)
    left, sag = leveled(ripple + 3e-3 * X - 2e-3 * Y + 1.0)
    assert np.allclose(left, leveled(ripple)[0], rtol=0, atol=1e-12)
    assert sag < 5e-8
    _, sag = leveled(0.05 * (X**2 + Y**2))
    assert sag == pytest.approx(0.1 * X.max() ** 2, rel=0.01)


# Unsteadiness


@pytest.mark.ci
def test_an_envelope_is_found_with_its_depth_and_the_kurtosis_it_makes() -> None:
    """exp(g) with var g = s on a Gaussian: depth √(e^s − 1), excess kurtosis 3 (e^{4 s} − 1)."""
    variance, fine = 0.08, lambda number, direction: np.where(number > 1500, number**-1.0, 0.0)
    slow = field(11, lambda number, direction: np.where(number < 150, 1.0, 0.0), 1.0)
    slow *= math.sqrt(variance) / slow.std()
    found = unsteadiness_of(field(10, fine) * np.exp(slow), PIXEL)
    assert found.am_depth == pytest.approx(math.sqrt(math.expm1(variance)), rel=0.25)
    assert found.excess_kurtosis == pytest.approx(3 * math.expm1(4 * variance), rel=0.35)
    steady = unsteadiness_of(field(10, fine), PIXEL)
    assert steady.am_depth is not None
    assert steady.am_depth < 0.08
    assert steady.excess_kurtosis < 0.1


# Skin


def test_the_share_in_contact_is_that_of_a_diffusion_that_ends_at_zero() -> None:
    """Pressure spread in small steps on a grid, what reaches zero is lost."""
    slope = 0.25
    spread = skin.MODULUS * slope / 2
    step = skin.PRESSURE / 30
    grid = np.arange(1, 500) * step
    density = np.where(np.arange(1, 500) == 30, 1.0, 0.0)
    count = round((spread / step) ** 2 / 0.4)
    for _ in range(count):
        inner = np.pad(density, 1)
        density = density + 0.2 * (inner[2:] - 2 * density + inner[:-2])
    assert grid[-1] > 6 * spread
    assert skin.share_in_contact(slope) == pytest.approx(density.sum(), rel=2e-3)


def test_gentle_relief_is_touched_all_over_and_steep_relief_in_proportion_to_pressure() -> None:
    assert skin.share_in_contact([0.0, 0.01]) == pytest.approx([1, 1])
    steep = 100.0
    share = math.sqrt(8 / math.pi) * skin.PRESSURE / (skin.MODULUS * steep)
    assert skin.share_in_contact(steep) == pytest.approx(share, rel=1e-4)
    assert skin.skin_gain(steep) == pytest.approx(skin.GAIN * math.sqrt(share), rel=1e-4)


def test_a_steep_grating_is_followed_less_than_in_proportion_and_that_is_told() -> None:
    wavelength, amplitude = 0.64e-3, 60e-6
    result = made(plane_wave(wavelength, 0, amplitude), level=0.1e-6)
    slope = 2 * np.pi * amplitude / wavelength / math.sqrt(2)
    expected = amplitude * 1e6 * float(skin.skin_gain(slope))
    assert result.descriptor.periodic[0].harmonics_um[0] == pytest.approx(expected, rel=0.03)
    assert result.rms_slope == pytest.approx(slope, rel=0.03)
    assert any(note.startswith("steep: rms slope 0.42") for note in result.notes)


# Limits


def test_a_small_picture_says_which_bands_are_assumed_and_holds_their_rms() -> None:
    result = made(field(1, isotropic)[:192])
    bands = bands_of(result)
    first = CENTERS.index(0.4)
    rms = bands + 10 * np.log10(CENTERS)
    assert rms[:first] == pytest.approx(np.full(first, rms[first]), abs=0.02)
    assert any(note.startswith("bands below 0.4 cycles/mm are assumed") for note in result.notes)
    assert any(note.startswith("am_depth is 0") for note in result.notes)
    with pytest.raises(InputError, match=r"some\.png: 7\.6 mm on its shorter side: needs 8 mm"):
        made(field(1, isotropic)[:142])


def test_bands_that_hold_only_the_rounding_of_gray_are_named() -> None:
    result = made(field(1, lambda number, _: number**-2.5, 1e-6), level=0.1e-6)
    (note,) = (note for note in result.notes if "rounding" in note)
    assert note.endswith("8 cycles/mm hold mostly rounding of gray levels")
    assert "0.25" not in note


def test_an_unknown_category_or_a_bad_name_is_refused() -> None:
    relief = HeightMap(field(1, isotropic), PIXEL, LEVEL)
    with pytest.raises(InputError, match=r"category 'woood': unknown; did you mean 'wood'\?"):
        texture_of(relief, name="a", category="woood", picture="")
    with pytest.raises(InputError, match="name 'My Oak': must be small letters"):
        texture_of(relief, name="My Oak", category="wood", picture="")


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
        (lambda p: p.write_bytes(b""), "no PNG; export"),
        (lambda p: p.write_bytes(b"GIF89a, but called a PNG"), "no PNG; export"),
        (lambda p: p.write_bytes(b"\x89PNG\r\n\x1a\n" + b"\0" * 40), "cannot be read"),
        (lambda p: save(p, RAMP.astype(np.uint8), format="JPEG"), "no PNG"),
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
    expected = "a picture needs Pillow; pip install 'tactile-display[picture]'"
    assert str(caught.value) == expected


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
    with pytest.raises(InputError, match="is there already; --force overwrites it"):
        relief_command(picture, "-o", output, *scales)
    relief_command(picture, "-o", output, *scales, "--force")
    told = capsys.readouterr().out
    shown = f"every {written.periodic[0].wavelength_mm:.4g} mm across"
    for word in (shown, "known within a factor of 2", "Bands along a stroke"):
        assert word in " ".join(told.split())


def test_a_mistake_on_the_command_line_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, output = save(tmp_path / "a.png", RAMP.astype(np.uint8)), tmp_path / "a.toml"
    command = ["tactile", "relief", str(picture), "-o", str(output), "--category", "wood"]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    told = capsys.readouterr().err
    assert told.startswith("tactile: --um-per-level is needed")
    assert told.count("\n") == 1
    assert not output.exists()
