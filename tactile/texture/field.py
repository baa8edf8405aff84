"""Fields: surfaces of any number of waves, which are looked up in tiles.

A sum of some hundred plane waves is a spectrum of lines, by which a classifier knows it. A field
is a sum of so many waves that its spectrum along a stroke is that of noise, and its cost does not
depend on their number: their sum is computed beforehand, by a fast Fourier transform, on the pixels
of a tile that repeats over the plane.

**Tile.** The tile of a height map is a rectangle, which repeats along x and y. That of noise is a
single row of n pixels: the pixel in column x and row y of the plane is entry (x + g y) mod n. That
is a rank-1 lattice with the generator g (Korobov 1959; Kämmerer, Potts & Volkmer, *Journal of
Complexity* 31, 2015). The waves of the tile have the wave vectors (m, g m mod n)/n cycles per
pixel, one for each m, and one transform of length n gives all pixels. g is chosen so that these lie
on a nearly hexagonal grid. A stroke along either axis meets all n pixels, ten meters and more,
before anything repeats; over a square tile of the same area it would repeat every few centimeters.
The shortest way after which this tile repeats is 1.07 sides of such a square, in three directions
that are at least 6° away from both axes and both diagonals.

**Reading.** Between pixels runs the tensor product of uniform quadratic B-splines. The spectrum is
divided by their response sinc³ beforehand, so that each wave has its amplitude exactly. What
remains are images of a wave at a multiple of the pixel frequency from it, (k/(1 − k))³ of its
amplitude for k cycles per pixel, at most −38 dB at the highest wave number, where a cycle has
`PER_CYCLE` pixels. Cubic ones would do the same with four pixels in a cycle, but they weigh 16
pixels at each place instead of 9, in twice the time.

**Levels.** A finger that moves at v turns the wave number κ into the frequency κ v, and what is
above some frequency is not played. Graphics hardware prefilters textures for that (Williams,
"Pyramidal parametrics", SIGGRAPH 1983). Level j holds the waves below κ₀ 10^(−j/10), each level a
third octave less than the one before, in pixels that double in size with every octave. At most
speeds one level is read, the finest one that ends below the band of the reader. Over the first
quarter of a third octave of speed after a level has reached it, it is mixed with the next one. In a
rectangle, the components of a wave number along x and along y end there, as those of a picture do,
and count at the speed |vx| + |vy|.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, irfft2, rfft2

from tactile.arrays import Complex, Floats, Ints, Singles
from tactile.machine_code import compiled

PIXELS = 1 << 19
"""Number n of pixels of a tile, a power of two."""
GENERATOR = 188_119
"""Generator g of the lattice: of 60 000 random odd numbers the one with the longest way before a
tile repeats, 776 pixels, at 37°, 97° and 157° to the x axis."""
PER_CYCLE = 16 / 3
"""Smallest number of pixels in a cycle."""
THIRD = 10**-0.1
"""Ratio of the highest wave number of a level to that of the level before it."""
FADE = 0.25
"""Part of a third octave of speed over which a level gives way to the next one (assumed): 5 ms of a
stroke at 80 mm/s that accelerates by 1 m/s². Two levels take twice the time of one."""
BORDER = 2
"""Number of pixels that follow the last one of a level once more, so that a row of three pixels
needs no wrapping."""


@dataclass(frozen=True)
class Field:
    """Displacement as a function of place, in levels that end at lower and lower wave numbers.

    Attributes
    ----------
    tiles : (T,) array of float32
        Pixels of all levels, one after the other [m].
    first : (J,) array of int
        Index of the first pixel of each level.
    shape : (J, 2) array of int
        Columns and rows of each level, powers of two; one row for a lattice.
    per_meter : (J, 2) array of float
        Number of pixels in a meter along x and y.
    highest : float
        Highest spatial frequency of the finest level, κ₀/2π, of a rectangle along x and along y
        [cycles/m].
    """

    tiles: Singles
    first: Ints
    shape: Ints
    per_meter: Floats
    highest: float

    def at(self, place: Floats) -> Floats:
        """Compute the displacement at given places, of all waves.

        Parameters
        ----------
        place : (..., 2) array of float
            Places [m].

        Returns
        -------
        (...) array of float
            Displacement [m].
        """
        places = place.reshape(-1, 2).T
        result = np.zeros((places.shape[1], 1), np.float32)
        slow = np.zeros(places.shape[1])
        FieldReader(self, np.zeros((1, 2)), band=1.0).add_to(result, places, slow)
        return result[:, 0].astype(np.float64).reshape(place.shape[:-1])


class FieldReader:
    """Reads a field under each contactor of a display.

    Parameters
    ----------
    field : Field
        Field to read.
    contactors : (N, 2) array of float
        Places of the contactors [m].
    band : float
        Frequency above which nothing is to be played [Hz]. A level whose highest wave is above it
        at the speed of the finger fades out over the following quarter (`FADE`) of a third octave
        of speed.
    gain : float
        Factor on the displacement of the field.
    """

    def __init__(self, field: Field, contactors: Floats, *, band: float, gain: float = 1.0) -> None:
        self._field = field
        self._scale, self._gain = (field.highest / band) ** 2, gain
        pixel = field.per_meter[:, :, None] * contactors.T
        whole = np.floor(pixel)
        self._part = np.ascontiguousarray(pixel - whole, np.float32)
        shift = np.where(field.shape[:, 1:] == 1, GENERATOR, 0)
        whole[:, 0] += shift * whole[:, 1]
        self._offset = np.ascontiguousarray(whole, np.int64)

    def add_to(self, shear: Singles, place: Floats, squares: Floats) -> None:
        """Add the displacement under each contactor along a stroke.

        Parameters
        ----------
        shear : (S, N) array of float32
            Displacement to add to [m].
        place : (2 or more, S) array of float
            Rows x and y of the finger's places [m].
        squares : (S,) array of float
            Squared speed of the finger at each sample, for a rectangle (|vx| + |vy|)² [m²/s²].
        """
        f = self._field
        add_levels(
            shear, place, self._scale * squares, self._offset, self._part,
            f.tiles, f.first, f.shape, f.per_meter, self._gain,
        )  # fmt: skip


def played_share(ratio: Floats, highest: float) -> Floats:
    """Compute the factor with which the levels of a field play its waves.

    Parameters
    ----------
    ratio : (...) array of float
        Highest frequency of each wave, κ v/2π, relative to the band.
    highest : float
        That of the highest wave of the field.

    Returns
    -------
    (...) array of float
        Factor on the displacement: 1 up to the end of the coarser of the two levels that are mixed,
        less between their ends, 0 above.
    """
    above = 10 * math.log10(max(highest, 1.0)) % 1
    mixed, end = min(above / FADE, 1.0), 10 ** (above / 10)
    return np.where(ratio < end * THIRD, 1.0, np.where(ratio < end, 1 - mixed, 0.0))


def lattice(pitch: float) -> Floats:
    """Compute the spatial frequencies of the waves of a tile.

    Parameters
    ----------
    pitch : float
        Side of a pixel [m].

    Returns
    -------
    (2, n/2 + 1) array of float
        Rows x and y of the frequencies [cycles/m]: one wave of each pair k and −k.
    """
    index = np.arange(PIXELS // 2 + 1)
    turns = np.stack([index, index * GENERATOR % PIXELS]) / PIXELS
    return np.asarray((turns - np.rint(turns)) / pitch)


def field_of(waves: Complex, highest: float, lowest: float) -> Field:
    """Compute the tiles of a sum of waves.

    Parameters
    ----------
    waves : (n/2 + 1,) array of complex
        Complex amplitude a exp(jφ) of each wave of `lattice`, at the pitch of `pitch_of` [m].
    highest, lowest : float
        Highest and lowest spatial frequency of any wave with an amplitude [cycles/m].

    Returns
    -------
    Field
        Field Σ a cos(k·p + φ).
    """
    pitch = pitch_of(highest)
    cycles = lattice(pitch)
    size = np.hypot(*cycles)
    tiles = []
    for j in range(_level_count(highest, lowest)):
        members = np.flatnonzero(size < highest * THIRD**j) if j else np.arange(len(waves))
        coarser = 1 << int(j * -math.log2(THIRD) + 1e-9)
        part = waves[members] / _spline_response(cycles[:, members] * pitch * coarser)
        tiles.append(_tile(part, members, PIXELS // coarser)[None])
    columns = np.array([[tile.shape[1]] * 2 for tile in tiles])
    return _joined(tiles, columns / (PIXELS * pitch), highest)


def field_of_rectangle(displacement: Floats, side: Floats, highest: float) -> Field:
    """Compute the tiles of displacement that repeats along x and y.

    Parameters
    ----------
    displacement : (R, C) array of float
        Displacement at the pixels of a rectangle, y by x, the first one at the origin [m].
    side : (2,) array of float
        Sides of the rectangle along x and y, C and R pixels long [m].
    highest : float
        Highest spatial frequency along x and along y, that two pixels resolve [cycles/m].

    Returns
    -------
    Field
        Field of all waves of the rectangle whose frequencies along x and y are below the highest.
    """
    rows, columns = displacement.shape
    spectrum = rfft2(displacement, norm="forward")
    across, up = np.arange(columns // 2 + 1), np.arange(rows)
    up[rows - rows // 2 :] -= rows
    finer, tiles = np.maximum(across / side[0], np.abs(up[:, None]) / side[1]), []
    for j in range(_level_count(highest, float(1 / side.max()))):
        end = highest * THIRD**j
        shape = [1 << max(math.ceil(math.log2(PER_CYCLE * end * s)), 2) for s in side]
        y, x = np.nonzero(finer < end)
        turns = np.stack([across[x] / shape[0], up[y] / shape[1]])
        waves = np.zeros((shape[1], shape[0] // 2 + 1), np.complex128)
        waves[up[y], x] = spectrum[y, x] / _spline_response(turns)
        tiles.append(irfft2(waves, shape[::-1], norm="forward"))
    per_meter = np.array([tile.shape[::-1] for tile in tiles]) / side
    return _joined(tiles, per_meter, highest)


def _level_count(highest: float, lowest: float) -> int:
    """Return the number of levels, of which the last one ends at the lowest wave [cycles/m]."""
    return math.ceil(math.log(highest / lowest) / -math.log(THIRD)) + 1


def _joined(tiles: list[Floats], per_meter: Floats, highest: float) -> Field:
    """Return the field with given pixels of each level (R, C) and numbers per meter (J, 2)."""
    shape = np.array([tile.shape[::-1] for tile in tiles])
    lengths = (shape[:, 0] + BORDER) * shape[:, 1]
    rows = [np.concatenate([tile, tile[:, :BORDER]], axis=1).ravel() for tile in tiles]
    pixels = np.concatenate(rows).astype(np.float32)
    return Field(pixels, np.cumsum(lengths) - lengths, shape, per_meter, highest)


def pitch_of(highest: float) -> float:
    """Compute the side of a pixel of the finest level.

    Parameters
    ----------
    highest : float
        Highest spatial frequency [cycles/m].

    Returns
    -------
    float
        Side of a pixel, `PER_CYCLE` of which make a cycle [m].
    """
    return 1 / (PER_CYCLE * highest)


def _spline_response(turns: Floats) -> Floats:
    """Return the response of the quadratic B-splines at frequencies (2, M) [cycles/pixel]."""
    return np.asarray(np.prod(np.sinc(turns), axis=0) ** 3)


def _tile(waves: Complex, members: Ints, count: int) -> Floats:
    """Return the pixels of some waves in a tile of fewer pixels.

    Every second pixel in both directions is every second entry of the array, so that the waves of
    a coarser tile are those of the finer one, with the index modulo the number of its pixels.
    """
    index = members % count
    mirrored = index > count // 2
    spectrum = np.zeros(count // 2 + 1, np.complex64)
    np.add.at(
        spectrum,
        np.where(mirrored, count - index, index),
        np.where(mirrored, waves.conj(), waves) * (count / 2),
    )
    return np.asarray(irfft(spectrum, count))


@compiled()
def _weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    """Return the weights of three pixels ``t``, 0 … 1, past half a pixel before the middle one."""
    s, half = np.float32(1) - t, np.float32(0.5)
    first, last = half * s * s, half * t * t
    return first, np.float32(1) - first - last, last


@compiled()
def _row(tiles: Singles, k: np.uint64, w: tuple[np.float32, np.float32, np.float32]) -> np.float32:
    """Return the weighted sum of three pixels from index ``k`` on.

    Indices are unsigned, so that numba need not check whether they count from the end.
    """
    right = w[1] * tiles[k + np.uint64(1)] + w[2] * tiles[k + np.uint64(2)]
    return w[0] * tiles[k] + right  # type: ignore[no-any-return]


@compiled()
def _start(first: np.uint64, k: int, mask: int, d: int, rows: int | None) -> np.uint64:
    """Return the index of the pixel in column ``k`` and row ``d`` of the plane.

    ``rows`` is None for a lattice: numba then compiles a function without the other case, which
    would make noise take 20 % longer.
    """
    if rows is None:
        return first + np.uint64(k & mask)
    return first + np.uint64((k & mask) + (d & (rows - 1)) * (mask + 1 + BORDER))


@compiled()
def _add_level(
    row: Singles, x: float, y: float, offset: Ints, part: Singles, tiles: Singles,
    first: np.uint64, mask: int, rows: int | None, share: np.float32,
) -> None:  # fmt: skip
    """Add the displacement of one level for a finger at a place [pixels] to one sample (N,)."""
    shift = GENERATOR if rows is None else 0
    x, y = x + 0.5, y + 0.5
    column, down = np.floor(x), np.floor(y)
    lowest = np.int64(down) - 1
    base = np.int64(column) - 1 + shift * lowest
    across, along = np.float32(x - column), np.float32(y - down)
    for i in range(len(row)):
        k, d = base + offset[0, i], lowest + offset[1, i]
        u, v = across + part[0, i], along + part[1, i]
        if u >= 1:
            k, u = k + 1, u - np.float32(1)
        if v >= 1:
            k, d, v = k + shift, d + 1, v - np.float32(1)
        w, b = _weights(u), _weights(v)
        total = b[0] * _row(tiles, _start(first, k, mask, d, rows), w)
        total += b[1] * _row(tiles, _start(first, k + shift, mask, d + 1, rows), w)
        total += b[2] * _row(tiles, _start(first, k + 2 * shift, mask, d + 2, rows), w)
        row[i] += share * total


@compiled(
    "void(float32[:, ::1], float64[:, :], float64[:], int64[:, :, ::1], float32[:, :, ::1], "
    "float32[::1], int64[::1], int64[:, ::1], float64[:, ::1], float64)"
)
def add_levels(
    shear: Singles, place: Floats, ratio: Floats, offset: Ints, part: Singles, tiles: Singles,
    first: Ints, shape: Ints, per_meter: Floats, gain: float,
) -> None:  # fmt: skip
    """Add the displacement of the levels of a field, as `FieldReader.add_to` describes.

    ``ratio`` (S,) is the square of the highest frequency of the field, relative to the band.
    ``offset`` (J, 2, N) and ``part`` (J, 2, N) are whole and remaining pixels from the finger to
    each contactor; columns include the shift of the rows.
    """
    for n in range(shear.shape[0]):
        level = 5 * np.log10(max(ratio[n], 1.0))
        lower = min(int(level), len(first))
        mixed = min((level - lower) / FADE, 1.0)
        for j in range(lower, min(lower + 2, len(first))):
            share = np.float32(gain * (1 - mixed if j == lower else mixed))
            if share != 0:
                x, y = place[0, n] * per_meter[j, 0], place[1, n] * per_meter[j, 1]
                start, mask, rows = np.uint64(first[j]), shape[j, 0] - 1, shape[j, 1]
                if rows == 1:
                    _add_level(shear[n], x, y, offset[j], part[j], tiles, start, mask, None, share)
                else:
                    _add_level(shear[n], x, y, offset[j], part[j], tiles, start, mask, rows, share)
