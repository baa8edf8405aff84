"""``bos1921:1``, displays driven by Boréas BOS1921 chips, one for each channel.

``bos1921:1?address=0x44,0x45`` uses chips on bus 1; ``mux=0x70&ports=0,1`` uses chips behind a
TCA9548A. ``range=95`` selects ±95 V and ``range=13`` ±13.28 V. ``clock_hz=`` is the clock of the
bus, at most 1 MHz. ``parcap=`` and ``sup_rise=`` are the values of these registers, which depend on
the board; otherwise they keep their reset values.

A chip plays 12-bit codes from a FIFO of 1024 samples, of which 80 are used, at its own 8 kHz. It
reports the free space, which is read at every second burst; between two readings the uncertainty is
0.2 samples. The host follows the first chip: `write` waits for it.

**An empty FIFO holds the last voltage**: ``on_host_death`` is "holds", which is refused unless it
is accepted explicitly. Playing always ends with a ramp to 0 V that the chip is verified to have
played before the output is switched off. After an error the chip is asked whether it has kept its
setup. If so, it still holds the sample that it took last, and is led to 0 V from there. An e-stop
appends the ramp to the contents of the FIFO, which take 10.3 ms at most. If that cannot be written
in time, the chip is reset, which causes a step.

Nothing in this module was checked against the data sheet. It is based on published drivers that
quote the data sheet. The following is also uncertain:

- the meaning of a code in the low range (13.28 V at 2047 is assumed; in the high range a code
  stands for code × 3.6 × 31 / 2047);
- the tolerance of the clock (±2.5 % is assumed);
- that a reset switches the output off;
- that a plain read of an unused chip returns CHIP_ID, by which `find` recognizes it;
- what a chip took of a burst that failed midway, if its FIFO is empty when it is asked: it is then
  led to 0 V from the middle of the voltages that it may hold.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated, Literal

from msgspec import Meta

from tactile.bus.base import DisplayLike, Wiring
from tactile.bus.chips import adapter
from tactile.bus.chips.adapter import ChipOptions, ChipTarget, Place
from tactile.bus.chips.chip import (
    BURST,
    Chip,
    ChipCounters,
    LostError,
    ramp_codes,
    was_not_acknowledged,
)
from tactile.bus.chips.chip_bus import ChipBus, check_voltage, open_chips
from tactile.bus.chips.occupancy import RATE, RATES
from tactile.bus.chips.pump import Runner, ThreadRunner
from tactile.bus.linux_i2c import I2cAdapter
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.bus.wire_time import i2c_bits
from tactile.clock import Clock
from tactile.errors import BusError

ADDRESS = 0x44
"""Default I2C address of the chip."""
ADDRESSES = range(0x40, 0x50)
"""I2C addresses that the chip can have."""
FASTEST = 1_000_000
"""Highest clock of the I2C bus [Hz]."""
REFERENCE, CONFIG, PARCAP, SUP_RISE, COMM = 0x00, 0x05, 0x06, 0x07, 0x0B
"""Registers that are written."""
IC_STATUS, FIFO_STATE, CHIP_ID = 0x10, 0x11, 0x1E
"""Registers that are read, by way of COMM."""
IDENTITY = 0x781
"""Value of bits 11:0 of CHIP_ID."""
RESET = 0x0040
"""Value of CONFIG that resets the chip."""
PLAY = 0x0217
"""Value of CONFIG while playing: PLAY_MODE 10:9 = FIFO, OE (bit 4), 8 kS/s (2:0 = 7)."""
LOW_RANGE = 0x0800
"""Bit GAIND of CONFIG, which selects ±13.28 V."""
ERROR, EMPTY, SPACE = 1 << 12, 1 << 10, 0x3FF
"""Masks of FIFO_STATE; a SPACE of 0 together with EMPTY means all 1024."""
DEPTH = 1024
"""Length of the FIFO [samples]."""
FAULTS = {7: "OVV", 6: "OCT", 5: "MXPWR", 4: "IDAC", 3: "UVLO", 2: "SC"}
"""Names of faults by their bit of IC_STATUS."""
SCALES = {"95": 3.6 * 31 / 2047, "13": 13.28 / 2047}
"""Voltage of one code, by range [V]; 54.5 mV in the high range."""
PEAKS = {"95": 95.0, "13": 13.28}
"""Largest voltage, by range [V]."""
SETTLE = 1e-3
"""Waiting time after a reset [s]."""
HIGH = 80
"""Largest number of samples in the FIFO, 10 ms, for which an e-stop waits."""
READ_EVERY = 2
"""Number of bursts between two readings of FIFO_STATE."""
PATIENCE = 10e-3
"""Longest time for which a chip may hold its voltage because the link fails [s].

The chip is led to 0 V afterwards.
"""
POLL = 0.5e-3
"""Interval between readings while a FIFO is to run empty [s]."""
POLLS = 400
"""Largest number of readings until a FIFO is empty."""


def bits_per_second() -> float:
    """Return the bits that a chip needs on the bus: a burst every 4 ms and FIFO_STATE every 8 ms.

    These take 596 and 68 bits, 39.4 % of a 400 kHz bus.

    Returns
    -------
    float
        Bit rate [1/s].
    """
    state = i2c_bits(3, 2)
    return (i2c_bits(1 + 2 * BURST) + state / READ_EVERY) * RATE / BURST


class Bos1921(Chip):
    """One BOS1921.

    Parameters
    ----------
    target, clock, counters
        Parameters of `Chip`.
    wide : str
        Output range, "95" or "13".
    step : float
        Largest change of the voltage in a sample [V].
    board : dict of int to int
        Values of further registers, which depend on the board, by register number.
    """

    kind = "BOS1921"
    default_address = ADDRESS
    fastest = FASTEST
    lead = HIGH

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters,
        *, wide: str, step: float, board: dict[int, int],
    ) -> None:  # fmt: skip
        scale = SCALES[wide]
        super().__init__(
            target, clock, counters, volts_per_code=scale,
            most=int(PEAKS[wide] / scale), step=step,
        )  # fmt: skip
        self._config = PLAY | (LOW_RANGE if wide == "13" else 0)
        self._board = board
        self._is_set_up = self._lost = False
        self._attempted = 0
        self._note_empty()

    def _note_empty(self) -> None:
        """Note that the FIFO is empty now."""
        now = self.clock.now()
        self._fill, self._times, self._bursts = (0, 0), (now, now), 0

    def _read_register(self, register: int) -> int:
        return int.from_bytes(self._read(bytes([COMM, 0, register]), 2), "big")

    def _write_register(self, register: int, value: int) -> None:
        self._write(bytes([register]) + value.to_bytes(2, "big"))

    def identify(self) -> None:
        """Check that the chip is a BOS1921.

        A 0 written to REFERENCE wakes the chip; a chip that plays takes it as 0 V.

        Raises
        ------
        BusError
            If it is another chip.
        OSError
            If it does not answer.
        """
        if not self._is_set_up:
            self._write_register(REFERENCE, 0)
        identity = self._read_register(CHIP_ID) & 0xFFF
        if identity != IDENTITY:
            raise BusError(f"{self.name}: CHIP_ID is 0x{identity:03x}, not a BOS1921's 0x781")

    def wake(self) -> None:
        """Lead the chip to 0 V if it has kept its setup, otherwise set it up.

        Raises
        ------
        BusError
            If it is another chip, does not accept its setup, or its FIFO does not run empty.
        OSError
            If it does not answer, or reports an error.
        """
        if self._is_set_up and self._read_register(CONFIG) == self._config:
            self._lead_to_zero()
        else:
            self._is_set_up = False
            self.identify()
            self._write_register(CONFIG, RESET)
            self.clock.sleep(SETTLE)
            self.identify()
            for register, value in self._board.items():
                self._write_register(register, value)
            self._write_register(CONFIG, self._config)
            if self._read_register(CONFIG) != self._config:
                raise BusError(f"{self.name}: CONFIG holds 0x{self._read_register(CONFIG):04x}")
            self._is_set_up = True
        self.silence()
        self._lost = False
        self._note_empty()

    def _lead_to_zero(self) -> None:
        """Write the ramp from the sample that was taken last, and wait until it has been played."""
        if self.unsure:
            self._find_taken()
        ramp = ramp_codes(self.last, self.step) if self.last else [0]
        for k in range(0, len(ramp), BURST):
            self.pending = ramp[k : k + BURST]
            self._burst(self.pending[:])
        for _ in range(POLLS):
            if self._state() == 0:
                return
            self.clock.sleep(POLL)
        raise BusError(f"{self.name}: its FIFO does not run empty")

    def _state(self) -> int:
        """Read the fill of the FIFO and store it as both bounds."""
        before = self.clock.now()
        state = self._read_register(FIFO_STATE)
        if state & ERROR:
            raise LostError(f"{self.name}: reports an error{self._faults()}")
        space = state & SPACE
        fill = 0 if state & EMPTY else DEPTH - space
        self._fill, self._times, self._bursts = (fill, fill), (before, self.clock.now()), 0
        return fill

    def _faults(self) -> str:
        """Return the names of the faults that the chip reports."""
        status = self._read_register(IC_STATUS)
        names = [name for bit, name in FAULTS.items() if status >> bit & 1]
        return f": {', '.join(names)}" if names else ""

    def _most_fill(self, now: float) -> int:
        """Return the largest number of samples that may be in the FIFO."""
        return max(0, self._fill[1] - int(max(0.0, now - self._times[1]) * RATES[0]))

    def fill(self) -> int:
        """Return how many samples are certainly in the FIFO.

        Returns
        -------
        int
            Number of samples.
        """
        return max(0, self._fill[0] - int((self.clock.now() - self._times[0]) * RATES[1]) - 1)

    def room(self) -> int:
        """Return how many samples certainly fit now within `lead`; reads FIFO_STATE now and then.

        Returns
        -------
        int
            Number of samples.

        Raises
        ------
        LostError
            If the chip reports an error or has lost its setup.
        """
        must_read = self._bursts >= READ_EVERY or (self._bursts and self.fill() == 0)
        if must_read and self._state() == 0:
            self._check_power()
            self.counters.stalls += self.last != 0
        return self.room_at(self.clock.now())

    def _check_power(self) -> None:
        """Check that the setup is intact, since a chip that lost its power seems empty."""
        if self._read_register(CONFIG) != self._config:
            self._is_set_up, self._lost = False, True
            raise LostError(f"{self.name}: lost its setup")

    def room_at(self, now: float) -> int:
        """Return how many samples certainly fit at a given time, without reading from the chip.

        Parameters
        ----------
        now : float
            Time on the host's clock [s].

        Returns
        -------
        int
            Number of samples.
        """
        return HIGH - self._most_fill(now)

    @property
    def lost_at(self) -> float:
        """Time at which the chip has held its voltage for too long [s]."""
        if self._lost:
            return 0.0
        return self._times[0] + self._fill[0] / RATES[1] + PATIENCE if self.last else math.inf

    def _burst(self, codes: Sequence[int]) -> None:
        if self._most_fill(self.clock.now()) == 0:
            self._note_empty()
        data = b"".join((code & 0xFFF).to_bytes(2, "big") for code in codes)
        try:
            self.target.write(bytes([REFERENCE]) + data)
        except OSError as error:
            self.unsure = not was_not_acknowledged(error)
            self._attempted = len(codes)
            raise
        self._fill = self._fill[0] + len(codes), self._fill[1] + len(codes)
        self._bursts += 1
        self._mark_taken(len(codes))

    def resolve(self) -> None:
        """Read the fill of the FIFO and derive how much the chip took of the burst that failed.

        Raises
        ------
        LostError
            If the FIFO is empty, so that it cannot be derived.
        """
        if not self._find_taken():
            self._lost = True
            raise LostError(f"{self.name}: ran empty after a burst that failed")

    def _find_taken(self) -> bool:
        """Derive what the chip took of a failed burst; return False if the FIFO is empty.

        Between the two readings of the fill the chip played as many samples as the bounds of its
        clock say, within one sample. The smallest number that it can have taken is assumed. At most
        two samples are therefore sent twice, which steps back by at most one slew limit.

        An empty FIFO does not tell what the chip took. The middle of the voltages that it may hold
        is then assumed.
        """
        most_before, attempted = self._most_fill(self.clock.now()), self._attempted
        least_before = self.fill()
        fill = self._state()
        self.unsure = False
        if fill == 0:
            held = [self.last, *self.pending[:attempted]]
            self.last = (min(held) + max(held)) // 2
            self.counters.unknown_voltages += 1
            return False
        least = min(max(fill - most_before - 1, 0), attempted)
        most = min(max(fill - least_before + 1, 0), attempted)
        self.counters.replayed_samples += most - least
        self._mark_taken(least)
        return True

    def quiet(self) -> bool:
        """Return whether everything has been played.

        Returns
        -------
        bool
            Whether the FIFO is empty.
        """
        return self._state() == 0

    def rest(self) -> None:
        """Reset the chip at 0 V, which switches its output off.

        Raises
        ------
        BusError
            If the chip is still set up to play.
        """
        self.reset()
        if self._read_register(CONFIG) & PLAY == PLAY:
            raise BusError(
                f"{self.name}: CONFIG holds 0x{self._read_register(CONFIG):04x} after a reset"
            )

    def reset(self) -> None:
        """Reset the chip, which switches its output off."""
        self._write_register(CONFIG, RESET)
        self._is_set_up = False
        self.silence()
        self._note_empty()


class Bos1921Bus(ChipBus):
    """Bus of BOS1921 chips, which hold their last voltage.

    Parameters
    ----------
    wiring : Wiring
        What the chips drive.
    place : Place
        Location of the chips.
    i2c : I2cAdapter
        The open adapter.
    runner : Runner
        Thread that writes to the chips, and its clock.
    wide : str
        Output range, "95" or "13".
    board : dict of int to int or None
        Values of registers that depend on the board, by register number.

    Raises
    ------
    BusError
        If a chip is missing.
    """

    on_host_death = "holds"

    def __init__(
        self, wiring: Wiring, place: Place, i2c: I2cAdapter, runner: Runner,
        *, wide: str = "95", board: dict[int, int] | None = None,
    ) -> None:  # fmt: skip
        make_chip = partial(Bos1921, wide=wide, step=wiring.slew / RATE, board=board or {})
        super().__init__(wiring, place, i2c, runner, make_chip)


class Bos1921Options(ChipOptions, frozen=True, kw_only=True):
    """Options of a URL ``bos1921:BUS?option=value&…``, where BUS is the number of the I2C bus.

    Attributes
    ----------
    address : tuple of int
        Addresses of the chips in the order of the channels, or the one behind all ports; by default
        0x44.
    range : str
        Range of the output [V]: ±95 V, or ±13.28 V.
    parcap : int or None
        Value of the register PARCAP, which depends on the board; by default its reset value.
    sup_rise : int or None
        Value of the register SUP_RISE, which depends on the board; by default its reset value.
    """

    address: tuple[
        Annotated[int, Meta(ge=ADDRESSES[0], le=ADDRESSES[-1], extra=HEXADECIMAL)], ...
    ] = ()
    range: Literal["95", "13"] = "95"
    parcap: Annotated[int, Meta(ge=0, le=0xFFFF, extra=HEXADECIMAL)] | None = None
    sup_rise: Annotated[int, Meta(ge=0, le=0xFFFF, extra=HEXADECIMAL)] | None = None


def _open(
    address: Address[Bos1921Options], display: DisplayLike, sample_rate: float | None
) -> ChipBus:
    """Open the bus of a display."""
    options = address.options
    wide = options.range
    check_voltage("bos1921", display.limits.voltage, PEAKS[wide])
    registers = {PARCAP: options.parcap, SUP_RISE: options.sup_rise}
    board = {register: value for register, value in registers.items() if value is not None}
    return open_chips(
        address, display, sample_rate, Bos1921, bits_per_second(),
        lambda wiring, place, i2c: Bos1921Bus(
            wiring, place, i2c, ThreadRunner(), wide=wide, board=board
        ),
    )  # fmt: skip


def find_on(number: str, i2c: I2cAdapter) -> Iterator[FoundDevice]:
    """Yield the chips that return their CHIP_ID to a plain read, as they do after a reset.

    Parameters
    ----------
    number : str
        Number of the I2C bus.
    i2c : I2cAdapter
        Adapter of the bus.

    Yields
    ------
    FoundDevice
        URL and description of a chip.
    """
    for address in ADDRESSES:
        reply = adapter.answer(i2c, address, b"", 2)
        if len(reply) == 2 and int.from_bytes(reply, "big") & 0xFFF == IDENTITY:
            yield FoundDevice(
                f"bos1921:{number}?address=0x{address:02x}",
                f"BOS1921 at 0x{address:02x} of I2C bus {number}",
            )


find = partial(adapter.find_on_adapters, find_on)
"""Function that yields the chips which answer on the I2C adapters of this computer."""

register_bus("bos1921", _open, Bos1921Options, takes_path=True, on_host_death="holds", find=find)
