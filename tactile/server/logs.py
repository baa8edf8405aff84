"""Logging of the server: lines of text or JSON, written by a thread that nobody waits for.

A full disk, or a standard error that is closed or not read, costs lines, which are counted, and
nothing else. Fields are passed as ``extra={"fields": {...}}``; they never contain a token.
"""

import json
import logging
import os
import queue
import sys
import time
from collections.abc import Callable
from logging.handlers import QueueHandler, QueueListener
from typing import Any

from tactile.clock import MONOTONIC
from tactile.errors import InputError
from tactile.server.config import LogConfig

MOST_WAITING = 1000
"""Maximum number of records that wait to be written."""
MOST_ALIKE = 10
"""Maximum number of records of one kind per second; further ones are only counted."""
PATIENCE = 1.0
"""Time that the end of the program waits for the last lines [s]."""


def fields_of(record: logging.LogRecord) -> dict[str, Any]:
    """Return what a record holds besides its message.

    Parameters
    ----------
    record : logging.LogRecord
        Any record.

    Returns
    -------
    dict of str to Any
        Fields by name.
    """
    fields: dict[str, Any] = getattr(record, "fields", {})
    return fields


class TextFormatter(logging.Formatter):
    """Formatter of lines ``2025-11-21T20:25:00.123Z INFO server: client connected session=…``."""

    converter = staticmethod(time.gmtime)

    def __init__(self) -> None:
        super().__init__(
            "%(asctime)s.%(msecs)03dZ %(levelname)s %(short)s: %(message)s%(rest)s",
            "%Y-%m-%dT%H:%M:%S",
        )

    def format(self, record: logging.LogRecord) -> str:
        """Format a record.

        Parameters
        ----------
        record : logging.LogRecord
            Any record.

        Returns
        -------
        str
            The line.
        """
        record.short = record.name.rpartition(".")[2]
        record.rest = "".join(f" {key}={value!r}" for key, value in fields_of(record).items())
        return super().format(record)


class JsonFormatter(TextFormatter):
    """Formatter of one JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record.

        Parameters
        ----------
        record : logging.LogRecord
            Any record.

        Returns
        -------
        str
            The line.
        """
        line = {
            "time": f"{self.formatTime(record, self.datefmt)}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **fields_of(record),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


class Gate(QueueHandler):
    """Handler that queues records for the writing thread and counts those that it drops.

    Parameters
    ----------
    waiting : queue.Queue
        Queue of the writing thread.
    clock : callable
        Function that returns the time [s].

    Attributes
    ----------
    dropped : int
        Number of records that were dropped.
    """

    def __init__(self, waiting: "queue.Queue[Any]", clock: Callable[[], float]) -> None:
        super().__init__(waiting)
        self.dropped = 0
        self._clock, self._second, self._alike = clock, 0, dict[str, int]()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record, unless there were too many of its kind in this second.

        Parameters
        ----------
        record : logging.LogRecord
            Any record.
        """
        second = int(self._clock())
        if second != self._second:
            self._second, self._alike = second, {}
        kind = f"{record.name} {str(record.msg)[:80]}"
        count = self._alike[kind] = self._alike.get(kind, 0) + 1
        if count > MOST_ALIKE:
            self.dropped += 1
        else:
            super().emit(record)

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """Return the record unchanged, as the writing thread formats it.

        Parameters
        ----------
        record : logging.LogRecord
            Any record.

        Returns
        -------
        logging.LogRecord
            The same record.
        """
        return record

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 — logging's name
        """Count a record for which the queue had no room.

        Parameters
        ----------
        record : logging.LogRecord
            The record.
        """
        self.dropped += 1


class LineHandler(logging.Handler):
    """Handler that writes lines to a file descriptor, unbuffered, and counts those that fail.

    Only one thread writes. There is neither a lock nor a buffer that the end of the program would
    wait for if that thread were waiting for somebody who does not read.

    Parameters
    ----------
    descriptor : int
        Descriptor of the file.

    Attributes
    ----------
    failed : int
        Number of lines that could not be written.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self.lock = None
        self.failed = 0
        self._descriptor = descriptor

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record.

        Parameters
        ----------
        record : logging.LogRecord
            Any record.
        """
        try:
            line = (self.format(record) + "\n").encode("utf-8", "backslashreplace")
            while line:
                line = line[os.write(self._descriptor, line) :]
        except (OSError, ValueError, TypeError):
            self.failed += 1


class LogWriter(QueueListener):
    """Thread that writes the records of a queue.

    Parameters
    ----------
    waiting : queue.Queue
        Queue of records.
    sink : logging.Handler
        Handler that writes them.
    """

    def __init__(self, waiting: "queue.Queue[Any]", sink: logging.Handler) -> None:
        super().__init__(waiting, sink)
        self._waiting = waiting

    def stop(self) -> None:
        """Write the records that wait, but do not wait for a file that nobody reads."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        try:
            self._waiting.put(None, timeout=PATIENCE / 2)
        except queue.Full:
            return
        thread.join(PATIENCE)


class Logs:
    """Logging of the server while it runs; `close` restores the logging that was there before.

    Parameters
    ----------
    config : LogConfig
        What is logged, and where.
    clock : callable
        Function that returns the time [s].

    Raises
    ------
    InputError
        If the file cannot be opened.
    """

    def __init__(self, config: LogConfig, *, clock: Callable[[], float] = MONOTONIC.now) -> None:
        self._sink = LineHandler(_descriptor(config.file))
        self._sink.setFormatter(JsonFormatter() if config.format == "json" else TextFormatter())
        waiting: queue.Queue[Any] = queue.Queue(MOST_WAITING)
        self._gate, self._writer = Gate(waiting, clock), LogWriter(waiting, self._sink)
        self._root = logging.getLogger()
        self._before = self._root.handlers[:], self._root.level
        self._root.handlers[:] = [self._gate]
        self._root.setLevel(config.level.upper())
        self._writer.start()

    @property
    def dropped(self) -> int:
        """Number of records that were not written: too many, no room, or no disk."""
        return self._gate.dropped + self._sink.failed

    def close(self) -> None:
        """Write the records that wait, for at most a second; may be called repeatedly."""
        if self._gate in self._root.handlers:
            self._root.handlers[:] = self._before[0]
            self._root.setLevel(self._before[1])
            self._writer.stop()


def _descriptor(file: str | None) -> int:
    """Open a file for appending and return its descriptor, or that of standard error if any."""
    if not file:
        if sys.stderr is None:
            return os.open(os.devnull, os.O_WRONLY)
        try:
            return os.dup(sys.stderr.fileno())
        except (OSError, ValueError):
            return os.open(os.devnull, os.O_WRONLY)
    try:
        return os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o640)
    except OSError as error:
        raise InputError(f"log.file = {file!r}: cannot be written: {error.strerror}") from error
