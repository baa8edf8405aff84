"""Crews that solve the parts of a study: this process, a pool of processes, or a Dask cluster.

A part is a study by itself (the values of one block), so that a worker needs nothing else. Whoever
solves it does so with one BLAS thread, and finds the same bits. If a worker dies, the crew goes on
with those that remain; if none is left it raises `CrewLostError`.
"""

import asyncio
import logging
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from typing import Any
from weakref import WeakKeyDictionary

from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tactile.clock import MONOTONIC
from tactile.errors import InputError
from tactile.study.extras import study_extra
from tactile.study.scenarios import Scenarios
from tactile.study.sweep import Block, Study, solve_block

PartValues = dict[str, NDArray[Any]]
"""Values of a part by variable."""

PACKAGE = "tactile-display"
"""Name of the distribution whose version all workers must share."""
CONNECT_S = 5.0
"""Time within which a scheduler must answer [s]."""
WORKERS_S = 5.0
"""Time within which a scheduler must have a worker [s]."""
COUNTED_S = 5.0
"""Interval between counts of a cluster's threads [s]."""
LOST_S = 15.0
"""Time after which a cluster without workers is given up; a nanny starts a new one in less [s]."""
RESTARTS = 3
"""Number of new pools that a run may start while no part succeeds."""
RETRIES = 3
"""Number of retries of a part on a cluster."""


class CrewLostError(Exception):
    """No worker is left; the message gives the reason."""


def part_of(study: Study, block: Block) -> Study:
    """Return the study of one block alone.

    Parameters
    ----------
    study : Study
        Study that the block belongs to.
    block : Block
        Slice of each axis.

    Returns
    -------
    Study
        Study with the values of the block.
    """
    along = dict(zip(study.dimensions, block, strict=True))
    axes = {name: values[along[name]] for name, values in study.axes.items()}  # type: ignore[index]
    drawn = study.scenarios
    if drawn is not None:
        part = along["scenario"]
        drawn = Scenarios(
            values={name: array[part] for name, array in drawn.values.items()},
            factors={name: array[part] for name, array in drawn.factors.items()},
        )
    return replace(study, axes=axes, scenarios=drawn)


def solve_part(part: Study) -> PartValues:
    """Solve a whole study on one thread.

    Parameters
    ----------
    part : Study
        Study of one block.

    Returns
    -------
    dict of str to ndarray
        Values by variable.
    """
    with threadpool_limits(1):
        return solve_block(part, tuple(slice(0, size) for size in part.shape))


class OwnCrew:
    """Crew that consists of the calling process."""

    size = 1

    def submit(self, part: Study) -> "Future[PartValues]":
        """Solve a part at once.

        Parameters
        ----------
        part : Study
            Study of one block.

        Returns
        -------
        Future
            Finished future of the values.
        """
        future: Future[PartValues] = Future()
        future.set_result(solve_part(part))
        return future

    def succeed(self) -> None:
        """Note that a part is solved."""

    def explain(self, future: "Future[PartValues]", error: BaseException) -> None:
        """Raise the error of a part.

        Parameters
        ----------
        future : Future
            Future of the part.
        error : BaseException
            Error of the part.
        """
        raise error

    def watch(self) -> None:
        """Raise if no worker is left, which cannot happen here."""

    def close(self) -> None:
        """Do nothing, as there is nothing to end."""


class PoolCrew:
    """Processes of this machine, which are started again if one of them dies.

    Parameters
    ----------
    workers : int
        Number of processes.

    Attributes
    ----------
    size : int
        Number of processes.
    """

    def __init__(self, workers: int) -> None:
        self.size = workers
        self._restarts = 0
        self._origin = WeakKeyDictionary[Future[PartValues], ProcessPoolExecutor]()
        self._pool = self._start()

    def _start(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.size, get_context("spawn"), _begin_worker)

    def submit(self, part: Study) -> "Future[PartValues]":
        """Queue a part for the pool.

        Parameters
        ----------
        part : Study
            Study of one block.

        Returns
        -------
        Future
            Future of the values.

        Raises
        ------
        CrewLostError
            If several pools died one after another.
        """
        with _interrupts_blocked():  # a pool starts its workers when parts are submitted
            try:
                future = self._pool.submit(solve_part, part)
            except BrokenExecutor:
                self._restart()
                future = self._pool.submit(solve_part, part)
        self._origin[future] = self._pool
        return future

    def succeed(self) -> None:
        """Note that a part is solved, so that new pools may be started again."""
        self._restarts = 0

    def explain(self, future: "Future[PartValues]", error: BaseException) -> None:
        """Start a new pool if a worker died; raise any other error.

        Parameters
        ----------
        future : Future
            Future of the part.
        error : BaseException
            Error of the part.

        Raises
        ------
        CrewLostError
            If several pools died one after another.
        """
        if not isinstance(error, BrokenExecutor | CancelledError):
            raise error
        if self._origin[future] is self._pool:
            self._restart()

    def _restart(self) -> None:
        """Start a new pool, unless several pools died while no part succeeded."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._restarts += 1
        if self._restarts > RESTARTS:
            raise CrewLostError(
                f"workers died in {self._restarts} pools one after another (short of memory?)"
            )
        self._pool = self._start()

    def watch(self) -> None:
        """Do nothing, because a pool reports dead workers at once."""

    def close(self) -> None:
        """End the pool after the parts that are being solved; queued parts are dropped."""
        self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C, so that processes that are started meanwhile never see it, even as they load.

    A child inherits the mask of signals of the thread that starts it. An interrupt of this process
    is raised all the same, or comes at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and end the worker whenever the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


class ClusterCrew:
    """Dask cluster, whose scheduler gives the parts of a dead worker to those that remain.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as tcp://host:8786.

    Attributes
    ----------
    address : str
        Address of the scheduler.

    Raises
    ------
    InputError
        If `distributed` is missing, no scheduler answers, it has no workers, or a worker has
        another version of tactile.
    """

    def __init__(self, address: str) -> None:
        with study_extra("a cluster"):
            import distributed
        self.address = address
        self._missed: float | None = None
        self._client: Any = _connect(distributed, address)
        try:
            self._count()
            _check_versions(self._client)
        except BaseException:
            self._client.close()
            raise

    def _count(self) -> int:
        """Return the present number of threads; raise CrewLostError if the scheduler is gone."""
        message = f"the scheduler at {self.address} is gone"
        if self._client.status != "running":
            raise CrewLostError(message)
        try:
            self._threads: int = sum(self._client.nthreads().values())
        except OSError as error:
            raise CrewLostError(message) from error
        self._counted = MONOTONIC.now()
        return self._threads

    @property
    def size(self) -> int:
        """Number of threads, at most `COUNTED_S` old; at least one, which may be yet to come."""
        if MONOTONIC.now() - self._counted > COUNTED_S:
            self._count()
        return max(1, self._threads)

    def submit(self, part: Study) -> "Future[PartValues]":
        """Send a part to the cluster.

        The executor of `distributed` is not used, because it gives a part up, with an error of its
        own, if the worker leaves just after its result has arrived.

        Parameters
        ----------
        part : Study
            Study of one block.

        Returns
        -------
        Future
            Future of the values.
        """
        task = self._client.submit(solve_part, part, pure=False, retries=RETRIES)
        result = self._client.gather(task, asynchronous=True)
        return asyncio.run_coroutine_threadsafe(result, self._client.loop.asyncio_loop)

    def succeed(self) -> None:
        """Note that a part is solved, so that there are workers."""
        self._missed = None

    def explain(self, future: "Future[PartValues]", error: BaseException) -> None:
        """Raise CrewLostError if the cluster failed, and any other error as it is.

        Parameters
        ----------
        future : Future
            Future of the part.
        error : BaseException
            Error of the part.

        Raises
        ------
        CrewLostError
            If the scheduler is gone, a part killed several workers, or a worker has another
            tactile.
        """
        with study_extra("a cluster"):
            from distributed.comm.core import CommClosedError
            from distributed.scheduler import KilledWorker

        if isinstance(error, KilledWorker):
            raise CrewLostError("one part killed several workers (short of memory?)") from error
        if isinstance(error, CancelledError | CommClosedError):
            raise CrewLostError(f"the scheduler at {self.address} is gone") from error
        if isinstance(error, ImportError | AttributeError):
            raise CrewLostError(f"a worker has another version of tactile: {error}") from error
        raise error

    def watch(self) -> None:
        """Check that the scheduler is there and has had a worker recently.

        Raises
        ------
        CrewLostError
            If the scheduler is gone, or has had no worker for `LOST_S`.
        """
        if self._count():
            self._missed = None
        elif self._missed is None:
            self._missed = MONOTONIC.now()
        elif MONOTONIC.now() - self._missed > LOST_S:
            raise CrewLostError(f"the scheduler at {self.address} has lost all its workers")

    def close(self) -> None:
        """Disconnect from the cluster; parts that are being solved are dropped."""
        with _quiet():
            self._client.close()


def _connect(distributed: Any, address: str) -> Any:
    """Return a client of a scheduler that has a worker."""
    where = f"--scheduler {address}"
    try:
        with _quiet(), ThreadPoolExecutor(1) as executor:
            kind = executor.submit(asyncio.run, _kind_of(distributed, address)).result()
            client = (
                distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
                if kind == "Scheduler"
                else None
            )
    except ValueError as error:
        raise InputError(f"{where}: {error}; it reads as tcp://host:8786") from None
    except (OSError, TimeoutError):
        client = None
    if client is None:
        raise InputError(
            f"{where}: no scheduler answers within {CONNECT_S:g} s; start it (dask scheduler), and "
            "give the address that it prints"
        )
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        client.close()
        raise InputError(
            f"{where}: has no workers after {WORKERS_S:g} s; start some: dask worker {address}"
        ) from None
    return client


async def _kind_of(distributed: Any, address: str) -> str:
    """Return the type of the Dask node at an address, sooner than a failing client would."""
    async with distributed.rpc(address) as peer, asyncio.timeout(CONNECT_S):
        return str((await peer.identity())["type"])


def _check_versions(client: Any) -> None:
    """Raise InputError if a worker has no tactile or another version of it."""
    ours = version(PACKAGE)
    for worker, theirs in client.run(version, PACKAGE, on_error="return").items():
        if theirs != ours:
            has = theirs if isinstance(theirs, str) else "none"
            raise InputError(
                f"worker {worker} has tactile {has}, here it is {ours}; install the same on all: "
                f"pip install '{PACKAGE}[study]=={ours}'"
            )


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress log messages about a connection that fails or ends."""
    # Each of their loggers has a level of its own, so that it does not suffice to set the roots'.
    noisy = ("distributed", "tornado", "asyncio")
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in noisy]
    logs = [logging.getLogger(name) for name in names]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
