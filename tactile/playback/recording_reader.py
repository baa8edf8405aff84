"""Reading of recordings: arrays with their units, and where they come from."""

import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.playback.origin import FORMAT, Provenance
from tactile.playback.recording import PROVENANCE, checked_suffix, unit_of

SAMPLED = ("drive_v", "shear_target_m", "time_s", "position_mm")
"""Arrays of every recording that have a row for each sample."""
PATH = ("path_time_s", "path_position_m", "path_normal_force_n")
"""Arrays of the path of the finger, as `Trajectory` takes them."""
DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError,
    SyntaxError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Exceptions of the libraries for a file that is damaged or is no recording."""


class Recording(Mapping[str, Floats]):
    """Recording of a stroke, made by `load_recording`: a mapping of arrays by name.

    Arrays are read from the file when they are used, so that a long recording takes no memory.

    Attributes
    ----------
    path : Path
        File of the recording.
    provenance : Provenance
        What the drive was rendered from, and what became of the stroke.
    units : dict of str to str
        Unit of each array by its name, such as "V" of ``drive_v``.
    """

    def __init__(
        self, path: Path, provenance: Provenance, shapes: Mapping[str, tuple[int, ...]]
    ) -> None:
        self.path = path
        self.provenance = provenance
        self.units = {name: unit_of(name) for name in shapes}
        self._shapes = shapes

    def __getitem__(self, name: str) -> Floats:
        """Read an array."""
        shape = self._shapes[name]
        array = np.empty(shape)
        rows = array if shape else array.reshape(1)
        start = 0
        for block in self.blocks(name):
            rows[start : start + len(block)] = block
            start += len(block)
        return array

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def __len__(self) -> int:
        return len(self._shapes)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without reading it.

        Parameters
        ----------
        name : str
            Name of the array.

        Returns
        -------
        tuple of int
            Its shape; empty for a number.
        """
        return self._shapes[name]

    @property
    def samples(self) -> int:
        """Number of samples that were recorded."""
        return self._shapes[SAMPLED[0]][0]

    @property
    def incomplete(self) -> str:
        """One line on why the stroke was not put out completely; empty if it was."""
        outcome = self.provenance.outcome
        whole = outcome.ending == "complete" and outcome.link == "up" and not outcome.lost_samples
        return "" if whole else outcome.cause or outcome.ending

    def blocks(self, name: str, size: int = 8192) -> Iterator[Floats]:
        """Read an array block by block.

        Parameters
        ----------
        name : str
            Name of the array.
        size : int
            Largest number of rows in a block.

        Yields
        ------
        array of float
            Next rows of the array; a number is a row.

        Raises
        ------
        InputError
            If the file cannot be read.
        """
        with _opened(self.path) as file:
            yield from file.blocks(name, size)


class _NpzFile:
    """An ``.npz`` that is open."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive

    def text(self) -> str:
        """Return the text of the provenance."""
        with self._archive.open(f"{PROVENANCE}.npy") as member:
            return str(np.lib.format.read_array(member, allow_pickle=False))

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the arrays by name."""
        names = [name.removesuffix(".npy") for name in self._archive.namelist()]
        shapes = {}
        for name in sorted(set(names) - {PROVENANCE}):
            with self._archive.open(f"{name}.npy") as member:
                shapes[name] = _npy_shape(name, member)
                size = self._archive.getinfo(f"{name}.npy").file_size - member.tell()
            if size != 8 * math.prod(shapes[name]):
                raise ValueError(f"{name} has {size} bytes, its shape is {shapes[name]}")
        return shapes

    def blocks(self, name: str, size: int) -> Iterator[Floats]:
        """Yield an array by blocks of rows."""
        with self._archive.open(f"{name}.npy") as member:
            rows, *rest = _npy_shape(name, member) or (1,)
            for start in range(0, rows, size):
                count = min(size, rows - start)
                data = member.read(8 * count * math.prod(rest))
                yield np.frombuffer(data, "<f8").astype(np.float64).reshape(count, *rest)


def _npy_shape(name: str, member: IO[bytes]) -> tuple[int, ...]:
    """Read the header of an array of an ``.npz``, and return its shape."""
    version = np.lib.format.read_magic(member)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, by_column, kind = read(member)
    if by_column or kind != np.dtype("<f8"):
        raise ValueError(f"{name} is not an array of doubles, row by row")
    return tuple(shape)


class _Hdf5File:
    """An HDF5 file that is open."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def text(self) -> str:
        """Return the text of the provenance."""
        return str(self._file[PROVENANCE].asstr()[()])

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the arrays by name."""
        return {name: self._array(name).shape for name in self._file if name != PROVENANCE}

    def blocks(self, name: str, size: int) -> Iterator[Floats]:
        """Yield an array by blocks of rows."""
        array = self._array(name)
        if not array.shape:
            yield np.array([array[()]], np.float64)
            return
        for start in range(0, array.shape[0], size):
            yield np.asarray(array[start : start + size], np.float64)

    def _array(self, name: str) -> Any:
        """Return an array of the file itself, which may not refer to another file."""
        import h5py

        link = self._file.get(name, getlink=True)
        array = self._file[name] if isinstance(link, h5py.HardLink) else None
        if not isinstance(array, h5py.Dataset) or array.external or array.is_virtual:
            raise ValueError(f"{name} is not an array of this file")
        if array.dtype != np.dtype("<f8"):
            raise ValueError(f"{name} is not an array of doubles")
        return array


@contextmanager
def _opened(path: Path) -> Iterator[_NpzFile | _Hdf5File]:
    """Open a recording; whatever is wrong with the file is an InputError of one line."""
    try:
        if checked_suffix(path) == ".npz":
            with zipfile.ZipFile(path) as archive:
                yield _NpzFile(archive)
        else:
            import h5py

            with h5py.File(path) as file:
                yield _Hdf5File(file)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: no such file") from error
    except DAMAGE as error:
        what = " ".join(str(error).split())
        raise InputError(f"{path}: is not a recording, or is damaged: {what}") from error


def load_recording(path: str | Path) -> Recording:
    """Open a recording of ``tactile play --record``.

    Parameters
    ----------
    path : str or Path
        File ending in ``.h5``, ``.hdf5`` or ``.npz``.

    Returns
    -------
    Recording
        Its arrays by name, with their units and where they come from.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is damaged or is not a recording, or was written by a newer version in a form
        that this one cannot read.

    Examples
    --------
    The recording of ``tactile play wood-oak --seconds 0.1 --record oak.h5``, made in Python:

    >>> import tactile
    >>> from tactile.playback.runs import run
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> stroke = tactile.Trajectory.line(speed=0.08, duration=0.1)
    >>> summary = run(display, texture, stroke, record="oak.h5")

    Its arrays, their units and their origin:

    >>> recording = tactile.load_recording("oak.h5")
    >>> recording["drive_v"].shape, recording.units["drive_v"]
    ((800, 24), 'V')
    >>> recording.provenance.seed, recording.provenance.device, recording.incomplete
    (0, 'sim:', '')
    """
    path = Path(path)
    with _opened(path) as file:
        provenance = _provenance(path, file.text())
        shapes = file.shapes()
        for name in (*SAMPLED, *PATH):
            if name not in shapes:
                raise ValueError(f"{name} is missing")
        if len({shapes[name][:1] for name in SAMPLED}) > 1 or len(shapes["drive_v"]) != 2:
            raise ValueError(f"{', '.join(SAMPLED)} do not belong together by their shapes")
    return Recording(path, provenance, shapes)


class _Head(msgspec.Struct):
    """First thing that is read of a provenance."""

    format: int


def _provenance(path: Path, text: str) -> Provenance:
    """Return the provenance that a recording holds as text."""
    try:
        form = msgspec.json.decode(text, type=_Head).format
        if form > FORMAT:
            raise InputError(
                f"{path}: is a recording of form {form}; this version of tactile reads form "
                f"{FORMAT}, a newer one reads both"
            )
        return msgspec.json.decode(text, type=Provenance)
    except msgspec.MsgspecError as error:
        raise InputError(f"{path}: {PROVENANCE}: {error}") from error
