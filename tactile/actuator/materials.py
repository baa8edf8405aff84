"""Materials of a bimorph: the piezoelectric layers and the shim between them.

The constants follow IEEE Std 176 (s11E, s55E, d31, eps33T). Every number may be an array that
broadcasts against the others, so that one call describes many designs. Losses are constant with
frequency and enter as factors on the complex constants at exp(+jωt): 1/s11 (1 + j/Q), ε (1 − j
tanδ) and d (1 − j tanθ).

`PIEZOS` and `SHIMS` hold the materials by name; `material_notes` gives the sources of the numbers
and the field that a ceramic withstands. All are typical values: manufacturers specify d31 and
permittivity to ±10 … 20 %.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = float | NDArray[np.float64]
"""A number, or an array of numbers over designs."""

VACUUM_PERMITTIVITY = 8.8541878128e-12
"""Vacuum permittivity ε0, CODATA 2018 [F/m]."""


LARGEST_FIELD = 0.4e6
"""Largest field allowed in a piezo layer: half the coercive field of a soft PZT, which is about 8
kV/cm [V/m]."""
LARGEST_STRESS = 27.6e6
"""Largest tensile stress allowed in a piezo layer that swings: 4000 psi, the dynamic strength of
PZT-5A that is quoted from Berlincourt, Krueger & Near (Morgan TP-226), which could not be checked;
assumed for all ceramics [Pa]."""


def require_positive(owner: str, **values: Real) -> None:
    """Check that values are finite and positive.

    Parameters
    ----------
    owner : str
        Name of the class or function that is checked, for the message.
    **values : float or array of float
        Values by name.

    Raises
    ------
    ValueError
        If a value is not finite or not above zero.
    """
    for name, value in values.items():
        if not np.all(np.isfinite(value) & (np.asarray(value) > 0)):
            raise ValueError(f"{owner}: {name} = {value} is not a finite number above 0")


def require_not_negative(owner: str, **values: Real) -> None:
    """Check that values are finite and not negative.

    Parameters
    ----------
    owner : str
        Name of the class or function that is checked, for the message.
    **values : float or array of float
        Values by name.

    Raises
    ------
    ValueError
        If a value is not finite or is below zero.
    """
    for name, value in values.items():
        if not np.all(np.isfinite(value) & (np.asarray(value) >= 0)):
            raise ValueError(f"{owner}: {name} = {value} is not a finite number from 0 up")


def require_quality(owner: str, quality_factor: Real) -> None:
    """Check that a quality factor is positive; it may be infinite.

    Parameters
    ----------
    owner : str
        Name of the class that is checked, for the message.
    quality_factor : float or array of float
        Quality factor.

    Raises
    ------
    ValueError
        If a quality factor is not above zero.
    """
    if not np.all(np.asarray(quality_factor) > 0):
        raise ValueError(f"{owner}: quality_factor = {quality_factor} is not a number above 0")


@dataclass(frozen=True, kw_only=True)
class PiezoMaterial:
    """A piezoceramic, poled across its thickness and driven in the 31 mode.

    Parameters
    ----------
    s11E, s55E : float or array of float
        Compliance along the bender and in thickness shear, at constant electric field [m²/N].
    d31 : float or array of float
        Piezoelectric charge constant, negative for the usual ceramics [m/V].
    eps33T : float or array of float
        Permittivity at constant stress [F/m].
    density : float or array of float
        Density [kg/m³].
    quality_factor : float or array of float
        Mechanical Q of both compliances; may be infinite.
    loss_tangent : float or array of float
        Dielectric loss tangent tanδ of eps33T.
    piezo_loss_tangent : float or array of float
        Piezoelectric loss tangent tanθ of d31.

    Raises
    ------
    ValueError
        If a constant is not finite or has the wrong sign, or if k31² is not below 1.
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
        """Square of the electromechanical coupling factor, k31² = d31²/(s11E eps33T)."""
        return np.asarray(self.d31) ** 2 / (np.asarray(self.s11E) * self.eps33T)


@dataclass(frozen=True, kw_only=True)
class ShimMaterial:
    """The passive layer between the piezo layers.

    Parameters
    ----------
    s11, s55 : float or array of float
        Compliance along the bender and in thickness shear [m²/N].
    density : float or array of float
        Density [kg/m³].
    quality_factor : float or array of float
        Mechanical Q of both compliances; may be infinite.

    Raises
    ------
    ValueError
        If a constant is not positive, or is not finite where it must be.
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


def _ceramic(
    *,
    s11E: float,
    s55E: float,
    d31: float,
    permittivity: float,
    density: float,
    quality_factor: float,
    loss_tangent: float = 0.02,
    piezo_loss_tangent: float = 0.01,
) -> PiezoMaterial:
    """Return a ceramic, by default a soft one, by its permittivity relative to the vacuum's."""
    return PiezoMaterial(
        s11E=s11E, s55E=s55E, d31=d31, eps33T=permittivity * VACUUM_PERMITTIVITY, density=density,
        quality_factor=quality_factor, loss_tangent=loss_tangent,
        piezo_loss_tangent=piezo_loss_tangent,
    )  # fmt: skip


PIEZO_3203HD = _ceramic(
    s11E=16.2e-12, s55E=44e-12, d31=-320e-12, permittivity=3800, density=7870.0,
    quality_factor=60.0,
)  # fmt: skip
"""Surrogate of VIBRIT 1100: d31, eps33T, density, s11E (Y11E 62 GPa) and tanδ from the CTS 3203HD
data sheet; s55E as of PZT-5H; quality factor and tanθ assumed."""
PIEZOS = {
    "3203hd": PIEZO_3203HD,
    "5a4e": _ceramic(
        s11E=15.1e-12, s55E=40.0e-12, d31=-190e-12, permittivity=1800, density=7800.0,
        quality_factor=80.0,
    ),
    "apc-855": _ceramic(
        s11E=1 / 59e9, s55E=43.5e-12, d31=-276e-12, permittivity=3300, density=7600.0,
        quality_factor=65.0, loss_tangent=0.025,
    ),
    "pic-255": _ceramic(
        s11E=16.1e-12, s55E=1 / 21e9, d31=-180e-12, permittivity=1750, density=7800.0,
        quality_factor=80.0,
    ),
    "pzt-4": _ceramic(
        s11E=12.3e-12, s55E=39.0e-12, d31=-123e-12, permittivity=1300, density=7500.0,
        quality_factor=500.0, loss_tangent=0.004, piezo_loss_tangent=0.002,
    ),
    "pzt-5a": _ceramic(
        s11E=16.4e-12, s55E=47.5e-12, d31=-171e-12, permittivity=1700, density=7750.0,
        quality_factor=75.0,
    ),
    "pzt-5h": _ceramic(
        s11E=16.5e-12, s55E=43.5e-12, d31=-274e-12, permittivity=3400, density=7500.0,
        quality_factor=65.0,
    ),
    "pzt-8": _ceramic(
        s11E=11.5e-12, s55E=31.9e-12, d31=-97e-12, permittivity=1000, density=7600.0,
        quality_factor=1000.0, loss_tangent=0.004, piezo_loss_tangent=0.002,
    ),
}  # fmt: skip
"""Piezoceramics by name; `MATERIAL_NOTES` has their sources. tanθ is assumed throughout: 0.01 for
soft ceramics and 0.002 for hard ones. VIBRIT 1100 is not included, because no full set of its
constants is published; 3203hd stands in for it."""
CFRP = ShimMaterial(s11=1 / 110e9, s55=1 / 4.5e9, density=1550.0, quality_factor=30.0)
"""Carbon-fiber reinforced plastic: E 110 GPa, G 4.5 GPa, 1550 kg/m³, Q 30; assumed typical values.
"""


def _isotropic(
    *, modulus: float, poisson: float, density: float, quality_factor: float
) -> ShimMaterial:
    """Return a shim of Young's modulus E [Pa] and Poisson's ratio ν, with G = E/(2 (1 + ν))."""
    return ShimMaterial(
        s11=1 / modulus,
        s55=2 * (1 + poisson) / modulus,
        density=density,
        quality_factor=quality_factor,
    )


SHIMS = {
    "alumina": _isotropic(modulus=303e9, poisson=0.21, density=3720.0, quality_factor=200.0),
    "brass": _isotropic(modulus=110e9, poisson=0.375, density=8530.0, quality_factor=100.0),
    "cfrp": CFRP,
    "fr4": ShimMaterial(s11=1 / 24e9, s55=1 / 3e9, density=1850.0, quality_factor=30.0),
    "steel": _isotropic(modulus=193e9, poisson=0.29, density=8000.0, quality_factor=200.0),
    "titanium": _isotropic(modulus=113.8e9, poisson=0.342, density=4430.0, quality_factor=200.0),
}
"""Shims by name; `MATERIAL_NOTES` has their sources. Quality factors are assumed throughout: they
are those of the glued layer, far below that of the metal alone."""
