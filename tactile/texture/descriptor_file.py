"""Writing of a descriptor as a TOML file in the form of the shipped textures.

`as_toml` returns the text and `write` writes the file. Values that equal their default are left
out, long arrays are set in rows of eight numbers, and long strings are wrapped. Comments say where
a number comes from. They are given by the path of their subject, such as "stochastic.level_db" or
"periodic[0]", and "" for the head of the file.
"""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import tomlkit

from tactile import files
from tactile.errors import InputError
from tactile.texture.descriptor import Descriptor

ROW = 8
"""Number of values in a row of an array."""
WIDTH = 100
"""Width at which strings are wrapped [columns]."""
CONTROL = re.compile(r"[\x00-\x1f\x7f]")
"""Control characters, which a TOML comment must not contain."""
NO_COMMENTS: Mapping[str, str] = MappingProxyType({})
"""Empty mapping, the default of ``comments``."""


def as_toml(descriptor: Descriptor, comments: Mapping[str, str] = NO_COMMENTS) -> str:
    """Format a descriptor as TOML text that reads back as an equal descriptor.

    Parameters
    ----------
    descriptor : Descriptor
        Texture to format.
    comments : mapping of str to str
        Comments by the path of a table or key. The one for "" is placed at the top. The comment of
        a table, or of an array of several rows, is placed above it, any other one behind its value.

    Returns
    -------
    str
        TOML document.

    Raises
    ------
    InputError
        If a number is not finite. The message names the field and its value.
    ValueError
        If the subject of a comment is not written.
    """
    unused_comments = dict(comments)
    lines = _remark(unused_comments.pop("", ""))
    for name, header, table in _tables(descriptor):
        lines += ["", *_remark(unused_comments.pop(name, "")), header] if lines else [header]
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if field.required or value != field.default:
                path = f"{name}.{field.name}"
                lines += _entry(path, field.name, value, unused_comments.pop(path, ""))
    if unused_comments:
        raise ValueError(f"comments about what is not written: {', '.join(unused_comments)}")
    return "\n".join(lines) + "\n"


def write(
    descriptor: Descriptor,
    path: Path,
    comments: Mapping[str, str] = NO_COMMENTS,
    *,
    force: bool = False,
) -> None:
    """Write a descriptor to a file that is named after its id.

    Nothing is written if an error is raised. `load` of `descriptor` reads the file.

    Parameters
    ----------
    descriptor : Descriptor
        Texture to write.
    path : Path
        File to create, ``<id>.toml`` in an existing folder.
    comments : mapping of str to str
        Comments by path, as in `as_toml`.
    force : bool
        Whether to overwrite an existing file.

    Raises
    ------
    InputError
        If the name of the file does not match, it exists already and ``force`` is false, its folder
        does not exist, or a value is outside its limits.
    """
    check_target(path, descriptor.texture.id, force=force)
    content = as_toml(descriptor, comments).encode()
    files.write_whole(path, content, force=force, check=lambda new: files.read(new, Descriptor))


def check_target(path: Path, name: str, *, force: bool) -> None:
    """Check that a descriptor can be written to a file, before the work of computing it.

    Parameters
    ----------
    path : Path
        File to create.
    name : str
        Id of the texture.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If the name of the file does not match, it exists already and ``force`` is false, or its
        folder does not exist.
    """
    if path.suffix != ".toml":
        raise InputError(f"{path}: must end in .toml")
    if path.stem != name:
        raise InputError(f"{path}: must be named after its texture: {name}.toml")
    files.check_target(path, force=force)


def _tables(descriptor: Descriptor) -> Iterator[tuple[str, str, Any]]:
    """Yield path, header and contents of each table that differs from its defaults."""
    for field in msgspec.structs.fields(descriptor):
        part = getattr(descriptor, field.name)
        if isinstance(part, tuple):
            for i, entry in enumerate(part):
                yield f"{field.name}[{i}]", f"[[{field.name}]]", entry
        elif field.required or part != field.default:
            yield field.name, f"[{field.name}]", part


def _remark(text: str) -> list[str]:
    """Return a text as comment lines."""
    return [f"# {CONTROL.sub(' ', line)}".rstrip() for line in text.splitlines()]


def _entry(path: str, name: str, value: Any, comment: str) -> list[str]:
    """Return the lines of a key with its value and comment."""
    if isinstance(value, tuple) and len(value) > ROW:
        cells = [f"{_number(path, number)}," for number in value]
        width = max(map(len, cells)) + 1
        rows = [
            "".join(cell.rjust(width) for cell in cells[i : i + ROW]).rstrip()
            for i in range(0, len(cells), ROW)
        ]
        return [*_remark(comment), f"{name} = [", *("    " + row for row in rows), "]"]
    if isinstance(value, tuple):
        text = f"[{', '.join(_number(path, number) for number in value)}]"
    else:
        text = _text(name, value) if isinstance(value, str) else _number(path, value)
    behind = f"  {_remark(' '.join(comment.split()))[0]}" if comment else ""
    return [f"{name} = {text}{behind}"]


def _number(path: str, value: float) -> str:
    """Return a number as TOML, or raise `InputError` if it is not finite."""
    if not math.isfinite(value):
        raise InputError(f"{path} = {value}: must be a finite number")
    return repr(value if isinstance(value, int) else float(value))


def _text(name: str, text: str) -> str:
    """Return a string as TOML: on one line if it fits, otherwise wrapped over several."""
    if "\n" not in text and len(name) + len(text) + 5 <= WIDTH:
        return f'"{_escaped(text)}"'
    lines = [_wrapped(_escaped(line)) for line in text.split("\n")]
    return '"""\n' + "\n".join(lines) + '"""'


def _escaped(text: str) -> str:
    """Return a text with the escape sequences of a TOML basic string."""
    return tomlkit.string(text).as_string()[1:-1]


def _wrapped(line: str) -> str:
    """Break a line at single spaces, with a backslash at the end that joins it to the next row.

    A TOML reader drops all white space after that backslash, so that no row may begin with a space.
    """
    words = re.split(r"(?<=[^ ]) (?=[^ ])", line)
    rows = [words[0]]
    for word in words[1:]:
        if len(rows[-1]) + len(word) + 4 <= WIDTH:
            rows[-1] += f" {word}"
        else:
            rows.append(word)
    return " \\\n".join(rows)
