"""The calibration in air from lag sums, against the finite-element plant's own admittances.

The plant gives its admittance in closed form, and the current of a drive is its product with it in
the frequency domain. Sums come from the reference amplifier's correlator; the last test steps the
plant through time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sensing_rig import CONTACTORS, exact_baseline, fingers, random_loads, tolerant_plant

from benchmarks.sensing import by_finger
from benchmarks.sensing_loop import (
    CODE,
    RATE,
    WINDOW,
    Loop,
    air_windows,
    design,
    draw_case,
    lag_sums,
    planned,
    repeated,
    steady,
)
from benchmarks.sensing_plant import Converter, SensingPlant
from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.sensing.admittance import Admittances, AirWindows, measure_admittances
from tactile.sensing.baseline import REFERENCE, Baseline, fit_baseline
from tactile.sensing.bender import Deviations, bender_of
from tactile.sensing.calibration import (
    FILLING,
    LARGEST,
    CalibrationPlan,
    plan_calibration,
)
from tactile.sensing.correlation import LAGS
from tactile.sensing.hysteresis import PlayModel

Response = Callable[[Floats], Complex]
CONVERTER = Converter()
PLAN = planned(CONVERTER)
NOISE = CONVERTER.step * float(np.hypot(CONVERTER.noise, 1 / np.sqrt(12)))
"""Noise of a sample: the converter's own and its rounding [A]."""
LIMITS = PLAN.limits


@pytest.fixture(scope="module")
def plant() -> SensingPlant:
    return tolerant_plant(random_loads(CONTACTORS))


def in_air(plant: SensingPlant) -> Response:
    """Return the admittance of the plant's contactors without fingers."""
    return lambda frequency: plant.admittance(frequency, np.zeros(CONTACTORS))


def played(plan: CalibrationPlan) -> Floats:
    """Return the drive in whole codes."""
    return np.asarray(np.rint(plan.drive / CODE) * CODE)


def drawn(plan: CalibrationPlan, response: Response) -> Floats:
    """Return the current (S, N) that a response draws, through the converter."""
    drive, rate = played(plan), plan.sample_rate
    padded = len(drive) + round(rate)
    frequency: Floats = np.asarray(np.fft.rfftfreq(padded, 1 / rate), np.float64)
    frequency[0] = 1e-3
    exact = np.fft.irfft(np.multiply(np.fft.rfft(drive, padded), response(frequency)), padded)
    rng, step = np.random.default_rng(0), CONVERTER.step
    codes = np.rint(exact.T[: len(drive)] / step + rng.standard_normal((len(drive), CONTACTORS)))
    return np.asarray(np.clip(codes, -2048, 2047) * step)


def measured(response: Response, plan: CalibrationPlan = PLAN) -> Admittances:
    """Return the admittances that a response is measured to have."""
    windows = air_windows(plan, CONVERTER, drawn(plan, response))
    return measure_admittances(plan, windows, played(plan), none(windows))


def none(windows: AirWindows) -> PlayModel:
    """Return the model of contactors that have no hysteresis."""
    return PlayModel.none(windows.sums.shape[1])


def fitted(found: Admittances) -> Baseline:
    """Return the baseline of measured admittances."""
    return fit_baseline(
        found.frequency, found.value, design(), deviation=found.deviation, clipped=found.clipped
    )


def error(found: Admittances, response: Response) -> Floats:
    """Return the error of admittances, as a part of that of the held design's capacitance."""
    scale = 2 * np.pi * found.frequency * design().capacitance
    return np.asarray(np.abs(found.value - response(found.frequency)) / scale)


def test_admittances_are_those_of_the_plant(plant: SensingPlant) -> None:
    """Compare all lines with the closed form, and the errors with what is stated of them.

    Free vibration that is left adds up to 2 % near the resonance, where the charge is sevenfold.
    """
    found = measured(in_air(plant))
    away = np.abs(found.frequency / design().resonance - 1) > 0.1
    departure = error(found, in_air(plant))
    assert np.sqrt(np.mean(departure[:, away & (found.frequency > 60)] ** 2)) < 1.2e-3
    assert departure[:, away].max() < 0.012
    assert departure.max() < 0.03
    stated = found.deviation / (2 * np.pi * found.frequency * design().capacitance)
    ratio = (departure / stated)[:, away]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.15)
    np.testing.assert_allclose(found.noise, NOISE, rtol=0.12)


def test_baseline_is_that_of_the_exact_admittances(plant: SensingPlant) -> None:
    """Compare capacitance and deviations with a fit to the closed form."""
    own, exact = fitted(measured(in_air(plant))), exact_baseline(plant)
    assert own.faults == ("",) * CONTACTORS
    for name, most in (("stiffness", 2e-5), ("coupling", 4e-4), ("loss", 2e-3)):
        ratio = getattr(own.deviations, name) / getattr(exact.deviations, name)
        assert np.abs(ratio - 1).max() < most, name
    frequency = np.geomspace(60, 2500, 100)
    away = np.abs(frequency / design().resonance - 1) > 0.12
    ratio = own.charge(frequency) / exact.charge(frequency)
    assert np.abs(ratio - 1)[:, away].max() < 1.5e-3


def test_weights_of_the_lines_make_the_capacitance_better() -> None:
    """Fit with and without the lines' deviations, over many draws of noise that they state."""
    plant = tolerant_plant(random_loads(1))
    lines, rng = PLAN.lines, np.random.default_rng(0)
    exact = plant.admittance(lines, np.zeros(1))
    size = 2 * np.pi * lines * design().capacitance
    deviation = np.tile(size * np.where(lines < 60, 6e-3, 4e-4), (40, 1))
    noise = rng.standard_normal((2, *deviation.shape)) * deviation / np.sqrt(2)
    noisy = exact + noise[0] + 1j * noise[1]
    frequency = np.geomspace(60, 2500, 50)
    true = fit_baseline(lines, exact, design()).charge(frequency)
    errors = [
        np.abs(fit_baseline(lines, noisy, design(), deviation=each).charge(frequency) / true - 1)
        for each in (deviation, None)
    ]
    assert np.sqrt(np.mean(errors[0] ** 2)) < 0.9 * np.sqrt(np.mean(errors[1] ** 2))


@pytest.mark.parametrize("sample_rate", [6000.0, 16000.0])
def test_other_sample_rates(plant: SensingPlant, sample_rate: float) -> None:
    """Measure at the ends of the range, from windows by the definition that begin anywhere."""
    window = round(0.025 * sample_rate)
    plan = plan_calibration(design(), sample_rate, LIMITS, window=window)
    current, drive = drawn(plan, in_air(plant)), played(plan)
    steps = np.diff(drive, prepend=0)
    positions = np.arange(LAGS, len(drive) - window, window)
    sums = [
        lag_sums(current[p : p + window].T, np.tile(steps[p - LAGS + 1 : p + window], (4, 1)))
        for p in positions
    ]
    shape = len(positions), CONTACTORS
    windows = AirWindows(
        positions, np.array(sums), np.zeros(shape), np.ones(shape, bool), np.zeros(shape, bool)
    )
    found = measure_admittances(plan, windows, drive, none(windows))
    departure = error(found, in_air(plant))
    assert departure[:, found.frequency > 60].max() < 0.03
    assert np.median(departure) < 1e-3
    assert found.frequency[-1] < 0.45 * sample_rate


def test_lost_windows_are_left_out(plant: SensingPlant) -> None:
    """Lose each third window, and fill the others of one channel's with nonsense."""
    windows = air_windows(PLAN, CONVERTER, drawn(PLAN, in_air(plant)))
    kept = np.flatnonzero(np.arange(len(windows.positions)) % 3)
    valid = windows.valid[kept].copy()
    valid[::4, 1] = False
    sums = np.where(valid[..., None], windows.sums[kept], np.nan)
    sums[::8, 1] = 1.0
    left = AirWindows(
        windows.positions[kept], sums, windows.rounding[kept], valid, windows.clipped[kept]
    )
    departure = error(measure_admittances(PLAN, left, played(PLAN), none(left)), in_air(plant))
    assert np.isfinite(departure).all()
    assert departure.max() < 0.03


def test_channel_with_too_few_windows_is_named(plant: SensingPlant) -> None:
    """Lose all windows of one segment of one channel, and all windows of another."""
    windows = air_windows(PLAN, CONVERTER, drawn(PLAN, in_air(plant)))
    segment = PLAN.segments[12]
    inside = (windows.positions >= segment.first) & (windows.positions + WINDOW <= segment.end)
    valid = windows.valid.copy()
    valid[inside, 0] = False
    valid[:, 2] = False
    found = measure_admittances(PLAN, replace(windows, valid=valid), played(PLAN), none(windows))
    lost = np.isin(found.frequency, segment.lines)
    np.testing.assert_array_equal(np.isnan(found.value[0]), lost)
    assert np.isnan(found.value[2]).all()
    assert np.isfinite(found.value[[1, 3]]).all()
    assert np.isnan(found.noise[2])
    faults = fitted(found).faults
    assert f"no current was measured at {segment.lines[0]:.0f} Hz" in faults[0]
    assert "no current was measured at 10 Hz" in faults[2]
    assert faults[1] == faults[3] == ""


def test_amplifiers_that_report_nothing_are_named() -> None:
    """Measure without any windows."""
    nothing = np.zeros((0, 2), np.bool_)
    windows = AirWindows(
        np.zeros(0, np.int64), np.zeros((0, 2, LAGS)), np.zeros((0, 2)), nothing, nothing
    )
    found = measure_admittances(PLAN, windows, played(PLAN), none(windows))
    assert np.isnan(found.value).all()
    assert np.isnan(found.noise).all()
    assert all("no current was measured at 10 Hz" in fault for fault in fitted(found).faults)


def faulty(plant: SensingPlant, fault: str) -> Response:
    """Return the plant's admittance with a fault of contactor 1."""
    air = in_air(plant)

    def response(frequency: Floats) -> Complex:
        """Return the admittances."""
        y, omega = air(frequency), 2 * np.pi * frequency
        y[1] = {
            "dead": 0 * y[1],
            "open": 100e-12j * omega,
            "wrong sign": -y[1],
            "late": y[1] * np.exp(-125e-6j * omega),
            "early": y[1] * np.exp(500e-6j * omega),
            "clipped": 1.8 * y[1],
            "small": 0.4 * y[1],
            "no bender": 1j * omega * design().capacitance,
        }[fault]
        return y

    return response


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("dead", "no current: the channel or its sensor is dead"),
        ("open", "no bender: 10[01] pF where"),
        ("wrong sign", "current of wrong sign"),
        ("late", "current 12[56] µs late"),
        ("early", "current -(499|500) µs late"),
        ("clipped", "current beyond the range of the converter at"),
        ("small", "capacitance 0.4[0-3] times the design's"),
        ("no bender", "d31 0"),
    ],
)
def test_faults_are_named(plant: SensingPlant, fault: str, words: str) -> None:
    """Measure with one faulty channel, which must not disturb the others."""
    baseline = fitted(measured(faulty(plant, fault)))
    assert baseline.faults[0] == baseline.faults[2] == baseline.faults[3] == ""
    assert re.search(words, baseline.faults[1])


@pytest.mark.parametrize("force", [0.05, 1.0])
def test_touched_contactors_are_named(plant: SensingPlant, force: float) -> None:
    """Lay fingers on two contactors, at the force of a light touch and a firm one [N]."""
    scale = np.sqrt(force) * np.array([0.0, 1.0, 0.0, 1.0])
    faults = fitted(measured(lambda frequency: plant.admittance(frequency, scale))).faults
    assert faults[0] == faults[2] == ""
    assert all("is it touched" in faults[channel] for channel in (1, 3))


def test_drive_stays_within_all_limits() -> None:
    """Check voltage, slew, current by differences of a capacitor, and that it ends at rest."""
    drive = PLAN.drive
    assert np.abs(drive).max() <= LARGEST * (1 + 1e-9)
    assert np.abs(np.diff(drive)).max() * RATE <= LIMITS.slew
    assert np.abs(drive[[0, -1]]).max() < 0.05
    assert np.abs(np.diff(drive)).max() * RATE * design().capacitance < FILLING * LIMITS.current
    assert PLAN.seconds < 10
    for limits, share in (
        (replace(LIMITS, voltage=5.0), 5.0 / LARGEST),
        (replace(LIMITS, current=0.5e-3), 1.0),
    ):
        plan = plan_calibration(design(), RATE, limits, window=WINDOW)
        assert np.abs(plan.drive).max() == pytest.approx(share * LARGEST, rel=1e-6)
    slow = plan_calibration(design(), RATE, replace(LIMITS, slew=1e4), window=WINDOW)
    inner = [np.abs(np.diff(slow.drive[s.first : s.end])).max() * RATE for s in slow.segments]
    assert max(inner) <= 1e4


def test_no_tolerated_bender_clips(plant: SensingPlant) -> None:
    """Check that the current of all contactors stays within the range, and uses it."""
    most = np.abs(drawn(PLAN, in_air(plant))).max(axis=0)
    assert np.all(most < 0.96 * CONVERTER.range)
    assert np.all(most > 0.5 * CONVERTER.range)


def test_each_line_is_in_one_steady_part() -> None:
    """Check the segments: in order, within the drive, lines far apart and each played once."""
    ends = [edge for segment in PLAN.segments for edge in (segment.first, segment.end)]
    assert np.all(np.diff([0, *ends, len(PLAN.drive)]) >= 0)
    lines = np.concatenate([segment.lines for segment in PLAN.segments])
    assert len(np.unique(lines)) == len(lines) == len(PLAN.lines)
    for segment in PLAN.segments:
        assert np.all(np.diff(segment.lines) > 60)
        assert (segment.end - segment.first) / RATE > 2 / segment.lines[0] - 1e-9


def test_windows_that_are_too_long_are_refused() -> None:
    """Plan for windows of 50 ms."""
    with pytest.raises(InputError, match="windows of 50 ms: must be at most 44 ms"):
        plan_calibration(design(), RATE, LIMITS, window=400)


def test_bender_behind_an_amplifier() -> None:
    """Compare charge and voltage of a design with the response of the bimorph as a whole."""
    amplifier = Amplifier(gain=20.0, bandwidth=5e3, output_resistance=1e3)
    bender = bender_of(Bimorph(), amplifier, RATE)
    frequency = np.arange(20.0, 2501.0, 70.0)
    air = tip_response(Bimorph(), FingerLoad.none(), frequency).admittance
    volts = amplifier.response(frequency, air, RATE)
    # the output resistance follows the resonance, 16 Hz wide, in steps of 5 Hz
    np.testing.assert_allclose(bender.electrode_voltage(frequency), volts, rtol=1e-3)
    lowest = np.array([REFERENCE / 10])
    force, stiffness = bender.at(lowest, Deviations(*np.ones((3, 1))))
    charge = bender.capacitance + (force**2 / stiffness)[0]
    expected = tip_response(Bimorph(), FingerLoad.none(), lowest).admittance / (2j * np.pi * lowest)
    np.testing.assert_allclose(charge.real, expected.real, rtol=1e-3)


def test_drive_behind_a_gain_is_smaller() -> None:
    """Plan for an amplifier of gain 20: the electrodes get the same voltage."""
    loud = bender_of(Bimorph(), Amplifier(gain=20.0), RATE)
    plan = plan_calibration(loud, RATE, LIMITS, window=WINDOW)
    np.testing.assert_allclose(20 * plan.drive, PLAN.drive, atol=1e-9)


@pytest.mark.ci
def test_equalizer_follows_as_well_as_after_an_exact_calibration() -> None:
    """Calibrate the plant in time, and compare the played shear with that of exact baselines."""
    case = draw_case(6, 3, CONVERTER, seed=11)
    loads, tolerances = fingers(case.logarithms[:3]), case.tolerances.first(3)
    exact = exact_baseline(SensingPlant(loads, tolerances, sample_rate=RATE))
    for name, most in (("stiffness", 2e-5), ("coupling", 8e-4)):
        ratio = getattr(case.array.deviations, name) / getattr(exact.deviations, name)
        assert np.abs(ratio - 1).max() < most, name
    medians = []
    for each in (case, replace(case, array=exact, baseline=repeated(exact, case.fingers))):
        loop = Loop(each, CONVERTER, force=steady, seconds=1.0)
        errors = np.array([moment.error for moment in loop.run() if moment.time >= 0.5])
        medians.append(np.median(by_finger(errors, case.fingers)[1]))
    assert medians[0] < medians[1] + 0.1
