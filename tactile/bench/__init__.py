"""Benchmarks of a host and its links: rendering speed, memory, jitter, round trips.

Each benchmark is a function that yields `Figure` objects, some with a goal. The figures of the
whole project are measured by ``python -m benchmarks`` in a checkout.
"""

import sys
from collections.abc import Callable, Iterator, Sequence

from rich.progress import track
from threadpoolctl import threadpool_limits

from tactile.bench.figures import Figure
from tactile.bench.link import measure_link
from tactile.bench.resources import measure_jitter, measure_memory, measure_speed

__all__ = ["BENCHMARKS", "Benchmark", "Figure", "measure", "measure_link"]

Benchmark = Callable[[], Iterator[Figure]]
"""Function that runs a benchmark and yields its figures."""

BENCHMARKS: dict[str, Benchmark] = {
    "speed": measure_speed,
    "memory": measure_memory,
    "jitter": measure_jitter,
}
"""Benchmarks by name."""


def measure(benchmarks: Sequence[Benchmark]) -> list[Figure]:
    """Run benchmarks with one BLAS thread, and with a progress bar on a terminal.

    Parameters
    ----------
    benchmarks : sequence of Benchmark
        Benchmarks, in the order in which to run them.

    Returns
    -------
    list of Figure
        All figures, in the order in which they were measured.
    """
    figures: list[Figure] = []
    with threadpool_limits(1):
        for run in track(benchmarks, "measuring", transient=True, disable=not sys.stdout.isatty()):
            figures.extend(run())
    return figures
