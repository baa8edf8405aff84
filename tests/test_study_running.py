"""Runs: bounded, the same whoever solves, and resumed with nothing lost wherever they end."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from study_rig import SMALL, bits, study

from tactile.actuator.bimorph import Bimorph
from tactile.errors import InputError
from tactile.study import block_store, crews, runs
from tactile.study.block_store import BlockStore, question, study_blocks
from tactile.study.crews import (
    ClusterCrew,
    CrewLostError,
    OwnCrew,
    PartValues,
    PoolCrew,
    part_of,
    solve_part,
)
from tactile.study.criteria import Conditions
from tactile.study.parameters import FINGERS
from tactile.study.runs import run_study, solve_blocks
from tactile.study.scenarios import draw_scenarios
from tactile.study.storing import load_study
from tactile.study.sweep import Block, Study, solve_block, solve_study


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make blocks of five lengths, so that small studies have several."""
    monkeypatch.setattr(block_store, "BLOCK_POINTS", SMALL)


@pytest.fixture
def whole() -> xr.Dataset:
    return run_study(study())


def test_a_run_finds_what_is_solved_at_once(whole: xr.Dataset) -> None:
    at_once = solve_study(study())
    for name, values in at_once.variables.items():
        np.testing.assert_allclose(values, whole[name], rtol=1e-12) if values.dtype.kind in "fc" \
            else np.testing.assert_array_equal(values, whole[name])  # fmt: skip


def test_a_part_is_its_block_with_scenarios_as_well() -> None:
    asked = replace(study(), scenarios=draw_scenarios(4), axes={"length_mm": np.arange(8, 30.0)})
    for block in list(study_blocks(asked))[:3]:
        one, other = solve_part(part_of(asked, block)), solve_block(asked, block)
        assert {n: v.tobytes() for n, v in one.items()} == {
            n: v.tobytes() for n, v in other.items()
        }


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_a_store_holds_the_same_bits(whole: xr.Dataset, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"s{suffix}"
    found = run_study(study(), store=path)
    assert bits(found) == bits(whole) == bits(load_study(path))
    assert "unfinished" not in found.attrs
    assert found["displacement_um_per_v"].attrs == whole["displacement_um_per_v"].attrs


class StoppedError(Exception):
    """Error that ends a run from within."""


def stop_at(block: int) -> runs.Progress:
    def progress(done: int, total: int) -> None:
        if done == block:
            raise StoppedError

    return progress


def test_a_run_goes_on_where_it_ended(
    whole: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s.zarr"
    with pytest.raises(StoppedError):
        run_study(study(), store=path, progress=stop_at(2))
    half = load_study(path)
    assert half.attrs["unfinished"] == "2 of 5 blocks stored"
    assert np.isfinite(half["blocked_force_mn_per_v"].values).mean() == pytest.approx(2 / 5, 0.2)
    solved: list[int] = []
    monkeypatch.setattr(OwnCrew, "submit", counted(OwnCrew.submit, solved))
    assert bits(run_study(study(), store=path)) == bits(whole)
    assert len(solved) == 3
    run_study(study(), store=path)
    assert len(solved) == 3


def counted(submit: object, solved: list[int]) -> object:
    def count(self: OwnCrew, part: Study) -> "Future[PartValues]":
        solved.append(part.designs)
        return submit(self, part)  # type: ignore[operator, no-any-return]

    return count


def test_runs_that_start_together_share_the_store_that_appears_first(
    whole: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Let a second run begin, and store a block, while the first one makes its store."""
    path, fill = tmp_path / "s.zarr", block_store._fill

    def overtaken(*arguments: Any) -> None:
        fill(*arguments)
        monkeypatch.setattr(block_store, "_fill", fill)
        with pytest.raises(StoppedError):
            run_study(study(), store=path, progress=stop_at(1))

    monkeypatch.setattr(block_store, "_fill", overtaken)
    first = BlockStore(study(), path)
    assert len(list(first.pending())) == 4
    assert bits(run_study(study(), store=path)) == bits(whole)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_store_of_another_study_that_appears_meanwhile_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, fill = tmp_path / "s.zarr", block_store._fill

    def overtaken(*arguments: Any) -> None:
        fill(*arguments)
        fill(study(12), study_blocks(study(12)), path)

    monkeypatch.setattr(block_store, "_fill", overtaken)
    with pytest.raises(InputError, match="holds another study"):
        BlockStore(study(), path)


def test_a_block_whose_mark_is_missing_is_solved_again(whole: xr.Dataset, tmp_path: Path) -> None:
    """A run that is killed between the values and the mark leaves such a block."""
    path = tmp_path / "s.zarr"
    run_study(study(), store=path)
    (path / "progress" / "stored" / "c" / "1" / "0").unlink()
    (path / "blocked_force_mn_per_v" / "c" / "1" / "0").write_bytes(b"cut")
    assert len(list(BlockStore(study(), path).pending())) == 1
    assert bits(run_study(study(), store=path)) == bits(whole)


OTHERS: tuple[dict[str, Any], ...] = (
    {"criteria": ("blocked_force",)},
    {"responses": ("force",)},
    {"fixed": {"width_mm": 2.2}},
    {"frequency": np.linspace(0, 1000, 52)},
    {"conditions": Conditions(band=(0, 1000), voltage=70)},
    {"axes": {"load": ["low", "high"], "length_mm": np.linspace(8, 30, 24)}},
    {"axes": {"length_mm": np.linspace(8, 30, 24)}, "scenarios": draw_scenarios(2)},
    {"base": Bimorph(width=2.2e-3)},
    {"fingers": {**FINGERS, "low": FINGERS["high"]}},
)


def test_a_store_of_another_study_is_refused_and_left(tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    run_study(study(), store=path)
    before = bits(load_study(path))
    for other in OTHERS:
        with pytest.raises(InputError, match=r"s\.zarr: holds another study .*name another file"):
            BlockStore(replace(study(), **other), path)
    assert len({question(replace(study(), **other)) for other in OTHERS}) == len(OTHERS)
    assert bits(load_study(path)) == before


@pytest.mark.parametrize("text", ["", '{"zarr_format": 3, "no', "[]", "null", '"text"', "array"])
def test_a_store_that_is_cut_or_holds_an_array_is_one_line_and_left(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.zarr"
    if text == "array":
        zarr.create_array(path, shape=(3,), dtype=float)
    else:
        path.mkdir()
        (path / "zarr.json").write_text(text)
    before = (path / "zarr.json").read_bytes()
    for ask in (lambda: run_study(study(), store=path), lambda: load_study(path)):
        with pytest.raises(InputError, match=r"bad\.zarr: cannot be read: ") as caught:
            ask()  # type: ignore[no-untyped-call]
        assert "\n" not in str(caught.value)
    assert (path / "zarr.json").read_bytes() == before


def test_a_store_without_its_marks_is_one_line(tmp_path: Path) -> None:
    run_study(study(), store=tmp_path / "s.zarr")
    shutil.rmtree(tmp_path / "s.zarr" / "progress")
    with pytest.raises(InputError, match=r"cannot be read: .*progress/stored"):
        run_study(study(), store=tmp_path / "s.zarr")


def test_the_same_question_has_the_same_hash_however_it_is_written() -> None:
    asked = study()
    again = replace(asked, axes={"length_mm": asked.axes["length_mm"], "load": ("low", "high")})
    assert question(asked) == question(again)


def test_a_store_of_another_version_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s.zarr"
    run_study(study(), store=path)
    monkeypatch.setattr("tactile.study.sweep.version", lambda package: "9.9")
    with pytest.raises(InputError, match=r"begun by tactile .*, this is tactile 9\.9"):
        run_study(study(), store=path)


def test_what_is_too_much_to_lose_must_be_stored() -> None:
    many = Study(axes={"length_mm": np.linspace(8, 30, 2**23), "width_mm": np.linspace(1, 3, 99)},
                 criteria=("footprint",))  # fmt: skip
    with pytest.raises(InputError, match=r"more than 2 GiB of memory; store it as it goes"):
        run_study(many)
    long = Study(axes={"length_mm": np.linspace(8, 30, 2**21)}, frequency=np.arange(1000),
                 criteria=("mean_force",), conditions=Conditions(band=(0, 999)))  # fmt: skip
    with pytest.raises(InputError, match=r"too many to lose; store it as it goes"):
        run_study(long)


def test_a_study_of_too_many_blocks_is_refused_before_anything_is_listed_or_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as lower:
        lower.setattr(block_store, "LARGEST", 20)
        assert len(study_blocks(study(100))) == 20
    axis = np.linspace(1, 2, 4096)
    many = Study(axes={"length_mm": axis * 8, "width_mm": axis, "shim_height_mm": axis / 9},
                 criteria=("footprint",))  # fmt: skip
    monkeypatch.setattr(block_store, "BLOCK_POINTS", 4096 * max(1, np.size(many.frequency)))
    told = r"6\.87195e\+10 designs, 16777216 blocks of work, more than 1000000; ask for fewer"
    for ask in (lambda: study_blocks(many), lambda: run_study(many, store=tmp_path / "s.zarr")):
        with pytest.raises(InputError, match=told):
            ask()
    assert not list(tmp_path.iterdir())


class LazyCrew:
    """Crew that solves a part only when asked for, the last first, and counts what is under way."""

    size = 3

    def __init__(self) -> None:
        self.flying: list[tuple[Future[PartValues], Study]] = []
        self.most = 0

    def submit(self, part: Study) -> "Future[PartValues]":
        future: Future[PartValues] = Future()
        self.flying.append((future, part))
        self.most = max(self.most, len(self.flying))
        return future

    def succeed(self) -> None: ...

    def explain(self, future: "Future[PartValues]", error: BaseException) -> None:
        raise error

    def watch(self) -> None:
        future, part = self.flying.pop()
        future.set_result(solve_part(part))

    def close(self) -> None: ...


def test_only_a_few_blocks_are_under_way_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "WATCHED_S", 0.0)
    crew, asked = LazyCrew(), study(100)
    pending = study_blocks(asked)
    taken: list[int] = []

    def tapped() -> Iterator[Block]:
        for block in pending:
            taken.append(1)
            yield block

    found = [block for block, _ in solve_blocks(asked, tapped(), crew)]  # type: ignore[arg-type]
    assert sorted(b[0].start for b in found) == [b[0].start for b in pending]
    assert len(pending) == 20
    assert crew.most == 2 * crew.size, "one is solved, one at hand"


class FrailCrew(PoolCrew):
    """Crew that loses a pool with every second part."""

    asked = 0

    def submit(self, part: Study) -> "Future[PartValues]":
        future: Future[PartValues] = Future()
        self._origin[future] = self._pool
        self.asked += 1
        if self.asked % 2:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(solve_part(part))
        return future


def test_a_pool_is_given_up_only_where_no_part_succeeds_in_between() -> None:
    asked = study(100)
    crew = FrailCrew(1)
    assert len(list(solve_blocks(asked, study_blocks(asked), crew))) == 20
    assert crew.asked == 40
    crew.asked = -99
    for _ in range(3):
        crew._restart()
    with pytest.raises(CrewLostError, match="died in 4 pools one after another"):
        crew._restart()


@pytest.fixture
def cluster_crew(monkeypatch: pytest.MonkeyPatch) -> tuple[ClusterCrew, SimpleNamespace]:
    """Return a crew without a cluster, and what it sees: the time now and its workers' threads."""
    seen = SimpleNamespace(now=1000.0, threads={"one": 1})
    monkeypatch.setattr(crews, "MONOTONIC", SimpleNamespace(now=lambda: seen.now))
    crew = ClusterCrew.__new__(ClusterCrew)
    crew.address, crew._missed = "tcp://here:1", None
    crew._client = SimpleNamespace(status="running", nthreads=lambda: seen.threads)
    crew._count()
    return crew, seen


def test_a_cluster_is_given_up_only_after_it_was_seen_without_workers_for_a_while(
    cluster_crew: tuple[ClusterCrew, SimpleNamespace],
) -> None:
    crew, seen = cluster_crew
    seen.now += 1500.0  # s of steady work, in which nobody looked
    crew.succeed()
    seen.threads = {}
    crew.watch()
    seen.now += 14.0  # of 15 s, in which a nanny starts a new one
    crew.watch()
    crew.succeed()
    seen.now += 14.0
    crew.watch()
    seen.now += 16.0
    with pytest.raises(CrewLostError, match="tcp://here:1 has lost all its workers"):
        crew.watch()


def test_a_cluster_that_grows_gets_more_parts_and_one_without_workers_still_one(
    cluster_crew: tuple[ClusterCrew, SimpleNamespace],
) -> None:
    crew, seen = cluster_crew
    sizes = []
    for threads in ({"one": 1}, {"one": 1, "two": 8}, {}):
        seen.threads, seen.now = threads, seen.now + 5.5  # s: looked at each 5
        sizes.append(crew.size)
    assert sizes == [1, 9, 1]


def test_a_crew_of_one_beside_this_process_has_its_next_part_at_hand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runs, "WATCHED_S", 0.0)
    monkeypatch.setattr(LazyCrew, "size", 1)
    crew, asked = LazyCrew(), study()
    assert len(list(solve_blocks(asked, study_blocks(asked), crew))) == 5  # type: ignore[arg-type]
    assert crew.most == 2


@pytest.mark.ci
def test_a_pool_of_which_a_process_is_killed_finishes_with_the_same_bits(
    whole: xr.Dataset, tmp_path: Path
) -> None:
    killed: list[int] = []

    def kill(done: int, total: int) -> None:
        children = [c for c in active_children() if c.pid is not None]
        if not killed and done >= 1 and children:
            killed.append(children[0].pid or 0)
            os.kill(killed[0], signal.SIGKILL)

    found = run_study(study(), store=tmp_path / "s.zarr", workers=2, progress=kill)
    assert killed
    assert bits(found) == bits(whole)


@pytest.mark.ci
def test_a_pool_that_keeps_dying_is_given_up_and_what_is_stored_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s.zarr"
    with pytest.raises(StoppedError):
        run_study(study(), store=path, progress=stop_at(2))
    monkeypatch.setattr(crews, "RESTARTS", 1)
    monkeypatch.setattr(crews, "solve_part", os._exit)
    monkeypatch.setattr(crews, "part_of", lambda study, block: 1)
    monkeypatch.setattr(runs, "part_of", lambda study, block: 1)
    told = r"workers died in 2 pools one .*; 2 of 5 blocks are stored in .*s\.zarr, and the same"
    with pytest.raises(InputError, match=told) as caught:
        run_study(study(), store=path, workers=2)
    assert isinstance(caught.value.__cause__, CrewLostError)
    assert "\n" not in str(caught.value)


def test_an_error_of_a_part_is_told_as_it_is() -> None:
    crew = PoolCrew.__new__(PoolCrew)
    with pytest.raises(InputError, match="beyond the tip"):
        crew.explain(Future(), InputError("beyond the tip"))


PROGRAM = """
if __name__ == "__main__":
    import sys
    sys.path[:0] = {path!r}
    from study_rig import SMALL, study
    from tactile.study import block_store, runs
    block_store.BLOCK_POINTS = SMALL
    runs.run_study(study(96), store={store!r}, workers={workers},
                      progress=lambda done, total: print(done, flush=True))
"""


@pytest.mark.ci
@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_is_killed_at_any_moment_is_resumed_with_nothing_lost(
    workers: int, tmp_path: Path
) -> None:
    path, script = tmp_path / "s.zarr", tmp_path / "program.py"
    here = [str(Path(__file__).parent), str(Path(runs.__file__).parents[2])]
    script.write_text(PROGRAM.format(path=here, store=str(path), workers=workers), "utf-8")
    rng, stored = np.random.default_rng(workers), 0
    for _ in range(4 - workers):
        run = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
        assert run.stdout is not None
        first = int(run.stdout.readline())
        assert first >= stored, "what was stored is still there"
        stored = first
        for _ in range(int(rng.integers(1, 4))):
            stored = int(run.stdout.readline() or stored)
        time.sleep(float(rng.uniform(0, 0.02)))
        run.kill()
        run.wait()
        run.stdout.close()
    assert stored >= 2
    assert bits(run_study(study(96), store=path)) == bits(run_study(study(96)))


@pytest.mark.ci
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(
        f"import sys, time\nsys.path[:0] = {[str(Path(runs.__file__).parents[2])]!r}\n"
        "import os\nfrom tactile.study.crews import PoolCrew\n"
        "if __name__ == '__main__':\n"
        "    crew = PoolCrew(1)\n"
        "    print(crew._pool.submit(os.getpid).result(), flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        worker = int(run.stdout.readline())
        run.kill()
    end = time.monotonic() + 60
    while time.monotonic() < end and _is_alive(worker):
        time.sleep(0.02)
    assert not _is_alive(worker)


def _is_alive(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    try:
        return state.read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
