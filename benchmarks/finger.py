"""A finger that rests on the display and is measured once, on the finite-element plant."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.sensing_loop import (
    CODE,
    DECIBEL,
    FREQUENCY,
    RATE,
    WINDOW,
    Case,
    design,
    draw_case,
    reported,
)
from benchmarks.sensing_plant import Converter, Fingers, SensingPlant
from firmware_protocol.correlation import Correlator
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most, seconds
from tactile.sensing.calibration import LARGEST, MeasuringLimits
from tactile.sensing.correlation import AFTER, EARLIER, MARGIN, SumWindow, during
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.finger_drive import measuring_drive
from tactile.sensing.population import Population, load_stiffness
from tactile.sensing.resting_load import EXPLAINED, MeasuredLoads, measure_loads
from tactile.sensing.uncertainty import shear_deviation, stiffness_deviation

FINGERS, CONTACTORS = 40, 8
"""Numbers of random fingers, and of contactors under each."""
SEED = 31
"""Seed of the fingers; those with which drive and model error were chosen had another."""
EVEN = np.geomspace(10, 1000, 25)
"""Frequencies at which stated deviations are judged [Hz]."""


def drive_of(converter: Converter) -> Floats:
    """Return the drive, in codes of the display (S,) [V]."""
    limits = MeasuringLimits(current=converter.range, voltage=LARGEST, slew=0.7e6)
    return np.asarray(np.rint(measuring_drive(design(), RATE, limits) / CODE) * CODE)


def windows_of(plant: SensingPlant, drive: Floats, scale: Floats | None = None) -> list[SumWindow]:
    """Return the windows of a drive (S,) that all contactors play, as `sum_windows_of`."""
    return sum_windows_of(plant, np.repeat(drive[:, None], len(plant.scale), axis=1), scale)


def sum_windows_of(
    plant: SensingPlant, whole: Floats, scale: Floats | None = None
) -> list[SumWindow]:
    """Return the windows of a drive (S, N) that a plant plays, as the reference amplifier reports.

    ``scale`` are the loads' scales (S + delay, N); by default they stay as they are.
    """
    n, lead = len(plant.scale), EARLIER + AFTER + 1
    _, current = plant.step(np.concatenate([whole, np.zeros((plant.delay, n))]), scale)
    sums, rounding, clipped = reported(
        Correlator(n), plant.converter, whole, current[plant.delay :]
    )
    played = np.concatenate([np.zeros((lead, n)), whole, np.zeros((MARGIN, n))])
    windows = []
    for k, begin in enumerate(range(0, len(whole), WINDOW)):
        steps = np.diff(played[begin : begin + lead + WINDOW + MARGIN], axis=0).T
        windows.append(
            SumWindow(
                sums[k],
                during(steps[:, EARLIER:]),
                steps[:, EARLIER:],
                2 * rounding[k],
                ~clipped[k],
                steps[:, :EARLIER],
            )
        )
    return windows


def plant_of(case: Case, converter: Converter) -> SensingPlant:
    """Return the plant of a case."""
    return SensingPlant(
        Fingers(*np.exp(case.logarithms).T), case.tolerances,
        converter=converter, sample_rate=RATE, seed=SEED,
    )  # fmt: skip


def estimated(case: Case, converter: Converter, windows: list[SumWindow]) -> MeasuredLoads:
    """Return the loads that windows of a case tell of."""
    population = Population.assumed()
    model = CurrentModel(case.baseline, population, RATE)
    noise = converter.step * float(np.hypot(converter.noise, 1 / np.sqrt(12)))
    return measure_loads(model, population, windows, noise=noise)


def level_error(case: Case, plant: SensingPlant, loads: MeasuredLoads, at: Floats) -> Floats:
    """Return the error of the predicted shear (N, F) at frequencies under the present load [dB]."""
    force, stiffness = case.baseline.tip(at)
    predicted = force / (stiffness + load_stiffness(loads.logarithms, at))
    return np.asarray(DECIBEL * np.log(np.abs(predicted / plant.response(at, plant.scale))))


def measure_finger() -> Iterator[Figure]:
    """Measure the errors of the load of fingers that rest, and whether the stated ones hold."""
    converter = Converter()
    case, drive = draw_case(FINGERS, CONTACTORS, converter, SEED), drive_of(converter)
    plant = plant_of(case, converter)
    windows = windows_of(plant, drive)
    loads = estimated(case, converter, windows)
    yield Figure("finger: duration", len(drive) / RATE, "s")
    yield _shear(case, converter, drive)
    yield at_most("finger: largest voltage", float(np.abs(drive).max()), "V", LARGEST)
    yield from _errors("finger, 1 N", case, plant, loads, 1.0)
    yield from _coverage(case, loads)
    worst = float(loads.inconsistency.max())
    yield at_most("finger: largest mean square of a residual", worst, "", EXPLAINED)
    cost = seconds(lambda: estimated(case, converter, windows), 1)
    yield Figure(f"finger: estimate of {len(case.logarithms)} contactors", cost, "s")
    yield from _conditions(converter, drive)
    yield from _touched(case, converter, drive)


def _shear(case: Case, converter: Converter, drive: Floats) -> Figure:
    """Return the shear that the drive plays, on the contactor in the middle."""
    moved, _ = plant_of(case, converter).step(np.repeat(drive[:, None], len(case.logarithms), 1))
    median = float(np.median(np.sqrt(np.mean(moved**2, axis=0))))
    return Figure("finger: shear, rms, of the median contactor", 1e6 * median, "µm")


def _errors(
    name: str, case: Case, plant: SensingPlant, loads: MeasuredLoads, goal: float | None = None
) -> Iterator[Figure]:
    """Yield errors of the predicted level."""
    errors = np.abs(level_error(case, plant, loads, FREQUENCY))
    p95 = np.percentile(errors.reshape(case.fingers, -1), 95, axis=1)
    yield Figure(f"{name}: median error", float(np.median(errors)), "dB")
    yield at_most(f"{name}: p95 of all errors", float(np.percentile(errors, 95)), "dB", goal)
    yield Figure(f"{name}: p95 of the worst finger", float(p95.max()), "dB")


def _coverage(case: Case, loads: MeasuredLoads) -> Iterator[Figure]:
    """Yield errors of the stiffness, and how often they are within two stated deviations."""
    true = load_stiffness(case.logarithms, EVEN)
    found = load_stiffness(loads.logarithms, EVEN)
    deviation = stiffness_deviation(loads.logarithms, loads.covariance, EVEN)
    error = found - true
    at = np.array([100.0, 300.0])
    exact = load_stiffness(case.logarithms, at)
    away = np.abs(load_stiffness(loads.logarithms, at) / exact - 1)
    for k, f in enumerate(at):
        yield Figure(
            f"finger: error of k({f:g} Hz), median", 100 * float(np.median(away[:, k])), "%"
        )
        yield Figure(
            f"finger: error of k({f:g} Hz), p95", 100 * float(np.percentile(away[:, k], 95)), "%"
        )
    for part in ("real", "imag"):
        within = np.abs(getattr(error, part)) < 2 * getattr(deviation, part)
        name = f"finger: {part} part of k within two stated deviations"
        yield at_least(name, 100 * float(within.mean()), "%", 80)
        least = 100 * float(within.mean(axis=0).min())
        yield at_least(f"{name}, at the worst of 25 frequencies", least, "%", 80)
    plant = plant_of(case, Converter())
    level = np.sqrt(np.mean(level_error(case, plant, loads, EVEN) ** 2, axis=1))
    stated = shear_deviation(case.baseline, loads.logarithms, loads.covariance)
    yield at_least(
        "finger: level within two stated deviations", 100 * float(np.mean(level < 2 * stated)),
        "%", 80,
    )  # fmt: skip


def _conditions(converter: Converter, drive: Floats) -> Iterator[Figure]:
    """Yield errors of eight fingers where something is not as it was at the calibration."""
    case = draw_case(8, CONTACTORS, converter, seed=SEED + 1)
    n = len(case.logarithms)
    plants = {
        "eight fingers": plant_of(case, converter),
        "skew 0.1 µs off": plant_of(case, Converter(skew=1e-7)),
        "skew 0.3 µs off": plant_of(case, Converter(skew=3e-7)),
        "capacitance 2 % off": plant_of(case, converter),
        "force rising by 20 %": plant_of(case, converter),
    }
    tip = plants["capacitance 2 % off"].tip
    plants["capacitance 2 % off"].tip = replace(tip, capacitance=1.02 * tip.capacitance)
    for name, plant in plants.items():
        ramp = None
        if "rising" in name:
            length = len(drive) + plant.delay
            ramp = np.repeat(np.sqrt(np.linspace(0.9, 1.1, length))[:, None], n, axis=1)
        loads = estimated(case, converter, windows_of(plant, drive, ramp))
        plant.scale[:] = 1
        yield from _errors(f"finger, {name}", case, plant, loads)
        yield Figure(f"finger, {name}: explained", 100 * float(loads.explained.mean()), "%")


def _touched(case: Case, converter: Converter, drive: Floats) -> Iterator[Figure]:
    """Yield how often air and light fingers are told apart."""
    for force in (0.0, 0.01, 0.05, 0.2):
        plant = plant_of(case, converter)
        plant.scale[:] = np.sqrt(force)
        loads = estimated(case, converter, windows_of(plant, drive))
        touching = 100 * float(loads.touching.mean())
        name = f"finger of {force:g} N" if force else "no finger"
        if force:
            yield at_least(f"{name}: contactors that are touched", touching, "%", 100)
        else:
            yield at_most(f"{name}: contactors that are touched", touching, "%", 0)
        known = loads.touching & loads.explained
        yield Figure(f"{name}: contactors with a known load", 100 * float(known.mean()), "%")
        if known.any():
            error = np.abs(level_error(case, plant, loads, FREQUENCY))[known]
            yield Figure(f"{name}: p95 of all errors", float(np.percentile(error, 95)), "dB")
