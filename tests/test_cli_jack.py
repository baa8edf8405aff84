"""Tests of the command ``tactile jack``, against a server that follows a script and a real one."""

import contextlib
import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command, assert_mistake
from client_rig import PATIENCE, Script, ScriptedServer
from jack_rig import JackServer, jack_server, until
from msgspec import structs
from rich.console import Console

import tactile
from tactile import client
from tactile import messages as m
from tactile.cli import jack_command
from tactile.cli.bridges import until_stopped
from tactile.cli.jack_command import meter_line

N = 2
"""Number of contactors of the scripted display."""
PROGRAMS = ["of", "all", "programs"]
ROOM = "--headroom-ms", "450"
"""Headroom for a slow machine, which is never raised."""


@pytest.fixture(autouse=True)
def unhurried(monkeypatch: pytest.MonkeyPatch, patient_client: None) -> None:
    """Let the command wait for a server that the machine holds up."""
    patient = functools.partial(client.open_connection, timeout=PATIENCE)
    monkeypatch.setattr(client, "open_connection", patient)


@pytest.fixture
def jackd(tmp_path: Path) -> Iterator[JackServer]:
    with jack_server(tmp_path) as jackd:
        jackd.start()
        yield jackd


def sounding(server: ScriptedServer) -> list[m.TactileFrames]:
    """Return the messages of frames with anything but silence."""
    return [said for said in server.of(m.TactileFrames) if any(bytes(said.frames))]


class CtrlC:
    """Press of Ctrl-C on the command once something has happened, and never after its end.

    Parameters
    ----------
    patch : pytest.MonkeyPatch
        Patch that lasts as long as the test.
    happened : Callable
        Function that tells whether it has happened.
    """

    def __init__(self, patch: pytest.MonkeyPatch, happened: Callable[[], Any]) -> None:
        self._happened, self.ended = happened, threading.Event()
        patch.setattr(jack_command, "until_stopped", self._until_stopped)

    @contextlib.contextmanager
    def _until_stopped(self) -> Iterator[tuple[threading.Event, set[int]]]:
        with until_stopped() as (stop, received):
            thread = threading.Thread(target=self._press, args=(stop,))
            thread.start()
            try:
                yield stop, received
            finally:
                self.ended.set()
                thread.join()  # while the command still takes signals

    def _press(self, stop: threading.Event) -> None:
        try:
            until(lambda: self.ended.is_set() or self._happened())
        except BaseException:
            stop.set()
            raise
        if not self.ended.is_set():
            os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture
def listener(server: ScriptedServer, jackd: JackServer, monkeypatch: pytest.MonkeyPatch) -> CtrlC:
    """Play into the ports, and press Ctrl-C when the display has got ten cycles of it."""
    monkeypatch.setattr("tactile.jack.sound_card.STANDSTILL", np.inf)  # of a slow machine
    jackd.play("tactile left", N)
    return CtrlC(monkeypatch, lambda: len(sounding(server)) >= 10)


def test_a_display_is_a_sound_card_until_ctrl_c(
    command: Command, server: ScriptedServer, listener: CtrlC
) -> None:
    run = command("jack", "--url", server.url, "--full-scale-um", 20, *ROOM, "--json")
    assert run.code == 130
    assert run.err.splitlines() == [
        "no finger touches the display: unless it is worn, waves are 34 dB weaker until one does",
        f"JACK client 'tactile left': {N} ports, 48000 Hz, 1024 frames",
        "tactile: interrupted",
    ]
    messages = sounding(server)
    assert {(said.frame_rate_hz, said.amplitude_um) for said in messages} == {(48000.0, 20.0)}
    assert all(said.time_us is not None for said in messages)
    assert run.json["delay_ms"] == pytest.approx(4.0 + 450.0)
    assert run.json["rate_hz"] == 48000.0
    assert run.json["frames"] >= 10 * 1024
    assert len(run.json["peaks_um"]) == len(run.json["clipped"]) == N
    assert server.of(m.ArmDisplay, m.StopPlaying) == [
        m.ArmDisplay(display="left", id=server.of(m.ArmDisplay)[0].id),
        m.StopPlaying(display="left", id=server.of(m.StopPlaying)[0].id),
    ]


def test_a_summary_is_printed_at_the_end_of_the_sound_card(
    command: Command, server: ScriptedServer, listener: CtrlC
) -> None:
    run = command("jack", "--url", server.url, *ROOM)
    assert run.err == "tactile: interrupted\n"
    lines = [line.split() for line in run.out.splitlines()]
    assert ["Played", "on", "left"] in lines
    assert ["delay", "454.0", "ms"] in lines
    assert {"dropped,", "gaps,"} <= {words[0] for words in lines if words[1:4] == PROGRAMS}
    assert ["JACK", "48000", "Hz,", "1024", "frames", "per", "cycle"] in lines


def test_a_terminal_shows_a_meter_of_each_channel(
    command: Command, server: ScriptedServer, listener: CtrlC, monkeypatch: pytest.MonkeyPatch
) -> None:
    def terminal(*, stderr: bool) -> Console:
        return Console(stderr=stderr, markup=False, force_terminal=True, width=150)

    monkeypatch.setattr(jack_command, "plain_console", terminal)
    out = command("jack", "--url", server.url, *ROOM).out
    assert "left armed, delay 454.0 ms" in out
    assert " 0 lost, 0 gaps, xruns of JACK" in out
    assert "dBFS" in out


def test_a_meter_is_a_bar_with_the_level_and_a_mark() -> None:
    assert meter_line(3, 1.0, 10.0, 0) == f"  3 {'█' * 20}    0.0 dBFS  10.00 µm     "
    half = f" 12 {'█' * 10}{'·' * 10}  -30.0 dBFS   0.32 µm CLIP"
    assert meter_line(12, 10**-1.5, 10.0, 5) == half
    assert meter_line(0, 0.0, 10.0, 0) == f"  0 {'·' * 20}      – dBFS   0.00 µm     "
    assert meter_line(0, 2.0, 10.0, 1) == f"  0 {'█' * 20}    6.0 dBFS  20.00 µm CLIP"


def test_a_link_of_spectrum_frames_is_a_mistake(
    command: Command, server: ScriptedServer, script: Script
) -> None:
    welcome = script.answer(m.ClientHello(client="test"))
    assert isinstance(welcome, m.Welcome)
    display = structs.replace(welcome.displays[0], waveforms=False)
    script.answers[m.ClientHello] = lambda said: structs.replace(
        welcome, id=said.id, displays=(display,)
    )
    run = command("jack", "--url", server.url)
    assert_mistake(run, "display 'left': the link takes spectrum frames")


def test_a_sound_card_that_fails_prints_its_summary(
    command: Command, server: ScriptedServer, jackd: JackServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactile.jack.sound_card.FASTEST", 44100.0)
    run = command("jack", "--url", server.url, "--json")
    assert run.code == 2
    assert run.err.splitlines()[-1] == (
        "tactile: JACK runs at 48000 Hz; a display takes at most 44100 Hz"
    )
    assert run.json["frames"] == 0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--full-scale-um", "0"], "full scale 0 µm: must be above 0 and at most 500 µm"),
        (["--headroom-ms", "501"], "headroom 501 ms: must be between 0 and 500 ms"),
    ],
)
def test_a_wrong_option_of_the_sound_card_is_a_mistake(
    command: Command, options: list[str], text: str
) -> None:
    assert_mistake(command("jack", *options), text)


def test_a_missing_library_of_jack_is_one_line(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "jack", None)
    assert_mistake(command("jack"), "needs JACK-Client: pip install 'tactile-display[jack]'")


# With a real server


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """Yield the address of a server of one display that is worn."""
    config = tmp_path / "tactile.toml"
    config.write_text(
        '[server]\nport = 0\nsocket = ""\n'
        '[[display]]\nname = "left"\ndevice = "mock:"\nworn = true\n'
    )
    words = [sys.executable, "-m", "tactile", "serve", "--config", str(config)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[0]
        process.terminate()
        process.wait(PATIENCE)


@pytest.mark.realtime
def test_a_real_display_plays_what_comes_from_jack(
    command: Command, url: str, jackd: JackServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """See the commanded shear: only the contactors move to whose ports something is connected."""
    jackd.play("tactile left", 3)
    moved = np.zeros(24, bool)

    def moves() -> bool:
        end = time.monotonic() + PATIENCE
        with tactile.connect(url, timeout=PATIENCE) as display:
            for telemetry in display.telemetry(50.0, samples=True):
                if telemetry.state == "disarmed":
                    with contextlib.suppress(tactile.TactileError):  # of a machine that is held up
                        display.arm()
                shear = None if telemetry.samples is None else telemetry.samples.shear
                if shear is not None:
                    moved[np.any(np.abs(shear) > 1e-8, axis=0)] = True
                if moved[:3].all() or press.ended.is_set() or time.monotonic() > end:
                    break
        return bool(moved[:3].all())

    press = CtrlC(monkeypatch, moves)
    run = command("jack", "--url", url, "--full-scale-um", 50, *ROOM, "--json")
    assert run.code == 130
    assert moved.tolist() == [True] * 3 + [False] * 21
    assert run.json["frames"] > 0
    peaks = run.json["peaks_um"]
    assert 0 < peaks[2] < peaks[1] < peaks[0] < 25.1
    assert max(peaks[3:]) == 0
