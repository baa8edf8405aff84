"""Onsets: when stimuli begin that were to begin at a time, and what is reported of them.

A burst begins 25 times a second, each on another contactor. Over a serial link a client in its own
process lets them begin at times of its own clock, and the server plays them to the C amplifier on a
pty. Over CAN FD they are ordered from the playback of this process, as the model of the link is
within reach of one process only. The true onset is where the drive in the amplifier's record agrees
best with the rendered burst, which knows nothing of what playback and server say about it. Each
burst has a marker, whose code has to rise with the same sample.
"""

import asyncio
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, closing, nullcontext
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.virtual import (
    Records,
    VirtualAmplifier,
    beside_amplifier,
    can_bus,
    real_time,
    workshop,
)
from tactile import messages as m
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most
from tactile.bus.base import Bus
from tactile.bus.wire_time import Can
from tactile.display.display import Display, load_display
from tactile.playback.block_rendering import BLOCK
from tactile.playback.commands import AppendSamples, OnsetReport, PlayAt
from tactile.playback.loop import PlaybackLoop
from tactile.playback.shared_memory import PlaybackMemory
from tactile.rendering.renderer import Renderer
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.host import Host
from tactile.server.server import running

PERIOD, AHEAD = 0.04, 0.15
"""Time from one burst to the next, and by which each is sent ahead [s]."""
CONTACTORS = 24
SHORT, LONG = 500, 5000
"""Numbers of bursts."""
SETTLING = 10.0
"""Time for which the link is up before bursts are ordered, as one to a server is [s]. In the first
seconds the clock of the amplifier is known to some 0.1 ms (`python -m benchmarks clock`)."""
AMPLITUDE = 2e-6
"""Shear of a burst [m]."""
CLIENT = "from benchmarks.onsets import send; send({!r}, {!r}, {!r})"
"""Code of the client's process."""
NAME = "bench"
"""Name of the display."""
HEAD, MARKS = struct.Struct("<QBI"), 18
"""Head of a record of what the amplifier sent, with its tick, kind and length, and the kind of a
change of the marker lines, of which the last byte is the code."""
SEARCHED = 0.03
"""Time around that of a stimulus in which its burst is looked for [s]."""


def burst() -> Floats:
    """Return the values of a burst at `RATE`: 16 ms of 250 Hz under half a period of a sine."""
    time_s = np.arange(int(0.016 * RATE)) / RATE
    return np.asarray(np.cos(2 * np.pi * 250 * time_s) * np.sin(np.pi * time_s / 0.016))


def marker(k: int) -> int:
    """Return the code of the marker of a burst, which those near to it do not have.

    Parameters
    ----------
    k : int
        Number of the burst.

    Returns
    -------
    int
        Code from 1 to 255.
    """
    return k % 255 + 1


def planned(count: int) -> Floats:
    """Return times at which bursts are to begin, from half a second ahead.

    Parameters
    ----------
    count : int
        Number of bursts, K.

    Returns
    -------
    (K,) array of float
        Times on the host's monotonic clock [s].
    """
    varied = np.random.default_rng(3).uniform(0, PERIOD / 4, count)
    return np.asarray(time.monotonic() + 0.5 + PERIOD * np.arange(count) + varied)


def send(url: str, count: int, file: str) -> None:
    """Let bursts begin at times, and store these and what is reported of them.

    Parameters
    ----------
    url : str
        Address of the server.
    count : int
        Number of bursts, K.
    file : str
        File for an array (K, 5): time that was given, reported onset and its uncertainty [s],
        whether there was a reason, and the code that the marker lines are reported to have shown.
    """
    import tactile.client

    samples = burst().tolist()
    stimuli = [
        tactile.client.At(float(when), marker=marker(k)) for k, when in enumerate(planned(count))
    ]
    with tactile.client.connect(url) as display:
        for k, at in enumerate(stimuli):
            while (left := at.time - AHEAD - time.monotonic()) > 0:
                time.sleep(left)
            display.append(
                samples, sample_rate=RATE, amplitude=AMPLITUDE, contactors=(k % CONTACTORS,), at=at
            )
        onsets = [at.onset(10.0) for at in stimuli]
    nan = float("nan")
    rows = [
        (o.at, nan if o.time is None else o.time, nan if o.uncertainty is None else o.uncertainty,
         float(bool(o.reason)), o.marker)
        for o in onsets
    ]  # fmt: skip
    np.save(file, np.array(rows))


async def played(
    device: str,
    count: int,
    file: Path,
    beside: Callable[[str], AbstractAsyncContextManager[object]],
) -> None:
    """Play the bursts that a client sends, on a display that stays armed.

    Parameters
    ----------
    device : str
        URL of the amplifier.
    count : int
        Number of bursts.
    file : Path
        File for what is reported of them, as of `send`.
    beside : Callable
        Function that takes the address of the server, and returns a context that is open from the
        time on at which the display is armed.
    """
    display = DisplayConfig(name=NAME, device=device, worn=True)
    config = Configuration(server=ServerConfig(port=0, socket=""), display=(display,))
    host = Host(config)
    async with running(config, host=host) as server:
        keeper = host.connect("bench", roles=m.ALL_ROLES)
        answer = await keeper.request(m.ArmDisplay(display=NAME))
        assert isinstance(answer, m.Done), answer
        async with beside(server.url):
            await asyncio.sleep(SETTLING)
            code = CLIENT.format(server.url, count, str(file))
            client = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
            if await client.wait():
                raise subprocess.CalledProcessError(client.returncode or 1, "client")
        await keeper.request(m.DisarmDisplay(display=NAME))


def _played_over_can(bus: Bus, display: Display, count: int) -> Floats:
    """Play on a bus from this process; return rows as of `send`."""
    time.sleep(SETTLING)
    samples, times = (AMPLITUDE * burst()).astype(np.float32), planned(count)
    reports: dict[int, OnsetReport] = {}
    ordered = 0
    with closing(PlaybackMemory.create(CONTACTORS)) as memory, real_time():
        player = PlaybackLoop(display, bus, memory, worn=True)
        player.arm()
        while len(reports) < count:
            while ordered < count and times[ordered] < time.monotonic() + AHEAD:
                order = AppendSamples(1, samples, RATE, (ordered % CONTACTORS,), append=True)
                when, code = float(times[ordered]), marker(ordered)
                player.apply(PlayAt(ordered, 1, when, False, order, code))
                ordered += 1
            player.step()
            reports |= {report.number: report for report in player.report_onsets()}
        player.disarm()
    return np.array([
        (times[k], reports[k].time, reports[k].uncertainty, float(bool(reports[k].reason)),
         reports[k].marker)
        for k in range(count)
    ])  # fmt: skip


def template() -> tuple[Floats, int]:
    """Return the drive of a burst on all contactors (S, N) [V], and the sample of its onset."""
    renderer, start = Renderer(load_display("reference-24"), None, sample_rate=RATE), 160
    shear = np.zeros((640, CONTACTORS), np.float32)
    shear[start : start + len(burst())] = AMPLITUDE * burst()[:, None]
    rest = np.zeros((BLOCK, 2)), np.full(BLOCK, 0.5)
    parts = [
        renderer.block(*rest, waveform=shear[k : k + BLOCK]) for k in range(0, len(shear), BLOCK)
    ]
    return np.concatenate(parts), start + renderer.delay


def drive_onsets(times: Floats, values: NDArray[np.number], asked: Floats) -> Floats:
    """Return the time at which each burst began, by the drive (K,) [s].

    Parameters
    ----------
    times : (S,) array of float
        Time of each sample [s].
    values : (S, N) array
        Drive of each contactor, in any unit.
    asked : (K,) array of float
        Times at which the bursts were to begin [s].

    Returns
    -------
    (K,) array of float
        Times; NaN where no drive is like a burst [s].
    """
    drive, onset = template()
    onsets = np.full(len(asked), np.nan)
    for k, when in enumerate(asked):
        first = int(np.searchsorted(times, when - SEARCHED)) - onset
        part = values[max(first, 0) :, k % CONTACTORS][: 2 * int(SEARCHED * RATE) + 640]
        wanted = drive[:, k % CONTACTORS]
        if len(part) < len(wanted):
            continue
        windows = np.lib.stride_tricks.sliding_window_view(part.astype(np.float64), len(wanted))
        likeness = windows @ wanted / (np.linalg.norm(windows, axis=1) + 1e-9)
        best = int(likeness.argmax())
        if likeness[best] > 0.99 * np.linalg.norm(wanted):
            onsets[k] = times[max(first, 0) + best + onset]
    return onsets


def true_onsets(records: Records, powered_up: float, asked: Floats) -> Floats:
    """Return the time at which each burst began, by the amplifier's record (K,) [s].

    Parameters
    ----------
    records : Records
        Output of the amplifier.
    powered_up : float
        Time at which its clock was 0 [s].
    asked : (K,) array of float
        Times at which the bursts were to begin [s].

    Returns
    -------
    (K,) array of float
        Times; NaN where no drive is like a burst [s].
    """
    times = powered_up + records.tick.astype(np.float64) * 1e-6
    return drive_onsets(times, records.codes, asked)


def marker_times(file: Path, powered_up: float, asked: Floats) -> Floats:
    """Return the time at which the marker of each burst rose, by the amplifier's record (K,) [s].

    Parameters
    ----------
    file : Path
        Record of what the amplifier sent.
    powered_up : float
        Time at which its clock was 0 [s].
    asked : (K,) array of float
        Times at which the bursts were to begin [s].

    Returns
    -------
    (K,) array of float
        Times; NaN where the code did not rise near that time [s].
    """
    data, at = file.read_bytes(), 0
    rises: dict[int, list[float]] = {}
    while at < len(data):
        tick, kind, size = HEAD.unpack_from(data, at)
        at += HEAD.size + size
        if kind == MARKS:
            rises.setdefault(data[at - 1], []).append(powered_up + tick * 1e-6)
    times = np.full(len(asked), np.nan)
    for k, when in enumerate(asked):
        near = [rise for rise in rises.get(marker(k), []) if abs(rise - when) < SEARCHED]
        times[k] = near[0] if len(near) == 1 else np.nan
    return times


def _figures(name: str, rows: Floats, onsets: Floats, rises: Floats) -> Iterator[Figure]:
    """Yield the figures of bursts: rows as of `send`, times of their samples and their markers."""
    asked, reported, uncertainty, excused, shown = rows.T
    error = np.abs(onsets - asked)
    missed = ~(error <= 1 / RATE)
    inside = np.abs(onsets - reported) <= uncertainty
    known = np.isfinite(reported)
    yield Figure(f"{name}.stimuli", float(len(asked)), "")
    yield at_least(f"{name}.within_a_sample", 100 * float(np.mean(~missed)), "%", 99.9)
    yield Figure(f"{name}.error.p50", 1e6 * float(np.nanpercentile(error, 50)), "µs")
    yield Figure(f"{name}.error.most", 1e6 * float(np.nanmax(error)), "µs")
    yield at_most(f"{name}.unreported_misses", float(np.sum(missed & ~excused.astype(bool))), "", 0)
    yield at_least(f"{name}.within_interval", 100 * float(np.mean(inside[known])), "%", 99)
    yield Figure(f"{name}.uncertainty.p50", 1e6 * float(np.nanpercentile(uncertainty, 50)), "µs")
    with_sample = np.abs(rises - onsets) < 0.5 / RATE
    yield at_least(f"{name}.marked_with_sample", 100 * float(np.mean(with_sample)), "%", 99.9)
    confirmed = shown == [marker(k) for k in range(len(rows))]
    wrong = confirmed != np.isfinite(rises)
    yield at_most(f"{name}.markers_misreported", float(np.sum(wrong)), "", 0)


def _measured(
    name: str, folder: Path, link: tuple[str, ...], play: Callable[[VirtualAmplifier], Floats]
) -> Iterator[Figure]:
    """Yield the figures of bursts that a function plays on an amplifier, by its record."""
    sent = folder / "sent"
    with closing(VirtualAmplifier(folder, *link, "--sent", str(sent))) as amplifier:
        rows = play(amplifier)
        time.sleep(0.1)
        onsets = true_onsets(amplifier.take(), amplifier.powered_up, rows[:, 0])
    yield from _figures(name, rows, onsets, marker_times(sent, amplifier.powered_up, rows[:, 0]))


def _serial(count: int) -> Iterator[Figure]:
    with workshop() as folder:
        file = folder / "onsets.npy"

        def play(amplifier: VirtualAmplifier) -> Floats:
            device = f"serial://{amplifier.path}"
            asyncio.run(played(device, count, file, lambda url: nullcontext()))
            return np.asarray(np.load(file))

        yield from _measured("onsets.serial", folder, ("--pty",), play)


def _can(count: int) -> Iterator[Figure]:
    display = load_display("reference-24")
    with workshop() as folder:

        def play(_: VirtualAmplifier) -> Floats:
            with can_bus(folder, display, Can(1e6, 5e6), rearm=True) as bus:
                return _played_over_can(bus, display, count)

        link = "--can", str(folder / "can"), "--fd"
        yield from _measured("onsets.canfd_1_5", folder, link, play)


def measure_onsets(count: int = SHORT) -> Iterator[Figure]:
    """Measure when stimuli begin that were to begin at a time.

    Parameters
    ----------
    count : int
        Number of stimuli on each link.

    Yields
    ------
    Figure
        Figures.
    """
    yield from beside_amplifier("onsets", chain(_serial(count), _can(count)))


def measure_onsets_long() -> Iterator[Figure]:
    """Measure the same with 5000 stimuli on each link."""
    yield from measure_onsets(LONG)
