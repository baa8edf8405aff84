"""Mapping of a client's clock to that of the host.

What a client stamps with its own clock arrives after a delay that jitters but never falls below a
minimum: arrival − client time lies above an envelope and touches it now and then. The least value
over the last two seconds is the offset between the clocks plus the least delay, which no one-way
message can separate (as in D. L. Mills' clock filter, RFC 5905, section 10, which trusts the sample
of least delay).

The map follows the envelope by at most 2 % of the time that passes, so that mapped time runs 0.98
to 1.02 times as fast as the client's. That difference of speed cannot be felt, and it is enough for
clocks 300 ppm apart and for a first message that came 20 ms late (corrected within 1 s). Over the
window such a clock drifts by 0.6 ms, which is the largest error of the map for this reason.
"""

import math
from collections import deque

WINDOW = 2.0
"""Length of the window of the envelope [s]; at 90 Hz it holds 180 delays, of which the least is
close to the minimum of the link (assumed)."""
BUCKETS = 8
"""Number of parts of the window, each of which keeps its least value."""
SLEW = 0.02
"""Largest difference of the map's rate from 1."""
JUMP = 0.5
"""Distance above the envelope from which on a sample means another clock, not a delay (assumed)
[s]."""
TOO_LATE = 0.05
"""Distance below the envelope from which on the map starts anew (assumed) [s]: a sample that is so
early proves the envelope wrong. This happens after a stall of the link, whose end cannot be told
from a clock that jumped."""


class ClockMap:
    """Map from the clock of one client to that of the host.

    Attributes
    ----------
    jumps : int
        Number of times that the client's clock was found to have jumped.
    invalid : int
        Number of client times that were not finite.
    """

    def __init__(self) -> None:
        self.jumps = self.invalid = 0
        self._least: deque[tuple[int, float]] = deque()
        """Number of each bucket, and least arrival − client time in it [s]."""
        self._offset = 0.0
        self._newest = self._mapped = -math.inf

    def __call__(self, client_time: float | None, arrival: float) -> float:
        """Return the host's time [s] at which a client took what has arrived.

        The result ascends for ascending client times. Without a client time it is the arrival.

        Parameters
        ----------
        client_time : float or None
            Time stamp in the client's clock [s].
        arrival : float
            Arrival in the host's clock, ascending [s].
        """
        if client_time is None or not math.isfinite(client_time):
            self.invalid += client_time is not None
            return arrival
        apart = arrival - client_time
        beyond = apart - self._offset
        if not self._least or beyond > JUMP or beyond < -TOO_LATE:
            return self._begin(client_time, arrival)
        self._note(apart, arrival)
        passed = client_time - self._newest
        if passed <= 0:
            return client_time + self._offset
        change = min(least for _, least in self._least) - self._offset
        self._offset += min(max(change, -SLEW * passed), SLEW * passed)
        self._newest = client_time
        self._mapped = max(self._mapped, client_time + self._offset)
        return self._mapped

    def _begin(self, client_time: float, arrival: float) -> float:
        """Start anew with a delay of 0, but not before what was mapped earlier."""
        self.jumps += bool(self._least) and (abs(arrival - client_time - self._offset) > JUMP)
        self._least.clear()
        if client_time <= self._newest:
            self._mapped = -math.inf
        self._newest = client_time
        self._mapped = max(self._mapped, arrival)
        self._offset = self._mapped - client_time
        self._note(arrival - client_time, arrival)
        return self._mapped

    def _note(self, apart: float, arrival: float) -> None:
        """Enter arrival − client time into its bucket, and drop buckets outside the window."""
        bucket = math.floor(arrival * (BUCKETS / WINDOW))
        while self._least and self._least[0][0] <= bucket - BUCKETS:
            self._least.popleft()
        if self._least and self._least[-1][0] == bucket:
            self._least[-1] = bucket, min(apart, self._least[-1][1])
        else:
            self._least.append((bucket, apart))
