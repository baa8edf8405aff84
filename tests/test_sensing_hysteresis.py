"""Hysteresis between drive and effective voltage: its model, its inverse, and its measurement.

The ceramics are springs and sliders of `benchmarks.sensing_plant`, which are not play operators.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sensing import by_finger
from benchmarks.sensing_loop import (
    CODE,
    RATE,
    VOLTAGE,
    WINDOW,
    Case,
    Loop,
    air_windows,
    design,
    draw_case,
    planned_loops,
    swinging,
)
from benchmarks.sensing_plant import (
    FULL_DRIVE,
    SLIDERS,
    Converter,
    Fingers,
    PlantTolerances,
    SensingPlant,
    SlidingCeramics,
    friction_strengths,
)
from tactile.arrays import Floats
from tactile.sensing.admittance import AirWindows
from tactile.sensing.calibration import FILLING, MeasuringLimits
from tactile.sensing.hysteresis import EffectiveVoltage, HysteresisStream, PlayModel
from tactile.sensing.loop_tones import LoopPlan, fit_hysteresis, loop_faults, plan_loops

CONTACTORS = 3
CONVERTER = Converter()
LIMITS = MeasuringLimits(current=CONVERTER.range, voltage=VOLTAGE, slew=0.7e6)


def even(width: float, plays: int = 200) -> PlayModel:
    """Return the model of a bender whose plays are evenly spread, with the loop of Rayleigh."""
    radii = FULL_DRIVE * (np.arange(plays) + 0.5) / plays
    weight = 4 * width / (1 - 2 * width) / plays
    return PlayModel(radii[None], np.full((1, plays), weight))


def random_model(seed: int) -> PlayModel:
    """Return a model with other radii and weights for each contactor."""
    rng = np.random.default_rng(seed)
    radii = np.sort(rng.uniform(0.1, 60, (CONTACTORS, 7)), axis=1)
    return PlayModel(radii, rng.uniform(0, 0.3, (CONTACTORS, 7)))


def random_drive(samples: int, seed: int) -> Floats:
    """Return a drive (samples, CONTACTORS) that wanders up to about 100 V."""
    steps = np.random.default_rng(seed).standard_normal((samples, CONTACTORS))
    return np.asarray(40 * np.sin(np.cumsum(steps, axis=0) / 9) + 3 * steps)


def test_plays_are_what_sliders_do() -> None:
    """Follow a drive by a model whose plays are the plant's sliders: they agree to rounding."""
    strength = friction_strengths(0.13, CONTACTORS, np.random.default_rng(3))
    limits = (SLIDERS[1:] + SLIDERS[:-1]) / 2
    model = PlayModel(np.tile(limits, (CONTACTORS, 1)), strength.T.copy())
    drive = random_drive(500, 1)
    found = HysteresisStream(model)(drive)
    np.testing.assert_allclose(
        found, SlidingCeramics(strength).effective(drive), rtol=0, atol=1e-11
    )
    assert np.abs(found - drive).max() > 5


@pytest.mark.parametrize("seed", range(5))
def test_inverse_gives_the_drive_of_an_effective_voltage(seed: int) -> None:
    """Check both orders, in blocks of random lengths."""
    model, wanted = random_model(seed), random_drive(400, seed)
    for first, second in ((model, model.inverse()), (model.inverse(), model)):
        before, after = HysteresisStream(first), HysteresisStream(second)
        cuts = np.sort(np.random.default_rng(seed).integers(0, 400, 9))
        found = [after(before(block)) for block in np.split(wanted, cuts)]
        np.testing.assert_allclose(np.concatenate(found), wanted, rtol=0, atol=1e-10)


def test_hysteresis_knows_no_sign() -> None:
    """Mirror a drive: its effective voltage is mirrored, so that polarity may be applied before."""
    drive = random_drive(300, 2)
    upright, mirrored = (HysteresisStream(random_model(4))(u) for u in (drive, -drive))
    np.testing.assert_array_equal(upright, -mirrored)


def test_virgin_curve_and_loop_of_rayleigh() -> None:
    """Compare with closed forms: u + s u²/2 at first, and branches that are apart by s A²/2."""
    width, amplitude = 0.13, 60.0
    slope = 4 * width / (1 - 2 * width) / FULL_DRIVE
    rising = np.linspace(0, amplitude, 400)
    turned = np.concatenate([rising, -rising[::-1], rising])[:, None]
    found = HysteresisStream(even(width))(turned)[:, 0]
    np.testing.assert_allclose(found[:400], rising + slope * rising**2 / 2, atol=0.01)
    cycle = amplitude * np.sin(2 * np.pi * np.arange(3000) / 1000)[:, None]
    loop = HysteresisStream(even(width))(cycle)[1000:, 0]
    apart = (loop[500] - loop[1000]) / np.ptp(loop)
    expected = slope * amplitude**2 / 2 / (2 * amplitude + slope * amplitude**2)
    assert apart == pytest.approx(expected, rel=2e-3)
    assert even(width).loop_width(amplitude)[0] == pytest.approx(expected, rel=2e-3)
    assert even(width).loop_width(FULL_DRIVE)[0] == pytest.approx(width, rel=2e-3)


def test_contactors_without_hysteresis_get_the_drive_itself() -> None:
    """Check that nothing is computed: the very array comes back, also below all radii."""
    drive = random_drive(100, 3)
    assert HysteresisStream(PlayModel.none(CONTACTORS))(drive) is drive
    assert HysteresisStream(PlayModel.none(CONTACTORS).inverse())(drive) is drive
    small = drive[:16] * 1e-4
    assert HysteresisStream(random_model(0))(small) is small


def test_pieces_that_overlap_are_followed_once() -> None:
    """Follow overlapping pieces of a drive: they are those of the whole."""
    model, drive = random_model(6), random_drive(900, 5)
    whole, pieces = HysteresisStream(model)(drive), EffectiveVoltage(model)
    for first, end in ((0, 300), (200, 500), (200, 520), (500, 900)):
        found = pieces.follow(1000 + first, drive[first:end])
        np.testing.assert_allclose(found, whole[first:end], rtol=0, atol=1e-12)
    pieces.restart()
    np.testing.assert_allclose(pieces.follow(0, drive[:50]), whole[:50], rtol=0, atol=1e-12)


def test_gap_between_pieces_begins_anew() -> None:
    """Leave out a part of the drive: what follows is taken to begin at rest."""
    model, drive = random_model(7), random_drive(500, 6)
    pieces = EffectiveVoltage(model)
    pieces.follow(0, drive[:200])
    found = pieces.follow(300, drive[300:])
    np.testing.assert_array_equal(found, HysteresisStream(model)(drive[300:]))


@pytest.mark.parametrize(
    ("limits", "highest"),
    [
        (LIMITS, VOLTAGE),
        (replace(LIMITS, current=1e-4), FILLING * 1e-4 / (2 * np.pi * 40 * 12e-9 * 2)),
        (replace(LIMITS, slew=1e4), FILLING * 1e4 / (2 * np.pi * 40)),
    ],
    ids=["voltage", "current", "slew"],
)
def test_levels_keep_the_limits(limits: MeasuringLimits, highest: float) -> None:
    """Check the largest level and the fastest change against each limit by itself."""
    plan = plan_loops(12e-9, RATE, limits, window=WINDOW)
    assert plan.levels[-1] == pytest.approx(highest)
    assert np.abs(plan.drive).max() <= limits.voltage
    assert np.abs(np.diff(plan.drive)).max() * RATE <= limits.slew
    assert plan.drive[0] == 0
    assert abs(plan.drive[-1]) < 1e-3 * highest


def measured(plan: LoopPlan, strength: Floats | None) -> AirWindows:
    """Return the windows that contactors in air give."""
    plant = SensingPlant(
        Fingers(*np.ones((4, CONTACTORS))), PlantTolerances.none(CONTACTORS),
        converter=CONVERTER, sample_rate=RATE, strength=strength,
    )  # fmt: skip
    plant.scale[:] = 0
    drive = np.concatenate([np.rint(plan.drive / CODE) * CODE, np.zeros(plant.delay)])
    _, current = plant.step(np.repeat(drive[:, None], CONTACTORS, axis=1))
    return air_windows(plan, CONVERTER, current[plant.delay :])


@pytest.fixture(scope="module")
def loops() -> LoopPlan:
    return planned_loops(CONVERTER)


@pytest.fixture(scope="module")
def strength() -> Floats:
    return friction_strengths(0.13, CONTACTORS, np.random.default_rng(1))


@pytest.fixture(scope="module")
def windows(loops: LoopPlan, strength: Floats) -> AirWindows:
    return measured(loops, strength)


@pytest.mark.ci
@pytest.mark.parametrize(("amplitude", "share"), [(5.0, 0.2), (20.0, 0.07), (90.0, 0.03)])
def test_hysteresis_is_found(
    loops: LoopPlan, windows: AirWindows, strength: Floats, amplitude: float, share: float
) -> None:
    """Compare the effective voltage of another drive with what the ceramics do with it.

    It departs from the drive by 1 to 30 %. The converter's noise hides more of the small loops.
    """
    model, n = fit_hysteresis(loops, windows), np.arange(8000)
    drive = amplitude * (np.sin(n / 350) + 0.1 * np.sin(n / 6))[:, None] / 1.1
    drive = np.repeat(drive, CONTACTORS, axis=1)
    exact = SlidingCeramics(strength).effective(drive)
    departure = (exact - drive).std(axis=0)
    assert np.all((HysteresisStream(model)(drive) - exact).std(axis=0) < share * departure)


@pytest.mark.ci
def test_benders_without_hysteresis_have_none(loops: LoopPlan) -> None:
    """Measure linear benders: noise and rounding are not taken for a loop."""
    assert not fit_hysteresis(loops, measured(loops, None)).weights.any()


@pytest.mark.ci
def test_channel_without_windows_has_no_hysteresis(loops: LoopPlan, windows: AirWindows) -> None:
    """Take away the windows of one channel at one level; it is named, and the others stay."""
    lost, which = windows.valid.copy(), windows.positions >= loops.first[3]
    lost[which & (windows.positions < loops.end[3]), 1] = False
    less = replace(windows, valid=lost)
    found = fit_hysteresis(loops, less).weights
    whole = fit_hysteresis(loops, windows).weights
    assert not found[1].any()
    np.testing.assert_array_equal(found[[0, 2]], whole[[0, 2]])
    assert [fault != "" for fault in loop_faults(loops, less)] == [False, True, False]
    assert loop_faults(loops, less)[1].endswith(f"at {loops.levels[3]:.0f} V")


def errors(case: Case) -> float:
    """Return the 95th percentile of the median finger's error [dB]."""
    loop = Loop(case, CONVERTER, force=swinging(1.5), seconds=0.8)
    moments = np.array([moment.error for moment in loop.run() if moment.time >= 0.4])
    return float(np.median(by_finger(moments, case.fingers)[1]))


@pytest.mark.ci
def test_finger_is_found_in_spite_of_hysteresis() -> None:
    """Play oak on ceramics with a loop of 13 %, under a force that swings.

    Without the model the shear of the median finger is 5 dB off and more.
    """
    plain, modeled = (
        errors(draw_case(3, 3, CONVERTER, seed=11, width=0.13, modeled=modeled))
        for modeled in (False, True)
    )
    assert modeled < 1.8
    assert plain > 2 * modeled


def test_design_is_that_of_the_plan(loops: LoopPlan) -> None:
    """Check that a bender with twice the current still fits the converter's range."""
    omega = 2 * np.pi * RATE / WINDOW
    assert 2 * omega * design().capacitance * loops.levels[-1] <= FILLING * CONVERTER.range
