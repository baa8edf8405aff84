"""A fit finds the surface that a slide was made of: bands, gratings, laws, and what it cannot know.

Slides are made in `slides`, from closed forms.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slides import Surface, slide

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import fitting, judging
from tactile.texture.descriptor import About, Laws, Reference
from tactile.texture.descriptor_file import write
from tactile.texture.fitting import Fit, describe, measure_slides
from tactile.texture.friction_fit import fit_friction
from tactile.texture.lines import common_lines
from tactile.texture.recorded_slide import Recorded

ABOUT = About(
    id="known", category="test", description="known", provenance="fitted", source="slides",
    license="CC0-1.0",
)  # fmt: skip
SPEEDS = (0.02, 0.03, 0.05, 0.06)


def fit(recordings: list[Recorded], noise: Recorded | None = None) -> Fit:
    return describe(measure_slides(recordings, noise=noise, reference_speed=0.04), ABOUT)


def errors(found: Fit, surface: Surface) -> Floats:
    """Return the bands' errors [dB]; a density that falls as k^slope is met at the center."""
    stochastic = found.descriptor.stochastic
    assert stochastic is not None
    k = np.asarray(stochastic.frequency_per_mm)
    edges = 10**-0.05, 10**0.05
    power = surface.slope + 1
    mean = 1 if power == 0 else (edges[1] ** power - edges[0] ** power) / power
    mean = np.log(edges[1] / edges[0]) if power == 0 else mean
    wanted = 10 * np.log10(surface.density(k) * mean / (edges[1] - edges[0]))
    return np.asarray(np.asarray(stochastic.level_db) - wanted)


@pytest.mark.parametrize(
    "quantity",
    [
        "acceleration",
        "force",
        pytest.param("velocity", marks=pytest.mark.ci),
        pytest.param("displacement", marks=pytest.mark.ci),
    ],
)
def test_every_quantity_gives_the_bands_it_was_made_of(quantity: str) -> None:
    surface = Surface(level_db=-5, slope=-2)
    slides = [
        slide(surface, v, quantity=quantity, seed=k)  # type: ignore[arg-type]
        for k, v in enumerate(SPEEDS)
    ]
    error = errors(fit(slides), surface)
    # n = 2 · 0.23 k · length per band: 1.0 dB at 0.6 cycles/mm, 0.2 dB at 20, of 480 mm in all
    assert np.abs(error.mean()) < 0.3
    assert np.sqrt(np.mean(error**2)) < 0.7


def test_the_laws_are_found_from_several_speeds_and_forces() -> None:
    surface = Surface(exponent=-0.6, force_exponent=0.9)
    grid = [(v, n) for v in (0.02, 0.04, 0.08) for n in (0.2, 0.5, 1.5)]
    slides = [slide(surface, v, force=n, seed=k) for k, (v, n) in enumerate(grid)]
    found = fit(slides)
    laws = found.descriptor.laws
    # the prior pulls by what its variance is of the sum: 25 and 3 % of the way
    assert laws.speed_exponent == pytest.approx(-0.6, abs=0.12)
    assert laws.force_exponent == pytest.approx(0.9, abs=0.1)
    assert found.exponent_error[0] < 0.15
    assert laws.force_range_n == pytest.approx((0.2 / 1.15, 1.5 * 1.15), rel=0.01)


def test_one_speed_and_one_force_leave_the_laws_at_what_is_known_and_say_so() -> None:
    found = fit([slide(Surface(), 0.04, seed=k) for k in range(3)])
    assert found.descriptor.laws.speed_exponent == -1.0
    assert found.descriptor.laws.force_exponent == 0.4
    assert any("speed exponent is assumed" in note for note in found.notes)
    assert any("normal force not told" in note for note in found.notes)


def test_exponents_are_the_posterior_of_a_normal_prior() -> None:
    """References are the limits of no and much evidence, and a closed form for two points."""
    one = np.ones(2)
    value, error = fitting.exponents(one, one, np.array([0.0, 3.0]))
    assert value == pytest.approx([-1, 0.4])
    assert error == pytest.approx([0.15, 0.3])
    v, n = np.random.default_rng(0).uniform(0.1, 10, (2, 1000))
    value, error = fitting.exponents(v, n, 20 * (0.7 * np.log10(v) - 0.3 * np.log10(n)))
    assert value == pytest.approx([0.7, -0.3], abs=0.01)
    assert error.max() < 0.01
    # two points, which their line meets: the scatter is the one assumed, 3 dB
    told, told_before = 400 * (0.25 + 0.25) / 9, 0.15**-2
    value, error = fitting.exponents(np.array([1.0, 10.0]), one, np.array([0.0, 20.0]))
    assert value[0] == pytest.approx((told - told_before) / (told + told_before))
    assert error[0] == pytest.approx((told + told_before) ** -0.5)


def test_noise_of_the_sensor_is_taken_off_as_power() -> None:
    surface = Surface(level_db=-5, slope=-3.5)
    slides = [slide(surface, v, seed=k, noise=2.0) for k, v in enumerate(SPEEDS)]
    still = slide(Surface(level_db=-300), 0.04, seed=99, noise=2.0)
    with_noise, without = errors(fit(slides), surface), errors(fit(slides, still), surface)
    assert with_noise[-3:].mean() > 6
    assert np.abs(without[-3:]).max() < 2


def test_ribs_are_found_with_wavelength_height_and_shape() -> None:
    ribs = Surface(
        level_db=-25, wavelength_mm=2.6, harmonics_um=(4.0, 2.0, 1.0), phases=(0.0, 1.0, -2.0)
    )
    slides = [slide(ribs, v, seed=k) for k, v in enumerate(SPEEDS)]
    found = fit(slides)
    (grating,) = found.descriptor.periodic
    assert grating.wavelength_mm == pytest.approx(2.6, rel=2e-3)
    assert grating.harmonics_um == pytest.approx((4, 2, 1), rel=0.08)
    assert grating.phases_deg == pytest.approx((0, np.degrees(1), np.degrees(-2)), abs=8)
    assert np.abs(errors(found, ribs)).max() < 4, "ribs are taken off the bands"


def test_a_speed_that_is_a_percent_off_does_not_hide_the_ribs() -> None:
    ribs = Surface(level_db=-20, wavelength_mm=1.3, harmonics_um=(3.0,))
    slides = [slide(ribs, v, seed=k) for k, v in enumerate(SPEEDS)]
    off = [
        Recorded(
            name=s.name, signal=s.signal, quantity=s.quantity, sample_rate=s.sample_rate,
            speed=s.speed * f,
        )
        for s, f in zip(slides, (1.006, 0.994, 1.004, 0.997), strict=True)
    ]  # fmt: skip
    (grating,) = fit(off).descriptor.periodic
    assert grating.wavelength_mm == pytest.approx(1.3, rel=0.01)
    assert grating.harmonics_um[0] == pytest.approx(3.0, rel=0.1)


def test_a_hum_is_no_rib() -> None:
    slides = [slide(Surface(), v, seed=k, noise=0.05, hum_hz=120) for k, v in enumerate(SPEEDS)]
    assert fit(slides).descriptor.periodic == ()
    mostly_one = [
        slide(Surface(), v, seed=k, noise=0.05, hum_hz=120)
        for k, v in enumerate((0.04, 0.04, 0.06))
    ]
    assert fit(mostly_one).descriptor.periodic == ()


@pytest.mark.parametrize("speeds", [(0.02, 0.03), SPEEDS])
def test_harmonics_of_a_hum_that_meet_at_one_spatial_frequency_are_no_ribs(
    speeds: tuple[float, ...],
) -> None:
    """50 Hz and its harmonics: 100 Hz at 20 mm/s and 150 Hz at 30 mm/s are 5 cycles/mm."""
    hum = []
    for k, v in enumerate(speeds):
        plain = slide(Surface(), v, seed=k)
        time = np.arange(len(plain.signal)) / plain.sample_rate
        waves = np.sin(2 * np.pi * np.outer(time, 50.0 * np.arange(1, 13))).sum(axis=1)
        hum.append(replace(plain, signal=plain.signal + 1.0 * waves))
    measured = measure_slides(hum, reference_speed=0.04)
    strokes = [u for s in measured.slides for u in s.strokes]
    speed = np.array([s.speed for s in measured.slides for _ in s.strokes])
    lines = common_lines(strokes, measured.step, speed, 20e3)
    assert any(line.frequency == pytest.approx(5e3, rel=0.02) for line in lines)
    assert measured.gratings == []


@pytest.mark.parametrize("speeds", [(0.02, 0.03), (0.04, 0.04, 0.06), SPEEDS])
def test_many_harmonics_of_ribs_at_speeds_of_a_simple_ratio_are_ribs(
    speeds: tuple[float, ...],
) -> None:
    """The sixth harmonic at 20 mm/s has the frequency of the fourth one at 30 mm/s."""
    ribs = Surface(level_db=-35, wavelength_mm=2.6, harmonics_um=(4.0, *[2.0] * 11))
    found = fit([slide(ribs, v, seed=k) for k, v in enumerate(speeds)])
    (grating,) = found.descriptor.periodic
    assert grating.wavelength_mm == pytest.approx(2.6, rel=2e-3)
    assert len(grating.harmonics_um) >= 9


def test_a_hum_at_a_third_of_the_frequency_of_ribs_is_not_their_fundamental() -> None:
    """12 Hz lie at 0.3 cycles/mm in two of three recordings, and ribs at three times that."""
    ribs = Surface(level_db=-35, wavelength_mm=1.11, harmonics_um=(3.0, 1.0))
    slides = [
        slide(ribs, v, seed=k, noise=0.01, hum_hz=12) for k, v in enumerate((0.04, 0.04, 0.06))
    ]
    measured = measure_slides(slides, reference_speed=0.04)
    strokes, speed = [s.strokes[0] for s in measured.slides], measured.speed
    lines = common_lines(strokes, measured.step, speed, 20e3)
    assert any(line.frequency == pytest.approx(300, rel=0.02) for line in lines)
    (grating,) = measured.gratings
    assert grating.frequency == pytest.approx(901, rel=0.005)


@pytest.mark.parametrize("ribs", [True, False])
def test_lines_at_one_speed_stay_in_the_bands_and_are_counted(ribs: bool) -> None:
    """Nothing tells a rib of 1/3 mm from a hum of 120 Hz at 40 mm/s."""
    surface = Surface(wavelength_mm=1 / 3, harmonics_um=(3.0,)) if ribs else Surface()
    hum = 0.0 if ribs else 120.0
    found = fit([slide(surface, 0.04, seed=k, noise=0.05, hum_hz=hum) for k in range(3)])
    assert found.descriptor.periodic == ()
    assert "one speed: 1 line left in the bands; record a second speed" in found.notes
    peak = int(np.argmin(np.abs(found.center - 3e3)))
    assert errors(found, Surface())[peak] > 3, "the line"
    two = fit([slide(surface, v, seed=k, noise=0.05, hum_hz=hum) for k, v in enumerate(SPEEDS)])
    assert len(two.descriptor.periodic) == ribs
    assert not any("left in the bands" in note for note in two.notes)


def test_noise_alone_has_no_lines() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        strokes = [rng.standard_normal(6000) for _ in range(3)]
        assert common_lines(strokes, 1e-5, np.full(3, 0.05), 20000) == []


def test_noise_that_ends_within_the_spectrum_has_no_line_at_its_end() -> None:
    """A median around the end is that of what is left above it, 60 dB lower."""
    rng = np.random.default_rng(8)
    end = np.fft.rfftfreq(6000, 1e-5) > 15e3
    for _ in range(20):
        spectra = np.fft.rfft(rng.standard_normal((3, 6000)))
        spectra[:, end] *= 1e-3
        strokes = list(np.fft.irfft(spectra, 6000))
        assert common_lines(strokes, 1e-5, np.full(3, 0.05), 20000) == []


def test_a_grating_is_not_finer_than_one_of_a_file(tmp_path: Path) -> None:
    """Lines at 67 cycles/mm stay in the bands; at 40 cycles/mm they are a grating."""
    found = {}
    for wavelength in (0.015, 0.025):
        surface = Surface(level_db=-10, wavelength_mm=wavelength, harmonics_um=(0.5,))
        slides = [slide(surface, v, seconds=5, seed=k) for k, v in enumerate((4e-3, 5e-3, 6e-3))]
        descriptor = fit(slides).descriptor
        write(descriptor, tmp_path / "known.toml", force=True)
        found[wavelength] = [p.wavelength_mm for p in descriptor.periodic]
    assert found == {0.015: [], 0.025: [pytest.approx(0.025, rel=1e-3)]}


def test_a_spectrum_that_no_isotropic_surface_has_is_given_a_direction_and_its_loss() -> None:
    rising = fit([slide(Surface(slope=1.0), v, seed=k) for k, v in enumerate(SPEEDS)])
    assert rising.descriptor.stochastic is not None
    assert rising.descriptor.stochastic.direction_spread_deg == 15, "as of the shipped woods"
    assert np.abs(rising.isotropic_loss).max() > 2
    falling = fit([slide(Surface(slope=-2.5), v, seed=k) for k, v in enumerate(SPEEDS)])
    assert falling.descriptor.stochastic is not None
    assert falling.descriptor.stochastic.direction_spread_deg is None


@pytest.mark.parametrize(
    "speeds", [(0.019,), (0.02, 0.03), (0.05, 0.06), (0.01, 0.1), (0.2,), (0.004,)]
)
def test_bands_reach_from_10_hz_at_the_fastest_speed_to_800_hz_at_the_slowest(
    speeds: tuple[float, ...],
) -> None:
    """Bands cover the one of 800 Hz, at 20 mm/s if all are faster, but for a tenth of a band.

    They end at 100 cycles/mm, as files do.
    """
    slides = [slide(Surface(), v, seed=k) for k, v in enumerate(speeds)]
    center = measure_slides(slides).center
    assert np.diff(np.log10(center)) == pytest.approx(0.1)
    assert np.log10(center) * 10 == pytest.approx(np.round(np.log10(center) * 10), abs=1e-6)
    assert 1 <= center[0] * 10**-0.05 * speeds[-1] / 10 < 10**0.1
    top = min(800 / min(*speeds, 0.02), 100e3)
    assert 10**-0.01 <= center[-1] / top * (1 + 1e-9) < 10**0.09


def test_a_surface_so_slow_that_no_band_is_one_of_skin_is_refused() -> None:
    with pytest.raises(InputError, match=r"0.4 mm/s: too slow to fit; at least 0.5 mm/s bring 25"):
        measure_slides([slide(Surface(), 0.0004)])
    assert len(measure_slides([slide(Surface(), 0.0005)]).center) >= 4


def test_fast_strokes_tell_what_slow_ones_feel_like() -> None:
    """Each level is that of the power law at its center, also at 800 Hz at 20 mm/s."""
    surface = Surface(level_db=-5, slope=-3.0)
    found = fit([slide(surface, v, seed=k, seconds=6.0) for k, v in enumerate((0.05, 0.06))])
    assert found.center[-1] * 0.02 == pytest.approx(800, rel=0.01)
    assert np.isfinite(found.level[:, -1]).all()
    error = errors(found, surface)
    assert np.abs(error[found.center * 0.02 > 40]).max() < 1.5


def test_a_recording_that_covers_less_leaves_no_step_in_the_bands() -> None:
    """One recording is 9 dB louder than the others and alone in the lowest bands."""
    level = np.tile(-3.0 * np.arange(22.0), (3, 1))
    level[2] += 9
    level[:2, :4] = np.nan
    assert np.diff(bands_of(level)) == pytest.approx(-3.0, abs=0.11)


def test_bands_beyond_what_was_recorded_go_on_straight_and_are_named() -> None:
    surface = Surface(slope=-3.0)
    slides = [slide(surface, 0.04, seed=k, rate=2000.0) for k in range(3)]
    found = describe(measure_slides(slides, reference_speed=0.04), ABOUT)
    assert np.isnan(found.level[:, -1]).all()
    assert any("were not recorded" in note for note in found.notes)
    assert np.abs(errors(found, surface)[-1]) < 2


def test_an_uncalibrated_recording_gets_the_level_that_is_assumed() -> None:
    calibrated = [slide(Surface(), v, seed=k) for k, v in enumerate(SPEEDS)]
    counts = [
        Recorded(
            name=s.name, signal=s.signal * 1234, quantity=s.quantity, sample_rate=s.sample_rate,
            speed=s.speed, calibrated=False,
        )
        for s in calibrated
    ]  # fmt: skip
    found, known = fit(counts), fit(calibrated)
    assert found.descriptor.stochastic is not None
    assert known.descriptor.stochastic is not None
    level = np.asarray(found.descriptor.stochastic.level_db)
    width = found.center * 1e-3 * (10**0.05 - 10**-0.05)
    core = (found.center * 0.04 > 23) & (found.center * 0.04 < 900)
    assert np.sum((10 ** (level / 10) * width)[core]) == pytest.approx(1.0, rel=0.02)
    shift = level - np.asarray(known.descriptor.stochastic.level_db)
    assert shift == pytest.approx(shift[0], abs=0.11)
    assert "uncalibrated" in found.notes[0]


def test_kurtosis_and_modulation_are_those_of_the_slide() -> None:
    """A log-normal envelope of var s: kurtosis 3 (exp(4s) − 1), depth √(exp s − 1)."""
    depth = 0.4
    s = np.log(1 + depth**2)
    slides = []
    for seed in range(4):
        plain = slide(Surface(slope=-2), 0.04, seed=seed, seconds=6.0, quantity="displacement")
        place = 0.04 * np.arange(len(plain.signal)) / plain.sample_rate * 1e3
        rng = np.random.default_rng(seed)
        waves = np.cos(
            np.outer(place, 2 * np.pi * np.linspace(0.02, 0.1, 8)) + rng.uniform(0, 7, 8)
        )
        swell = np.exp(waves @ np.full(8, np.sqrt(2 * s / 8)) - s)
        slides.append(
            Recorded(
                name="m", signal=plain.signal * swell, quantity="displacement",
                sample_rate=plain.sample_rate, speed=plain.speed,
            )
        )  # fmt: skip
    stochastic = fit(slides).descriptor.stochastic
    assert stochastic is not None
    # four strokes of 240 mm, 24 of the envelope's shortest periods each
    assert stochastic.am_depth == pytest.approx(depth, abs=0.08)
    assert stochastic.excess_kurtosis == pytest.approx(3 * (np.exp(4 * s) - 1), abs=1.0)
    assert 0.06 <= stochastic.am_corner_per_mm <= 0.25


def test_friction_comes_from_two_forces() -> None:
    """µ = 0.4 + 0.5 exp(−(v/12)²), N^−0.2."""
    rng = np.random.default_rng(0)
    rate, seconds = 2000.0, 10.0
    t = np.arange(round(rate * seconds)) / rate
    speed = 0.04 * (1 - np.cos(2 * np.pi * t / seconds)) / 2 + 1e-4
    normal = 0.5 + 0.3 * np.sin(2 * np.pi * 1.7 * t)
    mu = (0.4 + 0.5 * np.exp(-((speed / 0.012) ** 2))) * (normal / 0.5) ** -0.2
    recorded = Recorded(
        name="f", signal=rng.standard_normal(len(t)), quantity="acceleration", sample_rate=rate,
        speed=speed, normal_force=normal,
        tangential_force=mu * normal * (1 + 0.02 * rng.standard_normal(len(t))),
    )  # fmt: skip
    laws = Laws(force_range_n=(0.15, 1.0))
    friction = fit_friction([recorded], Reference(speed_mm_s=40.0, normal_force_n=0.5), laws)
    assert friction.kinetic_coefficient == pytest.approx(0.4, abs=0.02)
    assert friction.static_coefficient == pytest.approx(0.9, abs=0.04)
    assert friction.stribeck_speed_mm_s == pytest.approx(12, abs=1)
    assert friction.force_exponent == pytest.approx(-0.2, abs=0.05)
    assert friction.stick_slip == 0.0


def test_a_force_that_is_never_more_than_a_touch_gives_a_range_around_its_mean() -> None:
    """No sample is one of a pressing finger."""
    recorded = slide(Surface(), 0.04)
    force = np.full(len(recorded.signal), 0.02)
    fit, _ = judging.fit_texture([replace(recorded, normal_force=force)], ABOUT)
    assert fit.descriptor.laws.force_range_n == pytest.approx((0.02 / 1.15, 0.02 * 1.15), abs=1e-3)


def test_recordings_of_two_kinds_are_refused() -> None:
    slides = [slide(Surface(), 0.04), slide(Surface(), 0.04, quantity="velocity")]
    with pytest.raises(InputError, match="velocity, calibrated; slide0 is acceleration"):
        measure_slides(slides)
    with pytest.raises(InputError, match="no recording; give at least one"):
        measure_slides([])


def test_a_speed_that_is_not_steady_is_refused_with_what_would_do() -> None:
    s = slide(Surface(), 0.04)
    wild = 0.04 + 0.035 * np.sin(2 * np.pi * 4 * np.arange(len(s.signal)) / s.sample_rate)
    with pytest.raises(InputError, match=r"speed is not steady: .* slide longer and more evenly"):
        measure_slides(
            [Recorded(name="w", signal=s.signal, quantity=s.quantity, sample_rate=1e4, speed=wild)]
        )


def test_a_stroke_is_at_least_ten_periods_of_the_lowest_band() -> None:
    """25 Hz lies at 0.631 cycles/mm at 40 mm/s, a preferred number: 15.8 mm are 0.396 s.

    0.8 s are ten periods of 0.316 cycles/mm, in which 10 Hz begin.
    """
    for seconds, lowest in ((0.41, 0.631), (0.75, 0.631), (0.82, 0.316), (6.0, 0.316)):
        found = measure_slides([slide(Surface(), 0.04, seconds=seconds)], reference_speed=0.04)
        assert found.center[0] == pytest.approx(lowest * 1e3, rel=3e-3)
    too_short = slide(Surface(), 0.04, seconds=0.38, seed=1)
    with pytest.raises(InputError, match=r"slide1: .* for 15\.2 mm at most, needs 15\.8 mm"):
        measure_slides([slide(Surface(), 0.04), too_short], reference_speed=0.04)


@pytest.mark.parametrize(("seconds", "short"), [(2.9, True), (3.0, False), (3.1, False)])
def test_less_than_3_s_in_all_is_noted(seconds: float, short: bool) -> None:
    found = fit([slide(Surface(), 0.04, seconds=seconds)])
    assert any("s in all: bands want 3 s or more" in note for note in found.notes) == short


@pytest.mark.parametrize(("count", "few"), [(2, True), (3, False)])
def test_fewer_than_three_recordings_are_noted_and_tell_no_spread(count: int, few: bool) -> None:
    found = fit([slide(Surface(), 0.04, seed=k) for k in range(count)])
    assert (f"{count} recordings: three or more tell how bands spread" in found.notes) == few
    assert found.descriptor.stochastic is not None
    assert len(found.descriptor.stochastic.level_sd_db) == (0 if few else len(found.center))


def test_only_the_steady_part_of_a_slide_is_used() -> None:
    """A finger that rests, starts and slides: what the rest holds must not matter."""
    s = slide(Surface(slope=-2), 0.04, seconds=4.0, quantity="displacement")
    rest = np.zeros(10000)
    speed = np.concatenate([rest, s.speed])
    loud = np.concatenate([1e-3 * np.random.default_rng(0).standard_normal(10000), s.signal])
    whole = Recorded(name="w", signal=loud, quantity="displacement", sample_rate=1e4, speed=speed)
    error = errors(fit([whole]), Surface(slope=-2))
    assert np.abs(error.mean()) < 0.5


def bands_of(level: Floats) -> Floats:
    """Return the bands of a fit to recordings at the reference speed that have given levels.

    Sixteen are those of 25–800 Hz, 22 reach from 12 Hz to 1.6 kHz.
    """
    measured = measure_slides(
        [slide(Surface(), 0.04, seed=k) for k in range(len(level))], reference_speed=0.04
    )
    bands = measured.core if level.shape[1] == 16 else slice(None)
    measured = replace(measured, center=measured.center[bands], level=level)
    stochastic = describe(measured, ABOUT).descriptor.stochastic
    assert stochastic is not None
    return np.asarray(stochastic.level_db)


def test_bands_are_smoothed_as_far_as_recordings_disagree() -> None:
    """A straight spectrum that scatters by 3 dB is met better than by the mean of recordings.

    Over many seeds, 0.55 of the rms error of the mean is left.
    """
    true = -1.5 * np.arange(16.0)
    scattered = true + np.random.default_rng(3).normal(0, 3, (4, 16))
    plain = np.sqrt(np.mean((scattered.mean(axis=0) - true) ** 2))
    assert np.sqrt(np.mean((bands_of(scattered) - true) ** 2)) < 0.6 * plain


def test_a_rugged_spectrum_on_which_recordings_agree_is_kept() -> None:
    """Steps of 4 dB from band to band lose at most what recordings leave open, 0.3 dB."""
    rugged = -1.5 * np.arange(16.0) + np.tile([2.0, -2.0], 8)
    level = rugged + np.random.default_rng(4).normal(0, 0.3, (4, 16))
    assert np.abs(bands_of(level) - level.mean(axis=0)).max() < 0.3
    assert np.abs(bands_of(rugged[None]) - rugged).max() < 0.051, "one recording; rounded to 0.1"


@pytest.mark.ci
def test_a_fit_predicts_the_half_it_has_not_seen_as_well_as_the_seen_half_does() -> None:
    surface = Surface(slope=-2.0)
    slides = [slide(surface, v, seed=k) for k, v in enumerate(SPEEDS)]
    fitted, verdict = judging.fit_texture(slides, ABOUT)
    assert verdict.rendering.rms_db < verdict.ceiling.rms_db + 0.5
    assert verdict.white.rms_db > 8
    assert verdict.autoregressive.rms_db > verdict.rendering.rms_db
    assert fitted.descriptor.texture.id == "known"


def test_one_recording_is_judged_by_its_halves() -> None:
    alone, verdict = judging.fit_texture([slide(Surface(slope=-2.0), SPEEDS[0], seed=0)], ABOUT)
    assert verdict.rendering.rms_db < 2.5
    assert alone.descriptor.texture.id == "known"
