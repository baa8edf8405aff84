"""First resonance of a bimorph in air: that of an undamped cantilever with shorted electrodes.

At the clamp w = (u, ψ) = 0, and at the free tip f = (M, F) = 0. With the transition of the whole
length (`beam`), f2 = ff f1, so that a resonance is a zero of det ff, which is real and smooth in ω
without losses. The zero is bracketed on a grid up to Rayleigh's bound and then found by bisection,
for all designs at once.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tactile.actuator.beam import CrossSection, transition
from tactile.actuator.bimorph import Bimorph, section
from tactile.actuator.materials import Real
from tactile.arrays import Floats

EULER_ROOT = 1.8751040687119611
"""First root of cosh λ cos λ = −1, which gives ω = λ² √(EI/m)/l² of a slender cantilever (any
textbook)."""
TENSION_SHARE = 0.376
"""Ratio ∫φ'²/(l² ∫φ''²) of the first mode φ of a slender cantilever. Rayleigh's quotient of φ
bounds ω² from above by λ⁴ EI/(m l⁴) times 1 + 0.376 N l²/EI; shear and rotary inertia only lower
it."""
LOWEST = 1e-4
"""Fraction of Rayleigh's bound below which a compressed bender counts as buckled."""
GRID, HALVINGS = 120, 48
"""Number of grid points up to the bound, and number of bisections of the bracket."""


def first_resonance(bimorph: Bimorph, *, axial_force: Real = 0.0) -> Floats:
    """Compute the first resonance in air, without losses and with shorted electrodes.

    Parameters
    ----------
    bimorph : Bimorph
        One design, or arrays over designs (...,).
    axial_force : float or (...,) array of float
        Axial tension; a pressing finger is negative [N].

    Returns
    -------
    (...,) array of float
        First resonance [Hz]; NaN where the axial force has buckled the bender.
    """
    lossless = replace(
        bimorph,
        piezo=replace(bimorph.piezo, quality_factor=np.inf),
        shim=replace(bimorph.shim, quality_factor=np.inf),
    )
    s, length = section(lossless), np.asarray(bimorph.length, np.float64)
    axial = np.asarray(axial_force, np.float64)
    shape = np.broadcast_shapes(np.shape(s.EI), np.shape(s.m), length.shape, axial.shape)
    bound = (
        EULER_ROOT**2
        * np.sqrt(s.EI.real / s.m)
        / length**2
        * np.sqrt(1 + TENSION_SHARE * np.maximum(axial, 0) * length**2 / s.EI.real)
    )
    omega = _first_zero(s, length, axial, np.broadcast_to(bound, shape))
    return np.asarray(omega / (2 * np.pi))


def _first_zero(s: CrossSection, length: Floats, axial_force: Floats, bound: Floats) -> Floats:
    """Return ω (...,) of the first change of sign of det ff, which is 1 at rest."""

    def is_beyond(omega: Floats) -> NDArray[np.bool_]:
        """Return whether det ff is negative."""
        (a, b), (c, d) = transition(s, length, omega, axial_force).ff
        return np.asarray((a * d - b * c).real < 0)

    grid = np.multiply.outer(np.geomspace(LOWEST, 1.01, GRID), bound)
    beyond = is_beyond(grid)
    first = beyond.argmax(axis=0)
    low = np.take_along_axis(grid, np.maximum(first - 1, 0)[None], axis=0)[0]
    high = np.take_along_axis(grid, first[None], axis=0)[0]
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        over = is_beyond(middle)
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return np.where(beyond.any(axis=0) & (first > 0), high, np.nan)
