"""Hysteresis of a piezoceramic between voltage and polarization: a sum of play operators.

The effective voltage is P[U] = U + Σ w_r play_r[U] (Prandtl–Ishlinskii). A play of radius r follows
the voltage only when the voltage is farther away than r, so that its value lags by r on either way.
With weights in proportion to the spacing of the radii the loop widens with the amplitude, as that
of a soft ceramic does (Rayleigh). A drive smaller than the smallest radius is not changed at all;
at full drive the swing grows by 32 % for a width of 12 %. Number and spacing of the plays are
assumed; they are denser for small drives, since most textures are.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from tactile.arrays import Floats

PLAYS = 20
"""Number of play operators (assumed)."""
BOUNDS = (np.arange(PLAYS + 1) / PLAYS) ** 2
"""Bounds of the parts of full drive for each of which there is a play."""
RADII, SHARES = (BOUNDS[1:] + BOUNDS[:-1]) / 2, np.diff(BOUNDS)
"""Radius of each play as a fraction of full drive, and its share of all weights."""


@dataclass(frozen=True, kw_only=True)
class Hysteresis:
    """Hysteresis of a stated width at full drive.

    Parameters
    ----------
    width : float
        Largest distance between both branches of the loop at full drive, as a fraction of its whole
        swing; 0.12 to 0.15 is typical of soft ceramics (assumed).
    full_drive : float
        Amplitude of the drive at which the loop has that width [V].

    Raises
    ------
    ValueError
        If the width is not from 0 to 0.3, or if the full drive is not above zero.
    """

    width: float
    full_drive: float

    def __post_init__(self) -> None:
        if not 0 <= self.width <= 0.3:
            raise ValueError(f"Hysteresis: width = {self.width} is not 0 … 0.3")
        if not (np.isfinite(self.full_drive) and self.full_drive > 0):
            raise ValueError(f"Hysteresis: full_drive = {self.full_drive} V is not above 0 V")

    @property
    def weights(self) -> Floats:
        """Weights of the plays, array (PLAYS,).

        At amplitude A the branches are 2 Σ w min(r, A − r) apart in the middle, and the swing is
        2 A + 2 Σ w (A − r).
        """
        apart = SHARES @ np.minimum(RADII, 1 - RADII)
        return np.asarray(SHARES * self.width / (apart - self.width * (SHARES @ (1 - RADII))))


FINE = 4
"""Number of points per sample at which the hysteresis follows the drive."""


class Plays:
    """Play operators of N contactors, with their memory.

    Parameters
    ----------
    hysteresis : Hysteresis
        Width and full drive.
    contactors : int
        Number of contactors N.
    """

    def __init__(self, hysteresis: Hysteresis, contactors: int) -> None:
        self._weights = hysteresis.weights
        self._radius = hysteresis.full_drive * RADII[:, None]
        self._play = np.zeros((PLAYS, contactors))

    def follow(self, drive: Floats) -> Floats:
        """Compute how far the effective voltage departs from the drive.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive [V].

        Returns
        -------
        (S, N) array of float
            Effective voltage less the drive [V].
        """
        highest, lowest = drive[:, None] + self._radius, drive[:, None] - self._radius
        plays = np.empty_like(highest)
        for play, high, low in zip(plays, highest, lowest, strict=True):
            np.maximum(self._play, low, out=play)
            np.minimum(play, high, out=play)
            self._play = play
        return np.asarray(np.einsum("srn,r->sn", plays, self._weights))


class BentDrive:
    """Departure of the effective voltage from a band-limited drive, within each sample.

    The plays follow the drive at `FINE` points per sample, between which the departure is the
    polynomial through these points.

    Parameters
    ----------
    hysteresis : Hysteresis
        Width and full drive.
    contactors : int
        Number of contactors N.
    """

    def __init__(self, hysteresis: Hysteresis, contactors: int) -> None:
        self._plays = Plays(hysteresis, contactors)
        self._last = np.zeros((1, contactors))
        powers = np.arange(FINE + 1) / FINE
        scale = [factorial(j) for j in range(FINE + 1)]
        self._derivatives = np.linalg.inv(powers[:, None] ** np.arange(FINE + 1) / scale)

    def follow(self, drive: Floats) -> Floats:
        """Compute the departure.

        Parameters
        ----------
        drive : (S, FINE, N) array of float
            Drive at the fractions 1/FINE … 1 of each sample [V].

        Returns
        -------
        (S, N, FINE + 1) array of float
            Departure at the start of each sample, and its derivatives by the fraction of it [V].
        """
        count, _, contactors = drive.shape
        followed = self._plays.follow(drive.reshape(-1, contactors))
        line = np.concatenate([self._last, followed])
        self._last = line[-1:].copy()
        points = np.stack([line[i::FINE][:count] for i in range(FINE + 1)], axis=-1)
        return np.asarray(points @ self._derivatives.T)
