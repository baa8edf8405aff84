"""Trajectory of a finger: position, its continuous velocity, and normal force over time."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError

COLUMNS = ("time_s", "x_mm", "y_mm", "normal_force_n")
"""Columns of a trajectory file, in the order of the arrays they fill."""
LARGEST_FORCE = 50.0
"""Largest normal force that is accepted [N]. A sliding finger stays below 10 N, so that a larger
number is most likely in another unit."""
LARGEST_POSITION = 500.0
"""Largest magnitude of a coordinate that is accepted [m]."""
LARGEST_SPEED = 10.0
"""Largest speed between two samples that is accepted [m/s]; a fast stroke of a finger is below 1
m/s."""


class Trajectory:
    """Path of a finger over the surface.

    Samples are joined by a shape-preserving cubic (PCHIP): position and velocity are continuous,
    nothing overshoots, and a finger that rests stays at rest.

    Parameters
    ----------
    time : (T,) array_like of float
        Times of the samples, strictly ascending, T ≥ 2 [s].
    position : (T, 2) array_like of float
        Position of the finger on the surface [m].
    normal_force : (T,) array_like of float or float
        Normal force [N].

    Attributes
    ----------
    time : (T,) array of float
        Times of the samples [s].
    position : (T, 2) array of float
        Positions [m].
    normal_force : (T,) array of float
        Normal forces [N].

    Raises
    ------
    InputError
        If the times do not ascend, the shapes differ, or a value is not finite or out of range.

    Examples
    --------
    A stroke of 40 mm in one second, after which the finger rests:

    >>> import tactile
    >>> place = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.0]]
    >>> stroke = tactile.Trajectory([0.0, 1.0, 2.0], place, normal_force=0.5)
    >>> stroke.velocity(1.5).tolist()
    [0.0, 0.0]
    """

    def __init__(self, time: ArrayLike, position: ArrayLike, normal_force: ArrayLike) -> None:
        self.time = np.asarray(time, np.float64)
        self.position = np.asarray(position, np.float64)
        try:
            self.normal_force = np.broadcast_to(
                np.asarray(normal_force, np.float64), self.time.shape
            )
        except ValueError:
            raise InputError("normal_force: needs one value, or as many as time") from None
        self._check()
        samples = np.column_stack([self.position, self.normal_force])
        with np.errstate(over="ignore"):  # scipy inverts subnormal slopes twice, which is harmless
            self._curve = PchipInterpolator(self.time, samples)

    def _check(self) -> None:
        """Raise InputError for arrays that cannot be the path of a finger."""
        if self.time.ndim != 1 or len(self.time) < 2 or self.position.shape != (len(self.time), 2):
            raise InputError("trajectory: needs time (T,) and position (T, 2) with T ≥ 2")
        for name, values in (
            ("time", self.time),
            ("position", self.position),
            ("normal_force", self.normal_force),
        ):
            if not np.all(np.isfinite(values)):
                at = int(np.argmin(np.isfinite(values).reshape(len(self.time), -1).all(axis=1)))
                raise InputError(f"{name}, sample {at + 1}: not a finite number")
        step = np.diff(self.time)
        if np.any(step <= 0):
            at = int(np.argmax(step <= 0)) + 1
            raise InputError(
                f"time, sample {at + 1}: {self.time[at]:g} s after {self.time[at - 1]:g} s; "
                "must ascend"
            )
        if np.any((self.normal_force < 0) | (self.normal_force > LARGEST_FORCE)):
            worst = self.normal_force[np.argmax(np.abs(self.normal_force - LARGEST_FORCE / 2))]
            raise InputError(f"normal_force {worst:g} N: must be 0 … {LARGEST_FORCE:g} N")
        farthest = float(np.abs(self.position).max())
        if farthest > LARGEST_POSITION:
            raise InputError(
                f"position: reaches {farthest:g} m, limit {LARGEST_POSITION:g} m "
                "(is it in millimeters?)"
            )
        speed = float((np.linalg.norm(np.diff(self.position, axis=0), axis=1) / step).max())
        if speed > LARGEST_SPEED:
            raise InputError(
                f"position: reaches {farthest:g} m and {speed:g} m/s; "
                f"limits {LARGEST_POSITION:g} m and {LARGEST_SPEED:g} m/s (is it in millimeters?)"
            )

    @classmethod
    def line(
        cls, *, speed: float, angle: float = 0.0, duration: float = 1.0, normal_force: float = 0.5
    ) -> "Trajectory":
        """Return a straight stroke that begins at the origin.

        Parameters
        ----------
        speed : float
            Speed [m/s].
        angle : float
            Direction of motion, measured from the x axis [rad].
        duration : float
            Duration [s].
        normal_force : float
            Normal force, constant along the stroke [N].

        Returns
        -------
        Trajectory
            Stroke with one sample at either end.

        Examples
        --------
        >>> import tactile
        >>> stroke = tactile.Trajectory.line(speed=0.08, duration=0.5)
        >>> position, normal_force = stroke.at(0.25)
        >>> position.round(6).tolist(), float(normal_force)
        ([0.02, 0.0], 0.5)
        """
        direction = np.array([np.cos(angle), np.sin(angle)])
        return cls([0.0, duration], np.outer([0.0, speed * duration], direction), normal_force)

    @classmethod
    def from_csv(cls, path: str | Path) -> "Trajectory":
        """Read a trajectory from a CSV file with the columns time_s, x_mm, y_mm and normal_force_n.

        Parameters
        ----------
        path : str or Path
            File to read.

        Returns
        -------
        Trajectory
            Trajectory in SI units.

        Raises
        ------
        NotFoundError, InputError
            If the file is missing or invalid; the message is one line with file, row, field and
            value.
        """
        rows = files.read_columns(Path(path), COLUMNS)
        values = files.numbers(Path(path), COLUMNS, rows)
        if len(values) < 2:
            raise InputError(f"{path}: has {len(values)} rows, needs at least 2")
        try:
            return cls(values[:, 0], values[:, 1:3] * 1e-3, values[:, 3])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def at(self, time: ArrayLike) -> tuple[Floats, Floats]:
        """Return position and normal force at given times.

        Beyond either end the finger continues at the velocity that it has there, with constant
        force.

        Parameters
        ----------
        time : (...) array_like of float
            Times [s].

        Returns
        -------
        position : (..., 2) array of float
            Positions [m].
        normal_force : (...) array of float
            Normal forces [N].
        """
        t = np.asarray(time, np.float64)
        inside = np.clip(t, self.time[0], self.time[-1])
        values = self._curve(inside)
        beyond = (t - inside)[..., None]
        if np.any(beyond):
            values[..., :2] += beyond * self._curve(inside, 1)[..., :2]
        return values[..., :2], values[..., 2]

    def velocity(self, time: ArrayLike) -> Floats:
        """Return the velocity at given times.

        Parameters
        ----------
        time : (...) array_like of float
            Times [s]; beyond either end the velocity is that of the end.

        Returns
        -------
        (..., 2) array of float
            Velocities [m/s].
        """
        inside = np.clip(np.asarray(time, np.float64), self.time[0], self.time[-1])
        return np.asarray(self._curve(inside, 1)[..., :2])

    def blocks(
        self, sample_rate: float, size: int, *, extra: int = 0
    ) -> Iterator[tuple[Floats, Floats]]:
        """Yield the trajectory sampled at a constant rate, block by block.

        Sample k is taken at time[0] + k/sample_rate.

        Parameters
        ----------
        sample_rate : float
            Sample rate [Hz].
        size : int
            Largest number of samples in a block.
        extra : int
            Number of samples to add after the end of the trajectory.

        Yields
        ------
        position : (S, 2) array of float
            Positions [m].
        normal_force : (S,) array of float
            Normal forces [N].
        """
        count = round(self.duration * sample_rate) + extra
        for start in range(0, count, size):
            index = np.arange(start, min(start + size, count))
            yield self.at(self.time[0] + index / sample_rate)
