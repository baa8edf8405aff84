"""The plant of `sensing_plant` whose contactors are coupled by the skin between them.

A tip that moves stretches the skin of its neighbors too. The skin of contactor l is stretched by
e_l = Σ_i Q_li u_i, and pulls each tip i by Q_li of its force: the dynamic stiffness of all is
Qᵀ diag(k) Q, which is symmetric, and takes up energy for any loads. With Q the square root of
1 − C it is k (1 − C) where all loads are alike. Loads stay as they are in the uncoupled plant; only
what they see of the tips is mixed.
"""

import numpy as np
from scipy.linalg import sqrtm

from benchmarks.sensing_plant import (
    INNER,
    Advance,
    Converter,
    Fingers,
    PlantTolerances,
    SensingPlant,
    U,
)
from tactile.arrays import Complex, Floats


class CoupledAdvance(Advance):
    """One step of the integration of coupled contactors.

    The rows of the state that belong to the finger are those of the stretches e = Q u.

    Parameters
    ----------
    alone : Advance
        Step of contactors that are not coupled, which is taken over.
    mixing : (N, N) array of float
        The matrix Q.
    """

    def __init__(self, alone: Advance, mixing: Floats) -> None:
        self.stiff, self.now, self.push = alone.stiff, alone.now, alone.push
        self.free, self._mixing, self._yields = alone.free, mixing, alone.push[U].copy()
        self.matrix = alone.matrix.copy()
        # what the finger makes of the tips of this step, `step` makes of their stretches
        self.matrix[INNER] -= self.now * self.matrix[U]
        self.matrix[-1] -= self.stiff * self.matrix[U]

    def gain(self, scale: Floats) -> Floats:
        """Return the matrix (N, N) of the forces on the tips under loads with a scale (N,)."""
        Q = self._mixing
        taken = Q.T * scale
        closed = (taken * self.stiff) @ Q * self._yields
        return np.asarray(-np.linalg.solve(np.eye(len(scale)) + closed, taken))

    def step(self, state: Floats, gain: Floats, force: Floats, following: Floats) -> None:
        """Advance a state with its voltage; write the force and the following state."""
        free = np.einsum("ijn,jn->in", self.matrix, state, out=self.free)
        free[U] = self._mixing @ free[U]
        free[INNER] += self.now * free[U]
        free[-1] += self.stiff * free[U]
        np.matmul(gain, free[-1], out=force)
        np.multiply(self.push, force, out=following)
        following[U] = self._mixing @ (self._yields * force)
        following[INNER] = self.now * following[U]
        following += free[:-1]


class CoupledPlant(SensingPlant):
    """Contactors under fingers whose skin couples them.

    Parameters
    ----------
    fingers, tolerances, converter, sample_rate, seed
        As of `SensingPlant`.
    coupling : (N, N) array of float
        Symmetric, with 0 on the diagonal: C, of which 1 − C is positive definite.
    """

    def __init__(
        self,
        fingers: Fingers,
        tolerances: PlantTolerances,
        coupling: Floats,
        *,
        converter: Converter | None = None,
        sample_rate: float = 8000.0,
        seed: int = 0,
    ) -> None:
        super().__init__(
            fingers, tolerances, converter=converter, sample_rate=sample_rate, seed=seed
        )
        self.mixing = np.asarray(sqrtm(np.eye(len(coupling)) - coupling).real)
        self._coupled = CoupledAdvance(self._advance, self.mixing)
        self._advance = self._coupled

    def stiffness(self, frequency: Floats, scale: Floats) -> Complex:
        """Return the dynamic stiffness (F, N, N) that the tips see [N/m]."""
        alone = self.fingers.stiffness(frequency, scale).T
        return np.asarray(self.mixing.T @ (alone[:, :, None] * self.mixing))

    def coupling(self, frequency: Floats, scale: Floats) -> Floats:
        """Return −Re K_ij/√(K_ii K_jj) (F, N, N), with 0 on the diagonal."""
        K = self.stiffness(frequency, scale)
        own = np.sqrt(np.einsum("fii->fi", K))
        ratio = -(K / (own[:, :, None] * own[:, None])).real
        return np.asarray(ratio + np.eye(K.shape[1]))

    def transfer(self, frequency: Floats, scale: Floats) -> tuple[Complex, Complex]:
        """Return shear (F, N, N) per volt of each contactor [m/V], and current per volt [S]."""
        yielding, driven, _ = self._ports(frequency)
        K, one = self.stiffness(frequency, scale), np.eye(len(scale))
        moved = np.linalg.solve(one + yielding.T[:, :, None] * K, one * driven.T[:, None])
        air = self.admittance(frequency, 0 * scale).T
        pulled = 2j * np.pi * frequency[:, None, None] * driven.T[:, :, None] * (K @ moved)
        return np.asarray(moved), np.asarray(one * air[:, None] - pulled)

    def _gains(self, scales: Floats) -> Floats:
        """Return the matrices (S, N, N) of the fingers' forces under each row of scales (S, N)."""
        if np.all(scales == scales[0]):
            one = self._coupled.gain(scales[0])
            return np.broadcast_to(one, (len(scales), *one.shape))
        return np.array([self._coupled.gain(scale) for scale in scales])

    def _moved(self, volts: Floats, scales: Floats) -> tuple[Floats, Floats]:
        """Integrate as without coupling, and return the tips instead of their stretches."""
        stretched, charge = super()._moved(volts, scales)
        return np.asarray(np.linalg.solve(self.mixing, stretched.T).T), charge
