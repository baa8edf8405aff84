"""A texture from a picture of relief: what is known of the relief is found in the texture.

Height maps are synthetic; bands along a stroke are also compared with one-dimensional periodograms
of the picture's own rows and of the realized surface, which share no code with the two-dimensional
ones.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from relief_rig import (
    COUNT,
    LEVEL,
    PIXEL,
    X,
    Y,
    along,
    bands_of,
    field,
    isotropic,
    made,
    plane_wave,
)
from scipy.signal import welch

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import skin
from tactile.texture.descriptor_file import write
from tactile.texture.gratings import take_lines
from tactile.texture.picture import HeightMap
from tactile.texture.relief import (
    CENTERS,
    EDGES,
    FEWEST,
    leveled,
    orientation_of,
    spectrum_of,
    stroke_levels,
    unsteadiness_of,
)
from tactile.texture.relief_texture import texture_of
from tactile.texture.surface import load_texture

PRESSURE, MODULUS = 5e3, 50e3
"""Pressure of a fingertip on what it touches, and effective modulus E* of the fingertip [Pa]."""
GAIN = math.hypot(0.4, 2 * PRESSURE / MODULUS) / 3
"""Movement of the skin per relief [µm/µm]: friction of 0.4 and the normal traction, in a patch that
moves three times as much as the skin beside it, give 0.15."""

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
    assert list(part.harmonics_um) == pytest.approx([amplitude_um * GAIN], rel=0.02)


def test_harmonics_are_gathered_into_one_grating_with_their_phases() -> None:
    """The second is missing; phases count from the middle of the picture."""
    height = plane_wave(2e-3, 20, 4e-6, 0.5) + plane_wave(2e-3 / 3, 20, 1e-6, -1.0)
    result = made(height)
    (part,) = result.descriptor.periodic
    assert np.array(part.harmonics_um) / GAIN == pytest.approx([4, 0, 1], rel=0.02)
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
        lines, left = take_lines(height, PIXEL, finest=EDGES[FEWEST], least=LEVEL / 2)
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
    f = np.array([np.linspace(a, b, 50) for a, b in pairwise(EDGES[: FEWEST + 1])])
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
    """The spread is within 20 %, the direction within 3°, as the mean of three fields."""
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
    """Return the 16 lowest levels [dB re 1 m² m] of strokes (..., N), by one-dimensional means."""
    f, density = welch(signal, 1 / PIXEL, "hann", COUNT, detrend=False)
    mean = density.reshape(-1, len(f)).mean(axis=0)
    fine = np.linspace(EDGES[:FEWEST], EDGES[1 : FEWEST + 1], 20)
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
        differences.append(stroke_density(strokes) - stroke_density(rows * GAIN))
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
    """P(f) of h(x/2) is 2 P(2 f): three bands lower and 3 dB more.

    The finer pixels, 26.8 µm, resolve three more bands: to 17.9 of at most 18.7 cycles/mm.
    """
    height = field(4, isotropic, 1e-6) + plane_wave(1.0e-3, 50, 1e-6)
    one, two = made(height, PIXEL / 2), made(height, PIXEL)
    ratio = two.descriptor.periodic[0].wavelength_mm / one.descriptor.periodic[0].wavelength_mm
    assert ratio == pytest.approx(2, rel=1e-3)
    assert len(bands_of(one)) == 19
    moved = bands_of(two) - bands_of(one)[3:]
    assert moved == pytest.approx(np.full(16, 10 * math.log10(2)), abs=0.6)


@pytest.mark.parametrize(("pixel_um", "bands"), [(53.5, 16), (45, 16), (44, 17), (17, 21), (2, 21)])
def test_a_finer_picture_has_more_bands_up_to_25_cycles_per_mm(pixel_um: float, bands: int) -> None:
    """Each ends within half of the sampling frequency: at 11.2 of 11.4 cycles/mm for 44 µm."""
    spectrum = spectrum_of(field(1, isotropic), pixel_um * 1e-6)
    assert len(stroke_levels(spectrum, None)) == len(spectrum.edges) - 1 == bands
    assert spectrum.edges[-1] == pytest.approx(1e3 * CENTERS[bands - 1] * 10**0.05, rel=0.02)


def test_bands_that_a_fine_picture_adds_end_where_rounding_begins() -> None:
    """Pixels of 17 µm resolve 25 cycles/mm; white rounding of 60 nm covers what falls to it."""
    height = np.pad(field(2, lambda number, _: number**-2.5, 1e-6), (0, COUNT), "symmetric")
    fine, coarse = (made(height, 17e-6, level) for level in (0.1e-9, 60e-9))
    assert len(bands_of(fine)) == 21
    assert FEWEST <= len(bands_of(coarse)) < 21
    assert bands_of(coarse)[:10] == pytest.approx(bands_of(fine)[:10], abs=0.5)


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
    found = unsteadiness_of(field(10, fine) * np.exp(slow), PIXEL, EDGES[FEWEST])
    assert found.am_depth == pytest.approx(math.sqrt(math.expm1(variance)), rel=0.25)
    assert found.excess_kurtosis == pytest.approx(3 * math.expm1(4 * variance), rel=0.35)
    steady = unsteadiness_of(field(10, fine), PIXEL, EDGES[FEWEST])
    assert steady.am_depth is not None
    assert steady.am_depth < 0.08
    assert steady.excess_kurtosis < 0.1


# Skin


def test_the_share_in_contact_is_that_of_a_diffusion_that_ends_at_zero() -> None:
    """The reference spreads pressure in small steps on a grid; what reaches zero is lost."""
    slope = 0.25
    spread = MODULUS * slope / 2
    step = PRESSURE / 30
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
    share = math.sqrt(8 / math.pi) * PRESSURE / (MODULUS * steep)
    assert skin.share_in_contact(steep) == pytest.approx(share, rel=1e-4)
    assert skin.skin_gain(steep) == pytest.approx(GAIN * math.sqrt(share), rel=1e-4)


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
    rms = bands + 10 * np.log10(CENTERS[:FEWEST])
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
