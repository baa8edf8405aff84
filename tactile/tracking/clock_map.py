"""A client's clock in terms of ours.

What a client stamps with its own clock arrives later by a delay that jitters, but is never less
than the least: arrival − client time lies above an envelope, and now and then touches it. The
envelope's least value over the last two seconds is what lies between the clocks, up to the least
delay, which no one-way message can tell (as in D. L. Mills' clock filter, RFC 5905, section 10,
which trusts the sample of least delay).

The map follows the envelope at no more than 2 % of the time that passes, so that mapped time
runs 0.98 to 1.02 times as fast as the client's: a difference of speed that nobody feels, and enough
for clocks 300 ppm apart and for a first message that came 20 ms late (1 s). Over the window such a
clock runs 0.6 ms off, which is how much the map is late or early at most for its sake.
"""

import math
from collections import deque

WINDOW = 2.0
"""s; at 90 Hz 180 delays, of which the least is near what the link can do (assumed)."""
BUCKETS = 8
"""Parts of the window, of each of which the least is kept."""
SLEW = 0.02
"""Most that the map's rate differs from one."""
JUMP = 0.5
"""s; more than this from the envelope is another clock, and no delay (assumed)."""
TOO_LATE = 0.05
"""s; what comes so much sooner than the envelope proves it wrong, and it starts anew: after a stall
of the link, whose end nothing tells from a clock that jumped (assumed)."""


class ClockMap:
    """One client's clock → ours.

    Attributes
    ----------
    jumps : how often the client's clock was found to have jumped
    invalid : client times that were no finite numbers
    """

    def __init__(self) -> None:
        self.jumps = self.invalid = 0
        self._least: deque[tuple[int, float]] = deque()
        """Bucket's number and least arrival − client time in it."""
        self._offset = 0.0
        self._newest = self._mapped = -math.inf

    def __call__(self, client_time: float | None, arrival: float) -> float:
        """Return our time [s] at which a client took what arrived.

        For ascending client times it ascends too. Without a client time it is the arrival.

        Parameters
        ----------
        client_time : in the client's clock [s]
        arrival : in ours [s]; ascending
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
        wanted = min(least for _, least in self._least) - self._offset
        self._offset += min(max(wanted, -SLEW * passed), SLEW * passed)
        self._newest = client_time
        self._mapped = max(self._mapped, client_time + self._offset)
        return self._mapped

    def _begin(self, client_time: float, arrival: float) -> float:
        """Start from a delay of nothing, but no earlier than what was mapped before."""
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
        bucket = math.floor(arrival * (BUCKETS / WINDOW))
        while self._least and self._least[0][0] <= bucket - BUCKETS:
            self._least.popleft()
        if self._least and self._least[-1][0] == bucket:
            self._least[-1] = bucket, min(apart, self._least[-1][1])
        else:
            self._least.append((bucket, apart))
