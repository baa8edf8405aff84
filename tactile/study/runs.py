"""Execution of studies: a crew solves a bounded number of blocks at once; each is stored when done.

A study gives the same numbers, to the last bit, whoever solves it. With a store (``.zarr``) it
takes little memory whatever its size, and stored blocks are never solved again: a run that was
ended for whatever reason continues when it is started again. Two runs may even share a store, as
both would write the same.
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
from tactile.study.crews import ClusterCrew, CrewLostError, OwnCrew, PartValues, PoolCrew, part_of
from tactile.study.extras import study_extra
from tactile.study.storing import check_store, load_study, save
from tactile.study.sweep import Block, Study, check_memory, labeled, variables

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
"""Callback that receives the number of finished blocks and the number of all."""
Crew = OwnCrew | PoolCrew | ClusterCrew
"""Any crew that solves blocks."""

WINDOW = 2
"""Number of blocks for each worker that are being solved or wait to be."""
WATCHED_S = 1.0
"""Interval between checks whether a worker is left [s]."""
UNSTORED_POINTS = 2**30
"""Designs × frequencies above which a study must be stored as it goes: ten minutes of one core."""
POOL_POINTS = 2**25
"""Designs × frequencies from which on worker processes pay off: some fifteen seconds of one
core."""


class MemoryStore:
    """Blocks of a study in memory.

    Parameters
    ----------
    study : Study
        Study whose values are stored.

    Raises
    ------
    InputError
        If the study takes too much memory, is too large to be lost, or has too many blocks.
    """

    def __init__(self, study: Study) -> None:
        check_memory(study)
        if points(study) > UNSTORED_POINTS:
            raise InputError(
                f"the study has {study.designs:g} designs, {points(study):g} points in all: too "
                "many to lose; store it as it goes (--out study.zarr), which can be resumed"
            )
        self._blocks = study_blocks(study)
        self._values: PartValues = {}
        for name, (dimensions, _, kind) in variables(study).items():
            last = (np.size(study.frequency),) * (len(dimensions) - len(study.shape))
            self._values[name] = np.empty((*study.shape, *last), kind)
        self._study = study

    def pending(self) -> Iterator[Block]:
        """Yield all blocks, in order.

        Yields
        ------
        Block
            Slices of each axis.
        """
        yield from self._blocks

    def put(self, block: Block, arrays: dict[str, NDArray[Any]]) -> None:
        """Keep the values of a block.

        Parameters
        ----------
        block : Block
            Slices of each axis.
        arrays : dict of str to ndarray
            Values of the block by variable.
        """
        for name, values in arrays.items():
            self._values[name][block] = values

    def data(self) -> "xarray.Dataset":
        """Return the data set of the solved study.

        Returns
        -------
        xarray.Dataset
            Labeled values of all blocks.
        """
        return labeled(self._study, self._values)


def points(study: Study) -> int:
    """Return the number of designs × frequencies of a study.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    int
        Number of points; without frequencies, the number of designs.
    """
    return math.prod(study.shape) * max(1, np.size(study.frequency))


def fitting_workers(study: Study) -> int:
    """Return the number of processes that pay off for a study: one, or one for each core.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    int
        Number of processes.
    """
    return (os.cpu_count() or 1) if points(study) > POOL_POINTS else 1


def run_study(
    study: Study,
    *,
    store: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> "xarray.Dataset":
    """Solve a study with processes or a cluster, and store it.

    Parameters
    ----------
    study : Study
        Study to be solved.
    store : str or Path, optional
        Path of a ``.zarr`` store, which is written as the study goes and resumed if it exists, or
        of a ``.nc`` file, which is written at the end.
    workers : int
        Number of processes on this machine. With several, the calling program's start must be
        guarded by ``if __name__ == "__main__"``.
    scheduler : str, optional
        Address of a Dask cluster that solves instead, such as tcp://host:8786.
    progress : callable, optional
        Called with the number of finished blocks and the number of all.

    Returns
    -------
    xarray.Dataset
        Data set as of `solve_study`; lazy if it was stored as it went.

    Raises
    ------
    InputError
        If a library is missing, the store cannot be written or belongs to another study, the study
        is too large to be held in memory, no cluster answers, or no worker is left. In the last
        case the message gives the number of stored blocks; the same call resumes the study.
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
    store: BlockStore | MemoryStore,
    workers: int,
    scheduler: str | None,
    progress: Progress | None,
) -> None:
    """Solve the pending blocks and put them into the store; see `run_study`."""
    pending, total = list(store.pending()), len(study_blocks(study))
    done = total - len(pending)
    report = progress or (lambda done, total: None)
    report(done, total)
    if not pending:
        return
    crew = _gather(min(workers, len(pending)), scheduler)
    try:
        for block, values in solve_blocks(study, pending, crew):
            store.put(block, values)
            done += 1
            report(done, total)
    except CrewLostError as error:
        outcome = (
            f"{done} of {total} blocks are stored in {store.path}, and the same command goes on"
            if isinstance(store, BlockStore)
            else "nothing is stored; with --out study.zarr it would be, as it goes"
        )
        raise InputError(f"{error}; {outcome}") from error
    finally:
        crew.close()


def _gather(workers: int, scheduler: str | None) -> Crew:
    """Return the crew for a number of workers or a scheduler."""
    if scheduler is not None:
        return ClusterCrew(scheduler)
    return OwnCrew() if workers == 1 else PoolCrew(workers)


def solve_blocks(
    study: Study, pending: Iterable[Block], crew: Crew
) -> Iterator[tuple[Block, PartValues]]:
    """Yield each block with its values as it is solved, with `WINDOW` blocks per worker under way.

    Parameters
    ----------
    study : Study
        Study to be solved.
    pending : iterable of Block
        Blocks to be solved.
    crew : Crew
        Workers.

    Yields
    ------
    block : Block
        Slices of each axis.
    values : dict of str to ndarray
        Values of the block by variable.

    Raises
    ------
    CrewLostError
        If no worker is left.
    """
    waiting = iter(pending)
    in_flight: dict[Future[PartValues], Block] = {}
    retries: list[Block] = []
    while True:
        window = 1 if isinstance(crew, OwnCrew) else WINDOW * crew.size
        while len(in_flight) < window:
            block = retries.pop() if retries else next(waiting, None)
            if block is None:
                break
            in_flight[crew.submit(part_of(study, block))] = block
        if not in_flight:
            return
        finished, _ = wait(in_flight, WATCHED_S, FIRST_COMPLETED)
        if not finished:
            crew.watch()
        for future in finished:
            block = in_flight.pop(future)
            try:
                values = future.result()
            except Exception as error:
                crew.explain(future, error)
                retries.append(block)
            else:
                crew.succeed()
                yield block, values
