"""Drive that measures the coupling of contactors through the skin: slots of the same tones.

Each slot has the tones with other signs (`neighbors.sign_patterns`). Its windows of lag sums differ
from those of the other slots by what the neighbors add alone, since its own drive, and with it the
error of the capacitance and the hysteresis, is the same but for the sign.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.sensing.bender import Bender
from tactile.sensing.calibration import HIGHEST, MeasuringLimits, strongest
from tactile.sensing.finger_drive import faded

BAND = (40.0, 2400.0)
"""Lowest and highest tone [Hz]."""
TONES = 40
"""Number of tones, evenly over log f."""
CORNER = 600.0
"""Frequency above which tones are weaker, by its ratio squared, so that the couplings are those at
low frequencies: that they are real and the same at all is an approximation, and at high ones waves
run through the skin. The loads still need tones up to the end of the band [Hz]."""
SLOT = 3
"""Length of a slot in windows of lag sums."""
FADE = 12.5e-3
"""Duration of the fades at both ends of a slot [s]."""


@dataclass(frozen=True)
class CouplingPlan:
    """Drive of N contactors in slots.

    Attributes
    ----------
    tones : (L,) array of float
        Drive of a slot, which begins and ends at 0 V [V].
    signs : (S, N) array of float
        Sign of each contactor's drive in each slot.
    """

    tones: Floats
    signs: Floats

    @property
    def drive(self) -> Floats:
        """Drive of each contactor, (S · L, N) array of float [V]."""
        slots = self.signs[:, None] * self.tones[:, None]
        return np.asarray(slots.reshape(-1, self.signs.shape[1]))


def amplitude(frequency: Floats) -> Floats:
    """Compute the amplitudes of tones in relation to each other.

    Parameters
    ----------
    frequency : (F,) array of float
        Frequencies [Hz].

    Returns
    -------
    (F,) array of float
        Amplitudes; 0 outside `BAND`.
    """
    inside = (frequency >= BAND[0]) & (frequency <= BAND[1])
    return np.asarray(inside * np.minimum(1, CORNER / frequency) ** 2)


def plan_coupling(
    bender: Bender, sample_rate: float, limits: MeasuringLimits, signs: Floats, *, window: int
) -> CouplingPlan:
    """Compute the drive that measures the coupling.

    Parameters
    ----------
    bender : Bender
        The design.
    sample_rate : float
        Sample rate [Hz].
    limits : MeasuringLimits
        Limits of the drive.
    signs : (S, N) array of float
        Signs of the slots.
    window : int
        Length of a window of lag sums [samples].

    Returns
    -------
    CouplingPlan
        Drive, 1.2 s long with 16 slots and windows of 25 ms.
    """
    lines = np.geomspace(BAND[0], min(BAND[1], HIGHEST * sample_rate), TONES)
    tones = strongest(
        lines, amplitude(np.minimum(lines, BAND[1])), SLOT * window, sample_rate, bender, limits,
        np.random.default_rng(0),
    )  # fmt: skip
    return CouplingPlan(faded(tones, round(FADE * sample_rate)), signs)
