"""Descriptor and display files: where the shipped ones lie, and how any of them is read.

A file is TOML, its shape a msgspec Struct whose field names carry their units. Whatever does not
fit becomes one line: file, field, value, what is allowed, and for a misspelt key the nearest.
Tables (paths, responses) are CSV with a header whose names carry units.
"""

import csv
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError, NotFoundError

Shape = TypeVar("Shape", bound=msgspec.Struct)

LARGEST_TEXT = 1024 * 1024
"""Characters of a file: twice what a display of 4096 contactors takes, each spelled out."""
LARGEST_TABLE = 256 * 1024 * 1024
"""Bytes of a CSV file, which take some GB as Python's rows: an hour at 2 kHz."""
LONGEST_LINE = 1000
"""Characters of what is said of a file, which may hold what it says of a value."""
DEEPEST = 32
"""Parts of a dotted key."""
_NO_KEY = re.compile(
    r'''"""[\s\S]*?(?:"""|\Z)|\'{3}[\s\S]*?(?:\'{3}|\Z)'''
    r"""|"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?|\#[^\n]*"""
)
"""Strings and comments, also those that do not end."""


def shipped(kind: str) -> Path:
    """Return the folder of shipped files ("textures", "displays"), in a wheel or a checkout."""
    package = Path(__file__).parent
    inside = package / "_data" / kind
    return inside if inside.is_dir() else package.parent / kind


def shipped_names(kind: str) -> dict[str, Path]:
    """Return name and path of each shipped file, sorted by name."""
    paths = {path.stem: path for path in shipped(kind).rglob("*.toml")}
    return dict(sorted(paths.items()))


def nearest(name: str, known: list[str]) -> str:
    """Return " (did you mean …?)" or the list of what there is."""
    close = get_close_matches(name, known, 1, 0.5)
    return f"did you mean {close[0]!r}?" if close else f"there is: {', '.join(known) or 'nothing'}"


def is_file(path: Path) -> bool:
    """Return whether a file is there, also for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find(kind: str, name_or_path: str | Path) -> Path:
    """Return the path of a shipped file by its name, or of a file by its path.

    Raises
    ------
    NotFoundError
        Where neither exists, with the nearest shipped name.
    """
    names = shipped_names(kind)
    if str(name_or_path) in names:
        return names[str(name_or_path)]
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.parent != Path():
        if is_file(path):
            return path
        raise NotFoundError(f"{path}: no such file")
    raise NotFoundError(f"no {kind[:-1]} {str(path)!r}; {nearest(str(path), list(names))}")


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        Where it cannot be read, or is larger than `LARGEST_TEXT`.
    """
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(LARGEST_TEXT + 1)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if len(text) > LARGEST_TEXT:
        raise InputError(
            f"{path}: has more than {LARGEST_TEXT // 1024} KiB of text, the most that may be; is "
            "it the right file?"
        )
    return text


def _shallow(path: Path, text: str) -> str:
    """Return TOML, whose keys have few parts: the parser takes their square in time."""
    bare = re.sub(r"[ \t]", "", _NO_KEY.sub("s", text))
    if any(word.count(".") >= DEEPEST for word in re.split(r"[^\w.-]+", bare)):
        raise InputError(f"{path}: has a key of more than {DEEPEST} parts, the most that may be")
    return text


def read(
    path: Path, shape: type[Shape], *, adapt: Callable[[dict[str, Any]], None] | None = None
) -> Shape:
    """Read a TOML file into a Struct.

    Parameters
    ----------
    path : path of the file
    shape : class of the Struct
    adapt : function that changes the content of an older file to that of a present one

    Returns
    -------
    Struct
        The content of the file.

    Raises
    ------
    InputError
        Where it cannot be read, is no TOML, or does not fit: file, field, value and limit.
    """
    text = _shallow(path, read_text(path))
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: no valid TOML: {_one_line(str(error))}") from error
    if adapt is not None:
        adapt(data)
    for field, value in _leaves(data):
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{path}: {field} = {value}: must be a finite number")
    for field, problem in _unknown(data, msgspec.inspect.type_info(shape), ""):
        raise InputError(_one_line(f"{path}: {field}: {problem}"))
    try:
        return msgspec.convert(data, shape)
    except msgspec.ValidationError as error:
        raise InputError(_one_line(f"{path}: {_explain(data, str(error))}")) from error


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_LINE else line[: LONGEST_LINE - 1] + "…"


def _leaves(data: Any, field: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{field}.{key}" if field else key)
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _leaves(value, f"{field}[{i}]")
    else:
        yield field, data


def _unknown(data: Any, kind: msgspec.inspect.Type, field: str) -> Iterator[tuple[str, str]]:
    """Yield each key and option that the Struct does not know, with the nearest that it does."""
    if isinstance(kind, msgspec.inspect.UnionType):
        for member in kind.types:
            if not isinstance(member, msgspec.inspect.NoneType):
                yield from _unknown(data, member, field)
    elif isinstance(kind, msgspec.inspect.StructType) and isinstance(data, dict):
        known = {f.encode_name: f.type for f in kind.fields}
        for key, value in data.items():
            name = f"{field}.{key}" if field else key
            if key not in known:
                yield name, f"unknown key; {nearest(key, list(known))}"
            else:
                yield from _unknown(value, known[key], name)
    elif isinstance(kind, msgspec.inspect.LiteralType) and isinstance(data, str | int | float):
        if data not in kind.values:
            options = [str(value) for value in kind.values]
            yield f"{field} = {data!r}", f"unknown; {nearest(str(data), options)}"
    elif isinstance(kind, msgspec.inspect.VarTupleType) and isinstance(data, list):
        for i, value in enumerate(data):
            yield from _unknown(value, kind.item_type, f"{field}[{i}]")


def _explain(data: Any, message: str) -> str:
    """Turn msgspec's "Expected … - at `$.a[0].b`" into "a[0].b = value: expected …"."""
    found = re.fullmatch(r"(?s)(.*?)(?: - at `\$\.?(.*?)`)?", message)
    assert found is not None
    problem, field = found[1], found[2] or ""
    value = data
    for key in re.findall(r"[^.\[\]]+", field):
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, ValueError):
            value = None
    if field and re.match(r"[a-z]\w*_\w+ (=|has) ", problem):  # a Struct's own check of a field
        return f"{field}.{problem}"
    plain = isinstance(value, int | float | str | bool)
    where = f"{field} = {value!r}: " if plain else f"{field}: " if field else ""
    return where + problem.replace("Expected", "expected").replace("`", "")


class Row(NamedTuple):
    """A row of a table: its line in the file and its cells."""

    line: int
    cells: list[str]


def read_columns(path: Path, names: tuple[str, ...]) -> list[Row]:
    """Read named columns of a CSV file with a header, a `Row` each.

    Raises
    ------
    NotFoundError, InputError
        Where the file, a column or a cell is missing.
    """
    if not is_file(path):
        raise NotFoundError(f"{path}: no such file")
    try:
        if path.stat().st_size > LARGEST_TABLE:
            raise InputError(
                f"{path}: is larger than {LARGEST_TABLE // 1024**2} MiB, the most that may be; "
                "cut it into parts"
            )
        with path.open(newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            header = list(reader.fieldnames or [])
            for name in names:
                if name not in header:
                    raise InputError(f"{path}: no column {name!r}; {nearest(name, header)}")
            rows = [Row(reader.line_num, [row[name] for name in names]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    return rows


def numbers(path: Path, names: tuple[str, ...], rows: list[Row]) -> NDArray[np.float64]:
    """Return the first cells of `read_columns`, one per name, as numbers (rows, columns).

    Raises
    ------
    InputError
        Naming line, column and value of the first cell that is not a finite number.
    """
    table = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        for k, (name, cell) in enumerate(zip(names, row.cells, strict=False)):
            try:
                table[i, k] = float(cell)
            except (TypeError, ValueError):
                table[i, k] = math.nan
            if not math.isfinite(table[i, k]):
                raise InputError(
                    f"{path}: line {row.line}: {name} = {cell!r}: must be a finite number"
                )
    return table
