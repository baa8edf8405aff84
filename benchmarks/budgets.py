"""Capacity of links, counted in frames of real drive, and e-stops on saturated links.

The design's table of the largest number of channels (one amplifier, packets of 4 ms, 85 % of a
UART, 70 % of CAN, 80 % of I²C) is compared with what the frames of oak take, stuff bits included.
The design counted I²C transfers of any length. Transfers of 2 ms, as the protocol requires
(SPEC.md, 3.3), hold less at 400 kHz; both are reported. In entries up to 10, one channel less is
rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.protocol import oak_drive
from benchmarks.rendering import first_contactors
from firmware_protocol.can_link import CanEncoder
from firmware_protocol.host import codes_of, pcm
from firmware_protocol.i2c_link import DEFAULT_LIMIT
from firmware_protocol.messages import SampleFormat
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import encode_frame
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most
from tactile.bus.base import DriveBlock
from tactile.bus.registry import open_bus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.bus.wire_time import Can, I2c, Link, Uart, can_bits, fd_bits, i2c_bits, uart_bits
from tactile.display.display import load_display


@dataclass(frozen=True)
class LongI2c(I2c):
    """I²C whose transfers may take longer than 2 ms."""

    @property
    def name(self) -> str:
        """Name for people."""
        return f"{super().name} any length"

    def largest(self) -> int:
        """Return the size of the largest packet that a target accepts [bytes]."""
        return DEFAULT_LIMIT


TABLE: dict[Link, tuple[int, int, int, int, int]] = {
    Uart(1e6): (6, 9, 13, 19, 30),
    Uart(3e6): (20, 30, 41, 60, 95),
    Uart(12e6): (83, 124, 167, 243, 382),
    Can(1e6): (3, 4, 6, 9, 14),
    Can(1e6, 5e6): (25, 36, 50, 72, 114),
    Can(1e6, 8e6): (35, 52, 71, 103, 163),
    I2c(400e3): (2, 3, 5, 7, 11),
    LongI2c(400e3): (2, 3, 5, 7, 11),
    I2c(1e6): (6, 10, 13, 20, 31),
    I2c(3.4e6): (23, 35, 47, 69, 108),
}
"""Largest number of channels in the design, by link and coding."""
CODINGS = (
    (SampleFormat.PCM12, 8000), (SampleFormat.BFP8, 8000), (SampleFormat.PCM12, 4000),
    (SampleFormat.BFP8, 4000), (SampleFormat.BFP8, 2500),
)  # fmt: skip
"""Sample formats and sample rates [Hz] of the table's columns."""
SHORTEST = I2c(400e3)
"""Link for which the design's figures do not hold."""
BOARD = 255
"""Number of channels of an amplifier."""
TRIALS = 20
"""Number of e-stops on each link."""


def packet_seconds(link: Link, packet: Packet, encoder: CanEncoder) -> float:
    """Return the time that a packet takes on a link, counted bit by bit [s]."""
    if isinstance(link, Uart):
        return uart_bits(len(encode_frame(encode_packet(packet)))) / link.bit_rate
    if isinstance(link, I2c):
        return i2c_bits(len(encode_packet(packet))) / link.clock_hz
    assert isinstance(link, Can)
    frames = encoder.frames(packet)
    if link.data is None:
        return sum(can_bits(*frame) for frame in frames) / link.nominal
    return sum(fd_bits(*frame).seconds(link.nominal, link.data) for frame in frames)


def used(link: Link, kind: SampleFormat, rate: int, drive: Floats) -> float:
    """Return the fraction of a link that drive (S, C) takes at a sample rate [Hz]."""
    size = rate * 4 // 1000
    encoder = CanEncoder(from_amplifier=False, fd=isinstance(link, Can) and link.data is not None)
    total = 0.0
    for k in range(0, len(drive) - size + 1, size):
        for first in range(0, drive.shape[1], BOARD):
            codes = codes_of(drive[k : k + size, first : first + BOARD], 100.0)
            limit = link.largest()
            for message in pcm(k, codes, session=1, sample_format=kind, packet_limit=limit):
                total += packet_seconds(link, Packet.of(message, node=1), encoder)
    return total / (len(drive) // size * size / rate)


def _most(link: Link, kind: SampleFormat, rate: int, drive: Floats) -> int:
    """Return the largest number of channels that stays within the cap, by bisection."""
    low, high = 0, 500
    while high - low > 1:
        middle = (low + high) // 2
        columns = np.arange(middle) % drive.shape[1]
        fits = used(link, kind, rate, drive[:, columns]) <= link.cap
        low, high = (middle, high) if fits else (low, middle)
    return low


def measure_wire() -> Iterator[Figure]:
    """Compare the number of channels that links hold with the design's table; the worst counts."""
    drive = oak_drive()[800:1000] * 5
    for link, row in TABLE.items():
        shares = []
        for (kind, rate), expected in zip(CODINGS, row, strict=True):
            most = _most(link, kind, rate, drive)
            shares.append(1.0 if most == expected - 1 < 10 else most / expected)
        name = f"links.wire.{link.name.replace(' ', '_')}"
        goal = None if link == SHORTEST else 90
        yield at_least(name, 100 * min(shares), "% of the design's", goal)


SATURATED = {
    "uart_3M": ("mock:?link=serial&bit_rate=3000000&format=bfp8", 30),
    "can_1M": ("mock:?link=can&format=bfp8", 4),
    "canfd_1_5": ("mock:?link=canfd&format=bfp8", 35),
    "i2c_1M": ("mock:?link=i2c&bit_rate=1000000&format=bfp8", 9),
}
"""Saturated links: URL and number of channels, by name."""


def measure_estop() -> Iterator[Figure]:
    """Measure the time until 0 V of an e-stop at any moment on a saturated link at full drive."""
    random, whole = np.random.default_rng(0), load_display("reference-64")
    for name, (url, channels) in SATURATED.items():
        with open_bus(url, first_contactors(whole, channels), sample_rate=8000.0) as bus:
            assert isinstance(bus, ModeledBus)
            worst = max(_estop(bus, int(random.integers(400, 800))) for _ in range(TRIALS))
            use = 100 * bus.plan.use
        yield Figure(f"links.estop.{name}.wire", use, "%")
        yield at_most(f"links.estop.{name}", 1e3 * worst, "ms", 20)


def _estop(bus: ModeledBus, after: int) -> float:
    """Return the time from an e-stop, a number of samples after a start, to 0 V [s]."""
    (amplifier,) = bus.model.amplifiers
    time = np.arange(after + 64) / 8000
    tone = 100 * np.sin(2 * np.pi * 100 * time)[:, None] * np.minimum(time * 50, 1)[:, None]
    bus.start()
    for k in range(0, after, 16):
        bus.write(DriveBlock(k, np.repeat(tone[k : k + 16], bus.wiring.channels, axis=1)))
    pressed = bus.model.clock.now()
    bus.estop()
    while amplifier.high_voltage:
        bus.model.run_alone(bus.model.clock.now() + 0.25e-3)
    taken = bus.model.clock.now() - pressed
    bus.clear()
    return taken


def measure_budgets() -> Iterator[Figure]:
    """Measure the capacity of links and the delay of e-stops."""
    yield from measure_wire()
    yield from measure_estop()
