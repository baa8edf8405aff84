"""Fingers before anything is known of them: loads by their logarithms, and how they spread.

A load is k(ω) = k0 + jω d0 + jω k1 d1/(k1 + jω d1). Its four constants are positive and spread over
decades, so that the state of the estimator is their logarithms.

The mean is the geometric mean of the two fingers of Hofmann & Twiefel 2014. The spread is assumed:
no published measurement of tangential finger loads up to 1 kHz over many people was available. It
covers the paper's two fingers at 0.2–2 N if the load grows with the square root of the normal
force.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Complex, Floats

CONSTANTS = 4
"""Number of constants of a load: k0 [N/m], d0 [N s/m], k1 [N/m], d1 [N s/m]."""
MEAN = np.log([2070.0, 0.246, 2550.0, 0.812])
"""Logarithms of the geometric means of the paper's low and high finger."""
COMMON = 0.76
"""Standard deviation of the logarithm of a factor common to all four constants (assumed)."""
OWN = 0.30
"""Standard deviation of the logarithm of each constant besides (assumed)."""


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
        """Return the population of the module's docstring.

        Returns
        -------
        Population
            Fingers around the geometric mean of the paper's two.
        """
        return cls(MEAN, spread(COMMON, OWN))


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
