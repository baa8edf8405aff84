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
ROUNDED = np.array([1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8])
"""Nominal centers of the bands of a decade (IEC 61260-1)."""


def nominal_centers(center: Floats) -> Floats:
    """Compute the rounded frequencies by which third-octave bands are named.

    Parameters
    ----------
    center : (K,) array of float
        Band centers, powers of 10^0.1.

    Returns
    -------
    (K,) array of float
        Nominal centers, such as 250 for 251.19.
    """
    decade, band = np.divmod(np.rint(10 * np.log10(center)).astype(int), 10)
    return np.asarray(10.0**decade * ROUNDED[band])


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
