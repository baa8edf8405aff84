"""Differences between the benders of one array, as factors of the design's constants."""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats

STIFFNESS, D31, MASS = 0.05, 0.10, 0.01
"""Largest departures of stiffness, d31 and mass from the design (assumed; suppliers of ceramics
commonly state ±5 to ±10 % for elastic and piezoelectric constants)."""
CABLE = 100e-12
"""Capacitance of the cable to each contactor [F] (assumed; a meter of thin coaxial cable)."""


@dataclass(frozen=True)
class Tolerances:
    """Factors of N benders that are nearly alike, and the capacitance of their cables.

    Attributes
    ----------
    stiffness : (N,) array of float
        Factor of the bending and the shear stiffness.
    d31 : (N,) array of float
        Factor of the piezoelectric constant.
    mass : (N,) array of float
        Factor of mass and rotary inertia.
    cable : (N,) array of float
        Capacitance in parallel with the bender [F].
    """

    stiffness: Floats
    d31: Floats
    mass: Floats
    cable: Floats

    @classmethod
    def none(cls, contactors: int) -> "Tolerances":
        """Return benders that are as designed, without cables.

        Parameters
        ----------
        contactors : int
            Number of contactors N.

        Returns
        -------
        Tolerances
            Factors of one.
        """
        one = np.ones(contactors)
        return cls(one, one, one, np.zeros(contactors))

    @classmethod
    def drawn(cls, contactors: int, seed: int) -> "Tolerances":
        """Draw benders of an array, each factor uniformly within its tolerance (assumed).

        Parameters
        ----------
        contactors : int
            Number of contactors N.
        seed : int
            Seed, from 0 up; the same seed gives the same benders.

        Returns
        -------
        Tolerances
            Stiffness within ±5 %, d31 within ±10 %, mass within ±1 %, and a cable of 100 pF.
        """
        rng = np.random.default_rng(seed)
        parts = [1 + rng.uniform(-most, most, contactors) for most in (STIFFNESS, D31, MASS)]
        return cls(parts[0], parts[1], parts[2], np.full(contactors, CABLE))
