"""``bos1921:1``, displays driven by Boréas BOS1921 chips, one for each channel.

``bos1921:1?address=0x44,0x45`` on bus 1, or behind a TCA9548A with ``mux=0x70&ports=0,1``;
``range=95`` (±95 V) or ``13`` (±13.28 V); ``clock_hz=`` of the bus up to 1 MHz; ``parcap=`` and
``sup_rise=`` the board's values of those registers, else they stay at reset.

A chip plays 12-bit codes from a FIFO of 1024 samples at its own 8 kHz; 80 of them are used. It
tells how much room there is, read at every second burst; between readings 0.2 samples are in doubt.
The host follows the first chip: `write` waits for it.

**An empty FIFO holds the last voltage**: ``on_host_death`` is "holds", refused unless accepted.
Each end is a ramp to 0 V that is seen played before the output is switched off. After an error the
chip is asked whether it kept its setup; if so it still holds what it took last, and is led to 0 V
from there. An e-stop appends the ramp to what is in the FIFO, at most 10.3 ms; where that cannot be
written in time the chip is reset, at a step.

Nothing here was checked against the data sheet; it comes from published drivers that quote it.
Uncertain besides: what a code means in the low range (13.28 V at 2047 assumed; in the high range
code × 3.6 × 31 / 2047); the clock's tolerance (±2.5 % assumed); that a reset switches the output
off; that a plain read of an unused chip gives CHIP_ID, by which `find` knows it; what a chip took
of a burst that failed half-way where its FIFO is empty when it is asked: then it is led to 0 V from
the middle of what it may hold.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from msgspec import Meta

from tactile.bus.base import DisplayLike, Wiring
from tactile.bus.chips import adapter
from tactile.bus.chips.adapter import ChipOptions, ChipTarget, I2cAdapter, Place, transfer_bits
from tactile.bus.chips.chip import (
    BURST,
    Chip,
    ChipCounters,
    LostError,
    ramp_codes,
    was_taken_nothing,
)
from tactile.bus.chips.chip_bus import (
    ChipBus,
    checked_estop,
    checked_rate,
    checked_voltage,
    opened,
    step_codes,
)
from tactile.bus.chips.occupancy import RATE, RATES
from tactile.bus.chips.pump import Runner, ThreadRunner
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, Found, register_bus
from tactile.clock import Clock
from tactile.errors import BusError

ADDRESS = 0x44
ADDRESSES = range(0x40, 0x50)
FASTEST = 1_000_000
"""Hz of the I2C bus."""
REFERENCE, CONFIG, PARCAP, SUP_RISE, COMM = 0x00, 0x05, 0x06, 0x07, 0x0B
IC_STATUS, FIFO_STATE, CHIP_ID = 0x10, 0x11, 0x1E
IDENTITY = 0x781
"""CHIP_ID 11:0."""
RESET = 0x0040
PLAY = 0x0217
"""CONFIG: PLAY_MODE 10:9 = FIFO, OE (bit 4), 8 kS/s (2:0 = 7)."""
LOW_RANGE = 0x0800
"""CONFIG: GAIND, ±13.28 V."""
ERROR, EMPTY, SPACE = 1 << 12, 1 << 10, 0x3FF
"""FIFO_STATE; a SPACE of 0 with EMPTY is all 1024."""
DEPTH = 1024
FAULTS = {7: "OVV", 6: "OCT", 5: "MXPWR", 4: "IDAC", 3: "UVLO", 2: "SC"}
"""IC_STATUS, by bit."""
SCALES = {"95": 3.6 * 31 / 2047, "13": 13.28 / 2047}
"""V a code, by range; 54.5 mV in the high one."""
PEAKS = {"95": 95.0, "13": 13.28}
"""V."""
SETTLE = 1e-3
"""s after a reset."""
HIGH = 80
"""Samples in the FIFO at most, 10 ms: an e-stop waits for them."""
READ_EVERY = 2
"""Bursts."""
PATIENCE = 10e-3
"""s that a chip may hold its voltage for want of a working link, before it is led to 0 V."""
POLL = 0.5e-3
"""s between readings while a FIFO is to run empty."""
POLLS = 400


def bits_per_second() -> float:
    """Return what a chip needs of the bus: a burst every 4 ms and FIFO_STATE every 8 ms [1/s].

    596 and 68 bits: 39.4 % of a 400 kHz bus.
    """
    state = transfer_bits(3, 2)
    return (transfer_bits(1 + 2 * BURST) + state / READ_EVERY) * RATE / BURST


class Bos1921(Chip):
    """One chip; parameters as of `Chip`, and its board's registers.

    Parameters
    ----------
    wide : range, "95" or "13"
    board : further registers to set, by number
    """

    kind = "BOS1921"
    lead = HIGH

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters,
        *, wide: str, step: float, board: dict[int, int],
    ) -> None:  # fmt: skip
        scale = SCALES[wide]
        super().__init__(
            target, clock, counters, volts_per_code=scale,
            most=int(PEAKS[wide] / scale), step=step_codes(step, scale),
        )  # fmt: skip
        self._config = PLAY | (LOW_RANGE if wide == "13" else 0)
        self._board = board
        self._known = self._lost = False
        self._tried = 0
        self._empty_since()

    def _empty_since(self) -> None:
        now = self.clock.now()
        self._fill, self._times, self._bursts = (0, 0), (now, now), 0

    def _get(self, register: int) -> int:
        return int.from_bytes(self._ask(bytes([COMM, 0, register]), 2), "big")

    def _set(self, register: int, value: int) -> None:
        self._tell(bytes([register]) + value.to_bytes(2, "big"))

    def identify(self) -> None:
        """See that it is a BOS1921; wakes it by a 0 into REFERENCE, which a player takes as 0 V."""
        if not self._known:
            self._set(REFERENCE, 0)
        found = self._get(CHIP_ID) & 0xFFF
        if found != IDENTITY:
            raise BusError(f"{self.name}: CHIP_ID is 0x{found:03x}, not a BOS1921's 0x781")

    def wake(self) -> None:
        """Lead it to 0 V where it kept its setup, else set it up."""
        if self._known and self._get(CONFIG) == self._config:
            self._lead_to_zero()
        else:
            self._known = False
            self.identify()
            self._set(CONFIG, RESET)
            self.clock.sleep(SETTLE)
            self.identify()
            for register, value in self._board.items():
                self._set(register, value)
            self._set(CONFIG, self._config)
            if self._get(CONFIG) != self._config:
                raise BusError(f"{self.name}: CONFIG holds 0x{self._get(CONFIG):04x}")
            self._known = True
        self.silence()
        self._lost = False
        self._empty_since()

    def _lead_to_zero(self) -> None:
        """Write the ramp from what it plays last, and wait until it has been played."""
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
        """Read the fill, and keep it as both bounds."""
        before = self.clock.now()
        state = self._get(FIFO_STATE)
        if state & ERROR:
            raise LostError(f"{self.name}: reports an error{self._faults()}")
        space = state & SPACE
        fill = 0 if state & EMPTY else DEPTH - space
        self._fill, self._times, self._bursts = (fill, fill), (before, self.clock.now()), 0
        return fill

    def _faults(self) -> str:
        status = self._get(IC_STATUS)
        names = [name for bit, name in FAULTS.items() if status >> bit & 1]
        return f": {', '.join(names)}" if names else ""

    def _most_fill(self, now: float) -> int:
        return max(0, self._fill[1] - int(max(0.0, now - self._times[1]) * RATES[0]))

    def fill(self) -> int:
        """Return how many samples are in the FIFO for certain."""
        return max(0, self._fill[0] - int((self.clock.now() - self._times[0]) * RATES[1]) - 1)

    def room(self) -> int:
        """Return how many samples fit now within `lead`; reads FIFO_STATE now and then."""
        asked = self._bursts >= READ_EVERY or (self._bursts and self.fill() == 0)
        if asked and self._state() == 0:
            self._check_power()
            self.counters.stalls += self.last != 0
        return self.room_at(self.clock.now())

    def _check_power(self) -> None:
        """See that it still is as it was set up: a chip that lost its power seems empty."""
        if self._get(CONFIG) != self._config:
            self._known, self._lost = False, True
            raise LostError(f"{self.name}: lost its setup")

    def room_at(self, now: float) -> int:
        """Return how many samples fit at a time [s] for certain, by what is known already."""
        return HIGH - self._most_fill(now)

    @property
    def lost_at(self) -> float:
        """When it has held its voltage for too long [s]."""
        if self._lost:
            return 0.0
        return self._times[0] + self._fill[0] / RATES[1] + PATIENCE if self.last else math.inf

    def _burst(self, codes: Sequence[int]) -> None:
        if self._most_fill(self.clock.now()) == 0:
            self._empty_since()
        data = b"".join((code & 0xFFF).to_bytes(2, "big") for code in codes)
        try:
            self.target.write(bytes([REFERENCE]) + data)
        except OSError as error:
            self.unsure = not was_taken_nothing(error)
            self._tried = len(codes)
            raise
        self._fill = self._fill[0] + len(codes), self._fill[1] + len(codes)
        self._bursts += 1
        self._took(len(codes))

    def resolve(self) -> None:
        """Ask how much there is, and take what must have come of the burst that failed."""
        if not self._find_taken():
            self._lost = True
            raise LostError(f"{self.name}: ran empty after a burst that failed")

    def _find_taken(self) -> bool:
        """Take what came of it; return False where the FIFO is empty, so that nobody knows.

        Between the two fills the chip played within a sample of what its clock's bounds say: the
        fewest that it can have taken are taken as such, at most two are sent twice, which steps
        back by one slew limit at most.
        """
        before, tried = self._most_fill(self.clock.now()), self._tried
        least_before = self.fill()
        now = self._state()
        self.unsure = False
        if now == 0:
            held = [self.last, *self.pending[:tried]]
            self.last = (min(held) + max(held)) // 2
            self.counters.unknown_voltages += 1
            return False
        least = min(max(now - before - 1, 0), tried)
        most = min(max(now - least_before + 1, 0), tried)
        self.counters.replayed_samples += most - least
        self._took(least)
        return True

    def quiet(self) -> bool:
        """Return whether all has been played."""
        return self._state() == 0

    def rest(self) -> None:
        """Reset it at 0 V: the output off."""
        self.reset()
        if self._get(CONFIG) & PLAY == PLAY:
            raise BusError(f"{self.name}: CONFIG holds 0x{self._get(CONFIG):04x} after a reset")

    def reset(self) -> None:
        """Reset it: the output off."""
        self._set(CONFIG, RESET)
        self._known = False
        self.silence()
        self._empty_since()


class Bos1921Bus(ChipBus):
    """Chips that hold their last voltage.

    Parameters
    ----------
    wiring : what they drive
    place : where they are
    i2c : the adapter
    runner : who writes, and by which clock
    wide : range, "95" or "13"
    board : registers of the chips' boards, by number

    Raises
    ------
    BusError
        Where one of them is not there.
    """

    on_host_death = "holds"

    def __init__(
        self, wiring: Wiring, place: Place, i2c: I2cAdapter, runner: Runner,
        *, wide: str = "95", board: dict[int, int] | None = None,
    ) -> None:  # fmt: skip
        counters = ChipCounters()
        chips = [
            Bos1921(t, runner, counters, wide=wide, step=wiring.slew / RATE, board=board or {})
            for t in place.targets(i2c)
        ]
        super().__init__(wiring, chips, i2c, runner, counters)


class Bos1921Options(ChipOptions, frozen=True, kw_only=True):
    """Options of a ``bos1921:`` URL.

    Attributes
    ----------
    range : str
        Range of the output [V].
    parcap, sup_rise : int or None
        Values of the registers of these names, which depend on the board; the chip's own if None.
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
    wiring = Wiring.of(display, checked_rate("bos1921", sample_rate))
    checked_estop(wiring, HIGH)
    place = Place.of(address, ADDRESS)
    extra = transfer_bits(1) * RATE / BURST if len(place.ports) > 1 else 0.0
    place.check("bos1921", display.channels, bits_per_second() + extra, FASTEST)
    options = address.options
    wide = options.range
    checked_voltage("bos1921", display.limits.voltage, PEAKS[wide])
    registers = {PARCAP: options.parcap, SUP_RISE: options.sup_rise}
    board = {register: value for register, value in registers.items() if value is not None}
    return opened(
        place.path,
        lambda i2c: Bos1921Bus(wiring, place, i2c, ThreadRunner(), wide=wide, board=board),
    )


def find_on(number: str, i2c: I2cAdapter) -> Iterator[Found]:
    """Yield the chips that give their CHIP_ID to a plain read, as after a reset."""
    for address in ADDRESSES:
        got = adapter.answer(i2c, address, b"", 2)
        if len(got) == 2 and int.from_bytes(got, "big") & 0xFFF == IDENTITY:
            yield Found(
                f"bos1921:{number}?address=0x{address:02x}",
                f"BOS1921 at 0x{address:02x} of I2C bus {number}",
            )


def find() -> Iterator[Found]:
    """Yield the chips that answer on the I2C adapters there are."""
    return adapter.found_on_adapters(find_on)


register_bus("bos1921", _open, Bos1921Options, takes_path=True, on_host_death="holds", find=find)
