"""The finger's way as a renderer reads it: where, how fast and how hard, sample by sample.

Velocity is that of a parabola through each sample and those 4 and 8 before it, so that none later
is needed. What cannot be is mended: an invalid sample holds the last good place, without force.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats

NODE = 8
"""Samples between nodes of the roll-off, and behind each sample that give its velocity."""
HISTORY = 2 * NODE
STILL = 1e-4
"""m/s; below it a projected direction fades out."""
FARTHEST = 1e3
"""m and N from which on a sample is taken as invalid."""


@dataclass(frozen=True)
class Stroke:
    """Samples of a finger's way.

    Attributes
    ----------
    place : (3, S) x, y [m] and 1
    velocity : (2, `HISTORY` + S) [m/s], from `HISTORY` before the first sample
    squares : (`HISTORY` + S,) squared speed [m²/s²]
    normal_force : (S,) [N]
    start : position in the stream of the first
    """

    place: Floats
    velocity: Floats
    squares: Floats
    normal_force: Floats
    start: int


class Motion:
    """Turns places into strokes; the stream's first 9 samples give its first velocity together.

    Parameters
    ----------
    sample_rate : [Hz]

    Attributes
    ----------
    invalid_samples : samples that were not finite or beyond reason
    """

    def __init__(self, sample_rate: float) -> None:
        self._sample_rate = sample_rate
        self._slopes: dict[tuple[int, bool], Floats] = {}
        self._past, self._waiting = np.zeros((6, HISTORY)), np.zeros((6, 0))
        self._count = self.invalid_samples = 0

    def taken(self, position: ArrayLike, normal_force: ArrayLike) -> Floats:
        """Return places (S, 2) [m] and forces (S,) [N] as rows (6, S), mended where need be."""
        touch = np.zeros((6, len(np.asarray(position))))
        touch[:2], touch[2], touch[3] = np.transpose(position), 1.0, normal_force
        if not np.abs(touch).max(initial=0.0) < FARTHEST:
            touch = self._mended(touch)
        return touch

    def __call__(self, touch: Floats) -> Stroke | None:
        """Return the stroke of rows of `taken`; None while its first 9 samples are not complete.

        The first stroke is of all samples so far.
        """
        begun = self._count > NODE
        self._count += touch.shape[1]
        if not begun:
            touch = self._waiting = np.concatenate([self._waiting, touch], axis=1)
            if self._count <= NODE:
                return None
        past = self._past if begun else np.zeros((6, HISTORY))
        line = np.concatenate([past, touch], axis=1)
        self._past = line[:, -HISTORY:]
        line[4:, HISTORY:] = line[:2] @ self._slope(touch.shape[1], begun)
        squares = line[4:] * line[4:]
        return Stroke(
            line[:3, HISTORY:], line[4:], squares[0] + squares[1], touch[3],
            self._count - touch.shape[1],
        )  # fmt: skip

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

    def _mended(self, touch: Floats) -> Floats:
        """Hold the last good position, and lift the finger, where a sample is invalid."""
        touch, last = touch.copy(), self._past[:, -1]
        for sample in touch.T:
            if not (np.abs(sample) < FARTHEST).all():
                sample[:4] = last[0], last[1], 1.0, 0.0
                self.invalid_samples += 1
            last = sample
        return touch
