"""DRV2667 and BOS1921 against models of their registers, on a virtual clock."""

import errno
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chip_models import (
    Bos1921Model,
    ChipModel,
    Drv2667Model,
    ModelBus,
    Tca9548aModel,
    VirtualRunner,
    VirtualTime,
)
from numpy.typing import NDArray

from tactile.bus.base import Bus, DriveBlock, HostDeath, Wiring
from tactile.bus.parts import adapter, bos1921, drv2667
from tactile.bus.parts.adapter import Place, Target, transfer_bits
from tactile.bus.parts.bos1921 import Bos1921Bus
from tactile.bus.parts.chip import ChipCounters, codes_of, ramp_codes, stretch
from tactile.bus.parts.chip_bus import ChipBus
from tactile.bus.parts.drv2667 import Drv2667, Drv2667Bus
from tactile.bus.parts.occupancy import RATES, Occupancy, measured_rates
from tactile.bus.parts.pump import share
from tactile.bus.registry import find_devices, open_bus
from tactile.errors import BusError, BusStateError, InputError

Floats = NDArray[np.float64]

LSB = {"drv2667": 50 / 127, "bos1921": 3.6 * 31 / 2047}
"""V a code, at 100 V peak to peak and ±95 V."""
ROUNDING = 50 / 32767
"""V: the amplifier in memory rounds to 16 bits before."""
WIRING = Wiring(channels=1, sample_rate=8000.0, voltage=50.0, slew=80e3, fade=0.02)
"""Steps of 10 V a sample, 5 samples from the limit to 0 V."""
STEP = 10.0
KINDS = ("drv2667", "bos1921")
DRIFTS = (-0.01, 0.0, 0.01)
ESTOP = 20e-3
"""s."""


@dataclass
class Rig:
    """A bus on models."""

    kind: str
    runner: VirtualRunner
    wire: ModelBus
    chips: list[Drv2667Model | Bos1921Model]
    bus: ChipBus

    @property
    def chip(self) -> Drv2667Model | Bos1921Model:
        return self.chips[0]

    @property
    def lsb(self) -> float:
        return LSB[self.kind]

    def write(self, volts: Floats, begin: int = 0, size: int = 16) -> None:
        for k in range(0, len(volts), size):
            self.bus.write(DriveBlock(begin + k, volts[k : k + size]))


def rig(kind: str, drift: float | list[float] = 0.0, wiring: Wiring = WIRING) -> Rig:
    """Return a bus with a chip for each drift of its clock, those of DRV2667 behind a mux."""
    drifts = drift if isinstance(drift, list) else [drift]
    wiring = replace(wiring, channels=len(drifts))
    runner = VirtualRunner()
    ports = tuple(range(len(drifts))) if len(drifts) > 1 else ()
    mux = 0x70 if ports else None
    chips: list[Drv2667Model | Bos1921Model] = []
    models: dict[int | tuple[int, int], ChipModel] = {0x70: Tca9548aModel()} if ports else {}
    address = 0x59 if kind == "drv2667" else 0x44
    for k, wrong in enumerate(drifts):
        model = Drv2667Model if kind == "drv2667" else Bos1921Model
        chips.append(model(runner, 8000 * (1 + wrong)))
        models[(k, address) if ports else address] = chips[-1]
    wire = ModelBus(runner, models, 400e3 if kind == "drv2667" else 1e6)
    place = Place("test", (address,) * len(drifts), mux, ports, 400_000)
    bus: ChipBus
    if kind == "drv2667":
        bus = Drv2667Bus(wiring, place, wire, runner, wide=100)
    else:
        bus = Bos1921Bus(wiring, place, wire, runner)
    return Rig(kind, runner, wire, chips, bus)


def link(built: Rig) -> str:
    return built.bus.status.link


def sine(count: int, frequency: float = 97.0, peak: float = 40.0) -> Floats:
    """Return (count, 1) samples that begin at 0 V [V]."""
    return peak * np.sin(2 * np.pi * frequency * np.arange(count) / 8000)[:, None]


def level(volts: float, count: int) -> Floats:
    """Return (count, 1) samples that rise within the slew limit, then stay [V]."""
    rise = np.minimum(np.arange(count) * (0.9 * STEP), abs(volts))
    return np.asarray(rise[:, None] * math.copysign(1, volts), np.float64)


def without_lead(played: list[float]) -> Floats:
    """Return what was played from the first sample that is not 0 V."""
    line = np.asarray(played)
    return line[np.flatnonzero(line)[0] :]


def assert_steps(line: Floats, bound: float, drops: list[int] | None = None) -> None:
    """See that no sample steps further, but where the chip went to 0 V by itself."""
    steps = np.abs(np.diff(line, prepend=0.0))
    for at in drops or []:
        steps[max(at - 1, 0) : at + 1] = 0
    assert steps.max(initial=0.0) <= bound


@pytest.fixture(params=KINDS)
def one(request: pytest.FixtureRequest) -> Iterator[Rig]:
    built = rig(request.param)
    yield built
    built.bus.close()


# Pure parts


def test_codes_are_the_nearest_and_stay_within_the_most() -> None:
    assert codes_of(np.array([0.0, 0.2, -0.2, 49.9, -49.9, 60]), 50 / 127, 127) == [
        0, 1, -1, 127, -127, 127,
    ]  # fmt: skip


@pytest.mark.parametrize(("start", "step"), [(100, 7), (-100, 7), (3, 7), (0, 7), (-1, 1)])
def test_a_ramp_goes_straight_to_0_within_the_step(start: int, step: int) -> None:
    line = np.array([start, *ramp_codes(start, step)])
    assert line[-1] == 0
    assert np.all(np.abs(np.diff(line)) <= step)
    assert len(line) - 1 == max(1, math.ceil(abs(start) / step))


def test_stretching_keeps_the_ends_and_neither_voltage_nor_slew_grows() -> None:
    volts = np.array([1.0, 4, -2, 8])
    assert stretch(0.0, volts, 4) is volts
    for count in (1, 3, 5, 9):
        out = stretch(0.0, volts, count)
        assert len(out) == count
        assert out[-1] == volts[-1]
        assert np.abs(out).max() <= 8
        steps = np.abs(np.diff(out, prepend=0.0)) * count / 4
        assert steps.max() <= 10 + 1e-9


def test_the_share_of_another_chip_is_as_large_or_a_sixteenth_off() -> None:
    assert share(32, 32, 0) == 32
    assert share(32, 80, 0) == 35
    assert share(32, 0, 0) == 29
    assert share(32, 40, 8) == 32
    assert share(1, 0, 50) == 1


def test_the_bounds_of_a_fifo_hold_for_every_clock_within_the_tolerance() -> None:
    rng = np.random.default_rng(0)
    for rate in (RATES[0], 8000.0, RATES[1]):
        known, now = Occupancy(), 10.0
        known.begin(40, now, now)
        written, begun = 40, now
        for _ in range(20):
            now += float(rng.uniform(1e-3, 3e-3))
            true = written - math.floor((now - begun) * rate)
            assert known.least_fill(now) <= max(true, 0) <= known.most_fill(now)
            assert true > 0 or now >= known.dry_at
            count = max(0, 60 - known.most_fill(now))
            known.wrote(count, now)
            written += count


def test_a_rate_is_measured_within_what_the_times_leave_open() -> None:
    low, high = measured_rates(8081, (0.0, 1e-4), (1.0, 1.0003))
    assert low <= 8080 <= high
    assert high - low < 8


def test_what_a_chip_needs_of_the_bus_is_what_the_design_says() -> None:
    assert transfer_bits(33) == 308
    assert transfer_bits(1, 1) == 39
    assert drv2667.bits_per_second() / 400e3 == pytest.approx(0.217, abs=0.001)
    use = bos1921.bits_per_second() / 400e3
    assert int(0.8 / use) == 2
    assert int(0.8 / (use * 0.4)) == 5


# What is played


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_is_played_in_order_without_loss(kind: str, drift: float) -> None:
    """3 s: three times the FIFO of a DRV2667 is let run empty to measure the clock."""
    built = rig(kind, drift)
    volts = sine(24000)
    built.bus.start()
    built.write(volts)
    built.bus.stop()
    faults = built.bus.counters.faults()
    held = faults.pop("held_samples", 0)
    assert faults == {}
    assert held <= (40 if kind == "drv2667" else 0)
    played, given = without_lead(built.chip.played), volts[1:, 0]
    count = len(given) - 300
    off = np.abs(played[:count] - given[:count])
    assert off.max() <= built.lsb / 2 + ROUNDING
    assert_steps(built.chip.waveform(), STEP + built.lsb)
    built.bus.close()


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_played_at_once_and_evenly_whatever_the_clock(kind: str) -> None:
    """The output, holds included, is the written samples at the chip's rate: less than 1 % more."""
    built = rig(kind, 0.01)
    built.bus.start()
    built.write(sine(16000))
    out = built.chip.waveform()
    first = np.flatnonzero(out)[0]
    assert len(out) - first <= 1.01 * 16000
    built.bus.close()


def test_the_host_may_be_late_by_what_the_fifo_holds(one: Rig) -> None:
    rng = np.random.default_rng(1)
    one.runner.lateness = lambda: float(rng.exponential(0.3e-3)) if rng.random() < 0.9 else 2e-3
    volts = sine(16000)
    one.bus.start()
    one.write(volts)
    played, given = without_lead(one.chip.played), volts[1:, 0]
    count = min(len(played), len(given) - 300)
    assert np.abs(played[:count] - given[:count]).max() <= one.lsb / 2 + ROUNDING
    assert one.bus.counters.underruns == 0
    assert one.chip.drops == []


def test_write_waits_so_that_about_8_ms_and_the_fifo_are_queued(one: Rig) -> None:
    one.bus.start()
    volts = sine(8000)
    begun = one.runner.now()
    for k in range(0, 8000, 16):
        one.bus.write(DriveBlock(k, volts[k : k + 16]))
        assert len(one.chip.fifo) <= 80
    took = one.runner.now() - begun
    assert 1.0 - (64 + 80 + 16) / 8000 <= took <= 1.02


@pytest.mark.parametrize("kind", KINDS)
def test_chips_with_other_clocks_stay_together_by_stretching(kind: str) -> None:
    drifts = [0.0, 0.01, -0.01] if kind == "drv2667" else [0.004, -0.006]
    built = rig(kind, drifts)
    volts = np.repeat(sine(16000), len(drifts), axis=1)
    built.bus.start()
    built.write(volts)
    now = {len(chip.waveform()) for chip in built.chips}
    assert len(now) > 1
    tails = [chip.output[-1600:] for chip in built.chips]
    for k, tail in enumerate(tails):
        rate = 8000 * (1 + drifts[k])
        at = np.arange(-1600, 0) / rate
        basis = np.exp(2j * np.pi * 97 * at)
        phase = np.angle(np.vdot(basis, np.asarray(tail)))
        if k == 0:
            reference = phase
        assert abs(np.angle(np.exp(1j * (phase - reference)))) < 2 * np.pi * 97 * 4e-3, "4 ms"
    assert built.bus.counters.stretched_samples > 0
    assert built.bus.counters.underruns == 0
    for chip in built.chips:
        assert_steps(chip.waveform(), STEP * 1.07 + built.lsb, chip.drops)
        assert chip.drops == []
    built.bus.close()


# Ends


@pytest.mark.parametrize("kind", KINDS)
def test_stop_is_a_straight_ramp_of_the_fades_length_to_0_volts(kind: str) -> None:
    built = rig(kind)
    built.bus.start()
    built.write(level(40, 1600))
    built.bus.stop()
    assert built.bus.state == "idle"
    assert built.chip.volts == 0.0
    out = np.asarray(built.chip.played)
    last = np.flatnonzero(out > 40 - built.lsb)[-1]
    ramp = out[last : last + 162]
    line = 40 * (1 - np.arange(len(ramp)) / 160)
    assert np.abs(ramp - np.maximum(line, 0)).max() <= 1.5 * built.lsb
    built.bus.close()


@pytest.mark.parametrize("volts", [40.0, -50.0, 3.0])
def test_abort_goes_to_0_volts_at_the_slew_limit(one: Rig, volts: float) -> None:
    one.bus.start()
    one.write(level(volts, 800))
    one.bus.abort()
    out = np.asarray(one.chip.played)
    last = np.flatnonzero(np.abs(out) >= abs(volts) - one.lsb)[-1]
    rest = out[last + 1 :]
    assert np.flatnonzero(rest)[-1:].size == 0 or np.flatnonzero(rest)[-1] < math.ceil(
        abs(volts) / STEP
    )
    assert_steps(one.chip.waveform(), STEP + one.lsb)
    assert one.chip.volts == 0.0


@pytest.mark.ci
@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_estop_is_at_0_volts_within_20_ms_and_high_voltage_is_off(
    kind: str, drift: float
) -> None:
    for moment in range(0, 200, 7):
        built = rig(kind, drift)
        built.bus.start()
        built.write(level(50, 1600 + moment))
        asked = len(built.chip.waveform())
        built.bus.estop()
        out = built.chip.waveform()
        at = np.flatnonzero(out[asked:])
        assert (at[-1] + 1) / built.chip.rate <= ESTOP if len(at) else True
        assert built.chip.volts == 0.0
        assert_steps(out, STEP + built.lsb)
        if isinstance(built.chip, Drv2667Model):
            assert built.chip.control[2] & 0x40, "STANDBY"
        else:
            assert not built.chip.playing
        assert built.bus.state == "estopped"
        built.bus.close()


def test_an_estop_holds_until_it_is_cleared(one: Rig) -> None:
    one.bus.start()
    one.write(level(30, 400))
    one.bus.estop()
    for end in (one.bus.stop, one.bus.abort, one.bus.estop):
        end()
        assert one.bus.state == "estopped"
    with pytest.raises(BusStateError, match="clear it"):
        one.bus.start()
    one.bus.clear()
    one.bus.start()
    one.write(level(20, 400))
    assert max(one.chip.played[-80:]) == pytest.approx(20, abs=one.lsb)


def test_an_estop_while_nothing_can_be_written_switches_off_when_it_can(one: Rig) -> None:
    one.bus.start()
    one.write(level(50, 1600))
    one.wire.gone = True
    one.bus.estop()
    assert link(one) == "down"
    one.wire.gone = False
    one.runner.run(1.0)
    one.chip.run()
    assert one.chip.volts == 0.0
    assert link(one) == "up"
    assert one.bus.state == "estopped"


def test_an_exception_in_the_with_block_aborts_and_closes(one: Rig) -> None:
    def failing() -> None:
        with one.bus:
            one.bus.start()
            one.write(level(40, 800))
            raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        failing()
    assert one.bus.state == "closed"
    assert one.wire.closed
    assert one.chip.volts == 0.0
    assert_steps(one.chip.waveform(), STEP + one.lsb)


def test_stop_abort_and_close_may_come_at_any_time_and_twice(one: Rig) -> None:
    for end in (one.bus.stop, one.bus.abort):
        end()
        one.bus.start()
        end()
        end()
        one.bus.start()
        one.write(level(30, 100))
        end()
        assert one.chip.volts == 0.0
    one.bus.close()
    one.bus.close()
    with pytest.raises(BusStateError, match="closed"):
        one.bus.start()


# When the host dies


def test_when_the_host_dies_a_drv2667_goes_to_0_volts_by_its_timeout() -> None:
    built = rig("drv2667")
    built.bus.start()
    built.write(level(40, 1600))
    built.runner.end()
    died = len(built.chip.waveform())
    built.runner.sleep(0.1)
    out = built.chip.waveform()
    assert built.chip.volts == 0.0
    last = np.flatnonzero(out)[-1]
    assert (last + 1 - died) / 8000 <= 80 / 8000 + 20e-3 + 1e-3
    built.bus.close()


def test_when_the_host_dies_a_bos1921_holds_which_is_why_it_is_refused() -> None:
    built = rig("bos1921")
    built.bus.start()
    built.write(level(40, 1600))
    built.runner.end()
    built.runner.sleep(10.0)
    assert built.chip.waveform()[-1] == pytest.approx(40, abs=built.lsb)
    built.bus.close()
    with pytest.raises(InputError, match="holds its last voltage"):
        open_bus("bos1921:1", FakeDisplay())


def test_a_writer_that_stops_writing_makes_the_drive_fade(one: Rig) -> None:
    one.bus.start()
    one.write(level(40, 1600))
    one.runner.run(0.2)
    one.chip.run()
    assert one.chip.volts == 0.0
    assert one.bus.counters.underruns == 1
    assert one.chip.drops == []
    assert_steps(one.chip.waveform(), STEP + one.lsb)


# What goes wrong


class Faults:
    """Errors at random transfers."""

    def __init__(self, seed: int, chance: float, through: Callable[[int], int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._chance, self._through = chance, through
        self.on, self.count = True, 0

    def __call__(self, address: int, data: bytes) -> int | None:
        if not self.on or self._rng.random() >= self._chance:
            return None
        self.count += 1
        return self._through(int(self._rng.integers(0, len(data) + 1)))


def whole_words(through: int) -> int:
    """Return a number of bytes that ends after a sample of a BOS1921."""
    return 1 + (through - 1) // 2 * 2 if through > 1 else 0


def test_refused_addresses_are_tried_again_and_nothing_is_lost(one: Rig) -> None:
    one.wire.fault = faults = Faults(0, 0.2, lambda k: -1)
    volts = sine(16000)
    faults.on = False
    one.bus.start()
    faults.on = True
    one.write(volts)
    faults.on = False
    assert faults.count > 100
    assert one.bus.counters.bus_errors >= faults.count - 5
    assert one.bus.counters.disconnects == 0
    played, given = without_lead(one.chip.played), volts[1:, 0]
    count = min(len(played), len(given) - 300)
    assert np.abs(played[:count] - given[:count]).max() <= one.lsb / 2 + ROUNDING


def test_a_burst_refused_half_way_is_never_a_jump(one: Rig) -> None:
    one.wire.fault = faults = Faults(1, 0.02, whole_words)
    faults.on = False
    one.bus.start()
    faults.on = True
    one.write(sine(40000))
    faults.on = False
    assert faults.count > 20
    one.runner.run(0.3)
    assert one.bus.status.link == "up"
    assert_steps(one.chip.waveform(), STEP + one.lsb, one.chip.drops)
    if one.kind == "bos1921":
        assert one.chip.drops == []
        assert one.bus.counters.replayed_samples > 0


def test_a_bos1921_that_holds_nobody_knows_what_is_led_to_0_volts_from_the_middle() -> None:
    """The burst that failed half-way went from 0 V up by 20 V, and was all that it had."""
    built = rig("bos1921")
    built.bus.start()
    chip = built.bus.pump.chips[0]
    built.write(level(20, 320))
    built.runner.run(0.1)
    built.chip.run()
    assert built.chip.volts == 0.0
    built.wire.fault = lambda address, data: (
        15 if len(data) > 40 else (-1 if len(data) > 3 else None)
    )
    chip.pending = [40 * k for k in range(20)]
    with pytest.raises(OSError, match="Remote"):
        chip.flush()
    built.runner.sleep(0.1)
    built.wire.fault = lambda address, data: None
    with pytest.raises(OSError, match="ran empty after a burst that failed"):
        chip.flush()
    assert built.bus.counters.unknown_voltages == 1
    chip.wake()
    built.chip.run()
    assert built.chip.volts == 0.0
    assert_steps(built.chip.waveform(), max(STEP + built.lsb, 19 * 40 / 2 * built.lsb))
    built.bus.close()


def test_an_order_that_comes_after_an_estop_does_not_undo_it(one: Rig) -> None:
    one.bus.start()
    one.write(level(30, 400))
    pump = one.bus.pump
    pump.order("estop")
    pump.order("stop")
    one.runner.run(0.1)
    assert one.bus.pump.board.amplifier.counters.trips == 1
    assert one.chip.volts == 0.0


def test_a_multiplexer_that_lost_its_power_is_set_again() -> None:
    clock = VirtualTime()
    mux = Tca9548aModel()
    wire = ModelBus(clock, {0x70: mux, (3, 0x59): Drv2667Model(clock)}, None)
    (target,) = Place("test", (0x59,), 0x70, (3,), 400_000).targets(wire)
    target.write(bytes([2, 4]))
    assert mux.ports == 1 << 3
    before = wire.transfers
    assert target.read(bytes([2]), 1) == bytes([4])
    assert wire.transfers == before + 2, "the port is not set again for each transfer"
    mux.power_cycle()
    with pytest.raises(OSError, match="No such device"):
        target.read(bytes([2]), 1)
    assert target.read(bytes([2]), 1) == bytes([4])


def test_a_cut_drops_what_waits_and_begins_at_what_was_taken_last(one: Rig) -> None:
    chip = one.bus.pump.chips[0]
    chip.last, chip.step = 10, 4
    chip.pending = [20, 30]
    chip.cut()
    assert chip.pending == [6, 2, 0, 0]
    chip.silence()


def test_a_drv2667_that_may_have_timed_out_is_not_written_to() -> None:
    built = rig("drv2667")
    chip = built.bus.pump.chips[0]
    chip.wake()
    for held, lost in ((14e-3, False), (18e-3, True)):
        chip.warm()
        chip.ready()
        chip.pending = [50] * 32
        chip.flush()
        built.runner.sleep(32 / 8000 + held)
        chip.pending = [50] * 16 + [0] * 16
        if lost:
            with pytest.raises(OSError, match="ran empty for longer than its timeout"):
                chip.flush()
        else:
            chip.flush()
            built.runner.sleep(0.1)
    chip.wake()
    built.bus.close()


def test_a_drv2667_that_has_to_start_up_is_not_taken_to_play_at_once() -> None:
    built = rig("drv2667")
    chip = built.bus.pump.chips[0]
    assert isinstance(chip, Drv2667)
    chip.wake()
    built.runner.sleep(0.1)
    chip.pending = [1] * 32
    chip.flush()
    for _ in range(20):
        built.runner.sleep(0.2e-3)
        built.chip.run()
        assert chip.occupancy.most_fill(built.runner.now()) >= len(built.chip.fifo)
    built.bus.close()


@pytest.mark.ci
@pytest.mark.parametrize("times", [10, pytest.param(1000, marks=pytest.mark.ci)])
@pytest.mark.parametrize("power", [False, True], ids=["wire", "power"])
def test_many_disconnects_are_all_recovered_without_a_jump(
    one: Rig, power: bool, times: int
) -> None:
    rng = np.random.default_rng(2)
    threads = threading.active_count()
    one.bus.start()
    for k in range(times):
        volts = level(30 if k % 3 else -30, 16 * int(rng.integers(40, 60)))
        one.write(volts, one.bus.pump.position + 16, size=64)
        assert one.bus.status.link == "up", "after 80 ms at the latest"
        one.wire.gone = True
        if power:
            one.chip.power_cycle()
        one.runner.run(float(rng.uniform(1e-3, 60e-3)))
        one.wire.gone = False
    one.runner.run(2.0)
    assert one.bus.status.link == "up"
    assert one.bus.status.detail == ""
    assert one.bus.counters.disconnects == one.bus.counters.reconnects > times / 2
    assert_steps(one.chip.waveform(), STEP + one.lsb, one.chip.drops)
    assert threading.active_count() == threads
    before = len(one.chip.played)
    one.write(level(20, 1600), one.bus.pump.position + 16)
    assert max(one.chip.played[before:]) == pytest.approx(20, abs=one.lsb)
    one.bus.stop()
    assert one.chip.volts == 0.0


@pytest.mark.ci
@pytest.mark.parametrize("times", [10, pytest.param(1000, marks=pytest.mark.ci)])
def test_many_error_bursts_are_all_recovered_without_a_jump(one: Rig, times: int) -> None:
    rng = np.random.default_rng(3)
    one.wire.fault = faults = Faults(4, 0.9, lambda k: -1)
    faults.on = False
    one.bus.start()
    hit = 0
    for _ in range(times):
        before, faults.on = faults.count, True
        volts = sine(16 * int(rng.integers(4, 8)), peak=45)
        one.write(volts, one.bus.pump.position + 16, size=64)
        faults.on = False
        hit += faults.count > before
        one.write(sine(16 * int(rng.integers(20, 40)), peak=45), one.bus.pump.sent, size=64)
    one.runner.run(2.0)
    assert hit >= 0.9 * times, "a burst may fall between two transfers"
    assert one.bus.status.link == "up"
    assert_steps(one.chip.waveform(), STEP + one.lsb, one.chip.drops)
    one.bus.stop()
    assert one.chip.volts == 0.0


def test_while_the_link_is_down_status_says_so_and_write_neither_raises_nor_blocks(
    one: Rig,
) -> None:
    one.bus.start()
    one.write(level(40, 800))
    one.wire.gone = True
    begun = one.runner.now()
    one.write(level(40, 4000), 800)
    assert 0.4 <= one.runner.now() - begun <= 0.6
    status = one.bus.status
    assert (status.state, status.link) == ("running", "down")
    assert status.detail
    assert "\n" not in status.detail
    assert one.bus.counters.disconnects == 1
    assert one.bus.counters.dropped_samples > 3000
    one.wire.gone = False
    one.write(level(40, 8000), 4800)
    assert one.bus.status == replace(status, link="up", detail="")
    assert one.bus.counters.reconnects == 1


def test_a_bos1921_that_was_held_is_led_to_0_volts_first() -> None:
    built = rig("bos1921")
    built.bus.start()
    built.write(level(45, 1600))
    built.wire.gone = True
    built.runner.run(0.2)
    assert built.chip.waveform()[-1] == pytest.approx(45, abs=built.lsb)
    built.bus.stop()
    assert built.bus.status.link == "down"
    built.wire.gone = False
    built.runner.run(1.0)
    assert built.chip.volts == 0.0
    assert isinstance(built.chip, Bos1921Model)
    assert not built.chip.playing
    assert_steps(built.chip.waveform(), STEP + built.lsb, built.chip.drops)
    built.bus.close()


def test_a_chip_that_reports_an_error_is_set_up_again() -> None:
    built = rig("bos1921")
    built.bus.start()
    built.write(sine(1600))
    assert isinstance(built.chip, Bos1921Model)
    built.chip.error = True
    built.runner.run(0.05)
    assert built.bus.status.link == "down"
    assert "OVV" in built.bus.status.detail or "error" in built.bus.status.detail
    built.bus.close()


# Positions and counters, as of every bus


def test_a_resend_is_dropped_and_a_gap_is_bridged(one: Rig) -> None:
    one.bus.start()
    one.write(level(30, 320))
    one.write(level(30, 320))
    one.bus.write(DriveBlock(330, np.full((320, 1), 30.0)))
    one.bus.stop()
    assert one.bus.counters.repeated_samples == 320
    assert one.bus.counters.lost_samples == 10
    assert one.bus.counters.underruns == 0


def test_volts_over_the_limit_and_not_finite_are_counted_and_never_put_out(one: Rig) -> None:
    volts = level(30, 800)
    volts[500], volts[600] = 1e9, math.nan
    one.bus.start()
    one.write(volts)
    one.bus.stop()
    assert np.abs(one.chip.waveform()).max() <= 50 + one.lsb / 2
    assert one.bus.counters.clipped_samples == 1
    assert one.bus.counters.invalid_samples == 1


def test_what_comes_late_is_counted_and_dropped(one: Rig) -> None:
    one.bus.start()
    one.write(level(30, 640))
    one.runner.run(0.1)
    one.write(level(30, 1600), 640)
    assert one.bus.counters.late_blocks > 0
    assert one.bus.counters.dropped_samples > 100
    assert one.bus.counters.underruns == 1


def test_it_starts_again_after_each_end_and_the_clock_is_measured_once(one: Rig) -> None:
    took = []
    for _ in range(3):
        begun = one.runner.now()
        one.bus.start()
        took.append(one.runner.now() - begun)
        one.write(level(20, 400))
        assert max(one.chip.played[-80:]) == pytest.approx(20, abs=one.lsb)
        one.bus.stop()
        assert one.chip.volts == 0.0
    assert took[1] < 0.05
    assert one.bus.counters.underruns == 0


# Opening


@dataclass
class FakeLimits:
    voltage: float = 50.0
    fade: float = 0.02


@dataclass
class FakeDisplay:
    channels: int = 1
    slew: float = 80e3
    limits: Any = None
    amplifier: Any = None

    def __post_init__(self) -> None:
        self.limits = self.limits or FakeLimits()


@pytest.fixture
def shelf(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[int | tuple[int, int], ChipModel]]:
    """Give the chips of /dev/i2c-1, by the wall clock."""
    clock = VirtualTime()
    monkeypatch.setattr(clock, "now", time.monotonic)
    monkeypatch.setattr(clock, "sleep", lambda seconds: None)
    chips: dict[int | tuple[int, int], ChipModel] = {}
    monkeypatch.setattr(
        adapter, "open_adapter", lambda path: ModelBus(clock, chips, None), raising=True
    )
    monkeypatch.setattr(chips_of, "clock", clock, raising=False)
    yield chips
    assert not [t for t in threading.enumerate() if t.name == "tactile chips"]


class chips_of:  # noqa: N801
    """Where the fixture leaves its clock."""

    clock: VirtualTime


@pytest.mark.parametrize("url", ["drv2667:1", "drv2667:/dev/i2c-1", "bos1921:1"])
def test_a_thread_plays_what_is_written_and_is_gone_after_close(
    url: str, shelf: dict[int | tuple[int, int], ChipModel]
) -> None:
    chip = (Drv2667Model if "drv" in url else Bos1921Model)(chips_of.clock)
    shelf[0x59 if "drv" in url else 0x44] = chip
    with open_bus(url, FakeDisplay(), accept_unsafe_hold=True) as bus:
        bus.start()
        volts = level(30, 1600)
        for k in range(0, len(volts), 16):
            bus.write(DriveBlock(k, volts[k : k + 16]))
        bus.stop()
        assert bus.counters.samples == 1600
    assert chip.waveform()[-1] == 0.0
    assert chip.played, "how much depends on how busy this machine is"
    assert max(chip.played) <= 30.5


@pytest.mark.parametrize(
    ("url", "display", "message"),
    [
        ("drv2667:", FakeDisplay(), "path '': give the number"),
        ("drv2667:/dev/ttyS0", FakeDisplay(), "give the number of an I2C bus or /dev/i2c-N"),
        ("drv2667:1?adress=0x59", FakeDisplay(), "unknown option 'adress'; .*'address'"),
        ("drv2667:1?address=0x60", FakeDisplay(), "must be from 0x59 to 0x59"),
        ("drv2667:1?range=75", FakeDisplay(), "must be one of 50, 100, 150, 200"),
        ("drv2667:1?range=50", FakeDisplay(), "limit 50 V exceeds the range ±25 V"),
        ("drv2667:1", FakeDisplay(limits=FakeLimits(120.0)), "120 V exceeds the range ±100 V"),
        ("drv2667:1?mux=0x60&ports=0", FakeDisplay(), "must be from 0x70 to 0x77"),
        ("drv2667:1?mux=0x70&ports=0,8", FakeDisplay(), "must be from 0 to 7"),
        ("drv2667:1?mux=0x70&ports=0,0", FakeDisplay(2), "one comes twice"),
        ("drv2667:1?ports=0", FakeDisplay(), "of which mux"),
        ("drv2667:1", FakeDisplay(2), "1 chips for 2 channels.*ports="),
        ("bos1921:1?address=0x44,0x45", FakeDisplay(), "2 chips for 1 channels.*address="),
        ("drv2667:1?clock_hz=1000000", FakeDisplay(), "exceeds what the chip takes, 400000"),
        ("drv2667:1?mux=0x70&ports=0,1,2,3", FakeDisplay(4), "need 92% .*23% each.* 3 chips fit"),
        ("bos1921:1?address=0x44,0x45,0x46", FakeDisplay(3), "need 118% .*39% each.* 2 chips fit"),
        ("bos1921:1?range=50", FakeDisplay(), "must be one of 95, 13"),
        ("bos1921:1?range=13", FakeDisplay(), "exceeds the range ±13.28 V"),
        ("bos1921:1?parcap=x", FakeDisplay(), "parcap = 'x'"),
        ("drv2667:1", FakeDisplay(slew=4e3), "slew limit 4000 V/s.*20 ms are promised"),
        ("drv2667:1", FakeDisplay(slew=5e3), "after 80 samples in the chip"),
    ],
)
def test_what_cannot_be_is_one_line(
    url: str,
    display: FakeDisplay,
    message: str,
    shelf: dict[int | tuple[int, int], ChipModel],
) -> None:
    with pytest.raises(InputError, match=message) as found:
        open_bus(url, display, accept_unsafe_hold=True)
    assert "\n" not in str(found.value)


def test_only_8_khz_is_played(shelf: dict[int | tuple[int, int], ChipModel]) -> None:
    with pytest.raises(InputError, match="drv2667: sample_rate 4000 Hz: the chip plays 8000 Hz"):
        open_bus("drv2667:1", FakeDisplay(), sample_rate=4000.0)


def test_a_chip_that_does_not_answer_or_is_another_is_one_line(
    shelf: dict[int | tuple[int, int], ChipModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    wires: list[ModelBus] = []

    def wired(path: str) -> ModelBus:
        wires.append(ModelBus(chips_of.clock, shelf, None))
        return wires[-1]

    monkeypatch.setattr(adapter, "open_adapter", wired)
    for url in ("drv2667:1", "bos1921:1"):
        with pytest.raises(BusError, match=r"does not answer .*is it wired") as found:
            open_bus(url, FakeDisplay(), accept_unsafe_hold=True)
        assert "\n" not in str(found.value)
    assert all(wire.closed for wire in wires)
    shelf[0x59] = Drv2667Model(chips_of.clock, identity=5)
    with pytest.raises(BusError, match="DRV2667 at 0x59: there is DRV2665, not a DRV2667"):
        open_bus("drv2667:1", FakeDisplay())


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            FileNotFoundError(2, "No such file"),
            "there is no such I2C adapter; is the module i2c-dev loaded",
        ),
        (PermissionError(13, "Permission denied"), "permission denied; be in the group i2c"),
        (OSError(16, "Device or resource busy"), "Device or resource busy"),
    ],
)
def test_an_adapter_that_cannot_be_opened_is_one_line(
    monkeypatch: pytest.MonkeyPatch, error: OSError, message: str
) -> None:
    smbus2 = pytest.importorskip("smbus2")

    def refuse(path: str) -> None:
        raise error

    monkeypatch.setattr(smbus2, "SMBus", refuse)
    with pytest.raises(BusError, match=f"/dev/i2c-7: {message}") as found:
        open_bus("drv2667:7", FakeDisplay())
    assert "\n" not in str(found.value)


def test_without_smbus2_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "smbus2", None)
    with pytest.raises(BusError, match="pip install smbus2"):
        open_bus("drv2667:7", FakeDisplay())


@pytest.mark.parametrize(
    ("voltage", "wide"), [(10, 50), (25, 50), (25.1, 100), (75, 150), (99, 200)]
)
def test_the_smallest_range_that_covers_the_limit_is_chosen(voltage: float, wide: int) -> None:
    assert drv2667.chosen_range(voltage, None) == wide


@pytest.mark.parametrize(("kind", "death"), [(Drv2667Bus, "zero"), (Bos1921Bus, "holds")])
def test_what_host_death_does_is_declared(kind: type[Bus], death: HostDeath) -> None:
    assert kind.on_host_death == death


def test_chips_are_found_by_reading_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualTime()
    wire = ModelBus(clock, {0x59: Drv2667Model(clock), 0x45: Bos1921Model(clock)}, None)
    monkeypatch.setattr(adapter, "open_adapter", lambda path: wire)
    monkeypatch.setattr(Path, "glob", lambda self, pattern: [Path("/dev/i2c-3")])
    urls = [found.url for found in (*drv2667.find(), *bos1921.find())]
    assert urls == ["drv2667:3", "bos1921:3?address=0x45"]
    assert wire.closed


def test_without_an_adapter_nothing_is_found_silently(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Path, "glob", lambda self, pattern: [])
    assert [f for f in find_devices() if f.url.startswith(("drv", "bos"))] == []
    assert capfd.readouterr() == ("", "")


def test_a_refusal_of_a_full_fifo_is_none_that_the_driver_ever_meets() -> None:
    """The model refuses the 101st byte, so that the tests above would see one written."""
    clock = VirtualTime()
    chip = Drv2667Model(clock)
    chip.write(bytes([2, 4]))
    with pytest.raises(OSError, match="Remote") as found:
        chip.write(bytes([0x0B]) + bytes(101))
    assert found.value.errno == errno.EREMOTEIO
    chip._pointer = 0
    assert chip.read(1)[0] & 1
    single = Drv2667(
        Target(ModelBus(clock, {0x59: chip}, None), 0x59), clock, ChipCounters(), wide=50, step=1.0
    )
    single.identify()
