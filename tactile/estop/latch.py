"""The e-stop latch of one display: a file that server, e-stop process and playback all map.

Each of the three counts the e-stops that it was asked for in a word of its own, so that none ever
waits for another, and a process that is stopped or killed at any instant keeps nobody from tripping
the latch. The number of an e-stop is the sum of the three counts. It holds until the server has
written that number, or a later one, as cleared: a clear of an older e-stop never ends a newer one.

The file outlives all processes. Its blocks are there from the beginning, so that a full disk keeps
no e-stop from being written. A file that is damaged is an e-stop.
"""

import hashlib
import mmap
import os
import sys
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from enum import IntEnum
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from tactile.clock import MONOTONIC, Clock
from tactile.errors import BusError, InputError

if sys.platform != "win32":
    import fcntl

MAGIC = 0x31504F5453454354
"""First word of the file: "TCESTOP1", little-endian."""
CLEARED = 4
"""Word that holds the number up to which e-stops were cleared."""
WORDS, TEXT = 8, 248
"""Words of the header; bytes of the note of each writer, after the time of its e-stop."""
SIZE = 8 * WORDS + 3 * (8 + TEXT)
LOCK_WITHIN = 3.0
"""Time that the processes of a daemon that was killed have to let go of the file [s]."""
READ_WRITE = os.O_RDWR | getattr(os, "O_BINARY", 0)
"""Flags with which a latch's file is opened."""
SUFFIX = ".estop"
"""End of the name of each latch's file."""
LONGEST_NAME = 200
"""Characters of a file's name, which file systems hold to 255 bytes."""
UNSAVED = ("sim:",)
"""Devices without any voltage, the latch of which ends with the daemon."""


class LatchWriter(IntEnum):
    """Who trips the latch; the value is the index of its word."""

    SERVER = 1
    ESTOP_PROCESS = 2
    PLAYBACK = 3


class Latch:
    """The latch, mapped.

    Parameters
    ----------
    handle : of the file, as its `Latch.handle` says in the server
    writer : who maps it
    """

    def __init__(self, handle: str, writer: LatchWriter) -> None:
        self.handle, self._writer = handle, writer
        kind, _, what = handle.partition(":")
        self._file = int(what) if kind == "fd" else os.open(what, os.O_RDWR)
        self._map = mmap.mmap(self._file, SIZE)
        self._words: NDArray[np.uint64] = np.frombuffer(self._map, np.uint64, WORDS)

    @classmethod
    def open(cls, device: str, folder: Path, *, clock: Clock = MONOTONIC) -> "Latch":
        """Return the latch of a device for its server, and keep every other program from it.

        Parameters
        ----------
        device : URL of the device that the latch guards
        folder : where latches are kept; created where it is missing
        clock : to wait by for what is left of a program that was killed

        Raises
        ------
        InputError
            Where the file cannot be had.
        BusError
            Where another program has it, perhaps one that was killed and left a hung process.
        """
        if device.startswith(UNSAVED):
            file, name = tempfile.mkstemp(prefix="tactile-estop-")
            path = Path(name)
        else:
            path = folder / file_name(device)
            try:
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                file = os.open(path, READ_WRITE | os.O_CREAT, 0o600)
            except OSError as error:
                raise InputError(
                    f"e-stop latch of {device}: {path}: {error.strerror}; make it writable, or "
                    "set STATE_DIRECTORY to another folder"
                ) from error
            _lock(file, device, path, clock)
        latch = cls._of(file, path, device)
        if device.startswith(UNSAVED) and sys.platform != "win32":
            path.unlink()
        return latch

    @classmethod
    def _of(cls, file: int, path: Path, device: str) -> "Latch":
        """Return the server's latch from a file that it has locked."""
        intact = _is_intact(file)
        if sys.platform == "win32":
            os.close(file)
            latch = cls(f"file:{path}", LatchWriter.SERVER)
        else:
            latch = cls(f"fd:{file}", LatchWriter.SERVER)
        if not intact:
            latch.trip(f"the file of the latch of {device} was damaged")
        return latch

    @property
    def descriptor(self) -> int | None:
        """Descriptor that a child process has to inherit, None where it opens the file itself."""
        kind, _, number = self.handle.partition(":")
        return int(number) if kind == "fd" else None

    @property
    def number(self) -> int:
        """Number of the latest e-stop, 0 where there has been none."""
        return int(self._words[LatchWriter.SERVER : CLEARED].sum())

    @property
    def holds(self) -> int:
        """Number of the e-stop that holds, 0 where none does."""
        number = self.number
        return number if number > int(self._words[CLEARED]) else 0

    @property
    def reason(self) -> str:
        """One line on who tripped it last, and when; empty where nobody did."""
        notes = []
        for writer in LatchWriter:
            at = self._place(writer)
            when = np.frombuffer(self._map, np.float64, 1, at)[0]
            note = self._map[at + 8 : at + 8 + TEXT].rstrip(b"\0").decode(errors="replace")
            notes.append((float(when), note))
        when, note = max(notes)
        return f"{note}, {time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(when))}" if note else ""

    def trip(self, reason: str) -> int:
        """Latch an e-stop; never wait.

        Parameters
        ----------
        reason : who asked for it, in one line

        Returns
        -------
        int
            The number of the e-stop.
        """
        self._words[self._writer] += np.uint64(1)
        self._note(reason)
        return self.number

    def clear(self, number: int) -> None:
        """End the e-stop with a number, and those before it; only the server does that.

        None that is yet to come ends, whatever the number.
        """
        self._words[CLEARED] = max(min(number, self.number), int(self._words[CLEARED]))

    def save(self) -> None:
        """Wait until the disk has it.

        Raises
        ------
        OSError
            Where the disk fails.
        """
        if sys.platform != "linux":
            self._map.flush()  # holds Python's lock; Linux's fsync writes mapped pages as well
        os.fsync(self._file)

    def close(self) -> None:
        """Let go of the file; the server also of its lock, which its children share."""
        if self._writer is LatchWriter.SERVER and sys.platform != "win32":
            fcntl.flock(self._file, fcntl.LOCK_UN)
        del self._words
        self._map.close()
        os.close(self._file)

    def _note(self, reason: str) -> None:
        at = self._place(self._writer)
        np.frombuffer(self._map, np.float64, 1, at)[0] = time.time()
        text = " ".join(reason.split()).encode()[:TEXT]
        self._map[at + 8 : at + 8 + TEXT] = text.ljust(TEXT, b"\0")

    @staticmethod
    def _place(writer: LatchWriter) -> int:
        return 8 * WORDS + (writer - 1) * (8 + TEXT)


def file_name(device: str) -> str:
    """Return the name of the file that latches a device.

    Parameters
    ----------
    device : its URL
    """
    name = quote(device, safe="")
    if len(name) > LONGEST_NAME:
        name = f"{name[: LONGEST_NAME - 20]}~{hashlib.sha256(device.encode()).hexdigest()[:16]}"
    return name + SUFFIX


def inherit_estops(
    heirs: Mapping[str, Latch], used: Collection[str], folder: Path, *, clock: Clock = MONOTONIC
) -> None:
    """Latch the e-stops that hold for the same devices by other URLs.

    An e-stop is not over because somebody edited an option of the URL, or named the device by
    another link (``/dev/serial/by-id/…``; followed where the device is plugged in). Options may
    also choose among several amplifiers of a bus (``nodes`` of CAN): one display too many is
    stopped then. A file that cannot be read is an e-stop.

    Parameters
    ----------
    heirs : latches by URL of the device
    used : URLs of all devices of this daemon, which keep their e-stops
    folder : where latches are kept
    clock : to wait by for what is left of a program that was killed
    """
    kept = {file_name(device) for device in used}
    for path in sorted(folder.glob("*" + SUFFIX)):
        place = _place(unquote(path.name.removesuffix(SUFFIX)))
        latches = [latch for device, latch in heirs.items() if _place(device) == place]
        if latches and path.name not in kept:
            try:
                _hand_on(path, latches, clock)
            except (OSError, BusError) as error:
                for latch in latches:
                    latch.trip(f"e-stop latch {path.name} cannot be taken over: {error}")


def _place(device: str) -> str:
    """Return the URL of a device without its options and links.

    Taken apart as `tactile.bus.registry` does.
    """
    try:
        parts = urlsplit(device)
        is_file = not parts.netloc and os.path.isabs(parts.path)
        path = os.path.realpath(parts.path) if is_file else parts.path
    except ValueError:  # the name of a file that no daemon made
        return device
    return f"{parts.scheme}:{parts.netloc}{path}"


def _hand_on(path: Path, heirs: Sequence[Latch], clock: Clock) -> None:
    """Have latches take over an e-stop that holds, and end it where it was, once that is saved.

    Raises
    ------
    OSError, BusError
        Where the file cannot be opened, or a latch not saved; it still holds then.
    """
    file = os.open(path, READ_WRITE)
    try:
        _lock(file, path.name, path, clock)
    except BusError:
        return  # another daemon has it, and another amplifier of the same bus
    with closing(Latch._of(file, path, path.name)) as old:
        if old.holds:
            for latch in heirs:
                latch.trip(f"{old.reason}, before the URL of the device was edited")
                latch.save()
            old.clear(old.holds)
            old.save()


def _is_intact(file: int) -> bool:
    """Return whether a file holds a latch; make it a new one where it is empty or damaged.

    Raises
    ------
    BusError
        Where the disk is full.
    """
    content = os.read(file, SIZE + 1)
    if len(content) == SIZE:
        words = np.frombuffer(content, np.uint64, WORDS).tolist()
        if words[0] == MAGIC and words[CLEARED] <= sum(words[LatchWriter.SERVER : CLEARED]) < 2**53:
            return True
    os.ftruncate(file, 0)
    os.lseek(file, 0, os.SEEK_SET)
    try:
        written = os.write(file, MAGIC.to_bytes(8, "little") + bytes(SIZE - 8))
    except OSError as error:
        raise BusError(f"an e-stop latch cannot be written: {error.strerror}") from error
    if written != SIZE:
        raise BusError("an e-stop latch cannot be written: the disk is full")
    return not content


def _lock(file: int, device: str, path: Path, clock: Clock) -> None:
    """Keep other daemons from a latch; wait for what is left of one that was killed.

    Raises
    ------
    BusError
        Where another program has it.
    """
    if sys.platform == "win32":
        return  # the device itself lets no second daemon in
    end = clock.now() + LOCK_WITHIN
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if clock.now() > end:
                os.close(file)
                raise BusError(
                    f"e-stop latch of {device}: another program has it ({path}); end that first"
                ) from None
            clock.sleep(0.02)
