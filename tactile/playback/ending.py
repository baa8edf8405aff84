"""Fade of what a player has put out last, when that ends early."""

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Singles

ENDING = 5e-3
"""Time in which a wave that is replaced or ends early falls to 0 [s]."""


class Ending:
    """Fade to 0 from the last sample of a player.

    Parameters
    ----------
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    def __init__(self, drive_rate: float, contactors: int) -> None:
        self._ramp = np.linspace(1, 0, int(ENDING * drive_rate) + 1, dtype=np.float32)[1:, None]
        self._rest = np.zeros((0, contactors), np.float32)
        self._last: Singles | None = None

    @property
    def sounds(self) -> bool:
        """Whether a fade has samples that are still to come."""
        return len(self._rest) > 0

    def begin(self, contactors: slice | NDArray[np.intp] = slice(None)) -> None:
        """Begin to fade, if anything was put out in the block before.

        Parameters
        ----------
        contactors : slice or (K,) array of int
            Contactors whose waves end; by default all.
        """
        if self._last is not None:
            rest = np.zeros((len(self._ramp), len(self._last)), np.float32)
            rest[: len(self._rest)] = self._rest
            rest[:, contactors] = self._last[contactors] * self._ramp
            self._rest = rest

    def add_to(self, shear: Singles) -> None:
        """Add the next samples to what the player puts out, and remember the last of them.

        Parameters
        ----------
        shear : (S, N) array of float32
            Shear of the player [m].
        """
        rest = self._rest[: len(shear)]
        shear[: len(rest)] += rest
        self._rest, self._last = self._rest[len(shear) :], shear[-1]

    def skip(self, count: int) -> None:
        """Advance in silence, from which nothing fades.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        self._rest, self._last = self._rest[count:], None
