"""The bus that chips without firmware make, whichever they are."""

import atexit
from collections.abc import Callable, Sequence
from typing import Literal

from firmware_protocol.messages import FADE_MS, SampleFormat
from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DriveBlock, Wiring
from tactile.bus.board import MOST_CHANNELS, Board, config_of
from tactile.bus.chips import adapter
from tactile.bus.chips.adapter import I2cAdapter
from tactile.bus.chips.chip import BURST, Chip, ChipCounters
from tactile.bus.chips.occupancy import RATE, RATES
from tactile.bus.chips.pump import QUEUE, Pump, Runner
from tactile.errors import BusError, InputError

START_WAIT = 5.0
"""s for all chips to be set up and their clocks measured, 0.12 s each."""
END_WAIT = 1.0
"""s for what is queued and a fade, 30 ms, with retries."""


class ChipBus(Bus):
    """A chip for each channel, and a thread that writes to them.

    Parameters
    ----------
    wiring : what they drive
    chips : in the order of the channels
    i2c : the adapter, closed with the bus
    runner : who writes, and by which clock
    counters : that the chips count in

    Raises
    ------
    BusError
        Where a chip is not there.
    InputError
        Where 0 V cannot be reached within 20 ms of an e-stop.
    """

    def __init__(
        self, wiring: Wiring, chips: Sequence[Chip], i2c: I2cAdapter, runner: Runner,
        counters: ChipCounters,
    ) -> None:  # fmt: skip
        super().__init__(wiring, runner)
        self.counters: ChipCounters = counters
        self._i2c, self._runner = i2c, runner
        board = Board(config_of(wiring, wiring.channels, 1), SampleFormat.PCM16)
        checked_estop(wiring, chips[0].lead)
        for chip in chips:
            present(chip)
        self.pump = Pump(board, chips, counters, runner)
        atexit.register(self.close)
        runner.begin(self.pump.step)

    @property
    def status(self) -> BusStatus:
        """How it stands now."""
        link: Literal["up", "down"] = "down" if self.pump.phase == "down" else "up"
        state = self.state
        return BusStatus(state, link, self.pump.detail, state == "running" and link == "up")

    @property
    def ahead(self) -> float:
        """What waits in the chips [s]."""
        return self.pump.chips[0].lead / self.wiring.sample_rate

    def _start(self, position: int) -> None:
        with self._runner.lock:
            self.pump.start(position, round(self.wiring.sample_rate))
            self._runner.wait_for(self._started, START_WAIT)

    def _started(self) -> bool:
        return self.pump.phase in ("ready", "down") or self.state == "estopped"

    def _write(self, block: DriveBlock) -> None:
        pump = self.pump
        with self._runner.lock:
            if block.position < pump.position:
                self.counters.late_blocks += 1
                late = min(pump.position - block.position, len(block.volts))
                self.counters.dropped_samples += late
                block = DriveBlock(block.position + late, block.volts[late:])
            for k in range(0, len(block.volts), BURST):
                self._send(block.position + k, block.volts[k : k + BURST])

    def _send(self, position: int, volts: Floats) -> None:
        """Hand samples on as soon as there is room for them."""
        pump, end = self.pump, position + len(volts)

        def room() -> bool:
            return self.state != "running" or end - pump.position <= QUEUE

        while not room():
            pump.hurry()
            self._runner.wait_for(room, END_WAIT)
        if pump.phase == "down" or self.state != "running":
            self.counters.dropped_samples += len(volts)
        else:
            pump.send(position, volts)

    def _drop(self, position: int, count: int) -> None:
        self.counters.dropped_samples += count
        self._runner.sleep(count / self.wiring.sample_rate)

    def _stop(self) -> None:
        self._end("stop")

    def _abort(self) -> None:
        self._end("abort")

    def _estop(self) -> None:
        self._end("estop")

    def _end(self, order: Literal["stop", "abort", "estop"]) -> None:
        with self._runner.lock:
            self.pump.order(order)
            self._runner.wait_for(lambda: self.pump.settled, END_WAIT)

    def _clear(self) -> None:
        with self._runner.lock:
            if not self.pump.settled:
                raise BusError("clear: the chips are not at 0 V yet")
            self.pump.board.clear()

    def _close(self) -> None:
        """Let go; where a chip that holds its voltage cannot be reached `status` says so."""
        with self._runner.lock:
            self._runner.wait_for(lambda: self.pump.phase == "rest", END_WAIT)
        self._runner.end()
        self._i2c.close()
        atexit.unregister(self.close)


def present(chip: Chip) -> None:
    """See that a chip is there and is what it is taken for, with one more try.

    Raises
    ------
    BusError
        Where not, in one line.
    """
    try:
        chip.identify()
    except BusError:
        raise
    except OSError as error:
        raise BusError(
            f"{chip.name}: does not answer ({error.strerror or error}); is it wired to this bus "
            "and has it power?"
        ) from error


def opened(path: str, make: Callable[[I2cAdapter], ChipBus]) -> ChipBus:
    """Return the bus made on the adapter at a path, which is closed where that fails."""
    i2c = adapter.open_adapter(path)
    try:
        return make(i2c)
    except BaseException:
        i2c.close()
        raise


def checked_rate(scheme: str, sample_rate: float | None) -> float:
    """Return the chips' rate [Hz]; raises InputError where another is asked for."""
    if sample_rate not in (None, RATE):
        raise InputError(f"{scheme}: sample_rate {sample_rate:g} Hz: the chip plays {RATE:g} Hz")
    return RATE


def checked_voltage(scheme: str, voltage: float, peak: float) -> None:
    """Raise InputError where a display's voltage limit exceeds a chip's range [V]."""
    if voltage > peak:
        raise InputError(
            f"{scheme}: the display's limit {voltage:g} V exceeds the range ±{peak:g} V; lower "
            "limits.voltage_v or choose a wider range"
        )


def checked_estop(wiring: Wiring, lead: int) -> None:
    """Raise InputError where FIFO and ramp take longer than an e-stop may."""
    if wiring.channels > MOST_CHANNELS:
        raise InputError(f"{wiring.channels} channels: {MOST_CHANNELS} at most")
    ramp = wiring.voltage / wiring.slew
    total = (lead + 2) / RATES[0] + ramp
    if total > FADE_MS * 1e-3:
        raise InputError(
            f"slew limit {wiring.slew:g} V/s: takes {ramp * 1e3:.1f} ms from {wiring.voltage:g} V "
            f"to 0 V, after {lead} samples in the chip {total * 1e3:.1f} ms, {FADE_MS} ms are "
            "promised; lower the voltage limit"
        )


def step_codes(step: float, volts_per_code: float) -> int:
    """Return a slew limit [V a sample] in whole codes, one at least."""
    return max(1, int(step / volts_per_code))
