"""Travel: the stage of the limiter that bounds how far a drive would swing free tips.

When the finger leaves, a drive that was made for a loaded tip swings the free one up. An amplifier
that measures no current cannot notice that. This stage therefore never puts out a drive that would
swing a free tip further than it survives (`free_tip`), whether there is a finger or not.

It computes the swing of each tip from the drive that is put out, and looks as far ahead as the
limiter does. One gain, common to all contactors, is lowered so far that the present swing plus what
follows within the look-ahead stays within the limit; it recovers with the time constant of the
limiter. Where nothing comes near the limit, nothing is changed.

The bound holds for any input. A step that the slew limit forbids cannot be taken back at once, so
that every sample must leave a way out: the drive that falls from there to 0 V as fast as the slew
limit allows, by the same factor each sample, must keep the limit as well. That drive is always at
hand for the next sample. The drive goes from there towards its target as far as the limit allows.

Guards in an amplifier, which measure the current, may watch some of the contactors instead. How far
these swing is then unknown here, since a finger holds them. When such a contactor is bounded again,
it is taken as at rest under the latest drive: the finger that was there until then held it closer.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats, Singles
from tactile.rendering.free_tip import PIECE, FreeTip, largest_share

APART, NEARLY = 4, 0.999
"""Distance of the states at which a quiet drive is looked at, and part of the limit that they and
what may lie between them come up to."""
SETTLED = 1e-6
"""Reduction of the gain that is taken for none."""
ROUNDING = 5e-10
"""Relative distance that is kept from the largest travel; less than that of the limiter from its
limits, so that the highest voltage can be held where it gives the largest travel."""


class Bounded(NamedTuple):
    """Drive that keeps all limits.

    Attributes
    ----------
    drive : (S, N) array of float
        Drive [V].
    gain : (S,) array of float
        Gain of each sample.
    guarded : int
        Number of samples that went only part of the way to what their gain makes of them.
    """

    drive: Floats
    gain: Floats
    guarded: int


class TravelStage:
    """Bounds the swing of N free tips, and the step from sample to sample.

    Parameters
    ----------
    tip : FreeTip
        Model of the free tip.
    voltage, step : float
        Largest magnitude of a sample, which the drive keeps, and largest step [V].
    recovery : float
        Factor by which the reduction of the gain falls from sample to sample.
    ahead : int
        Number of samples that are known ahead of each.
    channels : int
        Number of contactors N.
    """

    def __init__(
        self,
        tip: FreeTip,
        voltage: float,
        step: float,
        *,
        recovery: float,
        ahead: int,
        channels: int,
    ) -> None:
        self._tip, self._largest = tip, tip.largest * (1 - ROUNDING)
        self._step, self._recovery, self._ahead = step, recovery, ahead
        self._state = np.zeros(channels, np.complex128)
        self._watched = np.zeros(channels, np.bool_)
        self._bounded_here: Floats | None = None
        """1 for contactors that are bounded here, 0 for others; None if all are."""
        self._reduction = 0.0
        self._maps: dict[int, tuple[Singles, Floats]] = {}
        self._ends: dict[int, tuple[Floats, complex]] = {}
        self._fall = max(1 - step / voltage, 0.0)
        """Factor of the drive from sample to sample on the way out."""
        pole, count = tip.pole, self._way_out(voltage)
        self._turns = pole ** np.append(np.arange(1, count + 1), ahead + 1)[:, None]
        """Factors of the state after each sample of the way out and after the look-ahead."""
        alone = (1 - pole) * pole ** np.arange(count)
        added = np.convolve(alone, self._fall ** np.arange(count))[:count]
        self._out = added[:, None]
        """States per volt of the next sample, after it and those of the way out from there."""
        self._beside = float(np.abs(added - alone).max())
        """Largest of the states that the way out alone adds."""
        self._weights = (1 - pole) * pole ** np.arange(ahead, -1, -1)
        """State after the look-ahead per volt of each of its samples."""

    def _way_out(self, voltage: float) -> int:
        """Return the number of samples of the way out after which the limit holds by itself.

        Then damping takes more from a state at the limit than the drive, which falls from the
        highest voltage, can add.
        """
        pole = self._tip.pole
        spare = (1 - abs(pole)) * self._largest / (abs(1 - pole) * voltage)
        if self._fall == 0 or spare >= 1:
            return 1
        return 1 + math.ceil(math.log(spare) / math.log(self._fall))

    def leave(self, watched: NDArray[np.bool_], last: Floats) -> None:
        """Leave contactors to guards in an amplifier, from the next sample on, and no others.

        Parameters
        ----------
        watched : (N,) array of bool
            Contactors that guards watch.
        last : (N,) array of float
            Sample before [V].
        """
        if np.array_equal(watched, self._watched):
            return
        back = self._watched & ~watched
        self._state = np.where(watched, 0, np.where(back, last, self._state))
        self._watched = watched.copy()
        self._bounded_here = (~watched).astype(np.float64) if watched.any() else None

    def _of_free(self, values: Floats) -> Floats:
        """Return values (..., N) of the contactors that are bounded here, and 0 for others."""
        return values if self._bounded_here is None else values * self._bounded_here

    def passes(self, line: Floats, highest: float) -> bool:
        """Follow a drive that keeps all other limits, if nothing in it comes near this one.

        Parameters
        ----------
        line : (S + ahead, N) array of float
            Drive, the look-ahead of the last sample included [V].
        highest : float
            Magnitude that no sample of it exceeds [V].

        Returns
        -------
        bool
            Whether it may be put out as it is; if not, nothing has changed.
        """
        if self._reduction:
            return False
        if self._bounded_here is not None:
            if not self._bounded_here.any():
                return True
            line = line * self._bounded_here
        if self._is_far(line, highest):
            self._state = self._turn(line[: len(line) - self._ahead])
            return True
        swing = self._tip.swing(line, self._state)
        if _largest(swing) > self._largest - self._beside * highest:
            return False
        self._state = swing[-self._ahead - 1].copy()
        return True

    def _is_far(self, line: Floats, highest: float) -> bool:
        """Return whether a look at every fourth state shows that all are far from the limit.

        Between two of them a state grows by at most three samples. Single precision is exact enough
        for `NEARLY`.
        """
        between = (APART - 1) * abs(1 - self._tip.pole) + self._beside
        most = NEARLY * self._largest - between * highest
        if len(line) > PIECE or not most > _largest(self._state):
            return False
        matrix, turns = self._looks(len(line))
        held = turns @ np.stack([self._state.real, self._state.imag])
        swing = matrix @ line.astype(np.float32) + held.astype(np.float32)
        square = swing * swing
        half = len(square) // 2
        return float(np.maximum.reduce(square[:half] + square[half:], axis=None)) <= most**2

    def _looks(self, count: int) -> tuple[Singles, Floats]:
        """Return what samples (count,) and the state add to real and imaginary parts of states."""
        if count not in self._maps:
            at = np.append(np.arange(APART - 1, count - 1, APART), count - 1)
            later = at[:, None] - np.arange(count)
            added = np.where(later >= 0, (1 - self._tip.pole) * self._tip.pole ** abs(later), 0)
            turn = self._tip.pole ** (at + 1)
            self._maps[count] = (
                np.concatenate([added.real, added.imag]).astype(np.float32),
                np.block([[turn.real[:, None], -turn.imag[:, None]],
                          [turn.imag[:, None], turn.real[:, None]]]),
            )  # fmt: skip
        return self._maps[count]

    def _turn(self, drive: Floats) -> Complex:
        """Return the state after a drive (S, N)."""
        count = len(drive)
        if count not in self._ends:
            added = (1 - self._tip.pole) * self._tip.pole ** np.arange(count - 1, -1, -1)
            self._ends[count] = np.stack([added.real, added.imag]), self._tip.pole**count
        (real, imaginary), turn = self._ends[count]
        return np.asarray(turn * self._state + real @ drive + 1j * (imaginary @ drive))

    def __call__(self, line: Floats, gain: Floats, last: Floats) -> Bounded:
        """Compute the drive that may be put out.

        Parameters
        ----------
        line : (S + ahead, N) array of float
            Drive, the look-ahead of the last sample included [V].
        gain : (S,) array of float
            Gain of each sample, with which it keeps the voltage.
        last : (N,) array of float
            Sample before [V].

        Returns
        -------
        Bounded
            Drive within the limits, with its gain.
        """
        drive = line[: len(gain)] * gain[:, None]
        calm = gain.min() == 1 and self._steps(drive, last).max() <= self._step
        if calm and self.passes(line, _largest(line)):
            return Bounded(drive, gain, 0)
        ahead = self._following(line) * gain[:, None]
        return self._recovering(drive, ahead, gain, last) or self._bounded(drive, ahead, gain, last)

    @staticmethod
    def _steps(drive: Floats, last: Floats) -> Floats:
        """Return the largest step (S,) to each sample."""
        return np.asarray(np.abs(np.diff(drive, axis=0, prepend=last[None])).max(axis=1))

    def _following(self, line: Floats) -> Complex:
        """Return what each sample (S, N) and those of its look-ahead add to the state."""
        window = sliding_window_view(self._of_free(line), self._ahead + 1, axis=0)
        return np.asarray((window @ self._weights.real) + 1j * (window @ self._weights.imag))

    def _recovering(
        self, drive: Floats, ahead: Complex, gain: Floats, last: Floats
    ) -> Bounded | None:
        """Return the drive if the gain can recover in all of it without a limit; else None."""
        reduction = self._reduction * self._recovery ** np.arange(1, len(drive) + 1)
        share = 1 - np.where(reduction < SETTLED, 0.0, reduction)[:, None]
        drive, ahead = drive * share, ahead * share
        if self._steps(drive, last).max() > self._step:
            return None
        swing = self._tip.swing(self._of_free(drive), self._state)
        before = np.concatenate([self._state[None], swing[:-1]])
        most = self._largest - self._beside * _largest(drive)
        if _largest(swing) > most:
            return None
        if _largest(self._turns[-1] * before + ahead) > self._largest:
            return None
        self._state, self._reduction = swing[-1].copy(), 1 - float(share[-1, 0])
        return Bounded(drive, gain * share[:, 0], 0)

    def _bounded(self, drive: Floats, ahead: Complex, gain: Floats, last: Floats) -> Bounded:
        """Return the drive with the gain that the limit requires, sample by sample."""
        gain, guarded = gain.copy(), 0
        added = np.concatenate([self._out * self._of_free(drive)[:, None], ahead[:, None]], axis=1)
        for n, sample in enumerate(drive):
            held = self._turns * self._state
            share = self._share(held, added[n])
            gain[n] *= share
            sample *= share
            move = sample - last
            largest = _largest(move)
            if largest > self._step:
                sample[:] = self._toward(held[:-1], last, last + move * (self._step / largest))
                guarded += 1
            self._state = held[0] + self._out[0] * self._of_free(sample)
            last = sample
        return Bounded(drive, gain, guarded)

    def _share(self, held: Complex, added: Complex) -> float:
        """Return the gain of a sample, with states (K, N) without it and what it adds to them."""
        self._reduction *= self._recovery
        if self._reduction < SETTLED:
            self._reduction = 0.0
        size = np.abs(held + (1 - self._reduction) * added)
        if np.maximum.reduce(size, axis=None) > self._largest:
            over = size > self._largest
            share = largest_share(held[over], added[over], self._largest)
            self._reduction = max(self._reduction, 1 - share)
        return 1 - self._reduction

    def _toward(self, held: Complex, last: Floats, target: Floats) -> Floats:
        """Return the sample after another one, as near to a target as the travel allows.

        The target is within the step, and so is the first sample of the way out.
        """
        out = self._fall * last
        if _largest(held + self._out * self._of_free(target)) <= self._largest:
            return target
        there, more = self._out * self._of_free(out), self._out * self._of_free(target - out)
        share = largest_share(held + there, more, self._largest)
        return np.asarray(out + min(share, 1.0) * (target - out))


def _largest(values: Floats | Complex) -> float:
    """Return the largest magnitude, without the detour of `max`, which takes longer than that."""
    return float(np.maximum.reduce(np.abs(values), axis=None))
