"""Hysteresis of a bender between drive and effective voltage, and its inverse, as play operators.

A soft piezoceramic does not follow its drive in proportion: the branches of its loop between
voltage and polarization are 12 to 15 % of the swing apart at full drive, and the gain grows with
the amplitude. Charge and force follow the polarization, so that both are linear in an effective
voltage (Newcomb & Flinn 1982: displacement against charge is nearly linear). The effective voltage
is that of the Prandtl–Ishlinskii model,

    v = u + Σ_j w_j play_j[u],

of play operators that follow the drive only when it is farther away than their radius r_j. The
inverse of such a model is one of the same form, with other radii and weights (Krejčí & Kuhnen
2001), so that an effective voltage can be played exactly.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats

LONGEST = 16
"""Largest number of samples that is processed at a time, for what fits into a cache."""


@dataclass(frozen=True)
class PlayModel:
    """Prandtl–Ishlinskii model of N benders.

    Attributes
    ----------
    radii : (N, R) array of float
        Radius of each play operator, ascending [V].
    weights : (N, R) array of float
        Weight of each play operator.
    """

    radii: Floats
    weights: Floats

    @classmethod
    def none(cls, contactors: int) -> "PlayModel":
        """Return the model of benders without hysteresis, which has no play operators.

        Parameters
        ----------
        contactors : int
            Number of benders N.

        Returns
        -------
        PlayModel
            Model whose effective voltage is the drive.
        """
        return cls(np.zeros((contactors, 0)), np.zeros((contactors, 0)))

    def loop_width(self, amplitude: float) -> Floats:
        """Compute how far apart the branches of a loop are at most.

        Parameters
        ----------
        amplitude : float
            Amplitude of the drive [V].

        Returns
        -------
        (N,) array of float
            Largest distance of the effective voltages of both branches, relative to their swing.
        """
        inside = np.minimum(self.radii, amplitude)
        apart = (self.weights * np.minimum(inside, amplitude - inside)).sum(axis=1)
        return np.asarray(apart / (amplitude + (self.weights * (amplitude - inside)).sum(axis=1)))

    def inverse(self) -> "PlayModel":
        """Return the model whose effective voltage is the drive of this one.

        The virgin curve u + Σ w_j max(u − r_j, 0) has the slopes m_j = 1 + Σ_{i ≤ j} w_i behind its
        corners. Its inverse has the slopes 1/m_j behind the corners' values.

        Returns
        -------
        PlayModel
            Inverse model.
        """
        corners = np.maximum(self.radii[:, :, None] - self.radii[:, None], 0)
        slopes = np.cumsum(np.insert(self.weights, 0, 1.0, axis=1), axis=1)
        return PlayModel(
            self.radii + np.einsum("nri,ni->nr", corners, self.weights), np.diff(1 / slopes, axis=1)
        )


class HysteresisStream:
    """Effective voltage of a drive, sample by sample, from play operators that begin at 0 V.

    Parameters
    ----------
    model : PlayModel
        Model of N benders.
    """

    def __init__(self, model: PlayModel) -> None:
        self._radii, self._weights = model.radii.T.copy(), model.weights.T.copy()
        self._smallest = model.radii.min(axis=0) if model.weights.any() else np.zeros(0)
        """Smallest radius of each play operator among the contactors; empty if there is none."""
        self._plays, self._highest = np.zeros_like(self._radii), 0.0

    def __call__(self, drive: Floats) -> Floats:
        """Compute the effective voltage of the next samples.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive [V].

        Returns
        -------
        (S, N) array of float
            Effective voltage [V].
        """
        if not len(self._smallest):
            return drive
        if len(drive) > LONGEST:
            parts = range(0, len(drive), LONGEST)
            return np.concatenate([self(drive[k : k + LONGEST]) for k in parts])
        self._highest = max(self._highest, float(np.abs(drive).max(initial=0.0)))
        moving = int(np.searchsorted(self._smallest, self._highest))  # wider ones are still at 0 V
        if not moving:
            return drive
        radii = self._radii[:moving]
        highest, lowest = drive[:, None] + radii, drive[:, None] - radii
        play = self._plays[:moving]
        for high, low in zip(highest, lowest, strict=True):
            np.maximum(play, low, out=low)
            np.minimum(low, high, out=low)
            play = low
        self._plays[:moving] = play
        return np.asarray(drive + np.einsum("srn,rn->sn", lowest, self._weights[:moving]))


class EffectiveVoltage:
    """Effective voltage of pieces of a drive that overlap.

    Parameters
    ----------
    hysteresis : PlayModel
        Hysteresis of N contactors.
    """

    def __init__(self, hysteresis: PlayModel) -> None:
        self._hysteresis = hysteresis
        self.restart()

    def restart(self) -> None:
        """Begin with another drive, before which there was none."""
        self._stream = HysteresisStream(self._hysteresis)
        self._voltage, self._end = np.zeros((0, len(self._hysteresis.radii))), 0

    def follow(self, first: int, drive: Floats) -> Floats:
        """Compute the effective voltage of a piece that does not end before the one before it.

        Parameters
        ----------
        first : int
            Position of its first sample. If what lies between is missing, the contactors are taken
            to have had no drive before it.
        drive : (S, N) array of float
            Drive [V].

        Returns
        -------
        (S, N) array of float
            Effective voltage [V].
        """
        if not self._hysteresis.weights.any():
            return drive
        known = self._end - first
        if not 0 <= known <= min(len(drive), len(self._voltage)):
            self.restart()
            known = 0
        line = np.concatenate([self._voltage, self._stream(drive[known:])])
        self._voltage, self._end = line[-len(drive) :], first + len(drive)
        return self._voltage
