"""Strokes of a recording: tangential displacement over place, where the speed is steady.

Acceleration and velocity are integrated in the frequency domain, between 10 Hz, below which motion
of the hand and drift dominate, and the top of the bands. A tangential force becomes the
displacement that it causes in the skin of a fingertip. Then the signal is interpolated at even
steps of place.
"""

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import detrend

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.recorded_slide import Quantity, Recorded

LOWEST = 10.0
"""Frequency from which on a recording is reliable (assumed: hands move below it, and integrated
drift lies there) [Hz]."""
INTEGRATIONS: dict[Quantity, int] = {
    "acceleration": 2,
    "velocity": 1,
    "displacement": 0,
    "force": 0,
}
"""Number of integrations from each quantity to displacement."""
SKIN_STIFFNESS = 1e3
"""Stiffness of the pad of a fingertip along the skin below 100 Hz (about 1 N/mm; Wiertlewski and
Hayward, J. Biomech. 45, 2012) [N/m]. It is stiffer above, so that a fit from force is too strong
there."""
STEADY = 0.10
"""Largest relative deviation of the speed within a stroke from its median."""
SMOOTHING = 0.1
"""Time over which the speed is averaged [s]."""
LONGEST = 10.0
"""Longest duration of a stroke [s]. A longer one is cut, so that a varying speed does not blur its
lines."""
OVERSAMPLING = 1.28
"""Ratio of the spatial sampling frequency to twice the highest band edge."""
ROLL = 0.2
"""Width of the roll-off outside of each edge of a band, relative to that edge."""


def strokes_of(recorded: Recorded, step: float, shortest: float) -> list[Floats]:
    """Convert a recording to strokes of displacement at even steps of place.

    Parameters
    ----------
    recorded : Recorded
        The slide.
    step : float
        Distance between samples of a stroke [m].
    shortest : float
        Smallest length of a stroke [m].

    Returns
    -------
    list of (S,) array of float
        Displacement of each stroke [m].

    Raises
    ------
    InputError
        If the speed is nowhere steady for long enough.
    """
    parts = steady_parts(recorded, shortest)
    top = min(1 / (2 * OVERSAMPLING * step), 0.4 * recorded.sample_rate / recorded.speed.max())
    return [_stroke(recorded, part, step, top) for part in parts]


def steady_parts(recorded: Recorded, shortest: float) -> list[slice]:
    """Find the parts of a recording in which the speed stays within 10 % of its median.

    Parameters
    ----------
    recorded : Recorded
        The slide.
    shortest : float
        Smallest length of a part [m].

    Returns
    -------
    list of slice
        Samples of each part, of 10 s at most.

    Raises
    ------
    InputError
        If there is no such part.
    """
    rate, speed = recorded.sample_rate, recorded.speed
    size = max(round(SMOOTHING * rate), 1)
    smooth = uniform_filter1d(median_filter(speed, 5, mode="nearest"), size, mode="nearest")
    moving = smooth[smooth > 0.25 * smooth.max()] if smooth.max() > 0 else smooth[:0]
    if not len(moving):
        raise InputError(f"{recorded.name}: speed is never above 0; record while the finger slides")
    typical_speed = float(np.median(moving))
    steady = np.abs(smooth - typical_speed) <= STEADY * typical_speed
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(np.int8), [0]])))
    parts = []
    for start, stop in edges.reshape(-1, 2):
        pieces = int(np.ceil((stop - start) / rate / LONGEST))
        cuts = np.linspace(start, stop, pieces + 1).astype(int)
        parts += [
            slice(a, b) for a, b in pairwise(cuts) if (b - a) / rate * typical_speed >= shortest
        ]
    if not parts:
        longest = max((b - a for a, b in edges.reshape(-1, 2)), default=0) / rate * typical_speed
        raise InputError(
            f"{recorded.name}: speed is not steady: it stays within {STEADY:.0%} of "
            f"{typical_speed * 1e3:.3g} mm/s for {longest * 1e3:.3g} mm at most, needs "
            f"{shortest * 1e3:.3g} mm; slide longer and more evenly"
        )
    return parts


def _stroke(recorded: Recorded, part: slice, step: float, top: float) -> Floats:
    """Return the displacement of a part of a recording at even steps of place [m]."""
    speed = recorded.speed[part]
    band = LOWEST, top * float(speed.mean())
    moved = displacement(recorded.signal[part], recorded.quantity, recorded.sample_rate, band)
    place = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) / recorded.sample_rate
    grid = step * np.arange(int(place[-1] / step))
    return np.asarray(CubicSpline(place, moved)(grid))


def displacement(
    signal: Floats, quantity: Quantity, sample_rate: float, band: tuple[float, float]
) -> Floats:
    """Convert a signal to tangential displacement within a frequency band.

    Parameters
    ----------
    signal : (S,) array of float
        Signal in the SI unit of its quantity.
    quantity : str
        Quantity of the signal: "acceleration", "velocity", "displacement" or "force".
    sample_rate : float
        Sample rate [Hz].
    band : tuple of float
        Lower and upper edge of the band [Hz]. Outside of it the displacement falls to zero within a
        fifth of either edge.

    Returns
    -------
    (S,) array of float
        Displacement [m].
    """
    plain = detrend(signal) / (SKIN_STIFFNESS if quantity == "force" else 1.0)
    frequency = np.fft.rfftfreq(len(plain), 1 / sample_rate)
    low, high = band
    rise = np.clip((frequency / low - (1 - ROLL)) / ROLL, 0, 1)
    fall = np.clip(((1 + ROLL) - frequency / high) / ROLL, 0, 1)
    weight = np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2
    # The limit avoids a division by zero; the weight is zero below 0.8 of the lower edge.
    omega = 2j * np.pi * np.maximum(frequency, low / 2)
    spectrum = np.fft.rfft(plain) * weight / omega ** INTEGRATIONS[quantity]
    return np.asarray(np.fft.irfft(spectrum, len(plain)))
