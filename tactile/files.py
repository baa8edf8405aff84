"""Reading and writing of descriptor and display files, and the places of the shipped ones.

A file is TOML and its shape is a msgspec Struct whose field names carry their units. Whatever does
not fit the shape is reported in one line: file, field, value, what is allowed, and for a misspelled
key the nearest valid one. Tables (paths, responses) are CSV files with a header whose names carry
units.
"""

import csv
import io
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from uuid import uuid4

import msgspec
import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError, NotFoundError, locate_mistake, show_field

Shape = TypeVar("Shape", bound=msgspec.Struct)

LARGEST_TEXT = 1024 * 1024
"""Maximum length of a TOML file: twice that of a display of 4096 contactors, each given in full
[characters]."""
LARGEST_TABLE = 256 * 1024 * 1024
"""Maximum size of a CSV file: an hour at 2 kHz, which takes some gigabytes as Python rows
[bytes]."""
LONGEST_LINE = 1000
"""Maximum length of a message about a file, since the file may contain any value [characters]."""
DEEPEST = 32
"""Maximum number of parts of a dotted TOML key; the parser takes time quadratic in that number."""
_NO_KEY = re.compile(
    r'''"""[\s\S]*?(?:"""|\Z)|\'{3}[\s\S]*?(?:\'{3}|\Z)'''
    r"""|"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?|\#[^\n]*"""
)
"""Pattern of the strings and comments of a TOML file, unterminated ones included."""


class SourceFile(msgspec.Struct, frozen=True):
    """File that something was loaded from, with the tables that it refers to.

    Attributes
    ----------
    name : str
        Name of the file.
    text : str
        Content of the file.
    tables : dict of str to str
        Content of each table, by the name that the file gives it.
    """

    name: str
    text: str
    tables: dict[str, str] = {}


def shipped(kind: str) -> Path:
    """Return the folder of shipped files, in an installed wheel or in a checkout.

    Parameters
    ----------
    kind : str
        Kind of the files: "textures" or "displays".

    Returns
    -------
    Path
        Folder of that kind.
    """
    package = Path(__file__).parent
    inside = package / "_data" / kind
    return inside if inside.is_dir() else package.parent / kind


def shipped_names(kind: str) -> dict[str, Path]:
    """List the shipped files of a kind.

    Parameters
    ----------
    kind : str
        Kind of the files: "textures" or "displays".

    Returns
    -------
    dict of str to Path
        Paths by name, sorted by name.
    """
    paths = {path.stem: path for path in shipped(kind).rglob("*.toml")}
    return dict(sorted(paths.items()))


def nearest(name: str, known: list[str]) -> str:
    """Compose a hint about an unknown name for an error message.

    Parameters
    ----------
    name : str
        Unknown name.
    known : list of str
        Valid names.

    Returns
    -------
    str
        "did you mean …?" if a valid name is similar, else the list of valid names.
    """
    close = get_close_matches(name, known, 1, 0.5)
    return f"did you mean {close[0]!r}?" if close else f"there is: {', '.join(known) or 'nothing'}"


def is_file(path: Path) -> bool:
    """Test whether a path is an existing file; a name that no file can have gives False.

    Parameters
    ----------
    path : Path
        Path to test.

    Returns
    -------
    bool
        Whether the file exists.
    """
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find(kind: str, name_or_path: str | Path) -> Path:
    """Find a shipped file by its name, or any file by its path.

    Parameters
    ----------
    kind : str
        Kind of the shipped files: "textures" or "displays".
    name_or_path : str or Path
        Name of a shipped file, or path of a file.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    NotFoundError
        If neither exists; the message suggests the nearest shipped name.
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
    """Read the text of a file.

    Parameters
    ----------
    path : Path
        File in UTF-8.

    Returns
    -------
    str
        Content of the file.

    Raises
    ------
    InputError
        If the file cannot be read or is longer than `LARGEST_TEXT`.
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


def _check_depth(path: Path, text: str) -> None:
    """Raise InputError for TOML text with a dotted key of too many parts.

    The parser takes time that is quadratic in the number of parts of a key.
    """
    bare = re.sub(r"[ \t]", "", _NO_KEY.sub("s", text))
    if any(word.count(".") >= DEEPEST for word in re.split(r"[^\w.-]+", bare)):
        raise InputError(f"{path}: has a key of more than {DEEPEST} parts, the most that may be")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Parameters
    ----------
    path : Path
        TOML file.

    Returns
    -------
    dict
        Content, of any shape.

    Raises
    ------
    InputError
        If the file cannot be read or is not valid TOML.
    """
    return _data_of(read_text(path), path)


def _data_of(text: str, path: Path) -> dict[str, Any]:
    """Parse the text of a TOML file; raise InputError if it is not valid."""
    _check_depth(path, text)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {_one_line(str(error))}") from error


def read(
    path: Path, shape: type[Shape], *, adapt: Callable[[dict[str, Any]], None] | None = None
) -> Shape:
    """Read a TOML file into a Struct.

    Parameters
    ----------
    path : Path
        TOML file.
    shape : type of msgspec.Struct
        Shape of the content.
    adapt : callable, optional
        Function that changes the content of an older file to that of a present one.

    Returns
    -------
    msgspec.Struct
        Content, an instance of ``shape``.

    Raises
    ------
    InputError
        If the file cannot be read, is not valid TOML, or does not fit the shape; the message gives
        file, field, value and limit.
    """
    return parse(read_text(path), path, shape, adapt=adapt)


def parse(
    text: str,
    path: Path,
    shape: type[Shape],
    *,
    adapt: Callable[[dict[str, Any]], None] | None = None,
) -> Shape:
    """Parse the text of a TOML file into a Struct.

    Parameters
    ----------
    text : str
        Content of the file.
    path : Path
        File that the text comes from, for the message.
    shape : type of msgspec.Struct
        Shape of the content.
    adapt : callable, optional
        Function that changes the content of an older file to that of a present one.

    Returns
    -------
    msgspec.Struct
        Content, an instance of ``shape``.

    Raises
    ------
    InputError
        If the text is not valid TOML or does not fit the shape; the message gives file, field,
        value and limit.
    """
    data = _data_of(text, path)
    if adapt is not None:
        adapt(data)
    return shaped(data, str(path), shape)


def shaped(data: Any, where: str, shape: type[Shape]) -> Shape:
    """Convert data to a Struct, without keys, options and numbers that it does not have.

    Parameters
    ----------
    data : object
        Nested tables, arrays, numbers and texts.
    where : str
        Origin of the data, for the message.
    shape : type of msgspec.Struct
        Shape of the data.

    Returns
    -------
    msgspec.Struct
        Data, an instance of ``shape``.

    Raises
    ------
    InputError
        If the data does not fit the shape; the message gives origin, field, value and limit.
    """
    for field, value in _leaves(data):
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{where}: {field} = {value}: must be a finite number")
    for field, problem in _unknown(data, msgspec.inspect.type_info(shape), ""):
        raise InputError(_one_line(f"{where}: {field}: {problem}"))
    try:
        return msgspec.convert(data, shape)
    except msgspec.ValidationError as error:
        raise InputError(_one_line(f"{where}: {explain(data, str(error))}")) from error


def _one_line(text: str) -> str:
    """Return text in one line, cut to `LONGEST_LINE` characters."""
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_LINE else line[: LONGEST_LINE - 1] + "…"


def _leaves(data: Any, field: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and the value of each leaf of nested tables and arrays."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{field}.{key}" if field else key)
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _leaves(value, f"{field}[{i}]")
    else:
        yield field, data


def _unknown(data: Any, kind: msgspec.inspect.Type, field: str) -> Iterator[tuple[str, str]]:
    """Yield each key and option that the Struct does not have, with the nearest that it has."""
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


def explain(data: Any, message: str) -> str:
    """Turn msgspec's "Expected … - at `$.a[0].b`" into "a[0].b = value: expected …".

    Parameters
    ----------
    data : object
        Data that does not fit its Struct.
    message : str
        Message of msgspec, or of the Struct's own check.

    Returns
    -------
    str
        Field, value and what is expected.
    """
    field, problem = locate_mistake(message)
    field = field.replace("[...]", "[…]")
    # The Struct's own check begins with a field of it.
    if field and re.match(r"[A-Za-z][\w.\[\]]*(:| =| has) ", problem):
        return f"{field}.{problem}"
    return show_field(data, field) + problem


class Row(NamedTuple):
    """Row of a table.

    Attributes
    ----------
    line : int
        Number of its line in the file, from 1.
    cells : list of str
        Text of its cells, in the order of the requested columns.
    """

    line: int
    cells: list[str]


def read_columns(path: Path, names: tuple[str, ...]) -> list[Row]:
    """Read named columns of a CSV file with a header.

    Parameters
    ----------
    path : Path
        CSV file in UTF-8.
    names : tuple of str
        Names of the columns.

    Returns
    -------
    list of Row
        One row for each line after the header.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file cannot be read, is larger than `LARGEST_TABLE`, or lacks a column.
    """
    return parse_columns(read_table(path), path, names)


def read_table(path: Path) -> str:
    """Read the text of a CSV file.

    Parameters
    ----------
    path : Path
        CSV file in UTF-8.

    Returns
    -------
    str
        Content of the file, with its line ends as they are.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file cannot be read or is larger than `LARGEST_TABLE`.
    """
    if not is_file(path):
        raise NotFoundError(f"{path}: no such file")
    try:
        if path.stat().st_size > LARGEST_TABLE:
            raise InputError(
                f"{path}: is larger than {LARGEST_TABLE // 1024**2} MiB, the most that may be; "
                "cut it into parts"
            )
        with path.open(newline="", encoding="utf-8-sig") as file:
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def parse_columns(text: str, path: Path, names: tuple[str, ...]) -> list[Row]:
    """Parse named columns of the text of a CSV file with a header.

    Parameters
    ----------
    text : str
        Content of the file.
    path : Path
        File that the text comes from, for the message.
    names : tuple of str
        Names of the columns.

    Returns
    -------
    list of Row
        One row for each line after the header.

    Raises
    ------
    InputError
        If the text is not valid CSV or lacks a column.
    """
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""))
        header = list(reader.fieldnames or [])
        for name in names:
            if name not in header:
                raise InputError(f"{path}: no column {name!r}; {nearest(name, header)}")
        return [Row(reader.line_num, [row[name] for name in names]) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def numbers(path: Path, names: tuple[str, ...], rows: list[Row]) -> NDArray[np.float64]:
    """Convert the first cells of each row to numbers.

    Parameters
    ----------
    path : Path
        File that the rows come from, for the message.
    names : tuple of str
        Names of the columns to convert, which are the first ones.
    rows : list of Row
        Rows from `read_columns`.

    Returns
    -------
    (rows, columns) array of float
        Values.

    Raises
    ------
    InputError
        If a cell is not a finite number; the message names line, column and value of the first one.
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


def check_target(path: Path, *, force: bool) -> None:
    """Check that a file can be written, before the work of computing its content.

    Parameters
    ----------
    path : Path
        File to write.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If its folder does not exist, or it exists already and ``force`` is false.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}")
    if path.exists() and not force:
        raise InputError(f"{path}: already exists; --force overwrites it")


def write_whole(
    path: Path,
    content: bytes,
    *,
    force: bool,
    check: Callable[[Path], object] = lambda new: None,
) -> None:
    """Write a file completely or not at all.

    Parameters
    ----------
    path : Path
        File to write.
    content : bytes
        Content of the file.
    force : bool
        Whether an existing file may be overwritten.
    check : callable
        Function that raises `InputError` if the file, which stands beside its place under another
        name, is not as it has to be.

    Raises
    ------
    InputError
        As in `check_target`, or that of the check; nothing is written then.
    """
    check_target(path, force=force)
    target = path.resolve()  # a link stays where it is
    new = target.with_name(f".tactile-{uuid4()}{path.suffix}")
    try:
        with new.open("xb") as file:
            file.write(content)
        try:
            check(new)
        except InputError as error:
            raise InputError(str(error).replace(str(new), f"{path}: not written", 1)) from error
        check_target(path, force=force)
        new.replace(target)
    finally:
        new.unlink(missing_ok=True)
