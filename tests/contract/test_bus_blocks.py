"""Tests of the contract of `tactile.bus.base`: the samples that arrive, also when wrong."""

import math

import numpy as np
import pytest
from bus_benches import BENCHES, Bench
from bus_contract import (
    FADE,
    VOLTAGE,
    assert_linear_ramp,
    assert_played,
    assert_rests,
    level,
    noise,
    on,
    play,
    played,
)

from tactile.bus.base import DriveBlock
from tactile.display.display import Display
from tactile.errors import InputError


@on(BENCHES)
class TestBlocks:
    """Tests of the samples that arrive, also when they are wrong."""

    def test_a_short_gap_is_counted_and_bridged_by_a_straight_line(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
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
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
        bus.start(100)
        bus.write(DriveBlock(104, level(10, 20, -30, count=FADE + 10)))
        bus.stop()
        rise = np.minimum(np.arange(1, FADE + 11) / FADE, 1)[:, None] * [10.0, 20, -30]
        out = bench.put_out(bus)
        assert not out[:4].any()
        assert_played(out[4:], rise, bench.wire)
        assert bus.counters.faults() == {"lost_samples": 4}

    def test_a_long_gap_fades_out_and_in_again(self, bench: Bench, three: Display) -> None:
        bus, gap = bench.open(three), 1600
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
        self, bench: Bench, three: Display
    ) -> None:
        volts = noise(300)
        once, twice = bench.open(three), bench.open(three)
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
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), noise(400)
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
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), noise(150)
        bus.start()
        bus.write(DriveBlock(0, volts[:100]))
        bus.write(DriveBlock(70, volts[70:]))
        bus.stop()
        assert_played(bench.put_out(bus), volts, bench.wire)
        assert bus.counters.faults() == {"repeated_samples": 30}
        assert bus.counters.samples == 150

    def test_what_lies_before_the_start_is_dropped(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        bus.start(1000)
        bus.write(DriveBlock(990, level(50, 50, 50)))
        bus.write(DriveBlock(1000, level(1, 2, 3)))
        bus.stop()
        assert_played(bench.put_out(bus), level(1, 2, 3), bench.wire)
        assert bus.counters.faults() == {"repeated_samples": 10}

    def test_what_is_not_finite_is_counted_and_played_as_0_volts(
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), level(10, 20, -30)
        volts[3, 1], volts[4, 1], volts[4, 2] = math.nan, math.inf, -math.inf
        expected = np.where(np.isfinite(volts), volts, 0.0)
        assert_played(played(bench, bus, volts), expected, bench.wire)
        assert bus.counters.faults() == {"invalid_samples": 3}

    def test_volts_over_the_limit_are_counted_and_never_put_out(
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), level(VOLTAGE, -VOLTAGE, 0)
        volts[2] = 101, -250, 30
        volts[5] = np.nextafter(VOLTAGE, 200), -1e300, math.nan
        out = played(bench, bus, volts)
        assert np.all(np.abs(out) <= VOLTAGE)
        assert_played(out, np.clip(np.nan_to_num(volts), -VOLTAGE, VOLTAGE), bench.wire)
        assert bus.counters.faults() == {"clipped_samples": 4, "invalid_samples": 1}

    def test_volts_at_the_limit_are_no_fault(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        played(bench, bus, level(VOLTAGE, -VOLTAGE, 0))
        assert bus.counters.faults() == {}

    def test_nothing_bad_survives_into_the_ramps(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        for end in (bus.stop, bus.abort):
            bus.start()
            bus.write(DriveBlock(0, level(math.nan, math.inf, 1e9)))
            end()
            out = bench.put_out(bus)
            assert np.all(np.abs(out) <= VOLTAGE)
            assert_rests(out)

    def test_a_block_without_a_column_per_channel_is_refused_and_nothing_played(
        self, bench: Bench, three: Display
    ) -> None:
        bus = bench.open(three)
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
        self, bench: Bench, three: Display, cuts: str
    ) -> None:
        bus, volts = bench.open(three), noise(500)
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

    def test_an_empty_block_is_no_fault(self, bench: Bench, three: Display) -> None:
        bus = bench.open(three)
        bus.start()
        bus.write(DriveBlock(0, np.zeros((0, 3))))
        bus.write(DriveBlock(0, level(1, 2, 3)))
        bus.stop()
        assert_played(bench.put_out(bus), level(1, 2, 3), bench.wire)
        assert bus.counters.faults() == {}

    def test_the_callers_array_is_neither_changed_nor_kept(
        self, bench: Bench, three: Display
    ) -> None:
        bus, volts = bench.open(three), level(150, math.nan, 3)
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

    def test_positions_begin_where_start_says(self, bench: Bench, three: Display) -> None:
        bus, volts = bench.open(three), noise(30)
        for begin in (10**12, 0, 5):
            before = len(bench.put_out(bus))
            bus.start(begin)
            play(bus, volts, [10, 20], begin)
            bus.stop()
            assert_played(bench.put_out(bus)[before:], volts, bench.wire)
        assert bus.counters.faults() == {}
