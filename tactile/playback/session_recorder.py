"""Program that records the session of one display: what its playback rendered from.

It is a process of its own beside the server and playback, which never wait for it: records come
through a ring in shared memory, orders and messages through a pipe. When the pipe ends, because the
server has ended or was killed, it writes what it has and ends.
"""

import datetime
import os
import queue
import shutil
import signal
import threading
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from tactile.clock import MONOTONIC, Clock
from tactile.playback.origin import present_versions
from tactile.playback.session_messages import (
    NumberedOrder,
    RecorderAnswer,
    SessionHeader,
    SessionMessage,
    SessionSetup,
)
from tactile.playback.session_orders import encoded
from tactile.playback.session_parts import write_part
from tactile.playback.session_ring import RECORD, RECORDS, Kind, SessionRing
from tactile.processes import pipes_of_parent, received, send

LOOK = 0.5
"""Interval between looks at the ring [s]."""
PART = 60.0
"""Longest duration of a part [s]; a kill of this process loses the one that is not written yet."""
MOST_MESSAGES = 2000
"""Maximum number of messages that wait to be collected, of 30 kB at most but for effects that are
played by name (2 MB for a minute). The server counts what it cannot send while that many wait
because a disk is slow."""
MOST_RECORDS = 8 * RECORDS
"""Number of records after which a part is written before its time: 19 MB."""
MOST_TEXT = 8 << 20
"""Size of orders and messages after which a part is written before its time [bytes]."""
LEAST_FREE = 256 << 20
"""Free space of the disk below which recording ends [bytes]."""
NICE = 10
"""Niceness of the process, so that it yields to playback and the server."""


class SessionRecorder:
    """Recorder of a session.

    Parameters
    ----------
    folder : Path
        Folder of the session, which exists and is empty.
    header : SessionHeader
        What the session is played with.
    ring : SessionRing
        Ring that playback writes to.
    """

    def __init__(self, folder: Path, header: SessionHeader, ring: SessionRing) -> None:
        self._folder, self._header, self._ring = folder, header, ring
        self._records: list[NDArray[np.void]] = []
        self._messages: queue.Queue[NumberedOrder | SessionMessage] = queue.Queue(MOST_MESSAGES)
        self._orders, self._news = bytearray(), bytearray()
        self._part, self._begun = 0, -np.inf

    def take(self, message: NumberedOrder | SessionMessage) -> None:
        """Take a message of the server, from another thread; wait while too many wait.

        Parameters
        ----------
        message : NumberedOrder or SessionMessage
            The message.
        """
        self._messages.put(message)

    def turn(self, now: float, *, last: bool = False) -> None:
        """Collect what has come, and write a part if it is time for one.

        Parameters
        ----------
        now : float
            Time in the host's clock [s].
        last : bool
            Whether this is the last call, which writes everything.

        Raises
        ------
        OSError
            If a part cannot be written, or the disk has less than `LEAST_FREE` left.
        """
        rows = self._ring.take()  # before the messages, with which the orders in it come
        if len(rows):
            self._records.append(rows)
        with suppress(queue.Empty):
            while True:
                self._add(self._messages.get_nowait())
        if self._begun == -np.inf:
            self._begun = now
        count, text = sum(map(len, self._records)), len(self._orders) + len(self._news)
        full = count >= MOST_RECORDS or text >= MOST_TEXT
        if last or full or now - self._begun >= PART:
            self._write()
            self._begun = now

    def _add(self, message: NumberedOrder | SessionMessage) -> None:
        if isinstance(message, NumberedOrder):
            self._orders += encoded(message.number, message.order)
        else:
            news = {"time_s": message.time, **vars(message.news)}
            self._news += msgspec.json.encode(news) + b"\n"

    def _write(self) -> None:
        """Write a part, but contacts only together with the block that took them."""
        if not (self._records or self._orders or self._news):
            return
        if shutil.disk_usage(self._folder).free < LEAST_FREE:
            raise OSError(f"less than {LEAST_FREE >> 20} MiB of the disk are free")
        rows = np.concatenate([np.zeros(0, RECORD), *self._records])
        whole = np.flatnonzero(rows["kind"] != Kind.CONTACT)
        end = int(whole[-1]) + 1 if len(whole) else 0
        self._part += 1
        write_part(
            self._folder, self._part, self._header, rows[:end], bytes(self._orders),
            bytes(self._news),
        )  # fmt: skip
        self._records = [rows[end:]] if end < len(rows) else []
        self._orders, self._news = bytearray(), bytearray()


def new_folder(parent: Path, name: str) -> Path:
    """Create the folder of a session, with a name that no other has.

    Parameters
    ----------
    parent : Path
        Folder of all sessions.
    name : str
        Name of the display.

    Returns
    -------
    Path
        New folder, named by display and time.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    time = datetime.datetime.now(datetime.UTC)
    for _ in range(1000):
        folder = parent / f"{name}-{time:%Y%m%dT%H%M%SZ}"
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
        time += datetime.timedelta(seconds=1)
    raise FileExistsError(f"{folder}: exists, as do 999 before it")


def completed(header: SessionHeader, now: float) -> SessionHeader:
    """Return the header of a session that begins now.

    Parameters
    ----------
    header : SessionHeader
        Header without versions and time.
    now : float
        Time in the host's clock [s].

    Returns
    -------
    SessionHeader
        Header with the versions of all that the drive depends on, and with the time.
    """
    utc = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    return msgspec.structs.replace(header, versions=present_versions(), begun_s=now, begun_utc=utc)


def main(clock: Clock = MONOTONIC) -> None:
    """Record as the server says on standard input, until that ends."""
    inward, outward = pipes_of_parent()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the end of the pipe ends it
    setup: SessionSetup | None = next(received(inward), None)
    if setup is None:
        return
    with suppress(AttributeError, OSError):
        os.nice(NICE)
    header = completed(setup.header, clock.now())
    try:
        folder = new_folder(Path(setup.folder), header.name)
        recorder = SessionRecorder(folder, header, SessionRing(setup.ring))
        send(outward, RecorderAnswer(str(folder)))
        ended = threading.Event()

        def read() -> None:
            try:
                for message in received(inward):
                    recorder.take(message)
            finally:
                ended.set()

        threading.Thread(target=read, name="tactile-session", daemon=True).start()
        last = False
        while not last:
            clock.wait(ended, LOOK)
            last = ended.is_set()  # read once, so that what came before the end is written
            recorder.turn(clock.now(), last=last)
    except OSError as error:
        with suppress(OSError):
            send(outward, RecorderAnswer(failure=f"{setup.folder}: {error.strerror or error}"))
