"""Motion of a finger, estimated from noisy samples of its position by three weighted filters.

A finger rests, glides steadily, or starts and stops, and no single filter serves all of these: one
that smooths enough for a steady stroke is late when the stroke begins. Three Kalman filters with
the same model of motion therefore run in parallel and differ in the acceleration that they expect:
the interacting multiple model estimator of Blom and Bar-Shalom (IEEE Trans. Autom. Control 33,
1988). The model is Singer's (IEEE Trans. Aerosp. Electron. Syst. 6, 1970): position p, velocity v
and acceleration a per axis, where the acceleration decays with a time constant τ,

    a' = −a/τ + w,   w white with spectral density 2σ²/τ,

so that the prediction a time s ahead is p + v s + a τ² (s/τ − 1 + exp(−s/τ)). All three share τ, so
that the mean of the three, weighted by their likelihoods, predicts as each of them does. Both axes
share gains and covariances, because they share times and noise.

The noise of the samples is estimated from what no smooth motion explains: the divided difference of
four samples, which is 0 on every parabola, scaled so that its variance is that of one sample.

Measured in the same tracker (`benchmarks.tracking`: 90 Hz, delays of 5 ms rms, noise 0.05 mm, 12 ms
ahead), rms error in mm on a steady stroke, a 1 Hz swing of 200 mm/s, and a recorded slide at its
own and at five times its speed:

    these three                     0.07   0.26   0.13   0.85
    one, σ = 0.1 m/s²               0.10   0.50   0.14   1.63
    one, σ = 1 m/s²                 0.23   0.26   0.22   1.03
    one, σ = 10 m/s²                0.65   0.64   0.62   0.92
    double exponential, best        0.10   1.04   0.15   1.22
    line through 6 samples          0.08   1.36   0.18   1.58
    parabola through 6 samples      0.24   0.28   0.23   1.09
"""

import math
from collections import deque

Pair = tuple[float, float]
"""Vector, x and y."""
Triple = tuple[float, float, float]
Numbers = list[float]
"""State, or filter, as a list of plain numbers."""

ACCELERATIONS = (0.02, 0.7, 5.0)
"""Standard deviation σ of the acceleration in each filter [m/s²]: a glide, a 1 Hz swing of 200 mm/s
(1.3 m/s² peak), the start of a stroke. Chosen by measurement: doubling the last reduces the error
by 0.06 mm of 0.85 mm on a stroke that starts with 6.6 m/s², and overshoots by half as much again on
a slower one."""
FORGETTING = 0.3
"""Time constant τ of the acceleration, the duration of a finger's burst of acceleration [s]
(assumed; measured: 0.1 to 0.5 s differ little)."""
STAY = 1.0
"""Mean time that a finger keeps to one kind of motion [s]; chosen by measurement."""
LEAST = 1e-12
"""Smallest likelihood of a filter relative to the best, so that it can recover."""
PLACE, VELOCITY = (6, 7, 8), (7, 9, 10)
"""Indices in a filter of the covariances of position and of velocity with p, v and a."""
FIRST_SPEED = 0.15
"""Standard deviation of the velocity before it is known (assumed) [m/s]."""
VELOCITY_NOISE = 0.01
"""Standard deviation of a velocity that a client gives (assumed: 0.05 mm over 7 ms) [m/s]."""
NOISE = 5e-5
"""Initial standard deviation of a position, per axis (assumed) [m]."""
NOISE_RANGE = (1e-5, 1e-3)
"""Range of the estimated standard deviation of a position, per axis [m]."""
NOISE_MEMORY = 60
"""Number of samples over which the noise is averaged."""
FORGOTTEN = 0.25
"""Time without samples after which the filters start anew (assumed) [s]."""

SHORT, LONG = 0.03, 0.15
"""Time constants of the two means that tell rest from motion [s]."""
DWELL = 0.1
"""Time that a finger must stand still to be taken as resting, longer than the turn of a stroke
[s]."""
STANDS, LEAVES, DARTS = 3.0, 6.0, 6.0
"""Thresholds for rest and motion, in standard deviations. STANDS (of the fast mean): largest
distance of the two means at rest. LEAVES (of the fast mean) and DARTS (of a sample): distance from
the place of rest at which the finger leaves it. Noise alone exceeds the last once a day at 90
Hz."""


def basis(ahead: float) -> Pair:
    """Compute what acceleration adds to position and velocity after a time.

    Parameters
    ----------
    ahead : float
        Time [s].

    Returns
    -------
    tuple of 2 floats
        Displacement per acceleration [s²] and change of velocity per acceleration [s].
    """
    turn = FORGETTING * (1 - math.exp(-ahead / FORGETTING))
    return FORGETTING * (ahead - turn), turn


class Noise:
    """Noise of positions, estimated from what no parabola through four of them explains.

    Attributes
    ----------
    variance : float
        Variance per axis [m²].
    """

    def __init__(self) -> None:
        self.variance = NOISE**2
        self._last: deque[tuple[float, float, float]] = deque(maxlen=4)

    def forget_places(self) -> None:
        """Drop the positions so far, as the finger continues elsewhere; the noise is kept."""
        self._last.clear()

    def add(self, time: float, x: float, y: float, samples: int) -> None:
        """Add a position, the mean of one or more samples.

        Parameters
        ----------
        time : float
            Time of the position [s].
        x, y : float
            Position [m].
        samples : int
            Number of samples that it is the mean of.
        """
        self._last.append((time, x, y))
        if len(self._last) < 4:
            return
        sum_x = sum_y = squares = 0.0
        for t, px, py in self._last:
            weight = 1.0
            for other, _, _ in self._last:
                if other != t:
                    weight /= t - other
            sum_x, sum_y = sum_x + weight * px, sum_y + weight * py
            squares += weight * weight
        estimate = (sum_x * sum_x + sum_y * sum_y) / (2 * squares) * samples
        estimate = min(estimate, 9 * self.variance)
        low, high = NOISE_RANGE
        variance = self.variance + (estimate - self.variance) / NOISE_MEMORY
        self.variance = min(max(variance, low * low), high * high)


class Stillness:
    """Distinguishes a resting finger from a slow one, by two exponential means of its position.

    At a speed v the slow mean lags 120 ms · v behind the fast one. Noise of σ = 0.05 mm leaves a
    noise of 0.021 mm in the fast mean at 90 Hz, so that 0.5 mm/s keep the means three of these
    apart: a finger of 1 mm/s or more is always moving. It leaves its place of rest by moving 0.13
    mm, or 0.3 mm in one sample.

    Attributes
    ----------
    place : tuple of 2 floats or None
        Place where the finger rests [m]; None while it moves.
    """

    def __init__(self) -> None:
        self.begin(0.0, 0.0, 0.0, 0.0)

    def begin(self, time: float, x: float, y: float, variance: float) -> None:
        """Start anew at a place, with the finger moving.

        Parameters
        ----------
        time : float
            Present time [s].
        x, y : float
            Position [m].
        variance : float
            Variance of the position per axis [m²].
        """
        self.place: Pair | None = None
        self._fast = self._slow = (x, y)
        self._variance = variance
        self._time = self._since = time

    def add(self, time: float, x: float, y: float, variance: float) -> None:
        """Add a position.

        Parameters
        ----------
        time : float
            Time of the position [s].
        x, y : float
            Position [m].
        variance : float
            Variance of the position per axis [m²].
        """
        elapsed, self._time = time - self._time, time
        fast, slow = -math.expm1(-elapsed / SHORT), -math.expm1(-elapsed / LONG)
        (fx, fy), (sx, sy) = self._fast, self._slow
        fx, fy = self._fast = fx + fast * (x - fx), fy + fast * (y - fy)
        sx, sy = self._slow = sx + slow * (x - sx), sy + slow * (y - sy)
        self._variance += fast * (fast * variance - (2 - fast) * self._variance)
        if self.place is not None:
            px, py = self.place
            if math.hypot(fx - px, fy - py) > LEAVES * math.sqrt(self._variance) or math.hypot(
                x - px, y - py
            ) > DARTS * math.sqrt(variance):
                self.place, self._since = None, time
        elif math.hypot(fx - sx, fy - sy) > STANDS * math.sqrt(self._variance):
            self._since = time
        elif time - self._since >= DWELL:
            self.place = self._slow


class MotionFilter:
    """Three Kalman filters of one finger, mixed by likelihood.

    The arithmetic uses plain numbers, which takes a third of the time of small arrays.

    Parameters
    ----------
    accelerations : tuple of 3 floats
        Standard deviation of the acceleration in each filter [m/s²]; three equal values make a
        single Kalman filter.

    Attributes
    ----------
    time : float
        Time of the newest sample; −inf before the first [s].
    state : list of 6 floats
        Position [m], velocity [m/s] and acceleration [m/s²] at this time, each as x and y.
    noise : Noise
        Noise of the samples.
    """

    def __init__(self, accelerations: Triple = ACCELERATIONS) -> None:
        self._accelerations = accelerations
        self._densities = [2 * acceleration**2 / FORGETTING for acceleration in accelerations]
        self.time = -math.inf
        self.state: Numbers = [0.0] * 6
        self.noise = Noise()
        self._filters: list[Numbers] = []
        """State of each filter, relative to ``state``, and its covariances pp pv pa vv va aa."""
        self._likely = [1 / 3] * 3

    def begin(self, time: float, x: float, y: float, velocity: Pair | None = None) -> None:
        """Start anew at a place, keeping only the noise.

        Parameters
        ----------
        time : float
            Present time [s].
        x, y : float
            Position [m].
        velocity : tuple of 2 floats, optional
            Velocity, if it is known [m/s].
        """
        self.time = time
        self.state = [x, y, *(velocity or (0.0, 0.0)), 0.0, 0.0]
        speed = FIRST_SPEED if velocity is None else VELOCITY_NOISE
        self._filters = [
            [0.0] * 6 + [self.noise.variance, 0.0, 0.0, speed**2, 0.0, acceleration**2]
            for acceleration in self._accelerations
        ]
        self._likely = [1 / 3] * 3
        self.noise.forget_places()
        self.noise.add(time, x, y, 1)

    def place(self, time: float) -> Pair:
        """Predict the position of the finger.

        Parameters
        ----------
        time : float
            Time, not far from that of the newest sample [s].

        Returns
        -------
        tuple of 2 floats
            Expected position [m].
        """
        ahead = time - self.time
        bend, _ = basis(ahead)
        x, y, vx, vy, ax, ay = self.state
        return x + vx * ahead + ax * bend, y + vy * ahead + ay * bend

    def add(
        self, time: float, x: float, y: float, velocity: Pair | None = None, samples: int = 1
    ) -> None:
        """Add a position that is newer than all before, the mean of one or more samples.

        Parameters
        ----------
        time : float
            Time of the position [s].
        x, y : float
            Position [m].
        velocity : tuple of 2 floats, optional
            Velocity, if it is known [m/s].
        samples : int
            Number of samples that the position is the mean of.
        """
        self.noise.add(time, x, y, samples)
        elapsed, self.time = time - self.time, time
        self._mix(math.exp(-elapsed / STAY))
        bend, turn = basis(elapsed)
        self.state = _moved(self.state, elapsed, bend, turn)
        error = (x - self.state[0], y - self.state[1])
        velocity_error = velocity and (velocity[0] - self.state[2], velocity[1] - self.state[3])
        log_weights = []
        for k, before in enumerate(self._filters):
            now = _passed(before, elapsed, bend, turn, self._densities[k])
            log_likelihood = _correct(now, 0, PLACE, error, self.noise.variance / samples)
            if velocity_error:
                log_likelihood += _correct(now, 2, VELOCITY, velocity_error, VELOCITY_NOISE**2)
            self._filters[k] = now
            log_weights.append(log_likelihood + math.log(self._likely[k]))
        self._weigh(log_weights)

    def _mix(self, stay: float) -> None:
        """Allow for a change in the kind of motion: each filter becomes a mixture of the three."""
        change = (1 - stay) / 3
        raw = [_with_moments(f, 0.5) for f in self._filters]
        likely = [stay * m + change for m in self._likely]
        mixed = []
        for j, total in enumerate(likely):
            share = [change * m / total for m in self._likely]
            share[j] += stay * self._likely[j] / total
            a, b, c = share
            blend = [a * p + b * q + c * r for p, q, r in zip(*raw, strict=True)]
            mixed.append(_with_moments(blend, -0.5))
        self._filters, self._likely = mixed, likely

    def _weigh(self, votes: Numbers) -> None:
        """Weight the filters by their log likelihoods, and take their mean as the new state."""
        best = max(votes)
        weights = [math.exp(vote - best) + LEAST for vote in votes]
        total = sum(weights)
        a, b, c = self._likely = [weight / total for weight in weights]
        f, g, h = self._filters
        shift = [a * p + b * q + c * r for p, q, r in zip(f[:6], g[:6], h[:6], strict=True)]
        self.state = [s + d for s, d in zip(self.state, shift, strict=True)]
        for each in self._filters:
            each[:6] = [p - d for p, d in zip(each, shift, strict=False)]


def _moved(state: Numbers, elapsed: float, bend: float, turn: float) -> Numbers:
    """Return a state after a time, with the terms of `basis` for it."""
    x, y, vx, vy, ax, ay = state
    keep = 1 - turn / FORGETTING
    return [
        x + vx * elapsed + ax * bend,
        y + vy * elapsed + ay * bend,
        vx + ax * turn,
        vy + ay * turn,
        ax * keep,
        ay * keep,
    ]


def _passed(one: Numbers, t: float, bend: float, turn: float, density: float) -> Numbers:
    """Return a filter after a time t: F P Fᵀ plus what white jerk adds in a time below τ."""
    pp, pv, pa, vv, va, aa = one[6:]
    keep = 1 - turn / FORGETTING
    to_v, to_a = pv + t * vv + bend * va, pa + t * va + bend * aa
    v_to_a = va + turn * aa
    t2, q = t * t, density * t
    return [
        *_moved(one[:6], t, bend, turn),
        pp + t * (pv + to_v) + bend * (pa + to_a) + q * t2 * t2 / 20,
        to_v + turn * to_a + q * t2 * t / 8,
        keep * to_a + q * t2 / 6,
        vv + turn * (va + v_to_a) + q * t2 / 3,
        keep * v_to_a + q * t / 2,
        keep * keep * aa + q,
    ]


def _correct(one: Numbers, at: int, row: tuple[int, int, int], miss: Pair, noise: float) -> float:
    """Update a filter with a measurement, in place; return the logarithm of its likelihood.

    ``at`` is the index of the measured x in the state, ``row`` those of its covariances with p, v
    and a.
    """
    p, v, a = (one[k] for k in row)
    total = one[row[at // 2]] + noise
    x, y = miss[0] - one[at], miss[1] - one[at + 1]
    gain_p, gain_v, gain_a = p / total, v / total, a / total
    one[0] += gain_p * x
    one[1] += gain_p * y
    one[2] += gain_v * x
    one[3] += gain_v * y
    one[4] += gain_a * x
    one[5] += gain_a * y
    one[6] -= gain_p * p
    one[7] -= gain_p * v
    one[8] -= gain_p * a
    one[9] -= gain_v * v
    one[10] -= gain_v * a
    one[11] -= gain_a * a
    return -0.5 * (x * x + y * y) / total - math.log(total)


def _with_moments(one: Numbers, sign: float) -> Numbers:
    """Return a filter with the products of its state, mean of x and y, added to its covariances."""
    x, y, vx, vy, ax, ay, pp, pv, pa, vv, va, aa = one
    return [
        x, y, vx, vy, ax, ay,
        pp + sign * (x * x + y * y),
        pv + sign * (x * vx + y * vy),
        pa + sign * (x * ax + y * ay),
        vv + sign * (vx * vx + vy * vy),
        va + sign * (vx * ax + vy * ay),
        aa + sign * (ax * ax + ay * ay),
    ]  # fmt: skip
