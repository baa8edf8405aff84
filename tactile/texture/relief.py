"""Measurements of a height map: spectrum, levels along a stroke, direction and unsteadiness.

All quantities are those of the relief, in meters of height. `skin` says what skin makes of it, and
`relief_texture` combines the two. The two-dimensional power spectral density is computed under one
Hann window over the whole picture and calibrated so that its sum is the variance. A stroke meets a
wave of wave vector q at the spatial frequency q·e along its direction e, so that the bands along a
stroke are a projection of the spectrum.
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
    10.0, 12.5, 16.0, 20.0, 25.0,
)  # fmt: skip
"""Band centers of the shipped textures up to 8, and those beyond that a fine picture adds
[cycles/mm]. Skin has not been observed at finer relief."""
EDGES = third_octaves(np.array(CENTERS)) * 1e3
"""Band edges, the same as those of `surface.band_edges` [cycles/m]."""
FEWEST = 16
"""Number of bands that every picture has, up to 8 cycles/mm, which the largest pixel samples."""
PERIODS = 4
"""Smallest number of periods of a band center in the shorter side for a band to count as measured.
A Hann window is good down to 2."""
RING_PERIODS = 8
"""Smallest number of periods in the shorter side for waves that count for the direction. The window
blurs their direction by 1.5 / periods [rad]."""
LEAST_RESULTANT = 0.2
"""Resultant below which a surface has no direction. That is a spread of more than 51°, which could
not be felt, nor stored above 60°."""
CARRIER = 1e3
"""Spatial frequency above which kurtosis and envelope are measured [cycles/m]."""
CORNER = 200.0
"""Highest spatial frequency of the envelope [cycles/m]: 5 mm, as the grain of the shipped calf
leather."""
MARGIN = 2e-3
"""Width of the margin of the picture that is left out because of the edge effects of filters
[m]."""
PATCHES = 4
"""Smallest number of periods of the envelope in the shorter side for its depth to be measured."""


@dataclass(frozen=True)
class ReliefSpectrum:
    """Power of a height map over wave vectors, one of each pair ±q.

    Attributes
    ----------
    x : (K,) array of float
        Spatial frequency along x [cycles/m].
    y : (K,) array of float
        Spatial frequency along y [cycles/m].
    power : (K,) array of float
        Power of each wave vector, which adds up to the variance of height [m²].
    side : float
        Shorter side of the picture [m].
    nyquist : float
        Half of the sampling frequency [cycles/m].
    """

    x: Floats
    y: Floats
    power: Floats
    side: float
    nyquist: float

    @cached_property
    def edges(self) -> Floats:
        """Edges of the B bands that the pixels resolve, (B + 1,) array [cycles/m]."""
        bands = int(np.count_nonzero(EDGES[1:] <= self.nyquist * (1 + 1e-9)))
        return EDGES[: max(bands, FEWEST) + 1]

    @cached_property
    def number(self) -> Floats:
        """Wave number of each wave vector, (K,) array [cycles/m]."""
        return np.hypot(self.x, self.y)

    def rms_slope(self, number: Floats) -> Floats:
        """Compute the rms slope of all relief up to given wave numbers.

        The window widens every line by two bins, which are counted with it.

        Parameters
        ----------
        number : (...) array of float
            Wave numbers [cycles/m].

        Returns
        -------
        (...) array of float
            Rms slope of the waves up to each of them, without unit.
        """
        ring = (self.number * self.side).astype(np.intp)
        total = np.cumsum(np.bincount(ring, (2 * np.pi * self.number) ** 2 * self.power))
        last_ring = (np.asarray(number) * self.side + 2).astype(np.intp)
        return np.asarray(np.sqrt(total[np.minimum(last_ring, len(total) - 1)]))

    def scaled(self, gain: Floats) -> "ReliefSpectrum":
        """Return the spectrum with a gain applied to the amplitudes.

        Parameters
        ----------
        gain : (K,) array of float
            Factor of the amplitude of each wave vector.

        Returns
        -------
        ReliefSpectrum
            Spectrum with the power multiplied by the square of the gain.
        """
        return ReliefSpectrum(self.x, self.y, self.power * gain**2, self.side, self.nyquist)


def leveled(height: Floats) -> tuple[Floats, float]:
    """Subtract the best-fit plane from a height map.

    Parameters
    ----------
    height : (R, C) array of float
        Height [m].

    Returns
    -------
    rest : (R, C) array of float
        Height without mean and tilt [m].
    sag : float
        Highest less lowest value of the paraboloid that fits the rest best [m].
    """
    y, x = (np.linspace(-1, 1, n) for n in height.shape)
    rest = height - height.mean()
    # Adding 0 * rest broadcasts the squares of a base to the shape of the picture.
    for base in (x[None, :], y[:, None]):
        rest = rest - base * (np.sum(rest * base) / np.sum(base**2 + 0 * rest))
    sag = np.zeros_like(rest)
    for base in (
        (x**2 - np.mean(x**2))[None, :], (y**2 - np.mean(y**2))[:, None], np.outer(y, x),
    ):  # fmt: skip
        sag += base * (np.sum(rest * base) / np.sum(base**2 + 0 * rest))
    return rest, float(np.ptp(sag))


def spectrum_of(height: Floats, pixel: float) -> ReliefSpectrum:
    """Compute the power of a height map over wave vectors.

    Parameters
    ----------
    height : (R, C) array of float
        Height, with row 0 at the lowest y [m].
    pixel : float
        Side of a pixel [m].

    Returns
    -------
    ReliefSpectrum
        Power spectrum. The power is |FFT(w h)|² / (R C Σw²) under the window w, doubled where the
        spectrum does not contain −q. By Parseval it adds up to Σ(w h)² / Σw².
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
    """Compute the band levels along a stroke.

    Parameters
    ----------
    spectrum : ReliefSpectrum
        Spectrum of the relief, or of the skin displacement that it causes.
    direction : float or None
        Direction of the stroke [rad], or None for the mean over all directions.

    Returns
    -------
    (B,) array of float
        Levels in the bands that the pixels resolve [dB re 1 µm²·mm].

    Notes
    -----
    In the mean over all directions, a wave number κ contributes the share (2/π)
    (acos(a/κ) − acos(b/κ)) of its power between the spatial frequencies a and b. Along one
    direction each bin is spread over its width, since the coarsest bands hold only one or two bins.
    """
    edges = np.minimum(spectrum.edges, spectrum.nyquist)
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
    """Return the lowest band of which a picture holds enough periods.

    Parameters
    ----------
    side : float
        Shorter side of the picture [m].

    Returns
    -------
    int
        Index into `CENTERS`.
    """
    return int(np.searchsorted(np.array(CENTERS) * 1e3, PERIODS / side * (1 - 1e-9)))


def held_below(levels: Floats, first: int) -> Floats:
    """Replace the levels below a band by levels of the same rms displacement as that band.

    The density then rises by 1 dB from each band to the next lower one. So does the reference skin
    spectrum below 0.5 cycles/mm, where it is assumed as well.

    Parameters
    ----------
    levels : (B,) array of float
        Levels [dB re 1 µm²·mm].
    first : int
        Index of the lowest band that is kept as it is.

    Returns
    -------
    (B,) array of float
        Levels with those before ``first`` replaced.
    """
    held = levels.copy()
    held[:first] = levels[first] + 10 * np.log10(CENTERS[first] / np.array(CENTERS[:first]))
    return held


@dataclass(frozen=True)
class Orientation:
    """Distribution of the directions of wave vectors.

    Attributes
    ----------
    direction : float
        Mean direction, 0 where none stands out [rad].
    spread : float or None
        Standard deviation of the direction, or None where no direction stands out [rad].
    resultant : float
        Length of the mean resultant vector on doubled angles: 0 for an isotropic surface, 1 for
        waves of one direction.
    """

    direction: float
    spread: float | None
    resultant: float


def orientation_of(spectrum: ReliefSpectrum) -> Orientation:
    """Fit the normal distribution of the directions of wave vectors that a descriptor assumes.

    Parameters
    ----------
    spectrum : ReliefSpectrum
        Spectrum of the relief, or of the skin displacement that it causes.

    Returns
    -------
    Orientation
        Mean direction, spread and resultant.

    Notes
    -----
    On doubled angles the resultant of a wrapped normal distribution is R = exp(−2 σ²) (Mardia &
    Jupp). It is computed for each third-octave ring of wave numbers. The rings are weighted by
    their rms, so that both coarse and fine relief count.
    """
    number = spectrum.number
    low = max(EDGES[0], RING_PERIODS / spectrum.side)
    ring = np.digitize(number, EDGES)
    ring[(number < low) | (number > min(spectrum.edges[-1], spectrum.nyquist))] = 0
    turn = np.exp(2j * np.arctan2(spectrum.y, spectrum.x)) * spectrum.power
    count, total = np.bincount(ring)[1:], np.bincount(ring, spectrum.power)[1:]
    vector = (np.bincount(ring, turn.real) + 1j * np.bincount(ring, turn.imag))[1:]
    occupied = (count > 0) & (total > 0)
    weight = np.sqrt(total[occupied])
    mean = np.sum(weight * vector[occupied] / total[occupied]) / np.sum(weight)
    chance = np.sqrt(2.25 * np.sum(weight**2 / count[occupied])) / np.sum(weight)
    resultant = float(np.abs(mean))
    direction = float(np.angle(mean)) / 2
    if resultant < max(LEAST_RESULTANT, 3 * chance):
        return Orientation(0.0, None, resultant)
    return Orientation(direction, float(np.sqrt(-np.log(min(resultant, 0.9999)) / 2)), resultant)


@dataclass(frozen=True)
class Unsteadiness:
    """Statistics of a relief that its spectrum does not contain.

    Attributes
    ----------
    excess_kurtosis : float
        Excess kurtosis, as in a descriptor.
    am_depth : float or None
        Depth of the amplitude modulation, as in a descriptor, or None where the picture is too
        small to measure it.
    """

    excess_kurtosis: float
    am_depth: float | None


def unsteadiness_of(height: Floats, pixel: float, finest: float) -> Unsteadiness:
    """Compare the relief above 1 cycle/mm with a Gaussian field of the same spectrum.

    Parameters
    ----------
    height : (R, C) array of float
        Height without mean and tilt [m].
    pixel : float
        Side of a pixel [m].
    finest : float
        Highest spatial frequency that counts [cycles/m].

    Returns
    -------
    Unsteadiness
        Excess kurtosis and modulation depth beyond those of the Gaussian field.

    Notes
    -----
    A log-normal envelope exp(g) with var g = s leaves a power e^{2g} of the relative variance
    V = e^{4s} − 1, and has the depth √(e^s − 1). The field with random phases tells the V and the
    kurtosis that chance alone gives in a picture of this size.
    """
    spectrum = rfft2(height)
    y, x = np.fft.fftfreq(height.shape[0], pixel), np.fft.rfftfreq(height.shape[1], pixel)
    number = np.hypot(y[:, None], x[None, :])
    ratio = np.maximum(number / CARRIER, 1e-9)
    spectrum *= np.where(number <= finest, 1 / np.sqrt(1 + ratio**-8), 0)
    kurtosis, power = _moments(irfft2(spectrum, height.shape), pixel)
    noise = rfft2(np.random.default_rng(0).standard_normal(height.shape))
    random_spectrum = np.abs(spectrum) * noise / np.maximum(np.abs(noise), 1e-300)
    by_chance, power_by_chance = _moments(irfft2(random_spectrum, height.shape), pixel)
    excess = max(kurtosis - by_chance, 0.0)
    if min(height.shape) * pixel < PATCHES / CORNER:
        return Unsteadiness(excess, None)
    excess_power = (1 + power) / (1 + power_by_chance) - 1
    variance = np.log1p(excess_power) / 4 if excess_power > power_by_chance / 2 else 0.0
    return Unsteadiness(excess, float(np.sqrt(np.expm1(variance))))


def _moments(field: Floats, pixel: float) -> tuple[float, float]:
    """Return the excess kurtosis of a field and the relative variance of its smoothed power."""
    edge = min(round(MARGIN / pixel), min(field.shape) // 4)
    inner = (slice(edge, -edge),) * 2
    square = field**2
    sigma = np.sqrt(np.log(2)) / (2 * np.pi * CORNER * pixel)
    slow = gaussian_filter(square, sigma)[inner]
    square = square[inner]
    kurtosis = np.mean(square**2) / np.mean(square) ** 2 - 3
    return float(kurtosis), float(np.var(slow) / np.mean(slow) ** 2)
