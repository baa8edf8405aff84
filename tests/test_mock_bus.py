"""Tests of promises of ideal buses alone: they have played what was written, and remember it.

``mock:`` and ``sim:`` play as fast as they are written to; what they share with all other buses
is in `contract`.
"""

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from bus_benches import IDEAL, Bench
from bus_contract import (
    FADE,
    RATE,
    SLOW,
    assert_broken_off,
    assert_linear_ramp,
    assert_slews,
    climb,
    level,
    limited,
    noise,
    play,
)

from tactile.bus import base
from tactile.bus.base import DriveBlock
from tactile.devices import open_bus
from tactile.display.display import Display

SECOND = 8000

pytestmark = pytest.mark.usefixtures("plant")


@pytest.mark.parametrize("bench", IDEAL, indirect=True)
class TestEveryIdealBus:
    """Tests of what holds for all ideal buses."""

    def test_what_was_written_has_been_played(self, bench: Bench, three: Display) -> None:
        bus, volts = bench.open(three), noise(500)
        bus.start()
        for k in range(0, 500, 50):
            bus.write(DriveBlock(k, volts[k : k + 50]))
            np.testing.assert_allclose(bench.put_out(bus), volts[: k + 50], rtol=0, atol=bench.wire)

    @pytest.mark.parametrize("end", ["abort", "estop"])
    def test_it_breaks_off_after_the_last_sample(
        self, bench: Bench, three: Display, end: str
    ) -> None:
        bus, step = bench.open(limited(three, slew=SLOW)), SLOW / RATE
        line = climb(np.array([80.0, -60, 10]), step, stay=1)
        bus.start()
        bus.write(DriveBlock(0, line))
        getattr(bus, end)()
        assert_slews(bench.put_out(bus)[len(line) :], line[-1], step)

    @pytest.mark.parametrize("slew", [0.7e6, 0.05e6, 54321.0, 0.1e6 / 3])
    def test_abort_is_at_the_slew_limit_from_anywhere(
        self, bench: Bench, three: Display, slew: float
    ) -> None:
        bus, step = bench.open(limited(three, slew=slew)), slew / RATE
        multiples = step * np.array([[1, -2, 3], [4, -1, 0], [7, -9, 11]])
        for start in (*noise(30), *np.clip(multiples, -100, 100)):
            line = climb(start, step, stay=1)
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.abort()
            out = bench.put_out(bus)
            begin = np.flatnonzero(np.all(np.abs(out - start) <= bench.wire, axis=1))[-1]
            assert_broken_off(out[begin:], line[-1:], step, bench.wire)

    def test_a_gap_of_seconds_fades_out_and_in_again(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        bus.start()
        bus.write(DriveBlock(0, level(10, 20, -30)))
        bus.write(DriveBlock(3 * SECOND + 7, level(1, 2, 3, count=2 * FADE)))
        assert bus.counters.faults() == {"lost_samples": 3 * SECOND - 3, "underruns": 1}
        out = bench.put_out(bus)
        rise = np.minimum(np.arange(1, 2 * FADE + 1) / FADE, 1)[:, None] * [1.0, 2, 3]
        np.testing.assert_allclose(out[-2 * FADE :], rise, rtol=0, atol=bench.wire)
        if "keep=all" not in bench.url:
            assert len(out) >= SECOND
            assert not out[: -2 * FADE].any()
            return
        assert len(out) == 3 * SECOND + 7 + 2 * FADE
        assert_linear_ramp(out[10 : 10 + FADE], out[9])
        assert not out[10 + FADE : -2 * FADE].any()

    def test_about_a_second_is_kept_or_with_keep_all_everything(
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), noise(3 * SECOND)
        bus.start()
        play(bus, volts, list(range(64, len(volts), 64)))
        out = bench.put_out(bus)
        if "keep=all" in bench.url:
            assert len(out) == len(volts)
        else:
            assert SECOND <= len(out) <= SECOND + 64
        np.testing.assert_allclose(out, volts[-len(out) :], rtol=0, atol=bench.wire)

    @pytest.mark.ci
    def test_memory_does_not_grow(self, bench: Bench, three: Display) -> None:
        if "keep=all" in bench.url:
            pytest.skip("keeps everything")
        bus, block = bench.open(three), level(10, 20, 30, count=64)
        bus.start()
        for k in range(200):
            bus.write(DriveBlock(64 * k, block))
        tracemalloc.start()
        try:
            for k in range(200, 400):
                bus.write(DriveBlock(64 * k, block))
            before = tracemalloc.get_traced_memory()[0]
            for k in range(400, 800):
                bus.write(DriveBlock(64 * k, block))
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        per_sample = 3 * 8
        assert grown < 0.05 * 400 * 64 * per_sample, "5 % of what was played"


def test_the_plant_of_this_test_lies_outside_the_package(three: Display) -> None:
    open_bus(IDEAL[3], three)
    module = sys.modules["plant_of_the_bus_contract"]
    assert not Path(str(module.__file__)).is_relative_to(Path(base.__file__).parents[1])
