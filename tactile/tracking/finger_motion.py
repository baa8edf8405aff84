"""How a finger moves, from noisy samples of its place: three filters that vote.

A finger rests, glides steadily, or sets off and stops, and no single filter serves all: one that
smooths enough for a steady stroke is late when the stroke begins. So three Kalman filters of one
model of motion run side by side, and differ in how hard they expect the finger to accelerate: the
interacting multiple model estimator of Blom and Bar-Shalom (IEEE Trans. Autom. Control 33, 1988).
The model is Singer's (IEEE Trans. Aerosp. Electron. Syst. 6, 1970): place p, velocity v and
acceleration a per axis, the acceleration forgotten with a time constant τ,

    a' = −a/τ + w,   w white with spectral density 2σ²/τ,

so that a prediction s ahead is p + v s + a τ² (s/τ − 1 + exp(−s/τ)). All share τ, so that the mean
of the three, weighted by how likely each is, predicts as each of them does. Both axes share gains
and covariances, since they share times and noise.

The noise of the samples is estimated from what no smooth motion explains: the divided difference
of four samples, which is zero on every parabola, scaled so that its variance is that of one sample.

Measured in the same tracker (`benchmarks.tracking`: 90 Hz, delays of 5 ms rms, noise 0.05 mm,
12 ms ahead), rms error in mm on a steady stroke, a 1 Hz swing of 200 mm/s and a recorded slide at
once and five times its speed:

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
Triple = tuple[float, float, float]
Numbers = list[float]

ACCELERATIONS = (0.02, 0.7, 5.0)
"""σ of each filter [m/s²]: a glide, a 1 Hz swing of 200 mm/s (1.3 m/s² peak), a stroke that sets
off. By measurement: twice the last gains 0.06 mm of 0.85 on a stroke that sets off with 6.6 m/s²,
and overshoots by half as much again where a slower one does."""
FORGETTING = 0.3
"""τ [s], the duration of a finger's burst of acceleration (assumed; measured: 0.1 to 0.5 differ
little)."""
STAY = 1.0
"""Mean time that a finger keeps to one kind of motion [s]; chosen by measurement."""
LEAST = 1e-12
"""Likelihood that a filter keeps against the best, so that it can return."""
PLACE, VELOCITY = (6, 7, 8), (7, 9, 10)
"""Where a filter's covariances of place and of velocity with p, v and a are."""
FIRST_SPEED = 0.15
"""Standard deviation of the velocity before it is known [m/s] (assumed)."""
VELOCITY_NOISE = 0.01
"""Standard deviation of a velocity that a client gives [m/s] (assumed: 0.05 mm over 7 ms)."""
NOISE = 5e-5
"""Standard deviation of a place before it is known, per axis [m] (assumed)."""
NOISE_RANGE = (1e-5, 1e-3)
NOISE_MEMORY = 60
"""Samples over which the noise is averaged."""
FORGOTTEN = 0.25
"""Time without samples after which everything begins anew [s] (assumed)."""

SHORT, LONG = 0.03, 0.15
"""Time constants of the two means that tell rest from motion [s]."""
DWELL = 0.1
"""s that a finger stands before it is taken as resting, longer than the turn of a stroke."""
STANDS, LEAVES, DARTS = 3.0, 6.0, 6.0
"""Standard deviations: of the fast mean, the means apart at rest; of the fast mean and of a sample,
from the place of rest when leaving it. Chance does the latter once in a day at 90 Hz."""


def basis(ahead: float) -> Pair:
    """Return what acceleration adds to place and velocity after a time [s]."""
    turn = FORGETTING * (1 - math.exp(-ahead / FORGETTING))
    return FORGETTING * (ahead - turn), turn


class Noise:
    """The noise of places, from what no parabola through four of them explains.

    Attributes
    ----------
    variance : per axis [m²]
    """

    def __init__(self) -> None:
        self.variance = NOISE**2
        self._last: deque[tuple[float, float, float]] = deque(maxlen=4)

    def forget_places(self) -> None:
        """Begin anew at another place; the noise stays what it is."""
        self._last.clear()

    def add(self, time: float, x: float, y: float, samples: int) -> None:
        """Take a place that is the mean of some samples."""
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
        found = (sum_x * sum_x + sum_y * sum_y) / (2 * squares) * samples
        found = min(found, 9 * self.variance)
        low, high = NOISE_RANGE
        variance = self.variance + (found - self.variance) / NOISE_MEMORY
        self.variance = min(max(variance, low * low), high * high)


class Stillness:
    """Tells a resting finger from a slow one, by two exponential means of its place.

    At a speed v the slow mean lags 120 ms · v behind the fast one. Noise of σ = 0.05 mm leaves the
    fast mean 0.021 mm at 90 Hz, so that 0.5 mm/s keep them three of these apart: a finger of
    1 mm/s or more is always moving. It leaves its place by 0.13 mm, or 0.3 mm in one sample.

    Attributes
    ----------
    place : where the finger rests [m]; None while it moves
    """

    def __init__(self) -> None:
        self.begin(0.0, 0.0, 0.0, 0.0)

    def begin(self, time: float, x: float, y: float, variance: float) -> None:
        """Begin anew at a place, moving."""
        self.place: Pair | None = None
        self._fast = self._slow = (x, y)
        self._variance = variance
        self._time = self._since = time

    def add(self, time: float, x: float, y: float, variance: float) -> None:
        """Take a place [m] with its variance per axis [m²]."""
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
    """Three Kalman filters of one finger, mixed.

    In plain numbers, which takes a third of the time that small arrays would.

    Parameters
    ----------
    accelerations : of the three [m/s²]; three times the same is a single Kalman filter

    Attributes
    ----------
    time : of the newest sample [s]; −inf before the first
    state : place [m], velocity [m/s] and acceleration [m/s²] at this time, each x and y
    noise : `Noise` of the samples
    """

    def __init__(self, accelerations: Triple = ACCELERATIONS) -> None:
        self._accelerations = accelerations
        self._densities = [2 * acceleration**2 / FORGETTING for acceleration in accelerations]
        self.time = -math.inf
        self.state: Numbers = [0.0] * 6
        self.noise = Noise()
        self._filters: list[Numbers] = []
        """Of each the state as above, against ``state``, and the covariances pp pv pa vv va aa."""
        self._likely = [1 / 3] * 3

    def begin(self, time: float, x: float, y: float, velocity: Pair | None = None) -> None:
        """Forget all but the noise, and stand at a place."""
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
        """Return where the finger is expected [m] at a time [s] not far from the newest sample."""
        ahead = time - self.time
        bend, _ = basis(ahead)
        x, y, vx, vy, ax, ay = self.state
        return x + vx * ahead + ax * bend, y + vy * ahead + ay * bend

    def add(
        self, time: float, x: float, y: float, velocity: Pair | None = None, samples: int = 1
    ) -> None:
        """Take a place (x, y) [m], the mean of some samples, later than the newest."""
        self.noise.add(time, x, y, samples)
        elapsed, self.time = time - self.time, time
        self._mix(math.exp(-elapsed / STAY))
        bend, turn = basis(elapsed)
        self.state = _moved(self.state, elapsed, bend, turn)
        miss = (x - self.state[0], y - self.state[1])
        swerve = velocity and (velocity[0] - self.state[2], velocity[1] - self.state[3])
        votes = []
        for k, before in enumerate(self._filters):
            now = _passed(before, elapsed, bend, turn, self._densities[k])
            vote = _correct(now, 0, PLACE, miss, self.noise.variance / samples)
            if swerve:
                vote += _correct(now, 2, VELOCITY, swerve, VELOCITY_NOISE**2)
            self._filters[k] = now
            votes.append(vote + math.log(self._likely[k]))
        self._count(votes)

    def _mix(self, stay: float) -> None:
        """Let the finger change its way of moving: each filter becomes a mixture of the three."""
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

    def _count(self, votes: Numbers) -> None:
        """Weigh the filters by their votes, and take their mean as the new state."""
        best = max(votes)
        weights = [math.exp(vote - best) + LEAST for vote in votes]
        total = sum(weights)
        a, b, c = self._likely = [weight / total for weight in weights]
        f, g, h = self._filters
        shift = [a * p + b * q + c * r for p, q, r in zip(f[:6], g[:6], h[:6], strict=True)]
        self.state = [s + d for s, d in zip(self.state, shift, strict=True)]
        for one in self._filters:
            one[:6] = [p - d for p, d in zip(one, shift, strict=False)]


def _moved(state: Numbers, elapsed: float, bend: float, turn: float) -> Numbers:
    """Return a state after a time."""
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
    """Return a filter after a time t: F P Fᵀ and what white jerk adds in a time below τ."""
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
    """Give a filter a measurement, in place; return the logarithm of its likelihood.

    ``at`` is where the state's x is that was measured, ``row`` its covariances with p, v and a.
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
    """Return a filter with the products of its state added to its covariances, mean of x and y."""
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
