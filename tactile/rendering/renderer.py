"""The renderer: position and force in, volts out, block by block.

Partial m of the surface sounds at f_m = k_m·v/2π (signed) as the finger moves at v, and contactor
i at x_i is to be sheared by Re a_m exp j(k_m·(p + x_i) + φ_m), rolled off above 1 kHz. That is
separable, so a block of samples is a product of matrices,

    shear = (exp(jΦ) ∘ W) @ E,    Φ = k·p per sample (S × M),    E = a exp j(k·x + φ) (M × N).

Phases are counted in float64, reduced, and looked up in a table of 8192 phasors (−73 dB, in what
is commanded and played alike). The
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
from tactile.errors import InputError
from tactile.rendering import equalizer
from tactile.rendering.contact import Trajectory
from tactile.rendering.limiter import Limiter
from tactile.rendering.shear import EventField, Law
from tactile.texture.surface import Partials, Texture

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

NODE = 8
"""Samples between nodes of the roll-off, and behind each sample that give its velocity."""
HISTORY = 2 * NODE
CHUNK = BLOCK = 64
PHASORS = 8192
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
        steps = wave_vector.T * (PHASORS / (2 * np.pi))
        self._steps = np.vstack([steps, np.full(len(wave_vector), ROUNDER)])
        self._scratch: dict[int, tuple[Floats, NDArray[np.int64], NDArray[np.complex64]]] = {}

    def __call__(self, place: Floats) -> NDArray[np.complex64]:
        """Return (S, M) phasors at places (3, S), x, y and 1; the next call uses it again."""
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
    """Weights of the partials that the finger's speed brings out of the band."""

    def __init__(self, wave_vector: Floats) -> None:
        self._cycles = wave_vector.T / (2 * np.pi)
        self._table = equalizer.roll_off(np.arange(ENTRIES + 1, dtype=np.float64) * GRID)
        self._table = self._table.astype(np.float32)
        highest = float(np.linalg.norm(self._cycles, axis=0).max(initial=0.0))
        self.slow_squared = (equalizer.PASS_BAND / max(highest, 1e-9)) ** 2
        """Square of the speed [m²/s²] up to which no partial leaves the band."""
        self._ramps: dict[tuple[int, int], Singles] = {}

    def __call__(self, velocity: Floats, start: int) -> Singles:
        """Return weights (S, M) of samples start … start + S − 1.

        They are read at nodes, multiples of `NODE` in the stream, and ramped between them a node
        late, so that no later velocity is needed. ``velocity`` (2, `HISTORY` + S) [m/s] begins
        two nodes before the samples.
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
    limiter : the `Limiter` that volts leave through, with its counts
    filter : the `InverseFilter` in use
    frequency, attainable : (F,) [Hz] and (L, N, F) peak shear [m] of a sinusoid at the voltage
        limit, per force of the finger's table and contactor
    invalid_samples : samples that were not finite or beyond reason; the last good position is held,
        the force taken as zero, a waveform's as zero

    Raises
    ------
    InputError
        Where the sample rate is below twice the band, or beyond reason.
    """

    def __init__(
        self, display: Display, texture: Texture, *, sample_rate: float = 8000.0, seed: int = 0
    ) -> None:
        if not equalizer.LOWEST_RATE <= sample_rate <= FASTEST:
            raise InputError(
                f"sample_rate {sample_rate:g} Hz: must be {equalizer.LOWEST_RATE:g} … "
                f"{FASTEST:g} Hz"
            )
        surface = texture.realize(seed)
        self._contactors = contactors = display.contactors
        partials = surface.partials
        self._law, self._sample_rate = Law(texture.descriptor), sample_rate
        self._slopes: dict[tuple[int, bool], Floats] = {}
        self._waves = _Waves((partials + surface.envelope).wave_vector)
        self._roll_off = _RollOff(partials.wave_vector)
        mean = np.exp(-np.sum(surface.envelope.amplitude**2) / 2)
        self._to_shear = _interleaved(_at_contactors(partials, contactors) * mean)
        self._to_envelope = _interleaved(_at_contactors(surface.envelope, contactors))
        self._axes = display.shear_axes if display.projected else None
        self._events = None
        if len(surface.event_peak):
            self._events = EventField(surface, texture.descriptor.events, contactors)
        frequency = np.arange(0, equalizer.STOP_BAND + 1, equalizer.GRID)
        response = display.responses(frequency, sample_rate)
        self.filter = equalizer.design(response, display.limits.voltage, sample_rate)
        self._equalizer = equalizer.Equalizer(
            self.filter, kind=display.kind, polarity=display.polarity, forces=display.load_forces
        )
        self.limiter = _limiter(display, sample_rate)
        self._fade, self._fade_step = 1.0, 0.0
        self._fade_rate = 1 / (display.limits.fade * sample_rate)
        self.delay = self.filter.delay + self.limiter.delay
        self.frequency = frequency
        self.attainable = equalizer.attainable(response[:, display.kind], display.limits.voltage)
        self.invalid_samples = self._count = 0
        self._past, self._waiting = np.zeros((6, HISTORY)), np.zeros((6, 0))
        self._late = np.zeros((self.delay, len(contactors)), np.float32)
        self._nothing = self._waveform = np.zeros((0, len(contactors)))

    def fade_in(self) -> None:
        """Let shear rise from nothing within the display's fade, from the next sample on."""
        self._fade, self._fade_step = 0.0, self._fade_rate

    def fade_out(self) -> None:
        """Let shear fall to nothing within the display's fade, and stay there."""
        self._fade_step = -self._fade_rate

    @overload
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: ArrayLike | None = None,
        shear: Literal[False] = False,
    ) -> Floats: ...
    @overload
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: ArrayLike | None = None,
        shear: Literal[True],
    ) -> tuple[Floats, Floats]: ...
    def block(
        self,
        position: ArrayLike,
        normal_force: ArrayLike,
        *,
        waveform: ArrayLike | None = None,
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
        touch = np.zeros((6, len(np.asarray(position))))
        touch[:2], touch[2], touch[3] = np.transpose(position), 1.0, normal_force
        if not np.abs(touch).max(initial=0.0) < FARTHEST:
            touch = self._mended(touch)
        count = touch.shape[1]
        added = self._nothing if waveform is None else self._added(waveform, count)
        if count <= CHUNK:
            drive, target = self._chunk(touch, added)
            return (drive, target.astype(np.float64)) if shear else drive
        parts = [
            self._chunk(touch[:, k : k + CHUNK], added[k : k + CHUNK])
            for k in range(0, count, CHUNK)
        ]
        drive = np.concatenate([part[0] for part in parts])
        if not shear:
            return drive
        return drive, np.concatenate([part[1] for part in parts]).astype(np.float64)

    def _added(self, waveform: ArrayLike, count: int) -> Floats:
        wave = np.asarray(waveform, np.float64)
        wave = wave[:, None] if wave.ndim == 1 else wave
        return self._finite(np.broadcast_to(wave, (count, len(self._contactors))))

    def _chunk(self, touch: Floats, waveform: Floats) -> tuple[Floats, Singles]:
        """Render at most `CHUNK` samples.

        The stream's first 9 samples are waited for, since together they give its first velocity.
        What falls before the stream's beginning is 0 V.
        """
        count, begun = touch.shape[1], self._count > NODE
        self._count += count
        if not begun:
            touch = self._waiting = np.concatenate([self._waiting, touch], axis=1)
            waveform = self._waveform = np.concatenate([self._waveform, waveform])
        if self._count > NODE:
            shear = self._shear(touch, waveform, begun)
            volts = self._equalizer(shear, touch[3])
            if not begun:
                volts[:NODE] = 0.0
            self._late = np.concatenate([self._late, shear])
        else:
            volts = np.zeros((count, len(self._contactors)), np.float32)
        shear, self._late = self._late[:count], self._late[count:]
        return self.limiter(volts[len(volts) - count :]), shear

    def _shear(self, touch: Floats, waveform: Floats, begun: bool) -> Singles:
        """Return what each contactor is to do (S, N) [m]."""
        past = self._past if begun else np.zeros((6, HISTORY))
        line = np.concatenate([past, touch], axis=1)
        self._past = line[:, -HISTORY:]
        line[4:, HISTORY:] = line[:2] @ self._slope(touch.shape[1], begun)
        squares = line[4:] * line[4:]
        squares = squares[0] + squares[1]
        phasors = self._waves(line[:3, HISTORY:])
        sides, split = phasors.view(np.float32), len(self._to_shear)
        if not squares.max() <= self._roll_off.slow_squared:
            start = self._count - touch.shape[1]
            phasors[:, : split // 2] *= self._roll_off(line[4:], start)
        shear = sides[:, :split] @ self._to_shear
        if len(self._to_envelope):
            shear *= np.exp(sides[:, split:] @ self._to_envelope)
        if self._events is not None:
            shear += self._events.at(touch[:2])
        shear *= self._scale(line[4:, HISTORY:], squares[HISTORY:], touch[3])
        if waveform.size:
            shear += waveform
        if self._fade_step or self._fade < 1:
            shear *= self._faded(len(shear))[:, None]
        return np.asarray(shear)

    def _faded(self, count: int) -> Singles:
        """Return the fade's weights (S,), half a cosine from 0 to 1."""
        ramp = np.clip(self._fade + self._fade_step * np.arange(count), 0, 1)
        self._fade = float(np.clip(self._fade + self._fade_step * count, 0, 1))
        if self._fade == (self._fade_step > 0):
            self._fade_step = 0.0
        return np.asarray((1 - np.cos(np.pi * ramp)) / 2, np.float32)

    def _slope(self, count: int, begun: bool) -> Floats:
        """Return what turns places (2, `HISTORY` + S) into the velocity (2, S) of the new ones.

        It is that of a parabola through the last 8 samples of each; in the stream's first 8
        samples that of the parabola through these.
        """
        if (count, begun) not in self._slopes:
            slope = np.zeros((HISTORY + count, count))
            for k in range(count):
                last = NODE if k < NODE and not begun else k
                points = last - np.array([NODE, NODE // 2, 0])
                weights = np.linalg.solve(np.vander(points - k, increasing=True).T, [0, 1, 0])
                slope[HISTORY + points, k] = weights * self._sample_rate
            self._slopes[count, begun] = slope
        return self._slopes[count, begun]

    def _scale(self, velocity: Floats, squares: Floats, normal_force: Floats) -> Singles:
        """Return the laws' factor per sample, (S, 1), or (S, N) where shear is projected."""
        factor = self._law(squares, normal_force)[:, None]
        if self._axes is not None:
            unit = velocity / np.sqrt(squares + STILL**2)
            factor = (self._axes @ unit).T * factor
        return factor.astype(np.float32)

    def _mended(self, touch: Floats) -> Floats:
        """Hold the last good position, and lift the finger, where a sample is invalid."""
        touch, last = touch.copy(), self._past[:, -1]
        for sample in touch.T:
            if not (np.abs(sample) < FARTHEST).all():
                sample[:4] = last[0], last[1], 1.0, 0.0
                self.invalid_samples += 1
            last = sample
        return touch

    def _finite(self, waveform: Floats) -> Floats:
        good = np.abs(waveform) < FARTHEST
        self.invalid_samples += waveform.size - int(np.count_nonzero(good))
        return np.where(good, waveform, 0.0)


def _limiter(display: Display, sample_rate: float) -> Limiter:
    limits = display.limits
    return Limiter(
        limits.voltage,
        display.slew / sample_rate,
        sample_rate=sample_rate,
        channels=len(display.contactors),
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
