"""Materials of a bimorph: the piezoelectric layers and the shim between them.

Constants follow IEEE Std 176 (s11E, s55E, d31, eps33T). Every number may be an array that
broadcasts against the others: one call then describes many designs. Losses are constant with
frequency, as factors on the complex constants at exp(+jωt):
1/s11 (1 + j/Q), ε (1 − j tanδ), d (1 − j tanθ).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = float | NDArray[np.float64]
"""A number, or an array of numbers over designs."""

VACUUM_PERMITTIVITY = 8.8541878128e-12
"""ε0 [F/m], CODATA 2018."""


def require_positive(owner: str, **values: Real) -> None:
    """Raise ValueError where a value is not finite and positive."""
    for name, value in values.items():
        if not np.all(np.isfinite(value) & (np.asarray(value) > 0)):
            raise ValueError(f"{owner}: {name} = {value} is not a finite number above 0")


def require_not_negative(owner: str, **values: Real) -> None:
    """Raise ValueError where a value is not finite or is below zero."""
    for name, value in values.items():
        if not np.all(np.isfinite(value) & (np.asarray(value) >= 0)):
            raise ValueError(f"{owner}: {name} = {value} is not a finite number from 0 up")


def require_quality(owner: str, quality_factor: Real) -> None:
    """Raise ValueError where a quality factor is not above zero; it may be infinite."""
    if not np.all(np.asarray(quality_factor) > 0):
        raise ValueError(f"{owner}: quality_factor = {quality_factor} is not a number above 0")


@dataclass(frozen=True, kw_only=True)
class PiezoMaterial:
    """A piezoceramic, poled across its thickness and driven in the 31 mode.

    Parameters
    ----------
    s11E, s55E : compliance along the bender and in thickness shear, field constant [m²/N]
    d31 : piezoelectric charge constant [m/V], negative for the usual ceramics
    eps33T : permittivity at constant stress [F/m]
    density : [kg/m³]
    quality_factor : mechanical Q of both compliances; may be infinite
    loss_tangent, piezo_loss_tangent : tanδ of eps33T and tanθ of d31

    Raises
    ------
    ValueError
        Naming the constant that is not finite or has the wrong sign.
    """

    s11E: Real
    s55E: Real
    d31: Real
    eps33T: Real
    density: Real
    quality_factor: Real
    loss_tangent: Real
    piezo_loss_tangent: Real

    def __post_init__(self) -> None:
        require_positive(
            "PiezoMaterial",
            s11E=self.s11E,
            s55E=self.s55E,
            eps33T=self.eps33T,
            density=self.density,
        )
        require_quality("PiezoMaterial", self.quality_factor)
        require_not_negative(
            "PiezoMaterial",
            loss_tangent=self.loss_tangent,
            piezo_loss_tangent=self.piezo_loss_tangent,
        )
        if not np.all(self.coupling_squared < 1):
            raise ValueError("PiezoMaterial: k31² = d31²/(s11E eps33T) must be a number below 1")

    @property
    def coupling_squared(self) -> NDArray[np.float64]:
        """k31² = d31²/(s11E eps33T), the electromechanical coupling."""
        return np.asarray(self.d31) ** 2 / (np.asarray(self.s11E) * self.eps33T)


@dataclass(frozen=True, kw_only=True)
class ShimMaterial:
    """The passive layer between the piezo layers.

    Parameters
    ----------
    s11, s55 : compliance along the bender and in thickness shear [m²/N]
    density : [kg/m³]
    quality_factor : mechanical Q of both compliances; may be infinite

    Raises
    ------
    ValueError
        Naming the constant that is not finite and positive.
    """

    s11: Real
    s55: Real
    density: Real
    quality_factor: Real

    def __post_init__(self) -> None:
        require_positive(
            "ShimMaterial",
            s11=self.s11,
            s55=self.s55,
            density=self.density,
        )
        require_quality("ShimMaterial", self.quality_factor)


PIEZO_3203HD = PiezoMaterial(
    s11E=16.2e-12,
    s55E=44e-12,
    d31=-320e-12,
    eps33T=3800 * VACUUM_PERMITTIVITY,
    density=7870.0,
    quality_factor=60.0,
    loss_tangent=0.02,
    piezo_loss_tangent=0.01,
)
"""Surrogate of VIBRIT 1100: d31, eps33T, density, s11E (Y11E 62 GPa) and tanδ from the CTS 3203HD
data sheet; s55E like PZT-5H; quality factor and tanθ assumed."""

CFRP = ShimMaterial(s11=1 / 110e9, s55=1 / 4.5e9, density=1550.0, quality_factor=30.0)
"""Carbon-fiber reinforced plastic: E 110 GPa, G 4.5 GPa, 1550 kg/m³, Q 30; assumed, typical."""
