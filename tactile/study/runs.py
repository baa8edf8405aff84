"""Running a study: its blocks solved by a crew, a bounded number at once, each stored when done.

A study is the same numbers, to the last bit, whoever solves it. With a store (``.zarr``) it takes
little memory whatever its size, and what is stored is never solved again: a run that was ended, by
whatever, goes on where it was when it is run again. Two runs may even share a store, as both would
write the same.
"""

import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError
from tactile.study.block_store import BlockStore, study_blocks
from tactile.study.crews import ClusterCrew, CrewLostError, Found, OwnCrew, PoolCrew, part_of
from tactile.study.extras import study_extra
from tactile.study.storing import check_store, load_study, save
from tactile.study.sweep import Block, Study, check_memory, labeled, variables

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
"""Is told how many blocks there are of how many."""
Crew = OwnCrew | PoolCrew | ClusterCrew

WINDOW = 2
"""Parts for each worker that are being solved or wait to be."""
WATCHED_S = 1.0
"""Between looks at whether somebody is left."""
UNSTORED_POINTS = 2**30
"""Designs × frequencies above which a study must be stored as it goes: ten minutes of one core."""
POOL_POINTS = 2**25
"""From which on it pays to start processes: some fifteen seconds of one core."""


class MemoryStore:
    """The blocks of a study in memory."""

    def __init__(self, study: Study) -> None:
        check_memory(study)
        if points(study) > UNSTORED_POINTS:
            raise InputError(
                f"the study has {study.designs:g} designs, {points(study):g} points in all: too "
                "many to lose; store it as it goes (--out study.zarr), which can be resumed"
            )
        self._blocks = study_blocks(study)
        self._values: Found = {}
        for name, (dimensions, _, kind) in variables(study).items():
            last = (np.size(study.frequency),) * (len(dimensions) - len(study.shape))
            self._values[name] = np.empty((*study.shape, *last), kind)
        self._study = study

    def pending(self) -> Iterator[Block]:
        """Yield all blocks."""
        yield from self._blocks

    def put(self, block: Block, found: dict[str, NDArray[Any]]) -> None:
        """Keep the values of a block."""
        for name, values in found.items():
            self._values[name][block] = values

    def data(self) -> "xarray.Dataset":
        """Return the data set."""
        return labeled(self._study, self._values)


def points(study: Study) -> int:
    """Return the number of designs × frequencies."""
    return math.prod(study.shape) * max(1, np.size(study.frequency))


def fitting_workers(study: Study) -> int:
    """Return how many processes pay for a study: one, or one for each core."""
    return (os.cpu_count() or 1) if points(study) > POOL_POINTS else 1


def run_study(
    study: Study,
    *,
    store: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> "xarray.Dataset":
    """Solve a study on processes or a cluster, and store it.

    Parameters
    ----------
    study : the question
    store : ``.zarr``, written as it goes and resumed where it is there; or ``.nc``, written at the
        end; or None
    workers : processes on this machine; with several, a program's own start must be guarded by
        ``if __name__ == "__main__"``
    scheduler : address of a Dask cluster, as tcp://host:8786, which then solves
    progress : called with blocks done and blocks in all

    Returns
    -------
    xarray.Dataset
        As of `solve_study`; lazy where it is stored as it goes.

    Raises
    ------
    InputError
        Where a library is missing, the store cannot be written or is of another study, the study is
        too large to be held in memory, no cluster answers, or no worker is left (how many blocks
        are stored, and that the same call goes on).
    """
    with study_extra("a study"):
        import xarray  # noqa: F401
    if workers < 1:
        raise InputError(f"workers = {workers}: must be at least 1")
    path = None if store is None else check_store(store)
    if path is not None and path.suffix == ".zarr":
        _solve(study, BlockStore(study, path), workers, scheduler, progress)
        return load_study(path)
    memory = MemoryStore(study)
    _solve(study, memory, workers, scheduler, progress)
    data = memory.data()
    if path is not None:
        save(data, path)
    return data


def _solve(
    study: Study,
    kept: BlockStore | MemoryStore,
    workers: int,
    scheduler: str | None,
    progress: Progress | None,
) -> None:
    """Have what is pending solved and kept; see `run_study`."""
    pending, total = list(kept.pending()), len(study_blocks(study))
    done = total - len(pending)
    tell = progress or (lambda done, total: None)
    tell(done, total)
    if not pending:
        return
    crew = _gather(min(workers, len(pending)), scheduler)
    try:
        for block, found in solve_blocks(study, pending, crew):
            kept.put(block, found)
            done += 1
            tell(done, total)
    except CrewLostError as error:
        after = (
            f"{done} of {total} blocks are stored in {kept.path}, and the same command goes on"
            if isinstance(kept, BlockStore)
            else "nothing is stored; with --out study.zarr it would be, as it goes"
        )
        raise InputError(f"{error}; {after}") from error
    finally:
        crew.close()


def _gather(workers: int, scheduler: str | None) -> Crew:
    if scheduler is not None:
        return ClusterCrew(scheduler)
    return OwnCrew() if workers == 1 else PoolCrew(workers)


def solve_blocks(
    study: Study, pending: Iterable[Block], crew: Crew
) -> Iterator[tuple[Block, Found]]:
    """Yield each block with its values as they are solved, `WINDOW` for each worker under way.

    Raises
    ------
    CrewLostError
        Where no worker is left.
    """
    waiting = iter(pending)
    flying: dict[Future[Found], Block] = {}
    again: list[Block] = []
    while True:
        window = 1 if isinstance(crew, OwnCrew) else WINDOW * crew.size
        while len(flying) < window:
            block = again.pop() if again else next(waiting, None)
            if block is None:
                break
            flying[crew.submit(part_of(study, block))] = block
        if not flying:
            return
        finished, _ = wait(flying, WATCHED_S, FIRST_COMPLETED)
        if not finished:
            crew.watch()
        for future in finished:
            block = flying.pop(future)
            try:
                found = future.result()
            except Exception as error:
                crew.explain(future, error)
                again.append(block)
            else:
                crew.succeed()
                yield block, found
