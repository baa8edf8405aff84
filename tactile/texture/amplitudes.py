"""Closed-form strength of a descriptor, which needs no surface and so is cheap for a whole list.

The variance of skin displacement along a stroke is the sum over the three parts of a texture: for a
band, its density times its width; for a grating, half the square of each harmonic; for sparse
events, see `event_power`. The displacement holds at the reference speed and force, before the
low-pass of ``contact_length_mm``. What an isotropic surface adds below its lowest band is not
counted. `tactile.strength.strength.commanded_figures` gives the vibration of a stroke, from 20 to
1000 Hz at any speed and force, with both of these included.
"""

import math
from dataclasses import dataclass

from tactile.texture.bands import RELATIVE_WIDTH
from tactile.texture.descriptor import Descriptor
from tactile.texture.event_power import MICRO, mean_square


@dataclass(frozen=True)
class PartAmplitudes:
    """Root mean square (rms) skin displacement of each part of a texture.

    Attributes
    ----------
    bands_um : float
        Rms displacement of the random bands [µm].
    gratings_um : float
        Rms displacement of the gratings [µm].
    events_um : float
        Rms displacement of the sparse events [µm].
    """

    bands_um: float
    gratings_um: float
    events_um: float

    @property
    def rms_um(self) -> float:
        """Rms displacement of all parts together, which are independent of each other [µm]."""
        return math.hypot(self.bands_um, self.gratings_um, self.events_um)


def strength_of(descriptor: Descriptor) -> PartAmplitudes:
    """Compute the rms skin displacement of each part of a texture.

    Parameters
    ----------
    descriptor : Descriptor
        Texture to evaluate, at its reference speed and force.

    Returns
    -------
    PartAmplitudes
        Rms displacement of the bands, the gratings and the events [µm].
    """
    bands, stochastic = 0.0, descriptor.stochastic
    if stochastic is not None:
        pairs = zip(stochastic.frequency_per_mm, stochastic.level_db, strict=True)
        bands = sum(10 ** (level / 10) * RELATIVE_WIDTH * center for center, level in pairs)
    peaks = [peak for part in descriptor.periodic for peak in part.harmonics_um]
    events = sum(mean_square(kind) for kind in descriptor.events) / MICRO**2
    return PartAmplitudes(math.sqrt(bands), math.hypot(*peaks) / math.sqrt(2), math.sqrt(events))
