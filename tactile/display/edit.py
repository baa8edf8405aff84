"""Editing of a display file with the results of a measurement or a mapping.

`write_map` writes which channel drives which contactor and with which polarity. `write_tables`
writes constants of the bender and of the finger, such as a fit to a measurement yields. Everything
else in the file remains as it was, comments included: whatever replaces ``[grid]``, the
``[[contactor]]`` tables or ``[finger]`` is preceded by their comments.
"""

import json
import os
import re
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile import files
from tactile.display.display import Display, contactors_of, load_display
from tactile.display.tables import Contactor, DisplayFile
from tactile.errors import InputError

HEADER = re.compile(r"""\s*(\[{1,2})\s*["']?([\w-]+(?:[\w."'\s-]*\w)?)["']?\s*\]{1,2}\s*(?:#.*)?""")
"""Header line of a table; its groups are the opening brackets and the name."""
COMMENT = re.compile(r"""(?:[^"'#]|"(?:\\.|[^"\\])*"|'[^']*')*(#.*)""")
"""Line with a comment outside of strings; its group is the comment."""
ASSIGNED = re.compile(r"""\s*["']?([\w-]+)["']?\s*=""")
"""Start of a line that assigns a value; its group is the key."""
MAPPED = {("[", "grid"), ("[[", "contactor")}
"""Tables that hold the map of contactors to channels."""

Value = bool | float | str | Sequence["Value"]
"""Value of a key in a table; a row of Maxwell branches is a sequence."""


@dataclass(frozen=True)
class Map:
    """Channel and polarity of each contactor.

    Attributes
    ----------
    channel : tuple of int
        Channel of each contactor.
    polarity : tuple of int
        Polarity of each contactor, 1 or −1.
    """

    channel: tuple[int, ...]
    polarity: tuple[int, ...]

    @classmethod
    def of(cls, display: Display) -> "Map":
        """Return the map of a display.

        Parameters
        ----------
        display : Display
            Display whose map is returned.

        Returns
        -------
        Map
            Its channels and polarities.
        """
        return cls(tuple(map(int, display.channel)), tuple(map(int, display.polarity)))


def checked_target(source: str | Path, target: Path, *, force: bool) -> None:
    """Check that the map of a display can be written to a file.

    Parameters
    ----------
    source : str or Path
        Name or file of the display.
    target : Path
        File to be written.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If the target exists and must not be overwritten, if its folder does not exist, if it does
        not end in .toml, if the display's measured responses would not be found from there, or if
        the map in the source is not written as tables.
    """
    path, content = _checked_place(source, target, force=force)
    _replaced(path, contactors_of(content))


def _checked_place(source: str | Path, target: Path, *, force: bool) -> tuple[Path, DisplayFile]:
    """Return path and content of a display after checking that a target file can be written."""
    path = files.find("displays", source)
    content = files.read(path, DisplayFile)
    if target.suffix != ".toml":
        raise InputError(f"{target}: must end in .toml")
    if target.exists() and not force:
        raise InputError(f"{target}: is there already; --force overwrites it")
    if not target.parent.is_dir():
        raise InputError(f"{target}: no folder {target.parent}")
    named = content.group or any(c.response is not None for c in content.contactor)
    if named and target.parent.resolve() != path.parent.resolve():
        raise InputError(f"{target}: must be in {path.parent}, where the measured responses are")
    return path, content


def write_map(source: str | Path, target: Path, told: Map, *, force: bool) -> None:
    """Write the file of a display with another map.

    Parameters
    ----------
    source : str or Path
        Name or file of the display.
    target : Path
        File to be written; with ``force`` it may be the source.
    told : Map
        Channel and polarity of each contactor.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        As in `checked_target`, or if the result would not be a valid display with that map; nothing
        is written then.
    """
    checked_target(source, target, force=force)
    path = files.find("displays", source)
    contactors = [
        Contactor(
            position_mm=c.position_mm, channel=channel, polarity=1 if polarity > 0 else -1,
            shear_direction_deg=c.shear_direction_deg, response=c.response,
        )
        for c, channel, polarity in zip(
            contactors_of(files.read(path, DisplayFile)), told.channel, told.polarity, strict=True
        )
    ]  # fmt: skip
    text = _replaced(path, contactors)
    _write(text, target, force=force, told=told)


def write_tables(
    source: str | Path,
    target: Path,
    *,
    bimorph: Mapping[str, Value] | None = None,
    finger: Mapping[str, Value] | None = None,
    force: bool,
) -> None:
    """Write the file of a display with other constants of its bender, its finger, or both.

    Parameters
    ----------
    source : str or Path
        Name or file of the display.
    target : Path
        File to be written; with ``force`` it may be the source.
    bimorph : mapping of str to value, optional
        Keys of ``[bimorph]`` (`tables.BimorphTable`), in the units of their names; all other keys
        remain.
    finger : mapping of str to value, optional
        All of ``[finger]`` (`tables.FingerLoadTable`): k0_n_per_m, d0_n_s_per_m and branches, or
        preset. It replaces the previous content.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If a key or value is not valid, if the target cannot be written, or if the file has
        ``bimorph`` or ``finger`` in another form than as tables; nothing is written then.
    """
    path, _ = _checked_place(source, target, force=force)
    old = files.read_text(path)
    expected, text = tomllib.loads(old), old
    if bimorph:
        expected["bimorph"] = expected.get("bimorph", {}) | _plain(bimorph)
        text = _with_keys(text, "bimorph", bimorph)
    if finger:
        expected["finger"] = _plain(finger)
        text = _with_table(text, "finger", finger)
    if json.dumps(_parsed(text), sort_keys=True) != json.dumps(expected, sort_keys=True):
        raise InputError(f"{path}: bimorph and finger are not written as tables, a key on a line")
    _write(text, target, force=force)


def _write(text: str, target: Path, *, force: bool, told: Map | None = None) -> None:
    """Write a file only if it is a valid display and, if a map is given, has that map."""
    handle, name = tempfile.mkstemp(suffix=".toml", prefix=".tactile-", dir=target.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        try:
            display = load_display(name)
        except InputError as error:
            raise InputError(str(error).replace(name, f"{target}: not written", 1)) from error
        if told is not None and Map.of(display) != told:
            raise InputError(f"{target}: not written: it would not have the map that was told")
        if force:
            os.replace(name, target)
        else:
            with target.open("x", encoding="utf-8") as file:
                file.write(text)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(name)


def _with_keys(text: str, table: str, values: Mapping[str, Value]) -> str:
    """Return the text of a file with keys of a table set, each in place or after the last one."""
    out: list[str] = []
    pending, is_present = {k: _line(k, v) for k, v in values.items()}, False
    for kind, lines in _sections(text.splitlines(keepends=True)):
        if kind != ("[", table):
            out += lines
            continue
        is_present, last = True, 0
        for k, line in enumerate(lines):
            assignment = ASSIGNED.match(line)
            if assignment is not None and assignment[1] in pending:
                comment = COMMENT.fullmatch(line.rstrip("\n"))
                new = pending.pop(assignment[1])
                lines[k] = new if comment is None else f"{new.rstrip()}  {comment[1]}\n"
            last = k + 1 if line.strip() else last
        lines[last - 1] = lines[last - 1].rstrip("\n") + "\n"
        out += [*lines[:last], *pending.values(), *lines[last:]]
    return "".join(out) if is_present else _appended(text, table, pending.values())


def _with_table(text: str, table: str, values: Mapping[str, Value]) -> str:
    """Return the text of a file with a table and its subtables replaced; their comments remain."""
    out: list[str] = []
    comments: list[str] = []
    place = None
    for (_, name), lines in _sections(text.splitlines(keepends=True)):
        if name != table and not name.startswith(f"{table}."):
            out += lines
            continue
        place = len(out) if place is None else place
        matches = (COMMENT.fullmatch(line.rstrip("\n")) for line in lines)
        comments += [match[1] + "\n" for match in matches if match]
    rows = [_line(k, v) for k, v in values.items()]
    if place is None:
        return _appended(text, table, rows)
    return "".join([*out[:place], *comments, f"[{table}]\n", *rows, "\n", *out[place:]])


def _appended(text: str, table: str, rows: Iterable[str]) -> str:
    """Return text with a table appended."""
    return "".join([text.rstrip("\n"), f"\n\n[{table}]\n", *rows])


def _line(key: str, value: Value) -> str:
    """Return the line that assigns a value to a key."""
    return f"{key} = {_toml(value)}\n"


def _toml(value: Value) -> str:
    """Return a value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, int | float):
        return repr(float(value))
    return f"[{', '.join(map(_toml, value))}]"


def _plain(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return values as a TOML parser returns them."""
    return tomllib.loads("".join(_line(k, v) for k, v in values.items()))


def _replaced(path: Path, contactors: Sequence[Contactor]) -> str:
    """Return the text of a file with its contactors replaced; all other tables remain."""
    text = files.read_text(path)
    pending, out = list(contactors), []
    for kind, lines in _sections(text.splitlines(keepends=True)):
        if kind not in MAPPED:
            out += lines
            continue
        replacement = pending if kind == ("[", "grid") else pending[:1]
        pending = pending[len(replacement) :]
        comments = [
            match[1] + "\n" for line in lines if (match := COMMENT.fullmatch(line.rstrip("\n")))
        ]
        out += [*comments, *(line for c in replacement for line in _lines(c))]
    new = "".join(out)
    expected = _without_map(text)
    if pending or _parsed(new) is None or _without_map(new) != expected:
        raise InputError(f"{path}: the map is not written as tables [grid] or [[contactor]]")
    return new


def _sections(lines: list[str]) -> Iterator[tuple[tuple[str, str], list[str]]]:
    """Yield the tables of a file, each with the comment lines directly above its header."""
    kind, begin = ("", ""), 0
    for k, line in enumerate(lines):
        header = HEADER.fullmatch(line.rstrip("\n"))
        if header is None:
            continue
        first = k
        while first > begin and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        yield kind, lines[begin:first]
        kind, begin = (header[1], header[2]), first
    yield kind, lines[begin:]


def _lines(c: Contactor) -> list[str]:
    """Return the lines of a ``[[contactor]]`` table."""
    rows: dict[str, Any] = {
        "position_mm": list(c.position_mm),
        "channel": c.channel,
        "shear_direction_deg": c.shear_direction_deg,
        "polarity": c.polarity,
    }
    text = [f"{name} = {value!r}\n" for name, value in rows.items()]
    if c.response is not None:
        escaped = c.response.replace("\\", "\\\\").replace('"', '\\"')
        text.append(f'response = "{escaped}"\n')
    return ["[[contactor]]\n", *text, "\n"]


def _parsed(text: str) -> dict[str, Any] | None:
    """Return the content of TOML text, or None if it is not valid."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _without_map(text: str) -> dict[str, Any]:
    """Return the content of TOML text without its contactors."""
    return {k: v for k, v in (_parsed(text) or {}).items() if k not in ("grid", "contactor")}
