"""Bounds of the fill of a FIFO that reports little, from a clock whose rate is known within bounds.

Since the FIFO was last seen empty, W samples were written and ⌊p⌋ of them were played, where p
grows at the chip's rate. The lower bound of p limits what is written, so that a burst is never
refused. The uncertainty, the upper minus the lower bound of p, grows until the FIFO is allowed to
run empty again. All W samples have been played then, which closes the bounds and measures the rate
over the whole run.
"""

RATE = 8000.0
"""Nominal sample rate of both chips (TI SLOS751E; BOS1921: CONFIG bits 2:0 = 7) [Hz]."""
TOLERANCE = 0.025
"""Relative tolerance of a chip's clock.

It is assumed, since the value of neither data sheet was available.
"""
RATES = (RATE * (1 - TOLERANCE), RATE * (1 + TOLERANCE))
"""Lowest and highest sample rate of a chip [Hz]."""
DRIFT = 200e-6
"""Relative change of a measured rate until the next measurement, some seconds later.

It is assumed, and allows for changes of the temperature.
"""


class Occupancy:
    """Bounds of the fill of a FIFO.

    Attributes
    ----------
    rates : tuple of float
        Lowest and highest rate of the clock [Hz].
    written : int
        Number of samples written since the FIFO was last empty.
    """

    def __init__(self) -> None:
        self.rates = RATES
        self.written = 0
        self._first = (0.0, 0.0)
        self._low = (0.0, 0.0)

    def begin(self, count: int, before: float, after: float) -> None:
        """Note that samples were written into the empty FIFO.

        Parameters
        ----------
        count : int
            Number of samples.
        before, after : float
            Times between which the first sample began to play [s].
        """
        self.written = count
        self._first, self._low = (before, after), (after, 0.0)

    def wrote(self, count: int, before: float) -> None:
        """Note that further samples were written.

        Parameters
        ----------
        count : int
            Number of samples.
        before : float
            Time before the write [s].
        """
        self._low = (before, self._least_played(before))
        self.written += count

    def measured(self, before: float, after: float) -> tuple[float, float]:
        """Return the bounds of the rate, measured from the time at which the FIFO became empty.

        The FIFO must have become empty for the first time since `begin`. The present bounds are
        narrowed as far as the measurement is compatible with them. They are returned unchanged if
        no chip can have the measured rate.

        Parameters
        ----------
        before, after : float
            Times between which the FIFO became empty [s].

        Returns
        -------
        tuple of float
            Lowest and highest rate [Hz].
        """
        low, high = measured_rates(self.written, self._first, (before, after))
        low, high = max(low, RATES[0]), min(high, RATES[1])
        narrowed = max(low, self.rates[0] * (1 - DRIFT)), min(high, self.rates[1] * (1 + DRIFT))
        if narrowed[0] < narrowed[1]:
            return narrowed
        return (low, high) if low < high else self.rates

    def _least_played(self, now: float) -> float:
        """Return the smallest number of samples, with fractions, that may have been played."""
        time, played = self._low
        return min(played + self.rates[0] * max(0.0, now - time), self.written)

    def _most_played(self, now: float) -> float:
        """Return the largest number of samples, with fractions, that may have been played."""
        return 1.0 + self.rates[1] * max(0.0, now - self._first[0])

    def most_fill(self, now: float) -> int:
        """Return how many samples there are at most in the FIFO.

        Parameters
        ----------
        now : float
            Time on the host's clock [s].

        Returns
        -------
        int
            Number of samples.
        """
        return self.written - int(self._least_played(now))

    def least_fill(self, now: float) -> int:
        """Return how many samples are certainly in the FIFO.

        Parameters
        ----------
        now : float
            Time on the host's clock [s].

        Returns
        -------
        int
            Number of samples.
        """
        return max(0, self.written - int(self._most_played(now)))

    @property
    def dry_at(self) -> float:
        """Earliest time at which the FIFO may be empty [s]."""
        return self._first[0] + (self.written - 1.0) / self.rates[1]


def measured_rates(
    count: int, first: tuple[float, float], empty: tuple[float, float]
) -> tuple[float, float]:
    """Return bounds of the rate at which a FIFO was emptied, drift included.

    Parameters
    ----------
    count : int
        Number of samples that were played without a pause.
    first : tuple of float
        Times between which the first sample was written [s].
    empty : tuple of float
        Times between which the FIFO became empty [s].

    Returns
    -------
    tuple of float
        Lowest and highest rate [Hz].
    """
    longest = empty[1] - first[0]
    shortest = max(empty[0] - first[1] - 1 / RATES[0], 1e-9)
    return (count - 1) / longest * (1 - DRIFT), (count - 1) / shortest * (1 + DRIFT)
