"""Course of the drive between two samples, as polynomials of the samples around it.

Drive samples stand for the band-limited signal through them. Within one sample that signal, the
samples weighted by a windowed sinc, is a polynomial of degree 7 to 2e-6 up to 0.42 of the sample
rate. An amplifier that holds its output jumps once within the sample, at the fraction of its delay,
so that the sample has two constant pieces.

The kernel is longer than that of `plant`, for the sake of the current, in which the images of a
slow drive weigh as much more as their frequency is higher.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import factorial

import numpy as np

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.plant import kernel
from tactile.arrays import Floats

HALF_WIDTH = 24
"""Half width of the interpolation kernel [samples]."""
KAISER_BETA = 12.0
"""Shape parameter β of the Kaiser window: flat to 0.42 fs, images 118 dB down."""
DEGREE = 7
"""Degree of the polynomial."""


@dataclass(frozen=True)
class DriveShape:
    """Linear maps from a window of drive samples to the drive within the sample that follows.

    Attributes
    ----------
    taps : int
        Number W of samples in a window.
    pieces : (P,) array of float
        Length of each piece as a fraction of the sample.
    derivatives : (W, P R) array of float
        Weights that give, piece by piece, the R derivatives of the drive at the start of the piece
        with respect to the fraction of the piece.
    value : (W,) array of float
        Weights that give the drive at the start of the sample.
    """

    taps: int
    pieces: Floats
    derivatives: Floats
    value: Floats


def weights(time: Floats, window: Floats, amplifier: Amplifier) -> Floats:
    """Return the weights of a window of samples at some times.

    Parameters
    ----------
    time : (T,) array of float
        Times [samples].
    window : (W,) array of float
        Times of the samples, as they arrive through the amplifier [samples].
    amplifier : Amplifier
        Amplifier, whose ``hold`` selects the kernel.

    Returns
    -------
    (T, W) array of float
        Weight of each sample at each time.
    """
    distance = np.asarray(np.subtract.outer(time, window), np.float64)
    return kernel(distance, amplifier, half_width=HALF_WIDTH, kaiser_beta=KAISER_BETA)


def window_of(amplifier: Amplifier, sample_rate: float) -> Floats:
    """Return when the samples of a window arrive through an amplifier.

    Parameters
    ----------
    amplifier : Amplifier
        Amplifier, whose delay shifts the samples.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    (W,) array of float
        Times, relative to the sample in which the window is used [samples].
    """
    late = amplifier.delay * sample_rate
    return np.arange(-HALF_WIDTH - int(np.ceil(late)), HALF_WIDTH + 1, dtype=np.float64) + late


def drive_shape(amplifier: Amplifier, sample_rate: float) -> DriveShape:
    """Compute the shape of the drive within a sample.

    Parameters
    ----------
    amplifier : Amplifier
        Amplifier, whose ``hold`` and delay matter.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    DriveShape
        Weights of the window of samples.
    """
    window = window_of(amplifier, sample_rate)
    held = amplifier.hold == "zoh"
    cuts = [0.0, amplifier.delay * sample_rate % 1, 1.0] if held else [0.0, 1.0]
    edges, degree = np.unique(cuts), 0 if held else DEGREE
    nodes = (1 + np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))) / 2
    powers = nodes[:, None] ** np.arange(degree + 1) / [factorial(j) for j in range(degree + 1)]
    derivatives = [
        np.linalg.solve(powers, weights(begin + (end - begin) * nodes, window, amplifier))
        for begin, end in pairwise(edges)
    ]
    (value,) = weights(np.array([edges[1] / 2 if held else 0.0]), window, amplifier)
    return DriveShape(len(window), np.diff(edges), np.vstack(derivatives).T, value)
