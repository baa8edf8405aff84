"""Third-octave bands of base ten (IEC 61260-1), each from 10^−0.05 to 10^0.05 times its center.

Every spectrum of the project is given in such bands, both over the spatial frequency of a surface
[cycles/m] and over the frequency of skin vibration [Hz].
"""

import numpy as np

from tactile.arrays import Floats

BELOW, ABOVE = 10**-0.05, 10**0.05
"""Lower and upper edge of a band, each divided by its center."""
RELATIVE_WIDTH = ABOVE - BELOW
"""Width of a band divided by its center."""


def third_octaves(center: Floats) -> Floats:
    """Compute the edges of adjacent third-octave bands.

    Centers that are rounded put the edge between two neighbors in two places. The lower edge of the
    upper band is taken.

    Parameters
    ----------
    center : (K,) array of float
        Band centers in ascending order, in any unit of frequency.

    Returns
    -------
    (K + 1,) array of float
        Edges in ascending order, in the unit of the centers.
    """
    return np.append(center * BELOW, center[-1] * ABOVE)
