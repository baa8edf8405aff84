"""Crowd: fifty programs touch one display at once while another program keeps a core busy.

There is also a soak test: two programs touch the display for an hour on an otherwise idle machine.

The server plays on 24 contactors to the C amplifier on a pty. Blocks must be in time, the
amplifier's output must never step, and memory must not grow.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

from benchmarks.floods import loaded, touch_together
from benchmarks.server import (
    PATIENCE,
    OutputRecorder,
    ServerProcess,
    amplifier_and_folder,
    block_figures,
    connected,
    counters_of,
    growth,
    observe,
)
from benchmarks.virtual import beside_amplifier
from tactile.bench.figures import Figure

BUSY = "while True: pass"
"""Code of the process that keeps a core busy."""


@dataclass(frozen=True)
class Crowd:
    """Number of programs, their duration [s], and whether another program keeps a core busy."""

    name: str
    clients: int
    seconds: float
    is_disturbed: bool = True


SHORT = Crowd("crowd", 50, 20.0)
LONG = Crowd("crowd", 50, 300.0)
SOAK = Crowd("hour", 2, 3600.0, is_disturbed=False)


def measure_crowd(crowd: Crowd = SHORT) -> Iterator[Figure]:
    """Measure a server under a crowd."""
    yield from beside_amplifier(crowd.name, _measured(crowd))


def _measured(crowd: Crowd) -> Iterator[Figure]:
    places = f"most_clients = {crowd.clients + 10}"
    with (
        amplifier_and_folder() as (amplifier, folder),
        closing(ServerProcess(folder, amplifier.path, server=places)) as server,
        connected(server) as keeper,
        loaded(touch_together, server.url, crowd.clients, crowd.seconds + PATIENCE) as load,
    ):
        recorder = OutputRecorder(amplifier)
        busy = subprocess.Popen([sys.executable, "-c", BUSY if crowd.is_disturbed else ""])
        try:
            with load.on():
                before = counters_of(server)
                memory = list(observe(server, recorder, keeper, crowd.seconds))
                after = counters_of(server)
        finally:
            busy.kill()
            busy.wait()
    yield Figure(f"{crowd.name}.seconds", crowd.seconds, "s")
    yield Figure(f"{crowd.name}.rate", load.rate(), "1/s")
    yield from block_figures(crowd.name, before, after, 1)
    yield from recorder.figures(crowd.name)
    for name, values in zip(("server", "playback"), zip(*memory, strict=True), strict=True):
        yield growth(f"{crowd.name}.{name}", list(values))
