"""Reading of untrusted files: JSON within limits, which is checked before anything uses it.

Whatever is wrong is reported in one line with the file, field, value and what is allowed. The size
is checked before the file is read; depth, numbers, text and duplicate fields are checked before the
contents are interpreted.
"""

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from tactile import files
from tactile.errors import InputError, NotFoundError

Shape = TypeVar("Shape", bound=msgspec.Struct)

LARGEST_FILE = 8 * 1024 * 1024
"""Largest size of a JSON or XML file [bytes]. That is minutes of effects, and some 200 MB as Python
objects at worst."""
DEEPEST = 32
"""Largest number of nested levels."""
LARGEST_WHOLE = 2**53
"""Largest integer. Beyond it not every JSON reader gives the same value (RFC 8259, 6)."""
_SURROGATE = re.compile("[\ud800-\udfff]")
"""Characters that no valid text contains."""
MOST_LINES = 8
"""Largest number of notes of one kind. The remaining ones are counted."""


def contents(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Read the contents of a file.

    Parameters
    ----------
    path : Path
        File to read.
    largest : int
        Largest size [bytes].

    Returns
    -------
    bytes
        Contents.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file cannot be read or is too large.
    """
    if not files.is_file(path):
        raise NotFoundError(f"{path}: no such file")
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(size) if size <= largest else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if size > largest:
        raise InputError(f"{path}: is larger than {largest // 1024**2} MiB")
    return data


def parsed_json(path: Path, *, null: bool = True) -> dict[str, Any]:
    """Read the object of a JSON file.

    Parameters
    ----------
    path : Path
        File to read.
    null : bool
        Whether the format allows null.

    Returns
    -------
    dict
        The object.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file cannot be read, is not JSON, or holds what no format allows: numbers that are
        not finite or too large, invalid text, duplicate fields, too many levels.
    """
    raw = contents(path)
    try:
        data = json.loads(raw.decode("utf-8-sig"), object_pairs_hook=_unique_fields)
    except RecursionError as error:
        raise InputError(f"{path}: more than {DEEPEST} levels deep") from error
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {one_line(str(error))}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: must be a JSON object")
    if fault := _fault(data, null, 0):
        field, problem = fault
        raise InputError(f"{path}: {one_line(field.removeprefix('.'))}{problem}")
    return data


def one_line(text: str) -> str:
    """Convert a text to one line of printable characters.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        Line of at most 300 characters.
    """
    line = " ".join(re.sub(r"[^ -~\u00a0-\ud7ff\ue000-\ufffd]", " ", text).split())
    return line if len(line) <= 300 else line[:299] + "…"


def _unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the fields of an object, or raise `ValueError` if one occurs twice."""
    fields = dict(pairs)
    if len(fields) < len(pairs):
        (name, _), *_ = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"field {name!r} occurs twice")
    return fields


def _fault(value: Any, null: bool, depth: int) -> tuple[str, str] | None:
    """Return the place and kind of what is not allowed in a value, or None if there is nothing."""
    if depth > DEEPEST:
        return "", f": is more than {DEEPEST} levels deep"
    if isinstance(value, dict):
        for key, inner in value.items():
            if fault := _fault(key, null, depth) or _fault(inner, null, depth + 1):
                return f".{key}{fault[0]}", fault[1]
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            if fault := _fault(inner, null, depth + 1):
                return f"[{i}]{fault[0]}", fault[1]
    elif isinstance(value, float) and not math.isfinite(value):
        return "", f" = {value}: must be a finite number"
    elif isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        return "", ": is larger than 2^53"
    elif isinstance(value, str) and not value.isascii() and _SURROGATE.search(value):
        return "", ": is no valid text"
    elif value is None and not null:
        return "", ": null is no value of this format"
    return None


def fitted(path: Path, data: Any, shape: type[Shape]) -> Shape:
    """Convert data to a Struct.

    Parameters
    ----------
    path : Path
        File that the data was read from, for the message.
    data : object
        Data of JSON.
    shape : type
        Struct to convert to.

    Returns
    -------
    Struct
        Instance of ``shape``.

    Raises
    ------
    InputError
        If the data does not fit. The message has the file, field, value and limit.
    """
    try:
        return msgspec.convert(data, shape)
    except msgspec.ValidationError as error:
        raise InputError(one_line(f"{path}: {files.explain(data, str(error))}")) from error


def unknown(data: Any, kind: msgspec.inspect.Type) -> Iterator[str]:
    """Find the fields of data that a Struct does not have.

    Parameters
    ----------
    data : object
        Data of JSON that fits the type.
    kind : msgspec.inspect.Type
        Type that the data is converted to.

    Yields
    ------
    str
        Name of a field, once for each occurrence.
    """
    if isinstance(kind, msgspec.inspect.UnionType):
        for member in kind.types:
            yield from unknown(data, member)
    elif isinstance(kind, msgspec.inspect.StructType) and isinstance(data, dict):
        known = {field.encode_name: field.type for field in kind.fields}
        for key, value in data.items():
            if key in known:
                yield from unknown(value, known[key])
            else:
                yield key
    elif isinstance(kind, msgspec.inspect.VarTupleType) and isinstance(data, list):
        for value in data:
            yield from unknown(value, kind.item_type)


def notes_on(what: str, names: Iterator[str] | list[str]) -> list[str]:
    """Format names as notes, one line each.

    Parameters
    ----------
    what : str
        Beginning of each line.
    names : iterator or list of str
        Names, which are counted if they repeat.

    Returns
    -------
    list of str
        Lines. After a few of them, the last one counts the remaining names.
    """
    counts = Counter(one_line(name) for name in names)
    lines = [
        f"{what} {name}" + (f" ({count} times)" if count > 1 else "")
        for name, count in counts.items()
    ]
    remaining = len(lines) - MOST_LINES
    return lines if remaining <= 1 else [*lines[:MOST_LINES], f"{what} {remaining} more names"]
