"""Zarr store of a study that is being solved: written block by block, and resumable.

The values of a block are written first and its mark last, each file beside its place and then
renamed, and the store itself appears with its axes complete. Whenever the process ends, blocks that
are marked are therefore complete, and all others are solved again. Several processes may write to
one store, because no two blocks share a file and the values of a block are the same whoever solves
it; of two stores made at once, the one that appears first is used. The attribute ``question`` is a
hash of all that the numbers depend on: a store with another hash is refused.
"""

import hashlib
import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError
from tactile.study.storing import MARKS, check_store, readable, write_zarr
from tactile.study.sweep import Block, Study, blocks, frame, provenance, variables

BLOCK_POINTS = 2**18
"""Number of designs × frequencies of a block: half a second of work, 4 MiB of each response."""
LARGEST = 1_000_000
"""Largest number of blocks of a study: six days of one core."""


def block_designs(study: Study) -> int:
    """Return the largest number of designs of a block.

    Parameters
    ----------
    study : Study
        Study to be cut into blocks.

    Returns
    -------
    int
        Number of designs, at least 1.
    """
    return max(1, BLOCK_POINTS // max(1, np.size(study.frequency)))


def study_blocks(study: Study) -> list[Block]:
    """Return the blocks of a study, in order.

    Parameters
    ----------
    study : Study
        Study to be cut into blocks.

    Returns
    -------
    list of Block
        Slices of each axis.

    Raises
    ------
    InputError
        If there are more than `LARGEST` blocks.
    """
    cut = blocks(study.shape, block_designs(study))
    first = next(blocks(study.shape, block_designs(study)))
    count = math.prod(_counts(study, first))
    if count > LARGEST:
        raise InputError(
            f"the study has {study.designs:g} designs, {count} blocks of work, more than "
            f"{LARGEST}; ask for fewer values along its axes or fewer frequencies, or make several "
            "studies of it"
        )
    return list(cut)


def _counts(study: Study, first: Block) -> tuple[int, ...]:
    """Return the number of blocks along each axis."""
    return tuple(-(-size // part.stop) for size, part in zip(study.shape, first, strict=True))


def question(study: Study) -> str:
    """Return a hash of all that the numbers of a study depend on, including tactile's version.

    Parameters
    ----------
    study : Study
        Study to identify.

    Returns
    -------
    str
        SHA-256 hash in hexadecimal digits.
    """
    inputs = {
        "study": _plain(study),
        "dimensions": study.dimensions,
        "block": block_designs(study),
        "source": provenance(study)["source"],
    }
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return a value that JSON can represent: arrays by a hash of their bytes, keys in order."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if hasattr(value, "items"):
        return [[key, _plain(entry)] for key, entry in sorted(value.items())]
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    if value is None or isinstance(value, str | bool):
        return value
    array = np.asarray(value)
    if array.dtype.kind in "iuf":
        array = array.astype(np.float64)
        digest = hashlib.sha256(array.tobytes()).hexdigest()
        return [list(array.shape), digest] if array.size > 1 else array.tolist()
    return array.astype(str).tolist()


class BlockStore:
    """Zarr store of a study, created or opened.

    Parameters
    ----------
    study : Study
        Study whose values are stored.
    path : str or Path
        Path of the store; ends in ``.zarr``.

    Attributes
    ----------
    path : Path
        Path of the store.

    Raises
    ------
    InputError
        If the path holds something else or the store of another study, cannot be read or written,
        or the study has too many blocks.
    """

    def __init__(self, study: Study, path: str | Path) -> None:
        self.path = check_store(path)
        if self.path.suffix != ".zarr":
            raise InputError(f"{self.path}: what is stored as it goes must end in .zarr")
        self._blocks = study_blocks(study)
        if not self.path.exists():
            _make(study, self._blocks, self.path)
        _check_question(study, self.path)
        with readable(self.path):
            self._group = _open(self.path, "r+")
            self._marks = self._group[MARKS]

    def pending(self) -> Iterator[Block]:
        """Yield the blocks that are not stored yet, in order.

        Yields
        ------
        Block
            Slices of each axis.
        """
        marks = self._marks[...].ravel()
        yield from (b for b, is_stored in zip(self._blocks, marks, strict=True) if not is_stored)

    def put(self, block: Block, arrays: dict[str, NDArray[Any]]) -> None:
        """Store the values of a block, then mark it as stored.

        Parameters
        ----------
        block : Block
            Slices of each axis.
        arrays : dict of str to ndarray
            Values of the block by variable.
        """
        for name, values in arrays.items():
            self._group[name][block] = values
        place = tuple(
            b.start // first.stop for b, first in zip(block, self._blocks[0], strict=True)
        )
        self._marks[place] = True


def _open(path: Path, mode: Literal["r", "r+"]) -> Any:
    """Open a Zarr group."""
    import zarr

    return zarr.open_group(path, mode=mode, use_consolidated=False)


def _check_question(study: Study, path: Path) -> None:
    """Raise InputError if a store belongs to another study."""
    with readable(path):
        known = dict(_open(path, "r").attrs)
    source = provenance(study)["source"]
    if known.get("question") == question(study):
        return
    if "question" not in known or "source" not in known:
        raise InputError(f"{path}: is not a stored study; name another file, or remove it")
    if known["source"] != source:
        raise InputError(
            f"{path}: was begun by {known['source']}, this is {source}; finish it with that one, "
            "name another file, or remove it"
        )
    raise InputError(
        f"{path}: holds another study ({known.get('title')}); name another file, or remove it"
    )


def _make(study: Study, parts: list[Block], path: Path) -> None:
    """Create an empty store, unless another run has created one meanwhile."""
    with tempfile.TemporaryDirectory(".new", f".{path.name}.", path.parent) as folder:
        new = Path(folder) / path.name
        _fill(study, parts, new)
        try:
            new.rename(path)
        except OSError:
            if not path.exists():
                raise


def _fill(study: Study, parts: list[Block], path: Path) -> None:
    """Write axes and attributes, variables filled with NaN, and the marks of no block."""
    data = frame(study)
    data.attrs |= {"question": question(study), "variables": " ".join(variables(study))}
    chunks = tuple(part.stop for part in parts[0])
    write_zarr(data, path)
    group = _open(path, "r+")
    for name, (dimensions, labels, kind) in variables(study).items():
        last = (np.size(study.frequency),) * (len(dimensions) - len(chunks))
        group.create_array(
            name, shape=(*study.shape, *last), chunks=(*chunks, *last), dtype=kind,
            fill_value=np.nan, dimension_names=dimensions, attributes=labels,
        )  # fmt: skip
    group.create_array(
        MARKS, shape=_counts(study, parts[0]), chunks=(1,) * len(chunks), dtype=bool,
        fill_value=False, compressors=None,
    )  # fmt: skip
