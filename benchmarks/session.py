"""What it takes to record a session: space, processor time, and whether its replay is the same.

A program moves a finger over oak through a server to the C amplifier on a pty. The server records;
in the end it is killed.
"""

import math
import os
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmarks.app import get_ready
from benchmarks.server import (
    ServerProcess,
    amplifier_and_folder,
    children_of,
    connected,
    is_alive,
    wait_for,
)
from benchmarks.virtual import beside_amplifier
from tactile.bench.figures import Figure, at_least, at_most
from tactile.bus.base import DriveBlock
from tactile.playback.block_rendering import BLOCK
from tactile.playback.mixer import BlockInput
from tactile.playback.session_recorder import PART
from tactile.playback.session_replay import replay_session
from tactile.playback.session_ring import SessionRing
from tactile.tracking.finger_sample import FingerSample, rounded

RATE = 250.0
"""Rate of contacts [1/s]."""
BLOCKS = 500.0
"""Rate of blocks at 8 kHz [1/s]."""
PARTS = 2
"""Number of whole parts over which processor time is measured."""
REPEATS = 10_000
"""Number of records over which the time in playback is averaged."""


def measure_session() -> Iterator[Figure]:
    """Measure a session of some minutes, with a velocity in each contact."""
    return beside_amplifier("session", _measure())


def _measure() -> Iterator[Figure]:
    with amplifier_and_folder() as (amplifier, folder):
        record = folder / "sessions"
        with closing(ServerProcess(folder, amplifier.path, record=str(record))) as server:
            wait_for("a recorder runs", lambda: "session_recorder" in children_of(server.pid))
            recorder = children_of(server.pid)["session_recorder"]
            spent, seconds = _play(server, record, recorder)
        wait_for("the recorder has ended", lambda: not is_alive(recorder))
        (session,) = record.iterdir()
        size = sum(path.stat().st_size for path in session.iterdir())
        begun = time.perf_counter()
        result = replay_session(session)
        took = time.perf_counter() - begun
    per_hour = size / max(result.compared_blocks, 1) * BLOCKS * 3600 / 1e6
    alone, with_contact = _block_time(contacts=0), _block_time(contacts=1)
    in_playback = (BLOCKS - RATE) * alone + RATE * with_contact
    yield at_most("session.size", per_hour, "MB/h", 20)
    yield at_most("session.processor_time", spent / seconds + in_playback, "of a core", 0.03)
    yield Figure("session.processor_time_in_playback", in_playback, "of a core")
    # Half of what is due: a machine that stands still disarms the display.
    yield at_least("session.compared_blocks", result.compared_blocks, "", BLOCKS * PARTS * PART / 2)
    yield at_most("session.replays_that_differ", int(not result.is_identical), "", 0)
    yield Figure("session.replay_speed", result.duration_s / took, "× real time")


def _play(server: ServerProcess, record: Path, recorder: int) -> tuple[float, float]:
    """Play for `PARTS` parts after the first; return the recorder's time and that of the host."""
    spent, at = [0.0], [0.0]
    files = 0
    with connected(server) as display:
        get_ready(display, "stroke")
        begun = time.monotonic()
        while files <= PARTS:
            now = time.monotonic() - begun
            place, speed = 0.04 * math.sin(2 * now), 0.08 * math.cos(2 * now)
            force = 0.5 + 0.2 * math.sin(9 * now)
            display.touch((place, 0.3 * place), velocity=(speed, 0.3 * speed), normal_force=force)
            if len(list(record.glob("*/part-*.h5"))) > files:
                files += 1
                spent.append(_processor_time(recorder))
                at.append(now)
            time.sleep(max(0.0, begun + now + 1 / RATE - time.monotonic()))
    return spent[-1] - spent[1], at[-1] - at[1]


def _processor_time(pid: int) -> float:
    """Return the processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _block_time(*, contacts: int) -> float:
    """Return the time that playback takes to record a block with contacts [s]."""
    with closing(SessionRing.create()) as ring:
        drive = DriveBlock(0, np.random.default_rng(0).normal(size=(BLOCK, 24)))
        sample = FingerSample(1.0, 1.1, 0.01, 0.02, 0.5, (0.08, 0.0))
        begun = time.perf_counter()
        for number in range(REPEATS):
            taken = tuple((1, rounded(sample)) for _ in range(contacts))
            ring.add_block(BlockInput(number, BLOCK * number, False, 1.0, 1.1, taken), drive)
        return (time.perf_counter() - begun) / REPEATS
