"""Calling back with events, in a thread for that, so that a callback may wait and use displays."""

import logging
import queue
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tactile.client.wire import Event

logger = logging.getLogger("tactile.client")

LONGEST = 256
"""Events that wait; what comes then is dropped."""

Callback = Callable[[Event], Any]


class Dispatcher:
    """Calls back; its thread starts with the first callback.

    Parameters
    ----------
    counters : where ``dropped_events`` is counted
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._events: queue.Queue[Event | None] = queue.Queue(LONGEST)
        self._callbacks: tuple[Callback, ...] = ()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._lock = threading.Lock()

    def add(self, callback: Callback) -> None:
        """Call this one as well from now on."""
        with self._lock:
            if callback not in self._callbacks:
                self._callbacks = (*self._callbacks, callback)
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(
                    target=self._run, name="tactile-events", daemon=True
                )
                self._thread.start()

    def put(self, event: Event) -> None:
        """Hand over an event; never waits."""
        if self._callbacks:
            try:
                self._events.put_nowait(event)
            except queue.Full:
                self._counters["dropped_events"] += 1

    def _run(self) -> None:
        while (event := self._events.get()) is not None and not self._closed:
            for callback in self._callbacks:
                try:
                    callback(event)
                except Exception:
                    logger.exception("callback for %s", event)

    def close(self, timeout: float) -> None:
        """End the thread, unless a callback is busy for longer than the timeout [s]."""
        with self._lock:
            self._closed = True
            thread = self._thread
        if thread is None or thread is threading.current_thread():
            return
        with suppress(queue.Full):  # it sees that it is closed with the next event
            self._events.put_nowait(None)
        thread.join(timeout)
