"""Friction as skin stretch: how far the surface drags the skin, slowly, under each contactor.

**Force.** A finger pressed with N that slides at speed v meets F = μ(v) φ(N) N with

    μ(v) = μk + (μs − μk) exp(−(v/vs)²)                                       (Stribeck),

φ(N) = (N/N0)^force_exponent, held beyond the descriptor's range of forces. The surface drags the
skin against the motion of the finger. Positive shear along a contactor's axis is skin dragged in
that direction, so that a contactor with the axis a stretches the skin by a·s, where s points along
−v. A contactor whose axis is at a right angle to the motion does nothing.

**Presliding.** The skin is modeled as a bristle. It follows the surface by 1/`GIVE` of coefficient
for each meter of motion, and by less the nearer it comes to μ(v). Its state is the mobilized
coefficient q, a vector, and dx is the displacement of the finger (`Bristles`; Dahl 1968, LuGre:
Canudas de Wit et al. 1995),

    dq = dx/GIVE − q |dx|/(GIVE μ(v)).

A reversal turns the stretch over within some tenths of a millimeter, a stop holds it, and a
trembling finger causes no jump. Along a straight piece of path the solution is an exponential and
is computed as such, so that no step is too long.

**Stick-slip.** A share ``stick_slip`` of the contact does not slide evenly. It sticks and follows
the surface fully (dq = dx/GIVE) up to the static force, then slips back by the 2 (μ(v) − μk) that a
mass on a spring overshoots, at low speed to 2μk − μs, as far below the kinetic level as it was
above. The result is a sawtooth of depth 2 stick_slip (μ(v) − μk) φN once every 2 GIVE (μ(v) − μk)
of path: its frequency grows with speed, and it disappears above the Stribeck speed. A slip lasts
`SLIP` nodes, during which the finger goes on; this reduces the depth accordingly, and where nothing
is left the contact slides evenly. Real stick-slip is irregular; this one is the same for the same
path.

**Commanded stretch.** Each of n contactors takes 1/n of F, which stretches the finger's load model
by F/(n k0). This is commanded up to `STROKE_SHARE` of what full drive attains at rest, with a tanh
that saturates there. A whole finger pad gives about a millimeter per newton, so that the display
plays a compressed copy, for 24 contactors on the lightly loading finger 1 : 26. Direction,
reversals, holds and slips stay in their places, and what is lost is size: materials of high μ,
pressed hard, are harder and harder to tell apart (0.76 of the share at F = `STROKE_SHARE` ×
attainable × n k0, which is 0.40 N there, 0.96 at twice that). The textures add up, each with its
gain, and their sum is held to the share.

**Timing.** The finger is read at nodes, one every 2 ms on the stream's own grid. Between them runs
a uniform cubic B-spline, which is smooth, never leaves the range of its nodes and has the spectrum
sinc⁴: a slip, however sudden, becomes a smooth step of 8 ms, with 10 to 90 % of it in 3 ms (a pad
of about 100 Hz swings no faster; assumed), 71 dB down from 1 kHz on. The spline is 4 ms late.
Motion is averaged over `AVERAGED` first, because the difference of two noisy positions of a resting
finger is not 0. Both delays are within what touch tolerates (40 ms: Okamoto et al., IEEE ToH 2009).

The friction laws belong to a layer; the state is kept here, beside the renderer's ramps. An
AC-coupled amplifier passes only what is faster than its corner frequency: reversals and slips, but
no hold.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from tactile.arrays import Floats, Singles
from tactile.display.display import Display
from tactile.rendering.contact import LARGEST_SPEED
from tactile.rendering.stroke import Stroke
from tactile.texture.descriptor import Descriptor
from tactile.texture.power_laws import held_power_law

Pair = tuple[float, float]
"""Vector, x and y."""

STROKE_SHARE = 0.3
"""Largest part of the shear attained by full drive at rest that friction may take. The rest is for
the texture: four times the rms of the strongest shipped texture, 9 µm at slow speeds, takes up to
68 % under the heavily loading finger. A moderate voltage that is held for long is also easy on the
ceramic."""
GIVE = 1e-3
"""Skin stretch per unit of friction coefficient [m]: a pad with a stiffness of 1 N/mm at 1 N
(assumed)."""
NODE_TIME = 2e-3
"""Time from node to node, rounded to a whole number of samples [s]."""
AVERAGED = 5e-3
"""Time constant over which the finger's motion is averaged (assumed) [s]."""
RESTS = 1e-12
"""Distance between nodes below which a finger does not move [m]."""
SLIP = 2
"""Duration of a slip, the steep half of the spline's step [nodes]."""
QUICKEST = 2
"""Shortest time from slip to slip [nodes]; a contact that would slip more often slides evenly."""
LEAST = 1e-3
"""Smallest coefficient, and smallest end of a range of forces [N], that is distinguished from 0."""


class GainLike(Protocol):
    """Gain that may change from value to value."""

    def after(self, samples: int) -> float:
        """Return the gain at a later sample.

        Parameters
        ----------
        samples : int
            Number of samples after the next one.

        Returns
        -------
        float
            Gain at that sample.
        """


class FrictionLaw:
    """Friction of a texture, without any state of the stream.

    Parameters
    ----------
    descriptor : Descriptor
        Description of a texture with friction.

    Attributes
    ----------
    kinetic : float
        Kinetic coefficient μk at the reference force.
    weakening : float
        Difference μs − μk of static and kinetic coefficient at the reference force.
    speed : float
        Stribeck speed vs [m/s].
    sticking : float
        Share of the contact that sticks and slips, 0 … 1.
    """

    def __init__(self, descriptor: Descriptor) -> None:
        friction, laws = descriptor.friction, descriptor.laws
        assert friction is not None
        self.kinetic = max(friction.kinetic_coefficient, LEAST)
        self.weakening = max(friction.static_coefficient, LEAST) - self.kinetic
        self.speed = friction.stribeck_speed_mm_s * 1e-3
        self.sticking = friction.stick_slip
        low, high = laws.force_range_n
        self._law = descriptor.reference.normal_force_n, (max(low, LEAST), high)
        self._exponent = friction.force_exponent

    def over_kinetic(self, speed: float) -> float:
        """Compute the excess of the coefficient over the kinetic one, μ(v) − μk.

        Parameters
        ----------
        speed : float
            Sliding speed [m/s].

        Returns
        -------
        float
            Excess of the coefficient.
        """
        ratio = speed / self.speed
        return self.weakening * math.exp(-ratio * ratio)

    def force(self, normal_force: float) -> float:
        """Compute φ(N) N, the friction force at a coefficient of 1.

        Parameters
        ----------
        normal_force : float
            Normal force N [N].

        Returns
        -------
        float
            Friction force [N].
        """
        return held_power_law(normal_force, *self._law, self._exponent) * normal_force


class Bristles:
    """Coefficient that a finger has mobilized of one texture, a vector along its motion.

    Parameters
    ----------
    law : FrictionLaw
        Friction of the texture.

    Attributes
    ----------
    law : FrictionLaw
        Friction of the texture.
    """

    def __init__(self, law: FrictionLaw) -> None:
        self.law = law
        self.release()

    def release(self) -> None:
        """Reset the stretch, for a finger that has left the surface."""
        self._even: Pair = (0.0, 0.0)
        self._stuck: Pair = (0.0, 0.0)

    def move(self, dx: float, dy: float, duration: float) -> Pair:
        """Move the finger in a straight line and return the mobilized coefficient q.

        The result is q at the end of the line. A slip on the way also counts for the part of the
        way before it, as if q were averaged over the way, so that slips are timed between nodes.

        Parameters
        ----------
        dx, dy : float
            Displacement of the finger [m].
        duration : float
            Duration of the motion [s].

        Returns
        -------
        tuple of 2 floats
            Mobilized coefficient q along x and y.
        """
        way = math.hypot(dx, dy)
        if way < RESTS:
            return self._mixed(self._stuck)
        over = self.law.over_kinetic(way / duration)
        top = self.law.kinetic + over
        self._even = _slid(self._even, dx, dy, way, top)
        if not self.law.sticking:
            return self._even
        drop = 2 * over - SLIP * way / GIVE
        if drop > QUICKEST * way / GIVE:
            return self._mixed(self._stick(dx / GIVE, dy / GIVE, top, drop))
        self._stuck = _slid(self._stuck, dx, dy, way, top)
        return self._mixed(self._stuck)

    def _stick(self, dx: float, dy: float, top: float, drop: float) -> Pair:
        """Follow the surface, and slip by ``drop`` where ``top`` is reached; return q averaged."""
        x, y = self._stuck[0] + dx, self._stuck[1] + dy
        size = math.hypot(x, y)
        beyond = size - top
        if beyond <= 0:
            self._stuck = x, y
            return self._stuck
        left = top - drop + min(beyond, drop)
        self._stuck = x * left / size, y * left / size
        before = max(1 - beyond / math.hypot(dx, dy), 0.0)
        mean = (left + (size - left) * before) / size
        return x * mean, y * mean

    def _mixed(self, stuck: Pair) -> Pair:
        """Return q of the whole contact from that of its sticking part."""
        share, (x, y) = self.law.sticking, self._even
        return x + share * (stuck[0] - x), y + share * (stuck[1] - y)


def _slid(q: Pair, dx: float, dy: float, way: float, top: float) -> Pair:
    """Return a bristle's q after a straight way, on which q nears ``top`` along the motion."""
    keep = math.exp(-way / (GIVE * top))
    x, y = dx / way * top, dy / way * top
    return x + (q[0] - x) * keep, y + (q[1] - y) * keep


class Stretch:
    """Converts the friction of the textures that play into stretch under each contactor.

    Parameters
    ----------
    display : Display
        Display that stretches the skin.
    attainable : (L,) array of float
        Shear at rest that full drive attains on every contactor, per force of the finger's table
        [m].
    sample_rate : float
        Sample rate of the stream [Hz].
    longest : int
        Length of the longest stroke that is processed at a time [samples].
    """

    def __init__(
        self, display: Display, attainable: Floats, sample_rate: float, longest: int
    ) -> None:
        self._every = max(1, round(NODE_TIME * sample_rate))
        self._duration = self._every / sample_rate
        self._fresh = -math.expm1(-self._duration / AVERAGED)
        self._farthest = LARGEST_SPEED * self._duration
        self._release = min(self._duration / display.limits.fade, 1.0)
        self._forces = display.load_forces
        stiffness = np.array([float(display.load_at(f).k0) for f in self._forces])
        self._mosts = attainable * STROKE_SHARE
        self._fulls = self._mosts * stiffness * len(display.contactors)
        self._scale = float(self._mosts[0]), float(self._fulls[0])
        self._axes = -display.shear_axes.T.astype(np.float32)
        self._common = (*self._axes[:, 0].tolist(),) if not np.ptp(self._axes, axis=1).any() else ()
        self._spline = self._cached = spline_weights(self._every, longest)
        self._cached_range = 0, 0
        self._line: list[Pair] = [(0.0, 0.0)] * 4
        self._place, self._motion = (0.0, 0.0), (0.0, 0.0)
        self._pressed = False
        self._force = self._falls = 0.0

    def __call__(
        self, stroke: Stroke, playing: Sequence[tuple[Bristles, GainLike]]
    ) -> Singles | None:
        """Return the stretch (S, N) [m] of the textures that play; None if there is none at all.

        It is (S, 1) if all contactors have one axis. ``playing`` holds the bristles and the gain of
        each texture.
        """
        if not playing and not any(x or y for x, y in self._line):
            self._pressed = False
            return None
        count, first = len(stroke.normal_force), -stroke.start % self._every
        line, every = self._line, self._every
        for k in range(first, count, every):
            place = stroke.place.item(0, k), stroke.place.item(1, k)
            line.append(self._at_node(place, stroke.normal_force.item(k), playing, k))
        self._line = line[-4:]
        spline = self._weights(every - first, count, len(line))
        if self._common:
            a, b = self._common
            along = np.array([x * a + y * b for x, y in line], np.float32)
            return np.asarray(spline.dot(along)[:, None])
        return np.asarray(spline.dot(np.array(line, np.float32)).dot(self._axes))

    def _weights(self, begin: int, count: int, nodes: int) -> Singles:
        """Return the spline's rows of some samples, cached for a repeated call."""
        if self._cached_range != (begin, count):
            self._cached_range = begin, count
            self._cached = np.ascontiguousarray(self._spline[begin : begin + count, :nodes])
        return self._cached

    def _at_node(
        self, place: Pair, force: float, playing: Sequence[tuple[Bristles, GainLike]], after: int
    ) -> Pair:
        """Return the stretch (x, y) [m] that the surface causes, in the direction of motion.

        It depends on no contactor's axis; ``after`` is the node's sample within the stroke.
        """
        dx, dy = self._moved(place, force > 0)
        self._press(force)
        if not self._force:
            for bristles, _ in playing:
                bristles.release()
            return 0.0, 0.0
        most, full = self._scale
        if len(self._forces) > 1:
            most = float(np.interp(self._force, self._forces, self._mosts))
            full = float(np.interp(self._force, self._forces, self._fulls))
        sx = sy = 0.0
        for bristles, gain in playing:
            x, y = bristles.move(dx, dy, self._duration)
            size = math.hypot(x, y)
            if size > 0 and full > 0:
                bent = math.tanh(size * bristles.law.force(self._force) / full) / size
                bent *= most * gain.after(after)
                sx, sy = sx + x * bent, sy + y * bent
        total = math.hypot(sx, sy)
        held = most / total if total > most else 1.0
        return sx * held, sy * held

    def _moved(self, place: Pair, pressed: bool) -> Pair:
        """Return the averaged motion (dx, dy) [m] since the last node; a jump is no motion."""
        dx, dy = place[0] - self._place[0], place[1] - self._place[1]
        if not (pressed and self._pressed):
            self._motion = dx, dy = 0.0, 0.0
        elif math.hypot(dx, dy) > self._farthest:
            dx = dy = 0.0
        self._place, self._pressed = place, pressed
        mx, my = self._motion
        mx, my = mx + (dx - mx) * self._fresh, my + (dy - my) * self._fresh
        self._motion = (mx, my) if abs(mx) + abs(my) > RESTS else (0.0, 0.0)
        return self._motion

    def _press(self, normal_force: float) -> None:
        """Follow the normal force, at most as fast as its last rise falls to 0 within the fade."""
        if normal_force >= self._force:
            self._force = normal_force
            self._falls = normal_force * self._release
        else:
            self._force = max(normal_force, self._force - self._falls, 0.0)


def spline_weights(every: int, longest: int) -> Singles:
    """Compute the weights of a spline's nodes at each sample.

    Row p is p samples after a node, and column j belongs to that node's (j − 3)rd successor:
    B(p/every + 3 − j) with the uniform cubic B-spline B on 0 … 4, which peaks two nodes after its
    own.

    Parameters
    ----------
    every : int
        Distance between nodes [samples].
    longest : int
        Length of the longest stroke [samples].

    Returns
    -------
    (every + longest, K) array of float32
        Weights; the first three columns belong to the nodes before that of the first row.
    """
    rows = np.arange(every + longest) / every
    u = np.clip(rows[:, None] + 3 - np.arange(int(rows[-1]) + 5), 0, 4)
    powers = (np.maximum(u - k, 0) ** 3 for k in range(4))
    return np.asarray(
        sum(c * p for c, p in zip((1, -4, 6, -4), powers, strict=True)) / 6, np.float32
    )
