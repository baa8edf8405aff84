"""Studies as files: what is loaded is what was saved, and what cannot be is one line."""

import shutil
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import xarray as xr

from tactile.errors import InputError, NotFoundError
from tactile.study.criteria import Conditions
from tactile.study.scenarios import draw_scenarios
from tactile.study.storing import check_store, load_study, save, write_zarr, written_whole
from tactile.study.sweep import Study, solve_study

SUFFIXES = pytest.mark.parametrize("suffix", [".nc", ".zarr"])


@pytest.fixture(scope="module")
def data() -> xr.Dataset:
    return solve_study(
        Study(
            axes={"length_mm": [12.0, 20.1], "load": ["low", "high", "none"]},
            frequency=[0.0, 100.0, 930.0],
            criteria=("smallest_displacement", "blocked_force"),
            responses=("displacement", "admittance"),
            scenarios=None,
            conditions=Conditions(band=(0, 930)),
        )
    )


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Hold two data sets against each other, types and the last bit included."""
    xr.testing.assert_identical(one, other)
    assert list(one.variables) == list(other.variables) or set(one) == set(other)
    for name, variable in one.variables.items():
        assert variable.dtype == other[name].dtype, name
        assert variable.values.tobytes() == other[name].values.tobytes(), name


@SUFFIXES
def test_what_is_loaded_is_what_was_saved(data: xr.Dataset, suffix: str, tmp_path: Path) -> None:
    data = data.copy(deep=True)
    data["blocked_force_mn_per_v"][0, 0] = np.nan
    data["admittance_us"][0, 0, 0] = complex(-0.0, np.nan)
    path = tmp_path / f"study{suffix}"
    save(data, path)
    found = load_study(path).load()
    assert_same(data, found)
    assert found["displacement_um_per_v"].attrs["units"] == "µm/V"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    save(found, path)
    assert_same(data, load_study(path).load())


@SUFFIXES
def test_scenarios_keep_their_values_and_factors(suffix: str, tmp_path: Path) -> None:
    study = Study(
        axes={"length_mm": [20.0]}, criteria=("blocked_force",), scenarios=draw_scenarios(4)
    )
    data = solve_study(study)
    save(data, tmp_path / f"s{suffix}")
    assert_same(data, load_study(tmp_path / f"s{suffix}").load())


def test_netcdf_has_complex_numbers_in_two_parts_with_units(
    data: xr.Dataset, tmp_path: Path
) -> None:
    """The file is read with another library, as another program would read it."""
    save(data, tmp_path / "s.nc")
    with h5netcdf.File(tmp_path / "s.nc", "r") as file:
        part = file["displacement_um_per_v_imag"]
        assert part.attrs["units"] == "µm/V"
        assert part.dimensions == ("length_mm", "load", "frequency_hz")
        expected = data["displacement_um_per_v"].values.imag
        np.testing.assert_array_equal(part[...], expected)
        assert "displacement_um_per_v" not in file.variables
        assert file.attrs["model"].startswith("Hofmann & Twiefel 2014")


def test_zarr_is_read_lazily(data: xr.Dataset, tmp_path: Path) -> None:
    save(data, tmp_path / "s.zarr")
    assert load_study(tmp_path / "s.zarr")["displacement_um_per_v"].chunks is not None


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "full.zarr").mkdir()
    (tmp_path / "full.zarr" / "thesis.txt").touch()
    (tmp_path / "dir.nc").mkdir()
    for name, words in {
        "s.csv": r"s.csv: must end in \.nc or \.zarr",
        "no/s.nc": "no/s.nc: cannot be written: No such file or directory",
        "no/s.zarr": "no/s.zarr: cannot be written: No such file or directory",
        "full.zarr": "full.zarr: exists and is not a Zarr store",
        "dir.nc": "dir.nc: is a folder",
    }.items():
        with pytest.raises(InputError, match=words) as caught:
            check_store(tmp_path / name)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "full.zarr" / "thesis.txt").exists()


@SUFFIXES
def test_what_a_killed_run_left_does_not_stop_the_next(
    data: xr.Dataset, suffix: str, tmp_path: Path
) -> None:
    path, left = tmp_path / f"s{suffix}", tmp_path / f".s{suffix}.new"
    if suffix == ".zarr":
        (left / "length_mm").mkdir(parents=True)
    else:
        left.write_text("half")
    assert check_store(path) == path
    assert left.exists()
    save(data, path)
    assert_same(data, load_study(path).load())
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_store_that_is_replaced_is_there_before_or_after_whatever_happens(
    data: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fail each step of the replacement in turn, as a kill would end it there."""
    path, old = tmp_path / "s.zarr", tmp_path / ".s.zarr.old"

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    def replace(owner: object, step: str) -> None:
        with monkeypatch.context() as broken, written_whole(path) as new:
            write_zarr(data, new)
            broken.setattr(owner, step, fail)

    for owner, step in ((Path, "rename"), (Path, "replace"), (shutil, "rmtree")):
        save(data, path)
        assert [p.name for p in tmp_path.iterdir()] == [path.name]
        with pytest.raises(KeyboardInterrupt):
            replace(owner, step)
        if not path.exists():
            old.rename(path)
        assert_same(data, load_study(path).load())


def test_a_file_that_cannot_be_read_is_one_line(data: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no such file"):
        load_study(tmp_path / "gone.nc")
    (tmp_path / "text.nc").write_text("not a data set")
    (tmp_path / "empty.zarr").mkdir()
    save(data, tmp_path / "cut.zarr")
    shutil.rmtree(tmp_path / "cut.zarr" / "length_mm")
    for name in ("text.nc", "empty.zarr", "cut.zarr"):
        with pytest.raises(InputError, match="cannot be read") as caught:
            load_study(tmp_path / name)
        assert "\n" not in str(caught.value)
