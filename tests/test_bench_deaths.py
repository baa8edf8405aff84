"""The benchmark of deaths: its arithmetic, on records that are made by hand, and one short run."""

import os
import random
import sys
from collections import Counter

import numpy as np
import pytest

from benchmarks import deaths
from benchmarks.app import SOUNDS
from benchmarks.deaths import Outcomes, is_over, plays, schedule
from benchmarks.server import AmplifierOutput, OutputRecorder, frame, joined, last_after
from benchmarks.virtual import Records, can_be_built

RATE = 1000
BEGUN, FAULT = 50.0, 51.0
SILENT_WITHIN, OFF_WITHIN = 0.3, 1.0
"""Longest times from a fault to 0 V and to high voltage off, the goals of docs/benchmarks.md
[s]."""


def output(silent_at: float, off_at: float, end: float = 53.0) -> AmplifierOutput:
    """Return a record with instants each millisecond, loud and with high voltage up to two times.

    Every tenth instant before ``silent_at`` is at 0 V, as a tone passes through it.
    """
    numbers = np.arange(round((end - BEGUN) * RATE))
    times = BEGUN + numbers / RATE
    loud = (times <= silent_at + 1e-9) & (numbers % 10 != 1)
    return AmplifierOutput(times, loud, times <= off_at + 1e-9)


def test_times_count_from_the_fault_to_the_last_instant() -> None:
    made = output(51.2, 51.75)
    assert last_after(made.times, made.is_loud, FAULT) == pytest.approx(0.2)
    assert last_after(made.times, made.high_voltage, FAULT) == pytest.approx(0.75)
    assert last_after(made.times, made.is_loud, 51.5) == 0.0


def test_a_sound_that_comes_back_counts() -> None:
    made = output(51.1, 51.1)
    made.is_loud[-300] = True
    assert last_after(made.times, made.is_loud, FAULT) == pytest.approx(53.0 - 0.3 - FAULT)


def test_a_try_fails_where_either_is_on_for_too_long() -> None:
    outcomes = Outcomes()
    late = 0.01
    assert outcomes.add(output(FAULT + SILENT_WITHIN - late, FAULT + OFF_WITHIN - late), FAULT)
    assert not outcomes.add(output(FAULT + SILENT_WITHIN + late, FAULT + 0.5), FAULT)
    assert not outcomes.add(output(FAULT + 0.1, FAULT + OFF_WITHIN + late), FAULT)
    assert outcomes.failures() == 2
    figures = {figure.name: figure for figure in outcomes.figures("x")}
    assert figures["x.tries"].value == 3
    assert figures["x.failures"].value == 2
    assert figures["x.failures"].reached is False
    assert figures["x.silent.worst"].value == pytest.approx(SILENT_WITHIN + late)
    assert figures["x.off.worst"].value == pytest.approx(OFF_WITHIN + late)
    between = 0.98 * (SILENT_WITHIN + late) + 0.02 * (SILENT_WITHIN - late)
    assert figures["x.silent.p99"].value == pytest.approx(between)


def test_it_plays_where_the_last_tenth_of_a_second_is_loud_with_high_voltage() -> None:
    assert plays(output(53.0, 53.0))
    assert not plays(output(52.8, 53.0)), "silent at the end"
    assert not plays(output(53.0, 52.95)), "high voltage off at the end"
    assert not plays(output(53.0, 53.0, end=50.05)), "not for long enough"


def test_it_is_watched_until_all_was_off_for_a_while() -> None:
    assert is_over(output(51.1, 51.3), FAULT)
    assert not is_over(output(51.1, 53.0), FAULT), "high voltage is on"
    assert not is_over(output(53.0, 51.3), FAULT), "it plays"
    assert not is_over(output(51.1, 51.1, end=FAULT + 0.35), FAULT), "it may come back"


def test_each_fault_meets_each_sound_as_often_in_random_order() -> None:
    faults = ["a", "b", "c", "d"]
    pairs = schedule(faults, range(6), random.Random(1))
    assert Counter(pairs) == {(sound, fault): 2 for sound in SOUNDS for fault in faults}
    assert pairs != sorted(pairs)
    parts = [*schedule(faults, range(1), random.Random(1)),
             *schedule(faults, range(1, 3), random.Random(2))]  # fmt: skip
    assert Counter(parts) == {(sound, fault): 1 for sound in SOUNDS for fault in faults}


class MadeAmplifier:
    """Amplifier that hands out records that were made before."""

    powered_up = 7.0

    def __init__(self, *parts: Records) -> None:
        self._parts = list(parts)

    def chunks(self) -> list[Records]:
        parts, self._parts = self._parts, []
        return parts


def records(ticks: list[int], codes: list[list[int]]) -> Records:
    count = len(ticks)
    return Records(
        np.array(ticks, np.uint64), np.zeros(count, np.uint32), np.zeros(count, np.uint8),
        np.array(codes, np.int16).reshape(count, 2), (np.array(ticks) < 300).astype(np.uint8),
    )  # fmt: skip


def test_the_largest_step_is_found_across_two_reads() -> None:
    amplifier = MadeAmplifier(
        records([100, 200], [[0, 10], [5, -20]]), records([300, 400], [[5, 32000], [0, 32000]])
    )
    recorder = OutputRecorder(amplifier)  # type: ignore[arg-type]
    made = recorder.read()
    np.testing.assert_allclose(made.times, 7.0 + 1e-4 * np.arange(1, 5))
    assert made.is_loud.all()
    assert made.high_voltage.tolist() == [True, True, False, False]
    assert (recorder.largest, recorder.largest_step) == (32000, 32020)
    assert not len(recorder.read().times)


def test_spans_are_joined_and_cut() -> None:
    made = output(51.0, 52.0)
    parts = [made.since(52.5 - 1e-6), made.since(52.8 - 1e-6)]
    assert [len(part.times) for part in parts] == [500, 200]
    assert len(joined(parts).is_loud) == 700


def test_a_long_message_has_its_length_in_two_bytes() -> None:
    assert frame({})[:2] == b"\x81\x82"
    assert frame("x" * 198)[:4] == b"\x81\xfe\x00\xc8"


@pytest.mark.realtime
def test_after_one_try_of_each_fault_the_amplifier_has_kept_its_limits() -> None:
    if sys.platform != "linux" or not can_be_built():
        if os.environ.get("CI") == "true":
            pytest.fail("no C compiler")
        pytest.skip("needs Linux, make and cc")
    figures = {figure.name: figure for figure in deaths.measure_deaths(1)}
    for fault in deaths.FAULTS | deaths.FULL_DISK:
        assert figures[f"deaths.{fault}.tries"].value == 1
    limits = [f for n, f in figures.items() if n.endswith(("largest_voltage", "largest_step"))]
    assert limits
    assert all(figure.reached for figure in limits)
