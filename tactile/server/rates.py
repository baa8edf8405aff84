"""Limit on how often something may happen; the time is passed in."""


class TokenBucket:
    """Token bucket that lets a number of messages through per second, and as many at once.

    Parameters
    ----------
    rate : float
        Messages per second [1/s].

    Attributes
    ----------
    refused : int
        Number of messages that were refused.
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._left, self._time = rate, rate, 0.0
        self._reported = -1.0
        self.refused = 0

    def take(self, now: float) -> bool:
        """Take a token for one message.

        Parameters
        ----------
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether the message may pass.
        """
        self._left = min(self._rate, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < 1:
            self.refused += 1
            return False
        self._left -= 1
        return True

    def report_is_due(self, now: float) -> bool:
        """Decide whether to report now that messages are refused, at most once per second.

        Parameters
        ----------
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether it is time for a report.
        """
        if now - self._reported < 1:
            return False
        self._reported = now
        return True
