"""Bus of chips without firmware, common to all kinds of chips."""

import atexit
from collections.abc import Callable
from typing import Any, Literal

from firmware_protocol.messages import FADE_MS, SampleFormat
from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DisplayLike, DriveBlock, Wiring
from tactile.bus.board import MOST_CHANNELS, Board, config_of
from tactile.bus.chips import adapter
from tactile.bus.chips.adapter import ChipTarget, Place
from tactile.bus.chips.chip import BURST, Chip, ChipCounters
from tactile.bus.chips.occupancy import RATE, RATES
from tactile.bus.chips.pump import QUEUE, Pump, Runner
from tactile.bus.linux_i2c import I2cAdapter
from tactile.bus.registry import Address
from tactile.bus.wire_time import i2c_bits
from tactile.clock import Clock
from tactile.errors import BusError, InputError

START_WAIT = 5.0
"""Time limit for setting up all chips and measuring their clocks, 0.12 s each [s]."""
END_WAIT = 1.0
"""Time limit for what is queued and a fade, 30 ms, with retries [s]."""


class ChipBus(Bus):
    """Bus with a chip for each channel, and a thread that writes to them.

    Parameters
    ----------
    wiring : Wiring
        What the chips drive.
    place : Place
        Location of the chips.
    i2c : I2cAdapter
        The open adapter, which is closed together with the bus.
    runner : Runner
        Thread that writes to the chips, and its clock.
    make_chip : callable
        Function that makes a chip from its target, its clock and its counters.

    Attributes
    ----------
    pump : Pump
        Amplifier in memory and its playback on the chips.

    Raises
    ------
    BusError
        If a chip is missing.
    InputError
        If 0 V cannot be reached within 20 ms of an e-stop.
    """

    def __init__(
        self, wiring: Wiring, place: Place, i2c: I2cAdapter, runner: Runner,
        make_chip: Callable[[ChipTarget, Clock, ChipCounters], Chip],
    ) -> None:  # fmt: skip
        super().__init__(wiring, runner)
        self.counters: ChipCounters = ChipCounters()
        chips = [make_chip(target, runner, self.counters) for target in place.targets(i2c)]
        self._i2c, self._runner = i2c, runner
        board = Board(config_of(wiring, wiring.channels, 1), SampleFormat.PCM16)
        check_estop(wiring, chips[0].lead)
        for chip in chips:
            identify(chip)
        self.pump = Pump(board, chips, self.counters, runner)
        atexit.register(self.close)
        runner.begin(self.pump.step)

    @property
    def status(self) -> BusStatus:
        """Present state of the bus."""
        link: Literal["up", "down"] = "down" if self.pump.phase == "down" else "up"
        state = self.state
        pump, playing = self.pump, state == "running" and link == "up"
        return BusStatus(state, link, pump.detail, playing, pump.last_fault)

    @property
    def ahead(self) -> float:
        """Duration of the samples that wait in a chip [s]."""
        return self.pump.chips[0].lead / self.wiring.sample_rate

    def _start(self, position: int) -> None:
        with self._runner.lock:
            self.pump.start(position, round(self.wiring.sample_rate))
            self._runner.wait_for(self._is_started, START_WAIT)

    def _is_started(self) -> bool:
        """Return whether the chips are set up, or will not be."""
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
        """Pass samples to the amplifier as soon as there is room for them."""
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
        self._end_playback("stop")

    def _abort(self) -> None:
        self._end_playback("abort")

    def _estop(self) -> None:
        self._end_playback("estop")

    def _end_playback(self, order: Literal["stop", "abort", "estop"]) -> None:
        """Order an end of playback, and wait for it."""
        with self._runner.lock:
            self.pump.order(order)
            self._runner.wait_for(lambda: self.pump.at_rest, END_WAIT)

    def _clear(self) -> None:
        with self._runner.lock:
            if not self.pump.at_rest:
                raise BusError("clear: the chips are not at 0 V yet")
            self.pump.board.clear()

    def _close(self) -> None:
        """Release the bus; `status` tells if a chip that holds its voltage cannot be reached."""
        with self._runner.lock:
            self._runner.wait_for(lambda: self.pump.phase == "rest", END_WAIT)
        self._runner.end()
        self._i2c.close()
        atexit.unregister(self.close)


def identify(chip: Chip) -> None:
    """Check that a chip is present and of the expected kind.

    Parameters
    ----------
    chip : Chip
        Chip to identify.

    Raises
    ------
    BusError
        If it does not answer or is another chip.
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


def open_chips(
    address: Address[Any],
    display: DisplayLike,
    sample_rate: float | None,
    kind: type[Chip],
    bits: float,
    make: Callable[[Wiring, Place, I2cAdapter], ChipBus],
) -> ChipBus:
    """Open a bus of chips for a display; the adapter is closed if that fails.

    Parameters
    ----------
    address : Address
        Address with `ChipOptions`.
    display : DisplayLike
        Display that the chips drive.
    sample_rate : float or None
        Requested sample rate [Hz]; None for that of the chips.
    kind : type of Chip
        Kind of the chips.
    bits : float
        Bits that each chip needs on the bus, without those of a multiplexer [1/s].
    make : callable
        Function that makes the bus on the open adapter.

    Returns
    -------
    ChipBus
        The open bus.

    Raises
    ------
    InputError
        If the chips cannot play the rate, cannot do what the display needs, or have not enough of
        the bus.
    BusError
        If the adapter cannot be opened, or a chip is missing.
    """
    scheme = address.scheme
    if sample_rate not in (None, RATE):
        raise InputError(f"{scheme}: sample_rate {sample_rate:g} Hz: the chip plays {RATE:g} Hz")
    wiring = Wiring.of(display, RATE)
    check_estop(wiring, kind.lead)
    place = Place.of(address, kind.default_address)
    extra = i2c_bits(1) * RATE / BURST if len(place.ports) > 1 else 0.0
    place.check(scheme, display.channels, bits + extra, kind.fastest)
    i2c = adapter.open_adapter(place.path)
    try:
        return make(wiring, place, i2c)
    except BaseException:
        i2c.close()
        raise


def check_voltage(scheme: str, voltage: float, peak: float) -> None:
    """Check that a voltage limit is within the range of a chip.

    Parameters
    ----------
    scheme : str
        Scheme of the URL, for messages.
    voltage : float
        Voltage limit of the display [V].
    peak : float
        Largest voltage of the range [V].

    Raises
    ------
    InputError
        If the limit exceeds the range.
    """
    if voltage > peak:
        raise InputError(
            f"{scheme}: the display's limit {voltage:g} V exceeds the range ±{peak:g} V; lower "
            "limits.voltage_v or choose a wider range"
        )


def check_estop(wiring: Wiring, lead: int) -> None:
    """Check that an e-stop is at 0 V in time, after the samples in the FIFO and the ramp.

    Parameters
    ----------
    wiring : Wiring
        What the chips drive.
    lead : int
        Largest number of samples in the FIFO.

    Raises
    ------
    InputError
        If it takes longer than 20 ms, or there are more channels than an amplifier can have.
    """
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
