"""The host's estimate of an amplifier's clock, from exchanges of four timestamps (SPEC.md, 7.2).

The amplifier received a probe after the host had sent it and before the host had its answer, so
that each exchange bounds host time, as a function of the amplifier's, from below (t1 at t2) and
from above (t4 at t3). The middle between the tightest bound from either side, of the last 8
exchanges along the line as it was, feeds an exponential regression: of the amplifier's time and
the host's lead over it.

Klipper's clocksync, the model, feeds a regression with the shortest round trip. The two tightest
bounds need not belong to one exchange: of n exponential delays the shortest lies 1/n of the mean
above the floor, while those of the shortest of n round trips lie √n times as far. With as long a
memory the error is a third to a half less (`python -m benchmarks clock` measures both). The line
in the middle of the widest band between all of 64 bounds, after Moon, Skelly & Towsley (INFOCOM
1999), was no better on exponential delays and twice as bad where short ones are rare, as on CAN.

What no exchange can show is a floor that is longer one way: half the difference is error. Make both
packets of one length, or pass `t1` later and `t4` earlier by what each needs on the wire, and set
FTDI's latency timer to 1 ms.
"""

import math
from collections import deque
from dataclasses import dataclass

FIRST_PROBES = 8
WINDOW = 8
"""Exchanges of which the tightest bounds are taken."""
GAIN = 1 / 48
"""Of the regression, after as many exchanges: it remembers 12 s (1/12 of every fourth, which the
shortest round trip of 8 is). A clock that wanders by 0.05 ppm/s, more than a crystal that warms up
(assumed), is followed 6 µs late."""
PRIOR_TIME = 1.0
"""s, the spread of time before the first exchange, with no drift: the error of the first samples,
some 30 µs, over the drift of a crystal, some 30 ppm (both assumed)."""
FIRST_INTERVAL, INTERVAL = 9.889e-3, 249.577e-3
"""s between probes, so that they fall on what polls each 0.125, 1 or 16 ms (USB microframe and
frame, FTDI's latency timer) in ever other phases: 249.577 ms is 1996.62, 249.577 and 15.60 times
as long. Probes each 250 ms would keep step with it."""
DRIFT_LIMIT = 0.02
"""Beyond it a clock has jumped: twice the 1 % of a microcontroller's RC oscillator (assumed)."""
TURNAROUND = 2.5e-3
"""s in which an amplifier answers, or its stamp of receipt is not trusted (SPEC.md, 7.2)."""
LEAPS = 3
"""Exchanges in a row that tell of a clock that leapt ahead: an amplifier that was reset begins at
0, so that it hardly ever does, and a stamp may be wrong, of a counter read while it carries."""
SILENCE = 12.0
"""s without an exchange, as long as the memory, after which the estimate begins anew: a restart
in a long silence could not be told from drift."""
FARTHEST = 1e10
"""s, more than 300 years: a host time beyond it is none."""


@dataclass(frozen=True)
class Exchange:
    """Four timestamps: sent and received by the host [s], in between by the amplifier [ticks]."""

    t1: float
    t2: int
    t3: int
    t4: float

    def taken(self, tick_hz: float) -> int:
        """Return the first tick that is surely after `t1`: `t2`, or `t3` where that is long after.

        An amplifier that was held up may say that it received what it only found later.
        """
        return self.t3 if self.t3 - self.t2 > TURNAROUND * tick_hz else self.t2

    def round_trip(self, tick_hz: float) -> float:
        """Return the time that both ways took [s], the amplifier's own taken off if short."""
        return self.t4 - self.t1 - (self.t3 - self.taken(tick_hz)) / tick_hz

    def is_possible(self, tick_hz: float) -> bool:
        """Tell whether time ran forward, and for less than the memory.

        Ticks may be one off, and run at another rate.
        """
        in_order = -FARTHEST < self.t1 <= self.t4 < FARTHEST and 0 <= self.t2 <= self.t3 < 2**64
        if not in_order or self.t4 - self.t1 > SILENCE:
            return False
        slack = (1 + DRIFT_LIMIT * (self.t3 - self.t2)) / tick_hz
        return self.round_trip(tick_hz) >= -slack

    def continues(self, last: "Exchange", tick_hz: float) -> bool:
        """Tell whether it can be of the same run of the amplifier as the exchange before it."""
        if not last.t1 < self.t1 <= last.t4 + SILENCE:
            return False
        least, most = self.t1 - last.t4, self.t4 - last.t1
        from_answer = (self.taken(tick_hz) - last.t3 + 1) / tick_hz
        to_answer = (self.t3 - last.taken(tick_hz) - 1) / tick_hz
        not_behind = from_answer >= least - DRIFT_LIMIT * abs(least)
        return not_behind and to_answer <= most + DRIFT_LIMIT * most

    def is_anew(self, last: "Exchange") -> bool:
        """Tell whether it alone tells of another run: ticks went back, or there was silence."""
        return self.t2 < last.t2 or not last.t1 - SILENCE <= self.t1 <= last.t4 + SILENCE


class ClockEstimator:
    """What an amplifier's clock shows, and when it will show it.

    It has no clock and sends nothing. Between two exchanges both directions are strictly monotonic;
    an exchange moves the estimate by some microseconds, either way. Before the first exchange
    tick 0 is at host time 0.

    Parameters
    ----------
    tick_hz : ticks per second by name, from CAPS

    Attributes
    ----------
    accepted, rejected : exchanges taken, and those that cannot be (also repeated or overtaken ones,
        and leaps that the next do not bear out)
    restarts : times that the estimate began anew: the amplifier's clock did, or there was silence

    Raises
    ------
    ValueError
        `tick_hz` is not positive and finite.
    """

    def __init__(self, tick_hz: float) -> None:
        if not 0 < tick_hz < math.inf:
            raise ValueError(f"tick_hz {tick_hz:g} must be positive and finite")
        self.tick_hz = float(tick_hz)
        self.accepted = self.rejected = self.restarts = 0
        self._window: deque[Exchange] = deque(maxlen=WINDOW)
        self._leaps: list[Exchange] = []
        self._next_probe = -math.inf
        self._begin(Exchange(0.0, 0, 0, 0.0))

    def _begin(self, first: Exchange) -> None:
        """Forget everything; count time from an exchange."""
        self._window.clear()
        self._origin, self._origin_ticks = first.t1, first.t2
        self._mean_x = self._mean_y = self._slope = 0.0
        self._variance, self._covariance = PRIOR_TIME**2, 0.0
        self._fed = self._probes = 0

    def probe_due(self, now: float) -> bool:
        """Tell whether to send a probe at host time `now` [s]; each True counts as one sent."""
        if now < self._next_probe:
            return False
        self._probes += 1
        self._next_probe = now + (FIRST_INTERVAL if self._probes < FIRST_PROBES else INTERVAL)
        return True

    def add(self, t1: float, t2: int, t3: int, t4: float) -> bool:
        """Take an exchange; return False, and count it, where it cannot be.

        One that leaps ahead or lags where no oscillator does may have a wrong stamp: it is dropped,
        and the next ones, soon, tell whether the clock leapt.

        Parameters
        ----------
        t1, t4 : sent and received by the host [s]
        t2, t3 : received and sent by the amplifier [ticks]
        """
        new, last = Exchange(t1, t2, t3, t4), self._window[-1] if self._window else None
        late = last is not None and last.t1 - SILENCE <= t1 <= last.t1 and t2 <= last.t2
        if late or not new.is_possible(self.tick_hz):
            self.rejected += 1
            return False
        if last is None or not new.continues(last, self.tick_hz):
            self._next_probe = min(self._next_probe, t4 + FIRST_INTERVAL)
            if last is not None and not self._has_leapt(new, last):
                self.rejected += 1
                return False
            self.restarts += last is not None
            self._begin(new)
        self._leaps.clear()
        self.accepted += 1
        self._window.append(new)
        self._feed()
        return True

    def _has_leapt(self, new: Exchange, last: Exchange) -> bool:
        """Tell whether a clock that does not go on began anew, and not a few stamps are wrong."""
        borne_out = bool(self._leaps) and new.continues(self._leaps[-1], self.tick_hz)
        self._leaps = [*self._leaps, new] if borne_out else [new]
        return len(self._leaps) == LEAPS or new.is_anew(last)

    def _feed(self) -> None:
        """Take the middle between the tightest bounds of the window into the regression."""
        asked = [(e.t1, e.taken(self.tick_hz)) for e in self._window]
        below = [(self._seconds(taken), t1 - self._origin) for t1, taken in asked]
        above = [(self._seconds(e.t3), e.t4 - self._origin) for e in self._window]
        lead = (
            max(host - x - self._lead(x) for x, host in below)
            + min(host - x - self._lead(x) for x, host in above)
        ) / 2
        x = (sum(x for x, _ in below) + sum(x for x, _ in above)) / (2 * len(self._window))
        dx, dy = x - self._mean_x, lead + self._lead(x) - self._mean_y
        self._fed += 1
        gain = max(GAIN, 1 / self._fed)
        self._mean_x += gain * dx
        self._mean_y += gain * dy
        if self._fed > 1:
            self._variance = (1 - gain) * (self._variance + gain * dx * dx)
            self._covariance = (1 - gain) * (self._covariance + gain * dx * dy)
        slope = self._covariance / self._variance
        self._slope = min(max(slope, -DRIFT_LIMIT), DRIFT_LIMIT)

    def _lead(self, seconds: float) -> float:
        """Return the host's time less the amplifier's [s], both since the first exchange."""
        return self._mean_y + self._slope * (seconds - self._mean_x)

    def _seconds(self, ticks: int) -> float:
        """Return the amplifier's time since the first exchange [s], by name."""
        return (ticks - self._origin_ticks) / self.tick_hz

    def ticks_at(self, host_time: float) -> int:
        """Return what the amplifier's clock shows at a host time [s]."""
        lead = self._lead(host_time - self._origin) / (1 + self._slope)
        return self._origin_ticks + round((host_time - self._origin - lead) * self.tick_hz)

    def host_time_at(self, ticks: int) -> float:
        """Return the host time [s] at which the amplifier's clock shows `ticks`."""
        seconds = self._seconds(ticks)
        return self._origin + seconds + self._lead(seconds)

    @property
    def next_probe(self) -> float:
        """Host time from which a probe is due [s]."""
        return self._next_probe

    @property
    def drift_ppm(self) -> float:
        """How much faster than by name the amplifier's clock runs, in host seconds [ppm]."""
        return -1e6 * self._slope / (1 + self._slope)

    @property
    def round_trip(self) -> float:
        """The shortest of the window [s]; infinite before the first."""
        trips = (e.round_trip(self.tick_hz) for e in self._window)
        return max(min(trips, default=math.inf), 0.0)

    @property
    def locked(self) -> bool:
        """Whether there have been enough exchanges to start by."""
        return self._fed >= FIRST_PROBES
