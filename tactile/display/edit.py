"""Editing of a display file with the results of a measurement or a mapping.

`write_map` writes which channel drives which contactor and with which polarity. `write_tables`
writes constants of the bender and of the finger, such as a fit to a measurement yields. Everything
else in the file remains as it was, comments included: whatever replaces ``[grid]`` or ``[finger]``
is preceded by their comments. Only ``[[contactor]]`` tables that stand apart, with other tables
between them, are gathered behind the first one.
"""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Item, Key, Table

from tactile import files
from tactile.display.display import Display, contactors_of, load_display
from tactile.display.tables import Contactor, DisplayFile
from tactile.errors import InputError

Value = bool | float | str | Sequence["Value"]
"""Value of a key in a table; a row of Maxwell branches is a sequence."""
TableItem = tuple[Key | None, Item]
"""Item of a document with its key; a comment or a blank line has none."""


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
        the source cannot be edited.
    """
    path, content = _checked_place(source, target, force=force)
    _mapped(path, contactors_of(content))


def _checked_place(source: str | Path, target: Path, *, force: bool) -> tuple[Path, DisplayFile]:
    """Return path and content of a display after checking that a target file can be written."""
    path = files.find("displays", source)
    content = files.read(path, DisplayFile)
    if target.suffix != ".toml":
        raise InputError(f"{target}: must end in .toml")
    files.check_target(target, force=force)
    named = content.group or any(c.response is not None for c in content.contactor)
    if named and target.parent.resolve() != path.parent.resolve():
        raise InputError(f"{target}: must be in {path.parent}, where the measured responses are")
    return path, content


def write_map(source: str | Path, target: Path, new_map: Map, *, force: bool) -> None:
    """Write the file of a display with another map.

    Parameters
    ----------
    source : str or Path
        Name or file of the display.
    target : Path
        File to be written; with ``force`` it may be the source.
    new_map : Map
        Channel and polarity of each contactor.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        As in `checked_target`, or if the result would not be a valid display with that map; nothing
        is written then.
    """
    path, content = _checked_place(source, target, force=force)
    contactors = [
        msgspec.structs.replace(c, channel=channel, polarity=1 if polarity > 0 else -1)
        for c, channel, polarity in zip(
            contactors_of(content), new_map.channel, new_map.polarity, strict=True
        )
    ]
    _write(_mapped(path, contactors), target, force=force, new_map=new_map)


def write_tables(
    source: str | Path,
    target: Path,
    *,
    bimorph: Mapping[str, Value] | None = None,
    finger: Mapping[str, Value] | None = None,
    change: str = "",
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
    change : str
        What is different from the source, for people, beginning with the part that is changed, such
        as "finger fitted to a.csv". The description ends with it. Whatever is changed, the name of
        the display in a new file is that of the file.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If a key or value is not valid, if the target cannot be written, or if the source cannot be
        edited; nothing is written then.
    """
    path, content = _checked_place(source, target, force=force)
    document, expected = _parsed(path)
    names = {"description": _changed(content.display.description, change)}
    if target.resolve() != path.resolve():
        names["id"] = _id_of(target)
    _set(document["display"], names)
    expected["display"] |= names
    if bimorph:
        values = {name: _plain(value) for name, value in bimorph.items()}
        if "bimorph" in document:
            _set(document["bimorph"], values)
        else:
            _replace(document, "bimorph", "bimorph", tomlkit.item(values))
        expected["bimorph"] = expected.get("bimorph", {}) | values
    if finger:
        values = {name: _plain(value) for name, value in finger.items()}
        _replace(document, "finger", "finger", tomlkit.item(values))
        expected["finger"] = values
    _write(_checked_text(path, document, expected), target, force=force)


CHANGE_MARK = "; adjusted: "
"""What separates the description of a display from what was changed in it."""


def _changed(description: str, change: str) -> str:
    """Return a description that ends with a change, in place of an earlier one of the same part."""
    if not change:
        return description
    before, _, changes = description.partition(CHANGE_MARK)
    part = change.split()[0]
    kept = [earlier for earlier in changes.split(", ") if earlier and earlier.split()[0] != part]
    return f"{before}{CHANGE_MARK}{', '.join([*kept, change])}"


def _id_of(target: Path) -> str:
    """Return the name of a display that is written to a file: lower-case words with hyphens."""
    words = re.findall("[a-z0-9]+", target.stem.lower())
    return "-".join(words) or "display"


def _write(text: str, target: Path, *, force: bool, new_map: Map | None = None) -> None:
    """Write a file only if it is a valid display and, if a map is given, has that map."""

    def check(new: Path) -> None:
        display = load_display(new)
        if new_map is not None and Map.of(display) != new_map:
            raise InputError(f"{new}: its channels and polarities would differ from the given map")

    files.write_whole(target, text.encode(), force=force, check=check)


def _parsed(path: Path) -> tuple[tomlkit.TOMLDocument, dict[str, Any]]:
    """Return a file as a document, which keeps comments and layout, and as plain data."""
    text = files.read_text(path)
    try:
        return tomlkit.parse(text), tomllib.loads(text)
    except (TOMLKitError, RecursionError) as error:
        raise InputError(f"{path}: cannot be edited: {error}") from error


def _checked_text(path: Path, document: tomlkit.TOMLDocument, expected: dict[str, Any]) -> str:
    """Return the text of a document after a check that it reads back as the expected data."""
    text = tomlkit.dumps(document)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: cannot be edited: {error}") from error
    # NaN equals itself only in JSON; `load_display` refuses it with a better message.
    if json.dumps(content, sort_keys=True) != json.dumps(expected, sort_keys=True):
        raise InputError(f"{path}: cannot be edited without a change of other values")
    return text


def _mapped(path: Path, contactors: Sequence[Contactor]) -> str:
    """Return the text of a display file with the map of contactors; a grid becomes contactors."""
    document, expected = _parsed(path)
    if "contactor" in document:
        entries = zip(document["contactor"], expected["contactor"], contactors, strict=True)
        for entry, row, contactor in entries:
            mapped = {"channel": contactor.channel, "polarity": contactor.polarity}
            changes = {key: value for key, value in mapped.items() if row.get(key, 1) != value}
            _set(entry, changes)
            row |= changes
    else:
        rows = [msgspec.to_builtins(c) for c in contactors]
        rows = [{key: value for key, value in row.items() if value is not None} for row in rows]
        tables = tomlkit.aot()
        for row in rows:
            if tables.body:
                tables.body[-1].add(tomlkit.nl())
            tables.append(tomlkit.item(row))
        _replace(document, "grid", "contactor", tables)
        del expected["grid"]
        expected["contactor"] = rows
    return _checked_text(path, document, expected)


def _set(table: Any, values: Mapping[str, Any]) -> None:
    """Set keys of a table, each in place or after the last one."""
    tail = _cut_tail(table)
    for name, value in values.items():
        table[name] = value
    if tail:
        table.value.body.extend(tail)


def _replace(document: tomlkit.TOMLDocument, old: str, name: str, new: Item) -> None:
    """Replace a table, or append one; comments of the old one precede the new one.

    The document can only be dumped afterwards, since its index of keys is left as it was.
    """
    body = document.body
    places = [i for i, (key, _) in enumerate(body) if key is not None and key.key == old]
    # A table without a header of its own is among the keys that precede all tables.
    has_header = bool(places) and _has_header(body[places[0]])
    comments: list[TableItem] = []
    for i in reversed(places):
        tail = _cut_tail(body[i][1])
        comments = [*_comments(body[i]), *comments]
        body[i : i + 1] = tail
    place = places[0] if has_header else len(body)
    gap: list[TableItem] = [] if has_header else [(None, tomlkit.nl())]
    body[place:place] = [*gap, *comments, (tomlkit.key(name), new)]


def _has_header(entry: TableItem) -> bool:
    """Return whether an item is written below a header in brackets."""
    key, item = entry
    return isinstance(item, Table | AoT) and key is not None and not key.is_dotted()


def _cut_tail(item: Any) -> list[TableItem]:
    """Remove and return what follows the last key of a table.

    These are blank lines and comments, which mostly belong to the table below.
    """
    if isinstance(item, AoT):
        return _cut_tail(item.body[-1])
    if not isinstance(item, Table):
        return []
    body = item.value.body
    if body and _has_header(body[-1]):
        return _cut_tail(body[-1][1])
    end = len(body)
    while end and body[end - 1][0] is None:
        end -= 1
    tail = body[end:]
    del body[end:]
    return tail


def _comments(entry: TableItem) -> list[TableItem]:
    """Return the comments in ``grid`` or ``finger``, whose strings cannot contain a #."""
    part = tomlkit.document()
    part.body.append(entry)
    texts = re.findall("#.*", part.as_string())
    return [(None, tomlkit.comment(text[1:].removeprefix(" "))) for text in texts]


def _plain(value: Value) -> Any:
    """Return a value as a TOML parser returns it."""
    if isinstance(value, bool | str):
        return value
    return float(value) if isinstance(value, int | float) else [_plain(v) for v in value]
