"""Prediction of the sums of the measured current times the delayed steps of the drive.

In a window of samples n the amplifier forms r_l = Σ_n i[n] d[n − l] of the current i and the steps
d[n] = u[n] − u[n − 1] of the drive that it played, for a few lags l. The current is linear in the
effective voltage v (`hysteresis`). Whatever its response h to a step is, the sums are r = Gᵀ h with
G[m, l] = Σ_n (v[n − m] − v[n − m − 1]) d[n − l], which the host computes from the drive that it
knows, a little before and after the window too. The edges of the windows therefore make no error.
The drive is taken as band-limited between samples: an amplifier needs a reconstruction filter,
since after a stair-step the current depends on when it is sampled.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats

LAGS = 16
"""Number of lags of the sums."""
BEFORE = 12
"""Number of samples before a step from which the current responds to it, since the drive between
samples is band-limited."""
AFTER = 240
"""Number of samples for which the current responds to a step: 30 ms at 8 kHz."""
EARLIER = 800
"""Number of samples before those for which a tip in air still swings: with them 130 ms at 8 kHz,
six time constants of the default bender's resonance."""
MARGIN = BEFORE + LAGS - 1
"""Number of steps after the window that the products need."""


@dataclass(frozen=True)
class SumWindow:
    """Lag sums of a window, and the drive that they belong to.

    Attributes
    ----------
    sums : (N, LAGS) array of float
        Sums of the measured current of each contactor [A V].
    played : (N, LAGS − 1 + S) array of float
        Steps of the drive, from `LAGS` − 1 samples before the window of S samples to its end [V].
    steps : (N, AFTER + S + MARGIN) array of float
        Steps of the effective voltage, from `AFTER` samples before the window to `MARGIN` after it
        [V].
    resolution : (N,) array of float
        Step to which the sums were rounded [A V].
    valid : (N,) array of bool
        Whether the sums may be used. They may not where the converter clipped, where the drive that
        was played is not known, or where no report came.
    earlier : (N, EARLIER) array of float
        Steps of the effective voltage before those [V].
    """

    sums: Floats
    played: Floats
    steps: Floats
    resolution: Floats
    valid: NDArray[np.bool_]
    earlier: Floats

    @property
    def samples(self) -> int:
        """Length of the window [samples]."""
        return int(self.steps.shape[1]) - AFTER - MARGIN


def during(steps: Floats) -> Floats:
    """Select those of the steps of a drive that a window's sums are formed with.

    Parameters
    ----------
    steps : (N, AFTER + S + MARGIN) array of float
        Steps of a drive, from `AFTER` samples before the window of S samples to `MARGIN` after it.

    Returns
    -------
    (N, LAGS − 1 + S) array of float
        Those from `LAGS` − 1 samples before the window to its end.
    """
    return steps[:, AFTER - LAGS + 1 : -MARGIN]


def step_products(steps: Floats, played: Floats) -> Floats:
    """Compute the products G of the steps of the effective voltage with delayed ones of the drive.

    Parameters
    ----------
    steps : (N, AFTER + S + MARGIN) array of float
        Steps of the effective voltage, from `AFTER` samples before the window of S samples to
        `MARGIN` after it [V].
    played : (N, LAGS − 1 + S) array of float
        Steps of the drive, from `LAGS` − 1 samples before the window to its end [V].

    Returns
    -------
    (N, BEFORE + AFTER + 1, LAGS) array of float
        G[m, l] for m = −BEFORE … AFTER and l = 0 … LAGS − 1 [V²].
    """
    begin, end = AFTER, steps.shape[1] - MARGIN
    rows = [
        np.correlate(row, now[LAGS - 1 :], "valid")[::-1]
        for row, now in zip(steps, played, strict=True)
    ]
    column = np.array(rows)  # l = 0, m = −MARGIN … AFTER
    reversed_ = steps[:, ::-1]

    def at(place: int) -> Floats:
        """Return the steps at ``place`` − m for all m but the last."""
        first = steps.shape[1] - 1 - (place + MARGIN)
        return np.ascontiguousarray(reversed_[:, first : first + column.shape[1] - 1])

    entering, leaving = at(begin - 1), at(end - 1)
    products = np.empty((LAGS, len(steps), BEFORE + AFTER + 1))
    products[0] = column[:, LAGS - 1 :]
    for lag in range(1, LAGS):
        # G[m + 1, l + 1] = G[m, l] + what enters at the begin − the same at the end
        moved = entering * played[:, LAGS - 1 - lag, None]
        moved -= leaving * played[:, -lag, None]
        column[:, 1:] = moved + column[:, :-1]
        products[lag] = column[:, LAGS - 1 :]
    return np.moveaxis(products, 0, 2)
