"""Clocks: the host's, that of a model, and that of a simulation.

Code that runs in a thread is given a `Clock`. Coroutines need none: their event loop is their
clock, which `asyncio.sleep` and `asyncio.timeout` use and `loop_time` reads.
"""

import asyncio
import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Interface of a clock that tells the time and can wait."""

    def now(self) -> float:
        """Return the time, which never decreases.

        Returns
        -------
        float
            Time [s].
        """
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for a duration.

        Parameters
        ----------
        seconds : float
            Duration [s]; a negative one returns at once.
        """
        ...

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait until an event is set, but no longer than a duration.

        Parameters
        ----------
        event : threading.Event
            Event that ends the wait early.
        seconds : float
            Longest duration [s].
        """
        ...


class MonotonicClock:
    """The host's clock, `time.monotonic`, which event loops and all processes of the host share."""

    def now(self) -> float:
        """Return the time.

        Returns
        -------
        float
            Time [s].
        """
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for a duration.

        Parameters
        ----------
        seconds : float
            Duration [s]; a negative one returns at once.
        """
        time.sleep(max(seconds, 0.0))

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Wait until an event is set, but no longer than a duration.

        Parameters
        ----------
        event : threading.Event
            Event that ends the wait early.
        seconds : float
            Longest duration [s].
        """
        event.wait(max(seconds, 0.0))


MONOTONIC = MonotonicClock()
"""Shared instance of the host's clock."""


def loop_time() -> float:
    """Return the time of the running event loop; for asyncio's own loops it is `time.monotonic`.

    Returns
    -------
    float
        Time [s].
    """
    return asyncio.get_running_loop().time()


class ModelClock:
    """Clock of a model, whose time advances only while somebody waits.

    Attributes
    ----------
    time : float
        Time of the model [s].
    """

    def __init__(self) -> None:
        self.time = 1.0

    def now(self) -> float:
        """Return the time of the model.

        Returns
        -------
        float
            Time [s].
        """
        return self.time

    def sleep(self, seconds: float) -> None:
        """Advance the time of the model.

        Parameters
        ----------
        seconds : float
            Duration [s]; a negative one changes nothing.
        """
        self.time += max(seconds, 0.0)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Advance the time of the model; in a model nobody else can set the event meanwhile.

        Parameters
        ----------
        event : threading.Event
            Event, which is ignored.
        seconds : float
            Duration [s].
        """
        self.sleep(seconds)
