"""Tests of faults: the amplifier goes to 0 V and stays there until somebody arms it again.

The server is a process of its own, as a user starts it; a program plays through it from another
one, a stroke or an effect of a minute; the C amplifier on a pty records what it puts out. How soon
it is silent is measured by ``python -m benchmarks deaths``; deaths in any order, at any moment, are
simulated (`simulator`).
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
from benchmarks.virtual import VirtualAmplifier
from tactile import messages
from tactile.errors import TactileError

pytestmark = pytest.mark.realtime

QUIET = 0.5
"""Length of the amplifier's own record that must hold nothing but 0 V [s]."""
WAIT = 60.0
KINDS = ("playback.process", "preparing", "estop.process", "")
"""Kinds of processes that a server starts, as they stand in a command line."""
APP = """
import itertools, sys, time, tactile.client
with tactile.client.connect(sys.argv[1], timeout=60.0) as display:
    display.select("wood-oak")
    display.arm()
    if sys.argv[2] == "effect":
        minute = [(0.0, 1.0), (60.0, 1.0)]
        display.effect(2e-6, amplitude_points=minute, frequency_points=[(0.0, 200.0)])
        print("plays", flush=True)
        time.sleep(60)
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
                kind = next(k for k in KINDS if k in words)
                found[kind] = int(entry.name)
    return found


def alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


class Rig:
    """A server that plays on an amplifier, and a program that plays through it."""

    def __init__(
        self, folder: Path, amplifier: VirtualAmplifier, log: str = "log", sound: str = "stroke"
    ) -> None:
        self.folder, self.amplifier, self.sound = folder, amplifier, sound
        self.config = folder / "tactile.toml"
        self.config.write_text(
            f'[server]\nport = 0\n[osc]\nport = 0\n[log]\nfile = "{log}"\n'
            f'[[display]]\nname = "right"\ndevice = "serial://{amplifier.path}"\n'
            "worn = true\n"
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
        app = self._run("-c", APP, self.url, self.sound)
        assert app.stdout is not None
        assert app.stdout.readline() == "plays\n"
        self.children = children(self.server.pid)
        self.amplifier.take()
        wait_for("it plays", lambda: self.amplifier.take().codes.any())
        return app

    def falls_silent(self) -> None:
        """Wait until the amplifier has put out nothing but 0 V for a while."""
        silent = 0.0

        def is_silent() -> bool:
            nonlocal silent
            records = self.amplifier.take()
            if len(records.tick):
                loud = np.flatnonzero(records.codes.any(axis=1))
                since = records.tick[loud[-1]] if len(loud) else records.tick[0]
                length = float(records.tick[-1] - since) * 1e-6
                silent = length if len(loud) else silent + length
            return silent > QUIET

        wait_for("it is silent", is_silent)

    def stays_silent(self) -> None:
        """See that nothing is put out for a while of the amplifier's time."""
        ticks: list[int] = []

        def has_passed() -> bool:
            records = self.amplifier.take()
            assert not records.codes.any(), "nobody armed it"
            ticks.extend(records.tick[[0, -1]].tolist() if len(records.tick) else [])
            return bool(ticks) and (ticks[-1] - ticks[0]) * 1e-6 > QUIET

        wait_for("time passes", has_passed)

    def arms_and_plays(self) -> None:
        """See that a new program gets it to play again."""
        self.falls_silent()
        self.play().kill()

    def health(self) -> dict[str, object]:
        where = self.url.replace("ws://", "http://").replace("/v1", "/healthz")
        with urllib.request.urlopen(where, timeout=WAIT) as answer:
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
def amplifier(tmp_path: Path, virtual_amplifier: Path) -> Iterator[VirtualAmplifier]:
    if sys.platform != "linux":
        pytest.skip("needs Linux")
    (tmp_path / "build").symlink_to(virtual_amplifier.parent)
    with closing(VirtualAmplifier(tmp_path, "--pty")) as amplifier:
        yield amplifier


@pytest.fixture
def sound() -> str:
    return "stroke"


@pytest.fixture
def served(tmp_path: Path, amplifier: VirtualAmplifier, sound: str) -> Iterator[Rig]:
    rig = Rig(tmp_path, amplifier, sound=sound)
    yield rig
    rig.end()


lasting = pytest.mark.parametrize("sound", ["effect"])
"""Mark of tests that end programs: an effect of a minute needs no program to go on."""


@lasting
def test_a_program_that_is_killed_is_silent_and_disarmed(served: Rig) -> None:
    served.play().kill()
    served.falls_silent()
    assert served.health()["status"] == "ok"
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("it is disarmed", lambda: display.stats().state == "disarmed")
    served.arms_and_plays()


@lasting
def test_a_program_that_hangs_is_silent_and_disarmed_and_stays_so(served: Rig) -> None:
    app = served.play()
    app.send_signal(signal.SIGSTOP)
    served.falls_silent()
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("it is disarmed", lambda: display.stats().state == "disarmed")
        app.send_signal(signal.SIGCONT)
        served.stays_silent()
        display.arm()
        wait_for("it is armed again", lambda: display.stats().state == "armed")


@lasting
def test_a_server_that_is_killed_leaves_0_volts_and_nothing_behind(served: Rig) -> None:
    served.play()
    before = served.children
    assert {"playback.process", "preparing", "estop.process"} <= set(before)
    served.server.kill()
    served.falls_silent()
    wait_for("its children are gone", lambda: not any(map(alive, before.values())))
    served.start()
    served.play()


def test_a_server_that_hangs_leaves_0_volts_and_stays_disarmed(served: Rig) -> None:
    app = served.play()
    served.server.send_signal(signal.SIGSTOP)
    served.falls_silent()
    served.server.send_signal(signal.SIGCONT)
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("it is disarmed", lambda: display.stats().state == "disarmed")
        served.stays_silent()
    app.kill()
    served.arms_and_plays()


def test_a_server_that_hangs_is_stopped_by_tactile_estop(served: Rig) -> None:
    served.play()
    served.server.send_signal(signal.SIGSTOP)
    words = [sys.executable, "-m", "tactile", "estop"]
    stopped = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=WAIT, check=False)
    assert stopped.returncode == 0
    assert stopped.stdout == "right: e-stop 1 is latched; tactile clear ends it\n"
    served.falls_silent()
    served.server.send_signal(signal.SIGCONT)
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("the server knows of it", lambda: display.stats().estop == 1)
        with pytest.raises(TactileError, match="e-stop 1 holds"):
            display.arm()
        display.clear(estop=1)
        served.stays_silent()
        display.arm()


def test_an_e_stop_while_playback_is_started_again_holds(served: Rig) -> None:
    served.play()
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        os.kill(served.children["playback.process"], signal.SIGKILL)
        display.estop()
        served.falls_silent()
        wait_for("it is back", lambda: display.stats().state == "estopped")
        with pytest.raises(TactileError, match="e-stop 1 holds"):
            display.arm()
        served.stays_silent()
        wait_for("it can be cleared", lambda: cleared(display))
        display.arm()


def cleared(display: tactile.client.RemoteDisplay) -> bool:
    """Clear what holds; return whether the server was ready for it."""
    with suppress(TactileError):
        display.clear()
        return display.stats().estop == 0
    return False


def test_an_e_stop_holds_over_a_server_that_is_killed(served: Rig) -> None:
    """The server has ``arm_on_start``, and the amplifier forgets, being switched off too."""
    served.config.write_text(served.config.read_text() + "arm_on_start = true\n")
    served.play()
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        display.estop()
        served.falls_silent()
    served.server.kill()
    served.server.wait()
    served.start()
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        assert display.stats().estop == 1
        with pytest.raises(TactileError, match="e-stop 1 holds"):
            display.arm()
        served.stays_silent()
        wait_for("it can be cleared", lambda: cleared(display))


def test_playback_that_is_killed_is_started_again_and_not_armed(served: Rig) -> None:
    app = served.play()
    os.kill(served.children["playback.process"], signal.SIGKILL)
    served.falls_silent()
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("it is back", lambda: display.stats().state == "disarmed")
        served.stays_silent()
    app.kill()
    served.arms_and_plays()


def test_playback_that_hangs_leaves_0_volts(served: Rig) -> None:
    served.play()
    playback = served.children["playback.process"]
    os.kill(playback, signal.SIGSTOP)
    served.falls_silent()
    os.kill(playback, signal.SIGCONT)
    with tactile.client.connect(served.url, timeout=WAIT) as display:

        def armed() -> bool:
            with suppress(TactileError):
                display.arm()
                return True
            return False

        wait_for("it can be armed again", armed)


def test_playback_that_hangs_for_good_is_started_again_once(served: Rig) -> None:
    served.play().kill()
    hung = served.children["playback.process"]
    os.kill(hung, signal.SIGSTOP)
    wait_for("it is gone", lambda: not alive(hung))
    with tactile.client.connect(served.url, timeout=WAIT) as display:
        wait_for("it is back", lambda: display.stats().state == "disarmed")
        display.select("wood-oak")
        display.arm()
    log = (served.folder / "log").read_text()
    assert log.count("playback hangs") == 1
    assert "while it opened" not in log, "what was killed is not taken for what is opened"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk at hand")
def test_a_full_disk_for_logs_changes_nothing(tmp_path: Path, amplifier: VirtualAmplifier) -> None:
    rig = Rig(tmp_path, amplifier, log="/dev/full")
    try:
        rig.play().kill()
        rig.falls_silent()
        assert rig.health()["status"] == "ok"
    finally:
        rig.end()


def test_ended_by_a_signal_it_fades_and_disarms(served: Rig) -> None:
    served.play()
    before = served.children
    served.server.send_signal(signal.SIGTERM)
    served.falls_silent()
    assert served.server.wait(WAIT) == 0
    assert not any(map(alive, before.values()))


def test_a_client_that_does_not_read_disturbs_no_other(served: Rig) -> None:
    served.play()
    hello = '{"type":"hello","client":"deaf"}'
    with websockets.connect(
        served.url, subprotocols=[Subprotocol(messages.JSON_PROTOCOL)], max_queue=1
    ) as deaf:
        deaf.send(hello)
        deaf.send('{"type":"subscribe","display":"right","rate_hz":100}')
        with tactile.client.connect(served.url, timeout=WAIT) as display:
            end = display.stats().counters["blocks"] + 1500
            wait_for("blocks are played", lambda: display.stats().counters["blocks"] >= end)
            wait_for("the other's finger is felt", lambda: display.stats().touching)
        served.amplifier.take()
        wait_for("it plays on", lambda: served.amplifier.take().codes.any())
