"""The least displacement that is felt, which figures draw levels against."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

THRESHOLD = np.array(
    [
        (1.0, 25.0),
        (10.0, 8.9),
        (20.0, 5.0),
        (40.0, 2.8),
        (63.0, 1.5),
        (100.0, 0.56),
        (160.0, 0.2),
        (250.0, 0.1),
        (400.0, 0.16),
        (500.0, 0.32),
        (630.0, 0.67),
        (800.0, 1.6),
        (1000.0, 3.5),
    ]
)
"""Hz and µm peak at which a large contactor is just felt: shape of Verrillo and Bolanowski.

For motion along the normal; along the skin 0.3–0.6 times that is felt (Biggs and Srinivasan 2002),
so that a margin seen against it is a cautious one.
"""
THRESHOLD_SPREAD_DB = 5.0
"""Of the threshold, from person to person and study to study."""


def threshold_at(frequency: ArrayLike) -> Floats:
    """Return the peak [m] that is just felt at frequencies (...) [Hz].

    Straight between the table's points where both are logarithmic; infinite beyond the table's
    last, from where on nothing is known, and held below its first.
    """
    f = np.asarray(frequency, np.float64)
    hz, micro = np.log(THRESHOLD.T)
    least = np.exp(np.interp(np.log(np.maximum(f, 1e-9)), hz, micro)) * 1e-6
    return np.where(f <= THRESHOLD[-1, 0] * (1 + 1e-9), least, np.inf)
