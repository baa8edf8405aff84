"""Studies beyond one process: the gain of a second Dask worker, and a million designs.

A real scheduler runs with worker processes on this machine, which needs two free cores. The million
designs are solved by this process alone and stored as they go. Memory must stay constant, and time
(processor time, so that other programs do not matter) must grow in proportion to the study.
"""

import logging
import sys
import time
from collections.abc import Iterator
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
"""Number of blocks of the study that workers share: some ten seconds for one worker."""
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


def _cluster_time(study: Study, workers: int) -> float:
    """Return the time that a cluster takes for a study, without its start [s]."""
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
