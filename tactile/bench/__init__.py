"""Every figure that the project promises, measured: accuracy, fidelity, speed and memory.

Each benchmark is a function that returns figures; a figure has a goal, or none where it is there to
compare with. Where another library does the same work it is measured in the same run. BLAS is held
to one thread.
"""

import sys
from collections.abc import Callable, Iterator

from rich.progress import track
from threadpoolctl import threadpool_limits

from tactile.bench.actuator import measure_matrix, measure_plant, measure_response
from tactile.bench.budgets import measure_budgets
from tactile.bench.clock import measure_clock
from tactile.bench.cluster import measure_dask, measure_million
from tactile.bench.crowd import measure_crowd, measure_crowd_long, measure_hour
from tactile.bench.deaths import measure_deaths, measure_deaths_long
from tactile.bench.estop import measure_estop, measure_estop_long, measure_estop_play
from tactile.bench.faults import measure_faults
from tactile.bench.figures import Figure, at_least, at_most
from tactile.bench.fit import measure_fit
from tactile.bench.friction import measure_friction
from tactile.bench.fuzz import measure_fuzz
from tactile.bench.fuzz_daemon import measure_fuzz_daemon
from tactile.bench.latency import measure_latency, measure_latency_long
from tactile.bench.library import measure_library
from tactile.bench.links import measure_links, measure_streams_long
from tactile.bench.optimize import measure_optimize
from tactile.bench.protocol import measure_protocol
from tactile.bench.rendering import measure_bands, measure_grating, measure_place, measure_wood
from tactile.bench.resources import measure_memory, measure_soak, measure_speed
from tactile.bench.spectrum import measure_spectrum
from tactile.bench.study import measure_study
from tactile.bench.tracking import measure_tracking
from tactile.bench.waves import measure_waves

__all__ = ["BENCHMARKS", "LONG", "Figure", "at_least", "at_most", "measure"]

BENCHMARKS: dict[str, Callable[[], Iterator[Figure]]] = {
    "matrix": measure_matrix,
    "response": measure_response,
    "grating": measure_grating,
    "wood": measure_wood,
    "friction": measure_friction,
    "bands": measure_bands,
    "place": measure_place,
    "speed": measure_speed,
    "spectrum": measure_spectrum,
    "plant": measure_plant,
    "study": measure_study,
    "memory": measure_memory,
    "clock": measure_clock,
    "protocol": measure_protocol,
    "faults": measure_faults,
    "budgets": measure_budgets,
    "links": measure_links,
    "fit": measure_fit,
    "tracking": measure_tracking,
    "latency": measure_latency,
    "waves": measure_waves,
    "crowd": measure_crowd,
    "optimize": measure_optimize,
    "deaths": measure_deaths,
    "estop": measure_estop,
}
LONG: dict[str, Callable[[], Iterator[Figure]]] = {
    "soak": measure_soak,
    "fuzz": measure_fuzz,
    "fuzz-daemon": measure_fuzz_daemon,
    "streams": measure_streams_long,
    "latency-long": measure_latency_long,
    "deaths-long": measure_deaths_long,
    "estop-long": measure_estop_long,
    "estop-play": measure_estop_play,
    "hour": measure_hour,
    "crowd-long": measure_crowd_long,
    "library": measure_library,
    "dask": measure_dask,
    "million": measure_million,
}
"""Those that take minutes."""


def measure(names: list[str]) -> list[Figure]:
    """Run benchmarks, with a progress bar on a terminal, and return their figures."""
    figures: list[Figure] = []
    known = BENCHMARKS | LONG
    with threadpool_limits(1):
        for name in track(names, "measuring", transient=True, disable=not sys.stdout.isatty()):
            figures.extend(known[name]())
    return figures
