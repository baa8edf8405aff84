"""The command line on links: capacity, devices that are found, and reports of playing."""

import json

import numpy as np
import pytest
from cli_rig import Command, assert_mistake

from tactile.bus import registry
from tactile.bus.base import DriveFrame
from tactile.bus.simulated.mock_bus import open_mock
from tactile.bus.simulated.modeled_bus import MockOptions, ModeledBus
from tactile.devices import link_at, open_bus
from tactile.display.display import load_display
from tactile.errors import InputError
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.texture.surface import load_texture

# Budget


def test_the_budget_marks_what_will_be_sent(command: Command) -> None:
    result = command("budget", "reference-24", "can:socketcan/can0?fd=true")
    assert result.code == 0
    assert "Guards" not in result.out
    rows = [line.split() for line in result.out.splitlines()[2:]]
    assert [row[0] for row in rows if row[-1] == "chosen"] == ["PCM12"]
    assert rows[0][0] == "PCM16"
    assert rows[0][-2:] == ["too", "much"]


def test_the_budget_counts_windows_of_currents(command: Command) -> None:
    """PCM12 no longer fits beside them."""
    url = "can:socketcan/can0?fd=true&correlation_ms=25"
    result = command("budget", "reference-24", url)
    lines = result.out.splitlines()
    assert lines[1].strip() == "Windows of 25 ms of currents take 8.6% of the way back"
    assert lines[2].strip() == "Guards, which follow the finger, take 8.3% of the way out"
    assert [line.split()[0] for line in lines if "chosen" in line] == ["BFP8"]
    told = json.loads(command("budget", "reference-24", url, "--json").out)
    assert 0.08 < told["correlation_use"] < told["reply_use"] < 0.1
    assert 0.08 < told["guard_use"] < 0.085


def test_the_budgets_plan_is_what_an_amplifier_on_that_link_gets(command: Command) -> None:
    url = "mock:?link=serial&bit_rate=3000000"
    told = json.loads(command("budget", "reference-24", url, "--json").out)
    with open_bus(url, load_display("reference-24")) as bus:
        assert isinstance(bus, ModeledBus)
        assert told["plan"]["sample_format"] == bus.plan.sample_format
        assert told["plan"]["use"] == pytest.approx(bus.plan.use)
    assert told["cap"] == link_at(url).cap


@pytest.mark.parametrize("url", ["audio:", "drv2667:1", "sim:"])
def test_a_device_without_packets_has_no_budget(command: Command, url: str) -> None:
    assert_mistake(command("budget", "reference-24", url), "carries no packets")


def test_what_cannot_fit_is_refused_with_the_table(command: Command) -> None:
    device = "mock:?link=i2c"
    result = command("play", "wood-oak", "--seconds", "0.2", "--device", device)
    assert result.code == 2
    first, *rows = result.err.splitlines()
    assert "I2C 400 kHz cannot carry 24 channels" in first
    assert len(rows) == 15
    assert all(row.split()[-2:] == ["too", "much"] for row in rows[1:])


# Devices


def test_devices_lists_what_every_driver_finds(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [registry.FoundDevice("serial:///dev/ttyACM7", "an amplifier, USB 1209:0001")]
    monkeypatch.setattr(registry, "_drivers", {})
    assert command("devices").out == "no device found; sim: and mock: are always available\n"
    registry.register_bus("serial", open_mock, MockOptions, find=lambda: found)
    assert "serial:///dev/ttyACM7  an amplifier, USB 1209:0001" in command("devices").out
    listed = json.loads(command("devices", "--json").out)
    assert listed == [{"url": found[0].url, "about": found[0].about}]


# Playing


def test_a_narrow_link_is_played_in_spectrum_frames_and_says_so(command: Command) -> None:
    told = json.loads(
        command("play", "wood-oak", "--seconds", "0.5", "--device", "mock:?link=can", "--json").out
    )
    assert (told["frames"], told["sample_rate_hz"], told["faults"]) == (25, 8000, {})
    said = command("play", "wood-oak", "--seconds", "0.5", "--device", "mock:?link=can").out
    assert "25 spectrum frames" in said


def test_frames_have_no_samples_to_record(command: Command, tmp_path: object) -> None:
    result = command(
        "play", "wood-oak", "--device", "mock:?link=can", "--record", f"{tmp_path}/a.npz"
    )
    assert result.code == 2
    assert (
        result.err == "tactile: --record: the link takes spectrum frames, which have no samples\n"
    )


def test_a_slower_link_is_played_at_its_own_rate() -> None:
    """A UART of 1 Mbit/s carries 24 channels of BFP8 at 2.5 kHz and no more."""
    stroke = Trajectory.line(speed=0.08, duration=0.3)
    summary = run(
        load_display("reference-24"), load_texture("wood-pine-sanded"), stroke,
        device="mock:?link=serial&bit_rate=1000000",
    )  # fmt: skip
    assert summary.sample_rate_hz == 2500
    assert summary.samples == 750
    assert summary.faults == {}


def test_frames_are_refused_before_the_bus_knows_their_carriers() -> None:
    with open_bus("mock:?link=can", load_display("reference-24")) as bus:
        with pytest.raises(OSError, match="tune it to their carriers first"):
            bus.start()
        bus.tune(np.array([0.0, 100.0]))
        bus.start()
        with pytest.raises(InputError, match="write_frame: 3 carriers, not 2"):
            bus.write_frame(DriveFrame(160, np.zeros((24, 3), complex)))


def test_what_holds_its_last_voltage_is_refused_unless_it_is_accepted(command: Command) -> None:
    arguments = ("play", "wood-oak", "--device", "bos1921:63")
    assert "accept that with --accept-unsafe-hold" in command(*arguments).err
    accepted = command(*arguments, "--accept-unsafe-hold")
    assert accepted.code == 2
    assert "--accept-unsafe-hold" not in accepted.err
