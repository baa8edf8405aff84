"""How much sparse events move the skin, by Campbell's theorem (Rice 1944): no event is drawn.

Events of density λ scattered at random, of mean square peak ⟨A²⟩ (a² exp(2s²) where it is
log-normal) and the shape h of unit peak, make shot noise: its autocorrelation along a stroke is
λ⟨A²⟩ ∫ h(r) h(r + d) dr, its mean zero, as often up as down. A pulse is the Gaussian
h = exp(−r²/2σ²), with ∫h² = πσ²; an edge is its derivative across the edge with the same peak,
√e (n·r/σ) exp(−r²/2σ²), with ∫h² = e πσ²/2.

With u = kσ, the Fourier transform along the stroke, integrated over the wave numbers across it,
leaves below the wave number k of a pulse λ⟨A²⟩πσ² erf(u), and of an edge whose n is at an angle β
from the stroke λ⟨A²⟩πσ² e [erf(u)/2 − cos²β u exp(−u²)/√π].
"""

import numpy as np
from scipy.special import erf

from tactile.arrays import Floats
from tactile.texture.descriptor import Events

FWHM = float(np.sqrt(8 * np.log(2)))
"""Full width at half maximum of a Gaussian, in standard deviations."""
MILLI, MICRO = 1e-3, 1e-6
ALL = 10.0
"""kσ below which all power is, to 1e-42 of it."""


def power_below(kind: Events, wave_number: Floats, angle: float = 0.0) -> Floats:
    """Return the mean square that one kind of event has up to wave numbers along a stroke.

    Parameters
    ----------
    kind : of event
    wave_number : (K,) [rad/m]; all of the power is below infinity
    angle : of the stroke from the x axis [rad]

    Returns
    -------
    (K,) ndarray
        [m²] at the reference speed and force, in the mean over surfaces.
    """
    sigma = kind.width_mm * MILLI / FWHM
    square = (kind.amplitude_um * MICRO) ** 2 * np.exp(2 * kind.amplitude_sd**2)
    whole = kind.density_per_mm2 / MILLI**2 * square * np.pi * sigma**2
    u = np.minimum(np.asarray(wave_number) * sigma, ALL)
    if kind.shape == "pulse":
        return np.asarray(whole * erf(u))
    along = np.cos(angle - np.radians(kind.direction_deg)) ** 2
    return np.asarray(whole * np.e * (erf(u) / 2 - along * u * np.exp(-(u**2)) / np.sqrt(np.pi)))


def mean_square(kind: Events) -> float:
    """Return the mean square [m²] of one kind of event at a place, whatever the stroke."""
    return float(power_below(kind, np.array([np.inf]))[0])
