"""Shear that friction commands in a steady stroke: its mean, and the spectrum of stick-slip."""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import BLOCK, Ramp, Renderer
from tactile.rendering.skin_stretch import Bristles, FrictionLaw, Stretch
from tactile.rendering.stroke import NODE, Motion
from tactile.strength.commanded import LineSpectrum
from tactile.strength.figures import ONSET, SEGMENT, PowerSpectrum, drag_signs
from tactile.texture.descriptor import Descriptor


@dataclass(frozen=True)
class SteadyFriction:
    """Shear of friction in the steady part of a stroke.

    Attributes
    ----------
    shear : (N,) array of float
        Mean shear of each contactor [m].
    drag : float
        Mean of the shear against the motion [m].
    lines : LineSpectrum
        Spectrum of stick-slip, as a mean over contactors.
    """

    shear: Floats
    drag: float
    lines: LineSpectrum


def steady_friction(
    display: Display, descriptor: Descriptor, stroke: Trajectory, sample_rate: float
) -> SteadyFriction:
    """Compute the shear that the friction of a texture commands in a straight stroke.

    Parameters
    ----------
    display : Display
        Display to play on.
    descriptor : Descriptor
        Description of the texture.
    stroke : Trajectory
        Straight stroke of constant speed, as long as `steady_duration`.
    sample_rate : float
        Sample rate [Hz].

    Returns
    -------
    SteadyFriction
        Mean and spectrum; zero for a texture without friction.
    """
    contactors = len(display.contactors)
    if descriptor.friction is None:
        return SteadyFriction(np.zeros(contactors), 0.0, LineSpectrum(np.zeros(0), np.zeros(0)))
    at_rest = Renderer(display, None, sample_rate=sample_rate).attainable[:, :, 0].min(axis=1)
    stretch = Stretch(display, at_rest, sample_rate, BLOCK + NODE)
    rubbing, motion = [(Bristles(FrictionLaw(descriptor)), Ramp(1.0, 1.0))], Motion(sample_rate)
    parts = []
    for position, normal_force in stroke.blocks(sample_rate, BLOCK):
        moved = motion(motion.rows(position, normal_force))
        shear = None if moved is None else stretch(moved, rubbing)
        if shear is not None:
            parts.append(np.broadcast_to(shear, (len(shear), contactors)))
    whole = np.concatenate(parts)
    steady = whole[-round(SEGMENT * sample_rate) :].astype(np.float64)
    spectrum = PowerSpectrum(sample_rate, contactors)
    spectrum.add(steady)
    lines = spectrum.lines()
    assert lines is not None
    mean = steady.mean(axis=0)
    signs = drag_signs(stroke.velocity(0.0)[None], display.shear_axes)[0]
    return SteadyFriction(mean, float(np.mean(signs * mean)), LineSpectrum(*lines))


def steady_duration(speed: float) -> float:
    """Return the duration of a stroke that has a steady part of one segment.

    Parameters
    ----------
    speed : float
        Speed of the finger [m/s].

    Returns
    -------
    float
        Duration [s].
    """
    return ONSET / speed + 2 * SEGMENT
