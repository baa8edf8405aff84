"""The finger pad as the bimorph's tip feels it: a generalized Maxwell load.

Z_L = k0/(jω) + d0 + Σ k_i d_i/(k_i + jω d_i), the mechanical impedance [N s/m] against shear; the
same form serves a rotational load [N m s]. The finger pushes back: F = −Z_L v at the tip.
Source: Hofmann & Twiefel 2014 (see `tactile.actuator`); with that paper's printed sign of the
load the response is wrong by up to 13 dB.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tactile.actuator.materials import Real, require_not_negative
from tactile.arrays import Complex


@dataclass(frozen=True, kw_only=True)
class FingerLoad:
    """A generalized Maxwell load; any number may be an array over designs.

    Parameters
    ----------
    k0 : parallel stiffness [N/m] (rotational: [N m])
    d0 : parallel damping [N s/m]
    branches : (k, d) of each Maxwell branch, a spring in series with a damper

    Raises
    ------
    ValueError
        Naming the constant that is not finite or is negative.
    """

    k0: Real
    d0: Real
    branches: tuple[tuple[Real, Real], ...] = ()

    def __post_init__(self) -> None:
        require_not_negative("FingerLoad", k0=self.k0, d0=self.d0)
        for i, (k, d) in enumerate(self.branches, 1):
            require_not_negative("FingerLoad", **{f"branch {i} k": k, f"branch {i} d": d})

    @classmethod
    def low(cls) -> "FingerLoad":
        """Return the paper's lightly loading finger."""
        return cls(k0=1000.0, d0=0.11, branches=((1300.0, 0.33),))

    @classmethod
    def high(cls) -> "FingerLoad":
        """Return the paper's heavily loading finger."""
        return cls(k0=4300.0, d0=0.55, branches=((5000.0, 2.0),))

    @classmethod
    def none(cls) -> "FingerLoad":
        """Return no load: the tip in air."""
        return cls(k0=0.0, d0=0.0)

    def stiffness(self, frequency: ArrayLike) -> Complex:
        """Return the dynamic stiffness jωZ_L.

        Parameters
        ----------
        frequency : (F,) [Hz], from 0 up

        Returns
        -------
        (..., F) complex ndarray
            k0 + jω d0 + Σ jω k d/(k + jω d) [N/m], finite at zero frequency.
        """
        rate = 2j * np.pi * np.asarray(frequency, np.float64)
        total = np.asarray(self.k0)[..., None] + rate * np.asarray(self.d0)[..., None]
        for k, d in self.branches:
            if np.any(k) and np.any(d):
                spring, damper = np.asarray(k)[..., None], rate * np.asarray(d)[..., None]
                total = total + spring * damper / (np.where(spring > 0, spring, 1) + damper)
        return np.asarray(total, np.complex128)

    def impedance(self, frequency: ArrayLike) -> Complex:
        """Return the mechanical impedance Z_L (..., F) [N s/m] at ``frequency`` (F,) [Hz] > 0."""
        return self.stiffness(frequency) / (2j * np.pi * np.asarray(frequency, np.float64))


@dataclass(frozen=True, kw_only=True)
class FingerTable:
    """A load that depends on how hard the finger presses.

    Parameters
    ----------
    normal_force : ascending, above zero [N]
    loads : one `FingerLoad` for each force, with equal numbers of branches

    Raises
    ------
    ValueError
        Where forces do not ascend, or loads differ in number or in branches.
    """

    normal_force: tuple[float, ...]
    loads: tuple[FingerLoad, ...]

    def __post_init__(self) -> None:
        force = np.asarray(self.normal_force)
        if not (
            force.size
            and np.all(np.isfinite(force))
            and force[0] > 0
            and np.all(np.diff(force) > 0)
        ):
            raise ValueError(
                f"FingerTable: normal_force {self.normal_force} N does not ascend from above 0"
            )
        if len(self.loads) != force.size:
            raise ValueError(f"FingerTable: {force.size} forces but {len(self.loads)} loads")
        if len({len(load.branches) for load in self.loads}) != 1:
            raise ValueError("FingerTable: the loads differ in their number of branches")

    def at(self, normal_force: Real) -> FingerLoad:
        """Return the load at a normal force [N], interpolated; held beyond the table's ends.

        Each constant runs straight between the table's forces (assumed).
        """

        def along(values: list[Real]) -> Real:
            return np.interp(normal_force, self.normal_force, np.asarray(values, np.float64))

        return FingerLoad(
            k0=along([load.k0 for load in self.loads]),
            d0=along([load.d0 for load in self.loads]),
            branches=tuple(
                (
                    along([load.branches[i][0] for load in self.loads]),
                    along([load.branches[i][1] for load in self.loads]),
                )
                for i in range(len(self.loads[0].branches))
            ),
        )
