"""Draw the pictures of studies in README.md: ``python docs/study_pictures.py``."""

from pathlib import Path

import numpy as np
import xarray

from tactile.study.criteria import Conditions
from tactile.study.optimizing import Task, attained, find_designs, judge
from tactile.study.paper import FINGERS, over_length
from tactile.study.plots import plot_length_map, plot_pareto
from tactile.study.recommending import recommend
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import solve_study

HERE = Path(__file__).parent
SHARE, OTHERS = 0.9, 1500


def draw_front(path: Path) -> None:
    """Draw shear against footprint for nine of ten fingers, among designs drawn at random."""
    task = Task(
        bounds={"length_mm": (8, 40), "width_mm": (1, 6), "piezo_height_mm": (0.12, 0.4)},
        objectives=("attainable", "footprint"),
        conditions=Conditions(band=(10.0, 1000.0)),
        scenarios=draw_scenarios(32),
        share=SHARE,
    )
    front = find_designs(task)
    low, high = np.array(list(task.bounds.values())).T
    others = np.random.default_rng(0).uniform(low, high, (OTHERS, len(low)))
    cloud = xarray.Dataset()
    for name, values in judge(task, others).items():
        sign = 1 if name == "attainable" else -1
        cloud[task.judged_by(name)] = ("design", attained(values, SHARE, sign))
    plot_pareto(path, front, task.variables, cloud=cloud, knee=recommend(front).place)


plot_length_map(HERE / "length-study.png", solve_study(over_length(*FINGERS)))
draw_front(HERE / "pareto.png")
