"""Drive with which a finger that rests on the display is measured: a quarter of a second of tones.

Many tones play at a time, in contrast to the calibration: a load has only four constants, and
sixteen sums of each of ten windows tell them, while a capacitance over frequency needs its lines
apart. Drive that is equal at all frequencies gave the smallest errors of the load; shaped like the
threshold of touch, so that it was hardly felt, it made them twice as large, and at a quarter of the
voltage too (on the benchmark's plant). As large as in the calibration, it meets the same hysteresis
of the ceramic. It is felt as a short buzz.
"""

import numpy as np

from tactile.arrays import Floats
from tactile.sensing.bender import Bender
from tactile.sensing.calibration import HIGHEST, MeasuringLimits, strongest

BAND = (10.0, 2400.0)
"""Lowest and highest tone [Hz]. The model of the current reaches up to 2600 Hz, and a sudden fade
would exceed that."""
TONES = 40
"""Number of tones, evenly over log f."""
DURATION, FADE = 0.25, 0.025
"""Duration, and that of its fades in and out, which it includes [s]."""


def measuring_drive(bender: Bender, sample_rate: float, limits: MeasuringLimits) -> Floats:
    """Compute the drive, the same for all contactors.

    Parameters
    ----------
    bender : Bender
        The design.
    sample_rate : float
        Sample rate [Hz].
    limits : MeasuringLimits
        Limits of the drive.

    Returns
    -------
    (S,) array of float
        Drive, which begins and ends at 0 V [V].
    """
    samples = round(DURATION * sample_rate)
    lines = np.geomspace(BAND[0], min(BAND[1], HIGHEST * sample_rate), TONES)
    drive = strongest(
        lines, np.ones(TONES), samples, sample_rate, bender, limits, np.random.default_rng(0)
    )
    return faded(drive, round(FADE * sample_rate))


def faded(drive: Floats, samples: int) -> Floats:
    """Let a drive rise from 0 V and fall to 0 V, as a cosine does.

    Parameters
    ----------
    drive : (S,) array of float
        Drive [V].
    samples : int
        Length of each fade [samples].

    Returns
    -------
    (S,) array of float
        Drive that begins and ends at 0 V [V].
    """
    rise = (1 - np.cos(np.pi * (np.arange(samples) + 0.5) / samples)) / 2
    middle = np.ones(len(drive) - 2 * samples)
    return np.asarray(drive * np.concatenate([rise, middle, rise[::-1]]))
