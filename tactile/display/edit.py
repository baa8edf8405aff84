"""What is found out about a display, written into its file.

`write_map` writes which channel moves which contactor and which way; `write_tables` what a fit to a
measurement found of its bender and of the finger. All else in the file stays as it was, comments
included: what replaces ``[grid]``, the ``[[contactor]]`` tables or ``[finger]`` has their comments
before it.
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
COMMENT = re.compile(r"""(?:[^"'#]|"(?:\\.|[^"\\])*"|'[^']*')*(#.*)""")
ASSIGNED = re.compile(r"""\s*["']?([\w-]+)["']?\s*=""")
MAPPED = {("[", "grid"), ("[[", "contactor")}
"""Tables that say where which contactor is."""

Value = bool | float | str | Sequence["Value"]
"""What a key of a table may be; a row of branches is a sequence."""


@dataclass(frozen=True)
class Map:
    """Channel and polarity of each contactor."""

    channel: tuple[int, ...]
    polarity: tuple[int, ...]

    @classmethod
    def of(cls, display: Display) -> "Map":
        """Return a display's."""
        return cls(tuple(map(int, display.channel)), tuple(map(int, display.polarity)))


def checked_target(source: str | Path, target: Path, *, force: bool) -> None:
    """See that a display's map can be written to a file.

    Raises
    ------
    InputError
        Where the file is there and is not to be overwritten, where its folder is not, or where the
        display's measured responses would not be found from there.
    """
    path, content = _checked_place(source, target, force=force)
    _replaced(path, contactors_of(content))


def _checked_place(source: str | Path, target: Path, *, force: bool) -> tuple[Path, DisplayFile]:
    """Return a display's path and content, if a changed one can be written to a file."""
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
    """Write a display's file with another map.

    Raises
    ------
    InputError
        As of `checked_target`, and where what would be written is no display; nothing is then.
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
    """Write a display's file with other constants of its bender, its finger or both.

    Parameters
    ----------
    source : a display's name or file
    target : file to write; with ``force`` it may be the same
    bimorph : keys of ``[bimorph]`` (`tables.BimorphTable`), with their units; keys that are
        not named stay
    finger : all of ``[finger]`` (`tables.Finger`): k0_n_per_m, d0_n_s_per_m and branches, or
        preset; what it said before goes
    force : overwrites a target that is there already

    Raises
    ------
    InputError
        Where a key or value is none of the file's, where the target cannot be written, or where
        the file says ``bimorph`` or ``finger`` in another form than as tables; nothing is written.
    """
    path, _ = _checked_place(source, target, force=force)
    old = files.read_text(path)
    wanted, text = tomllib.loads(old), old
    if bimorph:
        wanted["bimorph"] = wanted.get("bimorph", {}) | _plain(bimorph)
        text = _with_keys(text, "bimorph", bimorph)
    if finger:
        wanted["finger"] = _plain(finger)
        text = _with_table(text, "finger", finger)
    if json.dumps(_parsed(text), sort_keys=True) != json.dumps(wanted, sort_keys=True):
        raise InputError(f"{path}: bimorph and finger are not written as tables, a key on a line")
    _write(text, target, force=force)


def _write(text: str, target: Path, *, force: bool, told: Map | None = None) -> None:
    """Write a file if it is a display, and if it has the map that was told; or nothing."""
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
    """Return a file's text with keys of a table set, each on its line or after the last."""
    out: list[str] = []
    left, found = {k: _line(k, v) for k, v in values.items()}, False
    for kind, lines in _sections(text.splitlines(keepends=True)):
        if kind != ("[", table):
            out += lines
            continue
        found, last = True, 0
        for k, line in enumerate(lines):
            said = ASSIGNED.match(line)
            if said is not None and said[1] in left:
                comment = COMMENT.fullmatch(line.rstrip("\n"))
                new = left.pop(said[1])
                lines[k] = new if comment is None else f"{new.rstrip()}  {comment[1]}\n"
            last = k + 1 if line.strip() else last
        lines[last - 1] = lines[last - 1].rstrip("\n") + "\n"
        out += [*lines[:last], *left.values(), *lines[last:]]
    return "".join(out) if found else _appended(text, table, left.values())


def _with_table(text: str, table: str, values: Mapping[str, Value]) -> str:
    """Return a file's text with a table and those within it replaced; their comments stay."""
    out: list[str] = []
    said: list[str] = []
    place = None
    for (_, name), lines in _sections(text.splitlines(keepends=True)):
        if name != table and not name.startswith(f"{table}."):
            out += lines
            continue
        place = len(out) if place is None else place
        comments = (COMMENT.fullmatch(line.rstrip("\n")) for line in lines)
        said += [found[1] + "\n" for found in comments if found]
    rows = [_line(k, v) for k, v in values.items()]
    if place is None:
        return _appended(text, table, rows)
    return "".join([*out[:place], *said, f"[{table}]\n", *rows, "\n", *out[place:]])


def _appended(text: str, table: str, rows: Iterable[str]) -> str:
    return "".join([text.rstrip("\n"), f"\n\n[{table}]\n", *rows])


def _line(key: str, value: Value) -> str:
    return f"{key} = {_toml(value)}\n"


def _toml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, int | float):
        return repr(float(value))
    return f"[{', '.join(map(_toml, value))}]"


def _plain(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return values as TOML gives them back."""
    return tomllib.loads("".join(_line(k, v) for k, v in values.items()))


def _replaced(path: Path, contactors: Sequence[Contactor]) -> str:
    """Return a file's text with its contactors replaced; all other tables stay."""
    text = files.read_text(path)
    left, out = list(contactors), []
    for kind, lines in _sections(text.splitlines(keepends=True)):
        if kind not in MAPPED:
            out += lines
            continue
        here = left if kind == ("[", "grid") else left[:1]
        left = left[len(here) :]
        said = [
            found[1] + "\n" for line in lines if (found := COMMENT.fullmatch(line.rstrip("\n")))
        ]
        out += [*said, *(line for c in here for line in _lines(c))]
    new = "".join(out)
    wanted = _without_map(text)
    if left or _parsed(new) is None or _without_map(new) != wanted:
        raise InputError(f"{path}: the map is not written as tables [grid] or [[contactor]]")
    return new


def _sections(lines: list[str]) -> Iterator[tuple[tuple[str, str], list[str]]]:
    """Yield the tables of a file, each with the comments above it."""
    kind, begin = ("", ""), 0
    for k, line in enumerate(lines):
        found = HEADER.fullmatch(line.rstrip("\n"))
        if found is None:
            continue
        first = k
        while first > begin and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        yield kind, lines[begin:first]
        kind, begin = (found[1], found[2]), first
    yield kind, lines[begin:]


def _lines(c: Contactor) -> list[str]:
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
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _without_map(text: str) -> dict[str, Any]:
    return {k: v for k, v in (_parsed(text) or {}).items() if k not in ("grid", "contactor")}
