"""Coupling of neighboring contactors through the skin, from the currents that they draw together.

The tips move by u = (diag(S) + K)⁻¹ F U. The dynamic stiffness K of the skin has the load k_i of
each contactor on its diagonal, and −c_ij √(k_i k_j) beside it. A lag sum holds what the current of
a contactor has in common with its own drive. If all contactors play the same with signs s_i, this
is the admittance Y_ii + Σ_j s_i s_j Y_ij, in which each neighbor has its own course of signs.

From slot to slot nothing else changes but the force of the finger. So the mean over the slots is
left out, with all that is the same in them (the capacitance and the error of its model, and that of
the load), and so are a linear and a quadratic course of the force. The couplings are the least
squares of what is left. The model is exact for any coupling.

Loads and couplings are found in turns. The loads are those of the slots, in whose mean neighbors
cancel to first order. Where all contactors play the same they would be those of tips that move
together, k_i − Σ_j c_ij √(k_i k_j), which tell little of the loads before the couplings are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.sensing.baseline import Baseline
from tactile.sensing.correlation import SumWindow, step_products
from tactile.sensing.coupling_drive import amplitude
from tactile.sensing.current_model import GRID, CurrentModel
from tactile.sensing.neighbors import second_neighbors, slow_courses
from tactile.sensing.population import Population, load_stiffness, load_terms
from tactile.sensing.resting_load import MeasuredLoads, measure_loads
from tactile.sensing.uncertainty import DECIBELS, FREQUENCY

TURNS = 5
"""Number of times that loads and couplings are found in turns; the last one changes couplings of
0.2 by less than 1e-3."""
FARTHER = 0.02
"""Standard deviation of the couplings of contactors that have a neighbor in common, which are
estimated too (assumed). They reach a contactor by way of its neighbors as well: without them, where
0.2, 0.04 and, across the diagonals, 0.015 are right, 0.21 and 0.055 would be found."""
SMALLEST = 1e-9
"""Smallest eigenvalue of the products of the steps that carries information, relative to the
largest."""
TAKEN = 3
"""Number of parameters that each contactor's slots determine besides its couplings: the mean and
two slow courses."""


@dataclass(frozen=True)
class SlotWindow:
    """Window of lag sums within a slot.

    Attributes
    ----------
    slot : int
        Number of the slot.
    place : int
        Position of the window's first sample within the slot.
    window : SumWindow
        Sums and drive.
    """

    slot: int
    place: int
    window: SumWindow


@dataclass(frozen=True)
class MeasuredCoupling:
    """Couplings of P pairs of neighbors, and the loads of all N contactors.

    Attributes
    ----------
    pairs : (P, 2) array of int
        Pairs of neighbors whose loads are both known.
    value : (P,) array of float
        Coupling c of each pair.
    deviation : (P,) array of float
        Standard deviation of each.
    loads : MeasuredLoads
        Loads of the contactors while their neighbors rest.
    """

    pairs: NDArray[np.intp]
    value: Floats
    deviation: Floats
    loads: MeasuredLoads

    def matrix(self) -> Floats:
        """Return the couplings (N, N), 0 on the diagonal and where they are not known."""
        return _matrix(self.pairs, self.value, len(self.loads.windows))


def touched_pairs(pairs: NDArray[np.intp], loads: MeasuredLoads) -> NDArray[np.intp]:
    """Select the pairs of which both contactors are touched.

    Whether a load explains the current does not count: tips that move together need not have one
    that any finger has.

    Parameters
    ----------
    pairs : (P, 2) array of int
        Pairs.
    loads : MeasuredLoads
        Loads of all contactors.

    Returns
    -------
    (Q, 2) array of int
        Those pairs.
    """
    return pairs[(loads.touching & loads.measured)[pairs].all(axis=1)]


def measure_coupling(
    model: CurrentModel,
    population: Population,
    slots: Sequence[SlotWindow],
    signs: Floats,
    pairs: NDArray[np.intp],
    *,
    noise: float,
) -> MeasuredCoupling:
    """Estimate couplings and loads from windows with several patterns of signs.

    Parameters
    ----------
    model : CurrentModel
        Current that the N contactors draw.
    population : Population
        Fingers that are to be expected.
    slots : sequence of SlotWindow
        Windows in which the contactors play the same but for the signs, at least one.
    signs : (S, N) array of float
        Sign of each contactor in each slot.
    pairs : (P, 2) array of int
        Pairs of neighbors.
    noise : float
        Standard deviation of a sample of the measured current [A].

    Returns
    -------
    MeasuredCoupling
        Couplings of the pairs whose loads are known, and loads of all contactors.
    """
    windows = [one.window for one in slots]
    loads = measure_loads(model, population, windows, noise=noise)
    pairs = touched_pairs(pairs, loads)
    near = len(pairs)
    pairs = np.concatenate([pairs, second_neighbors(pairs, len(loads.windows))])
    precision = np.where(np.arange(len(pairs)) < near, 0, FARTHER**-2.0)
    coupled = np.isin(np.arange(len(loads.windows)), pairs)
    fit = _CouplingFit.of(model, slots, noise)
    value, deviation = np.zeros(len(pairs)), np.zeros(len(pairs))
    matrix = _matrix(pairs, value, len(coupled))
    for turn in range(TURNS if len(pairs) else 0):
        if turn:
            added = _Skin(model, loads, coupled, matrix, signs).added()
            others = [added[one.slot] for one in slots]
            loads = measure_loads(model, population, windows, noise=noise, others=others)
        skin = _Skin(model, loads, coupled, matrix, signs)
        value, deviation = fit.solve(skin, signs, pairs, value, precision)
        matrix = _matrix(pairs, value, len(coupled))
    deviation = np.hypot(deviation, value * _relative_deviation(model, loads, pairs))
    known = (loads.touching & loads.explained)[pairs].all(axis=1)
    known &= np.arange(len(pairs)) < near
    return MeasuredCoupling(pairs[known], value[known], deviation[known], loads)


def _matrix(pairs: NDArray[np.intp], value: Floats, count: int) -> Floats:
    """Return couplings as a symmetric matrix (N, N)."""
    matrix = np.zeros((count, count))
    matrix[pairs[:, 0], pairs[:, 1]] = matrix[pairs[:, 1], pairs[:, 0]] = value
    return matrix


def coupled_motion(
    stiffness: Complex, loads: Complex, coupling: Floats, forces: Complex
) -> Complex:
    """Compute the motion of tips that the skin couples.

    Parameters
    ----------
    stiffness : (N, F) complex array
        Dynamic stiffness of the undriven tips [N/m].
    loads : (N, F) complex array
        Dynamic stiffness of the load of each contactor, 0 in air [N/m].
    coupling : (N, N) array of float
        Couplings c, with 0 on the diagonal.
    forces : (F, N, K) complex array
        Forces on the tips [N].

    Returns
    -------
    (F, N, K) complex array
        Displacements u = (diag(S) + K)⁻¹ f [m].
    """
    root = np.sqrt(loads.T)
    across = coupling * root[:, :, None] * root[:, None]
    own = np.eye(len(coupling)) * (stiffness + loads).T[:, None]
    return np.asarray(np.linalg.solve(own - across, forces))


def level_together(baseline: Baseline, measured: MeasuredCoupling, polarity: Floats) -> Floats:
    """Compute the level of the shear where all contactors are to move alike, without coupling.

    Each contactor is driven as if its neighbors were at rest. Those that move with it pull less
    at its tip, by k_i (1 − Σ_j c_ij) instead of k_i, so that it moves farther.

    Parameters
    ----------
    baseline : Baseline
        Tips of the contactors.
    measured : MeasuredCoupling
        Couplings and loads, of one pair at least.
    polarity : (N,) array of float
        1, or −1 where a positive voltage shears the other way.

    Returns
    -------
    (K,) array of float
        Mean level over 10–1000 Hz of each contactor that has a coupling, re the commanded one [dB].
    """
    _, stiffness = baseline.tip(FREQUENCY)
    load = load_stiffness(measured.loads.logarithms, FREQUENCY)
    coupling = measured.matrix() * polarity * polarity[:, None]
    moved = coupled_motion(stiffness, load, coupling, (stiffness + load).T[..., None])
    level = DECIBELS * np.log(np.abs(moved[..., 0])).mean(axis=0)
    return np.asarray(level[np.unique(measured.pairs)])


class _Skin:
    """Contactors with loads and couplings in all slots, at the frequencies of the model.

    ``coupled`` (N,) are the contactors that are coupled; the others have no neighbors.
    """

    def __init__(
        self, model: CurrentModel, loads: MeasuredLoads, coupled: NDArray[np.bool_],
        coupling: Floats, signs: Floats,
    ) -> None:  # fmt: skip
        self._model, self._logarithms, self._signs = model, loads.logarithms, signs
        self._load = load_stiffness(loads.logarithms, GRID)
        self._root = np.sqrt(self._load) * coupled[:, None]
        unit = np.broadcast_to(np.eye(len(coupled)) + 0j, (len(GRID), *coupling.shape))
        held = coupled_motion(model.stiffness, self._load, coupling, unit)
        self._compliance = held.transpose(1, 2, 0)
        driven = (signs[..., None] * model.force).transpose(2, 1, 0)
        self._moved = (held @ driven).transpose(2, 1, 0)
        self._own = model.measuring * model.force
        self.weights = model.weights_of(signs[..., None] * self._moved * self._own)
        """Weights of the currents, (S, N, R) array of float."""

    def added(self) -> Floats:
        """Return the weights (S, N, R) of what other contactors add to the current."""
        return self.weights - self._model.weights(self._logarithms)

    def growing(self) -> Floats:
        """Return the change of the weights (N, R) per logarithm of the scale of the load."""
        yields = self._model.force / (self._model.stiffness + self._load) ** 2
        return self._model.weights_of(-self._own * self._load * yields)

    def slope(self, i: int, others: NDArray[np.intp]) -> Floats:
        """Return the change of the weights (S, K, R) of contactor i per coupling to K others."""
        towards = self._compliance[i, i] * self._moved[:, others]
        towards = towards + self._compliance[i, others] * self._moved[:, i, None]
        towards = towards * (self._root[i] * self._root[others])
        return self._model.weights_of(self._signs[:, i, None, None] * self._own[i] * towards)


@dataclass(frozen=True)
class _CouplingFit:
    """Windows of the slots, whitened for the noise of the converter.

    Attributes
    ----------
    slot : (W,) array of int
        Slot of each window.
    group : (W,) array of int
        Number of each window's place within the slot.
    valid : (W, N) array of bool
        Whether the sums may be used.
    measured : (W, N, LAGS) array of float
        Sums without those of the dielectric.
    shared : (W, N, LAGS, R) array of float
        Sums of the model's shared filters.
    """

    slot: NDArray[np.intp]
    group: NDArray[np.intp]
    valid: NDArray[np.bool_]
    measured: Floats
    shared: Floats

    @classmethod
    def of(cls, model: CurrentModel, slots: Sequence[SlotWindow], noise: float) -> "_CouplingFit":
        """Whiten windows; those at the same place of all slots in the same way."""
        group = np.unique([one.place for one in slots], return_inverse=True)[1]
        measured, shared, products = [], [], []
        for one in slots:
            window = one.window
            through = step_products(window.steps, window.played).transpose(0, 2, 1)
            sums = np.where(np.isfinite(window.sums), window.sums, 0)
            measured.append(sums - (through @ model.electrical[..., None])[..., 0])
            shared.append(through @ model.shared.T)
            delayed = sliding_window_view(window.played, window.samples, axis=1)[:, ::-1].copy()
            products.append(noise**2 * (delayed @ delayed.transpose(0, 2, 1)))
        rounding = np.array([one.window.resolution**2 / 12 for one in slots])
        turned = np.empty_like(products)
        for k in np.unique(group):
            which = group == k
            size, axes = np.linalg.eigh(np.mean(np.array(products)[which], axis=0))
            size = np.maximum(size, SMALLEST * size[:, -1:]) + rounding[which].mean(axis=0)[:, None]
            turned[which] = axes.transpose(0, 2, 1) / np.sqrt(size)[..., None]
        valid = [one.window.valid & np.isfinite(one.window.sums).all(axis=1) for one in slots]
        return cls(
            np.array([one.slot for one in slots]), group, np.array(valid),
            (turned @ np.array(measured)[..., None])[..., 0], turned @ np.array(shared),
        )  # fmt: skip

    def solve(
        self, skin: _Skin, signs: Floats, pairs: NDArray[np.intp], value: Floats, precision: Floats
    ) -> tuple[Floats, Floats]:
        """Return couplings (P,) of least squares, starting from values (P,), and their deviations.

        ``precision`` (P,) are the inverse variances of couplings that are expected to be 0.

        Deviations are those of the noise, or of what the slots differ by if that is more: the
        residuals of a slot are taken to depend on each other, those of different slots not.
        """
        parts = [
            (np.flatnonzero((pairs == i).any(axis=1)), *self._of_contactor(skin, signs, i, pairs))
            for i in np.unique(pairs)
        ]
        count = len(pairs)
        normal, pull, meat = np.zeros((count, count)), np.zeros(count), np.diag(precision)
        for which, columns, residual in parts:
            flat = columns.reshape(-1, len(which))
            normal[np.ix_(which, which)] += flat.T @ flat
            pull[which] += flat.T @ residual.ravel()
        normal += np.diag(precision)
        inverse = np.linalg.inv(normal)
        change = inverse @ (pull - precision * value)
        for which, columns, residual in parts:
            left = residual - columns @ change[which]
            slots = self._per_slot(np.einsum("wjp,wj->wp", columns, left), len(signs))
            spare = len(signs) / max(len(signs) - TAKEN - len(which) / 2, 1.0)
            meat[np.ix_(which, which)] += spare * slots.T @ slots
        spread = np.diag(inverse @ meat @ inverse)
        return value + change, np.sqrt(np.maximum(spread, np.diag(inverse)))

    def _per_slot(self, values: Floats, slots: int) -> Floats:
        """Return the sums (S, ...) of the values (W, ...) of each slot's windows."""
        total = np.zeros((slots, *values.shape[1:]))
        np.add.at(total, self.slot, values)
        return total

    def _of_contactor(
        self, skin: _Skin, signs: Floats, i: int, pairs: NDArray[np.intp]
    ) -> tuple[Floats, Floats]:
        """Return columns (W, LAGS, K) of a contactor's pairs and its residual (W, LAGS).

        What the mean over the slots and slow courses of the force explain is taken out of both.
        """
        own = pairs[(pairs == i).any(axis=1)]
        slopes = skin.slope(i, own[own != i]).transpose(0, 2, 1)
        columns = self.shared[:, i] @ slopes[self.slot]
        predicted = skin.weights[self.slot, i]
        residual = self.measured[:, i] - (self.shared[:, i] @ predicted[..., None])[..., 0]
        slow = (self.shared[:, i] @ skin.growing()[i])[..., None]
        slow = slow * slow_courses(len(signs))[self.slot, None]
        whole = np.concatenate([columns, residual[..., None], slow], axis=2)
        whole = self._without_mean(whole, self.valid[:, i])
        nuisance = whole[..., -2:].reshape(-1, 2)
        rest = whole[..., :-2].reshape(len(nuisance), -1)
        rest = rest - nuisance @ np.linalg.lstsq(nuisance, rest, rcond=None)[0]
        rest = rest.reshape(*whole.shape[:2], -1)
        return rest[..., :-1], rest[..., -1]

    def _without_mean(self, values: Floats, valid: NDArray[np.bool_]) -> Floats:
        """Return values (W, ...) without their mean over windows of a place; 0 if invalid."""
        values = values * valid[:, None, None]
        for k in np.unique(self.group):
            which = (self.group == k) & valid
            if which.any():
                values[which] -= values[which].mean(axis=0)
        return values


def _relative_deviation(
    model: CurrentModel, loads: MeasuredLoads, pairs: NDArray[np.intp]
) -> Floats:
    """Return the deviations (P,) of couplings, relative to them, that those of the loads make.

    The current by a neighbor grows with √(k_i k_j)/((S_i + k_i)(S_j + k_j)). Frequencies count by
    the square of such a current, for a neighbor that is alike.
    """
    terms = load_terms(loads.logarithms, GRID)
    k, S, F = terms.sum(axis=1), model.stiffness, model.force
    slope = (terms * (0.5 / k - 1 / (S + k))[:, None]).real
    weight = np.abs(amplitude(GRID) * GRID * F**2 * k / (S + k) ** 2) ** 2
    mean = np.einsum("naf,nf->na", slope, weight / weight.sum(axis=1, keepdims=True))
    variance = np.einsum("na,nab,nb->n", mean, loads.covariance, mean)
    return np.asarray(np.sqrt(variance[pairs].sum(axis=1)))
