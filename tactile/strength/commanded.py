"""What a texture asks of the skin in a steady stroke, in closed form: a spectrum of lines.

A plane wave of wave vector k sounds at |k·v|/2π with half its squared amplitude as power, times the
square of the laws of speed and force, rolled off above 1 kHz. The envelope exp(g − ⟨g²⟩), of mean
square one, leaves exp(−var g) of that power in its place and puts the rest into sidebands at the
frequencies of g's waves (their first order, which takes the little of the higher ones as well).

Sparse events have the expected spectrum of `tactile.texture.event_power`.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.rendering.equalizer import roll_off
from tactile.rendering.shear import Law
from tactile.texture.descriptor import Events
from tactile.texture.event_power import power_below
from tactile.texture.surface import Partials, Texture

EVENT_EDGES = np.append(np.arange(0.0, 100.0, 1.0), np.geomspace(100.0, 4000.0, 400))
"""Hz between which the events' power is told as one line."""


@dataclass(frozen=True)
class LineSpectrum:
    """A spectrum.

    Attributes
    ----------
    frequency : (K,) [Hz], not ascending
    power : (K,) mean square [m²] of each line
    """

    frequency: Floats
    power: Floats

    def times(self, factor: Floats | float) -> "LineSpectrum":
        """Return it with its displacement multiplied."""
        return LineSpectrum(self.frequency, self.power * np.square(factor))


def law_factor(texture: Texture, speed: float, normal_force: float) -> float:
    """Return what the laws multiply displacement by at a speed [m/s] and a force [N]."""
    law = Law(texture.descriptor)
    return float(law(np.array([speed**2]), np.array([normal_force]))[0])


def commanded_lines(
    texture: Texture, *, speed: float, normal_force: float, angle: float = 0.0, seed: int = 0
) -> LineSpectrum:
    """Return the spectrum of shear that a texture commands in a straight stroke.

    Parameters
    ----------
    texture : whose
    speed, normal_force, angle : of the stroke [m/s], [N] and from the x axis [rad]
    seed : of the surface's realization; it changes the envelope's share only

    Returns
    -------
    Lines
        Of what `Renderer` commands at every contactor, before what a display can do; without the
        cosine of a display that projects.
    """
    surface = texture.realize(seed)
    velocity = speed * np.array([np.cos(angle), np.sin(angle)])
    bands, gratings = surface.split
    waves = _modulated(bands, surface.envelope, velocity), _lines(gratings, velocity)
    parts = [*waves, *(_event_lines(kind, speed, angle) for kind in texture.descriptor.events)]
    return LineSpectrum(
        np.abs(np.concatenate([part.frequency for part in parts])),
        np.concatenate([part.power for part in parts]),
    ).times(law_factor(texture, speed, normal_force))


def _lines(waves: Partials, velocity: Floats) -> LineSpectrum:
    """Return the lines of waves, signed in frequency."""
    signed = waves.wave_vector @ velocity / (2 * np.pi)
    return LineSpectrum(signed, (waves.amplitude * roll_off(signed)) ** 2 / 2)


def _modulated(waves: Partials, envelope: Partials, velocity: Floats) -> LineSpectrum:
    """Return the waves' lines with the sidebands that the envelope makes, signed in frequency."""
    plain = _lines(waves, velocity)
    if not len(envelope.amplitude):
        return plain
    variance = envelope.amplitude**2 / 2
    kept = np.exp(-variance.sum())
    aside = envelope.wave_vector @ velocity / (2 * np.pi)
    share = (1 - kept) * variance / variance.sum() / 2
    moved = np.concatenate([[0.0], aside, -aside])
    weight = np.concatenate([[kept], share, share])
    return LineSpectrum(
        np.add.outer(plain.frequency, moved).ravel(), np.multiply.outer(plain.power, weight).ravel()
    )


def _event_lines(kind: Events, speed: float, angle: float) -> LineSpectrum:
    """Return one kind's expected spectrum; events are not rolled off."""
    below = power_below(kind, 2 * np.pi * EVENT_EDGES / speed, angle)
    return LineSpectrum((EVENT_EDGES[1:] + EVENT_EDGES[:-1]) / 2, np.diff(below))
