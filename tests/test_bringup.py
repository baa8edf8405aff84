"""Tests of the measurement of lines: capacitance, faults, and the current of a load."""

import itertools
import math
import struct
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from bringup_rig import CHANNELS, FOUR, LOADS, PF, RATE, Served, check_drive, verdicts
from c_amplifier_rig import IDLE, MS, SENSE, SET, owned, playing

from firmware_protocol import messages as m
from tactile.arrays import Floats
from tactile.bringup import bringup, probe
from tactile.bringup.bringup import bring_up
from tactile.bringup.probe import LineLoad, Signal, judge, load_of
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.link.inspection import identify, measuring, readings
from tactile.bus.link.link_bus import LinkBus
from tactile.devices import open_bus
from tactile.display.display import load_display

INTERVAL = 10e-3
"""Interval between readings, the shortest that SENSE_MS allows (SPEC.md, 4) [s]."""
FREQUENCY = 161.8
"""Frequency of the tone [Hz]: 1.618 turns from reading to reading, the golden ratio."""


@pytest.mark.realtime
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
        assert found[k].capacitance_nf == pytest.approx(PF[k] * 1e-3 * tan, rel=6 * error)
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


@pytest.mark.realtime
def test_a_capacitance_that_is_off_is_named(serve: Callable[..., Served], four: Path) -> None:
    report = bring_up(serve("--load-pf", "9000,12800,12800,22000").url, four)
    assert verdicts(report) == ["off", "good", "off", "off"]
    last = report.channels[-1]
    error = cast(float, last.error_percent) / 100  # of whole µA at whatever phases were met
    assert error < 0.005
    assert last.capacitance_nf == pytest.approx(22.0, rel=6 * error + 0.002)
    told = f"{last.capacitance_nf:.2f} nF where the display has 12.81 nF"
    assert report.faults[-1].startswith(f"channel 4, contactor 3: off: {told}, ")


@pytest.mark.realtime
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_error_in_the_middle_leaves_the_device_idle(
    serve: Callable[..., Served], four: Path, error: type[BaseException],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The error comes while the tone sounds at full level."""
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


@pytest.mark.realtime
def test_a_link_in_trouble_is_no_measurement(
    serve: Callable[..., Served], four: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sound(bus: Bus, *arguments: Any) -> None:
        probe.sound(bus, *arguments)
        bus.counters.underruns += 1

    monkeypatch.setattr(bringup, "sound", sound)
    monkeypatch.setattr(bringup, "MOST_DISTURBED", 2)
    report = bring_up(serve("--load-pf", "12800").url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert report.faults == [
        f"channel {k} was not measured: the link had faults in 2 of 2 tones" for k in (0, 1, 3, 4)
    ]


@pytest.mark.realtime
def test_lines_are_measured_by_the_tones_without_faults_alone(
    serve: Callable[..., Served], four: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every other tone is broken, here by one of a fifth of the level, and a fault is counted."""
    tones = itertools.count()

    def sound(bus: Bus, signal: Signal, channel: int) -> None:
        broken = next(tones) % 2 == 0
        weak = replace(signal, envelope=lambda time: signal.envelope(time) / 5)
        probe.sound(bus, weak if broken else signal, channel)
        bus.counters.underruns += broken

    monkeypatch.setattr(bringup, "sound", sound)
    report = bring_up(serve("--load-pf", LOADS).url, four)
    assert verdicts(report) == ["good", "open", "off", "good"]
    assert report.channels[0].capacitance_nf == pytest.approx(12.8, rel=0.01)
    assert next(tones) >= 2 * 3 * 4


@pytest.mark.realtime
def test_readings_that_do_not_come_are_a_fault(
    serve: Callable[..., Served], four: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bringup, "readings", lambda bus: readings(bus)[:3])
    report = bring_up(serve("--load-pf", "12800").url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert len(report.faults) == 4
    assert report.faults[0].endswith("readings came, of 30")


@pytest.mark.realtime
def test_measuring_ends_with_its_block(serve: Callable[..., Served], four: Path) -> None:
    def interval(bus: LinkBus) -> int:
        value = bus.request(m.Get(m.Parameter.SENSE_MS), 1)
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
        kept = bus.peers[0].queries.senses
        kept.extend([m.Sense()] * 1000)
        assert len(kept) == 256
        assert len(bus.take_senses()) == 256
        assert bus.take_senses() == []


@pytest.mark.realtime
def test_an_amplifier_that_does_not_measure(serve: Callable[..., Served], four: Path) -> None:
    report = bring_up(serve().url, four)
    assert set(verdicts(report)) == {"not measured"}
    assert report.faults == []
    assert report.notes[0] == (
        "node 1 does not measure (CAPS features): of its channels open, short and wrong lines are "
        "not noticed"
    )


def test_the_model_draws_c_dv_dt(virtual_amplifier: Path, tmp_path: Path) -> None:
    """A ramp of 305 mV in 125 µs, then a level: 24.4 µA into 10 nF, then none."""
    run = playing([100 * min(k, 160) for k in range(320)])
    run.feed(1 * MS, owned(SET, struct.pack("<HI", 3, 10)))
    run.feed(45 * MS)
    run.run(virtual_amplifier.parent, tmp_path, "--load-pf", "10000,0,short", channels=3)
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
    one.run(virtual_amplifier.parent, tmp_path, "--load-pf", "short", channels=1)
    assert struct.unpack_from("<hh", one.packets(SENSE)[-1][2], 6) == (0, 32767)


@pytest.mark.parametrize("text", ["", "12,", "x", "-5", "1000001", "shorty", "4294967296", "1 2"])
def test_loads_that_are_none(virtual_amplifier: Path, text: str) -> None:
    done = subprocess.run(
        [virtual_amplifier, "--pty", "--load-pf", text],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    assert "no number from 0 to 1000000, nor short" in done.stderr


# Loads


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
    """The deviation of 400 fits is the mean stated one within 15 % (3.5 % is its own spread)."""
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
    assert (probe.FREQUENCY, probe.INTERVAL) == (FREQUENCY, INTERVAL)
    turns = np.sort(np.arange(12) * FREQUENCY * INTERVAL % 1)
    assert np.diff([*turns, turns[0] + 1]).max() < 2 / 12


def test_the_tone_is_slow_against_the_resonance(four: Path) -> None:
    """Motion adds no more than half a percent to the capacitance in air."""
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
    load = LineLoad(5 * volts, abs(y) * 5 * volts, complex(y), 0.001)
    assert judge(load, drive=5.0, admittance=2j * np.pi * FREQUENCY * 1e-8) == verdict


def test_no_voltage_at_all() -> None:
    at, volts, current = pairs(1e-8)
    short = load_of(at, 0 * volts, current, sample_rate=RATE)
    assert (short.voltage, short.error) == (0.0, math.inf)
    assert judge(short, drive=4.9, admittance=2j * np.pi * FREQUENCY * 0.9e-8) == "short"
    dead = load_of(at, 0 * volts, 0 * current, sample_rate=RATE)
    assert judge(dead, drive=4.9, admittance=2j * np.pi * FREQUENCY * 1e-8) == "no voltage"
