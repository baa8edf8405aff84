"""State of a bus, with atomic transitions, so that no call overwrites an e-stop.

E-stops are counted when they begin, and again when the driver has carried them out. A bus is
e-stopped as long as there were more e-stops than have been cleared, whatever else it does: no other
transition touches these counts, and a clear ends only the e-stops that it has seen carried out.
"""

import threading
from typing import Literal

BusState = Literal["idle", "running", "estopped", "closed"]


class States:
    """State of one bus; every method may be called from any thread and from a signal handler.

    Attributes
    ----------
    estops : int
        Number of e-stops that have begun.
    interrupted : bool
        Whether playing ended without a stop: by an e-stop, or because the amplifier went to 0 V by
        itself. The thread that writes may not know of it yet.
    """

    def __init__(self) -> None:
        self.estops = self._ended = self._cleared = 0
        self.interrupted = False
        self._activity: Literal["idle", "running", "closed"] = "idle"
        # Held for a few instructions only. Reentrant, since a signal handler may call `estop`
        # while the thread that it interrupts holds the lock.
        self._lock = threading.RLock()

    @property
    def running(self) -> bool:
        """Whether the bus was started and has not come to rest since."""
        return self._activity == "running"

    @property
    def now(self) -> BusState:
        """Present state; "estopped" as long as an e-stop has not been cleared."""
        if self._activity != "closed" and self.estops > self._cleared:
            return "estopped"
        return self._activity

    @property
    def estop_under_way(self) -> bool:
        """Whether the driver is still carrying out an e-stop."""
        return self.estops > self._ended

    def begin(self, estops: int) -> None:
        """Become running, unless an e-stop came since the caller counted them.

        Parameters
        ----------
        estops : int
            Value of `estops` when the caller began to start.
        """
        with self._lock:
            if self.estops == estops:
                self._activity, self.interrupted = "running", False

    def rest(self) -> bool:
        """Become idle because the caller wants to stop, and forget an interruption.

        Returns
        -------
        bool
            Whether the bus was running, so that the driver has something to stop.
        """
        with self._lock:
            was_running, self.interrupted = self.running, False
            if was_running:
                self._activity = "idle"
            return was_running

    def fall(self) -> None:
        """Become idle because the amplifier went to 0 V by itself; do nothing unless running."""
        with self._lock:
            if self.running:
                self._activity, self.interrupted = "idle", True

    def close(self) -> None:
        """Become closed, for good."""
        with self._lock:
            self._activity, self.interrupted = "closed", False

    def estop(self) -> bool:
        """Begin an e-stop, unless the bus is closed.

        Returns
        -------
        bool
            Whether the e-stop began, so that the driver has to act and `end_estop` must follow.
        """
        with self._lock:
            if self._activity == "closed":
                return False
            self.interrupted |= self.running
            self._activity = "idle"
            self.estops += 1
            return True

    def end_estop(self) -> None:
        """Record that the driver has carried out an e-stop."""
        with self._lock:
            self._ended += 1

    def trip(self) -> None:
        """Become e-stopped because the amplifier is; do nothing if that is known already."""
        with self._lock:
            if self.now != "estopped" and self.estop():
                self.end_estop()

    def clear(self, estops: int) -> None:
        """Clear e-stops and become idle, unless the bus is closed.

        Parameters
        ----------
        estops : int
            Number of e-stops that are cleared, counted from the first; later ones hold.
        """
        with self._lock:
            self._cleared = estops
            if self._activity != "closed":
                self._activity = "idle"
