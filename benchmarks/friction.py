"""Friction: accuracy of slow stretch through the time-domain plant, and its cost."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as changed

from benchmarks.rendering import (
    FINGERS,
    SKIPPED,
    grating_texture,
    played_shear,
    ratio_db,
    swing,
)
from tactile.bench.figures import RATE, Figure, at_least, at_most
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer, render
from tactile.texture.descriptor import Friction, textures
from tactile.texture.surface import Texture, load_texture, without_friction

BLOCK = 16
"""Number of samples of a block."""
SLOW = 20.0
"""Frequency up to which stretch is taken as quasi-static [Hz]."""
STICKY = Friction(
    static_coefficient=0.8, kinetic_coefficient=0.5, force_exponent=0.0, stick_slip=1.0
)
"""Friction with stick-slip."""


def friction_only(friction: Friction) -> Texture:
    """Return a texture that only has friction; its reference force is 0.5 N."""
    flat = grating_texture(0.0)
    return replace(flat, descriptor=changed(flat.descriptor, friction=friction))


def measure_friction() -> Iterator[Figure]:
    """Compare the skin's shear with the commanded one, back and forth with reversals and slips."""
    creep = Trajectory([0.0, 2.0], [[0.0, 0.0], [6e-3, 0.0]], 0.5)
    for name, finger in FINGERS.items():
        display = load_display("reference-24", load=finger())
        for case, path in (("swing", swing()), ("slips", creep)):
            r = render(display, friction_only(STICKY), path)
            error = played_shear(display, r.drive) - r.shear
            lines = np.abs(np.fft.rfft([error[SKIPPED:, 0], r.shear[SKIPPED:, 0]])) ** 2
            slow = np.fft.rfftfreq(len(error) - SKIPPED, 1 / RATE) <= SLOW
            part = np.sqrt(lines[0, slow].sum() / lines[1, slow].sum())
            yield at_most(f"friction.{name}.{case}.0_to_20_hz", 100 * float(part), "%", 1.0)
            ratio = ratio_db(r.shear, r.shear + error)
            yield at_least(f"friction.{name}.{case}.20_to_1000_hz", ratio, "dB", 40)
        share = np.abs(r.drive).max() / display.limits.voltage
        yield Figure(f"friction.{name}.slips.drive", 100 * float(share), "% of the limit")
    yield from _cost()


def _cost() -> Iterator[Figure]:
    """Time blocks of 16 with and without friction, in turns, by the fastest percent of each."""
    display = load_display("reference-24")
    blocks = list(swing().blocks(RATE, BLOCK))
    for name in textures():
        texture = load_texture(name)
        both = Renderer(display, without_friction(texture)), Renderer(display, texture)
        taken = np.zeros((len(blocks), 2))
        for k, block in enumerate(blocks):
            for i, renderer in enumerate(both):
                begun = time.perf_counter()
                renderer.block(*block)
                taken[k, i] = time.perf_counter() - begun
        plain, rubbed = np.percentile(taken, 1, axis=0) * 1e6
        yield Figure(f"friction.block_of_16.{name}.without", float(plain), "µs")
        yield Figure(f"friction.block_of_16.{name}.with", float(rubbed), "µs")
