"""A texture realized: spatial partials, their envelope and sparse events, the same at every visit.

The stochastic part is a set of M plane waves. A wave of wave number κ at an angle α from a stroke
sounds at the spatial frequency κ|cos α| along it, so a surface's bands along every direction are a
linear function of the waves' powers. Wave numbers are spread evenly over the bands (in their
logarithm), directions by the golden angle. A first non-negative least squares finds one power per
ring of wave numbers, a second one per wave near its ring's, from the bands in 72 directions.

An isotropic surface cannot have every spectrum: whatever has a wave number κ also sounds below it,
so bands cannot rise or peak. The nearest surface is taken and its error told per band.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import ndtri

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import descriptor as descriptors
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import BANDS, Descriptor, Events, Laws, Periodic, Stochastic

GOLDEN = (np.sqrt(5) - 1) / 2
DIRECTIONS = 72
"""In which an isotropic surface's bands are met, 2.5° apart."""
NEARNESS = 0.05
"""Weight that keeps a wave's power near its ring's: 0.1 dB of fit for a spread within ± 25 %."""
KEPT = 0.75
"""Of the kurtosis of bursts, within the bands: they carry power beyond, mostly below (measured)."""
JITTER_LINES = 5
ENVELOPE_WAVES = 12
BURSTS = 3.0, 4.5
"""Times the AM corner: where the envelope that carries the remaining kurtosis varies."""
MICRO, PER_MM = 1e-6, 1e3


@dataclass(frozen=True)
class Partials:
    """Plane waves of skin displacement, Σ a cos(k·p + φ).

    Attributes
    ----------
    wave_vector : (M, 2) [rad/m]
    amplitude : (M,) peak [m]
    phase : (M,) [rad]
    """

    wave_vector: Floats
    amplitude: Floats
    phase: Floats

    def __add__(self, other: "Partials") -> "Partials":
        return Partials(
            np.concatenate([self.wave_vector, other.wave_vector]),
            np.concatenate([self.amplitude, other.amplitude]),
            np.concatenate([self.phase, other.phase]),
        )

    def part(self, members: slice) -> "Partials":
        """Return some of the waves."""
        return Partials(self.wave_vector[members], self.amplitude[members], self.phase[members])

    def at(self, place: Floats) -> Floats:
        """Return the displacement [m] at places (..., 2) [m]."""
        phase = place @ self.wave_vector.T + self.phase
        return np.asarray(np.cos(phase) @ self.amplitude)

    def along(self, step: Floats, count: int) -> Floats:
        """Return the displacement [m] at places on a straight line from the origin.

        It is what `at` returns there, much sooner: a wave turns by the same angle with each step,
        so that its phasor at step i J + j is the product of one of step i J and one of step j.

        Parameters
        ----------
        step : from each place to the next (2,) [m]
        count : of the places
        """
        turn = self.wave_vector @ step
        size = math.isqrt(count) + 1
        coarse = self.phase + turn * size * np.arange(-(count // -size))[:, None]
        fine = turn * np.arange(size)[:, None]
        real = (self.amplitude * np.cos(coarse)) @ np.cos(fine).T
        imaginary = (self.amplitude * np.sin(coarse)) @ np.sin(fine).T
        return np.asarray((real - imaginary).ravel()[:count])


@dataclass(frozen=True)
class Surface:
    """One realization of a texture, ready to be rendered.

    Attributes
    ----------
    partials : the waves
    envelope : exponent of the positive envelope that multiplies them, itself slow waves (no unit)
    gratings : how many of the partials, the last, are a grating's, which no envelope multiplies
    events : place (E, 2) [m], peak (E,) [m] and kind (index into the descriptor's) of the sparse
        features in one tile of ``tile`` [m], which repeats
    """

    partials: Partials
    envelope: Partials
    event_place: Floats
    event_peak: Floats
    event_kind: NDArray[np.intp]
    tile: float = 25.6e-3
    gratings: int = 0

    @property
    def split(self) -> tuple[Partials, Partials]:
        """The waves that the envelope multiplies, and those of gratings."""
        count = len(self.partials.amplitude) - self.gratings
        return self.partials.part(slice(count)), self.partials.part(slice(count, None))


@dataclass(frozen=True)
class Texture:
    """A descriptor with the waves that meet it.

    Attributes
    ----------
    name : of the texture
    descriptor : as in its file
    wave_vector, amplitude : (M, 2) [rad/m] and (M,) [m] of the stochastic waves
    band_frequency : (16,) centers [cycles/m]; empty without a stochastic part
    band_error_db : (16,) what the realized surface has above (+) or below (−) the descriptor, mean
        over directions for an isotropic one; a large one names a band that no isotropic surface
        with these neighbors can have
    """

    name: str
    descriptor: Descriptor
    wave_vector: Floats
    amplitude: Floats
    band_frequency: Floats
    band_error_db: Floats

    @cached_property
    def partials(self) -> Partials:
        """The waves of seed 0, gratings included."""
        return self.realize().partials

    @property
    def laws(self) -> Laws:
        """The speed and force laws."""
        return self.descriptor.laws

    def realize(self, seed: int = 0) -> Surface:
        """Draw the surface: phases, envelope and events from the seed, the rest as it is."""
        rng = np.random.default_rng(seed)
        phase = rng.uniform(0, 2 * np.pi, len(self.amplitude))
        partials = Partials(self.wave_vector, self.amplitude, phase)
        for part in self.descriptor.periodic:
            partials = partials + grating(part, rng)
        scale = 1 / np.hypot(
            1, np.linalg.norm(partials.wave_vector, axis=1) * self.laws.contact_length_mm / PER_MM
        )
        scaled = Partials(partials.wave_vector, partials.amplitude * scale, partials.phase)
        return Surface(
            scaled,
            envelope(self.descriptor.stochastic, rng),
            *scatter(self.descriptor.events, Surface.tile, rng),
            gratings=len(partials.amplitude) - len(self.amplitude),
        )


def load_texture(name_or_path: str | Path, *, partials: int = 384) -> Texture:
    """Return a texture by its name or its file, realized as plane waves.

    Parameters
    ----------
    name_or_path : a shipped texture (`textures`), or a TOML file
    partials : M, the number of plane waves, those of gratings included

    Raises
    ------
    NotFoundError
        With the nearest name.
    InputError
        One line: file, field, value and limit.
    """
    descriptor = descriptors.load(name_or_path)
    waves = sum(
        len(p.harmonics_um) * (JITTER_LINES if p.jitter else 1) for p in descriptor.periodic
    )
    stochastic, left = descriptor.stochastic, partials - waves
    if left < (8 * BANDS if stochastic else 0):
        raise InputError(
            f"{name_or_path}: partials = {partials}: needs {waves} for its gratings"
            + (f" and at least {8 * BANDS} for its bands" if stochastic else "")
        )
    drawn = stochastic_waves(stochastic, left) if stochastic else _no_waves()
    frequency, error = np.zeros(0), np.zeros(0)
    if stochastic:
        frequency = np.asarray(stochastic.frequency_per_mm) * PER_MM
        levels = band_levels(*drawn, stochastic, stroke_directions(stochastic))
        power = np.mean(10 ** (levels / 10), axis=0)
        error = 10 * np.log10(np.maximum(power, 1e-30)) - np.asarray(stochastic.level_db)
    return Texture(descriptor.texture.id, descriptor, *drawn, frequency, error)


def without_friction(texture: Texture) -> Texture:
    """Return a texture whose shear is a function of place alone."""
    return replace(texture, descriptor=structs.replace(texture.descriptor, friction=None))


def _no_waves() -> tuple[Floats, Floats]:
    return np.zeros((0, 2)), np.zeros(0)


def band_edges(stochastic: Stochastic) -> Floats:
    """Return the 17 edges of the third-octave bands [rad/m]."""
    edges = third_octaves(np.asarray(stochastic.frequency_per_mm))
    return edges * 2 * np.pi * PER_MM


def stroke_directions(stochastic: Stochastic) -> Floats:
    """Return the directions [rad] along which the bands are to be met."""
    if stochastic.direction_spread_deg is None:
        return np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    return np.radians([stochastic.direction_deg])


def stochastic_waves(stochastic: Stochastic, count: int) -> tuple[Floats, Floats]:
    """Return wave vectors (M, 2) [rad/m] and amplitudes (M,) [m] that meet the bands.

    Bands are met in the least-squares sense of their power relative to the descriptor's.
    """
    edges = band_edges(stochastic)
    number = edges[0] * (edges[-1] / edges[0]) ** ((np.arange(count) + 0.5) / count)
    turn = _directions(stochastic, count)
    waves = number[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    width = np.diff(edges) / (2 * np.pi * PER_MM)
    target = 10 ** (np.asarray(stochastic.level_db) / 10) * width * MICRO**2
    share = band_shares(waves, edges, stroke_directions(stochastic)) / target[None, :, None]
    return waves, np.sqrt(2 * _powers(share.reshape(-1, count), np.digitize(number, edges) - 1))


def _directions(stochastic: Stochastic, count: int) -> Floats:
    """Return where wave vectors point [rad]: everywhere, or scattered about the direction."""
    spread = (np.arange(count) * GOLDEN + 0.5) % 1
    if stochastic.direction_spread_deg is None:
        return np.asarray(np.pi * spread)
    normal = ndtri(np.clip(spread, 1e-3, 1 - 1e-3))
    return np.asarray(
        np.radians(stochastic.direction_deg + stochastic.direction_spread_deg * normal)
    )


def _powers(share: Floats, ring: NDArray[np.intp]) -> Floats:
    """Return the power of each wave: one per ring, then one per wave near its ring's."""
    rows, count = share.shape
    belongs = np.equal.outer(ring, np.arange(BANDS)).astype(np.float64)
    start = belongs @ nnls(share @ belongs, np.ones(rows))[0]
    start = np.maximum(start, 1e-6 * start.max())
    hold = NEARNESS * np.sqrt(rows / BANDS)
    matrix = np.concatenate([share * start, hold * np.eye(count)])
    wanted = np.concatenate([np.ones(rows), np.full(count, hold)])
    return np.asarray(start * nnls(matrix, wanted)[0])


def band_shares(waves: Floats, edges: Floats, directions: Floats) -> Floats:
    """Return (D, 16, M) ones where a wave sounds in a band along a direction."""
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    band = np.digitize(np.abs(along @ waves.T), edges) - 1
    return np.asarray((band[:, None, :] == np.arange(BANDS)[:, None]).astype(np.float64))


def band_levels(
    waves: Floats, amplitude: Floats, stochastic: Stochastic, directions: Floats
) -> Floats:
    """Return the exact band levels of a line spectrum.

    Parameters
    ----------
    waves, amplitude : (M, 2) [rad/m] and (M,) [m]
    directions : (D,) of straight strokes [rad]

    Returns
    -------
    (D, 16) ndarray
        Of one-sided power spectral density, dB re 1 µm²·mm.
    """
    edges = band_edges(stochastic)
    power = band_shares(waves, edges, directions) @ (amplitude**2 / 2) / MICRO**2
    width = np.diff(edges) / (2 * np.pi * PER_MM)
    return np.asarray(10 * np.log10(np.maximum(power / width, 1e-30)))


def grating(part: Periodic, rng: np.random.Generator) -> Partials:
    """Return the waves of a grating.

    Without jitter each harmonic is one wave, its phase the file's. With it each is five waves at
    the quantiles of a normal distribution of wavelength, of equal power and random phase.
    """
    order = np.arange(1, len(part.harmonics_um) + 1)
    number = 2 * np.pi * PER_MM / part.wavelength_mm * order
    amplitude = np.asarray(part.harmonics_um) * MICRO
    phase = np.radians(part.phases_deg or np.zeros(len(order)))
    if part.jitter:
        quantiles = ndtri((np.arange(JITTER_LINES) + 0.5) / JITTER_LINES)
        stretch = 1 + part.jitter * quantiles / quantiles.std()
        number = np.outer(number, stretch).ravel()
        amplitude = np.repeat(amplitude / np.sqrt(JITTER_LINES), JITTER_LINES)
        phase = rng.uniform(0, 2 * np.pi, len(number))
    turn = np.radians(part.direction_deg)
    return Partials(np.outer(number, [np.cos(turn), np.sin(turn)]), amplitude, phase)


def envelope(stochastic: Stochastic | None, rng: np.random.Generator) -> Partials:
    """Return the waves g of the envelope exp(g − ⟨g²⟩), whose mean square is one.

    Slow waves spread evenly, along a stroke, from nothing to the AM corner, bursts beyond it; of
    an isotropic surface their wave vectors point everywhere, of a grained one along its direction
    with the bands' scatter.
    """
    total = Partials(*_no_waves(), np.zeros(0))
    if stochastic is None:
        return total
    place = (np.arange(ENVELOPE_WAVES) + 0.5) / ENVELOPE_WAVES
    turn, burst = _directions(stochastic, ENVELOPE_WAVES), BURSTS[0] + place * np.ptp(BURSTS)
    if stochastic.direction_spread_deg is None:
        slow, heard = np.sqrt(1 - (1 - place) ** 2), 2 / np.pi * np.arcsin(1 / burst)
    else:
        across = np.cos(turn - np.radians(stochastic.direction_deg))
        slow, heard = place, (burst * np.abs(across) <= 1).astype(np.float64)
    corner = 2 * np.pi * PER_MM * stochastic.am_corner_per_mm
    unit = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    shares = _variances(stochastic, float(heard.mean()))
    for number, variance in zip((slow, burst), shares, strict=True):
        if variance > 0:
            total = total + Partials(
                corner * number[:, None] * unit,
                np.full(ENVELOPE_WAVES, np.sqrt(2 * variance / ENVELOPE_WAVES)),
                rng.uniform(0, 2 * np.pi, ENVELOPE_WAVES),
            )
    return total


def _variances(stochastic: Stochastic, heard: float) -> tuple[float, float]:
    """Return the variance of the slow waves and of the bursts.

    ``heard`` is the share of the bursts that a stroke meets below the AM corner. A log-normal
    envelope of var(g) = s has the depth std/mean = √(exp(s) − 1) and gives the product with a
    normal process the excess kurtosis 3 (exp(4s) − 1): below the corner s is to give the depth,
    in all the kurtosis. A sum of n waves lacks some of a normal g's tail, which the next term of
    ln I₀ makes up for, s (1 + 7s/2n), as `KEPT` does for the band limits. A depth alone brings
    the kurtosis 3 ((1 + d²)⁴ − 1); where less is stated, that remains.
    """
    below = float(np.log(1 + stochastic.am_depth**2))
    total = float(np.log(1 + stochastic.excess_kurtosis / 3)) / 4
    total *= 1 + 3.5 * total / ENVELOPE_WAVES
    if total <= below:
        return below, 0.0
    burst = min((total - below) / (KEPT - heard), total / KEPT)
    return max(below - heard * burst, 0.0), burst


def scatter(
    kinds: tuple[Events, ...], tile: float, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Scatter events over a tile: Poisson in number, uniform in place, log-normal in amplitude."""
    places, peaks, kind = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros(0, np.intp)]
    for i, events in enumerate(kinds):
        count = rng.poisson(events.density_per_mm2 * (tile * PER_MM) ** 2)
        places.append(rng.uniform(0, tile, (count, 2)))
        sign = rng.choice([-1.0, 1.0], count)
        size = (
            events.amplitude_um * MICRO * np.exp(events.amplitude_sd * rng.standard_normal(count))
        )
        peaks.append(sign * size)
        kind.append(np.full(count, i, np.intp))
    return np.concatenate(places), np.concatenate(peaks), np.concatenate(kind)
