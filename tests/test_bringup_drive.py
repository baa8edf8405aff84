"""Bring-up never exceeds 5 V nor drives two channels at once, on any bus; and its command."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bringup_rig import FOUR, LOADS, Served, check_drive, put_out, same, verdicts
from cli_rig import Command

from firmware_protocol import messages as m
from tactile.bringup import probe
from tactile.bringup.bringup import CheckReport, bring_up
from tactile.bringup.probe import INTERVAL
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.link.inspection import amplifiers, identify, measuring, readings
from tactile.bus.link.link_bus import LinkBus
from tactile.devices import open_bus
from tactile.display.display import load_display

# What is put out, on any bus


URLS = (
    "mock:?keep=all", "sim:?keep=all", "mock:?link=serial&keep=all", "mock:?link=can&keep=all",
    "mock:?link=can&format=spectrum&keep=all",
)  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("url", URLS)
def test_no_bus_gets_more_than_5_v_or_two_channels_at_once(
    url: str, four: Path, opened: list[Bus]
) -> None:
    report = bring_up(url, four, ask=lambda question: "")
    volts = put_out(opened[0])
    check_drive(volts)
    assert np.abs(volts).max() > 4.7
    assert [bool(np.any(column)) for column in volts.T] == [True, True, False, True, True]
    assert opened[0].state == "closed"
    assert report.faults == []
    assert len(report.amplifiers) == ("link" in url)
    assert any("CAPS" in note for note in report.notes)


@pytest.mark.parametrize(("gain", "limit", "most"), [(1, 3, 3), (20, 5, 0.25), (0.5, 100, 5)])
def test_neither_drive_nor_electrodes_see_more_than_5_v(
    gain: float, limit: float, most: float, four: Path, opened: list[Bus]
) -> None:
    text = FOUR.replace("voltage_v = 100.0", f"voltage_v = {limit}")
    four.write_text(f"{text}[amplifier]\ngain = {gain}\n", encoding="utf-8")
    report = bring_up("mock:?keep=all", four, ask=lambda question: "")
    assert report.voltage_v == pytest.approx(most)
    check_drive(put_out(opened[0]), most=most)
    assert np.abs(put_out(opened[0])).max() > 0.95 * most
    assert opened[0].wiring.voltage == pytest.approx(most)


def test_tones_fade_in_and_out(four: Path) -> None:
    display = probe.cautious(load_display(four))
    signal = probe.tone(display)
    gain = np.array([signal.envelope(np.array([t]))[0] for t in (0, 0.01, 0.02, 0.12, 0.13, 0.14)])
    assert gain == pytest.approx(np.array([0, 0.5, 1, 1, 0.5, 0]) * 0.98 * 5)


def test_a_slow_display_is_driven_less(four: Path) -> None:
    """A current limit of 4 µA is 0.31 V/ms into 12.8 nF: 0.3 V at 161.8 Hz, 1.5 V in an edge."""
    four.write_text(FOUR + "current_ma = 0.004\n", encoding="utf-8")
    display = probe.cautious(load_display(four))
    time = np.arange(0, 0.14, 1e-5)
    steepest = np.abs(np.diff(probe.tone(display).at(time))).max() / 1e-5
    assert 0.95 * display.slew < steepest <= display.slew
    pulses = np.diff(probe.train(display, 1.0).at(time)) / 1e-5
    assert np.abs(pulses).max() <= display.slew


def test_an_e_stop_ends_it_and_is_named(four: Path, opened: list[Bus]) -> None:
    def progress(done: int, total: int) -> None:
        if done == 2:
            opened[0].estop()

    report = bring_up(
        "mock:?link=serial&keep=all", four, progress=progress, ask=lambda question: "1"
    )
    assert verdicts(report) == ["not measured", "not measured", "stopped", "not measured"]
    assert report.faults[0].startswith("stopped at channel 3: ")
    assert not any(one.asked for one in report.channels)
    assert not put_out(opened[0])[:, 3:].any()


@pytest.mark.ci
def test_several_boards_show_themselves_in_turn(four: Path) -> None:
    asked = []

    def ask(question: str) -> str:
        asked.append(question)
        return "" if "board" in question else "q"

    report = bring_up("mock:?link=can&boards=2", four, ask=ask)
    assert asked[:2] == [
        "board 1 of 2, node 1, shows itself; enter to go on: ",
        "board 2 of 2, node 2, shows itself; enter to go on: ",
    ]
    assert [(one.node, one.first_channel) for one in report.amplifiers] == [(1, 0), (2, 3)]


def test_what_is_asked_aside_disturbs_nothing(four: Path) -> None:
    with open_bus("mock:?link=serial&keep=all", load_display(four)) as bus:
        assert isinstance(bus, LinkBus)
        refused = bus.request(m.Set(bus.peers[0].host.session, m.Parameter.SENSE_MS, 10), 1)
        assert isinstance(refused, m.Nak)
        assert refused.code == m.NakCode.PARAMETER
        bus.start()
        bus.write(DriveBlock(0, np.full((800, 5), 3.0)))
        refused = bus.request(m.Get(m.Parameter.TEMPERATURE_MK), 1)
        assert isinstance(refused, m.Nak)
        assert identify(bus, 1, 1)
        value = bus.request(m.Get(m.Parameter.PULSE_MS), 1)
        assert isinstance(value, m.Value)
        assert value.value == 10
        bus.write(DriveBlock(800, np.full((800, 5), 3.0)))
        assert (bus.state, bus.status.detail) == ("running", "")
    assert np.count_nonzero(put_out(bus)[:, 0] > 2.99) >= 1600


def test_a_request_is_repeated_and_given_up(four: Path) -> None:
    """Each of 40 requests is tried three times over a line that loses a third of all."""
    with open_bus("mock:?link=serial&loss=0.33&seed=3", load_display(four)) as bus:
        assert isinstance(bus, LinkBus)
        answers = [bus.request(m.Get(m.Parameter.PULSE_MS), 1) for _ in range(40)]
    answered = [one for one in answers if one is not None]
    assert all(isinstance(one, m.Value) for one in answered)
    assert 25 <= len(answered) < 40  # (1 − (2/3)²)³ of them fail: 17 %


def test_a_bus_without_amplifiers_of_ours_tells_nothing(four: Path) -> None:
    with open_bus("mock:", load_display(four)) as bus:
        assert amplifiers(bus) == ()
        assert not identify(bus, 1, 1)
        with measuring(bus, INTERVAL) as nodes:
            assert nodes == set()
        assert readings(bus) == []


# The command


@pytest.mark.ci
def test_the_command_finds_no_fault(command: Command, four: Path) -> None:
    said = command("check", "mock:?link=serial", "--display", four)
    out = " ".join(said.out.split())
    assert said.code == 0
    assert "four at mock:?link=serial, checked with 5 V at most" in out
    assert "node 1: 'virtual', firmware 0x00010000, channels 0 … 4" in out
    assert "no faults found; not all values were measured" in out
    said = command("check", "mock:?link=serial", "--display", four, "--json")
    told = json.loads(said.out)
    assert said.code == 0
    assert set(told) == set(CheckReport.__dataclass_fields__)
    assert told["amplifiers"][0]["formats"] == ["pcm16", "pcm12", "bfp8", "spectrum"]


def test_the_command_says_2_for_what_cannot_be(command: Command, four: Path) -> None:
    said = command("check", "serial:///dev/nothing", "--display", four)
    assert said.code == 2
    assert "no such port" in said.err
    target = four.with_name("new.toml")
    said = command("check", "mock:", "--display", four, "--out", target)
    assert said.code == 2
    assert "--out: needs a person at a terminal" in said.err
    assert not target.exists()


@pytest.mark.realtime
def test_the_command_says_1_for_faults(
    command: Command, four: Path, serve: Callable[..., Served]
) -> None:
    said = command("check", serve("--load-pf", LOADS).url, "--display", four)
    assert said.code == 1
    assert "fault: channel 1, contactor 1: open" in " ".join(said.out.split())


@pytest.mark.ci
def test_the_command_asks_at_a_terminal(
    command: Command, monkeypatch: pytest.MonkeyPatch, four: Path
) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: "")
    target = four.with_name("new.toml")
    arguments = ("check", "mock:", "--display", four, "--out", target)
    said = command(*arguments)
    assert said.code == 0
    assert "written:" in said.out
    same(load_display(target), load_display(four))
    assert command(*arguments).code == 2
    assert command(*arguments, "--json", "--force").code == 2
    assert command(*arguments, "--force").code == 0
