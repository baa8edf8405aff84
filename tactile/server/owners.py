"""Ownership of the high voltage of a display: it belongs to those who armed."""

from collections.abc import Iterator
from contextlib import contextmanager

CONFIGURATION = 0
"""Number that stands for the configuration among the clients that armed; their numbers begin
at 1."""
OWNERLESS = 0.5
"""Time after which high voltage that belongs to nobody is switched off [s]."""


class Owners:
    """Owners of the high voltage of a display.

    Attributes
    ----------
    clients : set of int
        Numbers of the clients that armed, and have neither left nor disarmed since.
    """

    def __init__(self) -> None:
        self.clients: set[int] = set()
        self._arms_under_way = 0
        self._owned = 0.0

    @contextmanager
    def arm(self) -> Iterator[None]:
        """Keep the owners, although high voltage is not on yet, while arming is under way.

        Yields
        ------
        None
            Nothing; arming takes place inside the ``with`` block.
        """
        self._arms_under_way += 1
        try:
            yield
        finally:
            self._arms_under_way -= 1

    def check(self, now: float, *, running: bool, armed: bool) -> bool:
        """Check whether high voltage has belonged to nobody for too long.

        If playback disarmed by itself, the owners lose the high voltage and must arm again.

        Parameters
        ----------
        now : float
            Time of a monotonic clock [s].
        running : bool
            Whether playback is supposed to run; it still is while a bus arms again by itself.
        armed : bool
            Whether the amplifier plays.

        Returns
        -------
        bool
            Whether high voltage must be switched off.
        """
        if not (running or self._arms_under_way):
            self.clients.clear()
        if self.clients or not armed:
            self._owned = now
        if now - self._owned <= OWNERLESS:
            return False
        self._owned = now
        return True
