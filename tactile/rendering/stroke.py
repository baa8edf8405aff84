"""Motion of the finger as a renderer needs it: position, velocity and force, sample by sample.

Velocity is that of a parabola through each sample and those 4 and 8 before it, so that no later
sample is needed. Invalid input is repaired: the last valid position is held, without force.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats

NODE = 8
"""Samples between nodes of the roll-off, and span of the parabola that gives a sample's
velocity."""
HISTORY = 2 * NODE
"""Samples that a stroke keeps of the velocity before its first sample."""
RESTING_SPEED = 1e-4
"""Speed below which the direction of a projected display fades out [m/s]."""
FARTHEST = 1e3
"""Magnitude from which on a sample is taken as invalid [m] and [N]."""


@dataclass(frozen=True)
class Stroke:
    """Consecutive samples of a finger's motion.

    Attributes
    ----------
    place : (3, S) array of float
        Rows x and y [m], and 1.
    velocity : (2, `HISTORY` + S) array of float
        Velocity from `HISTORY` samples before the first sample on [m/s].
    squares : (`HISTORY` + S,) array of float
        Squared speed [m²/s²].
    normal_force : (S,) array of float
        Normal force [N].
    start : int
        Position of the first sample in the stream [samples].
    """

    place: Floats
    velocity: Floats
    squares: Floats
    normal_force: Floats
    start: int


class Motion:
    """Converts positions into strokes.

    The first 9 samples of the stream determine its first velocity together.

    Parameters
    ----------
    sample_rate : float
        Sample rate [Hz].

    Attributes
    ----------
    invalid_samples : int
        Number of samples that were not finite or out of range.
    """

    def __init__(self, sample_rate: float) -> None:
        self._sample_rate = sample_rate
        self._slopes: dict[tuple[int, bool], Floats] = {}
        self._past, self._pending = np.zeros((6, HISTORY)), np.zeros((6, 0))
        self._count = self.invalid_samples = 0

    def rows(self, position: ArrayLike, normal_force: ArrayLike) -> Floats:
        """Arrange positions and forces as rows for the next stroke, and repair invalid samples.

        Parameters
        ----------
        position : (S, 2) array_like of float
            Positions of the finger [m].
        normal_force : (S,) array_like of float
            Normal forces [N].

        Returns
        -------
        (6, S) array of float
            Rows x and y [m], 1, force [N], and two rows for the velocity.
        """
        rows = np.zeros((6, len(np.asarray(position))))
        rows[:2], rows[2], rows[3] = np.transpose(position), 1.0, normal_force
        if not np.abs(rows).max(initial=0.0) < FARTHEST:
            rows = self._repaired(rows)
        return rows

    def __call__(self, rows: Floats) -> Stroke | None:
        """Return the stroke of such `rows`; None until the first 9 samples are complete.

        The first stroke consists of all samples so far.
        """
        begun = self._count > NODE
        self._count += rows.shape[1]
        if not begun:
            rows = self._pending = np.concatenate([self._pending, rows], axis=1)
            if self._count <= NODE:
                return None
        past = self._past if begun else np.zeros((6, HISTORY))
        line = np.concatenate([past, rows], axis=1)
        self._past = line[:, -HISTORY:]
        line[4:, HISTORY:] = line[:2] @ self._slope(rows.shape[1], begun)
        squares = line[4:] * line[4:]
        return Stroke(
            line[:3, HISTORY:], line[4:], squares[0] + squares[1], rows[3],
            self._count - rows.shape[1],
        )  # fmt: skip

    def _slope(self, count: int, begun: bool) -> Floats:
        """Return the matrix that turns positions (2, `HISTORY` + S) into the new velocities (2, S).

        The velocity of a sample is that of a parabola through it and the samples 4 and 8 before it;
        the first 8 samples of the stream share the parabola through samples 0, 4 and 8.
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

    def _repaired(self, rows: Floats) -> Floats:
        """Hold the last valid position, and lift the finger, where a sample is invalid."""
        rows, last = rows.copy(), self._past[:, -1]
        for sample in rows.T:
            if not (np.abs(sample) < FARTHEST).all():
                sample[:4] = last[0], last[1], 1.0, 0.0
                self.invalid_samples += 1
            last = sample
        return rows
