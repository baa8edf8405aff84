"""Voice of a client: the textures, waveforms, effects and tactile frames that it plays."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tactile.arrays import Singles
from tactile.playback.frame_player import FramePlayer
from tactile.playback.waveforms import WaveformQueue
from tactile.playback.waves import EffectPlayer

Begins = Sequence[tuple[int, Callable[[], object]]]
"""Samples of a block at which something begins, and what begins it."""


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

    def take(self, count: int, begins: Begins = ()) -> Singles | None:
        """Return the next samples of its waves.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        begins : sequence of (int, callable)
            Samples at which something is to be called, in ascending order.

        Returns
        -------
        (S, N) or (S, 1) array of float32 or None
            Shear [m]; None without waves.
        """
        parts = [self._next(each) for each in _cut(count, begins)]
        waves = [wave for _, wave in parts if wave is not None]
        wave: Singles | None = None
        if len(parts) == 1 and waves:
            wave = waves[0]
        elif waves:
            columns = max(part.shape[1] for part in waves)
            wave = np.concatenate([
                np.zeros((each, columns), np.float32) if part is None
                else np.broadcast_to(part, (each, columns))
                for each, part in parts
            ])  # fmt: skip
        self._last = wave
        if wave is not None and self._silent:
            wave = wave * _rise(count)
        self._silent = False
        return wave

    def _next(self, count: int) -> tuple[int, Singles | None]:
        """Return a number of samples, and the next samples of its waves; None without waves."""
        wave: Singles | None = None
        for part in self._parts:
            shear = part.take(count)
            if shear is not None:
                wave = shear if wave is None else wave + shear
        return count, wave

    def skip(self, count: int, begins: Begins = ()) -> Singles | None:
        """Advance its waves in silence.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        begins : sequence of (int, callable)
            Samples at which something is to be called, in ascending order.

        Returns
        -------
        (S, N) or (S, 1) array of float32 or None
            Fade to silence [m]; None if there was no wave in the block before.
        """
        for each in _cut(count, begins):
            for part in self._parts:
                part.skip(each)
        last, self._last, self._silent = self._last, None, True
        return None if last is None else last[-1] * (1 - _rise(count))


def _cut(count: int, begins: Begins) -> Iterator[int]:
    """Yield the lengths of the parts of a block, and call what begins between them."""
    at = 0
    for offset, begin in begins:
        if offset > at:
            yield offset - at
            at = offset
        begin()
    if count > at:
        yield count - at


def _rise(count: int) -> Singles:
    """Return a linear ramp to 1, (S, 1)."""
    return np.arange(1, count + 1, dtype=np.float32)[:, None] / np.float32(count)
