"""Loads of a finger that is followed, for whoever displays them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats


@dataclass(frozen=True, eq=False)
class FollowedFinger:
    """Loads of N contactors, as playback reports them to the server.

    Attributes
    ----------
    touching : (N,) array of bool
        Whether a finger is on the contactor.
    stiffness : (N,) array of float
        Magnitude of the dynamic stiffness of the load at 100 Hz; 0 in air [N/m].
    deviation : (N,) array of float
        Standard deviation of the level of the played shear that follows from that of the load; 0 in
        air [dB].
    explained : (N,) array of bool
        Whether the load explains the current. Where it does not, filters for the mean of the
        population play.
    guarded : (N,) array of bool
        Whether a guard in an amplifier has turned the contactor down, since it lost the finger.
    """

    touching: NDArray[np.bool_]
    stiffness: Floats
    deviation: Floats
    explained: NDArray[np.bool_]
    guarded: NDArray[np.bool_]
