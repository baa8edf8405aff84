"""Time on the wire: how long UART, USB, CAN, CAN FD and I²C take for what is sent.

`Link` tells it of packets, and how much of the wire may be used; the functions count bits.

CAN's stuff bits depend on the data. `can_bits` and `fd_bits` count those of a frame's own bits, in
45 µs for 8 bytes; `can_estimate` and `fd_estimate` are arithmetic on the size, in 0.2 µs:

- "most": those that there can be. A sender that is paced by it is never faster than the wire.
- "mean": those of random data, one after each 30 bits, and one in the head. Drive at full
  scale has 1 to 2 % more bits on the wire than that, drive 30 dB down up to 5 %.
- "none".
"""

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from firmware_protocol.can_link import CLASSIC, FD, FD_SIZES
from firmware_protocol.fragments import LENGTH
from firmware_protocol.i2c_link import DEFAULT_LIMIT, SMBUS_BLOCK
from firmware_protocol.messages import FRAGMENT_TIMEOUT_MS, MESSAGES, PACKET_MAX, CanClass
from firmware_protocol.packet import SMALLEST
from firmware_protocol.serial_link import DELIMITER, coded_limit
from tactile.errors import InputError

Bits = list[int]
Stuffing = Literal["none", "mean", "most"]

UART_BITS = 10
"""A byte with 8N1: start, 8 data, stop."""
I2C_BITS = 9
"""A byte with its acknowledge (NXP UM10204, 3.1.5)."""
CAN_TAIL = 1 + 2 + 7 + 3
"""CRC delimiter, acknowledge with its delimiter, end of frame, intermission (ISO 11898-1)."""
CAN_CRC, FD_CRC_17, FD_CRC_21 = 15, 17, 21
CAN_POLYNOMIAL = 0x4599
FD_SHORT = 16
"""Data bytes up to which CAN FD has the CRC of 17 bits."""
FD_START = 1 + 4
"""ESI and DLC."""
STUFF_COUNT = 4
"""Bits of CAN FD's stuff count, parity included; before it and after each 4 bits a fixed one."""
BASE_ID = 0x7FF
"""Largest identifier of 11 bits; beyond it they have 29."""
CAN_HEAD, CAN_HEAD_29 = 19, 39
"""Bits to the DLC, that included, with an identifier of 11 and of 29 bits."""
FD_HEAD, FD_HEAD_29 = 17, 36
"""Bits to BRS, that included."""
MEAN_SPACING = 30
"""Random bits from stuff bit to stuff bit: after one, or a change, four more of its kind must
follow, which takes 2⁵ − 2 on average."""
HEAD_SPACING = 17
"""Bits of a head to a stuff bit, as those with a low node have them: 1, with 29 bits 2."""


I2C_SECONDS = 2e-3
"""Longest transfer (SPEC.md, 3.3)."""
HIGH_SPEED = 1e6
"""Hz beyond which each transfer begins with a controller code in fast mode (UM10204, 5.3.1)."""
HIGH_SPEED_CODE = 10 / 400e3
"""s, at most: start, code, no acknowledge."""
CAN_SECONDS = FRAGMENT_TIMEOUT_MS * 1e-3 / 2
"""Longest transfer: half of what a receiver waits for, the rest is for other frames in between."""
LEAST_PACKET = 52
"""Bytes that the slowest links carry at once, however long it takes: 16 carriers of a channel."""


# Bits


class FdTime(NamedTuple):
    """Bits of a CAN FD frame at the two bit rates."""

    nominal: float
    data: float

    def seconds(self, nominal_rate: float, data_rate: float) -> float:
        """Return how long it takes."""
        return self.nominal / nominal_rate + self.data / data_rate


def uart_bits(size: int) -> int:
    """Return the bits of bytes on a UART."""
    return UART_BITS * size


def i2c_bits(size: int) -> int:
    """Return the bits of a transfer of bytes: start, address, bytes, stop."""
    return 1 + I2C_BITS * (1 + size) + 1


def smbus_write_bits(size: int) -> int:
    """Return the bits of a block write: start, address, command, count, bytes, stop."""
    return i2c_bits(2 + size)


def smbus_read_bits(size: int) -> int:
    """Return the bits of a block read: as written, but for a second start with the address."""
    return i2c_bits(3 + size) + 1


def can_estimate(size: int, stuffing: Stuffing = "most", *, extended: bool = False) -> float:
    """Return the bits of a classic frame: 44 + 8 n + 3 and stuff bits, 20 more if ``extended``.

    The most are ⌊(34 + 8 n − 1) / 4⌋, of 54 with 29-bit identifiers (Davis et al. 2007).
    """
    head, rest = CAN_HEAD_29 if extended else CAN_HEAD, 8 * size + CAN_CRC
    extra: float = 0
    if stuffing == "most":
        extra = (head + rest - 1) // 4
    elif stuffing == "mean":
        extra = head // HEAD_SPACING + rest / MEAN_SPACING
    return head + rest + extra + CAN_TAIL


def fd_estimate(size: int, stuffing: Stuffing = "most", *, extended: bool = False) -> FdTime:
    """Return the bits of an FD frame with bit-rate switching.

    Nominal: SOF, identifier, RRS, IDE, FDF, res, BRS (17; with 29-bit identifiers SRR and 18 bits
    more); CRC delimiter and what follows (13). Data: ESI, DLC, 8 n, stuff count 4, CRC 17 or 21,
    and one fixed stuff bit before and after each 4 of those: 6 or 7. Up to the last data bit stuff
    bits are as in classic CAN.
    """
    head, body = FD_HEAD_29 if extended else FD_HEAD, FD_START + 8 * size
    check = STUFF_COUNT + (FD_CRC_17 if size <= FD_SHORT else FD_CRC_21)
    slow: float = 0
    fast: float = 0
    if stuffing == "most":
        slow, fast = (head - 1) // 4, body // 4
    elif stuffing == "mean":
        slow, fast = head // HEAD_SPACING, body / MEAN_SPACING
    return FdTime(head + slow + CAN_TAIL, body + fast + check + check // 4 + 1)


def can_bits(identifier: int, data: bytes) -> int:
    """Return the bits of a classic frame with its own stuff bits."""
    reserved = [0, 0] if identifier > BASE_ID else [0]
    body = [*_address(identifier), *reserved, *_bits(len(data), 4), *_data_bits(data)]
    body += _bits(can_crc(body), CAN_CRC)
    return len(body) + sum(stuffed(body)) + CAN_TAIL


def fd_bits(identifier: int, data: bytes) -> FdTime:
    """Return the bits of an FD frame with its own stuff bits; the DLC's value is taken as 15."""
    head = [*_address(identifier), 1, 0, 1]
    own = stuffed([*head, 0, *_bits(15, 4), *_data_bits(data)])
    plain = fd_estimate(len(data), "none", extended=identifier > BASE_ID)
    split = len(head)
    return FdTime(plain.nominal + sum(own[:split]), plain.data + sum(own[split:]))


def can_crc(bits: Iterable[int]) -> int:
    """Return the CRC-15 of ISO 11898-1."""
    crc = 0
    for bit in bits:
        crc = crc << 1 ^ (CAN_POLYNOMIAL if (crc >> 14 & 1) ^ bit else 0)
        crc &= 0x7FFF
    return crc


def stuffed(bits: Bits) -> list[int]:
    """Return, for each bit, 1 where a stuff bit follows it: after five of a kind, its own counted.

    A stuff bit begins the next five.
    """
    follows, last, run = [], -1, 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        follows.append(int(run == 5))
        if run == 5:
            last, run = 1 - bit, 1
    return follows


def _address(identifier: int) -> Bits:
    """Return SOF, identifier, RTR or RRS, and IDE; where it has 29 bits SRR and IDE lie within."""
    if identifier > BASE_ID:
        return [0, *_bits(identifier >> 18, 11), 1, 1, *_bits(identifier, 18), 0]
    return [0, *_bits(identifier, 11), 0, 0]


def _bits(value: int, count: int) -> Bits:
    return [value >> k & 1 for k in range(count - 1, -1, -1)]


def _data_bits(data: bytes) -> Bits:
    return [bit for byte in data for bit in _bits(byte, 8)]


# Links


class Link(ABC):
    """A wire, and what may be used of it.

    Attributes
    ----------
    name : for people
    cap : fraction of the wire that may be used
    """

    cap: float

    @property
    @abstractmethod
    def name(self) -> str: ...  # noqa: D102

    @abstractmethod
    def seconds(self, packet: bytes) -> float:
        """Return the longest time on the wire [s] of a packet of the host, CRC-32 included.

        Who paces by it never sends faster than the wire. It takes 0.3 to 5 µs, whatever the size.
        """

    def mean_seconds(self, packet: bytes) -> float:
        """Return the time that a packet of random data takes on average [s]."""
        return self.seconds(packet)

    def answer_seconds(self, packet: bytes) -> float:
        """Return the time that the host's direction is held up by an amplifier's packet [s]."""
        return 0.0

    def largest(self) -> int:
        """Return the most bytes that a packet should have."""
        return PACKET_MAX


def above_zero(what: str, value: float, unit: str) -> None:
    """Raise InputError for a value that is not."""
    if not 0 < value < math.inf:
        raise InputError(f"{what} {value:g} {unit}: must be finite and above 0 {unit}")


def _scaled(value: float, unit: str) -> str:
    scale, prefix = (1e6, "M") if value >= 1e6 else (1e3, "k")
    return f"{value / scale:g} {prefix}{unit}"


def _blocks(packet: bytes) -> list[int]:
    """Return the bytes of a packet's SMBus blocks."""
    full, rest = divmod(LENGTH.size + len(packet) - 1, SMBUS_BLOCK - 1)
    return [SMBUS_BLOCK] * full + [rest + 2]


def _coded(packet: bytes) -> int:
    """Return the most bytes of a packet on a serial line."""
    return coded_limit(len(packet)) + len(DELIMITER)


@dataclass(frozen=True)
class Uart(Link):
    """8N1, both ways at once; ``bit_rate`` [bit/s]."""

    bit_rate: float
    cap = 0.85

    def __post_init__(self) -> None:
        above_zero("UART", self.bit_rate, "bit/s")

    @property
    def name(self) -> str:  # noqa: D102
        return f"UART {_scaled(self.bit_rate, 'bit/s')}"

    def seconds(self, packet: bytes) -> float:  # noqa: D102
        return uart_bits(_coded(packet)) / self.bit_rate


@dataclass(frozen=True)
class Usb(Link):
    """CDC; ``bytes_per_s`` one way, by default of full speed (assumed; 1.2 are the limit)."""

    bytes_per_s: float = 0.8e6
    cap = 0.85

    def __post_init__(self) -> None:
        above_zero("USB", self.bytes_per_s, "B/s")

    @property
    def name(self) -> str:  # noqa: D102
        return f"USB {_scaled(self.bytes_per_s, 'B/s')}"

    def seconds(self, packet: bytes) -> float:  # noqa: D102
        return _coded(packet) / self.bytes_per_s


@dataclass(frozen=True)
class Can(Link):
    """CAN of ``nominal`` bit/s, or CAN FD with its ``data`` phase at so many; shared both ways.

    ``extended``: identifiers of 29 bits, where CANopen shares the bus.
    """

    nominal: float
    data: float | None = None
    extended: bool = False
    cap = 0.70

    def __post_init__(self) -> None:
        above_zero("CAN", self.nominal, "bit/s")
        above_zero("CAN FD", self.nominal if self.data is None else self.data, "bit/s")

    @property
    def name(self) -> str:  # noqa: D102
        if self.data is None:
            return f"CAN {_scaled(self.nominal, 'bit/s')}"
        return f"CAN FD {self.nominal / 1e6:g}/{self.data / 1e6:g} Mbit/s"

    def seconds(self, packet: bytes) -> float:  # noqa: D102
        return self._packet_seconds(packet, "most")

    def mean_seconds(self, packet: bytes) -> float:  # noqa: D102
        return self._packet_seconds(packet, "mean")

    def answer_seconds(self, packet: bytes) -> float:  # noqa: D102
        return self.mean_seconds(packet)

    def largest(self) -> int:
        """Return what a receiver puts together in time."""
        frames = int(CAN_SECONDS / self._frame_seconds(self._frame, "most"))
        return min(max(frames * (self._frame - 1) - LENGTH.size, LEAST_PACKET), PACKET_MAX)

    @property
    def _frame(self) -> int:
        return CLASSIC if self.data is None else FD

    def _frame_seconds(self, size: int, stuffing: Stuffing) -> float:
        if self.data is None:
            return can_estimate(size, stuffing, extended=self.extended) / self.nominal
        bits = fd_estimate(size, stuffing, extended=self.extended)
        return bits.seconds(self.nominal, self.data)

    def _packet_seconds(self, packet: bytes, stuffing: Stuffing) -> float:
        """Count full frames and the last; a START is counted as if it were no prompt frame."""
        kind, payload = MESSAGES[packet[0]].CAN, len(packet) - SMALLEST
        if kind in (CanClass.ESTOP, CanClass.PULSE):
            return self._frame_seconds(payload, stuffing)
        if kind == CanClass.PROMPT:
            return self._frame_seconds(1 + payload, stuffing)
        full, rest = divmod(LENGTH.size + len(packet) - 1, self._frame - 1)
        last = next(size for size in FD_SIZES if size >= rest + 2)
        return full * self._frame_seconds(self._frame, stuffing) + self._frame_seconds(
            last, stuffing
        )


@dataclass(frozen=True)
class I2c(Link):
    """I²C of ``clock_hz``, shared both ways; ``smbus``: in block writes and reads."""

    clock_hz: float
    smbus: bool = False
    cap = 0.80

    def __post_init__(self) -> None:
        above_zero("I2C", self.clock_hz, "Hz")

    @property
    def name(self) -> str:  # noqa: D102
        return f"{'SMBus' if self.smbus else 'I2C'} {_scaled(self.clock_hz, 'Hz')}"

    def seconds(self, packet: bytes) -> float:  # noqa: D102
        if self.smbus:
            return self._transfers(map(smbus_write_bits, _blocks(packet)))
        return self._transfers([i2c_bits(len(packet))])

    def answer_seconds(self, packet: bytes) -> float:
        """Return the time of the reads that fetch it."""
        if self.smbus:
            return self._transfers(map(smbus_read_bits, _blocks(packet)))
        return self._transfers([i2c_bits(LENGTH.size + len(packet))])

    def _transfers(self, bits: Iterable[int]) -> float:
        code = HIGH_SPEED_CODE if self.clock_hz > HIGH_SPEED else 0.0
        return sum(count / self.clock_hz + code for count in bits)

    def largest(self) -> int:
        """Return what a target takes, and one transfer in time."""
        if self.smbus:
            return DEFAULT_LIMIT
        most = bisect_right(range(DEFAULT_LIMIT + 1), I2C_SECONDS * self.clock_hz, key=i2c_bits) - 1
        return max(most, LEAST_PACKET)


@dataclass(frozen=True)
class Unlimited(Link):
    """A link that is never full: memory, TCP."""

    cap = 1.0
    name = "no limit"

    def seconds(self, packet: bytes) -> float:  # noqa: D102
        return 0.0
