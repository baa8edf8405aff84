"""Studies beyond one process: what a second Dask worker brings, and a million designs.

A real scheduler with worker processes on this machine, which needs two free cores. The million is
solved by this process alone and stored as it goes: what counts is that memory stays where it is,
and that time (of the processor, whatever else runs) grows as the study does.
"""

import logging
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tactile.bench.figures import Figure, at_least, at_most
from tactile.bench.resources import resident_bytes
from tactile.study.block_store import BLOCK_POINTS
from tactile.study.criteria import Conditions
from tactile.study.runs import points, run_study
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import Study

FREQUENCY = np.linspace(10.0, 1000.0, 32)
"""Hz of every study here."""
SCENARIOS = 64
BLOCKS = 96
"""Of the study that workers share: some ten seconds of one."""
DESIGNS = (100_000, 1_000_000)
MEMORY_GIB = 4.0
GROWTH = 1.15
"""Time for one point of the large study over that of the small one."""


def robust_study(designs: int) -> Study:
    """Return a study of so many designs: lengths under fingers and tolerances."""
    return Study(
        axes={"length_mm": np.linspace(8.0, 30.0, designs // SCENARIOS)},
        frequency=FREQUENCY,
        criteria=("smallest_displacement",),
        scenarios=draw_scenarios(SCENARIOS),
        conditions=Conditions(band=(10.0, 1000.0)),
    )


def _cluster_time(study: Study, workers: int) -> float:
    """Return how long a cluster takes for a study [s], its start left out."""
    from distributed import LocalCluster

    with LocalCluster(  # type: ignore[no-untyped-call]
        processes=True,
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        run_study(robust_study(SCENARIOS * workers), scheduler=cluster.scheduler_address)
        begun = time.perf_counter()
        run_study(study, scheduler=cluster.scheduler_address)
        return time.perf_counter() - begun


def measure_dask() -> Iterator[Figure]:
    """Time a study on one Dask worker and on two."""
    study = robust_study(BLOCKS * BLOCK_POINTS // FREQUENCY.size)
    one, two = (_cluster_time(study, workers) for workers in (1, 2))
    yield Figure("study.dask.points_per_second_of_one", points(study) / one, "1/s")
    yield at_least("study.dask.two_workers_over_one", one / two, "×", 1.6)


def measure_million() -> Iterator[Figure]:
    """Solve a robust sweep of a million designs: memory, and time against a tenth of it."""
    if sys.platform == "win32":  # no accounting of a process's memory there
        return
    from resource import RUSAGE_SELF, getrusage

    rates = {}
    with TemporaryDirectory() as folder:  # libraries are loaded
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
