"""From a recording to strokes: tangential displacement over place, where the speed was steady.

Acceleration and velocity are integrated in the frequency domain, between 10 Hz, below which hands
and drift speak, and the top of the bands. A tangential force becomes the displacement that it
gives a fingertip's skin. Then the signal is read at even steps of place.
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
"""Hz from which a recording is believed (assumed: hands move below, and integrated drift)."""
INTEGRATIONS: dict[Quantity, int] = {
    "acceleration": 2,
    "velocity": 1,
    "displacement": 0,
    "force": 0,
}
SKIN_STIFFNESS = 1e3
"""N/m, of a fingertip's pad along the skin below 100 Hz (about 1 N/mm; Wiertlewski and Hayward,
J. Biomech. 45, 2012); above it yields less, so that a fit from force is too strong there."""
STEADY = 0.10
"""Relative, of the speed within a stroke from its median."""
SMOOTHING = 0.1
"""s over which a speed's trace is averaged."""
LONGEST = 10.0
"""s; a longer stroke is cut, so that a speed that wanders does not smear its lines."""
OVERSAMPLING = 1.28
"""Of the step of place, over twice the highest edge."""
ROLL = 0.2
"""Of either edge of the band that is kept, rolled off outside of it."""


def strokes_of(recorded: Recorded, step: float, shortest: float) -> list[Floats]:
    """Return a recording's strokes (S,) as displacement [m] at even steps of place.

    Parameters
    ----------
    recorded : the slide
    step : of place [m]
    shortest : length of a stroke [m]

    Raises
    ------
    InputError
        Where its speed is nowhere steady for long enough.
    """
    parts = steady_parts(recorded, shortest)
    top = min(1 / (2 * OVERSAMPLING * step), 0.4 * recorded.sample_rate / recorded.speed.max())
    return [_stroke(recorded, part, step, top) for part in parts]


def steady_parts(recorded: Recorded, shortest: float) -> list[slice]:
    """Return where the speed stays within 10 % of its median for ``shortest`` [m] or more.

    Raises
    ------
    InputError
        Where there is no such part.
    """
    rate, speed = recorded.sample_rate, recorded.speed
    size = max(round(SMOOTHING * rate), 1)
    smooth = uniform_filter1d(median_filter(speed, 5, mode="nearest"), size, mode="nearest")
    moving = smooth[smooth > 0.25 * smooth.max()] if smooth.max() > 0 else smooth[:0]
    if not len(moving):
        raise InputError(f"{recorded.name}: speed is never above 0; record while the finger slides")
    usual = float(np.median(moving))
    steady = np.abs(smooth - usual) <= STEADY * usual
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(np.int8), [0]])))
    parts = []
    for start, stop in edges.reshape(-1, 2):
        pieces = int(np.ceil((stop - start) / rate / LONGEST))
        cuts = np.linspace(start, stop, pieces + 1).astype(int)
        parts += [slice(a, b) for a, b in pairwise(cuts) if (b - a) / rate * usual >= shortest]
    if not parts:
        longest = max((b - a for a, b in edges.reshape(-1, 2)), default=0) / rate * usual
        raise InputError(
            f"{recorded.name}: speed is not steady: it stays within {STEADY:.0%} of "
            f"{usual * 1e3:.3g} mm/s for {longest * 1e3:.3g} mm at most, needs "
            f"{shortest * 1e3:.3g} mm; slide longer and more evenly"
        )
    return parts


def _stroke(recorded: Recorded, part: slice, step: float, top: float) -> Floats:
    speed = recorded.speed[part]
    band = LOWEST, top * float(speed.mean())
    moved = displacement(recorded.signal[part], recorded.quantity, recorded.sample_rate, band)
    place = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) / recorded.sample_rate
    grid = step * np.arange(int(place[-1] / step))
    return np.asarray(CubicSpline(place, moved)(grid))


def displacement(
    signal: Floats, quantity: Quantity, sample_rate: float, band: tuple[float, float]
) -> Floats:
    """Return tangential displacement (S,) [m] within a band.

    Parameters
    ----------
    signal : (S,) [SI]
    quantity : what it is
    sample_rate : [Hz]
    band : lower and upper edge [Hz], outside of which it falls to nothing within a fifth
    """
    plain = detrend(signal) / (SKIN_STIFFNESS if quantity == "force" else 1.0)
    frequency = np.fft.rfftfreq(len(plain), 1 / sample_rate)
    low, high = band
    rise = np.clip((frequency / low - (1 - ROLL)) / ROLL, 0, 1)
    fall = np.clip(((1 + ROLL) - frequency / high) / ROLL, 0, 1)
    weight = np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2
    omega = 2j * np.pi * np.maximum(frequency, low / 2)
    spectrum = np.fft.rfft(plain) * weight / omega ** INTEGRATIONS[quantity]
    return np.asarray(np.fft.irfft(spectrum, len(plain)))
