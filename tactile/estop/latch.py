"""E-stop latch of one display: a file mapped by the server, the e-stop process and playback.

Each of the three processes counts the e-stops that it was asked for in a word of its own. None ever
waits for another, and a process that is stopped or killed at any instant prevents nobody from
tripping the latch. The number of an e-stop is the sum of the three counts. The e-stop holds until
the server has written that number, or a later one, as cleared. Clearing an older e-stop therefore
never ends a newer one.

The file outlives all processes. Its blocks are allocated from the beginning, so that a full disk
does not prevent an e-stop from being written. A damaged file counts as an e-stop.
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
"""Index of the word that holds the number up to which e-stops were cleared."""
WORDS, TEXT = 8, 248
"""Number of words of the header, and size of each writer's note after the time of its e-stop
[bytes]."""
SIZE = 8 * WORDS + 3 * (8 + TEXT)
"""Size of the file [bytes]."""
LOCK_WITHIN = 3.0
"""Time that the processes of a killed server have to release the file [s]."""
READ_WRITE = os.O_RDWR | getattr(os, "O_BINARY", 0)
"""Flags with which the file of a latch is opened."""
SUFFIX = ".estop"
"""Suffix of the file name of every latch."""
LONGEST_NAME = 200
"""Maximum length of a file name without its suffix [characters]; file systems allow 255 bytes."""
UNSAVED = ("sim:",)
"""Prefixes of the URLs of devices without any voltage, whose latch ends with the server."""


class LatchWriter(IntEnum):
    """Process that trips a latch; the value is the index of its word."""

    SERVER = 1
    ESTOP_PROCESS = 2
    PLAYBACK = 3


class Latch:
    """E-stop latch of a device, mapped into this process.

    Parameters
    ----------
    handle : str
        Handle of the file, as given by `Latch.handle` in the server.
    writer : LatchWriter
        Process that maps the file.

    Attributes
    ----------
    handle : str
        "fd:" and an inherited descriptor, or "file:" and a path.
    """

    def __init__(self, handle: str, writer: LatchWriter) -> None:
        self.handle, self._writer = handle, writer
        kind, _, address = handle.partition(":")
        self._file = int(address) if kind == "fd" else os.open(address, os.O_RDWR)
        self._map = mmap.mmap(self._file, SIZE)
        self._words: NDArray[np.uint64] = np.frombuffer(self._map, np.uint64, WORDS)

    @classmethod
    def open(cls, device: str, folder: Path, *, clock: Clock = MONOTONIC) -> "Latch":
        """Open the latch of a device in its server and lock out every other program.

        Parameters
        ----------
        device : str
            URL of the device that the latch guards.
        folder : Path
            Folder of the latches, which is created if it does not exist.
        clock : Clock
            Clock for waiting until the processes of a killed program have released the file.

        Returns
        -------
        Latch
            The latch, written as `LatchWriter.SERVER`. It is tripped if its file was damaged.

        Raises
        ------
        InputError
            If the file cannot be opened.
        BusError
            If another program has it, perhaps one that was killed and left a hung process.
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
        """Return the server's latch of a file that the server has locked."""
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
        """Descriptor that a child process must inherit; None if the child opens the file itself."""
        kind, _, number = self.handle.partition(":")
        return int(number) if kind == "fd" else None

    @property
    def number(self) -> int:
        """Number of the latest e-stop, 0 if there has been none."""
        return int(self._words[LatchWriter.SERVER : CLEARED].sum())

    @property
    def holds(self) -> int:
        """Number of the e-stop that holds, 0 if none does."""
        number = self.number
        return number if number > int(self._words[CLEARED]) else 0

    @property
    def reason(self) -> str:
        """Line that says who tripped the latch last, and when; empty if nobody did."""
        notes = []
        for writer in LatchWriter:
            offset = self._note_offset(writer)
            when = np.frombuffer(self._map, np.float64, 1, offset)[0]
            note = self._map[offset + 8 : offset + 8 + TEXT].rstrip(b"\0").decode(errors="replace")
            notes.append((float(when), note))
        when, note = max(notes)
        return f"{note}, {time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(when))}" if note else ""

    def trip(self, reason: str) -> int:
        """Latch an e-stop, without waiting for anything.

        Parameters
        ----------
        reason : str
            Who asked for it, in one line.

        Returns
        -------
        int
            Number of the e-stop.
        """
        self._words[self._writer] += np.uint64(1)
        self._note(reason)
        return self.number

    def clear(self, number: int) -> None:
        """End the e-stop with a number, and all before it; only the server may do so.

        An e-stop that is yet to come is not ended, whatever the number.

        Parameters
        ----------
        number : int
            Number of the e-stop.
        """
        self._words[CLEARED] = max(min(number, self.number), int(self._words[CLEARED]))

    def save(self) -> None:
        """Write the latch to the disk, and wait until it is there.

        Raises
        ------
        OSError
            If the disk fails.
        """
        if sys.platform != "linux":
            # flush holds the interpreter lock; on Linux fsync alone writes mapped pages as well
            self._map.flush()
        os.fsync(self._file)

    def close(self) -> None:
        """Unmap and close the file.

        The server also releases its lock, which its child processes share.
        """
        if self._writer is LatchWriter.SERVER and sys.platform != "win32":
            fcntl.flock(self._file, fcntl.LOCK_UN)
        del self._words
        self._map.close()
        os.close(self._file)

    def _note(self, reason: str) -> None:
        """Write the time and the reason of this writer's latest e-stop."""
        offset = self._note_offset(self._writer)
        np.frombuffer(self._map, np.float64, 1, offset)[0] = time.time()
        text = " ".join(reason.split()).encode()[:TEXT]
        self._map[offset + 8 : offset + 8 + TEXT] = text.ljust(TEXT, b"\0")

    @staticmethod
    def _note_offset(writer: LatchWriter) -> int:
        """Return the offset of a writer's note in the file [bytes]."""
        return 8 * WORDS + (writer - 1) * (8 + TEXT)


def file_name(device: str) -> str:
    """Return the name of the file that latches a device.

    Parameters
    ----------
    device : str
        URL of the device.

    Returns
    -------
    str
        The URL, percent-encoded; a long one is shortened and completed by its hash.
    """
    name = quote(device, safe="")
    if len(name) > LONGEST_NAME:
        name = f"{name[: LONGEST_NAME - 20]}~{hashlib.sha256(device.encode()).hexdigest()[:16]}"
    return name + SUFFIX


def inherit_estops(
    heirs: Mapping[str, Latch], used: Collection[str], folder: Path, *, clock: Clock = MONOTONIC
) -> None:
    """Take over the e-stops that hold for the same devices under other URLs.

    An e-stop does not end because somebody edited an option of the URL, or named the device by
    another link (``/dev/serial/by-id/…``, which is followed if the device is plugged in). Options
    may also select among several amplifiers of a bus (``nodes`` of CAN); in that case one display
    too many is stopped. A file that cannot be read counts as an e-stop.

    Parameters
    ----------
    heirs : mapping of str to Latch
        Latches that take over, by URL of the device.
    used : collection of str
        URLs of all devices of this server, which keep their e-stops.
    folder : Path
        Folder of the latches.
    clock : Clock
        Clock for waiting until the processes of a killed program have released a file.
    """
    used_names = {file_name(device) for device in used}
    for path in sorted(folder.glob("*" + SUFFIX)):
        key = _device_key(unquote(path.name.removesuffix(SUFFIX)))
        latches = [latch for device, latch in heirs.items() if _device_key(device) == key]
        if latches and path.name not in used_names:
            try:
                _transfer_estop(path, latches, clock)
            except (OSError, BusError) as error:
                for latch in latches:
                    latch.trip(f"e-stop latch {path.name} cannot be taken over: {error}")


def _device_key(device: str) -> str:
    """Return the URL of a device without its options and links.

    It is split as in `tactile.bus.registry`.
    """
    try:
        parts = urlsplit(device)
        is_file = not parts.netloc and os.path.isabs(parts.path)
        path = os.path.realpath(parts.path) if is_file else parts.path
    except ValueError:  # the file was not made by a server
        return device
    return f"{parts.scheme}:{parts.netloc}{path}"


def _transfer_estop(path: Path, heirs: Sequence[Latch], clock: Clock) -> None:
    """Trip latches for an e-stop that holds in a file, then clear it there, once they are saved.

    Raises
    ------
    OSError, BusError
        If the file cannot be opened or a latch cannot be saved; the e-stop in the file still holds
        then.
    """
    file = os.open(path, READ_WRITE)
    try:
        _lock(file, path.name, path, clock)
    except BusError:
        return  # another server has it, for another amplifier of the same bus
    with closing(Latch._of(file, path, path.name)) as old:
        if old.holds:
            for latch in heirs:
                latch.trip(f"{old.reason}, before the URL of the device was edited")
                latch.save()
            old.clear(old.holds)
            old.save()


def _is_intact(file: int) -> bool:
    """Return whether a file holds a latch; initialize it if it is empty or damaged.

    A new, empty file counts as intact.

    Raises
    ------
    BusError
        If the disk is full.
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
    """Lock out other servers from a latch; wait for the processes of one that was killed.

    Raises
    ------
    BusError
        If another program has the lock.
    """
    if sys.platform == "win32":
        return  # there, the device itself cannot be opened by a second server
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
