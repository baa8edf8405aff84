"""The pilot, which is played beside a texture in order to measure."""

import numpy as np

from tactile.arrays import Floats

TONES = (1440.0, 1560.0, 1680.0, 1840.0)
"""Frequencies of the pilot [Hz]: above the band of textures, below the null of the bender's force
at 2.5 kHz, and whole multiples of 40 Hz, so that windows of 25 ms hold whole periods."""
VOLTS = (0.28, 0.4, 0.48, 0.65)
"""Amplitudes of the pilot's tones [V]. Together they stay 20 dB below the threshold at the softest
of 40 fingers; the threshold rises by 22 dB per octave there (assumed, see
`texture.perception.THRESHOLD`)."""


def pilot_phases(contactors: int) -> Floats:
    """Draw the phases of the pilot, so that tones do not add up over contactors.

    Parameters
    ----------
    contactors : int
        Number of contactors, N.

    Returns
    -------
    (K, N) array of float
        Phases of the K tones [rad].
    """
    rng = np.random.default_rng(0)
    return rng.uniform(0, 2 * np.pi, (len(TONES), contactors))


def pilot(first: int, samples: int, sample_rate: float, phases: Floats) -> Floats:
    """Compute samples of the pilot.

    Parameters
    ----------
    first : int
        Position of the first sample in the stream.
    samples : int
        Number of samples, S.
    sample_rate : float
        Sample rate [Hz].
    phases : (K, N) array of float
        Phases of the tones.

    Returns
    -------
    (S, N) array of float
        Drive to be added [V].
    """
    time = (first + np.arange(samples)) / sample_rate
    angle = 2 * np.pi * np.outer(time, TONES)
    volts = np.asarray(VOLTS)
    return np.asarray(
        (np.cos(angle) * volts) @ np.cos(phases) - (np.sin(angle) * volts) @ np.sin(phases)
    )
