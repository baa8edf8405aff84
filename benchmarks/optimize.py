"""Optimization: the front that is found compared with a grid of all designs, and its time."""

import time
from collections.abc import Iterator

import numpy as np

from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most
from tactile.study.criteria import Conditions
from tactile.study.optimizing import Task, find_designs, scores
from tactile.study.scenarios import draw_scenarios

WISHES = ("attainable", "footprint")
"""Objectives."""
LENGTHS, WIDTHS, HEIGHTS = (8.0, 40.0), (1.0, 6.0), (0.1, 0.5)
"""Bounds of length, width and height of a piezo layer [mm]."""
CONDITIONS = Conditions(band=(10.0, 1000.0))
"""Band of the objectives."""
STEPS = 80
"""Number of grid points along each side."""
SCENARIOS = 64
"""Number of scenarios."""


def measure_optimize() -> Iterator[Figure]:
    """Compare a front over two dimensions with a grid, and time a robust front over three."""
    task = Task(
        bounds={"length_mm": LENGTHS, "width_mm": WIDTHS},
        objectives=WISHES,
        fixed={"load": "low"},
        conditions=CONDITIONS,
    )
    sides = [np.linspace(low, high, STEPS) for low, high in (LENGTHS, WIDTHS)]
    grid, _ = scores(task, np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2))
    front = find_designs(task)
    objectives = np.stack([-front["attainable_um"].values, front["footprint_mm2"].values], axis=-1)
    best, worst = grid.min(axis=0), grid.max(axis=0)
    share = dominated((objectives - best) / (worst - best)) / dominated(
        (grid - best) / (worst - best)
    )
    yield at_least("optimize.hypervolume", 100 * share, "% of the grid's", 99)
    yield at_most("optimize.sampling_error", 100 * front.attrs["sampling_error"], "%", 1)
    begun = time.process_time()
    front = find_designs(
        Task(
            bounds={"length_mm": LENGTHS, "width_mm": WIDTHS, "piezo_height_mm": HEIGHTS},
            objectives=WISHES,
            conditions=CONDITIONS,
            scenarios=draw_scenarios(SCENARIOS),
            unseen=draw_scenarios(4 * SCENARIOS, seed=1),
        )
    )
    taken = time.process_time() - begun
    yield at_most("optimize.robust_front", taken, "s of one core", 60)
    yield Figure("optimize.unseen_loss", 100 * front.attrs["unseen_loss"], "%")
    yield Figure("optimize.evaluations", front.attrs["evaluations"] * SCENARIOS / taken, "1/s")


def dominated(lowered: Floats) -> float:
    """Return the area up to (1.1, 1.1) that points (N, 2) dominate, where less is better."""
    points = lowered[np.lexsort(lowered.T[::-1])]
    floor = np.minimum.accumulate(np.append(1.1, points[:, 1]))
    return float(((1.1 - points[:, 0]) * (floor[:-1] - floor[1:])).sum())
