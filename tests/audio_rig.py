"""Rig of the tests of ``audio:``: a display, and JACK's dummy card with a recorder behind it.

The recorder is a program of its own (this file, run): the JACK library does not bear two servers
in one process, nor one that ends before its clients.
"""

import contextlib
import itertools
import os
import pickle
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from display_files import load

from tactile.arrays import Floats
from tactile.display.display import Display

Block = tuple[float, Floats]
"""Time at which a block came [s, monotonic] and the block (S, C) [full scale]."""

CHANNELS = 24
RATE = 48000
FADE = 960
"""Number of samples of a block, 20 ms."""
VOLTAGE, FULL_SCALE, SLEW = 100.0, 125.0, 0.7e6
STEP = SLEW / RATE
ANY = 2e7
"""Slew limit with which any sample may follow any other [V/s]."""
CODE = VOLTAGE / 32767
"""Voltage of one sample code, which 16 bits can tell apart over the limit [V]."""
WIRE = 0.51 * CODE
BUFFER, LONG_BUFFER = 256, 1024
"""Frames of JACK's dummy card: for times, and for what must not be disturbed by other programs."""

ROW = "[grid]\ncolumns = 24\nrows = 1\npitch_mm = [3.0, 3.0]\n"
CALIBRATED = "[amplifier]\naudio_full_scale_v = 125.0\n"


def display_of(folder: Path, amplifier: str = CALIBRATED) -> Display:
    """Return a display of contactors in a row, sample.toml in a folder."""
    return load(folder, ROW, amplifier)


NUMBERS = itertools.count()


def waves(count: int, channels: int = CHANNELS) -> Floats:
    """Return sines of 50 Hz and up, each channel's own, in whole codes [V]."""
    time = np.arange(count)[:, None] / RATE
    volts = 90 * np.sin(2 * np.pi * (50 + 10 * np.arange(channels)) * time)
    return np.asarray(np.rint(volts / CODE) * CODE)


def needed() -> str:
    """Return jackd's path, or skip; where CI promises it its absence is a failure."""
    path, why = shutil.which("jackd"), []
    if path is None:
        why.append("no jackd on PATH (apt install jackd2)")
    for module, package in (("jack", "pip install JACK-Client"), ("sounddevice", "libportaudio2")):
        run = subprocess.run([sys.executable, "-c", f"import {module}"], capture_output=True)
        if run.returncode:
            why.append(f"no {module} ({package})")
    if path is not None and not why:
        return path
    if os.environ.get("CI") == "true":
        pytest.fail("; ".join(why))
    pytest.skip("; ".join(why))


class Server:
    """A JACK server with a dummy card, and the recorder.

    Parameters
    ----------
    path : path of jackd
    buffer : frames
    folder : folder for their logs
    """

    def __init__(self, path: str, buffer: int, folder: Path) -> None:
        self.name, self.buffer = f"tactile{os.getpid()}-{next(NUMBERS)}", buffer
        words = ["--no-mlock", "-r", "-n", self.name, "--port-max", "1024", "-d", "dummy"]
        size = ["-r", str(RATE), "-p", str(buffer), "-C", str(CHANNELS), "-P", str(CHANNELS)]
        with (folder / "jackd.log").open("w") as log:
            self.process = subprocess.Popen([path, *words, *size], stdout=log, stderr=log)
            self.recorder = subprocess.Popen(
                [sys.executable, __file__, self.name],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
            )  # fmt: skip
        try:
            assert self._ask("hello") == "ready"
        except BaseException:
            self.close()
            raise

    def _ask(self, what: str) -> Any:
        inward, outward = self.recorder.stdin, self.recorder.stdout
        assert inward is not None
        assert outward is not None
        inward.write(what.encode() + b"\n")
        inward.flush()
        return pickle.load(outward)

    def record(self) -> None:
        """Record afresh what PortAudio plays."""
        assert self._ask("record") == CHANNELS

    def blocks(self) -> list[Block]:
        """Return what was recorded so far."""
        return list(self._ask("blocks"))

    def silent_blocks(self) -> list[Block]:
        """Return what was recorded until the card is silent; it must be within a minute."""
        end = time.monotonic() + 60
        while time.monotonic() < end:
            blocks = self.blocks()
            if not any(block.any() for _, block in blocks[-1:]):
                return blocks
            time.sleep(0.02)
        pytest.fail("the card still sounds")

    def xruns(self) -> int:
        """Return how often the server itself was late, with the recorder or with its card."""
        return int(self._ask("xruns"))

    def heard(self) -> Floats:
        """Return what was recorded up to now, from the first sound on [full scale]."""
        time.sleep(3 * self.buffer / RATE + 0.05)
        heard = np.concatenate([block for _, block in self.blocks()])
        sounding = np.flatnonzero(heard.any(axis=1))
        return heard[sounding[0] :] if len(sounding) else heard[:0]

    def close(self) -> None:
        """End both."""
        for pipe in (self.recorder.stdin, self.recorder.stdout):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()
        end_of(self.recorder)
        self.process.terminate()  # which lets it tidy up what it shares
        end_of(self.process)


def end_of(process: subprocess.Popen[bytes]) -> None:
    """Wait for the end of a process that was asked to end."""
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextlib.contextmanager
def serving(buffer: int, folder: Path) -> Iterator[Server]:
    """Run a server that PortAudio finds."""
    path = needed()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JACK_NO_START_SERVER", "1")
        patch.setenv("JACK_NO_AUDIO_RESERVATION", "1")
        server = Server(path, buffer, folder)
        patch.setenv("JACK_DEFAULT_SERVER", server.name)
        try:
            yield server
        finally:
            server.close()


class Recorder:
    """A JACK client that keeps what comes in."""

    def __init__(self, server: str) -> None:
        self.blocks: list[Block] = []
        self.xruns = 0
        self.client = self._client(server)
        self.ports = [self.client.inports.register(f"in_{k}") for k in range(CHANNELS)]
        self.client.set_process_callback(self._process)
        self.client.set_xrun_callback(self._xrun)
        self.client.activate()

    def _client(self, server: str) -> Any:
        import jack

        end = time.monotonic() + 60
        while True:
            try:
                return jack.Client("recorder", no_start_server=True, servername=server)
            except jack.JackError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)

    def _process(self, frames: int) -> None:
        if self.ports[0].number_of_connections:
            heard = np.array([port.get_array() for port in self.ports], np.float64).T
            self.blocks.append((time.monotonic(), heard))

    def _xrun(self, delayed_us: float) -> None:
        self.xruns += 1

    def record(self) -> int:
        """Connect to PortAudio, and forget what was; return how many ports have a source.

        A client that was killed has its ports for a moment more.
        """
        import jack

        end = time.monotonic() + 60
        while time.monotonic() < end:
            ports = self.client.get_ports(is_output=True, is_audio=True)
            theirs = [p for p in ports if not p.name.startswith(("system:", "recorder:"))]
            with contextlib.suppress(jack.JackError, ValueError):
                for source, sink in zip(theirs, self.ports, strict=True):
                    if not sink.is_connected_to(source):
                        self.client.connect(source, sink)
                break
            time.sleep(0.05)
        self.blocks.clear()
        return sum(bool(port.number_of_connections) for port in self.ports)


def main(server: str, inward: IO[bytes], outward: IO[bytes]) -> None:
    """Carry out commands from standard input, one word per line, and pickle the answers."""
    recorder = Recorder(server)
    for line in inward:
        word = line.decode().strip()
        answers: dict[str, Callable[[], object]] = {
            "hello": lambda: "ready",
            "record": recorder.record,
            "blocks": lambda: list(recorder.blocks),
            "xruns": lambda: recorder.xruns,
        }
        pickle.dump(answers[word](), outward)
        outward.flush()
    recorder.client.close()


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # for what libjack says
    main(sys.argv[1], sys.stdin.buffer, answers)
