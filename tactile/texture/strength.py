"""How strong a descriptor is, in closed form: no surface is drawn, so that all can be listed.

The variance of skin displacement along a stroke is a sum over the three parts: of a band, its
density times its width; of a grating, half the square of each harmonic; of sparse events,
Campbell's theorem (Rice 1944): density × mean square amplitude × the integral of the squared
shape. Displacement holds at the reference speed and force, before ``contact_length_mm``; what an
isotropic surface adds below its lowest band is not counted.
"""

import math
from dataclasses import dataclass

from tactile.texture.descriptor import Descriptor, Events

FWHM = math.sqrt(8 * math.log(2))
"""Full width at half maximum of a Gaussian, in standard deviations."""
RELATIVE_WIDTH = 10**0.05 - 10**-0.05
"""Width of a third octave over its center (IEC 61260-1, base ten)."""


@dataclass(frozen=True)
class Strength:
    """Root mean square skin displacement of each part of a texture [µm].

    Attributes
    ----------
    bands_um, gratings_um, events_um : of the random bands, the gratings and the sparse events
    """

    bands_um: float
    gratings_um: float
    events_um: float

    @property
    def rms_um(self) -> float:
        """Of all together, which are independent of each other."""
        return math.hypot(self.bands_um, self.gratings_um, self.events_um)


def strength_of(descriptor: Descriptor) -> Strength:
    """Return how far each part of a texture moves the skin."""
    bands, stochastic = 0.0, descriptor.stochastic
    if stochastic is not None:
        pairs = zip(stochastic.frequency_per_mm, stochastic.level_db, strict=True)
        bands = sum(10 ** (level / 10) * RELATIVE_WIDTH * center for center, level in pairs)
    peaks = [peak for part in descriptor.periodic for peak in part.harmonics_um]
    events = sum(event_variance(kind) for kind in descriptor.events)
    return Strength(math.sqrt(bands), math.hypot(*peaks) / math.sqrt(2), math.sqrt(events))


def event_variance(kind: Events) -> float:
    """Return the variance [µm²] of events at a place.

    A pulse is the Gaussian b = exp(−r²/2σ²), ∫b² = πσ²; an edge its derivative with the same
    peak, b·(x/σ)·√e, ∫ = e·πσ²/2. Log-normal amplitudes have the mean square a² exp(2s²).
    """
    sigma = kind.width_mm / FWHM
    area = math.pi * sigma**2 * (math.e / 2 if kind.shape == "edge" else 1.0)
    return kind.density_per_mm2 * kind.amplitude_um**2 * math.exp(2 * kind.amplitude_sd**2) * area
