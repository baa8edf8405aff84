"""Ownership of the finger on a display: it belongs to one client at a time."""

import math

from tactile.messages import SILENCE
from tactile.playback.shared_memory import Touch


class FingerOwnership:
    """Owner of the finger on a display: the client that touched first.

    Attributes
    ----------
    client : int or None
        Number of the client that the finger belongs to; None while nobody touches.
    """

    def __init__(self) -> None:
        self.client: int | None = None
        self._last = -math.inf
        self._touch: Touch | None = None

    def take(self, client: int, touch: Touch) -> bool:
        """Take a contact, if the finger belongs to its client or to nobody.

        An owner that has been silent for longer than `SILENCE` loses the finger to the next client
        that touches.

        Parameters
        ----------
        client : int
            Number of the client that sent the contact.
        touch : Touch
            The contact.

        Returns
        -------
        bool
            Whether the contact counts.
        """
        if client != self.client:
            silent = touch.arrival - self._last > SILENCE
            if touch.normal_force <= 0 or not (self.client is None or silent):
                return False
        self._last, self._touch = touch.arrival, touch
        self.client = client if touch.normal_force > 0 else None
        return True

    def lifted(self, client: int, now: float) -> Touch | None:
        """Return the contact that lifts a client's finger.

        Parameters
        ----------
        client : int
            Number of the client.
        now : float
            Time of the contact [s].

        Returns
        -------
        Touch or None
            Last contact of the client with a normal force of 0; None if the finger is not the
            client's.
        """
        if self.client != client or self._touch is None:
            return None
        return self._touch._replace(time=now, arrival=now, normal_force=0.0)
