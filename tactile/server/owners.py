"""To whom the high voltage of a display belongs: those who armed it."""

from collections.abc import Iterator
from contextlib import contextmanager

CONFIGURATION = 0
"""Stands for the configuration among the clients that armed; their numbers begin at 1."""
OWNERLESS = 0.5
"""s after which high voltage that belongs to nobody is switched off."""


class Owners:
    """The owners of high voltage.

    Attributes
    ----------
    clients : numbers of those who armed, and have neither left nor disarmed since
    """

    def __init__(self) -> None:
        self.clients: set[int] = set()
        self._arms_under_way = 0
        self._owned = 0.0

    @contextmanager
    def arm(self) -> Iterator[None]:
        """Keep owners while high voltage is not on yet."""
        self._arms_under_way += 1
        try:
            yield
        finally:
            self._arms_under_way -= 1

    def look(self, now: float, *, running: bool, armed: bool) -> bool:
        """Return whether high voltage has belonged to nobody for too long.

        Where playback disarmed by itself its owners lose it: they must arm anew.

        Parameters
        ----------
        now : time of a clock that never steps [s]
        running : whether playback is to run; a bus that arms again by itself runs on meanwhile
        armed : whether the amplifier plays
        """
        if not (running or self._arms_under_way):
            self.clients.clear()
        if self.clients or not armed:
            self._owned = now
        if now - self._owned <= OWNERLESS:
            return False
        self._owned = now
        return True
