"""The time of each cycle of JACK, from readings of JACK's clock, some of which are wrong."""

from tactile.jack.frame_numbers import frames_between

AGREEING = 1e-3
"""Largest difference of a reading that is right from the time that is expected [s]. Assumed: more
than JACK's clock wanders in a cycle, and no more than the server takes for the same stream."""
SHARE = 0.1
"""Share of its difference by which a reading corrects the time. A clock that drifts by 2e-4 is then
followed to within the drift of ten cycles."""
JUMP = 8
"""Number of readings in a row that must agree on another time for the clock to jump to it.
Assumed: more than are disturbed at once."""


class CycleClock:
    """Clock of the cycles, which goes on evenly over wrong readings."""

    def __init__(self) -> None:
        self._time: float | None = None
        self._number = self._others = 0
        self._difference = 0.0

    def take(self, number: int, reading: float, rate: float) -> float:
        """Take the reading of a cycle, and return its time.

        Parameters
        ----------
        number : int
            Number of the first frame of the cycle, of 32 bits.
        reading : float
            Begin of the cycle as it was read [s].
        rate : float
            Sample rate [Hz].

        Returns
        -------
        float
            Begin of the cycle [s].
        """
        expected = reading
        if self._time is not None:
            expected = self._time + frames_between(self._number, number) / rate
        self._time = expected + self._correction(reading - expected)
        self._number = number
        return self._time

    def _correction(self, difference: float) -> float:
        """Return the correction by a reading that differs from the time that is expected [s]."""
        if abs(difference) <= AGREEING:
            self._others = 0
            return SHARE * difference
        agrees = self._others > 0 and abs(difference - self._difference) <= AGREEING
        self._others = self._others + 1 if agrees else 1
        self._difference = difference
        if self._others < JUMP:
            return 0.0
        self._others = 0
        return difference
