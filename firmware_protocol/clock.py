"""Estimate of an amplifier's clock by the host, from exchanges of four timestamps (SPEC.md, 7.2).

The amplifier received a probe after the host had sent it and before the host had the answer. Each
exchange therefore bounds host time, as a function of the amplifier's time, from below (t1 at t2)
and from above (t4 at t3). The middle between the tightest lower and the tightest upper bound of the
last 8 exchanges, measured against the present estimate, feeds an exponentially weighted regression
of the host's lead over the amplifier's time.

Klipper's clocksync, which served as the model, feeds its regression with the shortest round trip.
The two tightest bounds need not belong to one exchange. Of n exponential delays the shortest lies
1/n of the mean above the floor, while the delays of the shortest of n round trips lie √n times as
far above it. With an equally long memory the error is a third to a half less (`python -m benchmarks
clock` measures both). The line in the middle of the widest band between all of 64 bounds, after
Moon, Skelly & Towsley (INFOCOM 1999), was no better with exponential delays and twice as bad where
short delays are rare, as on CAN.

No exchange can reveal a minimum delay that is longer in one direction: half the difference is an
error of the estimate. To avoid it, make both packets equally long, or pass a later `t1` and an
earlier `t4` by the time that each packet takes on the wire, and set the latency timer of FTDI
adapters to 1 ms.
"""

import math
from collections import deque
from dataclasses import dataclass

FIRST_PROBES = 8
"""Number of exchanges at the beginning, sent at the shorter interval, until the estimate counts
as locked."""
WINDOW = 8
"""Number of exchanges of which the tightest bounds are taken."""
GAIN = 1 / 48
"""Gain of the regression once it has had as many exchanges. It remembers 12 s, which equals a
gain of 1/12 for every fourth exchange, as the shortest round trip of 8 is. A clock that wanders
by 0.05 ppm/s, more than a crystal that warms up (assumed), is followed with a lag of 6 µs."""
PRIOR_TIME = 1.0
"""Spread of the amplifier's time that the regression assumes, without drift, before the first
exchange [s]. It is the error of the first samples, some 30 µs, divided by the drift of a
crystal, some 30 ppm (both assumed)."""
FIRST_INTERVAL, INTERVAL = 9.889e-3, 249.577e-3
"""Intervals between the first probes and between later ones [s]. They make probes fall on
devices that poll every 0.125, 1 or 16 ms (USB microframe and frame, FTDI's latency timer) at
ever other phases: 249.577 ms is 1996.62, 249.577 and 15.60 times as long. Probes every 250 ms
would stay in step with such polling."""
DRIFT_LIMIT = 0.02
"""Relative drift beyond which a clock has jumped: twice the 1 % of a microcontroller's RC
oscillator (assumed)."""
TURNAROUND = 2.5e-3
"""Longest time from reception to answer for which an amplifier's timestamp of reception is
trusted (SPEC.md, 7.2) [s]."""
LEAPS = 3
"""Number of consecutive exchanges that prove that a clock leapt ahead. A clock hardly ever does,
because an amplifier that was reset begins at 0. A single timestamp may be wrong, for example of
a counter that was read while it carried."""
SILENCE = 12.0
"""Longest time without an exchange, as long as the memory, after which the estimate begins anew
[s]. After a longer silence a restart of the amplifier could not be told from drift."""
FARTHEST = 1e10
"""Largest valid host time, more than 300 years [s]."""


@dataclass(frozen=True)
class Exchange:
    """An exchange of four timestamps.

    Attributes
    ----------
    t1, t4 : float
        Times at which the host sent the probe and received the answer [s].
    t2, t3 : int
        Times at which the amplifier received the probe and sent the answer [ticks].
    """

    t1: float
    t2: int
    t3: int
    t4: float

    def receipt_tick(self, tick_hz: float) -> int:
        """Return the first tick that is certain to be after `t1`: `t2`, or a much later `t3`.

        An amplifier that was held up may report as reception the time at which it found the packet.

        Parameters
        ----------
        tick_hz : float
            Nominal tick frequency [Hz].

        Returns
        -------
        int
            Time of reception or, after a long turnaround, of the answer [ticks].
        """
        return self.t3 if self.t3 - self.t2 > TURNAROUND * tick_hz else self.t2

    def round_trip(self, tick_hz: float) -> float:
        """Compute the time on the way, without a short turnaround of the amplifier.

        Parameters
        ----------
        tick_hz : float
            Nominal tick frequency [Hz].

        Returns
        -------
        float
            Sum of the delays in both directions [s].
        """
        return self.t4 - self.t1 - (self.t3 - self.receipt_tick(tick_hz)) / tick_hz

    def is_possible(self, tick_hz: float) -> bool:
        """Test whether the timestamps are in order and span no more than the memory.

        Ticks may be off by one, and may run at another rate within `DRIFT_LIMIT`.

        Parameters
        ----------
        tick_hz : float
            Nominal tick frequency [Hz].

        Returns
        -------
        bool
            Whether the exchange can have happened.
        """
        in_order = -FARTHEST < self.t1 <= self.t4 < FARTHEST and 0 <= self.t2 <= self.t3 < 2**64
        if not in_order or self.t4 - self.t1 > SILENCE:
            return False
        slack = (1 + DRIFT_LIMIT * (self.t3 - self.t2)) / tick_hz
        return self.round_trip(tick_hz) >= -slack

    def continues(self, last: "Exchange", tick_hz: float) -> bool:
        """Test whether this exchange can belong to the same run of the amplifier as an earlier one.

        Parameters
        ----------
        last : Exchange
            The earlier exchange.
        tick_hz : float
            Nominal tick frequency [Hz].

        Returns
        -------
        bool
            Whether the elapsed ticks agree with the elapsed host time.
        """
        if not last.t1 < self.t1 <= last.t4 + SILENCE:
            return False
        least, most = self.t1 - last.t4, self.t4 - last.t1
        from_answer = (self.receipt_tick(tick_hz) - last.t3 + 1) / tick_hz
        to_answer = (self.t3 - last.receipt_tick(tick_hz) - 1) / tick_hz
        not_behind = from_answer >= least - DRIFT_LIMIT * abs(least)
        return not_behind and to_answer <= most + DRIFT_LIMIT * most

    def is_anew(self, last: "Exchange") -> bool:
        """Test whether this exchange alone proves another run of the amplifier or a long silence.

        Parameters
        ----------
        last : Exchange
            The earlier exchange.

        Returns
        -------
        bool
            Whether the ticks went back, or the host times are too far apart.
        """
        return self.t2 < last.t2 or not last.t1 - SILENCE <= self.t1 <= last.t4 + SILENCE


class ClockEstimator:
    """Estimator of the mapping between an amplifier's clock and the host's.

    It has no clock of its own and sends nothing. Between two exchanges the mapping is strictly
    monotonic in both directions; an exchange moves it by some microseconds, either way. Before the
    first exchange tick 0 is at host time 0.

    Parameters
    ----------
    tick_hz : float
        Nominal tick frequency, from CAPS [Hz].

    Attributes
    ----------
    tick_hz : float
        The parameter of the same name.
    accepted : int
        Number of exchanges that were used.
    rejected : int
        Number of exchanges that are impossible, repeated or overtaken, or that leap where the next
        ones do not confirm it.
    restarts : int
        Number of times that the estimate began anew, because the amplifier's clock did or after a
        silence.

    Raises
    ------
    ValueError
        If `tick_hz` is not positive and finite.
    """

    def __init__(self, tick_hz: float) -> None:
        if not 0 < tick_hz < math.inf:
            raise ValueError(f"tick_hz {tick_hz:g} must be positive and finite")
        self.tick_hz = float(tick_hz)
        self.accepted = self.rejected = self.restarts = 0
        self._window: deque[Exchange] = deque(maxlen=WINDOW)
        self._leaps: list[Exchange] = []
        self._next_probe = -math.inf
        self._errors: list[tuple[float, float]] | None = None
        self._begin(Exchange(0.0, 0, 0, 0.0))

    def _begin(self, first: Exchange) -> None:
        """Forget everything and count time from an exchange."""
        self._window.clear()
        self._origin, self._origin_ticks = first.t1, first.t2
        self._mean_x = self._mean_y = self._slope = 0.0
        self._variance, self._covariance = PRIOR_TIME**2, 0.0
        self._fed = self._probes = 0

    def probe_due(self, now: float) -> bool:
        """Test whether a probe is due; each True counts as a probe that was sent.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        bool
            Whether to send a probe now.
        """
        if now < self._next_probe:
            return False
        self._probes += 1
        self._next_probe = now + (FIRST_INTERVAL if self._probes < FIRST_PROBES else INTERVAL)
        return True

    def add(self, t1: float, t2: int, t3: int, t4: float) -> bool:
        """Add an exchange.

        An exchange that leaps ahead or lags by more than an oscillator can drift may have a wrong
        timestamp. It is dropped, and the next exchanges, which follow soon, decide whether the
        clock leapt.

        Parameters
        ----------
        t1 : float
            Host time at which the probe was sent [s].
        t2 : int
            Amplifier time at which it was received [ticks].
        t3 : int
            Amplifier time at which the answer was sent [ticks].
        t4 : float
            Host time at which it was received [s].

        Returns
        -------
        bool
            Whether the exchange was used; otherwise it is counted as rejected.
        """
        new, last = Exchange(t1, t2, t3, t4), self._window[-1] if self._window else None
        is_overtaken = last is not None and last.t1 - SILENCE <= t1 <= last.t1 and t2 <= last.t2
        if is_overtaken or not new.is_possible(self.tick_hz):
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
        """Return whether the clock has begun anew, rather than a few timestamps being wrong."""
        is_confirmed = bool(self._leaps) and new.continues(self._leaps[-1], self.tick_hz)
        self._leaps = [*self._leaps, new] if is_confirmed else [new]
        return len(self._leaps) == LEAPS or new.is_anew(last)

    def _feed(self) -> None:
        """Feed the middle between the tightest bounds of the window into the regression."""
        self._errors = None
        below, above = self._bounds()
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

    def _bounds(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Return times of the amplifier before which, and after which, host times were [s].

        Both are counted from the first exchange.
        """
        sent = [(e.t1, e.receipt_tick(self.tick_hz)) for e in self._window]
        below = [(self._seconds(receipt), t1 - self._origin) for t1, receipt in sent]
        above = [(self._seconds(e.t3), e.t4 - self._origin) for e in self._window]
        return below, above

    def _lead(self, seconds: float) -> float:
        """Return host time minus nominal amplifier time [s], both since the first exchange."""
        return self._mean_y + self._slope * (seconds - self._mean_x)

    def _seconds(self, ticks: int) -> float:
        """Return the nominal amplifier time since the first exchange [s]."""
        return (ticks - self._origin_ticks) / self.tick_hz

    def ticks_at(self, host_time: float) -> int:
        """Convert a host time to the amplifier's time.

        Parameters
        ----------
        host_time : float
            Host time [s].

        Returns
        -------
        int
            Amplifier time [ticks].
        """
        lead = self._lead(host_time - self._origin) / (1 + self._slope)
        return self._origin_ticks + round((host_time - self._origin - lead) * self.tick_hz)

    def host_time_at(self, ticks: int) -> float:
        """Convert an amplifier's time to host time.

        Parameters
        ----------
        ticks : int
            Amplifier time [ticks].

        Returns
        -------
        float
            Host time [s].
        """
        seconds = self._seconds(ticks)
        return self._origin + seconds + self._lead(seconds)

    def uncertainty_at(self, ticks: int) -> float:
        """Return half of an interval around `host_time_at` that holds the true host time.

        The amplifier received each probe of the window after it was sent, and sent each answer
        before that was received, however long either was on its way. So the clock is a straight
        line between these bounds, as far as it keeps its rate for the seconds of the window; the
        interval holds all such lines that drift no more than `DRIFT_LIMIT`.

        Parameters
        ----------
        ticks : int
            Amplifier time [ticks].

        Returns
        -------
        float
            Half of the interval; infinite before the first exchange [s].
        """
        if not self._window:
            return math.inf
        if self._errors is None:
            self._errors = self._possible_errors()
        since = self._seconds(ticks) - self._seconds(self._window[-1].t3)
        return max((abs(error + slope * since) for error, slope in self._errors), default=math.inf)

    def _possible_errors(self) -> list[tuple[float, float]]:
        """Return the corners of the region of possible errors of the present estimate.

        Each is an error at the newest answer [s], and what it grows by [s/s]. The region is clipped
        by one bound after the other (Sutherland & Hodgman, 1974); a bound may be off by a tick.
        """
        now, tick = self._seconds(self._window[-1].t3), 1 / self.tick_hz
        below, above = self._bounds()
        bounds = [(x, host, 1) for x, host in below] + [(x, host, -1) for x, host in above]
        slopes = -DRIFT_LIMIT - self._slope, DRIFT_LIMIT - self._slope
        corners = [(error, slope) for slope in slopes for error in (-SILENCE, SILENCE)]
        corners[2:] = reversed(corners[2:])  # around the region
        for x, host, side in bounds:
            bound = host - x - self._lead(x)
            inside = [side * (e + s * (x - now) - bound) + tick for e, s in corners]
            clipped = []
            for k, ((error, slope), distance) in enumerate(zip(corners, inside, strict=True)):
                before = inside[k - 1]
                if (before < 0) != (distance < 0):
                    part = before / (before - distance)
                    (e, s) = corners[k - 1]
                    clipped.append((e + part * (error - e), s + part * (slope - s)))
                if distance >= 0:
                    clipped.append((error, slope))
            corners = clipped
        return corners

    @property
    def next_probe(self) -> float:
        """Host time from which a probe is due [s]."""
        return self._next_probe

    @property
    def drift_ppm(self) -> float:
        """Relative deviation of the amplifier's clock from nominal; positive if fast [ppm]."""
        return -1e6 * self._slope / (1 + self._slope)

    @property
    def round_trip(self) -> float:
        """Shortest round trip of the window; infinite before the first exchange [s]."""
        trips = (e.round_trip(self.tick_hz) for e in self._window)
        return max(min(trips, default=math.inf), 0.0)

    @property
    def locked(self) -> bool:
        """Whether there have been enough exchanges to start a stream."""
        return self._fed >= FIRST_PROBES
