"""Realization of a texture as a field of noise, gratings, an envelope and events, fixed in place.

The two-dimensional spectrum of the random part is determined by a set of M plane waves. A wave of
wave number κ at an angle α to a stroke has the spatial frequency κ|cos α| along it, so that the
bands of a surface along every direction are a linear function of the powers of its waves. Wave
numbers are spread evenly over the bands (in their logarithm), directions by the golden angle. A
first non-negative least-squares fit to the bands in 72 directions finds one power per ring of wave
numbers, a second one finds one per wave, near that of its ring.

Samples play a `field` with that spectrum instead of the waves themselves, whose lines a classifier
recognizes. If the file has a map, they play it instead of waves, envelope and gratings. Spectrum
frames, which can carry few waves, play the waves; field and waves of a surface are two realizations
of one texture. Closed forms are computed from the `density` of both.

An isotropic surface cannot have every spectrum: whatever has a wave number κ also contributes below
it, so that bands can neither rise nor peak. The nearest surface is taken, and its error is reported
for each band.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from zlib import crc32

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq, nnls
from scipy.special import i0, i0e, i1, ndtri

from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.files import SourceFile, find, read_text
from tactile.texture import descriptor as descriptors
from tactile.texture.bands import third_octaves
from tactile.texture.density import Density
from tactile.texture.descriptor import (
    Descriptor,
    Events,
    Laws,
    Modulation,
    Periodic,
    SkinMap,
    Stochastic,
)
from tactile.texture.field import Field, field_of_rectangle

GOLDEN = (np.sqrt(5) - 1) / 2
"""Golden ratio less one, which spreads the directions of waves evenly."""
PARTIALS = 384
"""Number of plane waves of a texture unless another is given."""
DIRECTIONS = 72
"""Number of stroke directions in which the bands of an isotropic surface are fitted, 2.5° apart."""
NEARNESS = 0.05
"""Weight that keeps the power of a wave near that of its ring. The fit of the bands is 0.1 dB worse
for it, and the powers of a ring stay within ±25 %."""
LARGEST_CONDITION = 1e6
"""Largest condition of the normal equations of the fit, at which they lose six of their 16 digits;
that of shipped textures is 1e3."""
BURST_KURTOSIS = 0.75
"""Share of the kurtosis of bursts that remains within the bands (measured). They also carry power
outside of them, mostly below."""
JITTER_LINES = 5
"""Number of waves that represent one harmonic of a grating with jitter."""
ENVELOPE_WAVES = 12
"""Number of waves in each of the two parts of an envelope, the slow one and the bursts."""
BURSTS = 3.0, 4.5
"""Range of the wave numbers of bursts, the part of the envelope that carries the remaining
kurtosis, as multiples of the AM corner."""
FIELD_STREAM = 1
"""Number of the stream of random numbers that the phases of a field come from."""
MICRO, PER_MM = 1e-6, 1e3
"""Meters per micrometer, and cycles/m per cycle/mm."""


@dataclass(frozen=True)
class Partials:
    """Plane waves of skin displacement, Σ a cos(k·p + φ).

    Attributes
    ----------
    wave_vector : (M, 2) array of float
        Wave vectors k [rad/m].
    amplitude : (M,) array of float
        Peak amplitudes a [m].
    phase : (M,) array of float
        Phases φ [rad].
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

    def part(self, members: slice | NDArray[np.bool_]) -> "Partials":
        """Select some of the waves.

        Parameters
        ----------
        members : slice or (M,) array of bool
            Waves to select.

        Returns
        -------
        Partials
            Selected waves.
        """
        return Partials(self.wave_vector[members], self.amplitude[members], self.phase[members])

    def at(self, place: Floats) -> Floats:
        """Compute the displacement at given places.

        Parameters
        ----------
        place : (..., 2) array of float
            Positions p [m].

        Returns
        -------
        (...) array of float
            Sum of the waves [m].
        """
        phase = place @ self.wave_vector.T + self.phase
        return np.asarray(np.cos(phase) @ self.amplitude)

    def phasors(self, places: Floats) -> Complex:
        """Compute a exp j(k·x + φ) of each wave at given places.

        Parameters
        ----------
        places : (N, 2) array of float
            Positions x [m].

        Returns
        -------
        (M, N) array of complex
            Phasors, whose real parts add up to the displacement [m].
        """
        phase = self.wave_vector @ places.T + self.phase[:, None]
        return np.asarray(self.amplitude[:, None] * np.exp(1j * phase))


@dataclass(frozen=True)
class Surface:
    """One realization of a texture, ready to be rendered.

    Attributes
    ----------
    partials : Partials
        All waves of skin displacement, those of gratings last.
    envelope : Partials
        Waves g, without unit, whose sum is the exponent of the positive envelope that multiplies
        the waves outside of gratings.
    event_place : (E, 2) array of float
        Places of the sparse events within one tile [m].
    event_peak : (E,) array of float
        Peak displacements of the events, of either sign [m].
    event_kind : (E,) array of int
        Index of the kind of each event in the descriptor.
    tile : float
        Side of the square tile of events, which repeats over the surface [m].
    gratings : int
        Number of partials, at the end, that belong to gratings and are not multiplied by the
        envelope.
    map : SkinMap or None
        Displacement pixel by pixel, which is played instead of waves and envelope.
    contact : float
        Length of the low-pass of the contact, which is not yet applied to the map [m].
    density : Density or None
        Two-dimensional spectrum of the random part, None without one.
    seed : tuple of int
        Seed of the field.
    """

    partials: Partials
    envelope: Partials
    event_place: Floats
    event_peak: Floats
    event_kind: NDArray[np.intp]
    tile: float = 25.6e-3
    gratings: int = 0
    map: SkinMap | None = None
    contact: float = 0.0
    density: Density | None = None
    seed: tuple[int, ...] = (0,)

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """Random part or map as fields, which are played instead of the waves."""
        if self.map is not None:
            return (map_field(self.map, self.contact),)
        rng = np.random.default_rng([*self.seed, FIELD_STREAM])
        return () if self.density is None else self.density.drawn(rng)

    @property
    def beside_fields(self) -> "Surface":
        """Surface without the waves that its fields replace, to be added to the fields.

        Waves remain where a tile has too few, and those of gratings. Nothing but sparse events
        remains beside a map.
        """
        if self.map is not None:
            none = Partials(*_no_waves(), np.zeros(0))
            return replace(self, partials=none, envelope=none, gratings=0)
        if not self.fields or self.density is None:
            return self
        bands, gratings = self.split
        size = np.linalg.norm(bands.wave_vector, axis=1) / (2 * np.pi)
        lowest = self.density.ranges[-1][0]
        return replace(self, partials=bands.part(size < lowest) + gratings)

    def random_part(self, place: Floats) -> Floats:
        """Compute the displacement of the random part without its envelope, or that of the map.

        Parameters
        ----------
        place : (..., 2) array of float
            Places [m].

        Returns
        -------
        (...) array of float
            Sum of the fields and of the waves beside them [m].
        """
        waves = self.beside_fields.split[0].at(place)
        return np.asarray(waves + sum(field.at(place) for field in self.fields))

    @property
    def split(self) -> tuple[Partials, Partials]:
        """Waves that the envelope multiplies, and waves of gratings."""
        count = len(self.partials.amplitude) - self.gratings
        return self.partials.part(slice(count)), self.partials.part(slice(count, None))


@dataclass(frozen=True)
class Texture:
    """A descriptor with the waves that realize its stochastic part.

    Attributes
    ----------
    name : str
        Name of the texture.
    descriptor : Descriptor
        Contents of its file.
    wave_vector : (M, 2) array of float
        Wave vectors of the stochastic part [rad/m].
    amplitude : (M,) array of float
        Peak amplitudes of these waves [m].
    band_frequency : (B,) array of float
        Band centers, empty without a stochastic part [cycles/m].
    band_error_db : (B,) array of float
        Level of the realized surface above (+) or below (−) that of the descriptor, in the mean
        over directions for an isotropic surface, empty without a stochastic part [dB]. A large
        error marks a band that no isotropic surface with these neighboring bands can have.
    density : Density or None
        Two-dimensional spectrum of the random part, of which the waves are a sample and which the
        field realizes; None without a random part.
    """

    name: str
    descriptor: Descriptor
    wave_vector: Floats
    amplitude: Floats
    band_frequency: Floats
    band_error_db: Floats
    density: Density | None = None

    @cached_property
    def partials(self) -> Partials:
        """Waves of the realization with seed 0, those of gratings last."""
        return self.realize().partials

    @property
    def laws(self) -> Laws:
        """Speed and force laws of the descriptor."""
        return self.descriptor.laws

    def realize(self, seed: int = 0) -> Surface:
        """Draw one realization of the surface.

        Parameters
        ----------
        seed : int
            Seed of the random numbers that determine phases, envelope and events. All else is the
            same for every seed. The name of the texture is part of the seed, so that textures of
            one seed have nothing in common.

        Returns
        -------
        Surface
            Realization, with the contact low-pass of ``contact_length_mm`` applied to its waves.
        """
        entropy = crc32(self.name.encode()), seed
        rng = np.random.default_rng(entropy)
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
            envelope(self.descriptor.stochastic, rng) + modulating(self.descriptor.modulation),
            *scatter(self.descriptor.events, Surface.tile, rng),
            gratings=len(partials.amplitude) - len(self.amplitude),
            map=self.descriptor.map,
            contact=self.laws.contact_length_mm / PER_MM,
            density=self.density,
            seed=entropy,
        )


def load_texture(name_or_path: str | Path, *, partials: int = PARTIALS) -> Texture:
    """Load a texture and fit plane waves to its bands.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped texture (`textures`), or path of a TOML file.
    partials : int
        Total number of plane waves, those of gratings included.

    Returns
    -------
    Texture
        Descriptor with its waves.

    Raises
    ------
    NotFoundError
        If there is no such texture or file. The message names the nearest one.
    InputError
        If the file is invalid or ``partials`` is too small. The message is one line with the file,
        field, value and limit.

    Examples
    --------
    >>> import tactile
    >>> tactile.load_texture("wood-oak", partials=200).amplitude.shape
    (200,)
    """
    return _fitted(descriptors.load(name_or_path), partials, str(name_or_path))


def load_with_source(name_or_path: str | Path) -> tuple[Texture, SourceFile]:
    """Load a texture together with the text of the file that describes it.

    Parameters
    ----------
    name_or_path : str or Path
        As in `load_texture`.

    Returns
    -------
    texture : Texture
        The texture.
    source : SourceFile
        Text of its file.

    Raises
    ------
    NotFoundError, InputError
        As in `load_texture`.
    """
    path = find("textures", name_or_path)
    source = SourceFile(path.name, read_text(path))
    return texture_of(source, path.parent), source


def texture_of(source: SourceFile, folder: Path) -> Texture:
    """Build a texture from the text of its file.

    Parameters
    ----------
    source : SourceFile
        Text, as `load_with_source` returns it.
    folder : Path
        Folder of the file in error messages; no file is read.

    Returns
    -------
    Texture
        The texture.

    Raises
    ------
    InputError
        As in `load_texture`.
    """
    path = folder / source.name
    return _fitted(descriptors.parse(source.text, path), PARTIALS, str(path))


def _fitted(descriptor: Descriptor, partials: int, name: str) -> Texture:
    """Return a descriptor with the plane waves that are fitted to it."""
    grating_waves = sum(
        len(p.harmonics_um) * (JITTER_LINES if p.jitter else 1) for p in descriptor.periodic
    )
    stochastic, remaining = descriptor.stochastic, partials - grating_waves
    fewest = 8 * len(stochastic.level_db) if stochastic else 0
    if remaining < fewest:
        raise InputError(
            f"{name}: partials = {partials}: needs {grating_waves} for its gratings"
            + (f" and at least {fewest} for its bands" if stochastic else "")
        )
    fitted_waves = stochastic_waves(stochastic, remaining) if stochastic else _no_waves()
    frequency, error = np.zeros(0), np.zeros(0)
    if stochastic:
        frequency = np.asarray(stochastic.frequency_per_mm) * PER_MM
        levels = band_levels(*fitted_waves, stochastic, stroke_directions(stochastic))
        power = np.mean(10 ** (levels / 10), axis=0)
        error = 10 * np.log10(np.maximum(power, 1e-30)) - np.asarray(stochastic.level_db)
    density = density_of(*fitted_waves, stochastic, descriptor.laws) if stochastic else None
    return Texture(descriptor.texture.id, descriptor, *fitted_waves, frequency, error, density)


def density_of(waves: Floats, amplitude: Floats, stochastic: Stochastic, laws: Laws) -> Density:
    """Compute the continuous two-dimensional spectrum of a surface from its plane waves.

    Parameters
    ----------
    waves : (M, 2) array of float
        Wave vectors [rad/m].
    amplitude : (M,) array of float
        Peak amplitudes [m].
    stochastic : Stochastic
        Random part that the waves are fitted to.
    laws : Laws
        Laws of the texture, of which the low-pass of the contact is part of the density.

    Returns
    -------
    Density
        Density whose rings have the power of their waves, adjusted so that strokes have the bands
        that the waves have on average over `stroke_directions`.
    """
    power = amplitude**2 / 2
    edges, spread = band_edges(stochastic), stochastic.direction_spread_deg
    ring = np.digitize(np.linalg.norm(waves, axis=1), edges[1:-1])
    met = band_shares(waves, edges, stroke_directions(stochastic)) @ power
    density = Density(
        np.asarray(stochastic.frequency_per_mm) * PER_MM,
        np.bincount(ring, power, len(edges) - 1).astype(np.float64),
        math.radians(stochastic.direction_deg),
        None if spread is None else math.radians(spread),
    ).with_bands(met.mean(axis=0))
    return replace(density, contact=laws.contact_length_mm / PER_MM)


def map_field(played: SkinMap, contact: float) -> Field:
    """Compute the field of a map.

    Parameters
    ----------
    played : SkinMap
        Map of a descriptor.
    contact : float
        Length l of the low-pass of the contact, 1/√(1 + (κ l)²), 0 for none [m].

    Returns
    -------
    Field
        Field of the waves that the map resolves in all directions.
    """
    side = np.array([played.width_mm, played.height_mm]) / PER_MM
    displacement = played.displacement
    if contact:
        rows, columns = displacement.shape
        y, x = np.fft.fftfreq(rows, side[1] / rows), np.fft.rfftfreq(columns, side[0] / columns)
        low_pass = 1 / np.hypot(1, 2 * np.pi * contact * np.hypot(x, y[:, None]))
        displacement = np.fft.irfft2(np.fft.rfft2(displacement) * low_pass, displacement.shape)
    return field_of_rectangle(displacement, side, played.highest_per_mm * PER_MM)


def without_friction(texture: Texture) -> Texture:
    """Return a copy of a texture without friction, whose shear is a function of place alone.

    Parameters
    ----------
    texture : Texture
        Texture to copy.

    Returns
    -------
    Texture
        Same texture with no friction in its descriptor.
    """
    return replace(texture, descriptor=structs.replace(texture.descriptor, friction=None))


def _no_waves() -> tuple[Floats, Floats]:
    """Return empty arrays of wave vectors and amplitudes."""
    return np.zeros((0, 2)), np.zeros(0)


def band_edges(stochastic: Stochastic) -> Floats:
    """Compute the edges of the third-octave bands of a stochastic part as wave numbers.

    Parameters
    ----------
    stochastic : Stochastic
        Random part of a texture.

    Returns
    -------
    (B + 1,) array of float
        Edges in ascending order [rad/m].
    """
    edges = third_octaves(np.asarray(stochastic.frequency_per_mm))
    return edges * 2 * np.pi * PER_MM


def stroke_directions(stochastic: Stochastic) -> Floats:
    """Return the stroke directions along which the bands of a stochastic part must hold.

    Parameters
    ----------
    stochastic : Stochastic
        Random part of a texture.

    Returns
    -------
    (D,) array of float
        72 directions for an isotropic surface, otherwise its own direction [rad].
    """
    if stochastic.direction_spread_deg is None:
        return np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    return np.radians([stochastic.direction_deg])


def stochastic_waves(stochastic: Stochastic, count: int) -> tuple[Floats, Floats]:
    """Compute plane waves whose bands are those of a stochastic part.

    The bands are fitted by least squares of their power relative to that of the descriptor.

    Parameters
    ----------
    stochastic : Stochastic
        Random part of a texture.
    count : int
        Number M of waves.

    Returns
    -------
    wave_vector : (M, 2) array of float
        Wave vectors [rad/m].
    amplitude : (M,) array of float
        Peak amplitudes [m].
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
    """Return the directions of wave vectors, all around or scattered about the direction [rad]."""
    spread = (np.arange(count) * GOLDEN + 0.5) % 1
    if stochastic.direction_spread_deg is None:
        return np.asarray(np.pi * spread)
    normal = ndtri(np.clip(spread, 1e-3, 1 - 1e-3))
    return np.asarray(
        np.radians(stochastic.direction_deg + stochastic.direction_spread_deg * normal)
    )


def _powers(share: Floats, ring: NDArray[np.intp]) -> Floats:
    """Return the power of each wave: one per ring first, then one per wave near its ring."""
    rows, count = share.shape
    bands = int(ring.max()) + 1
    membership = np.equal.outer(ring, np.arange(bands)).astype(np.float64)
    ring_power = membership @ nnls(share @ membership, np.ones(rows))[0]
    ring_power = np.maximum(ring_power, 1e-6 * ring_power.max())
    weight = NEARNESS * np.sqrt(rows / bands)
    # Rows below those of the bands pull the power of each wave, relative to its ring, to 1.
    matrix = np.concatenate([share * ring_power, weight * np.eye(count)])
    target = np.concatenate([np.ones(rows), np.full(count, weight)])
    return np.asarray(ring_power * _least_squares(matrix, target, weight))


def _least_squares(matrix: Floats, target: Floats, lowest: float) -> Floats:
    """Return the least squares solution without negative elements.

    ``lowest`` is a lower bound of the singular values of the matrix. If the solution without the
    condition has no negative element, it is the one; `nnls`, which admits one element after the
    other, takes ten times as long to find it.
    """
    normal = matrix.T @ matrix
    if np.trace(normal) < LARGEST_CONDITION * lowest**2:
        free = cho_solve(cho_factor(normal), matrix.T @ target)
        if free.min() >= 0:
            return np.asarray(free)
    return np.asarray(nnls(matrix, target)[0])


def band_shares(waves: Floats, edges: Floats, directions: Floats) -> Floats:
    """Determine which wave contributes to which band along each direction.

    Parameters
    ----------
    waves : (M, 2) array of float
        Wave vectors [rad/m].
    edges : (B + 1,) array of float
        Edges of the B bands [rad/m].
    directions : (D,) array of float
        Directions of straight strokes [rad].

    Returns
    -------
    (D, B, M) array of float
        1 where a wave falls into a band along a direction, otherwise 0.
    """
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    band = np.digitize(np.abs(along @ waves.T), edges) - 1
    return np.asarray((band[:, None, :] == np.arange(len(edges) - 1)[:, None]).astype(np.float64))


def band_levels(
    waves: Floats, amplitude: Floats, stochastic: Stochastic, directions: Floats
) -> Floats:
    """Compute the exact band levels of a line spectrum.

    Parameters
    ----------
    waves : (M, 2) array of float
        Wave vectors [rad/m].
    amplitude : (M,) array of float
        Peak amplitudes [m].
    stochastic : Stochastic
        Random part that defines the bands.
    directions : (D,) array of float
        Directions of straight strokes [rad].

    Returns
    -------
    (D, B) array of float
        One-sided power spectral density in each band [dB re 1 µm²·mm].
    """
    edges = band_edges(stochastic)
    power = band_shares(waves, edges, directions) @ (amplitude**2 / 2) / MICRO**2
    width = np.diff(edges) / (2 * np.pi * PER_MM)
    return np.asarray(10 * np.log10(np.maximum(power / width, 1e-30)))


def grating(part: Periodic, rng: np.random.Generator) -> Partials:
    """Compute the waves of a grating.

    Without jitter each harmonic is one wave with the phase of the descriptor. With jitter it is
    five waves of equal power and random phase, at quantiles of a normal distribution of the
    relative deviation of the wave number.

    Parameters
    ----------
    part : Periodic
        Grating of a descriptor.
    rng : numpy.random.Generator
        Source of the random phases.

    Returns
    -------
    Partials
        Waves of the grating.
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
    """Draw the slow waves and the bursts of the exponent g of an envelope exp(g).

    Slow waves are spread evenly along a stroke from zero to the AM corner, and bursts lie above it.
    On an isotropic surface their wave vectors point in all directions, on a surface with a
    direction along it, with the same scatter as the bands.

    Parameters
    ----------
    stochastic : Stochastic or None
        Random part of a texture.
    rng : numpy.random.Generator
        Source of the random phases.

    Returns
    -------
    Partials
        Waves without unit. There are none without a stochastic part, modulation and kurtosis.
    """
    total = Partials(*_no_waves(), np.zeros(0))
    if stochastic is None:
        return total
    place = (np.arange(ENVELOPE_WAVES) + 0.5) / ENVELOPE_WAVES
    turn, burst = _directions(stochastic, ENVELOPE_WAVES), BURSTS[0] + place * np.ptp(BURSTS)
    if stochastic.direction_spread_deg is None:
        slow, share_below_corner = np.sqrt(1 - (1 - place) ** 2), 2 / np.pi * np.arcsin(1 / burst)
    else:
        across = np.cos(turn - np.radians(stochastic.direction_deg))
        slow, share_below_corner = place, (burst * np.abs(across) <= 1).astype(np.float64)
    corner = 2 * np.pi * PER_MM * stochastic.am_corner_per_mm
    unit = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    shares = _variances(stochastic, float(share_below_corner.mean()))
    for number, variance in zip((slow, burst), shares, strict=True):
        if variance > 0:
            total = total + Partials(
                corner * number[:, None] * unit,
                np.full(ENVELOPE_WAVES, np.sqrt(2 * variance / ENVELOPE_WAVES)),
                rng.uniform(0, 2 * np.pi, ENVELOPE_WAVES),
            )
    return total


def modulating(parts: tuple[Modulation, ...]) -> Partials:
    """Compute the waves of periodic envelopes, each a cos of phase 0 at the origin.

    Parameters
    ----------
    parts : tuple of Modulation
        Periodic envelopes of a descriptor.

    Returns
    -------
    Partials
        Waves without unit.
    """
    if not parts:
        return Partials(*_no_waves(), np.zeros(0))
    amplitude = [exponent_of_depth(p.depth) for p in parts]
    number = 2 * np.pi * PER_MM / np.array([p.wavelength_mm for p in parts])
    turn = np.radians([p.direction_deg for p in parts])
    vector = number[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Partials(vector, np.array(amplitude), np.zeros(len(parts)))


def exponent_of_depth(depth: float) -> float:
    """Compute the amplitude of the exponent of a periodic envelope from its depth.

    The envelope exp(a cos φ) has the mean I₀(a) and the fundamental 2 I₁(a) (Abramowitz & Stegun,
    9.6.34).

    Parameters
    ----------
    depth : float
        Amplitude of the envelope's fundamental ÷ its mean, 0 to 1.

    Returns
    -------
    float
        Amplitude a, without unit.
    """
    return float(brentq(lambda a: 2 * i1(a) / i0(a) - depth, 0.0, 2.0))


def envelope_scale(waves: Partials) -> float:
    """Compute the factor that brings the envelope exp(g) to a mean square of one.

    A wave of amplitude a brings the mean square ⟨exp(2a cos φ)⟩ = I₀(2a), independent of the
    others.

    Parameters
    ----------
    waves : Partials
        Waves of g, without unit.

    Returns
    -------
    float
        Factor 1/√∏ I₀(2a), 1 without waves.
    """
    twice = 2 * waves.amplitude
    return float(np.exp(-np.sum(np.log(i0e(twice)) + twice) / 2))


def _variances(stochastic: Stochastic, low_share: float) -> tuple[float, float]:
    """Return the variances of the slow waves and of the bursts.

    ``low_share`` is the share of the bursts that a stroke meets below the AM corner. A log-normal
    envelope with var(g) = s has the depth std/mean = √(exp(s) − 1) and gives the product with a
    normal process the excess kurtosis 3 (exp(4s) − 1). So s below the corner must give the depth,
    and s in total the kurtosis. A sum of n waves has less of a tail than a normal g. The next term
    of ln I₀ compensates for that, s (1 + 7s/2n), as `BURST_KURTOSIS` does for the band limits. A
    depth alone brings the kurtosis 3 ((1 + d²)⁴ − 1); where less is stated, the depth prevails.
    """
    below = float(np.log(1 + stochastic.am_depth**2))
    total = float(np.log(1 + stochastic.excess_kurtosis / 3)) / 4
    total *= 1 + 3.5 * total / ENVELOPE_WAVES
    if total <= below:
        return below, 0.0
    burst = min((total - below) / (BURST_KURTOSIS - low_share), total / BURST_KURTOSIS)
    return max(below - low_share * burst, 0.0), burst


def scatter(
    kinds: tuple[Events, ...], tile: float, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Draw events over a tile: Poisson in number, uniform in place, log-normal in amplitude.

    Parameters
    ----------
    kinds : tuple of Events
        Kinds of events of a descriptor.
    tile : float
        Side of the square tile [m].
    rng : numpy.random.Generator
        Source of the random numbers.

    Returns
    -------
    place : (E, 2) array of float
        Places within the tile [m].
    peak : (E,) array of float
        Peak displacements, of either sign [m].
    kind : (E,) array of int
        Index of the kind of each event.
    """
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
