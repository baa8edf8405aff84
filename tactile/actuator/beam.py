"""Exact transition matrix of a passive Timoshenko beam segment at any frequency.

The beam lies along x, deflects by u, and its cross-sections rotate by ψ (u_x = zψ), so that the
curvature is ψ' and the shear angle is u' + ψ. The bending moment is M = EI ψ' and the shear force
is F = AG (u' + ψ). With F' = −ω² m u and M' = F − ω² ρI ψ + N ψ, where N is the axial tension, the
state [u, ψ, M, F] at the end of a segment is a matrix times the state at its start.

The matrix is built from four functions c0…c3 of the two roots z1 = λ1² and z2 = −λ2² of the
characteristic polynomial. These functions are divided differences of entire functions of z, so they
have no singular point, neither at ω = 0 nor where λ1 turns imaginary at √(AG/ρI). Since they are
symmetric in the two roots, they are power series in the sum and the product of the roots. Up to λ =
10 these series are summed without computing the roots or an exponential, which is two to five times
as fast as the closed form and loses no accuracy at λ = 0.

Source: Hofmann & Twiefel 2014 (see `tactile.actuator`), corrected.
"""

from dataclasses import dataclass
from functools import cached_property
from math import factorial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex

Matrix2: TypeAlias = tuple[tuple[Complex, Complex], tuple[Complex, Complex]]
"""A 2 × 2 matrix whose entries are arrays."""
Four: TypeAlias = tuple[Complex, Complex, Complex, Complex]
"""The functions c0, c1, c2 and c3."""

SERIES_BELOW = 100.0
"""Largest |z| for which c0…c3 are computed as power series; beyond it their closed form is used."""
SERIES = np.array([[1 / factorial(2 * k + n) for k in range(40)] for n in (2, 3, 4, 5)])
"""Series coefficients (4, terms) of c2, c3, (1 − c0)/(z1 z2) and (1 − c1)/(z1 z2)."""
SERIES_ERROR = 1e-17
"""Bound on the terms left out of a series, relative to its first term."""


@dataclass(frozen=True)
class CrossSection:
    """Stiffnesses and inertias of a cross-section; the arrays broadcast against each other.

    Parameters
    ----------
    EI : complex array
        Bending stiffness [N m²].
    AG : complex array
        Shear stiffness, shear correction factor included [N].
    m : array of float
        Mass per length [kg/m].
    rhoI : array of float
        Rotary inertia per length [kg m].
    """

    EI: Complex
    AG: Complex
    m: NDArray[np.float64]
    rhoI: NDArray[np.float64]


@dataclass(frozen=True)
class Transition:
    """State transition of a segment from its start (1) to its end (2), in 2 × 2 blocks.

    With w = (u, ψ) and f = (M, F), w2 = ww w1 + wf f1 and f2 = fw w1 + ff f1. Each block is
    computed when it is first used, because not every caller needs all of them: at a clamp, w1 = 0.

    Parameters
    ----------
    section : CrossSection
        Cross-section of the segment.
    length : array of float
        Length of the segment [m].
    inertia : array of float
        Inertia force per length and deflection, m ω² [N/m²].
    turning : array of float
        Moment per length and rotation, ρI ω² − N [N].
    sigma, tau : complex array
        The dimensionless terms σ = m ω² l²/AG and τ = (ρI ω² − N) l²/EI.
    c : tuple of four complex arrays
        The dimensionless functions c0…c3.
    """

    section: CrossSection
    length: NDArray[np.float64]
    inertia: NDArray[np.float64]
    turning: NDArray[np.float64]
    sigma: Complex
    tau: Complex
    c: Four

    @cached_property
    def ww(self) -> Matrix2:
        """Block that maps w1 to w2."""
        (psi, along), (across, u) = self.ff
        return (u, -along), (-across, psi)

    @cached_property
    def wf(self) -> Matrix2:
        """Block that maps f1 to w2."""
        _, c1, c2, c3 = self.c
        L, a = self.length, self.length**2 / self.section.EI
        bend = L / self.section.EI
        slide = L / self.section.AG * (c1 - self.sigma * c3) - a * L * c3
        return (-a * c2, slide), (bend * (c1 - self.tau * c3), a * c2)

    @cached_property
    def fw(self) -> Matrix2:
        """Block that maps w1 to f2."""
        _, c1, c2, c3 = self.c
        L, inertia, turning = self.length, self.inertia, self.turning
        moment = inertia * L**2 * c2
        turn = L * ((inertia * L**2 + self.tau * turning) * c3 - turning * c1)
        return (-moment, turn), (-inertia * L * (c1 - self.sigma * c3), moment)

    @cached_property
    def ff(self) -> Matrix2:
        """Block that maps f1 to f2."""
        c0, c1, c2, c3 = self.c
        L, a = self.length, self.length**2 / self.section.EI
        along = L * (c1 - (self.sigma + self.tau) * c3)
        across = self.inertia * (a * L) * c3
        return (c0 - self.tau * c2, along), (across, c0 - self.sigma * c2)


def characteristic_roots(total: Complex, product: Complex) -> tuple[Complex, Complex]:
    """Compute the roots of the characteristic polynomial.

    Parameters
    ----------
    total : complex array
        Sum of the roots, −(σ + τ).
    product : complex array
        Product of the roots, στ − β⁴.

    Returns
    -------
    z1, z2 : complex array
        The dimensionless roots z1 = λ1² and z2 = −λ2².
    """
    root = np.sqrt(total**2 / 4 - product)
    return total / 2 + root, total / 2 - root


def _closed_form(z1: Complex, z2: Complex) -> Four:
    """Return c0…c3 from hyperbolic and circular functions of λ1 = √z1 and λ2 = √−z2."""
    lambda1, lambda2 = np.sqrt(z1), np.sqrt(-z2)
    growth, turn = np.exp(lambda1), np.exp(1j * lambda2)
    decay, inverse_turn = 1 / growth, 1 / turn
    cosh, cos = (growth + decay) / 2, (turn + inverse_turn) / 2
    sinh = _over_root((growth - decay) / 2, lambda1)
    sin = _over_root((turn - inverse_turn) / 2, 1j * lambda2)
    scale = 1 / (z1 - z2)
    return (
        (z1 * cos - z2 * cosh) * scale,
        (z1 * sin - z2 * sinh) * scale,
        (cosh - cos) * scale,
        (sinh - sin) * scale,
    )


def _over_root(sinh: Any, root: Any) -> Any:
    """Return sinh(√z)/√z from sinh(√z) and √z, by its power series where the root is near zero."""
    z = root * root
    near = np.abs(z) < 1e-3
    series = 1 + z / 6 * (1 + z / 20 * (1 + z / 42))
    return np.where(near, series, sinh / np.where(near, 1, root))


def _series(total: Complex, product: Complex, reach: float) -> Four:
    """Return c0…c3 from their power series, for roots no larger than ``reach`` in magnitude.

    Each function is Σ aₖ hₖ with hₖ = Σ z1^i z2^(k−i), the divided difference of z^(k+1), for which
    |hₖ| ≤ (k+1) reach^k.
    """
    k = np.arange(SERIES.shape[1])
    left_out = (k + 1) * reach**k * SERIES[0] / SERIES[0, 0] < SERIES_ERROR
    terms = max(2, int(np.argmax(left_out)))
    h = np.empty((terms, *total.shape), np.complex128)
    h[0], h[1] = 1, total
    for n in range(2, terms):
        np.subtract(total * h[n - 1], product * h[n - 2], out=h[n, ...])
    sums = SERIES[:, :terms] @ h.reshape(terms, -1).view(np.float64)
    c2, c3, c0, c1 = sums.view(np.complex128).reshape(4, *total.shape)
    return 1 - product * c0, 1 - product * c1, c2, c3


def c_functions(total: Complex, product: Complex) -> Four:
    """Compute c0…c3 from the sum and the product of the two roots, accurate down to ω = 0.

    Parameters
    ----------
    total : complex array
        Sum of the roots, z1 + z2.
    product : complex array
        Product of the roots, z1 z2, of the same shape.

    Returns
    -------
    tuple of four complex arrays
        The dimensionless functions c0, c1, c2 and c3.
    """
    reach = np.abs(total) + np.sqrt(np.abs(product))
    longest = float(reach.max(initial=0.0))
    if longest <= SERIES_BELOW:
        return _series(total, product, longest)
    c = np.empty((4, *total.shape), np.complex128)
    near = reach <= SERIES_BELOW
    c[:, near] = _series(total[near], product[near], SERIES_BELOW)
    c[:, ~near] = _closed_form(*characteristic_roots(total[~near], product[~near]))
    return c[0], c[1], c[2], c[3]


def transition(
    section: CrossSection,
    length: NDArray[np.float64],
    omega: NDArray[np.float64],
    axial_force: NDArray[np.float64],
) -> Transition:
    """Compute the exact state transition of a segment.

    Parameters
    ----------
    section : CrossSection
        Cross-section, whose arrays broadcast against ``omega``.
    length : array of float
        Length of the segment [m].
    omega : array of float
        Angular frequency [rad/s]; zero is allowed.
    axial_force : array of float
        Axial tension N [N]; a finger that presses on the tip makes it negative.

    Returns
    -------
    Transition
        Blocks of the transition matrix.

    Notes
    -----
    The entries grow as exp(λ1), where λ1 = 14 for the default section 20 mm long at 60 kHz. Sums of
    products of entries, such as a determinant, lose accuracy in proportion. `response` therefore
    cuts long segments into pieces.
    """
    a = length**2 / section.EI
    inertia = section.m * omega**2
    turning = section.rhoI * omega**2 - axial_force
    beta4, sigma, tau = inertia * (length**2 * a), inertia * (length**2 / section.AG), turning * a
    c = c_functions(-1 * (sigma + tau), sigma * tau - beta4)
    return Transition(section, length, inertia, turning, sigma, tau, c)
