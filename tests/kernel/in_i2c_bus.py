"""Checks in QEMU: our I²C buses on /dev/i2c-7, whose targets are in Python."""

import errno
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from bus_tools import (
    CODE,
    TRIES,
    Limits,
    Rig,
    assert_is,
    linked,
    opened,
    play,
    playing,
    wait_for_link,
    write,
)
from chip_models import Bos1921Model, Drv2667Model
from cuse_i2c import CuseI2c
from guest_tools import wait_for
from i2c_targets import AmplifierTarget, I2cBus

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import State
from tactile.arrays import Floats
from tactile.bus import i2c_bus
from tactile.bus.chips import bos1921, drv2667
from tactile.bus.chips.chip import ChipCounters
from tactile.bus.chips.chip_bus import ChipBus
from tactile.bus.registry import open_bus
from tactile.clock import MONOTONIC
from tactile.errors import BusError

NUMBER, ADDRESS, NOBODY = 7, 0x42, 0x33
URL = f"i2c:{NUMBER}?address={ADDRESS:#x}"
REARMED = f"{URL}&rearm=true"
RATE = 2500
BURST = 5
"""Refused transfers in a row: less than the 0.1 s after which a link is taken as broken."""
MANY = 10**6
LSB = {"drv2667": 50 / 127, "bos1921": 3.6 * 31 / 2047}
"""Voltage of one code of each chip [V]."""
SLEW = 80e3
"""Slew limit of the display [V/s]."""
ADDRESSES = {"drv2667": drv2667.ADDRESS, "bos1921": bos1921.ADDRESS}


@pytest.fixture(autouse=True)
def switching() -> Iterator[None]:
    """Let the threads of bus and targets take turns, as on two machines."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(before)


class Recorded(AmplifierTarget):
    """An amplifier whose output is kept."""

    def __init__(self) -> None:
        super().__init__(ReferenceAmplifier(AmplifierConfig(channels=2)))
        self.runs: list[PlayedRun] = []

    def read(self, size: int) -> bytes:
        """Answer, and keep what was put out meanwhile."""
        data = super().read(size)
        self.runs += self.amplifier.take_played()
        return data

    @property
    def state(self) -> State:
        """Present state of the amplifier, also when nobody communicates with it."""
        self.amplifier.run(self._now())
        return self.amplifier.state

    @property
    def volts(self) -> Floats:
        """Output so far (S, C) [V]."""
        codes = [run.codes for run in self.runs]
        return np.concatenate([np.zeros((1, 2)), *codes]) * CODE

    @property
    def sounds(self) -> bool:
        """Whether the amplifier is not at 0 V."""
        return bool(self.volts[-20:].any())


@pytest.fixture
def target() -> Recorded:
    return Recorded()


@pytest.fixture
def wire(target: Recorded) -> Iterator[I2cBus]:
    wire = I2cBus({ADDRESS: target})
    with CuseI2c(NUMBER, wire):
        yield wire


@pytest.mark.parametrize("options", ["", "&smbus=true"])
def test_it_plays_what_it_is_given(target: Recorded, wire: I2cBus, options: str) -> None:
    with linked(URL + options, 2, RATE) as bus:
        volts = play(bus)
        wait_for("it is at 0 V", lambda: not target.sounds)
        first = bus._session.peers[0].wire_end(0)
    begin = max(k for k, run in enumerate(target.runs) if run.position == first)
    played = np.concatenate([run.codes for run in target.runs[begin:]]) * CODE
    assert_is(played[: len(volts)], volts, bus.plan.sample_format)


def test_refused_transfers_are_counted_and_survived(target: Recorded, wire: I2cBus) -> None:
    with linked(REARMED, 2, RATE) as bus, playing(bus):
        wait_for("it plays", lambda: target.sounds)
        assert bus._wire is not None
        counters = bus._wire.counters
        before = counters.malformed
        wire.refusals.extend([errno.EREMOTEIO] * BURST)
        wait_for("all were refused", lambda: not wire.refusals)
        wait_for("it is counted", lambda: counters.malformed >= before + BURST)
        assert bus.status.link == "up"
        wait_for("it plays on", lambda: target.sounds)


def test_a_storm_of_refusals_ends_the_link_until_it_is_over(target: Recorded, wire: I2cBus) -> None:
    with linked(REARMED, 2, RATE) as bus, playing(bus):
        wait_for("it plays", lambda: target.sounds)
        wire.refusals.extend([errno.EREMOTEIO] * MANY)
        wait_for_link(bus, "down")
        assert "nothing acknowledges" in bus.status.detail
        wait_for("it is safe", lambda: target.state is State.SAFE)
        wire.refusals.clear()
        wait_for_link(bus, "up")
        wait_for("it plays on", lambda: target.sounds)
    assert (bus.counters.disconnects, bus.counters.reconnects) == (1, 1)


def test_a_bus_that_goes_away_and_comes_back(target: Recorded) -> None:
    wire = I2cBus({ADDRESS: target})
    with CuseI2c(NUMBER, wire):
        bus = opened(REARMED, 2, RATE)
    with bus:
        wait_for_link(bus, "down")
        assert bus.status.detail
        with CuseI2c(NUMBER, wire):
            wait_for_link(bus, "up")
            with playing(bus):
                wait_for("it plays", lambda: target.sounds)
            bus.close()


def test_an_estop(target: Recorded, wire: I2cBus) -> None:
    with linked(REARMED, 2, RATE) as bus:
        with playing(bus):
            wait_for("it plays", lambda: target.sounds)
            bus.estop()
        wait_for("it is told", lambda: target.amplifier.state is State.ESTOP)
        wait_for("it is at 0 V", lambda: not target.sounds)
        bus.clear()


def test_an_absent_target_is_one_line(wire: I2cBus) -> None:
    with pytest.raises(BusError, match="nothing acknowledges at address 0x33") as caught:
        open_bus(f"i2c:{NUMBER}?address={NOBODY:#x}", Rig(2))
    assert "\n" not in str(caught.value)
    with pytest.raises(BusError, match=r"no such bus; there are: .*/dev/i2c-7"):
        open_bus("i2c:99", Rig(2))


def test_the_bus_is_found(wire: I2cBus) -> None:
    assert f"i2c:{NUMBER}?address={ADDRESS:#x}" in [found.url for found in i2c_bus.find()]


Model = Drv2667Model | Bos1921Model


@pytest.fixture(params=["drv2667", "bos1921"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def chip(kind: str) -> Model:
    return Drv2667Model(MONOTONIC) if kind == "drv2667" else Bos1921Model(MONOTONIC)


@pytest.fixture
def chips(kind: str, chip: Model) -> Iterator[I2cBus]:
    wire = I2cBus({ADDRESSES[kind]: chip})
    with CuseI2c(NUMBER, wire):
        yield wire


def parts(kind: str) -> ChipBus:
    rig = Rig(1, slew=SLEW, limits=Limits(voltage=50.0))
    bus = open_bus(f"{kind}:{NUMBER}", rig, accept_unsafe_hold=True)
    assert isinstance(bus, ChipBus)
    return bus


def triangle(count: int) -> Floats:
    """Return samples (S, 1) that rise slowly, and fall [V]."""
    up = np.linspace(0, 40, count // 2)
    return np.concatenate([up, up[::-1]])[:, None]


def test_a_chip_plays_and_ends_at_0_volts(kind: str, chip: Model, chips: I2cBus) -> None:
    module = drv2667 if kind == "drv2667" else bos1921
    assert [found.url.partition("?")[0] for found in module.find()] == [f"{kind}:{NUMBER}"]
    volts = triangle(4000)
    with parts(kind) as bus:
        for _ in range(TRIES):
            chip.played.clear()
            bus.start()
            write(bus, volts)
            bus.stop()
            print(bus.counters.faults(), bus.status)
            if max(chip.played, default=0) >= volts.max() - LSB[kind]:
                break
    assert max(chip.played) >= volts.max() - LSB[kind]
    assert np.abs(np.diff(chip.played)).max() <= SLEW / 8000
    assert chip.waveform()[-1] == 0


def test_a_chip_that_refuses_for_a_while_ends_at_0_volts(
    kind: str, chip: Model, chips: I2cBus
) -> None:
    with parts(kind) as bus:
        with playing(bus):
            wait_for("it plays", lambda: bool(chip.played and chip.volts))
            chips.refusals.extend([errno.ENXIO, errno.EREMOTEIO] * 20)
            wait_for("all were refused", lambda: not chips.refusals)
            played = len(chip.played)
            wait_for("it plays on", lambda: bool(len(chip.played) > played + 100 and chip.volts))
        assert isinstance(bus.counters, ChipCounters)
        assert bus.counters.bus_errors >= 20
        bus.stop()
    assert chip.waveform()[-1] == 0


def test_a_chip_that_is_not_there_is_one_line(kind: str) -> None:
    with CuseI2c(NUMBER, I2cBus({})), pytest.raises(BusError, match="does not answer") as caught:
        parts(kind)
    assert "\n" not in str(caught.value)
