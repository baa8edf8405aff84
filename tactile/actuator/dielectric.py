"""Causal dielectric of a piezoceramic: a chain of Debye relaxations with a nearly constant tan δ.

A complex permittivity ε (1 − j tan δ) that does not depend on frequency is not causal. A material
whose tan δ is constant has a permittivity that falls with frequency (Kramers–Kronig): that of a
constant-phase element, ε ∝ (jω)^(−2δ/π), falls by 2 tan δ/π · ln 10 per decade, which is 2.9 % for
tan δ = 0.02. A sum of relaxations has a state in time, unlike the constant-phase element itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from tactile.arrays import Complex, Floats

REFERENCE = 1e3
"""Frequency at which the permittivity is that of the data sheet [Hz]; 1 kHz is usual (IEEE Std
176)."""
BAND = (1.0, 10e3)
"""Band in which tan δ is constant [Hz]."""
CORNERS = np.geomspace(0.3, 30e3, 9)
"""Corner frequencies of the relaxations [Hz]; 1.6 per decade leave a ripple of tan δ of 1 %."""
POINTS = 200
"""Number of frequencies at which the chain is fitted."""
FIXED = 1e3
"""Weight with which the fit keeps the value at `REFERENCE`."""


@dataclass(frozen=True)
class DebyeChain:
    """Permittivity ε(ω)/ε(1 kHz) = instantaneous + Σ strength/(1 + jω/rate).

    Attributes
    ----------
    instantaneous : float
        Part that follows the field at once.
    strength : (M,) array of float
        Part of each relaxation.
    rate : (M,) array of float
        Rate at which each relaxation follows the field [1/s].
    """

    instantaneous: float
    strength: Floats
    rate: Floats

    def at(self, frequency: ArrayLike) -> Complex:
        """Compute the permittivity relative to that at 1 kHz.

        Parameters
        ----------
        frequency : (F,) array_like of float
            Frequencies, zero allowed [Hz].

        Returns
        -------
        (F,) complex array
            Relative permittivity ε' − jε''.
        """
        omega = 2 * np.pi * np.asarray(frequency, np.float64)[..., None]
        parts = self.strength / (1 + 1j * omega / self.rate)
        return np.asarray(self.instantaneous + parts.sum(axis=-1), np.complex128)


def debye_chain(loss_tangent: float) -> DebyeChain:
    """Fit relaxations to a tan δ that is constant from 1 Hz to 10 kHz.

    Parameters
    ----------
    loss_tangent : float
        tan δ of the dielectric, from 0 up.

    Returns
    -------
    DebyeChain
        Chain whose real part is 1 at 1 kHz; without loss it has no relaxations.

    Examples
    --------
    The real part falls by 2.9 % per decade, and tan δ is 0.02 everywhere.

    >>> from tactile.actuator.dielectric import debye_chain
    >>> relative = debye_chain(0.02).at([10.0, 100.0, 1000.0])
    >>> relative.real.round(3).tolist()
    [1.06, 1.03, 1.0]
    >>> (-relative.imag / relative.real).round(3).tolist()
    [0.02, 0.02, 0.02]
    """
    none = np.zeros(0)
    if loss_tangent == 0:
        return DebyeChain(1.0, none, none)
    rate = 2 * np.pi * CORNERS

    def columns(frequency: Floats) -> Complex:
        """Return the response of the instantaneous part and of each relaxation."""
        omega = 2 * np.pi * frequency[:, None]
        return np.hstack([np.ones((len(frequency), 1)), 1 / (1 + 1j * omega / rate)])

    over_band = columns(np.geomspace(*BAND, POINTS))
    lossy = (-over_band.imag - loss_tangent * over_band.real) / loss_tangent
    fixed = FIXED * columns(np.array([REFERENCE])).real
    parts, _ = nnls(np.vstack([lossy, fixed]), np.append(np.zeros(POINTS), FIXED))
    return DebyeChain(float(parts[0]), parts[1:], rate)
