"""Signals that are played in order to measure: the multisine of the calibration, and the pilot."""

import numpy as np

from tactile.arrays import Complex, Floats

TONES = (1440.0, 1560.0, 1680.0, 1840.0)
"""Frequencies of the pilot [Hz]: above the band of textures, below the null of the bender's force
at 2.5 kHz, and whole multiples of 40 Hz, so that windows of 25 ms hold whole periods."""
VOLTS = (0.28, 0.4, 0.48, 0.65)
"""Amplitudes of the pilot's tones [V]. Together they stay 20 dB below the threshold at the softest
of 40 fingers; the threshold rises by 22 dB per octave there (assumed, see
`texture.perception.THRESHOLD`)."""
PERIOD = 1.0
"""Period of the calibration's multisine [s]."""
BAND = (10.0, 2900.0)
"""Lowest and highest line of the multisine [Hz]."""
LARGEST = 20.0
"""Largest magnitude of the multisine [V]."""
CORNER = 250.0
"""Frequency above which the lines of the multisine have equal currents [Hz]."""
TRIALS = 200
"""Number of sets of random phases that are tried."""
FILLING = 0.8
"""Part of the converter's range that the current of the multisine may fill."""


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


def calibration_lines(resonance: float) -> Floats:
    """Choose the lines of the multisine: evenly over log f, and every 3 Hz around the resonance.

    Parameters
    ----------
    resonance : float
        Expected resonance in air [Hz].

    Returns
    -------
    (F,) array of float
        Frequencies, whole multiples of 1/`PERIOD` [Hz].
    """
    wide = np.geomspace(*BAND, 80)
    near = np.arange(0.85 * resonance, 1.15 * resonance, 3.0)
    lines = np.unique(np.rint(np.concatenate([wide, near]) * PERIOD)) / PERIOD
    return np.asarray(lines)


def multisine(lines: Floats, sample_rate: float, *, capacitance: float, current: float) -> Floats:
    """Create one period of a sum of sinusoids whose currents are alike.

    Below `CORNER` all lines have the same voltage, above it the same current. Of `TRIALS` sets of
    random phases, the one with the lowest peaks is taken.

    Parameters
    ----------
    lines : (F,) array of float
        Frequencies, whole multiples of 1/`PERIOD` [Hz].
    sample_rate : float
        Sample rate [Hz].
    capacitance : float
        Capacitance of a channel [F].
    current : float
        Largest current that can be measured [A].

    Returns
    -------
    (S,) array of float
        Drive of one period, within `LARGEST` and within `FILLING` of the measurable current [V].
    """
    omega, time = 2 * np.pi * lines, np.arange(round(PERIOD * sample_rate)) / sample_rate
    amplitude = 1 / np.maximum(lines, CORNER)
    rng = np.random.default_rng(0)
    best = np.zeros_like(time), np.inf
    for _ in range(TRIALS):
        turning = np.zeros(len(time) // 2 + 1, np.complex128)
        at = np.rint(lines * PERIOD).astype(int)
        turning[at] = amplitude * np.exp(2j * np.pi * rng.random(len(lines))) * len(time) / 2
        volts = np.fft.irfft(turning, len(time))
        turning[at] *= 1j * omega * capacitance
        drawn = np.fft.irfft(turning, len(time))
        over = max(np.abs(volts).max() / LARGEST, np.abs(drawn).max() / (FILLING * current))
        if over < best[1]:
            best = volts, over
    return best[0] / best[1]


def line_spectrum(signal: Floats, lines: Floats) -> Complex:
    """Compute the complex amplitudes of one period of a signal at the lines.

    Parameters
    ----------
    signal : (S, ...) array of float
        Samples of one `PERIOD`.
    lines : (F,) array of float
        Frequencies, whole multiples of 1/`PERIOD` [Hz].

    Returns
    -------
    (F, ...) complex array
        Amplitudes of exp(+jωt).
    """
    return np.asarray(
        2 / len(signal) * np.fft.rfft(signal, axis=0)[np.rint(lines * PERIOD).astype(int)]
    )
