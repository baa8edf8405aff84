"""Waves: the cost of a block of all clients' waveforms and effects, and of a unit of work.

Processor time is measured, so that other programs on the machine have little influence.
"""

import time
from collections.abc import Iterator

import numpy as np

from tactile import messages as m
from tactile.bench.figures import RATE, Figure, at_most
from tactile.bus.base import Wiring
from tactile.bus.simulated.mock_bus import MockBus
from tactile.display.display import load_display
from tactile.playback.block_rendering import BLOCK
from tactile.playback.loop import PlaybackLoop
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.voice import Voice
from tactile.playback.waves import BLOCK_WORK, Curve

CLIENTS = 60
"""Number of clients of a crowd."""
BLOCKS = 1000
"""Number of blocks that are timed."""
SECONDS = 3.0
"""Duration of an effect [s]."""


def costliest(seconds: float = SECONDS) -> Curve:
    """Return an effect with the largest numbers of points and of transients, which overlap."""
    time = np.linspace(0.0, seconds, m.MOST_POINTS)
    full = np.full(m.MOST_POINTS, 1.0)
    return Curve(
        1e-6,
        np.column_stack([time, full]),
        np.column_stack([time, 200 * full]),
        np.column_stack([time / 4, full, 20 * full]),
        stream=False,
    )


def plain(seconds: float = SECONDS) -> Curve:
    """Return an effect of two points."""
    return Curve(
        1e-6,
        np.array([[0.0, 1.0], [seconds, 1.0]]),
        np.array([[0.0, 200.0], [seconds, 200.0]]),
        np.zeros((0, 3)),
        stream=False,
    )


def fill(voice: Voice, sample_rate: float = 48_000.0, cuts: int = 1) -> None:
    """Keep a client's queue full, with a number of segments in each message."""
    samples = np.full(m.MOST_SAMPLES // cuts, 1e-6, np.float32)
    while voice.queue.waiting() < 0.05:
        for k in range(cuts):
            if not voice.queue.append(samples, sample_rate, (k % 2,) if cuts > 1 else ()):
                return


def _player() -> PlaybackLoop:
    display = load_display("reference-24")
    memory = PlaybackMemory.create(len(display.contactors))
    return PlaybackLoop(display, MockBus(Wiring.of(display, RATE)), memory)


def _microseconds(clients: int, curve: Curve | None, *, cuts: int = 0) -> tuple[float, ...]:
    """Return the mean and the 99th percentile of a block's time [µs], and its mean work."""
    player, taken, works = _player(), [], []
    for block in range(BLOCKS):
        for client in range(1, clients + 1):
            voice = player.voice(client)
            if curve is not None and block % 100 == 0:
                voice.effect.begin(curve)
            if cuts:
                fill(voice, cuts=cuts)
        works.append(sum(voice.work(BLOCK) for voice in player.voices.values()))
        begun = time.thread_time_ns()
        player._waves(BLOCK, block)
        taken.append(1e-3 * (time.thread_time_ns() - begun))
    return float(np.mean(taken)), float(np.percentile(taken, 99)), float(np.mean(works))


def measure_waves() -> Iterator[Figure]:
    """Time a block of one client's waves by kind, then of a crowd that plays all it may."""
    kinds = {
        "effect": (plain(), 0),
        "effect_with_transients": (costliest(), 0),
        "waveform": (None, 1),
        "waveform_of_short_segments": (None, m.MOST_SAMPLES // 48),
    }
    for name, (curve, cuts) in kinds.items():
        one, _, work = _microseconds(1, curve, cuts=cuts)
        two, _, works = _microseconds(2, curve, cuts=cuts)
        yield Figure(f"waves.{name}", two - one, "µs a block")
        yield Figure(f"waves.{name}.unit", 1e3 * (two - one) / (works - work), "ns")
    yield Figure("waves.budget", float(BLOCK_WORK), "units a block")
    for name, curve, cuts in (("plain", plain(), 0), ("costliest", costliest(), 1)):
        mean, p99, _ = _microseconds(CLIENTS, curve, cuts=cuts)
        yield Figure(f"waves.{CLIENTS}_clients.{name}.mean", 1e-3 * mean, "ms a block")
        yield at_most(f"waves.{CLIENTS}_clients.{name}.p99", 1e-3 * p99, "ms a block", 1)
