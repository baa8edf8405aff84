"""Fingers before anything is known of them: loads by their logarithms, and how they spread.

A load is k(ω) = k0 + jω d0 + jω k1 d1/(k1 + jω d1). Its four constants are positive and spread over
decades, so that the state of the estimator is their logarithms.

Mean and spread are those of `actuator.population`, which names the assumptions.
"""

from dataclasses import dataclass

import numpy as np

from tactile.actuator.finger import FingerLoad
from tactile.actuator.population import OWN_SIGMA, SCALE_SIGMA
from tactile.arrays import Complex, Floats

CONSTANTS = 4
"""Number of constants of a load: k0 [N/m], d0 [N s/m], k1 [N/m], d1 [N s/m]."""


@dataclass(frozen=True)
class Population:
    """Normal distribution of the logarithms of a load's constants.

    Attributes
    ----------
    mean : (4,) array of float
        Means of ln k0, ln d0, ln k1 and ln d1 in SI units.
    covariance : (4, 4) array of float
        Covariance.
    """

    mean: Floats
    covariance: Floats

    @classmethod
    def assumed(cls) -> "Population":
        """Return the population that `actuator.population` draws fingers from.

        Returns
        -------
        Population
            Fingers around the geometric mean of the paper's two.
        """
        mean = FingerLoad.mid()
        ((k1, d1),) = mean.branches
        constants = np.array([mean.k0, mean.d0, k1, d1], np.float64)
        return cls(np.log(constants), spread(SCALE_SIGMA, OWN_SIGMA))


def spread(common: float, own: float) -> Floats:
    """Compute the covariance of logarithms with a common and an own deviation.

    Parameters
    ----------
    common : float
        Standard deviation that all four constants share.
    own : float
        Standard deviation of each constant besides.

    Returns
    -------
    (4, 4) array of float
        Covariance.
    """
    return common**2 * np.ones((CONSTANTS, CONSTANTS)) + own**2 * np.eye(CONSTANTS)


def load_stiffness(logarithms: Floats, frequency: Floats) -> Complex:
    """Compute the dynamic stiffness of loads.

    Parameters
    ----------
    logarithms : (..., 4) array of float
        Logarithms of k0, d0, k1 and d1 in SI units.
    frequency : (F,) array of float
        Frequencies [Hz].

    Returns
    -------
    (..., F) complex array
        k0 + jω d0 + jω k1 d1/(k1 + jω d1) [N/m].
    """
    return np.asarray(load_terms(logarithms, frequency).sum(axis=-2))


def load_terms(logarithms: Floats, frequency: Floats) -> Complex:
    """Compute the parts of a load's dynamic stiffness and its sensitivity to the constants.

    Parameters
    ----------
    logarithms : (..., 4) array of float
        Logarithms of k0, d0, k1 and d1 in SI units.
    frequency : (F,) array of float
        Frequencies [Hz].

    Returns
    -------
    (..., 4, F) complex array
        Derivatives of the dynamic stiffness to the four logarithms [N/m]. Since it is homogeneous
        of first degree in the constants, their sum is the dynamic stiffness itself (Euler).
    """
    s = 2j * np.pi * frequency
    k0, d0, k1, d1 = np.moveaxis(np.exp(logarithms)[..., None], -2, 0)
    spring, damper = k1, s * d1
    series = spring * damper / (spring + damper)
    share = damper / (spring + damper)
    return np.stack([k0 + 0 * s, s * d0, series * share, series * (1 - share)], axis=-2)
