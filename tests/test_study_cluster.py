"""Studies on a real Dask scheduler with worker processes: the same bits, also if one is killed."""

import gc
import os
import platform
import signal
import socket
import time
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_rig import SMALL, bits, study

from benchmarks import cluster as cluster_benchmark
from tactile.errors import InputError
from tactile.study import block_store, crews
from tactile.study.runs import run_study
from tactile.study.storing import load_study
from tactile.study.sweep import Study

PART_POINTS = block_store.BLOCK_POINTS
"""Number of points of a part, without the small blocks of these tests."""

pytestmark = [
    pytest.mark.ci,
    # Dask warns if a folder takes a second, which is the disk's fault.
    pytest.mark.filterwarnings("ignore:Creating scratch directories:UserWarning"),
]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_store, "BLOCK_POINTS", SMALL)


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use long timeouts for a slow machine, unless a test sets its own."""
    for limit in ("CONNECT_S", "WORKERS_S", "LOST_S"):
        monkeypatch.setattr(crews, limit, 60.0)


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Start a scheduler and two worker processes."""
    from distributed import LocalCluster

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # of a killed worker's sockets
        with LocalCluster(  # type: ignore[no-untyped-call]
            processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0"
        ) as made:
            yield made
        gc.collect()  # no other test is warned of the sockets


def worker_pids(cluster: Any) -> list[int]:
    return [nanny.process.pid for nanny in cluster.workers.values()]


def test_a_cluster_finds_the_same_bits_also_where_a_worker_is_killed(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, path = run_study(study(96)), tmp_path / "s.zarr"
    killed: list[int] = []

    def kill(done: int, total: int) -> None:
        if done >= 3 and not killed:
            killed.append(worker_pids(cluster)[0])
            os.kill(killed[0], signal.SIGKILL)

    found = run_study(study(96), store=path, scheduler=cluster.scheduler_address, progress=kill)
    assert killed
    assert bits(found) == bits(whole)
    assert "unfinished" not in load_study(path).attrs
    _lost_workers(cluster, tmp_path / "t.zarr", monkeypatch)


def test_a_result_counts_also_where_its_worker_leaves_the_moment_after(cluster: Any) -> None:
    crew = crews.ClusterCrew(cluster.scheduler_address)
    gather = crew._client._gather

    async def gather_and_lose(task: Any, *args: Any, **options: Any) -> Any:
        found = await gather(task, *args, **options)
        for key in list(crew._client.futures):
            crew._client._handle_lost_data(key)
        return found

    crew._client._gather = gather_and_lose
    try:
        part = study(96)
        found = crew.submit(part).result(60)
        assert found.keys() == crews.solve_part(part).keys()
    finally:
        crew.close()


def faults_of(part: Study) -> int:
    """Return how many pages a process fetches to solve a part that it has solved before."""
    from resource import RUSAGE_SELF, getrusage

    crews.solve_part(part)
    before = getrusage(RUSAGE_SELF).ru_minflt
    crews.solve_part(part)
    return getrusage(RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the variable is one of glibc")
def test_a_worker_keeps_its_memory_as_the_guide_says_and_as_benchmarks_set_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part of 262 144 points fetches fewer than 2000 pages anew; by Dask's default it is 40 000.

    The guide has the number that the benchmark sets. An array that finds no room in the heap gets
    pages of its own from the system each time, unless it is smaller than a second threshold of
    glibc. One worker in five has such arrays, by chance, of 2400 to 7500 pages; the second
    threshold takes that chance out of this test.
    """
    from distributed import Client

    guide = Path(__file__).parents[1] / "docs" / "guide" / "studies.md"
    assert f"MALLOC_TRIM_THRESHOLD_={cluster_benchmark.TRIM} dask worker" in guide.read_text()
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "")  # restored after the benchmark has set it
    monkeypatch.setenv("MALLOC_MMAP_THRESHOLD_", str(2**25))  # the largest that glibc accepts
    part = cluster_benchmark.robust_study(PART_POINTS // cluster_benchmark.FREQUENCY.size)
    with cluster_benchmark.local_cluster(1) as address, Client(address) as client:  # type: ignore[no-untyped-call]
        assert client.submit(faults_of, part).result(60) < 2000


def _lost_workers(cluster: Any, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take all workers away midway: one line, and what is stored is there."""
    monkeypatch.setattr(crews, "LOST_S", 1.0)

    def leave(done: int, total: int) -> None:
        if done == 4:
            cluster.scale(0)
            end = time.monotonic() + 60
            while cluster.scheduler.workers:
                assert time.monotonic() < end, "not all workers have left after 60 s"
                time.sleep(0.02)

    told = r"has lost all its workers; \d+ of 20 blocks are stored in .*t\.zarr, and the same comm"
    with pytest.raises(InputError, match=told):
        run_study(study(96), store=path, scheduler=cluster.scheduler_address, progress=leave)
    stored = np.isfinite(load_study(path)["blocked_force_mn_per_v"].values).mean()
    assert 0.1 < stored < 1
    monkeypatch.setattr(crews, "WORKERS_S", 0.5)
    with pytest.raises(InputError, match=r"has no workers after 0.5 s; start some: dask worker"):
        run_study(study(96), store=path, scheduler=cluster.scheduler_address)
    assert bits(run_study(study(96), store=path)) == bits(run_study(study(96)))


def test_a_scheduler_that_cannot_be_reached_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        for address, seconds, words in (
            ("tcp://127.0.0.1:9", 0.5, "no scheduler answers within 0.5 s; start it"),
            (f"tcp://127.0.0.1:{deaf.getsockname()[1]}", 0.5, "no scheduler answers within 0.5 s"),
            ("tcp://127.0.0.1", 60.0, "missing port number .*reads as tcp://host:8786"),
            ("http://127.0.0.1:8786", 60.0, "unknown address scheme"),
        ):
            monkeypatch.setattr(crews, "CONNECT_S", seconds)
            with pytest.raises(InputError, match=f"--scheduler {address}: .*{words}") as caught:
                run_study(study(), scheduler=address)
            assert "\n" not in str(caught.value)


def test_a_worker_with_another_tactile_is_one_line(
    cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, real = os.getpid(), version
    monkeypatch.setattr(
        crews, "version", lambda package: real(package) if os.getpid() == here else "0.0.1"
    )
    with pytest.raises(
        InputError, match=r"worker tcp://.* has tactile 0\.0\.1, here it is .*pip install"
    ):
        run_study(study(), scheduler=cluster.scheduler_address)
