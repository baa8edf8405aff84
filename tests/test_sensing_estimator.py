"""The estimator on the finite-element plant: loads, uncertainty, and what must not lead it astray.

The figures on 40 fingers are measured by ``python -m benchmarks sensing``; here are a few fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from benchmarks.sensing import by_finger
from benchmarks.sensing_loop import (
    RATE,
    WINDOW,
    Loop,
    draw_case,
    lag_sums,
    references,
    steady,
    swinging,
)
from benchmarks.sensing_plant import Converter
from tactile.arrays import Floats
from tactile.sensing.baseline import Baseline
from tactile.sensing.correlation import (
    AFTER,
    EARLIER,
    LAGS,
    MARGIN,
    SumWindow,
    during,
    step_products,
)
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import CAPACITANCE_SPREAD, FARTHEST, LoadEstimator
from tactile.sensing.excitation import pilot, pilot_phases
from tactile.sensing.population import CONSTANTS, Population, load_stiffness
from tactile.sensing.uncertainty import FREQUENCY, shear_deviation

NOISE = 1e-6
"""Standard deviation of the noise [A]."""
COUNT = 6


def pilot_steps(window: int) -> Floats:
    """Return the steps of the pilot (N, AFTER + WINDOW + MARGIN) around a window."""
    first = window * WINDOW - AFTER - 1
    phases = pilot_phases(COUNT)
    return np.asarray(np.diff(pilot(first, AFTER + 1 + WINDOW + MARGIN, RATE, phases), axis=0).T)


@pytest.fixture(scope="module")
def loads() -> Floats:
    return random_loads(COUNT, seed=2)


@pytest.fixture(scope="module")
def model(loads: Floats) -> CurrentModel:
    return CurrentModel(exact_baseline(tolerant_plant(loads)), Population.assumed(), RATE)


def window_of(
    model: CurrentModel, loads: Floats, window: int, noise: float = NOISE, drift: float = 1.0
) -> SumWindow:
    """Return the window of the model's own current under loads, with noise and a capacitance."""
    steps = pilot_steps(window)
    taps = drift * model.electrical + model.weights(loads) @ model.shared
    exact = np.einsum("nml,nm->nl", step_products(steps, during(steps)), taps)
    rng = np.random.default_rng(window)
    current = noise * rng.standard_normal((COUNT, WINDOW))
    measured = lag_sums(current, during(steps))
    valid, earlier = np.ones(COUNT, np.bool_), np.zeros((COUNT, EARLIER))
    return SumWindow(exact + measured, during(steps), steps, np.zeros(COUNT), valid, earlier)


def followed(model: CurrentModel, loads: Floats, windows: int, drift: float = 1.0) -> LoadEstimator:
    """Return an estimator after some windows of the pilot alone."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for window in range(windows):
        estimator.update(window_of(model, loads, window, drift=drift))
    return estimator


def shear_error(baseline: Baseline, logarithms: Floats, loads: Floats) -> Floats:
    """Return the errors (N, F) of the shear for loads that were found [dB]."""
    _, stiffness = baseline.tip(FREQUENCY)
    ratio = stiffness + load_stiffness(logarithms, FREQUENCY)
    return np.asarray(20 * np.log10(np.abs(ratio / (stiffness + load_stiffness(loads, FREQUENCY)))))


def test_pilot_alone_finds_the_dynamic_stiffness(model: CurrentModel, loads: Floats) -> None:
    """Follow loads for a second: the shear that they lead to is known as well as is stated."""
    estimator = followed(model, loads, 40)
    estimate = estimator.update(window_of(model, loads, 40))
    baseline = exact_baseline(tolerant_plant(loads))
    error = shear_error(baseline, estimate.logarithms, loads)
    stated = shear_deviation(baseline, estimate.logarithms, estimate.covariance)
    assert np.all(np.sqrt(np.mean(error**2, axis=1)) < 3 * stated)
    assert np.median(np.abs(error)) < 1.0
    assert np.all(estimate.inconsistency < 2)


def test_restart_forgets_the_finger_and_keeps_the_capacitance(
    model: CurrentModel, loads: Floats
) -> None:
    """Start one contactor again and compare both."""
    estimator = followed(model, loads, 12)
    before = estimator.ahead(0)
    some = np.arange(COUNT) == 2
    estimator.restart(some)
    after = estimator.ahead(0)
    np.testing.assert_array_equal(after[~some], before[~some])
    np.testing.assert_array_equal(after[some][0], Population.assumed().mean)
    assert not np.array_equal(before[some][0], after[some][0])


def test_nonsense_is_named_and_bounded(model: CurrentModel, loads: Floats) -> None:
    """Feed sums that no load explains: loads stay among fingers, and the inconsistency is high."""
    estimator = followed(model, loads, 12)
    rng = np.random.default_rng(0)
    window = window_of(model, loads, 12)
    for _ in range(20):
        noise = 1e-3 * rng.standard_normal((COUNT, WINDOW))
        sums = lag_sums(noise, window.steps[:, AFTER - LAGS + 1 : AFTER + WINDOW])
        estimate = estimator.update(replace(window, sums=sums))
    assert np.all(estimate.inconsistency > 3)
    population = Population.assumed()
    away = np.abs(estimate.logarithms - population.mean) / np.sqrt(np.diag(population.covariance))
    assert np.all(away <= FARTHEST + 1e-9)


@pytest.mark.parametrize("amplitude", [0.0, 1e-12])
def test_drive_at_rest_says_nothing(model: CurrentModel, amplitude: float) -> None:
    """Feed windows without drive: the estimate stays that of the population."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    steps = np.full((COUNT, AFTER + WINDOW + MARGIN), amplitude)
    valid, earlier = np.ones(COUNT, np.bool_), np.zeros((COUNT, EARLIER))
    still = SumWindow(
        np.zeros((COUNT, LAGS)), during(steps), steps, np.zeros(COUNT), valid, earlier
    )
    for _ in range(5):
        estimate = estimator.update(still)
    np.testing.assert_allclose(estimate.logarithms, np.tile(Population.assumed().mean, (COUNT, 1)))
    assert np.all(np.isfinite(estimate.covariance))


def test_capacitance_that_has_drifted_is_no_load(model: CurrentModel, loads: Floats) -> None:
    """Raise all capacitances by 2 %; a finger that returns profits from what was learnt.

    Half of the contactors or more do: how uncertain one finger is depends on more than that.
    """
    baseline, drift = exact_baseline(tolerant_plant(loads)), 1.02
    estimator = followed(model, loads, 40, drift)
    error = shear_error(baseline, estimator.ahead(0), loads)
    assert np.median(np.abs(error)) < 1.0
    estimator.restart(np.ones(COUNT, bool))
    fresh = LoadEstimator(model, Population.assumed(), noise=NOISE)
    stated = []
    for each in (estimator, fresh):
        estimate = each.update(window_of(model, loads, 40, drift=drift))
        stated.append(shear_deviation(baseline, estimate.logarithms, estimate.covariance))
    assert np.median(stated[0] / stated[1]) < 0.995


def test_load_beyond_all_fingers_is_clamped(model: CurrentModel) -> None:
    """Follow loads of five standard deviations: a confident estimate must not leave fingers."""
    population = Population.assumed()
    deviation = np.sqrt(np.diag(population.covariance))
    estimator = followed(model, np.tile(population.mean + 5 * deviation, (COUNT, 1)), 30)
    away = (estimator.ahead(0) - population.mean) / deviation
    assert away.max() == pytest.approx(FARTHEST, abs=0.3)
    assert np.all(away < FARTHEST + 0.3)


def test_rounding_of_the_sums_counts_as_noise(model: CurrentModel, loads: Floats) -> None:
    """Round the sums coarsely: that is consistent only if the estimator is told."""
    inconsistencies = []
    for told in (True, False):
        estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
        for window in range(10):
            exact = window_of(model, loads, window)
            step = np.abs(exact.sums).max(axis=1) / 200
            sums = np.rint(exact.sums / step[:, None]) * step[:, None]
            resolution = step if told else 0 * step
            estimate = estimator.update(replace(exact, sums=sums, resolution=resolution))
        inconsistencies.append(np.median(estimate.inconsistency))
    assert inconsistencies[0] < 2
    assert inconsistencies[1] > 10


@pytest.mark.parametrize("fault", ["not valid", "NaN"])
def test_contactor_without_a_report_does_not_disturb_the_others(
    model: CurrentModel, loads: Floats, fault: str
) -> None:
    """Leave out one contactor's sums for a while: it is named, and follows again afterwards."""
    estimator = followed(model, loads, 12)
    first = np.arange(COUNT) == 0
    for number in range(12, 16):
        window = window_of(model, loads, number)
        if fault == "NaN":
            window.sums[0, 3] = np.nan
        else:
            window = replace(window, valid=~first, sums=np.where(first[:, None], 1.0, window.sums))
        estimate = estimator.update(window)
        assert np.isinf(estimate.inconsistency[0])
        assert np.all(estimate.inconsistency[1:] < 3)
    for number in range(16, 20):
        estimate = estimator.update(window_of(model, loads, number))
    assert np.all(np.isfinite(estimator.ahead(2.5)))
    assert np.all(estimate.inconsistency < 3)


def test_an_estimate_stays_as_it_was(model: CurrentModel, loads: Floats) -> None:
    """Restart after an estimate was returned."""
    estimator = followed(model, loads, 3)
    estimate = estimator.update(window_of(model, loads, 3))
    logarithms, covariance = estimate.logarithms.copy(), estimate.covariance.copy()
    estimator.restart(np.ones(COUNT, np.bool_))
    np.testing.assert_array_equal(estimate.logarithms, logarithms)
    np.testing.assert_array_equal(estimate.covariance, covariance)


def test_restart_of_all_forgets_the_rate(model: CurrentModel, loads: Floats) -> None:
    """Let the loads rise, then lift off: what is extrapolated must not rise any more."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for number in range(20):
        estimator.update(window_of(model, loads + 0.05 * number, number))
    rising = estimator.ahead(1) - estimator.ahead(0)
    assert np.median(rising) == pytest.approx(0.05, rel=0.3)
    estimator.restart(np.ones(COUNT, np.bool_))
    for number in range(4):
        estimator.update(window_of(model, loads, number))
    assert np.abs(estimator.ahead(1) - estimator.ahead(0)).max() < 0.02


@pytest.mark.ci
def test_equalizer_follows_a_swinging_force() -> None:
    """Play oak under four fingers, 0.2–2 N every 1.5 s, and compare with filters that stay."""
    case = draw_case(4, 3, Converter(), seed=7)
    loop = Loop(case, Converter(), force=swinging(1.5), seconds=1.0)
    settled = [moment for moment in loop.run() if moment.time >= 0.5]
    _, p95 = by_finger(np.array([moment.error for moment in settled]), case.fingers)
    # 2.3 dB under the stiffest finger, of 8.7 N/mm, which changes the charge by 1 % only
    assert p95.max() < 3.0
    fixed = references(loop, settled[-1].time)
    for name in ("as shipped", "population mean"):
        assert np.median(p95) < np.median(by_finger(fixed[name], case.fingers)[1]) / 3
    assert by_finger(fixed["known finger"], case.fingers)[1].max() < 0.15


@pytest.mark.ci
def test_equalizer_follows_a_steady_finger() -> None:
    """Play oak under a steady force: the error at 0.2 s and once settled."""
    case = draw_case(4, 3, Converter(), seed=8)
    moments = list(Loop(case, Converter(), force=steady, seconds=1.0).run())
    first = next(moment for moment in moments if moment.time >= 0.2)
    assert np.percentile(np.abs(first.error), 95) < 3
    settled = np.array([moment.error for moment in moments if moment.time >= 0.5])
    assert np.median(by_finger(settled, case.fingers)[1]) < 1.0


def in_air(model: CurrentModel, window: int, factor: float = 1.0) -> SumWindow:
    """Return the window of contactors in air, with another capacitance."""
    steps, valid = pilot_steps(window), np.ones(COUNT, np.bool_)
    first = window * WINDOW - AFTER - 1 - EARLIER
    earlier = np.diff(pilot(first, EARLIER + 1, RATE, pilot_phases(COUNT)), axis=0).T
    empty = SumWindow(
        np.zeros((COUNT, LAGS)), during(steps), steps, np.zeros(COUNT), valid, earlier
    )
    exact = np.einsum("nml,nm->nl", step_products(steps, during(steps)), factor * model.electrical)
    return replace(empty, sums=exact + model.air_sums(empty))


def test_in_air_the_capacitance_is_followed_within_its_reach(model: CurrentModel) -> None:
    """Let it drift by 1 %, and then read sums that no capacitance explains."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for window in range(8):
        estimate = estimator.update(in_air(model, 10 + window, 1.01))
    assert not estimate.touching.any()
    np.testing.assert_allclose(estimator._state[:, CONSTANTS], np.log(1.01), atol=5e-4)
    np.testing.assert_allclose(estimate.logarithms, np.tile(Population.assumed().mean, (COUNT, 1)))
    for window in range(20):
        estimator.update(in_air(model, 20 + window, 2.0))
    assert np.all(np.abs(estimator._state[:, CONSTANTS]) <= FARTHEST * CAPACITANCE_SPREAD + 1e-9)


@pytest.mark.parametrize("scale", [0.25, 0.5, 1.0, 4.0])
def test_a_touch_is_noticed_after_air_however_soft_the_finger(
    model: CurrentModel, scale: float
) -> None:
    """Touch with fingers far from the mean one, and near it, after half a second in air."""
    loads = np.tile(Population.assumed().mean + np.log(scale), (COUNT, 1))
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for window in range(20):
        estimate = estimator.update(in_air(model, window))
    assert not estimate.touching.any()
    for window in range(20, 24):
        estimate = estimator.update(window_of(model, loads, window))
    assert estimate.touching.all()
    assert np.all(estimate.inconsistency < 3)


def test_without_windows_loads_do_not_go_on_changing(model: CurrentModel, loads: Floats) -> None:
    """Let loads rise, and then read windows that are not valid: the rate is forgotten."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for window in range(16):
        estimator.update(window_of(model, loads + 0.03 * window, window))
    rate = np.mean(estimator.ahead(1) - estimator.ahead(0))
    assert rate == pytest.approx(0.03, rel=0.3)
    for window in range(20):
        blind = replace(window_of(model, loads, 16 + window), valid=np.zeros(COUNT, np.bool_))
        estimator.update(blind)
    assert np.mean(estimator.ahead(1) - estimator.ahead(0)) < 0.01 * rate
    risen = np.mean(estimator.ahead(0) - (loads + 0.03 * 15))
    assert risen < 0.2
