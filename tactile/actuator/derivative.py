"""Current as the band-limited derivative of the charge that is sampled.

A load that changes from sample to sample makes the tip move quickly within each sample. The current
of an instant misses such motion, while the charge contains it.
"""

import numpy as np

from tactile.arrays import Floats

REACH = 16
"""Number of samples on either side that the derivative is made of."""
BAND = 0.4
"""Highest frequency at which it is exact, to 6e-5, as a fraction of the sample rate."""
POINTS = 2000
"""Number of frequencies at which it is fitted."""


def derivative_taps() -> Floats:
    """Fit a filter whose response is jω below `BAND`, in the least squares of the relative error.

    Returns
    -------
    (2 REACH + 1,) array of float
        Weights of the samples −REACH … REACH [per sample].
    """
    omega = 2 * np.pi * BAND * (np.arange(POINTS) + 0.5) / POINTS
    steps = np.arange(1, REACH + 1)
    sines = 2 * np.sin(np.outer(omega, steps)) / omega[:, None]
    half, *_ = np.linalg.lstsq(sines, np.ones(POINTS), rcond=None)
    return np.concatenate([-half[::-1], [0.0], half])


class Derivative:
    """Derivative of a signal of N channels, block by block.

    Parameters
    ----------
    channels : int
        Number of channels N.
    """

    def __init__(self, channels: int) -> None:
        self._taps = derivative_taps()
        self._past = np.zeros((2 * REACH, channels))

    def follow(self, signal: Floats) -> Floats:
        """Compute the derivative at further samples.

        Parameters
        ----------
        signal : (S, N) array of float
            Signal.

        Returns
        -------
        (S, N) array of float
            Derivative per sample, `REACH` samples late.
        """
        line = np.concatenate([self._past, signal])
        self._past = line[len(signal) :].copy()
        total = np.zeros_like(signal)
        for k in range(REACH):
            rise = line[2 * REACH - k : len(line) - k] - line[k : k + len(signal)]
            total += self._taps[2 * REACH - k] * rise
        return total
