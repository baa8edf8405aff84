"""Lines in the spatial spectra of recordings: what repeats along a surface, and its shape.

A line is a peak of the periodogram of a whole stroke that stands out of its surroundings by more
than chance, at the same spatial frequency in most of the recordings. With recordings at different
speeds that tells a rib from a hum, which stays at its frequency in time. Lines at multiples of one
spatial frequency are one grating.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import detrend, find_peaks, zoom_fft
from scipy.signal.windows import blackmanharris

from tactile.arrays import Complex, Floats

PROMINENCE = 13.0
"""Times the surroundings' mean power: 2e-6 of all bins of noise stand out that far (e^−13)."""
ALONE = 20.0
"""The same where a single recording has to convince: 2e-9 of all bins."""
TOLERANCE = 0.015
"""Relative, of a line's spatial frequency from recording to recording: of the speed's accuracy."""
NEIGHBORHOOD = 0.5
"""Octaves over whose median a line must stand out."""
PADDING = 4
PLACES = 61
"""That a stroke's own fundamental is sought at, within the tolerance."""
MOST_HARMONICS = 32
HARMONIC = 0.02
"""Relative, of a harmonic's place from a multiple of the fundamental's."""


@dataclass(frozen=True)
class HarmonicLines:
    """What repeats.

    Attributes
    ----------
    frequency : of the fundamental [cycles/m]
    orders : (H,) of the harmonics that stand out, 1 for the fundamental
    heights : (R, H) peak amplitudes in each stroke, in its unit; NaN where it does not reach down
    phases : (H,) [rad], the fundamental's is 0
    found : in how many of the strokes
    """

    frequency: float
    orders: tuple[int, ...]
    heights: Floats
    phases: Floats
    found: int


def peaks(stroke: Floats, step: float, low: float, high: float, prominence: float) -> Floats:
    """Return the spatial frequencies of one stroke's lines [cycles/m].

    Parameters
    ----------
    stroke : (S,) displacement
    step : between samples [m]
    low, high : between which lines are sought [cycles/m]
    prominence : times the mean power around
    """
    count = PADDING * len(stroke)
    spectrum = np.fft.rfft(detrend(stroke) * blackmanharris(len(stroke)), count)
    power = np.abs(spectrum) ** 2
    frequency = np.asarray(np.fft.rfftfreq(count, step), np.float64)
    inside = (frequency >= low / 2) & (frequency <= min(high, 0.45 / step))
    found, power = frequency[inside], power[inside]
    if len(found) < 8:
        return np.zeros(0)
    place, _ = find_peaks(power / _surroundings(found, power), height=prominence)
    place = place[(place > 0) & (place < len(found) - 1) & (found[place] >= low)]
    left, middle, right = (np.log(power[place + k]) for k in (-1, 0, 1))
    offset = 0.5 * (left - right) / (left - 2 * middle + right)
    return np.asarray(found[place] + offset * (found[1] - found[0]))


def _surroundings(frequency: Floats, power: Floats) -> Floats:
    """Return the mean power around each frequency, read from the median, which lines leave be.

    The median of a periodogram of noise is ln 2 times its mean.
    """
    even = np.geomspace(frequency[0], frequency[-1], 2 * len(frequency))
    octaves = np.log2(frequency[-1] / frequency[0])
    size = max(int(len(even) * NEIGHBORHOOD / octaves), 9)
    middle = median_filter(np.interp(even, frequency, power), size, mode="reflect")
    return np.asarray(np.interp(frequency, even, middle / np.log(2)))


def common_lines(
    strokes: Sequence[Floats], step: float, lows: Floats, high: float
) -> list[tuple[float, int]]:
    """Return spatial frequency [cycles/m] and count of the lines that most strokes have.

    Most of those that reach down to it; parameters as of `find_gratings`.
    """
    prominence = ALONE if len(strokes) == 1 else PROMINENCE
    places = [peaks(u, step, low, high, prominence) for u, low in zip(strokes, lows, strict=True)]
    owner = np.repeat(np.arange(len(places)), [len(p) for p in places])
    every = np.concatenate(places)
    order = np.argsort(every)
    every, owner = every[order], owner[order]
    lines: list[tuple[float, int]] = []
    k = 0
    while k < len(every):
        close = every <= every[k] * (1 + 2 * TOLERANCE)
        close[:k] = False
        if len(set(owner[close])) > np.count_nonzero(lows <= every[k]) // 2:
            lines.append((float(np.median(every[close])), len(set(owner[close]))))
            k = int(np.flatnonzero(close)[-1]) + 1
        else:
            k += 1
    return lines


def find_gratings(
    strokes: Sequence[Floats], step: float, lows: Floats, high: float
) -> list[HarmonicLines]:
    """Return what repeats in most of the strokes, the strongest first.

    Parameters
    ----------
    strokes : (S,) each, of one texture
    step : between their samples [m]
    lows : (R,) from which each stroke is believed [cycles/m]
    high : up to which lines are sought [cycles/m]
    """
    left = common_lines(strokes, step, lows, high)
    found = []
    while left:
        first, count = left[0]
        order = [round(line / first) for line, _ in left]
        near = [
            k <= MOST_HARMONICS and abs(line / first - k) <= HARMONIC * k
            for (line, _), k in zip(left, order, strict=True)
        ]
        members = [(line, k) for (line, _), k, n in zip(left, order, near, strict=True) if n]
        weight = np.array([k for _, k in members], np.float64)
        base = float(np.sum([line * k for line, k in members]) / np.sum(weight**2))
        orders = tuple(sorted({k for _, k in members}))
        found.append(_measured(strokes, step, lows <= base, base, orders, count))
        left = [line for line, n in zip(left, near, strict=True) if not n]
    return sorted(found, key=lambda g: -float(np.nansum(g.heights**2)))


def _measured(
    strokes: Sequence[Floats],
    step: float,
    covers: NDArray[np.bool_],
    base: float,
    orders: tuple[int, ...],
    count: int,
) -> HarmonicLines:
    """Return the grating of a fundamental whose given multiples stand out."""
    tuned = [_tuned(u, step, base, orders) for u, c in zip(strokes, covers, strict=True) if c]
    own = np.array([fundamental for fundamental, _ in tuned])
    waves = np.array([wave for _, wave in tuned])
    heights = np.full((len(strokes), len(orders)), np.nan)
    heights[covers] = np.abs(waves)
    turned = waves * np.exp(-1j * np.outer(np.angle(waves[:, 0]), np.array(orders) / orders[0]))
    weight = np.abs(waves[:, 0]) ** 2
    place = float(np.sum(own * weight) / np.sum(weight))
    return HarmonicLines(place, orders, heights, np.angle(turned.sum(axis=0)), count)


def _tuned(
    stroke: Floats, step: float, base: float, orders: tuple[int, ...]
) -> tuple[float, Complex]:
    """Return where one stroke has its fundamental [cycles/m], and its complex amplitudes (H,)."""
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


def without(stroke: Floats, step: float, found: Sequence[HarmonicLines]) -> Floats:
    """Return a stroke (S,) less its gratings, each at its own best spatial frequency."""
    left = stroke
    for grating in found:
        base, waves = _tuned(left, step, grating.frequency, grating.orders)
        place = step * np.arange(len(stroke))
        turn = np.exp(2j * np.pi * base * np.outer(grating.orders, place))
        left = left - np.real(waves @ turn)
    return left
