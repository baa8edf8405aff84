"""The renderer: position and force in, volts out, block by block.

Partial m of the surface sounds at f_m = k_m·v/2π (signed) as the finger moves at v, and contactor
i at x_i is to be sheared by Re a_m exp j(k_m·(p + x_i) + φ_m), rolled off above 1 kHz. That is
separable, so a block of samples is a product of matrices,

    shear = (exp(jΦ) ∘ W) @ E,    Φ = k·p per sample (S × M),    E = a exp j(k·x + φ) (M × N).

Phases are counted in float64, reduced, and looked up in a table of 32768 phasors (−85 dB). The
roll-off W follows the velocity at nodes every 8 samples of the stream, ramped between them; while
the finger is too slow for any partial to leave the band it is one. The envelope multiplies, sparse
events and streamed waveforms add, the laws of speed and force multiply; then the `Equalizer` turns
shear into volts and the `Limiter` lets them out. Nothing depends on how the stream is cut.
"""

from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.display import Display
from tactile.rendering import equalizer
from tactile.rendering.contact import Trajectory
from tactile.rendering.limiter import Limiter
from tactile.rendering.shear import EventField, law
from tactile.texture.surface import Partials, Texture

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

NODE = 8
"""Samples between nodes of the roll-off, and behind each sample that give its velocity."""
HISTORY = 3 * NODE
CHUNK = BLOCK = 64
PHASORS = 32768
PHASOR_TABLE = np.exp(2j * np.pi * np.arange(PHASORS) / PHASORS).astype(np.complex64)
ROUNDER = 1.5 * 2.0**52
"""Added to a float64 it leaves the nearest integer in the low bits (IEEE 754)."""
GRID = 0.1
"""Hz between entries of the roll-off's table."""
ENTRIES = round(equalizer.STOP_BAND / GRID)
STILL = 1e-4
"""m/s; below it a projected direction fades out."""
FARTHEST = 1e3
"""m and N from which on a sample is taken as invalid."""
FASTEST = 200e3
"""Hz."""


@dataclass(frozen=True)
class Rendering:
    """A rendered trajectory; drive and shear are aligned.

    Attributes
    ----------
    drive : (S, N) [V], contactors in the display's order
    shear : (S, N) [m], what the skin should do at ``time`` when drive plays from sample 0
    time : (S,) [s]
    position : (S, 2) of the finger [m]
    sample_rate : [Hz]
    limited_samples : how many samples the limiter turned down
    """

    drive: Floats
    shear: Floats
    time: Floats
    position: Floats
    sample_rate: float
    limited_samples: int


def _interleaved(phasor: NDArray[np.complex128]) -> Singles:
    """Return (2M, N) so that z (S, M) complex, viewed as (S, 2M) real, @ it is Re(z @ phasor)."""
    rows = np.empty((2 * len(phasor), phasor.shape[1]), np.float32)
    rows[0::2], rows[1::2] = phasor.real, -phasor.imag
    return rows


def _at_contactors(partials: Partials, contactors: Floats) -> NDArray[np.complex128]:
    """Return a exp j(k·x + φ), (M, N)."""
    phase = partials.wave_vector @ contactors.T + partials.phase[:, None]
    return np.asarray(partials.amplitude[:, None] * np.exp(1j * phase))


class _Waves:
    """exp(jk·p) of a set of waves at many places, through the phasor table."""

    def __init__(self, wave_vector: Floats) -> None:
        self._steps = np.ascontiguousarray(wave_vector.T * (PHASORS / (2 * np.pi)))
        self._scratch: dict[int, tuple[Floats, NDArray[np.complex64]]] = {}

    def __call__(self, place: Floats) -> NDArray[np.complex64]:
        """Return (S, M) phasors at places (S, 2); the array is used again by the next call."""
        count = len(place)
        if count not in self._scratch:
            shape = (count, self._steps.shape[1])
            self._scratch[count] = np.empty(shape), np.empty(shape, np.complex64)
        steps, phasors = self._scratch[count]
        np.matmul(place, self._steps, out=steps)
        steps += ROUNDER
        index = steps.view(np.int64)
        index &= PHASORS - 1
        return np.take(PHASOR_TABLE, index, out=phasors, mode="clip")


class _RollOff:
    """Weights of the partials that the finger's speed brings out of the band."""

    def __init__(self, wave_vector: Floats) -> None:
        self._cycles = wave_vector.T / (2 * np.pi)
        self._highest = float(np.linalg.norm(self._cycles, axis=0).max(initial=0.0))
        self._table = equalizer.roll_off(np.arange(ENTRIES + 1, dtype=np.float64) * GRID).astype(np.float32)
        self._ramps: dict[tuple[int, int], Singles] = {}

    def __call__(self, velocity: Floats, count: int, start: int) -> Singles | None:
        """Return weights (S, M), or None where all are one.

        ``velocity`` (nodes, 2) [m/s] is that at the `_nodes` of samples start … start + S − 1.
        """
        if float(np.abs(velocity).max()) * np.sqrt(2) * self._highest <= equalizer.PASS_BAND:
            return None
        frequency = np.abs(velocity @ self._cycles)
        index = np.minimum(frequency * (1 / GRID), ENTRIES).astype(np.intp)
        return np.asarray(self._ramp(count, start % NODE) @ self._table.take(index))

    def _ramp(self, count: int, phase: int) -> Singles:
        if (count, phase) not in self._ramps:
            place = (phase + np.arange(count)) / NODE
            hat = 1 - np.abs(place[:, None] - np.arange(int(place[-1]) + 2))
            self._ramps[count, phase] = np.maximum(hat, 0).astype(np.float32)
        return self._ramps[count, phase]


def _nodes(count: int, start: int) -> NDArray[np.intp]:
    """Return, counted from the block's first sample, the nodes whose ramp covers the block.

    The ramp runs a node behind, so that the last one is no later than the block's last sample.
    """
    phase = start % NODE
    return np.arange((phase + count - 1) // NODE + 2) * NODE - NODE - phase


class _Envelope:
    """The positive envelope exp(g − ⟨g²⟩) of amplitude modulation, at each contactor."""

    def __init__(self, display: Display, slow: Partials) -> None:
        self._waves = _Waves(slow.wave_vector)
        self._rows = _interleaved(_at_contactors(slow, display.contactors))
        self._variance = np.float32(np.sum(slow.amplitude**2) / 2)

    def __call__(self, place: Floats) -> Singles:
        """Return factors (S, N) at places (S, 2)."""
        exponent = self._waves(place).view(np.float32) @ self._rows - self._variance
        return np.asarray(np.exp(exponent))


class Renderer:
    """Renders one texture on one display, sample by sample in step with the finger.

    Parameters
    ----------
    display, texture : what to render on, and what
    sample_rate : of the drive [Hz]
    seed : of the surface's realization

    Attributes
    ----------
    delay : samples by which `block` lags its input
    limiter : the `Limiter` that volts leave through; it counts, and fades
    filter : the `InverseFilter` in use
    invalid_samples : samples that were not finite or beyond reason; the last good position is held,
        the force taken as zero, a waveform's as zero

    Raises
    ------
    ValueError
        Where the sample rate is below twice the band.
    """

    def __init__(
        self, display: Display, texture: Texture, *, sample_rate: float = 8000.0, seed: int = 0
    ) -> None:
        if not 2 * equalizer.FREE_BAND <= sample_rate <= FASTEST:
            raise ValueError(
                f"sample_rate {sample_rate:g} Hz: must be {2 * equalizer.FREE_BAND:g} … "
                f"{FASTEST:g} Hz"
            )
        surface = texture.realize(seed)
        partials, contactors = surface.partials, display.contactors
        self._descriptor, self._sample_rate = texture.descriptor, sample_rate
        self._waves, self._roll_off = _Waves(partials.wave_vector), _RollOff(partials.wave_vector)
        self._to_shear = _interleaved(_at_contactors(partials, contactors))
        self._axes = display.shear_axes if display.projected else None
        self._envelope = self._events = None
        if len(surface.envelope.amplitude):
            self._envelope = _Envelope(display, surface.envelope)
        if len(surface.event_peak):
            self._events = EventField(surface, texture.descriptor.events)
        frequency = np.arange(0, equalizer.STOP_BAND + 1, equalizer.GRID)
        response = display.responses(frequency, sample_rate)
        self.filter = equalizer.design(response, display.limits.voltage, sample_rate)
        self._equalizer = equalizer.Equalizer(
            self.filter, kind=display.kind, polarity=display.polarity, forces=display.load_forces
        )
        self._contactors, self.limiter = contactors, _limiter(display, sample_rate)
        self.delay = self.filter.delay + self.limiter.delay
        self.invalid_samples = self._count = 0
        self._past, self._late = np.zeros((HISTORY, 3)), np.zeros((self.delay, len(contactors)))

    @overload
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: Floats | None = None,
        shear: Literal[False] = False,
    ) -> Floats: ...
    @overload
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: Floats | None = None,
        shear: Literal[True],
    ) -> tuple[Floats, Floats]: ...
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: Floats | None = None,
        shear: bool = False,
    ) -> Floats | tuple[Floats, Floats]:
        """Render the next samples.

        Parameters
        ----------
        position : (S, 2) of the finger [m]
        normal_force : (S,) [N]
        waveform : (S,) or (S, N) shear [m] to add to the surface's, such as a transient
        shear : also return what the skin is to do

        Returns
        -------
        drive : (S, N) ndarray
            Volts, limited, ``delay`` samples late; contactors in the display's order.
        shear : (S, N) ndarray
            Shear displacement [m] that this drive commands, equally late. Only on request.
        """
        touch = np.column_stack([position, normal_force]).astype(np.float64, copy=False)
        parts = []
        for k in range(0, len(touch), CHUNK):
            added = None if waveform is None else waveform[k : k + CHUNK]
            parts.append(self._chunk(touch[k : k + CHUNK], added))
        if len(parts) == 1:
            return parts[0] if shear else parts[0][0]
        nothing = np.zeros((0, len(self._contactors)))
        drive = np.concatenate([nothing, *(part[0] for part in parts)])
        if not shear:
            return drive
        return drive, np.concatenate([nothing, *(part[1] for part in parts)])

    def _chunk(self, touch: Floats, waveform: Floats | None) -> tuple[Floats, Floats]:
        line = self._follow(touch)
        place, force = line[HISTORY:, :2], line[HISTORY:, 2]
        shear = self._surface(line) * self._scale(line)
        if waveform is not None:
            added = self._finite(np.asarray(waveform, np.float64))
            shear += added[:, None] if added.ndim == 1 else added
        volts = self._equalizer(shear, force)
        late = np.concatenate([self._late, shear])
        self._late = late[len(place) :]
        return self.limiter(volts), late[: len(place)]

    def _follow(self, touch: Floats) -> Floats:
        """Return the new samples behind the last `HISTORY`, with bad ones mended."""
        if not (np.abs(touch) < FARTHEST).all():
            touch = self._mended(touch)
        if self._count == 0:
            self._past[:] = touch[0]
        line = np.concatenate([self._past, touch])
        self._past = line[len(touch) :]
        self._count += len(touch)
        return line

    def _mended(self, touch: Floats) -> Floats:
        touch, last = touch.copy(), self._past[-1]
        for row in touch:
            if not (np.abs(row) < FARTHEST).all():
                row[:] = last[0], last[1], 0.0
                self.invalid_samples += 1
            last = row
        return touch

    def _finite(self, waveform: Floats) -> Floats:
        good = np.abs(waveform) < FARTHEST
        if good.all():
            return waveform
        self.invalid_samples += waveform.size - int(np.count_nonzero(good))
        return np.where(good, waveform, 0.0)

    def _surface(self, line: Floats) -> Singles:
        """Return what the surface asks of each contactor (S, N) [m], before the laws."""
        count, place = len(line) - HISTORY, line[HISTORY:, :2]
        start = self._count - count
        phasors = self._waves(place)
        nodes = HISTORY + _nodes(count, start)
        weight = self._roll_off(self._velocity(line, nodes), count, start)
        if weight is not None:
            phasors *= weight
        shear = phasors.view(np.float32) @ self._to_shear
        if self._envelope is not None:
            shear *= self._envelope(place)
        if self._events is not None:
            shear += self._events.at(place[:, None] + self._contactors)
        return np.asarray(shear)

    def _velocity(self, line: Floats, at: NDArray[np.intp]) -> Floats:
        """Return the velocity [m/s] at samples of the line, from a parabola through the last 8.

        In the stream's first 8 samples it is the parabola through these 8, as far as they are
        known, and before them there is none.
        """
        half, p = NODE // 2, line[:, :2]
        rise = 3 * p[at] - 4 * p[at - half] + p[at - NODE]
        first = HISTORY - (self._count - (len(line) - HISTORY))
        if at[0] < first + NODE:
            known = np.minimum(first + np.array([0, half, NODE]), len(line) - 1)
            a, b, c = p[known]
            begun = np.clip((at - first) / NODE, 0, 1)[:, None]
            early = (-3 * a + 4 * b - c) + begun * (4 * a - 8 * b + 4 * c)
            early[at < first] = 0.0
            rise = np.where((at < first + NODE)[:, None], early, rise)
        return np.asarray(rise * (self._sample_rate / NODE))

    def _scale(self, line: Floats) -> Floats:
        """Return the laws' factor per sample, (S, 1), or (S, N) where shear is projected."""
        velocity = self._velocity(line, np.arange(HISTORY, len(line)))
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        factor = law(self._descriptor, speed * 1e3, line[HISTORY:, 2])
        if self._axes is None:
            return factor[:, None]
        unit = velocity / np.hypot(speed, STILL)[:, None]
        return np.asarray(unit @ self._axes.T * factor[:, None])


def _limiter(display: Display, sample_rate: float) -> Limiter:
    limits = display.limits
    return Limiter(
        limits.voltage,
        limits.step(sample_rate, display.capacitance),
        sample_rate=sample_rate,
        channels=len(display.contactors),
        fade=limits.fade,
    )


def render(
    display: Display,
    texture: Texture,
    trajectory: Trajectory,
    *,
    sample_rate: float = 8000.0,
    seed: int = 0,
) -> Rendering:
    """Render a whole trajectory.

    Parameters
    ----------
    display, texture, trajectory : what to render on, what, and where the finger goes
    sample_rate : of the drive [Hz]
    seed : of the surface's realization

    Returns
    -------
    Rendering
        With drive and shear aligned: the renderer's delay is taken off both.
    """
    renderer = Renderer(display, texture, sample_rate=sample_rate, seed=seed)
    blocks = list(trajectory.blocks(sample_rate, BLOCK, extra=renderer.delay))
    sides = [renderer.block(*block, shear=True) for block in blocks]
    position = np.concatenate([block[0] for block in blocks])
    count = len(position) - renderer.delay
    return Rendering(
        drive=np.concatenate([side[0] for side in sides])[renderer.delay :],
        shear=np.concatenate([side[1] for side in sides])[renderer.delay :],
        time=trajectory.time[0] + np.arange(count) / sample_rate,
        position=position[:count],
        sample_rate=sample_rate,
        limited_samples=renderer.limiter.limited_samples,
    )
