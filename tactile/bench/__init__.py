"""Benchmarks of a host and its links: rendering speed, memory, jitter, round trips.

Each benchmark is a function that yields `Figure` objects, some with a goal. The figures of the
whole project are measured by ``python -m benchmarks`` in a checkout.
"""

from collections.abc import Callable, Iterator, Mapping

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
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


def measure(benchmarks: Mapping[str, Benchmark]) -> Iterator[Figure]:
    """Run benchmarks with one BLAS thread; their progress is shown on a terminal's standard error.

    Parameters
    ----------
    benchmarks : mapping of str to Benchmark
        Benchmarks by name, in the order in which to run them.

    Yields
    ------
    Figure
        Each figure as soon as it is measured.
    """
    console = Console(stderr=True)
    columns = TextColumn("measuring {task.description}"), BarColumn(), MofNCompleteColumn()
    with (
        threadpool_limits(1),
        Progress(
            *columns, TimeElapsedColumn(),
            console=console, transient=True, disable=not console.is_terminal,
            redirect_stdout=False,
        ) as progress,
    ):  # fmt: skip
        task = progress.add_task("", total=len(benchmarks))
        for name, run in benchmarks.items():
            progress.update(task, description=name)
            yield from run()
            progress.advance(task)
