"""How often something may happen, with the time passed in."""


class TokenBucket:
    """Lets so many messages through in a second, and as many at once."""

    def __init__(self, rate: float) -> None:
        self._rate, self._left, self._time = rate, rate, 0.0
        self._told = -1.0
        self.refused = 0

    def take(self, now: float) -> bool:
        """Return whether one more may pass at a time [s]."""
        self._left = min(self._rate, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < 1:
            self.refused += 1
            return False
        self._left -= 1
        return True

    def is_to_be_told(self, now: float) -> bool:
        """Return whether it is time to say that messages are refused: once a second."""
        if now - self._told < 1:
            return False
        self._told = now
        return True
