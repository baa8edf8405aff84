"""A descriptor written as the file it would be read from, in the form of the shipped ones.

`as_toml` gives the text, `write` the file. Values that are the default are left out, long arrays
stand in rows of eight, and long texts are wrapped. Comments say where a number comes from; they go
by the path of what they are about ("stochastic.level_db", "periodic[0]", "" for the head).
"""

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from tactile.errors import InputError
from tactile.texture.descriptor import Descriptor

ROW = 8
"""Numbers in a row of an array."""
WIDTH = 100
"""Columns that text is wrapped at."""
ESCAPES = {"\\": "\\\\", '"': '\\"', "\b": "\\b", "\t": "\\t", "\f": "\\f", "\r": "\\r"}
CONTROL = re.compile(r"[\x00-\x1f\x7f]")
"""What no comment may hold."""
NO_COMMENTS: Mapping[str, str] = MappingProxyType({})


def as_toml(descriptor: Descriptor, comments: Mapping[str, str] = NO_COMMENTS) -> str:
    """Return a descriptor as TOML, which reads back as the same descriptor.

    Parameters
    ----------
    descriptor : the texture
    comments : text by the path of a table or key; "" stands above everything, the comment of a
        table or of an array of several rows above it, any other behind its value

    Raises
    ------
    InputError
        Where a number is not finite: the field and its value.
    ValueError
        Where a comment is about nothing that is written.
    """
    left = dict(comments)
    lines = _remark(left.pop("", ""))
    for name, header, table in _tables(descriptor):
        lines += ["", *_remark(left.pop(name, "")), header] if lines else [header]
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if field.required or value != field.default:
                path = f"{name}.{field.name}"
                lines += _entry(path, field.name, value, left.pop(path, ""))
    if left:
        raise ValueError(f"comments about what is not written: {', '.join(left)}")
    return "\n".join(lines) + "\n"


def write(
    descriptor: Descriptor,
    path: Path,
    comments: Mapping[str, str] = NO_COMMENTS,
    *,
    force: bool = False,
) -> None:
    """Write a descriptor to a file named after its id; `load` of `descriptor` reads it.

    Raises
    ------
    InputError
        Where the file has another name or is there and is not to be overwritten (``force``), its
        folder is not, or a value is outside its limits: nothing is written then.
    """
    check_target(path, descriptor.texture.id, force=force)
    text = as_toml(descriptor, comments)
    try:
        msgspec.convert(tomllib.loads(text), Descriptor)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: not written: {' '.join(str(error).split())}") from error
    with path.open("w" if force else "x", encoding="utf-8", newline="\n") as file:
        file.write(text)


def check_target(path: Path, name: str, *, force: bool) -> None:
    """See that a descriptor can be written to a file, before the work of making it.

    Raises
    ------
    InputError
        As of `write`.
    """
    if path.suffix != ".toml":
        raise InputError(f"{path}: must end in .toml")
    if path.stem != name:
        raise InputError(f"{path}: must be named after its texture: {name}.toml")
    if not path.parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}")
    if path.exists() and not force:
        raise InputError(f"{path}: is there already; --force overwrites it")


def _tables(descriptor: Descriptor) -> Iterator[tuple[str, str, Any]]:
    """Yield path, header and content of each table that says more than its defaults."""
    for field in msgspec.structs.fields(descriptor):
        part = getattr(descriptor, field.name)
        if isinstance(part, tuple):
            for i, one in enumerate(part):
                yield f"{field.name}[{i}]", f"[[{field.name}]]", one
        elif field.required or part != field.default:
            yield field.name, f"[{field.name}]", part


def _remark(text: str) -> list[str]:
    return [f"# {CONTROL.sub(' ', line)}".rstrip() for line in text.splitlines()]


def _entry(path: str, name: str, value: Any, comment: str) -> list[str]:
    """Return the lines of a key with its value and comment."""
    if isinstance(value, tuple) and len(value) > ROW:
        cells = [f"{_number(path, one)}," for one in value]
        width = max(map(len, cells)) + 1
        rows = [
            "".join(cell.rjust(width) for cell in cells[i : i + ROW]).rstrip()
            for i in range(0, len(cells), ROW)
        ]
        return [*_remark(comment), f"{name} = [", *("    " + row for row in rows), "]"]
    if isinstance(value, tuple):
        written = f"[{', '.join(_number(path, one) for one in value)}]"
    else:
        written = _text(name, value) if isinstance(value, str) else _number(path, value)
    behind = f"  {_remark(' '.join(comment.split()))[0]}" if comment else ""
    return [f"{name} = {written}{behind}"]


def _number(path: str, value: float) -> str:
    if not math.isfinite(value):
        raise InputError(f"{path} = {value}: must be a finite number")
    return repr(float(value))


def _text(name: str, text: str) -> str:
    """Return a string on one line, or where it is long or has lines of its own, wrapped."""
    if "\n" not in text and len(name) + len(text) + 5 <= WIDTH:
        return f'"{_escaped(text)}"'
    lines = [_wrapped(_escaped(line)) for line in text.split("\n")]
    return '"""\n' + "\n".join(lines) + '"""'


def _escaped(text: str) -> str:
    return "".join(
        ESCAPES.get(c, f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else c) for c in text
    )


def _wrapped(line: str) -> str:
    r"""Break a line at single spaces; a backslash at its end joins it to the next.

    What a TOML reader drops after that backslash is white space, so that no row may begin with it.
    """
    words = re.split(r"(?<=[^ ]) (?=[^ ])", line)
    rows = [words[0]]
    for word in words[1:]:
        if len(rows[-1]) + len(word) + 4 <= WIDTH:
            rows[-1] += f" {word}"
        else:
            rows.append(word)
    return " \\\n".join(rows)
