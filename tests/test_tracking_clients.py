"""Tests of tracking with clients of all kinds, whatever times they give."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracking_rig import Run, speeds, stroke

from benchmarks import tracking as bench
from benchmarks.tracking import SamplingClient
from tactile.arrays import Floats
from tactile.tracking.clock_map import ClockMap
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

# What clients may send


def test_the_first_velocity_is_believed() -> None:
    run = Run()
    run.tracker.add(FingerSample(0.0, 0.0, 0.0, 0.0, 0.5, (0.2, -0.1)))
    run.until(0.01)
    assert run.place == pytest.approx(np.outer(run.times, [0.2, -0.1]), abs=1e-9)


def test_order_of_arrival_does_not_matter_between_blocks() -> None:
    rows = stroke(0.1, 0, 1.0, rate=1000)
    ordered, mixed = Run(), Run()
    for k in range(0, len(rows), 2):
        ordered.samples(rows[k : k + 2])
        mixed.until(rows[k][0])
        mixed.samples([]).until(rows[k + 1][0])
        for time, x, y, force in reversed(rows[k : k + 2]):
            mixed.tracker.add(FingerSample(time, rows[k + 1][0], x, y, force))
    assert np.abs(ordered.place[800:] - mixed.place[800 : len(ordered.place)]).max() < 1e-6
    assert mixed.tracker.late == 0


def test_late_and_double_samples_are_counted_and_change_nothing() -> None:
    plain, other = Run(), Run()
    rows = stroke(0.1, 0, 0.5)
    for k, row in enumerate(rows):
        plain.samples([row]).block()
        other.samples([row]).block()
        other.tracker.add(FingerSample(row[0], *row))
        if k:
            other.tracker.add(FingerSample(rows[k - 1][0], row[0], 0.4, 0.0, 0.5))
        plain.block()
        other.block()
    assert other.tracker.late == 2 * len(rows) - 1
    assert np.array_equal(plain.place, other.place)
    assert np.array_equal(plain.force, other.force)


VALID = FingerSample(0.1, 0.1, 0.0, 0.0, 0.5)
NONSENSE = [
    VALID._replace(x=math.nan),
    VALID._replace(y=math.inf),
    VALID._replace(x=1e9),
    VALID._replace(normal_force=math.nan),
    VALID._replace(normal_force=-1.0),
    VALID._replace(normal_force=1e9),
    VALID._replace(time=math.nan),
    VALID._replace(time=math.inf),
    VALID._replace(time=1e9),
    VALID._replace(arrival=math.nan),
    VALID._replace(arrival=1e9),
    VALID._replace(velocity=(math.nan, 0.0)),
    VALID._replace(velocity=(1e5, 0.0)),
]


@pytest.mark.parametrize("sample", NONSENSE, ids=repr)
def test_nonsense_is_counted_and_changes_nothing(sample: FingerSample) -> None:
    run = Run().samples(stroke(0.1, 0, 0.1))
    run.tracker.add(sample)
    plain = Run().samples(stroke(0.1, 0, 0.1)).samples(stroke(0.1, 0.12, 0.3))
    run.samples(stroke(0.1, 0.12, 0.3))
    assert run.tracker.invalid == 1
    assert np.array_equal(run.place, plain.place)


def test_what_nobody_asks_for_does_not_pile_up() -> None:
    tracker = ContactTracker()
    for k in range(2560):
        tracker.add(FingerSample(k * 1e-3, k * 1e-3, 0.0, 0.0, 0.5))
    assert tracker.dropped == 2560 - 256, "256 wait: a quarter of a second of 1000 a second"


anything = st.floats() | st.floats(-1, 1)
samples = st.tuples(
    st.floats(-0.05, 0.05) | st.floats(),
    anything,
    anything,
    st.just(0.5) | st.just(0.0) | anything,
    st.none() | st.tuples(anything, anything),
    st.integers(0, 30),
)


@pytest.mark.ci
@given(st.lists(samples, max_size=30), st.sampled_from([1, 16, 64]))
def test_whatever_comes_what_goes_out_is_a_finger(rows: list[tuple[Any, ...]], block: int) -> None:
    """Nothing raises; places are finite, forces plausible, and no jump is audible."""
    run = Run(block=block)
    for offset, x, y, force, velocity, blocks in rows:
        run.tracker.add(FingerSample(run.now + offset, run.now, x, y, force, velocity))
        for _ in range(blocks):
            run.block()
    run.block()
    assert np.all(np.isfinite(run.place))
    assert run.force.min() >= -1e-12
    assert run.force.max() <= 50 * 1.05  # N, more than a finger that slides has
    heard = np.minimum(run.force[1:], run.force[:-1]) > 0
    # what is left to correct, 20 mm at most, goes within 3 ms; 30 m/s for the course's own speed
    assert np.all(speeds(run.place)[heard] < 20e-3 / 3e-3 + 30)


def test_times_that_make_no_sense_do_not_stop_it() -> None:
    run = Run().samples(stroke(0.1, 0, 0.2))
    tracker = run.tracker
    for times in ([0.1, 0.1], [-1e6, 0.0], [1e9], [5.0, 4.0], []):
        place, force = tracker.at(np.array(times), 0.2)
        assert place.shape == (len(times), 2)
        assert force.shape == (len(times),)
        assert np.all(np.isfinite(place))
        assert np.all(np.isfinite(force))


# The clock


def mapped(
    drift: float = 0.0,
    *,
    seed: int = 0,
    seconds: float = 30.0,
    rate: float = 90.0,
    base: float = 0.0,
) -> tuple[Floats, Floats, Floats]:
    """Return true times, client times and mapped times with delays of 5 ms rms above a base."""
    rng, clock = np.random.default_rng(seed), ClockMap()
    true = np.arange(0, seconds, 1 / rate)
    client = 1e5 + true * (1 + drift)
    arrival = np.maximum.accumulate(true + base + np.abs(rng.normal(0, 0.005, len(true))))
    ours = [clock(c, a) for c, a in zip(client.tolist(), arrival.tolist(), strict=True)]
    return true, client, np.array(ours)


@pytest.mark.parametrize("drift", [0.0, 3e-4, -3e-4])
def test_the_clock_map_takes_jitter_off_and_follows_drift(drift: float) -> None:
    """300 ppm over the window of 2 s are 0.6 ms; the least of 180 delays is 0.04 ms or so."""
    true, _, ours = mapped(drift)
    late = true > 1.5
    assert np.abs(ours - true)[late].max() < 1e-3
    assert np.abs(np.diff(ours - true))[late[1:]].max() < 0.021 / 90


def test_the_clock_map_is_off_by_the_least_delay_which_nobody_knows() -> None:
    true, _, ours = mapped(base=0.02)
    assert (ours - true)[true > 1.5] == pytest.approx(0.02, abs=5e-4)


def test_mapped_time_runs_within_2_percent_of_the_clients() -> None:
    for seed in range(5):
        _, client, ours = mapped(3e-4, seed=seed, seconds=5)
        pace = np.diff(ours) / np.diff(client)
        assert np.abs(pace - 1).max() <= 0.02 * (1 + 1e-6)


@pytest.mark.parametrize("jump", [10.0, -10.0, 3600.0])
def test_a_clients_clock_may_jump(jump: float) -> None:
    clock, times = ClockMap(), np.arange(0, 4, 1 / 90)
    ours = [clock(t + 50 + (jump if t > 2 else 0), t + 0.001) for t in times.tolist()]
    assert clock.jumps == 1
    assert np.all(np.diff(ours) > 0)
    assert np.array(ours) == pytest.approx(times + 0.001, abs=1e-9)


def test_a_stall_is_taken_in_without_running_backward() -> None:
    """All that was sent in 2 s comes at once."""
    clock, times = ClockMap(), np.arange(0, 9, 1 / 90)
    arrivals = np.where((times > 2) & (times < 4), 4.0, times)
    ours = [clock(t, a) for t, a in zip(times.tolist(), arrivals.tolist(), strict=True)]
    assert np.all(np.diff(ours) >= 0)
    assert np.abs(np.array(ours) - times)[times > 4].max() <= 0.05 + 1e-9, "more begins anew"
    assert np.abs(np.array(ours) - times)[times > 8].max() < 1e-9


@given(st.lists(st.tuples(st.floats() | st.floats(0, 2), st.floats(0, 0.2)), max_size=40))
def test_mapped_time_never_runs_backward_for_ascending_client_times(
    steps: list[tuple[float, float]],
) -> None:
    clock, arrival, newest, last = ClockMap(), 0.0, -math.inf, -math.inf
    for client, passed in steps:
        arrival += passed
        ours = clock(client, arrival)
        assert math.isfinite(ours) or not math.isfinite(client)
        if math.isfinite(client) and client > newest and newest > -math.inf:
            assert ours >= last
        if math.isfinite(client) and client > newest:
            newest, last = client, ours


def test_without_a_client_time_it_is_the_arrival() -> None:
    clock = ClockMap()
    assert clock(None, 3.0) == 3.0
    assert clock(math.nan, 4.0) == 4.0
    assert clock.invalid == 1


def test_the_clock_map_remembers_no_more_than_its_window() -> None:
    clock = ClockMap()
    for k in range(20000):
        clock(k * 1e-3, k * 1e-3 + 1e-3)
    assert len(clock._least) <= 8 + 1, "of each quarter of a second of the last 2 s one"


def test_a_client_of_another_rate_is_a_client() -> None:
    """The bench's streams are what they say."""
    lossy = bench.sampled(bench.line(0.1, 5.0), replace(SamplingClient(), loss=0.3), 0)
    assert len(lossy.time) == pytest.approx(0.7 * 90 * (1.5 + 5), rel=0.1)  # s
    assert np.all(np.diff(lossy.arrival) >= 0)
    assert np.all(lossy.arrival >= lossy.time)


def test_samples_alike_but_for_a_velocity_raise_nothing() -> None:
    for order in ((None, (0.1, 0.0)), ((0.1, 0.0), None)):
        tracker = ContactTracker()
        for velocity in order:
            tracker.add(FingerSample(1.0, 1.0, 0.0, 0.0, 0.5, velocity))
        tracker.at(1.0 + np.arange(16) / 8000, 1.0)
        assert tracker.touching


@pytest.mark.parametrize(("apart", "averaged"), [(0.0035, True), (0.0045, False)])
@pytest.mark.parametrize("velocity", [None, (0.0, 0.0)])
def test_samples_that_wait_within_4_ms_are_averaged(
    apart: float, averaged: bool, velocity: tuple[float, float] | None
) -> None:
    """Two that came together begin a contact between them; others one after the other."""
    tracker = ContactTracker()
    tracker.add(FingerSample(0.0, apart, 0.0, 0.0, 0.5, velocity))
    tracker.add(FingerSample(apart, apart, 1e-3, 0.0, 0.5, velocity))
    place, _ = tracker.at(apart + np.arange(4) / 8000, apart)
    if averaged:
        np.testing.assert_allclose(place, np.tile([0.5e-3, 0.0], (4, 1)), atol=1e-12)
    else:
        assert abs(place[0, 0] - 0.5e-3) > 1e-5


def heard_again(speed: float, gap: float, x: float) -> ContactTracker:
    """Return a tracker that heard a stroke until 0.5 s, and after a gap one sample at x [m]."""
    tracker = ContactTracker()
    for k in range(46):
        time = 0.5 - (45 - k) / 90
        tracker.add(FingerSample(time, time, speed * time, 0.0, 0.5))
    tracker.add(FingerSample(0.5 + gap, 0.5 + gap, x, 0.0, 0.5))
    tracker.at(0.5 + gap + 0.001 * np.arange(4), 0.5 + gap)
    return tracker


@pytest.mark.parametrize(("gap", "jumps"), [(0.24, (0, 1)), (0.26, (1, 0))])
def test_a_finger_is_expected_on_its_stroke_for_a_quarter_of_a_second(
    gap: float, jumps: tuple[int, int]
) -> None:
    """The finger is then where it was last: 20 mm are within its reach; 0.1 m/s go 24 and 26 mm."""
    found = [heard_again(0.1, gap, x) for x in (0.05 + 0.1 * gap, 0.05)]
    assert (found[0].jumps, found[1].jumps) == jumps


def test_after_a_quarter_of_a_second_a_finger_s_velocity_is_forgotten() -> None:
    assert heard_again(0.05, 0.24, 0.025 + 0.05 * 0.24).velocity == pytest.approx([0.05, 0.0])
    assert np.all(heard_again(0.05, 0.26, 0.025 + 0.05 * 0.26).velocity == 0)
