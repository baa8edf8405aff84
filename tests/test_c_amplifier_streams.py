"""Tests of the C amplifier beyond the vectors: long streams, fades, its log."""

from pathlib import Path

import pytest
from c_amplifier_rig import (
    FAULTY,
    HEARTBEAT,
    LOG,
    MS,
    NOTHING,
    PERIOD,
    POLL,
    STOP,
    T0,
    Run,
    arm,
    hello,
    limits,
    owned,
    packet,
    pcm,
    playing,
    start,
)


def test_a_buffer_of_any_depth_goes_round_many_times(build: Path, tmp_path: Path) -> None:
    """64 ms at 15 kHz are 960 samples; 1000 do not divide a turn of 16 bits either."""
    codes = [30 * (500 - abs(500 - k % 1000)) for k in range(4000)]
    run = playing(codes)
    for k in range(0, 4000, 800):
        run.feed(T0 + k * PERIOD, owned(HEARTBEAT))
    run.feed(T0 + 3999 * PERIOD, packet(POLL))
    run.run(build, tmp_path, "--fifo", "1000", "--rate-max", "15000")
    values = [x.codes[0] for x in run.instants if x.tick >= T0]
    assert values == codes
    assert run.status()["late_samples"] == run.status()["future_samples"] == 0


@pytest.mark.parametrize(
    ("fade_us", "count"), [(19949, 199), (19950, 200), (19999, 200), (49, 1), (1, 1)]
)
def test_a_fade_takes_the_nearest_number_of_instants_halves_up(
    build: Path, tmp_path: Path, fade_us: int, count: int
) -> None:
    """19.95 ms at 10 kHz are 199.5 instants; a fade has one at least (SPEC.md, 8.3)."""
    period = 100
    run = Run()
    run.feed(0, hello())
    run.feed(0, limits(0, fade_us=fade_us))
    run.feed(0, arm(rate=10000))
    run.feed(1 * MS, start(0, 10))
    run.feed(1 * MS, pcm(0, [20000] * 200))
    run.feed(1 * MS, pcm(200, [20000] * 200))
    run.feed(T0 + 100 * period, owned(STOP))
    run.feed(T0 + 350 * period, kind=NOTHING)
    run.run(build, tmp_path, "--slew-v-per-s", "100000000")
    fade = [x.codes[0] for x in run.instants if x.tick > T0 + 100 * period]
    assert fade[:count] == [20000 * g // count for g in range(count - 1, -1, -1)]
    assert not any(fade[count:])


@pytest.mark.parametrize("code", [9, 10, 99, 100, 199, 200, 255])
def test_a_fault_is_logged_by_its_number(build: Path, tmp_path: Path, code: int) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(1 * MS, bytes([code]), FAULTY)
    run.run(build, tmp_path)
    assert [p for _, _, p in run.packets(LOG)] == [b"\3fault %d" % code]
