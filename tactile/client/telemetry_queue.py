"""Telemetry as it is waited for: a queue that keeps the newest."""

import threading
from collections import deque
from concurrent.futures import Future

from tactile.client.wire import Telemetry, to_number
from tactile.errors import InputError

LONGEST = 64
"""Maximum number of items in a queue; the oldest is dropped for a further one."""


class TelemetryQueue:
    """Telemetry that came and was not read yet; one reader at a time calls `get`.

    Parameters
    ----------
    display : str
        Name of the display.
    rate : float
        Rate of the telemetry [Hz].
    contactor : int, optional
        Contactor whose shear is wanted sample by sample.
    samples : bool
        Whether all that is played is wanted.

    Raises
    ------
    InputError
        If the rate is not above 0.
    """

    def __init__(
        self, display: str, rate: float, contactor: int | None = None, *, samples: bool = False
    ) -> None:
        rate = to_number(rate, "rate [Hz]")
        if not rate > 0:
            raise InputError(f"rate: {rate:g} Hz is not above 0")
        self.display, self.rate, self.contactor, self.samples = display, rate, contactor, samples
        self._lock = threading.Lock()
        self._items: deque[Telemetry] = deque(maxlen=LONGEST)
        self._reader: Future[Telemetry | None] | None = None
        self._closed = False

    def put(self, telemetry: Telemetry) -> int:
        """Hand over an item, from any thread; this never waits.

        Parameters
        ----------
        telemetry : Telemetry
            Newest item.

        Returns
        -------
        int
            Number of items that were dropped for it.
        """
        with self._lock:
            reader, self._reader = self._reader, None
            if reader is None or not reader.set_running_or_notify_cancel():
                full = len(self._items) == LONGEST
                self._items.append(telemetry)
                return int(full)
        reader.set_result(telemetry)
        return 0

    def get(self) -> "Future[Telemetry | None]":
        """Take the oldest item.

        Returns
        -------
        Future
            Future of the item; of None if no more will come.
        """
        future: Future[Telemetry | None] = Future()
        with self._lock:
            if self._items:
                future.set_result(self._items.popleft())
            elif self._closed:
                future.set_result(None)
            else:
                self._reader = future
        return future

    def close(self) -> None:
        """Let no more come; what came may still be read."""
        with self._lock:
            self._closed = True
            reader, self._reader = self._reader, None
        if reader is not None and reader.set_running_or_notify_cancel():
            reader.set_result(None)
