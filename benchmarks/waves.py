"""Waves: the cost of a block of all clients' waveforms and effects, and of a unit of work.

Processor time is measured, so that other programs on the machine have little influence.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from unittest.mock import patch

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
from tactile.playback.waveforms import LONGEST, MOST_SEGMENTS
from tactile.playback.waves import BLOCK_WORK, Curve

CLIENTS = 60
"""Number of clients of a crowd."""
BLOCKS = 1000
"""Number of blocks that are timed."""
SECONDS = 3.0
"""Duration of an effect [s]."""
SAMPLE_RATE = 48_000.0
"""Sample rate of the waveforms, the largest of a message [Hz]."""
CONTACTORS = 24
"""Number of contactors of the display."""
UNBOUNDED = 1 << 30
"""Work for which there always is time, so that all is played whose cost is timed."""
SETS = (0, 1), (1, 2)
"""Contactors of segments that wait for each other."""
Filler = Callable[[Voice], None]
"""Function that fills a client's queue of samples."""


def costliest() -> Curve:
    """Return an effect with the largest numbers of points and of transients, which overlap."""
    time = np.linspace(0.0, SECONDS, m.MOST_POINTS)
    full = np.full(m.MOST_POINTS, 1.0)
    return Curve(
        1e-6,
        np.column_stack([time, full]),
        np.column_stack([time, 200 * full]),
        np.column_stack([time / 4, full, 20 * full]),
        stream=False,
    )


def plain() -> Curve:
    """Return an effect of two points."""
    return Curve(
        1e-6,
        np.array([[0.0, 1.0], [SECONDS, 1.0]]),
        np.array([[0.0, 200.0], [SECONDS, 200.0]]),
        np.zeros((0, 3)),
        stream=False,
    )


def fill(voice: Voice, cuts: int = 1) -> None:
    """Keep a client's queue full, with a number of segments in each message.

    Parameters
    ----------
    voice : Voice
        Client.
    cuts : int
        Number of segments.
    """
    samples = np.full(m.MOST_SAMPLES // cuts, 1e-6, np.float32)
    while voice.queue.waiting() < 0.05:
        for k in range(cuts):
            if not voice.queue.append(samples, SAMPLE_RATE, (k % 2,) if cuts > 1 else ()):
                return


def alternate(voice: Voice) -> None:
    """Keep a second of a client's queue full, with as many segments as may wait.

    Each message has the other of `SETS`, so that it needs a segment of its own.

    Parameters
    ----------
    voice : Voice
        Client.
    """
    queue, seconds = voice.queue, LONGEST / (MOST_SEGMENTS + CONTACTORS)
    samples = np.full(int(seconds * SAMPLE_RATE), 1e-6, np.float32)
    while queue.waiting() + seconds <= LONGEST:
        newest = int(queue.waiting((2,)) > queue.waiting((0,)))
        if not queue.append(samples, SAMPLE_RATE, SETS[1 - newest]):
            return


def _player() -> PlaybackLoop:
    display = load_display(f"reference-{CONTACTORS}")
    memory = PlaybackMemory.create(len(display.contactors))
    return PlaybackLoop(display, MockBus(Wiring.of(display, RATE)), memory)


@dataclass(frozen=True)
class Cost:
    """Cost of a block of all clients' waves.

    Attributes
    ----------
    mean, p99 : float
        Mean and 99th percentile of its time [µs].
    work : float
        Mean of its work.
    dropped : float
        Share of the clients' blocks for which there was no time [%].
    """

    mean: float
    p99: float
    work: float
    dropped: float


def _cost(clients: int, curve: Curve | None, filler: Filler | None = None) -> Cost:
    """Time the blocks of clients that all play an effect, or samples."""
    player, taken, works = _player(), [], []
    for block in range(BLOCKS):
        for client in range(1, clients + 1):
            voice = player.voice(client)
            if curve is not None and block % 100 == 0:
                voice.effect.begin(curve)
            if filler is not None:
                filler(voice)
        works.append(sum(voice.work(BLOCK) for voice in player.voices.values()))
        begun = time.thread_time_ns()
        player._waves(BLOCK, block)
        taken.append(1e-3 * (time.thread_time_ns() - begun))
    dropped = 100 * player.dropped_waves / (BLOCKS * clients)
    return Cost(
        float(np.mean(taken)), float(np.percentile(taken, 99)), float(np.mean(works)), dropped
    )


def measure_waves() -> Iterator[Figure]:
    """Time a block of one client's waves by kind, then of a crowd that plays all it may.

    Yields
    ------
    Figure
        Figures.
    """
    kinds: dict[str, tuple[Curve | None, Filler | None]] = {
        "effect": (plain(), None),
        "effect_with_transients": (costliest(), None),
        "waveform": (None, fill),
        "waveform_of_short_segments": (None, partial(fill, cuts=m.MOST_SAMPLES // 48)),
        "waveform_of_overlapping_segments": (None, alternate),
    }
    for name, (curve, filler) in kinds.items():
        with patch("tactile.playback.waves.BLOCK_WORK", UNBOUNDED):
            one, two = (_cost(clients, curve, filler) for clients in (1, 2))
        yield Figure(f"waves.{name}", two.mean - one.mean, "µs a block")
        unit = 1e3 * (two.mean - one.mean) / (two.work - one.work)
        yield Figure(f"waves.{name}.unit", unit, "ns")
    yield Figure("waves.budget", float(BLOCK_WORK), "units a block")
    alone = _cost(1, None, alternate)
    yield Figure("waves.waveform_of_overlapping_segments.work", alone.work, "units a block")
    yield Figure("waves.waveform_of_overlapping_segments.dropped", alone.dropped, "%")
    crowds: tuple[tuple[str, Curve, Filler | None], ...] = (
        ("plain", plain(), None),
        ("costliest", costliest(), fill),
    )
    for name, curve, filler in crowds:
        cost = _cost(CLIENTS, curve, filler)
        yield Figure(f"waves.{CLIENTS}_clients.{name}.mean", 1e-3 * cost.mean, "ms a block")
        yield at_most(f"waves.{CLIENTS}_clients.{name}.p99", 1e-3 * cost.p99, "ms a block", 1)
