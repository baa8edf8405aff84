"""Where the finger will be when what is rendered now comes out, from samples that come late.

A client samples the finger 30 to 1000 times a second and sends what it sees; the samples arrive
with jitter, some late, some never. The playback loop renders blocks that reach the skin 8 to 14 ms
from now. `ContactTracker.add` takes samples, `ContactTracker.at` answers for the times of a block:

1. **Motion** (`tactile.tracking.finger_motion`): Kalman filters turn samples into place, velocity
   and acceleration at the newest sample. Such a state predicts a *course* p(s), s after the sample.
   Up to 60 ms ahead the course is what the filters predict; beyond, its clock runs slower and
   slower, and it comes to rest within another 20 ms: u(s) = H + D (1 − exp(−(s − H)/D)).
2. **Rest** (`Stillness`, there too): a finger that does not move significantly has a course that
   stands still, exactly, however much its samples tremble.
3. **Path** (`Path`): each sample changes the course, never the place that is played. What the new
   course differs by from the path so far, in place e and velocity e', is carried on and forgotten:

       path(t) = course(t) + (e + (e' + ω e) t) exp(−ω t),    t since the change,

   the critically damped solution of e'' + 2ω e' + ω² e = 0. The path is C¹; a change bends it by no
   more than ω² |e| + 2ω |e'|. It is forgotten slowly (1/ω = 20 ms) on a slow finger, that must not
   tremble, fast (3 ms) on a fast one, that must not be late.
4. **Press** (`Press`): the force follows the samples' in the same way, unpredicted, times a
   presence that rises from 0 to 1 and falls back to 0, exactly, along cubics. The place moves
   freely only while the presence is 0: a contact elsewhere waits until the last has gone.

All are closed forms of time since the last change. Changes take place at a block's first time,
when samples have come, or at a time of their own, for which a block is cut in two; so with the same
samples added at the same times the path is the same however the blocks are cut.

What prediction can do is bounded. At 90 Hz the newest sample is 5.5 ms old in the mean, its delay
comes to that, and 12 ms lie ahead; a finger that sets off at 6.6 m/s² goes 0.5 mm in 12 ms and
1.5 mm in 21.5 ms before anything that is played can know (`benchmarks.tracking`).

LaViola ("Double exponential smoothing: an alternative to Kalman filter-based predictive
tracking", EGVE 2003) found smoothing as good as single Kalman filters; both are measured beside
this in the benchmark, as is Casiez, Roussel and Vogel's thought (1€ filter, CHI 2012) that a finger
that rests wants smoothness and one that moves wants speed, which is here what the filters vote on.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats
from tactile.rendering.contact import LARGEST_FORCE, LARGEST_POSITION, LARGEST_SPEED
from tactile.tracking.finger_motion import (
    FORGETTING,
    FORGOTTEN,
    MotionFilter,
    Numbers,
    Pair,
    Stillness,
    basis,
)

SILENCE = 0.1
"""Age of the newest arrival at which the finger is taken as gone [s]."""
HORIZON = 0.06
"""How far a course is trusted beyond its sample [s]: two periods at 90 Hz, delay and latency."""
BRAKING = 0.02
"""D above [s]."""
SETTLING, SLOW_SETTLING = 0.003, 0.02
"""1/ω of the path at speed and at rest [s]: shorter is noisier, longer is later. By measurement."""
SLOW = 0.03
"""Speed at which it is between [m/s]: slow motion must not tremble, fast motion not be late."""
CATCHING_UP = 0.01
"""What is left to correct counts as speed, as if gone in this time [s]."""
FORCE_SETTLING = 0.005
"""1/ω of the force [s] (assumed)."""
CLEARING = 0.0032
"""Between the place's jump and the force's rise [s]: 8 samples at 2.5 kHz, which the renderer reads
its velocity from."""
ONSET = 0.01
FALL = 0.018
"""Duration of the presence's rise and fall [s]."""
CLEAR = 5e-4
"""s without force before the place may jump: one sample at 2.5 kHz."""
FASTEST = 3.0
"""m/s between two samples, above which the finger was lifted; a fast stroke is below 1 m/s."""
SMALLEST_LEAP = 5e-3
"""m; below it no two samples are too fast, since times jitter."""
FARTHEST_MISS = 20e-3
"""m from where it was expected, above which the finger was lifted."""
TOGETHER = 0.004
"""s; samples that wait and lie within are averaged."""
MOST_WAITING = 256
EARLIEST = 0.05
"""s; samples from further in the future are invalid. A clock map that still settles is ahead."""
OLDEST = 1.0
"""s; samples from further in the past are late, whatever came before."""
SAME = 1e-5
"""s; two samples within are one."""


class Sample(NamedTuple):
    """What a client said, in our time."""

    time: float
    x: float
    y: float
    normal_force: float
    velocity: Pair | None
    arrival: float


class Path:
    """The place that is played: a course and what is left of its corrections.

    Attributes
    ----------
    settling : 1/ω of the last correction [s]
    """

    def __init__(self) -> None:
        self._origin = self._changed = 0.0
        self.settling = SETTLING
        self._rows: list[Numbers] = [[0.0, 0.0] for _ in range(5)]
        self._table = np.array(self._rows)

    def jump(self, origin: float, state: Numbers) -> None:
        """Be on a course, wherever the path was."""
        self._origin = self._changed = origin
        self._rows = [state[:2], state[2:4], state[4:], [0.0, 0.0], [0.0, 0.0]]
        self._table = np.array(self._rows)

    def bend(self, time: float, origin: float, state: Numbers) -> None:
        """Go over to another course at a time, with place and velocity kept.

        ``state`` is place, velocity and acceleration, each x and y, at the time ``origin``.
        """
        place, velocity = self.now(time)
        ahead, slower = _elapsed(time - origin)
        bend, turn = basis(ahead)
        x, y, vx, vy, ax, ay = state
        ex = place[0] - (x + vx * ahead + ax * bend)
        ey = place[1] - (y + vy * ahead + ay * bend)
        pace = max(math.hypot(vx, vy), math.hypot(ex, ey) / CATCHING_UP) / SLOW
        self.settling = SETTLING + (SLOW_SETTLING - SETTLING) / (1 + pace * pace)
        rate_x = velocity[0] - slower * (vx + ax * turn) + ex / self.settling
        rate_y = velocity[1] - slower * (vy + ay * turn) + ey / self.settling
        self._origin, self._changed = origin, time
        self._rows = [[x, y], [vx, vy], [ax, ay], [ex, ey], [rate_x, rate_y]]
        self._table = np.array(self._rows)

    def now(self, time: float) -> tuple[Numbers, Numbers]:
        """Return place [m] and velocity [m/s] at one time."""
        ahead, slower = _elapsed(time - self._origin)
        bend, turn = basis(ahead)
        since = max(time - self._changed, 0.0)
        left = math.exp(-since / self.settling)
        place, velocity = [], []
        for p, v, a, e, rate in zip(*self._rows, strict=True):
            error = (e + rate * since) * left
            place.append(p + v * ahead + a * bend + error)
            velocity.append(slower * (v + a * turn) + rate * left - error / self.settling)
        return place, velocity

    def at(self, times: Floats) -> Floats:
        """Return places (S, 2) [m]."""
        ahead, since = times - self._origin, times - self._changed
        if ahead[-1] > HORIZON or ahead[0] < -HORIZON or since[0] < 0:
            over = np.maximum(ahead - HORIZON, 0)
            ahead = np.clip(ahead, -HORIZON, HORIZON)
            ahead -= BRAKING * np.expm1(over * (-1 / BRAKING))
            since = np.maximum(since, 0)
        terms = np.empty((5, len(times)))
        terms[0], terms[1] = 1.0, ahead
        np.expm1(ahead * (-1 / FORGETTING), out=terms[2])
        terms[2] *= FORGETTING**2
        terms[2] += ahead * FORGETTING
        np.exp(since * (-1 / self.settling), out=terms[3])
        np.multiply(terms[3], since, out=terms[4])
        return np.asarray(terms.T @ self._table)


def _elapsed(ahead: float) -> Pair:
    """Return the time u(s) that passes on a course in a time s, and its rate u'(s)."""
    if -HORIZON <= ahead <= HORIZON:
        return ahead, 1.0
    slower = math.exp(-max(ahead - HORIZON, 0.0) / BRAKING)
    return min(max(ahead, -HORIZON), HORIZON) + BRAKING * (1 - slower), slower


class Press:
    """The normal force that is played: the samples', smoothed, times a presence."""

    def __init__(self) -> None:
        self._target = self._error = self._rate = self._changed = 0.0
        self._start = self._value = self._slope = self._goal = 0.0
        self._duration = 1.0

    def begin(self, time: float, force: float) -> None:
        """Let a contact begin [N]."""
        self._target, self._error, self._rate, self._changed = force, 0.0, 0.0, time
        self._start, self._duration = time + CLEARING, ONSET
        self._value, self._slope, self._goal = 0.0, 0.0, 1.0

    def follow(self, time: float, force: float) -> None:
        """Go over to another force [N] at a time."""
        since = max(time - self._changed, 0.0)
        left = math.exp(-since / FORCE_SETTLING)
        error = (self._error + self._rate * since) * left
        speed = self._rate * left - error / FORCE_SETTLING
        error += self._target - force
        self._target, self._changed = force, time
        self._error, self._rate = error, speed + error / FORCE_SETTLING

    def end(self, time: float) -> float:
        """Let the contact end from a time on; return when it will have, and the place may jump."""
        since = min(max((time - self._start) / self._duration, 0.0), 1.0)
        value = since * since * (3 - 2 * since)
        self._slope = 6 * since * (1 - since) / self._duration
        self._value, self._goal = value, 0.0
        self._start, self._duration = time, FALL
        return time + FALL + CLEAR if value else time

    def at(self, times: Floats) -> Floats:
        """Return forces (S,) [N]."""
        since = np.maximum(times - self._changed, 0)
        force = (since * self._rate + self._error) * np.exp(since * (-1 / FORCE_SETTLING))
        force += self._target
        if times[0] - self._start < self._duration:
            force *= self._presence(times)
        elif not self._goal:
            force[:] = 0.0
        return np.asarray(force)

    def _presence(self, times: Floats) -> Floats:
        """Return the cubic from value and slope to the goal, (S,)."""
        r = np.clip((times - self._start) / self._duration, 0, 1)
        step = r * r * (3 - 2 * r)
        cubic = self._value + (self._goal - self._value) * step
        return np.asarray(cubic + self._slope * self._duration * r * (1 - r) ** 2)


class ContactTracker:
    """Turns a client's samples into what is played, block by block.

    Parameters
    ----------
    motion : another filter than `MotionFilter`, to compare

    Attributes
    ----------
    touching : whether the newest sample was in contact, and is not too old
    late : samples older than one before, or of the same time; left out
    invalid : samples that were not finite or beyond reason; left out
    dropped : samples for which there was no room because `at` was not called
    jumps : leaps of the finger, each taken as lifting it and touching elsewhere
    silences : contacts that ended because nothing more was heard
    """

    def __init__(self, *, motion: MotionFilter | None = None) -> None:
        self.touching = False
        self.late = self.invalid = self.dropped = self.jumps = self.silences = 0
        self._waiting: deque[Sample] = deque(maxlen=MOST_WAITING)
        self._motion, self._stillness = motion or MotionFilter(), Stillness()
        self._path, self._press = Path(), Press()
        self._last: Sample | None = None
        self._arrival = -math.inf
        self._down = self._leapt = self._fresh = False
        self._rest: Pair | None = None
        self._gone = -math.inf
        """When the presence is or was 0 again, while not down."""
        self._time = 0.0

    @property
    def velocity(self) -> Floats:
        """Velocity (2,) of the place at the end of the last block [m/s]; 0 without contact."""
        return np.array(self._path.now(self._time)[1])

    def add(
        self,
        time: float,
        position: ArrayLike,
        normal_force: float,
        velocity: ArrayLike | None = None,
        *,
        arrival: float | None = None,
    ) -> None:
        """Take a sample, in any order, whatever it says.

        Parameters
        ----------
        time : at which it was taken, in our clock [s]
        position : (2,) of the finger over the surface [m]
        normal_force : [N]; 0 is lifted
        velocity : (2,) [m/s], where the client knows it
        arrival : when it came [s]; ``time`` where not given
        """
        try:
            x, y = map(float, position)  # type: ignore[arg-type]
            pace = None
            if velocity is not None:
                vx, vy = map(float, velocity)  # type: ignore[arg-type]
                pace = vx, vy
            came = float(time if arrival is None else arrival)
            sample = Sample(float(time), x, y, float(normal_force), pace, came)
        except (TypeError, ValueError, OverflowError):
            self.invalid += 1
            return
        if not _reasonable(sample):
            self.invalid += 1
            return
        self.dropped += len(self._waiting) == MOST_WAITING
        self._waiting.append(sample)

    def at(self, times: ArrayLike, now: float) -> tuple[Floats, Floats]:
        """Return position (S, 2) [m] and normal force (S,) [N] at times.

        Parameters
        ----------
        times : (S,) at which the samples come out, ascending from block to block, our clock [s]
        now : our clock's time [s]
        """
        moments = np.asarray(times, np.float64)
        if not moments.size:
            return np.zeros((0, 2)), np.zeros(0)
        if self._waiting:
            self._take(now)
        begin, end = float(moments[0]), float(moments[-1])
        silent = begin + self._arrival + SILENCE - now
        if self.touching and begin >= silent:
            self.touching = False
            self.silences += 1
        self._turn(begin)
        cut = silent if self.touching else math.inf
        if not self._down and begin < self._gone:
            cut = min(cut, self._gone)
        if begin < cut <= end:
            k = int(np.searchsorted(moments, cut))
            first = self._play(moments[:k])
            then = self.at(moments[k:], now + float(moments[k]) - begin)
            return np.concatenate([first[0], then[0]]), np.concatenate([first[1], then[1]])
        return self._play(moments)

    def _play(self, times: Floats) -> tuple[Floats, Floats]:
        self._time = float(times[-1])
        return self._path.at(times), self._press.at(times)

    def _turn(self, time: float) -> None:
        """Let contact begin, end or go on, and the path follow the samples, from a time on."""
        motion, last = self._motion, self._last
        if self._down:
            if self._leapt or not self.touching or last is None:
                self._down = False
                self._gone = self._press.end(time)
            elif self._fresh:
                self._press.follow(time, last.normal_force)
                if self._stillness.place is None or self._stillness.place != self._rest:
                    self._rest = self._stillness.place
                    self._path.bend(time, motion.time, self._course())
        if not self._down and time >= self._gone:
            if self.touching and last is not None:
                self._down, self._leapt = True, False
                self._press.begin(time, last.normal_force)
                self._rest = self._stillness.place
                self._path.jump(motion.time, self._course())
            elif self._gone > -math.inf:
                self._hold(self._gone)
        self._fresh = False

    def _hold(self, time: float) -> None:
        """Stay where the contact ended."""
        self._path.jump(time, [*self._path.now(time)[0], 0.0, 0.0, 0.0, 0.0])
        self._gone = -math.inf

    def _course(self) -> Numbers:
        if self._rest is not None:
            return [*self._rest, 0.0, 0.0, 0.0, 0.0]
        return self._motion.state

    def _take(self, now: float) -> None:
        """Give the samples that wait to the filters, in order of their times."""
        samples, group = sorted(self._waiting, key=lambda s: s.time), list[Sample]()
        self._waiting.clear()
        newest = self._motion.time
        for sample in samples:
            if max(sample.time, sample.arrival) > now + EARLIEST:
                self.invalid += 1
                continue
            if sample.time < max(newest + SAME, now - OLDEST):
                self.late += 1
                continue
            newest = sample.time
            if group and (sample.time - group[0].time > TOGETHER or _differ(group[-1], sample)):
                self._give(group)
                group = []
            group.append(sample)
        if group:
            self._give(group)

    def _give(self, group: list[Sample]) -> None:
        """Give the mean of samples to the filters; begin anew where the finger leapt."""
        count, first, last = len(group), group[0], group[-1]
        time, x, y, pace = first[0], first[1], first[2], first.velocity
        if count > 1:
            time = math.fsum(s.time for s in group) / count
            x, y = math.fsum(s.x for s in group) / count, math.fsum(s.y for s in group) / count
            if pace is not None:
                vx, vy = zip(*(s.velocity or pace for s in group), strict=True)
                pace = math.fsum(vx) / count, math.fsum(vy) / count
        motion = self._motion
        leapt = self._last is not None and self._leaps(first, time, x, y)
        if leapt and self.touching:
            self.jumps += 1
            self._leapt = self._down
        if leapt or time - motion.time > FORGOTTEN:
            motion.begin(time, x, y, pace)
            self._stillness.begin(time, x, y, motion.noise.variance)
        else:
            motion.add(time, x, y, pace, count)
            self._stillness.add(time, x, y, motion.noise.variance / count)
        self._last, self._fresh = last, True
        for sample in group:
            self._arrival = max(self._arrival, sample.arrival)
        self.touching = last.normal_force > 0

    def _leaps(self, sample: Sample, time: float, x: float, y: float) -> bool:
        last = self._last
        if last is None or _differ(last, sample, contact=False):
            return True
        if time - self._motion.time > FORGOTTEN:
            return math.hypot(x - last.x, y - last.y) > FARTHEST_MISS
        px, py = self._motion.place(time)
        return math.hypot(x - px, y - py) > FARTHEST_MISS


def _reasonable(sample: Sample) -> bool:
    """Whether a sample is finite and within what a finger does; false for NaN."""
    fast = 0.0 if sample.velocity is None else math.hypot(*sample.velocity)
    return (
        math.isfinite(sample.time)
        and math.isfinite(sample.arrival)
        and abs(sample.x) <= LARGEST_POSITION
        and abs(sample.y) <= LARGEST_POSITION
        and 0 <= sample.normal_force <= LARGEST_FORCE
        and fast <= LARGEST_SPEED
    )


def _differ(one: Sample, next_one: Sample, *, contact: bool = True) -> bool:
    """Whether the finger leapt between two samples, or also touched, lifted, or told its speed."""
    far = math.hypot(next_one.x - one.x, next_one.y - one.y)
    if far > SMALLEST_LEAP and far > FASTEST * (next_one.time - one.time):
        return True
    return contact and (
        (one.normal_force > 0) != (next_one.normal_force > 0)
        or (one.velocity is None) != (next_one.velocity is None)
    )
