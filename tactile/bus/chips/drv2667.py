"""``drv2667:1``, displays driven by TI DRV2667 chips, one for each channel.

``drv2667:1?mux=0x70&ports=0,1,2`` uses chips on bus 1 behind a TCA9548A, because all chips have the
same address. ``range=50`` (100, 150, 200) is the output range [V peak to peak], by default the
smallest that covers the display's voltage limit. ``clock_hz=`` is the clock of the bus.

A chip plays 8-bit codes from a FIFO of 100 bytes at its own 8 kHz (TI SLOS751E). The host follows
it: `write` waits. The FIFO reports only whether it is full or empty, and several samples are played
during the transfer of a burst, so that "full" is reported too late to prevent a refusal. The fill
is therefore kept below 80 by the bounds of `Occupancy`. When their uncertainty has grown to 24
samples, the FIFO is allowed to run empty. The next burst is ready by then, the last voltage is held
for some tenths of a millisecond (counted as ``held_samples``), and the clock is known more
precisely. This happens after 0.1 s of silence before the first start, then after about 0.15 s,
0.3 s, 0.5 s, 0.9 s and so on up to every 2.5 s. It is done earlier, without an effect, while the
drive is constant.

When the host dies, the FIFO runs empty after 10 ms at most, and 20 ms later the chip's timeout
switches its amplifier off (EN_OVERRIDE = 0): ``on_host_death`` is "zero". An e-stop appends the
ramp to the contents of the FIFO, which take 10.3 ms at most, followed by STANDBY. If that cannot be
written, DEV_RST stops the chip at once, which causes a step.

The following is uncertain:

- the tolerance of the clock (±2.5 % is assumed);
- the longest start-up time (4 ms is assumed, 2 ms is typical);
- how the output goes to 0 V at the timeout, in STANDBY and at DEV_RST ("Ramp Down Behavior",
  SLOS751E 7.3.3, was not available);
- whether the chip keeps the beginning of a burst that it refuses midway. After such a burst, or any
  error other than ENXIO, the chip is left to run empty and time out, and the drive fades in again.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated, Literal

from msgspec import Meta

from tactile.bus.base import DisplayLike, Wiring
from tactile.bus.chips import adapter
from tactile.bus.chips.adapter import ChipOptions, ChipTarget, Place
from tactile.bus.chips.chip import BURST, Chip, ChipCounters, LostError, was_not_acknowledged
from tactile.bus.chips.chip_bus import ChipBus, check_voltage, open_chips
from tactile.bus.chips.occupancy import RATE, RATES, Occupancy, measured_rates
from tactile.bus.chips.pump import Runner, ThreadRunner
from tactile.bus.linux_i2c import I2cAdapter
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.bus.wire_time import i2c_bits
from tactile.clock import Clock
from tactile.errors import BusError

ADDRESS = 0x59
"""I2C address of the chip."""
FASTEST = 400_000
"""Highest clock of the I2C bus (TI SLOS751E) [Hz]."""
STATUS, CONTROL_1, CONTROL_2, FIFO = 0x00, 0x01, 0x02, 0x0B
"""Registers."""
EMPTY = 1 << 1
"""Bit of STATUS that tells that the FIFO is empty."""
DEV_RST, STANDBY = 1 << 7, 1 << 6
"""Bits of CONTROL_2."""
TIMEOUT_20_MS = 3 << 2
"""Value of the timeout field of CONTROL_2."""
ACTIVE = TIMEOUT_20_MS
"""Value of CONTROL_2 while playing: STANDBY, EN_OVERRIDE and GO are clear."""
TIMEOUT = 20e-3
"""Timeout of the chip, which serves as a watchdog (TI SLOS751E) [s].

It is the longest that can be set, so that a host that is late by some milliseconds only holds a
voltage and does not lose it. An e-stop does not wait for it.
"""
IDENTITY = 7
"""CHIPID of a DRV2667."""
CHIPS = {IDENTITY: "DRV2667", 5: "DRV2665"}
"""Names of chips by CHIPID, bits 6:3 of CONTROL_1 (TI SLOS751E, SLOS740C)."""
RANGES = {50: 0, 100: 1, 150: 2, 200: 3}
"""Value of GAIN by output range [V peak to peak] (TI SLOS751E)."""
MOST = 127
"""Code of the range's peak."""
STARTUP = 4e-3
"""Longest time from the first byte to its output [s].

About 2 ms are typical (TI SLOS751E); twice that is assumed.
"""
SETTLE = 1e-3
"""Waiting time between leaving STANDBY and the next write (TI SLOS751E) [s]."""
EARLY = 0.8
"""Fraction of the timeout within which an empty FIFO certainly holds its voltage (assumed)."""
HIGH = 80
"""Largest number of samples in the FIFO, 10 ms, for which an e-stop waits."""
DOUBT = 24
"""Uncertainty of the fill at which the FIFO is allowed to run empty [samples].

Of the 80 samples, a burst of 32 then still leaves 24 for delays of the host.
"""
FLAT_DOUBT = 8
"""Value of `DOUBT` while all samples in the FIFO are equal [samples]."""
POLL = 50e-6
"""Interval between readings of STATUS [s].

A reading itself takes 0.1 ms, and a sample is played every 125 µs.
"""
MEASURED = 0.1
"""Duration of the silence during which the clock is measured [s]."""
RESERVE = 50
"""Number of samples written ahead of the slowest clock during the measurement.

The fastest clock plays 40 more in that time.
"""
POLLS = 1000
"""Largest number of readings of STATUS until a FIFO is empty."""


def bits_per_second() -> float:
    """Return the bits that a chip needs on the bus: a burst and at most one status every 4 ms.

    These take 308 and 39 bits, 21.7 % of a 400 kHz bus. On average STATUS is read less often.

    Returns
    -------
    float
        Bit rate [1/s].
    """
    return (i2c_bits(1 + BURST) + i2c_bits(1, 1)) * RATE / BURST


def chosen_range(voltage: float, option: str | None) -> int:
    """Return the output range for a voltage limit.

    Parameters
    ----------
    voltage : float
        Voltage limit of the display [V].
    option : str or None
        Range that the URL requests [V peak to peak]; None for the smallest that covers the limit.

    Returns
    -------
    int
        Range [V peak to peak].

    Raises
    ------
    InputError
        If the requested range, or each range, is too small.
    """
    wide = int(option) if option else next((r for r in RANGES if r / 2 >= voltage), max(RANGES))
    check_voltage("drv2667", voltage, wide / 2)
    return wide


class Drv2667(Chip):
    """One DRV2667.

    Parameters
    ----------
    target, clock, counters
        Parameters of `Chip`.
    wide : int
        Output range [V peak to peak].
    step : float
        Largest change of the voltage in a sample [V].

    Attributes
    ----------
    gain : int
        Value of GAIN in CONTROL_1.
    occupancy : Occupancy
        Bounds of the fill of the FIFO.
    """

    kind = "DRV2667"
    default_address = ADDRESS
    fastest = FASTEST
    lead = HIGH

    def __init__(
        self, target: ChipTarget, clock: Clock, counters: ChipCounters, *, wide: int, step: float
    ) -> None:
        scale = wide / 2 / MOST
        super().__init__(
            target, clock, counters,
            volts_per_code=scale, most=MOST, step=step,
        )  # fmt: skip
        self.gain = RANGES[wide]
        self.occupancy = Occupancy()
        self._is_calibrated = False
        self._new_rates: tuple[float, float] | None = None
        self._status_times = (0.0, 0.0)
        self.silence()

    def silence(self) -> None:
        """Discard the pending samples; the output is at 0 V and the FIFO empty."""
        super().silence()
        self._empty, self._runs_empty, self._lost = True, False, False
        self._new_rates = None
        self._constant_samples, self._was_held, self._full_until = 0, False, self.clock.now()

    def _read_status(self) -> int:
        """Read STATUS, and note between which times that happened."""
        before = self.clock.now()
        status = self._read(bytes([STATUS]), 1)[0]
        self._status_times = (before, self.clock.now())
        return status

    def _write_register(self, register: int, value: int, mask: int) -> None:
        """Write a register, and verify the bits of a mask."""
        self._write(bytes([register, value]))
        present = self._read(bytes([register]), 1)[0] & mask
        if present != value:
            raise BusError(
                f"{self.name}: register 0x{register:02x} holds 0x{present:02x} after 0x{value:02x}"
            )

    def identify(self) -> None:
        """Check that the chip is a DRV2667.

        Raises
        ------
        BusError
            If it is another chip.
        OSError
            If it does not answer.
        """
        identity = self._read(bytes([CONTROL_1]), 1)[0] >> 3 & 0xF
        if identity != IDENTITY:
            name = CHIPS.get(identity, f"a chip with CHIPID {identity}")
            raise BusError(f"{self.name}: there is {name}, not a DRV2667")

    def wake(self) -> None:
        """Let the chip run empty and time out, then leave STANDBY.

        Raises
        ------
        BusError
            If it is another chip, does not accept its setup, or its FIFO does not run empty.
        OSError
            If it does not answer.
        """
        self.identify()
        if not self._read(bytes([CONTROL_2]), 1)[0] & STANDBY:
            self._wait_until_empty()
            self.clock.sleep(TIMEOUT / EARLY)
        self._write_register(CONTROL_2, ACTIVE, 0xFF)
        self.clock.sleep(SETTLE)
        self._write_register(CONTROL_1, self.gain, 0b111)
        self.silence()

    def _wait_until_empty(self) -> tuple[float, float]:
        """Wait until the FIFO is empty; return two times between which that happened."""
        since = self.clock.now()
        for _ in range(POLLS):
            if self._read_status() & EMPTY:
                return since, self._status_times[1]
            since = self._status_times[0]
            self.clock.sleep(POLL)
        raise BusError(f"{self.name}: its FIFO does not run empty")

    def warm(self) -> None:
        """Write some silence, so that the chip starts up."""
        self._write_silence(BURST)

    def ready(self) -> None:
        """Wait until the silence has been played."""
        self._wait_until_empty()

    def calibrate(self) -> None:
        """Measure the clock with silence of length `MEASURED`, played without a pause.

        Raises
        ------
        BusError
            If the rate is not within the tolerance of the clock.
        LostError
            If the chip has lost its setup.
        """
        if self._is_calibrated:
            return
        self.warm()
        self.ready()
        begun = self.clock.now()
        self._write_silence(RESERVE)
        self.occupancy = Occupancy()
        self.occupancy.begin(RESERVE, begun, self.clock.now())
        while (now := self.clock.now()) < begun + MEASURED:
            more = int(RATES[0] * (now - begun)) + RESERVE - self.occupancy.written
            if more > 0:
                self._write_silence(more)
                self.occupancy.wrote(more, now)
            self.clock.sleep(BURST / 4 / RATE)
        empty = self._wait_until_empty()
        self._check_power()
        rates = measured_rates(self.occupancy.written, (begun, begun), empty)
        if rates[1] < RATES[0] or rates[0] > RATES[1]:
            raise BusError(f"{self.name}: plays {rates[0]:.0f} samples a second, not {RATE:g}")
        self.occupancy.rates = self.occupancy.measured(*empty)
        self._is_calibrated = True

    def _write_silence(self, count: int) -> None:
        """Write samples of 0 V."""
        self._write(bytes([FIFO]) + bytes(count))

    def demand(self) -> int:
        """Return how many samples should be put next.

        While the FIFO runs empty, one burst is kept in reserve.

        Returns
        -------
        int
            Number of samples.
        """
        room = self.room()
        return max(0, (BURST if self._runs_empty else room) - len(self.pending))

    def due(self) -> float:
        """Return when the chip can take the next burst.

        Returns
        -------
        float
            Time on the host's clock [s].
        """
        if self._runs_empty:
            return max(self.occupancy.dry_at, self.clock.now() + POLL)
        return super().due()

    def room(self) -> int:
        """Return how many samples certainly fit now; none while the FIFO is to run empty.

        Returns
        -------
        int
            Number of samples.
        """
        now = self.clock.now()
        if not self._empty and now > self.occupancy.dry_at:
            self._check_empty()
        elif not self._empty and not self._runs_empty:
            doubt = self.occupancy.most_fill(now) - self.occupancy.least_fill(now)
            self._runs_empty = doubt > (FLAT_DOUBT if self._constant_samples > HIGH else DOUBT)
            self._full_until = self.occupancy.dry_at
        return self.room_at(now)

    def _check_empty(self) -> None:
        """Check whether the FIFO has run empty."""
        if not self._read_status() & EMPTY:
            self._full_until = self._status_times[0]
            return
        if self._runs_empty:
            self._new_rates = self.occupancy.measured(self._full_until, self._status_times[1])
        else:
            self._full_until = self._status_times[0]
            self.counters.stalls += 1
        self._empty, self._runs_empty, self._was_held = True, False, True

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
        if self._empty:
            return HIGH
        return 0 if self._runs_empty else HIGH - self.occupancy.most_fill(now)

    def fill(self) -> int:
        """Return how many samples are certainly in the FIFO.

        Returns
        -------
        int
            Number of samples.
        """
        return 0 if self._empty else self.occupancy.least_fill(self.clock.now())

    @property
    def lost_at(self) -> float:
        """Time from which the timeout may switch off the output, which does no harm at 0 V [s]."""
        if self._lost:
            return 0.0
        return self.occupancy.dry_at + EARLY * TIMEOUT if self.last else math.inf

    def _burst(self, codes: Sequence[int]) -> None:
        # The port is connected before the time is read: a delay there may last until the timeout.
        self.target.connect()
        before = self.clock.now()
        if before > self.lost_at:
            self._lost = True
            raise LostError(f"{self.name}: ran empty for longer than its timeout")
        try:
            self.target.write(bytes([FIFO, *(code & 0xFF for code in codes)]))
        except OSError as error:
            self.unsure = self._lost = not was_not_acknowledged(error)
            raise
        after = self.clock.now()
        if self._empty:
            idle = before > self.occupancy.dry_at + EARLY * TIMEOUT
            self.occupancy.begin(len(codes), before, after + STARTUP * idle)
        else:
            self.occupancy.wrote(len(codes), before)
        self._empty = False
        same = all(code == self.last for code in codes)
        self._constant_samples = self._constant_samples + len(codes) if same else 0
        self._mark_taken(len(codes))
        if self._was_held:
            self._was_held = False
            self.counters.held_samples += int((before - self._full_until) * RATE) + 2
            self._check_power()
            self.occupancy.rates = self._new_rates or self.occupancy.rates
            self._new_rates = None

    def _check_power(self) -> None:
        """Check that the setup is intact, since a chip that lost its power seems empty."""
        if self._read(bytes([CONTROL_2]), 1)[0] != ACTIVE:
            self._lost = True
            raise LostError(f"{self.name}: lost its setup")

    def resolve(self) -> None:
        """Give up, since the chip does not tell how much of a burst it took.

        Raises
        ------
        LostError
            Always.
        """
        raise LostError(f"{self.name}: refused a burst half-way")

    def quiet(self) -> bool:
        """Return whether everything has been played.

        Returns
        -------
        bool
            Whether the FIFO is empty.
        """
        return bool(self._read_status() & EMPTY)

    def rest(self) -> None:
        """Enter STANDBY and verify that."""
        self._write_register(CONTROL_2, STANDBY | ACTIVE, 0xFF)
        self.silence()

    def reset(self) -> None:
        """Reset the chip, which stops at once and enters STANDBY."""
        self._write(bytes([CONTROL_2, DEV_RST]))
        self.silence()


class Drv2667Bus(ChipBus):
    """Bus of DRV2667 chips, which go to 0 V by themselves.

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
    wide : int
        Output range [V peak to peak].

    Raises
    ------
    BusError
        If a chip is missing.
    """

    on_host_death = "zero"

    def __init__(
        self, wiring: Wiring, place: Place, i2c: I2cAdapter, runner: Runner, *, wide: int
    ) -> None:
        make_chip = partial(Drv2667, wide=wide, step=wiring.slew / RATE)
        super().__init__(wiring, place, i2c, runner, make_chip)


class Drv2667Options(ChipOptions, frozen=True, kw_only=True):
    """Options of a URL ``drv2667:BUS?option=value&…``, where BUS is the number of the I2C bus.

    Attributes
    ----------
    address : tuple of int
        Address of the chips, which all have the same.
    range : str or None
        Range of the output, peak to peak [V]; by default the smallest that covers the voltage limit
        of the display.
    """

    address: tuple[Annotated[int, Meta(ge=ADDRESS, le=ADDRESS, extra=HEXADECIMAL)], ...] = ()
    range: Literal["50", "100", "150", "200"] | None = None


def _open(
    address: Address[Drv2667Options], display: DisplayLike, sample_rate: float | None
) -> ChipBus:
    """Open the bus of a display."""
    wide = chosen_range(display.limits.voltage, address.options.range)
    return open_chips(
        address, display, sample_rate, Drv2667, bits_per_second(),
        lambda wiring, place, i2c: Drv2667Bus(wiring, place, i2c, ThreadRunner(), wide=wide),
    )  # fmt: skip


def find_on(number: str, i2c: I2cAdapter) -> Iterator[FoundDevice]:
    """Yield the chip that answers on an adapter; chips behind multiplexers are not found.

    The chip is recognized by reading CONTROL_1.

    Parameters
    ----------
    number : str
        Number of the I2C bus.
    i2c : I2cAdapter
        Adapter of the bus.

    Yields
    ------
    FoundDevice
        URL and description of the chip.
    """
    reply = adapter.answer(i2c, ADDRESS, bytes([CONTROL_1]), 1)
    if reply and reply[0] >> 3 & 0xF == 7:
        yield FoundDevice(f"drv2667:{number}", f"DRV2667 at 0x{ADDRESS:02x} of I2C bus {number}")


find = partial(adapter.find_on_adapters, find_on)
"""Function that yields the chips which answer on the I2C adapters of this computer."""

register_bus("drv2667", _open, Drv2667Options, takes_path=True, on_host_death="zero", find=find)
