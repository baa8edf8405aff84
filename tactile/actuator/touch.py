"""A finger that touches: its load, and the course of its normal force.

How the load depends on the force is a property of skin that no source here measures. A
`FingerTable` tells it; the constants of a `FingerLoad` are those at 1 N and grow with force^0.5
(assumed), as the contact area grows with a power of the force. Without force there is no finger.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.materials import Real
from tactile.arrays import Floats

EXPONENT = 0.5
"""Exponent of the normal force in the constants of a load (assumed)."""
TRANSITION = 5e-3
"""Time in which the force goes to zero at a lift-off, and comes back at a touch [s] (assumed)."""


@dataclass(frozen=True, kw_only=True)
class NormalForce:
    """Course of a normal force: it swings, and the finger may lift off and touch again.

    Parameters
    ----------
    low, high : float
        Ends of the swing [N]; a steady force has both alike.
    period : float
        Period of the swing, a raised cosine that begins at ``low`` [s].
    liftoff : float
        Time at which the finger begins to lift off [s]; infinite for never.
    retouch : float
        Time at which it begins to touch again [s]; infinite for never.

    Raises
    ------
    ValueError
        If a force is negative or not finite, the period is not above zero, or the finger is to
        touch again before it has lifted off.

    Examples
    --------
    >>> import numpy as np
    >>> from tactile.actuator.touch import NormalForce
    >>> force = NormalForce(low=0.2, high=2.0, period=1.5, liftoff=2.0)
    >>> force(np.array([0.0, 0.75, 1.5, 3.0])).round(3).tolist()
    [0.2, 2.0, 0.2, 0.0]
    """

    low: float = 1.0
    high: float = 1.0
    period: float = 1.5
    liftoff: float = np.inf
    retouch: float = np.inf

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high < np.inf:
            raise ValueError(f"NormalForce: {self.low} … {self.high} N does not ascend from 0 N")
        if not 0 < self.period < np.inf:
            raise ValueError(f"NormalForce: period = {self.period} s is not above 0 s")
        if not self.liftoff + TRANSITION <= self.retouch:
            raise ValueError(
                f"NormalForce: retouch = {self.retouch} s is not {TRANSITION:g} s after "
                f"liftoff = {self.liftoff} s"
            )

    def __call__(self, time: Floats) -> Floats:
        """Return the force at times.

        Parameters
        ----------
        time : (S,) array of float
            Times [s].

        Returns
        -------
        (S,) array of float
            Normal force [N].
        """
        swing = self.low + (self.high - self.low) * (1 - np.cos(2 * np.pi * time / self.period)) / 2
        lifted = np.clip((time - self.liftoff) / TRANSITION, 0, 1)
        returned = np.clip((time - self.retouch) / TRANSITION, 0, 1)
        return np.asarray(swing * (1 - lifted + returned))


@dataclass(frozen=True, kw_only=True)
class Touch:
    """A finger and the course of its force.

    Parameters
    ----------
    load : FingerLoad or FingerTable
        Load over force; the constants of a `FingerLoad` are those at 1 N, and may be arrays (N,)
        over contactors.
    force : callable
        Function from times (S,) [s] to normal forces (S,), or (S, N) of each contactor [N].
    """

    load: FingerLoad | FingerTable
    force: Callable[[Floats], Floats] = NormalForce()

    def load_at(self, normal_force: Real) -> FingerLoad:
        """Return the load at a normal force.

        Parameters
        ----------
        normal_force : float or (N,) array of float
            Normal force, zero for a finger that does not touch [N].

        Returns
        -------
        FingerLoad
            Load at that force.
        """
        force = np.asarray(normal_force, np.float64)
        if isinstance(self.load, FingerTable):
            load, factor = self.load.at(force), np.where(force > 0, 1.0, 0.0)
        else:
            load, factor = self.load, force**EXPONENT
        return FingerLoad(
            k0=load.k0 * factor,
            d0=load.d0 * factor,
            branches=tuple((k * factor, d * factor) for k, d in load.branches),
        )
