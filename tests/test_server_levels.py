"""Levels of textures on a server: the largest within the limits, or those of the file."""

from pathlib import Path

import numpy as np
import pytest
from strength_rig import few, ribs

from tactile.display.display import Display
from tactile.playback.commands import DeviceOpened
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.renderer import Renderer
from tactile.server.preparing import PreparationRequest, prepare
from tactile.strength.strength import (
    USUAL_SPEEDS,
    SteadyStroke,
    automatic_gain,
    gain_at_usual_speeds,
)
from tactile.texture.surface import load_texture

RATE = 8000.0


def prepared(
    display: Display, name: str, *, largest: bool, follows: bool = False
) -> tuple[RealizedLayer, float]:
    """Return a texture as the server prepares it, and the gain in its description."""
    request = PreparationRequest(1, display, name, 3, DeviceOpened(follows=follows), largest)
    layer, description = prepare(request)
    assert isinstance(layer, RealizedLayer)
    return layer, description.gain


def stroked(display: Display, layer: RealizedLayer, speed: float, seconds: float) -> Renderer:
    """Return the renderer that a stroke was rendered with."""
    renderer = Renderer(display, None, sample_rate=RATE)
    renderer.play([(layer, 1.0)])
    count = round(seconds * RATE)
    place = np.outer(np.arange(count) * speed / RATE, [1.0, 0.0])
    renderer.block(place, np.full(count, 0.5))
    return renderer


@pytest.mark.parametrize("name", ["leather-suede", "wood-oak", "glass-ribbed"])
def test_the_largest_level_leaves_the_limiter_nothing_to_do(pair: Display, name: str) -> None:
    """Strokes at all speeds stay within the limits; with 0.4 of the voltage they do not."""
    layer, gain = prepared(pair, name, largest=True)
    texture = load_texture(name)
    strokes = [SteadyStroke(speed=speed) for speed in USUAL_SPEEDS]
    assert gain == min(automatic_gain(pair, texture, stroke).value for stroke in strokes) > 1
    for speed in USUAL_SPEEDS:
        assert stroked(pair, layer, speed, 5.0).limiter.limited_samples == 0
    louder = few(pair, *range(len(pair.contactors)), volts=0.4 * pair.limits.voltage)
    limited = [stroked(louder, layer, speed, 5.0).limiter.limited_samples for speed in USUAL_SPEEDS]
    assert max(limited) > 0


def test_the_levels_of_the_file_have_gain_1(pair: Display) -> None:
    """A layer for the levels of the file commands the shear of the texture as it is."""
    layer, gain = prepared(pair, "wood-oak", largest=False)
    assert gain == 1.0
    amplified_layer, larger = prepared(pair, "wood-oak", largest=True)
    place = np.outer(np.arange(800) * 0.08 / RATE, [1.0, 0.0])
    shears = []
    for played in (layer, amplified_layer, RealizedLayer(pair, load_texture("wood-oak"), seed=3)):
        renderer = Renderer(pair, None, sample_rate=RATE)
        renderer.play([(played, 1.0)])
        shears.append(renderer.block(place, np.full(800, 0.5), shear=True)[1])
    np.testing.assert_array_equal(shears[0], shears[2])
    vibration = [np.diff(shear[300:], axis=0) for shear in shears]  # without the drag
    np.testing.assert_allclose(
        vibration[1], larger * vibration[0], atol=1e-3 * np.ptp(vibration[1])
    )


def test_a_finger_that_is_followed_has_the_levels_of_the_file(pair: Display) -> None:
    """The largest gain is that of the display's own finger, and a stiffer one allows less."""
    assert prepared(pair, "wood-oak", largest=True, follows=True)[1] == 1.0


def test_a_texture_with_nothing_to_play_has_gain_1(tmp_path: Path, pair: Display) -> None:
    """Ribs above the band at all speeds have no largest gain, others that of the slowest."""
    assert gain_at_usual_speeds(pair, ribs(tmp_path, 4000.0, 2.0)) == 1.0
    slow = ribs(tmp_path, 1300.0, 2.0)
    gain = automatic_gain(pair, slow, SteadyStroke(speed=USUAL_SPEEDS[0])).value
    assert gain_at_usual_speeds(pair, slow) == gain > 1
