"""Textures played through an equalizer that follows the finger, on the finite-element plant.

Everything but plant and clock is the product's own: the texture, the calibration in air, the pilot,
the sums as the reference amplifier reports them, the estimator, and the equalizer whose filters it
replaces.
A window ends 25 ms before the filters that it leads to begin to fade in, which take 25 ms more: the
report takes its time, and the host renders ahead of the amplifier.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

import tactile
from benchmarks.sensing_plant import (
    REACH,
    Converter,
    Fingers,
    PlantTolerances,
    SensingPlant,
    friction_strengths,
)
from firmware_protocol.correlation import Correlator, decode, messages_of
from firmware_protocol.messages import FULL_SCALE_CODE, PACKET_MAX, Window
from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.arrays import Complex, Floats
from tactile.rendering.equalizer import FollowingEqualizer
from tactile.sensing.admittance import AirWindows, measure_admittances
from tactile.sensing.baseline import Baseline, fit_baseline
from tactile.sensing.bender import Bender, Deviations, bender_of
from tactile.sensing.calibration import CalibrationPlan, MeasuringLimits, plan_calibration
from tactile.sensing.correlation import AFTER, EARLIER, MARGIN, SumWindow, during
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import Estimate, LoadEstimator
from tactile.sensing.excitation import pilot, pilot_phases
from tactile.sensing.hysteresis import HysteresisStream, PlayModel
from tactile.sensing.inverse_mix import InverseMix
from tactile.sensing.loop_tones import LoopPlan, fit_hysteresis, plan_loops
from tactile.sensing.population import Population

RATE = 8000.0
"""Sample rate [Hz]."""
WINDOW = 200
"""Length of a window of lag sums, and of the cross-fade to other filters [samples]."""
TAPS, DELAY = 32, 8
"""Length and delay of the equalizer's filters [samples]."""
AHEAD = 2.5
"""Time from the middle of a window to the end of the cross-fade that it leads to [windows]."""
FREQUENCY = np.arange(10.0, 1001.0, 10.0)
"""Frequencies at which played shear is compared with commanded shear [Hz]."""
VOLTAGE = 100.0
"""Voltage limit and full scale of the display [V]."""
CODE = VOLTAGE / FULL_SCALE_CODE
"""Volts of a sample code."""
VARIED_SCALE, VARIED_SHAPE = 0.15, 0.10
"""Standard deviations of the logarithms between contactors of one finger: of all constants in
common, and of each besides (assumed)."""
DECIBEL = 20 / np.log(10)
"""Decibels per unit of natural logarithm."""


@dataclass(frozen=True)
class Case:
    """Contactors of an array under several fingers, in the order finger by finger.

    Attributes
    ----------
    fingers : int
        Number of fingers.
    array : Baseline
        Baseline of the contactors under one finger, measured in air.
    baseline : Baseline
        The same for all contactors.
    tolerances : PlantTolerances
        Deviations of the contactors.
    logarithms : (N, 4) array of float
        Logarithms of the constants of the loads at 1 N.
    strength : (ELEMENTS, N) array of float or None
        Strengths of the hysteresis; None without.
    """

    fingers: int
    array: Baseline
    baseline: Baseline
    tolerances: PlantTolerances
    logarithms: Floats
    strength: Floats | None


def design() -> Bender:
    """Return the default bender as `tactile.sensing` sees it."""
    return bender_of(Bimorph(), Amplifier(), RATE)


def reported(
    correlator: Correlator, converter: Converter, drive: Floats, current: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Report windows as the reference amplifier does.

    Of a drive (S, N) and the current of the same instants, of whole windows, it returns the sums
    (W, N, LAGS), the largest error of their rounding (W, N) and whether they clipped (W, N).
    """
    amperes = converter.range / FULL_SCALE_CODE
    codes, currents = (
        np.rint(values / unit).astype(np.int64)
        for values, unit in ((drive, CODE), (current, amperes))
    )
    # what the plant clips is at an end of the range of the protocol too
    top = converter.range - 1.5 * converter.step
    currents = np.where(np.abs(current) > top, FULL_SCALE_CODE * np.sign(currents), currents)
    sums, rounding, clipped = [], [], []
    for window in correlator.add(0, codes, currents.astype(np.int64), WINDOW):
        messages = messages_of(window, round(converter.range * 1e6), PACKET_MAX)
        entries = [part for part in map(decode, messages) if part is not None]
        sums.append(np.concatenate([part.sums for part in entries]) * (amperes * CODE))
        rounding.append(np.concatenate([part.rounding for part in entries]) * (amperes * CODE))
        clipped.append(np.concatenate([part.flags for part in entries]) & Window.CLIPPED != 0)
    return np.array(sums), np.array(rounding), np.array(clipped)


def air_windows(
    plan: CalibrationPlan | LoopPlan, converter: Converter, current: Floats
) -> AirWindows:
    """Return the windows of a plan's current (S, N), as the reference amplifier reports them."""
    n = current.shape[1]
    drive = np.repeat(plan.drive[:, None], n, axis=1)
    sums, rounding, clipped = reported(Correlator(n), converter, drive, current)
    positions = WINDOW * np.arange(len(sums), dtype=np.int64)
    return AirWindows(positions, sums, rounding, np.ones_like(clipped), clipped)


def planned(converter: Converter) -> CalibrationPlan:
    """Return the drive of the calibration."""
    limits = MeasuringLimits(current=converter.range, voltage=VOLTAGE, slew=0.7e6)
    return plan_calibration(design(), RATE, limits, window=WINDOW)


def planned_loops(converter: Converter) -> LoopPlan:
    """Return the drive that measures the hysteresis."""
    limits = MeasuringLimits(current=converter.range, voltage=VOLTAGE, slew=0.7e6)
    return plan_loops(design().capacitance, RATE, limits, window=WINDOW)


def calibrate(
    tolerances: PlantTolerances,
    converter: Converter,
    seed: int,
    strength: Floats | None = None,
    *,
    modeled: bool = True,
) -> Baseline:
    """Measure the baseline of contactors in air, and their hysteresis if it is to be modeled."""
    n, plan, loops = len(tolerances.mass), planned(converter), planned_loops(converter)

    def windows_of(plan: CalibrationPlan | LoopPlan) -> AirWindows:
        """Play a drive on contactors in air."""
        plant = SensingPlant(
            Fingers(*np.ones((4, n))), tolerances,
            converter=converter, sample_rate=RATE, seed=seed, strength=strength,
        )  # fmt: skip
        plant.scale[:] = 0
        longer = np.concatenate([np.rint(plan.drive / CODE) * CODE, np.zeros(plant.delay)])
        _, current = plant.step(np.repeat(longer[:, None], n, axis=1))
        return air_windows(plan, converter, current[plant.delay :])

    hysteresis = fit_hysteresis(loops, windows_of(loops)) if modeled else PlayModel.none(n)
    found = measure_admittances(
        plan, windows_of(plan), np.rint(plan.drive / CODE) * CODE, hysteresis
    )
    return fit_baseline(
        found.frequency, found.value, design(),
        deviation=found.deviation, clipped=found.clipped, hysteresis=hysteresis,
    )  # fmt: skip


def draw_case(
    fingers: int,
    contactors: int,
    converter: Converter,
    seed: int,
    *,
    width: float = 0.0,
    modeled: bool = True,
) -> Case:
    """Draw random contactors, calibrate them, and draw random fingers.

    ``width`` is that of the hysteresis at ±100 V, and ``modeled`` whether the calibration measures
    it.
    """
    rng = np.random.default_rng(seed)
    tolerances = PlantTolerances.drawn(contactors, rng)
    strength = friction_strengths(width, contactors, np.random.default_rng(seed)) if width else None
    one = calibrate(tolerances, converter, seed + 1, strength, modeled=modeled)
    population = Population.assumed()
    common = rng.multivariate_normal(population.mean, population.covariance, fingers)
    n = fingers * contactors
    logarithms = np.repeat(common, contactors, axis=0)
    logarithms = logarithms + VARIED_SCALE * rng.standard_normal((n, 1))
    logarithms = logarithms + VARIED_SHAPE * rng.standard_normal((n, 4))
    t = tolerances
    tolerances = PlantTolerances(
        *(np.tile(values, fingers) for values in (t.stiffness, t.coupling, t.mass, t.cable))
    )
    strength = None if strength is None else np.tile(strength, (1, fingers))
    return Case(fingers, one, repeated(one, fingers), tolerances, logarithms, strength)


def repeated(one: Baseline, fingers: int) -> Baseline:
    """Return the baseline of the contactors of one finger, repeated for several."""
    d, h = one.deviations, one.hysteresis
    h = PlayModel(np.tile(h.radii, (fingers, 1)), np.tile(h.weights, (fingers, 1)))
    tiled = [np.tile(values, fingers) for values in (d.stiffness, d.coupling, d.loss)]
    return Baseline(
        one.bender, Deviations(*tiled), np.tile(one.skew, fingers),
        np.tile(one.capacitance, (fingers, 1)), np.tile(one.resonance, fingers),
        np.tile(one.residual, fingers), one.faults * fingers, h,
    )  # fmt: skip


def swinging(period: float) -> Callable[[Floats], Floats]:
    """Return a normal force [N] over time [s] that swings between 0.2 and 2 N."""
    return lambda time: 0.2 * 10 ** ((1 - np.cos(2 * np.pi * time / period)) / 2)


def steady(time: Floats) -> Floats:
    """Return a normal force of 1 N at each time."""
    return np.ones_like(time)


def stroke_shear(texture: str, seconds: float, contactors: int) -> Floats:
    """Return the commanded shear (S, contactors) of a stroke at 80 mm/s [m]."""
    display = tactile.load_display("reference-24")
    stroke = tactile.Trajectory.line(speed=0.08, duration=seconds + 0.5)
    shear = tactile.render(display, tactile.load_texture(texture), stroke).shear
    return np.asarray(shear[round(0.5 * RATE) :, np.arange(contactors) % 24])


def lag_sums(current: Floats, steps: Floats) -> Floats:
    """Compute what an amplifier sends of a window, by the definition and in double precision.

    Of the current (N, S) [A] and the steps (N, LAGS − 1 + S) of the drive [V], which begin LAGS − 1
    samples before the window, it returns Σ_n i[n] d[n − l] for l = 0 … LAGS − 1 (N, LAGS) [A V].
    """
    delayed = sliding_window_view(steps, current.shape[1], axis=1)[:, ::-1]
    return np.asarray(np.einsum("nls,ns->nl", delayed, current))


@dataclass(frozen=True)
class Moment:
    """Filters that play at a moment.

    Attributes
    ----------
    time : float
        Time since the first touch [s].
    error : (N, F) array of float
        Level of the played shear re the commanded one at `FREQUENCY` [dB].
    estimate : Estimate or None
        Latest estimate; None before the first.
    """

    time: float
    error: Floats
    estimate: Estimate | None


def level(taps: Floats, response: Complex) -> Floats:
    """Compute the level [dB] at which filters (N, T) and a plant (N, F) play what is commanded."""
    turns = np.exp(-2j * np.pi / RATE * np.outer(np.arange(taps.shape[1]) - DELAY, FREQUENCY))
    return np.asarray(DECIBEL * np.log(np.abs(taps @ turns * response)))


class Loop:
    """A texture under several fingers, with an equalizer that follows the load of each contactor.

    Each finger has an estimator of its own, as on a display. There is no limiter; `beyond` says how
    much of the drive a display of ±100 V could not play.

    Parameters
    ----------
    case : Case
        Contactors and fingers.
    converter : Converter
        Converter of the current.
    texture : str
        Name of the texture.
    force : function
        Normal force [N] over time [s].
    seconds : float
        Duration.
    rounded : bool
        Whether the sums are those of 16 bits that the amplifier sends, or in double precision.
    piloted : bool
        Whether the pilot plays beside the texture.
    """

    def __init__(
        self,
        case: Case,
        converter: Converter,
        *,
        texture: str = "wood-oak",
        force: Callable[[Floats], Floats] = steady,
        seconds: float = 2.0,
        rounded: bool = True,
        piloted: bool = True,
    ) -> None:
        self.case, self.force, self._rounded, self._piloted = case, force, rounded, piloted
        self._converter, n = converter, len(case.logarithms)
        self.plant = SensingPlant(
            Fingers(*np.exp(case.logarithms).T), case.tolerances,
            converter=converter, sample_rate=RATE, seed=5, strength=case.strength,
        )  # fmt: skip
        population = Population.assumed()
        model = CurrentModel(case.array, population, RATE)
        noise = converter.step * float(np.hypot(converter.noise, 1 / np.sqrt(12)))
        self._estimators = [
            LoadEstimator(model, population, noise=noise) for _ in range(case.fingers)
        ]
        self.mix = InverseMix(case.baseline, RATE, taps=TAPS, delay=DELAY)
        self._shear = stroke_shear(texture, seconds, n // case.fingers).astype(np.float32)
        self._phases = pilot_phases(n)
        start = self.mix.taps(np.tile(population.mean, (n, 1)))
        self._equalizer, self._taps, self._next = FollowingEqualizer(start), start, start
        self._drive = np.zeros((EARLIER + AFTER + 1 + 2 * WINDOW, n))
        self._voltage = self._drive
        hysteresis = case.baseline.hysteresis
        self._drive_for = HysteresisStream(hysteresis.inverse())
        self._effective = HysteresisStream(hysteresis)
        self._current = np.zeros((2 * WINDOW, n))
        self._correlator = Correlator(n)
        self._beyond: list[float] = []

    @property
    def beyond(self) -> float:
        """Part of all samples of the drive so far that are beyond ±100 V."""
        return float(np.mean(self._beyond))

    def run(self) -> Iterator[Moment]:
        """Play, and yield three moments of each window."""
        estimate = None
        for begin in range(0, len(self._shear) - WINDOW + 1, WINDOW):
            before, self._taps = self._taps, self._next
            self._equalizer.replace(self._taps, WINDOW)
            self._play(begin)
            for share in (0.2, 0.6, 1.0):
                time = (begin + share * WINDOW) / RATE
                scale = np.sqrt(self.force(np.full(len(before), time)))
                response = self.plant.response(FREQUENCY, scale)
                faded = (1 - np.cos(np.pi * share)) / 2
                taps = before + faded * (self._taps - before)
                yield Moment(time, level(taps, response), estimate)
            if begin == 0:
                continue
            window = self._window()
            if begin > WINDOW:  # the drive jumps at the beginning of the first window
                estimate = self._estimate(window)
                self._next = self.mix.taps(self._ahead(AHEAD), estimate.touching)
                self._estimated(estimate)

    def _ahead(self, windows: float) -> Floats:
        """Return the loads that are to be expected a number of windows after the last estimate."""
        return np.concatenate([each.ahead(windows) for each in self._estimators])

    def _estimated(self, estimate: Estimate) -> None:
        """Take note of an estimate."""

    def _estimate(self, window: SumWindow) -> Estimate:
        """Update the estimator of each finger, and return all estimates as one."""
        columns = [
            window.sums, window.played, window.steps, window.resolution, window.valid,
            window.earlier,
        ]  # fmt: skip
        parts = zip(*(np.split(column, self.case.fingers) for column in columns), strict=True)
        estimates = [
            estimator.update(SumWindow(*part))
            for estimator, part in zip(self._estimators, parts, strict=True)
        ]
        return Estimate(
            np.concatenate([each.logarithms for each in estimates]),
            np.concatenate([each.covariance for each in estimates]),
            np.concatenate([each.inconsistency for each in estimates]),
            np.concatenate([each.touching for each in estimates]),
            np.concatenate([each.capacitance for each in estimates]),
        )

    def _play(self, begin: int) -> None:
        """Play the drive of a window."""
        shear = np.tile(self._shear[begin : begin + WINDOW], (1, self.case.fingers))
        drive = self._equalizer(shear, np.zeros(len(shear))).astype(np.float64)
        if self._piloted:
            drive += pilot(begin, len(shear), RATE, self._phases)
        drive = self._drive_for(drive)
        self._beyond.append(float(np.mean(np.abs(drive) > VOLTAGE)))
        drive = np.rint(drive / CODE) * CODE
        drive, current = self._put_out(begin, drive)
        self._drive = np.concatenate([self._drive, drive])[len(drive) :]
        self._voltage = np.concatenate([self._voltage, self._effective(drive)])[len(drive) :]
        self._current = np.concatenate([self._current, current])[len(current) :]

    def _scale(self, first: int, samples: int) -> Floats:
        """Return the scale of the loads (S, N) while samples are put out."""
        time = (first + np.arange(samples) - REACH) / RATE
        scale = np.sqrt(self.force(np.maximum(time, 0)))
        return np.repeat(scale[:, None], len(self._taps), axis=1)

    def _put_out(self, begin: int, drive: Floats) -> tuple[Floats, Floats]:
        """Put out the drive of a window; return what was played of it, and the current."""
        _, current = self.plant.step(drive, self._scale(begin, len(drive)))
        return drive, current

    def _window(self) -> SumWindow:
        """Return the window before the one that was played last."""
        end, late = len(self._drive) - WINDOW, self.plant.delay
        before = EARLIER + AFTER + 1
        span = slice(end - WINDOW - before, end + MARGIN)
        played = during(np.diff(self._drive[span], axis=0).T[:, EARLIER:])
        whole = np.diff(self._voltage[span], axis=0).T
        earlier, steps = whole[:, :EARLIER], whole[:, EARLIER:]
        current = self._current[late : late + WINDOW]
        if self._rounded:
            sums, resolution = self._reported(self._drive[end - WINDOW : end], current)
        else:
            sums = lag_sums(current.T, played)
            resolution = np.zeros(len(sums))
        valid = np.ones(len(sums), np.bool_)
        return SumWindow(sums, played, steps, resolution, valid, earlier)

    def _reported(self, drive: Floats, current: Floats) -> tuple[Floats, Floats]:
        """Return sums and their resolution as the reference amplifier reports them."""
        sums, rounding, _ = reported(self._correlator, self._converter, drive, current)
        return sums[0], 2 * rounding[0]


def references(loop: Loop, time: float) -> dict[str, Floats]:
    """Compute the errors (N, F) of filters that do not follow, at a time [dB].

    They are the equalizer as shipped (the display's own bender and finger), filters for calibrated
    benders under the mean of the population, and the same for the true load.
    """
    case = loop.case
    scale = np.sqrt(loop.force(np.full(len(case.logarithms), time)))
    response = loop.plant.response(FREQUENCY, scale)
    mean = np.tile(Population.assumed().mean, (len(scale), 1))
    true = case.logarithms + np.log(scale)[:, None]
    nominal = tactile.load_display("reference-24").responses(FREQUENCY, RATE)[0, 0]
    return {
        "as shipped": np.asarray(DECIBEL * np.log(np.abs(response / nominal))),
        "population mean": level(loop.mix.taps(mean), response),
        "known finger": level(loop.mix.taps(true), response),
    }
