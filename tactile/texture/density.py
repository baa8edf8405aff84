"""Two-dimensional spectra of random surfaces, and the fields that realize them.

The plane waves of a texture are a coarse quadrature of such a spectrum: as many waves as links and
closed forms can afford, each with the power of the part of the plane around it. The density here
is the spectrum itself. It is piecewise linear over the logarithm of the wave number, with a knot at
the center of each third octave, and every ring of a third octave has the power of its waves. Over
directions it is even, or normal about the direction of the texture.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtri

from tactile.arrays import Floats
from tactile.machine_code import compiled
from tactile.texture.bands import ABOVE, BELOW, third_octaves
from tactile.texture.field import PIXELS, Field, field_of, lattice, pitch_of

ANGLES, RADII = 64, 32
"""Number of directions, and of wave numbers in a ring, with which rings are projected to bands."""
NEARNESS = 0.02
"""Weight that keeps the power of a ring near that of its waves, where bands leave it open."""
LEFT = 3
"""Number of third octaves that are left to plane waves, which cost about as much as a field."""
NARROW = 3.0
"""Ratio between the ends of a field that is worth while."""
FEWEST = 20
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
    weight : (B,) array of float, or 1
        Factor on the power of each third octave, which is not smoothed.
    """

    center: Floats
    power: Floats
    direction: float
    spread: float | None
    contact: float = 0.0
    weight: Floats = field(default_factory=lambda: np.ones(1))

    @property
    def edges(self) -> Floats:
        """Edges of the third octaves, (B + 1,) [cycles/m]."""
        return third_octaves(self.center)

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """Lowest and highest spatial frequency of each field, the finest first [cycles/m].

        A field ends where its tile has too few waves, and the next one begins there, unless no
        more than `LEFT` third octaves remain, which are left to plane waves. All is left to them
        for a surface whose wave vectors point so nearly in one direction that a tile would have too
        few of them within a factor of `NARROW`.
        """
        share = 1.0 if self.spread is None else min(1.0, 2 * self.spread / math.sqrt(math.pi))
        waves = math.pi * (ABOVE**2 - BELOW**2) / 2 * PIXELS * pitch_of(1.0) ** 2 * share
        resolved, highest = math.sqrt(FEWEST / waves), float(self.edges[-1])
        fields: list[tuple[float, float]] = []
        if resolved > 1 / NARROW:
            return []
        while np.count_nonzero(self.center < highest) > LEFT or not fields:
            fields.append((max(float(self.edges[0]), resolved * highest), highest))
            highest = fields[-1][0]
        return fields

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
        factor = self.weight * self.power / (ring @ knots) / math.log(ABOVE / BELOW)
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

    def weighted(self, factor: Floats | float) -> "Density":
        """Return the density of a surface whose displacement is multiplied by a factor.

        Parameters
        ----------
        factor : (B,) array of float or float
            Factor on the displacement of each third octave.

        Returns
        -------
        Density
            Density with the squares of the factors as weights.
        """
        return replace(self, weight=self.weight * np.square(factor))

    def met(self, angle: float) -> tuple[Floats, Floats, Floats]:
        """Sample the waves that a stroke meets.

        A wave at an angle α to the stroke is met with the spatial frequency κ|cos α|.

        Parameters
        ----------
        angle : float
            Direction of the stroke [rad].

        Returns
        -------
        size : (K, 1) array of float
            Spatial frequencies κ/2π of the waves, `RADII` in each third octave [cycles/m].
        along : (K, A) array of float
            Spatial frequencies along the stroke, in `ANGLES` directions of equal power [cycles/m].
        power : (K, 1) array of float
            Power in each of these directions [m²].
        """
        even = (np.arange(ANGLES) + 0.5) / ANGLES
        turns = np.pi * even if self.spread is None else self.direction + self.spread * ndtri(even)
        ring, ends = np.repeat(np.arange(len(self.center)), RADII), np.log(self.edges)
        step = np.diff(ends) / RADII
        size = np.exp(ends[ring] + step[ring] * (np.arange(len(ring)) % RADII + 0.5))
        power = self.per_unit_log(size) / (1 + (2 * np.pi * size * self.contact) ** 2)
        along = np.abs(np.outer(size, np.cos(turns - angle)))
        return size[:, None], along, (power * step[ring] / ANGLES)[:, None]

    def met_squares(self, velocity: Floats, squares: Floats) -> Floats:
        """Compute the squared speed at which a finger may meet the waves.

        It is less than that of the finger where all wave vectors, within two standard deviations
        of their direction, point away from its motion.

        Parameters
        ----------
        velocity : (2, S) array of float
            Rows x and y of the velocity of the finger [m/s].
        squares : (S,) array of float
            Squared speed of the finger [m²/s²].

        Returns
        -------
        (S,) array of float
            Largest square of κ·v/κ among the waves [m²/s²].
        """
        if self.spread is None:
            return squares
        wide = min(2 * self.spread, math.pi / 2)
        return met_squares(velocity, squares, self.direction, wide)

    def with_bands(self, band: Floats) -> "Density":
        """Return a density near this one whose strokes have given bands.

        Parameters
        ----------
        band : (B,) array of float
            Power of a stroke in each band [m²].

        Returns
        -------
        Density
            Density whose rings have other powers, each as near as possible to what it was.
        """
        count = len(self.center)
        _, along, power = self.met(self.direction)
        place = np.digitize(along, self.edges[1:]) * count + np.arange(len(along))[:, None] // RADII
        inside = along >= self.edges[0]
        share = np.bincount(place[inside], np.broadcast_to(power, along.shape)[inside], count**2)
        share = share.reshape(count, count)
        scale = np.maximum(band, share.sum(axis=1))
        scale = np.maximum(scale, 1e-9 * scale.max())
        target = np.append(band / scale, np.full(count, NEARNESS))
        near = np.concatenate([share / scale[:, None], NEARNESS * np.eye(count)])
        return replace(self, power=self.power * nnls(near, target)[0])

    def drawn(self, rng: np.random.Generator) -> tuple[Field, ...]:
        """Draw fields with this density.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of the random phases.

        Returns
        -------
        tuple of Field
            A field for each of `ranges`; none for a surface without power.
        """
        if not np.any(self.weight * self.power):
            return ()
        return tuple(self._field(*ends, rng) for ends in self.ranges)

    def _field(self, lowest: float, highest: float, rng: np.random.Generator) -> Field:
        """Return a field of all waves between two spatial frequencies [cycles/m]."""
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


@compiled("float64[::1](float64[:, :], float64[:], float64, float64)")
def met_squares(velocity: Floats, squares: Floats, direction: float, wide: float) -> Floats:
    """Compute `Density.met_squares` for wave vectors within an angle of a direction.

    Parameters
    ----------
    velocity : (2, S) array of float
        Rows x and y of the velocity of the finger [m/s].
    squares : (S,) array of float
        Squared speed of the finger [m²/s²].
    direction : float
        Direction about which wave vectors are scattered [rad].
    wide : float
        Largest angle between a wave vector and that direction, at most π/2 [rad].

    Returns
    -------
    (S,) array of float
        Largest square of κ·v/κ among the waves [m²/s²].
    """
    met = np.empty(len(squares))
    for n in range(len(squares)):
        x, y = velocity[0, n], velocity[1, n]
        along = abs(x * math.cos(direction) + y * math.sin(direction))
        across = abs(y * math.cos(direction) - x * math.sin(direction))
        nearest = along * math.cos(wide) + across * math.sin(wide)
        away = across * math.cos(wide) > along * math.sin(wide)
        met[n] = nearest * nearest if away else squares[n]
    return met
