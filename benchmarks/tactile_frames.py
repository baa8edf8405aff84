"""Tactile frames: how late they are felt, how exactly, and what becomes of a source that is gone.

A client in its own process writes frames for 64 contactors a thousand times a second through the
SDK. The server plays them to the C amplifier on a pty, whose record says when each sample was put
out. The traces of `benchmarks.traced_frames` say which frame a block plays. The goal is for the
newest frame: in a queue, a frame also waits for the four after it. Random fields are also played on
``sim:``, in its own time, and the shear of the skin is compared with what was sent.
"""

import asyncio
import signal
import subprocess
import sys
import time
from asyncio.subprocess import Process
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from benchmarks import traced_frames
from benchmarks.latency import output_times
from benchmarks.traced_frames import AMPLITUDE, COUNT
from benchmarks.tracing import traced
from benchmarks.virtual import NO_AMPLIFIER, VirtualAmplifier, can_be_built, workshop
from tactile import messages as m
from tactile.arrays import Floats, Singles
from tactile.bench.figures import RATE, Figure, at_least, at_most, beside_machine, not_measured
from tactile.clock import ModelClock
from tactile.display.display import load_display
from tactile.playback.block_rendering import BLOCK, SamplePlayback
from tactile.playback.commands import AddFrames
from tactile.playback.loop import PlaybackLoop
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.voice import Voice
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.host import Host
from tactile.server.server import Server, running
from tactile.sim import SimulatedDisplay

FRAME_RATE = 1000.0
"""Rate of the frames [Hz]."""
CONTACTORS = 64
SHORT, LONG = 10.0, 300.0
"""Durations of a stream [s]."""
CLIENT = "from benchmarks.tactile_frames import send; send({!r}, {!r}, {!r}, {!r})"
"""Code of the client's process."""
NAME = "bench"
"""Name of the display."""
HIGHEST = 500.0
"""Highest frequency of a random field [Hz]."""
KILLS = 3
"""Number of times that a source is killed in each way."""
AT_REST = 1
"""Largest code of a drive that counts as 0 V."""


def random_field(time: Floats, contactors: int) -> Floats:
    """Return 40 sinusoids of random frequency up to `HIGHEST`, others for each contactor.

    Parameters
    ----------
    time : (S,) array of float
        Times [s].
    contactors : int
        Number of contactors, N.

    Returns
    -------
    (S, N) array of float
        Values; few are beyond ±1.
    """
    rng = np.random.default_rng(7)
    frequency = rng.uniform(5.0, HIGHEST, (40, contactors))
    phase = rng.uniform(0, 2 * np.pi, (40, contactors))
    field = np.zeros((len(time), contactors))
    for f, p in zip(frequency, phase, strict=True):
        field += np.sin(2 * np.pi * time[:, None] * f + p)
    return field / 16


def send(url: str, seconds: float, latest: bool, file: str) -> None:
    """Write numbered frames for a while, and store the time at which each was written.

    Parameters
    ----------
    url : str
        URL of the server.
    seconds : float
        Duration [s].
    latest : bool
        Whether only the newest frame counts.
    file : str
        File for the times, an array of one for each frame [s, monotonic].
    """
    import tactile.client

    count = int(seconds * FRAME_RATE)
    field = random_field(np.arange(4096) / FRAME_RATE, CONTACTORS).clip(-1, 1)
    sent = np.zeros(count)
    with tactile.client.connect(url) as display:
        frames = display.frames(FRAME_RATE, amplitude=AMPLITUDE, latest=latest)
        begun = time.monotonic() + 0.2
        for k in range(count):
            while (left := begun + k / FRAME_RATE - time.monotonic()) > 0:
                time.sleep(left)
            frame = field[k % len(field)]
            frame[0] = k % COUNT / COUNT
            sent[k] = time.monotonic()
            frames.write(frame)
        time.sleep(0.3)
        np.save(file, sent)


def _configuration(device: str) -> Configuration:
    display = DisplayConfig(name=NAME, display="reference-64", device=device, worn=True)
    return Configuration(server=ServerConfig(port=0, socket=""), display=(display,))


async def _armed(host: Host) -> Client:
    """Return a client of the host that has armed the display."""
    keeper = host.connect("bench", roles=m.ALL_ROLES)
    answer = await keeper.request(m.ArmDisplay(display=NAME))
    assert isinstance(answer, m.Done), answer
    while (await _stats(keeper)).state != "armed":
        await asyncio.sleep(0.01)
    return keeper


async def _stats(client: Client) -> m.StatsReply:
    answer = await client.request(m.GetStats(display=NAME))
    assert isinstance(answer, m.StatsReply)
    return answer


async def _client(server: Server, seconds: float, latest: bool, file: Path) -> Process:
    code = CLIENT.format(server.url, seconds, latest, str(file))
    return await asyncio.create_subprocess_exec(sys.executable, "-c", code)


async def _streamed(device: str, seconds: float, latest: bool, sent: Path) -> m.StatsReply:
    """Play what a client streams; return the state of the display at the end."""
    host = Host(_configuration(device))
    async with running(_configuration(device), host=host) as server:
        keeper = await _armed(host)
        client = await _client(server, seconds, latest, sent)
        if await client.wait():
            raise subprocess.CalledProcessError(client.returncode or 1, "client")
        stats = await _stats(keeper)
        await keeper.request(m.DisarmDisplay(display=NAME))
    return stats


def _counted_on(remainders: Floats) -> NDArray[np.int64]:
    """Return numbers of frames in the order in which they came, from their remainders by `COUNT`.

    Fewer than `COUNT` / 2 frames are missing between two of them.
    """
    return np.rint(np.unwrap(remainders, period=COUNT)).astype(np.int64)


def lateness(traces: dict[str, Floats], sent: Floats, amplifier: VirtualAmplifier) -> Floats:
    """Return the time from each frame to the sample at which it is played (K,) [s].

    Of a queue, this is the sample in whose place the frame is; of the newest frame, the first
    sample that depends on it. The traces hold the remainders of the numbers of frames by `COUNT`,
    as numbers are used again after a minute; which minute it is follows from their order.

    Parameters
    ----------
    traces : dict of str to array
        Traces of `FrameTracingLoop`.
    sent : (F,) array of float
        Times at which the frames were written [s].
    amplifier : VirtualAmplifier
        Amplifier that played them.

    Returns
    -------
    (K,) array of float
        Times of the frames that were played [s].
    """
    position, due, newest, place, distance, stream = traces["blocks"].T
    delay = SamplePlayback(load_display("reference-64"), RATE).timed
    if traces["kind"]:
        delay = LOOK_AHEAD
        fresh = np.flatnonzero(np.diff(newest, prepend=-1.0) != 0)
        number, block, offset = _counted_on(newest[fresh]), fresh, np.zeros(len(fresh))
    else:
        number, index, of_stream = traces["frames"].T
        number = _counted_on(number)
        key, keys = of_stream * 1e9 + index, stream * 1e9 + place
        block = np.searchsorted(keys, key, side="right") - 1
        offset = (key - keys[block]) / distance[block]
        inside = (block >= 0) & (offset < BLOCK)
        number, block, offset = number[inside], block[inside], offset[inside]
    played = output_times(amplifier, position + delay, due + delay / RATE)[block] + offset / RATE
    late = played - sent[number]
    return np.asarray(late[np.isfinite(late)])


def _latencies(name: str, seconds: float, latest: bool) -> Iterator[Figure]:
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--pty", channels=CONTACTORS)) as amplifier,
    ):
        trace, sent = folder / "trace.npz", folder / "sent.npy"
        with traced(traced_frames, trace):
            stats = asyncio.run(_streamed(f"serial://{amplifier.path}", seconds, latest, sent))
        time.sleep(0.1)
        late = 1e3 * lateness(dict(np.load(trace)), np.load(sent), amplifier)
    yield Figure(f"{name}.frames", float(len(late)), "")
    for part, goal in ((50, 12), (99, 20), (99.9, None)):
        value = float(np.percentile(late, part))
        yield at_most(f"{name}.p{part:g}", value, "ms", goal if latest else None)
    for counter in (
        "dropped_frames", "frame_gaps", "late_blocks", "skipped_samples", "underruns",
    ):  # fmt: skip
        yield Figure(f"{name}.{counter}", float(stats.counters[counter]), "")


async def _silences(device: str, latest: bool, how: signal.Signals, folder: Path) -> list[float]:
    """End sources by a signal while they stream; return the times of the signals [s]."""
    host = Host(_configuration(device))
    moments = []
    async with running(_configuration(device), host=host) as server:
        keeper = await _armed(host)
        for _ in range(KILLS):
            client = await _client(server, 60.0, latest, folder / "unused.npy")
            while not host.playing[NAME].memory.shear.any():
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.5)
            client.send_signal(how)
            moments.append(time.monotonic())
            await asyncio.sleep(0.5)
            if client.returncode is None:
                client.kill()
            await client.wait()
            await asyncio.sleep(0.3)
        await keeper.request(m.DisarmDisplay(display=NAME))
    return moments


def _silence(name: str, latest: bool, how: signal.Signals) -> Figure:
    """Measure the longest time from a signal to the last sample that is not at rest."""
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--pty", channels=CONTACTORS)) as amplifier,
    ):
        moments = asyncio.run(_silences(f"serial://{amplifier.path}", latest, how, folder))
        time.sleep(0.1)
        records = amplifier.take()
        times = amplifier.powered_up + records.tick.astype(np.float64) * 1e-6
        loud = np.abs(records.codes).max(axis=1) > AT_REST
    lasting = []
    for moment in moments:
        after = (times > moment) & (times < moment + 0.4) & loud
        if not after.any():  # what did not play when it was ended would end at once
            return not_measured(name, "a source was not played when it was ended")
        lasting.append(1e3 * (times[after].max() - moment))
    return at_most(name, max(lasting), "ms", 120)


def fidelity(frame_rate: float, seconds: float = 2.0) -> float:
    """Return the level of a random field over the error with which the skin plays it [dB].

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    seconds : float
        Duration [s].

    Returns
    -------
    float
        Ratio of the field to its difference from the shear of the skin on ``sim:``, for the delay
        at which that is least.
    """
    display = load_display("reference-24")
    count, amplitude = len(display.contactors), 0.3e-6
    memory = PlaybackMemory.create(count)
    bus = SimulatedDisplay(display, RATE)
    loop = PlaybackLoop(display, bus, memory, worn=True, clock=ModelClock())
    loop.arm()
    number, parts = 0, []
    for _ in range(int(seconds * RATE / BLOCK)):
        came = int(loop.position / RATE * frame_rate) + 1
        if came > number:
            times = np.arange(number, came) / frame_rate
            frames: Singles = (amplitude * random_field(times, count)).astype(np.float32)
            loop.apply(AddFrames(1, frames, frame_rate, latest=False))
            number = came
        loop.step()
        parts.append(bus.take_shear())
    played = np.concatenate(parts) / amplitude
    loop.disarm()
    bus.close()
    memory.close()
    part = slice(int(0.5 * RATE), int((seconds - 0.2) * RATE))
    time_s = np.arange(len(played))[part] / RATE

    def error(delay: float, every: int) -> float:
        sent = random_field(time_s[::every] - delay, count)
        return float(np.mean((played[part][::every] - sent) ** 2))

    # a part of the samples tells the delay to a sample, and takes a tenth of the time
    near = min(np.arange(0, 0.02, 1 / RATE).tolist(), key=lambda delay: error(delay, 16))
    around = near - 1 / RATE, near + 1 / RATE
    best = minimize_scalar(lambda delay: error(delay, 1), bounds=around, method="bounded")
    return float(10 * np.log10(np.mean(played[part] ** 2) / best.fun))


def _block_time(frame_rate: float) -> float:
    """Return the time that a voice takes for a block of frames of 64 contactors [µs]."""
    voice = Voice(RATE, CONTACTORS)
    frames = np.full((1, CONTACTORS), 1e-6, np.float32)
    number, taken = 0, []
    for block in range(1000):
        while number / frame_rate <= block * BLOCK / RATE:
            voice.frames.add(frames, frame_rate, latest=False)
            number += 1
        begun = time.thread_time_ns()
        voice.take(BLOCK)
        taken.append(1e-3 * (time.thread_time_ns() - begun))
    return float(np.median(taken))


def measure_tactile_frames(seconds: float = SHORT) -> Iterator[Figure]:
    """Measure how late, how exactly and at which cost frames are played, and how they end.

    Parameters
    ----------
    seconds : float
        Duration of a stream [s].

    Yields
    ------
    Figure
        Figures.
    """
    for rate in (2000.0, 8000.0):
        name = f"tactile_frames.fidelity.{rate:g}_hz"
        yield at_least(name, fidelity(rate), "dB", 40)
    for rate in (1000.0, 8000.0):
        yield Figure(f"tactile_frames.block.{rate:g}_hz", _block_time(rate), "µs")
    if not can_be_built():
        yield not_measured("tactile_frames.latency", NO_AMPLIFIER)
        return
    for kind, latest in (("latest", True), ("queue", False)):
        name = f"tactile_frames.{kind}"
        yield from beside_machine(name, _latencies(name, seconds, latest))
        for how in (signal.SIGKILL, signal.SIGSTOP):
            yield _silence(f"{name}.{how.name.lower()}", latest, how)


def measure_tactile_frames_long() -> Iterator[Figure]:
    """Measure the same with streams of five minutes."""
    yield from measure_tactile_frames(LONG)
