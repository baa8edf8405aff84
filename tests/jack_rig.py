"""Rig of the tests of ``tactile jack``: JACK with a dummy card, and a program that plays.

The program is this file, run. It plays values from which the number of each frame can be read, as
JACK counts them, so that a test sees which frames came however slow the machine is.
"""

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile.arrays import Singles

PATIENCE = 60.0
"""Longest wait for something that takes milliseconds on an idle machine [s]."""
RATE, BUFFER = 48000, 1024
SOURCE = "source"
"""Name of the client that plays."""
NAMES = tuple(f"tactile-test-{k}" for k in range(6))
"""Names of servers. A system has room for eight, with those that were killed, whose place is free
again as soon as a server of the same name begins."""
BITS = 20
"""Bits of the number of a frame that its value holds, which is never 0."""


def needed_jackd() -> str:
    """Return jackd's path, or skip; where CI promises it its absence is a failure."""
    path = shutil.which("jackd")
    run = subprocess.run([sys.executable, "-c", "import jack"], capture_output=True)
    if path is not None and not run.returncode:
        return path
    reason = "no jackd (apt install jackd2) or no jack (pip install JACK-Client)"
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)


def until(happened: Callable[[], Any]) -> Any:
    """Wait for something that is to come, and return it."""
    deadline = time.monotonic() + PATIENCE
    while not (result := happened()):
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.01)
    return result


def end_of(process: subprocess.Popen[bytes], within: float) -> None:
    """Wait for the end of a process that was asked to end."""
    try:
        process.wait(within)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def free_name() -> tuple[str, IO[str]]:
    """Return a name of a server that no other test uses, and the lock to hold meanwhile."""

    def take() -> tuple[str, IO[str]] | None:
        for name in NAMES:
            path = Path(tempfile.gettempdir(), f"{name}-{os.getuid()}.lock")
            lock = path.open("a")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.close()
            else:
                return name, lock
        return None

    free: tuple[str, IO[str]] = until(take)
    return free


class JackServer:
    """A JACK server with a dummy card, which waits for its clients however late they are.

    Parameters
    ----------
    path : path of jackd
    folder : folder for its log
    ports : number of all ports that there may be
    """

    def __init__(self, path: str, folder: Path, ports: int = 256) -> None:
        self.name, self._lock = free_name()
        words = ["--no-mlock", "-r", "-S", "-t", "20000", "-n", self.name]
        card = ["-d", "dummy", "-r", str(RATE), "-p", str(BUFFER)]
        self._line = [path, *words, "--port-max", str(ports), *card]
        self._log = folder / "jackd.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._sources: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start it, and wait until it takes clients."""
        brief = [sys.executable, __file__, self.name, "", "0"]
        with self._log.open("a") as log:
            held = (self._lock.fileno(),)  # a server that outlives the tests keeps its name
            server = subprocess.Popen(self._line, stdout=log, stderr=log, pass_fds=held)
            self._process = server
            client = subprocess.Popen(brief, stdin=subprocess.DEVNULL, stderr=log)
        until(lambda: client.poll() is not None or server.poll() is not None)
        client.kill()
        works = client.wait() == 0 and server.poll() is None
        assert works, f"no JACK server: {self._log.read_text(errors='replace')}"

    def kill(self) -> None:
        """Kill it as a crash does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def play(self, client: str = "", ports: int = 3) -> None:
        """Start a source; it is connected to the ports of a client, or to none."""
        line = [sys.executable, __file__, self.name, client, str(ports)]
        with self._log.open("a") as log:
            self._sources.append(subprocess.Popen(line, stdin=subprocess.PIPE, stderr=log))

    def end_sources(self) -> None:
        """End all sources as programs end."""
        for source in self._sources:
            if source.stdin is not None:
                source.stdin.close()
            end_of(source, PATIENCE)
        self._sources.clear()

    def close(self) -> None:
        """End it such that it tidies up, also what one that was killed has left."""
        self.end_sources()
        try:
            if self._process is not None:
                if self._process.poll() == -signal.SIGKILL:
                    self.start()  # under the name of the one that was killed, whose place it takes
                self._process.terminate()
                end_of(self._process, PATIENCE)
        finally:
            self._lock.close()


@contextlib.contextmanager
def jack_server(folder: Path, **options: int) -> Iterator[JackServer]:
    """Yield a JACK server that is the default one; it is not started yet."""
    path = needed_jackd()
    server = JackServer(path, folder, **options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JACK_NO_START_SERVER", "1")
        patch.setenv("JACK_NO_AUDIO_RESERVATION", "1")
        patch.setenv("JACK_DEFAULT_SERVER", server.name)
        try:
            yield server
        finally:
            server.close()


def encoded(numbers: NDArray[np.int64], port: int) -> Singles:
    """Return the values of frames with these numbers at a port, which float32 holds exactly."""
    values = (numbers % (1 << BITS) + 1) / (1 << BITS + 1) * 0.5**port
    return np.asarray(values, np.float32)


def decoded(values: Singles, port: int) -> NDArray[np.int64]:
    """Return the numbers of frames from the values at a port; −1 where there was silence."""
    return np.asarray(values.astype(np.float64) * (1 << BITS + 1) * 2**port, np.int64) - 1


class Source:
    """A JACK client that plays the numbers of the frames."""

    def __init__(self, server: str, ports: int) -> None:
        self.client = self._client(server, SOURCE if ports else "test")
        self._ports = [self.client.outports.register(f"out_{k}") for k in range(ports)]
        self.client.set_process_callback(self._process)
        self.client.set_shutdown_callback(lambda status, reason: os._exit(0))
        self.client.activate()

    def _client(self, server: str, name: str) -> Any:
        import jack

        end = time.monotonic() + PATIENCE
        while True:
            try:
                return jack.Client(name, no_start_server=True, servername=server)
            except jack.JackError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)

    def _process(self, frames: int) -> None:
        numbers = self.client.last_frame_time + np.arange(frames, dtype=np.int64)
        for index, port in enumerate(self._ports):
            port.get_array()[:] = encoded(numbers, index)

    def connect(self, client: str) -> None:
        """Connect each port to one of a client, as soon as that has as many."""
        import jack

        while True:
            theirs = self.client.get_ports(f"^{client}:", is_input=True, is_audio=True)
            pairs = list(zip(self._ports, theirs, strict=False))
            missing = [pair for pair in pairs if not pair[0].is_connected_to(pair[1])]
            if len(theirs) >= len(self._ports) and not missing:
                return
            for mine, other in missing:
                with contextlib.suppress(jack.JackError):  # a client that is not active yet
                    self.client.connect(mine, other)
            time.sleep(0.05)


def main(server: str, client: str, ports: int) -> None:
    """Play until standard input ends."""
    source = Source(server, ports)
    if client:
        threading.Thread(target=source.connect, args=(client,), daemon=True).start()
    sys.stdin.read()
    source.client.close()
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
