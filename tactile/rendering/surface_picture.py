"""Picture of a surface seen from above, as the finger meets it.

It shows the same realization, at the same places, as `Renderer` plays, at the texture's reference
speed and force.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Bytes, Floats
from tactile.rendering.shear import EventField
from tactile.texture.descriptor import Events
from tactile.texture.surface import Partials, Surface, Texture, envelope_scale

FINER = 3
"""Number of places along each side of a pixel over which displacement is averaged, so that waves
shorter than two pixels fade instead of making false patterns."""
CLIPPED = 0.5
"""Share of the pixels that is clipped at either end, so that few high events do not take all
contrast (assumed) [%]."""


@dataclass(frozen=True)
class SurfaceSection:
    """Rectangle of a surface, divided into square pixels.

    Attributes
    ----------
    left, bottom : float
        Corner of the rectangle [m].
    pixel : float
        Side of a pixel [m].
    columns, rows : int
        Number of pixels along x and along y.
    """

    left: float
    bottom: float
    pixel: float
    columns: int
    rows: int


@dataclass(frozen=True)
class SurfacePicture:
    """Displacement over a section of a surface, in 256 steps.

    Attributes
    ----------
    lowest, highest : float
        Displacements that the values 0 and 255 stand for [m].
    pixels : (R, C) array of uint8
        Displacement of each pixel, the row with the largest y first.
    """

    lowest: float
    highest: float
    pixels: Bytes


def draw_surface(texture: Texture, section: SurfaceSection, *, seed: int = 0) -> SurfacePicture:
    """Draw a section of a surface.

    Each pixel is the mean over its area. The scale ends at the percentiles `CLIPPED` and 100 minus
    that, beyond which displacements are clipped.

    Parameters
    ----------
    texture : Texture
        Texture to draw.
    section : SurfaceSection
        What to draw of it.
    seed : int
        Seed of the realization.

    Returns
    -------
    SurfacePicture
        Picture of the section.
    """
    columns, rows = section.columns, section.rows
    x = section.left + _inside(columns) * section.pixel
    y = section.bottom + _inside(rows) * section.pixel
    fine = surface_heights(texture, x, y, seed=seed)
    heights = fine.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))[::-1]
    lowest, highest = np.percentile(heights, [CLIPPED, 100 - CLIPPED])
    steps = (heights - lowest) * (255 / max(highest - lowest, 1e-12))
    pixels = np.rint(np.clip(steps, 0, 255)).astype(np.uint8)
    return SurfacePicture(float(lowest), float(highest), pixels)


def _inside(pixels: int) -> Floats:
    """Return the places within pixels along one axis, in units of a pixel."""
    return np.asarray((np.arange(FINER * pixels) + 0.5) / FINER)


def surface_heights(texture: Texture, x: Floats, y: Floats, *, seed: int = 0) -> Floats:
    """Compute the displacement of a surface on a grid, at the texture's reference speed and force.

    Parameters
    ----------
    texture : Texture
        Texture whose surface is computed.
    x : (C,) array of float
        Coordinates of the columns [m].
    y : (R,) array of float
        Coordinates of the rows [m].
    seed : int
        Seed of the realization.

    Returns
    -------
    (R, C) array of float
        Displacement [m].
    """
    surface = texture.realize(seed)
    beside = surface.beside_fields
    bands, gratings = beside.split
    heights = _waves_on(bands, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1)
    for field in surface.fields:
        heights += field.at(places)
    if len(beside.envelope.amplitude):
        heights *= envelope_scale(beside.envelope) * np.exp(_waves_on(beside.envelope, x, y))
    heights += _waves_on(gratings, x, y)
    if len(surface.event_peak):
        heights += _events_at(surface, texture.descriptor.events, places)
    return heights


def _waves_on(partials: Partials, x: Floats, y: Floats) -> Floats:
    """Return Σ a cos(k·p + φ) [m] on a grid as y by x, as a product of two matrices."""
    kx, ky = partials.wave_vector.T
    along_x = np.exp(1j * np.outer(x, kx))
    along_y = np.exp(1j * np.outer(y, ky))
    phasor = partials.amplitude * np.exp(1j * partials.phase)
    return np.asarray(((along_y * phasor) @ along_x.T).real)


def _events_at(surface: Surface, kinds: tuple[Events, ...], places: Floats) -> Floats:
    """Return the sparse events [m] at places (R, C, 2)."""
    shear = np.zeros((places.shape[0] * places.shape[1], 1), np.float32)
    paths = np.ascontiguousarray(places.reshape(-1, 2).T)
    EventField(surface, kinds, np.zeros((1, 2))).add_to(shear, paths)
    return shear[:, 0].reshape(places.shape[:2]).astype(np.float64)
