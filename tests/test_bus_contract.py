"""Every bus keeps the contract of `tactile.bus.base`: states, ramps, counters, memory.

A new bus joins by adding its URL to `URLS`. It is watched through ``output``, the volts that it put
out (or decoded from what it sent), at least the last second of them.
"""

import math
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Protocol, cast, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile.bus import base, registry
from tactile.bus.base import Bus, DriveBlock, HostDeath, Rig, Wiring
from tactile.bus.registry import Address
from tactile.devices import open_bus
from tactile.display import Display, load_display
from tactile.errors import BusError, BusStateError, InputError

Floats = NDArray[np.float64]

URLS = ("mock:", "mock:?keep=all", "sim:", "sim:?plant=plant_of_the_bus_contract:make")
SCHEMES = sorted({url.partition(":")[0] for url in URLS})

RATE = 8000.0
SECOND = 8000
FADE = 160
"""Samples: 20 ms."""
VOLTAGE = 100.0
SLEW = 2e6
"""V/s of the display below: any sample may follow any other at 8 kHz."""
SLOW = 0.05e6
"""V/s of the display of the ramps: 16 samples from 100 V."""
WIRE = 5e-3
"""V; 16 bits over ±100 V round by 1.5 mV at most. 0 V is compared exactly."""
ROUNDING = 1e-9
"""V; of differences of doubles up to 100 V, with ample room."""

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


class Watched(Protocol):
    """What the tests see of a bus."""

    @property
    def output(self) -> Floats: ...


@pytest.fixture(scope="module", autouse=True)
def _plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("plants")
    (folder / "plant_of_the_bus_contract.py").write_text(PLANT, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield
    sys.modules.pop("plant_of_the_bus_contract", None)


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Display:
    path = tmp_path_factory.mktemp("displays") / "three.toml"
    path.write_text(DISPLAY, encoding="utf-8")
    return load_display(path)


@pytest.fixture
def bus(url: str, display: Display) -> Iterator[Bus]:
    opened = open_bus(url, display, sample_rate=RATE)
    yield opened
    opened.close()


@pytest.fixture
def slow(display: Display) -> Display:
    """Give the same with a slew limit that ramps can be seen in."""
    return replace(display, limits=replace(display.limits, slew=SLOW))


def put_out(bus: Bus) -> Floats:
    return cast(Watched, bus).output.copy()


def level(*volts: float, count: int = 10) -> Floats:
    """Return (count, 3) samples that stay where they are [V]."""
    return np.tile(np.asarray(volts, np.float64), (count, 1))


def climb(start: Floats, step: float) -> Floats:
    """Return samples that rise from 0 V to ``start`` within a step's size each [V]."""
    count = math.ceil(np.abs(start).max() / (0.9 * step)) + 1
    return np.linspace(np.zeros(len(start)), start, count)


def noise(count: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform(-VOLTAGE, VOLTAGE, (count, 3))


def play(bus: Bus, volts: Floats, cuts: list[int], begin: int = 0) -> None:
    """Write samples in blocks that end at the given positions and at the end."""
    edges = [0, *cuts, len(volts)]
    for start, end in pairwise(edges):
        bus.write(DriveBlock(begin + start, volts[start:end]))


def assert_rests(bus: Bus, before: int) -> Floats:
    """See that the bus is at exactly 0 V; return what it put out after ``before`` samples."""
    out = put_out(bus)
    assert len(out)
    assert np.all(out[-1] == 0.0)
    return out[before:]


def assert_linear_ramp(ramp: Floats, start: Floats) -> None:
    """Compare with the straight line from ``start``, its own sample left out, to 0 V."""
    assert len(ramp) == FADE
    line = (1 - np.arange(1, FADE + 1) / FADE)[:, None] * start
    np.testing.assert_allclose(ramp, line, rtol=0, atol=WIRE)


def assert_slews(ramp: Floats, start: Floats, step: float) -> None:
    """See that it goes to 0 V at the slew limit: never steeper, never back, and not later.

    Not later than the limit in whole codes of 16 bits allows, a little less than in volts.
    """
    line = np.concatenate([start[None], ramp])
    assert np.all(np.abs(np.diff(line, axis=0)) <= step + ROUNDING)
    assert np.all(np.diff(np.abs(line), axis=0) <= 0)
    code = VOLTAGE / 32767
    assert len(ramp) <= math.ceil(np.abs(start).max() / (step - code) + ROUNDING)


@pytest.mark.parametrize("url", URLS)
class TestEveryBus:
    """What holds for any bus."""

    # States

    def test_opens_idle_for_its_display_and_declares_what_host_death_does(
        self, bus: Bus, display: Display
    ) -> None:
        assert bus.state == "idle"
        assert bus.wiring == Wiring.of(display, RATE)
        assert bus.on_host_death in get_args(HostDeath)
        assert bus.counters == base.Counters()

    def test_start_is_refused_while_running_and_after_close(self, bus: Bus) -> None:
        bus.start()
        with pytest.raises(BusStateError, match="start: the bus is running"):
            bus.start()
        assert bus.state == "running"
        bus.close()
        with pytest.raises(BusStateError, match="start: the bus is closed"):
            bus.start()

    def test_write_is_refused_unless_running(self, bus: Bus) -> None:
        block = DriveBlock(0, level(1, 2, 3))
        with pytest.raises(BusStateError, match="write: the bus is idle"):
            bus.write(block)
        bus.start()
        bus.stop()
        with pytest.raises(BusStateError, match="write: the bus is idle"):
            bus.write(block)
        bus.start()
        bus.abort()
        with pytest.raises(BusStateError, match="write: the bus is idle"):
            bus.write(block)
        bus.close()
        with pytest.raises(BusStateError, match="write: the bus is closed"):
            bus.write(block)
        assert not put_out(bus).any()
        assert bus.counters.samples == 0

    def test_a_forbidden_call_is_also_the_built_in_errors(self, bus: Bus) -> None:
        for kind in (BusError, OSError, RuntimeError):
            with pytest.raises(kind):
                bus.write(DriveBlock(0, level(1, 2, 3)))

    def test_starts_again_after_stop_and_after_abort(self, bus: Bus) -> None:
        for end in (bus.stop, bus.abort, bus.stop):
            bus.start()
            bus.write(DriveBlock(0, level(10, 20, 30)))
            assert np.allclose(put_out(bus)[-10:], [10, 20, 30], rtol=0, atol=WIRE)
            end()
            assert bus.state == "idle"
            assert_rests(bus, 0)
        assert bus.counters.faults() == {}

    @pytest.mark.parametrize("first", ["stop", "abort"])
    def test_stop_abort_and_close_are_idempotent(self, bus: Bus, first: str) -> None:
        bus.stop()
        bus.abort()
        assert not put_out(bus).any()
        bus.start()
        bus.write(DriveBlock(0, level(80, -60, 0)))
        getattr(bus, first)()
        ended = put_out(bus)
        for again in (bus.stop, bus.abort, bus.abort, bus.stop, bus.close, bus.close):
            again()
        bus.stop()
        bus.abort()
        assert bus.state == "closed"
        assert np.array_equal(put_out(bus), ended)

    def test_close_stops_first(self, bus: Bus) -> None:
        bus.start()
        bus.write(DriveBlock(0, level(80, -60, 10)))
        bus.close()
        assert_linear_ramp(assert_rests(bus, 10), np.array([80.0, -60, 10]))

    # Ends

    def test_leaving_the_with_block_stops_and_closes(self, bus: Bus) -> None:
        with bus as entered:
            assert entered is bus
            bus.start()
            bus.write(DriveBlock(0, level(80, -60, 10)))
        assert bus.state == "closed"
        assert_linear_ramp(assert_rests(bus, 10), np.array([80.0, -60, 10]))

    @pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt, BusError])
    def test_an_exception_in_the_with_block_aborts_closes_and_goes_on(
        self, url: str, slow: Display, kind: type[BaseException]
    ) -> None:
        start = np.array([80.0, -60, 10])
        bus = open_bus(url, slow, sample_rate=RATE)
        line = climb(start, SLOW / RATE)

        def failing() -> None:
            with bus:
                bus.start()
                bus.write(DriveBlock(0, line))
                raise kind("no more")

        with pytest.raises(kind, match="no more"):
            failing()
        assert bus.state == "closed"
        assert_slews(assert_rests(bus, len(line)), start, SLOW / RATE)

    def test_stop_is_a_straight_ramp_of_the_fades_length_to_exactly_0_volts(self, bus: Bus) -> None:
        bus.start()
        for k, volts in enumerate([(100, -100, 0), (1e-3, -33.3, 77.7), (0, 0, 0)]):
            begin = k * (10 + FADE)
            if k:
                bus.start()
            bus.write(DriveBlock(0, level(*volts)))
            bus.stop()
            assert_linear_ramp(assert_rests(bus, begin + 10), np.array(volts, np.float64))

    @pytest.mark.parametrize("rate", [5000.0, 16000.0])
    def test_ramps_take_their_time_at_any_sample_rate(
        self, url: str, display: Display, rate: float
    ) -> None:
        start = np.array([80.0, -60, 10])
        with open_bus(url, display, sample_rate=rate) as bus:
            bus.start()
            bus.write(DriveBlock(0, start[None]))
            bus.stop()
            assert len(assert_rests(bus, 1)) == round(20e-3 * rate)
        slow = replace(display, limits=replace(display.limits, slew=SLOW))
        line = climb(start, SLOW / rate)
        with open_bus(url, slow, sample_rate=rate) as bus:
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.abort()
            assert_slews(assert_rests(bus, len(line)), start, SLOW / rate)

    def test_estop_goes_to_0_volts_at_the_slew_limit_and_only_clear_ends_it(
        self, url: str, slow: Display
    ) -> None:
        start = np.array([80.0, -60, 10])
        with open_bus(url, slow, sample_rate=RATE) as bus:
            line = climb(start, SLOW / RATE)
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.estop()
            assert_slews(assert_rests(bus, len(line)), start, SLOW / RATE)
            assert bus.state == bus.status.state == "estopped"
            for end in (bus.stop, bus.abort, bus.estop):
                end()
                assert bus.state == "estopped"
            with pytest.raises(BusStateError, match="write: the bus is estopped"):
                bus.write(DriveBlock(0, line))
            with pytest.raises(BusStateError, match=r"start: the bus is estopped.*; clear it"):
                bus.start()
            bus.clear()
            bus.clear()
            bus.start()
            bus.write(DriveBlock(0, level(1, 2, 3)))
            np.testing.assert_allclose(put_out(bus)[-10:], level(1, 2, 3), rtol=0, atol=WIRE)

    def test_estop_holds_where_nothing_played(self, bus: Bus) -> None:
        bus.estop()
        with pytest.raises(BusStateError, match="start: the bus is estopped"):
            bus.start()
        bus.clear()
        bus.start()
        bus.close()
        bus.estop()
        assert bus.state == "closed"

    @pytest.mark.parametrize("fade", [1e-5, 62.5e-6, 125e-6, 1e-3])
    def test_stop_ends_at_0_volts_however_short_the_fade(
        self, url: str, display: Display, fade: float
    ) -> None:
        short = replace(display, limits=replace(display.limits, fade=fade))
        with open_bus(url, short, sample_rate=RATE) as bus:
            bus.start()
            bus.write(DriveBlock(0, level(40, -30, 20)))
            bus.stop()
            assert_rests(bus, 10)

    @pytest.mark.parametrize("slew", [0.7e6, 0.05e6, 54321.0, 0.1e6 / 3])
    def test_abort_goes_to_exactly_0_volts_at_the_slew_limit(
        self, url: str, display: Display, slew: float
    ) -> None:
        steep = replace(display, limits=replace(display.limits, slew=slew))
        step = slew / RATE
        multiples = step * np.array([[1, -2, 3], [4, -1, 0], [7, -9, 11]])
        with open_bus(url, steep, sample_rate=RATE) as bus:
            for start in (*noise(30), *np.clip(multiples, -VOLTAGE, VOLTAGE), np.zeros(3)):
                bus.start()
                bus.write(DriveBlock(0, climb(start, step)))
                bus.abort()
                out = put_out(bus)
                assert np.all(out[-1] == 0.0)
                before = np.flatnonzero(np.all(np.abs(out - start) <= WIRE, axis=1))[-1]
                assert_slews(out[before + 1 :], out[before], step)

    def test_abort_asks_no_more_current_than_the_display_allows(
        self, url: str, display: Display
    ) -> None:
        weak = replace(display, limits=replace(display.limits, current=0.1e-3))
        step = weak.limits.step(RATE, weak.capacitance)
        assert step < SLOW / RATE
        line = climb(np.array([50.0, -30, 20]), step)
        with open_bus(url, weak, sample_rate=RATE) as bus:
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.abort()
            out = put_out(bus)[len(line) - 1 :]
            assert np.all(np.abs(np.diff(out, axis=0)) <= step + ROUNDING)

    def test_no_sample_steps_further_than_the_slew_limit(self, url: str, slow: Display) -> None:
        with open_bus(url, slow, sample_rate=RATE) as bus:
            bus.start()
            play(bus, noise(300), [100, 200])
            bus.stop()
            out = np.concatenate([np.zeros((1, 3)), put_out(bus)])
            assert np.abs(np.diff(out, axis=0)).max() == pytest.approx(SLOW / RATE, abs=WIRE)
            assert np.all(np.abs(np.diff(out, axis=0)) <= SLOW / RATE + ROUNDING)

    def test_a_slew_limit_that_breaks_the_promise_to_be_at_0_volts_is_refused(
        self, url: str, display: Display
    ) -> None:
        lame = replace(display, limits=replace(display.limits, slew=4e3))
        with pytest.raises(InputError, match="slew limit 4000 V/s: takes 25 ms") as found:
            open_bus(url, lame, sample_rate=RATE)
        assert "\n" not in str(found.value)

    def test_a_sample_rate_that_is_no_whole_number_is_refused(
        self, url: str, display: Display
    ) -> None:
        with pytest.raises(InputError, match=r"sample_rate 8000.5 Hz: the protocol tells whole Hz"):
            open_bus(url, display, sample_rate=8000.5)

    # What arrives wrong

    def test_a_short_gap_is_counted_and_bridged_by_a_straight_line(self, bus: Bus) -> None:
        bus.start()
        bus.write(DriveBlock(0, level(10, 20, -30)))
        bus.write(DriveBlock(25, level(1, 2, 3)))
        line = np.linspace([10.0, 20, -30], [1.0, 2, 3], 17)
        expected = np.concatenate([level(10, 20, -30, count=9), line, level(1, 2, 3, count=9)])
        np.testing.assert_allclose(put_out(bus), expected, rtol=0, atol=2 * WIRE)
        assert bus.counters.faults() == {"lost_samples": 15}
        assert bus.counters.samples == 20

    def test_a_gap_at_the_beginning_is_silent_and_what_follows_fades_in(self, bus: Bus) -> None:
        bus.start(100)
        bus.write(DriveBlock(104, level(10, 20, -30, count=FADE + 10)))
        rise = np.minimum(np.arange(1, FADE + 11) / FADE, 1)[:, None] * [10.0, 20, -30]
        expected = np.concatenate([level(0, 0, 0, count=4), rise])
        np.testing.assert_allclose(put_out(bus), expected, rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"lost_samples": 4}

    def test_a_long_gap_fades_out_and_in_again(self, url: str, bus: Bus) -> None:
        bus.start()
        bus.write(DriveBlock(0, level(10, 20, -30)))
        bus.write(DriveBlock(3 * SECOND + 7, level(1, 2, 3, count=2 * FADE)))
        assert bus.counters.faults() == {"lost_samples": 3 * SECOND - 3, "underruns": 1}
        out = put_out(bus)
        rise = np.minimum(np.arange(1, 2 * FADE + 1) / FADE, 1)[:, None] * [1.0, 2, 3]
        np.testing.assert_allclose(out[-2 * FADE :], rise, rtol=0, atol=WIRE)
        if "keep=all" not in url:
            assert len(out) >= SECOND
            assert not out[: -2 * FADE].any()
            return
        assert len(out) == 3 * SECOND + 7 + 2 * FADE
        assert_linear_ramp(out[10 : 10 + FADE], out[9])
        assert not out[10 + FADE : -2 * FADE].any()

    def test_a_resend_is_dropped_counted_and_otherwise_changes_nothing(
        self, url: str, display: Display
    ) -> None:
        volts = noise(300)
        with open_bus(url, display, sample_rate=RATE) as once:
            once.start()
            play(once, volts, [100, 200])
            expected = put_out(once)
            samples = once.counters.samples
        with open_bus(url, display, sample_rate=RATE) as twice:
            twice.start()
            for start in (0, 100, 200):
                for _ in range(2):
                    twice.write(DriveBlock(start, volts[start : start + 100]))
            twice.write(DriveBlock(0, volts))
            assert np.array_equal(put_out(twice), expected)
            assert twice.counters.faults() == {"repeated_samples": 600}
            assert twice.counters.samples == samples

    def test_a_block_from_long_ago_does_not_turn_the_stream_back(self, bus: Bus) -> None:
        volts = noise(400)
        bus.start()
        play(bus, volts[:300], [100, 200])
        bus.write(DriveBlock(0, volts[:50]))
        bus.write(DriveBlock(-500, volts[:50]))
        bus.write(DriveBlock(300, volts[300:]))
        np.testing.assert_allclose(put_out(bus), volts, rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"repeated_samples": 100}
        assert bus.counters.samples == 400

    def test_of_an_overlapping_block_the_new_part_is_played(self, bus: Bus) -> None:
        volts = noise(150)
        bus.start()
        bus.write(DriveBlock(0, volts[:100]))
        bus.write(DriveBlock(70, volts[70:]))
        np.testing.assert_allclose(put_out(bus), volts, rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"repeated_samples": 30}
        assert bus.counters.samples == 150

    def test_what_lies_before_the_start_is_dropped(self, bus: Bus) -> None:
        bus.start(1000)
        bus.write(DriveBlock(990, level(50, 50, 50)))
        assert not put_out(bus).any()
        bus.write(DriveBlock(1000, level(1, 2, 3)))
        np.testing.assert_allclose(put_out(bus)[-10:], level(1, 2, 3), rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"repeated_samples": 10}

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_what_is_not_finite_is_counted_and_played_as_0_volts(
        self, bus: Bus, value: float
    ) -> None:
        volts = level(10, 20, -30)
        volts[3, 1] = volts[4, 1] = volts[4, 2] = value
        bus.start()
        bus.write(DriveBlock(0, volts))
        expected = np.where(np.isfinite(volts), volts, 0.0)
        np.testing.assert_allclose(put_out(bus), expected, rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"invalid_samples": 3}

    def test_volts_over_the_limit_are_counted_and_never_put_out(self, bus: Bus) -> None:
        volts = level(VOLTAGE, -VOLTAGE, 0)
        volts[2] = 101, -250, 30
        volts[5] = np.nextafter(VOLTAGE, 200), -1e300, math.nan
        bus.start()
        bus.write(DriveBlock(0, volts))
        expected = np.clip(np.nan_to_num(volts), -VOLTAGE, VOLTAGE)
        out = put_out(bus)
        assert np.all(np.abs(out) <= VOLTAGE)
        np.testing.assert_allclose(out, expected, rtol=0, atol=WIRE)
        assert bus.counters.faults() == {"clipped_samples": 4, "invalid_samples": 1}

    def test_volts_at_the_limit_are_no_fault(self, bus: Bus) -> None:
        bus.start()
        bus.write(DriveBlock(0, level(VOLTAGE, -VOLTAGE, 0)))
        assert bus.counters.faults() == {}

    def test_nothing_bad_survives_into_the_ramps(self, bus: Bus) -> None:
        for end in (bus.stop, bus.abort):
            bus.start()
            bus.write(DriveBlock(0, level(math.nan, math.inf, 1e9)))
            end()
            out = put_out(bus)
            assert np.all(np.abs(out) <= VOLTAGE)
            assert np.all(out[-1] == 0.0)

    @pytest.mark.parametrize("shape", [(10,), (10, 2), (10, 4), (3, 10), (1, 10, 3), ()])
    def test_a_block_without_a_column_per_channel_is_refused_and_nothing_played(
        self, bus: Bus, shape: tuple[int, ...]
    ) -> None:
        bus.start()
        with pytest.raises(InputError, match=r"write: block of shape .*, needs \(S, 3\)"):
            bus.write(DriveBlock(0, np.ones(shape)))
        assert bus.state == "running"
        assert not put_out(bus).any()
        bus.write(DriveBlock(0, level(1, 2, 3)))
        assert bus.counters.faults() == {}

    # Blocks

    @pytest.mark.parametrize("cuts", ["1", "7", "64", "random", "whole"])
    def test_how_the_stream_is_cut_does_not_matter(self, bus: Bus, cuts: str) -> None:
        volts = noise(500)
        volts[100:110] = math.nan
        volts[200:220] *= 3
        edges = {
            "1": list(range(1, 500)),
            "7": list(range(7, 500, 7)),
            "64": list(range(64, 500, 64)),
            "random": sorted(np.random.default_rng(1).integers(0, 500, 20).tolist()),
            "whole": [],
        }[cuts]
        bus.start()
        play(bus, volts, edges)
        bus.stop()
        played = np.clip(np.nan_to_num(volts), -VOLTAGE, VOLTAGE)
        out = assert_rests(bus, 0)
        np.testing.assert_allclose(out[:500], played, rtol=0, atol=WIRE)
        assert_linear_ramp(out[500:], out[499])
        over = int(np.count_nonzero(np.abs(np.nan_to_num(volts)) > VOLTAGE))
        assert over > 0
        assert bus.counters.faults() == {"invalid_samples": 30, "clipped_samples": over}
        assert bus.counters.samples == 500

    def test_an_empty_block_is_no_fault(self, bus: Bus) -> None:
        bus.start()
        bus.write(DriveBlock(0, np.zeros((0, 3))))
        bus.write(DriveBlock(0, level(1, 2, 3)))
        np.testing.assert_allclose(put_out(bus), level(1, 2, 3), rtol=0, atol=WIRE)
        assert bus.counters.faults() == {}

    def test_the_callers_array_is_neither_changed_nor_kept(self, bus: Bus) -> None:
        volts = level(150, math.nan, 3)
        same = volts.copy()
        bus.start()
        bus.write(DriveBlock(0, volts))
        assert np.array_equal(volts, same, equal_nan=True)
        volts[:] = level(9, 9, 9)
        bus.write(DriveBlock(10, volts))
        out = put_out(bus)
        volts[:] = 77
        assert np.array_equal(put_out(bus), out)
        np.testing.assert_allclose(out[:10], level(100, 0, 3), rtol=0, atol=WIRE)

    def test_positions_begin_where_start_says(self, bus: Bus) -> None:
        for begin in (10**12, 0, 5):
            bus.start(begin)
            play(bus, noise(30), [10, 20], begin)
            bus.stop()
        assert bus.counters.faults() == {}

    # Memory

    def test_about_a_second_is_kept(self, url: str, bus: Bus) -> None:
        if "keep=all" in url:
            pytest.skip("keeps everything, as the test below says")
        bus.start()
        for k in range(3 * SECOND // 64):
            bus.write(DriveBlock(64 * k, level(k % 100, 0, 0, count=64)))
        out = put_out(bus)
        assert SECOND <= len(out) <= SECOND + 64
        assert out[-1, 0] == pytest.approx((k % 100), abs=WIRE)

    def test_keep_all_keeps_everything(self, url: str, bus: Bus) -> None:
        if "keep=all" not in url:
            pytest.skip("keeps a second, as the test above says")
        volts = noise(3 * SECOND)
        bus.start()
        play(bus, volts, list(range(64, len(volts), 64)))
        np.testing.assert_allclose(put_out(bus), volts, rtol=0, atol=WIRE)

    def test_memory_does_not_grow(self, url: str, bus: Bus) -> None:
        if "keep=all" in url:
            pytest.skip("keeps everything")
        block = level(10, 20, 30, count=64)
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


@pytest.mark.parametrize("scheme", SCHEMES)
class TestEveryScheme:
    """What holds for any kind of device URL."""

    def test_the_driver_says_of_host_death_what_its_buses_say(
        self, scheme: str, display: Display
    ) -> None:
        with open_bus(f"{scheme}:", display) as bus:
            assert registry._drivers[scheme].on_host_death == bus.on_host_death

    def test_an_unknown_option_is_one_line_with_the_nearest(
        self, scheme: str, display: Display
    ) -> None:
        with pytest.raises(InputError, match=f"^{scheme}: unknown option 'kep'; .*'keep'") as found:
            open_bus(f"{scheme}:?kep=all", display)
        assert "\n" not in str(found.value)

    @pytest.mark.parametrize("options", ["keep=all&bogus=1", "xyzzy=2", "KEEP=all"])
    def test_every_option_is_looked_at(self, scheme: str, display: Display, options: str) -> None:
        with pytest.raises(InputError, match="unknown option"):
            open_bus(f"{scheme}:?{options}", display)

    def test_an_option_with_a_wrong_value_says_what_may_be(
        self, scheme: str, display: Display
    ) -> None:
        with pytest.raises(InputError, match=f"{scheme}: keep = 'al': must be 'second' or 'all'"):
            open_bus(f"{scheme}:?keep=al", display)

    @pytest.mark.parametrize("query", ["keep", "keep=all&keep", "keep=all&&", "&"])
    def test_options_that_are_no_options_are_one_line(
        self, scheme: str, display: Display, query: str
    ) -> None:
        with pytest.raises(InputError, match="options are name=value") as found:
            open_bus(f"{scheme}:?{query}", display)
        assert "\n" not in str(found.value)

    def test_a_path_that_means_nothing_is_refused(self, scheme: str, display: Display) -> None:
        with pytest.raises(InputError):
            open_bus(f"{scheme}:keep=all", display)

    def test_the_scheme_is_read_in_any_case(self, scheme: str, display: Display) -> None:
        with open_bus(f"{scheme.upper()}:", display) as bus:
            assert bus.state == "idle"


@pytest.mark.parametrize(
    ("url", "nearest"),
    [("moc:", "'mock:'"), ("mock", "'mock:'"), ("simm:?keep=all", "'sim:'"), ("sim", "'sim:'")],
)
def test_an_unknown_scheme_is_one_line_with_the_nearest(
    display: Display, url: str, nearest: str
) -> None:
    with pytest.raises(InputError, match=f"no such kind; did you mean {nearest}") as found:
        open_bus(url, display)
    assert repr(url) in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("url", ["", ":", "xyzzy:", "/dev/ttyUSB0", "c:\\here"])
def test_a_url_that_resembles_nothing_is_one_line_with_what_there_is(
    display: Display, url: str
) -> None:
    with pytest.raises(InputError, match="no such kind") as found:
        open_bus(url, display)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("url", ["sim://[", "mock://[half?keep=all"])
def test_a_malformed_url_is_an_input_error(display: Display, url: str) -> None:
    with pytest.raises(InputError):
        open_bus(url, display)


class TestRegisteredBus:
    """A driver that fails to open."""

    @pytest.fixture(autouse=True)
    def _own_factories(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(registry, "_drivers", dict(registry._drivers))

    def test_an_operating_system_error_becomes_a_bus_error_that_names_the_device(
        self, display: Display
    ) -> None:
        def absent(address: Address, rig: Rig, sample_rate: float | None) -> Bus:
            raise FileNotFoundError(2, "No such file or directory", address.path)

        registry.register_bus("absent", absent)
        with pytest.raises(BusError, match=r"device 'absent:/dev/ttyX': .*No such file") as found:
            open_bus("absent:/dev/ttyX", display)
        assert isinstance(found.value.__cause__, FileNotFoundError)

    def test_a_bus_error_passes_as_it_is(self, display: Display) -> None:
        error = BusError("the amplifier does not answer")

        def silent(address: Address, rig: Rig, sample_rate: float | None) -> Bus:
            raise error

        registry.register_bus("silent", silent)
        with pytest.raises(BusError) as found:
            open_bus("silent:", display)
        assert found.value is error

    @pytest.mark.parametrize("death", ["holds", "unknown"])
    def test_what_does_not_go_to_0_volts_by_itself_is_refused_unless_accepted(
        self, display: Display, death: HostDeath
    ) -> None:
        def factory(address: Address, rig: Rig, sample_rate: float | None) -> Bus:
            opened.append(address.scheme)
            return open_bus("mock:", rig)

        opened: list[str] = []
        registry.register_bus("own", factory, on_host_death=death)
        with pytest.raises(InputError, match=r"when the host dies.*--accept-unsafe-hold") as found:
            open_bus("own:", display)
        assert "\n" not in str(found.value)
        assert opened == []
        open_bus("own:", display, accept_unsafe_hold=True).close()
        assert opened == ["own"]

    def test_found_devices_are_those_of_every_kind(self) -> None:
        def finder(scheme: str) -> Callable[[], list[registry.Found]]:
            return lambda: [registry.Found(f"{scheme}:{k}", "a device") for k in range(2)]

        for scheme in ("one", "two"):
            registry.register_bus(scheme, registry._drivers["mock"].factory, find=finder(scheme))
        urls = [found.url for found in registry.find_devices()]
        assert [u for u in urls if u[:3] in ("one", "two")] == ["one:0", "one:1", "two:0", "two:1"]

    def test_a_factory_is_given_path_options_display_and_rate(self, display: Display) -> None:
        given: list[tuple[Address, Rig, float | None]] = []

        def factory(address: Address, rig: Rig, sample_rate: float | None) -> Bus:
            given.append((address, rig, sample_rate))
            return open_bus("mock:", rig, sample_rate=sample_rate)

        registry.register_bus("own", factory)
        open_bus("own://host:12/dev/x?a=1&b=%20", display, sample_rate=4000.0)
        address = Address("own", "host:12/dev/x", {"a": "1", "b": " "})
        assert given == [(address, display, 4000.0)]


def test_the_plant_of_this_test_lies_outside_the_package(display: Display) -> None:
    open_bus(URLS[3], display)
    module = sys.modules["plant_of_the_bus_contract"]
    assert not Path(str(module.__file__)).is_relative_to(Path(base.__file__).parents[1])
