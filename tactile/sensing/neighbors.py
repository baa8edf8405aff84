"""Neighbors among contactors, and signs of their drives by which their couplings are told apart."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from tactile.arrays import Floats

BETWEEN = 1.02
"""Factor of a circle through two contactors that are no neighbors if a third one lies in it: beside
a rectangular grid's diagonal two lie on the circle itself, and positions are rounded."""
SLOTS = 16
"""Smallest number of slots. Grids need five signs and rows of three contactors three; what is left
tells couplings from a force that changes meanwhile."""
ORDERS = 300
"""Number of orders of the slots of which the best is taken."""


def neighbor_pairs(positions: Floats) -> NDArray[np.intp]:
    """Find the pairs of contactors between which there is no third one.

    They are the edges of the Gabriel graph (Gabriel & Sokal 1969): pairs whose circle, of which the
    way between them is the diameter, holds no other contactor. On a rectangular grid they are the
    neighbors along both axes, on a triangular one all six.

    Parameters
    ----------
    positions : (N, 2) array of float
        Positions of the contactors [m].

    Returns
    -------
    (P, 2) array of int
        Pairs i < j.
    """
    first, second = np.triu_indices(len(positions), 1)
    middle = (positions[first] + positions[second]) / 2
    radius = np.linalg.norm(positions[first] - positions[second], axis=1) / 2
    away = np.linalg.norm(positions - middle[:, None], axis=2)
    rows = np.arange(len(first))
    away[rows, first] = away[rows, second] = np.inf
    alone = ~np.any(away < BETWEEN * radius[:, None], axis=1)
    return np.stack([first[alone], second[alone]], axis=1)


def second_neighbors(pairs: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Find the pairs of contactors that have a neighbor in common and are none themselves.

    Parameters
    ----------
    pairs : (P, 2) array of int
        Neighbors.
    count : int
        Number of contactors N.

    Returns
    -------
    (Q, 2) array of int
        Pairs i < j.
    """
    near = np.zeros((count, count), np.intp)
    near[pairs[:, 0], pairs[:, 1]] = near[pairs[:, 1], pairs[:, 0]] = 1
    return np.argwhere(np.triu((near @ near > 0) & (near == 0), 1))


def sign_patterns(positions: Floats, pairs: NDArray[np.intp]) -> Floats:
    """Choose the sign of each contactor's drive in each slot of a measurement.

    Over all slots, a contactor and its neighbors have signs that are orthogonal to each other, so
    that each neighbor changes the contactor's current in a way of its own, and none changes its
    mean. Contactors that are farther apart share signs. The slots are in an order in which no
    product of signs resembles a slow course.

    Parameters
    ----------
    positions : (N, 2) array of float
        Positions of the contactors [m].
    pairs : (P, 2) array of int
        Neighbors.

    Returns
    -------
    (S, N) array of float
        Signs ±1; S is a power of 2.
    """
    count = len(positions)
    near = np.eye(count, dtype=np.bool_)
    near[pairs[:, 0], pairs[:, 1]] = near[pairs[:, 1], pairs[:, 0]] = True
    together = (near.astype(np.intp) @ near) > 0  # in the neighborhood of one contactor
    away = np.linalg.norm(positions[:, None] - positions, axis=2)
    slots, code = SLOTS, np.full(count, -1)
    for k in range(count):
        taken = np.unique(code[together[k] & (code >= 0)])
        while len(taken) == slots:
            slots *= 2
        nearest = np.full(slots, np.inf)
        np.minimum.at(nearest, code[:k], away[k, :k])
        nearest[taken] = -1.0
        code[k] = int(np.argmax(nearest))
    rows = hadamard(slots).astype(np.float64)
    return np.asarray(rows[code][:, _order(rows)].T)


def slow_courses(slots: int) -> Floats:
    """Compute the courses over time that a force may have, which couplings are told from.

    Parameters
    ----------
    slots : int
        Number of slots S.

    Returns
    -------
    (S, 2) array of float
        A linear and a quadratic course, of which the mean squares are 1.
    """
    time = np.linspace(-1, 1, slots)
    courses = np.stack([time, time**2 - np.mean(time**2)], axis=1)
    return np.asarray(courses / np.sqrt(np.mean(courses**2, axis=0)))


def _order(rows: Floats) -> NDArray[np.intp]:
    """Return the order of the slots in which no row but the constant one is a slow course."""
    slow = slow_courses(len(rows))
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(rows)) for _ in range(ORDERS)]
    worst = [np.max(np.sum((rows[1:, order] @ slow) ** 2, axis=1)) for order in orders]
    return orders[int(np.argmin(worst))]
