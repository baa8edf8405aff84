"""The equalizer's filter as a mix of fixed filters, since the inverse is linear in the load.

1/H = S/F + k/F. The dynamic stiffness k of any load is within 0.1 dB a sum of a few fixed functions
of frequency, so that the filters of S/F and of each function over F are designed once, and a load
only changes their weights.
"""

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.rendering.equalizer import GRID, STOP_BAND, fit_taps
from tactile.sensing.baseline import Baseline
from tactile.sensing.population import load_stiffness

CORNERS = (120.0, 350.0, 1000.0)
"""Corner frequencies of the functions jω/(jω + ω_j) beside 1 and jω [Hz]."""
FREQUENCY = np.arange(0, STOP_BAND + 1, GRID)
"""Frequencies at which filters are fitted [Hz]."""
BAND = (10.0, 1000.0)
"""Lowest and highest frequency at which loads are fitted [Hz]."""


def _functions(frequency: Floats) -> Complex:
    """Return the functions (B, F) whose sum with real weights is a load's dynamic stiffness."""
    s = 1j * frequency / 1000.0
    return np.stack([np.ones_like(s), s, *(1j * frequency / (1j * frequency + c) for c in CORNERS)])


class InverseMix:
    """Filters of the inverse response of N contactors, for any loads.

    Parameters
    ----------
    baseline : Baseline
        Tips of the contactors.
    sample_rate : float
        Sample rate [Hz].
    taps, delay : int
        Length and delay of the filters [samples].
    """

    def __init__(self, baseline: Baseline, sample_rate: float, *, taps: int, delay: int) -> None:
        force, stiffness = baseline.tip(FREQUENCY)
        functions = _functions(FREQUENCY)
        gains = np.concatenate([stiffness[:, None], functions + 0 * force[:, None]], axis=1)
        gains = gains / (force * baseline.bender.electrode_voltage(FREQUENCY))[:, None]
        n, terms, count = gains.shape
        fitted, _ = fit_taps(gains.reshape(n * terms, count), sample_rate, taps, delay)
        self._fixed = fitted.reshape(n, terms, taps)
        lowest, highest = BAND
        self._inside = inside = (lowest <= FREQUENCY) & (highest >= FREQUENCY)
        self._functions = functions[:, inside]
        self._compliance = stiffness[:, inside]

    def weights(self, logarithms: Floats) -> Floats:
        """Compute the weights of the functions for loads.

        The fit is weighted by 1/(S + k), so that the error is that of the shear.

        Parameters
        ----------
        logarithms : (N, 4) array of float
            Logarithms of the constants of each contactor's load.

        Returns
        -------
        (N, B) array of float
            Weights [N/m].
        """
        k = load_stiffness(logarithms, FREQUENCY[self._inside])
        weight = 1 / np.abs(self._compliance + k)
        left = self._functions * weight[:, None]
        right = k * weight
        gram = (left @ left.conj().transpose(0, 2, 1)).real
        pull = np.einsum("nbf,nf->nb", left.conj(), right).real
        return np.linalg.solve(gram, pull[..., None])[..., 0]

    def taps(self, logarithms: Floats, touching: NDArray[np.bool_] | None = None) -> Floats:
        """Mix the filters for loads.

        Parameters
        ----------
        logarithms : (N, 4) array of float
            Logarithms of the constants of each contactor's load.
        touching : (N,) array of bool, optional
            Contactors that have a load; the others move in air. By default all have one.

        Returns
        -------
        (N, T) array of float
            Filter of each contactor [V/m].
        """
        weights = self.weights(logarithms)
        if touching is not None:
            weights *= touching[:, None]
        mixed = np.einsum("nb,nbt->nt", weights, self._fixed[:, 1:])
        return np.asarray(self._fixed[:, 0] + mixed)
