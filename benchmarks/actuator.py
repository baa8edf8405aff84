"""Actuator: transfer matrix, loaded response and plant, compared with other solvers."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, matrix_balance
from scipy.signal import dlsim

from tactile.actuator.bimorph import Bimorph, active_segment, transfer_matrix
from tactile.actuator.finger import FingerLoad
from tactile.actuator.plant import Plant
from tactile.actuator.population import random_finger
from tactile.actuator.response import tip_response
from tactile.actuator.tolerances import Tolerances
from tactile.actuator.touch import NormalForce, Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.bench.figures import RATE, Figure, at_least, at_most, seconds


def _first_order(bimorph: Bimorph, omega: float, axial_force: float) -> NDArray[np.complex128]:
    """Return the matrix A of the beam's equations x' = A x, with x = (v, ψ̇, M, F, U, I)."""
    s = active_segment(bimorph)
    EI, AG, K = complex(s.section.EI), complex(s.section.AG), complex(s.coupling)
    A = np.zeros((6, 6), np.complex128)
    jw = 1j * omega
    A[0, 1], A[0, 3] = -1, jw / AG
    A[1, 2], A[1, 4] = jw / EI, jw * K / EI
    A[2, 3], A[2, 1] = 1, (axial_force - float(s.section.rhoI) * omega**2) / jw
    A[3, 0] = -float(s.section.m) * omega**2 / jw
    A[5, :] = K * A[1, :]
    A[5, 4] += jw * complex(s.capacitance) / float(s.length)
    return A


def measure_matrix() -> Iterator[Figure]:
    """Compare the transfer matrix with scipy's matrix exponential."""
    worst = 0.0
    for length in (5e-3, 20e-3, 45e-3):
        bimorph = Bimorph(length=length)
        for force in (-5.0, 0.0, 5.0):
            for f in np.geomspace(0.1, 60e3, 25):
                ours = transfer_matrix(active_segment(bimorph), [f], axial_force=force)[0]
                A = _first_order(bimorph, 2 * np.pi * f, force) * length
                _, (scale, _) = matrix_balance(A, permute=False, separate=True)
                theirs = expm(A / scale[:, None] * scale)
                keep = [0, 1, 2, 3, 4], [0, 1, 2, 3, 5]
                theirs = theirs[np.ix_(keep[1], keep[0])]
                mine = ours / scale[keep[1]][:, None] * scale[keep[0]]
                worst = max(worst, float(np.linalg.norm(mine - theirs) / np.linalg.norm(theirs)))
    yield at_most("matrix.error_against_exponential", worst, "relative", 1e-9)
    segment, f = active_segment(Bimorph()), np.geomspace(1, 5000, 2000)
    generators = np.array([_first_order(Bimorph(), 2 * np.pi * x, 0.0) for x in f]) * 20e-3
    yield Figure(
        "matrix.speed_over_scipy_expm",
        seconds(lambda: expm(generators), 2) / seconds(lambda: transfer_matrix(segment, f)),
        "×",
    )


def measure_response() -> Iterator[Figure]:
    """Time the loaded response."""
    f = np.linspace(1, 5000, 20_000)
    taken = seconds(lambda: tip_response(Bimorph(), FingerLoad.low(), f))
    yield at_least("response.points_per_second", len(f) / taken, "1/s", 500_000)
    lengths = Bimorph(length=np.linspace(8e-3, 30e-3, 40))
    taken = seconds(lambda: tip_response(lengths, FingerLoad.low(), f[:500]))
    yield at_least("response.designs_points_per_second", 40 * 500 / taken, "1/s", 500_000)


def _touched_plant() -> Iterator[Figure]:
    """Time the plant under a finger whose force is steady, and swings from 0.2 to 2 N."""
    drive = np.random.default_rng(0).standard_normal((8000, 24))
    for name, force in (("steady", NormalForce()), ("swinging", NormalForce(low=0.2, high=2.0))):
        plant = TouchedPlant(
            Bimorph(),
            Touch(load=random_finger(1, 24), force=force),
            RATE,
            contactors=24,
            tolerances=Tolerances.drawn(24, 1),
        )
        plant.step(np.tile(drive, (2, 1)))  # a swing, so that all maps are there
        rate = 1 / seconds(lambda plant=plant: plant.step(drive))  # type: ignore[misc]
        yield at_least(f"touched_plant.24.{name}.times_real_time", rate, "×", 2)


def measure_plant() -> Iterator[Figure]:
    """Time both plants, and scipy's simulation of the same system."""
    ours = Plant(Bimorph(), FingerLoad.low(), RATE, contactors=24)
    drive = np.random.default_rng(0).standard_normal((8000, 24))
    yield Figure("plant.24.times_real_time", 1 / seconds(lambda: ours.step(drive)), "×")
    s = ours.system
    theirs = (expm(s.A / RATE), s.B[:, None] / RATE, s.C_u[None], np.zeros((1, 1)), 1 / RATE)
    one = drive[:, :1]
    taken = seconds(lambda: dlsim(theirs, one), 2)
    yield Figure("plant.1.times_real_time_of_scipy_dlsim", 1 / taken, "×")
    yield from _touched_plant()
