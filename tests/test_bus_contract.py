"""Every bus keeps the contract of `tactile.bus.base`: states, ramps, what arrives wrong.

`bus_benches` says which buses there are, and what of them runs in real time. What only a bus can do
that plays as fast as it is written to is in `test_mock_bus`.
"""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from bus_benches import BENCHES, REAL, Bench, bench_of, built, steadied
from bus_contract import (
    FADE,
    RATE,
    ROUNDING,
    SLOW,
    VOLTAGE,
    assert_broken_off,
    assert_linear_ramp,
    assert_played,
    assert_rests,
    climb,
    level,
    limited,
    noise,
    planted,
    play,
    played,
    three,
)

from tactile.bus import base
from tactile.bus.base import DriveBlock, HostDeath, Wiring
from tactile.display import Display
from tactile.errors import BusError, BusStateError, InputError

pytestmark = pytest.mark.filterwarnings(
    "ignore:set(Daemon|Name).*:DeprecationWarning"
)  # pyserial's


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("amplifier"))


@pytest.fixture(scope="module", autouse=True)
def _plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    yield from planted(tmp_path_factory)


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Display:
    return three(tmp_path_factory)


@pytest.fixture
def slow(display: Display) -> Display:
    """Give the same with a slew limit that ramps can be seen in."""
    return limited(display, slew=SLOW)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    yield from bench_of(request.param, request)


@pytest.fixture(autouse=True)
def _no_wait_for_adapters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Open slcan without the 2 s that python-can gives an Arduino to boot."""
    clock = SimpleNamespace(time=time.time, sleep=lambda seconds: None)
    monkeypatch.setattr("can.interfaces.slcan.time", clock)


@pytest.mark.parametrize("bench", BENCHES, indirect=True)
@steadied
class TestStates:
    """Which calls are allowed, and what ends."""

    def test_opens_idle_for_its_display_and_declares_what_host_death_does(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        assert bus.state == "idle"
        assert bus.status == base.Status("idle")
        assert bus.wiring == Wiring.of(display, RATE)
        assert bus.on_host_death in get_args(HostDeath)
        assert bus.counters == base.Counters()
        assert not bench.put_out(bus).any()

    def test_start_is_refused_while_running_and_after_close(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        bus.start()
        with pytest.raises(BusStateError, match="start: the bus is running"):
            bus.start()
        assert bus.state == "running"
        bus.close()
        with pytest.raises(BusStateError, match="start: the bus is closed"):
            bus.start()

    def test_write_is_refused_unless_running(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        block = DriveBlock(0, level(1, 2, 3))
        for kind in (BusStateError, BusError, OSError, RuntimeError):
            with pytest.raises(kind, match="write: the bus is idle"):
                bus.write(block)
        for end in (bus.stop, bus.abort):
            bus.start()
            end()
            with pytest.raises(BusStateError, match="write: the bus is idle"):
                bus.write(block)
        bus.close()
        with pytest.raises(BusStateError, match="write: the bus is closed"):
            bus.write(block)
        assert not bench.put_out(bus).any()
        assert bus.counters.samples == 0

    def test_starts_again_after_stop_and_after_abort(self, bench: Bench, slow: Display) -> None:
        bus = bench.open(slow)
        volts = climb(np.array([10.0, 20, 30]), SLOW / RATE)
        for end in (bus.stop, bus.abort, bus.stop):
            before = len(bench.put_out(bus))
            bus.start()
            bus.write(DriveBlock(0, volts))
            end()
            assert bus.state == "idle"
            out = bench.put_out(bus)[before:]
            if end == bus.stop:
                assert_played(out, volts, bench.wire)
                assert_linear_ramp(out[len(volts) :], volts[-1], bench.wire)
            else:
                assert_broken_off(out, volts, SLOW / RATE, bench.wire)
        assert bus.counters.faults() == {}

    @pytest.mark.parametrize("first", ["stop", "abort"])
    def test_stop_abort_and_close_are_idempotent(
        self, bench: Bench, display: Display, first: str
    ) -> None:
        bus = bench.open(display)
        bus.stop()
        bus.abort()
        assert not bench.put_out(bus).any()
        bus.start()
        bus.write(DriveBlock(0, level(80, -60, 0)))
        getattr(bus, first)()
        ended = bench.put_out(bus)
        for again in (bus.stop, bus.abort, bus.abort, bus.stop, bus.close, bus.close):
            again()
        bus.stop()
        bus.abort()
        assert bus.state == "closed"
        assert np.array_equal(bench.put_out(bus), ended)

    def test_close_stops_first(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        bus.start()
        bus.write(DriveBlock(0, level(80, -60, 10)))
        bus.close()
        assert_linear_ramp(bench.put_out(bus)[10:], np.array([80.0, -60, 10]), bench.wire)

    def test_leaving_the_with_block_stops_and_closes(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        with bus as entered:
            assert entered is bus
            bus.start()
            bus.write(DriveBlock(0, level(80, -60, 10)))
        assert bus.state == "closed"
        assert_linear_ramp(bench.put_out(bus)[10:], np.array([80.0, -60, 10]), bench.wire)

    @pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
    def test_an_exception_in_the_with_block_aborts_closes_and_goes_on(
        self, bench: Bench, slow: Display, kind: type[BaseException]
    ) -> None:
        bus = bench.open(slow)
        line = climb(np.array([80.0, -60, 10]), SLOW / RATE)

        def failing() -> None:
            with bus:
                bus.start()
                bus.write(DriveBlock(0, line))
                raise kind("no more")

        with pytest.raises(kind, match="no more"):
            failing()
        assert bus.state == "closed"
        assert_broken_off(bench.put_out(bus), line, SLOW / RATE, bench.wire)

    def test_estop_goes_to_0_volts_at_the_slew_limit_and_only_clear_ends_it(
        self, bench: Bench, slow: Display
    ) -> None:
        bus = bench.open(slow)
        line = climb(np.array([80.0, -60, 10]), SLOW / RATE)
        bus.start()
        bus.write(DriveBlock(0, line))
        bus.estop()
        assert_broken_off(bench.put_out(bus), line, SLOW / RATE, bench.wire)
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
        assert bus.status == base.Status("idle")
        assert_played(played(bench, bus, level(1, 2, 3)), level(1, 2, 3), bench.wire)

    def test_estop_holds_where_nothing_played(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        bus.estop()
        with pytest.raises(BusStateError, match="start: the bus is estopped"):
            bus.start()
        bus.clear()
        bus.start()
        bus.close()
        bus.estop()
        assert bus.state == "closed"


@pytest.mark.parametrize("bench", BENCHES, indirect=True)
@steadied
class TestRamps:
    """How it comes to 0 V, and how fast it moves at all."""

    def test_stop_is_a_straight_ramp_of_the_fades_length_to_exactly_0_volts(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        for volts in [(100, -100, 0), (1e-3, -33.3, 77.7), (0, 0, 0)]:
            out = played(bench, bus, level(*volts))
            assert_linear_ramp(out[10:], np.array(volts, np.float64), bench.wire)

    @pytest.mark.parametrize("rate", [5000.0, 16000.0])
    def test_ramps_take_their_time_at_any_sample_rate(
        self, bench: Bench, display: Display, slow: Display, rate: float
    ) -> None:
        if rate not in bench.rates:
            pytest.skip("more than its wire carries")
        start = np.array([80.0, -60, 10])
        out = played(bench, bench.open(display, rate), start[None])
        assert_linear_ramp(out[1:], start, bench.wire, round(20e-3 * rate))
        bus, line = bench.open(slow, rate), climb(start, SLOW / rate)
        bus.start()
        bus.write(DriveBlock(0, line))
        bus.abort()
        assert_broken_off(bench.put_out(bus), line, SLOW / rate, bench.wire)

    @pytest.mark.parametrize("fade", [1e-5, 62.5e-6, 1e-3])
    def test_stop_ends_at_0_volts_however_short_the_fade(
        self, bench: Bench, display: Display, fade: float
    ) -> None:
        out = played(bench, bench.open(limited(display, fade=fade)), level(40, -30, 20))
        assert_played(out, level(40, -30, 20), bench.wire)
        assert len(out) == 10 + max(1, round(fade * RATE))
        assert_rests(out)

    @pytest.mark.parametrize("slew", [0.7e6, 54321.0, 0.1e6 / 3])
    def test_abort_goes_to_exactly_0_volts_at_the_slew_limit(
        self, bench: Bench, display: Display, slew: float
    ) -> None:
        bus, step = bench.open(limited(display, slew=slew)), slew / RATE
        multiple = np.clip(step * np.array([1, -2, 3]), -VOLTAGE, VOLTAGE)
        for start in (*noise(2), multiple, np.zeros(3)):
            before, line = len(bench.put_out(bus)), climb(start, step)
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.abort()
            assert_broken_off(bench.put_out(bus)[before:], line, step, bench.wire)

    def test_abort_asks_no_more_current_than_the_display_allows(
        self, bench: Bench, display: Display
    ) -> None:
        weak = limited(display, current=0.1e-3)
        step = weak.limits.step(RATE, weak.capacitance)
        assert step < SLOW / RATE
        bus, line = bench.open(weak), climb(np.array([50.0, -30, 20]), step)
        bus.start()
        bus.write(DriveBlock(0, line))
        bus.abort()
        assert_broken_off(bench.put_out(bus), line, step, bench.wire)

    def test_no_sample_steps_further_than_the_slew_limit(self, bench: Bench, slow: Display) -> None:
        volts = np.concatenate([noise(300), level(0, 0, 0, count=40)])
        out = played(bench, bench.open(slow), volts, [100, 200])
        steps = np.abs(np.diff(out, axis=0, prepend=np.zeros((1, 3))))
        assert steps.max() == pytest.approx(SLOW / RATE, abs=bench.wire)
        assert np.all(steps <= SLOW / RATE + ROUNDING)

    def test_a_slew_limit_that_breaks_the_promise_to_be_at_0_volts_is_refused(
        self, bench: Bench, display: Display
    ) -> None:
        with pytest.raises(InputError, match="slew limit 4000 V/s: takes 25 ms") as found:
            bench.open(limited(display, slew=4e3))
        assert "\n" not in str(found.value)

    def test_a_sample_rate_that_is_no_whole_number_is_refused(
        self, bench: Bench, display: Display
    ) -> None:
        with pytest.raises(InputError, match=r"sample_rate 8000.5 Hz: the protocol tells whole Hz"):
            bench.open(display, 8000.5)


@pytest.mark.parametrize("bench", BENCHES, indirect=True)
@steadied
class TestBlocks:
    """What arrives, also where it is wrong."""

    def test_a_short_gap_is_counted_and_bridged_by_a_straight_line(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        bus.start()
        bus.write(DriveBlock(0, level(10, 20, -30)))
        bus.write(DriveBlock(25, level(1, 2, 3)))
        bus.stop()
        line = np.linspace([10.0, 20, -30], [1.0, 2, 3], 17)
        expected = np.concatenate([level(10, 20, -30, count=9), line, level(1, 2, 3, count=9)])
        out = bench.put_out(bus)
        assert_played(out, expected, 2 * bench.wire)
        assert_linear_ramp(out[35:], np.array([1.0, 2, 3]), bench.wire)
        assert bus.counters.faults() == {"lost_samples": 15}
        assert bus.counters.samples == 20

    def test_a_gap_at_the_beginning_is_silent_and_what_follows_fades_in(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        bus.start(100)
        bus.write(DriveBlock(104, level(10, 20, -30, count=FADE + 10)))
        bus.stop()
        rise = np.minimum(np.arange(1, FADE + 11) / FADE, 1)[:, None] * [10.0, 20, -30]
        out = bench.put_out(bus)
        assert not out[:4].any()
        assert_played(out[4:], rise, bench.wire)
        assert bus.counters.faults() == {"lost_samples": 4}

    def test_a_long_gap_fades_out_and_in_again(self, bench: Bench, display: Display) -> None:
        bus, gap = bench.open(display), 1600
        bus.start()
        bus.write(DriveBlock(0, level(10, 20, -30)))
        bus.write(DriveBlock(gap, level(1, 2, 3, count=2 * FADE)))
        bus.stop()
        assert bus.counters.faults() == {"lost_samples": gap - 10, "underruns": bench.boards}
        out = bench.put_out(bus)
        assert_linear_ramp(out[10 : 10 + FADE], out[9], bench.wire)
        assert not out[10 + FADE : gap].any()
        rise = np.minimum(np.arange(1, 2 * FADE + 1) / FADE, 1)[:, None] * [1.0, 2, 3]
        assert_played(out[gap:], rise, bench.wire)
        assert_linear_ramp(out[gap + 2 * FADE :], np.array([1.0, 2, 3]), bench.wire)

    def test_a_resend_is_dropped_counted_and_otherwise_changes_nothing(
        self, bench: Bench, display: Display
    ) -> None:
        volts = noise(300)
        once, twice = bench.open(display), bench.open(display)
        expected = played(bench, once, volts, [100, 200])
        twice.start()
        for start in (0, 100, 200):
            for _ in range(2):
                twice.write(DriveBlock(start, volts[start : start + 100]))
        twice.write(DriveBlock(0, volts))
        twice.stop()
        assert np.array_equal(bench.put_out(twice), expected)
        assert twice.counters.faults() == {"repeated_samples": 600}
        assert twice.counters.samples == once.counters.samples

    def test_a_block_from_long_ago_does_not_turn_the_stream_back(
        self, bench: Bench, display: Display
    ) -> None:
        bus, volts = bench.open(display), noise(400)
        bus.start()
        play(bus, volts[:300], [100, 200])
        bus.write(DriveBlock(0, volts[:50]))
        bus.write(DriveBlock(-500, volts[:50]))
        bus.write(DriveBlock(300, volts[300:]))
        bus.stop()
        assert_played(bench.put_out(bus), volts, bench.wire)
        assert bus.counters.faults() == {"repeated_samples": 100}
        assert bus.counters.samples == 400

    def test_of_an_overlapping_block_the_new_part_is_played(
        self, bench: Bench, display: Display
    ) -> None:
        bus, volts = bench.open(display), noise(150)
        bus.start()
        bus.write(DriveBlock(0, volts[:100]))
        bus.write(DriveBlock(70, volts[70:]))
        bus.stop()
        assert_played(bench.put_out(bus), volts, bench.wire)
        assert bus.counters.faults() == {"repeated_samples": 30}
        assert bus.counters.samples == 150

    def test_what_lies_before_the_start_is_dropped(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        bus.start(1000)
        bus.write(DriveBlock(990, level(50, 50, 50)))
        bus.write(DriveBlock(1000, level(1, 2, 3)))
        bus.stop()
        assert_played(bench.put_out(bus), level(1, 2, 3), bench.wire)
        assert bus.counters.faults() == {"repeated_samples": 10}

    def test_what_is_not_finite_is_counted_and_played_as_0_volts(
        self, bench: Bench, display: Display
    ) -> None:
        bus, volts = bench.open(display), level(10, 20, -30)
        volts[3, 1], volts[4, 1], volts[4, 2] = math.nan, math.inf, -math.inf
        expected = np.where(np.isfinite(volts), volts, 0.0)
        assert_played(played(bench, bus, volts), expected, bench.wire)
        assert bus.counters.faults() == {"invalid_samples": 3}

    def test_volts_over_the_limit_are_counted_and_never_put_out(
        self, bench: Bench, display: Display
    ) -> None:
        bus, volts = bench.open(display), level(VOLTAGE, -VOLTAGE, 0)
        volts[2] = 101, -250, 30
        volts[5] = np.nextafter(VOLTAGE, 200), -1e300, math.nan
        out = played(bench, bus, volts)
        assert np.all(np.abs(out) <= VOLTAGE)
        assert_played(out, np.clip(np.nan_to_num(volts), -VOLTAGE, VOLTAGE), bench.wire)
        assert bus.counters.faults() == {"clipped_samples": 4, "invalid_samples": 1}

    def test_volts_at_the_limit_are_no_fault(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        played(bench, bus, level(VOLTAGE, -VOLTAGE, 0))
        assert bus.counters.faults() == {}

    def test_nothing_bad_survives_into_the_ramps(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        for end in (bus.stop, bus.abort):
            bus.start()
            bus.write(DriveBlock(0, level(math.nan, math.inf, 1e9)))
            end()
            out = bench.put_out(bus)
            assert np.all(np.abs(out) <= VOLTAGE)
            assert_rests(out)

    def test_a_block_without_a_column_per_channel_is_refused_and_nothing_played(
        self, bench: Bench, display: Display
    ) -> None:
        bus = bench.open(display)
        bus.start()
        for shape in [(10,), (10, 2), (10, 4), (3, 10), (1, 10, 3), ()]:
            with pytest.raises(InputError, match=r"write: block of shape .*, needs \(S, 3\)"):
                bus.write(DriveBlock(0, np.ones(shape)))
        assert bus.state == "running"
        bus.write(DriveBlock(0, level(1, 2, 3)))
        bus.stop()
        assert_played(bench.put_out(bus), level(1, 2, 3), bench.wire)
        assert bus.counters.faults() == {}

    @pytest.mark.parametrize("cuts", ["1", "64", "random", "whole"])
    def test_how_the_stream_is_cut_does_not_matter(
        self, bench: Bench, display: Display, cuts: str
    ) -> None:
        bus, volts = bench.open(display), noise(500)
        volts[100:110] = math.nan
        volts[200:220] *= 3
        edges = {
            "1": list(range(1, 500)),
            "64": list(range(64, 500, 64)),
            "random": sorted(np.random.default_rng(1).integers(0, 500, 20).tolist()),
            "whole": [],
        }[cuts]
        out = played(bench, bus, volts, edges)
        assert_played(out, np.clip(np.nan_to_num(volts), -VOLTAGE, VOLTAGE), bench.wire)
        assert_linear_ramp(out[500:], out[499], bench.wire)
        over = int(np.count_nonzero(np.abs(np.nan_to_num(volts)) > VOLTAGE))
        assert over > 0
        assert bus.counters.faults() == {"invalid_samples": 30, "clipped_samples": over}
        assert bus.counters.samples == 500

    def test_an_empty_block_is_no_fault(self, bench: Bench, display: Display) -> None:
        bus = bench.open(display)
        bus.start()
        bus.write(DriveBlock(0, np.zeros((0, 3))))
        bus.write(DriveBlock(0, level(1, 2, 3)))
        bus.stop()
        assert_played(bench.put_out(bus), level(1, 2, 3), bench.wire)
        assert bus.counters.faults() == {}

    def test_the_callers_array_is_neither_changed_nor_kept(
        self, bench: Bench, display: Display
    ) -> None:
        bus, volts = bench.open(display), level(150, math.nan, 3)
        same = volts.copy()
        bus.start()
        bus.write(DriveBlock(0, volts))
        assert np.array_equal(volts, same, equal_nan=True)
        volts[:] = level(9, 9, 9)
        bus.write(DriveBlock(10, volts))
        volts[:] = 77
        bus.stop()
        expected = np.concatenate([level(100, 0, 3), level(9, 9, 9)])
        assert_played(bench.put_out(bus), expected, bench.wire)

    def test_positions_begin_where_start_says(self, bench: Bench, display: Display) -> None:
        bus, volts = bench.open(display), noise(30)
        for begin in (10**12, 0, 5):
            before = len(bench.put_out(bus))
            bus.start(begin)
            play(bus, volts, [10, 20], begin)
            bus.stop()
            assert_played(bench.put_out(bus)[before:], volts, bench.wire)
        assert bus.counters.faults() == {}


SLCAN = pytest.param("slcan", marks=pytest.mark.ci)  # has the least time to spare


@pytest.mark.parametrize("bench", [*REAL[:-1], SLCAN], indirect=True)
@steadied
class TestRealLinks:
    """What the default run sees of each link in real time; all else runs with ``-m ci``."""

    def test_a_stream_is_put_out_stopped_and_broken_off(self, bench: Bench, slow: Display) -> None:
        bus, step = bench.open(slow), SLOW / bench.rate
        volts = climb(np.array([80.0, -60, 10]), step)
        out = played(bench, bus, volts, list(range(16, len(volts), 16)))
        assert_played(out, volts, bench.wire)
        fade = round(20e-3 * bench.rate)
        assert_linear_ramp(out[len(volts) :], volts[-1], bench.wire, fade)
        bus.start()
        bus.write(DriveBlock(0, volts))
        bus.estop()
        assert_broken_off(bench.put_out(bus)[len(out) :], volts, step, bench.wire)
        bus.clear()
        assert bus.counters.faults() == {}
