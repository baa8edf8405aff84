"""What tests of self-sensing share: the design, random fingers, and contactors in air."""

import numpy as np

from benchmarks.sensing_loop import RATE, design
from benchmarks.sensing_plant import Fingers, PlantTolerances, SensingPlant
from tactile.arrays import Floats
from tactile.sensing.baseline import Baseline, fit_baseline
from tactile.sensing.calibration import calibration_lines
from tactile.sensing.population import Population

CONTACTORS = 4


def fingers(logarithms: Floats) -> Fingers:
    """Return the plant's loads of logarithms (N, 4)."""
    return Fingers(*np.exp(logarithms).T)


def random_loads(count: int, seed: int = 0) -> Floats:
    """Draw the logarithms (count, 4) of loads from the population.

    The symmetric root of the covariance is unique. Singular vectors are not, as three of its values
    are equal, and numpy's own draw by them differs between processors.
    """
    population = Population.assumed()
    values, vectors = np.linalg.eigh(population.covariance)
    root = (vectors * np.sqrt(values)) @ vectors.T
    drawn = np.random.default_rng(seed).standard_normal((count, len(root)))
    return np.asarray(population.mean + drawn @ root)


def tolerant_plant(logarithms: Floats, seed: int = 1) -> SensingPlant:
    """Return a plant of contactors with tolerances, under loads (N, 4)."""
    rng = np.random.default_rng(seed)
    tolerances = PlantTolerances.drawn(len(logarithms), rng)
    return SensingPlant(fingers(logarithms), tolerances, sample_rate=RATE)


def exact_baseline(plant: SensingPlant, skew: float = 0.0) -> Baseline:
    """Fit the baseline to the plant's own admittance in air, without noise."""
    bender = design()
    lines = calibration_lines(bender.resonance)
    air = plant.admittance(lines, np.zeros(len(plant.scale)))
    return fit_baseline(lines, air * np.exp(-2j * np.pi * lines * skew), bender)
