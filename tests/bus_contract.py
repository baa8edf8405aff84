"""Displays, signals and comparisons of the tests that every bus passes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bus_benches import PCM16, RATE, Bench, Test, steadied

from tactile.arrays import Floats
from tactile.bus.base import Bus, DriveBlock
from tactile.display.display import Display

FADE = 160
"""Number of samples of a block, 20 ms."""
VOLTAGE = 100.0
SLOW = 0.05e6
"""Slew limit of the display of the ramps [V/s]: 16 samples from 100 V. That of the other display is
2e6, with which any sample may follow any other at 8 kHz."""
LONG = 1200
"""Number of samples, 75 ms at the highest rate: more than any bus sends ahead."""
ROUNDING = 1e-9
"""Largest rounding error of differences of doubles up to 100 V, with ample margin [V]."""

DISPLAY = """
[display]
id = "three"
description = "Three contactors on lines 0 to 2"
opening_mm = [2.0, 3.0]
[[contactor]]
position_mm = [0.0, 0.0]
channel = 1
[[contactor]]
position_mm = [3.0, 0.0]
channel = 0
polarity = -1
[[contactor]]
position_mm = [6.0, 0.0]
channel = 2
[finger]
preset = "low"
[limits]
voltage_v = 100.0
slew_v_per_us = 2.0
fade_ms = 20.0
"""
PLANT = '''
"""A plant that follows at once: 1 nm/V."""


class Follower:
    delay = 0

    def step(self, drive):
        return 1e-9 * drive, 0 * drive


def make(display, sample_rate):
    return Follower()
'''


def on(benches: Sequence[object]) -> Callable[[Test], Test]:
    """Run a class of tests on each bench, steadied, whatever pyserial calls deprecated."""

    def marked(cases: Test) -> Test:
        quiet = pytest.mark.filterwarnings("ignore:set(Daemon|Name).*:DeprecationWarning")
        each = pytest.mark.parametrize("bench", benches, indirect=True)
        used = pytest.mark.usefixtures("plant", "unhurried_links")
        return used(each(quiet(steadied(cases))))

    return marked


def limited(display: Display, **limits: float) -> Display:
    """Return a display with other limits."""
    return replace(display, limits=replace(display.limits, **limits))


# Signals


def level(*volts: float, count: int = 10) -> Floats:
    """Return (count, 3) samples that stay where they are [V]."""
    return np.tile(np.asarray(volts, np.float64), (count, 1))


def climb(start: Floats, step: float, *, stay: int = LONG) -> Floats:
    """Return samples that rise from 0 V to ``start`` within a step's size each, and stay [V]."""
    count = math.ceil(np.abs(start).max() / (0.9 * step)) + 1
    rise = np.linspace(np.zeros(len(start)), start, count)
    return np.concatenate([rise, np.tile(start, (stay, 1))])


def noise(count: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform(-VOLTAGE, VOLTAGE, (count, 3))


def play(bus: Bus, volts: Floats, cuts: list[int], begin: int = 0) -> None:
    """Write samples in blocks that end at the given positions and at the end."""
    edges = [0, *cuts, len(volts)]
    for start, end in pairwise(edges):
        bus.write(DriveBlock(begin + start, volts[start:end]))


# Comparisons


def assert_played(out: Floats, volts: Floats, wire: float = PCM16) -> None:
    """See that output begins with these samples."""
    assert len(out) >= len(volts)
    np.testing.assert_allclose(out[: len(volts)], volts, rtol=0, atol=wire)


def assert_rests(out: Floats) -> None:
    """See that it ends at exactly 0 V."""
    assert len(out)
    assert np.all(out[-1] == 0.0)


def assert_linear_ramp(ramp: Floats, start: Floats, wire: float = PCM16, count: int = FADE) -> None:
    """Compare with the straight line from ``start``, its own sample left out, to 0 V."""
    assert len(ramp) == count
    line = (1 - np.arange(1, count + 1) / count)[:, None] * start
    np.testing.assert_allclose(ramp, line, rtol=0, atol=wire)
    assert_rests(ramp)


def assert_slews(ramp: Floats, start: Floats, step: float) -> None:
    """See that it goes to 0 V at the slew limit: never steeper, never back, and not later.

    Not later than the limit in whole codes of 16 bits allows, a little less than in volts.
    """
    line = np.concatenate([start[None], ramp])
    assert np.all(line[-1] == 0.0)
    assert np.all(np.abs(np.diff(line, axis=0)) <= step + ROUNDING)
    assert np.all(np.diff(np.abs(line), axis=0) <= 0)
    code = VOLTAGE / 32767
    assert len(ramp) <= math.ceil(np.abs(start).max() / (step - code) + ROUNDING)


def assert_broken_off(out: Floats, volts: Floats, step: float, wire: float) -> None:
    """See that of what was written a part was played, up to `LONG` before its end and then no ramp.

    What was on its way to the amplifier is not played; from where it was it went to 0 V.
    """
    count = min(len(out), len(volts))
    same = np.all(np.abs(out[:count] - volts[:count]) <= wire, axis=1)
    played = count if same.all() else int(np.argmin(same))
    assert played >= len(volts) - LONG
    assert_slews(out[played:], out[played - 1], step)


def played(bench: Bench, bus: Bus, volts: Floats, cuts: list[int] | None = None) -> Floats:
    """Start, write samples and stop; return the output."""
    before = len(bench.put_out(bus))
    bus.start()
    play(bus, volts, cuts or [])
    bus.stop()
    return bench.put_out(bus)[before:]


__all__ = [
    "FADE", "LONG", "RATE", "ROUNDING", "SLOW", "VOLTAGE", "Bench", "Floats", "assert_broken_off",
    "assert_linear_ramp", "assert_played", "assert_rests", "assert_slews", "climb", "level",
    "limited", "noise", "play", "played",
]  # fmt: skip
