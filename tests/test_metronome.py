"""The metronome beside a measurement tells by how much each block woke late, in virtual time."""

import os
import subprocess
import sys
import time
from array import array

import numpy as np
import pytest

from tactile.bench import metronome
from tactile.bench.metronome import beat, beating

BLOCKS, HELD_UP_AT, HELD_UP = 200, 80, 37e-3
PERIOD = 2e-3
"""Period of the bare loop of docs/benchmarks.md: a block of 16 samples at 8 kHz [s]."""
STEP = 1e-4
"""Lateness that counts as one in what a beat tells [s]."""


class Clock:
    """Clock that passes by sleeping, for too long; the last sleep ends standard input."""

    def __init__(self, end: int) -> None:
        self.now, self.sleeps, self._end = 1000.0, 0, end

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.sleeps += 1
        self.now += seconds + HELD_UP * (self.sleeps == HELD_UP_AT)
        if self.sleeps == BLOCKS:
            os.close(self._end)


def test_it_tells_how_late_each_block_was(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    clock = Clock(writer)
    monkeypatch.setattr(metronome, "time", clock)
    with open(reader) as pipe:
        monkeypatch.setattr(sys, "stdin", pipe)
        late = np.array(beat(clock.now - 10.5 * PERIOD))
    held_up = 10 + HELD_UP_AT - 1  # ten blocks had passed before it was there
    catching_up = np.maximum(HELD_UP - PERIOD * np.arange(BLOCKS - HELD_UP_AT + 1), 0.0)
    assert len(late) == 10 + BLOCKS
    assert not late[:held_up].any()
    np.testing.assert_allclose(late[held_up:], catching_up / STEP, atol=0.51)


def test_of_all_processors_the_latest_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told = {"0": [0, 9, 2, 4], "1": [7, 1, 3]}
    code = "import sys; sys.stdin.read(); sys.stdout.buffer.write(bytes.fromhex(sys.argv[1]))"

    def process(words: list[str], stdin: int, stdout: int) -> "subprocess.Popen[bytes]":
        steps = array("H", told[words[-1]]).tobytes()
        return popen([sys.executable, "-c", code, steps.hex()], stdin=stdin, stdout=stdout)

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", process)
    monkeypatch.setattr(metronome, "processors", lambda: list(told))
    with beating() as late:
        assert not late
    assert late == [7, 9, 3]


def test_it_beats_by_itself() -> None:
    begun = time.monotonic()
    with beating() as late:
        time.sleep(0.5)
    assert 0 < len(late) <= (time.monotonic() - begun) / PERIOD + 1
