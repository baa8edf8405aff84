"""Loads of fingers that rest, from a quarter of a second on the finite-element plant.

The figures on 40 fingers are measured by ``python -m benchmarks finger``; here are a few fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from benchmarks.finger import drive_of, windows_of
from benchmarks.sensing_loop import FREQUENCY, RATE, design
from benchmarks.sensing_plant import Converter, SensingPlant
from tactile.arrays import Floats
from tactile.sensing.baseline import Baseline
from tactile.sensing.calibration import MeasuringLimits
from tactile.sensing.correlation import SumWindow
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.finger_drive import DURATION, measuring_drive
from tactile.sensing.population import Population, load_stiffness
from tactile.sensing.resting_load import LEAST_WINDOWS, MeasuredLoads, measure_loads
from tactile.sensing.uncertainty import shear_deviation, stiffness_deviation

COUNT = 12
NOISE = Converter().step * np.sqrt(1 + 1 / 12)
"""Standard deviation of a sample of the current: noise of one step and its rounding [A]."""
LOADS = random_loads(COUNT, seed=5)
DRIVE = drive_of(Converter())


@pytest.fixture(scope="module")
def plant() -> SensingPlant:
    return tolerant_plant(LOADS)


@pytest.fixture(scope="module")
def baseline(plant: SensingPlant) -> Baseline:
    return exact_baseline(plant)


@pytest.fixture(scope="module")
def windows(plant: SensingPlant) -> list[SumWindow]:
    return windows_of(plant, DRIVE)


def found(baseline: Baseline, windows: list[SumWindow]) -> MeasuredLoads:
    """Return the loads that windows tell of."""
    population = Population.assumed()
    model = CurrentModel(baseline, population, RATE)
    return measure_loads(model, population, windows, noise=NOISE)


def level_error(plant: SensingPlant, baseline: Baseline, loads: MeasuredLoads) -> Floats:
    """Return the error (N, F) of the predicted shear per volt [dB]."""
    force, stiffness = baseline.tip(FREQUENCY)
    predicted = force / (stiffness + load_stiffness(loads.logarithms, FREQUENCY))
    return np.asarray(20 * np.log10(np.abs(predicted / plant.response(FREQUENCY, plant.scale))))


def test_loads_are_found_as_well_as_is_stated(
    plant: SensingPlant, baseline: Baseline, windows: list[SumWindow]
) -> None:
    """Measure twelve fingers, from soft to stiff.

    Two stated deviations hold for about 95 % of the values of the benchmark; here are only twelve
    independent fingers, of which one or two may be outside.
    """
    loads = found(baseline, windows)
    assert loads.touching.all()
    assert loads.explained.all()
    error = level_error(plant, baseline, loads)
    assert np.median(np.abs(error)) < 0.2
    assert np.percentile(np.abs(error), 95) < 1.2
    stated = shear_deviation(baseline, loads.logarithms, loads.covariance)
    assert np.mean(np.sqrt(np.mean(error**2, axis=1)) < 2 * stated) >= 10 / 12
    assert np.all(stated < 1.0)
    true = load_stiffness(LOADS, FREQUENCY)
    away = load_stiffness(loads.logarithms, FREQUENCY) - true
    deviation = stiffness_deviation(loads.logarithms, loads.covariance, FREQUENCY)
    assert np.mean(np.abs(away.real) < 2 * deviation.real) >= 0.8
    assert np.mean(np.abs(away.imag) < 2 * deviation.imag) >= 0.8


def test_nothing_and_a_light_touch_are_told_apart(baseline: Baseline) -> None:
    """Press with 0 N on six contactors and with 0.05 N on the others."""
    plant = tolerant_plant(LOADS)
    light = np.arange(COUNT) >= COUNT // 2
    plant.scale[:] = np.sqrt(0.05) * light
    loads = found(baseline, windows_of(plant, DRIVE))
    assert loads.touching.tolist() == light.tolist()
    assert loads.explained[~light].all()


def test_a_capacitance_that_drifted_is_no_load(
    plant: SensingPlant, baseline: Baseline, windows: list[SumWindow]
) -> None:
    """Warm the ceramic after the calibration: 2 % of capacitance are as much as a stiff finger."""
    warm = tolerant_plant(LOADS)
    warm.tip = replace(warm.tip, capacitance=1.02 * warm.tip.capacitance)
    loads, cold = found(baseline, windows_of(warm, DRIVE)), found(baseline, windows)
    assert loads.explained.all()
    change = level_error(plant, baseline, loads) - level_error(plant, baseline, cold)
    assert np.max(np.abs(change)) < 0.5


def test_windows_that_are_not_valid_do_not_count(
    baseline: Baseline, windows: list[SumWindow]
) -> None:
    """Spoil six windows of the first contactor and one of the second."""
    spoiled = []
    for k, window in enumerate(windows):
        sums, valid = window.sums.copy(), window.valid.copy()
        if k < 6:
            sums[0] *= 3
            valid[0] = False
        if k == 4:
            sums[1] = np.nan
        spoiled.append(replace(window, sums=sums, valid=valid))
    loads, before = found(baseline, spoiled), found(baseline, windows)
    assert loads.windows.tolist() == [4, 9] + [10] * (COUNT - 2)
    assert LEAST_WINDOWS == 5
    assert loads.measured.tolist() == [False] + [True] * (COUNT - 1)
    assert not loads.explained[0]
    assert loads.explained[1:].all()
    np.testing.assert_allclose(loads.logarithms[2:], before.logarithms[2:], atol=1e-6)
    assert np.all(np.abs(loads.logarithms[:2] - before.logarithms[:2]) < 1.0)


def test_what_no_load_makes_is_not_explained(baseline: Baseline, windows: list[SumWindow]) -> None:
    """Connect the sensor of the first contactor to the neighbor's current."""
    crossed = []
    for window in windows:
        sums = window.sums.copy()
        sums[0] = -sums[1]
        crossed.append(replace(window, sums=sums))
    loads = found(baseline, crossed)
    assert loads.touching[0]
    assert loads.explained.tolist() == [False] + [True] * (COUNT - 1)


def test_stiffness_deviation_is_that_of_drawn_loads() -> None:
    """Draw 20 000 loads from a narrow posterior: to first order, the deviations are linear.

    Those of 20 000 draws are within 0.5 % (1/√(2·20 000)); with logarithms that deviate by 0.02
    the next order adds as little.
    """
    rng = np.random.default_rng(0)
    root = 0.01 * rng.standard_normal((4, 4))
    mean, covariance = Population.assumed().mean, root @ root.T
    drawn = rng.multivariate_normal(mean, covariance, 20_000)
    frequency = np.array([10.0, 100.0, 300.0, 1000.0])
    stiffness = load_stiffness(drawn, frequency)
    stated = stiffness_deviation(mean[None], covariance[None], frequency)[0]
    np.testing.assert_allclose(stated.real, stiffness.real.std(axis=0), rtol=0.02)
    np.testing.assert_allclose(stated.imag, stiffness.imag.std(axis=0), rtol=0.02)


@pytest.mark.parametrize(
    "limits",
    [
        MeasuringLimits(current=2.5e-3, voltage=100.0, slew=0.7e6),
        MeasuringLimits(current=2.5e-3, voltage=12.0, slew=0.7e6),
        MeasuringLimits(current=0.5e-3, voltage=100.0, slew=0.7e6),
        MeasuringLimits(current=2.5e-3, voltage=100.0, slew=5e3),
    ],
)
def test_the_drive_keeps_every_limit_and_uses_it(limits: MeasuringLimits) -> None:
    """Keep 20 V at the electrodes too.

    The current is at least that of the held capacitance; at resonance it is twice that.
    """
    drive, bender = measuring_drive(design(), RATE, limits), design()
    assert len(drive) == DURATION * RATE
    steps = np.abs(np.diff(drive, prepend=0.0, append=0.0)).max() * RATE
    shares = [
        np.abs(drive).max() / min(limits.voltage, 20.0),
        steps / limits.slew,
        bender.capacitance * steps / limits.current,
    ]
    assert max(shares) <= 1 + 1e-9
    assert max(shares) > 0.4


def test_the_drive_stays_in_the_band_of_the_model() -> None:
    """Keep what is above 2600 Hz, where the current is not predicted, 60 dB below the rest."""
    drive = np.pad(DRIVE, (4000, 4000))
    power = np.abs(np.fft.rfft(drive)) ** 2
    above = np.fft.rfftfreq(len(drive), 1 / RATE) > 2600
    assert power[above].sum() < 1e-6 * power.sum()
    assert np.abs(DRIVE[[0, -1]]).max() < 0.1
