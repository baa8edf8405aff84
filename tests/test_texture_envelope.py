"""Envelope and events of a surface have the statistics that the texture's file states.

They are compared with closed forms; the tolerance is four standard errors where the sample is
random.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.special import i0, i1
from texture_rig import FALLING, bands, rms, write

from tactile.arrays import Floats
from tactile.display.display import load_display
from tactile.errors import InputError
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.strength.commanded import commanded_lines
from tactile.texture.surface import Surface, envelope_scale, load_texture

# Envelope


@dataclass(frozen=True)
class Statistics:
    depth: float
    mean_square: float
    excess_kurtosis: float


def along_a_path(folder: Path, seed: int, *, length: float = 300.0, **more: float) -> Statistics:
    """Return what an envelope does along 300 m of a straight path, sampled every 1.7 mm."""
    texture = load_texture(write(folder / "varied.toml", stochastic=bands(FALLING, **more)))
    waves = texture.realize(seed).envelope
    s = np.arange(0, length, 1.7e-3)
    path = s[:, None] * np.array([math.cos(0.5), math.sin(0.5)])
    parts = np.array_split(path, 40)
    e = np.concatenate([envelope_scale(waves) * np.exp(waves.at(p)) for p in parts])
    square = float(np.mean(e**2))
    kurtosis = 3 * float(np.mean(e**4)) / square**2 - 3
    return Statistics(float(np.std(e) / np.mean(e)), square, kurtosis)


@pytest.mark.parametrize("depth", [0.1, 0.3, 0.6])
def test_the_envelope_has_the_stated_depth(tmp_path: Path, depth: float) -> None:
    """The mean square of the envelope is one, so that bands keep their levels.

    Twelve sinusoids are nearly a normal process: ∏ I₀(2a)/∏ I₀(a)² − 1 is 1.3 % low in its root at
    0.6, less below. A path of 300 m holds 3·10⁴ periods of the fastest, so that sampling adds 1 %.
    """
    measured = along_a_path(tmp_path, 1, am_depth=depth)
    assert measured.depth == pytest.approx(depth, rel=0.03)
    assert measured.mean_square == pytest.approx(1, abs=0.02)
    waves = load_texture(tmp_path / "varied.toml").realize(1).envelope.amplitude
    exact = math.sqrt(np.prod(i0(2 * waves)) / np.prod(i0(waves)) ** 2 - 1)
    assert measured.depth == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("depth", [0.1, 0.3, 0.6])
def test_a_modulation_alone_has_the_excess_kurtosis_of_the_closed_form(
    tmp_path: Path, depth: float
) -> None:
    """The excess kurtosis of a modulated normal process is 3⟨e⁴⟩/⟨e²⟩² − 3 = 3 ((1 + d²)⁴ − 1).

    12 sinusoids lack some of a normal process's tail, 10 % of the kurtosis at 0.6 (from
    ∏ I₀(4a)/∏ I₀(2a)²); a fourth moment over 300 m errs by 3 %.
    """
    measured = along_a_path(tmp_path, 2, am_depth=depth)
    wanted = 3 * ((1 + depth**2) ** 4 - 1)
    assert measured.excess_kurtosis == pytest.approx(wanted, rel=0.15)
    assert measured.mean_square == pytest.approx(1, abs=0.02)


def test_a_surface_under_its_envelope_has_the_excess_kurtosis_of_its_depth(
    tmp_path: Path,
) -> None:
    """The 7·10⁴ samples along 100 m are 1.37 mm apart, far beyond the correlation length.

    Of the surface alone it is that of 384 sinusoids, −1.5 Σa⁴/(Σa²)², above −0.01, ± √(24/n).
    Under the envelope, 3 (1.09⁴ − 1) = 1.23, fourth powers have four times the spread: ± 0.15.
    """
    texture = load_texture(write(tmp_path / "varied.toml", stochastic=bands(am_depth=0.3)))
    surface = texture.realize(3)
    path = np.arange(0, 100, 1.37e-3)[:, None] * np.array([math.cos(0.3), math.sin(0.3)])
    parts = np.array_split(path, 60)
    plain = np.concatenate([surface.partials.at(part) for part in parts])
    exponent = np.concatenate([surface.envelope.at(part) for part in parts])
    varied = plain * envelope_scale(surface.envelope) * np.exp(exponent)

    def excess(x: Floats) -> float:
        return float(np.mean(x**4) / np.mean(x**2) ** 2 - 3)

    assert excess(plain) == pytest.approx(0, abs=4 * math.sqrt(24 / len(path)))
    assert excess(varied) == pytest.approx(1.23, abs=0.15)
    assert rms(varied) == pytest.approx(rms(plain), rel=0.02)


def test_modulation_is_no_faster_than_its_corner_and_bursts_are_three_times_it_and_more(
    tmp_path: Path,
) -> None:
    """The variance below the corner, along 720 strokes, is the depth's for both together."""
    stochastic = bands(am_depth=0.2, excess_kurtosis=1.0, am_corner_per_mm=0.3)
    texture = load_texture(write(tmp_path / "varied.toml", stochastic=stochastic))
    waves = texture.realize().envelope
    cycles = np.linalg.norm(waves.wave_vector, axis=1) / (2 * np.pi) * 1e-3
    slow, fast = np.split(cycles, 2)
    assert 0.8 * 0.3 < slow.max() <= 0.3
    assert 0.9 < fast.min() < fast.max() <= 1.35
    turn = np.arange(720) * np.pi / 720
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1) @ waves.wave_vector.T
    below = np.abs(along) <= 0.3e3 * 2 * np.pi
    variance = np.mean(below @ waves.amplitude**2 / 2)
    assert math.sqrt(math.expm1(variance)) == pytest.approx(0.2, rel=1e-2)


def test_the_envelope_of_a_grained_surface_lies_along_its_grain(tmp_path: Path) -> None:
    """Depth and corner of the envelope hold along the stroke for which the bands hold."""
    stochastic = bands(am_depth=0.2, excess_kurtosis=1.0, direction_deg=40.0)
    path = write(tmp_path / "grain.toml", stochastic=stochastic | {"direction_spread_deg": 10.0})
    waves = load_texture(path).realize().envelope
    turn = np.degrees(np.arctan2(waves.wave_vector[:, 1], waves.wave_vector[:, 0]))
    assert np.mean(turn) == pytest.approx(40, abs=2)
    assert np.std(turn) == pytest.approx(10, rel=0.25)


@pytest.mark.parametrize("kurtosis", [0.5, 2.0, 4.0])
def test_three_quarters_of_bursts_and_the_slow_waves_bring_the_stated_kurtosis(
    tmp_path: Path, kurtosis: float
) -> None:
    """A quarter of what bursts bring is carried beyond the bands, by measurement.

    Of independent sinusoids ⟨exp(n Σ)⟩ is ∏ I₀(n a), so that a normal process under them has
    3 ∏ I₀(4a)/∏ I₀(2a)² − 3: exactly, where a normal g of their variance would bring 1 … 10 % more.
    """
    for depth in (0.0, 0.1):
        stochastic = bands(am_depth=depth, excess_kurtosis=kurtosis)
        waves = load_texture(write(tmp_path / "varied.toml", stochastic=stochastic)).realize()
        a = waves.envelope.amplitude
        within = a[-12:] * math.sqrt(0.75)
        if len(a) > 12:
            within = np.concatenate([within, a[:12]])
        found = 3 * np.prod(i0(4 * within)) / np.prod(i0(2 * within)) ** 2 - 3
        assert found == pytest.approx(kurtosis, rel=0.03)


def test_phases_of_an_envelope_are_spread_evenly_over_a_turn(tmp_path: Path) -> None:
    """The mean of 100 × 24 random phasors is below 4/√(2·2400) in each part."""
    stochastic = bands(am_depth=0.2, excess_kurtosis=1.0)
    texture = load_texture(write(tmp_path / "varied.toml", stochastic=stochastic))
    phase = np.concatenate([texture.realize(seed).envelope.phase for seed in range(100)])
    assert len(phase) == 2400
    mean = np.mean(np.exp(1j * phase))
    assert max(abs(mean.real), abs(mean.imag)) < 4 / math.sqrt(2 * 2400)


def test_depth_that_brings_more_kurtosis_than_stated_adds_no_bursts(tmp_path: Path) -> None:
    """A depth of 0.3 alone gives 3 (1.09⁴ − 1) = 1.2."""
    for kurtosis, waves in ((0.0, 12), (1.1, 12), (1.3, 24)):
        stochastic = bands(am_depth=0.3, excess_kurtosis=kurtosis)
        texture = load_texture(write(tmp_path / "varied.toml", stochastic=stochastic))
        assert len(texture.realize().envelope.amplitude) == waves


def test_without_depth_and_kurtosis_there_is_no_envelope(tmp_path: Path) -> None:
    even = load_texture(write(tmp_path / "even.toml", stochastic=bands()))
    ribs = write(tmp_path / "ribs.toml", periodic=[{"wavelength_mm": 2.0, "harmonics_um": (1.0,)}])
    for texture in (even, load_texture(ribs)):
        assert len(texture.realize().envelope.amplitude) == 0


# Periodic envelope

RIBBED = {"wavelength_mm": 2.0, "depth": 0.8}
"""Ribs whose envelope is exp(a cos) with 2 I₁(a)/I₀(a) = 0.8, that is a = 0.871."""


@pytest.mark.parametrize("depth", [0.1, 0.5, 1.0])
def test_a_periodic_envelope_has_the_stated_fundamental_and_a_mean_square_of_one(
    tmp_path: Path, depth: float
) -> None:
    """One period in 1000 steps is exact. The crest lies at the origin, whatever the seed."""
    part = {"wavelength_mm": 2.0, "depth": depth}
    texture = load_texture(write(tmp_path / "r.toml", stochastic=bands(), modulation=[part]))
    waves = texture.realize(7).envelope
    place = np.arange(1000)[:, None] * np.array([2e-6, 1e-3])
    e = envelope_scale(waves) * np.exp(waves.at(place))
    assert np.mean(e**2) == pytest.approx(1, abs=1e-9)
    fundamental = 2 * np.fft.rfft(e)[1] / e.sum()
    assert fundamental == pytest.approx(depth, abs=1e-9)


def test_a_periodic_envelope_brings_its_kurtosis_beside_that_of_the_slow_waves(
    tmp_path: Path,
) -> None:
    """Independent factors multiply ⟨e⁴⟩/⟨e²⟩²: a wave alone has I₀(4a)/I₀(2a)²."""
    amplitude = []
    for modulation in ([], [RIBBED]):
        path = write(tmp_path / "r.toml", stochastic=bands(am_depth=0.3), modulation=modulation)
        amplitude.append(load_texture(path).realize(1).envelope.amplitude)
    np.testing.assert_array_equal(amplitude[1][:-1], amplitude[0])
    a = amplitude[1][-1]
    assert 2 * i1(a) / i0(a) == pytest.approx(0.8)
    place = 2 * np.pi * np.arange(1000) / 1000
    e = np.exp(a * np.cos(place))
    assert np.mean(e**4) / np.mean(e**2) ** 2 == pytest.approx(i0(4 * a) / i0(2 * a) ** 2)


def test_a_modulated_surface_is_strongest_on_its_ribs_and_keeps_its_power(tmp_path: Path) -> None:
    """Strength folded over the period follows the envelope; the whole power stays.

    The mean square over a phase is exp(2a cos φ)/I₀(2a). 24 contactors, 4 s at 100 mm/s and three
    seeds give 14 400 periods; the lowest band, of 4 mm, is what errs, by 3 % per phase.
    """
    display, power, squares = load_display("reference-24"), [], np.zeros(16)
    for modulation in ([], [RIBBED]):
        file = write(tmp_path / "r.toml", stochastic=bands(), modulation=modulation)
        texture, sums = load_texture(file), []
        for seed in range(3):
            path = Trajectory.line(speed=0.1, duration=4.5)
            shear = render(display, texture, path, seed=seed).shear[4000:]
            sums.append(np.mean(shear**2))
            phase = (0.1 * (np.arange(len(shear)) + 4000) / 8000)[:, None] + display.contactors[
                :, 0
            ]
            if modulation:
                bin_of = ((phase / 2e-3) % 1 * 16).astype(int) % 16
                squares += np.bincount(bin_of.ravel(), shear.ravel() ** 2, 16)
        power.append(np.mean(sums))
    assert power[1] == pytest.approx(power[0], rel=0.03)
    a = load_texture(tmp_path / "r.toml").realize().envelope.amplitude[0]
    turn = np.exp(2j * np.pi * (np.arange(16) + 0.5) / 16)
    folded = squares @ turn.conj() / squares.sum()
    assert folded.real == pytest.approx(i1(2 * a) / i0(2 * a), abs=0.05)


def test_the_commanded_spectrum_keeps_the_power_and_moves_it_into_sidebands(
    tmp_path: Path,
) -> None:
    """The share at the carrier of exp(a cos) is I₀(a)²/I₀(2a)."""
    plain = commanded_lines(
        load_texture(write(tmp_path / "r.toml", stochastic=bands())), speed=0.05, normal_force=0.5
    )
    ribbed = load_texture(write(tmp_path / "r.toml", stochastic=bands(), modulation=[RIBBED]))
    moved = commanded_lines(ribbed, speed=0.05, normal_force=0.5)
    assert moved.power.sum() == pytest.approx(plain.power.sum(), rel=1e-9)
    a = ribbed.realize().envelope.amplitude[0]
    third = moved.power.reshape(-1, 3).sum(axis=0) / moved.power.sum()
    assert third[0] == pytest.approx(i0(a) ** 2 / i0(2 * a), rel=1e-9)
    assert third[1] == pytest.approx(third[2])


def test_a_modulation_without_a_random_part_is_refused(tmp_path: Path) -> None:
    rib = [{"wavelength_mm": 2.0, "harmonics_um": (1.0,)}]
    path = write(tmp_path / "ribs.toml", periodic=rib, modulation=[RIBBED])
    with pytest.raises(InputError, match=r"\[\[modulation\]\] has nothing to modulate"):
        load_texture(path)


# Events

PORES = {"density_per_mm2": 0.7, "amplitude_um": 2.5, "amplitude_sd": 0.6, "width_mm": 0.4}
GRIT = {"density_per_mm2": 0.1, "amplitude_um": 9.0, "width_mm": 1.0, "shape": "edge"}
TILE = 25.6
"""Length of a side of the tile [mm]."""


def scattered(folder: Path, seeds: int) -> list[Surface]:
    texture = load_texture(write(folder / "pores.toml", events=[PORES, GRIT]))
    return [texture.realize(seed) for seed in range(seeds)]


def test_events_are_as_dense_as_stated_and_poisson_in_number(tmp_path: Path) -> None:
    """Variance over mean of n Poisson counts is 1 ± √(2/n)."""
    surfaces, seeds = scattered(tmp_path, 200), 200
    for kind, density in enumerate((0.7, 0.1)):
        counts = np.array([np.count_nonzero(s.event_kind == kind) for s in surfaces])
        mean = density * TILE**2
        assert counts.mean() == pytest.approx(mean, abs=4 * math.sqrt(mean / seeds))
        assert counts.var() / counts.mean() == pytest.approx(1, abs=4 * math.sqrt(2 / seeds))


def test_events_are_scattered_evenly_over_the_tile(tmp_path: Path) -> None:
    """Counts in 64 cells: χ² of 63 degrees of freedom, 63 ± 4 √126."""
    surfaces = scattered(tmp_path, 40)
    place = np.concatenate([s.event_place for s in surfaces]) * 1e3
    assert surfaces[0].tile == TILE * 1e-3
    assert place.min() >= 0
    assert place.max() < TILE
    cells = np.bincount(np.ravel_multi_index(tuple((place / TILE * 8).astype(int).T), (8, 8)))
    chi = np.sum((cells - cells.mean()) ** 2) / cells.mean()
    assert chi == pytest.approx(63, abs=4 * math.sqrt(126))


def test_event_amplitudes_are_log_normal_with_the_stated_median_and_spread(
    tmp_path: Path,
) -> None:
    """ln|a| of n events is normal: mean ± σ/√n, deviation ± σ/√(2n), skewness ± √(6/n)."""
    surfaces = scattered(tmp_path, 40)
    peak = np.concatenate([s.event_peak[s.event_kind == 0] for s in surfaces]) * 1e6
    log, n = np.log(np.abs(peak)), len(peak)
    assert np.mean(log) == pytest.approx(math.log(2.5), abs=4 * 0.6 / math.sqrt(n))
    assert np.std(log) == pytest.approx(0.6, abs=4 * 0.6 / math.sqrt(2 * n))
    assert np.mean(((log - log.mean()) / log.std()) ** 3) == pytest.approx(
        0, abs=4 * math.sqrt(6 / n)
    )
    grit = np.concatenate([s.event_peak[s.event_kind == 1] for s in surfaces])
    np.testing.assert_allclose(np.abs(grit), 9e-6, rtol=1e-12)
