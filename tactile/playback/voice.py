"""Voice of a client: the textures, waveforms, effects and tactile frames that it plays."""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Singles
from tactile.playback.frame_stream import FramePlayer
from tactile.playback.waveforms import WaveformQueue
from tactile.playback.waves import EffectPlayer


@dataclass
class ClientState:
    """What a client plays besides its waves.

    Attributes
    ----------
    layers : tuple of (int, float)
        Number of each selected texture, with its gain.
    gain : float
        Gain of everything that the client plays.
    sounds : bool
        Whether its textures sound.
    """

    layers: tuple[tuple[int, float], ...] = ()
    gain: float = 1.0
    sounds: bool = True


class Voice:
    """What one client plays.

    Parameters
    ----------
    sample_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.

    Attributes
    ----------
    queue : WaveformQueue
        Streamed waveforms.
    effect : EffectPlayer
        Parametric effects.
    frames : FramePlayer
        Stream of tactile frames.
    state : ClientState
        Textures and gain.
    has_left : bool
        Whether the client has left.
    """

    def __init__(self, sample_rate: float, contactors: int) -> None:
        self._rate, self._contactors = sample_rate, contactors
        self.silence()
        self.state = ClientState()
        self.has_left = False

    def silence(self) -> None:
        """Drop all waves at once, while nothing sounds."""
        self.queue = WaveformQueue(self._rate, self._contactors)
        self.effect = EffectPlayer(self._rate)
        self.frames = FramePlayer(self._rate, self._contactors)
        self._parts = self.queue, self.effect, self.frames
        self._last: Singles | None = None
        self._silent = False

    def end_waves(self) -> None:
        """Let all waves fade and drop them."""
        self.queue.clear()
        self.effect.begin(None)
        self.frames.end()

    def work(self, count: int) -> int:
        """Return the work of the next samples of its waves.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        int
            Work; 0 without waves.
        """
        return self.queue.work(count) + self.effect.work(count) + self.frames.work(count)

    def take(self, count: int) -> Singles | None:
        """Return the next samples of its waves.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) or (S, 1) array of float32 or None
            Shear [m]; None without waves.
        """
        wave = None
        for part in self._parts:
            shear = part.take(count)
            if shear is not None:
                wave = shear if wave is None else wave + shear
        self._last = wave
        if wave is not None and self._silent:
            wave = wave * _rise(count)
        self._silent = False
        return wave

    def skip(self, count: int) -> Singles | None:
        """Advance its waves in silence.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) or (S, 1) array of float32 or None
            Fade to silence [m]; None if there was no wave in the block before.
        """
        for part in self._parts:
            part.skip(count)
        last, self._last, self._silent = self._last, None, True
        return None if last is None else last[-1] * (1 - _rise(count))


def _rise(count: int) -> Singles:
    """Return a linear ramp to 1, (S, 1)."""
    return np.arange(1, count + 1, dtype=np.float32)[:, None] / np.float32(count)
