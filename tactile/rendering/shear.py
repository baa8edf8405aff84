"""What the skin is to do: the laws of speed and force, and sparse events, as shear targets."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tactile.texture.descriptor import Descriptor, Events
from tactile.texture.surface import Surface

Floats = NDArray[np.float64]

SHARPNESS = 8
"""Of the turn from law to constant at a range's ends: 0.75 dB off the law right at an end."""
CONTACT_FORCE = 0.05
"""N; below it the finger is leaving and shear falls to nothing at 0 N (assumed)."""
PIXELS = 2048
"""Of an event field's side: 25 µm on a tile of 51.2 mm."""
FWHM = 2 * np.sqrt(2 * np.log(2))


def held_power_law(
    value: Floats, reference: float, bounds: tuple[float, float], exponent: float
) -> Floats:
    """Return (value/reference)^exponent, held smoothly constant outside its bounds.

    One at the reference. Even and smooth at zero, so that a stop and a reversal change nothing.
    """
    if exponent == 0:
        return np.ones_like(value)
    low, high = bounds

    def held(x: Floats) -> Floats:
        from_below = x**SHARPNESS + low**SHARPNESS
        return np.asarray((1 / (1 / from_below + high**-SHARPNESS)) ** (1 / SHARPNESS))

    return np.asarray((held(value) / held(np.asarray(reference))) ** exponent)


def law(descriptor: Descriptor, speed: Floats, normal_force: Floats) -> Floats:
    """Return the factor on displacement at speeds [mm/s] and normal forces [N].

    Both laws, and a smooth fall to nothing as the force goes to zero.
    """
    laws, reference = descriptor.laws, descriptor.reference
    touch = np.clip(normal_force / CONTACT_FORCE, 0, 1)
    return np.asarray(
        held_power_law(speed, reference.speed_mm_s, laws.speed_range_mm_s, laws.speed_exponent)
        * held_power_law(
            normal_force, reference.normal_force_n, laws.force_range_n, laws.force_exponent
        )
        * (touch * touch * (3 - 2 * touch))
    )


class EventField:
    """Sparse events drawn once on a tile that repeats over the surface, read by cubic B-splines."""

    def __init__(self, surface: Surface, kinds: tuple[Events, ...]) -> None:
        self._pitch = surface.tile / PIXELS
        self._field = np.zeros((PIXELS, PIXELS), np.float32)
        places = surface.event_place / self._pitch
        for place, peak, kind in zip(places, surface.event_peak, surface.event_kind, strict=True):
            self._draw(place, peak, kinds[kind])

    def _draw(self, place: Floats, peak: float, kind: Events) -> None:
        """Add one event; a spline's own width, a third of a pixel squared, is taken off."""
        width = kind.width_mm * 1e-3 / FWHM / self._pitch
        sigma = np.sqrt(width**2 - 1 / 3)
        reach = int(np.ceil(5 * sigma))
        start = np.floor(place).astype(int)
        offset = np.arange(-reach, reach + 2)
        x, y = (offset + start[i] - place[i] for i in (0, 1))
        bump = np.exp(-0.5 * np.add.outer(x**2, y**2) / sigma**2)
        if kind.shape == "edge":
            turn = np.radians(kind.direction_deg)
            bump = bump * np.add.outer(x * np.cos(turn), y * np.sin(turn)) / sigma * np.exp(0.5)
        rows, columns = (offset + start[0]) % PIXELS, (offset + start[1]) % PIXELS
        # the sum over a spline's pixels keeps area, so that a narrower bump must be higher
        self._field[np.ix_(rows, columns)] += peak * (width / sigma) ** 2 * bump

    def at(self, place: Floats) -> Floats:
        """Return displacement [m] at places (..., 2) [m]."""
        pixel = np.moveaxis(place / self._pitch, -1, 0)
        return np.asarray(
            map_coordinates(self._field, pixel, order=3, mode="grid-wrap", prefilter=False),
            np.float64,
        )
