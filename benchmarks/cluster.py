"""Studies beyond one process: the gain of Dask workers over none, and a million designs.

A real scheduler runs with worker processes on this machine, which needs two free cores. The million
designs are solved by this process alone and stored as they go. Memory must stay constant, and time
(processor time, so that other programs do not matter) must grow in proportion to the study.
"""

import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tactile.bench.figures import Figure, at_least, at_most, not_measured
from tactile.bench.resources import resident_bytes
from tactile.study.block_store import BLOCK_POINTS
from tactile.study.criteria import Conditions
from tactile.study.runs import points, run_study
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import Study

FREQUENCY = np.linspace(10.0, 1000.0, 32)
"""Frequencies of all studies here [Hz]."""
SCENARIOS = 64
"""Number of scenarios of each design."""
BLOCKS = 96
"""Number of blocks of the study that workers share: some five seconds for one process."""
TURNS = 9
"""Number of times that the study is solved in each way."""
TRIM = 2**27
"""Free memory that a worker keeps [bytes]. Dask's nannies set 64 KiB, unless the variable is set
already, and each array of a part is then returned to the system and fetched again."""
DESIGNS = (100_000, 1_000_000)
"""Number of designs, scenarios included, of the small and of the large study."""
MEMORY_GIB = 4.0
"""Largest permitted memory [GiB]."""
GROWTH = 1.15
"""Largest permitted ratio of the time per point in the large study to that in the small one."""


def robust_study(designs: int) -> Study:
    """Return a study of a number of designs: lengths with fingers and tolerances."""
    return Study(
        axes={"length_mm": np.linspace(8.0, 30.0, designs // SCENARIOS)},
        frequency=FREQUENCY,
        criteria=("smallest_displacement",),
        scenarios=draw_scenarios(SCENARIOS),
        conditions=Conditions(band=(10.0, 1000.0)),
    )


@contextmanager
def local_cluster(workers: int) -> Iterator[str]:
    """Run a cluster, and yield the address of its scheduler once its workers have solved a part."""
    from distributed import LocalCluster

    os.environ["MALLOC_TRIM_THRESHOLD_"] = str(TRIM)
    with LocalCluster(  # type: ignore[no-untyped-call]
        processes=True,
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=":0",
        silence_logs=logging.CRITICAL,
    ) as cluster:
        run_study(robust_study(SCENARIOS * workers), scheduler=cluster.scheduler_address)
        yield cluster.scheduler_address


def measure_dask() -> Iterator[Figure]:
    """Time a study without Dask, on one Dask worker and on two, in turns, several times.

    Ratios are medians over the turns, because other programs slow each of the three down. The load
    of the machine while it is measured, this program's one or two processes included, stands beside
    them.
    """
    study = robust_study(BLOCKS * BLOCK_POINTS // FREQUENCY.size)
    run_study(robust_study(SCENARIOS))
    with local_cluster(1) as one, local_cluster(2) as two:
        times, loads = [], []
        for _ in range(TURNS):
            times.append([_duration(study, address) for address in (None, one, two)])
            if hasattr(os, "getloadavg"):  # not on Windows
                loads.append(os.getloadavg()[0])
    taken = np.array(times)
    rate = points(study) / np.median(taken[:, 0])
    yield Figure("study.dask.points_per_second_without", float(rate), "1/s")
    if loads:
        yield Figure("study.dask.load", float(np.mean(loads)), "processes")
    over = {
        "one_worker_over_none": taken[:, 0] / taken[:, 1],
        "two_workers_over_none": taken[:, 0] / taken[:, 2],
        "two_workers_over_one": taken[:, 1] / taken[:, 2],
    }
    for name, ratio in over.items():
        goal = 1.5 if name == "two_workers_over_none" else None
        yield at_least(f"study.dask.{name}", float(np.median(ratio)), "×", goal)
        yield Figure(f"study.dask.{name}.least", float(ratio.min()), "×")
        yield Figure(f"study.dask.{name}.most", float(ratio.max()), "×")


def _duration(study: Study, scheduler: str | None) -> float:
    """Return the time that a study takes in this process, or on a cluster [s]."""
    begun = time.perf_counter()
    run_study(study, scheduler=scheduler)
    return time.perf_counter() - begun


def measure_million() -> Iterator[Figure]:
    """Measure memory and growth of time of a robust sweep over a million designs."""
    if sys.platform == "win32":
        yield not_measured("study.million", "needs getrusage, which Windows lacks")
        return
    from resource import RUSAGE_SELF, getrusage

    rates = {}
    # A first small study loads the libraries, so that their time does not count.
    with TemporaryDirectory() as folder:
        run_study(robust_study(SCENARIOS), store=Path(folder) / "study.zarr")
    for designs in DESIGNS:
        study = robust_study(designs)
        with TemporaryDirectory() as folder:
            begun = time.process_time()
            run_study(study, store=Path(folder) / "study.zarr")
            rates[designs] = points(study) / (time.process_time() - begun)
        yield Figure(f"study.designs_{designs}.points_per_second", rates[designs], "1/s")
    growth = rates[DESIGNS[0]] / rates[DESIGNS[1]]
    yield at_most("study.million.time_per_point_over_that_of_a_tenth", growth, "×", GROWTH)
    peak = resident_bytes(getrusage(RUSAGE_SELF).ru_maxrss) / 2**30
    yield at_most("study.million.peak_memory", peak, "GiB", MEMORY_GIB)
