"""Contactors under a finger whose skin couples them, while the drive runs.

The finger's springs and dampers at contactor l are stretched by e_l = Σ_i Q_li u_i, and pull each
tip i by Q_li of their force. The dynamic stiffness of all is Qᵀ diag(k) Q, which takes up energy
for any loads. Where all loads are alike, it is k (1 − C) with Q² = 1 − C. All contactors together
are one system, whose map of a sample is computed once, so that the force must be constant.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm, sqrtm

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.tip_port import TipPort, loaded, spring_roots
from tactile.actuator.touch import Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.arrays import Floats


def coupled(port: TipPort, load: FingerLoad, mixing: Floats) -> Floats:
    """Connect a finger to the tips that couples them.

    Parameters
    ----------
    port : TipPort
        Benders in air, n states of each.
    load : FingerLoad
        Load, of numbers or of arrays (N,).
    mixing : (N, N) array of float
        Stretches e = Q u of the finger per displacement of the tips.

    Returns
    -------
    (N, n, N, n) array of float
        System matrix of all contactors.
    """
    contactors, size = port.B.shape
    roots = spring_roots(load, contactors)
    damping = np.broadcast_to(np.asarray(load.d0, np.float64), contactors)
    A, own = np.zeros((contactors, size, contactors, size)), np.arange(contactors)
    # what a load does to its springs alone: `loaded` without what it does to the tip
    A[own, :, own] = port.A
    A[own, port.springs, own, port.springs] += (
        loaded(port, load)[:, port.springs, port.springs] - port.A[:, port.springs, port.springs]
    )
    drag = (mixing.T * damping) @ mixing
    A -= np.einsum("ij,ia,jb->iajb", drag, port.v, port.v)
    A[:, port.springs] += np.einsum("ls,lj,jb->lsjb", roots, mixing, port.v)
    A[..., port.springs] -= np.einsum("li,ia,ls->ials", mixing, port.v, roots)
    return A


class CoupledTouchedPlant(TouchedPlant):
    """Simulated contactors under a finger of constant force whose skin couples them.

    Parameters
    ----------
    bimorph, touch, sample_rate, contactors, amplifier, tolerances, hysteresis
        As of `TouchedPlant`; of the normal force, that at the start is taken.
    coupling : (N, N) array of float
        Couplings C, symmetric and 0 on the diagonal; 1 − C must be positive definite.

    Raises
    ------
    ValueError
        If 1 − C is not positive definite.
    """

    def __init__(
        self, bimorph: Bimorph, touch: Touch, sample_rate: float, *, coupling: Floats, **others: Any
    ) -> None:
        super().__init__(bimorph, touch, sample_rate, **others)
        rest = np.eye(len(coupling)) - coupling
        if np.linalg.eigvalsh(rest)[0] <= 0:
            raise ValueError("CoupledTouchedPlant: couplings exceed the loads of the contactors")
        self._map = self._sample_map(coupled(self.port, self.load, sqrtm(rest).real))

    def _sample_map(self, A: Floats) -> Floats:
        """Return the map (N · n, N · (n + inputs)) of a sample, as `_run` arranges a line."""
        contactors, size = self.port.B.shape
        pieces = self.shape.pieces / self.sample_rate
        each, states = self.shape.derivatives.shape[1] // len(pieces), contactors * size
        own = np.arange(contactors)
        driven = np.zeros((contactors, size, contactors, each))
        driven[own, :, own, 0] = self.port.B
        shifted = np.kron(np.eye(contactors), np.eye(each, k=1))
        whole = np.zeros((states, contactors, size + len(pieces) * each))
        whole[:, :, :size] = np.eye(states).reshape(states, contactors, size)
        for i, length in enumerate(pieces):
            augmented = np.zeros((states + contactors * each,) * 2)
            augmented[:states, :states] = A.reshape(states, states) * length
            augmented[:states, states:] = driven.reshape(states, -1) * length
            augmented[states:, states:] = shifted
            e = expm(augmented)
            whole = np.tensordot(e[:states, :states], whole, 1)
            start = size + i * each
            whole[:, :, start : start + each] = e[:states, states:].reshape(states, contactors, -1)
        return np.asarray(whole.reshape(states, -1))

    def _run(self, inputs: Floats) -> Floats:
        """Advance the states by a chunk; return them (S, N, n) at the start of each sample."""
        contactors, size = self._state.shape
        line = np.zeros((len(inputs) + 1, contactors, size + inputs.shape[2]))
        line[0, :, :size], line[:-1, :, size:] = self._state, inputs
        for now, following in pairwise(line):
            following[:, :size] = (self._map @ now.ravel()).reshape(contactors, size)
        self._position += len(inputs)
        self._state = line[-1, :, :size].copy()
        return np.asarray(line[:-1, :, :size])
