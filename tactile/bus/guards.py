"""Guards of amplifiers, as a host sets them and as they report that they have tripped.

An amplifier with guards compares each current with what the host expects under the present finger,
and turns a channel down at once where they part (SPEC.md, 17). `GuardSettings` are what it is to
expect, in SI units; a bus converts them to the codes of its amplifiers. `GuardReport` is what an
amplifier reports.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats


@dataclass(frozen=True, eq=False)
class GuardSettings:
    """What the guards of K channels are to expect.

    Attributes
    ----------
    channels : (K,) array of int
        Channels of the display, in ascending order.
    armed : (K,) array of bool
        Whether the guard of each channel may trip.
    release : (K,) array of bool
        Whether a channel that has tripped is to come back.
    poles : (K, 2) array of float
        Coefficients of earlier currents.
    drive : (K, 13) array of float
        Coefficients of the expected current, for the steps of the drive [A/V].
    change : (K, 13) array of float
        Coefficients of the change of the current that a lost finger makes [A/V].
    limit : (K,) array of float
        Largest rms of the residual while the current is small [A].
    share : float
        Square of the largest ratio of the residual to the current, below 1.
    floor : (K,) array of float
        Least sum of residual times change that counts as a lost contact [A²].
    """

    channels: NDArray[np.intp]
    armed: NDArray[np.bool_]
    release: NDArray[np.bool_]
    poles: Floats
    drive: Floats
    change: Floats
    limit: Floats
    share: float
    floor: Floats


@dataclass(frozen=True, eq=False)
class GuardReport:
    """Guards of one amplifier that have tripped.

    Attributes
    ----------
    position : int
        Position from which on gains change, on the scale that `Bus.start` begins.
    first_channel : int
        Channel of the display to which the first of the C channels of the amplifier belongs.
    tripped : (C,) array of bool
        Whether each channel is turned down.
    """

    position: int
    first_channel: int
    tripped: NDArray[np.bool_]
