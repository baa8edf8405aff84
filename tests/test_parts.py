"""DRV2667 and BOS1921 play what is written and come to 0 V, on models and a virtual clock."""

import math

import numpy as np
import pytest
from chip_models import Drv2667Model
from parts_rig import (
    DRIFTS,
    ESTOP,
    KINDS,
    ROUNDING,
    STEP,
    FakeDisplay,
    Rig,
    assert_steps,
    level,
    link,
    rig,
    sine,
    without_lead,
)

from tactile.bus.base import DriveBlock
from tactile.bus.chips import bos1921, drv2667
from tactile.bus.chips.chip import codes_of, ramp_codes, stretch
from tactile.bus.chips.occupancy import RATES, Occupancy, measured_rates
from tactile.bus.chips.pump import share
from tactile.bus.registry import open_bus
from tactile.bus.wire_time import i2c_bits
from tactile.errors import BusStateError, InputError

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
    assert i2c_bits(33) == 308
    assert i2c_bits(1, 1) == 39
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
