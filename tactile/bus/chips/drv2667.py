"""``drv2667:1``, displays driven by TI DRV2667 chips, one for each channel.

``drv2667:1?mux=0x70&ports=0,1,2`` on bus 1 behind a TCA9548A, for all have the same address;
``range=50`` (100, 150, 200) V peak to peak, by default the smallest that covers the display's
voltage limit; ``clock_hz=`` of the bus.

A chip plays 8-bit codes from a FIFO of 100 bytes at its own 8 kHz (TI SLOS751E). The host follows
it: `write` waits. The FIFO tells only whether it is full or empty, and while a burst is on its way
several samples are played, so that "full" comes too late to prevent a refusal. So the fill is kept
below 80 by the bounds of `Occupancy`, and when their doubt has grown to 24 samples the FIFO is let
run empty: the next burst is ready by then, the last voltage is held for some tenths of a
millisecond (counted as ``held_samples``), and the clock is known better: after 0.1 s of silence
before the first start, then about 0.15 s, 0.3 s, 0.5 s, 0.9 s and so on up to every 2.5 s. Where
the drive stands still that is done earlier, unnoticed.

When the host dies the FIFO runs empty after 10 ms at most, and 20 ms later the chip's timeout
switches its amplifier off (EN_OVERRIDE = 0): ``on_host_death`` is "zero". An e-stop appends the
ramp to what is in the FIFO, at most 10.3 ms, then STANDBY; where that cannot be written DEV_RST,
which stops at once, at a step.

Uncertain: the clock's tolerance (±2.5 % assumed); the longest start-up (4 ms assumed, 2 ms
typical); how the output goes to 0 V at the timeout, in STANDBY and at DEV_RST ("Ramp Down
Behavior", SLOS751E 7.3.3, was not at hand); whether a burst that is refused half-way keeps what
came before. After such a burst, or any error that is not ENXIO, the chip is left to run empty and
time out, and the drive fades in again.
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
from tactile.bus.chips.occupancy import RATE, RATES, Occupancy, measured_rates
from tactile.bus.chips.pump import Runner, ThreadRunner
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, Found, register_bus
from tactile.clock import Clock
from tactile.errors import BusError

ADDRESS = 0x59
FASTEST = 400_000
"""Hz of the I2C bus (TI SLOS751E)."""
STATUS, CONTROL_1, CONTROL_2, FIFO = 0x00, 0x01, 0x02, 0x0B
EMPTY = 1 << 1
DEV_RST, STANDBY = 1 << 7, 1 << 6
TIMEOUT_20_MS = 3 << 2
ACTIVE = TIMEOUT_20_MS
"""CONTROL_2 while playing: STANDBY, EN_OVERRIDE and GO clear."""
TIMEOUT = 20e-3
"""s, the natural watchdog (TI SLOS751E); the longest, so that a host that is late for some ms only
holds a voltage and does not lose it. An e-stop does not wait for it."""
IDENTITY = 7
CHIPS = {IDENTITY: "DRV2667", 5: "DRV2665"}
"""By CHIPID, CONTROL_1 6:3 (TI SLOS751E, SLOS740C)."""
RANGES = {50: 0, 100: 1, 150: 2, 200: 3}
"""GAIN by V peak to peak (TI SLOS751E)."""
MOST = 127
"""Code of the range's peak."""
STARTUP = 4e-3
"""s from the first byte to its output at most; about 2 ms typical (TI SLOS751E), twice assumed."""
SETTLE = 1e-3
"""s between leaving STANDBY and the next write (TI SLOS751E)."""
EARLY = 0.8
"""Of the timeout within which an empty FIFO certainly still holds its last voltage (assumed)."""
HIGH = 80
"""Samples in the FIFO at most, 10 ms: an e-stop waits for them."""
DOUBT = 24
"""Samples of doubt at which the FIFO is let run empty: 24 of 80 are left for the host's delays."""
FLAT_DOUBT = 8
"""The same while all in the FIFO is one voltage."""
POLL = 50e-6
"""s between statuses, which take 0.1 ms themselves; a sample passes in 125 µs."""
MEASURED = 0.1
"""s of silence that the clock is measured by."""
RESERVE = 50
"""Samples ahead of the slowest clock meanwhile: the fastest takes 40 more in that time."""
POLLS = 1000
"""Statuses that are read at most until a FIFO is empty."""


def bits_per_second() -> float:
    """Return what a chip needs of the bus: a burst and, on average less than, a status every 4 ms.

    308 and 39 bits: 21.7 % of a 400 kHz bus. [1/s]
    """
    return (transfer_bits(1 + BURST) + transfer_bits(1, 1)) * RATE / BURST


def chosen_range(voltage: float, option: str | None) -> int:
    """Return the range [V peak to peak] that covers a voltage limit [V].

    Raises
    ------
    InputError
        Where none does, or that of the option does not.
    """
    wide = int(option) if option else next((r for r in RANGES if r / 2 >= voltage), max(RANGES))
    checked_voltage("drv2667", voltage, wide / 2)
    return wide


class Drv2667(Chip):
    """One chip; parameters as of `Chip`, with ``gain`` for CONTROL_1."""

    kind = "DRV2667"
    lead = HIGH

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters, *, wide: int, step: float
    ) -> None:
        scale = wide / 2 / MOST
        super().__init__(
            target, clock, counters,
            volts_per_code=scale, most=MOST, step=step_codes(step, scale),
        )  # fmt: skip
        self.gain = RANGES[wide]
        self.occupancy = Occupancy()
        self._measured = False
        self._measure: tuple[float, float] | None = None
        self._seen = (0.0, 0.0)
        self.silence()

    def silence(self) -> None:
        """Drop what is pending; the output is at 0 V, the FIFO empty, the chip perhaps idle."""
        super().silence()
        self._empty, self._sounding, self._lost = True, False, False
        self._measure = None
        self._flat, self._held, self._full_until = 0, False, self.clock.now()

    def _status(self) -> int:
        before = self.clock.now()
        status = self._ask(bytes([STATUS]), 1)[0]
        self._seen = (before, self.clock.now())
        return status

    def _set(self, register: int, value: int, mask: int) -> None:
        self._tell(bytes([register, value]))
        found = self._ask(bytes([register]), 1)[0] & mask
        if found != value:
            raise BusError(
                f"{self.name}: register 0x{register:02x} holds 0x{found:02x} after 0x{value:02x}"
            )

    def identify(self) -> None:
        """See that it is a DRV2667."""
        identity = self._ask(bytes([CONTROL_1]), 1)[0] >> 3 & 0xF
        if identity != IDENTITY:
            there = CHIPS.get(identity, f"a chip with CHIPID {identity}")
            raise BusError(f"{self.name}: there is {there}, not a DRV2667")

    def wake(self) -> None:
        """Let it run empty and time out, then leave STANDBY."""
        self.identify()
        if not self._ask(bytes([CONTROL_2]), 1)[0] & STANDBY:
            self._run_empty()
            self.clock.sleep(TIMEOUT / EARLY)
        self._set(CONTROL_2, ACTIVE, 0xFF)
        self.clock.sleep(SETTLE)
        self._set(CONTROL_1, self.gain, 0b111)
        self.silence()

    def _run_empty(self) -> tuple[float, float]:
        """Wait until the FIFO is empty; return between which times it became so."""
        since = self.clock.now()
        for _ in range(POLLS):
            if self._status() & EMPTY:
                return since, self._seen[1]
            since = self._seen[0]
            self.clock.sleep(POLL)
        raise BusError(f"{self.name}: its FIFO does not run empty")

    def warm(self) -> None:
        """Write some silence, so that it starts up."""
        self._zeros(BURST)

    def ready(self) -> None:
        """Wait until that has been played."""
        self._run_empty()

    def calibrate(self) -> None:
        """Play 0 V for `MEASURED` without a pause, and see when the FIFO is empty."""
        if self._measured:
            return
        self.warm()
        self.ready()
        begun = self.clock.now()
        self._zeros(RESERVE)
        self.occupancy = Occupancy()
        self.occupancy.begin(RESERVE, begun, self.clock.now())
        while (now := self.clock.now()) < begun + MEASURED:
            more = int(RATES[0] * (now - begun)) + RESERVE - self.occupancy.written
            if more > 0:
                self._zeros(more)
                self.occupancy.wrote(more, now)
            self.clock.sleep(BURST / 4 / RATE)
        empty = self._run_empty()
        self._check_power()
        rates = measured_rates(self.occupancy.written, (begun, begun), empty)
        if rates[1] < RATES[0] or rates[0] > RATES[1]:
            raise BusError(f"{self.name}: plays {rates[0]:.0f} samples a second, not {RATE:g}")
        self.occupancy.rates = self.occupancy.measured(*empty)
        self._measured = True

    def _zeros(self, count: int) -> None:
        self._tell(bytes([FIFO]) + bytes(count))

    def wanted(self) -> int:
        """Return how many samples should be put next; a burst in reserve while it runs empty."""
        room = self.room()
        return max(0, (BURST if self._sounding else room) - len(self.pending))

    def due(self) -> float:
        """Return when it can take the next burst [s]."""
        if self._sounding:
            return max(self.occupancy.dry_at, self.clock.now() + POLL)
        return super().due()

    def room(self) -> int:
        """Return how many samples fit now for certain; none while it is to run empty."""
        now = self.clock.now()
        if not self._empty and now > self.occupancy.dry_at:
            self._look()
        elif not self._empty and not self._sounding:
            doubt = self.occupancy.most_fill(now) - self.occupancy.least_fill(now)
            self._sounding = doubt > (FLAT_DOUBT if self._flat > HIGH else DOUBT)
            self._full_until = self.occupancy.dry_at
        return self.room_at(now)

    def _look(self) -> None:
        """See whether the FIFO has run empty."""
        if not self._status() & EMPTY:
            self._full_until = self._seen[0]
            return
        if self._sounding:
            self._measure = self.occupancy.measured(self._full_until, self._seen[1])
        else:
            self._full_until = self._seen[0]
            self.counters.stalls += 1
        self._empty, self._sounding, self._held = True, False, True

    def room_at(self, now: float) -> int:
        """Return how many samples fit at a time [s] for certain, by what is known already."""
        if self._empty:
            return HIGH
        return 0 if self._sounding else HIGH - self.occupancy.most_fill(now)

    def fill(self) -> int:
        """Return how many samples are in the FIFO for certain."""
        return 0 if self._empty else self.occupancy.least_fill(self.clock.now())

    @property
    def lost_at(self) -> float:
        """When the timeout may switch off, which at 0 V is no loss [s]."""
        if self._lost:
            return 0.0
        return self.occupancy.dry_at + EARLY * TIMEOUT if self.last else math.inf

    def _burst(self, codes: Sequence[int]) -> None:
        self.target.connect()  # first, for a host that is held up there comes after the timeout
        before = self.clock.now()
        if before > self.lost_at:
            self._lost = True
            raise LostError(f"{self.name}: ran empty for longer than its timeout")
        try:
            self.target.write(bytes([FIFO, *(code & 0xFF for code in codes)]))
        except OSError as error:
            self.unsure = self._lost = not was_taken_nothing(error)
            raise
        after = self.clock.now()
        if self._empty:
            idle = before > self.occupancy.dry_at + EARLY * TIMEOUT
            self.occupancy.begin(len(codes), before, after + STARTUP * idle)
        else:
            self.occupancy.wrote(len(codes), before)
        self._empty = False
        same = all(code == self.last for code in codes)
        self._flat = self._flat + len(codes) if same else 0
        self._took(len(codes))
        if self._held:
            self._held = False
            self.counters.held_samples += int((before - self._full_until) * RATE) + 2
            self._check_power()
            self.occupancy.rates = self._measure or self.occupancy.rates
            self._measure = None

    def _check_power(self) -> None:
        """See that it still is as it was set up: a chip that lost its power seems empty."""
        if self._ask(bytes([CONTROL_2]), 1)[0] != ACTIVE:
            self._lost = True
            raise LostError(f"{self.name}: lost its setup")

    def resolve(self) -> None:
        """Give up: nobody knows how much it took."""
        raise LostError(f"{self.name}: refused a burst half-way")

    def quiet(self) -> bool:
        """Return whether all has been played."""
        return bool(self._status() & EMPTY)

    def rest(self) -> None:
        """Enter STANDBY."""
        self._set(CONTROL_2, STANDBY | ACTIVE, 0xFF)
        self.silence()

    def reset(self) -> None:
        """Reset it: stops at once and enters STANDBY."""
        self._tell(bytes([CONTROL_2, DEV_RST]))
        self.silence()


class Drv2667Bus(ChipBus):
    """Chips that go to 0 V by themselves.

    Parameters
    ----------
    wiring : what they drive
    place : where they are
    i2c : the adapter
    runner : who writes, and by which clock
    wide : range of the chips [V peak to peak]

    Raises
    ------
    BusError
        Where one of them is not there.
    """

    on_host_death = "zero"

    def __init__(
        self, wiring: Wiring, place: Place, i2c: I2cAdapter, runner: Runner, *, wide: int
    ) -> None:
        counters = ChipCounters()
        chips = [
            Drv2667(t, runner, counters, wide=wide, step=wiring.slew / RATE)
            for t in place.targets(i2c)
        ]
        super().__init__(wiring, chips, i2c, runner, counters)


class Drv2667Options(ChipOptions, frozen=True, kw_only=True):
    """Options of a ``drv2667:`` URL.

    Attributes
    ----------
    range : str or None
        Range of the output, peak to peak [V]; None for the smallest that covers the limit.
    """

    address: tuple[Annotated[int, Meta(ge=ADDRESS, le=ADDRESS, extra=HEXADECIMAL)], ...] = ()
    range: Literal["50", "100", "150", "200"] | None = None


def _open(
    address: Address[Drv2667Options], display: DisplayLike, sample_rate: float | None
) -> ChipBus:
    wiring = Wiring.of(display, checked_rate("drv2667", sample_rate))
    checked_estop(wiring, HIGH)
    place = Place.of(address, ADDRESS)
    extra = transfer_bits(1) * RATE / BURST if len(place.ports) > 1 else 0.0
    place.check("drv2667", display.channels, bits_per_second() + extra, FASTEST)
    wide = chosen_range(display.limits.voltage, address.options.range)
    return opened(place.path, lambda i2c: Drv2667Bus(wiring, place, i2c, ThreadRunner(), wide=wide))


def find_on(number: str, i2c: I2cAdapter) -> Iterator[Found]:
    """Yield the chip that answers on an adapter, by reading CONTROL_1; not behind multiplexers."""
    got = adapter.answer(i2c, ADDRESS, bytes([CONTROL_1]), 1)
    if got and got[0] >> 3 & 0xF == 7:
        yield Found(f"drv2667:{number}", f"DRV2667 at 0x{ADDRESS:02x} of I2C bus {number}")


def find() -> Iterator[Found]:
    """Yield the chips that answer on the I2C adapters there are."""
    return adapter.found_on_adapters(find_on)


register_bus("drv2667", _open, Drv2667Options, takes_path=True, on_host_death="zero", find=find)
