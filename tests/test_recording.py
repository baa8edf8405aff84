"""A recording holds exactly what was added, is there whole or not at all, and costs no memory."""

import errno
import math
import os
import subprocess
import sys
import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cli_rig import recorded

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.playback.recording import Recorder

KINDS = pytest.mark.parametrize("kind", [".npz", ".h5"])
TROUBLE = [0.0, -0.0, math.nan, math.inf, -math.inf, 5e-324, -1.7976931348623157e308, 1 / 3]


def assert_same(found: Floats, expected: Floats) -> None:
    """Compare shape and every bit."""
    assert found.dtype == np.float64
    assert found.shape == expected.shape
    assert np.ascontiguousarray(found).tobytes() == np.ascontiguousarray(expected).tobytes()


def only(folder: Path, *names: str) -> bool:
    """Tell whether a folder holds these and nothing else, hidden ones included."""
    return sorted(os.listdir(folder)) == sorted(names)


# Round trip


@KINDS
@pytest.mark.parametrize("cuts", [(), (0,), (1, 2), (7, 7, 300), tuple(range(1, 500))])
def test_arrays_come_back_bit_for_bit_however_they_are_cut(
    tmp_path: Path, kind: str, cuts: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(0)
    whole = {
        "flat": rng.normal(size=500),
        "wide": rng.normal(size=(500, 24)),
        "deep": rng.normal(size=(500, 2, 3)),
        "thin": rng.normal(size=(500, 1)),
        "nothing": np.zeros((500, 0)),
    }
    whole["flat"][: len(TROUBLE)] = TROUBLE
    whole["wide"][-1, : len(TROUBLE)] = TROUBLE
    target = tmp_path / f"all{kind}"
    with Recorder(target) as recorder:
        edges = [0, *cuts, 500]
        for start, end in pairwise(edges):
            recorder.add(**{name: array[start:end] for name, array in whole.items()})
    found = recorded(target)
    assert set(found) == set(whole)
    for name, array in whole.items():
        assert_same(found[name], array)


@KINDS
def test_constants_come_back_and_keep_their_shape(tmp_path: Path, kind: str) -> None:
    target = tmp_path / f"constants{kind}"
    table = np.asfortranarray(np.random.default_rng(0).normal(size=(24, 2)))
    with Recorder(target, sample_rate_hz=8000.0, contactors_mm=table, empty=np.zeros((0, 3))):
        pass
    found = recorded(target)
    assert set(found) == {"sample_rate_hz", "contactors_mm", "empty"}
    assert_same(found["sample_rate_hz"], np.array(8000.0))
    assert_same(found["contactors_mm"], table)
    assert_same(found["empty"], np.zeros((0, 3)))


def test_whatever_its_layout_an_array_is_recorded_row_by_row(tmp_path: Path) -> None:
    base = np.arange(24.0).reshape(6, 4)
    target = tmp_path / "layouts.npz"
    with Recorder(target) as recorder:
        recorder.add(
            turned=np.asfortranarray(base),
            reversed=base[::-1],
            strided=base[::2, 1::2],
            big=base.astype(">f8"),
            single=base.astype(np.float32),
        )
    found = recorded(target)
    assert_same(found["turned"], base)
    assert_same(found["reversed"], base[::-1])
    assert_same(found["strided"], base[::2, 1::2])
    assert_same(found["big"], base)
    assert_same(found["single"], base)


def test_what_was_added_may_be_used_again(tmp_path: Path) -> None:
    target, buffer = tmp_path / "buffer.npz", np.zeros((10, 2))
    with Recorder(target) as recorder:
        for k in range(5):
            buffer[:] = k
            recorder.add(values=buffer)
    assert_same(recorded(target)["values"], np.repeat(np.arange(5.0), 10)[:, None] * np.ones(2))


def test_a_name_without_folder_is_written_where_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Recorder("here.npz") as recorder:
        recorder.add(values=np.ones(3))
    assert only(tmp_path, "here.npz")


@KINDS
def test_the_file_is_as_readable_as_any_other(tmp_path: Path, kind: str) -> None:
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    with Recorder(tmp_path / f"new{kind}") as recorder:
        recorder.add(values=np.ones(3))
    assert (tmp_path / f"new{kind}").stat().st_mode == plain.stat().st_mode


# Whole or not at all


def test_the_target_appears_only_at_the_end_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    target = tmp_path / "end.npz"
    with Recorder(target) as recorder:
        recorder.add(values=np.ones(1000))
        assert not target.exists()
        assert len(list(tmp_path.iterdir())) == 1, "the folder that it grows in"
    assert only(tmp_path, "end.npz")


@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt, SystemExit])
def test_after_an_exception_there_is_neither_target_nor_temporary_folder(
    tmp_path: Path, kind: type[BaseException]
) -> None:
    def fail() -> None:
        with Recorder(tmp_path / "never.npz") as recorder:
            recorder.add(values=np.ones(1000))
            raise kind("no more")

    with pytest.raises(kind, match="no more"):
        fail()
    assert only(tmp_path)


def test_an_existing_target_is_kept_when_a_run_fails(tmp_path: Path) -> None:
    target = tmp_path / "old.npz"
    with Recorder(target) as recorder:
        recorder.add(values=np.arange(3.0))
    before = target.read_bytes()

    def fail() -> None:
        with Recorder(target) as recorder:
            recorder.add(values=np.ones(1000))
            raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        fail()
    assert target.read_bytes() == before
    assert only(tmp_path, "old.npz")


@KINDS
def test_an_existing_target_is_replaced_when_a_run_succeeds(tmp_path: Path, kind: str) -> None:
    target = tmp_path / f"old{kind}"
    target.write_text("something else", encoding="utf-8")
    with Recorder(target) as recorder:
        recorder.add(values=np.ones(3))
        assert target.read_text(encoding="utf-8") == "something else"
    assert_same(recorded(target)["values"], np.ones(3))
    assert only(tmp_path, f"old{kind}")


def test_a_disk_that_is_full_at_the_end_leaves_the_old_target_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "old.npz"
    target.write_text("something else", encoding="utf-8")

    def full(*args: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def fill() -> None:
        with Recorder(target) as recorder:
            recorder.add(values=np.ones(1000))
            monkeypatch.setattr("tactile.playback.recording._copy", full)

    with pytest.raises(InputError, match="No space left"):
        fill()
    assert target.read_text(encoding="utf-8") == "something else"
    assert only(tmp_path, "old.npz")


LIMITED = """
import resource, sys
import numpy as np
from tactile.errors import InputError
from tactile.playback.recording import Recorder

try:
    with Recorder(sys.argv[1]) as recorder:
        for name in "abc":
            recorder.add(**{name: np.ones((100, 1000))})
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, resource.RLIM_INFINITY))
except InputError as error:
    print(error)
"""
"""Program that makes a recording of 2.4 MB where files have no more than 1 MB."""


@KINDS
def test_a_file_that_may_not_become_so_large_is_an_input_error(tmp_path: Path, kind: str) -> None:
    """Regression: the library of HDF5 ended the program with a segmentation fault."""
    target = tmp_path / f"large{kind}"
    result = subprocess.run(
        [sys.executable, "-c", LIMITED, str(target)], capture_output=True, text=True, check=False
    )
    said = f"{target}: cannot be written: File too large\n"
    assert (result.returncode, result.stdout, result.stderr) == (0, said, "")
    assert only(tmp_path)


@KINDS
def test_rows_whose_writing_was_interrupted_are_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    target, append = tmp_path / f"interrupted{kind}", Recorder._append
    with Recorder(target) as recorder:
        recorder.add(first=np.zeros(2), second=np.zeros((2, 3)))

        def interrupted(self: Recorder, name: str, rows: int, array: Floats) -> None:
            append(self, name, rows, array)
            if name == "second":
                raise KeyboardInterrupt

        monkeypatch.setattr(Recorder, "_append", interrupted)
        with pytest.raises(KeyboardInterrupt):
            recorder.add(first=np.full(2000, 7.0), second=np.full((2000, 3), 7.0))
        monkeypatch.undo()
        recorder.add(first=np.ones(1), second=np.ones((1, 3)))
    found = recorded(target)
    assert_same(found["first"], np.array([0.0, 0.0, 1.0]))
    assert_same(found["second"], np.repeat([[0.0], [0.0], [1.0]], 3, axis=1))
    assert target.stat().st_size < 10_000, "12 numbers, and none of the 8000 others"


# Memory


@KINDS
def test_memory_stays_flat_while_much_is_added_and_packed(tmp_path: Path, kind: str) -> None:
    """60 MB pass through less than 4 MB: the packing copies 1 MiB at a time."""
    rows = np.random.default_rng(0).normal(size=(1250, 24))
    target = tmp_path / f"much{kind}"
    with Recorder(target, constant=1.0) as warm:
        warm.add(values=rows)
    tracemalloc.start()
    try:
        with Recorder(target, constant=1.0) as recorder:
            for _ in range(250):
                recorder.add(values=rows)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert target.stat().st_size > 250 * rows.nbytes
    assert peak < 4e6


# Where nothing can be written


def test_a_missing_folder_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing/a\.npz: cannot be written: No such file"):
        Recorder(tmp_path / "missing" / "a.npz")
    assert only(tmp_path)


def test_a_file_in_place_of_a_folder_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.npz: cannot be written: Not a directory"):
        Recorder(tmp_path / "file" / "a.npz")
    assert only(tmp_path, "file")


@pytest.mark.parametrize("name", ["x.wav", "x", "x.npz.gz", "h5", ".h5"])
def test_a_suffix_that_no_recording_has_is_an_input_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"has this suffix; use \.h5, \.hdf5, \.npz$"):
        Recorder(tmp_path / name)
    assert only(tmp_path)


@pytest.mark.parametrize("name", ["x.HDF5", "x.y.H5"])
def test_capital_letters_of_a_suffix_do_not_matter(tmp_path: Path, name: str) -> None:
    with Recorder(tmp_path / name) as recorder:
        recorder.add(values=np.ones(3))
    assert_same(recorded(tmp_path / name)["values"], np.ones(3))


def test_a_folder_as_target_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="folder: is a folder; give the name of a file"):
        Recorder(tmp_path / "folder")
    assert only(tmp_path, "folder")
    assert only(tmp_path / "folder")


def test_a_folder_that_may_not_be_written_is_an_input_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*args: object, **options: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("tactile.playback.recording.tempfile.mkdtemp", refused)
    with pytest.raises(InputError, match=r"a\.npz: cannot be written: Permission denied"):
        Recorder(tmp_path / "a.npz")


def test_a_name_that_no_file_can_have_is_an_input_error_before_anything_is_played(
    tmp_path: Path,
) -> None:
    with pytest.raises(InputError):
        Recorder(tmp_path / f"{'long' * 100}.npz")
    assert only(tmp_path)
