"""Height maps with closed forms for wavelength, direction, amplitude and spectrum.

Pictures are 384 pixels of 53.5 µm: 20.5 mm, five periods of the coarsest band.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

from tactile.arrays import Floats
from tactile.texture.picture import HeightMap
from tactile.texture.relief_texture import Relief, texture_of

Image = pytest.importorskip("PIL.Image")


COUNT, PIXEL, LEVEL = 384, 53.5e-6, 10e-9
X, Y = np.meshgrid(
    (np.arange(COUNT) - (COUNT - 1) / 2) * PIXEL, (np.arange(COUNT) - (COUNT - 1) / 2) * -PIXEL
)
"""Places of the pixels as seen: y up."""


def plane_wave(wavelength: float, degrees: float, amplitude: float, phase: float = 0.0) -> Floats:
    turn = math.radians(degrees)
    along = X * math.cos(turn) + Y * math.sin(turn)
    return np.asarray(amplitude * np.cos(2 * np.pi * along / wavelength + phase))


def field(seed: int, shape: Callable[[Floats, Floats], Floats], rms: float = 2e-6) -> Floats:
    """Return a Gaussian field whose amplitude spectrum is shape(wave number, direction).

    Cut from one of twice the size, so that it does not repeat.
    """
    count = 2 * COUNT
    y, x = np.meshgrid(-np.fft.fftfreq(count, PIXEL), np.fft.rfftfreq(count, PIXEL), indexing="ij")
    number = np.hypot(x, y)
    number[0, 0] = np.inf
    field = irfft2(white(seed) * shape(number, np.arctan2(y, x)), (count, count))
    return np.asarray(field[:COUNT, :COUNT] * (rms / field.std()))


@lru_cache
def white(seed: int) -> NDArray[np.complex128]:
    noise = np.random.default_rng(seed).standard_normal((2 * COUNT, 2 * COUNT))
    return np.asarray(rfft2(noise))


def isotropic(number: Floats, direction: Floats) -> Floats:
    return np.asarray((number**2 + 500.0**2) ** -0.75)


def along(degrees: float, spread: float) -> Callable[[Floats, Floats], Floats]:
    """Return a falling spectrum whose directions are normally distributed."""

    def shape(number: Floats, direction: Floats) -> Floats:
        off = (direction - math.radians(degrees) + np.pi / 2) % np.pi - np.pi / 2
        return np.asarray(number**-1.2 * np.exp(-0.25 * (off / math.radians(spread)) ** 2))

    return shape


def made(
    height: Floats, pixel: float = PIXEL, level: float = LEVEL, *, with_map: bool = False
) -> Relief:
    """Return the texture of heights, rounded to gray levels as a picture would."""
    relief = HeightMap(np.round(height / level) * level, pixel, level)
    return texture_of(
        relief, name="some-relief", category="test", picture="some.png", with_map=with_map
    )


def bands_of(result: Relief) -> Floats:
    assert result.descriptor.stochastic is not None
    return np.array(result.descriptor.stochastic.level_db)
