"""The map of a display, which channel moves which contactor and which way, written into its file.

All else in the file stays as it was, comments included: what replaces ``[grid]`` or the
``[[contactor]]`` tables has their comments before it.
"""

import os
import re
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile import files
from tactile.display import Display, contactors_of, load_display
from tactile.display_file import Contactor, DisplayFile
from tactile.errors import InputError

HEADER = re.compile(r"""\s*(\[{1,2})\s*["']?([\w-]+(?:[\w."'\s-]*\w)?)["']?\s*\]{1,2}\s*(?:#.*)?""")
COMMENT = re.compile(r"""(?:[^"'#]|"(?:\\.|[^"\\])*"|'[^']*')*(#.*)""")
MAPPED = {("[", "grid"), ("[[", "contactor")}
"""Tables that say where which contactor is."""


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
    _replaced(path, contactors_of(content))


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
    handle, name = tempfile.mkstemp(suffix=".toml", prefix=".tactile-", dir=target.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        if Map.of(load_display(name)) != told:
            raise InputError(f"{target}: not written: it would not have the map that was told")
        if force:
            os.replace(name, target)
        else:
            with target.open("x", encoding="utf-8") as file:
                file.write(text)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(name)


def _replaced(path: Path, contactors: Sequence[Contactor]) -> str:
    """Return a file's text with its contactors replaced; all other tables stay."""
    text = path.read_text("utf-8")
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
