"""How strong a descriptor is, in closed form: no surface is drawn, so that all can be listed.

The variance of skin displacement along a stroke is a sum over the three parts: of a band, its
density times its width; of a grating, half the square of each harmonic; of sparse events, see
`event_power`. Displacement holds at the reference speed and force, before ``contact_length_mm``;
what an isotropic surface adds below its lowest band is not counted. What a realized surface has at
another speed and force, with both, is `tactile.show.views.texture_rms`.
"""

import math
from dataclasses import dataclass

from tactile.texture.bands import RELATIVE_WIDTH
from tactile.texture.descriptor import Descriptor
from tactile.texture.event_power import MICRO, mean_square


@dataclass(frozen=True)
class PartAmplitudes:
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


def strength_of(descriptor: Descriptor) -> PartAmplitudes:
    """Return how far each part of a texture moves the skin."""
    bands, stochastic = 0.0, descriptor.stochastic
    if stochastic is not None:
        pairs = zip(stochastic.frequency_per_mm, stochastic.level_db, strict=True)
        bands = sum(10 ** (level / 10) * RELATIVE_WIDTH * center for center, level in pairs)
    peaks = [peak for part in descriptor.periodic for peak in part.harmonics_um]
    events = sum(mean_square(kind) for kind in descriptor.events) / MICRO**2
    return PartAmplitudes(math.sqrt(bands), math.hypot(*peaks) / math.sqrt(2), math.sqrt(events))
