"""Files of a session: a folder of HDF5 files, each of which holds a part of it.

A part is written whole under another name, flushed to the disk and then renamed, so that every part
is complete whatever is killed or loses power. Columns of 64 bits are stored as their first value
and then the differences, which compress best; their attribute ``coding`` says so.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import msgspec
import numpy as np
from numpy.typing import NDArray

from tactile.errors import InputError, NotFoundError
from tactile.playback.mixer import BlockInput
from tactile.playback.session_messages import FORMAT, SessionHeader
from tactile.playback.session_ring import DUE_PLACES, Kind
from tactile.tracking.finger_sample import (
    FORCE_PLACES,
    POSITION_PLACES,
    SPEED_PLACES,
    TIME_PLACES,
    FingerSample,
)

LARGEST = 1e9
"""Largest magnitude of a number of a contact that is stored, 32 years or a million kilometers; a
contact with a larger one, or with one that is not finite, is stored as `INVALID`, since playback
ignores it."""
INVALID = np.iinfo(np.int64).min
"""Time of a contact that is not valid."""
DIGEST_BITS = 0xFFFF
"""Bits of a block's digest that are stored. Each digest depends on all blocks before, so that the
blocks after a difference show one that a single digest hides by chance."""
CONTACT_COLUMNS = {
    "time_us": ("time_s", TIME_PLACES),
    "arrival_us": ("arrival_s", TIME_PLACES),
    "x_10nm": ("x_m", POSITION_PLACES),
    "y_10nm": ("y_m", POSITION_PLACES),
    "normal_force_100un": ("normal_force_n", FORCE_PLACES),
    "velocity_x_10um_s": ("velocity_x_m_s", SPEED_PLACES),
    "velocity_y_10um_s": ("velocity_y_m_s", SPEED_PLACES),
}
"""Columns of contacts, each with its name in SI units, and the number of decimal places of these
that it is an integer of."""
TABLES = {
    "blocks": ("number", "position", "skipped", "now_us", "due_100ns", "contacts", "digest"),
    "contacts": ("client", "velocity_known", *CONTACT_COLUMNS),
    "events": ("before_block", "kind", "number"),
}
"""Tables of a file and their columns, which are all integers."""
DAMAGE = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError, msgspec.MsgspecError,
)  # fmt: skip
"""Exceptions of the libraries for a file that is damaged or is no part of a session."""
NAME = re.compile(r"part-(\d{6})\.h5")
"""Names of the files."""


@dataclass(frozen=True)
class SessionBlock:
    """Block of a session.

    Attributes
    ----------
    rendered_from : BlockInput
        What it was rendered from.
    digest : int
        `DIGEST_BITS` of the digest of all blocks up to this one.
    """

    rendered_from: BlockInput
    digest: int


@dataclass(frozen=True)
class SessionEvent:
    """Event between two blocks: an order, silence before playing, or lost records.

    Attributes
    ----------
    kind : Kind
        Kind of the event.
    number : int
        Number of the order, or of lost records.
    """

    kind: Kind
    number: int


class SessionPart:
    """Part of a session, as it was read.

    Parameters
    ----------
    path : Path
        File of the part.

    Attributes
    ----------
    header : SessionHeader
        What the session was played with.
    orders : list of bytes
        Orders that the server sent while the part was recorded, as lines of JSON.
    messages : list of dict
        What happened to the display meanwhile: ``time_s``, ``kind`` and ``detail``.
    """

    def __init__(self, path: Path) -> None:
        try:
            with h5py.File(path, "r") as file:
                self.header = msgspec.json.decode(bytes(file["header"][:]), type=SessionHeader)
                if self.header.format != FORMAT:
                    raise InputError(
                        f"{path}: has format {self.header.format}, must be {FORMAT}; use the "
                        "version of tactile that recorded it, "
                        f"{self.header.versions.get('tactile', 'unknown')}"
                    )
                self._columns = {
                    f"{table}/{name}": _plain(file[table][name])
                    for table, names in TABLES.items()
                    for name in names
                }
                self.orders = bytes(file["orders"][:]).splitlines()
                lines = bytes(file["messages"][:]).splitlines()
            self.messages = [msgspec.json.decode(line, type=dict[str, Any]) for line in lines]
            self._check()
        except InputError:
            raise
        except DAMAGE as error:
            raise InputError(f"{path}: is no part of a session, or damaged: {error}") from error

    def _check(self) -> None:
        """Refuse columns that do not belong together.

        Raises
        ------
        ValueError
            If that is so.
        """
        c = self._columns
        for table, names in TABLES.items():
            columns = [c[f"{table}/{name}"] for name in names]
            if any(column.ndim != 1 or column.dtype.kind not in "iu" for column in columns):
                raise ValueError(f"a column of {table!r} is no list of integers")
            if len({len(column) for column in columns}) != 1:
                raise ValueError(f"the columns of {table!r} differ in length")
        if np.sum(c["blocks/contacts"], dtype=np.int64) != len(c["contacts/client"]):
            raise ValueError("the blocks took more or fewer contacts than there are")
        if not np.isin(c["events/kind"], (Kind.ORDER, Kind.SILENCE, Kind.LOST)).all():
            raise ValueError("there is an unknown kind of event")

    def __iter__(self) -> Iterator[SessionBlock | SessionEvent]:
        """Yield blocks and the events between them, in their order."""
        c = {name: column.tolist() for name, column in self._columns.items()}
        b = {name: column.tolist() for name, column in self.blocks().items()}
        contacts = self._samples()
        events = [
            SessionEvent(Kind(kind), number)
            for kind, number in zip(c["events/kind"], c["events/number"], strict=True)
        ]
        before = c["events/before_block"]
        done = taken = 0
        for k, count in enumerate(c["blocks/contacts"]):
            while done < len(events) and before[done] <= k:
                yield events[done]
                done += 1
            rendered_from = BlockInput(
                c["blocks/number"][k], b["position"][k], b["skipped"][k], b["rendered_s"][k],
                b["due_s"][k], tuple(contacts[taken : taken + count]),
            )  # fmt: skip
            yield SessionBlock(rendered_from, c["blocks/digest"][k])
            taken += count
        yield from events[done:]

    def contacts(self) -> dict[str, NDArray[np.generic]]:
        """Return the contacts in the order in which playback took them.

        Returns
        -------
        dict of str to (K,) array
            ``client``, the number of the client, and in SI units ``time_s``, ``arrival_s``,
            ``x_m``, ``y_m``, ``normal_force_n``, ``velocity_x_m_s`` and ``velocity_y_m_s``. A
            contact that was not valid is NaN, and so is a velocity that the client did not send.
        """
        c = self._columns
        table: dict[str, NDArray[np.generic]] = {"client": c["contacts/client"]}
        for stored, (name, places) in CONTACT_COLUMNS.items():
            known = c["contacts/time_us"] != INVALID
            if name.startswith("velocity"):
                known &= c["contacts/velocity_known"] != 0
            table[name] = np.where(known, c[f"contacts/{stored}"] / 10**places, np.nan)
        return table

    def blocks(self) -> dict[str, NDArray[np.generic]]:
        """Return when and where blocks were rendered.

        Returns
        -------
        dict of str to (B,) array
            ``rendered_s``, the time of rendering; ``due_s``, the time for which it was rendered;
            ``position``, counted in samples since playing began; ``skipped``, whether positions
            before it were left out.
        """
        c = self._columns
        return {
            "rendered_s": c["blocks/now_us"] / 10**TIME_PLACES,
            "due_s": c["blocks/due_100ns"] / 10**DUE_PLACES,
            "position": c["blocks/position"],
            "skipped": c["blocks/skipped"] != 0,
        }

    def _samples(self) -> list[tuple[int, FingerSample]]:
        """Return the contacts, each with its client."""
        table = {name: column.tolist() for name, column in self.contacts().items()}
        known = self._columns["contacts/velocity_known"].tolist()
        return [
            (client, FingerSample(t, at, x, y, force, (vx, vy) if has else None))
            for has, client, t, at, x, y, force, vx, vy in zip(known, *table.values(), strict=True)
        ]


def part_files(folder: Path) -> list[Path]:
    """Return the files of a session.

    Parameters
    ----------
    folder : Path
        Folder of the session.

    Returns
    -------
    list of Path
        File of each part, in order.

    Raises
    ------
    NotFoundError
        If the folder holds no part.
    InputError
        If a part is missing.
    """
    files = {
        int(match[1]): path
        for path in (folder.iterdir() if folder.is_dir() else ())
        if (match := NAME.fullmatch(path.name))
    }
    if not files:
        raise NotFoundError(f"{folder}: holds no session: there is no part-000001.h5")
    for number in range(1, max(files)):
        if number not in files:
            raise InputError(
                f"{folder}: part-{number:06d}.h5 is missing, without which what follows cannot be "
                "rendered"
            )
    return [files[number] for number in sorted(files)]


def write_part(
    folder: Path,
    number: int,
    header: SessionHeader,
    records: NDArray[np.void],
    orders: bytes,
    messages: bytes,
) -> None:
    """Write a part of a session.

    Parameters
    ----------
    folder : Path
        Folder of the session.
    number : int
        Number of the part, from 1.
    header : SessionHeader
        What the session is played with.
    records : (R,) array of `tactile.playback.session_ring.RECORD`
        Records of playback.
    orders : bytes
        Orders of the server, as lines of JSON.
    messages : bytes
        What happened to the display, as lines of JSON.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    content = _content(header, records, orders, messages)
    new = folder / f"part-{number:06d}.new"
    try:
        with open(new, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, folder / f"part-{number:06d}.h5")
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _content(
    header: SessionHeader, records: NDArray[np.void], orders: bytes, messages: bytes
) -> bytes:
    """Return the content of a file, built in memory: HDF5 crashes when the disk is full."""
    with h5py.File("part", "w", driver="core", backing_store=False, libver="latest") as file:
        file["header"] = np.frombuffer(msgspec.json.encode(header), np.uint8)
        for name, text in (("orders", orders), ("messages", messages)):
            _write(file, name, np.frombuffer(text, np.uint8))
        for name, column in _columns(records).items():
            _write(file, name, column)
        file.flush()
        content: bytes = file.id.get_file_image()
    return content


def _columns(records: NDArray[np.void]) -> dict[str, NDArray[np.generic]]:
    """Return the columns of a part."""
    kind, number, values = records["kind"], records["number"], records["values"]
    is_block, is_contact = kind == Kind.BLOCK, kind == Kind.CONTACT
    is_event = ~(is_block | is_contact)
    before = np.cumsum(is_block)
    position, now, due = values[is_block, :3].T
    contacts = values[is_contact]
    valid = (np.abs(contacts) < LARGEST).all(axis=1)  # False for NaN
    contacts = np.where(valid[:, None], contacts, 0.0)
    columns: dict[str, NDArray[np.generic]] = {
        "blocks/number": number[is_block],
        "blocks/position": position.astype(np.int64),
        "blocks/skipped": records["flag"][is_block],
        "blocks/now_us": _whole(now, TIME_PLACES),
        "blocks/due_100ns": _whole(due, DUE_PLACES),
        "blocks/contacts": np.diff(np.cumsum(is_contact)[is_block], prepend=0).astype(np.uint16),
        "blocks/digest": (records["digest"][is_block] & DIGEST_BITS).astype(np.uint16),
        "contacts/client": number[is_contact],
        "contacts/velocity_known": records["flag"][is_contact],
        "events/before_block": before[is_event].astype(np.int64),
        "events/kind": kind[is_event],
        "events/number": number[is_event],
    }
    for (name, (_, places)), column in zip(CONTACT_COLUMNS.items(), contacts.T, strict=True):
        columns[f"contacts/{name}"] = _whole(column, places)
    columns["contacts/time_us"][~valid] = INVALID
    return columns


def _whole(column: NDArray[np.float64], places: int) -> NDArray[np.int64]:
    """Return numbers that have so many decimal places as integers."""
    whole: NDArray[np.int64] = np.rint(column * 10**places).astype(np.int64)
    return whole


def _write(file: h5py.File, name: str, column: NDArray[np.generic]) -> None:
    """Write a column, compressed."""
    differs = column.dtype == np.int64
    if differs:
        column = np.diff(column, prepend=np.int64(0))
    packing = (
        {"shuffle": True, "compression": "gzip", "chunks": column.shape} if column.size else {}
    )
    dataset = file.create_dataset(name, data=column, **packing)
    if differs:
        dataset.attrs["coding"] = "first value, then differences"


def _plain(dataset: h5py.Dataset) -> NDArray[np.generic]:
    """Return the values of a column."""
    column: NDArray[np.generic] = dataset[:]
    return np.cumsum(column) if "coding" in dataset.attrs else column
