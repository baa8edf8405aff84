"""Tests of tracking: prediction without jumps, from samples that are noisy and late."""

import math

import numpy as np
import pytest
from tracking_rig import BLOCK, LATENCY, RATE, ROUNDING, Run, needs_slide, speeds, stroke

from benchmarks import tracking as bench
from benchmarks.tracking import Held, SamplingClient, misses, rms, tracked
from tactile.tracking.finger_motion import MotionFilter, Noise
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker, Path

GOAL = 0.3
"""Largest rms error of a tracked place, the goal of docs/benchmarks.md [mm]."""
HORIZON, BRAKING = 0.060, 0.020
"""Time for which a course is trusted beyond its newest sample (two periods of 90 Hz, a delay and
the latency of 12 ms), and time in which a finger that says nothing more is then brought to rest
[s]."""
SETTLING, FORCE_SETTLING = 0.003, 0.005
"""Time constants 1/ω of the place at speed and of the force [s]: as short as noise allows, by
measurement."""
CLEARING = 8 / 2500
"""Time from a jump of the place to the rise of the force [s]: the 8 samples from which the renderer
reads its velocity, at the slowest rate of an amplifier (2.5 kHz)."""
ONSET, FALL = 0.010, 0.018
"""Times in which a touch rises to its whole force and falls from it: a lift is over in 20 ms
[s]."""

# Accuracy


@pytest.mark.parametrize("delay", ["jitter", "even"])
def test_a_swing_of_200_mm_s_is_met_within_300_um(delay: str) -> None:
    assert bench.GOAL == GOAL, "the benchmark's figure is judged by its page's goal"
    found = misses(bench.sine(3.0), SamplingClient(delay=delay), 2)
    assert rms(found) <= GOAL
    assert found.max() <= 1.2


@needs_slide
def test_the_recorded_slide_is_met_within_300_um() -> None:
    found = misses(bench.recorded(), SamplingClient(), 2)
    assert rms(found) <= GOAL
    assert rms(misses(bench.recorded(), SamplingClient(delay="heavy"), 2)) <= GOAL


@needs_slide
def test_at_five_times_its_speed_nobody_meets_the_slide_within_300_um() -> None:
    """The error that is reached is held; a blind tracker has 0.34 mm (see the benchmark)."""
    slide = bench.recorded(5.0)
    assert rms(bench.blind(slide, SamplingClient(), 20)) > GOAL
    assert rms(misses(slide, SamplingClient(), 10)) <= 1.0


def test_prediction_is_what_reaches_it() -> None:
    assert rms(misses(bench.sine(2.0), SamplingClient(), 1, Held)) > 10 * GOAL


def test_a_given_velocity_makes_it_better() -> None:
    plain, told = (misses(bench.sine(3.0), SamplingClient(velocity=v), 3) for v in (False, True))
    assert rms(told) < 0.95 * rms(plain)


def test_without_noise_and_delay_a_steady_stroke_is_met_exactly() -> None:
    times, place, _ = tracked(bench.line(0.1, 1.0), SamplingClient(noise=0.0, delay="none"))
    assert np.abs(place[:, 0] - 0.1 * times).max() < 2e-6
    assert np.abs(place[:, 1]).max() == 0


@pytest.mark.parametrize("delay", ["jitter", "heavy"])
def test_a_grating_keeps_its_pitch(delay: str) -> None:
    line = bench.line(0.08, 4.0)
    times, place, _ = tracked(line, SamplingClient(delay=delay))
    assert bench.grating_power(place[:, 0], line.place(times)[:, 0]) >= 0.9
    times, place, _ = tracked(line, SamplingClient(delay=delay), tracker=Held())
    assert bench.grating_power(place[:, 0], line.place(times)[:, 0]) < 0.7


@pytest.mark.parametrize(
    ("client", "limit"),
    [
        (SamplingClient(rate=30.0), 0.6),
        (SamplingClient(rate=1000.0), 0.2),
        (SamplingClient(loss=0.3), 0.5),
        (SamplingClient(delay="heavy"), 0.4),
        (SamplingClient(stamped=False), 1.0),
        (SamplingClient(noise=2e-4), 0.6),
    ],
    ids=["30 Hz", "1000 Hz", "loss of 30 %", "heavy jitter", "no stamps", "noise of 0.2 mm"],
)
def test_other_clients_are_followed_too(client: SamplingClient, limit: float) -> None:
    """Regression: limits are a third above what is measured."""
    assert rms(misses(bench.sine(3.0), client, 2)) <= limit


# Rest and slow motion


def test_a_resting_finger_is_still_however_its_samples_tremble() -> None:
    _, place, force = tracked(bench.line(0.0, 10.0), SamplingClient())
    assert np.ptp(place, axis=0).max() == 0
    assert force[0] == pytest.approx(0.5)


def test_skin_rests_40_db_below_a_stroke_when_the_finger_does() -> None:
    slides = bench.played(bench.line(0.08, 2.0), SamplingClient())
    rests = bench.played(bench.line(0.0, 2.0), SamplingClient())
    trembles = bench.played(bench.line(0.0, 2.0), SamplingClient(), still=False)
    assert rests < slides / 100 < trembles


def test_a_finger_that_trembles_more_than_assumed_is_still_once_that_is_known() -> None:
    _, place, _ = tracked(bench.line(0.0, 5.0), SamplingClient(noise=3e-4))
    assert np.ptp(place, axis=0).max() == 0


@pytest.mark.parametrize("rate", [30.0, 90.0, 1000.0])
@pytest.mark.parametrize("speed", [0.002, 0.005])
def test_a_slow_finger_moves_without_sticking(speed: float, rate: float) -> None:
    line = bench.line(speed, 5.0)
    times, place, _ = tracked(line, SamplingClient(rate=rate))
    moved = np.diff(place[:: round(0.5 * RATE), 0])
    assert moved == pytest.approx(0.5 * speed, abs=5e-4)
    assert np.mean(speeds(place) < 1e-6) < 1e-3
    assert rms(place - line.place(times)) < 1.2e-4


def test_from_10_mm_s_on_it_never_goes_backward_for_noise() -> None:
    _, place, _ = tracked(bench.line(0.01, 5.0), SamplingClient())
    assert np.mean(np.diff(place[:, 0]) < 0) < 1e-3
    _, place, _ = tracked(bench.line(0.005, 5.0), SamplingClient())
    assert np.mean(np.diff(place[:, 0]) < 0) < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_finger_that_sets_off_does_so_without_a_jump(seed: int) -> None:
    """The finger leaves by 0.3 mm or less, which is caught up with at no more than e/τ."""
    rng, run = np.random.default_rng(seed), Run()
    for t in (np.arange(0, 450) / 90).tolist():
        x, y = rng.normal(0, 5e-5, 2)
        run.samples([(t, x + max(0.0, 0.005 * (t - 3)), y, 0.5)])
    moves = np.flatnonzero(speeds(run.place) * (run.times[1:] > 2.5) > 0)
    assert 3 < run.times[moves[0]] < 3.15
    assert speeds(run.place[run.times > 2]).max() < 0.3e-3 / SETTLING
    late = run.times > 4
    assert rms(run.place[late, 0] - 0.005 * (run.times[late] - 3)) < 1.5e-4


def test_noise_is_learnt_from_what_no_parabola_explains() -> None:
    rng, noise = np.random.default_rng(2), Noise()
    times = np.cumsum(rng.uniform(0.005, 0.015, 600))
    for t in times.tolist():
        x, y = 0.3 * t + 2 * t * t + rng.normal(0, 2e-4, 2)
        noise.add(t, x, y, 1)
    assert math.sqrt(noise.variance) == pytest.approx(2e-4, rel=0.25)


def test_three_equal_filters_are_one_kalman_filter() -> None:
    """The matrices of the textbook are the reference: mixing equal filters changes nothing."""
    motion = MotionFilter((2.0, 2.0, 2.0))
    motion.noise.add = lambda *_: None  # type: ignore[method-assign]
    rng, tau, r, elapsed = np.random.default_rng(3), 0.3, 5e-5**2, 0.011
    places = np.cumsum(rng.normal(0, 1e-3, (40, 2)), axis=0)
    motion.begin(0.0, *places[0])
    state = np.array([places[0], [0.0, 0.0], [0.0, 0.0]])
    spread = np.diag([r, 0.15**2, 4.0])
    e = math.exp(-elapsed / tau)
    step = np.array(
        [[1, elapsed, tau * (elapsed - tau * (1 - e))], [0, 1, tau * (1 - e)], [0, 0, e]]
    )
    power = [
        [elapsed ** (5 - i - j) / ((5 - i - j) * (2, 1, 1)[i] * (2, 1, 1)[j]) for j in range(3)]
        for i in range(3)
    ]
    for k, place in enumerate(places[1:], 1):
        motion.add(k * elapsed, *place)
        state, spread = step @ state, step @ spread @ step.T + 8 / tau * np.array(power)
        gain = spread[:, :1] / (spread[0, 0] + r)
        state, spread = state + gain * (place - state[0]), spread - gain * spread[:1]
        assert np.ravel(state) == pytest.approx(motion.state, rel=1e-6, abs=1e-9)


# Smoothness


def test_a_correction_keeps_place_and_velocity_and_bends_no_more_than_it_says() -> None:
    path = Path()
    path.jump(0.0, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    before = path.now(0.02)
    path.bend(0.02, 0.01, [0.003, 0.001, 0.3, -0.1, 0.0, 0.0])
    assert np.ravel(path.now(0.02)) == pytest.approx(np.ravel(before), abs=ROUNDING)
    pace = 0.4 / 0.03  # 4 mm within 10 ms; at 30 mm/s 1/ω is between 3 and 20 ms
    assert path.settling == pytest.approx(SETTLING + 0.017 / (1 + pace**2))
    omega = 1 / path.settling
    times = 0.02 + np.arange(400) / 1e5
    place = path.at(times)
    assert place[0] == pytest.approx(before[0], abs=ROUNDING)
    error = np.array([0.002 - 0.003 - 0.003, 0.0 - 0.001 + 0.001])
    rate = np.array([0.1 - 0.3, 0.1])
    bends = np.abs(np.diff(place, 2, axis=0)).max(axis=0) * 1e10
    limit = omega**2 * np.abs(error) + 2 * omega * np.abs(rate)
    assert np.all(bends <= limit * 1.001)
    assert np.all(bends >= 0.5 * limit)
    assert path.at(np.array([0.1]))[0] == pytest.approx(path.now(0.1)[0], abs=ROUNDING)


def test_velocity_steps_no_more_than_corrections_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps are at most (ω² e + 2ω e' + the course's own acceleration) / rate, over all blocks."""
    largest, bend = [0.0, 0.0, 0.0], Path.bend

    def watched(self: Path, time: float, origin: float, state: list[float]) -> None:
        bend(self, time, origin, state)
        e, rate = (math.hypot(*row) for row in self._rows[3:])
        omega = 1 / self.settling
        largest[0] = max(largest[0], omega**2 * e + 2 * omega * (rate + omega * e))
        largest[1] = max(largest[1], math.hypot(*state[4:]))
        largest[2] = max(largest[2], math.hypot(*state[2:4]))

    monkeypatch.setattr(Path, "bend", watched)
    for client in (SamplingClient(), SamplingClient(delay="heavy", loss=0.3)):
        largest[:] = [0.0, 0.0, 0.0]
        _, place, force = tracked(bench.sine(2.0), client)
        assert force.min() > 0
        correction, acceleration, speed = largest
        limit = correction + acceleration + 1.1 * speed / BRAKING
        steps = np.hypot(*np.diff(place, 2, axis=0).T) * RATE
        assert steps.max() <= limit / RATE


# Touching, lifting, leaping


def test_a_contact_rises_from_nothing_where_the_finger_is() -> None:
    run = Run().until(0.1)
    run.samples(stroke(0.0, 0.1, 0.4, at=0.2))
    first = np.flatnonzero(run.force)[0]
    begun = run.times[np.flatnonzero(run.place[:, 0])[0]]
    assert run.times[first] - begun >= CLEARING
    assert np.all(run.place[first:, 0] == 0.2)
    assert np.all(np.diff(run.force) >= 0)
    up = run.times[np.argmax(run.force > 0.999 * 0.5)]
    assert ONSET - 5e-4 < up - run.times[first] <= ONSET
    assert np.abs(np.diff(run.force)).max() <= 0.5 * 1.5 / ONSET / RATE * 1.001
    assert np.abs(np.diff(run.force, 2)).max() <= 0.5 * 6 / ONSET**2 / RATE**2 * 1.001
    assert run.tracker.touching


def test_a_lift_falls_to_nothing_in_20_ms_and_smoothly() -> None:
    run = Run().samples(stroke(0.05, 0, 0.5))
    run.samples(stroke(0.05, 0.5, 0.7, force=0.0))
    lifted = 0.5 + 1 / 90 + BLOCK / RATE + LATENCY
    assert np.all(run.force[run.times > lifted + 0.020] == 0)
    assert np.abs(np.diff(run.force)).max() <= 0.5 * 1.5 / ONSET / RATE * 1.001
    assert np.abs(np.diff(run.force, 2)).max() <= 0.5 * 6 / ONSET**2 / RATE**2 * 1.001
    assert not run.tracker.touching
    assert run.tracker.silences == 0
    assert np.all(run.tracker.velocity == 0)


def test_a_lift_during_the_onset_is_smooth_too() -> None:
    run = Run().samples([(0.0, 0.0, 0.0, 0.5), (0.008, 0.0, 0.0, 0.0)]).until(0.1)
    assert 0.1 < run.force.max() < 0.5
    assert run.force.min() >= 0
    assert run.force[-1] == 0
    assert np.abs(np.diff(run.force)).max() <= 0.5 * 1.5 / ONSET / RATE * 1.001
    bend = 0.5 * max(6 / ONSET**2, 6 / FALL**2 + 4 * 1.5 / ONSET / FALL)
    assert np.abs(np.diff(run.force, 2)).max() <= bend / RATE**2


@pytest.mark.parametrize("block", [16, 64])
def test_silence_ends_a_contact_after_100_ms_and_the_place_does_not_run_away(block: int) -> None:
    run = Run(block=block).samples(stroke(0.2, 0, 0.5))
    last = stroke(0.2, 0, 0.5)[-1]
    run.until(1.0)
    gone = last[0] + 0.1 + LATENCY
    before = (run.times > 0.1) & (run.times < gone)
    assert run.force[before].min() > 0.49
    assert np.all(run.force[run.times > gone + FALL + 1e-9] == 0)
    assert run.place[:, 0].max() <= last[1] + 0.2 * (HORIZON + BRAKING) + 1e-4
    assert run.place[:, 0].max() >= last[1] + 0.2 * HORIZON
    assert np.all(run.place[-100:] == run.place[-1])
    late = (run.times > 0.2) & (run.force > 0)
    assert np.abs(np.diff(run.place[late], 2, axis=0)).max() < 0.2 / BRAKING / RATE**2 * 1.05
    assert run.tracker.silences == 1


@pytest.mark.parametrize(("last", "gone"), [(0.25 - 2**-13, False), (0.25, True)])
def test_a_contact_is_over_in_the_sample_that_is_100_ms_after_the_last_arrival(
    last: float, gone: bool
) -> None:
    """The last of a block as well: 100 ms after 0.15 s; all times are exact."""
    tracker = ContactTracker()
    tracker.add(FingerSample(0.15, 0.15, 0.0, 0.0, 0.5))
    for block in range(2):
        begin = 0.1875 + block * 2**-5
        tracker.at(np.linspace(begin, last if block else 0.21875 - 2**-13, 2), begin)
    assert tracker.touching != gone
    assert tracker.silences == gone


def test_it_goes_on_through_a_loss_of_80_ms_and_comes_back() -> None:
    rows = stroke(0.1, 0, 0.5) + stroke(0.1, 0.565, 1.0)
    run = Run().samples(rows)
    settled = run.times > 0.1
    assert run.force[settled].min() > 0.49
    assert np.all(np.diff(run.place[settled, 0]) > 0)
    late = run.times > 0.75
    assert run.place[late, 0] == pytest.approx(0.1 * run.times[late], abs=1e-4)
    assert run.tracker.jumps == 0


@pytest.mark.parametrize("far", [0.03, 0.3])
def test_a_leap_is_a_lift_and_a_contact_elsewhere(far: float) -> None:
    run = Run().samples(stroke(0.05, 0, 0.5)).samples(stroke(0.05, 0.5, 1.0, at=far))
    leap = int(np.argmax(np.diff(run.place[:, 0])))
    assert run.force[leap] == 0
    assert run.force[leap + 1] == 0
    heard = run.force[1:] * run.force[:-1] > 0
    assert speeds(run.place)[heard].max() < 0.2
    assert run.place[-1, 0] == pytest.approx(far + 0.05 * run.times[-1], abs=1e-4)
    assert run.force[-1] == pytest.approx(0.5)
    silent = np.count_nonzero(run.force[run.times > 0.2] == 0) / RATE
    assert silent < CLEARING + 2 * BLOCK / RATE
    assert run.tracker.jumps == 1


def test_a_contact_elsewhere_waits_until_the_last_has_fallen() -> None:
    run = Run().samples(stroke(0.0, 0, 0.5))
    run.samples([(0.5, 0.0, 0.0, 0.0)]).samples(stroke(0.0, 0.505, 0.8, at=0.1))
    moved = int(np.argmax(run.place[:, 0] > 0))
    assert np.all(run.place[moved:, 0] == 0.1)
    assert run.force[moved - 1] == run.force[moved] == 0
    assert run.times[moved] == pytest.approx(0.5 + LATENCY + FALL, abs=1.5 * BLOCK / RATE)


def test_a_new_force_is_followed_smoothly_and_met() -> None:
    run = Run().samples(stroke(0.0, 0, 0.5)).samples(stroke(0.0, 0.5, 1.0, force=2.0))
    assert run.force[-1] == pytest.approx(2.0)
    assert run.force.max() <= 2.0
    late = run.times > 0.1
    assert np.all(np.diff(run.force[late]) >= -ROUNDING)
    assert np.abs(np.diff(run.force[late])).max() <= 1.5 * 0.37 / 0.005 / RATE


def test_a_force_that_changes_its_mind_has_no_kink() -> None:
    """The force bends by ω² e + 2ω e' at most, e' being no more than ω e/e (Euler's)."""
    rows = [*stroke(0.0, 0, 0.5), (0.5, 0.0, 0.0, 2.0), (0.51, 0.0, 0.0, 0.5)]
    run = Run().samples(rows).until(0.58)
    late, omega = run.times > 0.1, 1 / FORCE_SETTLING
    assert run.force.max() > 0.8
    bend = omega**2 * 1.5 * (1 + 2 / math.e)
    assert np.abs(np.diff(run.force[late], 2)).max() <= bend / RATE**2


def test_velocity_is_that_of_the_path() -> None:
    run = Run().samples(stroke(0.08, 0, 0.5))
    assert run.tracker.velocity == pytest.approx((run.place[-1] - run.place[-2]) * RATE, abs=1e-5)
    assert run.tracker.velocity == pytest.approx([0.08, 0], abs=1e-3)


# Blocks


@pytest.mark.parametrize("other", [16, 40, 320])
def test_blocks_cut_otherwise_give_the_same_path(other: int) -> None:
    """Samples come at multiples of 40 ms, with a leap, a silence and a lift among them."""
    runs = []
    for block in (64, other):
        run = Run(block=block)
        for k in range(50):
            time = 0.04 * k
            at = 0.2 if k > 12 else 0.0
            if 20 < k < 26:
                continue
            force = 0.0 if 30 < k < 35 else 0.4 + 0.01 * (k % 5)
            run.samples([(time, at + 0.1 * time + 1e-4 * (-1) ** k, 0.03 * time, force)])
        runs.append(run.until(2.04))
    count = min(len(run.times) for run in runs)
    one, two = runs
    assert np.abs(one.place[:count] - two.place[:count]).max() < 1e-9
    assert np.abs(one.force[:count] - two.force[:count]).max() < 1e-9
    assert one.tracker.silences == two.tracker.silences == 1
    assert one.tracker.jumps == two.tracker.jumps == 1


def test_at_2500_hz_the_place_has_moved_8_samples_before_the_force() -> None:
    run = Run(rate=2500.0).samples(stroke(0.0, 0.1, 0.5, at=0.1))
    moved, pressed = (int(np.argmax(a > 0)) for a in (run.place[:, 0], run.force))
    assert pressed - moved >= 8
    assert run.force[-1] == pytest.approx(0.5)
