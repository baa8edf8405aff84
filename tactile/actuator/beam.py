"""A passive Timoshenko beam segment, exactly, at any frequency.

The beam lies along x, deflects by u and its cross-sections rotate by ψ (u_x = zψ), so that the
curvature is ψ' and the shear angle u' + ψ. With bending moment M = EI ψ', shear force
F = AG (u' + ψ), F' = −ω² m u and M' = F − ω² ρI ψ + N ψ (N the axial tension) the state
[u, ψ, M, F] at the end of a segment is a matrix times that at its start.

The matrix is built from four functions c0…c3 of the two roots z1 = λ1², z2 = −λ2² of the
characteristic polynomial; they are divided differences of entire functions of z, so they have
no singular point, neither at ω = 0 nor where λ1 turns imaginary at √(AG/ρI).
Source: Hofmann & Twiefel 2014 (see `tactile.actuator`), corrected.
"""

from dataclasses import dataclass
from math import factorial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Complex: TypeAlias = NDArray[np.complex128]
Matrix2: TypeAlias = tuple[tuple[Complex, Complex], tuple[Complex, Complex]]
"""A 2 × 2 matrix whose entries are arrays."""

SERIES_BELOW = 0.25
"""Below this |λ²| the power series of c0…c3 is used: eight terms leave 1e-17."""
SERIES_TERMS = 8


@dataclass(frozen=True)
class Section:
    """What a cross-section resists and weighs; entries broadcast.

    Parameters
    ----------
    EI : bending stiffness [N m²], complex
    AG : shear stiffness, shear factor included [N], complex
    m : mass per length [kg/m]
    rhoI : rotary inertia per length [kg m]
    """

    EI: Complex
    AG: Complex
    m: NDArray[np.float64]
    rhoI: NDArray[np.float64]


@dataclass(frozen=True)
class Transition:
    """State at the end of a segment from that at its start, in 2 × 2 blocks.

    With w = (u, ψ) and f = (M, F): w2 = ww w1 + wf f1 and f2 = fw w1 + ff f1.
    """

    ww: Matrix2
    wf: Matrix2
    fw: Matrix2
    ff: Matrix2


def characteristic_roots(sigma: Complex, tau: Complex, beta4: Complex) -> tuple[Complex, Complex]:
    """Return z1 = λ1² and z2 = −λ2²: ∓(σ+τ)/2 + √(β⁴ + (σ−τ)²/4), dimensionless."""
    root = np.sqrt(beta4 + (sigma - tau) ** 2 / 4)
    mean = -(sigma + tau) / 2
    return mean + root, mean - root


def _closed_form(z1: Complex, z2: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """c0…c3 from hyperbolic and circular functions of λ1 = √z1 and λ2 = √−z2."""
    lambda1, lambda2 = np.sqrt(z1), np.sqrt(-z2)
    growth, turn = np.exp(lambda1), np.exp(1j * lambda2)
    decay, back = 1 / growth, 1 / turn
    cosh, cos = (growth + decay) / 2, (turn + back) / 2
    sinh = _over_root((growth - decay) / 2, lambda1)
    sin = _over_root((turn - back) / 2, 1j * lambda2)
    scale = 1 / (z1 - z2)
    return (
        (z1 * cos - z2 * cosh) * scale,
        (z1 * sin - z2 * sinh) * scale,
        (cosh - cos) * scale,
        (sinh - sin) * scale,
    )


def _over_root(sinh: Any, root: Any) -> Any:
    """Return sinh(√z)/√z from both, by its series where the root is near zero."""
    z = root * root
    near = np.abs(z) < 1e-3
    series = 1 + z / 6 * (1 + z / 20 * (1 + z / 42))
    return np.where(near, series, sinh / np.where(near, 1, root))


def _series(z1: Complex, z2: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """c0…c3 from their power series in the symmetric functions of z1 and z2."""
    total, product = z1 + z2, z1 * z2
    # symmetric[n] = Σ z1^i z2^(n−i), the divided difference of z^(n+1)
    symmetric = [np.ones_like(total), total]
    for _ in range(SERIES_TERMS):
        symmetric.append(total * symmetric[-1] - product * symmetric[-2])
    c0, c1 = np.ones_like(total), np.ones_like(total)
    c2, c3 = np.zeros_like(total), np.zeros_like(total)
    for n in range(1, SERIES_TERMS):
        c2 = c2 + symmetric[n - 1] / factorial(2 * n)
        c3 = c3 + symmetric[n - 1] / factorial(2 * n + 1)
    for n in range(2, SERIES_TERMS + 1):
        c0 = c0 - product * symmetric[n - 2] / factorial(2 * n)
        c1 = c1 - product * symmetric[n - 2] / factorial(2 * n + 1)
    return c0, c1, c2, c3


def c_functions(z1: Complex, z2: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """Return c0…c3 of the roots z1 and z2 (equal shapes), accurate from ω = 0 up."""
    small = (np.abs(z1) < SERIES_BELOW) & (np.abs(z2) < SERIES_BELOW)
    if not small.any():
        return _closed_form(z1, z2)
    c = np.empty((4, *z1.shape), np.complex128)
    c[:, small] = _series(z1[small], z2[small])
    if not small.all():
        c[:, ~small] = _closed_form(z1[~small], z2[~small])
    return c[0], c[1], c[2], c[3]


def transition(
    section: Section,
    length: NDArray[np.float64],
    omega: NDArray[np.float64],
    axial_force: NDArray[np.float64],
) -> Transition:
    """Return the exact state transition of a segment.

    Parameters
    ----------
    section : entries broadcast against ``omega``
    length : of the segment [m]
    omega : angular frequency [rad/s], zero allowed
    axial_force : tension N [N]; a finger that presses on the tip is N < 0

    Notes
    -----
    Entries grow as exp(λ1) (λ1 = 14 for the default section 20 mm long at 60 kHz), so that sums of
    products of them, such as a determinant, lose as much. `response` cuts longer segments.
    """
    L, EI, AG = length, section.EI, section.AG
    a = L**2 / EI
    inertia = section.m * omega**2
    turning = section.rhoI * omega**2 - axial_force
    beta4 = inertia * L**2 * a
    sigma = inertia * L**2 / AG + 0 * beta4
    tau = turning * a + 0 * beta4
    c0, c1, c2, c3 = c_functions(*characteristic_roots(sigma, tau, beta4))
    along = L * (c1 - (sigma + tau) * c3)
    across = inertia * L * a * c3
    moment = inertia * L**2 * c2
    u, psi = c0 - sigma * c2, c0 - tau * c2
    return Transition(
        ww=((u, -along), (-across, psi)),
        wf=((-a * c2, L / AG * (c1 - sigma * c3) - a * L * c3), (L / EI * (c1 - tau * c3), a * c2)),
        fw=(
            (-moment, L * ((inertia * L**2 + tau * turning) * c3 - turning * c1)),
            (-inertia * L * (c1 - sigma * c3), moment),
        ),
        ff=((psi, along), (across, u)),
    )
