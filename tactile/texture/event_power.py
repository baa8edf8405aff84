"""Displacement power of sparse events by Campbell's theorem (Rice 1944), without drawing events.

Events that are scattered at random with density λ, mean square peak ⟨A²⟩ (a² exp(2s²) for a
log-normal amplitude) and a shape h of unit peak make shot noise. Its mean is zero, since either
sign is equally likely, and its autocorrelation along a stroke is λ⟨A²⟩ ∫ h(r) h(r + d) dr. A pulse
is the Gaussian h = exp(−r²/2σ²), with ∫h² = πσ². An edge is the derivative of that Gaussian across
the edge, scaled to the same peak: √e (n·r/σ) exp(−r²/2σ²), with ∫h² = e πσ²/2.

The power of an event up to a wave number k along the stroke follows from the Fourier transform
along the stroke, integrated over the wave numbers across it. With u = kσ it is λ⟨A²⟩πσ² erf(u) for
a pulse and λ⟨A²⟩πσ² e [erf(u)/2 − cos²β u exp(−u²)/√π] for an edge whose normal n is at an angle β
to the stroke.
"""

import math

import numpy as np
from scipy.special import erf

from tactile.arrays import Floats
from tactile.texture.descriptor import Events

FWHM = float(np.sqrt(8 * np.log(2)))
"""Full width at half maximum of a Gaussian, in standard deviations."""
MILLI, MICRO = 1e-3, 1e-6
"""SI prefixes."""
ALL = 10.0
"""Largest value of kσ that is evaluated. All but 1e-42 of the power lies below it."""


def power_below(kind: Events, wave_number: Floats, angle: float = 0.0) -> Floats:
    """Compute the mean square displacement of one kind of event up to wave numbers along a stroke.

    Parameters
    ----------
    kind : Events
        Kind of event.
    wave_number : (K,) array of float
        Wave numbers along the stroke [rad/m]. Infinity gives the whole power.
    angle : float
        Direction of the stroke from the x axis [rad].

    Returns
    -------
    (K,) array of float
        Mean square displacement at the reference speed and force, averaged over realizations of the
        surface [m²].
    """
    sigma = kind.width_mm * MILLI / FWHM
    square = (kind.amplitude_um * MICRO) ** 2 * np.exp(2 * kind.amplitude_sd**2)
    total = kind.density_per_mm2 / MILLI**2 * square * np.pi * sigma**2
    u = np.minimum(np.asarray(wave_number) * sigma, ALL)
    if kind.shape == "pulse":
        return np.asarray(total * erf(u))
    along = np.cos(angle - np.radians(kind.direction_deg)) ** 2
    return np.asarray(total * math.e * (erf(u) / 2 - along * u * np.exp(-(u**2)) / np.sqrt(np.pi)))


def mean_square(kind: Events) -> float:
    """Compute the mean square displacement of one kind of event, the same for every stroke.

    Parameters
    ----------
    kind : Events
        Kind of event.

    Returns
    -------
    float
        Mean square displacement at the reference speed and force [m²].
    """
    return float(power_below(kind, np.array([np.inf]))[0])
