"""Meters of a sound card: the level of each channel, and what was beyond full scale."""

import numpy as np

from tactile.arrays import Floats, Ints, Singles

FALL = 20.0 / 1.7
"""Rate at which a level falls after a peak, that of the digital peak meters of IEC 60268-18
[dB/s]."""


class Meters:
    """Meters of all channels; one thread adds frames, and any may read.

    Parameters
    ----------
    channels : int
        Number of channels.

    Attributes
    ----------
    levels : (N,) array
        Peak level of each channel now, which falls slowly [full scale].
    peaks : (N,) array
        Largest level of each channel so far, also beyond full scale [full scale].
    clipped : (N,) array of int
        Number of samples of each channel that were beyond full scale.
    invalid : int
        Number of samples that were no finite number.
    """

    def __init__(self, channels: int) -> None:
        self.levels: Floats = np.zeros(channels)
        self.peaks: Floats = np.zeros(channels)
        self.clipped: Ints = np.zeros(channels, np.int64)
        self.invalid = 0

    def take(self, frames: Singles, rate: float) -> Singles:
        """Measure frames, and return them as they may be played.

        Parameters
        ----------
        frames : (F, N) array of float32
            Frames as they came [full scale].
        rate : float
            Their rate [Hz].

        Returns
        -------
        (F, N) array of float32
            Frames from −1 to 1, with 0 in place of what is no finite number.
        """
        finite = np.isfinite(frames)
        invalid = frames.size - np.count_nonzero(finite)
        if invalid:
            self.invalid += int(invalid)
            frames = np.where(finite, frames, np.float32(0))
        sizes = np.abs(frames)
        largest = sizes.max(axis=0, initial=0.0)
        fallen = self.levels * 10 ** (-FALL * len(frames) / rate / 20)
        # arrays are replaced and not changed, for those who read them meanwhile
        self.levels = np.maximum(largest, fallen)
        self.peaks = np.maximum(largest, self.peaks)
        if largest.max(initial=0.0) > 1:
            self.clipped = self.clipped + np.count_nonzero(sizes > 1, axis=0)
            frames = np.clip(frames, -1, 1)
        return frames

    def rest(self) -> None:
        """Let all levels fall to 0, since no frames come."""
        self.levels = np.zeros_like(self.levels)


def to_decibels(level: float) -> float:
    """Return a level in decibels.

    Parameters
    ----------
    level : float
        Level [full scale].

    Returns
    -------
    float
        Level; minus infinity for silence [dBFS].
    """
    return 20 * float(np.log10(level)) if level > 0 else -np.inf
