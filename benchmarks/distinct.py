"""Differences between the shipped textures, and what of them is felt on `reference-24`.

The textures are compared at gain 1 and 40 and 80 mm/s, and at 80 mm/s with the gain of each that
the display allows.
"""

from collections.abc import Iterator

import numpy as np

from tactile.bench.figures import Figure, at_least
from tactile.display.display import load_display
from tactile.playback.gain_search import largest_gain
from tactile.rendering.contact import Trajectory
from tactile.strength.differences import Impression, impression, most_distinct
from tactile.strength.strength import SAMPLE_RATE, SteadyStroke
from tactile.texture.descriptor import textures
from tactile.texture.surface import load_texture

DURATION = 1.5
"""Duration of the stroke whose limits set the gain [s]."""
DISTINCT, LOUD, MEISSNER, LOWEST = 22, 20, 27, 6.0
"""Least numbers of textures that are distinct at gain 1, that are so at the largest gain, and that
reach Meissner channels; and least level of a texture [dB SL]."""


def measure_distinct() -> Iterator[Figure]:
    """Measure how many textures are mutually distinct, and how strongly they are felt."""
    display = load_display("reference-24")
    library = {name: load_texture(name) for name in textures()}
    for speed, goal in ((0.04, None), (0.08, DISTINCT)):
        stroke = SteadyStroke(speed=speed)
        felt = {name: impression(display, t, stroke) for name, t in library.items()}
        at = f"{speed * 1e3:g} mm/s, gain 1"
        yield at_least(f"distinct, textures, {at}", len(most_distinct(felt)), "", goal)
        reached = _meissner(felt)
        yield at_least(f"distinct, reach Meissner, {at}", reached, "", goal and MEISSNER)
    path = Trajectory.line(speed=0.08, duration=DURATION, normal_force=0.5)
    gains = {
        name: largest_gain(display, t, path, sample_rate=SAMPLE_RATE).value
        for name, t in library.items()
    }
    felt = {name: impression(display, t, gain=gains[name]) for name, t in library.items()}
    lowest = float(np.min([max(f.pacini, f.meissner) for f in felt.values()]))
    at = "80 mm/s, largest gain"
    yield at_least(f"distinct, textures, {at}", len(most_distinct(felt)), "", LOUD)
    yield at_least(f"distinct, reach Meissner, {at}", _meissner(felt), "", MEISSNER)
    yield at_least(f"distinct, lowest level, {at}", lowest, "dB SL", LOWEST)


def _meissner(felt: dict[str, Impression]) -> int:
    """Return the number of textures above the threshold of NP I."""
    return sum(f.meissner > 0 for f in felt.values())
