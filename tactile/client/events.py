"""Dispatchers of events to callbacks, none of which holds up a request: a thread, or tasks."""

import asyncio
import inspect
import logging
import queue
import threading
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from tactile.client.wire import Event, excerpt
from tactile.errors import InputError

logger = logging.getLogger("tactile.client")

LONGEST = 256
"""Maximum number of events that wait or are being handled; further ones are dropped."""

Callback = Callable[[Event], Any]
"""Function that takes an event."""


def as_callback(callback: Callback) -> Callback:
    """Return a callback that can be called.

    Parameters
    ----------
    callback : Callable
        Callback as the program gave it.

    Returns
    -------
    Callable
        The same.

    Raises
    ------
    InputError
        If it cannot be called.
    """
    if not callable(callback):
        raise InputError(f"callback: {excerpt(callback)} is not a function")
    return callback


class Dispatcher(ABC):
    """Dispatcher of events to callbacks; `ThreadDispatcher` and `TaskDispatcher` say where.

    Parameters
    ----------
    counters : Counter
        Counters, of which ``dropped_events`` is incremented for each event that is dropped.
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._lock = threading.Lock()
        self._callbacks: tuple[Callback, ...] = ()
        self._calls = 0  # number of calls that wait or run

    def add(self, callback: Callback) -> None:
        """Call back to one more function from now on.

        Parameters
        ----------
        callback : Callable
            Function to call with each event; one that is there already is still called once.
        """
        with self._lock:
            if callback not in self._callbacks:
                self._callbacks = (*self._callbacks, callback)

    def put(self, event: Event) -> None:
        """Hand over an event, from any thread; this never waits.

        Parameters
        ----------
        event : Event
            Event for all callbacks.
        """
        callbacks = self._callbacks
        with self._lock:
            if self._calls + len(callbacks) > LONGEST * len(callbacks):
                self._counters["dropped_events"] += 1
                return
            self._calls += len(callbacks)
        for callback in callbacks:
            self._hand_over(callback, event)

    @abstractmethod
    def _hand_over(self, callback: Callback, event: Event) -> None:
        """Let a callback be called elsewhere, from any thread."""

    @contextmanager
    def _calling(self, event: Event) -> Iterator[None]:
        """Log what is wrong with a callback, and count the call as done."""
        try:
            yield
        except Exception:
            logger.exception("a callback failed for %s", event)
        finally:
            with self._lock:
                self._calls -= 1

    @abstractmethod
    async def close(self, timeout: float) -> None:
        """End all calls, except the one that closes.

        Parameters
        ----------
        timeout : float
            Longest wait for a callback that is busy [s].
        """


class ThreadDispatcher(Dispatcher):
    """Dispatcher that calls back in a thread of its own, which starts with the first callback.

    A callback may therefore wait, and use displays.
    """

    def __init__(self, counters: Counter[str]) -> None:
        super().__init__(counters)
        self._closed = False
        self._queue: queue.SimpleQueue[tuple[Callback, Event] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def add(self, callback: Callback) -> None:
        """Call back to one more function from now on.

        Parameters
        ----------
        callback : Callable
            Function to call with each event; one that is there already is still called once.
        """
        super().add(callback)
        with self._lock:
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(
                    target=self._run, name="tactile-events", daemon=True
                )
                self._thread.start()

    def _hand_over(self, callback: Callback, event: Event) -> None:
        self._queue.put((callback, event))

    def _run(self) -> None:
        while (call := self._queue.get()) is not None and not self._closed:
            callback, event = call
            with self._calling(event):
                callback(event)

    async def close(self, timeout: float) -> None:
        """End the thread.

        Parameters
        ----------
        timeout : float
            Longest wait for a callback that is busy [s]; none where a callback closes.
        """
        with self._lock:
            self._closed = True
            thread = self._thread
        self._queue.put(None)
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout)


class TaskDispatcher(Dispatcher):
    """Dispatcher in the program's event loop, where a coroutine function runs as a task."""

    def __init__(self, counters: Counter[str]) -> None:
        super().__init__(counters)
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Call back in the running event loop; do this before the first event."""
        self._loop = asyncio.get_running_loop()

    def _hand_over(self, callback: Callback, event: Event) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._begin, callback, event)

    def _begin(self, callback: Callback, event: Event) -> None:
        task = self._loop.create_task(self._call(callback, event))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _call(self, callback: Callback, event: Event) -> None:
        with self._calling(event):
            result = callback(event)
            if inspect.isawaitable(result):
                await result

    async def close(self, timeout: float) -> None:
        """Cancel all tasks, except the one that closes.

        Parameters
        ----------
        timeout : float
            Longest wait for a task that does not end although it is canceled [s].
        """
        busy = self._tasks - {asyncio.current_task()}
        for task in busy:
            task.cancel()
        if busy:
            await asyncio.wait(busy, timeout=timeout)
