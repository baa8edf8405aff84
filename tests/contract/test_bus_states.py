"""Tests of the contract of `tactile.bus.base`: states of a bus, and links in real time."""

from typing import get_args

import numpy as np
import pytest
from bus_benches import BENCHES, REAL, Bench
from bus_contract import (
    RATE,
    SLOW,
    assert_broken_off,
    assert_linear_ramp,
    assert_played,
    climb,
    level,
    on,
    played,
)

from tactile.bus import base
from tactile.bus.base import DriveBlock, HostDeath, Wiring
from tactile.display.display import Display
from tactile.errors import BusError, BusStateError


@on(BENCHES)
class TestStates:
    """Tests of the calls that each state allows, and of what ends a state."""

    def test_opens_idle_for_its_display_and_declares_what_host_death_does(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        assert bus.state == "idle"
        assert bus.status == base.BusStatus("idle")
        assert bus.wiring == Wiring.of(three, RATE)
        assert bus.on_host_death in get_args(HostDeath)
        assert bus.counters == type(bus.counters)()
        assert not bench.put_out(bus).any()

    def test_start_is_refused_while_running_and_after_close(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        bus.start()
        with pytest.raises(BusStateError, match="start: the bus is running"):
            bus.start()
        assert bus.state == "running"
        bus.close()
        with pytest.raises(BusStateError, match="start: the bus is closed"):
            bus.start()

    def test_write_is_refused_unless_running(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
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
        self, bench: Bench, three: Display, first: str
    ) -> None:
        bus = bench.open(three)
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

    def test_close_stops_first(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        bus.start()
        bus.write(DriveBlock(0, level(80, -60, 10)))
        bus.close()
        assert_linear_ramp(bench.put_out(bus)[10:], np.array([80.0, -60, 10]), bench.wire)

    def test_leaving_the_with_block_stops_and_closes(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
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
        dropped = bus.counters.dropped_samples
        bus.write(DriveBlock(len(line), level(1, 2, 3)))
        assert bus.counters.dropped_samples == dropped + 10
        with pytest.raises(BusStateError, match=r"start: the bus is estopped.*; clear it"):
            bus.start()
        bus.clear()
        bus.clear()
        assert bus.status == base.BusStatus("idle")
        bus.stop()
        with pytest.raises(BusStateError, match="write: the bus is idle"):
            bus.write(DriveBlock(0, line))
        assert_played(played(bench, bus, level(1, 2, 3)), level(1, 2, 3), bench.wire)

    def test_positions_are_due_one_after_another_at_the_sample_rate(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        bus.start(1000)
        bus.write(DriveBlock(1000, level(1, 2, 3)))
        steps = np.diff([bus.due(1000 + k) for k in (0, 16, 8000)])
        # a clock of the amplifier's own is known to 200 ppm and rounds to ticks of 1 µs
        assert steps == pytest.approx(np.array([16, 7984]) / bus.wiring.sample_rate, rel=1e-3)
        assert bus.ahead >= 0
        bus.stop()

    def test_currents_come_only_where_they_were_asked_for(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        bus.start()
        bus.write(DriveBlock(0, level(1, 2, 3, count=400)))
        bus.stop()
        assert not bus.correlates
        assert bus.take_correlations() == []
        assert bus.correlation_counters.windows == bus.correlation_counters.faults == 0

    def test_estop_holds_where_nothing_played(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        bus.estop()
        with pytest.raises(BusStateError, match="start: the bus is estopped"):
            bus.start()
        bus.clear()
        bus.start()
        bus.close()
        bus.estop()
        assert bus.state == "closed"


@pytest.mark.realtime
@on(REAL)
class TestRealLinks:
    """Tests of each link in real time, also of slcan, which has the least to spare."""

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
