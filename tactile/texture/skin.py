"""From the relief of a surface to the tangential displacement of a finger's skin: a model, assumed.

The way from relief to traction is highly nonlinear (Wiertlewski, Lozada & Hayward, IEEE T-RO
2011), so no linear model is true. This is the simplest one that physics allows, good for ranking
and for shape, not for level:

1. Skin is an elastic half-space of contact modulus E* under a mean pressure p. Following a wave of
   relief h of wave number k takes the pressure E* k h/2 (full contact of a wavy surface,
   Westergaard; needed mean pressure π E* h/λ: tribonet.org, "Indentation of elastic body by
   sinusoidal surface").
2. Two tractions come of it: friction, µ times that pressure, and the mean pressure tilted by the
   slope, p k h: lateral force ∝ slope, by which a surface is felt without any height
   (Minsky, "Computational haptics: the Sandpaper system", MIT 1995, abstract and a summary of the
   paper of 1990 read).
3. A half-space yields by 2/(E* k) per traction, so that k and E* cancel: µ h and (2 p/E*) h, a
   quarter period apart. **Skin in contact moves in proportion to height, at every wavelength.**
4. Where relief is too steep for the pressure, skin bridges its valleys. The pressure at a place is
   a random walk over ever finer relief that ends at zero, where contact is lost (Persson's theory,
   as told in Dapp, Prodanov & Müser 2014, abstract read). The share still in contact follows, and
   power passes in proportion to it.
5. What descriptors state moves less than the patch itself: the skin beside it, on which the
   reference spectrum of `textures/README.md` was drawn.

Numbers, all assumed: µ = 0.4 (finger on most solids, 0.3–0.6 in the prior), p = 5 kPa (0.5 N on
1 cm²), E* = 50 kPa, patch ÷ skin beside it = 3 ("several times"). Hence 0.15 µm of skin per µm of
relief. Two checks against the levels of the shipped textures, whose own gains are assumed too:
Ra 5 µm (sanded wood, 3–8) is 0.9 µm of skin, `wood-pine-sanded` has 1.06; Ra 2.2 µm (VDI 3400
Ref 27) is 0.41 µm, `plastic-abs-vdi27` has 0.88. So take **levels as known within a factor of 2
(6 dB)**, and differences between two pictures as better known than either.

Left out: fingerprint ridges, the stiffer outer layer, stick-slip and the harmonics it adds to a
grating, adhesion, events, a soft surface that yields, the quarter period between the two
tractions, and that skin yields up to twice as much to waves that lie along the stroke.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from tactile.arrays import Floats

FRICTION = 0.4
PRESSURE = 5e3
"""Pa."""
MODULUS = 50e3
"""E* = E/(1 − ν²) [Pa]."""
PATCH = 3.0
"""How much more the contact patch moves than the skin beside it."""
GAIN = float(np.hypot(FRICTION, 2 * PRESSURE / MODULUS)) / PATCH
"""Displacement of the skin per height of relief that it touches."""
STEEP = 0.1
"""Rms slope above which the contact filter takes more than 0.2 dB, and twice the height is less
than twice the displacement."""


def share_in_contact(rms_slope: ArrayLike) -> Floats:
    """Return the share of the skin that touches relief of an rms slope: erf(√2 p/(E* s)).

    Pressure that starts at p and spreads to the variance σ² = (E* s/2)² without ever having been
    zero, the solution of diffusion with an absorbing end by its mirror image: erf(p/(√2 σ)).

    Parameters
    ----------
    rms_slope : s, of all relief as coarse as the wavelength asked for or coarser

    Returns
    -------
    ndarray
        Of the same shape: 1 is full contact, and 1.6 p/(E* s) is left of it on steep relief.
    """
    slope = np.maximum(np.asarray(rms_slope, np.float64), 1e-12)
    return np.asarray(erf(np.sqrt(2) * PRESSURE / (MODULUS * slope)))


def skin_gain(rms_slope: ArrayLike) -> Floats:
    """Return the displacement of the skin per height of a wave of relief, both peak or both rms.

    Parameters
    ----------
    rms_slope : of all relief as coarse as that wave or coarser
    """
    return GAIN * np.sqrt(share_in_contact(rms_slope))
