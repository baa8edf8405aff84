"""Whose finger it is that touches a display: one client's at a time."""

import math

from tactile.messages import SILENCE
from tactile.playback.shared_memory import Touch


class FingerOwnership:
    """The finger on a display, which belongs to the client that touched first.

    Attributes
    ----------
    client : number of the client that it belongs to; None while nobody touches
    """

    def __init__(self) -> None:
        self.client: int | None = None
        self._last = -math.inf
        self._touch: Touch | None = None

    def take(self, client: int, touch: Touch) -> bool:
        """Return whether a contact counts: the finger is the client's, or nobody's.

        Parameters
        ----------
        client : number of the client that sent it
        touch : the contact
        """
        if client != self.client:
            silent = touch.arrival - self._last > SILENCE
            if touch.normal_force <= 0 or not (self.client is None or silent):
                return False
        self._last, self._touch = touch.arrival, touch
        self.client = client if touch.normal_force > 0 else None
        return True

    def lifted(self, client: int, now: float) -> Touch | None:
        """Return the contact that lifts a client's finger at a time [s]; None if it has none."""
        if self.client != client or self._touch is None:
            return None
        return self._touch._replace(time=now, arrival=now, normal_force=0.0)
