"""Map of skin displacement that is cut out of a height map and repeats without a seam.

**Seam.** A piece of a picture does not fit to itself at its edges, and the jump would be a click in
every stroke. Mirrored copies would fit, but turn a slanted weave into a herringbone. Instead, the
strip that follows the piece in the picture, a tenth of its side, is blended into the strip at its
beginning. The piece ends where the two strips are most alike, so that ribs continue as ribs. The
weights w and 1 − w are divided by √(w² + (1 − w)² + 2ρ w (1 − w)), which keeps the power of strips
whose correlation is ρ: a linear blend if they are equal, one of equal power if they have nothing in
common.

**Displacement.** Each wave of the piece moves the skin as `skin` assumes, as in the bands that
`relief_texture` makes of the picture. Waves outside the bands are left out. Two pixels in the
shortest wave that remains are enough (Nyquist).
"""

import math

import numpy as np
from scipy.fft import irfft2, rfft2

from tactile.arrays import Floats
from tactile.texture import skin
from tactile.texture.descriptor import LARGEST_MAP, SkinMap
from tactile.texture.map_pixels import packed
from tactile.texture.relief import EDGES, ReliefSpectrum

STRIP = 0.1
"""Width of the strip that is blended, as a share of the side of the picture."""
FULL = 0.98
"""Share of the largest number of pixels that is used, which leaves room for rounding up."""
LEAST = 1e-12
"""Least range of the levels, for a picture without waves in the bands [m]."""
TOP_LEVEL = 32767
"""Level of the largest displacement."""


def map_of(height: Floats, pixel: float, spectrum: ReliefSpectrum, highest: float) -> SkinMap:
    """Make a map of skin displacement from heights.

    Parameters
    ----------
    height : (R, C) array of float
        Height without mean and tilt, with row 0 at the lowest y [m].
    pixel : float
        Side of a pixel [m].
    spectrum : ReliefSpectrum
        Spectrum of these heights.
    highest : float
        Spatial frequency along x and along y at which the map ends [cycles/m].

    Returns
    -------
    SkinMap
        Map of as much from the middle of the picture as a file may hold.
    """
    tile = _blended(_blended(_middle(height, 2 * highest * pixel)).T).T
    rows, columns = (2 * math.floor(n * pixel * highest) + 2 for n in tile.shape)
    displacement = _followed(tile, pixel, spectrum, highest, (rows, columns))
    level = float(f"{max(np.abs(displacement).max(), LEAST) / (TOP_LEVEL - 1):.5g}")
    return SkinMap(
        width_mm=float(f"{tile.shape[1] * pixel * 1e3:.9g}"),
        height_mm=float(f"{tile.shape[0] * pixel * 1e3:.9g}"),
        columns=columns,
        rows=rows,
        level_um=level * 1e6,
        pixels=packed(np.rint(displacement / level).astype(np.int16)),
    )


def _middle(height: Floats, density: float) -> Floats:
    """Return the middle of a picture that a file may hold at so many pixels per pixel."""
    share = math.sqrt(FULL * LARGEST_MAP / height.size) / density / (1 - STRIP)
    cut = [max(0, n - math.floor(n * share)) // 2 for n in height.shape]
    return height[cut[0] : height.shape[0] - cut[0], cut[1] : height.shape[1] - cut[1]]


def _blended(height: Floats) -> Floats:
    """Return a piece whose last row continues in its first one."""
    width = round(STRIP * len(height))
    first = height[:width]
    cuts = range(len(height) - 2 * width, len(height) - width + 1)
    alike = [_correlation(first, height[cut : cut + width]) for cut in cuts]
    cut, likeness = cuts[int(np.argmax(alike))], max(0.0, *alike)
    weight = np.sin(np.pi / 2 * (np.arange(width)[:, None] + 0.5) / width) ** 2
    other = 1 - weight
    power = weight**2 + other**2 + 2 * likeness * weight * other
    strip = (weight * first + other * height[cut : cut + width]) / np.sqrt(power)
    return np.concatenate([strip, height[width:cut]])


def _correlation(one: Floats, other: Floats) -> float:
    """Return the correlation of two strips, 0 for one without relief."""
    scale = math.sqrt(float(np.sum(one**2) * np.sum(other**2)))
    return float(np.sum(one * other)) / scale if scale else 0.0


def _followed(
    tile: Floats, pixel: float, spectrum: ReliefSpectrum, highest: float, shape: tuple[int, int]
) -> Floats:
    """Return the displacement that follows a tile, at other numbers of pixels [m]."""
    rows, columns = tile.shape
    up = np.rint(np.fft.fftfreq(rows, 1 / rows)).astype(np.intp)
    across = np.arange(columns // 2 + 1)
    along_x, along_y = across / (columns * pixel), np.abs(up[:, None]) / (rows * pixel)
    number, finer = np.hypot(along_x, along_y), np.maximum(along_x, along_y)
    y, x = np.nonzero((number >= EDGES[0]) & (finer < min(highest, 0.5 / pixel)))
    gain = skin.skin_gain(spectrum.rms_slope(number[y, x]))
    waves = np.zeros((shape[0], shape[1] // 2 + 1), np.complex128)
    waves[up[y], x] = gain * rfft2(tile, norm="forward")[y, x]
    return np.asarray(irfft2(waves, shape, norm="forward"))
