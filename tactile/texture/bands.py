"""Third octaves of base ten (IEC 61260-1): each reaches from 10^−0.05 to 10^0.05 of its center.

Every spectrum of the project is in such bands, over cycles per meter of a surface as over hertz at
the skin.
"""

import numpy as np

from tactile.arrays import Floats

BELOW, ABOVE = 10**-0.05, 10**0.05
"""Of a band's center, its edges."""
RELATIVE_WIDTH = ABOVE - BELOW
"""Of a band's center, its width."""


def third_octaves(center: Floats) -> Floats:
    """Return the K + 1 edges of the bands around K ascending centers, in the centers' unit.

    Where centers are rounded, neighbors would meet in two places; the upper one's edge is taken.
    """
    return np.append(center * BELOW, center[-1] * ABOVE)
