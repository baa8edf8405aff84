"""Lines in the spatial spectra of recordings: what repeats along a surface, and its waveform.

A line is a peak of the periodogram of a whole stroke that rises above its surroundings by more than
chance, at the same spatial frequency in most of the recordings. Lines at multiples of one spatial
frequency form one grating, if recordings at different speeds tell it from a hum, whose frequencies
in time stay the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.ndimage import median_filter
from scipy.signal import detrend, find_peaks, zoom_fft
from scipy.signal.windows import blackmanharris

from tactile.arrays import Complex, Floats
from tactile.texture.slide_strokes import LOWEST

PROMINENCE = 13.0
"""Ratio of the power of a line to the mean power around it. A share of 2e-6 of all bins of noise
rises that far (e^−13)."""
ALONE = 20.0
"""The same ratio for a single recording, which has no other one to confirm it: 2e-9 of all bins."""
TOLERANCE = 0.015
"""Largest relative difference of the spatial frequency of a line between recordings, from the
accuracy of the speed."""
APART = 1.15
"""Ratio from which on two speeds, or two forces, count as different."""
NEIGHBORHOOD = 0.5
"""Width of the two medians, together, that estimate the power around a line [octaves]."""
PADDING = 4
"""Factor by which strokes are zero-padded at least for their spectrum."""
PLACES = 61
"""Number of spatial frequencies, within the tolerance, at which the fundamental of one stroke is
searched."""
MOST_HARMONICS = 32
"""Highest order of a harmonic."""
HARMONIC = 0.02
"""Largest relative deviation of a harmonic from a multiple of the fundamental."""


@dataclass(frozen=True)
class Line:
    """A line that most strokes have.

    Attributes
    ----------
    frequency : float
        Spatial frequency [cycles/m].
    strokes : tuple of int
        Indices of the strokes that have it.
    is_hum : bool
        Whether most of these strokes, at different speeds, also have a line at the temporal
        frequency that it has in the others.
    """

    frequency: float
    strokes: tuple[int, ...]
    is_hum: bool


@dataclass(frozen=True)
class HarmonicLines:
    """A grating found in recordings: lines at multiples of one spatial frequency.

    Attributes
    ----------
    frequency : float
        Spatial frequency of the fundamental [cycles/m].
    orders : tuple of int
        Orders of the H harmonics that stand out, 1 for the fundamental.
    heights : (R, H) array of float
        Peak amplitude of each harmonic in each stroke, in the unit of the strokes. NaN where a
        stroke does not cover the fundamental.
    phases : (H,) array of float
        Phases of the harmonics, relative to a phase of 0 of the first of them [rad].
    count : int
        Number of strokes in which the fundamental was found.
    """

    frequency: float
    orders: tuple[int, ...]
    heights: Floats
    phases: Floats
    count: int


def peaks(stroke: Floats, step: float, low: float, high: float, prominence: float) -> Floats:
    """Find the spatial frequencies of the lines of one stroke.

    Parameters
    ----------
    stroke : (S,) array of float
        Displacement at even steps of place, in any unit.
    step : float
        Distance between samples [m].
    low : float
        Lowest spatial frequency of a line [cycles/m].
    high : float
        Highest spatial frequency of a line [cycles/m].
    prominence : float
        Smallest ratio of the power of a line to the mean power around it.

    Returns
    -------
    (L,) array of float
        Spatial frequencies of the lines, interpolated between bins [cycles/m].
    """
    count = next_fast_len(PADDING * len(stroke), real=True)
    spectrum = np.fft.rfft(detrend(stroke) * blackmanharris(len(stroke)), count)
    power = np.abs(spectrum) ** 2
    frequency = np.asarray(np.fft.rfftfreq(count, step), np.float64)
    inside = (frequency >= low / 2) & (frequency <= min(high, 0.45 / step))
    searched, power = frequency[inside], power[inside]
    if len(searched) < 8:
        return np.zeros(0)
    peak_index, _ = find_peaks(power / _surroundings(searched, power), height=prominence)
    peak_index = peak_index[
        (peak_index > 0) & (peak_index < len(searched) - 1) & (searched[peak_index] >= low)
    ]
    return vertices(searched, power, peak_index)


def vertices(frequency: Floats, power: Floats, index: NDArray[np.intp]) -> Floats:
    """Determine where peaks of a spectrum lie between its bins.

    The vertex of a parabola through three bins of log power is taken.

    Parameters
    ----------
    frequency : (F,) array of float
        Frequencies of the bins, evenly spaced.
    power : (F,) array of float
        Power in each bin, in any unit.
    index : (L,) array of int
        Bins of the peaks, not at either end.

    Returns
    -------
    (L,) array of float
        Frequencies of the peaks.
    """
    left, middle, right = (np.log(power[index + k]) for k in (-1, 0, 1))
    offset = 0.5 * (left - right) / (left - 2 * middle + right)
    return np.asarray(frequency[index] + offset * (frequency[1] - frequency[0]))


def _surroundings(frequency: Floats, power: Floats) -> Floats:
    """Estimate the mean power around each frequency from medians, which lines hardly change.

    The median of a periodogram of noise is ln 2 times its mean. The larger one of those below and
    above a frequency counts, so that nothing rises above its surroundings because these end there
    (Hansen and Sawyers, IEEE Transactions on Aerospace and Electronic Systems 1980).
    """
    even = np.geomspace(frequency[0], frequency[-1], 2 * len(frequency))
    octaves = np.log2(frequency[-1] / frequency[0])
    half = max(int(len(even) * NEIGHBORHOOD / octaves / 2), 9)
    around = np.interp(even, frequency, power)
    below, above = (
        median_filter(around, half, mode="reflect", origin=origin)
        for origin in ((half - 1) // 2, -(half // 2))
    )
    return np.asarray(np.interp(frequency, even, np.maximum(below, above) / np.log(2)))


def differ(values: Floats) -> bool:
    """Return whether speeds, or forces, are not all the same.

    Parameters
    ----------
    values : (R,) array of float
        Speeds or forces of recordings, above 0.

    Returns
    -------
    bool
        Whether the largest one is at least 1.15 times the smallest one.
    """
    return bool(values.max() >= APART * values.min())


def common_lines(strokes: Sequence[Floats], step: float, speed: Floats, high: float) -> list[Line]:
    """Find the lines that most of the strokes have.

    A line must be found in more than half of the strokes that reach down to its frequency, to 10
    Hz.

    Parameters
    ----------
    strokes : sequence of (S,) array of float
        Displacement of strokes over one texture, in any unit.
    step : float
        Distance between samples [m].
    speed : (R,) array of float
        Speed of each stroke [m/s].
    high : float
        Highest spatial frequency of a line [cycles/m].

    Returns
    -------
    list of Line
        Lines in ascending order.
    """
    prominence, lows = ALONE if len(strokes) == 1 else PROMINENCE, LOWEST / speed
    places = [peaks(u, step, low, high, prominence) for u, low in zip(strokes, lows, strict=True)]
    return shared_lines(places, lows, speed)


def shared_lines(places: list[Floats], lows: Floats, speed: Floats) -> list[Line]:
    """Gather the lines of strokes to those that more than half of the strokes have.

    Parameters
    ----------
    places : list of (L,) array of float
        Spatial frequencies of the lines of each of R strokes [cycles/m].
    lows : (R,) array of float
        Spatial frequency down to which each stroke reaches [cycles/m].
    speed : (R,) array of float
        Speed of each stroke [m/s].

    Returns
    -------
    list of Line
        Lines in ascending order.
    """
    owner = np.repeat(np.arange(len(places)), [len(p) for p in places])
    every = np.concatenate(places)
    order = np.argsort(every)
    every, owner = every[order], owner[order]
    lines: list[Line] = []
    k = 0
    while k < len(every):
        close = every <= every[k] * (1 + 2 * TOLERANCE)
        close[:k] = False
        owners = tuple(sorted(set(owner[close].tolist())))
        if len(owners) > np.count_nonzero(lows <= every[k]) // 2:
            frequency = float(np.median(every[close]))
            lines.append(Line(frequency, owners, _is_hum(frequency, owners, speed, places)))
            k = int(np.flatnonzero(close)[-1]) + 1
        else:
            k += 1
    return lines


def _is_hum(frequency: float, owners: tuple[int, ...], speed: Floats, places: list[Floats]) -> bool:
    """Return whether strokes that have a line also have those that it would be as a hum.

    Harmonics of a hum meet at one spatial frequency if speeds have a simple ratio: those of 50 Hz
    at 100 Hz and 20 mm/s, and at 150 Hz and 30 mm/s.
    """
    pairs = [(i, j) for i in owners for j in owners if differ(speed[[i, j]])]
    hums = [
        np.any(np.abs(places[j] * speed[j] / (frequency * speed[i]) - 1) <= 2 * TOLERANCE)
        for i, j in pairs
    ]
    return len(hums) > 0 and float(np.mean(hums)) > 0.5


def find_gratings(
    strokes: Sequence[Floats], step: float, speed: Floats, lines: Sequence[Line]
) -> list[HarmonicLines]:
    """Find the gratings among the lines that most of the strokes have.

    More of its harmonics must occur at different speeds than are those of a hum. At a single speed
    there are no gratings.

    Parameters
    ----------
    strokes : sequence of (S,) array of float
        Displacement of strokes over one texture, in any unit.
    step : float
        Distance between samples [m].
    speed : (R,) array of float
        Speed of each stroke [m/s].
    lines : sequence of Line
        Lines that most strokes have, by `common_lines`.

    Returns
    -------
    list of HarmonicLines
        Gratings, strongest first.
    """
    differs = {line: differ(speed[list(line.strokes)]) for line in lines}
    doubled = np.array([line.frequency / 2 for line in lines if differs[line]])

    def may_belong(line: Line) -> bool:
        if differs[line]:
            return True
        # Without it at another speed that reaches it, a line is a hum. What only one speed reaches
        # is a fundamental at best.
        unreached = not differ(speed[speed >= LOWEST / line.frequency])
        return unreached and bool(np.any(np.abs(doubled / line.frequency - 1) <= HARMONIC))

    remaining = [line for line in lines if may_belong(line)]
    gratings = []
    while remaining:
        first = remaining[0]
        order = [round(line.frequency / first.frequency) for line in remaining]
        is_harmonic = [
            k <= MOST_HARMONICS and abs(line.frequency / first.frequency - k) <= HARMONIC * k
            for line, k in zip(remaining, order, strict=True)
        ]
        members = [(line, k) for line, k, n in zip(remaining, order, is_harmonic, strict=True) if n]
        remaining = [line for line, n in zip(remaining, is_harmonic, strict=True) if not n]
        if sum(differs[line] - 2 * line.is_hum for line, _ in members) <= 0:
            continue
        weight = np.array([k for _, k in members], np.float64)
        base = float(np.sum([line.frequency * k for line, k in members]) / np.sum(weight**2))
        orders = tuple(sorted({k for _, k in members}))
        covers = speed >= LOWEST / base
        gratings.append(_fitted_grating(strokes, step, covers, base, orders, len(first.strokes)))
    return sorted(gratings, key=lambda g: -float(np.nansum(g.heights**2)))


def _fitted_grating(
    strokes: Sequence[Floats],
    step: float,
    covers: NDArray[np.bool_],
    base: float,
    orders: tuple[int, ...],
    count: int,
) -> HarmonicLines:
    """Return the grating of a fundamental whose given multiples stand out."""
    tuned = [
        fitted_harmonics(u, step, base, orders) for u, c in zip(strokes, covers, strict=True) if c
    ]
    own = np.array([fundamental for fundamental, _ in tuned])
    waves = np.array([wave for _, wave in tuned])
    heights = np.full((len(strokes), len(orders)), np.nan)
    heights[covers] = np.abs(waves)
    turned = waves * np.exp(-1j * np.outer(np.angle(waves[:, 0]), np.array(orders) / orders[0]))
    weight = np.abs(waves[:, 0]) ** 2
    place = float(np.sum(own * weight) / np.sum(weight))
    return HarmonicLines(place, orders, heights, np.angle(turned.sum(axis=0)), count)


def fitted_harmonics(
    stroke: Floats, step: float, base: float, orders: tuple[int, ...]
) -> tuple[float, Complex]:
    """Fit the harmonics of a grating to one stroke, at the fundamental that fits it best.

    Parameters
    ----------
    stroke : (S,) array of float
        Displacement at even steps of place, in any unit.
    step : float
        Distance between samples [m].
    base : float
        Spatial frequency of the fundamental, within 1.5 % [cycles/m].
    orders : tuple of int
        Orders of the H harmonics.

    Returns
    -------
    fundamental : float
        Spatial frequency of the fundamental in this stroke [cycles/m].
    waves : (H,) array of complex
        Complex peak amplitudes with the phase at the first sample, in the unit of ``stroke``.
    """
    window = np.hanning(len(stroke))
    ends = base * (1 - TOLERANCE), base * (1 + TOLERANCE)
    around = np.array(
        [
            zoom_fft(
                stroke * window, [k * ends[0], k * ends[1]], PLACES, fs=1 / step, endpoint=True
            )
            for k in orders
        ]
    )
    best = int(np.argmax(np.sum(np.abs(around) ** 2, axis=0)))
    return float(np.linspace(*ends, PLACES)[best]), 2 * around[:, best] / window.sum()


def without(stroke: Floats, step: float, gratings: Sequence[HarmonicLines]) -> Floats:
    """Subtract gratings from a stroke, each at the spatial frequency that fits this stroke best.

    Parameters
    ----------
    stroke : (S,) array of float
        Displacement at even steps of place.
    step : float
        Distance between samples [m].
    gratings : sequence of HarmonicLines
        Gratings to subtract.

    Returns
    -------
    (S,) array of float
        Displacement without the gratings, in the unit of ``stroke``.
    """
    rest = stroke
    for grating in gratings:
        base, waves = fitted_harmonics(rest, step, grating.frequency, grating.orders)
        place = step * np.arange(len(stroke))
        turn = np.exp(2j * np.pi * base * np.outer(grating.orders, place))
        rest = rest - np.real(waves @ turn)
    return rest
