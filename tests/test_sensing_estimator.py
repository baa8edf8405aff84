"""The estimator on the finite-element plant: loads, uncertainty, and what must not lead it astray.

The figures on 40 fingers are measured by ``python -m benchmarks sensing``; here are a few fingers.
"""

from __future__ import annotations

import numpy as np
import pytest
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from benchmarks.sensing import by_finger
from benchmarks.sensing_loop import RATE, WINDOW, Loop, draw_case, references, steady, swinging
from benchmarks.sensing_plant import Converter
from tactile.arrays import Floats
from tactile.sensing.correlation import AFTER, LAGS, MARGIN, lag_sums, step_products
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import FARTHEST, LoadEstimator
from tactile.sensing.excitation import pilot, pilot_phases
from tactile.sensing.population import Population, load_stiffness
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


def sums_of(model: CurrentModel, loads: Floats, window: int, noise: float = 0.0) -> Floats:
    """Return the sums of the model's own current under loads, with noise."""
    steps = pilot_steps(window)
    taps = model.electrical + model.weights(loads)[0] @ model.shared
    exact = np.einsum("nml,nm->nl", step_products(steps, WINDOW), taps)
    rng = np.random.default_rng(window)
    current = noise * rng.standard_normal((COUNT, WINDOW))
    measured = lag_sums(current, steps[:, AFTER - LAGS + 1 : AFTER + WINDOW])
    return np.asarray(exact + measured)


def followed(model: CurrentModel, loads: Floats, windows: int) -> LoadEstimator:
    """Return an estimator after some windows of the pilot alone."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    for window in range(windows):
        estimator.update(
            sums_of(model, loads, window, NOISE), pilot_steps(window), WINDOW,
            resolution=np.zeros(COUNT),
        )  # fmt: skip
    return estimator


def test_pilot_alone_finds_the_dynamic_stiffness(model: CurrentModel, loads: Floats) -> None:
    """Follow loads for a second: the shear that they lead to is known as well as is stated."""
    estimator = followed(model, loads, 40)
    estimate = estimator.update(
        sums_of(model, loads, 40, NOISE), pilot_steps(40), WINDOW, resolution=np.zeros(COUNT)
    )
    baseline = exact_baseline(tolerant_plant(loads))
    _, stiffness = baseline.tip(FREQUENCY)
    ratio = stiffness + load_stiffness(estimate.logarithms, FREQUENCY)
    error = 20 * np.log10(np.abs(ratio / (stiffness + load_stiffness(loads, FREQUENCY))))
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
    steps = pilot_steps(12)
    for _ in range(20):
        nonsense = lag_sums(
            1e-3 * rng.standard_normal((COUNT, WINDOW)),
            steps[:, AFTER - LAGS + 1 : AFTER + WINDOW],
        )
        estimate = estimator.update(nonsense, steps, WINDOW, resolution=np.zeros(COUNT))
    assert np.all(estimate.inconsistency > 3)
    population = Population.assumed()
    away = np.abs(estimate.logarithms - population.mean) / np.sqrt(np.diag(population.covariance))
    assert np.all(away <= FARTHEST + 1e-9)


@pytest.mark.parametrize("amplitude", [0.0, 1e-12])
def test_drive_at_rest_says_nothing(model: CurrentModel, amplitude: float) -> None:
    """Feed windows without drive: the estimate stays that of the population."""
    estimator = LoadEstimator(model, Population.assumed(), noise=NOISE)
    steps = np.full((COUNT, AFTER + WINDOW + MARGIN), amplitude)
    for _ in range(5):
        estimate = estimator.update(
            np.zeros((COUNT, LAGS)), steps, WINDOW, resolution=np.zeros(COUNT)
        )
    np.testing.assert_allclose(estimate.logarithms, np.tile(Population.assumed().mean, (COUNT, 1)))
    assert np.all(np.isfinite(estimate.covariance))


@pytest.mark.ci
def test_equalizer_follows_a_swinging_force() -> None:
    """Play oak under four fingers, 0.2–2 N every 1.5 s, and compare with filters that stay."""
    case = draw_case(4, 3, Converter(), seed=7, periods=3)
    loop = Loop(case, Converter(), force=swinging(1.5), seconds=1.0)
    settled = [moment for moment in loop.run() if moment.time >= 0.5]
    _, p95 = by_finger(np.array([moment.error for moment in settled]), case.fingers)
    assert p95.max() < 2.5
    fixed = references(loop, settled[-1].time)
    for name in ("as shipped", "population mean"):
        assert np.median(p95) < np.median(by_finger(fixed[name], case.fingers)[1]) / 3
    assert by_finger(fixed["known finger"], case.fingers)[1].max() < 0.15


@pytest.mark.ci
def test_equalizer_follows_a_steady_finger() -> None:
    """Play oak under a steady force: the error at 0.2 s and once settled."""
    case = draw_case(4, 3, Converter(), seed=8, periods=3)
    moments = list(Loop(case, Converter(), force=steady, seconds=1.0).run())
    first = next(moment for moment in moments if moment.time >= 0.2)
    assert np.percentile(np.abs(first.error), 95) < 3
    settled = np.array([moment.error for moment in moments if moment.time >= 0.5])
    assert np.median(by_finger(settled, case.fingers)[1]) < 1.0
