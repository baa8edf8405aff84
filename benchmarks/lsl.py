"""LSL: how exactly a recorder knows when stimuli began, by the streams of `tactile lsl`.

A client in its own process lets a burst begin 25 times a second, each with a marker, and the server
plays them to the C amplifier on a pty. Another process is the bridge, which offers all streams, and
one more records the markers and the drive with the library of LSL, as any recorder does. The true
onset is where the drive in the amplifier's record agrees best with the burst; the recorded drive is
searched in the same way.
"""

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.onsets import NAME, drive_onsets, marker, played, true_onsets
from benchmarks.virtual import VirtualAmplifier, beside_amplifier, workshop
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most, not_measured

COUNT = 1000
"""Number of bursts: 40 s."""
CLOSE = 0.02
"""Largest distance of a marker from the onset that it may be of [s]; others of its code are 10 s
away."""
STREAMS = "markers", "drive"
"""Streams that are recorded."""
REPORTED = 1.0
"""Time after the report on the last burst within which its marker comes [s]."""
NO_LIBRARY = "needs pylsl: pip install 'tactile-display[lsl]'"
"""Reason why nothing is measured."""


def record(file: str) -> None:
    """Record markers and drive as a recorder does, until standard input ends.

    Parameters
    ----------
    file : str
        File for the arrays of each stream: times on the monotonic clock [s], and values.
    """
    import pylsl

    ended, recorded = threading.Event(), dict[str, tuple[Floats, NDArray[Any]]]()

    def record_stream(quantity: str) -> None:
        streams: list[Any] = []
        while not streams and not ended.is_set():
            streams = pylsl.resolve_byprop("name", f"tactile {NAME} {quantity}", timeout=0.5)
        times, values = list[float](), list[Any]()
        inlet = pylsl.StreamInlet(streams[0])
        while not ended.is_set():
            chunk, stamps = inlet.pull_chunk(timeout=0.2, max_samples=4096)
            values += [np.array(chunk)] if stamps else []
            times += stamps
        recorded[quantity] = np.array(times) - _lsl_offset(), np.concatenate(values)

    threads = [threading.Thread(target=record_stream, args=(name,)) for name in STREAMS]
    for thread in threads:
        thread.start()
    sys.stdin.read()
    ended.set()
    for thread in threads:
        thread.join()
    (marked, texts), (driven, volts) = recorded["markers"], recorded["drive"]
    np.savez(file, markers_times=marked, markers=texts, drive_times=driven, drive=volts)


class _Programs:
    """The bridge and a recorder, in processes of their own."""

    def __init__(self, url: str, file: Path) -> None:
        command = [sys.executable, "-m", "tactile", "lsl", "--url", url, "--json"]
        self._bridge = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        code = f"from benchmarks.lsl import record; record({str(file)!r})"
        self._recorder = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
        self._file, self._began = file, time.monotonic()
        self.summary: dict[str, Any] = {}
        self.recorded: dict[str, NDArray[Any]] = {}
        self.load = 0.0

    def end(self) -> None:
        """End both, the recorder first."""
        self._recorder.communicate()
        lasted = time.monotonic() - self._began
        self._bridge.send_signal(signal.SIGINT)
        assert self._bridge.stdout is not None
        output = self._bridge.stdout.read()
        _, _, used = os.wait4(self._bridge.pid, 0)
        self.load = (used.ru_utime + used.ru_stime) / lasted
        self.summary = json.loads(output)
        with np.load(self._file) as recorded:
            self.recorded = dict(recorded)


def _lsl_offset() -> float:
    """Return the clock of LSL less the monotonic clock, which are the same on Linux [s]."""
    import pylsl

    readings = [(time.monotonic(), pylsl.local_clock(), time.monotonic()) for _ in range(100)]
    # the quickest, as a program that is held up between two readings learns nothing of the clocks
    before, lsl, after = min(readings, key=lambda reading: reading[2] - reading[0])
    return float(lsl - (before + after) / 2)


def _marker_onsets(times: Floats, texts: NDArray[Any], asked: Floats) -> Floats:
    """Return the time of the marker of each burst (K,); NaN where there is not exactly one [s]."""
    onsets = np.full(len(asked), np.nan)
    for k, when in enumerate(asked):
        near = times[(texts == str(marker(k))) & (np.abs(times - when) < CLOSE)]
        onsets[k] = near[0] if len(near) == 1 else np.nan
    return onsets


def _figures(programs: _Programs, rows: Floats, onsets: Floats) -> Iterator[Figure]:
    """Yield the figures of a recording: rows as of `benchmarks.onsets.send`, and true onsets."""
    asked, shown, recorded = rows[:, 0], rows[:, 4], programs.recorded
    by_stream = {
        "marker": _marker_onsets(recorded["markers_times"], recorded["markers"][:, 0], asked),
        "drive": drive_onsets(recorded["drive_times"], recorded["drive"], asked),
    }
    yield Figure("lsl.stimuli", float(len(asked)), "")
    agree = np.isfinite(by_stream["marker"]) == (shown > 0)
    yield at_least("lsl.markers_agree", 100 * float(np.mean(agree)), "%", 100)
    known = np.isfinite(onsets)
    for name, times in by_stream.items():
        error = 1e6 * np.abs(times - onsets)[known]
        yield Figure(f"lsl.{name}.error.p50", float(np.nanpercentile(error, 50)), "µs")
        yield at_most(f"lsl.{name}.error.most", float(np.nanmax(error)), "µs", 1000)
        yield at_most(f"lsl.{name}.missing", float(np.sum(np.isnan(error))), "", 0)
    summary = programs.summary
    yield at_most("lsl.missing_samples", float(summary["missing"]), "", 0)
    yield Figure("lsl.uncertainty.most", float(summary["uncertainty_us"]), "µs")
    yield Figure("lsl.load", 100 * programs.load, "% of a core")


def _recorded(count: int) -> Iterator[Figure]:
    """Yield the figures of bursts that are played on an amplifier and recorded."""
    with workshop() as folder, closing(VirtualAmplifier(folder, "--pty")) as amplifier:
        file, programs = folder / "onsets.npy", list[_Programs]()

        @asynccontextmanager
        async def beside(url: str) -> AsyncIterator[None]:
            programs.append(_Programs(url, folder / "recorded.npz"))
            try:
                yield
                await asyncio.sleep(REPORTED)
            finally:  # in a thread, as the server goes on
                await asyncio.to_thread(programs[0].end)

        asyncio.run(played(f"serial://{amplifier.path}", count, file, beside))
        rows = np.asarray(np.load(file))
        onsets = true_onsets(amplifier.take(), amplifier.powered_up, rows[:, 0])
        yield from _figures(programs[0], rows, onsets)


def measure_lsl(count: int = COUNT) -> Iterator[Figure]:
    """Measure how exactly a recorder of LSL knows when stimuli began.

    Parameters
    ----------
    count : int
        Number of stimuli.

    Yields
    ------
    Figure
        Figures.
    """
    if find_spec("pylsl") is None:
        yield not_measured("lsl", NO_LIBRARY)
    else:
        yield from beside_amplifier("lsl", _recorded(count))
