"""Self-sensing: how well played shear follows the commanded one under fingers that are unknown."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.sensing_loop import (
    DELAY,
    FREQUENCY,
    RATE,
    TAPS,
    VOLTAGE,
    WINDOW,
    Case,
    Loop,
    Moment,
    design,
    draw_case,
    planned,
    planned_loops,
    references,
    steady,
    swinging,
)
from benchmarks.sensing_plant import Converter, Fingers, PlantTolerances, SensingPlant
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most, seconds
from tactile.rendering.equalizer import Equalizer, FollowingEqualizer, InverseFilter
from tactile.sensing.baseline import NEAR, Baseline, fit_baseline
from tactile.sensing.bender import Deviations
from tactile.sensing.calibration import calibration_lines
from tactile.sensing.correlation import AFTER, EARLIER, MARGIN, SumWindow, during, step_products
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import LoadEstimator
from tactile.sensing.excitation import TONES, VOLTS
from tactile.sensing.hysteresis import HysteresisStream, PlayModel
from tactile.sensing.inverse_mix import InverseMix
from tactile.sensing.loop_tones import DENSER, PLAYS
from tactile.sensing.population import Population
from tactile.sensing.uncertainty import shear_deviation
from tactile.texture.perception import detection_threshold

FINGERS, CONTACTORS = 40, 24
"""Numbers of random fingers, and of contactors under each."""
SETTLED = 0.5
"""Time from the first touch from which errors count [s]."""
SECONDS = 2.0
"""Duration of each stroke [s]."""
ROUNDS = 50
"""Number of repetitions of each timing."""


def by_finger(errors: Floats, fingers: int) -> tuple[Floats, Floats]:
    """Return median and 95th percentile of |error| of each finger, from errors (..., N, F) [dB]."""
    size = np.abs(errors).reshape(-1, fingers, errors.shape[-2] // fingers, errors.shape[-1])
    rows = np.moveaxis(size, 1, 0).reshape(fingers, -1)
    return np.median(rows, axis=1), np.percentile(rows, 95, axis=1)


def measure_sensing() -> Iterator[Figure]:
    """Measure the equalizer that follows the finger, and what it costs."""
    converter = Converter()
    case = draw_case(FINGERS, CONTACTORS, converter, seed=7)
    yield from _calibration(case, converter)
    yield from _swinging(case, converter)
    yield from _steady(case, converter)
    yield from _hysteresis(converter)
    yield from _conditions(converter)
    yield from _rounding(converter)
    yield _pilot(case)
    yield _transient()
    yield from _cost()


def _calibration(case: Case, converter: Converter) -> Iterator[Figure]:
    """Yield how long the calibration takes, and its errors against a fit to exact admittances."""
    n, plan = CONTACTORS, planned(converter)
    plant = SensingPlant(
        Fingers(*np.exp(case.logarithms[:n]).T), case.tolerances.first(n), sample_rate=RATE
    )
    air = plant.admittance(plan.lines, np.zeros(n))
    exact, own = fit_baseline(plan.lines, air, design()), case.array
    frequency = np.geomspace(60, 2500, 100)
    away = np.abs(frequency / design().resonance - 1) > NEAR
    error = np.abs(own.charge(frequency) / exact.charge(frequency) - 1)[:, away]
    coupling = np.abs(own.deviations.coupling / exact.deviations.coupling - 1)
    yield at_most("sensing, calibration: duration", plan.seconds, "s", 10.0)
    loops = len(planned_loops(converter).drive) / RATE
    yield Figure("sensing, calibration: duration for the hysteresis", loops, "s")
    yield Figure("sensing, calibration: error of the capacitance", 100 * rms(error), "%")
    yield Figure("sensing, calibration: largest error of d31", 100 * float(coupling.max()), "%")
    fit = seconds(lambda: fit_baseline(plan.lines, air, design()), 3)
    yield Figure("sensing, calibration: fit of 24 contactors", fit, "s")
    touched = _touched(case, 0.05)
    yield at_least("sensing, calibration: fingers of 0.05 N that are named", touched, "%", 100)


def _touched(case: Case, force: float) -> float:
    """Return the share of contactors [%] whose fault is named if a finger stays on them."""
    plant = SensingPlant(Fingers(*np.exp(case.logarithms).T), case.tolerances, sample_rate=RATE)
    some = np.arange(0, len(case.logarithms), 5)
    lines = calibration_lines(design().resonance)
    loaded = plant.admittance(lines, np.full(len(case.logarithms), np.sqrt(force)))[some]
    return 100 * float(
        np.mean([fault != "" for fault in fit_baseline(lines, loaded, design()).faults])
    )


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _swinging(case: Case, converter: Converter) -> Iterator[Figure]:
    """Yield errors while the normal force swings between 0.2 and 2 N every 1.5 s."""
    loop = Loop(case, converter, force=swinging(1.5), seconds=SECONDS)
    name = "sensing, force 0.2–2 N every 1.5 s"
    settled, first, shares = [], math.nan, []
    others: dict[str, list[Floats]] = {}
    for moment in loop.run():
        if moment.time >= 0.2 and math.isnan(first):
            first = float(np.percentile(np.abs(moment.error), 95))
        if moment.time < SETTLED:
            continue
        settled.append(moment.error.astype(np.float32))
        shares.append(_within_two_deviations(case, moment))
        for other, error in references(loop, moment.time).items():
            others.setdefault(other, []).append(error.astype(np.float32))
    _, p95 = by_finger(np.array(settled), case.fingers)
    yield at_most(f"{name}: p95 of the median finger", float(np.median(p95)), "dB", 0.9)
    yield at_least(f"{name}: fingers with p95 ≤ 1.5 dB", 100 * float(np.mean(p95 <= 1.5)), "%", 90)
    yield Figure(f"{name}: p95 of the worst finger", float(p95.max()), "dB")
    yield at_most(f"{name}: p95 at 0.2 s", first, "dB", 3.0)
    yield Figure(f"{name}: within two stated deviations", 100 * float(np.mean(shares)), "%")
    yield Figure(f"{name}: samples beyond ±100 V", 100 * loop.beyond, "%")
    for other, errors in others.items():
        median, p95 = by_finger(np.array(errors), case.fingers)
        yield Figure(f"{name}, {other}: median", float(np.median(median)), "dB")
        yield Figure(f"{name}, {other}: p95", float(np.median(p95)), "dB")
        yield Figure(f"{name}, {other}: p95 of the worst finger", float(p95.max()), "dB")


def _within_two_deviations(case: Case, moment: Moment) -> float:
    """Return the share of contactors whose rms error is within two of the stated deviations."""
    assert moment.estimate is not None
    estimate = moment.estimate
    stated = shear_deviation(case.baseline, estimate.logarithms, estimate.covariance)
    even = np.searchsorted(FREQUENCY, np.geomspace(10, 1000, 25))  # as `shear_deviation` weighs
    return float(np.mean(np.sqrt(np.mean(moment.error[:, even] ** 2, axis=1)) < 2 * stated))


def _steady(case: Case, converter: Converter) -> Iterator[Figure]:
    """Yield errors under a steady normal force of 1 N."""
    loop = Loop(case, converter, force=steady, seconds=SECONDS)
    moments = [moment for moment in loop.run() if moment.time >= SETTLED]
    errors = np.array([moment.error.astype(np.float32) for moment in moments])
    _, p95 = by_finger(errors, case.fingers)
    shares = [_within_two_deviations(case, moment) for moment in moments]
    yield at_most("sensing, 1 N: p95 of the median finger", float(np.median(p95)), "dB", 0.6)
    yield Figure("sensing, 1 N: p95 of the worst finger", float(p95.max()), "dB")
    yield Figure("sensing, 1 N: within two stated deviations", 100 * float(np.mean(shares)), "%")


def _hysteresis(converter: Converter) -> Iterator[Figure]:
    """Yield errors of benders with a hysteresis, with its model and, for fewer of them, without."""
    for width, modeled, fingers, contactors in (
        (0.13, True, FINGERS, CONTACTORS),
        (0.15, True, FINGERS, CONTACTORS),
        (0.13, False, 8, 4),
    ):
        case = draw_case(fingers, contactors, converter, seed=7, width=width, modeled=modeled)
        loop = Loop(case, converter, force=swinging(1.5), seconds=SECONDS)
        errors = np.array([m.error.astype(np.float32) for m in loop.run() if m.time >= SETTLED])
        _, p95 = by_finger(errors, fingers)
        name = f"sensing, hysteresis of {width:.0%}"
        if modeled:
            yield at_most(f"{name}: p95 of the median finger", float(np.median(p95)), "dB", 1.5)
            share = 100 * float(np.mean(p95 <= 1.5))
            yield Figure(f"{name}: fingers with p95 ≤ 1.5 dB", share, "%")
        else:
            yield Figure(f"{name}, not modeled: p95", float(np.median(p95)), "dB")


def _conditions(converter: Converter) -> Iterator[Figure]:
    """Yield errors of eight fingers where something is not as it was at the calibration."""
    case = draw_case(8, 4, converter, seed=11)
    wide = Converter(range=20e-3)
    loops = {
        "as before": Loop(case, converter, force=swinging(1.5), seconds=1.5),
        "force every 0.7 s": Loop(case, converter, force=swinging(0.7), seconds=1.5),
        "without pilot": Loop(case, converter, force=swinging(1.5), seconds=1.5, piloted=False),
        "smooth steel": Loop(
            case, converter, force=swinging(1.5), seconds=1.5, texture="metal-steel-smooth"
        ),
        "skew 0.1 µs off": Loop(case, Converter(skew=1e-7), force=swinging(1.5), seconds=1.5),
        "skew 0.3 µs off": Loop(case, Converter(skew=3e-7), force=swinging(1.5), seconds=1.5),
        "capacitance 2 % off": Loop(case, converter, force=swinging(1.5), seconds=1.5),
        "range ±20 mA": Loop(draw_case(8, 4, wide, 11), wide, force=swinging(1.5), seconds=1.5),
    }
    plant = loops["capacitance 2 % off"].plant
    plant.tip = replace(plant.tip, capacitance=1.02 * plant.tip.capacitance)
    for name, loop in loops.items():
        errors = np.array([m.error for m in loop.run() if m.time >= SETTLED])
        _, p95 = by_finger(errors, case.fingers)
        yield Figure(
            f"sensing, {name}: p95 of the median of 8 fingers", float(np.median(p95)), "dB"
        )
        yield Figure(f"sensing, {name}: p95 of the worst of 8", float(p95.max()), "dB")


def _rounding(converter: Converter) -> Iterator[Figure]:
    """Yield what 16 lag sums of 16 bits lose against sums in double precision."""
    case = draw_case(8, 4, converter, seed=11)
    medians = []
    for rounded in (False, True):
        loop = Loop(case, converter, force=swinging(1.5), seconds=1.5, rounded=rounded)
        errors = np.array([m.error for m in loop.run() if m.time >= SETTLED])
        medians.append(float(np.median(by_finger(errors, case.fingers)[1])))
    yield at_most("sensing, loss by lag sums of 16 bits", medians[1] - medians[0], "dB", 0.05)


def _pilot(case: Case) -> Figure:
    """Return the level of the pilot re the threshold, at the contactor that moves most."""
    plant = SensingPlant(Fingers(*np.exp(case.logarithms).T), case.tolerances, sample_rate=RATE)
    tones, volts = np.array(TONES), np.array(VOLTS)
    levels = []
    for force in (0.05, 0.2, 1.0, 2.0):
        shear = np.abs(plant.response(tones, np.full(len(case.logarithms), np.sqrt(force))))
        power = (shear * volts / detection_threshold(tones)) ** 2
        levels.append(10 * np.log10(power.sum(axis=1).max()))
    return at_most("sensing, pilot of four tones re threshold", float(max(levels)), "dB", -20.0)


def _as_designed() -> Baseline:
    """Return the baseline of one contactor that is exactly as designed."""
    one = np.ones(1)
    return Baseline(
        design(), Deviations(one, one, one), 0 * one, np.zeros((1, 7), np.complex128),
        one, 0 * one, ("",), PlayModel.none(1),
    )  # fmt: skip


def _transient() -> Figure:
    """Return the transient of a change from the low finger's filter to the high one's.

    A sinusoid of 10 µm at 100 Hz plays under the mean finger; the transient is what its shear has
    between 200 and 1000 Hz.
    """
    mix = InverseMix(_as_designed(), RATE, taps=TAPS, delay=DELAY)
    low, high = (
        mix.taps(np.log([[float(f.k0), float(f.d0), *map(float, f.branches[0])]]))
        for f in (FingerLoad.low(), FingerLoad.high())
    )
    shear = 10e-6 * np.sin(2 * np.pi * 100 * np.arange(8000) / RATE).astype(np.float32)[:, None]
    follower = FollowingEqualizer(low)
    drive = [follower(shear[:4000], np.zeros(4000))]
    follower.replace(high, WINDOW)
    drive.append(follower(shear[4000:], np.zeros(4000)))
    plant = SensingPlant(
        Fingers(*np.exp(Population.assumed().mean)[:, None]),
        PlantTolerances.none(1),
        sample_rate=RATE,
    )
    moved, _ = plant.step(np.concatenate(drive).astype(np.float64))
    band = butter(8, (200, 1000), "bandpass", fs=RATE, output="sos")
    transient = np.abs(sosfiltfilt(band, moved[:, 0])[3000:6000]).max()
    return at_most("sensing, transient of a change of filters", float(transient) * 1e6, "µm", 0.05)


def _update_cost(contactors: int) -> Iterator[Figure]:
    """Yield the time of an update of the loads and filters of contactors under two fingers."""
    case = draw_case(2, contactors // 2, Converter(), seed=3)
    population = Population.assumed()
    model = CurrentModel(case.baseline, population, RATE)
    estimator = LoadEstimator(model, population, noise=1e-6)
    mix = InverseMix(case.baseline, RATE, taps=TAPS, delay=DELAY)
    rng = np.random.default_rng(0)
    steps = rng.standard_normal((contactors, AFTER + WINDOW + MARGIN))
    drawn = model.electrical + model.weights(case.logarithms) @ model.shared
    window = SumWindow(
        np.einsum("nml,nm->nl", step_products(steps, during(steps)), drawn),
        during(steps),
        steps,
        np.zeros(contactors),
        np.ones(contactors, np.bool_),
        rng.standard_normal((contactors, EARLIER)),
    )

    def update() -> None:
        """Update all loads and mix their filters."""
        estimator.update(window)
        mix.taps(estimator.ahead(2.5))

    for _ in range(10):  # beyond the first windows, which get more iterations
        update()
    yield at_most(
        f"sensing, update of {contactors} contactors", 1e3 * seconds(update, ROUNDS), "ms", 10.0
    )


def _cost() -> Iterator[Figure]:
    """Yield the times of an update, and of a block of 64 contactors with filters of their own."""
    contactors, rng = 64, np.random.default_rng(0)
    yield from _update_cost(contactors)
    taps = rng.standard_normal((contactors, TAPS))
    shear = rng.standard_normal((64, contactors)).astype(np.float32)
    force = np.full(64, 0.7)
    following = FollowingEqualizer(taps)
    own = seconds(lambda: following(shear, force), ROUNDS)
    fade = seconds(lambda: following.replace(taps, 10**9), ROUNDS)
    fading = seconds(lambda: following(shear, force), ROUNDS)
    one = _fixed(taps[:1, None], (1.0,))
    shared = seconds(lambda: one(shear, force), ROUNDS)
    table = _fixed(taps[:3, None], (0.5, 1.0, 2.0))
    tabled = seconds(lambda: table(shear, force), ROUNDS)
    name = "equalizer, 64 samples of 64 contactors"
    yield Figure(f"{name}: filters of their own", 1e6 * own, "µs")
    yield Figure(f"{name}: the same while they cross-fade", 1e6 * fading, "µs")
    yield Figure(f"{name}: to begin a cross-fade", 1e6 * fade, "µs")
    yield Figure(f"{name}: one filter for all, a table of 3 forces", 1e6 * tabled, "µs")
    yield Figure(f"{name}: one filter for all", 1e6 * shared, "µs")
    radii = np.tile(VOLTAGE * (np.arange(1, PLAYS + 1) / (PLAYS + 1)) ** DENSER, (contactors, 1))
    stream = HysteresisStream(PlayModel(radii, np.full_like(radii, 0.6 / PLAYS)))
    for volts in (20.0, VOLTAGE):
        drive = np.outer(volts * np.sin(np.arange(64) / 10), np.ones(contactors))
        stream(drive)
        cost = 1e6 * seconds(partial(stream, drive), ROUNDS)
        yield Figure(f"{name}: inverse of the hysteresis, up to {volts:g} V", cost, "µs")


def _fixed(taps: Floats, forces: tuple[float, ...]) -> Equalizer:
    """Return an equalizer that plays the same filter on 64 contactors."""
    filter_ = InverseFilter(taps, np.ones((1, 1)), DELAY, 0.0)
    return Equalizer(filter_, kind=np.zeros(64, np.intp), polarity=np.ones(64), forces=forces)
