"""Where the finger is: a trajectory of position and normal force, continuous with its velocity."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError

COLUMNS = ("time_s", "x_mm", "y_mm", "normal_force_n")
LARGEST_FORCE = 50.0
"""N; a finger that slides stays below 10 N, so that more is another unit."""
LARGEST_POSITION = 500.0
"""m."""
LARGEST_SPEED = 10.0
"""m/s between two samples; a fast stroke of a finger is below 1 m/s."""


class Trajectory:
    """A finger's way over the surface.

    Between samples it is a shape-preserving cubic (PCHIP): position and velocity are continuous,
    nothing overshoots, and a finger that rests stays at rest.

    Parameters
    ----------
    time : (T,) ascending [s]
    position : (T, 2) of the finger over the surface [m]
    normal_force : (T,) or one number [N]

    Raises
    ------
    InputError
        Where time does not ascend, shapes differ, or a value is not finite or beyond reason.
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
        with np.errstate(over="ignore"):  # 1 / (a subnormal slope): scipy takes the inverse again
            self._curve = PchipInterpolator(self.time, samples)

    def _check(self) -> None:
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
        """Return a straight stroke from the origin.

        Parameters
        ----------
        speed : [m/s]
        angle : of the motion, from the x axis [rad]
        duration : [s]
        normal_force : [N]
        """
        direction = np.array([np.cos(angle), np.sin(angle)])
        return cls([0.0, duration], np.outer([0.0, speed * duration], direction), normal_force)

    @classmethod
    def from_csv(cls, path: str | Path) -> "Trajectory":
        """Read a file with the columns time_s, x_mm, y_mm, normal_force_n.

        Raises
        ------
        NotFoundError, InputError
            One line: file, row, field and value.
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
        """From the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def at(self, time: ArrayLike) -> tuple[Floats, Floats]:
        """Return position (..., 2) [m] and normal force (...) [N] at times [s].

        Beyond either end the finger goes on at the velocity it has there, its force held.
        """
        t = np.asarray(time, np.float64)
        inside = np.clip(t, self.time[0], self.time[-1])
        values = self._curve(inside)
        beyond = (t - inside)[..., None]
        if np.any(beyond):
            values[..., :2] += beyond * self._curve(inside, 1)[..., :2]
        return values[..., :2], values[..., 2]

    def velocity(self, time: ArrayLike) -> Floats:
        """Return velocity (..., 2) [m/s] at times [s]; beyond either end what it is there."""
        inside = np.clip(np.asarray(time, np.float64), self.time[0], self.time[-1])
        return np.asarray(self._curve(inside, 1)[..., :2])

    def blocks(
        self, sample_rate: float, size: int, *, extra: int = 0
    ) -> Iterator[tuple[Floats, Floats]]:
        """Yield position (S, 2) and normal force (S,) in blocks of at most ``size`` samples.

        Sample k is at time[0] + k/sample_rate, for the whole duration and ``extra`` samples more.
        """
        count = round(self.duration * sample_rate) + extra
        for start in range(0, count, size):
            index = np.arange(start, min(start + size, count))
            yield self.at(self.time[0] + index / sample_rate)
