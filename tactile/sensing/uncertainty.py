"""What the uncertainty of a load means for its stiffness, and for the shear that is played.

The covariance of an estimate is that at the middle of its window. It does not contain what changes
until a filter for it plays.
"""

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.sensing.baseline import Baseline
from tactile.sensing.population import load_terms

FREQUENCY = np.geomspace(10.0, 1000.0, 25)
"""Frequencies at which the uncertainty is computed [Hz]."""
DECIBELS = 20 / np.log(10)
"""Decibels per unit of natural logarithm."""


def shear_deviation(baseline: Baseline, logarithms: Floats, covariance: Floats) -> Floats:
    """Compute the standard deviation of the level of the played shear.

    The shear per volt is H = F/(S + k), so that d ln H = −dk/(S + k).

    Parameters
    ----------
    baseline : Baseline
        Tips of the contactors.
    logarithms : (N, 4) array of float
        Logarithms of the constants of the load for which the filters are made.
    covariance : (N, 4, 4) array of float
        Covariance of these logarithms.

    Returns
    -------
    (N,) array of float
        Standard deviation, root mean square over 10–1000 Hz on a logarithmic axis [dB].
    """
    terms = load_terms(logarithms, FREQUENCY)
    _, stiffness = baseline.tip(FREQUENCY)
    slope = (terms / (stiffness + terms.sum(axis=1))[:, None]).real
    variance = np.einsum("naf,nab,nbf->nf", slope, covariance, slope)
    return np.asarray(DECIBELS * np.sqrt(variance.mean(axis=1)))


def stiffness_deviation(logarithms: Floats, covariance: Floats, frequency: Floats) -> Complex:
    """Compute the standard deviations of the dynamic stiffness of loads.

    Parameters
    ----------
    logarithms : (N, 4) array of float
        Logarithms of the constants of the loads.
    covariance : (N, 4, 4) array of float
        Covariance of these logarithms.
    frequency : (F,) array of float
        Frequencies [Hz].

    Returns
    -------
    (N, F) complex array
        Standard deviation of the real part, and as the imaginary part that of the imaginary part
        [N/m].
    """
    terms = load_terms(logarithms, frequency)
    real, imaginary = (
        np.sqrt(np.einsum("naf,nab,nbf->nf", slope, covariance, slope))
        for slope in (terms.real, terms.imag)
    )
    return np.asarray(real + 1j * imaginary)
