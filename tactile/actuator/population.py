"""Fingers that nobody has measured: a population around those of Hofmann & Twiefel 2014.

The paper gives two fingers. That these are typical, and how fingers differ, is assumed: the
constants are lognormal around the geometric mean of both fingers.
"""

import numpy as np

from tactile.actuator.finger import FingerLoad

SCALE_SIGMA = 0.76
"""Standard deviation of the logarithm of the factor that is common to all constants of a finger
(assumed; the two fingers of the paper are ln 4.3 = 1.46 apart, two of it)."""
OWN_SIGMA = 0.30
"""Standard deviation of the logarithm of each constant besides (assumed)."""
CONTACTOR_SIGMA = 0.15
"""Standard deviation of the logarithm of the factor of each contactor, which touches another place
of the pad (assumed)."""


def random_finger(seed: int, contactors: int) -> FingerLoad:
    """Draw a finger of the population, with a load for each contactor.

    ln k0, ln d0, ln k1 and ln d1 are those of `FingerLoad.mid` plus three normal deviates: one that
    all constants and contactors have in common, one of each constant, and one of each contactor,
    which its constants have in common.

    Parameters
    ----------
    seed : int
        Seed, from 0 up; the same seed gives the same finger.
    contactors : int
        Number of contactors N.

    Returns
    -------
    FingerLoad
        Load at 1 N, of arrays (N,).
    """
    rng = np.random.default_rng(seed)
    mean = FingerLoad.mid()
    ((k1, d1),) = mean.branches
    common = SCALE_SIGMA * rng.standard_normal() + OWN_SIGMA * rng.standard_normal(4)
    place = CONTACTOR_SIGMA * rng.standard_normal(contactors)
    constants = np.array([mean.k0, mean.d0, k1, d1])[:, None] * np.exp(common[:, None] + place)
    return FingerLoad(k0=constants[0], d0=constants[1], branches=((constants[2], constants[3]),))
