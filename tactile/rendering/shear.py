"""Laws of speed and force, and sparse events, as targets of shear."""

import numpy as np

from tactile.arrays import Floats, Singles
from tactile.texture.descriptor import Descriptor, Events
from tactile.texture.event_power import FWHM
from tactile.texture.power_laws import force_factor, speed_factor
from tactile.texture.surface import Surface

CONTACT_FORCE = 0.05
"""Normal force below which the finger is leaving and shear falls, to 0 at 0 N (assumed) [N]."""
PIXELS = 1 << 11
"""Number of pixels along one side of an event field: pixels of 12.5 µm on a tile of 25.6 mm."""
LAST = PIXELS - 1
"""Index of the last pixel, and mask that wraps an index around the tile."""


class Law:
    """Factor on displacement at a given speed and normal force, read from two tables.

    The factor is the product of the descriptor's two laws and of a smooth fall to 0 as the force
    goes to 0. The tables cover the range in which the laws vary. Between entries, 1 % of speed or
    force apart, they are interpolated linearly, which is within 3e-5 for an exponent of 1.

    Parameters
    ----------
    descriptor : Descriptor
        Description of the texture.
    """

    def __init__(self, descriptor: Descriptor) -> None:
        laws, reference = descriptor.laws, descriptor.reference
        speed = _places(laws.speed_range_mm_s)
        self._speed = (speed * 1e-3) ** 2, speed_factor(laws, reference, speed * 1e-3)
        landing = np.linspace(0, CONTACT_FORCE, 65)
        force = np.union1d(landing, _places(laws.force_range_n))
        touch = np.minimum(force / CONTACT_FORCE, 1)
        by_force = force_factor(laws, reference, force)
        self._force = force, touch * touch * (3 - 2 * touch) * by_force

    def __call__(self, speed_squared: Floats, normal_force: Floats) -> Floats:
        """Return factors (S,) at squared speeds (S,) [m²/s²] and normal forces (S,) [N]."""
        factor = np.interp(speed_squared, *self._speed)
        factor *= np.interp(normal_force, *self._force)
        return factor


def _places(bounds: tuple[float, float]) -> Floats:
    """Return the arguments of a law's table: 1/6 of the lower to 6 times the upper bound."""
    low, high = bounds[0] / 6, bounds[1] * 6
    return np.geomspace(low, high, int(np.log(high / low) / 0.01))


class EventField:
    """Sparse events, drawn once on a tile that repeats over the surface and read bilinearly.

    The narrowest event, 0.1 mm, is 8 pixels wide: its reading is within 2.2 % of its peak, that of
    an event of 0.25 mm within 0.4 %. Contactors are assumed to stand on whole pixels, so that one
    fraction of a pixel serves them all; this moves them by at most 9 µm, and not at all for the
    shipped displays.

    Parameters
    ----------
    surface : Surface
        Realized surface with the events' places and peaks.
    kinds : tuple of Events
        Kinds of events, in the order of the descriptor.
    contactors : (N, 2) array of float
        Places of the contactors [m].
    """

    def __init__(self, surface: Surface, kinds: tuple[Events, ...], contactors: Floats) -> None:
        pitch = surface.tile / PIXELS
        self._per_meter = 1 / pitch
        self._rows, self._columns = np.rint(contactors.T / pitch).astype(np.int64)
        field = np.zeros((PIXELS, PIXELS), np.float32)
        for place, peak, kind in zip(
            surface.event_place / pitch, surface.event_peak, surface.event_kind, strict=True
        ):
            _draw(field, place, peak, kinds[kind], pitch)
        # The first row and column once more behind the last: a pixel's neighbors need no wrapping.
        # One array, because a prepared texture is pickled: a view would be another copy of it.
        self._flat = np.pad(field, (0, 1), mode="wrap").ravel()

    def at(self, place: Floats) -> Singles:
        """Return the displacement at each contactor.

        Parameters
        ----------
        place : (2, S) array of float
            Positions of the finger [m].

        Returns
        -------
        (S, N) array of float
            Displacement [m].
        """
        pixel = place * self._per_meter
        whole = np.floor(pixel)
        x, y = (pixel - whole).astype(np.float32)[..., None]
        finger_row, finger_column = whole.astype(np.int64)[..., None]
        index = (finger_row + self._rows) & LAST
        index *= PIXELS + 1
        index += (finger_column + self._columns) & LAST
        weights = (1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y
        shear, part = np.zeros((2, *index.shape), np.float32)
        for corner, weight in zip((0, 1, PIXELS + 1, PIXELS + 2), weights, strict=True):
            self._flat[corner:].take(index, out=part, mode="clip")
            part *= weight
            shear += part
        return np.asarray(shear)


def _draw(field: Singles, place: Floats, peak: float, kind: Events, pitch: float) -> None:
    """Add one event to the field at a place [pixels]."""
    sigma = kind.width_mm * 1e-3 / FWHM / pitch
    reach = int(np.ceil(5 * sigma))
    start = np.floor(place).astype(int)
    offset = np.arange(-reach, reach + 2)
    x, y = (offset + start[i] - place[i] for i in (0, 1))
    bump = np.exp(-0.5 * np.add.outer(x**2, y**2) / sigma**2)
    if kind.shape == "edge":
        turn = np.radians(kind.direction_deg)
        bump = bump * np.add.outer(x * np.cos(turn), y * np.sin(turn)) / sigma * np.exp(0.5)
    rows, columns = (offset + start[0]) % PIXELS, (offset + start[1]) % PIXELS
    np.add.at(field, np.ix_(rows, columns), (peak * bump).astype(np.float32))
