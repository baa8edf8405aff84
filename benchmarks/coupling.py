"""Coupling of neighbors through the skin, measured on the finite-element plant.

Each of eight random fingers touches twelve contactors of the reference array, 4 × 3 of them.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.coupled_plant import CoupledPlant
from benchmarks.finger import drive_of, estimated, sum_windows_of
from benchmarks.sensing_loop import CODE, RATE, WINDOW, Case, design, draw_case
from benchmarks.sensing_plant import Converter, Fingers
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most, seconds
from tactile.sensing.calibration import LARGEST, MeasuringLimits
from tactile.sensing.coupling_drive import SLOT, CouplingPlan, plan_coupling
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.neighbors import neighbor_pairs, sign_patterns
from tactile.sensing.population import Population, load_stiffness
from tactile.sensing.skin_coupling import MeasuredCoupling, SlotWindow, measure_coupling

FINGERS, SEED = 8, 41
"""Number of random fingers, and their seed; another one served to choose the drive."""
PLACES = np.array([(2.5e-3 * x, 3.5e-3 * y) for y in range(3) for x in range(4)])
"""Positions of the contactors under a finger, of the reference array's pitch [m]."""
PAIRS = neighbor_pairs(PLACES)
"""Neighbors."""
EXPONENT = 4.8
"""Power of the distance by which couplings fall: 0.2 along the short pitch are 0.04 along the long
one and 0.015 across a diagonal (assumed)."""
AT = np.array([100.0, 300.0])
"""Frequencies of the loads that are compared [Hz]."""


def coupling_matrix(coupling: float) -> Floats:
    """Return couplings (N, N) of the contactors under a finger, by that along the short pitch."""
    away = np.linalg.norm(PLACES[:, None] - PLACES, axis=2)
    np.fill_diagonal(away, np.inf)
    return np.asarray(coupling * (away.min() / away) ** EXPONENT)


def plan_of(converter: Converter, fingers: int = 1) -> CouplingPlan:
    """Return the drive of the contactors under some fingers, in codes of the display."""
    limits = MeasuringLimits(current=converter.range, voltage=LARGEST, slew=0.7e6)
    signs = np.tile(sign_patterns(PLACES, PAIRS), (1, fingers))
    plan = plan_coupling(design(), RATE, limits, signs, window=WINDOW)
    return CouplingPlan(np.rint(plan.tones / CODE) * CODE, signs)


def plant_of(case: Case, converter: Converter, coupling: float) -> CoupledPlant:
    """Return the plant of a case."""
    return CoupledPlant(
        Fingers(*np.exp(case.logarithms).T), case.tolerances,
        np.asarray(np.kron(np.eye(case.fingers), coupling_matrix(coupling))),
        converter=converter, sample_rate=RATE, seed=SEED,
    )  # fmt: skip


def couplings_of(
    case: Case, converter: Converter, plant: CoupledPlant, scale: Floats | None = None
) -> MeasuredCoupling:
    """Return the couplings of all fingers of a case; ``scale`` are those of the loads meanwhile."""
    plan, n = plan_of(converter, case.fingers), len(PLACES)
    slots = [
        SlotWindow(k // SLOT, k % SLOT * WINDOW, window)
        for k, window in enumerate(sum_windows_of(plant, plan.drive, scale))
    ]
    pairs = np.concatenate([PAIRS + n * finger for finger in range(case.fingers)])
    population = Population.assumed()
    return measure_coupling(
        CurrentModel(case.baseline, population, RATE), population, slots, plan.signs, pairs,
        noise=converter.step * float(np.hypot(converter.noise, 1 / np.sqrt(12))),
    )  # fmt: skip


def true_coupling(plant: CoupledPlant, measured: MeasuredCoupling) -> Floats:
    """Return the plant's couplings (P,) of the measured pairs at 200 Hz, and at a scale of 1."""
    exact = plant.coupling(np.array([200.0]), np.ones(len(plant.scale)))[0]
    return np.asarray(exact[measured.pairs[:, 0], measured.pairs[:, 1]])


def measure_couplings() -> Iterator[Figure]:
    """Measure the errors of couplings of 0, 0.05 and 0.2, and what they do to the loads."""
    converter = Converter()
    case = draw_case(FINGERS, len(PLACES), converter, SEED)
    yield Figure("coupling: duration", len(plan_of(converter).drive) / RATE, "s")
    for coupling in (0.0, 0.05, 0.2):
        plant = plant_of(case, converter, coupling)
        measured = couplings_of(case, converter, plant)
        yield from _errors(f"coupling {coupling:g}", plant, measured, coupling)
        yield from _loads(f"coupling {coupling:g}", case, converter, plant, measured)
    yield from _drifting(case, converter)
    one = draw_case(2, len(PLACES), converter, SEED)
    plant = plant_of(one, converter, 0.05)
    cost = seconds(lambda: couplings_of(one, converter, plant), 1)
    yield Figure("coupling: plant and estimate of 24 contactors", cost, "s")


def _errors(
    name: str, plant: CoupledPlant, measured: MeasuredCoupling, coupling: float
) -> Iterator[Figure]:
    """Yield errors along the short pitch, and how often two stated deviations hold."""
    true = true_coupling(plant, measured)
    error = measured.value - true
    places = PLACES[measured.pairs % len(PLACES)]
    along = places[:, 0, 1] == places[:, 1, 1]
    known = 100 * len(true) / (FINGERS * len(PAIRS))
    yield at_least(f"{name}: pairs with a known coupling", known, "%", 95)
    yield Figure(f"{name}: error, rms", float(np.sqrt(np.mean(error[along] ** 2))), "")
    if coupling:
        away = 100 * np.abs(error[along] / true[along])
        yield Figure(f"{name}: error, median", float(np.median(away)), "%")
        yield at_most(f"{name}: error, p95", float(np.percentile(away, 95)), "%", 20)
    yield Figure(f"{name}: stated deviation, median", float(np.median(measured.deviation)), "")
    within = 100 * float(np.mean(np.abs(error) < 2 * measured.deviation))
    yield at_least(f"{name}: within two stated deviations", within, "%", 90)


def _loads(
    name: str, case: Case, converter: Converter, plant: CoupledPlant, measured: MeasuredCoupling
) -> Iterator[Figure]:
    """Yield the median ratio of loads to true ones, without and with regard to the coupling."""
    true = np.einsum("fii->if", plant.stiffness(AT, np.ones(len(plant.scale))))
    drive = np.repeat(drive_of(converter)[:, None], len(plant.scale), axis=1)
    alike = estimated(case, converter, sum_windows_of(plant, drive))
    for which, loads in (("alike", alike), ("with signs", measured.loads)):
        explained = 100 * float(loads.explained.mean())
        yield Figure(f"{name}: loads explained, all moved {which}", explained, "%")
        ratio = np.abs(load_stiffness(loads.logarithms, AT) / true)
        for k, f in enumerate(AT):
            away = 100 * float(np.median(ratio[:, k]) - 1)
            yield Figure(f"{name}: bias of k({f:g} Hz), all moved {which}", away, "%")


def _drifting(case: Case, converter: Converter) -> Iterator[Figure]:
    """Yield the errors while the force rises by 20 %, and trembles by 2 % at 9 Hz."""
    plant = plant_of(case, converter, 0.05)
    length = len(plan_of(converter).drive) + plant.delay
    time = np.arange(length) / RATE
    force = np.linspace(0.9, 1.1, length) * (1 + 0.02 * np.sqrt(2) * np.sin(2 * np.pi * 9 * time))
    scale = np.repeat(np.sqrt(force)[:, None], len(plant.scale), axis=1)
    measured = couplings_of(case, converter, plant, scale)
    yield from _errors("coupling 0.05, force that drifts", plant, measured, 0.05)
