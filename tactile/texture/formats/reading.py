"""Reading what anybody may have written: JSON within limits, checked before anything uses it.

Whatever is wrong becomes one line: file, field, value, what is allowed. Size is checked before the
file is read, and depth, numbers, text and twice-named fields before it is taken for anything.
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
"""Bytes of JSON or XML: minutes of effects; as Python objects some 200 MB at worst."""
DEEPEST = 32
LARGEST_WHOLE = 2**53
"""Integers beyond it are not the same in every JSON reader (RFC 8259, 6)."""
_SURROGATE = re.compile("[\ud800-\udfff]")
MOST_LINES = 8
"""Told of one kind; the rest is counted."""


def contents(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return a file's bytes.

    Raises
    ------
    NotFoundError, InputError
        Where it is not there, cannot be read or is too large.
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
    """Return a JSON file's object; ``null`` says whether the format has any use for null.

    Raises
    ------
    NotFoundError, InputError
        Where it cannot be read, is no JSON, or holds what no format has any use for: numbers that
        are not finite or too large, text that is no text, a field twice, too many levels.
    """
    raw = contents(path)
    try:
        data = json.loads(raw.decode("utf-8-sig"), object_pairs_hook=_without_twins)
    except RecursionError as error:
        raise InputError(f"{path}: more than {DEEPEST} levels deep") from error
    except ValueError as error:
        raise InputError(f"{path}: no valid JSON: {one_line(str(error))}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: must be a JSON object")
    if fault := _fault(data, null, 0):
        field, problem = fault
        raise InputError(f"{path}: {one_line(field.removeprefix('.'))}{problem}")
    return data


def one_line(text: str) -> str:
    """Return text as one line of printable characters, cut where it is very long."""
    line = " ".join(re.sub(r"[^ -~\u00a0-\ud7ff\ue000-\ufffd]", " ", text).split())
    return line if len(line) <= 300 else line[:299] + "…"


def _without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        (name, _), *_ = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"field {name!r} is there twice")
    return fields


def _fault(value: Any, null: bool, depth: int) -> tuple[str, str] | None:
    """Return where in a value, and what, cannot be used; None where all can."""
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
    """Return data as a Struct.

    Raises
    ------
    InputError
        Where it does not fit: file, field, value and limit.
    """
    try:
        return msgspec.convert(data, shape)
    except msgspec.ValidationError as error:
        found = re.fullmatch(r"(?s)(.*?)(?: - at `\$\.?(.*?)`)?", str(error))
        assert found is not None
        field = (found[2] or "").replace("[...]", "[…]")
        value = _value_at(data, field)
        plain = isinstance(value, int | float | str)
        where = f"{field} = {value!r}: " if plain else f"{field}: " if field else ""
        problem = found[1].replace("Expected", "expected").replace("`", "")
        raise InputError(one_line(f"{path}: {where}{problem}")) from error


def _value_at(data: Any, field: str) -> Any:
    for key in re.findall(r"[^.\[\]]+", field):
        try:
            data = data[int(key)] if isinstance(data, list) else data[key]
        except (KeyError, IndexError, ValueError, TypeError):
            return None
    return data


def unknown(data: Any, kind: msgspec.inspect.Type) -> Iterator[str]:
    """Yield the name of each field that a Struct does not know, in data that fits it."""
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


def told(what: str, names: Iterator[str] | list[str]) -> list[str]:
    """Return a line for each name, with how often it came; a last one for those beyond a few."""
    counts = Counter(one_line(name) for name in names)
    lines = [
        f"{what} {name}" + (f" ({count} times)" if count > 1 else "")
        for name, count in counts.items()
    ]
    more = len(lines) - MOST_LINES
    return lines if more <= 1 else [*lines[:MOST_LINES], f"{what} {more} more names"]
