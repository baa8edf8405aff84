"""Tests of pictures of a surface: their place, their pixels, and that they are what is played."""

import numpy as np
import pytest

from tactile.display.display import Display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.rendering.surface_picture import (
    FINER,
    SurfaceSection,
    draw_surface,
    surface_heights,
)
from tactile.texture.surface import Texture, load_texture, without_friction

RIBBED = "plastic-acrylic-ribbed"
"""Texture whose gratings have crests along y."""


def heights_of(texture: Texture, section: SurfaceSection, seed: int = 0) -> np.ndarray:
    """Return what a picture shows [m], rows from the largest y."""
    picture = draw_surface(texture, section, seed=seed)
    return picture.lowest + picture.pixels / 255 * (picture.highest - picture.lowest)


def test_a_pixel_is_the_mean_over_its_area() -> None:
    texture = load_texture("wood-oak")
    section = SurfaceSection(0.013, -0.02, 0.3e-3, 40, 25)
    finest = 15
    at = [np.arange(finest * n) + 0.5 for n in (section.columns, section.rows)]
    x = section.left + at[0] * section.pixel / finest
    y = section.bottom + at[1] * section.pixel / finest
    fine = surface_heights(texture, x, y).reshape(25, finest, 40, finest)
    mean = fine.mean(axis=(1, 3))[::-1]
    picture = draw_surface(texture, section)
    step = (picture.highest - picture.lowest) / 255
    clipped = np.clip(mean, picture.lowest, picture.highest)
    # the mean of 3 × 3 places differs from that of 15 × 15 by the shortest waves
    error = np.abs(heights_of(texture, section) - clipped)
    assert np.sqrt(np.mean(error**2)) < step + 0.05 * mean.std()


def test_few_pixels_are_clipped() -> None:
    texture, section = load_texture("wood-oak"), SurfaceSection(0.0, 0.0, 0.25e-3, 80, 80)
    pixels = draw_surface(texture, section).pixels
    for end in (0, 255):
        assert 0.003 < np.mean(pixels == end) < 0.012


def test_a_flat_surface_is_drawn_without_contrast() -> None:
    texture = load_texture("glass-float")
    section = SurfaceSection(0.0, 0.0, 1e-9, 4, 4)  # a point
    picture = draw_surface(texture, section)
    assert picture.highest - picture.lowest < 1e-9
    assert picture.pixels.shape == (4, 4)


@pytest.mark.parametrize("name", ["wood-oak", RIBBED, "wood-pine-sanded"])
def test_the_picture_is_what_the_finger_meets(name: str, display: Display) -> None:
    """Stroke along a row of the picture, and compare it with the shear that is commanded."""
    texture = load_texture(name)
    reference = texture.descriptor.reference
    speed, force = reference.speed_mm_s * 1e-3, reference.normal_force_n
    stroke = Trajectory.line(speed=speed, duration=0.03 / speed, normal_force=force)
    shear = render(display, without_friction(texture), stroke).shear
    contactor, (x0, y0) = 3, display.contactors[3]
    x = x0 + speed * np.arange(len(shear)) / 8000.0
    heights = surface_heights(texture, x, np.array([y0]))[0]
    inner = slice(len(x) // 4, -len(x) // 8)  # the shear fades in and out
    commanded, drawn = shear[inner, contactor], heights[inner]
    # commanded shear ends at 1 kHz, and lacks what is below 10 Hz
    assert np.corrcoef(commanded, drawn)[0, 1] > 0.98
    assert np.std(commanded) == pytest.approx(np.std(drawn), rel=0.1)


def test_waves_shorter_than_a_pixel_make_no_false_pattern() -> None:
    """Ribs of 1.69 mm, sampled at pixels of 1.6 mm, would look like some of 30 mm."""
    texture = load_texture(RIBBED)
    coarse = heights_of(texture, SurfaceSection(0.0, 0.0, 1.6e-3, 60, 20))
    x = 1.6e-3 * (np.arange(60) + 0.5)
    sampled = surface_heights(texture, np.asarray(x), np.asarray(x[:20]))
    assert coarse.std() < 0.3 * sampled.std()
    assert FINER % 2 == 1  # the center of a pixel is among the places
