"""How full a FIFO is that tells little: bounds from a clock whose rate is known within bounds.

W samples were written since the FIFO was last seen empty, and ⌊p⌋ of them were played, where p
grows by the chip's rate. What is written stays below what fits by the least p, so that a burst is
never refused. The doubt, the most p minus the least, grows until the FIFO is let run empty again:
then all W were played, which closes the bounds and measures the rate over the whole run.
"""

RATE = 8000.0
"""Hz, of both chips (TI SLOS751E; BOS1921: CONFIG bits 2:0 = 7)."""
TOLERANCE = 0.025
"""Of a chip's clock, assumed: neither sheet's number was at hand."""
RATES = (RATE * (1 - TOLERANCE), RATE * (1 + TOLERANCE))
"""Hz."""
DRIFT = 200e-6
"""Of a measured rate until the next measurement, some seconds later: temperature, assumed."""


class Occupancy:
    """Bounds of a FIFO's fill.

    Attributes
    ----------
    rates : least and most the clock may run [Hz]
    written : samples since it was last empty
    """

    def __init__(self) -> None:
        self.rates = RATES
        self.written = 0
        self._first = (0.0, 0.0)
        self._low = (0.0, 0.0)

    def begin(self, count: int, before: float, after: float) -> None:
        """Take that samples were written into the empty FIFO.

        Parameters
        ----------
        count : of samples
        before, after : between which the first began to play [s]
        """
        self.written = count
        self._first, self._low = (before, after), (after, 0.0)

    def wrote(self, count: int, before: float) -> None:
        """Take that further samples were written, from a time on."""
        self._low = (before, self._least(before))
        self.written += count

    def measured(self, before: float, after: float) -> tuple[float, float]:
        """Return the rate's bounds from when it became empty, for the first time since it began.

        Closer than those so far by as much as they are compatible; those so far where it is no
        chip's rate.
        """
        low, high = measured_rates(self.written, self._first, (before, after))
        low, high = max(low, RATES[0]), min(high, RATES[1])
        both = max(low, self.rates[0] * (1 - DRIFT)), min(high, self.rates[1] * (1 + DRIFT))
        if both[0] < both[1]:
            return both
        return (low, high) if low < high else self.rates

    def _least(self, now: float) -> float:
        time, played = self._low
        return min(played + self.rates[0] * max(0.0, now - time), self.written)

    def _most(self, now: float) -> float:
        return 1.0 + self.rates[1] * max(0.0, now - self._first[0])

    def most_fill(self, now: float) -> int:
        """Return how many samples there may be."""
        return self.written - int(self._least(now))

    def least_fill(self, now: float) -> int:
        """Return how many samples there are for certain."""
        return max(0, self.written - int(self._most(now)))

    @property
    def dry_at(self) -> float:
        """When it may be empty, at the earliest [s]."""
        return self._first[0] + (self.written - 1.0) / self.rates[1]


def measured_rates(
    count: int, first: tuple[float, float], empty: tuple[float, float]
) -> tuple[float, float]:
    """Return the least and the most rate at which a FIFO was emptied, drift included [Hz].

    Parameters
    ----------
    count : samples played without a pause
    first : between which times the first was written [s]
    empty : between which times the FIFO became empty [s]
    """
    longest = empty[1] - first[0]
    shortest = max(empty[0] - first[1] - 1 / RATES[0], 1e-9)
    return (count - 1) / longest * (1 - DRIFT), (count - 1) / shortest * (1 + DRIFT)
