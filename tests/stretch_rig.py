"""Friction alone, read from the shear of a texture with one wave of a vanishing amplitude."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec.structs import replace as changed

from benchmarks.friction import STICKY, friction_only
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Floats
from tactile.display.display import Display, load_display
from tactile.rendering.renderer import Renderer
from tactile.rendering.skin_stretch import FrictionLaw
from tactile.texture.descriptor import Friction
from tactile.texture.surface import Texture

RATE = 8000.0
DISPLAY = load_display("reference-24")
STICKY_ONLY = friction_only(STICKY)
VS = 10e-3
"""Stribeck speed of the shipped textures and of those here [m/s]."""
STROKE_SHARE = 0.3
"""Share of the shear that full drive attains at rest that friction may take; the rest is left to
the texture."""
GIVE = 1e-3
"""Stretch per unit of friction coefficient, for a pad with a stiffness of 1 N/mm at 1 N [m]."""
NODE_TIME = 2e-3
"""Time from node to node [s]."""


def rubbed(**friction: Any) -> Texture:
    """Return a texture with next to nothing but friction; its reference force is 0.5 N."""
    values = {"static_coefficient": 0.8, "kinetic_coefficient": 0.5, "force_exponent": 0.0}
    changes = Friction(**(values | friction))
    return replace(STICKY_ONLY, descriptor=changed(STICKY_ONLY.descriptor, friction=changes))


def law(**friction: Any) -> FrictionLaw:
    return FrictionLaw(rubbed(**friction).descriptor)


def shear_of(
    texture: Texture,
    place: Floats,
    force: Any = 0.5,
    *,
    display: Display | None = None,
    sizes: tuple[int, ...] = (64,),
    rate: float = RATE,
) -> Floats:
    """Return what the renderer asks of the skin, the delay taken off, for places (S, 2) [m]."""
    renderer = Renderer(display or load_display("reference-24"), texture, sample_rate=rate)
    force = np.broadcast_to(np.asarray(force, np.float64), len(place))
    place = np.concatenate([place, np.repeat(place[-1:], renderer.delay, axis=0)])
    force = np.concatenate([force, np.repeat(force[-1:], renderer.delay)])
    parts, at, k = [], 0, 0
    while at < len(place):
        size = sizes[k % len(sizes)]
        block = slice(at, at + size)
        parts.append(renderer.block(place[block], force[block], shear=True)[1])
        at, k = at + size, k + 1
    return np.concatenate(parts)[renderer.delay :]


def stroke(speed: float, duration: float, angle: float = 0.0) -> Floats:
    way = speed * np.arange(round(duration * RATE)) / RATE
    return np.column_stack([way * math.cos(angle), way * math.sin(angle)])


def expected_stretch(force: float, display: Display, load: FingerLoad, attainable: float) -> float:
    """Return share × tanh of what each contactor's part of a force does to the load's spring."""
    most = STROKE_SHARE * attainable
    own = force / len(display.contactors) / float(load.k0)
    return most * math.tanh(own / most)


def static_shear(display: Display) -> float:
    """Return what full drive attains at rest [m]."""
    return float(np.abs(display.responses(np.zeros(1), RATE)[0, 0, 0])) * display.limits.voltage
