"""Time for whoever reads it or waits: the host's, a model's, or a simulation's.

Code that runs in a thread is given a `Clock`. Coroutines need none: their event loop is their
clock, by which `asyncio.sleep` and `asyncio.timeout` go, and which `loop_time` reads.
"""

import asyncio
import threading
import time
from typing import Protocol


class Clock(Protocol):
    """What tells the time and lets it pass."""

    def now(self) -> float:
        """Return the time [s]; it never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass; nothing, where the seconds are negative."""
        ...

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Let time pass, or less of it where an event is set."""
        ...


class MonotonicClock:
    """The host's clock, `time.monotonic`: that of event loops and of all processes of the host."""

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(max(seconds, 0.0))

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Let time pass, or less of it where an event is set."""
        event.wait(max(seconds, 0.0))


MONOTONIC = MonotonicClock()


def loop_time() -> float:
    """Return the time of the running event loop [s]; that of asyncio's own is `time.monotonic`."""
    return asyncio.get_running_loop().time()


class ModelClock:
    """Time that goes while somebody waits."""

    def __init__(self) -> None:
        self.time = 1.0

    def now(self) -> float:
        """Return the time [s]."""
        return self.time

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.time += max(seconds, 0.0)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Let time pass: nobody else is there to set an event."""
        self.sleep(seconds)
