"""The delay from JACK to the skin, which stays the same as long as the display can keep it."""

TOLERANCE = 0.5e-3
"""Time by which the latency of a display may grow before the delay is raised [s], since each change
fades the playback out and in. Assumed: a small part of the headroom."""
HEADROOM, LARGEST_RAISED = 8e-3, 40e-3
"""Headroom at first, if the user has set none, and up to which it is raised [s]. The server needs
3 ms of it. Assumed: the rest is for a program that is held up for a few milliseconds; the largest
is longer than a busy machine holds up a program as a rule, and a delay that a player still
bears."""
SETTLING = 2.0
"""Time after a change of the delay in which the headroom is not raised [s], since the change itself
costs frames. Assumed: longer than the largest delay."""


class Delay:
    """Delay of a sound card: the latency of the display and the headroom.

    Parameters
    ----------
    latency : float
        Latency of the display as the server describes it, which counts until it is measured [s].
    headroom : float or None
        Time that is added to it and stays; None for one that may be raised [s].

    Attributes
    ----------
    seconds : float
        Delay [s].
    """

    def __init__(self, latency: float, headroom: float | None) -> None:
        self._may_rise = headroom is None
        self._headroom = HEADROOM if headroom is None else headroom
        self.seconds = latency + self._headroom
        self._was_measured = False
        self._changed = -float("inf")

    def update(self, latency: float | None, now: float) -> bool:
        """Take the latency that the server measures.

        The first one sets the delay. From then on it is only raised.

        Parameters
        ----------
        latency : float or None
            Latency of the display; None while nothing plays [s].
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether the delay was raised, beyond the first measurement.
        """
        if latency is None:
            return False
        needed = latency + self._headroom
        if not self._was_measured:
            self._was_measured = True
            self._set(needed, now)
            return False
        if needed - self.seconds <= TOLERANCE:
            return False
        self._set(needed, now)
        return True

    def raise_headroom(self, now: float) -> bool:
        """Raise the headroom by half, unless it is the user's or the delay has just changed.

        Parameters
        ----------
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether it was raised.
        """
        before = self._headroom
        if not self._may_rise or before >= LARGEST_RAISED or now - self._changed < SETTLING:
            return False
        self._headroom = min(1.5 * before, LARGEST_RAISED)
        self._set(self.seconds + self._headroom - before, now)
        return True

    def _set(self, seconds: float, now: float) -> None:
        """Set the delay [s] at a time [s]."""
        if seconds != self.seconds:
            self.seconds, self._changed = seconds, now
