"""Tests of the contract of `tactile.bus.base`: the ways of a bus to 0 V."""

import numpy as np
import pytest
from bus_benches import BENCHES, Bench
from bus_contract import (
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
    on,
    played,
)

from tactile.bus.base import DriveBlock
from tactile.display.display import Display
from tactile.errors import InputError


@on(BENCHES)
class TestRamps:
    """Tests of the ways to 0 V, and of the speed of any movement."""

    def test_stop_is_a_straight_ramp_of_the_fades_length_to_exactly_0_volts(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        for volts in [(100, -100, 0), (1e-3, -33.3, 77.7), (0, 0, 0)]:
            out = played(bench, bus, level(*volts))
            assert_linear_ramp(out[10:], np.array(volts, np.float64), bench.wire)

    @pytest.mark.parametrize("rate", [5000.0, 16000.0])
    def test_ramps_take_their_time_at_any_sample_rate(
        self, bench: Bench, three: Display, slow: Display, rate: float
    ) -> None:
        if rate not in bench.rates:
            pytest.skip("more than its wire carries")
        start = np.array([80.0, -60, 10])
        out = played(bench, bench.open(three, rate), start[None])
        assert_linear_ramp(out[1:], start, bench.wire, round(20e-3 * rate))
        bus, line = bench.open(slow, rate), climb(start, SLOW / rate)
        bus.start()
        bus.write(DriveBlock(0, line))
        bus.abort()
        assert_broken_off(bench.put_out(bus), line, SLOW / rate, bench.wire)

    @pytest.mark.parametrize("fade", [1e-5, 62.5e-6, 1e-3])
    def test_stop_ends_at_0_volts_however_short_the_fade(
        self, bench: Bench, three: Display, fade: float
    ) -> None:
        out = played(bench, bench.open(limited(three, fade=fade)), level(40, -30, 20))
        assert_played(out, level(40, -30, 20), bench.wire)
        assert len(out) == 10 + max(1, round(fade * RATE))
        assert_rests(out)

    @pytest.mark.parametrize("slew", [0.7e6, 54321.0, 0.1e6 / 3])
    def test_abort_goes_to_exactly_0_volts_at_the_slew_limit(
        self, bench: Bench, three: Display, slew: float
    ) -> None:
        bus, step = bench.open(limited(three, slew=slew)), slew / RATE
        multiple = np.clip(step * np.array([1, -2, 3]), -VOLTAGE, VOLTAGE)
        for start in (*noise(2), multiple, np.zeros(3)):
            before, line = len(bench.put_out(bus)), climb(start, step)
            bus.start()
            bus.write(DriveBlock(0, line))
            bus.abort()
            assert_broken_off(bench.put_out(bus)[before:], line, step, bench.wire)

    def test_abort_asks_no_more_current_than_the_display_allows(
        self, bench: Bench, three: Display
    ) -> None:
        weak = limited(three, current=0.1e-3)
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
        self, bench: Bench, three: Display
    ) -> None:
        with pytest.raises(InputError, match="slew limit 4000 V/s: takes 25 ms") as found:
            bench.open(limited(three, slew=4e3))
        assert "\n" not in str(found.value)

    def test_a_sample_rate_that_is_no_whole_number_is_refused(
        self, bench: Bench, three: Display
    ) -> None:
        with pytest.raises(InputError, match=r"sample_rate 8000.5 Hz: the protocol tells whole Hz"):
            bench.open(three, 8000.5)
