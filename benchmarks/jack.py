"""JACK: how late, how evenly and how exactly `tactile jack` plays what an audio program sends.

A JACK client in its own process plays tones on 24 ports, whose phase is a function of the number of
JACK's frame. `tactile jack` plays them on a server, which drives the C amplifier on a pty. The
amplifier's record holds when each sample was put out; the time of each frame is that of JACK.
"""

import ctypes
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.server import (
    NAME,
    PATIENCE,
    ServerProcess,
    amplifier_and_folder,
    connected,
    wait_for,
)
from benchmarks.tones import (
    CHANNELS,
    JACK_RATE,
    FrameClock,
    ToneFit,
    fit_seconds,
    tone_table,
    wanted_drive,
)
from benchmarks.virtual import VirtualAmplifier, beside_amplifier
from firmware_protocol.messages import FULL_SCALE_CODE, State
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_most, not_measured
from tactile.client import RemoteDisplay
from tactile.display.display import load_display

SHORT, LONG = 60, 600
"""Durations of the tones [s]."""
PERIOD = 128
"""Frames of a cycle of JACK."""
SETTLING = 10.0
"""Time for which the tones are played before they are measured [s]. In the first seconds the clock
of the amplifier is known to some 0.1 ms (`python -m benchmarks clock`)."""
HEADROOM = 8
"""Time that the bridge adds to the latency of the display, as it does by default at first [ms]."""
FULL_SCALE = 10e-6
"""Shear of a value of 1, the default of the command [m]."""
DISTURBED = 1e-3
"""Share of power that is no tone above which something was left out of a second: one of 1000 ms."""
AFTER = 2.0
"""Time after JACK was late for which a second does not count: JACK needs it to know its clock again
[s]."""
SHORTLY = 0.3
"""Time between a cause and its count [s]."""
Counted = tuple[float, dict[str, int]]
"""Time [s], and counters of a display."""
NO_JACK = "needs jackd (apt install jackd2) and pip install 'tactile-display[jack]'"
"""Reason why nothing is measured."""
CONNECTED = ".connected"
"""Suffix of the file that says that the source is connected."""
CLIENT = "from benchmarks.jack import play_tones; play_tones({!r}, {!r}, {!r})"
"""Code of the source's process."""
COUNTED = "dropped_frames", "frame_gaps", "limited_samples", "skipped_samples", "underruns"
"""Counters of the display whose change is reported."""
OURS = COUNTED[:3]
"""Counters that are to stay at 0 whatever the machine does beside."""


class _CycleReader:
    """Reader of the times of JACK's cycles, in the process callback.

    JACK-Client has no function for these times, which are not those that the bridge measures.
    """

    def __init__(self, client: Any) -> None:
        import jack

        self._jack = ctypes.CDLL("libjack.so.0")
        self._jack.jack_get_time.restype = ctypes.c_uint64
        self._client = ctypes.c_void_p(int(jack._ffi.cast("uintptr_t", client._ptr)))
        self._values = ctypes.c_uint32(), ctypes.c_uint64(), ctypes.c_uint64(), ctypes.c_float()
        self._pointers = [ctypes.byref(value) for value in self._values]

    def row(self) -> tuple[int, int, float, int, float]:
        """Return a row of `FrameClock.of`."""
        self._jack.jack_get_cycle_times(self._client, *self._pointers)
        before = time.monotonic()
        now = self._jack.jack_get_time()
        return self._values[0].value, self._values[1].value, before, now, time.monotonic()


def play_tones(server: str, sink: str, file: str) -> None:
    """Play the tones as an audio program does, until standard input ends.

    Parameters
    ----------
    server : str
        Name of the JACK server.
    sink : str
        Name of the client to whose ports they are sent.
    file : str
        File for the arrays: rows as of `FrameClock.of`, and the times of xruns. One beside it,
        with the suffix `CONNECTED`, appears when the ports are connected.
    """
    import jack

    client = jack.Client("tones", no_start_server=True, servername=server)
    table, reader, rows, xruns = tone_table(), _CycleReader(client), list[Any](), list[float]()
    ports = [client.outports.register(f"out_{k + 1}") for k in range(CHANNELS)]

    def process(count: int) -> None:
        rows.append(reader.row())
        first = client.last_frame_time % JACK_RATE
        for port, values in zip(ports, table[:, first : first + count], strict=True):
            port.get_array()[:] = values

    client.set_process_callback(process)
    client.set_xrun_callback(lambda _: xruns.append(time.monotonic()))
    gc.disable()
    client.activate()
    sinks = list[Any]()
    while len(sinks) < CHANNELS:
        time.sleep(0.1)
        every = client.get_ports(is_input=True, is_audio=True)
        sinks = [port for port in every if port.name.startswith(f"{sink}:")]
    for source, port in zip(ports, sinks, strict=True):
        client.connect(source, port)
    Path(file).with_suffix(CONNECTED).touch()  # standard output is the library's
    sys.stdin.read()
    client.deactivate()
    np.savez(file, rows=np.array(rows, np.float64), xruns=np.array(xruns))
    client.close()


@contextmanager
def _jack_server(folder: Path) -> Iterator[str]:
    """Run a JACK server with a dummy card, which all programs that are started meanwhile use."""
    name = "tactile-bench"  # one for all runs: those that are killed use up JACK's few places
    words = ["jackd", "--no-mlock", "--realtime", "-n", name, "--port-max", "1024", "-d", "dummy"]
    card = ["-r", str(JACK_RATE), "-p", str(PERIOD), "-C", "2", "-P", "2"]
    settings = {
        "JACK_DEFAULT_SERVER": name, "JACK_NO_START_SERVER": "1", "JACK_NO_AUDIO_RESERVATION": "1",
    }  # fmt: skip
    with (folder / "jackd.log").open("w") as log:
        process = subprocess.Popen([*words, *card], stdout=log, stderr=log)
    try:
        with patch.dict(os.environ, settings):
            yield name
    finally:
        process.terminate()
        process.wait()


class _Programs:
    """The bridge and the source, in processes of their own."""

    def __init__(self, server: ServerProcess, jack_server: str, folder: Path) -> None:
        self._file, self._log = folder / "tones.npz", folder / "programs.log"
        command = [sys.executable, "-m", "tactile", "jack", "--url", server.url, "--json"]
        command += ["--headroom-ms", str(HEADROOM)]
        code = CLIENT.format(jack_server, f"tactile {NAME}", str(self._file))
        with self._log.open("w") as log:
            self.bridge = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
            self._source = subprocess.Popen(
                [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=log, stderr=log
            )
        self.summary: dict[str, Any] = {}

    def are_connected(self) -> bool:
        """Return whether the source plays on the bridge's ports."""
        for process in (self.bridge, self._source):
            if process.poll() is not None:
                raise RuntimeError(f"a program has ended: {self._log.read_text()[-2000:]}")
        return self._file.with_suffix(CONNECTED).exists()

    def end(self) -> tuple[FrameClock, Floats]:
        """End both, the bridge first; return JACK's clock, and the times of its xruns [s]."""
        self.bridge.send_signal(signal.SIGINT)
        self.summary = json.loads(self.bridge.communicate()[0])
        self._source.communicate()
        with np.load(self._file) as logged:
            return FrameClock.of(logged["rows"]), logged["xruns"]

    def close(self) -> None:
        """End both in any state."""
        for process in (self.bridge, self._source):
            process.kill()
            process.wait()


def _is_armed(display: RemoteDisplay) -> bool:
    """Return whether a display is armed; arm one that is not, as its page would do."""
    if display.stats(timeout=PATIENCE).state == "armed":
        return True
    display.arm(timeout=PATIENCE)
    return False


class _Span(NamedTuple):
    """Observations while the tones were measured.

    Latency of the display [s], its counters at times [s], the bridge's load of a core, and how
    often the display had been disarmed.
    """

    latency: float
    counters: list[Counted]
    load: float
    disarmed: int

    @property
    def begin(self) -> float:
        """Begin [s]."""
        return self.counters[0][0]

    @property
    def end(self) -> float:
        """End [s]."""
        return self.counters[-1][0]


def _processor_time(pid: int) -> float:
    """Return the processor time of a process and of its children [s]."""
    spent = 0
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if pid in (int(entry.name), int(fields[1])):
                spent += int(fields[11]) + int(fields[12])
    return spent / os.sysconf("SC_CLK_TCK")


def _observe(display: RemoteDisplay, bridge: int, seconds: int) -> _Span:
    """Let the tones play; a display that playback has disarmed is armed again."""
    counted, latencies, disarmed = list[Counted](), list[float](), 0
    begun, spent = time.monotonic(), _processor_time(bridge)
    while not counted or time.monotonic() < begun + seconds:
        time.sleep(1.0 if counted else 0.0)
        disarmed += not _is_armed(display)
        stats = display.stats(timeout=PATIENCE)
        counted.append((time.monotonic(), stats.counters))
        latencies += [] if stats.latency is None else [stats.latency]
    load = (_processor_time(bridge) - spent) / (time.monotonic() - begun)
    return _Span(float(np.median(latencies or [np.nan])), counted, load, disarmed)


def split_counts(counters: list[Counted], name: str, breaks: Floats) -> tuple[int, int]:
    """Split what was counted by whether JACK was late.

    Parameters
    ----------
    counters : list of tuple
        Times [s] and counters.
    name : str
        Name of the counter.
    breaks : (K,) array of float
        Times at which JACK was late [s].

    Returns
    -------
    tuple of int
        Count while it was not, and while it was or just before.
    """
    apart = [0, 0]
    for (begin, before), (end, after) in pairwise(counters):
        late = bool(np.any((breaks > begin - SHORTLY) & (breaks < end + SHORTLY)))
        apart[late] += after[name] - before[name]
    return apart[0], apart[1]


def _record(amplifier: VirtualAmplifier, span: _Span) -> tuple[Floats, NDArray[np.int16]]:
    """Return the times [s] and the codes of what was put out while a span lasted."""
    times, codes = list[Floats](), list[NDArray[np.int16]]()
    for records in amplifier.chunks():
        when = amplifier.powered_up + 1e-6 * records.tick.astype(np.float64)
        inside = (when >= span.begin) & (when < span.end + 1) & (records.state == State.RUNNING)
        times.append(when[inside])
        codes.append(records.codes[inside].copy())
    return np.concatenate(times), np.concatenate(codes)


def undisturbed(fits: list[ToneFit], breaks: Floats) -> tuple[list[ToneFit], list[ToneFit]]:
    """Return the seconds in which JACK was not late, and those of them that have no gap.

    Parameters
    ----------
    fits : list of ToneFit
        Seconds of the record.
    breaks : (K,) array of float
        Times at which JACK was late [s].

    Returns
    -------
    calm, whole : list of ToneFit
        Seconds.
    """
    calm = [
        fit for fit in fits
        if not np.any((breaks > fit.begin - AFTER) & (breaks < fit.begin + 1.0))
    ]  # fmt: skip
    return calm, [fit for fit in calm if fit.noise < DISTURBED]


def _delays(name: str, whole: list[ToneFit], clock: FrameClock, span: _Span) -> Iterator[Figure]:
    """Yield the figures of the delay."""
    delays = np.array([fit.delay for fit in whole])
    total = float(np.median(delays))
    yield Figure(f"{name}.latency", 1e3 * total, "ms")
    yield Figure(f"{name}.latency.display", 1e3 * span.latency, "ms")
    yield at_most(f"{name}.latency.added", 1e3 * (total - span.latency), "ms", 10)
    for kind, off in (
        ("delay", delays - total),
        ("clock_of_jack", clock.wander(span.begin, span.end)),
    ):
        if len(off):
            yield Figure(f"{name}.{kind}.p99", 1e6 * float(np.percentile(np.abs(off), 99)), "µs")
            yield Figure(f"{name}.{kind}.most", 1e6 * float(np.abs(off).max()), "µs")


def _fidelity(name: str, whole: list[ToneFit]) -> Iterator[Figure]:
    """Yield the figures of level and phase, once a constant delay is taken off."""
    total = float(np.median([fit.delay for fit in whole]))
    ratio = np.mean([fit.without(total) for fit in whole], axis=0)
    level, phase = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    yield at_most(f"{name}.level", float(np.abs(level).max()), "dB", 0.1)
    yield at_most(f"{name}.phase", float(np.abs(phase).max()), "°", 1)
    noise = 10 * np.log10(max(fit.noise for fit in whole))
    yield Figure(f"{name}.noise", float(noise), "dB")


def _run(name: str, seconds: int) -> Iterator[Figure]:
    """Yield the figures of tones that are played on an amplifier."""
    with (
        amplifier_and_folder() as (amplifier, folder),
        _jack_server(folder) as jack_server,
        closing(ServerProcess(folder, amplifier.path)) as server,
        closing(_Programs(server, jack_server, folder)) as programs,
    ):
        with connected(server) as display:
            wait_for("the source is connected", programs.are_connected)
            wait_for("the display is armed", lambda: _is_armed(display))
            time.sleep(SETTLING)
            span = _observe(display, programs.bridge.pid, seconds)
            time.sleep(1.0)
        clock, xruns = programs.end()
        times, codes = _record(amplifier, span)
    yield from _figures(name, span, _fits(clock, times, codes), clock, xruns)
    for count in ("frames", "missing", "dropped", "gaps", "xruns"):  # since it was started
        yield Figure(f"{name}.bridge.{count}", float(programs.summary[count]), "")


def _fits(clock: FrameClock, times: Floats, codes: NDArray[np.int16]) -> list[ToneFit]:
    """Return the seconds of a record of `reference-24`."""
    display = load_display("reference-24")
    drive = wanted_drive(display, FULL_SCALE) * FULL_SCALE_CODE / display.limits.voltage
    return fit_seconds(clock, times, codes[:, display.channel], drive)


def _figures(
    name: str, span: _Span, fits: list[ToneFit], clock: FrameClock, xruns: Floats
) -> Iterator[Figure]:
    """Yield the figures of a span."""
    breaks = np.concatenate([xruns, clock.breaks()])
    calm, whole = undisturbed(fits, breaks)
    yield Figure(f"{name}.seconds", float(len(fits)), "s")
    missing = max(int(span.end - span.begin) - len(fits), 0)
    yield Figure(f"{name}.seconds.not_put_out", float(missing), "s")
    yield Figure(f"{name}.seconds.with_xruns", float(len(fits) - len(calm)), "s")
    yield at_most(f"{name}.seconds.disturbed", float(len(calm) - len(whole)), "s", 0)
    if whole:
        yield from _delays(name, whole, clock, span)
        yield from _fidelity(name, whole)
    else:
        yield not_measured(f"{name}.latency", "no second was played without gaps")
    yield Figure(f"{name}.disarmed", float(span.disarmed), "")
    for counter in COUNTED:
        ours, beside = split_counts(span.counters, counter, breaks)
        yield at_most(f"{name}.{counter}", float(ours), "", 0 if counter in OURS else None)
        yield Figure(f"{name}.{counter}.with_xruns", float(beside), "")
    inside = (xruns > span.begin) & (xruns < span.end)
    yield Figure(f"{name}.xruns", float(np.sum(inside)), "")
    yield Figure(f"{name}.load", 100 * span.load, "% of a core")


def measure_jack(seconds: int = SHORT) -> Iterator[Figure]:
    """Measure how late, how evenly and how exactly an audio program is played.

    Parameters
    ----------
    seconds : int
        Duration of the tones [s].

    Yields
    ------
    Figure
        Figures.
    """
    if shutil.which("jackd") is None or find_spec("jack") is None:
        yield not_measured("jack", NO_JACK)
    else:
        yield from beside_amplifier("jack", _run("jack", seconds))


def measure_jack_long() -> Iterator[Figure]:
    """Measure the same with ten minutes of tones."""
    yield from measure_jack(LONG)
