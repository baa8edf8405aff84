"""What a bus does, changed one step at a time, so that no call overwrites an e-stop.

E-stops are counted when they begin and when the driver has done what they ask. A bus is e-stopped
as long as there were more e-stops than have been cleared, whatever else it does: no other change
touches that count, and a clear ends only the e-stops that it has seen end.
"""

import threading
from typing import Literal

BusState = Literal["idle", "running", "estopped", "closed"]


class States:
    """The state of one bus.

    Attributes
    ----------
    estops : how many there were
    interrupted : whether playing ended without a stop: by an e-stop, or for the amplifier went to
        0 V by itself. Who writes may not know yet.
    """

    def __init__(self) -> None:
        self.estops = self._ended = self._cleared = 0
        self.interrupted = False
        self._activity: Literal["idle", "running", "closed"] = "idle"
        # held for a few instructions only; reentrant, for a signal handler may e-stop meanwhile
        self._lock = threading.RLock()

    @property
    def running(self) -> bool:
        """Whether it was started and has not come to rest since."""
        return self._activity == "running"

    @property
    def now(self) -> BusState:
        """The state."""
        if self._activity != "closed" and self.estops > self._cleared:
            return "estopped"
        return self._activity

    @property
    def estop_under_way(self) -> bool:
        """Whether a driver is still at an e-stop."""
        return self.estops > self._ended

    def begin(self, estops: int) -> None:
        """Run, unless there were more than so many e-stops."""
        with self._lock:
            if self.estops == estops:
                self._activity, self.interrupted = "running", False

    def rest(self) -> bool:
        """Be idle, as whoever plays wants it; tell whether there is anything to stop."""
        with self._lock:
            moving, self.interrupted = self.running, False
            if moving:
                self._activity = "idle"
            return moving

    def fall(self) -> None:
        """Be idle because the amplifier went to 0 V by itself; nothing to do unless running."""
        with self._lock:
            if self.running:
                self._activity, self.interrupted = "idle", True

    def close(self) -> None:
        """Be closed for good."""
        with self._lock:
            self._activity, self.interrupted = "closed", False

    def estop(self) -> bool:
        """Begin an e-stop; tell whether the driver is to act, which it is unless closed."""
        with self._lock:
            if self._activity == "closed":
                return False
            self.interrupted |= self.running
            self._activity = "idle"
            self.estops += 1
            return True

    def end_estop(self) -> None:
        """End an e-stop: the driver has acted."""
        with self._lock:
            self._ended += 1

    def trip(self) -> None:
        """Be e-stopped because the amplifier is; nothing to do where that is known."""
        with self._lock:
            if self.now != "estopped" and self.estop():
                self.end_estop()

    def clear(self, estops: int) -> None:
        """End the first so many e-stops, and be idle."""
        with self._lock:
            self._cleared = estops
            if self._activity != "closed":
                self._activity = "idle"
