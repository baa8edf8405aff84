"""One texture on one display: the shear that it commands under each contactor, stroke by stroke.

The random part, or the map of a texture, is read from fields, whose levels follow the speed of the
finger. What is not in them, the waves of gratings and those too long for a tile, is a sum of
partials. Partial m sounds at f_m = k_m·v/2π (signed) while the finger moves at velocity v.
Contactor i at x_i is to shear the skin by Re a_m exp j(k_m·(p + x_i) + φ_m), rolled off above
1 kHz. This is separable, so that a block of samples is a product of matrices,

    shear = (exp(jΦ) ∘ W) @ E,    Φ = k·p per sample (S × M),    E = a exp j(k·x + φ) (M × N).

Phases are computed in float64, reduced, and looked up in a table of 8192 phasors (errors of −73 dB,
alike in what is commanded and in what is played). The roll-off W follows the velocity at nodes,
every 8 samples of the stream, with ramps between them; as long as the finger is too slow for any
partial to leave the band, W is 1. The envelope multiplies everything but gratings, sparse events
are added, and the laws of speed and force multiply the sum. A layer keeps no state of the stream,
so that it may be made in one process and sent to the one that plays it.
"""

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats, Singles
from tactile.display.display import Display
from tactile.rendering import equalizer
from tactile.rendering.shear import EventField, Law
from tactile.rendering.skin_stretch import FrictionLaw
from tactile.rendering.stroke import HISTORY, NODE, RESTING_SPEED, Stroke
from tactile.texture.field import FADE, THIRD, FieldReader
from tactile.texture.surface import Texture, envelope_scale

PHASORS = 8192
"""Number of phasors in the table, a power of two."""
PHASOR_TABLE = np.exp(2j * np.pi * np.arange(PHASORS) / PHASORS).astype(np.complex64)
"""Phasors of the phases 0 … 2π, evenly spaced."""
ROUNDER = 1.5 * 2.0**52
"""Number that leaves the nearest integer in the low bits of a float64 to which it is added (IEEE
754)."""
GRID = 0.1
"""Spacing of the entries in the table of the roll-off [Hz]."""
ENTRIES = round(equalizer.STOP_BAND / GRID)
"""Index of the last entry in the table of the roll-off, that of the stop band."""

FIELD_BAND = equalizer.STOP_BAND * THIRD**FADE
"""Frequency from which on a level of a field fades, so that it is gone at the stop band [Hz]. The
next level ends a third octave below, so that all waves up to 937 Hz are played at any speed."""


def _interleaved(phasor: NDArray[np.complex128]) -> Singles:
    """Return the matrix (2M, N) that gives Re(z @ phasor) from z (S, M), viewed as real (S, 2M)."""
    rows = np.empty((2 * len(phasor), phasor.shape[1]), np.float32)
    rows[0::2], rows[1::2] = phasor.real, -phasor.imag
    return rows


class _Waves:
    """Phasors exp(jk·p) of a set of waves at many places, looked up in the table."""

    def __init__(self, wave_vector: Floats) -> None:
        steps = wave_vector.T * (PHASORS / (2 * np.pi))
        self._steps = np.vstack([steps, np.full(len(wave_vector), ROUNDER)])
        self._scratch: dict[int, tuple[Floats, NDArray[np.int64], NDArray[np.complex64]]] = {}

    def __call__(self, place: Floats) -> NDArray[np.complex64]:
        """Return phasors (S, M) at places (3, S) with the rows x, y and 1.

        The array is overwritten by the next call.
        """
        count = place.shape[1]
        if count not in self._scratch:
            steps = np.empty((count, self._steps.shape[1]))
            phasors = np.empty(steps.shape, np.complex64)
            self._scratch[count] = steps, steps.view(np.int64), phasors
        steps, index, phasors = self._scratch[count]
        np.matmul(place.T, self._steps, out=steps)
        index &= PHASORS - 1
        PHASOR_TABLE.take(index, out=phasors, mode="clip")
        return phasors


class _RollOff:
    """Weights of the partials, which fall to 0 as the finger's speed takes them out of the band."""

    def __init__(self, wave_vector: Floats) -> None:
        self._cycles = wave_vector.T / (2 * np.pi)
        self._table = equalizer.roll_off(np.arange(ENTRIES + 1, dtype=np.float64) * GRID)
        self._table = self._table.astype(np.float32)
        highest = float(np.linalg.norm(self._cycles, axis=0).max(initial=0.0))
        self.slow_squared = (equalizer.PASS_BAND / max(highest, 1e-9)) ** 2
        """Square of the speed up to which no partial leaves the band [m²/s²]."""
        self._ramps: dict[tuple[int, int], Singles] = {}

    def __call__(self, velocity: Floats, start: int) -> Singles:
        """Return weights (S, M) of samples start … start + S − 1.

        The weights are computed at nodes, multiples of `NODE` in the stream, and ramp between them
        one node late, so that no later velocity is needed. ``velocity`` (2, `HISTORY` + S) [m/s]
        begins two nodes before the samples.
        """
        count, phase = velocity.shape[1] - HISTORY, start % NODE
        if (count, phase) not in self._ramps:
            place = (phase + np.arange(count)) / NODE
            hat = 1 - np.abs(place[:, None] - np.arange(int(place[-1]) + 2))
            self._ramps[count, phase] = np.maximum(hat, 0).astype(np.float32)
        ramp = self._ramps[count, phase]
        at_nodes = velocity[:, NODE - phase :: NODE][:, : ramp.shape[1]].T
        index = np.minimum(np.abs(at_nodes @ self._cycles) * (1 / GRID), ENTRIES).astype(np.intp)
        return np.asarray(ramp @ self._table.take(index))


class RealizedLayer:
    """Texture realized under each contactor of a display.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    seed : int
        Seed of the surface's realization.

    Attributes
    ----------
    friction : FrictionLaw or None
        Law of the quasi-static part, which `skin_stretch` renders; None for a texture without
        friction.
    """

    def __init__(self, display: Display, texture: Texture, *, seed: int = 0) -> None:
        realized = texture.realize(seed)
        surface, contactors = realized.beside_fields, display.contactors
        partials = surface.partials
        self._law = Law(texture.descriptor)
        with_friction = texture.descriptor.friction is not None
        self.friction = FrictionLaw(texture.descriptor) if with_friction else None
        self._waves = _Waves((partials + surface.envelope).wave_vector)
        self._roll_off = _RollOff(partials.wave_vector)
        self._bands = 2 * (len(partials.amplitude) - surface.gratings)
        self._to_shear = _interleaved(partials.phasors(contactors))
        scale = envelope_scale(surface.envelope)
        self._to_shear[: self._bands] *= scale
        self._fields = [
            FieldReader(field, contactors, band=FIELD_BAND, gain=scale) for field in realized.fields
        ]
        self._density, self._is_map = realized.density, realized.map is not None
        highest = max((field.highest for field in realized.fields), default=1.0)
        self._slow_squared = (FIELD_BAND / highest) ** 2
        self._to_envelope = _interleaved(surface.envelope.phasors(contactors))
        self._axes = display.shear_axes if display.projected else None
        self._events = None
        if len(surface.event_peak):
            self._events = EventField(surface, texture.descriptor.events, contactors)

    def __call__(self, stroke: Stroke) -> Singles:
        """Return the shear (S, N) that each contactor is to give along a stroke [m]."""
        phasors = self._waves(stroke.place)
        sides, split = phasors.view(np.float32), len(self._to_shear)
        if not stroke.squares.max() <= self._roll_off.slow_squared:
            phasors[:, : split // 2] *= self._roll_off(stroke.velocity, stroke.start)
        modulated = self._bands if len(self._to_envelope) else split
        shear = sides[:, :modulated] @ self._to_shear[:modulated]
        if self._fields:
            squares, velocity = stroke.squares[HISTORY:], stroke.velocity[:, HISTORY:]
            if self._is_map:
                squares = np.abs(velocity).sum(axis=0) ** 2
            elif self._density is not None and not squares.max() <= self._slow_squared:
                squares = self._density.met_squares(velocity, squares)
            for field in self._fields:
                field.add_to(shear, stroke.place, squares)
        if len(self._to_envelope):
            shear *= np.exp(sides[:, split:] @ self._to_envelope)
        if modulated < split:
            shear += sides[:, modulated:split] @ self._to_shear[modulated:]
        if self._events is not None:
            self._events.add_to(shear, stroke.place)
        shear *= self._scale(
            stroke.velocity[:, HISTORY:], stroke.squares[HISTORY:], stroke.normal_force
        )
        return np.asarray(shear)

    def _scale(self, velocity: Floats, squares: Floats, normal_force: Floats) -> Singles:
        """Return the factor of the laws per sample, (S, 1), or (S, N) where shear is projected."""
        factor = self._law(squares, normal_force)[:, None]
        if self._axes is not None:
            unit = velocity / np.sqrt(squares + RESTING_SPEED**2)
            factor = (self._axes @ unit).T * factor
        return factor.astype(np.float32)
