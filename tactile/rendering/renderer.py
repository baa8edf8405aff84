"""Renderer: finger position and force in, drive voltage out, block by block.

`Motion` turns the finger's positions into strokes (`stroke`), and the `RealizedLayer` of each
texture turns these into shear. The sum of all layers, each with its gain, of the skin stretch due
to friction (`skin_stretch`) and of streamed waveforms is what is commanded. The `Equalizer`
converts it to volts, which leave through the `Limiter`. Layers may be changed during playback: new
ones fade in as old ones fade out. The result does not depend on how the stream is cut into blocks.
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
from tactile.rendering.free_tip import free_tip_of, travel_voltage
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.limiter import Limiter
from tactile.rendering.skin_stretch import Bristles, Stretch
from tactile.rendering.stroke import FARTHEST, NODE, Motion, Stroke
from tactile.texture.surface import Texture

CHUNK = BLOCK = 64
"""Largest number of samples that is rendered at a time, and size of the blocks of `render`."""
FASTEST = 200e3
"""Highest sample rate that is accepted [Hz]."""


@dataclass(frozen=True)
class Rendering:
    """Rendered trajectory, with drive and shear aligned in time.

    Attributes
    ----------
    drive : (S, N) array of float
        Drive, contactors in the display's order [V].
    shear : (S, N) array of float
        Shear that the skin should have at ``time`` if the drive plays from sample 0 [m].
    time : (S,) array of float
        Times of the samples [s].
    position : (S, 2) array of float
        Positions of the finger [m].
    sample_rate : float
        Sample rate [Hz].
    limited_samples : int
        Number of samples that the limiter turned down; nothing else can be lost without a device.
    """

    drive: Floats
    shear: Floats
    time: Floats
    position: Floats
    sample_rate: float
    limited_samples: int


class Ramp:
    """Gain that moves from value to value along half a cosine.

    Parameters
    ----------
    step : float
        Part of a transition that one sample makes, 0 … 1.
    value : float
        Initial gain.
    """

    def __init__(self, step: float, value: float) -> None:
        self._step, self._from, self._to, self._way = step, value, value, 1.0

    def to(self, value: float) -> None:
        """Start a transition from the present gain.

        Parameters
        ----------
        value : float
            Gain to reach.
        """
        self._from, self._to, self._way = self._at(self._way), value, 0.0

    def after(self, samples: int) -> float:
        """Return the gain at a later sample.

        Parameters
        ----------
        samples : int
            Number of samples after the next one.

        Returns
        -------
        float
            Gain at that sample.
        """
        return self._to if self._way == 1 else self._at(min(self._way + self._step * samples, 1.0))

    def _at(self, way: float) -> float:
        """Return the gain at a part of the transition, 0 … 1."""
        return self._from + (self._to - self._from) * (1 - float(np.cos(np.pi * way))) / 2

    @property
    def silent(self) -> bool:
        """Whether the gain is 0 and stays there."""
        return self._way == 1 and self._to == 0

    @property
    def full(self) -> bool:
        """Whether the gain is 1 and stays there."""
        return self._way == 1 and self._to == 1

    def __call__(self, shear: Singles) -> Singles:
        """Return shear (S, N), scaled by the next S gains, and advance by as many samples."""
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
    display : Display
        Display to render for.
    texture : Texture or None
        Texture to render from the first sample on; None for none yet.
    sample_rate : float
        Sample rate of the drive [Hz].
    seed : int
        Seed of the surface's realization.
    inverse : EqualizerLike, optional
        What turns shear into volts in place of the inverse ``filter``, of the N contactors.

    Attributes
    ----------
    delay : int
        Delay of `block` from input to output [samples].
    limiter : Limiter
        Limiter that the drive leaves through, with its counts.
    filter : InverseFilter
        Inverse of the display's own response.
    frequency : (F,) array of float
        Frequencies of ``attainable`` [Hz].
    attainable : (L, N, F) array of float
        Peak shear of a sinusoid at the voltage limit, or at the smaller drive that a free tip
        survives, per force of the finger's table, contactor and frequency [m].

    Raises
    ------
    InputError
        If the sample rate is below twice the band or too high.

    Examples
    --------
    Ten milliseconds of a stroke at 80 mm/s, which are played 2 ms late:

    >>> import numpy as np
    >>> import tactile
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> renderer = tactile.Renderer(display, texture)
    >>> position = np.outer(np.arange(80) * 0.08 / 8000, [1.0, 0.0])
    >>> renderer.block(position, np.full(80, 0.5)).shape, renderer.delay / 8000
    ((80, 24), 0.002)
    """

    def __init__(
        self,
        display: Display,
        texture: Texture | None,
        *,
        sample_rate: float = 8000.0,
        seed: int = 0,
        inverse: equalizer.EqualizerLike | None = None,
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
        self._equalizer = inverse or equalizer.Equalizer(
            self.filter, kind=display.kind, polarity=display.polarity, forces=display.load_forces
        )
        self.limiter = limiter_of(display, sample_rate)
        self._fade_step = 1 / (display.limits.fade * sample_rate)
        self._fade = Ramp(self._fade_step, 1.0)
        self._layers: list[tuple[RealizedLayer, Ramp]] = []
        self._rubbing: list[tuple[Bristles, Ramp]] = []
        if texture is not None:
            self._add(RealizedLayer(display, texture, seed=seed), Ramp(self._fade_step, 1.0))
        self.delay = self._equalizer.delay + self.limiter.delay
        self.frequency = frequency
        volts = np.minimum(display.limits.voltage, travel_voltage(display, frequency, sample_rate))
        self.attainable = equalizer.attainable(response[:, display.kind], volts)
        at_rest = self.attainable[:, :, 0].min(axis=1)
        self._stretch = Stretch(display, at_rest, sample_rate, CHUNK + NODE)
        self._invalid = 0
        self._late = np.zeros((self.delay, self._contactors), np.float32)
        self._nothing = self._waveform = np.zeros((0, self._contactors))

    @property
    def invalid_samples(self) -> int:
        """Number of samples that were not finite or out of range.

        The last valid position is held, the force is taken as 0, and so is a waveform's sample.
        """
        return self._motion.invalid_samples + self._invalid

    @property
    def fading(self) -> bool:
        """Whether the shear is not whole yet, or not any more."""
        return not self._fade.full

    def fade_in(self) -> None:
        """Let the shear rise from 0 within the display's fade, from the next sample on."""
        self._fade = Ramp(self._fade_step, 0.0)
        self._fade.to(1.0)

    def fade_out(self) -> None:
        """Let the shear fall to 0 within the display's fade, and stay there."""
        self._fade.to(0.0)

    def play(self, layers: Sequence[tuple[RealizedLayer, float]]) -> None:
        """Cross-fade to other layers within the display's fade.

        A layer that plays already continues, and its gain moves to the new one.

        Parameters
        ----------
        layers : sequence of (RealizedLayer, float)
            Layers to play, each with its gain.
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
        """Start a layer, and its friction if it has any, with a gain."""
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
        position : (S, 2) array_like of float
            Positions of the finger [m].
        normal_force : (S,) array_like of float
            Normal forces [N].
        waveform : (S,) or (S, N) array_like of float, optional
            Shear to add to that of the surface, such as a transient [m].
        shear : bool
            Whether to return the commanded shear as well.

        Returns
        -------
        drive : (S, N) array of float
            Limited drive, ``delay`` samples late; contactors in the display's order [V].
        shear : (S, N) array of float
            Shear displacement that this drive commands, equally late [m]. Only on request.
        """
        touch = self._motion.rows(position, normal_force)
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
        """Return a waveform as a valid array (S, N) of shear [m]."""
        wave = np.asarray(waveform, np.float64)
        wave = wave[:, None] if wave.ndim == 1 else wave
        return self._finite(np.broadcast_to(wave, (count, self._contactors)))

    def _finite(self, waveform: Floats) -> Floats:
        """Return a waveform with invalid values replaced by 0, and count them."""
        good = np.abs(waveform) < FARTHEST
        self._invalid += waveform.size - int(np.count_nonzero(good))
        return np.where(good, waveform, 0.0)

    def _chunk(self, touch: Floats, waveform: Floats) -> tuple[Floats, Singles]:
        """Render at most `CHUNK` samples; samples before the stream's first stroke are 0 V."""
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
        """Return the shear that each contactor is to give (S, N) [m]."""
        stretch = self._stretch(stroke, self._rubbing)  # reads the ramps before they advance
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


def limiter_of(display: Display, sample_rate: float) -> Limiter:
    """Create the limiter of a display's drive.

    Parameters
    ----------
    display : Display
        Display that plays.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    Limiter
        Limiter of the N contactors.
    """
    return Limiter(
        display.limits.voltage,
        display.slew / sample_rate,
        sample_rate=sample_rate,
        channels=len(display.contactors),
        tip=free_tip_of(display, sample_rate),
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
    display : Display
        Display to render for.
    texture : Texture
        Texture to render.
    trajectory : Trajectory
        Path of the finger.
    sample_rate : float
        Sample rate of the drive [Hz].
    seed : int
        Seed of the surface's realization.

    Returns
    -------
    Rendering
        Drive and shear, aligned: the renderer's delay is removed from both.

    Examples
    --------
    >>> import tactile
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> stroke = tactile.Trajectory.line(speed=0.08, duration=0.1)
    >>> played = tactile.render(display, texture, stroke)
    >>> played.drive.shape, played.limited_samples
    ((800, 24), 0)
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
