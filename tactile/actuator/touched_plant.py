"""Contactors under fingers that differ and change while the drive runs.

`Plant` has one load for all contactors and all times. `TouchedPlant` closes the load at the tip of
each contactor (`tip_port`), which follows the normal force from sample to sample. Within a sample
the load is constant, and the system is integrated exactly; between samples it changes without
adding energy. The charge contains a causal dielectric, and the current is the derivative of the
charge in the band below half the sample rate, also of an amplifier that holds.

The map of a sample is computed for some forces, uniform in force^¼, in which √k of the load is
linear, and interpolated linearly between these. Since all maps are contractions of the same energy,
their interpolation is one too: no course of the force can make the plant unstable.
"""

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import expm

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.derivative import REACH, Derivative
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.hysteresis import FINE, BentDrive, Hysteresis, Plays
from tactile.actuator.interpolation import HALF_WIDTH, drive_shape, weights, window_of
from tactile.actuator.tip_port import loaded, spring_roots, tip_ports
from tactile.actuator.tolerances import Tolerances
from tactile.actuator.touch import Touch
from tactile.arrays import Floats

STEPS = 48
"""Number of maps from no force to 1 N; interpolation between them is good to 1e-4 of the load."""
LARGEST_FORCE = 16.0
"""Largest normal force of a finger [N]."""
SMALLEST = 1e-300
"""Smallest divisor, instead of none."""
CHUNK = 64
"""Largest number of samples whose courses are computed at once."""


class _Maps:
    """Maps of one sample, x' = Φ x + Γ c, of N contactors over steps of the force.

    ``c`` are the derivatives of the drive (`DriveShape`).
    """

    def __init__(self, plant: "TouchedPlant") -> None:
        self._plant = plant
        contactors, size = plant.port.B.shape
        count = round(STEPS * LARGEST_FORCE**0.25) + 2
        inputs = plant.shape.derivatives.shape[1]
        self._maps = np.zeros((count, contactors, size, size + inputs))
        self._known = np.zeros(count, bool)
        self._all = np.arange(contactors)
        self._latest = np.full(contactors, -1)
        self._pair = np.zeros((contactors, size, 2, size + inputs))
        self._steady = self._latest, np.zeros(0), self._maps[0]
        branches = plant.port.springs.stop - plant.port.springs.start
        self.roots = np.zeros((count, contactors, branches))
        for step in range(1, count):
            load = plant.touch.load_at((step / STEPS) ** 4)
            self.roots[step] = spring_roots(load, contactors)

    def places(self, force: Floats) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the step below each force (S, N), the share of the one above, and √k of the load.

        The smallest force of a touching finger is the first step, so that the finger is either
        there or gone.
        """
        place = STEPS * force**0.25
        place = np.where((place > 0) & (place < 1), 1.0, place)
        step = np.minimum(place.astype(np.intp), len(self._known) - 2)
        share = place - step
        low, high = self.roots[step, self._all], self.roots[step + 1, self._all]
        return step, share, low + share[..., None] * (high - low)

    def pair(self, step: NDArray[np.intp]) -> Floats:
        """Return the maps (N, n, 2 (n + inputs)) of each contactor's step and of the one above."""
        moved = np.flatnonzero(step != self._latest)
        for needed in np.unique([step[moved], step[moved] + 1]):
            if not self._known[needed]:
                self._maps[needed] = self._map(needed)
                self._known[needed] = True
        for above in (0, 1):
            self._pair[moved, :, above] = self._maps[step[moved] + above, moved]
        self._latest = step
        return self._pair.reshape(*self._pair.shape[:2], -1)

    def at(self, step: NDArray[np.intp], share: Floats) -> Floats:
        """Return the map (N, n, n + inputs) between each contactor's step and the one above."""
        if not (np.array_equal(step, self._steady[0]) and np.array_equal(share, self._steady[1])):
            self.pair(step)
            low, high = self._pair[:, :, 0], self._pair[:, :, 1]
            self._steady = step, share, low + share[:, None, None] * (high - low)
        return np.asarray(self._steady[2])

    def _map(self, step: int) -> Floats:
        """Compute the map of one sample under a constant load."""
        port, shape = self._plant.port, self._plant.shape
        A = loaded(port, self._plant.touch.load_at((step / STEPS) ** 4))
        size, pieces = A.shape[1], len(shape.pieces)
        each = shape.derivatives.shape[1] // pieces
        whole = np.zeros((len(A), size, size + pieces * each))
        whole[:, :, :size] = np.eye(size)
        for i, length in enumerate(shape.pieces / self._plant.sample_rate):
            augmented = np.zeros((len(A), size + each, size + each))
            augmented[:, :size, :size], augmented[:, :size, size] = A * length, port.B * length
            augmented[:, size:, size:] = np.eye(each, k=1)
            e = expm(augmented)
            whole = e[:, :size, :size] @ whole
            start = size + i * each
            whole[:, :, start : start + each] = e[:, :size, size:]
        return whole


class TouchedPlant:
    """Simulated contactors under fingers that change: drive voltage in, shear and current out.

    Parameters
    ----------
    bimorph : Bimorph
        Design of the benders.
    touch : Touch
        Load of each contactor, and course of the normal force. The first drive sample is played at
        time 0.
    sample_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors N.
    amplifier : Amplifier, optional
        Amplifier between drive and electrodes; ideal by default.
    tolerances : Tolerances, optional
        Differences between the benders; by default all are as designed.
    hysteresis : Hysteresis, optional
        Hysteresis of the ceramic, as mechanics and charge see the drive; none by default. It acts
        before low-pass and resistance of the amplifier.

    Attributes
    ----------
    delay : int
        Delay of the outputs against the drive [samples].
    port : TipPort
        Continuous-time system of the contactors in air.
    force : (N,) array of float
        Normal force of each contactor at present, `REACH` samples after the latest output [N].

    Notes
    -----
    Outputs do not depend on how the drive is divided into blocks. Forces above `LARGEST_FORCE` are
    taken for that.

    Examples
    --------
    A finger that lifts off after 0.25 s: 10 V shear the skin by 5.64 µm, and the tip in air by 9.31
    µm.

    >>> import numpy as np
    >>> import tactile
    >>> from tactile.actuator.touch import NormalForce, Touch
    >>> from tactile.actuator.touched_plant import TouchedPlant
    >>> touch = Touch(load=tactile.FingerLoad.low(), force=NormalForce(liftoff=0.25))
    >>> plant = TouchedPlant(tactile.Bimorph(), touch, 8000.0, contactors=1)
    >>> displacement, current = plant.step(np.full((4000, 1), 10.0))
    >>> [round(float(displacement[k, 0]) * 1e6, 2) for k in (1999, 3999)]
    [5.64, 9.31]
    """

    def __init__(
        self,
        bimorph: Bimorph,
        touch: Touch,
        sample_rate: float,
        *,
        contactors: int,
        amplifier: Amplifier | None = None,
        tolerances: Tolerances | None = None,
        hysteresis: Hysteresis | None = None,
    ) -> None:
        amplifier = Amplifier() if amplifier is None else amplifier
        tolerances = Tolerances.none(contactors) if tolerances is None else tolerances
        load = touch.load.loads[0] if isinstance(touch.load, FingerTable) else touch.load
        self.delay = HALF_WIDTH + REACH
        self.touch, self.sample_rate = touch, sample_rate
        self.port = tip_ports(bimorph, tolerances, amplifier, branches=len(load.branches))
        self.shape = drive_shape(amplifier, sample_rate)
        self._maps = _Maps(self)
        self._state: Floats = np.zeros(self.port.B.shape)
        self._past = np.zeros((self.shape.taps - 1, contactors))
        self._position = -HALF_WIDTH
        self._derivative = Derivative(contactors)
        self._late = np.zeros((REACH, contactors))
        self._set_hysteresis(hysteresis, amplifier)
        self.force = self._forces(1)[0]
        self._roots = np.zeros((contactors, 1 + len(load.branches)))

    def _set_hysteresis(self, hysteresis: Hysteresis | None, amplifier: Amplifier) -> None:
        """Prepare the hysteresis: of the samples if they are held, of the course between if not."""
        self._plays: Plays | None = None
        self._bent: BentDrive | None = None
        rows = [self.shape.derivatives, self.shape.value[:, None]]
        if hysteresis is not None and amplifier.hold == "zoh":
            self._plays = Plays(hysteresis, len(self._state))
        elif hysteresis is not None:
            self._bent = BentDrive(hysteresis, len(self._state))
            window = window_of(amplifier, self.sample_rate)
            rows.append(weights(np.arange(1, FINE + 1) / FINE, window, amplifier).T)
        self._weights = np.hstack(rows)

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Whether each contactor is touched at present, array (N,)."""
        return np.asarray(self.force > 0)

    @property
    def load(self) -> FingerLoad:
        """Present load of each contactor, of arrays (N,)."""
        return self.touch.load_at(self.force)

    @property
    def beam_energy(self) -> Floats:
        """Energy of motion and bending in each bender, array (N,) [J]."""
        return np.asarray((self._state[:, self.port.beam] ** 2).sum(axis=1) / 2)

    @property
    def finger_energy(self) -> Floats:
        """Energy in the springs of each finger, array (N,) [J]."""
        return np.asarray((self._state[:, self.port.springs] ** 2).sum(axis=1) / 2)

    def step(self, drive: Floats) -> tuple[Floats, Floats]:
        """Play drive samples.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive of each contactor [V].

        Returns
        -------
        displacement : (S, N) array of float
            Shear displacement of the skin under each contactor, ``delay`` samples late [m].
        current : (S, N) array of float
            Current into the electrodes, equally late [A].
        """
        out = np.empty((2, *drive.shape))
        for start in range(0, len(drive), CHUNK):
            block = drive[start : start + CHUNK]
            if self._plays is not None:
                block = block + self._plays.follow(block)
            inputs, value = self._courses(block)
            states = self._run(inputs)
            shear = np.einsum("snj,nj->sn", states, self.port.u)
            charge = np.einsum("snj,nj->sn", states, self.port.C_q) + self.port.D_q * value
            line = np.concatenate([self._late, shear])
            self._late = line[len(shear) :]
            part = out[:, start : start + len(block)]
            part[0], part[1] = line[: len(shear)], self._derivative.follow(charge)
        return out[0], out[1] * self.sample_rate

    def _courses(self, block: Floats) -> tuple[Floats, Floats]:
        """Return derivatives (S, N, inputs) of the drive in each sample, and its value (S, N)."""
        line = np.concatenate([self._past, block])
        self._past = line[len(block) :].copy()
        windows = np.ascontiguousarray(sliding_window_view(line, self.shape.taps, axis=0))
        course, count = windows @ self._weights, self.shape.derivatives.shape[1]
        inputs, value = course[..., :count], course[..., count]
        if self._bent is not None:
            more = self._bent.follow(course[..., count + 1 :].swapaxes(1, 2))
            inputs[..., : FINE + 1] += more
            value += more[..., 0]
        return inputs, value

    def _run(self, inputs: Floats) -> Floats:
        """Advance the states by a chunk; return them (S, N, n) at the start of each sample."""
        forces = self._forces(len(inputs))
        step, share, roots = self._maps.places(forces)
        before = np.concatenate([self._roots[None], roots[:-1]])
        kept = np.minimum(before, roots) / np.maximum(np.maximum(before, roots), SMALLEST)
        size = self._state.shape[1]
        line = np.zeros((len(inputs) + 1, len(self._state), size + inputs.shape[2]))
        line[0, :, :size], line[:-1, :, size:] = self._state, inputs
        if np.all(forces == forces[0]) and np.array_equal(before, roots):
            self._stay(line, self._maps.at(step[0], share[0]))
        else:
            self._change(line, step, share, kept)
        self._position += len(inputs)
        self._state, self._roots, self.force = line[-1, :, :size].copy(), roots[-1], forces[-1]
        return np.asarray(line[:-1, :, :size])

    def _stay(self, line: Floats, map_: Floats) -> None:
        """Advance the states in a line (S + 1, N, n + inputs) under a constant load."""
        size = self._state.shape[-1]
        for now, following in pairwise(line[..., None]):
            np.matmul(map_, now, out=following[:, :size])

    def _change(self, line: Floats, step: NDArray[np.intp], share: Floats, kept: Floats) -> None:
        """Advance the states in a line while the load changes."""
        size, springs = self._state.shape[1], self.port.springs
        shares = np.stack([1 - share, share], axis=2)[..., None]
        moves = [True, *np.any(step[1:] != step[:-1], axis=1).tolist()]
        both = np.empty((len(self._state), 2, line.shape[2]))
        column = both.reshape(len(both), -1, 1)
        for k in range(len(line) - 1):
            line[k, :, springs] *= kept[k]
            if moves[k]:
                pair = self._maps.pair(step[k])
            np.multiply(line[k, :, None], shares[k], out=both)
            np.matmul(pair, column, out=line[k + 1, :, :size, None])

    def _forces(self, count: int) -> Floats:
        """Return the force in the middle of the next samples, array (count, N)."""
        time = (self._position + 0.5 + np.arange(count)) / self.sample_rate
        force = np.asarray(self.touch.force(np.maximum(time, 0)), np.float64)
        force = force[:, None] if force.ndim == 1 else force
        return np.broadcast_to(np.clip(force, 0, LARGEST_FORCE), (count, len(self._state)))
