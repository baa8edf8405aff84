"""Whatever dies or hangs, the amplifier is at 0 V within 300 ms, and what starts again plays on.

The daemon is a process of its own, as a user starts it; a program plays through it from another
one; the C amplifier on a pty tells by its own clock when volts were last put out.
"""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
import websockets.sync.client as websockets
from websockets.typing import Subprotocol

import tactile.client
from tactile.bench.virtual import VirtualAmplifier, can_be_built
from tactile.daemon import messages
from tactile.errors import TactileError

PROMISE = 0.3
"""s from whatever happens to 0 V."""
WAIT = 30.0
APP = """
import itertools, sys, time, tactile.client
with tactile.client.connect(sys.argv[1], timeout=30.0) as display:
    display.select("wood-oak")
    display.arm()
    begun = time.monotonic()
    for k in itertools.count():
        now = time.monotonic() - begun
        display.touch((0.08 * now, 0.0), velocity=(0.08, 0.0), normal_force=0.5)
        if k == 60:
            print("plays", flush=True)
        time.sleep(1 / 90)
"""


def wait_for(what: str, happens: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT
    while not happens():
        assert time.monotonic() < deadline, f"{what}: not after {WAIT:g} s"
        time.sleep(0.02)


def children(pid: int) -> dict[str, int]:
    """Return the processes that a process has started, by what they are."""
    found = {}
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            stat = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(stat[1]) == pid and stat[0] != "Z":
                words = (entry / "cmdline").read_text()
                kind = next(k for k in ("playback_process", "drawing", "") if k in words)
                found[kind] = int(entry.name)
    return found


def alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


class Daemon:
    """A daemon that plays on an amplifier, and a program that plays through it."""

    def __init__(self, folder: Path, amplifier: VirtualAmplifier, log: str = "log") -> None:
        self.folder, self.amplifier = folder, amplifier
        self.config = folder / "tactile.toml"
        self.config.write_text(
            f'[server]\nport = 0\n[osc]\nport = 0\n[log]\nfile = "{log}"\n'
            f'[[display]]\nname = "right"\ndevice = "serial://{amplifier.path}"\n'
        )
        self.processes: list[subprocess.Popen[str]] = []
        self.start()

    def _run(self, *words: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *words], stdout=subprocess.PIPE, text=True, cwd=self.folder
        )
        self.processes.append(process)
        return process

    def start(self) -> None:
        self.server = self._run("-m", "tactile", "serve", "--config", str(self.config))
        assert self.server.stdout is not None
        self.url = self.server.stdout.readline().split()[0]
        self.children = children(self.server.pid)

    def play(self) -> subprocess.Popen[str]:
        """Have a program play, and return when it does."""
        app = self._run("-c", APP, self.url)
        assert app.stdout is not None
        assert app.stdout.readline() == "plays\n"
        self.children = children(self.server.pid)
        return app

    def silent_after(self, moment: float) -> float:
        """Return how long after a moment the last volts were put out [s]."""
        time.sleep(2 * PROMISE)
        records = self.amplifier.take()
        times = self.amplifier.powered_up + records.tick * 1e-6
        loud = np.asarray(records.codes.any(axis=1))
        assert loud[(times > moment - 0.2) & (times < moment)].mean() > 0.5, "it played before"
        assert times[-1] > moment + PROMISE, "the amplifier's clock goes on"
        return float(times[np.flatnonzero(loud)[-1]] - moment)

    def health(self) -> dict[str, object]:
        where = self.url.replace("ws://", "http://").replace("/v1", "/healthz")
        with urllib.request.urlopen(where, timeout=5) as answer:
            return dict(json.load(answer))

    def end(self) -> None:
        for process in reversed(self.processes):
            with suppress(OSError):
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


@pytest.fixture
def amplifier(tmp_path: Path) -> Iterator[VirtualAmplifier]:
    if sys.platform != "linux" or not can_be_built():
        if os.environ.get("CI") == "true":
            pytest.fail("no C compiler")
        pytest.skip("needs Linux, make and cc")
    with closing(VirtualAmplifier(tmp_path, "--pty")) as amplifier:
        yield amplifier


@pytest.fixture
def daemon(tmp_path: Path, amplifier: VirtualAmplifier) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path, amplifier)
    yield daemon
    daemon.end()


@pytest.mark.ci
def test_a_program_that_is_killed_is_a_finger_that_lifts(daemon: Daemon) -> None:
    app = daemon.play()
    app.kill()
    assert daemon.silent_after(time.monotonic()) < PROMISE
    assert daemon.health()["status"] == "ok"
    daemon.play()


@pytest.mark.ci
def test_a_program_that_hangs_is_a_finger_that_lifts_and_it_goes_on(daemon: Daemon) -> None:
    app = daemon.play()
    app.send_signal(signal.SIGSTOP)
    assert daemon.silent_after(time.monotonic()) < PROMISE
    app.send_signal(signal.SIGCONT)
    wait_for("it plays again", lambda: daemon.amplifier.take().codes.any())


@pytest.mark.ci
def test_a_server_that_is_killed_leaves_0_volts_and_nothing_behind(daemon: Daemon) -> None:
    daemon.play()
    before = daemon.children
    assert {"playback_process", "drawing"} <= set(before)
    daemon.server.kill()
    assert daemon.silent_after(time.monotonic()) < PROMISE
    wait_for("its children are gone", lambda: not any(map(alive, before.values())))
    daemon.start()
    daemon.play()


@pytest.mark.ci
def test_a_server_that_hangs_leaves_0_volts_and_goes_on(daemon: Daemon) -> None:
    daemon.play()
    daemon.server.send_signal(signal.SIGSTOP)
    assert daemon.silent_after(time.monotonic()) < PROMISE
    time.sleep(2 - 2 * PROMISE)
    daemon.server.send_signal(signal.SIGCONT)
    wait_for("it plays again", lambda: daemon.amplifier.take().codes.any())


@pytest.mark.ci
def test_playback_that_is_killed_is_started_again_and_not_armed(daemon: Daemon) -> None:
    app = daemon.play()
    os.kill(daemon.children["playback_process"], signal.SIGKILL)
    assert daemon.silent_after(time.monotonic()) < PROMISE
    with tactile.client.connect(daemon.url, timeout=WAIT) as display:
        wait_for("it is back", lambda: display.stats().state == "disarmed")
        time.sleep(0.5)
        assert not daemon.amplifier.take().codes.any(), "nobody armed it"
        display.arm()
        wait_for("it plays again", lambda: daemon.amplifier.take().codes.any())
    app.kill()


@pytest.mark.ci
def test_playback_that_hangs_leaves_0_volts(daemon: Daemon) -> None:
    daemon.play()
    playback = daemon.children["playback_process"]
    os.kill(playback, signal.SIGSTOP)
    assert daemon.silent_after(time.monotonic()) < PROMISE
    os.kill(playback, signal.SIGCONT)
    with tactile.client.connect(daemon.url, timeout=WAIT) as display:

        def armed() -> bool:
            with suppress(TactileError):
                display.arm()
                return True
            return False

        wait_for("it can be armed again", armed)
        wait_for("it plays again", lambda: daemon.amplifier.take().codes.any())


@pytest.mark.ci
def test_playback_that_hangs_for_good_is_started_again_once(daemon: Daemon) -> None:
    daemon.play().kill()
    hung = daemon.children["playback_process"]
    os.kill(hung, signal.SIGSTOP)
    wait_for("it is gone", lambda: not alive(hung))
    with tactile.client.connect(daemon.url, timeout=WAIT) as display:
        wait_for("it is back", lambda: display.stats().state == "disarmed")
        display.select("wood-oak")
        display.arm()
    log = (daemon.folder / "log").read_text()
    assert log.count("playback hangs") == 1
    assert "while it opened" not in log, "what was killed is not taken for what is opened"


@pytest.mark.ci
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk at hand")
def test_a_full_disk_for_logs_changes_nothing(tmp_path: Path, amplifier: VirtualAmplifier) -> None:
    daemon = Daemon(tmp_path, amplifier, log="/dev/full")
    try:
        app = daemon.play()
        app.kill()
        assert daemon.silent_after(time.monotonic()) < PROMISE
        assert daemon.health()["status"] == "ok"
    finally:
        daemon.end()


@pytest.mark.ci
def test_ended_by_a_signal_it_fades_and_disarms(daemon: Daemon) -> None:
    daemon.play()
    before = daemon.children
    daemon.server.send_signal(signal.SIGTERM)
    assert daemon.silent_after(time.monotonic()) < PROMISE
    assert daemon.server.wait(WAIT) == 0
    assert not any(map(alive, before.values()))


@pytest.mark.ci
def test_a_client_that_does_not_read_disturbs_no_other(daemon: Daemon) -> None:
    daemon.play()
    hello = '{"type":"hello","client":"deaf"}'
    with websockets.connect(
        daemon.url, subprotocols=[Subprotocol(messages.JSON_PROTOCOL)], max_queue=1
    ) as deaf:
        deaf.send(hello)
        deaf.send('{"type":"subscribe","display":"right","rate_hz":100}')
        with tactile.client.connect(daemon.url, timeout=WAIT) as display:
            end = display.stats().counters["blocks"] + 1500
            wait_for("blocks are played", lambda: display.stats().counters["blocks"] >= end)
            wait_for("the other's finger is felt", lambda: display.stats().touching)
