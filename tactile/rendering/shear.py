"""Laws of speed and force, and sparse events, as targets of shear."""

import numpy as np

from tactile.arrays import Floats, Ints, Singles
from tactile.machine_code import compiled
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
    an event of 0.25 mm within 0.4 %.

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
        pixel = contactors.T / pitch
        whole = np.floor(pixel)
        self._offset = np.ascontiguousarray(whole, np.int64)
        self._part = np.ascontiguousarray(pixel - whole, np.float32)
        field = np.zeros((PIXELS, PIXELS), np.float32)
        for place, peak, kind in zip(
            surface.event_place / pitch, surface.event_peak, surface.event_kind, strict=True
        ):
            # Rows along x, the usual direction of a stroke, are read faster than columns.
            _draw(field.T, place, peak, kinds[kind], pitch)
        # The first row and column once more behind the last: a pixel's neighbors need no wrapping.
        self._pixels = np.pad(field, (0, 1), mode="wrap")

    def add_to(self, shear: Singles, place: Floats) -> None:
        """Add the displacement at each contactor.

        Parameters
        ----------
        shear : (S, N) array of float32
            Displacement to add to [m].
        place : (2 or more, S) array of float
            Rows x and y of the finger's places [m].
        """
        add_events(shear, place, self._offset, self._part, self._pixels, self._per_meter)


@compiled(
    "void(float32[:, ::1], float64[:, :], int64[:, ::1], float32[:, ::1], float32[:, ::1], float64)"
)
def add_events(
    shear: Singles, place: Floats, offset: Ints, part: Singles, pixels: Singles, per_meter: float
) -> None:
    """Add what is between four pixels of an event field, as `EventField.add_to` describes.

    ``offset`` (2, N) and ``part`` (2, N) are whole and remaining pixels from the finger to each
    contactor. Indices are unsigned, so that numba need not check whether they count from the end.
    """
    one = np.uint64(1)
    for n in range(shear.shape[0]):
        x, y = place[0, n] * per_meter, place[1, n] * per_meter
        column, row = np.floor(x), np.floor(y)
        across, down = np.float32(x - column), np.float32(y - row)
        column, row = np.int64(column), np.int64(row)
        for i in range(shear.shape[1]):
            j, k = row + offset[1, i], column + offset[0, i]
            u, v = across + part[0, i], down + part[1, i]
            if u >= 1:
                k, u = k + 1, u - np.float32(1)
            if v >= 1:
                j, v = j + 1, v - np.float32(1)
            a, b = np.uint64(j & LAST), np.uint64(k & LAST)
            upper = pixels[a, b] + u * (pixels[a, b + one] - pixels[a, b])
            lower = pixels[a + one, b] + u * (pixels[a + one, b + one] - pixels[a + one, b])
            shear[n, i] += upper + v * (lower - upper)


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
