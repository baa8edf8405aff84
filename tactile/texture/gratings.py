"""Sharp lines in the two-dimensional spectrum of a height map, gathered to gratings.

A line is a plane wave that keeps its phase over the whole picture. In a spectrum under a Hann
window it is a peak as narrow as the window allows, unlike the speckle of a random field, whose
peaks have neighbors of a similar height. A line must therefore rise 6 dB above everything around
it, and far enough above the local background that this does not happen by chance. Lines are found
strongest first and subtracted from the relief, so that weak ones become visible beside strong ones.

A pattern that repeats only roughly, such as the rings of a tree, is a ridge and not a line. It
remains in the random part, with a direction.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft2
from scipy.ndimage import maximum_filter, uniform_filter

from tactile.arrays import Complex, Floats

PERIODS = 6
"""Smallest number of periods of a line in the shorter side. From 8 on its wavelength is good to
1 %."""
ABOVE = 4.0
"""Ratio of the power of a line to everything 3 to 6 bins away (6 dB)."""
CERTAIN = 7.0
"""Margin of the detection threshold: in a random spectrum a bin reaches ln(bins) + 7 times its mean
once in e^7 pictures."""
NEAR, FAR, WIDE = 3, 6, 21
"""Distance at which the main lobe of a Hann window has ended, largest distance of neighbors, and
width of the background [bins]."""
ROUNDS, MOST_LINES = 16, 64
"""Largest number of passes over the spectrum, and of lines."""
HARMONICS = 32
"""Largest number of harmonics of a grating, which is that of a descriptor."""
TOGETHER = 0.3
"""Distance from a multiple of the fundamental within which a line counts as its harmonic [bins]."""
EULER = 0.5772156649
"""Euler's constant γ: the mean of an exponential variate is e^γ times its geometric mean."""


@dataclass(frozen=True)
class PlaneWave:
    """A plane wave a cos(2π f·p + φ), with p from the middle of the picture.

    Attributes
    ----------
    frequency : (2,) array of float
        Spatial frequency f along x and y [cycles/m].
    amplitude : float
        Peak amplitude a [m].
    phase : float
        Phase φ [rad].
    """

    frequency: Floats
    amplitude: float
    phase: float


@dataclass(frozen=True)
class HarmonicWaves:
    """A grating: plane waves whose frequencies are multiples of one fundamental.

    Attributes
    ----------
    frequency : (2,) array of float
        Spatial frequency of the fundamental along x and y [cycles/m].
    amplitude : (H,) array of float
        Peak amplitudes of the harmonics, 0 for a missing one [m].
    phase : (H,) array of float
        Phases of the harmonics, 0 for a missing one [rad].
    """

    frequency: Floats
    amplitude: Floats
    phase: Floats


def hann(count: int) -> Floats:
    """Compute the periodic Hann window.

    Parameters
    ----------
    count : int
        Number of samples.

    Returns
    -------
    (count,) array of float
        Window from 0 to 1.
    """
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count, dtype=np.float64) / count)


def take_lines(
    height: Floats, pixel: float, *, finest: float, least: float
) -> tuple[list[PlaneWave], Floats]:
    """Find the lines of a height map and subtract them.

    Parameters
    ----------
    height : (R, C) array of float
        Height without mean and tilt, with row 0 at the lowest y [m].
    pixel : float
        Side of a pixel [m].
    finest : float
        Highest spatial frequency that is searched [cycles/m].
    least : float
        Smallest amplitude of a line [m].

    Returns
    -------
    lines : list of PlaneWave
        Lines, strongest first.
    rest : (R, C) array of float
        Height without these lines [m].
    """
    rest, lines = height.copy(), list[PlaneWave]()
    for _ in range(ROUNDS):
        new_lines = [
            line
            for line in _strongest_lines(rest, pixel, finest)[: MOST_LINES - len(lines)]
            if line.amplitude >= least
        ]
        if not new_lines:
            break
        for line in new_lines:
            rest -= _wave(line, rest.shape, pixel)
        lines += new_lines
    return sorted(lines, key=lambda line: -line.amplitude), rest


def _places(count: int, pixel: float) -> Floats:
    """Return the coordinates of pixels from the middle of the picture [m]."""
    return np.asarray((np.arange(count) - (count - 1) / 2) * pixel, np.float64)


def _wave(line: PlaneWave, shape: tuple[int, ...], pixel: float) -> Floats:
    """Return the height of a plane wave at each pixel [m]."""
    x, y = (
        np.exp(2j * np.pi * f * _places(n, pixel))
        for f, n in zip(line.frequency, shape[::-1], strict=True)
    )
    return np.asarray((line.amplitude * np.exp(1j * line.phase) * np.outer(y, x)).real)


def _strongest_lines(height: Floats, pixel: float, finest: float) -> list[PlaneWave]:
    """Return the lines of one pass over the spectrum, strongest first, none near a stronger one."""
    rows, columns = height.shape
    window = np.outer(hann(rows), hann(columns))
    spectrum = rfft2(window * height)
    power = np.abs(spectrum) ** 2
    number = np.hypot(
        np.fft.fftfreq(rows, pixel)[:, None], np.fft.rfftfreq(columns, pixel)[None, :]
    )
    searched = (number >= PERIODS / (min(rows, columns) * pixel)) & (number <= finest)
    floor = background(power, number) * max(ABOVE, np.log(max(searched.sum(), 1)) + CERTAIN)
    peaks = np.argwhere(searched & (power > floor) & (power == maximum_filter(power, 3)))
    peaks = peaks[np.argsort(-power[tuple(peaks.T)])]
    taken_bins: list[tuple[int, int]] = []
    lines = []
    for row, column in peaks:
        beside = any(_are_near((row, column), other, rows) for other in taken_bins)
        if not beside and _stands_out(power, row, column):
            taken_bins.append((row, column))
            lines.append(_refined_line(height * window, spectrum, row, column, pixel))
    return lines


def _are_near(one: tuple[int, int], other: tuple[int, int], rows: int) -> bool:
    """Return whether two bins, or one and the mirror image of the other, are near each other."""
    return any(
        min((one[0] - sign * other[0]) % rows, (sign * other[0] - one[0]) % rows) <= FAR
        and abs(one[1] - sign * other[1]) <= FAR
        for sign in (1, -1)
    )


def background(power: Floats, number: Floats) -> Floats:
    """Estimate the mean power of the random part around each bin, without the line in that bin.

    The geometric mean is used, since lines hardly raise it: first over rings of wave number, then,
    for the deviation from these rings, over the neighborhood outside the main lobe.

    Parameters
    ----------
    power : (R, F) array of float
        Power spectrum, half of the plane.
    number : (R, F) array of float
        Wave number of each bin [cycles/m].

    Returns
    -------
    (R, F) array of float
        Mean power, in the unit of ``power``.
    """
    log = np.log(np.maximum(power, power.max() * 1e-20))
    ring = np.minimum(number / number[0, 1], 2.0**30).astype(np.intp).ravel()
    mean = np.bincount(ring, log.ravel()) / np.maximum(np.bincount(ring), 1)
    along = mean[ring].reshape(log.shape)
    near = 2 * NEAR - 1
    wide_sum, near_sum = (
        uniform_filter(log - along, size, mode=["wrap", "reflect"]) * size**2
        for size in (WIDE, near)
    )
    return np.asarray(np.exp(along + (wide_sum - near_sum) / (WIDE**2 - near**2) + EULER))


def _at(values: NDArray[Any], row: NDArray[np.intp], column: NDArray[np.intp]) -> NDArray[Any]:
    """Return bins of a half-plane spectrum, those of the other half by their mirror image."""
    rows, columns = values.shape
    mirrored = column < 0
    r, c = np.where(mirrored, -row, row) % rows, np.minimum(np.abs(column), columns - 1)
    return np.asarray(values[r, c])


def _stands_out(power: Floats, row: int, column: int) -> bool:
    """Return whether a peak rises above everything beyond its main lobe."""
    down, right = np.mgrid[-FAR : FAR + 1, -FAR : FAR + 1].reshape(2, -1)
    far = np.hypot(down, right)
    ring = (far >= NEAR) & (far <= FAR)
    around = _at(power, row + down[ring], column + right[ring])
    return bool(power[row, column] > ABOVE * np.max(around))


def _refined_line(
    windowed: Floats, spectrum: Complex, row: int, column: int, pixel: float
) -> PlaneWave:
    """Return a line with its frequency between the bins, and its amplitude and phase there.

    For a Hann window the ratio r of the larger neighbor to the peak gives the offset
    (2r − 1)/(1 + r), which is exact for a single long line.
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
    """Gather lines whose frequencies are multiples of the lowest one among them.

    Parameters
    ----------
    lines : list of PlaneWave
        Lines found by `take_lines`.
    side : float
        Shorter side of the picture [m].

    Returns
    -------
    list of HarmonicWaves
        Gratings, strongest first.
    """
    remaining, gratings = sorted(lines, key=lambda line: float(np.hypot(*line.frequency))), []
    while remaining:
        members: dict[int, PlaneWave] = {}
        others = []
        for line in remaining:
            order = _order(line.frequency, remaining[0].frequency, side)
            if not order:
                others.append(line)
            elif abs(order) not in members or members[abs(order)].amplitude < line.amplitude:
                members[abs(order)] = line if order > 0 else _opposite(line)
        gratings.append(_grating(members))
        remaining = others
    return sorted(gratings, key=lambda g: -float(np.max(g.amplitude)))


def _order(frequency: Floats, first: Floats, side: float) -> int:
    """Return the order of the harmonic that a frequency is of a fundamental, or 0 if it is none."""
    order = round(float(frequency @ first) / float(first @ first))
    off = float(np.hypot(*(frequency - order * first))) * side
    fits = abs(order) <= HARMONICS and off <= TOGETHER * max(1, abs(order) / 2)
    return order if fits else 0


def _opposite(line: PlaneWave) -> PlaneWave:
    """Return the same wave described by the opposite wave vector."""
    return PlaneWave(-line.frequency, line.amplitude, -line.phase)


def _grating(members: dict[int, PlaneWave]) -> HarmonicWaves:
    """Return the grating of lines by their order, with its frequency by least squares."""
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
