"""A texture's file becomes a surface whose spectra are those that the file states.

Spectra are counted here from the waves themselves, and once from a sampled cut that knows nothing
of waves; the tolerance is four standard errors where the sample is random.
"""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls
from texture_rig import CENTERS, EDGES, WITH_BANDS, bands, counted, edges_of, misses, rms, write

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import descriptor, surface
from tactile.texture.surface import Partials, load_texture

# Descriptors


def test_shipped_descriptors_load_and_are_realized() -> None:
    assert set(WITH_BANDS) <= set(descriptor.textures())
    for name in WITH_BANDS:  # the others: test_library.py
        texture = load_texture(name)
        assert texture.name == texture.descriptor.texture.id == name
        assert texture.descriptor.texture.category == name.split("-")[0]
        assert texture.band_error_db.shape == texture.band_frequency.shape == (20,)
        places = np.random.default_rng(1).uniform(-1, 1, (1000, 2))
        assert (
            0.2e-6 < rms(texture.partials.at(places)) < 3e-6
        )  # textures/README.md: 0.46 … 1.75 µm


def test_a_texture_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"needs at least one of \[stochastic\]"):
        load_texture(write(tmp_path / "nothing.toml"))


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_bands_that_are_no_third_octaves_are_refused(tmp_path: Path, factor: float) -> None:
    """10 % off is far beyond the rounding of nominal centers, 1.3 % at most (IEC 61260-1)."""
    centers = CENTERS.copy()
    centers[7] *= factor
    path = write(
        tmp_path / "odd.toml",
        stochastic=bands() | {"frequency_per_mm": tuple(centers.tolist())},
    )
    with pytest.raises(InputError, match="frequency_per_mm must ascend in third octaves"):
        load_texture(path)


def some_bands(count: int) -> dict[str, object]:
    """Return the table of a stochastic part of a number of bands from 0.01 cycles/mm on."""
    centers, levels = 0.01 * 10 ** (np.arange(count) / 10), 20 - 1.5 * np.arange(count)
    return {"frequency_per_mm": tuple(centers.tolist()), "level_db": tuple(levels.tolist())}


@pytest.mark.parametrize("count", [0, 3, 42])
def test_fewer_than_4_and_more_than_41_bands_are_refused(tmp_path: Path, count: int) -> None:
    """There are 41 third octaves in the range of a spatial frequency, 0.01 to 100 cycles/mm."""
    for name, allowed in (("fewest", 4), ("most", 41)):
        load_texture(write(tmp_path / f"{name}.toml", stochastic=some_bands(allowed)))
    path = write(tmp_path / "odd.toml", stochastic=some_bands(min(count, 41)))
    if count > 41:
        path.write_text(path.read_text().replace("100.0]", "100.0, 100.0]"))
    with pytest.raises(InputError, match=rf"frequency_per_mm has {count} values, needs 4 to 41"):
        load_texture(path)


@pytest.mark.parametrize("count", [4, 16, 27, 41])
def test_a_surface_has_as_many_bands_as_its_file(tmp_path: Path, count: int) -> None:
    """The power of a cut is the sum of density times width over all bands, in closed form."""
    table = some_bands(count) | {"direction_spread_deg": 1e-3}
    texture = load_texture(write(tmp_path / "many.toml", stochastic=table))
    center, level = (np.array(table[name]) for name in ("frequency_per_mm", "level_db"))
    assert texture.band_frequency == pytest.approx(center * 1e3)
    assert np.abs(texture.band_error_db).max() < 0.05
    power = np.sum(10 ** (level / 10) * center * (10**0.05 - 10**-0.05))
    assert np.sum((texture.amplitude * 1e6) ** 2) / 2 == pytest.approx(power, rel=0.01)
    isotropic = load_texture(write(tmp_path / "isotropic.toml", stochastic=some_bands(count)))
    assert np.abs(isotropic.band_error_db).max() < 0.7, "nine waves per band at worst"


@pytest.mark.parametrize("name", ["speed_range_mm_s", "force_range_n"])
def test_a_range_that_does_not_ascend_is_refused(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "range.toml", stochastic=bands(), laws={name: (2.0, 2.0)})
    with pytest.raises(InputError, match=rf"laws.{name} = \[2.0, 2.0\] must ascend"):
        load_texture(path)


# Spectra


@pytest.mark.parametrize("degrees", [-70.0, 25.0, 90.0])
def test_the_grain_turns_with_its_direction(tmp_path: Path, degrees: float) -> None:
    """Bands hold along the grain, and not 60° off, where a wave sounds at half its frequency."""
    grain = bands((0.0,) * 16, direction_deg=degrees, direction_spread_deg=8.0)
    texture = load_texture(write(tmp_path / "grain.toml", stochastic=grain))
    assert rms(misses(texture, np.array([degrees]))) <= 1.0
    assert misses(texture, np.array([degrees + 60]))[0, -1] < -20


@pytest.mark.parametrize("spread", [5.0, 15.0, 40.0])
def test_wave_vectors_scatter_with_the_stated_spread(tmp_path: Path, spread: float) -> None:
    """The standard deviation of 384 low-discrepancy draws has an error far below 2 %."""
    grain = bands(direction_deg=30.0, direction_spread_deg=spread)
    texture = load_texture(write(tmp_path / "grain.toml", stochastic=grain))
    turn = np.degrees(np.arctan2(texture.wave_vector[:, 1], texture.wave_vector[:, 0])) - 30
    turn = (turn + 180) % 360 - 180
    assert np.std(turn) == pytest.approx(spread, rel=0.02)
    assert np.mean(turn) == pytest.approx(0, abs=0.02 * spread)


@pytest.mark.parametrize(("name", "degrees"), [("leather-calf", 33.0), ("wood-oak", 0.0)])
def test_the_spectrum_of_a_sampled_cut_is_that_of_the_descriptor(name: str, degrees: float) -> None:
    """A Hann periodogram of 8 m at 50 samples/mm knows nothing of waves.

    Its resolution, 0.2 cycles/m, is a 300th of the narrowest band. Against the count of waves
    1 dB remains for lines that beat with each other within a resolution, and for lines that the
    window spreads over a band's edge; against the descriptor the design's 1 and 2.5 dB hold.
    """
    texture = load_texture(name)
    step, count = 1 / 50e3, 400_000
    turn = math.radians(degrees)
    cut = np.arange(count)[:, None] * step * np.array([math.cos(turn), math.sin(turn)])
    phase = texture.realize(5).partials.phase[: len(texture.amplitude)]
    waves = Partials(texture.wave_vector, texture.amplitude, phase)
    shear = np.concatenate([waves.at(part) for part in np.array_split(cut, 64)]) * 1e6
    window = np.hanning(count)
    spectrum = np.abs(np.fft.rfft(shear * window)) ** 2 * 2 * step * 1e3 / np.sum(window**2)
    frequency = np.fft.rfftfreq(count, step * 1e3)
    assert texture.descriptor.stochastic is not None
    edges = edges_of(texture.descriptor.stochastic)
    level = [
        10 * np.log10(np.mean(spectrum[(frequency >= low) & (frequency < high)]))
        for low, high in pairwise(edges)
    ]
    miss = np.array(level) - texture.descriptor.stochastic.level_db
    lines = counted(texture.wave_vector, texture.amplitude, degrees, edges)
    np.testing.assert_allclose(level, lines, atol=1.0)
    assert rms(miss) <= 1.0
    assert np.abs(miss).max() <= 2.5


def test_partials_are_the_displacement_that_they_say() -> None:
    """The reference adds up Σ a cos(k·p + φ) wave by wave."""
    waves = load_texture("wood-oak").partials
    place = np.array([0.013, -0.021])
    total = 0.0
    for k, a, phase in zip(waves.wave_vector, waves.amplitude, waves.phase, strict=True):
        total += a * math.cos(k[0] * place[0] + k[1] * place[1] + phase)
    assert waves.at(place) == pytest.approx(total, abs=1e-17)


def nearest_isotropic(levels: Floats) -> Floats:
    """Return what the nearest isotropic spectrum has above the levels [dB].

    320 rings of continuously spread directions: of a ring of wave number κ the share
    (2/π) (asin(b/κ) − asin(a/κ)) sounds between a and b along any direction.
    """
    ring = EDGES[0] * (EDGES[-1] / EDGES[0]) ** ((np.arange(320) + 0.5) / 320)
    share = 2 / np.pi * np.diff(np.arcsin(np.minimum(EDGES[:, None] / ring, 1)), axis=0)
    target = 10 ** (levels / 10) * np.diff(EDGES)
    power = nnls(share / target[:, None], np.ones(16))[0]
    return np.asarray(10 * np.log10(share @ power / target))


@pytest.mark.parametrize(
    ("levels", "lossy", "kept"),
    [
        (np.where(np.arange(16) == 9, 10.0, -10.0), [9], [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (np.arange(16) - 20.0, range(9, 16), [2, 3, 4]),
        (-1.0 * np.arange(16) - 15 * (np.arange(16) == 9), [10, 11, 12], [0, 1, 2, 3, 4, 5]),
    ],
    ids=["a peak", "a rise", "a rise out of a notch"],
)
def test_a_spectrum_that_no_isotropic_surface_has_reports_its_loss_per_band(
    tmp_path: Path, levels: Floats, lossy: list[int], kept: list[int]
) -> None:
    """The report is what a count gives, and what must be lost by an independent fit of rings.

    Counts agree but for a wave right on an edge. 384 waves lie within 2 dB of continuous rings
    in the band of the peak, and within 1 dB where nothing need be lost.
    """
    path = write(tmp_path / "impossible.toml", stochastic=bands(tuple(levels.tolist())))
    texture = load_texture(path)
    error, nearest = texture.band_error_db, nearest_isotropic(levels)
    miss = misses(texture, np.arange(0, 180, 2.5, dtype=np.float64))
    np.testing.assert_allclose(error, 10 * np.log10(np.mean(10 ** (miss / 10), axis=0)), atol=0.02)
    assert np.all(error[lossy] < -6)
    assert np.all(nearest[lossy] < -6)
    assert error[lossy[0]] == pytest.approx(nearest[lossy[0]], abs=2)
    np.testing.assert_allclose(error[kept], nearest[kept], atol=1)


def test_a_spectrum_that_falls_reports_no_loss(tmp_path: Path) -> None:
    texture = load_texture(write(tmp_path / "falling.toml", stochastic=bands()))
    assert np.abs(texture.band_error_db).max() < 0.2
    np.testing.assert_allclose(texture.band_frequency, CENTERS * 1e3)


@pytest.mark.parametrize(
    "levels",
    [
        -1.0 * np.arange(16),
        np.arange(16) - 20.0,
        np.where(np.arange(16) == 9, -120.0, 20.0),
    ],
    ids=["a fall", "a rise", "a hole"],
)
def test_powers_are_those_of_least_squares_without_negative_ones(
    tmp_path: Path, levels: Floats, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fit once more with `nnls` alone; normal equations of a condition of 1e3 lose 1e-13."""
    path = write(tmp_path / "fitted.toml", stochastic=bands(tuple(levels.tolist())))
    own = load_texture(path).amplitude
    monkeypatch.setattr(surface, "LARGEST_CONDITION", 0.0)
    np.testing.assert_allclose(own, load_texture(path).amplitude, rtol=1e-11)


# Seeds and numbers of waves


def test_the_same_seed_is_the_same_surface() -> None:
    one, two = (load_texture("wood-oak").realize(3) for _ in range(2))
    assert np.array_equal(one.partials.phase, two.partials.phase)
    assert np.array_equal(one.partials.amplitude, two.partials.amplitude)
    assert np.array_equal(one.envelope.phase, two.envelope.phase)
    assert np.array_equal(one.event_place, two.event_place)
    assert np.array_equal(one.event_peak, two.event_peak)
    texture = load_texture("wood-oak")
    assert np.array_equal(texture.partials.phase, texture.realize(0).partials.phase)


def test_another_seed_is_another_surface_with_the_same_bands() -> None:
    texture = load_texture("wood-oak")
    one, two = texture.realize(1), texture.realize(2)
    assert not np.any(one.partials.phase == two.partials.phase)
    assert not np.any(one.envelope.phase == two.envelope.phase)
    assert len(one.event_peak) != len(two.event_peak) or np.any(one.event_peak != two.event_peak)
    assert np.array_equal(one.partials.wave_vector, two.partials.wave_vector)
    assert np.array_equal(one.partials.amplitude, two.partials.amplitude)
    assert np.array_equal(one.envelope.amplitude, two.envelope.amplitude)


def test_phases_are_spread_evenly_over_a_turn() -> None:
    """The mean of 384 random phasors is below 4/√(2·384) in each part but once in 10⁴ seeds."""
    phase = load_texture("leather-calf").realize(11).partials.phase
    mean = np.mean(np.exp(1j * phase))
    assert max(abs(mean.real), abs(mean.imag)) < 4 / math.sqrt(2 * 384)
    assert phase.min() >= 0
    assert phase.max() < 2 * np.pi


@pytest.mark.parametrize("count", [192, 256, 384, 500])
@pytest.mark.parametrize("name", ["leather-calf", "wood-pine-sanded", "plastic-acrylic-ribbed"])
def test_as_many_waves_are_drawn_as_asked_for_gratings_included(name: str, count: int) -> None:
    waves = load_texture(name, partials=count).partials
    assert waves.wave_vector.shape == (count, 2)
    assert waves.amplitude.shape == waves.phase.shape == (count,)
    assert np.all(np.isfinite(waves.amplitude) & (waves.amplitude >= 0))


@pytest.mark.parametrize(
    ("name", "least", "gratings"),
    [("leather-calf", 160, 0), ("wood-pine-sanded", 175, 15), ("plastic-acrylic-ribbed", 185, 25)],
)
def test_too_few_waves_are_refused_with_how_many_it_needs(
    name: str, least: int, gratings: int
) -> None:
    """The texture needs eight for each band, and five for each harmonic with jitter."""
    load_texture(name, partials=least)
    for count in (least - 1, 0, -5):
        with pytest.raises(InputError) as caught:
            load_texture(name, partials=count)
        message = str(caught.value)
        assert message.startswith(f"{name}: partials = {count}: needs {gratings} for its gratings")
        assert "160 for its bands" in message
        assert "\n" not in message


def test_gratings_alone_need_no_waves_for_bands(tmp_path: Path) -> None:
    part = {"wavelength_mm": 2.0, "harmonics_um": (1.0, 0.5, 0.2)}
    path = write(tmp_path / "ribs.toml", periodic=[part])
    assert len(load_texture(path, partials=3).partials.amplitude) == 3
    assert load_texture(path).band_error_db.size == 0
    with pytest.raises(InputError, match=r"ribs.toml: partials = 2: needs 3 for its gratings$"):
        load_texture(path, partials=2)


# Gratings


@pytest.mark.parametrize("degrees", [0.0, 30.0, -110.0])
def test_a_grating_is_its_harmonics_along_its_direction(tmp_path: Path, degrees: float) -> None:
    """Σ h_n cos(2πn s/λ + φ_n) along it, nothing across it, from any seed."""
    wavelength, harmonics, phases = 1.7, (2.0, 0.5, 0.25), (10.0, -90.0, 200.0)
    part = {"wavelength_mm": wavelength, "harmonics_um": harmonics, "phases_deg": phases}
    path = write(tmp_path / "ribs.toml", periodic=[part | {"direction_deg": degrees}])
    waves = load_texture(path).realize(9).partials
    turn, rng = math.radians(degrees), np.random.default_rng(4)
    along, across = rng.uniform(-50, 50, (2, 400))
    place = np.outer(along, [math.cos(turn), math.sin(turn)])
    place += np.outer(across, [-math.sin(turn), math.cos(turn)])
    expected = np.zeros(400)
    for n, (h, phase) in enumerate(zip(harmonics, phases, strict=True), 1):
        expected += h * np.cos(2 * np.pi * n * along / wavelength + math.radians(phase))
    np.testing.assert_allclose(waves.at(place * 1e-3), expected * 1e-6, atol=1e-15)


def test_phases_are_zero_unless_given(tmp_path: Path) -> None:
    part = {"wavelength_mm": 2.0, "harmonics_um": (1.0, 0.5)}
    waves = load_texture(write(tmp_path / "ribs.toml", periodic=[part])).partials
    assert waves.at(np.zeros(2)) * 1e6 == pytest.approx(1.5, rel=1e-12)


def harmonic_groups(folder: Path, jitter: float) -> list[Partials]:
    """Return the waves of each harmonic of a jittered grating, seed 7."""
    part = {"wavelength_mm": 2.0, "harmonics_um": (1.0, 0.4), "jitter": jitter}
    path = write(folder / "ribs.toml", periodic=[part | {"direction_deg": 20.0}])
    waves = load_texture(path).realize(7).partials
    cycles = np.linalg.norm(waves.wave_vector, axis=1) / (2 * np.pi) * 2e-3
    groups = [np.rint(cycles) == n for n in (1, 2)]
    assert groups[0].sum() + groups[1].sum() == len(cycles)
    return [Partials(waves.wave_vector[g], waves.amplitude[g], waves.phase[g]) for g in groups]


@pytest.mark.parametrize("jitter", [0.01, 0.05, 0.1])
def test_jitter_keeps_power_place_and_direction_of_each_harmonic(
    tmp_path: Path, jitter: float
) -> None:
    for n, (waves, h) in enumerate(zip(harmonic_groups(tmp_path, jitter), (1.0, 0.4), strict=True)):
        assert np.sum((waves.amplitude * 1e6) ** 2) == pytest.approx(h**2, rel=1e-12)
        number = np.linalg.norm(waves.wave_vector, axis=1)
        mean = np.average(number, weights=waves.amplitude**2)
        assert mean == pytest.approx(2 * np.pi * (n + 1) / 2e-3, rel=1e-9)
        turn = np.degrees(np.arctan2(waves.wave_vector[:, 1], waves.wave_vector[:, 0]))
        np.testing.assert_allclose(turn, 20.0, atol=1e-9)


@pytest.mark.parametrize("jitter", [0.01, 0.05, 0.1])
def test_jitter_spreads_each_harmonic_by_the_stated_standard_deviation(
    tmp_path: Path, jitter: float
) -> None:
    """The deviation is of wavelength, weighted by power, to 5 % for few lines (JND: 18 %)."""
    for n, waves in enumerate(harmonic_groups(tmp_path, jitter)):
        wavelength = 2 * np.pi / np.linalg.norm(waves.wave_vector, axis=1) * (n + 1)
        power = waves.amplitude**2
        mean = np.average(wavelength, weights=power)
        spread = math.sqrt(np.average((wavelength - mean) ** 2, weights=power)) / mean
        assert spread == pytest.approx(jitter, rel=0.05)


def test_jittered_phases_are_drawn_and_steady_ones_are_not(tmp_path: Path) -> None:
    part = {"wavelength_mm": 2.0, "harmonics_um": (1.0,)}
    path = write(tmp_path / "ribs.toml", periodic=[part, part | {"jitter": 0.1}])
    one, two = (load_texture(path).realize(seed).partials.phase for seed in (1, 2))
    assert one[0] == two[0] == 0
    assert not np.any(one[1:] == two[1:])


def test_jittered_phases_are_spread_evenly_over_a_turn(tmp_path: Path) -> None:
    """The mean of 400 × 5 random phasors is below 4/√(2·2000) in each part."""
    part = {"wavelength_mm": 2.0, "harmonics_um": (1.0,), "jitter": 0.1}
    texture = load_texture(write(tmp_path / "ribs.toml", periodic=[part]))
    phase = np.concatenate([texture.realize(seed).partials.phase for seed in range(400)])
    assert len(phase) == 2000
    mean = np.mean(np.exp(1j * phase))
    assert max(abs(mean.real), abs(mean.imag)) < 4 / math.sqrt(2 * 2000)


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_a_surface_is_split_into_what_the_envelope_multiplies_and_its_gratings(
    tmp_path: Path, jitter: float
) -> None:
    part = {"wavelength_mm": 2.0, "harmonics_um": (3.0, 1.0), "jitter": jitter}
    path = write(tmp_path / "both.toml", stochastic=bands(), periodic=[part])
    surface = load_texture(path, partials=200).realize()
    ground, ribs = surface.split
    assert surface.gratings == len(ribs.amplitude) == (10 if jitter else 2)
    assert len(ground.amplitude) == 200 - surface.gratings
    together = ground + ribs
    assert np.array_equal(together.wave_vector, surface.partials.wave_vector)
    assert np.array_equal(together.phase, surface.partials.phase)
    assert 2e12 * np.sum((ribs.amplitude) ** 2) / 2 == pytest.approx(10, rel=1e-12)


# The contact's low-pass


@pytest.mark.parametrize("length", [0.3, 2.0])
def test_contact_length_is_a_low_pass_in_space(tmp_path: Path, length: float) -> None:
    """1/√(1 + (κ l)²) on every wave, gratings included; nothing at length zero."""
    tables = {
        "stochastic": bands(direction_spread_deg=20.0),
        "periodic": [{"wavelength_mm": 0.5, "harmonics_um": (1.0, 1.0)}],
    }
    plain = load_texture(write(tmp_path / "a.toml", **tables)).partials  # type: ignore[arg-type]
    tables["laws"] = {"contact_length_mm": length}
    soft = load_texture(write(tmp_path / "b.toml", **tables)).partials  # type: ignore[arg-type]
    turn = np.hypot(plain.wave_vector[:, 0], plain.wave_vector[:, 1]) * length * 1e-3
    np.testing.assert_allclose(
        soft.amplitude, plain.amplitude / np.sqrt(1 + turn**2), rtol=1e-12, atol=0
    )
    assert plain.amplitude[-1] == 1e-6
