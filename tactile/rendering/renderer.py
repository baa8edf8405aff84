"""The renderer: position and force in, volts out, block by block.

The finger's places become strokes (`stroke`), each texture's `RealizedLayer` turns these into
shear, and layers, each with its gain, what friction stretches the skin by (`skin_stretch`) and
streamed waveforms add up; then the `Equalizer` turns shear into volts and the `Limiter` lets them
out. Layers may be changed while it plays: new ones fade in as old ones fade out. Nothing depends on
how the stream is cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats, Singles
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.rendering import equalizer
from tactile.rendering.contact import Trajectory
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.limiter import Limiter
from tactile.rendering.skin_stretch import Bristles, Stretch
from tactile.rendering.stroke import FARTHEST, NODE, Motion, Stroke
from tactile.texture.surface import Texture

CHUNK = BLOCK = 64
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


class Ramp:
    """A gain that goes from value to value by half a cosine.

    Parameters
    ----------
    step : of the way, per sample
    value : to begin with
    """

    def __init__(self, step: float, value: float) -> None:
        self._step, self._from, self._to, self._way = step, value, value, 1.0

    def to(self, value: float) -> None:
        """Go to a value, from where it is now."""
        self._from, self._to, self._way = self._at(self._way), value, 0.0

    def after(self, samples: int) -> float:
        """Return the gain some samples after the next."""
        return self._to if self._way == 1 else self._at(min(self._way + self._step * samples, 1.0))

    def _at(self, way: float) -> float:
        return self._from + (self._to - self._from) * (1 - float(np.cos(np.pi * way))) / 2

    @property
    def silent(self) -> bool:
        """Whether it is 0 and stays there."""
        return self._way == 1 and self._to == 0

    def __call__(self, shear: Singles) -> Singles:
        """Return shear (S, N) scaled by the next S values."""
        if self._way == 1:
            return shear if self._to == 1 else np.asarray(shear * np.float32(self._to))
        way = np.minimum(self._way + self._step * np.arange(len(shear)), 1.0)
        self._way = float(min(self._way + self._step * len(shear), 1.0))
        gain = self._from + (self._to - self._from) * (1 - np.cos(np.pi * way)) / 2
        return np.asarray(shear * gain[:, None].astype(np.float32))


class Renderer:
    """Renders textures on one display, sample by sample in step with the finger.

    Parameters
    ----------
    display, texture : what to render on, and what; None for nothing yet
    sample_rate : of the drive [Hz]
    seed : of the surface's realization

    Attributes
    ----------
    delay : samples by which `block` lags its input
    limiter : the `Limiter` that volts leave through, with its counts
    filter : the `InverseFilter` in use
    frequency, attainable : (F,) [Hz] and (L, N, F) peak shear [m] of a sinusoid at the voltage
        limit, per force of the finger's table and contactor

    Raises
    ------
    InputError
        Where the sample rate is below twice the band, or beyond reason.
    """

    def __init__(
        self,
        display: Display,
        texture: Texture | None,
        *,
        sample_rate: float = 8000.0,
        seed: int = 0,
    ) -> None:
        if not equalizer.LOWEST_RATE <= sample_rate <= FASTEST:
            raise InputError(
                f"sample_rate {sample_rate:g} Hz: must be {equalizer.LOWEST_RATE:g} … "
                f"{FASTEST:g} Hz"
            )
        self._contactors = len(display.contactors)
        self._motion = Motion(sample_rate)
        frequency = np.arange(0, equalizer.STOP_BAND + 1, equalizer.GRID)
        response = display.responses(frequency, sample_rate)
        self.filter = equalizer.design(response, display.limits.voltage, sample_rate)
        self._equalizer = equalizer.Equalizer(
            self.filter, kind=display.kind, polarity=display.polarity, forces=display.load_forces
        )
        self.limiter = _limiter(display, sample_rate)
        self._fade_step = 1 / (display.limits.fade * sample_rate)
        self._fade = Ramp(self._fade_step, 1.0)
        self._layers: list[tuple[RealizedLayer, Ramp]] = []
        self._rubbing: list[tuple[Bristles, Ramp]] = []
        if texture is not None:
            self._add(RealizedLayer(display, texture, seed=seed), Ramp(self._fade_step, 1.0))
        self.delay = self.filter.delay + self.limiter.delay
        self.frequency = frequency
        self.attainable = equalizer.attainable(response[:, display.kind], display.limits.voltage)
        at_rest = self.attainable[:, :, 0].min(axis=1)
        self._stretch = Stretch(display, at_rest, sample_rate, CHUNK + NODE)
        self._invalid = 0
        self._late = np.zeros((self.delay, self._contactors), np.float32)
        self._nothing = self._waveform = np.zeros((0, self._contactors))

    @property
    def invalid_samples(self) -> int:
        """Samples that were not finite or beyond reason.

        The last good position is held, the force taken as zero, a waveform's sample as zero.
        """
        return self._motion.invalid_samples + self._invalid

    def fade_in(self) -> None:
        """Let shear rise from nothing within the display's fade, from the next sample on."""
        self._fade = Ramp(self._fade_step, 0.0)
        self._fade.to(1.0)

    def fade_out(self) -> None:
        """Let shear fall to nothing within the display's fade, and stay there."""
        self._fade.to(0.0)

    def play(self, layers: Sequence[tuple[RealizedLayer, float]]) -> None:
        """Go over to other layers, each with its gain, within the display's fade.

        A layer that plays already goes on, at its new gain.
        """
        gains = {id(layer): gain for layer, gain in layers}
        for layer, ramp in self._layers:
            ramp.to(gains.pop(id(layer), 0.0))
        for layer, gain in layers:
            if id(layer) in gains:
                ramp = Ramp(self._fade_step, 0.0)
                ramp.to(gain)
                self._add(layer, ramp)

    def _add(self, layer: RealizedLayer, ramp: Ramp) -> None:
        self._layers.append((layer, ramp))
        if layer.friction is not None:
            self._rubbing.append((Bristles(layer.friction), ramp))

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
        touch = self._motion.taken(position, normal_force)
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
        return self._finite(np.broadcast_to(wave, (count, self._contactors)))

    def _finite(self, waveform: Floats) -> Floats:
        good = np.abs(waveform) < FARTHEST
        self._invalid += waveform.size - int(np.count_nonzero(good))
        return np.where(good, waveform, 0.0)

    def _chunk(self, touch: Floats, waveform: Floats) -> tuple[Floats, Singles]:
        """Render at most `CHUNK` samples; what falls before the stream's beginning is 0 V."""
        count = touch.shape[1]
        stroke = self._motion(touch)
        if len(self._waveform) or stroke is None:
            added = waveform if len(waveform) else np.zeros((count, self._contactors))
            waveform = np.concatenate([self._waveform, added])
        self._waveform = waveform if stroke is None else self._nothing
        if stroke is None:
            volts = np.zeros((count, self._contactors), np.float32)
        else:
            shear = self._shear(stroke, waveform)
            volts = self._equalizer(shear, stroke.normal_force)
            if not stroke.start:
                volts[:NODE] = 0.0
            self._late = np.concatenate([self._late, shear])
        shear, self._late = self._late[:count], self._late[count:]
        return self.limiter(volts[len(volts) - count :]), shear

    def _shear(self, stroke: Stroke, waveform: Floats) -> Singles:
        """Return what each contactor is to do (S, N) [m]."""
        stretch = self._stretch(stroke, self._rubbing)  # before the ramps go on
        parts = [ramp(layer(stroke)) for layer, ramp in self._layers]
        shear = (
            parts[0]
            if parts
            else np.zeros((len(stroke.normal_force), self._contactors), np.float32)
        )
        for part in parts[1:]:
            shear = shear + part
        if any(ramp.silent for _, ramp in self._layers):
            self._layers = [(layer, ramp) for layer, ramp in self._layers if not ramp.silent]
            self._rubbing = [
                (bristles, ramp) for bristles, ramp in self._rubbing if not ramp.silent
            ]
        if stretch is not None:
            shear += stretch
        if waveform.size:
            shear += waveform
        return self._fade(shear)


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
