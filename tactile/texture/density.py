"""Two-dimensional spectra of random surfaces, and the fields that realize them.

The plane waves of a texture are a coarse quadrature of such a spectrum: as many waves as links and
closed forms can afford, each with the power of the part of the plane around it. The density here
is the spectrum itself. It is piecewise linear over the logarithm of the wave number, with a knot at
the center of each third octave, and every ring of a third octave has the power of its waves. Over
directions it is even, or normal about the direction of the texture.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from tactile.arrays import Floats
from tactile.texture.bands import ABOVE, BELOW, third_octaves
from tactile.texture.field import PIXELS, Field, field_of, lattice, pitch_of

FEWEST = 24
"""Number of waves of a tile that a third octave needs; with fewer, the bands of strokes would
differ from direction to direction."""


@dataclass(frozen=True)
class Density:
    """Power of a random surface by wave number and direction.

    Attributes
    ----------
    center : (B,) array of float
        Centers of adjacent third octaves [cycles/m].
    power : (B,) array of float
        Power of each third octave, as a ring of the plane [m²].
    direction : float
        Direction about which wave vectors are scattered [rad].
    spread : float or None
        Standard deviation of their direction [rad]; None for an isotropic surface.
    contact : float
        Length l of the low-pass of the contact, 1/√(1 + (κ l)²), 0 for none [m].
    """

    center: Floats
    power: Floats
    direction: float
    spread: float | None
    contact: float = 0.0

    @property
    def edges(self) -> Floats:
        """Edges of the third octaves, (B + 1,) [cycles/m]."""
        return third_octaves(self.center)

    @property
    def resolved(self) -> float:
        """Lowest spatial frequency of a field, below which a tile has too few waves [cycles/m]."""
        share = 1.0 if self.spread is None else min(1.0, 2 * self.spread / math.sqrt(math.pi))
        area = PIXELS * pitch_of(self.edges[-1]) ** 2
        ring = math.pi * (ABOVE**2 - BELOW**2) / 2 * area * share
        return max(float(self.edges[0]), math.sqrt(FEWEST / ring))

    def per_unit_log(self, frequency: Floats) -> Floats:
        """Compute the power per unit of the logarithm of the spatial frequency.

        The knots at the centers are those whose rings come nearest to their powers without being
        negative. Where a peak is too narrow for them, the factor of a ring makes up for it.

        Parameters
        ----------
        frequency : (M,) array of float
            Magnitudes of spatial frequencies [cycles/m].

        Returns
        -------
        (M,) array of float
            Power per unit of ln κ, whose integral over each ring is the power of the ring [m²].
        """
        count, least = len(self.center), 1e-12 * self.power.max()
        ring = 0.75 * np.eye(count) + 0.125 * (np.eye(count, k=1) + np.eye(count, k=-1))
        ring[0, 0] = ring[-1, -1] = 0.875
        weight = 1 / np.maximum(self.power, least)
        knots = nnls(ring * weight[:, None], self.power * weight)[0] + least
        factor = self.power / (ring @ knots) / math.log(ABOVE / BELOW)
        smooth = np.interp(np.log(frequency), np.log(self.center), knots)
        return np.asarray(smooth * factor[np.digitize(frequency, self.edges[1:-1])])

    def at(self, frequency: Floats) -> Floats:
        """Compute the density over the plane of spatial frequencies.

        Parameters
        ----------
        frequency : (2, M) array of float
            Rows x and y of the spatial frequencies, none of them 0 [cycles/m].

        Returns
        -------
        (M,) array of float
            Power per area, whose integral over the plane is the variance [m⁴].
        """
        size = np.hypot(*frequency)
        per_log = self.per_unit_log(size) / (1 + (2 * np.pi * size * self.contact) ** 2)
        around = np.full(len(size), 1 / (2 * np.pi))
        if self.spread is not None:
            off = np.arctan2(frequency[1], frequency[0]) - self.direction
            off = (off + np.pi / 2) % np.pi - np.pi / 2
            turns = off[:, None] + np.pi * np.arange(-1, 2)
            around = np.exp(-((turns / self.spread) ** 2) / 2).sum(axis=1)
            around /= 2 * self.spread * math.sqrt(2 * math.pi)
        return np.asarray(per_log * around / size**2)

    def field(self, rng: np.random.Generator) -> Field | None:
        """Draw a field with this density.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of the random phases.

        Returns
        -------
        Field or None
            Field of all waves from `resolved` to the last edge; None for a surface without power.
        """
        highest, lowest = float(self.edges[-1]), self.resolved
        if not self.power.any() or lowest >= highest:
            return None
        pitch = pitch_of(highest)
        frequency = lattice(pitch)
        size = np.hypot(*frequency)
        inside = (size >= lowest) & (size < highest)
        # Each wave stands for itself and for its mirror image, and has 1/(n pitch²) of the plane.
        power = 2 * self.at(frequency[:, inside]) / (PIXELS * pitch**2)
        phase = rng.uniform(0, 2 * np.pi, len(power))
        waves = np.zeros(len(size), np.complex128)
        waves[inside] = np.sqrt(2 * power) * np.exp(1j * phase)
        return field_of(waves, highest, lowest)
