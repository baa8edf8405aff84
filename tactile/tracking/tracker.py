"""Prediction of the finger's position at the time when a block is put out, from late samples.

A client samples the finger 30 to 1000 times a second; the samples arrive with jitter, some of them
late, some never. The playback loop renders blocks that reach the skin 8 to 14 ms from now.
`ContactTracker.add` takes samples, `ContactTracker.at` returns the contact at the times of a block:

1. **Motion** (`tactile.tracking.finger_motion`): Kalman filters turn samples into position,
   velocity and acceleration at the newest sample. Such a state predicts a *course* p(s), a time s
   after the sample. Up to 60 ms ahead the course is what the filters predict; beyond, its clock
   slows down, and it comes to rest within another 20 ms: u(s) = H + D (1 − exp(−(s − H)/D)).
2. **Rest** (`Stillness`, in the same module): a finger that does not move significantly has a
   course that stands exactly still, however much its samples tremble.
3. **Path** (`Path`): each sample changes the course, but never the position that is played. The
   difference of the path so far from the new course, in position e and velocity e', is carried on
   and decays:

       path(t) = course(t) + (e + (e' + ω e) t) exp(−ω t),    t since the change,

   the critically damped solution of e'' + 2ω e' + ω² e = 0. The path is C¹; a change bends it by no
   more than ω² |e| + 2ω |e'|. The difference decays slowly (1/ω = 20 ms) for a slow finger, which
   must not tremble, and fast (3 ms) for a fast one, which must not be late.
4. **Press** (`Press`): the force follows that of the samples in the same way, without prediction,
   times a presence that rises from 0 to 1 and falls back to 0, exactly, along cubics. The position
   may jump only while the presence is 0: a contact elsewhere waits until the last one has ended.

All of these are closed forms of the time since the last change. Changes take place at the first
time of a block, if samples have come, or at a time of their own, at which a block is cut in two.
With the same samples added at the same times, the path is therefore the same however the blocks are
cut.

Prediction is limited. At 90 Hz the newest sample is 5.5 ms old on average, to which its delay is
added, and 12 ms lie ahead. A finger that starts at 6.6 m/s² moves 0.5 mm in 12 ms and 1.5 mm in
21.5 ms before anything that is played can follow (`benchmarks.tracking`).

LaViola ("Double exponential smoothing: an alternative to Kalman filter-based predictive tracking",
EGVE 2003) found smoothing as good as single Kalman filters; the benchmark measures both beside this
tracker. Casiez, Roussel and Vogel (1€ filter, CHI 2012) argue that a resting finger needs
smoothness and a moving one needs speed; the weights of the filters make that choice here.
"""

import math
from collections import deque

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
from tactile.tracking.finger_sample import FingerSample

SILENCE = 0.1
"""Age of the newest arrival at which the finger is taken as gone [s]."""
HORIZON = 0.06
"""Time H beyond its sample for which a course is trusted [s]: two periods at 90 Hz, delay and
latency."""
BRAKING = 0.02
"""Time constant D with which a course comes to rest beyond the horizon [s]."""
SETTLING, SLOW_SETTLING = 0.003, 0.02
"""Time constant 1/ω of the path at speed and at rest [s], by measurement: shorter is noisier,
longer is later."""
SLOW = 0.03
"""Speed at which the path's time constant is midway [m/s]: slow motion must not tremble, and fast
motion must not be late."""
CATCHING_UP = 0.01
"""Time in which a remaining correction is taken to be made, where it counts as speed [s]."""
FORCE_SETTLING = 0.005
"""Time constant 1/ω of the force (assumed) [s]."""
CLEARING = 0.0032
"""Time between a jump of the position and the rise of the force [s]: 8 samples at 2.5 kHz, from
which the renderer computes its velocity."""
ONSET = 0.01
"""Duration of the presence's rise [s]."""
FALL = 0.018
"""Duration of the presence's fall [s]."""
CLEAR = 5e-4
"""Time without force before the position may jump [s]: one sample at 2.5 kHz."""
FASTEST = 3.0
"""Speed between two samples above which the finger was lifted [m/s]; a fast stroke is below
1 m/s."""
SMALLEST_LEAP = 5e-3
"""Distance below which no two samples are too fast, because times jitter [m]."""
FARTHEST_MISS = 20e-3
"""Distance from the expected position above which the finger was lifted [m]."""
TOGETHER = 0.004
"""Interval of time within which waiting samples are averaged [s]."""
MOST_WAITING = 256
"""Largest number of samples that wait for a call of `ContactTracker.at`."""
EARLIEST = 0.05
"""Time ahead of the present beyond which a sample is invalid [s]. A clock map that still settles
may be ahead by less."""
OLDEST = 1.0
"""Age beyond which a sample is late, whatever came before [s]."""
SAME = 1e-5
"""Interval of time within which two samples count as one [s]."""


class Path:
    """Position that is played: a course plus what is left of the corrections to it.

    Attributes
    ----------
    settling : float
        Time constant 1/ω of the last correction [s].
    """

    def __init__(self) -> None:
        self._origin = self._changed = 0.0
        self.settling = SETTLING
        self._rows: list[Numbers] = [[0.0, 0.0] for _ in range(5)]
        self._table = np.array(self._rows)

    def jump(self, origin: float, state: Numbers) -> None:
        """Continue on a course, wherever the path was.

        Parameters
        ----------
        origin : float
            Time of the course's state [s].
        state : list of 6 floats
            Position [m], velocity [m/s] and acceleration [m/s²], each as x and y.
        """
        self._origin = self._changed = origin
        self._rows = [state[:2], state[2:4], state[4:], [0.0, 0.0], [0.0, 0.0]]
        self._table = np.array(self._rows)

    def bend(self, time: float, origin: float, state: Numbers) -> None:
        """Change over to another course without a step in position or velocity.

        Parameters
        ----------
        time : float
            Time of the change [s].
        origin : float
            Time of the new course's state [s].
        state : list of 6 floats
            Position [m], velocity [m/s] and acceleration [m/s²], each as x and y.
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
        """Return position and velocity at one time.

        Parameters
        ----------
        time : float
            Time [s].

        Returns
        -------
        position : list of 2 floats
            Position [m].
        velocity : list of 2 floats
            Velocity [m/s].
        """
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
        """Return the positions at given times.

        Parameters
        ----------
        times : (S,) array of float
            Times, ascending [s].

        Returns
        -------
        (S, 2) array of float
            Positions [m].
        """
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
    """Return the time u(s) that passes on a course in a time s [s], and its rate u'(s)."""
    if -HORIZON <= ahead <= HORIZON:
        return ahead, 1.0
    slower = math.exp(-max(ahead - HORIZON, 0.0) / BRAKING)
    return min(max(ahead, -HORIZON), HORIZON) + BRAKING * (1 - slower), slower


class Press:
    """Normal force that is played: that of the samples, smoothed, times a presence."""

    def __init__(self) -> None:
        self._target = self._error = self._rate = self._changed = 0.0
        self._start = self._value = self._slope = self._goal = 0.0
        self._duration = 1.0

    def begin(self, time: float, force: float) -> None:
        """Begin a contact.

        Parameters
        ----------
        time : float
            Time at which the position jumps [s].
        force : float
            Normal force [N].
        """
        self._target, self._error, self._rate, self._changed = force, 0.0, 0.0, time
        self._start, self._duration = time + CLEARING, ONSET
        self._value, self._slope, self._goal = 0.0, 0.0, 1.0

    def follow(self, time: float, force: float) -> None:
        """Change over to another force, smoothly.

        Parameters
        ----------
        time : float
            Time of the change [s].
        force : float
            Normal force to reach [N].
        """
        since = max(time - self._changed, 0.0)
        left = math.exp(-since / FORCE_SETTLING)
        error = (self._error + self._rate * since) * left
        speed = self._rate * left - error / FORCE_SETTLING
        error += self._target - force
        self._target, self._changed = force, time
        self._error, self._rate = error, speed + error / FORCE_SETTLING

    def end(self, time: float) -> float:
        """End the contact.

        Parameters
        ----------
        time : float
            Time at which the presence begins to fall [s].

        Returns
        -------
        float
            Time from which on the position may jump [s].
        """
        since = min(max((time - self._start) / self._duration, 0.0), 1.0)
        value = since * since * (3 - 2 * since)
        self._slope = 6 * since * (1 - since) / self._duration
        self._value, self._goal = value, 0.0
        self._start, self._duration = time, FALL
        return time + FALL + CLEAR if value else time

    def at(self, times: Floats) -> Floats:
        """Return the forces at given times.

        Parameters
        ----------
        times : (S,) array of float
            Times, ascending [s].

        Returns
        -------
        (S,) array of float
            Normal forces [N].
        """
        since = np.maximum(times - self._changed, 0)
        force = (since * self._rate + self._error) * np.exp(since * (-1 / FORCE_SETTLING))
        force += self._target
        if times[0] - self._start < self._duration:
            force *= self._presence(times)
        elif not self._goal:
            force[:] = 0.0
        return np.asarray(force)

    def _presence(self, times: Floats) -> Floats:
        """Return the cubic from the present value and slope to the goal, (S,)."""
        r = np.clip((times - self._start) / self._duration, 0, 1)
        step = r * r * (3 - 2 * r)
        cubic = self._value + (self._goal - self._value) * step
        return np.asarray(cubic + self._slope * self._duration * r * (1 - r) ** 2)


class ContactTracker:
    """Converts a client's samples into the contact that is played, block by block.

    Parameters
    ----------
    motion : MotionFilter, optional
        Filter to use instead of a `MotionFilter` with its defaults, for comparison.

    Attributes
    ----------
    touching : bool
        Whether the newest sample was in contact and is not too old.
    late : int
        Number of samples that were older than one before, or of the same time, and were ignored.
    invalid : int
        Number of samples that were not finite or out of range and were ignored.
    dropped : int
        Number of samples without room because `at` was not called.
    jumps : int
        Number of leaps of the finger, each taken as lifting it and touching elsewhere.
    silences : int
        Number of contacts that ended because no more samples came.
    """

    def __init__(self, *, motion: MotionFilter | None = None) -> None:
        self.touching = False
        self.late = self.invalid = self.dropped = self.jumps = self.silences = 0
        self._waiting: deque[FingerSample] = deque(maxlen=MOST_WAITING)
        self._motion, self._stillness = motion or MotionFilter(), Stillness()
        self._path, self._press = Path(), Press()
        self._last: FingerSample | None = None
        self._arrival = -math.inf
        self._down = self._leapt = self._fresh = False
        self._rest: Pair | None = None
        self._free_from = -math.inf
        """Time at which the presence is or was 0 again, while the finger is not down [s]."""
        self._time = 0.0

    @property
    def velocity(self) -> Floats:
        """Velocity (2,) of the position at the end of the last block; 0 without contact [m/s]."""
        return np.array(self._path.now(self._time)[1])

    def add(self, sample: FingerSample) -> None:
        """Add a sample; samples may come in any order, and their numbers may be any.

        Parameters
        ----------
        sample : FingerSample
            Sample to add.
        """
        if not _is_plausible(sample):
            self.invalid += 1
            return
        self.dropped += len(self._waiting) == MOST_WAITING
        self._waiting.append(sample)

    def at(self, times: ArrayLike, now: float) -> tuple[Floats, Floats]:
        """Return position and normal force at the times of a block.

        Parameters
        ----------
        times : (S,) array_like of float
            Times at which the samples are put out, ascending from block to block, in the host's
            clock [s].
        now : float
            Present time of the host's clock [s].

        Returns
        -------
        position : (S, 2) array of float
            Positions [m].
        normal_force : (S,) array of float
            Normal forces [N].
        """
        moments = np.asarray(times, np.float64)
        if not moments.size:
            return np.zeros((0, 2)), np.zeros(0)
        if self._waiting:
            self._process_waiting(now)
        begin, end = float(moments[0]), float(moments[-1])
        silent = begin + self._arrival + SILENCE - now
        if self.touching and begin >= silent:
            self.touching = False
            self.silences += 1
        self._turn(begin)
        cut = silent if self.touching else math.inf
        if not self._down and begin < self._free_from:
            cut = min(cut, self._free_from)
        if begin < cut <= end:
            k = int(np.searchsorted(moments, cut))
            first = self._play(moments[:k])
            then = self.at(moments[k:], now + float(moments[k]) - begin)
            return np.concatenate([first[0], then[0]]), np.concatenate([first[1], then[1]])
        return self._play(moments)

    def _play(self, times: Floats) -> tuple[Floats, Floats]:
        """Return positions and forces at times between which nothing changes."""
        self._time = float(times[-1])
        return self._path.at(times), self._press.at(times)

    def _turn(self, time: float) -> None:
        """Begin, end or continue the contact from a time on; the path follows the samples."""
        motion, last = self._motion, self._last
        if self._down:
            if self._leapt or not self.touching or last is None:
                self._down = False
                self._free_from = self._press.end(time)
            elif self._fresh:
                self._press.follow(time, last.normal_force)
                if self._stillness.place is None or self._stillness.place != self._rest:
                    self._rest = self._stillness.place
                    self._path.bend(time, motion.time, self._course())
        if not self._down and time >= self._free_from:
            if self.touching and last is not None:
                self._down, self._leapt = True, False
                self._press.begin(time, last.normal_force)
                self._rest = self._stillness.place
                self._path.jump(motion.time, self._course())
            elif self._free_from > -math.inf:
                self._hold(self._free_from)
        self._fresh = False

    def _hold(self, time: float) -> None:
        """Stay where the contact ended."""
        self._path.jump(time, [*self._path.now(time)[0], 0.0, 0.0, 0.0, 0.0])
        self._free_from = -math.inf

    def _course(self) -> Numbers:
        """Return the state that the path follows: that of the filters, or the place of rest."""
        if self._rest is not None:
            return [*self._rest, 0.0, 0.0, 0.0, 0.0]
        return self._motion.state

    def _process_waiting(self, now: float) -> None:
        """Pass the waiting samples to the filters, in the order of their times."""
        samples, group = sorted(self._waiting, key=lambda s: s.time), list[FingerSample]()
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
                self._update_filters(group)
                group = []
            group.append(sample)
        if group:
            self._update_filters(group)

    def _update_filters(self, group: list[FingerSample]) -> None:
        """Update the filters with the mean of some samples; start anew if the finger leapt."""
        count, first, last = len(group), group[0], group[-1]
        time, x, y, velocity = first.time, first.x, first.y, first.velocity
        if count > 1:
            time = math.fsum(s.time for s in group) / count
            x, y = math.fsum(s.x for s in group) / count, math.fsum(s.y for s in group) / count
            if velocity is not None:
                vx, vy = zip(*(s.velocity or velocity for s in group), strict=True)
                velocity = math.fsum(vx) / count, math.fsum(vy) / count
        motion = self._motion
        leapt = self._last is not None and self._leaps(first, time, x, y)
        if leapt and self.touching:
            self.jumps += 1
            self._leapt = self._down
        if leapt or time - motion.time > FORGOTTEN:
            motion.begin(time, x, y, velocity)
            self._stillness.begin(time, x, y, motion.noise.variance)
        else:
            motion.add(time, x, y, velocity, count)
            self._stillness.add(time, x, y, motion.noise.variance / count)
        self._last, self._fresh = last, True
        for sample in group:
            self._arrival = max(self._arrival, sample.arrival)
        self.touching = last.normal_force > 0

    def _leaps(self, sample: FingerSample, time: float, x: float, y: float) -> bool:
        """Return whether a sample is too far from the last one or from its expected position."""
        last = self._last
        if last is None or _differ(last, sample, contact=False):
            return True
        if time - self._motion.time > FORGOTTEN:
            return math.hypot(x - last.x, y - last.y) > FARTHEST_MISS
        px, py = self._motion.place(time)
        return math.hypot(x - px, y - py) > FARTHEST_MISS


def _is_plausible(sample: FingerSample) -> bool:
    """Return whether a sample is finite and within what a finger does; False for NaN."""
    fast = 0.0 if sample.velocity is None else math.hypot(*sample.velocity)
    return (
        math.isfinite(sample.time)
        and math.isfinite(sample.arrival)
        and abs(sample.x) <= LARGEST_POSITION
        and abs(sample.y) <= LARGEST_POSITION
        and 0 <= sample.normal_force <= LARGEST_FORCE
        and fast <= LARGEST_SPEED
    )


def _differ(one: FingerSample, next_one: FingerSample, *, contact: bool = True) -> bool:
    """Return whether the finger leapt between two samples.

    With ``contact``, also whether only one of them is in contact, or only one has a velocity.
    """
    distance = math.hypot(next_one.x - one.x, next_one.y - one.y)
    if distance > SMALLEST_LEAP and distance > FASTEST * (next_one.time - one.time):
        return True
    return contact and (
        (one.normal_force > 0) != (next_one.normal_force > 0)
        or (one.velocity is None) != (next_one.velocity is None)
    )
