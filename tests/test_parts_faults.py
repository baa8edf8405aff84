"""DRV2667 and BOS1921 on a bus that fails: all recovered, nothing jumps, all counted."""

import math
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from chip_models import Bos1921Model, Drv2667Model, ModelBus, Tca9548aModel
from parts_rig import KINDS, ROUNDING, STEP, Rig, assert_steps, level, rig, sine, without_lead
from repeating import often

from firmware_protocol.messages import State
from tactile.bus.base import DriveBlock
from tactile.bus.chips.adapter import Place
from tactile.bus.chips.drv2667 import Drv2667
from tactile.clock import ModelClock
from tactile.errors import BusStateError

# Faults


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


@pytest.mark.parametrize("kind", KINDS)
def test_where_a_chip_does_not_answer_it_misses_nothing_that_others_were_given(kind: str) -> None:
    """The first has its samples when the second is asked how many fit."""
    built = rig(kind, [0.005, -0.005])
    mux = built.wire.chips[0x70]
    assert isinstance(mux, Tca9548aModel)

    def fault(address: int, data: bytes) -> int | None:
        """Refuse the second chip's address for 12 ms of each 0.1 s."""
        second = mux.ports == 1 << 1 and address != 0x70
        return -1 if second and built.runner.now() % 0.1 < 12e-3 else None

    built.bus.start()
    built.wire.fault = fault
    volts = sine(24000)
    built.write(np.hstack([volts, volts]))
    built.wire.fault = lambda address, data: None
    built.runner.run(0.3)
    assert built.bus.counters.bus_errors > 20
    for chip in built.chips:
        assert_steps(chip.waveform(), STEP + built.lsb, chip.drops)
    built.bus.close()


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
    clock = ModelClock()
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


def test_a_drv2667_is_not_written_to_where_its_port_was_connected_too_late() -> None:
    """The host is held up for 0.1 s as it connects the port: meanwhile the chip goes to 0 V."""
    built = rig("drv2667", [0.0, 0.0])
    held_up = [0.5 + 0.3137 * k for k in range(20)]

    def hold_up(address: int, data: bytes) -> None:
        if address == 0x70 and held_up and built.runner.now() > held_up[0]:
            del held_up[0]
            built.runner.sleep(0.1)

    built.bus.start()
    built.wire.fault = hold_up
    volts = sine(80000)
    built.write(np.hstack([volts, volts]))
    built.runner.run(0.3)
    assert not held_up
    for chip in built.chips:
        assert chip.drops
        assert_steps(chip.waveform(), STEP + built.lsb, chip.drops)
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
@pytest.mark.parametrize("times", [10, pytest.param(often(1000), marks=pytest.mark.ci)])
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
@pytest.mark.parametrize("times", [10, pytest.param(often(1000), marks=pytest.mark.ci)])
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
    assert (status.state, status.link, status.playing) == ("running", "down", False)
    assert status.detail
    assert "\n" not in status.detail
    assert one.bus.counters.disconnects == 1
    assert one.bus.counters.dropped_samples > 3000
    one.wire.gone = False
    one.write(level(40, 8000), 4800)
    assert one.bus.status == replace(status, link="up", detail="", playing=True)
    assert one.bus.counters.reconnects == 1


def test_an_estop_while_one_waits_to_write_drops_the_rest(
    one: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    one.bus.start()
    one.write(level(40, 800))
    wait = one.runner.wait_for

    def press(done: Callable[[], bool], seconds: float) -> bool:
        monkeypatch.setattr(one.runner, "wait_for", wait)
        one.bus.estop()
        return wait(done, seconds)

    monkeypatch.setattr(one.runner, "wait_for", press)
    one.write(np.full((800, 1), 40.0), begin=800, size=400)
    assert one.bus.state == "estopped"
    assert one.bus.counters.dropped_samples > 600
    assert one.chip.volts == 0.0
    one.bus.clear()
    one.bus.start()
    assert (one.bus.status.state, one.bus.status.playing) == ("running", True)
    one.bus.stop()


def test_an_estop_while_chips_are_set_up_holds_and_start_says_so_at_once(
    one: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, wait = one.runner.now(), one.runner.wait_for

    def press(done: Callable[[], bool], seconds: float) -> bool:
        assert seconds == 5.0, "0.12 s to measure the clock of each of forty chips"
        monkeypatch.setattr(one.runner, "wait_for", wait)
        one.bus.estop()
        return wait(done, seconds)

    monkeypatch.setattr(one.runner, "wait_for", press)
    with pytest.raises(BusStateError, match="start: the bus was e-stopped meanwhile"):
        one.bus.start()
    assert one.runner.now() - begun < 5.0
    assert one.bus.state == "estopped"
    assert one.bus.pump.board.amplifier.state == State.ESTOP
    one.bus.clear()
    one.bus.start()
    one.write(level(40, 800))
    one.bus.stop()
    assert np.abs(one.chip.waveform()).max() > 30


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
