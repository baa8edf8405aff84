"""The store of a study that is being solved: Zarr, block by block, resumable.

A block's values come first and its mark last, each file of it written beside its place and renamed,
and the store itself appears with its axes complete; so whenever the process ends, what is marked is
whole, and what is not is solved again. Several processes may write, as no two blocks share a file
and the values of one are the same whoever solves it; whose store appears first is kept. The
attribute ``question`` is a hash
of all that the numbers depend on: a store of another question is refused.
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
"""Designs × frequencies of a block: half a second of work, 4 MiB of each response."""
LARGEST = 1_000_000
"""Blocks of a study: six days of one core."""


def block_designs(study: Study) -> int:
    """Return how many designs a block has at most."""
    return max(1, BLOCK_POINTS // max(1, np.size(study.frequency)))


def study_blocks(study: Study) -> list[Block]:
    """Return the blocks of a study, in order.

    Raises
    ------
    InputError
        Where there are more than `LARGEST`.
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
    """Return how many blocks there are along each axis."""
    return tuple(-(-size // part.stop) for size, part in zip(study.shape, first, strict=True))


def question(study: Study) -> str:
    """Return a hash of all that the numbers of a study depend on, tactile's version included."""
    told = {
        "study": _plain(study),
        "dimensions": study.dimensions,
        "block": block_designs(study),
        "source": provenance(study)["source"],
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: arrays by their bytes, keys in order."""
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
    """A store on the disk, made or found.

    Parameters
    ----------
    study : whose store it is
    path : ends in ``.zarr``

    Raises
    ------
    InputError
        Where something else is there, or the store of another study, or it cannot be read; and
        where the study has too many blocks.
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
        """Yield the blocks that are not stored, in order."""
        marks = self._marks[...].ravel()
        yield from (b for b, is_stored in zip(self._blocks, marks, strict=True) if not is_stored)

    def put(self, block: Block, found: dict[str, NDArray[Any]]) -> None:
        """Store the values of a block, then mark it."""
        for name, values in found.items():
            self._group[name][block] = values
        place = tuple(
            b.start // first.stop for b, first in zip(block, self._blocks[0], strict=True)
        )
        self._marks[place] = True


def _open(path: Path, mode: Literal["r", "r+"]) -> Any:
    import zarr

    return zarr.open_group(path, mode=mode, use_consolidated=False)


def _check_question(study: Study, path: Path) -> None:
    """Raise InputError where a store is not of this study."""
    with readable(path):
        known = dict(_open(path, "r").attrs)
    source = provenance(study)["source"]
    if known.get("question") == question(study):
        return
    if "question" not in known or "source" not in known:
        raise InputError(f"{path}: holds something else; name another file, or remove it")
    if known["source"] != source:
        raise InputError(
            f"{path}: begun by {known['source']}, this is {source}; finish it with that, "
            "name another file, or remove it"
        )
    raise InputError(
        f"{path}: holds another study ({known.get('title')}); name another file, or remove it"
    )


def _make(study: Study, parts: list[Block], path: Path) -> None:
    """Make an empty store, unless another run has made one meanwhile, which is left."""
    with tempfile.TemporaryDirectory(".new", f".{path.name}.", path.parent) as aside:
        new = Path(aside) / path.name
        _fill(study, parts, new)
        try:
            new.rename(path)
        except OSError:
            if not path.exists():
                raise


def _fill(study: Study, parts: list[Block], path: Path) -> None:
    """Write axes and attributes, variables of NaN, and marks of no block."""
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
