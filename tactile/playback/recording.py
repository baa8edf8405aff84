"""Recording of what is played as one ``.h5``, ``.hdf5`` or ``.npz``, streamed to disk as it grows.

Each array goes to a file of its own beside the target, and all are packed at the end, so that
memory stays flat and the target appears whole or not at all. HDF5 would let a file grow by itself,
but its library crashes the program when the disk is full. It therefore writes the structure of the
file only, after the space of the whole file has been reserved once, and the arrays are copied to
their places in it.
"""

import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import IO

import msgspec
import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.playback.origin import Provenance

COPY = 1 << 20
"""Size of the pieces in which arrays are copied [bytes]."""
STRUCTURE = 1 << 20
"""Space for the structure of an HDF5 file, without its arrays and its text; ten arrays take 8 KiB
[bytes]."""
PROVENANCE = "provenance"
"""Name of the entry that holds the provenance as JSON."""
UNITS = {"v": "V", "m": "m", "mm": "mm", "s": "s", "n": "N", "hz": "Hz"}
"""Units by the last part of the name of an array."""

Column = tuple[tuple[int, ...], Path | bytes]
"""Shape of an array, and the file or the bytes that hold its values."""


def unit_of(name: str) -> str:
    """Return the unit of an array of a recording.

    Parameters
    ----------
    name : str
        Name of the array, such as "drive_v".

    Returns
    -------
    str
        Its unit, such as "V"; empty for a name without a unit.
    """
    return UNITS.get(name.rpartition("_")[2], "")


def checked_suffix(path: str | Path) -> str:
    """Return the suffix of a recording, which decides on its kind.

    Parameters
    ----------
    path : str or Path
        File of the recording.

    Returns
    -------
    str
        Key of `PACKERS`.

    Raises
    ------
    InputError
        If no recording has that suffix, or the path is a folder.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the name of a file")
    except OSError as error:
        raise InputError(f"{path}: cannot be used: {error.strerror}") from error
    suffix = path.suffix.lower()
    if suffix not in PACKERS:
        raise InputError(f"{path}: no recording has this suffix; use {', '.join(PACKERS)}")
    return suffix


class Recorder:
    """Writer of arrays that grow along their first axis.

    Use it as a context manager: leaving it without an exception makes the file, otherwise there is
    none. Rows whose `add` was interrupted are not in the file.

    Parameters
    ----------
    path : str or Path
        File to write, of the kind that its suffix names.
    **constants : array of float or float
        Arrays that do not grow, by name.

    Attributes
    ----------
    provenance : Provenance or None
        Provenance to store.

    Raises
    ------
    InputError
        If no recording has the suffix, or the folder does not exist or cannot be written.
    """

    def __init__(self, path: str | Path, **constants: NDArray[np.float64] | float) -> None:
        self.provenance: Provenance | None = None
        self._path = Path(path)
        self._constants = constants
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._files: dict[str, FileIO] = {}
        self._open_files = ExitStack()
        self._pack_as = PACKERS[checked_suffix(self._path)]
        try:
            self._folder = Path(tempfile.mkdtemp(prefix=".recording-", dir=self._path.parent))
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error

    def add(self, **arrays: Floats) -> None:
        """Append rows to each array.

        Parameters
        ----------
        **arrays : array of float
            Rows to append, by name; every call gives the same names.

        Raises
        ------
        InputError
            If the disk cannot be written.
        """
        shapes = dict[str, tuple[int, ...]]()
        try:
            for name, array in arrays.items():
                rows = self._shapes.get(name, (0,))[0]
                self._append(name, rows, np.ascontiguousarray(array, "<f8"))
                shapes[name] = (rows + len(array), *array.shape[1:])
        except OSError as error:
            raise self._unwritable(error) from error
        self._shapes = self._shapes | shapes  # all at once, since Ctrl-C may come at any time

    def _append(self, name: str, rows: int, array: Floats) -> None:
        """Write an array behind the first rows of its column."""
        if name not in self._files:
            opened = (self._folder / name).open("wb", buffering=0)
            self._files[name] = self._open_files.enter_context(opened)
        file = self._files[name]
        data = array.reshape(-1).view(np.uint8).data
        file.seek(rows * array[:1].nbytes)
        while data:
            data = data[file.write(data) :]

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._open_files.close()
            if kind is None:
                self._pack()
        except OSError as failed:
            raise self._unwritable(failed) from failed
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _unwritable(self, error: OSError) -> InputError:
        """Return the exception for a file that cannot be written."""
        return InputError(f"{self._path}: cannot be written: {error.strerror or error}")

    def _pack(self) -> None:
        """Write all arrays to one file, and move it to the target."""
        columns: dict[str, Column] = {}
        for name, constant in self._constants.items():
            values = np.asarray(constant, np.float64)
            columns[name] = values.shape, values.astype("<f8").tobytes()
        for name, shape in self._shapes.items():
            columns[name] = shape, self._folder / name
        text = "" if self.provenance is None else msgspec.json.encode(self.provenance).decode()
        whole = self._folder / "whole"
        self._pack_as(whole, columns, text)
        os.replace(whole, self._path)


def _pack_npz(whole: Path, columns: dict[str, Column], text: str) -> None:
    """Write arrays and a text as an ``.npz``."""
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, (shape, source) in columns.items():
            header = {"descr": "<f8", "fortran_order": False, "shape": shape}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_2_0(member, header)
                _copy(source, shape, member)
        if text:
            with archive.open(f"{PROVENANCE}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(text), allow_pickle=False)


def _pack_hdf5(whole: Path, columns: dict[str, Column], text: str) -> None:
    """Write arrays and a text as an HDF5 file."""
    size = STRUCTURE + 2 * len(text.encode()) + sum(_bytes(shape) for shape, _ in columns.values())
    with whole.open("wb") as file:  # a full disk is found here, where it does no harm
        if sys.platform == "linux":
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            for start in range(0, size, COPY):
                file.write(bytes(min(COPY, size - start)))
    places = _structure(whole, {name: shape for name, (shape, _) in columns.items()}, text)
    with whole.open("r+b") as file:
        for name, (shape, source) in columns.items():
            if _bytes(shape):
                file.seek(places[name])
                _copy(source, shape, file)


def _structure(whole: Path, shapes: dict[str, tuple[int, ...]], text: str) -> dict[str, int]:
    """Write an HDF5 file whose arrays are still to be filled; return where each begins [bytes]."""
    import h5py
    from h5py import h5d, h5p, h5s, h5t

    layout = h5p.create(h5p.DATASET_CREATE)
    layout.set_layout(h5d.CONTIGUOUS)
    layout.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5d.FILL_TIME_NEVER)
    places = {}
    with h5py.File(whole, "w") as file:
        for name, shape in shapes.items():
            space = h5s.create_simple(shape) if shape else h5s.create(h5s.SCALAR)
            array = h5d.create(file.id, name.encode(), h5t.IEEE_F64LE, space, layout)
            places[name] = array.get_offset()
            file[name].attrs["unit"] = unit_of(name)
        if text:
            file.create_dataset(PROVENANCE, data=text, dtype=h5py.string_dtype())
    return places


def _bytes(shape: tuple[int, ...]) -> int:
    """Return the size of an array of doubles [bytes]."""
    return 8 * int(np.prod(shape))


def _copy(source: Path | bytes, shape: tuple[int, ...], target: IO[bytes]) -> None:
    """Copy an array to a file; rows beyond its shape are left."""
    if isinstance(source, bytes):
        target.write(source)
        return
    with source.open("rb") as rows:
        left = _bytes(shape)
        while piece := rows.read(min(COPY, left)):
            target.write(piece)
            left -= len(piece)


PACKERS: dict[str, Callable[[Path, dict[str, Column], str], None]] = {
    ".h5": _pack_hdf5,
    ".hdf5": _pack_hdf5,
    ".npz": _pack_npz,
}
"""Writers by the suffix of the recording."""
