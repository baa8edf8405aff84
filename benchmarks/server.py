"""A server in its own process that plays on the C amplifier, and the amplifier's output.

Whatever is done to the processes, the amplifier's own record tells by its own clock when a voltage
was last put out and until when high voltage was on.
"""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import tactile.client
from benchmarks.virtual import VirtualAmplifier, largest_step, workshop
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.bench.figures import Figure, at_most
from tactile.client import RemoteDisplay
from tactile.display.display import load_display
from tactile.errors import ClientError
from tactile.playback.block_rendering import BLOCK

NAME = "tactile-bench"
"""Name of the display. An e-stop that names it stops no other server's display."""
PATIENCE = 60.0
"""Time within which whatever is waited for must happen [s]."""
POLL = 0.02
"""Interval between checks of a condition [s]."""
SETTLED = 0.2
"""Share of the time after which memory has grown to what it needs."""


class AmplifierOutput(NamedTuple):
    """Output of the amplifier.

    Attributes
    ----------
    times : (K,) array of float
        Time of each instant on the monotonic clock [s].
    is_loud : (K,) array of bool
        Whether any channel was not at 0 V.
    high_voltage : (K,) array of bool
        Whether high voltage was on.
    """

    times: NDArray[np.float64]
    is_loud: NDArray[np.bool_]
    high_voltage: NDArray[np.bool_]

    def since(self, moment: float) -> "AmplifierOutput":
        """Return the output after a moment [s]."""
        first = int(np.searchsorted(self.times, moment, side="right"))
        return AmplifierOutput(self.times[first:], self.is_loud[first:], self.high_voltage[first:])

    def reaches(self, moment: float) -> bool:
        """Return whether the output goes beyond a moment [s]."""
        return len(self.times) > 0 and bool(self.times[-1] > moment)


def last_after(times: NDArray[np.float64], is_set: NDArray[np.bool_], moment: float) -> float:
    """Return how long after a moment something was last set [s]; 0 if it was not set after it."""
    after = times[is_set & (times > moment)]
    return float(after.max() - moment) if len(after) else 0.0


class OutputRecorder:
    """Reader of an amplifier's record that keeps the largest values.

    Parameters
    ----------
    amplifier : VirtualAmplifier
        Amplifier whose output is read.

    Attributes
    ----------
    largest : int
        Largest absolute value of all codes.
    largest_step : int
        Largest step between two instants [codes].
    """

    def __init__(self, amplifier: VirtualAmplifier) -> None:
        self._amplifier = amplifier
        self._last = np.zeros((1, 1), np.int32)
        self.largest = self.largest_step = 0

    def read(self) -> AmplifierOutput:
        """Return the output since the last call."""
        parts = [AmplifierOutput(np.empty(0), np.empty(0, bool), np.empty(0, bool))]
        for records in self._amplifier.chunks():
            self._measure(records.codes.astype(np.int32))
            parts.append(
                AmplifierOutput(
                    self._amplifier.powered_up + records.tick.astype(np.float64) * 1e-6,
                    np.asarray(records.codes.any(axis=1)),
                    records.high_voltage != 0,
                )
            )
        return joined(parts)

    def read_until(
        self, happens: Callable[[AmplifierOutput], bool], what: str, *, span: float = math.inf
    ) -> AmplifierOutput:
        """Return the output until a condition of it is true, or the last span of it [s].

        Raises
        ------
        TimeoutError
            If it does not become true in time.
        """
        parts: list[AmplifierOutput] = []

        def is_true() -> bool:
            parts[:] = [joined([*parts, self.read()]).since(time.monotonic() - span)]
            return happens(parts[0])

        wait_for(what, is_true)
        return parts[0]

    def _measure(self, codes: NDArray[np.int32]) -> None:
        before = np.broadcast_to(self._last, (1, codes.shape[1]))
        steps = np.abs(np.diff(codes, axis=0, prepend=before))
        self.largest = max(self.largest, int(np.abs(codes).max()))
        self.largest_step = max(self.largest_step, int(steps.max()))
        self._last = codes[-1:]

    def figures(self, name: str) -> Iterator[Figure]:
        """Yield the largest values, relative to their limits."""
        yield at_most(f"{name}.largest_voltage", self.largest / FULL_SCALE_CODE, "of limit", 1)
        yield largest_step(name, self.largest_step, load_display("reference-24"))


def joined(parts: list[AmplifierOutput]) -> AmplifierOutput:
    """Return the outputs of several spans as one."""
    return AmplifierOutput(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def wait_for(what: str, happens: Callable[[], object]) -> None:
    """Wait until a condition is true; as long as the server refuses what it asks, it is false.

    Raises
    ------
    TimeoutError
        If it does not become true in time.
    """
    deadline = time.monotonic() + PATIENCE
    refusal = None
    while time.monotonic() < deadline:
        try:
            if happens():
                return
        except ClientError as error:
            refusal = error
        time.sleep(POLL)
    raise TimeoutError(f"{what}: not within {PATIENCE:g} s") from refusal


def send_signal(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process if it still exists."""
    with suppress(ProcessLookupError):
        os.kill(pid, number)


def is_alive(pid: int) -> bool:
    """Return whether a process runs, or is stopped."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    return False


def children_of(pid: int) -> dict[str, int]:
    """Return the processes that a server started: "playback.process", "preparing" and others."""
    processes = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == pid:
                words = (entry / "cmdline").read_text()
                for kind in ("playback.process", "preparing", "estop.process", "session_recorder"):
                    if kind in words and is_alive(int(entry.name)):
                        processes[kind] = int(entry.name)
    return processes


class ServerProcess:
    """`tactile serve` in its own process, on an amplifier.

    Parameters
    ----------
    folder : Path
        Folder for its configuration and log.
    device : str
        Path of the amplifier's pty.
    worn : bool
        Whether the finger stays on the display.
    log : str
        File of the log.
    osc : int
        OSC port, 0 for none.
    server : str
        Further lines of the table ``server``.
    record : str
        Folder for sessions; nothing is recorded if it is empty.
    """

    def __init__(
        self,
        folder: Path,
        device: str,
        *,
        worn: bool = True,
        log: str = "log",
        osc: int = 0,
        server: str = "",
        record: str = "",
    ) -> None:
        self._config, self._stderr = folder / "tactile.toml", folder / "stderr"
        recorded = f'[record]\nfolder = "{record}"\n' if record else ""
        self._config.write_text(
            f'[server]\nport = 0\n{server}\n[osc]\nport = {osc}\n[log]\nfile = "{log}"\n{recorded}'
            f'[[display]]\nname = "{NAME}"\ndevice = "serial://{device}"\n'
            f"worn = {str(worn).lower()}\n"
        )
        self.start()

    def start(self) -> None:
        """Start the server, and wait until it listens."""
        words = ["-m", "tactile", "serve", "--config", str(self._config)]
        with self._stderr.open("a") as stderr:
            self._process = subprocess.Popen(
                [sys.executable, *words], stdout=subprocess.PIPE, stderr=stderr, text=True
            )
        assert self._process.stdout is not None
        line = self._process.stdout.readline().split()
        if not line:
            code, why = self._process.wait(), self._stderr.read_text()[-2000:]
            raise RuntimeError(f"the server did not start: exit code {code}: {why}")
        self.url = line[0]

    @property
    def pid(self) -> int:
        """Process identifier of the server."""
        return self._process.pid

    @property
    def port(self) -> int:
        """Port of the WebSocket."""
        return int(self.url.rpartition(":")[2].partition("/")[0])

    def playback(self) -> int:
        """Return the identifier of the playback process; wait while it is started again."""
        wait_for("playback runs", lambda: "playback.process" in children_of(self.pid))
        return children_of(self.pid)["playback.process"]

    def is_running(self) -> bool:
        """Return whether the server has not ended."""
        return self._process.poll() is None

    def restart(self) -> None:
        """Start the server again if it has ended."""
        if not self.is_running():
            self.close()
            self.start()

    def close(self) -> None:
        """End the server in any state, and wait until its processes are gone."""
        left = children_of(self.pid)
        if self.is_running():
            self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
        for pid in left.values():
            send_signal(pid, signal.SIGCONT)
        wait_for("its processes are gone", lambda: not any(map(is_alive, left.values())))


def connected(server: ServerProcess) -> RemoteDisplay:
    """Return the display of a server, as a client that is connected to it."""
    return tactile.client.connect(server.url, display=NAME, timeout=PATIENCE)


def clear(display: RemoteDisplay) -> bool:
    """Clear the active e-stop; return whether there was none."""
    estop = display.stats(timeout=PATIENCE).estop
    if estop:
        display.clear(estop=estop, timeout=PATIENCE)
    return not estop


def observe(
    server: ServerProcess, recorder: OutputRecorder, display: RemoteDisplay, seconds: float
) -> Iterator[tuple[float, float]]:
    """Yield the memory of server and playback each second [MiB], and keep the display armed.

    The amplifier's record is read meanwhile.
    """
    playback, end = server.playback(), time.monotonic() + seconds
    while time.monotonic() < end:
        for _ in range(10):
            time.sleep(0.1)
            recorder.read()
            with suppress(ClientError):
                clear(display)
                if display.stats(timeout=PATIENCE).state != "armed":
                    display.arm(timeout=PATIENCE)
        yield resident(server.pid), resident(playback)


def resident(pid: int) -> float:
    """Return the resident memory of a process [MiB]; NaN if it has ended."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    return math.nan


def growth(name: str, memory: list[float]) -> Figure:
    """Return the figure of the growth of a memory [MiB] after it has settled."""
    settled = memory[int(SETTLED * len(memory)) :]
    grown = settled[-1] - settled[0] if settled else math.nan
    return at_most(f"{name}_growth", grown, "MiB", 2)


def counters_of(server: ServerProcess) -> dict[str, int]:
    """Return the counters of playback."""
    with connected(server) as display:
        return display.stats(timeout=PATIENCE).counters


def block_figures(
    name: str, before: dict[str, int], after: dict[str, int], limit: float
) -> Iterator[Figure]:
    """Yield the losses of playback by its counters before and after; of late blocks a limit."""
    names = ("blocks", "late_blocks", "skipped_samples", "underruns")
    change = {each: after.get(each, 0) - before.get(each, 0) for each in names}
    late = change["late_blocks"] + change["skipped_samples"] / BLOCK
    yield Figure(f"{name}.blocks", float(change["blocks"]), "")
    share = 1e4 * late / max(change["blocks"], 1)
    yield at_most(f"{name}.late_blocks", share, "of 10 000", limit)
    yield Figure(f"{name}.underruns", float(change["underruns"]), "")


@contextmanager
def amplifier_and_folder() -> Iterator[tuple[VirtualAmplifier, Path]]:
    """Yield the C amplifier on a pty, and a folder for a server that plays on it.

    Servers that are started meanwhile have their own folders for state and sockets.
    """
    with TemporaryDirectory(prefix="t-") as own, workshop() as folder:
        folders = {"STATE_DIRECTORY": f"{own}/state", "RUNTIME_DIRECTORY": f"{own}/run"}
        with (
            patch.dict(os.environ, folders),
            closing(VirtualAmplifier(folder, "--pty")) as amplifier,
        ):
            yield amplifier, folder


def frame(message: object) -> bytes:
    """Return a message as a text frame of a client's WebSocket, masked with zeros."""
    payload = json.dumps(message).encode()
    size = len(payload)
    length = bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + size.to_bytes(2)
    return b"\x81" + length + bytes(4) + payload
