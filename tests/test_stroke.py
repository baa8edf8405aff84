"""Position becomes velocity by a parabola, and what is no position is repaired."""

import math

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.rendering.stroke import HISTORY, Motion

RATE = 8000.0


def velocities(place: Floats, sizes: list[int]) -> Floats:
    """Return the velocities (S, 2) of places in blocks of changing sizes."""
    motion, parts, at, k = Motion(RATE), list[Floats](), 0, 0
    while at < len(place):
        block = place[at : at + sizes[k % len(sizes)]]
        stroke = motion(motion.rows(block, np.ones(len(block))))
        at, k = at + len(block), k + 1
        if stroke is not None:
            np.testing.assert_allclose(stroke.squares, (stroke.velocity**2).sum(axis=0))
            parts.append(stroke.velocity[:, HISTORY:].T)
    return np.concatenate(parts)


@pytest.mark.parametrize("sizes", [[100], [64], [1], [3, 20], [9, 1], [8, 1, 40]])
def test_the_velocity_of_a_parabola_is_exact_from_the_first_sample_on(sizes: list[int]) -> None:
    time = np.arange(100)[:, None] / RATE
    speed, change = np.array([0.08, -0.02]), np.array([-3.0, 5.0])
    result = velocities(0.01 + speed * time + change / 2 * time**2, sizes)
    np.testing.assert_allclose(result, speed + change * time, atol=1e-11)


def test_a_finger_at_rest_has_no_velocity_at_all() -> None:
    assert not np.any(velocities(np.full((200, 2), math.pi / 100), [30]))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e3, -1e300])
@pytest.mark.parametrize("row", range(3))
def test_an_invalid_sample_is_held_without_force_and_counted(bad: float, row: int) -> None:
    motion, samples = Motion(RATE), np.full((3, 40), 0.5)
    samples[:2] = np.linspace(0, 1e-3, 40)
    samples[row, [10, 11, 32]] = bad
    strokes = [motion(motion.rows(part[:2].T, part[2])) for part in np.split(samples, 2, axis=1)]
    place = np.concatenate([s.place for s in strokes if s is not None], axis=1)
    force = np.concatenate([s.normal_force for s in strokes if s is not None])
    held = np.linspace(0, 1e-3, 40)
    held[10:12], held[32] = held[9], held[31]
    np.testing.assert_array_equal(place, [held, held, np.ones(40)])
    np.testing.assert_array_equal(np.flatnonzero(force == 0), [10, 11, 32])
    assert motion.invalid_samples == 3
