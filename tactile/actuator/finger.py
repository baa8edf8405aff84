"""Mechanical load of the finger pad on the tip of the bimorph: a generalized Maxwell model.

The mechanical impedance against shear is Z_L = k0/(jω) + d0 + Σ k_i d_i/(k_i + jω d_i) [N s/m]. The
same form serves as a rotational load [N m s]. The finger pushes back: the force on the tip is F =
−Z_L v.

Source: Hofmann & Twiefel 2014 (see `tactile.actuator`). With the sign of the load as that paper
prints it, the response is wrong by up to 13 dB.
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
    k0 : float or array of float
        Parallel stiffness [N/m]; of a rotational load [N m].
    d0 : float or array of float
        Parallel damping [N s/m]; of a rotational load [N m s].
    branches : tuple of (float or array of float, float or array of float)
        Stiffness and damping of each Maxwell branch, a spring in series with a damper.

    Raises
    ------
    ValueError
        If a constant is negative or not finite.

    Examples
    --------
    A spring beside a damper, whose part of the stiffness is 2π · 100 Hz · 0.1 N s/m:

    >>> import tactile
    >>> load = tactile.FingerLoad(k0=1000.0, d0=0.1)
    >>> load.stiffness([0.0, 100.0]).round(1).tolist()
    [(1000+0j), (1000+62.8j)]
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
        """Return the lightly loading finger of Hofmann & Twiefel 2014.

        Returns
        -------
        FingerLoad
            Load with k0 = 1000 N/m, d0 = 0.11 N s/m and one branch.

        Examples
        --------
        >>> import tactile
        >>> finger = tactile.FingerLoad.low()
        >>> finger.stiffness([0.0, 250.0]).real.round().tolist()
        [1000.0, 1178.0]
        """
        return cls(k0=1000.0, d0=0.11, branches=((1300.0, 0.33),))

    @classmethod
    def high(cls) -> "FingerLoad":
        """Return the heavily loading finger of Hofmann & Twiefel 2014.

        Returns
        -------
        FingerLoad
            Load with k0 = 4300 N/m, d0 = 0.55 N s/m and one branch.
        """
        return cls(k0=4300.0, d0=0.55, branches=((5000.0, 2.0),))

    @classmethod
    def mid(cls) -> "FingerLoad":
        """Return a finger between both of the paper: the geometric mean of each constant (assumed).

        Returns
        -------
        FingerLoad
            Load with k0 = 2074 N/m, d0 = 0.246 N s/m and one branch.
        """
        low, high = cls.low(), cls.high()
        (low_branch,), (high_branch,) = low.branches, high.branches
        return cls(
            k0=np.sqrt(low.k0 * high.k0),
            d0=np.sqrt(low.d0 * high.d0),
            branches=(
                (
                    np.sqrt(low_branch[0] * high_branch[0]),
                    np.sqrt(low_branch[1] * high_branch[1]),
                ),
            ),
        )

    @classmethod
    def none(cls) -> "FingerLoad":
        """Return the load of a tip that moves in air.

        Returns
        -------
        FingerLoad
            Load without stiffness or damping.
        """
        return cls(k0=0.0, d0=0.0)

    def stiffness(self, frequency: ArrayLike) -> Complex:
        """Compute the dynamic stiffness jωZ_L.

        Parameters
        ----------
        frequency : (F,) array_like of float
            Frequencies, zero allowed [Hz].

        Returns
        -------
        (..., F) complex array
            k0 + jω d0 + Σ jω k d/(k + jω d), finite at zero frequency [N/m].
        """
        rate = 2j * np.pi * np.asarray(frequency, np.float64)
        total = np.asarray(self.k0)[..., None] + rate * np.asarray(self.d0)[..., None]
        for k, d in self.branches:
            if np.any(k) and np.any(d):
                spring, damper = np.asarray(k)[..., None], rate * np.asarray(d)[..., None]
                total = total + spring * damper / (np.where(spring > 0, spring, 1) + damper)
        return np.asarray(total, np.complex128)

    def impedance(self, frequency: ArrayLike) -> Complex:
        """Compute the mechanical impedance Z_L.

        Parameters
        ----------
        frequency : (F,) array_like of float
            Frequencies, above zero [Hz].

        Returns
        -------
        (..., F) complex array
            Mechanical impedance [N s/m].
        """
        return self.stiffness(frequency) / (2j * np.pi * np.asarray(frequency, np.float64))


@dataclass(frozen=True, kw_only=True)
class FingerTable:
    """A load that depends on the normal force of the finger.

    Parameters
    ----------
    normal_force : tuple of float
        Normal forces, above zero and ascending [N].
    loads : tuple of FingerLoad
        Load at each normal force; all have the same number of branches.

    Raises
    ------
    ValueError
        If the forces do not ascend from above zero, or if the loads differ from them in number or
        from each other in their number of branches.

    Examples
    --------
    >>> import tactile
    >>> loads = tactile.FingerLoad.low(), tactile.FingerLoad.high()
    >>> table = tactile.FingerTable(normal_force=(0.2, 1.0), loads=loads)
    >>> [round(float(table.at(force).k0)) for force in (0.2, 0.6, 1.0, 5.0)]
    [1000, 2650, 4300, 4300]
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
        """Interpolate the load at a normal force.

        Each constant is interpolated linearly between the tabulated forces (assumed), and held
        constant beyond the ends of the table.

        Parameters
        ----------
        normal_force : float or array of float
            Normal force [N].

        Returns
        -------
        FingerLoad
            Load at that force.
        """

        def along(values: list[Real]) -> Real:
            """Interpolate a constant."""
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
