"""Design studies: speed and accuracy of the solver.

The reference is the finite-element model of the project's tests, which shares no code with the
package. Its figures are measured if the package runs from a checkout, and left out otherwise.
"""

import runpy
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import TipResponse, tip_response
from tactile.bench.figures import Figure, at_least, at_most, seconds
from tactile.study.criteria import Conditions
from tactile.study.fit_figures import load_fit_figures
from tactile.study.paper import over_length
from tactile.study.ranges import SHARE, within
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import PIECE_POINTS, Study, solve_block, solve_study

REFERENCE = Path(__file__).parents[1] / "tests" / "reference_beam.py"
"""Path of the finite-element model."""
BAND = (10.0, 1000.0)
"""Band of the studies [Hz]."""
FREQUENCIES = np.linspace(*BAND, 100)
"""Frequencies of the studies [Hz]."""
FINGERS = {
    "air": (None, FingerLoad.none()),
    "low": ((1000.0, 0.11, ((1300.0, 0.33),)), FingerLoad.low()),
    "high": ((4300.0, 0.55, ((5000.0, 2.0),)), FingerLoad.high()),
}
"""The same loads for the finite elements and for the package."""
SCENARIOS = 32
"""Number of scenarios."""
LENGTHS = {"low": (17.7, 27.7), "high": (9.4, 20.1)}
"""Good lengths of the default design by the 85 % criterion, an earlier result of this program [mm].

The paper states 18–27 mm and 10–20 mm.
"""


def random_geometries(count: int) -> dict[str, Any]:
    """Return dimensions (count,) of benders 5–45 mm long and 0.25–1.5 mm thick [m]."""
    ranges = {
        "length": (5e-3, 45e-3),
        "width": (0.5e-3, 5e-3),
        "clamped_length": (0.0, 9e-3),
        "piezo_height": (0.1e-3, 0.5e-3),
        "shim_height": (0.05e-3, 0.5e-3),
    }
    rng = np.random.default_rng(0)
    return {name: rng.uniform(*r, count) for name, r in ranges.items()}


def random_fingers(count: int) -> FingerLoad:
    """Return a different load for each of a number of designs, around the paper's two."""
    k0, d0, k1, d1 = np.random.default_rng(1).uniform(0.5, 2.0, (4, count))
    return FingerLoad(k0=2000 * k0, d0=0.25 * d0, branches=((2500 * k1, 0.8 * d1),))


def measure_study() -> Iterator[Figure]:
    """Measure speed and accuracy of the basis of design studies."""
    yield from _speed()
    yield from _criteria()
    yield from _lengths()
    yield from _load_fit()
    if REFERENCE.is_file():
        reference = runpy.run_path(str(REFERENCE), run_name="reference_beam")
        yield from _ratio(reference)
        yield from _agreement(reference)


def _speed() -> Iterator[Figure]:
    """Time the loaded response of designs that have nothing in common."""
    count = PIECE_POINTS // len(FREQUENCIES)
    designs, fingers = random_geometries(count), random_fingers(count)
    taken = seconds(lambda: tip_response(Bimorph(**designs), fingers, FREQUENCIES), 20)
    points = count * len(FREQUENCIES)
    yield at_least("study.points_per_second", points / taken, "1/s", 500_000)


def _criteria() -> Iterator[Figure]:
    """Time a sweep from its definition to its criteria, with tolerances and fingers."""
    count = 8192
    taken = seconds(lambda: sweep_robustly(count))
    yield at_least(
        "study.criteria.points_per_second", count * len(FREQUENCIES) / taken, "1/s", 500_000
    )


def sweep_robustly(count: int) -> None:
    """Judge a number (a multiple of 512) of lengths × widths × heights × scenarios."""
    lengths = count // (SCENARIOS * 16)
    study = Study(
        axes={
            "length_mm": np.linspace(8, 30, lengths),
            "width_mm": np.linspace(1, 3, 4),
            "piezo_height_mm": np.linspace(0.15, 0.35, 4),
        },
        frequency=FREQUENCIES,
        criteria=("smallest_displacement", "current"),
        scenarios=draw_scenarios(SCENARIOS),
        conditions=Conditions(band=BAND),
    )
    solve_block(study, tuple(slice(0, size) for size in study.shape))


def _lengths() -> Iterator[Figure]:
    """Find the good lengths of the default design under the paper's two fingers."""
    study = over_length(*LENGTHS)
    data = solve_study(replace(study, responses=()))
    for finger, ends in LENGTHS.items():
        values = data.smallest_displacement_um_per_v.sel(load=finger).values
        good = within(data.length_mm.values, values, share=SHARE)
        for name, value, expected in zip(("from", "to"), (good.low, good.high), ends, strict=True):
            met = abs(value - expected) <= 0.1
            goal = f"{expected:g} ± 0.1"
            yield Figure(f"study.good_lengths.{finger}.{name}", value, "mm", goal, met)


def _load_fit() -> Iterator[Figure]:
    """Fit fingers to responses with 1 % noise, and the paper's two to noiseless ones."""
    figures = load_fit_figures(60)
    yield at_most("study.load_fit.worst_prediction", figures["worst_db"], "dB", 0.3)
    yield at_most("study.load_fit.papers_constants", figures["clean_percent"], "%", 1.0)
    yield Figure("study.load_fit.intervals_that_hold_the_truth", figures["covered_percent"], "%")
    yield Figure("study.load_fit.right_number_of_branches", figures["one_branch_percent"], "%")


def _ratio(reference: dict[str, Any]) -> Iterator[Figure]:
    """Time a point of the package and one of the finite elements, in turns."""
    count = PIECE_POINTS // len(FREQUENCIES)
    designs, fingers = random_geometries(count), random_fingers(count)
    beam, load = reference["Beam"](), FINGERS["low"][0]
    tasks: tuple[tuple[int, Callable[[], object]], ...] = (
        (
            count * len(FREQUENCIES),
            lambda: tip_response(Bimorph(**designs), fingers, FREQUENCIES),
        ),
        (len(FREQUENCIES), lambda: reference["response"](beam, FREQUENCIES, load=load)),
    )
    best = [np.inf, np.inf]
    for _ in range(5):
        for i, (points, work) in enumerate(tasks):
            best[i] = min(best[i], seconds(work, 1) / points)
    yield Figure("study.finite_elements.points_per_second", 1 / best[1], "1/s")
    yield at_least("study.speed_over_finite_elements", best[1] / best[0], "×", 400)


def _agreement(reference: dict[str, Any]) -> Iterator[Figure]:
    """Compare whole responses, 1 Hz to 5 kHz, for random designs under tension and compression."""
    frequencies, designs = np.geomspace(1, 5000, 12), random_geometries(12)
    for name, (constants, load) in FINGERS.items():
        worst = 0.0
        for force in (0.0, 5.0, -5.0):
            response = tip_response(Bimorph(**designs), load, frequencies, axial_force=force)
            for i in range(12):
                beam = reference["Beam"](**{key: float(v[i]) for key, v in designs.items()})
                exact = reference["response"](beam, frequencies, load=constants, axial_force=force)
                worst = max(worst, _distance(response, i, exact))
        yield at_most(f"study.error_against_finite_elements.{name}", worst, "relative", 1e-6)


def _distance(found: TipResponse, design: int, exact: Any) -> float:
    """Return the largest relative difference of a design's responses that are not zero."""
    ratios = [
        np.abs(getattr(found, name)[design] - getattr(exact, name)) / np.abs(getattr(exact, name))
        for name in ("displacement", "rotation", "force", "admittance")
        if np.any(getattr(exact, name))
    ]
    return float(np.max(ratios))
