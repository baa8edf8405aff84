"""The benchmark of tactile frames: how late they are, from traces, without a server or a clock."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from benchmarks.tactile_frames import fidelity, lateness
from benchmarks.traced_frames import AMPLITUDE, COUNT, FrameTracingLoop
from benchmarks.traced_playback import FILE
from benchmarks.virtual import Records, VirtualAmplifier
from firmware_protocol.messages import State
from tactile.arrays import Floats
from tactile.clock import ModelClock
from tactile.display.display import Display, load_display
from tactile.playback.commands import AddFrames
from tactile.playback.shared_memory import PlaybackMemory
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.sim import SimulatedDisplay

RATE = 8000.0
BLOCK = 16
EQUALIZED = 16
"""Delay of equalizer and limiter [samples]."""
FIRST = COUNT - 10
"""Number of the first frame of the made traces, soon after which the remainders begin again."""
LATE = 7e-3
"""Time from each frame of the made traces to its sample [s]."""


class MadeAmplifier:
    """Amplifier that put sample 0 out at a time, and counted it as another one."""

    def __init__(self, begun: float, samples: int = 4000, apart: int = 512) -> None:
        self.powered_up, count = 50.0, np.arange(samples)
        self._records = Records(
            np.rint(1e6 * (begun - self.powered_up + count / RATE)).astype(np.uint64),
            (count + apart).astype(np.uint32),
            np.full(samples, State.RUNNING, np.uint8),
            np.zeros((samples, 1), np.int16),
            np.zeros(samples, np.uint8),
        )

    def take(self) -> Records:
        return self._records


def late(traces: dict[str, Floats], sent: Floats, begun: float) -> Floats:
    """Return how late the frames of traces are if sample 0 is put out at ``begun`` [s]."""
    return lateness(traces, sent, cast(VirtualAmplifier, MadeAmplifier(begun)))


def made(begun: float, *, queued: bool) -> dict[str, Floats]:
    """Return traces of 100 blocks of frames of 1 kHz, from number `FIRST` on, in two streams."""
    block, frame = np.arange(100), np.arange(200)
    blocks = np.zeros((100, 6))
    blocks[:, 0] = BLOCK * block
    blocks[:, 1] = begun + BLOCK * block / RATE
    blocks[:, 2] = (FIRST + 2 * block) % COUNT
    if queued:  # the second stream counts its places anew
        blocks[:, 3] = 2 * (block % 50)
        blocks[:, 4], blocks[:, 5] = 1 / 8, 1 + block // 50
    frames = np.stack([(FIRST + frame) % COUNT, frame % 100, 1 + frame // 100], axis=1)
    return {"blocks": blocks, "frames": frames.astype(float), "kind": np.array(not queued)}


def test_frames_of_a_queue_are_as_late_as_their_places_say() -> None:
    sent = np.arange(FIRST + 200) / 1000 + 60.0
    begun = float(sent[FIRST]) + LATE - EQUALIZED / RATE
    delays = late(made(begun, queued=True), sent, begun)
    assert len(delays) == 200, "also those whose remainders begin again"
    assert delays == pytest.approx(LATE, abs=2e-6)


def test_the_newest_frame_is_as_late_as_the_block_after_it() -> None:
    sent = np.arange(FIRST + 200) / 1000 + 60.0
    begun = float(sent[FIRST]) + LATE - LOOK_AHEAD / RATE
    delays = late(made(begun, queued=False), sent, begun)
    assert len(delays) == 100, "every second frame is overtaken"
    assert delays == pytest.approx(LATE, abs=2e-6)


def struck(display: Display, number: int) -> int:
    """Play numbered frames of 1 kHz, of which one has a value on the second contactor.

    Returns the sample at which the skin's shear is largest there.
    """
    count, parts = len(display.contactors), []
    memory, bus = PlaybackMemory.create(count), SimulatedDisplay(display, RATE)
    loop = FrameTracingLoop(display, bus, memory, worn=True, clock=ModelClock())
    loop.arm()
    for block in range(100):
        numbers = np.arange(2) + 2 * block
        frames = np.zeros((2, count), np.float32)
        frames[:, 0] = numbers / COUNT * AMPLITUDE
        frames[:, 1] = np.where(numbers == number, 1e-6, 0.0)
        loop.apply(AddFrames(1, frames, 1000.0, latest=False))
        loop.step()
        parts.append(bus.take_shear())
    loop.disarm()
    bus.close()
    memory.close()
    return int(np.concatenate(parts)[:, 1].argmax())


def test_a_frame_is_felt_at_the_sample_that_the_trace_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FILE, str(tmp_path / "trace.npz"))
    felt = struck(load_display("reference-64"), 120)
    traces = dict(np.load(tmp_path / "trace.npz"))
    assert traces["frames"][:, 0].tolist() == list(range(200))
    due = traces["blocks"][0, 1] - traces["blocks"][0, 0] / RATE
    played = late(traces, np.zeros(200), due)
    assert played[120] == pytest.approx(due + felt / RATE, abs=1 / RATE)


def test_a_random_field_is_played_with_the_promised_fidelity() -> None:
    assert fidelity(2000.0, seconds=0.9) > 40
