"""Differences between the shipped textures, and what of them is felt on `reference-24`.

The textures are compared at gain 1: at 40 and 80 mm/s along x, at 80 mm/s also in other directions,
with the differences that a masked finger notices, and with thresholds that are as much higher and
lower as they are uncertain; then with the gain of each that the display allows.
"""

import math
from collections.abc import Iterator

import numpy as np

from tactile.bench.figures import Figure, at_least
from tactile.display.display import Display, load_display
from tactile.playback.gain_search import largest_gain
from tactile.rendering.contact import Trajectory
from tactile.strength.differences import MASKED, Impression, impression, most_distinct
from tactile.strength.strength import SAMPLE_RATE, SteadyStroke
from tactile.texture.descriptor import textures
from tactile.texture.perception import THRESHOLD_SPREAD_DB
from tactile.texture.surface import Texture, load_texture

DURATION = 1.5
"""Duration of the stroke whose limits set the gain [s]."""
DISTINCT, MEISSNER, LOWEST = 20, 25, 6.0
"""Least numbers of textures that are to be distinct and to reach Meissner channels, which are half
of them, and least level of a texture [dB SL]."""


def measure_distinct() -> Iterator[Figure]:
    """Measure how many textures are mutually distinct, and how strongly they are felt."""
    display = load_display("reference-24")
    library = {name: load_texture(name) for name in textures()}
    slow, usual = SteadyStroke(speed=0.04), SteadyStroke(speed=0.08)
    yield from _counts("40 mm/s, gain 1", _felt(display, library, slow))
    felt = _felt(display, library, usual)
    yield from _counts("80 mm/s, gain 1", felt, DISTINCT, MEISSNER)
    yield _count("80 mm/s, gain 1, masked", len(most_distinct(felt, MASKED)))
    for degrees in (45, 90):
        turned = SteadyStroke(speed=0.08, angle=math.radians(degrees))
        yield from _counts(f"80 mm/s, gain 1, {degrees}°", _felt(display, library, turned))
    for raised in (THRESHOLD_SPREAD_DB, -THRESHOLD_SPREAD_DB):
        felt = _felt(display, library, usual, raised_db=raised)
        yield from _counts(f"80 mm/s, gain 1, thresholds {raised:+g} dB", felt)
    path = Trajectory.line(speed=0.08, duration=DURATION, normal_force=0.5)
    gains = {
        name: largest_gain(display, texture, path, sample_rate=SAMPLE_RATE).value
        for name, texture in library.items()
    }
    felt = {name: impression(display, t, usual, gain=gains[name]) for name, t in library.items()}
    yield from _counts("80 mm/s, largest gain", felt, DISTINCT, MEISSNER)
    lowest = float(np.min([max(f.pacini, f.meissner) for f in felt.values()]))
    yield at_least("distinct, lowest level, 80 mm/s, largest gain", lowest, "dB SL", LOWEST)


def _felt(
    display: Display, library: dict[str, Texture], stroke: SteadyStroke, raised_db: float = 0.0
) -> dict[str, Impression]:
    """Return the impression of each texture at gain 1."""
    return {
        name: impression(display, texture, stroke, raised_db=raised_db)
        for name, texture in library.items()
    }


def _counts(
    at: str, felt: dict[str, Impression], distinct: int | None = None, meissner: int | None = None
) -> Iterator[Figure]:
    """Yield the numbers of distinct textures and of those above the threshold of NP I."""
    yield _count(at, len(most_distinct(felt)), distinct)
    reached = sum(f.meissner > 0 for f in felt.values())
    yield at_least(f"distinct, reach Meissner, {at}", reached, "", meissner)


def _count(at: str, number: int, goal: int | None = None) -> Figure:
    """Return the figure of a number of distinct textures."""
    return at_least(f"distinct, textures, {at}", number, "", goal)
