"""Crowd: fifty programs touch one display at once while another program keeps a core busy.

There is also a soak test: two programs touch the display for an hour on an otherwise idle machine.

The daemon plays on 24 contactors to the C amplifier on a pty. Blocks must be in time, the
amplifier's output must never step, and memory must not grow.
"""

import asyncio
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.virtual import VirtualAmplifier, can_be_built, workshop
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile import messages as m
from tactile.bench.figures import Figure, at_most, beside_machine
from tactile.display.display import load_display
from tactile.server.config import DaemonConfig, DisplayConfig, ServerConfig
from tactile.server.host import Host
from tactile.server.server import running

RATE = 90.0
"""Rate at which each program touches [Hz]."""
SETTLED = 0.2
"""Share of the blocks after which memory has grown to what it needs."""
NAME, BLOCKS_PER_S = "bench", 500
"""Name of the display, and blocks per second."""
CROWD = "from benchmarks.crowd import be_many; be_many({!r}, {!r}, {!r})"
"""Code of the process that runs the crowd."""
BUSY = "while True: pass"
"""Code of the process that keeps a core busy."""
CHUNK = 1 << 22
"""Number of bytes of records that are read at a time."""


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


def be_many(url: str, clients: int, seconds: float) -> None:
    """Run a number of programs, each of which touches for a while."""
    asyncio.run(_be_many(url, clients, seconds))


async def _be_many(url: str, clients: int, seconds: float) -> None:
    from tactile.client import aio

    async def one(number: int) -> None:
        async with aio.connect(url, timeout=30.0) as display:
            await display.select("wood-oak")
            if not number:
                await display.arm()
            begun = time.monotonic() + number / clients / RATE
            for k in range(int(seconds * RATE)):
                await asyncio.sleep(max(0.0, begun + k / RATE - time.monotonic()))
                x = 0.04 * math.sin(2 * k / RATE)
                await display.touch((x, 0.0), normal_force=0.5)

    await asyncio.gather(*(one(number) for number in range(clients)))


def resident(pid: int | str = "self") -> float:
    """Return the resident memory of a process [MiB]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return math.nan


class Steps:
    """Largest step of an amplifier's output, read as it plays."""

    def __init__(self, amplifier: VirtualAmplifier) -> None:
        self._amplifier = amplifier
        self._last: np.ndarray[tuple[int, ...], np.dtype[np.int32]] | None = None
        self.largest = 0

    def take(self) -> None:
        """Read the records so far."""
        while len(codes := self._amplifier.take(CHUNK).codes):
            wide = codes.astype(np.int32)
            before = wide[:1] if self._last is None else self._last
            self.largest = max(
                self.largest, int(np.abs(np.diff(wide, axis=0, prepend=before)).max())
            )
            self._last = wide[-1:]


async def _session(amplifier: VirtualAmplifier, crowd: Crowd) -> Iterator[Figure]:
    config = DaemonConfig(
        server=ServerConfig(port=0, socket="", most_clients=crowd.clients + 10),
        display=(DisplayConfig(name=NAME, device=f"serial://{amplifier.path}"),),
    )
    host, steps = Host(config), Steps(amplifier)
    async with running(config, host=host) as server:
        child = host.playing[NAME].child
        assert child is not None
        code = CROWD.format(server.url, crowd.clients, crowd.seconds)
        busy = subprocess.Popen([sys.executable, "-c", BUSY if crowd.is_disturbed else ""])
        programs = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
        memory = [(0.0, 0.0, 0.0)]
        ended = asyncio.create_task(programs.wait())
        while not ended.done():
            await asyncio.wait({ended}, timeout=1.0)
            steps.take()
            passed = host.playing[NAME].report.blocks / (crowd.seconds * BLOCKS_PER_S)
            memory.append((passed, resident(), resident(child.pid)))
        busy.kill()
        busy.wait()
        stats = await host.connect("bench", roles=frozenset({"watch"})).request(
            m.GetStats(display=NAME)
        )
        assert isinstance(stats, m.StatsReply)
    steps.take()
    return _figures(stats.counters, np.array(memory), steps.largest, crowd)


def _figures(
    counters: dict[str, int],
    memory: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    largest: int,
    crowd: Crowd,
) -> Iterator[Figure]:
    """Yield the figures of a crowd's session."""
    display = load_display("reference-24")
    blocks = max(counters["blocks"], 1)
    bad = counters["late_blocks"] + counters["skipped_samples"] / 16
    yield Figure(f"{crowd.name}.seconds", crowd.seconds, "s")
    yield Figure(f"{crowd.name}.blocks", float(blocks), "")
    yield at_most(f"{crowd.name}.late_blocks", 1e4 * bad / blocks, "of 10 000", 1)
    yield Figure(f"{crowd.name}.underruns", float(counters["underruns"]), "")
    slew = min(display.slew / 8000.0 / display.limits.voltage, 2.0) * FULL_SCALE_CODE
    yield at_most(f"{crowd.name}.largest_step", largest / slew, "of slew", 1)
    settled = memory[memory[:, 0] > SETTLED]
    for column, name in ((1, "server"), (2, "playback")):
        growth = float(settled[-1, column] - settled[0, column]) if len(settled) else math.nan
        yield at_most(f"{crowd.name}.{name}_growth", growth, "MiB", 2)


def measure_crowd(crowd: Crowd = SHORT) -> Iterator[Figure]:
    """Measure a daemon under a crowd for a short while."""
    if not can_be_built() or sys.platform != "linux":
        return
    yield from beside_machine(crowd.name, _measured(crowd))


def _measured(crowd: Crowd) -> Iterator[Figure]:
    with workshop() as folder, closing(VirtualAmplifier(folder, "--pty")) as amplifier:
        yield from asyncio.run(_session(amplifier, crowd))


def measure_crowd_long() -> Iterator[Figure]:
    """Measure a daemon under a crowd for five minutes."""
    yield from measure_crowd(LONG)


def measure_hour() -> Iterator[Figure]:
    """Measure a daemon under two programs for an hour."""
    yield from measure_crowd(SOAK)
