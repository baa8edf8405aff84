"""Ownership of the finger on a display: it belongs to one client at a time."""

import math

from tactile.messages import SILENCE
from tactile.tracking.finger_sample import FingerSample


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
        self._sample: FingerSample | None = None

    def take(self, client: int, sample: FingerSample) -> bool:
        """Take a sample, if the finger belongs to its client or to nobody.

        An owner that has been silent for longer than `SILENCE` loses the finger to the next client
        that touches.

        Parameters
        ----------
        client : int
            Number of the client that sent the sample.
        sample : FingerSample
            Sample of the client's finger.

        Returns
        -------
        bool
            Whether the sample counts.
        """
        if client != self.client:
            silent = sample.arrival - self._last > SILENCE
            if sample.normal_force <= 0 or not (self.client is None or silent):
                return False
        self._last, self._sample = sample.arrival, sample
        self.client = client if sample.normal_force > 0 else None
        return True

    def lifted(self, client: int, now: float) -> FingerSample | None:
        """Return the sample that lifts a client's finger.

        Parameters
        ----------
        client : int
            Number of the client.
        now : float
            Time of the sample [s].

        Returns
        -------
        FingerSample or None
            Last sample of the client with a normal force of 0; None if the finger is not the
            client's.
        """
        if self.client != client or self._sample is None:
            return None
        return self._sample._replace(time=now, arrival=now, normal_force=0.0)
