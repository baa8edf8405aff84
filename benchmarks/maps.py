"""Maps: height maps as they are played, compared with the pictures and with bands alone."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec.structs import replace as changed
from scipy.fft import irfft2, rfft2

from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_most
from tactile.display.display import load_display
from tactile.files import SourceFile
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer, render
from tactile.texture import skin, surface
from tactile.texture.descriptor import Descriptor, Laws
from tactile.texture.descriptor_file import as_toml
from tactile.texture.picture import HeightMap
from tactile.texture.relief import EDGES, leveled
from tactile.texture.relief_texture import texture_of
from tactile.texture.surface import Surface, Texture, envelope_scale

COUNT, PIXEL, LEVEL = 400, 50e-6, 5e-9
"""Pixels along a side of a picture, their side and the height of a gray level [m]."""
BANDS = EDGES[:17]
"""Edges of the bands that these pixels resolve [cycles/m]."""
STROKES = 400
"""Number of strokes over a surface."""


def noise(seed: int, spread_deg: float | None = None) -> Floats:
    """Return Gaussian relief (COUNT, COUNT) of 1 µm rms, cut from a larger one [m].

    Its amplitudes fall with the wave number to the power of 1.5 above 0.5 cycles/mm, and there is
    nothing coarser than the bands, which would leak into periodograms. A spread makes it a grain.
    """
    count = 2 * COUNT
    y, x = np.meshgrid(np.fft.fftfreq(count, PIXEL), np.fft.rfftfreq(count, PIXEL), indexing="ij")
    number = np.hypot(x, y)
    shape = (number**2 + 500.0**2) ** -0.75 * (number > EDGES[0])
    if spread_deg is not None:
        turn = np.arctan2(y, x)
        turn = (turn + np.pi / 2) % np.pi - np.pi / 2
        shape *= np.exp(-0.25 * (turn / np.radians(spread_deg)) ** 2)
    white = rfft2(np.random.default_rng(seed).standard_normal((count, count)))
    height = irfft2(white * shape, (count, count))[:COUNT, :COUNT]
    return np.asarray(height / height.std() * 1e-6)


def ribs() -> Floats:
    """Return a grating of 1.3 mm at 20° [m]."""
    x, y = np.meshgrid(*[np.arange(COUNT) * PIXEL] * 2)
    along = x * np.cos(np.radians(20)) + y * np.sin(np.radians(20))
    return np.asarray(3e-6 * np.cos(2 * np.pi * along / 1.3e-3))


def pores() -> Floats:
    """Return pits of 10 µm, one for each two square millimeters, 0.15 mm wide [m]."""
    rng = np.random.default_rng(7)
    count = round((COUNT * PIXEL * 1e3) ** 2 / 2)
    number = np.hypot(np.fft.fftfreq(COUNT, PIXEL)[:, None], np.fft.rfftfreq(COUNT, PIXEL))
    pits = np.zeros((COUNT, COUNT))
    np.add.at(pits, tuple(rng.integers(0, COUNT, (2, count))), 1.0)
    bump = np.exp(-((np.pi * number * 0.15e-3 / 1.665) ** 2)) * (number > EDGES[0])
    pits = irfft2(rfft2(pits) * bump, pits.shape)
    return np.asarray(-10e-6 * pits / pits.max())


PICTURES = {
    "noise": noise(1),
    "grain": noise(2, 12),
    "ribs": noise(3) + ribs(),
    "pores": 0.2 * noise(4) + pores(),
}
"""Heights of each picture, by name [m]."""


def relief_of(height: Floats) -> Descriptor:
    """Return the descriptor of a picture, with a map and without laws."""
    relief = HeightMap(np.round(height / LEVEL)[::-1] * LEVEL, PIXEL, LEVEL)
    made = texture_of(relief, name="a", category="test", picture="", with_map=True)
    return changed(made.descriptor, laws=Laws())


def stored(descriptor: Descriptor) -> Texture:
    """Return the texture that is read from the text of a descriptor."""
    return surface.texture_of(SourceFile("a.toml", as_toml(descriptor)), Path())


def met(realized: Surface) -> Floats:
    """Return strokes (STROKES, COUNT) along x and along y, from random places [m]."""
    rng = np.random.default_rng(0)
    along = np.zeros((STROKES, COUNT, 2))
    along[::2, :, 0] = along[1::2, :, 1] = np.arange(COUNT) * PIXEL
    place = along + rng.uniform(0, 0.2, (STROKES, 1, 2))
    beside = realized.beside_fields
    swell = envelope_scale(beside.envelope) * np.exp(beside.envelope.at(place))
    return np.asarray(realized.random_part(place) * swell + beside.split[1].at(place))


def levels(strokes: Floats) -> Floats:
    """Return the band levels (2, 16) of strokes along x and along y, by their periodograms [dB]."""
    number, power = np.fft.rfftfreq(COUNT, PIXEL), np.abs(np.fft.rfft(strokes * np.hanning(COUNT)))
    fine = np.array([np.linspace(a, b, 20) for a, b in pairwise(BANDS)])
    mean = [np.mean(power[k::2] ** 2, axis=0) for k in range(2)]
    return np.array([10 * np.log10(np.interp(fine, number, p).mean(axis=1)) for p in mean])


def kurtosis(values: Floats) -> float:
    """Return the excess kurtosis of the waves that are finer than 1 cycle/mm."""
    fine = np.fft.rfft(values - values.mean(axis=1, keepdims=True))
    fine[:, np.fft.rfftfreq(values.shape[1], PIXEL) < 1e3] = 0
    kept = np.fft.irfft(fine)
    return float(np.mean(kept**4) / np.mean(kept**2) ** 2 - 3)


def measure_pictures() -> Iterator[Figure]:
    """Compare strokes over maps, and over bands and gratings alone, with rows and columns."""
    for name, height in PICTURES.items():
        own, descriptor = leveled(height)[0] * skin.GAIN, relief_of(height)
        lines = np.stack([own, own.T], axis=1).reshape(-1, COUNT)
        cases = {"map": descriptor, "bands": changed(descriptor, map=None)}
        for case, played in cases.items():
            strokes = met(stored(played).realize())
            error = levels(strokes) - levels(lines)
            error = (
                error[:1] if name == "grain" else error
            )  # across the grain, along which is little
            limits = (1.0, 3.0) if case == "map" else (None, None)
            rms, worst = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
            yield at_most(f"map.{name}.{case}.rms", rms, "dB", limits[0])
            yield at_most(f"map.{name}.{case}.worst", worst, "dB", limits[1])
            if name == "pores":
                yield Figure(f"map.pores.{case}.kurtosis", kurtosis(strokes), "")
        if name == "pores":
            yield Figure("map.pores.picture.kurtosis", kurtosis(lines), "")


def seam(descriptor: Descriptor) -> float:
    """Return the largest second difference within 2 pixels of a seam, relative to all others."""
    assert descriptor.map is not None
    values, ratios = descriptor.map.displacement, []
    for rows in (values, values.T):
        twice = np.abs(np.diff(np.concatenate([rows, rows[:, :40]], axis=1), 2, axis=1))
        end = rows.shape[1] - 2
        ratios.append(twice[:, end - 1 : end + 3].max() / twice[:, 40 : end - 40].max())
    return float(max(ratios))


def block_error(texture: Texture, size: int) -> float:
    """Return the error of the shear of a path in blocks of a size against blocks of 64 [dB]."""
    path, shear = np.outer(0.02 * np.sin(8.2 / RATE * np.arange(8000)), [1.0, 0.4]), []
    for step in (64, size):
        renderer = Renderer(load_display("reference-24"), texture)
        parts = [path[k : k + step] for k in range(0, len(path), step)]
        blocks = [renderer.block(p, np.full(len(p), 0.5), shear=True)[1] for p in parts]
        shear.append(np.concatenate(blocks))
    return float(
        10 * np.log10(np.mean((shear[1] - shear[0]) ** 2) / np.mean(shear[0] ** 2) + 1e-30)
    )


def measure_maps() -> Iterator[Figure]:
    """Measure maps against their pictures, over the array, on the way back and at their seams."""
    yield from measure_pictures()
    descriptor = relief_of(PICTURES["ribs"])
    texture, display = stored(descriptor), load_display("reference-24")
    there = Trajectory.line(speed=0.08, angle=0.4, duration=0.5)
    back = Trajectory(there.time, there.position[::-1], 0.5)
    one, other = (render(display, texture, path) for path in (there, back))
    rms = float(one.shear.std())
    wanted = texture.realize().random_part(one.position[:, None] + display.contactors)
    yield at_most("map.array", float(np.std(one.shear - wanted)) / rms, "of rms", 1e-3)
    way_back = float(np.std(one.shear[1:] - other.shear[:0:-1])) / rms
    yield at_most("map.out_and_back", way_back, "of rms", 1e-6)
    for size in (1, 7, 160):
        yield at_most(f"map.blocks_of_{size}_against_64", block_error(texture, size), "dB", -60)
    for name, height in PICTURES.items():
        yield at_most(f"map.{name}.seam", seam(relief_of(height)), "of others", 1.2)
