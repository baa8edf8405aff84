"""What the skin is to do: the laws of speed and force, and sparse events, as shear targets."""

import numpy as np
from numpy.typing import NDArray

from tactile.texture.descriptor import Descriptor, Events
from tactile.texture.surface import Surface

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

CONTACT_FORCE = 0.05
"""N; below it the finger is leaving and shear falls to nothing at 0 N (assumed)."""
PIXELS = 2048
"""Of an event field's side: 12.5 µm on a tile of 25.6 mm."""
FWHM = 2 * np.sqrt(2 * np.log(2))


def held_power_law(
    x: Floats, reference: float, bounds: tuple[float, float], exponent: float
) -> Floats:
    """Return (x/reference)^exponent, held smoothly constant outside its bounds.

    x is first bent to stay within: x⁸ becomes 1/(1/(x⁸ + low⁸) + 1/high⁸), 0.75 dB off the law
    right at an end. Even and smooth at zero, so that a stop and a reversal change nothing.
    """

    def held(value: Floats) -> Floats:
        return np.asarray(1 / (1 / (value**8 + bounds[0] ** 8) + bounds[1] ** -8))

    return np.asarray((held(x) / held(np.asarray(reference))) ** (exponent / 8))


class Law:
    """The factor on displacement at a speed and a normal force, from two tables.

    Both of the descriptor's laws, and a smooth fall to nothing as the force goes to zero. Between
    the tables' entries, 0.9 % apart, it runs straight: within 1e-5 of an exponent of one.
    """

    def __init__(self, descriptor: Descriptor) -> None:
        laws, reference = descriptor.laws, descriptor.reference
        self._at = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 2048)])
        touch = np.minimum(self._at / CONTACT_FORCE, 1)
        self._speed = held_power_law(
            self._at, reference.speed_mm_s, laws.speed_range_mm_s, laws.speed_exponent
        )
        self._force = (touch * touch * (3 - 2 * touch)) * held_power_law(
            self._at, reference.normal_force_n, laws.force_range_n, laws.force_exponent
        )

    def __call__(self, speed: Floats, normal_force: Floats) -> Floats:
        """Return factors (S,) at speeds [m/s] and normal forces [N]."""
        by_speed = np.interp(speed * 1e3, self._at, self._speed)
        return np.asarray(by_speed * np.interp(normal_force, self._at, self._force))


class EventField:
    """Sparse events drawn once on a tile that repeats over the surface, read bilinearly.

    The narrowest event, 0.1 mm, is 8 pixels wide: the reading is within 1.1 % of its peak, one of
    0.25 mm within 0.2 %.
    """

    def __init__(self, surface: Surface, kinds: tuple[Events, ...], contactors: Floats) -> None:
        pitch = surface.tile / PIXELS
        self._per_meter = 1 / pitch
        self._offset = contactors * self._per_meter
        field = np.zeros((PIXELS, PIXELS), np.float32)
        for place, peak, kind in zip(
            surface.event_place / pitch, surface.event_peak, surface.event_kind, strict=True
        ):
            _draw(field, place, peak, kinds[kind], pitch)
        self._flat = field.ravel()

    def at(self, place: Floats) -> Singles:
        """Return displacement (S, N) [m] at each contactor for finger places (S, 2) [m]."""
        finger = np.fmod(place * self._per_meter, PIXELS)[:, :, None] + self._offset.T
        finger += 2 * PIXELS  # above zero, so that the integer part is the floor
        whole = finger.astype(np.int32)
        finger -= whole
        rest = finger.astype(np.float32)
        whole &= PIXELS - 1
        after = (whole + 1) & (PIXELS - 1)
        x, y, right = rest[:, 0], rest[:, 1], after[:, 1]
        row, below, left = whole[:, 0] * PIXELS, after[:, 0] * PIXELS, whole[:, 1]
        top = self._flat.take(row + left)
        top += y * (self._flat.take(row + right) - top)
        bottom = self._flat.take(below + left)
        bottom += y * (self._flat.take(below + right) - bottom)
        bottom -= top
        bottom *= x
        top += bottom
        return np.asarray(top)


def _draw(field: Singles, place: Floats, peak: float, kind: Events, pitch: float) -> None:
    """Add one event at a place [pixels]."""
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
