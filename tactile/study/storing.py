"""Studies as files: NetCDF (``.nc``) for one that is finished, Zarr (``.zarr``) for any.

What is loaded equals what was saved, to the last bit: values, names along an axis, units and all
other attributes. NetCDF knows no complex numbers; there ``x`` becomes ``x_real`` and ``x_imag``,
which loading joins. Zarr (version 3) has them, and is read lazily: only what is asked for comes
into memory (`tactile.study.block_store` writes it as lazily). Either file appears whole or not at
all, as it is written beside its place and then renamed.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.errors import InputError, NotFoundError
from tactile.study.extras import study_extra

if TYPE_CHECKING:
    import xarray

SUFFIXES = (".nc", ".zarr")
PARTS = {"_real": "real", "_imag": "imag"}
"""Ends of the names of a complex variable's parts, and what each is called."""
PART_OF = "complex_variable"
"""Attribute of a part that names the whole."""
MARKS = "progress/stored"
"""Path in a store of the array of marks, one for each block that is there
(`tactile.study.block_store`)."""
AS_STORED: dict[str, Any] = {"decode_times": False, "decode_timedelta": False}
"""No unit of ours is a date."""
NUMBERED = ("scenario", "design")
"""Axes along which there is nothing but a number; all others have values."""


def check_store(path: str | Path) -> Path:
    """Return the path of a store that can be written, before anything is computed for it.

    Raises
    ------
    InputError
        Where its name ends in neither `SUFFIXES`, its folder is not there or cannot be written,
        something else is in its place, or a library is missing.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: must end in {' or '.join(SUFFIXES)}")
    with study_extra(f"{path.suffix} file"):
        if path.suffix == ".nc":
            import h5netcdf  # noqa: F401
        else:
            import zarr  # noqa: F401
    if path.suffix == ".zarr" and path.exists() and not (path / "zarr.json").is_file():
        raise InputError(f"{path}: is there and is no Zarr store; name another, or remove it")
    if path.suffix == ".nc" and path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.new")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a path to write to, and rename it to this one once that is done.

    A folder that was there is renamed before it goes (``.NAME.old``), so that whenever the process
    ends there is one of the two.
    """
    new, old = _beside(path), path.with_name(f".{path.name}.old")
    if new.is_dir():
        shutil.rmtree(new)
    yield new
    if path.is_dir():
        if old.is_dir():
            shutil.rmtree(old)
        path.rename(old)
    new.replace(path)
    if old.is_dir():
        shutil.rmtree(old)


def save(data: "xarray.Dataset", path: str | Path) -> None:
    """Write a data set to NetCDF or Zarr, as the suffix says; what was there goes.

    Raises
    ------
    InputError
        See `check_store`.
    """
    path = check_store(path)
    with study_extra(f"{path.suffix} file"), written_whole(path) as new:
        if path.suffix == ".nc":
            _split(data).to_netcdf(new, engine="h5netcdf")
        else:
            write_zarr(data, new)


def write_zarr(data: "xarray.Dataset", path: Path) -> None:
    """Write a data set to Zarr version 3; names as text of any length, which its standard has."""
    names = {
        name: (v.dims, v.values.astype(np.dtypes.StringDType()), v.attrs)
        for name, v in data.variables.items()
        if v.dtype.kind == "U"
    }
    data.assign(names).to_zarr(path, mode="w-", zarr_format=3, consolidated=False)


def load_study(path: str | Path) -> "xarray.Dataset":
    """Load a study; one in Zarr lazily, and also while it is not finished.

    Returns
    -------
    xarray.Dataset
        Values that an unfinished study lacks are NaN, and its attribute ``unfinished`` says how
        much there is.

    Raises
    ------
    NotFoundError, InputError
        Where the file is not there, or cannot be read.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: must end in {' or '.join(SUFFIXES)}")
    if not path.exists():
        raise NotFoundError(f"{path}: no such file")
    with study_extra(f"{path.suffix} file"):
        import xarray

        with readable(path):
            if path.suffix == ".nc":
                return _plain_names(
                    _joined(xarray.load_dataset(path, engine="h5netcdf", **AS_STORED))
                )
            data = xarray.open_zarr(path, chunks={}, consolidated=False, **AS_STORED)
            if "variables" in data.attrs:  # a group knows no order
                data = data[data.attrs["variables"].split()]
            data.attrs.update(stored_share(path))
            for name in data.dims:
                if name not in data.coords and name not in NUMBERED:
                    raise ValueError(f"the values along {name} are missing")
            return _plain_names(data)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise InputError for what a file that is cut or holds something else makes of reading it."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = " ".join(str(error).split())
        raise InputError(
            f"{path}: cannot be read: {why}; name another file, or remove it"
        ) from error


def stored_share(path: Path) -> dict[str, str]:
    """Return the attribute of a Zarr store that is not finished, or nothing."""
    import zarr

    group = zarr.open_group(path, mode="r")
    if MARKS not in group:
        return {}
    marks: Any = group[MARKS]
    done = np.asarray(marks[...])
    return {} if done.all() else {"unfinished": f"{done.sum()} of {done.size} blocks stored"}


def _plain_names(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return the data set with names as numpy's own strings, as studies make them."""
    return data.assign_coords(
        {
            name: (v.dims, np.array(v.values.tolist(), str), v.attrs)
            for name, v in data.coords.items()
            if v.dtype.kind in "OT"
        }
    )


def _split(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return the data set with complex variables in two parts."""
    found: dict[Any, Any] = {}
    for name, v in data.data_vars.items():
        if v.dtype.kind != "c":
            found[name] = v
            continue
        for end, part in PARTS.items():
            labels = {**v.attrs, PART_OF: str(name)}
            found[f"{name}{end}"] = (v.dims, getattr(v.values, part), labels)
    return data.drop_vars(list(data.data_vars)).assign(found)


def _joined(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return the data set with complex variables whole."""
    found: dict[Any, Any] = {}
    for name, v in data.data_vars.items():
        whole = v.attrs.get(PART_OF)
        if whole is None:
            found[name] = v
            continue
        labels = {key: value for key, value in v.attrs.items() if key != PART_OF}
        values = found[whole][1] if whole in found else np.empty(v.shape, np.complex128)
        setattr(values, PARTS[str(name).removeprefix(whole)], v.values)
        found[whole] = (v.dims, values, labels)
    return data.drop_vars(list(data.data_vars)).assign(found)
