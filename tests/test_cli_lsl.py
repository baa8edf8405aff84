"""Tests of the command ``tactile lsl``, against a server that follows a script."""

import functools
import os
import signal
import struct
import sys
import threading
import uuid
from collections.abc import Iterator
from typing import Any

import pytest
from cli_rig import Command, assert_mistake
from client_rig import PATIENCE, Script, ScriptedServer, until
from lsl_rig import loopback as loopback
from lsl_rig import pylsl
from rich.console import Console

from tactile import client, lsl
from tactile import messages as m
from tactile.cli import lsl_command
from tactile.lsl import Bridge

BLOCK = 4


@pytest.fixture
def name() -> str:
    return f"hand-{uuid.uuid4().hex}"


@pytest.fixture
def script(name: str) -> Script:
    return Script(name)


@pytest.fixture(autouse=True)
def unhurried(monkeypatch: pytest.MonkeyPatch, patient_client: None) -> None:
    """Let the command wait for a server that the machine holds up."""
    patient = functools.partial(client.open_connection, timeout=PATIENCE)
    monkeypatch.setattr(client, "open_connection", patient)


def telemetry(name: str, first: int) -> m.TelemetryMessage:
    """Return two blocks for two contactors."""
    rows = struct.pack(f"<{4 * BLOCK}f", *range(4 * BLOCK))
    times = struct.pack("<2d", *(5e6 + 125.0 * (first + BLOCK * k) for k in range(2)))
    samples = m.TelemetrySamples(
        first=first, sample_rate_hz=8000.0, block_samples=BLOCK,
        times_us=times, uncertainty_us=20.0, finger_times_us=times,
        position_mm=bytes(16), velocity_mm_s=bytes(16), normal_force_n=bytes(8),
        touching=(False, True), shear_um=rows, drive_v=rows,
    )  # fmt: skip
    return m.TelemetryMessage(
        display=name, time_us=0, state="armed", position_mm=(0.0, 0.0), velocity_mm_s=(0.0, 0.0),
        normal_force_n=0.0, shear_um=(0.0, 0.0), drive_v=(0.0, 0.0), counters={}, samples=samples,
    )  # fmt: skip


@pytest.fixture
def bridges(monkeypatch: pytest.MonkeyPatch) -> list[lsl.Bridge]:
    """Return the bridges that the command makes."""
    made: list[lsl.Bridge] = []

    def make(*arguments: Any) -> lsl.Bridge:
        made.append(Bridge(*arguments))
        return made[-1]

    monkeypatch.setattr(lsl, "Bridge", make)
    return made


@pytest.fixture
def recorder(server: ScriptedServer, name: str, bridges: list[lsl.Bridge]) -> Iterator[None]:
    """Send telemetry to who asks for samples, and press Ctrl-C when it is in all streams."""

    def act() -> None:
        (asked,) = until(lambda: server.of(m.Subscribe))
        assert asked.samples
        server.say(telemetry(name, 0))
        server.say(telemetry(name, 2 * BLOCK + 5))
        streams = pylsl.resolve_bypred(f"starts-with(name, 'tactile {name} ')", 4, PATIENCE)
        seen.extend(one.name().rpartition(" ")[2] for one in streams)
        until(lambda: bridges[0].summary.missing)
        server.say(telemetry(name, 4 * BLOCK + 5))  # after the interrupt nobody waits for more
        os.kill(os.getpid(), signal.SIGINT)

    seen: list[str] = []
    thread = threading.Thread(target=act)
    thread.start()
    yield
    thread.join()
    assert sorted(seen) == ["contacts", "drive", "markers", "shear"]


def test_a_display_is_offered_until_ctrl_c(
    command: Command, server: ScriptedServer, name: str, recorder: None
) -> None:
    handler = signal.getsignal(signal.SIGINT)
    run = command("lsl", "--url", server.url, "--json")
    assert run.code == 130
    assert signal.getsignal(signal.SIGINT) is handler
    assert run.err.splitlines() == [
        f"tactile {name} markers: Markers, 1 channel, no rate",
        f"tactile {name} contacts: MoCap, 6 channels, 2000 Hz",
        f"tactile {name} shear: Haptics, 2 channels, 8000 Hz",
        f"tactile {name} drive: Haptics, 2 channels, 8000 Hz",
        "tactile: interrupted",
    ]
    assert run.json["display"] == name
    assert run.json["missing"] == 5
    assert [one["rate_hz"] for one in run.json["streams"]] == [2000.0, 8000.0, 8000.0, 0.0]
    assert [one["samples"] for one in run.json["streams"]][3] == 1, "the marker of what is missing"
    assert run.json["uncertainty_us"] >= 20.0


def test_a_summary_is_printed_at_the_end(
    command: Command, server: ScriptedServer, name: str, recorder: None
) -> None:
    run = command("lsl", "--url", server.url)
    assert run.err == "tactile: interrupted\n"
    lines = [line.split() for line in run.out.splitlines()]
    assert ["Offered", name] in lines
    assert ["missing", "samples", "5"] in lines
    assert ["effects", "0", "begun,", "0", "dropped"] in lines


def test_a_terminal_shows_a_line_of_what_was_done(
    command: Command, server: ScriptedServer, recorder: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def terminal(*, stderr: bool) -> Console:
        return Console(stderr=stderr, markup=False, force_terminal=True, width=200)

    monkeypatch.setattr(lsl_command, "plain_console", terminal)
    run = command("lsl", "--url", server.url)
    assert "markers 1, missing samples 5" in run.out


def test_of_several_displays_one_is_to_be_named(
    command: Command, server: ScriptedServer, script: Script
) -> None:
    script.displays = ("left", "right")
    run = command("lsl", "--url", server.url)
    assert_mistake(run, "the server has left, right; name one of them")
    run = command("lsl", "--url", server.url, "lefd")
    assert_mistake(run, "no display 'lefd'", "did you mean 'left'?")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--streams", "shears"], "stream 'shears': there are contacts, shear, drive, markers"),
        (["--decimate", "100"], "decimation by 100: must be between 1 and 64"),
        (["--start", "go=tap"], "marker 'go': there is no stream that markers come from"),
        (["--start-from", "x", "--start", "go"], "'go': must be a marker and an effect"),
        (["--start-from", "x", "--delay-s", "31"], "delay 31 s: must be between 0 and 30 s"),
    ],
)
def test_a_wrong_option_is_a_mistake(command: Command, options: list[str], text: str) -> None:
    assert_mistake(command("lsl", *options), text)


def test_an_effect_that_the_server_does_not_have_is_a_mistake(
    command: Command, server: ScriptedServer
) -> None:
    run = command("lsl", "--url", server.url, "--start-from", "x", "--start", "go=tab")
    assert_mistake(run, "no effect 'tab' on the server; there are: tap")


def test_a_missing_library_is_one_line(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    assert_mistake(command("lsl"), "needs pylsl: pip install 'tactile-display[lsl]'")
