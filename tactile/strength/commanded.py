"""Spectrum of the shear that a texture commands in a steady stroke, in closed form as lines.

A plane wave of wave vector k sounds at |k·v|/2π. The waves of a grating have half their squared
amplitude as power, times the square of the laws of speed and force, rolled off above 1 kHz. The
random part has the power of its density that a stroke meets in each interval of frequency, with the
levels that its field plays. The envelope exp(g), scaled to the mean square 1, leaves I₀(a)²/I₀(2a)
of that power at the wave's frequency for each of g's waves a, and moves the rest into sidebands at
the frequencies of g's waves (the first order, which here takes the small power of the higher ones
as well).

Sparse events have the expected spectrum of `tactile.texture.event_power`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import i0

from tactile.arrays import Floats
from tactile.rendering.equalizer import roll_off
from tactile.rendering.layer import FIELD_BAND
from tactile.rendering.shear import Law
from tactile.texture.density import Density
from tactile.texture.descriptor import Events
from tactile.texture.event_power import power_below
from tactile.texture.field import played_share
from tactile.texture.surface import Partials, Texture

RANDOM_LINES = 480
"""Number of lines of the random part, 16 per third octave."""

EVENT_EDGES = np.append(np.arange(0.0, 100.0, 1.0), np.geomspace(100.0, 4000.0, 400))
"""Edges of the frequency intervals in which the power of events is combined into one line [Hz]."""


@dataclass(frozen=True)
class LineSpectrum:
    """Power spectrum of discrete lines.

    Attributes
    ----------
    frequency : (K,) array of float
        Frequencies, in any order [Hz].
    power : (K,) array of float
        Mean square of each line [m²].
    """

    frequency: Floats
    power: Floats

    def __add__(self, other: "LineSpectrum") -> "LineSpectrum":
        return LineSpectrum(
            np.concatenate([self.frequency, other.frequency]),
            np.concatenate([self.power, other.power]),
        )

    def times(self, factor: Floats | float) -> "LineSpectrum":
        """Return the spectrum of a scaled displacement.

        Parameters
        ----------
        factor : (K,) array of float or float
            Factor on the displacement.

        Returns
        -------
        LineSpectrum
            Spectrum with its powers times the square of the factor.
        """
        return LineSpectrum(self.frequency, self.power * np.square(factor))


def law_factor(texture: Texture, speed: float, normal_force: float) -> float:
    """Compute the factor of a texture's laws on displacement.

    Parameters
    ----------
    texture : Texture
        Texture with the laws.
    speed : float
        Speed of the finger [m/s].
    normal_force : float
        Normal force [N].

    Returns
    -------
    float
        Factor on displacement.
    """
    law = Law(texture.descriptor)
    return float(law(np.array([speed**2]), np.array([normal_force]))[0])


def commanded_lines(
    texture: Texture, *, speed: float, normal_force: float, angle: float = 0.0
) -> LineSpectrum:
    """Compute the spectrum of the shear that a texture commands in a straight stroke.

    Parameters
    ----------
    texture : Texture
        Texture to play.
    speed : float
        Speed of the stroke [m/s].
    normal_force : float
        Normal force [N].
    angle : float
        Direction of the stroke, measured from the x axis [rad].

    Returns
    -------
    LineSpectrum
        Lines that `Renderer` commands at every contactor, before the limits of a display and
        without the cosine of a display that projects.
    """
    surface = texture.realize()
    velocity = speed * np.array([np.cos(angle), np.sin(angle)])
    parts = [_lines(surface.split[1], velocity)]
    if surface.density is not None:
        parts.append(
            _modulated(random_lines(surface.density, velocity), surface.envelope, velocity)
        )
    parts += [_event_lines(kind, speed, angle) for kind in texture.descriptor.events]
    return LineSpectrum(
        np.abs(np.concatenate([part.frequency for part in parts])),
        np.concatenate([part.power for part in parts]),
    ).times(law_factor(texture, speed, normal_force))


def _lines(waves: Partials, velocity: Floats) -> LineSpectrum:
    """Return the lines of waves, with signed frequencies."""
    signed = waves.wave_vector @ velocity / (2 * np.pi)
    return LineSpectrum(signed, (waves.amplitude * roll_off(signed)) ** 2 / 2)


def random_lines(density: Density, velocity: Floats) -> LineSpectrum:
    """Compute the spectrum of the random part, without its envelope and the laws.

    Parameters
    ----------
    density : Density
        Two-dimensional spectrum of the surface.
    velocity : (2,) array of float
        Velocity of the finger [m/s].

    Returns
    -------
    LineSpectrum
        `RANDOM_LINES` lines, each with the power in an interval of frequency.
    """
    size, along, power = density.met(float(np.arctan2(velocity[1], velocity[0])))
    squares = np.array([velocity @ velocity])
    fastest = float(np.sqrt(density.met_squares(velocity[:, None], squares)[0])) / FIELD_BAND
    power = power * played_share(size * fastest, float(density.edges[-1]) * fastest) ** 2
    edges = np.append(0.0, density.edges[-1] * np.geomspace(1e-3, 1.0, RANDOM_LINES))
    met = np.histogram(along, edges, weights=np.broadcast_to(power, along.shape))[0]
    return LineSpectrum((edges[1:] + edges[:-1]) / 2 * np.sqrt(squares[0]), met)


def _modulated(plain: LineSpectrum, envelope: Partials, velocity: Floats) -> LineSpectrum:
    """Return lines with the envelope's sidebands, with signed frequencies."""
    if not len(envelope.amplitude):
        return plain
    variance = envelope.amplitude**2 / 2
    remaining = np.prod(i0(envelope.amplitude) ** 2 / i0(2 * envelope.amplitude))
    offset = envelope.wave_vector @ velocity / (2 * np.pi)
    share = (1 - remaining) * variance / variance.sum() / 2
    moved = np.concatenate([[0.0], offset, -offset])
    weight = np.concatenate([[remaining], share, share])
    return LineSpectrum(
        np.add.outer(plain.frequency, moved).ravel(), np.multiply.outer(plain.power, weight).ravel()
    )


def _event_lines(kind: Events, speed: float, angle: float) -> LineSpectrum:
    """Return the expected spectrum of one kind of events, which are not rolled off."""
    below = power_below(kind, 2 * np.pi * EVENT_EDGES / speed, angle)
    return LineSpectrum((EVENT_EDGES[1:] + EVENT_EDGES[:-1]) / 2, np.diff(below))
