"""Bring-up: what is measured of lines, what a person is asked, and that 5 V are never exceeded.

The amplifier that measures is the C one on a pseudo-terminal, with loads on its channels; its
record of every instant tells what it put out.
"""

import json
import math
import re
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from test_c_amplifier import IDLE, MS, SENSE, SET, SOURCE, compiler, owned, playing

from firmware_protocol import messages as m
from tactile import cli
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.inspection import amplifiers, identify, measuring, readings
from tactile.bus.link_bus import LinkBus
from tactile.daemon import bringup, probe
from tactile.daemon.bringup import Report, bring_up
from tactile.daemon.probe import FREQUENCY, INTERVAL, TEST_VOLTAGE, Load, judge, load_of
from tactile.devices import open_bus
from tactile.display import Display, load_display
from tactile.display_map import Map, checked_target, write_map
from tactile.errors import InputError

Floats = NDArray[np.float64]

CHANNELS = 5
PF = (12800, 0, 99, 22000, 12000)
"""Of the channels; the third is a short."""
LOADS = ",".join("short" if pf == 99 else str(pf) for pf in PF)
RATE = 8000.0
CODE = 100 / 32767
"""V."""

FOUR = """\
# Four contactors in a row, and a gap in the channels
[display]
id = "four"
description = "A # that is none, and [grid] in a text"
opening_mm = [2.0, 3.0]   # along and across

# how they stand
[[contactor]]
position_mm = [0.0, 0.0]
channel = 0
[[contactor]]
# the second one
position_mm = [3.1, 0]
channel = 1
polarity = -1            # glued the other way round
shear_direction_deg = 30.0
[[contactor]]
position_mm = [6.2, 0.0]
channel = 3

[finger]                  # [[contactor]] is over
preset = "low"
[[contactor]]
position_mm = [9.3, 0.0]
channel = 4
# of the limits
[limits]
voltage_v = 100.0
"""
GRID = """\
# Rows of three
[display]
id = "six"
description = "Two rows of three"
opening_mm = [2.0, 3.0]

# the comment above
[grid]       # of the header
columns = 3  # along x
rows = 2
pitch_mm = [2.9, 3.7]   # 0.9 mm apart
polarity = -1
first_channel = 2

# the finger's own
[finger]
preset = "none"
[limits]
voltage_v = 60.0
"""


@pytest.fixture
def four(tmp_path: Path) -> Path:
    path = tmp_path / "four.toml"
    path.write_text(FOUR, encoding="utf-8")
    return path


@pytest.fixture
def grid(tmp_path: Path) -> Path:
    path = tmp_path / "six.toml"
    path.write_text(GRID, encoding="utf-8")
    return path


def verdicts(report: Report) -> list[str]:
    return [one.verdict for one in report.channels]


# The C amplifier


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of the virtual amplifier."""
    directory = tmp_path_factory.mktemp("c")
    command = ["make", "-C", str(SOURCE), f"BUILD={directory}", f"CC={compiler()}"]
    made = subprocess.run(
        [*command, "virtual-amplifier"], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    return directory


@dataclass
class Served:
    """A virtual amplifier on a pseudo-terminal."""

    url: str
    out: Path

    def rows(self) -> tuple[NDArray[np.int64], Floats]:
        """Return states, high voltage (S, 2), and volts (S, C), up to some moment after now."""
        size = struct.calcsize(f"<QIBB{CHANNELS}h")
        before = self.out.stat().st_size
        end = time.monotonic() + 20
        while self.out.stat().st_size < before + 2 * 20 * 8 * size:  # two flushes
            assert time.monotonic() < end, "nothing is put out any more"
            time.sleep(0.01)
        data = self.out.read_bytes()
        kind = np.dtype(
            [("tick", "<u8"), ("at", "<u4"), ("now", "u1", 2), ("codes", "<i2", CHANNELS)]
        )
        rows = np.frombuffer(data[: len(data) // size * size], kind)
        return rows["now"].astype(np.int64), rows["codes"].astype(np.float64) * CODE


@pytest.fixture
def serve(built: Path, tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Start amplifiers with options."""
    processes = []

    def start(*options: str) -> Served:
        out = tmp_path / "out"
        command = [built / "virtual-amplifier", "--pty", "--channels", str(CHANNELS)]
        process = subprocess.Popen(
            [*map(str, command), "--out", str(out), *options],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        processes.append(process)
        assert process.stdout is not None
        return Served(f"serial://{process.stdout.readline().decode().strip()}", out)

    yield start
    for process in processes:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def check_drive(volts: Floats, *, most: float = TEST_VOLTAGE) -> None:
    """See that no more than one channel is driven at a time, within the limit."""
    assert np.abs(volts).max() <= most
    assert np.count_nonzero(volts, axis=1).max() == 1


def test_lines_are_measured_and_faulty_ones_named(serve: Callable[..., Served], four: Path) -> None:
    """12.8 nF is the display's own; 5 % of it is asked for, what is stated is far less."""
    served = serve("--load-pf", LOADS)
    text = FOUR.replace("channel = 4", "channel = 2")
    four.write_text(text.replace("channel = 3", "channel = 4"), encoding="utf-8")
    report = bring_up(served.url, four)
    found = {one.channel: one for one in report.channels}
    assert {k: one.verdict for k, one in found.items()} == {
        0: "good", 1: "open", 2: "short", 4: "good",
    }  # fmt: skip
    assert [one.contactor for one in report.channels] == [0, 1, 3, 2]
    for k in (0, 4):
        assert found[k].capacitance_nf == pytest.approx(PF[k] * 1e-3, rel=0.05)
        error = cast(float, found[k].error_percent) / 100
        assert error < 0.005
        tan = math.tan(np.pi * FREQUENCY / RATE) / (np.pi * FREQUENCY / RATE)  # of the model
        assert found[k].capacitance_nf == pytest.approx(PF[k] * 1e-3 * tan, rel=4 * error)
    assert any(f.startswith("channel 1, contactor 1: open: ") for f in report.faults)
    assert any(f.startswith("channel 2, contactor 3: short: 0.00 V") for f in report.faults)
    assert len(report.faults) == 2
    (one,) = report.amplifiers
    assert (one.name, one.channels, one.measures) == ("virtual", CHANNELS, True)
    assert abs(one.drift_ppm) < 1000  # the same clock, known from few exchanges
    states, volts = served.rows()
    check_drive(volts)
    driven = [0 if not row.any() else int(row.argmax()) + 1 for row in volts != 0]
    order = [k for k, last in zip(driven[1:], driven, strict=False) if k and k != last]
    assert sorted(set(order), key=order.index) == [1, 2, 3, 5]
    assert np.abs(volts).max() > 4.8
    assert tuple(states[-1]) == (IDLE, 0)
    assert not volts[-100:].any()


@pytest.mark.ci
def test_a_capacitance_that_is_off_is_named(serve: Callable[..., Served], four: Path) -> None:
    report = bring_up(serve("--load-pf", "9000,12800,12800,22000").url, four)
    assert verdicts(report) == ["off", "good", "off", "off"]
    assert "22.0" in report.faults[-1]
    assert "the display has 12.81 nF" in report.faults[-1]


@pytest.mark.ci
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_error_in_the_middle_leaves_the_device_idle(
    serve: Callable[..., Served], four: Path, error: type[BaseException],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """While it sounds, at full level."""
    served = serve("--load-pf", "12800")
    write, count = LinkBus._write, [0]

    def failing(self: LinkBus, block: DriveBlock) -> None:
        count[0] += 1
        if count[0] == 30:
            raise error
        write(self, block)

    monkeypatch.setattr(LinkBus, "_write", failing)
    with pytest.raises(error):
        bring_up(served.url, four)
    states, volts = served.rows()
    assert tuple(states[-1]) == (IDLE, 0)
    assert not volts[-100:].any()
    assert np.abs(volts).max() > 1
    check_drive(volts)


def interrupted(bus: Bus) -> None:
    with measuring(bus, INTERVAL):
        bus.start()
        raise KeyboardInterrupt


@pytest.mark.ci
def test_a_link_in_trouble_is_no_measurement(
    serve: Callable[..., Served], four: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sound(bus: Bus, *arguments: Any) -> None:
        probe.sound(bus, *arguments)
        bus.counters.underruns += 1

    monkeypatch.setattr(bringup, "sound", sound)
    monkeypatch.setattr(bringup, "TRIES", 2)
    report = bring_up(serve("--load-pf", "12800").url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert report.faults == [
        f"channel {k} was not measured: the link had troubles in each of 2 tones"
        for k in (0, 1, 3, 4)
    ]


@pytest.mark.ci
def test_readings_that_do_not_come_are_a_fault(
    serve: Callable[..., Served], four: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bringup, "readings", lambda bus: readings(bus)[:11])
    report = bring_up(serve("--load-pf", "12800").url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert len(report.faults) == 4
    assert report.faults[0].endswith("readings came, of 30")


@pytest.mark.ci
def test_measuring_ends_with_its_block(serve: Callable[..., Served], four: Path) -> None:
    def interval(bus: LinkBus) -> int:
        value = bus.ask(m.Get(m.Parameter.SENSE_MS), 1)
        assert isinstance(value, m.Value)
        return value.value

    with open_bus(serve("--load-pf", "12800").url, load_display(four)) as bus:
        assert isinstance(bus, LinkBus)
        with measuring(bus, INTERVAL) as nodes:
            assert nodes == {1}
            assert interval(bus) == 10
            bus.start()
        assert bus.state == "idle"
        assert interval(bus) == 0
        with pytest.raises(KeyboardInterrupt):
            interrupted(bus)
        assert interval(bus) == 0
        assert bus.state == "idle"
        time.sleep(0.05)
        readings(bus)
        time.sleep(0.05)
        assert readings(bus) == []
        assert identify(bus, 1, 1)


@pytest.mark.ci
def test_readings_do_not_grow(serve: Callable[..., Served], four: Path) -> None:
    with open_bus(serve("--load-pf", "12800").url, load_display(four)) as bus:
        assert isinstance(bus, LinkBus)
        kept = bus.peers[0].aside.senses
        kept.extend([m.Sense()] * 1000)
        assert len(kept) == 256
        assert len(bus.sensed()) == 256
        assert bus.sensed() == []


@pytest.mark.ci
def test_an_amplifier_that_does_not_measure(serve: Callable[..., Served], four: Path) -> None:
    report = bring_up(serve().url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert report.faults == []
    assert report.notes[0] == (
        "node 1 does not measure (CAPS features): of its channels open, short and wrong lines are "
        "not noticed"
    )


def test_the_model_draws_c_dv_dt(built: Path, tmp_path: Path) -> None:
    """A ramp of 305 mV in 125 µs, then a level: 24.4 µA into 10 nF, then none."""
    run = playing([100 * min(k, 160) for k in range(320)])
    run.feed(1 * MS, owned(SET, struct.pack("<HI", 3, 10)))
    run.feed(45 * MS)
    run.run(built, tmp_path, "--load-pf", "10000,0,short", channels=3)
    codes = {x.position: x.codes[0] for x in run.instants}
    told = [struct.unpack_from("<IBB6h", p) for _, _, p in run.packets(SENSE)]
    ramp = [t for t in told if 16 < t[0] <= 160]
    level = [t for t in told if t[0] > 160]
    assert len(ramp) == 2
    assert len(level) == 1
    for t in ramp:
        assert t[3:5] == (codes[t[0]] - 50, 24)
    assert level[0][3:5] == (16000, 0)
    assert all(t[5:] == (0, 0, 0, 0) for t in told)  # channels 1 and 2 are at 0 V
    one = playing([3000] * 300)
    one.feed(1 * MS, owned(SET, struct.pack("<HI", 3, 10)))
    one.feed(30 * MS)
    one.run(built, tmp_path, "--load-pf", "short", channels=1)
    assert struct.unpack_from("<hh", one.packets(SENSE)[-1][2], 6) == (0, 32767)


@pytest.mark.parametrize("text", ["", "12,", "x", "-5", "1000001", "shorty", "4294967296", "1 2"])
def test_loads_that_are_none(built: Path, text: str) -> None:
    done = subprocess.run(
        [built / "virtual-amplifier", "--pty", "--load-pf", text],
        capture_output=True, text=True, check=False, timeout=20,
    )  # fmt: skip
    assert done.returncode == 1
    assert "no number from 0 to 1000000, nor short" in done.stderr


# What a load is


def pairs(
    capacitance: float, *, resistance: float = math.inf, count: int = 30, delay: float = 0.0,
    offset: tuple[float, float] = (0.0, 0.0), level: float = 4.9,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Return positions, volts and current at every 10 ms."""
    at: Floats = 123.0 + np.arange(count, dtype=np.float64) * (INTERVAL * RATE)
    angle = 2 * np.pi * FREQUENCY * (at / RATE - delay)
    current = -2 * np.pi * FREQUENCY * capacitance * np.sin(angle) + np.cos(angle) / resistance
    return at, level * np.cos(angle) + offset[0], level * current + offset[1]


def test_capacitance_and_resistance_come_out_whatever_delay_and_offset() -> None:
    load = load_of(
        *pairs(5e-9, resistance=1e6, delay=1.7e-3, offset=(0.3, -7e-6)), sample_rate=RATE
    )
    assert load.capacitance == pytest.approx(5e-9, rel=1e-9)
    assert load.admittance.real == pytest.approx(1e-6, rel=1e-9)
    assert load.voltage == pytest.approx(4.9, rel=1e-9)
    assert load.loss == pytest.approx(1e-6 / (2 * np.pi * FREQUENCY * 5e-9), rel=1e-9)
    assert load.error < 1e-9


def test_the_stated_error_is_that_of_noise() -> None:
    """Of 400 fits the deviation is the mean stated one within 15 % (3.5 % is its own spread)."""
    random = np.random.default_rng(1)
    found = []
    for _ in range(400):
        at, volts, current = pairs(12.8e-9)
        noisy = current + random.normal(0, 2e-6, len(at))
        found.append(load_of(at, volts + random.normal(0, 0.05, len(at)), noisy, sample_rate=RATE))
    stated = np.mean([load.error for load in found])
    spread = np.std([load.capacitance for load in found]) / 12.8e-9
    assert spread == pytest.approx(stated, rel=0.15)
    assert np.mean([load.capacitance for load in found]) == pytest.approx(12.8e-9, rel=2e-3)


def test_readings_meet_ever_other_phases() -> None:
    """No gap between the phases of any 12 readings is twice as wide as if they were even."""
    turns = np.sort(np.arange(12) * FREQUENCY * INTERVAL % 1)
    assert np.diff([*turns, turns[0] + 1]).max() < 2 / 12


def test_the_tone_is_slow_against_the_resonance(four: Path) -> None:
    """So that motion adds no more than half a percent to the capacitance in air."""
    from tactile.actuator.finger import FingerLoad
    from tactile.actuator.response import tip_response

    display = load_display(four)
    r = tip_response(display.bimorph, FingerLoad.none(), [FREQUENCY])
    there = float((r.admittance / (2j * np.pi * FREQUENCY)).real[0])
    assert there == pytest.approx(display.capacitance, rel=5e-3)


@pytest.mark.parametrize(
    ("share", "volts", "loss", "verdict"),
    [
        (1.0, 1.0, 0.02, "good"),
        (1.24, 1.0, 0.02, "good"),
        (1.26, 1.0, 0.02, "off"),
        (0.74, 1.0, 0.02, "off"),
        (0.26, 1.0, 0.02, "off"),
        (0.24, 1.0, 0.02, "open"),
        (0.0, 1.0, 0.0, "open"),
        (1.0, 1.0, 0.31, "leaks"),
        (11.0, 1.0, 0.02, "short"),
        (3.0, 0.49, 0.0, "short"),
        (1.0, 0.49, 0.0, "no voltage"),
        (1.0, 0.85, 0.02, "wrong voltage"),
        (1.0, 1.15, 0.02, "wrong voltage"),
    ],
)
def test_verdicts(share: float, volts: float, loss: float, verdict: str) -> None:
    omega = 2 * np.pi * FREQUENCY
    y = omega * 1e-8 * share * (1j + loss)
    load = Load(5 * volts, abs(y) * 5 * volts, complex(y), 0.001)
    assert judge(load, drive=5.0, capacitance=1e-8) == verdict


def test_no_voltage_at_all() -> None:
    at, volts, current = pairs(1e-8)
    short = load_of(at, 0 * volts, current, sample_rate=RATE)
    assert (short.voltage, short.error) == (0.0, math.inf)
    assert judge(short, drive=4.9, capacitance=0.9e-8) == "short"
    dead = load_of(at, 0 * volts, 0 * current, sample_rate=RATE)
    assert judge(dead, drive=4.9, capacitance=1e-8) == "no voltage"


# What is put out, on any bus


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Bus]:
    """Collect the buses that are opened."""
    found: list[Bus] = []

    def open_and_keep(*arguments: Any, **named: Any) -> Bus:
        found.append(open_bus(*arguments, **named))
        return found[-1]

    monkeypatch.setattr(bringup, "open_bus", open_and_keep)
    return found


def put_out(bus: Bus) -> Floats:
    return cast(Any, bus).output  # type: ignore[no-any-return]


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
    gain = np.array([signal.envelope(np.array([t]))[0] for t in (0, 0.01, 0.02, 0.32, 0.33, 0.34)])
    assert gain == pytest.approx(np.array([0, 0.5, 1, 1, 0.5, 0]) * 0.98 * 5)


def test_a_slow_display_is_driven_less(four: Path) -> None:
    """A current limit of 4 µA is 0.31 V/ms into 12.8 nF: 0.3 V at 161.8 Hz, 1.5 V in an edge."""
    four.write_text(FOUR + "current_ma = 0.004\n", encoding="utf-8")
    display = probe.cautious(load_display(four))
    time = np.arange(0, 0.34, 1e-5)
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
        refused = bus.ask(m.Set(bus.peers[0].host.session, m.Parameter.SENSE_MS, 10), 1)
        assert isinstance(refused, m.Nak)
        assert refused.code == m.NakCode.PARAMETER
        bus.start()
        bus.write(DriveBlock(0, np.full((800, 5), 3.0)))
        refused = bus.ask(m.Get(m.Parameter.TEMPERATURE_MK), 1)
        assert isinstance(refused, m.Nak)
        assert identify(bus, 1, 1)
        value = bus.ask(m.Get(m.Parameter.PULSE_MS), 1)
        assert isinstance(value, m.Value)
        assert value.value == 10
        bus.write(DriveBlock(800, np.full((800, 5), 3.0)))
        assert (bus.state, bus.status.detail) == ("running", "")
    assert np.count_nonzero(put_out(bus)[:, 0] > 2.99) >= 1600


def test_a_request_is_repeated_and_given_up(four: Path) -> None:
    """Of 40 requests over a line that loses a third of all, each is tried three times."""
    with open_bus("mock:?link=serial&loss=0.33&seed=3", load_display(four)) as bus:
        assert isinstance(bus, LinkBus)
        answers = [bus.ask(m.Get(m.Parameter.PULSE_MS), 1) for _ in range(40)]
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


# What a person tells


class Person:
    """Sees what moves: channel k moves ``moves[k]``, positive volts along or against its direction.

    What is asked is kept; ``extra`` are answers given before the true one to the first question.
    """

    def __init__(self, bus: list[Bus], moves: dict[int, tuple[int, int]], *extra: str) -> None:
        self.asked: list[str] = []
        self._bus, self._moves, self._extra = bus, moves, list(extra)
        self._sign = 0.0
        self._now = (0, 0)

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        if self._extra:
            return self._extra.pop(0)
        if "which contactor" in question:
            volts = put_out(self._bus[0])[-4000:]  # of the last train, 8000 samples long
            channel = int(np.abs(volts).max(axis=0).argmax())
            self._now, self._sign = self._moves[channel], np.sign(volts[:, channel].sum())
            return str(self._now[0])
        return "y" if self._sign * self._now[1] > 0 else "n"


AS_IN_FILE = {0: (0, 1), 1: (1, -1), 3: (2, 1), 4: (3, 1)}


def test_true_answers_about_a_right_file_change_nothing(
    four: Path, tmp_path: Path, opened: list[Bus]
) -> None:
    person, target = Person(opened, AS_IN_FILE), tmp_path / "new.toml"
    report = bring_up("mock:?keep=all", four, ask=person, write=target)
    assert report.faults == []
    assert report.written == str(target)
    same(load_display(target), load_display(four))
    assert len(person.asked) == 8
    assert person.asked[3] == "did it shear toward 30° and back? [Y/n] "


def test_what_moves_otherwise_is_written(four: Path, tmp_path: Path, opened: list[Bus]) -> None:
    """Two lines are swapped, and three of four benders are glued the other way round."""
    moves = {0: (1, 1), 1: (0, -1), 3: (2, 1), 4: (3, -1)}
    target = tmp_path / "new.toml"
    report = bring_up("mock:?keep=all", four, ask=Person(opened, moves), write=target)
    assert report.faults == []
    new, old = load_display(target), load_display(four)
    assert new.channel.tolist() == [1, 0, 3, 4]
    assert new.polarity.tolist() == [-1, 1, 1, -1]
    same(replace(new, channel=old.channel, polarity=old.polarity), old)


def test_without_write_another_map_is_a_fault(four: Path, opened: list[Bus]) -> None:
    moves = AS_IN_FILE | {4: (3, -1)}
    report = bring_up("mock:?keep=all", four, ask=Person(opened, moves))
    assert report.faults == ["the display file has another map than the display; see --write"]


def test_enter_is_as_in_the_file(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    assert bring_up("mock:", four, ask=lambda question: "", write=target).faults == []
    same(load_display(target), load_display(four))


def test_answers_that_are_none_are_asked_again(four: Path, opened: list[Bus]) -> None:
    person = Person(opened, AS_IN_FILE, "4", "zero", "r")
    report = bring_up("mock:?keep=all", four, ask=person)
    assert report.faults == []
    assert [q.partition("channel")[0] for q in person.asked[:4]] == [
        "", "'4': a number below 4, r, - or q\n", "'zero': a number below 4, r, - or q\n", "",
    ]  # fmt: skip
    sounds = np.abs(put_out(opened[0])[:, 0]) > 1
    assert np.count_nonzero(np.diff(sounds.astype(int)) == 1) > 4 * 5  # trains, and the tone


def test_one_contactor_for_two_channels_is_refused(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    answers = iter(["2", "y", "2", "y", "2", "y", "3", "y"])
    report = bring_up("mock:", four, ask=lambda question: next(answers), write=target)
    assert report.faults == [
        "contactor 2: channels 0 and 1 both move it",
        "contactor 2: channels 1 and 3 both move it",
        f"{target} was not written: nobody told the whole map",
    ]
    assert not target.exists()


def test_a_channel_that_moves_nothing_is_a_fault(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    answers = iter(["-", "", "", "", "n", "", ""])
    report = bring_up("mock:", four, ask=lambda question: next(answers), write=target)
    assert report.faults == ["channel 0 moved nothing"]
    assert load_display(target).polarity.tolist() == [1, -1, -1, 1]
    answers = iter(["-", "0", "", "", "", "", ""])
    report = bring_up("mock:", four, ask=lambda question: next(answers))
    assert "channel 0: what it moves is not known" in report.faults


@pytest.mark.parametrize("answers", [["", "", "q"], ["", "", ""], ["", "", "", "bad"]])
def test_who_goes_away_ends_the_questions(answers: list[str], four: Path, tmp_path: Path) -> None:
    """By q, or by the end of input, in either question."""
    left = iter(answers)

    def ask(question: str) -> str:
        try:
            return next(left)
        except StopIteration:
            raise EOFError from None

    target = tmp_path / "new.toml"
    report = bring_up("mock:", four, ask=ask, write=target)
    assert report.notes[-1] == "from channel 1 on nobody told what moves"
    assert report.faults == [f"{target} was not written: nobody told the whole map"]
    assert not target.exists()


# The file


def same(a: Display, b: Display) -> None:
    """See that two displays have the same arrays, bit by bit, and all else."""
    for name in ("contactors", "shear_direction", "polarity", "channel", "kind"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    names = ("name", "opening", "projected", "bimorph", "load", "amplifier", "limits")
    assert [getattr(a, n) for n in names] == [getattr(b, n) for n in names]
    assert len(a.measured) == len(b.measured)


def rewritten(path: Path, told: Map | None = None) -> str:
    target = path.with_name("new.toml")
    write_map(path, target, told or Map.of(load_display(path)), force=True)
    return target.read_text("utf-8")


def test_a_grid_becomes_contactors(grid: Path) -> None:
    text = rewritten(grid)
    same(load_display(grid.with_name("new.toml")), load_display(grid))
    assert "[grid]" not in text
    assert text.count("[[contactor]]") == 6
    comments = re.findall("#.*", text)
    assert comments == re.findall("#.*", GRID)
    before, _, after = text.partition("[[contactor]]")
    assert before.startswith(GRID[: GRID.index("# the comment")])
    assert after.endswith(GRID[GRID.index("# the finger's") :])


def test_contactors_keep_their_comments_and_all_else_its_place(four: Path) -> None:
    text = rewritten(four)
    same(load_display(four.with_name("new.toml")), load_display(four))
    kept = [line for line in FOUR.splitlines() if line.lstrip().startswith("#")]
    assert all(line in text.splitlines() for line in kept)
    assert "# glued the other way round\n" in text
    for part in ('description = "A # that is none, and [grid] in a text"', "[finger]          "):
        assert part in text
    assert text.index("[finger]") < text.rindex("[[contactor]]") < text.index("# of the limits")
    assert rewritten(four.with_name("new.toml")) == text


def test_the_shipped_displays_can_be_rewritten(tmp_path: Path) -> None:
    for name in ("reference-24", "reference-64"):
        target = tmp_path / f"{name}.toml"
        write_map(name, target, Map.of(load_display(name)), force=False)
        same(load_display(target), load_display(name))


def test_responses_stay_and_keep_the_folder(four: Path, tmp_path: Path) -> None:
    rows = "frequency_hz,magnitude,phase_deg,unit\n20,1,0,um/V\n1000,1,0,um/V\n"
    for name in ("one.csv", 'tw"o.csv'):
        (tmp_path / name).write_text(rows, encoding="utf-8")
    text = FOUR.replace("channel = 3", "channel = 3\nresponse = 'tw\"o.csv' # measured")
    group = '[[group]]\nresponse = "one.csv"\ncontactors = [0]\n'
    four.write_text(text + group, encoding="utf-8")
    new = rewritten(four)
    same(load_display(tmp_path / "new.toml"), load_display(four))
    assert "# measured\n" in new
    assert load_display(tmp_path / "new.toml").kind.tolist() == [1, 0, 2, 0]
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match=r"must be in .*, where the measured responses are"):
        checked_target(four, tmp_path / "other" / "new.toml", force=False)


OTHER_FORMS = {
    "dotted": GRID.replace("[grid]", "[grid.x]"),
    "inline": re.sub(r"# the comment(.|\n)*first_channel = 2\n", "", GRID).replace(
        "# Rows", "grid = {columns = 3, rows = 2, pitch_mm = [2.9, 3.7]}\n# Rows"
    ),
    "in a text": GRID.replace('"Two rows of three"', "'''\n[grid]\n'''\n# '''"),
}


@pytest.mark.parametrize("text", OTHER_FORMS.values(), ids=OTHER_FORMS)
def test_contactors_in_another_form_are_refused(text: str, grid: Path) -> None:
    grid.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"not written as tables|unknown key"):
        checked_target(grid, grid.with_name("new.toml"), force=False)


def test_nothing_is_overwritten_without_force(four: Path, tmp_path: Path) -> None:
    target, told = tmp_path / "new.toml", Map.of(load_display(four))
    target.write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="is there already; --force overwrites it"):
        write_map(four, target, told, force=False)
    with pytest.raises(InputError, match="is there already"):
        bring_up("nothing:", four, ask=lambda question: "", write=target)
    assert target.read_text("utf-8") == "mine"
    write_map(four, target, told, force=True)
    same(load_display(target), load_display(four))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["four.toml", "new.toml"]


@pytest.mark.parametrize(
    ("name", "said"), [("new.txt", "must end in .toml"), ("no/new.toml", "no folder")]
)
def test_targets_that_cannot_be(name: str, said: str, four: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        checked_target(four, tmp_path / name, force=False)


def test_what_would_be_no_display_is_not_written(four: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="drives more than one contactor"):
        write_map(four, tmp_path / "new.toml", Map((0, 0, 3, 4), (1, 1, 1, 1)), force=False)
    assert [path.name for path in tmp_path.iterdir()] == ["four.toml"]


# The command


def run(capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch, *arguments: object) -> int:
    patch.setattr(sys, "argv", ["tactile", "check", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert isinstance(left.value.code, int)
    return left.value.code


@pytest.mark.ci
def test_the_command_finds_no_fault(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, four: Path
) -> None:
    assert run(capsys, monkeypatch, "mock:?link=serial", "--display", four) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "four at mock:?link=serial, tried with 5 V at most" in out
    assert "node 1: 'virtual', firmware 0x00010000, channels 0 … 4" in out
    assert "no fault found in what was looked at" in out
    assert run(capsys, monkeypatch, "mock:?link=serial", "--display", four, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == set(Report.__dataclass_fields__)
    assert told["amplifiers"][0]["formats"] == ["pcm16", "pcm12", "bfp8", "spectrum8"]


def test_the_command_says_1_for_faults_and_2_for_what_cannot_be(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, four: Path,
    serve: Callable[..., Served],
) -> None:  # fmt: skip
    assert run(capsys, monkeypatch, "serial:///dev/nothing", "--display", four) == 2
    assert "no such port" in capsys.readouterr().err
    target = four.with_name("new.toml")
    assert run(capsys, monkeypatch, "mock:", "--display", four, "--write", target) == 2
    assert "--write: needs a person at a terminal" in capsys.readouterr().err
    assert not target.exists()
    url = serve("--load-pf", LOADS).url
    assert run(capsys, monkeypatch, url, "--display", four) == 1
    out = capsys.readouterr().out
    assert "fault: channel 1, contactor 1: open" in " ".join(out.split())


@pytest.mark.ci
def test_the_command_asks_at_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, four: Path
) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: "")
    target = four.with_name("new.toml")
    assert run(capsys, monkeypatch, "mock:", "--display", four, "--write", target) == 0
    assert "written:" in capsys.readouterr().out
    same(load_display(target), load_display(four))
    arguments = ("mock:", "--display", four, "--write", target)
    assert run(capsys, monkeypatch, *arguments) == 2
    assert run(capsys, monkeypatch, *arguments, "--json", "--force") == 2
    assert run(capsys, monkeypatch, *arguments, "--force") == 0
