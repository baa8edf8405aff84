"""Motion of the finger as a renderer needs it: position, velocity and force, sample by sample.

Velocity is that of a parabola through each sample and those 4 and 8 before it, so that no later
sample is needed. Invalid input is repaired: the last valid position is held, without force.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats
from tactile.machine_code import compiled

NODE = 8
"""Samples between nodes of the roll-off, and span of the parabola that gives a sample's
velocity."""
HISTORY = 2 * NODE
"""Samples that a stroke keeps of the velocity before its first sample."""
RESTING_SPEED = 1e-4
"""Speed below which the direction of a projected display fades out [m/s]."""
FARTHEST = 1e3
"""Magnitude from which on a sample is taken as invalid [m] and [N]."""


class Stroke(NamedTuple):
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
        place = np.asarray(position)
        rows = np.zeros((6, len(place)))
        rows[:2], rows[2], rows[3] = place.T, 1.0, normal_force
        self.invalid_samples += _repair(rows, self._past.item(0, -1), self._past.item(1, -1))
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
        squares = _differentiate(line, self._sample_rate, begun)
        return Stroke(line[:3, HISTORY:], line[4:], squares, rows[3], self._count - rows.shape[1])


@compiled("int64(float64[:, ::1], float64, float64)")
def _repair(rows: Floats, x: float, y: float) -> int:
    """Hold the last valid position, and lift the finger, where a sample is invalid; count them."""
    invalid = 0
    for n in range(rows.shape[1]):
        if abs(rows[0, n]) < FARTHEST and abs(rows[1, n]) < FARTHEST and abs(rows[3, n]) < FARTHEST:
            x, y = rows[0, n], rows[1, n]
        else:
            rows[0, n], rows[1, n], rows[3, n] = x, y, 0.0
            invalid += 1
    return invalid


@compiled("float64[::1](float64[:, ::1], float64, boolean)")
def _differentiate(line: Floats, sample_rate: float, begun: bool) -> Floats:
    """Fill in the velocities after the history, and return the squared speeds.

    The velocity of a sample is that of a parabola through it and the samples 4 and 8 before it;
    the first 8 samples of the stream share the parabola through samples 0, 4 and 8.
    """
    half = NODE // 2
    for n in range(HISTORY, line.shape[1]):
        last = n if begun else max(n, HISTORY + NODE)
        later = (n - last) / half
        for axis in range(2):
            new, middle, old = line[axis, last], line[axis, last - half], line[axis, last - NODE]
            slope = (later + 1.5) * (new - middle) - (later + 0.5) * (middle - old)
            line[4 + axis, n] = slope * (sample_rate / half)
    squares: Floats = line[4] * line[4] + line[5] * line[5]
    return squares
