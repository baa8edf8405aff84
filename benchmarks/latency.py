"""Latency from a contact message to the first sample that depends on it, by the amplifier's clock.

A client in its own process sends a position a thousand times a second over a WebSocket to the
server, whose playback plays oak on 24 contactors to the C amplifier on a pty. The contacts that
each block was rendered from are in the trace of `benchmarks.traced_playback`, which the server
starts in place of its own playback; the time at which the amplifier put that block out is in the
amplifier's record. The first sample that can depend on a contact is
the first of the next block, delayed by the look-ahead of the limiter.
"""

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmarks import traced_playback
from benchmarks.tracing import traced
from benchmarks.virtual import NO_AMPLIFIER, VirtualAmplifier, can_be_built, workshop
from firmware_protocol.messages import State
from tactile import messages as m
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_most, beside_machine, not_measured
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.host import Host
from tactile.server.server import running
from tactile.tracking.finger_sample import FingerSample

RATE = 1000.0
"""Rate of messages [1/s]."""
SHORT, LONG = 10.0, 300.0
"""Durations of the messages [s]."""
SPEED, STROKE = 0.08, 0.04
"""Speed [m/s] and amplitude [m] of the finger that moves back and forth."""
CLIENT = "from benchmarks.latency import send; send({!r}, {!r}, {!r})"
"""Code of the client's process."""
NAME = "bench"
"""Name of the display."""
FORCE, MARK = 0.5, 1e-9
"""Normal force, and the imperceptible step of force by which each message carries its number
[N]."""


def send(url: str, seconds: float, file: str) -> None:
    """Send positions at `RATE` for a while, and store the time at which each was sent.

    Parameters
    ----------
    url : str
        URL of the server.
    seconds : float
        Duration [s].
    file : str
        File for the times, an array of one for each message [s, monotonic].
    """
    import tactile.client

    count = int(seconds * RATE)
    sent = np.zeros(count)
    with tactile.client.connect(url) as display:
        display.select("wood-oak", timeout=20.0)
        display.arm(timeout=10.0)
        begun = time.monotonic() + 0.2
        for k in range(count):
            while (left := begun + k / RATE - time.monotonic()) > 0:
                time.sleep(left)
            x = STROKE * np.sin(SPEED / STROKE * k / RATE)
            sent[k] = time.monotonic()
            display.touch((float(x), 0.0), normal_force=FORCE + k * MARK)
        time.sleep(0.3)
        np.save(file, sent)
        display.disarm(timeout=5.0)


async def _session(
    folder: Path, device: str, seconds: float
) -> tuple[Floats, Floats, m.StatsReply]:
    """Play while a client sends.

    Returns the trace (B, 3), the time at which each contact that came was sent (K,) [s], and the
    statistics of the display.
    """
    config = Configuration(
        server=ServerConfig(port=0, socket=""),
        display=(DisplayConfig(name=NAME, device=device),),
    )
    host = Host(config)
    numbers: list[int] = []  # of the messages whose contacts came: the client drops outdated ones
    async with running(config, host=host) as server:
        playing = host.playing[NAME]
        add = playing.add_sample

        def add_sample(client: int, sample: FingerSample) -> None:
            add(client, sample)
            numbers.append(round((sample.normal_force - FORCE) / MARK))

        setattr(playing, "add_sample", add_sample)  # noqa: B010
        code = CLIENT.format(server.url, seconds, str(folder / "sent.npy"))
        client = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
        if await client.wait():
            raise subprocess.CalledProcessError(client.returncode or 1, "client")
        stats = await host.connect("bench", roles=frozenset({"watch"})).request(
            m.GetStats(display=NAME)
        )
        assert isinstance(stats, m.StatsReply)
    sent = np.load(folder / "sent.npy")
    return np.load(folder / "trace.npy"), sent[[n for n in numbers if n >= 0]], stats


def output_times(amplifier: VirtualAmplifier, positions: Floats, due: Floats) -> Floats:
    """Return the times at which an amplifier put samples out, by its clock.

    Parameters
    ----------
    amplifier : VirtualAmplifier
        Amplifier whose record is taken.
    positions : (K,) array of float
        Positions of the samples in the stream; the amplifier counts them from another beginning.
    due : (K,) array of float
        Times at which the host expected them [s].

    Returns
    -------
    (K,) array of float
        Times on the host's monotonic clock; NaN for samples that were not put out [s].
    """
    records = amplifier.take()
    playing = records.state == State.RUNNING
    ticks, counted = records.tick[playing], records.position[playing].astype(np.int64)
    times = amplifier.powered_up + ticks.astype(np.float64) * 1e-6
    nearest = np.clip(np.searchsorted(times, due), 1, len(times) - 1)
    nearest -= due - times[nearest - 1] < times[nearest] - due
    apart = np.rint(np.median(counted[nearest] - positions)).astype(np.int64)
    when = dict(zip((counted - apart).tolist(), times.tolist(), strict=True))
    return np.array([when.get(int(p), np.nan) for p in positions])


def latencies(trace: Floats, sent: Floats, amplifier: VirtualAmplifier) -> Floats:
    """Return the time from each message to the first sample that depends on it (K,) [s].

    Messages before the first block or after the last are left out.

    Parameters
    ----------
    trace : (B, 3) array of float
        Position of each block [samples], number of contacts that had come when it was rendered, and
        the time at which it is due on the host's monotonic clock [s].
    sent : (M,) array of float
        Times at which the messages were sent, on the same clock [s].
    amplifier : VirtualAmplifier
        Amplifier that played the blocks.

    Returns
    -------
    (K,) array of float
        Latencies of the other messages [s].
    """
    block, contacts, due = trace.T
    played = output_times(amplifier, block + LOOK_AHEAD, due)
    first = np.searchsorted(contacts, np.arange(len(sent)), side="right")
    inside = (first > 0) & (first < len(trace))
    late = played[first[inside]] - sent[inside]
    return np.asarray(late[np.isfinite(late)])


def measure_latency(seconds: float = SHORT) -> Iterator[Figure]:
    """Measure the latency over a pty, with samples and with spectrum frames.

    Parameters
    ----------
    seconds : float
        Duration of a stroke [s].

    Yields
    ------
    Figure
        Figures.
    """
    if not can_be_built():
        yield not_measured("latency", NO_AMPLIFIER)
        return
    yield from beside_machine("latency", _measured("latency", "", seconds, goals=True))
    yield from _measured("latency.spectrum", "?format=spectrum", seconds, goals=False)


def _measured(name: str, options: str, seconds: float, *, goals: bool) -> Iterator[Figure]:
    with workshop() as folder, closing(VirtualAmplifier(folder, "--pty")) as amplifier:
        device = f"serial://{amplifier.path}{options}"
        with traced(traced_playback, folder / "trace.npy"):
            trace, sent, stats = asyncio.run(_session(folder, device, seconds))
        time.sleep(0.1)
        late = 1e3 * latencies(trace, sent, amplifier)
    yield Figure(f"{name}.messages", float(len(late)), "")
    for part, goal in ((50, 12), (99, 20), (99.9, 40)):
        value = float(np.percentile(late, part))
        figure = f"{name}.p{part:g}"
        yield at_most(figure, value, "ms", goal) if goals else Figure(figure, value, "ms")
    yield Figure(f"{name}.most", float(late.max()), "ms")
    for counter in ("late_blocks", "skipped_samples", "underruns", "lost_contacts"):
        yield Figure(f"{name}.{counter}", float(stats.counters[counter]), "")


def measure_latency_long() -> Iterator[Figure]:
    """Measure each latency for five minutes."""
    yield from measure_latency(LONG)
