"""Recording of played drive and shear as one ``.npz``, streamed to disk as it grows.

Each array goes to a file of its own beside the target, and all are packed at the end, so that
memory stays flat and the target appears whole or not at all.
"""

import os
import shutil
import tempfile
import zipfile
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.errors import InputError

COPY = 1 << 20
"""Size of the pieces in which arrays are copied [bytes]."""


class Recorder:
    """Writer of arrays that grow along their first axis.

    Use it as a context manager: leaving it without an exception makes the file, otherwise there is
    none.

    Parameters
    ----------
    path : str or Path
        ``.npz`` file to write.
    **constants : array of float or float
        Arrays that do not grow, by name.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written.
    """

    def __init__(self, path: str | Path, **constants: NDArray[np.float64] | float) -> None:
        self._path = Path(path)
        self._constants = constants
        self._shapes: dict[str, tuple[int, ...]] = {}
        try:
            if self._path.is_dir():
                raise InputError(f"{path}: is a folder; give the name of a file")
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
        for name, array in arrays.items():
            rows, *rest = self._shapes.get(name, (0, *array.shape[1:]))
            self._shapes[name] = (rows + len(array), *rest)
            try:
                with (self._folder / name).open("ab") as file:
                    file.write(np.ascontiguousarray(array, np.float64).data)
            except OSError as error:
                raise self._unwritable(error) from error

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
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
        """Write all arrays to one archive, and move it to the target."""
        whole = self._folder / "whole.npz"
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, constant in self._constants.items():
                with archive.open(f"{name}.npy", "w") as member:
                    np.lib.format.write_array(member, np.asarray(constant, np.float64))
            for name, shape in self._shapes.items():
                header = {"descr": "<f8", "fortran_order": False, "shape": shape}
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array_header_2_0(member, header)
                    with (self._folder / name).open("rb") as rows:
                        shutil.copyfileobj(rows, member, COPY)
        os.replace(whole, self._path)
