"""What repeats in a height map: sharp lines of its two-dimensional spectrum, gathered to gratings.

A line is a plane wave that keeps its phase over the whole picture. In a spectrum under a Hann
window it is a peak as narrow as the window allows, unlike the speckle of a random field, whose
peaks have neighbors of their own height. So a line must rise 6 dB above all that is around it and
far enough above the local background that chance does not do it. Lines are found strongest first
and taken out of the relief, so that weak ones show beside strong ones.

A pattern that repeats only roughly (rings of a tree) is a ridge, no line: it stays random, with a
direction.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft2
from scipy.ndimage import maximum_filter, uniform_filter

from tactile.arrays import Complex, Floats

PERIODS = 6
"""Fewest periods of a line in the shorter side; from 8 on its wavelength is good to 1 %."""
ABOVE = 4.0
"""Power of a line above everything 3 to 6 bins away (6 dB)."""
CERTAIN = 7.0
"""A random spectrum has a bin ln(bins) + 7 times its mean once in e^7 pictures."""
NEAR, FAR, WIDE = 3, 6, 21
"""Bins: where the main lobe of a Hann window has ended, where neighbors end, background."""
ROUNDS, MOST_LINES = 16, 64
HARMONICS = 32
"""As many as a descriptor holds."""
TOGETHER = 0.3
"""Bins that a line may be off its place to be a harmonic."""
EULER = 0.5772156649
"""The mean of an exponential variate is e^0.577 times its geometric mean."""


@dataclass(frozen=True)
class PlaneWave:
    """A plane wave a cos(2π f·p + φ), p from the middle of the picture.

    Attributes
    ----------
    frequency : (2,) along x and y [cycles/m]
    amplitude : peak [m]
    phase : [rad]
    """

    frequency: Floats
    amplitude: float
    phase: float


@dataclass(frozen=True)
class HarmonicWaves:
    """Lines whose frequencies are multiples of one.

    Attributes
    ----------
    frequency : (2,) of the fundamental [cycles/m]
    amplitude, phase : (H,) of the harmonics, peak [m] and [rad]; 0 where there is none
    """

    frequency: Floats
    amplitude: Floats
    phase: Floats


def hann(count: int) -> Floats:
    """Return the periodic Hann window."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count, dtype=np.float64) / count)


def take_lines(
    height: Floats, pixel: float, *, finest: float, least: float
) -> tuple[list[PlaneWave], Floats]:
    """Find the lines of a height map and what is left without them.

    Parameters
    ----------
    height : (R, C) [m], row 0 at the lowest y, mean and tilt removed
    pixel : [m]
    finest : highest spatial frequency that is looked at [cycles/m]
    least : smallest amplitude [m]

    Returns
    -------
    list of Line, (R, C) ndarray
        Strongest first; the height without them [m].
    """
    left, lines = height.copy(), list[PlaneWave]()
    for _ in range(ROUNDS):
        found = [
            line
            for line in _strongest(left, pixel, finest)[: MOST_LINES - len(lines)]
            if line.amplitude >= least
        ]
        if not found:
            break
        for line in found:
            left -= _wave(line, left.shape, pixel)
        lines += found
    return sorted(lines, key=lambda line: -line.amplitude), left


def _places(count: int, pixel: float) -> Floats:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pixel, np.float64)


def _wave(line: PlaneWave, shape: tuple[int, ...], pixel: float) -> Floats:
    x, y = (
        np.exp(2j * np.pi * f * _places(n, pixel))
        for f, n in zip(line.frequency, shape[::-1], strict=True)
    )
    return np.asarray((line.amplitude * np.exp(1j * line.phase) * np.outer(y, x)).real)


def _strongest(height: Floats, pixel: float, finest: float) -> list[PlaneWave]:
    """Return the lines of one look at the spectrum, strongest first, none beside a stronger one."""
    rows, columns = height.shape
    window = np.outer(hann(rows), hann(columns))
    spectrum = rfft2(window * height)
    power = np.abs(spectrum) ** 2
    number = np.hypot(
        np.fft.fftfreq(rows, pixel)[:, None], np.fft.rfftfreq(columns, pixel)[None, :]
    )
    looked = (number >= PERIODS / (min(rows, columns) * pixel)) & (number <= finest)
    floor = background(power, number) * max(ABOVE, np.log(max(looked.sum(), 1)) + CERTAIN)
    peaks = np.argwhere(looked & (power > floor) & (power == maximum_filter(power, 3)))
    peaks = peaks[np.argsort(-power[tuple(peaks.T)])]
    taken: list[tuple[int, int]] = []
    lines = []
    for row, column in peaks:
        beside = any(_beside((row, column), other, rows) for other in taken)
        if not beside and _stands_out(power, row, column):
            taken.append((row, column))
            lines.append(_measured(height * window, spectrum, row, column, pixel))
    return lines


def _beside(one: tuple[int, int], other: tuple[int, int], rows: int) -> bool:
    """Return whether two bins, or one and the mirror image of the other, are near each other."""
    return any(
        min((one[0] - sign * other[0]) % rows, (sign * other[0] - one[0]) % rows) <= FAR
        and abs(one[1] - sign * other[1]) <= FAR
        for sign in (1, -1)
    )


def background(power: Floats, number: Floats) -> Floats:
    """Return the mean that a random spectrum would have around each bin without its own line.

    The geometric mean, which lines hardly raise, first over rings of wave number, then of what
    differs from them over the neighborhood outside the main lobe.
    """
    log = np.log(np.maximum(power, power.max() * 1e-20))
    ring = np.minimum(number / number[0, 1], 2.0**30).astype(np.intp).ravel()
    mean = np.bincount(ring, log.ravel()) / np.maximum(np.bincount(ring), 1)
    along = mean[ring].reshape(log.shape)
    near = 2 * NEAR - 1
    wide, middle = (
        uniform_filter(log - along, size, mode=["wrap", "reflect"]) * size**2
        for size in (WIDE, near)
    )
    return np.asarray(np.exp(along + (wide - middle) / (WIDE**2 - near**2) + EULER))


def _at(values: NDArray[Any], row: NDArray[np.intp], column: NDArray[np.intp]) -> NDArray[Any]:
    """Return bins of half a spectrum, those of the other half by their mirror image."""
    rows, columns = values.shape
    mirrored = column < 0
    r, c = np.where(mirrored, -row, row) % rows, np.minimum(np.abs(column), columns - 1)
    return np.asarray(values[r, c])


def _stands_out(power: Floats, row: int, column: int) -> bool:
    """Return whether a peak rises above all that is beyond its main lobe."""
    down, right = np.mgrid[-FAR : FAR + 1, -FAR : FAR + 1].reshape(2, -1)
    far = np.hypot(down, right)
    ring = (far >= NEAR) & (far <= FAR)
    around = _at(power, row + down[ring], column + right[ring])
    return bool(power[row, column] > ABOVE * np.max(around))


def _measured(
    windowed: Floats, spectrum: Complex, row: int, column: int, pixel: float
) -> PlaneWave:
    """Return a line's frequency between the bins, then its amplitude and phase there.

    Of a Hann window the ratio r of the larger neighbor to the peak gives the offset
    (2r − 1)/(1 + r), exactly for a single long line.
    """
    offsets = []
    for step in ((0, 1), (1, 0)):
        sides = np.array([-1, 1])
        near = np.abs(_at(spectrum, row + sides * step[0], column + sides * step[1]))
        ratio = near.max() / np.abs(spectrum[row, column])
        offsets.append((2 * ratio - 1) / (1 + ratio) * sides[np.argmax(near)])
    rows, columns = windowed.shape
    signed = row if row <= rows // 2 else row - rows
    frequency = np.array(
        [(column + offsets[0]) / (columns * pixel), (signed + offsets[1]) / (rows * pixel)]
    )
    x, y = (
        np.exp(-2j * np.pi * f * _places(n, pixel))
        for f, n in zip(frequency, (columns, rows), strict=True)
    )
    complex_amplitude = 2 * (y @ windowed @ x) / (hann(rows).sum() * hann(columns).sum())
    return PlaneWave(
        frequency, float(np.abs(complex_amplitude)), float(np.angle(complex_amplitude))
    )


def gather(lines: list[PlaneWave], side: float) -> list[HarmonicWaves]:
    """Gather lines whose frequencies are multiples of the lowest among them, strongest first.

    Parameters
    ----------
    lines : as of `take_lines`
    side : shorter side of the picture [m]
    """
    left, gratings = sorted(lines, key=lambda line: float(np.hypot(*line.frequency))), []
    while left:
        members: dict[int, PlaneWave] = {}
        others = []
        for line in left:
            order = _order(line.frequency, left[0].frequency, side)
            if not order:
                others.append(line)
            elif abs(order) not in members or members[abs(order)].amplitude < line.amplitude:
                members[abs(order)] = line if order > 0 else _turned(line)
        gratings.append(_grating(members))
        left = others
    return sorted(gratings, key=lambda g: -float(np.max(g.amplitude)))


def _order(frequency: Floats, first: Floats, side: float) -> int:
    """Return which harmonic of a first frequency another one is; 0 for none."""
    order = round(float(frequency @ first) / float(first @ first))
    off = float(np.hypot(*(frequency - order * first))) * side
    fits = abs(order) <= HARMONICS and off <= TOGETHER * max(1, abs(order) / 2)
    return order if fits else 0


def _turned(line: PlaneWave) -> PlaneWave:
    return PlaneWave(-line.frequency, line.amplitude, -line.phase)


def _grating(members: dict[int, PlaneWave]) -> HarmonicWaves:
    """Return the grating of lines by their order; its frequency by least squares."""
    order = np.array(sorted(members))
    weight = np.array([members[n].amplitude ** 2 for n in order])
    places = np.array([members[n].frequency for n in order])
    frequency = ((weight * order) @ places) / (weight @ order**2)
    amplitude, phase = np.zeros(order[-1]), np.zeros(order[-1])
    for n in order:
        amplitude[n - 1], phase[n - 1] = members[n].amplitude, members[n].phase
    if frequency[0] < 0 or (frequency[0] == 0 and frequency[1] < 0):
        return HarmonicWaves(-frequency, amplitude, -phase)
    return HarmonicWaves(frequency, amplitude, phase)
