"""Rendering of one block for each kind of link: samples, or frames of a spectrum.

Neither knows the bus or the time: what they render depends on what they are passed only.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats, Singles
from tactile.bus.base import DriveBlock, DriveFrame, FrameCapability
from tactile.display.display import Display
from tactile.rendering.equalizer import EqualizerLike
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.rendering.renderer import Renderer
from tactile.rendering.spectrum import FrameLimiter, SpectrumRenderer, band_carriers
from tactile.rendering.stroke import Motion

BLOCK = 16
"""Length of a block [samples]: 2 ms at 8 kHz."""


class SamplePlayback:
    """Rendering for a bus that takes blocks of samples.

    Parameters
    ----------
    display : Display
        Display to render for.
    sample_rate : float
        Sample rate of the drive [Hz].
    inverse : EqualizerLike, optional
        What turns shear into volts, as in `Renderer`.

    Attributes
    ----------
    spacing : int
        Length of a block [samples].
    timed : int
        Position in a block of the sample whose time `times` begins with, since the output is behind
        the input that it is rendered from [samples].
    first : int
        Position in a block of the first sample in which a new contact can be noticed [samples].
    trace : (S, N) array of float
        Commanded shear of the last block [m].
    shear : (N,) array of float
        Last commanded shear [m].
    drive : (N,) array of float
        Last drive [V].
    """

    spacing = BLOCK
    first = LOOK_AHEAD

    def __init__(
        self,
        display: Display,
        sample_rate: float,
        inverse: EqualizerLike | None = None,
    ) -> None:
        self._display, self._rate = display, sample_rate
        self._renderer = Renderer(display, None, sample_rate=sample_rate, inverse=inverse)
        self.timed = self._renderer.delay
        self.trace: Floats = np.zeros((0, len(display.contactors)))
        self.shear = self.drive = np.zeros(len(display.contactors))

    def play(self, layers: Sequence[tuple[RealizedLayer | SpectrumRenderer, float]]) -> None:
        """Cross-fade to other textures.

        Parameters
        ----------
        layers : sequence of (RealizedLayer, float)
            Textures, each with its gain; textures for frames are ignored.
        """
        self._renderer.play([(t, gain) for t, gain in layers if isinstance(t, RealizedLayer)])

    @property
    def fading(self) -> bool:
        """Whether the shear has not risen yet after `fade_in`."""
        return self._renderer.fading

    def fade_in(self) -> None:
        """Let the shear rise from 0."""
        self._renderer.fade_in()

    def times(self, due: float) -> Floats:
        """Return the times for which a block is rendered.

        Parameters
        ----------
        due : float
            Time at which the sample `timed` of the block is put out [s].

        Returns
        -------
        (S,) array of float
            Times in the host's clock [s].
        """
        return np.asarray(due + np.arange(BLOCK) / self._rate)

    def render(
        self, position: int, place: Floats, force: Floats, waves: Singles | None
    ) -> DriveBlock:
        """Render a block.

        Parameters
        ----------
        position : int
            Position of the block [samples].
        place : (S, 2) array of float
            Positions of the finger [m].
        force : (S,) array of float
            Normal forces [N].
        waves : (S, N) array of float32 or None
            Shear to add [m].

        Returns
        -------
        DriveBlock
            Drive of all channels.
        """
        drive, self.trace = self._renderer.block(place, force, waveform=waves, shear=True)
        self.drive, self.shear = drive[-1], self.trace[-1]
        return DriveBlock(position, self._display.to_channels(drive))

    def leave_travel(self, watched: NDArray[np.bool_]) -> None:
        """Leave the travel of contactors to guards in an amplifier, as `Limiter` does.

        Parameters
        ----------
        watched : (N,) array of bool
            Contactors that guards watch.
        """
        self._renderer.limiter.leave_travel(watched)

    def warm_up(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is allocated.

        Parameters
        ----------
        texture : RealizedLayer or SpectrumRenderer
            Texture to use; one for frames is ignored.
        """
        if isinstance(texture, RealizedLayer):
            motion = Motion(self._rate)
            stroke = motion(motion.rows(np.zeros((BLOCK, 2)), np.zeros(BLOCK)))
            assert stroke is not None
            texture(stroke)

    def restart(self) -> None:
        """Render silence until the filters hold nothing played before, and fade in."""
        nothing = np.zeros((4 * BLOCK, 2))
        for _ in range(4):
            self._renderer.block(nothing, nothing[:, 0])
        self.fade_in()

    @property
    def limited(self) -> int:
        """Number of samples that were turned down."""
        return self._renderer.limiter.limited_samples


class FramePlayback:
    """Rendering for a bus that takes spectrum frames, which have no room for waves.

    All textures have the same carriers; their frames are added and then limited.

    Parameters
    ----------
    display : Display
        Display to render for.
    sample_rate : float
        Sample rate of the drive [Hz].
    frames : FrameCapability
        Frames that the bus takes.

    Attributes
    ----------
    spacing : int
        Distance between frames [samples].
    timed : int
        Position in a stretch of the sample whose time `times` ends with: that of the frame
        [samples].
    carriers : (K,) array of float
        Frequencies of the carriers [Hz].
    first : int
        Position in a stretch of the first sample in which a new contact can be noticed [samples].
    shear : (N,) array of float
        Commanded shear, which is not computed and stays 0 [m].
    drive : (N,) array of float
        Largest drive that the last frame can give [V].
    """

    first = 0

    def __init__(self, display: Display, sample_rate: float, frames: FrameCapability) -> None:
        self._display, self._rate = display, sample_rate
        self.spacing = self.timed = round(self._rate / frames.rate)
        self._playing: list[tuple[SpectrumRenderer, float]] = []
        rate = self._rate / self.spacing
        self.carriers = band_carriers(frames.carriers, rate, self._rate)
        self._limiter = FrameLimiter(display, self.carriers, rate, sample_rate)
        self._rise = 0.0
        self.shear = self.drive = np.zeros(len(display.contactors))

    def play(self, layers: Sequence[tuple[RealizedLayer | SpectrumRenderer, float]]) -> None:
        """Change to other textures from the next frame on, to which the envelopes ramp.

        Parameters
        ----------
        layers : sequence of (SpectrumRenderer, float)
            Textures, each with its gain; textures for samples are ignored.
        """
        self._playing = [(t, gain) for t, gain in layers if isinstance(t, SpectrumRenderer)]

    @property
    def fading(self) -> bool:
        """Whether the frame of 0 V of `fade_in` is still to come."""
        return self._rise == 0

    def fade_in(self) -> None:
        """Begin with a frame of 0 V."""
        self._rise = 0.0

    def restart(self) -> None:
        """Begin with a frame of 0 V; frames hold nothing of what was played before."""
        self.fade_in()

    def times(self, due: float) -> Floats:
        """Return the times of a stretch that ends with the next frame.

        Parameters
        ----------
        due : float
            Time at which the frame is put out [s].

        Returns
        -------
        (S,) array of float
            Times in the host's clock; the last is that of the frame [s].
        """
        steps = np.arange(self.spacing // BLOCK)[::-1]
        return np.asarray(due - steps * (BLOCK / self._rate))

    def render(
        self, position: int, place: Floats, force: Floats, waves: Singles | None
    ) -> DriveFrame:
        """Render the frame at the end of a stretch.

        Parameters
        ----------
        position : int
            Position of the stretch [samples].
        place : (S, 2) array of float
            Positions of the finger [m].
        force : (S,) array of float
            Normal forces [N].
        waves : (S, N) array of float32 or None
            Ignored.

        Returns
        -------
        DriveFrame
            Drive of all channels.
        """
        frame_position = position + self.spacing
        step = min(8, len(place) - 1)
        velocity = (place[-1] - place[-1 - step]) * self._rate / (BLOCK * max(step, 1))
        lines = np.zeros((self._display.channels, len(self.carriers)), np.complex128)
        total = np.zeros((len(self._display.contactors), len(self.carriers)), np.complex128)
        for texture, gain in self._playing:
            texture.sample = frame_position
            total += gain * self._rise * texture.unlimited(place[-1], velocity, float(force[-1]))
        total = self._limiter(total)
        lines[self._display.channel] = total
        self._rise = 1.0
        self.drive = np.asarray(np.abs(total).sum(axis=1))
        return DriveFrame(frame_position, lines)

    def warm_up(self, texture: RealizedLayer | SpectrumRenderer) -> None:
        """Use a texture once, so that its memory is allocated.

        Parameters
        ----------
        texture : RealizedLayer or SpectrumRenderer
            Texture to use; one for samples is ignored.
        """
        if isinstance(texture, SpectrumRenderer):
            texture.unlimited(np.zeros(2), np.zeros(2), 0.0)

    @property
    def limited(self) -> int:
        """Number of frames that were turned down."""
        return self._limiter.limited_frames
