"""Studies as files: NetCDF (``.nc``) for a finished study, Zarr (``.zarr``) for any.

A study is loaded exactly as it was saved, to the last bit: values, names along an axis, units and
all other attributes. NetCDF has no complex numbers; a complex variable ``x`` becomes ``x_real`` and
``x_imag`` there, which loading joins. Zarr (version 3) has complex numbers and is read lazily: only
what is used is read into memory (`tactile.study.block_store` writes it block by block as well).
Both kinds of file are written under another name and then renamed, so that they are complete or
missing.
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
"""Suffixes of the files of a study."""
PARTS = {"_real": "real", "_imag": "imag"}
"""Suffixes of the two variables that store a complex one, and the part that each stores."""
PART_OF = "complex_variable"
"""Attribute of a part that holds the name of the complex variable."""
MARKS = "progress/stored"
"""Path in a store of the array of marks, one for each stored block
(`tactile.study.block_store`)."""
AS_STORED: dict[str, Any] = {"decode_times": False, "decode_timedelta": False}
"""Options of xarray that switch off the decoding of dates, since no unit of a study is one."""
NUMBERED = ("scenario", "design")
"""Axes that have only numbered positions; all other axes have values."""


def check_store(path: str | Path) -> Path:
    """Check that a store can be written, before anything is computed for it.

    Parameters
    ----------
    path : str or Path
        Path of the store.

    Returns
    -------
    Path
        Path of the store.

    Raises
    ------
    InputError
        If the name ends in none of `SUFFIXES`, its folder is missing or cannot be written,
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
        raise InputError(f"{path}: exists and is not a Zarr store; name another, or remove it")
    if path.suffix == ".nc" and path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def _beside(path: Path) -> Path:
    """Return the path to which a file is written before it is renamed."""
    return path.with_name(f".{path.name}.new")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a path to write to, and rename it to the final path when the block ends.

    A folder in its place is renamed to ``.NAME.old`` before it is removed, so that one of the two
    is there whenever the process ends.

    Parameters
    ----------
    path : Path
        Final path.

    Yields
    ------
    Path
        Path to write to.
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
    """Write a data set to NetCDF or Zarr, by the suffix of the path, replacing an existing one.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    path : str or Path
        Path that ends in ``.nc`` or ``.zarr``.

    Raises
    ------
    InputError
        If the path cannot be written, or a library is missing; see `check_store`.
    """
    path = check_store(path)
    with study_extra(f"{path.suffix} file"), written_whole(path) as new:
        if path.suffix == ".nc":
            _split(data).to_netcdf(new, engine="h5netcdf")
        else:
            write_zarr(data, new)


def write_zarr(data: "xarray.Dataset", path: Path) -> None:
    """Write a data set to Zarr version 3, with names as strings of variable length.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study.
    path : Path
        Path at which there is nothing yet.
    """
    names = {
        name: (v.dims, v.values.astype(np.dtypes.StringDType()), v.attrs)
        for name, v in data.variables.items()
        if v.dtype.kind == "U"
    }
    data.assign(names).to_zarr(path, mode="w-", zarr_format=3, consolidated=False)


def load_study(path: str | Path) -> "xarray.Dataset":
    """Load a study; a Zarr store is loaded lazily, and may be unfinished.

    Parameters
    ----------
    path : str or Path
        Path that ends in ``.nc`` or ``.zarr``.

    Returns
    -------
    xarray.Dataset
        Data set. Values that an unfinished study lacks are NaN, and its attribute ``unfinished``
        gives the number of stored blocks.

    Raises
    ------
    NotFoundError
        If the file does not exist.
    InputError
        If the file cannot be read, or a library is missing.
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
            if "variables" in data.attrs:  # A Zarr group has no order.
                data = data[data.attrs["variables"].split()]
            data.attrs.update(stored_share(path))
            for name in data.dims:
                if name not in data.coords and name not in NUMBERED:
                    raise ValueError(f"the values along {name} are missing")
            return _plain_names(data)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise InputError for errors of reading a file that is truncated or holds something else.

    Parameters
    ----------
    path : Path
        Path of the file, for the message.

    Yields
    ------
    None
        Nothing; the block reads the file.

    Raises
    ------
    InputError
        If the block raises an error of reading.
    """
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = " ".join(str(error).split())
        raise InputError(
            f"{path}: cannot be read: {why}; name another file, or remove it"
        ) from error


def stored_share(path: Path) -> dict[str, str]:
    """Return an attribute that tells how much of a Zarr store is there.

    Parameters
    ----------
    path : Path
        Path of the store.

    Returns
    -------
    dict of str to str
        Attribute ``unfinished`` of a store that lacks blocks; otherwise empty.
    """
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
    """Return the data set with complex variables split into two parts."""
    variables: dict[Any, Any] = {}
    for name, v in data.data_vars.items():
        if v.dtype.kind != "c":
            variables[name] = v
            continue
        for end, part in PARTS.items():
            labels = {**v.attrs, PART_OF: str(name)}
            variables[f"{name}{end}"] = (v.dims, getattr(v.values, part), labels)
    return data.drop_vars(list(data.data_vars)).assign(variables)


def _joined(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return the data set with complex variables joined from their parts."""
    variables: dict[Any, Any] = {}
    for name, v in data.data_vars.items():
        whole = v.attrs.get(PART_OF)
        if whole is None:
            variables[name] = v
            continue
        labels = {key: value for key, value in v.attrs.items() if key != PART_OF}
        values = variables[whole][1] if whole in variables else np.empty(v.shape, np.complex128)
        setattr(values, PARTS[str(name).removeprefix(whole)], v.values)
        variables[whole] = (v.dims, values, labels)
    return data.drop_vars(list(data.data_vars)).assign(variables)
