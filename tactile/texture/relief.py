"""A height map measured: its spectrum, what of it a stroke meets, its direction, its unsteadiness.

All is about relief, in meters of height; `skin` says what skin makes of it, `relief_texture` puts
both together. The two-dimensional power spectral density comes from one Hann window over the whole
picture, calibrated so that its sum is the variance. A stroke meets a wave of wave vector q at the
spatial frequency q·e along its direction e: bands along a stroke are a projection of the spectrum.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter

from tactile.arrays import Floats
from tactile.texture.bands import third_octaves
from tactile.texture.gratings import hann

CENTERS = (
    0.25, 0.316, 0.4, 0.5, 0.63, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0,
)  # fmt: skip
"""Cycles/mm, of the shipped textures."""
EDGES = third_octaves(np.array(CENTERS)) * 1e3
"""Cycles/m, as `surface.band_edges` draws them."""
PERIODS = 4
"""Fewest periods of a band's center in the shorter side; a Hann window is good to 2."""
RING_PERIODS = 8
"""Fewest periods of waves whose direction counts: the window blurs it by 1.5 / periods [rad]."""
LEAST_RESULTANT = 0.2
"""Below it (a spread of more than 51°) a direction could not be felt, nor stored (60°)."""
CARRIER = 1e3
"""Cycles/m above which kurtosis and envelope are measured."""
CORNER = 200.0
"""Cycles/m up to which the envelope is: 5 mm, as the grain of the shipped calf leather."""
MARGIN = 2e-3
"""Meters at each side of the picture that filters have spoiled."""
PATCHES = 4
"""Fewest periods of the envelope in the shorter side."""


@dataclass(frozen=True)
class ReliefSpectrum:
    """Power of a height map over wave vectors, one of each pair ±q.

    Attributes
    ----------
    x, y : (K,) [cycles/m]
    power : (K,) [m²]; the sum is the variance
    side : shorter side of the picture [m]
    nyquist : half the sampling frequency [cycles/m]
    """

    x: Floats
    y: Floats
    power: Floats
    side: float
    nyquist: float

    @cached_property
    def number(self) -> Floats:
        """(K,) wave numbers [cycles/m]."""
        return np.hypot(self.x, self.y)

    def rms_slope(self, number: Floats) -> Floats:
        """Return the rms slope of all relief as coarse as wave numbers (…) [cycles/m], or coarser.

        The window widens every line by two bins; these belong to it.
        """
        ring = (self.number * self.side).astype(np.intp)
        total = np.cumsum(np.bincount(ring, (2 * np.pi * self.number) ** 2 * self.power))
        asked = (np.asarray(number) * self.side + 2).astype(np.intp)
        return np.asarray(np.sqrt(total[np.minimum(asked, len(total) - 1)]))

    def scaled(self, gain: Floats) -> "ReliefSpectrum":
        """Return the spectrum of what amplitudes times a gain (K,) are."""
        return ReliefSpectrum(self.x, self.y, self.power * gain**2, self.side, self.nyquist)


def leveled(height: Floats) -> tuple[Floats, float]:
    """Take the best-fit plane out of a height map.

    Returns
    -------
    (R, C) ndarray, float
        The rest, and the sag of the paraboloid that fits it best: its highest minus its lowest
        value over the picture [m].
    """
    y, x = (np.linspace(-1, 1, n) for n in height.shape)
    rest = height - height.mean()
    for base in (x[None, :], y[:, None]):
        rest = rest - base * (np.sum(rest * base) / np.sum(base**2 + 0 * rest))
    sag = np.zeros_like(rest)
    for base in (
        (x**2 - np.mean(x**2))[None, :], (y**2 - np.mean(y**2))[:, None], np.outer(y, x),
    ):  # fmt: skip
        sag += base * (np.sum(rest * base) / np.sum(base**2 + 0 * rest))
    return rest, float(np.ptp(sag))


def spectrum_of(height: Floats, pixel: float) -> ReliefSpectrum:
    """Return the power of a height map (R, C) [m], row 0 at the lowest y, over wave vectors.

    P = |FFT(w h)|² / (R C Σw²), doubled where −q is not there; by Parseval ΣP = Σ(w h)² / Σw².
    """
    rows, columns = height.shape
    window = np.outer(hann(rows), hann(columns))
    power = np.abs(rfft2(window * height)) ** 2 / (height.size * np.sum(window**2))
    twice = np.full(power.shape[1], 2.0)
    twice[0] = 1.0
    if columns % 2 == 0:
        twice[-1] = 1.0
    y, x = np.meshgrid(np.fft.fftfreq(rows, pixel), np.fft.rfftfreq(columns, pixel), indexing="ij")
    side = min(rows, columns) * pixel
    return ReliefSpectrum(x.ravel(), y.ravel(), (power * twice).ravel(), side, 0.5 / pixel)


def stroke_levels(spectrum: ReliefSpectrum, direction: float | None) -> Floats:
    """Return the 16 band levels [dB re 1 µm²·mm] along a stroke.

    Parameters
    ----------
    spectrum : of relief or of what skin makes of it
    direction : of the stroke [rad], or None for the mean over all directions, of which the share
        (2/π) (acos(a/κ) − acos(b/κ)) puts a wave number κ between a and b. Along one direction
        each bin counts as spread over its width, since the coarsest bands hold but one or two
    """
    edges = np.append(EDGES[:-1], min(EDGES[-1], spectrum.nyquist))
    if direction is None:
        ring = (spectrum.number * spectrum.side * 8).astype(np.intp)
        power = np.bincount(ring, spectrum.power)
        number = (np.arange(len(power)) + 0.5) / (8 * spectrum.side)
        beyond = np.arccos(np.minimum(edges[:, None] / number, 1)) * 2 / np.pi
        bands = -np.diff(beyond @ power[:, None], axis=0)[:, 0]
    else:
        along = np.abs(spectrum.x * np.cos(direction) + spectrum.y * np.sin(direction))
        step = np.round(along * spectrum.side).astype(np.intp)
        below = np.concatenate([[0.0], np.cumsum(np.bincount(step, spectrum.power))])
        place = (np.arange(len(below)) - 0.5) / spectrum.side
        bands = np.diff(np.interp(edges, place, below))
    density = bands * 1e12 / (np.diff(edges) * 1e-3)
    return np.asarray(10 * np.log10(np.maximum(density, 1e-12)))


def first_measured(side: float) -> int:
    """Return the index of the lowest band of which a picture's side [m] holds enough periods."""
    return int(np.searchsorted(np.array(CENTERS) * 1e3, PERIODS / side * (1 - 1e-9)))


def held_below(levels: Floats, first: int) -> Floats:
    """Return levels with those below a band set to its rms: the density rises by 1 dB a band.

    So does the reference skin spectrum below 0.5 cycles/mm, where it is assumed as well.
    """
    held = levels.copy()
    held[:first] = levels[first] + 10 * np.log10(CENTERS[first] / np.array(CENTERS[:first]))
    return held


@dataclass(frozen=True)
class Orientation:
    """How wave vectors lie: mean direction and standard deviation [rad], resultant 0–1.

    ``spread`` is None where no direction stands out.
    """

    direction: float
    spread: float | None
    resultant: float


def orientation_of(spectrum: ReliefSpectrum) -> Orientation:
    """Fit the normal distribution of wave vectors' directions that a descriptor knows.

    On doubled angles its resultant is R = exp(−2 σ²) (Mardia & Jupp, wrapped normal). Each
    third-octave ring has its own, weighed by the ring's rms, so that coarse and fine count.
    """
    number = spectrum.number
    low = max(EDGES[0], RING_PERIODS / spectrum.side)
    ring = np.digitize(number, EDGES)
    ring[(number < low) | (number > min(EDGES[-1], spectrum.nyquist))] = 0
    turn = np.exp(2j * np.arctan2(spectrum.y, spectrum.x)) * spectrum.power
    count, total = np.bincount(ring)[1:], np.bincount(ring, spectrum.power)[1:]
    vector = (np.bincount(ring, turn.real) + 1j * np.bincount(ring, turn.imag))[1:]
    held = (count > 0) & (total > 0)
    weight = np.sqrt(total[held])
    mean = np.sum(weight * vector[held] / total[held]) / np.sum(weight)
    chance = np.sqrt(2.25 * np.sum(weight**2 / count[held])) / np.sum(weight)
    resultant = float(np.abs(mean))
    direction = float(np.angle(mean)) / 2
    if resultant < max(LEAST_RESULTANT, 3 * chance):
        return Orientation(0.0, None, resultant)
    return Orientation(direction, float(np.sqrt(-np.log(min(resultant, 0.9999)) / 2)), resultant)


@dataclass(frozen=True)
class Unsteadiness:
    """What a spectrum does not tell: ``excess_kurtosis`` and ``am_depth``, as in a descriptor.

    ``am_depth`` is None where the picture is too small to tell.
    """

    excess_kurtosis: float
    am_depth: float | None


def unsteadiness_of(height: Floats, pixel: float) -> Unsteadiness:
    """Compare the relief above 1 cycle/mm with a Gaussian field of the same spectrum.

    A log-normal envelope exp(g), var g = s, leaves power e^{2g} of the relative variance
    V = e^{4s} − 1 and the depth √(e^s − 1). The field with random phases says what V and kurtosis
    chance alone gives in a picture of this size.
    """
    spectrum = rfft2(height)
    y, x = np.fft.fftfreq(height.shape[0], pixel), np.fft.rfftfreq(height.shape[1], pixel)
    number = np.hypot(y[:, None], x[None, :])
    ratio = np.maximum(number / CARRIER, 1e-9)
    spectrum *= np.where(number <= EDGES[-1], 1 / np.sqrt(1 + ratio**-8), 0)
    kurtosis, power = _moments(irfft2(spectrum, height.shape), pixel)
    noise = rfft2(np.random.default_rng(0).standard_normal(height.shape))
    drawn = np.abs(spectrum) * noise / np.maximum(np.abs(noise), 1e-300)
    by_chance, power_by_chance = _moments(irfft2(drawn, height.shape), pixel)
    excess = max(kurtosis - by_chance, 0.0)
    if min(height.shape) * pixel < PATCHES / CORNER:
        return Unsteadiness(excess, None)
    more = (1 + power) / (1 + power_by_chance) - 1
    variance = np.log1p(more) / 4 if more > power_by_chance / 2 else 0.0
    return Unsteadiness(excess, float(np.sqrt(np.expm1(variance))))


def _moments(field: Floats, pixel: float) -> tuple[float, float]:
    """Return the excess kurtosis of a field and the relative variance of its slow power."""
    edge = min(round(MARGIN / pixel), min(field.shape) // 4)
    inner = (slice(edge, -edge),) * 2
    square = field**2
    sigma = np.sqrt(np.log(2)) / (2 * np.pi * CORNER * pixel)
    slow = gaussian_filter(square, sigma)[inner]
    square = square[inner]
    kurtosis = np.mean(square**2) / np.mean(square) ** 2 - 3
    return float(kurtosis), float(np.var(slow) / np.mean(slow) ** 2)
