"""Tests of fields: tiles against the sum of their waves, strokes against statistics of noise."""

import itertools

import numpy as np
import pytest
from scipy.signal import welch

from tactile.arrays import Complex, Floats
from tactile.rendering.equalizer import PASS_BAND
from tactile.texture.density import Density
from tactile.texture.field import (
    FADE,
    PIXELS,
    THIRD,
    Field,
    FieldReader,
    field_of,
    field_of_rectangle,
    lattice,
    pitch_of,
)
from tactile.texture.surface import load_texture

HIGHEST, LOWEST = 9e3, 3e2
"""Range of the spatial frequencies of the waves of `scattered` [cycles/m]."""


def scattered() -> tuple[Complex, Field]:
    """Return the complex amplitudes of a few waves [m] all over the plane, and their field."""
    rng = np.random.default_rng(5)
    size = np.hypot(*lattice(pitch_of(HIGHEST)))
    some = rng.choice(np.flatnonzero((size > LOWEST) & (size < HIGHEST)), 400, replace=False)
    waves = np.zeros(len(size), np.complex128)
    waves[some] = rng.normal(size=(400, 2)) @ [1e-6, 1e-6j]
    return waves, field_of(waves, HIGHEST, LOWEST)


WAVES, FIELD = scattered()


def summed(waves: Complex, place: Floats) -> Floats:
    """Return Σ Re a exp j(k·p) of lattice waves at places (P, 2) [m], term by term."""
    some = np.flatnonzero(waves)
    turns = place @ lattice(pitch_of(HIGHEST))[:, some]
    return np.asarray((np.exp(2j * np.pi * turns) @ waves[some]).real)


def scatter(count: int) -> Floats:
    """Return random places (count, 2) within a meter of the origin [m]."""
    return np.random.default_rng(2).uniform(-1, 1, (count, 2))


def read(field: Field, place: Floats, speed: float) -> Floats:
    """Return the displacement (P,) at places (P, 2) [m] for a finger at a speed [m/s]."""
    shear = np.zeros((len(place), 1), np.float32)
    reader = FieldReader(field, np.zeros((1, 2)), band=PASS_BAND)
    reader.add_to(shear, place.T, np.full(len(place), speed**2))
    return shear[:, 0].astype(np.float64)


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def test_a_field_is_the_sum_of_its_waves() -> None:
    """Compare with the sum: images of the spline are 38 dB down at most, less far below the top."""
    place = scatter(300)
    exact = summed(WAVES, place)
    assert rms(FIELD.at(place) - exact) < 10 ** (-38 / 20) * rms(exact)
    low = np.where(np.hypot(*lattice(pitch_of(HIGHEST))) < HIGHEST / 4, WAVES, 0)
    exact = summed(low, place)
    assert rms(field_of(low, HIGHEST, LOWEST).at(place) - exact) < 3e-4 * rms(exact)


@pytest.mark.parametrize("level", [1, 2, 3, 4, 7, 10])
def test_each_level_is_the_sum_of_the_waves_below_its_end(level: int) -> None:
    place, size = scatter(200), np.hypot(*lattice(pitch_of(HIGHEST)))
    exact = summed(np.where(size < HIGHEST * THIRD**level, WAVES, 0), place)
    speed = PASS_BAND / (HIGHEST * THIRD**level) * (1 + 1e-9)
    assert rms(read(FIELD, place, speed) - exact) < 10 ** (-38 / 20) * rms(exact)


def test_levels_are_mixed_between_their_speeds() -> None:
    """Read at a third of the fade from one level to the next, in the logarithm of the speed."""
    place, step = scatter(200), PASS_BAND / HIGHEST
    ends = [read(FIELD, place, step * 10 ** (0.1 * k) * (1 + 1e-9)) for k in (2, 3)]
    mixed = read(FIELD, place, step * 10 ** (0.1 * (2 + FADE / 3)))
    assert rms(mixed - (2 * ends[0] + ends[1]) / 3) < 1e-5 * rms(mixed)
    faded = read(FIELD, place, step * 10 ** (0.1 * (2 + FADE)))
    assert rms(faded - ends[1]) < 1e-5 * rms(faded)


def test_nothing_is_left_at_a_speed_that_takes_all_waves_out_of_the_band() -> None:
    fast = PASS_BAND / LOWEST * 10**0.2
    assert not read(FIELD, scatter(50), fast).any()
    assert read(FIELD, scatter(50), fast / 3).any()


def test_contactors_read_the_field_at_their_places() -> None:
    place, contactors = scatter(40), scatter(30) * 0.01
    shear = np.ones((40, 30), np.float32)
    reader = FieldReader(FIELD, contactors, band=PASS_BAND, gain=-2)
    reader.add_to(shear, place.T, np.zeros(40))
    there = FIELD.at(place[:, None] + contactors)
    assert np.abs(shear - (1 - 2 * there)).max() < 1e-6


def test_a_way_back_meets_exactly_what_the_way_there_met() -> None:
    place = np.outer(np.linspace(-0.3, 0.3, 999), [0.8, 0.6])
    assert np.array_equal(FIELD.at(place), FIELD.at(place[::-1])[::-1])


def test_the_shortest_way_after_which_a_tile_repeats_is_776_pixels() -> None:
    """Search the lattice; a hexagonal one, than which none is better, has 778."""
    row = np.arange(1, 1000)
    column = -row * 188_119 % PIXELS
    way = np.hypot(np.minimum(column, PIXELS - column), row)
    assert way.min() == pytest.approx(775.8, abs=0.1)
    step = pitch_of(HIGHEST) * np.array([min(column[way.argmin()], PIXELS), row[way.argmin()]])
    if step[0] > 1:
        step[0] -= PIXELS * pitch_of(HIGHEST)
    place = scatter(20)
    assert np.abs(FIELD.at(place + step) - FIELD.at(place)).max() < 1e-9


def deviation(strokes: list[Floats], step: float, edges: Floats) -> float:
    """Return the standard deviation within third octaves of the periodograms of strokes [dB]."""
    frequency = np.fft.rfftfreq(len(strokes[0]), step)
    band = np.where(np.arange(len(frequency)) % 4, 0, np.digitize(frequency, edges))
    scatter = []
    for stroke in strokes:
        level = 20 * np.log10(np.abs(np.fft.rfft(stroke * np.hanning(len(stroke)))))
        scatter += [level[band == k].var(ddof=1) for k in range(7, len(edges))]
    return float(np.sqrt(np.mean(scatter)))


@pytest.mark.parametrize("name", ["leather-calf", "wood-oak"])
def test_the_spectrum_within_third_octaves_is_that_of_noise(name: str) -> None:
    """Compare logarithms of the periodograms of strokes of 0.1 m with those of Gaussian noise.

    A bin is exponentially distributed, so that its logarithm has the standard deviation
    10 π/(√6 ln 10) = 5.57 dB. Every fourth bin is taken, since a window of Hann correlates
    neighbors.
    """
    surface = load_texture(name).realize(1)
    assert surface.density is not None
    edges = surface.density.edges
    step = 0.25 / edges[-1]
    way = np.outer(np.arange(round(0.1 / step)) * step, [1.0, 0.0])
    places = scatter(20)
    noise = [surface.random_part(way + place) for place in places]
    assert deviation(noise, step, edges) == pytest.approx(5.57, abs=0.3)
    lines = [surface.partials.at(way + place) for place in places[:4]]
    assert deviation(lines, step, edges) > 7


@pytest.mark.parametrize("name", ["leather-calf", "wood-oak", "metal-steel-smooth"])
def test_a_stroke_over_a_field_has_the_bands_of_its_descriptor(name: str) -> None:
    """Estimate the levels of bands along strokes of 2 m.

    The estimate of a band of 100 waves is within 0.4 dB. A texture with a direction misses single
    bands by 0.5 dB, since its waves are fitted one by one and its field ring by ring.
    """
    texture = load_texture(name)
    surface, stochastic = texture.realize(2), texture.descriptor.stochastic
    assert surface.density is not None
    assert stochastic is not None
    edges = surface.density.edges
    step = 0.25 / edges[-1]
    count = int(2.0 / step)
    turns = np.radians(stochastic.direction_deg)
    if stochastic.direction_spread_deg is None:
        turns = np.radians(np.arange(0, 180, 20))
    error = []
    for turn in np.atleast_1d(turns):
        ahead = step * np.array([np.cos(turn), np.sin(turn)])
        met = surface.random_part(np.outer(np.arange(count), ahead))
        frequency, density = welch(met, 1 / step, nperseg=1 << 14)
        band = np.digitize(frequency, edges) - 1
        level = [10 * np.log10(density[band == k].mean() * 1e15) for k in range(len(edges) - 1)]
        error.append(np.array(level) - stochastic.level_db)
    assert np.sqrt(np.mean(np.square(error))) < 0.5
    assert np.abs(error).max() < 1.6


def test_a_density_has_the_power_of_its_rings() -> None:
    """Integrate over the plane numerically, with a steep spectrum and with one that has a peak."""
    center = 10 ** (np.arange(25, 37) / 10)
    for power in (center**-2.0, np.where(np.arange(12) == 5, 9.0, 1.0)):
        for spread in (None, 0.3):
            density = Density(center, power, 0.4, spread)
            size = np.geomspace(density.edges[0], density.edges[-1], 12 * 64 + 1)
            size = np.sqrt(size[1:] * size[:-1])
            turn = (np.arange(720) + 0.5) / 720 * 2 * np.pi
            plane = np.outer(size, np.exp(1j * turn))
            value = density.at(np.stack([plane.real.ravel(), plane.imag.ravel()]))
            ring = (
                value.reshape(plane.shape).mean(axis=1) * 2 * np.pi * size**2 * np.log(10**0.1) / 64
            )
            np.testing.assert_allclose(ring.reshape(12, 64).sum(axis=1), power, rtol=0.02)


def test_the_contact_takes_power_from_short_waves() -> None:
    center = 10 ** (np.arange(25, 37) / 10)
    place = np.stack([np.array([500.0, 2000.0]), np.zeros(2)])
    sharp, soft = (Density(center, center**-2.0, 0.0, None, length) for length in (0.0, 1e-3))
    expected = 1 / (1 + (2 * np.pi * place[0] * 1e-3) ** 2)
    np.testing.assert_allclose(soft.at(place) / sharp.at(place), expected, rtol=1e-12)


@pytest.mark.parametrize("spread", [None, 0.3])
def test_a_wide_surface_has_several_fields_which_meet(spread: float | None) -> None:
    """Compare the variance of each at random places with the power between its ends."""
    center = 10 ** (np.arange(10, 48) / 10)
    density = Density(center, center**-0.5, 0.7, spread)
    ranges = density.ranges
    assert len(ranges) == 3
    assert ranges[0][1] == density.edges[-1]
    assert all(fine[0] == coarse[1] for fine, coarse in itertools.pairwise(ranges))
    assert np.count_nonzero(center < ranges[-1][0]) <= 4
    place = scatter(20_000)
    for (low, high), field in zip(ranges, density.drawn(np.random.default_rng(1)), strict=True):
        size = np.geomspace(low, high, 4001)
        power = (
            np.sum(density.per_unit_log(np.sqrt(size[1:] * size[:-1]))) * np.log(high / low) / 4000
        )
        assert np.mean(field.at(place) ** 2) == pytest.approx(power, rel=0.06)


def test_waves_in_nearly_one_direction_are_left_to_plane_waves() -> None:
    center = 10 ** (np.arange(25, 37) / 10)
    assert Density(center, center**-1.0, 0.0, np.radians(0.3)).ranges == []
    assert Density(center, center**-1.0, 0.0, np.radians(5)).ranges


def test_a_surface_without_power_has_no_field() -> None:
    rng = np.random.default_rng(0)
    assert Density(np.array([1e3, 1.26e3]), np.zeros(2), 0.0, None).drawn(rng) == ()


SIDE = np.array([13e-3, 9.1e-3])
"""Sides of a rectangle [m]."""
PIXELS_OF_IT = np.random.default_rng(4).normal(size=(90, 130))
"""Displacement of its pixels [m]."""
FINEST = 4.9e3
"""Highest spatial frequency of the rectangle along x and y, of 4945 and 5000 [cycles/m]."""
RECTANGLE = field_of_rectangle(PIXELS_OF_IT, SIDE, FINEST)


def transformed(place: Floats, end: float) -> Floats:
    """Return the Fourier series of the rectangle's pixels, below an end [cycles/m], at places."""
    rows, columns = PIXELS_OF_IT.shape
    y = np.fft.fftfreq(rows, SIDE[1] / rows)
    x = np.fft.fftfreq(columns, SIDE[0] / columns)
    waves = np.fft.fft2(PIXELS_OF_IT) / PIXELS_OF_IT.size
    waves *= (np.abs(x) < end) & (np.abs(y)[:, None] < end)
    up = np.exp(2j * np.pi * np.outer(place[:, 1], y))
    return np.asarray(np.sum((up @ waves) * np.exp(2j * np.pi * np.outer(place[:, 0], x)), 1).real)


@pytest.mark.parametrize("level", [0, 1, 3, 8, 13])
def test_each_level_of_a_rectangle_is_the_fourier_series_of_its_pixels(level: int) -> None:
    """Images of the spline are 38 dB down at most, in a corner for each of two directions."""
    place, end = scatter(300), FINEST * THIRD**level
    exact = transformed(place, end)
    played = read(RECTANGLE, place, PASS_BAND / end * (1 + 1e-9))
    assert rms(played - exact) < 10 ** (-35 / 20) * rms(exact)


def test_a_rectangle_repeats_along_x_and_y() -> None:
    place = scatter(50)
    for step in ([SIDE[0], 0], [0, -3 * SIDE[1]], [-2 * SIDE[0], SIDE[1]]):
        assert np.abs(RECTANGLE.at(place + step) - RECTANGLE.at(place)).max() < 1e-5


def test_contactors_read_a_rectangle_at_their_places() -> None:
    place, contactors = scatter(40), scatter(30) * 0.01
    shear = np.zeros((40, 30), np.float32)
    FieldReader(RECTANGLE, contactors, band=PASS_BAND).add_to(shear, place.T, np.zeros(40))
    assert np.abs(shear - RECTANGLE.at(place[:, None] + contactors)).max() < 1e-4
