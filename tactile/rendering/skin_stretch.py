"""Friction as skin stretch: what the surface drags the skin along, slowly, under each contactor.

**Force.** A finger pressed with N that slides at speed v meets F = μ(v) φ(N) N with

    μ(v) = μk + (μs − μk) exp(−(v/vs)²)                                       (Stribeck),

φ(N) = (N/N0)^force_exponent, held beyond the descriptor's range of forces. The surface drags the
skin against the motion of the finger: positive shear along a contactor's axis is skin dragged that
way, so a contactor with the axis a is to stretch the skin by a·s, s pointing along −v. A contactor
whose axis is at a right angle to the motion does nothing.

**Presliding.** The skin is a bristle: it follows the surface by 1/`GIVE` of coefficient for each
meter of motion, the less the nearer it comes to μ(v). Its state is the mobilized coefficient q, a
vector, and dx the way of the finger (`Bristles`; Dahl 1968, LuGre: Canudas de Wit et al. 1995),

    dq = dx/GIVE − q |dx|/(GIVE μ(v)).

A reversal pulls the stretch over within some tenths of a millimeter, a stop holds it, and however
a finger trembles nothing jumps. Along a straight piece of way the solution is an exponential; it
is taken as such, so that no step is too long.

**Stick-slip.** A share ``stick_slip`` of the contact does not slide evenly: it sticks, follows the
surface whole (dq = dx/GIVE) until the static force, and slips back by the 2 (μ(v) − μk) that a mass
on a spring overshoots, at low speed to 2μk − μs, as far below the kinetic level as it was above.
Hence a saw-tooth of depth 2 stick_slip (μ(v) − μk) φN once every 2 GIVE (μ(v) − μk) of way: higher
with speed, gone above the Stribeck speed. A slip lasts `SLIP` nodes, in which the finger goes on;
that takes as much off the depth, and where nothing is left the contact slides evenly. Real
stick-slip is irregular; this one is the same for the same path.

**What is felt of it.** Each of n contactors takes 1/n of F, which stretches the finger's load model
by F/(n k0). Up to `STROKE_SHARE` of what full drive attains at rest, bent there by a tanh, that is
commanded. A whole finger pad gives about a millimeter per newton: the display plays a compressed
copy, 24 contactors on the lightly loading finger 1 : 26, with direction, reversals, holds and slips
in their places, and what is lost is size: materials of high μ, pressed hard, are told apart less
and less (0.76 of the share at F = `STROKE_SHARE` × attainable × n k0, 0.40 N there, 0.96 at twice
that). Textures add up, each with its gain, and their
sum is held to the share.

**When.** The finger is read at nodes, one every 2 ms on the stream's own grid; between them a
uniform cubic B-spline runs, which is smooth, never leaves the range of its nodes and has the
spectrum sinc⁴: a slip, however sudden, becomes a smooth step of 8 ms, 10 to 90 % of it in 3 ms (a
pad of about 100 Hz swings no faster; assumed), 71 dB down from 1 kHz on. That is 4 ms late. Motion
is averaged over `AVERAGED` before, since difference of noisy places is not rest. Both err late,
as touch forgives (40 ms: Okamoto et al., IEEE ToH 2009).

The laws are a layer's; the state is here, beside the renderer's ramps. An amplifier that is coupled
to AC lets through what is faster than its corner: reversals and slips, no hold.
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

Pair = tuple[float, float]

STROKE_SHARE = 0.3
"""Of the shear that full drive attains at rest: the most that friction takes. The rest is the
texture's: four times the rms of the strongest shipped, 7 µm, takes up to 53 % under the heavily
loading finger; and what is held for long is easy on the ceramic."""
GIVE = 1e-3
"""m of skin stretch per unit of friction coefficient: a pad as stiff as 1 N/mm at 1 N (assumed)."""
NODE_TIME = 2e-3
"""s from node to node, to the nearest whole number of samples."""
AVERAGED = 5e-3
"""s, the time constant over which the finger's motion is averaged (assumed)."""
RESTS = 1e-12
"""m from node to node, below which a finger does not move."""
SLIP = 2
"""Nodes that a slip takes, the steep half of the spline's step."""
QUICKEST = 2
"""Nodes from slip to slip; what would slip more often slides evenly."""
LEAST = 1e-3
"""Smallest coefficient, and smallest end of a range of forces [N], that is told from nothing."""


class GainLike(Protocol):
    """A gain that may go from value to value."""

    def after(self, samples: int) -> float:
        """Return it some samples after the next."""


class FrictionLaw:
    """What a texture's friction is, with no memory of the stream.

    Attributes
    ----------
    kinetic, weakening : μk and μs − μk, at the reference force
    speed : vs [m/s]
    sticking : the share of the contact that sticks and slips
    """

    def __init__(self, descriptor: Descriptor) -> None:
        friction, laws = descriptor.friction, descriptor.laws
        assert friction is not None
        self.kinetic = max(friction.kinetic_coefficient, LEAST)
        self.weakening = max(friction.static_coefficient, LEAST) - self.kinetic
        self.speed = friction.stribeck_speed_mm_s * 1e-3
        self.sticking = friction.stick_slip
        self._exponent = friction.force_exponent / 8
        low, high = laws.force_range_n
        self._low, self._high = max(low, LEAST) ** 8, high**-8
        self._reference = 1.0
        self._reference = self.force(descriptor.reference.normal_force_n) / (
            descriptor.reference.normal_force_n
        )

    def over_kinetic(self, speed: float) -> float:
        """Return μ(v) − μk at a speed [m/s]."""
        ratio = speed / self.speed
        return self.weakening * math.exp(-ratio * ratio)

    def force(self, normal_force: float) -> float:
        """Return φ(N) N [N]: the friction at a coefficient of one; bends as `held_power_law`."""
        bent = 1 / (1 / (normal_force**8 + self._low) + self._high)
        return float(bent**self._exponent / self._reference * normal_force)


class Bristles:
    """The coefficient that a finger has mobilized of one texture, a vector along its motion.

    Parameters
    ----------
    law : of the texture
    """

    def __init__(self, law: FrictionLaw) -> None:
        self.law = law
        self.release()

    def release(self) -> None:
        """Let go: the finger has left."""
        self._even: Pair = (0.0, 0.0)
        self._stuck: Pair = (0.0, 0.0)

    def move(self, dx: float, dy: float, duration: float) -> Pair:
        """Return q after the finger has gone straight by (dx, dy) [m] within a time [s].

        It is that of the end; but a slip on the way counts for the part of the way before it too,
        as if q were averaged over the way: so that slips are timed between nodes.
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
        share, (x, y) = self.law.sticking, self._even
        return x + share * (stuck[0] - x), y + share * (stuck[1] - y)


def _slid(q: Pair, dx: float, dy: float, way: float, top: float) -> Pair:
    """Return the bristle's q after a straight way, on which it nears ``top`` along the way."""
    keep = math.exp(-way / (GIVE * top))
    x, y = dx / way * top, dy / way * top
    return x + (q[0] - x) * keep, y + (q[1] - y) * keep


class Stretch:
    """Turns the friction of the textures that play into stretch under each contactor.

    Parameters
    ----------
    display : what stretches the skin
    attainable : (L,) shear at rest that full drive attains on every contactor [m], per force of
        the finger's table
    sample_rate : of the stream [Hz]
    longest : stroke that is ever taken at a time [samples]
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
        self._spline = self._found = spline_weights(self._every, longest)
        self._asked = 0, 0
        self._line: list[Pair] = [(0.0, 0.0)] * 4
        self._place, self._motion = (0.0, 0.0), (0.0, 0.0)
        self._pressed = False
        self._force = self._falls = 0.0

    def __call__(
        self, stroke: Stroke, playing: Sequence[tuple[Bristles, GainLike]]
    ) -> Singles | None:
        """Return stretch (S, N) [m] of the textures that play; None where there is none at all.

        It is (S, 1) where all contactors have one axis. ``playing`` has the bristles of each
        texture and its gain.
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
        """Return the spline's rows of some samples; the last ones asked for are at hand."""
        if self._asked != (begin, count):
            self._asked = begin, count
            self._found = np.ascontiguousarray(self._spline[begin : begin + count, :nodes])
        return self._found

    def _at_node(
        self, place: Pair, force: float, playing: Sequence[tuple[Bristles, GainLike]], after: int
    ) -> Pair:
        """Return what the surface does to the skin [m], turned along motion."""
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
        """Follow the normal force, down no faster than from what it was to 0 within the fade."""
        if normal_force >= self._force:
            self._force = normal_force
            self._falls = normal_force * self._release
        else:
            self._force = max(normal_force, self._force - self._falls, 0.0)


def spline_weights(every: int, longest: int) -> Singles:
    """Return weights (every + longest, K) of nodes, the first three before the first row's.

    Row p is p samples after a node, column j that node's (j − 3)rd successor: B(p/every + 3 − j),
    with B the uniform cubic B-spline on 0 … 4, which peaks two nodes after its own.
    """
    rows = np.arange(every + longest) / every
    u = np.clip(rows[:, None] + 3 - np.arange(int(rows[-1]) + 5), 0, 4)
    powers = (np.maximum(u - k, 0) ** 3 for k in range(4))
    return np.asarray(
        sum(c * p for c, p in zip((1, -4, 6, -4), powers, strict=True)) / 6, np.float32
    )
