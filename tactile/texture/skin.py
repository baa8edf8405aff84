"""Assumed model of the tangential skin displacement of a finger on a relief.

The way from relief to traction is highly nonlinear (Wiertlewski, Lozada & Hayward, IEEE T-RO 2011),
so no linear model is true. This is the simplest one that physics allows. It is good for ranking and
for the shape of spectra, not for levels:

1. Skin is an elastic half-space of contact modulus E* under a mean pressure p. To follow a wave of
   relief of height h and wave number k it takes the pressure E* k h/2 (full contact of a wavy
   surface, Westergaard; the mean pressure needed is π E* h/λ: tribonet.org, "Indentation of elastic
   body by sinusoidal surface").
2. Two tractions result. One is friction, µ times that pressure. The other is the mean pressure
   tilted by the slope, p k h: a lateral force in proportion to slope, by which a surface can be
   felt without any height (Minsky, "Computational haptics: the Sandpaper system", MIT 1995; its
   abstract and a summary of the paper of 1990 were read).
3. A half-space yields by 2/(E* k) per traction, so that k cancels: the displacements are µ h and
   (2p/E*) h, a quarter period apart. **Skin in contact moves in proportion to height, at every
   wavelength.**
4. Where relief is too steep for the pressure, skin bridges its valleys. As ever finer relief is
   added, the pressure at a place makes a random walk that ends at zero, where contact is lost
   (Persson's theory, as described by Dapp, Prodanov & Müser 2014, whose abstract was read). This
   gives the share of the skin that is still in contact, and power is transmitted in proportion to
   it.
5. Descriptors state the displacement of the skin beside the contact patch, for which the reference
   spectrum of `textures/README.md` was drawn. It is smaller than that of the patch.

All numbers are assumed: µ = 0.4 (finger on most solids, 0.3–0.6 in the prior), p = 5 kPa (0.5 N on
1 cm²), E* = 50 kPa, displacement of the patch ÷ that of the skin beside it = 3 ("several times").
Hence the skin moves by 0.15 µm per µm of relief. There are two checks against the levels of the
shipped textures, whose gains are themselves assumed: Ra 5 µm (sanded wood, 3–8) gives 0.9 µm of
skin displacement, and `wood-pine-sanded` has 1.06; Ra 2.2 µm (VDI 3400 Ref 27) gives 0.41 µm, and
`plastic-abs-vdi27` has 0.88. So take **levels as known within a factor of 2 (6 dB)**, and
differences between two pictures as better known than either.

The model leaves out fingerprint ridges, the stiffer outer layer, stick-slip and the harmonics that
it adds to a grating, adhesion, events, a soft surface that yields, the quarter period between the
two tractions, and that skin yields up to twice as much to waves that lie along the stroke.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from tactile.arrays import Floats

FRICTION = 0.4
"""Coefficient of friction µ of a finger on the surface."""
PRESSURE = 5e3
"""Mean contact pressure p [Pa]."""
MODULUS = 50e3
"""Contact modulus E* = E/(1 − ν²) of skin [Pa]."""
PATCH = 3.0
"""Ratio of the displacement of the contact patch to that of the skin beside it."""
GAIN = float(np.hypot(FRICTION, 2 * PRESSURE / MODULUS)) / PATCH
"""Skin displacement per height of relief in contact."""
STEEP = 0.1
"""Rms slope above which the contact filter takes away more than 0.2 dB, and twice the height gives
noticeably less than twice the displacement."""


def share_in_contact(rms_slope: ArrayLike) -> Floats:
    """Compute the share of the skin that touches relief of a given rms slope.

    Parameters
    ----------
    rms_slope : array_like of float
        Rms slope s of all relief up to the wave number of interest.

    Returns
    -------
    array of float
        Share in contact, of the same shape: 1 is full contact. On steep relief it approaches 1.6
        p/(E* s).

    Notes
    -----
    The share is erf(√2 p/(E* s)). It is the share of a pressure that starts at p and spreads to the
    variance σ² = (E* s/2)² without ever having been zero, erf(p/(√2 σ)): the solution of the
    diffusion equation with an absorbing boundary by the method of images.
    """
    slope = np.maximum(np.asarray(rms_slope, np.float64), 1e-12)
    return np.asarray(erf(np.sqrt(2) * PRESSURE / (MODULUS * slope)))


def skin_gain(rms_slope: ArrayLike) -> Floats:
    """Compute the skin displacement per height of a wave of relief, both peak or both rms.

    Parameters
    ----------
    rms_slope : array_like of float
        Rms slope of all relief up to the wave number of that wave.

    Returns
    -------
    array of float
        Displacement per height, of the same shape.
    """
    return GAIN * np.sqrt(share_in_contact(rms_slope))
