"""Time on the wire of UART, USB, CAN, CAN FD and I²C.

A `Link` tells how long packets take and which fraction of the wire may be used. The functions count
bits.

The number of stuff bits on CAN depends on the data. `can_bits` and `fd_bits` count those of a given
frame, which takes 45 µs for 8 bytes. `can_estimate` and `fd_estimate` compute them from the size,
which takes 0.2 µs:

- "most": the largest possible number. A sender that is paced by it is never faster than the wire.
- "mean": the number for random data, one for each 30 bits and one in the head. Drive at full scale
  has 1 to 2 % more bits on the wire than that, drive 30 dB below up to 5 % more.
- "none": no stuff bits.
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
"""Length of a byte with 8N1, start bit, 8 data bits, stop bit [bits]."""
I2C_BITS = 9
"""Length of a byte with its acknowledge (NXP UM10204, 3.1.5) [bits]."""
CAN_TAIL = 1 + 2 + 7 + 3
"""Length of what follows the CRC (ISO 11898-1) [bits].

It consists of the CRC delimiter, the acknowledge with its delimiter, the end of frame and the
intermission.
"""
CAN_CRC, FD_CRC_17, FD_CRC_21 = 15, 17, 21
"""Lengths of the CRCs of classic CAN and CAN FD [bits]."""
CAN_POLYNOMIAL = 0x4599
"""Generator polynomial of the CRC-15 (ISO 11898-1)."""
FD_SHORT = 16
"""Largest number of data bytes for which CAN FD uses the CRC of 17 bits."""
FD_START = 1 + 4
"""Length of ESI and DLC [bits]."""
STUFF_COUNT = 4
"""Length of CAN FD's stuff count, parity included [bits].

A fixed stuff bit precedes it and follows each 4 bits.
"""
BASE_ID = 0x7FF
"""Largest identifier of 11 bits; larger ones have 29 bits."""
CAN_HEAD, CAN_HEAD_29 = 19, 39
"""Lengths of a head through the DLC, with an identifier of 11 and of 29 bits [bits]."""
FD_HEAD, FD_HEAD_29 = 17, 36
"""Lengths of a head through BRS, with an identifier of 11 and of 29 bits [bits]."""
MEAN_SPACING = 30
"""Mean number of random bits from one stuff bit to the next.

After a stuff bit or a change, four more equal bits must follow, which takes 2⁵ − 2 bits on average.
"""
HEAD_SPACING = 17
"""Number of bits of a head for each stuff bit, as in heads with a low node number.

There is 1 stuff bit with 11-bit identifiers, and 2 with 29 bits.
"""


I2C_SECONDS = 2e-3
"""Longest transfer on I²C (firmware_protocol/SPEC.md, 3.3) [s]."""
HIGH_SPEED = 1e6
"""Clock above which transfers begin with a controller code in fast mode [Hz].

UM10204, 5.3.1.
"""
HIGH_SPEED_CODE = 10 / 400e3
"""Longest duration of the controller code: start, code, no acknowledge [s]."""
CAN_SECONDS = FRAGMENT_TIMEOUT_MS * 1e-3 / 2
"""Longest transfer of a packet on CAN [s].

It is half of the time that a receiver waits for fragments; the rest is for other frames in between.
"""
LEAST_PACKET = 52
"""Size of packets that even the slowest links carry at once, 16 carriers of a channel [bytes].

It applies however long they take.
"""


# Bits


class FdTime(NamedTuple):
    """Length of a CAN FD frame at each of the two bit rates.

    Attributes
    ----------
    nominal : float
        Length of the part at the nominal bit rate [bits].
    data : float
        Length of the part at the data bit rate [bits].
    """

    nominal: float
    data: float

    def seconds(self, nominal_rate: float, data_rate: float) -> float:
        """Return the duration of the frame.

        Parameters
        ----------
        nominal_rate : float
            Nominal bit rate [bit/s].
        data_rate : float
            Bit rate of the data phase [bit/s].

        Returns
        -------
        float
            Duration [s].
        """
        return self.nominal / nominal_rate + self.data / data_rate


def uart_bits(size: int) -> int:
    """Return the length of bytes on a UART.

    Parameters
    ----------
    size : int
        Number of bytes.

    Returns
    -------
    int
        Length [bits].
    """
    return UART_BITS * size


def i2c_bits(size: int, read: int = 0) -> int:
    """Return the length of an I²C transfer: start, address, bytes, stop.

    Parameters
    ----------
    size : int
        Number of bytes that are written, or that are read if none are written.
    read : int
        Number of bytes that are read after a repeated start, with an address of its own.

    Returns
    -------
    int
        Length [bits].
    """
    return 1 + I2C_BITS * (1 + size) + 1 + (1 + I2C_BITS * (1 + read) if read else 0)


def smbus_write_bits(size: int) -> int:
    """Return the length of an SMBus block write.

    It has a start, address, command, count, bytes and a stop.

    Parameters
    ----------
    size : int
        Number of bytes.

    Returns
    -------
    int
        Length [bits].
    """
    return i2c_bits(2 + size)


def smbus_read_bits(size: int) -> int:
    """Return the length of an SMBus block read.

    It has a start, address and command, a second start with the address, count, bytes and a stop.

    Parameters
    ----------
    size : int
        Number of bytes.

    Returns
    -------
    int
        Length [bits].
    """
    return i2c_bits(1, 1 + size)


def can_estimate(size: int, stuffing: Stuffing = "most", *, extended: bool = False) -> float:
    """Estimate the length of a classic CAN frame from its size.

    Without stuff bits it has 44 + 8 n + 3 bits, 20 more with 29-bit identifiers. The largest number
    of stuff bits is ⌊(34 + 8 n − 1) / 4⌋, with 54 in place of 34 for 29-bit identifiers (Davis et
    al. 2007).

    Parameters
    ----------
    size : int
        Number of data bytes.
    stuffing : str
        Stuff bits to count: "most", "mean" or "none".
    extended : bool
        Whether the identifier has 29 bits.

    Returns
    -------
    float
        Length [bits].
    """
    head, rest = CAN_HEAD_29 if extended else CAN_HEAD, 8 * size + CAN_CRC
    extra: float = 0
    if stuffing == "most":
        extra = (head + rest - 1) // 4
    elif stuffing == "mean":
        extra = head // HEAD_SPACING + rest / MEAN_SPACING
    return head + rest + extra + CAN_TAIL


def fd_estimate(size: int, stuffing: Stuffing = "most", *, extended: bool = False) -> FdTime:
    """Estimate the length of a CAN FD frame with bit-rate switching from its size.

    At the nominal rate there are SOF, identifier, RRS, IDE, FDF, res and BRS (17 bits; with 29-bit
    identifiers SRR and 18 more), and the CRC delimiter with what follows (13 bits). At the data
    rate there are ESI, DLC, 8 n data bits, the stuff count of 4, the CRC of 17 or 21, and a fixed
    stuff bit before these two and after each 4 of their bits: 6 or 7. Stuff bits up to the last
    data bit are as in classic CAN.

    Parameters
    ----------
    size : int
        Number of data bytes.
    stuffing : str
        Stuff bits to count: "most", "mean" or "none".
    extended : bool
        Whether the identifier has 29 bits.

    Returns
    -------
    FdTime
        Length at each bit rate [bits].
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
    """Return the length of a classic CAN frame, with the stuff bits of its content.

    Parameters
    ----------
    identifier : int
        Identifier; above 0x7FF it has 29 bits.
    data : bytes
        Data of the frame.

    Returns
    -------
    int
        Length [bits].
    """
    reserved = [0, 0] if identifier > BASE_ID else [0]
    body = [*_address(identifier), *reserved, *_bits(len(data), 4), *_data_bits(data)]
    body += _bits(can_crc(body), CAN_CRC)
    return len(body) + sum(stuffed(body)) + CAN_TAIL


def fd_bits(identifier: int, data: bytes) -> FdTime:
    """Return the length of a CAN FD frame, with the stuff bits of its content.

    The value of the DLC is taken as 15.

    Parameters
    ----------
    identifier : int
        Identifier; above 0x7FF it has 29 bits.
    data : bytes
        Data of the frame.

    Returns
    -------
    FdTime
        Length at each bit rate [bits].
    """
    head = [*_address(identifier), 1, 0, 1]
    stuff_bits = stuffed([*head, 0, *_bits(15, 4), *_data_bits(data)])
    plain = fd_estimate(len(data), "none", extended=identifier > BASE_ID)
    split = len(head)
    return FdTime(plain.nominal + sum(stuff_bits[:split]), plain.data + sum(stuff_bits[split:]))


def can_crc(bits: Iterable[int]) -> int:
    """Compute the CRC-15 of ISO 11898-1.

    Parameters
    ----------
    bits : iterable of int
        Bits from the start of frame, without stuff bits.

    Returns
    -------
    int
        CRC.
    """
    crc = 0
    for bit in bits:
        crc = crc << 1 ^ (CAN_POLYNOMIAL if (crc >> 14 & 1) ^ bit else 0)
        crc &= 0x7FFF
    return crc


def stuffed(bits: Bits) -> list[int]:
    """Return for each bit whether a stuff bit follows it.

    A stuff bit follows five equal bits. It is itself the first of the next five.

    Parameters
    ----------
    bits : list of int
        Bits without stuff bits.

    Returns
    -------
    list of int
        1 for each bit that a stuff bit follows, otherwise 0.
    """
    follows, previous, run = [], -1, 0
    for bit in bits:
        run = run + 1 if bit == previous else 1
        previous = bit
        follows.append(int(run == 5))
        if run == 5:
            previous, run = 1 - bit, 1
    return follows


def _address(identifier: int) -> Bits:
    """Return SOF, identifier, RTR or RRS, and IDE.

    With a 29-bit identifier SRR and IDE lie within it.
    """
    if identifier > BASE_ID:
        return [0, *_bits(identifier >> 18, 11), 1, 1, *_bits(identifier, 18), 0]
    return [0, *_bits(identifier, 11), 0, 0]


def _bits(value: int, count: int) -> Bits:
    """Return the lowest bits of a value, most significant bit first."""
    return [value >> k & 1 for k in range(count - 1, -1, -1)]


def _data_bits(data: bytes) -> Bits:
    return [bit for byte in data for bit in _bits(byte, 8)]


# Links


class Link(ABC):
    """Link to amplifiers: how long packets take, and what part of it may be used.

    Attributes
    ----------
    name : str
        Name for messages.
    cap : float
        Fraction of the wire that may be used.
    """

    cap: float

    @property
    @abstractmethod
    def name(self) -> str:
        """Name for messages."""

    @abstractmethod
    def seconds(self, packet: bytes) -> float:
        """Return the longest time that a packet of the host takes on the wire.

        A sender that is paced by it never sends faster than the wire. The computation takes 0.3 to
        5 µs, whatever the size.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """

    def mean_seconds(self, packet: bytes) -> float:
        """Return the mean time that a packet of random data takes on the wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return self.seconds(packet)

    def answer_seconds(self, packet: bytes) -> float:
        """Return the time that a packet of an amplifier occupies the direction of the host.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return 0.0

    def reply_seconds(self, packet: bytes) -> float:
        """Return the time that a packet of an amplifier takes in its own direction.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s]; that of `answer_seconds` where both directions share the wire.
        """
        return self.answer_seconds(packet) or self.mean_seconds(packet)

    def largest(self) -> int:
        """Return the largest size that a packet should have.

        Returns
        -------
        int
            Size [bytes].
        """
        return PACKET_MAX


def above_zero(what: str, value: float, unit: str) -> None:
    """Check that a value is finite and above 0.

    Parameters
    ----------
    what : str
        Name of the value, for messages.
    value : float
        Value to check.
    unit : str
        Unit of the value.

    Raises
    ------
    InputError
        If it is not.
    """
    if not 0 < value < math.inf:
        raise InputError(f"{what} {value:g} {unit}: must be finite and above 0 {unit}")


def _scaled(value: float, unit: str) -> str:
    """Format a value with the prefix k or M."""
    scale, prefix = (1e6, "M") if value >= 1e6 else (1e3, "k")
    return f"{value / scale:g} {prefix}{unit}"


def _blocks(packet: bytes) -> list[int]:
    """Return the size of each of the SMBus blocks of a packet [bytes]."""
    full, rest = divmod(LENGTH.size + len(packet) - 1, SMBUS_BLOCK - 1)
    return [SMBUS_BLOCK] * full + [rest + 2]


def _coded(packet: bytes) -> int:
    """Return the largest size of a packet on a serial line [bytes]."""
    return coded_limit(len(packet)) + len(DELIMITER)


@dataclass(frozen=True)
class Uart(Link):
    """UART with 8N1, which sends and receives at the same time.

    Parameters
    ----------
    bit_rate : float
        Bit rate [bit/s].
    """

    bit_rate: float
    cap = 0.85

    def __post_init__(self) -> None:
        above_zero("UART", self.bit_rate, "bit/s")

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"UART {_scaled(self.bit_rate, 'bit/s')}"

    def seconds(self, packet: bytes) -> float:
        """Return the longest time that a packet takes on the wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return uart_bits(_coded(packet)) / self.bit_rate


@dataclass(frozen=True)
class Usb(Link):
    """USB CDC.

    Parameters
    ----------
    bytes_per_s : float
        Throughput of one direction [B/s]. The default is assumed for full speed, whose limit is 1.2
        MB/s.
    """

    bytes_per_s: float = 0.8e6
    cap = 0.85

    def __post_init__(self) -> None:
        above_zero("USB", self.bytes_per_s, "B/s")

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"USB {_scaled(self.bytes_per_s, 'B/s')}"

    def seconds(self, packet: bytes) -> float:
        """Return the longest time that a packet takes on the wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return _coded(packet) / self.bytes_per_s


@dataclass(frozen=True)
class Can(Link):
    """CAN or CAN FD, which both directions share.

    Parameters
    ----------
    nominal : float
        Nominal bit rate [bit/s].
    data : float or None
        Bit rate of the data phase of CAN FD [bit/s]; None for classic CAN.
    extended : bool
        Whether identifiers have 29 bits, as where CANopen shares the bus.
    """

    nominal: float
    data: float | None = None
    extended: bool = False
    cap = 0.70

    def __post_init__(self) -> None:
        above_zero("CAN", self.nominal, "bit/s")
        above_zero("CAN FD", self.nominal if self.data is None else self.data, "bit/s")

    @property
    def name(self) -> str:
        """Name for messages."""
        if self.data is None:
            return f"CAN {_scaled(self.nominal, 'bit/s')}"
        return f"CAN FD {self.nominal / 1e6:g}/{self.data / 1e6:g} Mbit/s"

    def seconds(self, packet: bytes) -> float:
        """Return the longest time that a packet takes on the wire, with the most stuff bits.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return self._packet_seconds(packet, "most")

    def mean_seconds(self, packet: bytes) -> float:
        """Return the mean time that a packet of random data takes on the wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return self._packet_seconds(packet, "mean")

    def answer_seconds(self, packet: bytes) -> float:
        """Return the mean time of a packet, since amplifiers send on the same wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return self.mean_seconds(packet)

    def largest(self) -> int:
        """Return the largest packet that a receiver can reassemble in time.

        Returns
        -------
        int
            Size [bytes].
        """
        frames = int(CAN_SECONDS / self._frame_seconds(self._frame, "most"))
        return min(max(frames * (self._frame - 1) - LENGTH.size, LEAST_PACKET), PACKET_MAX)

    @property
    def _frame(self) -> int:
        """Number of data bytes of a full frame."""
        return CLASSIC if self.data is None else FD

    def _frame_seconds(self, size: int, stuffing: Stuffing) -> float:
        """Return the time of a frame of so many data bytes [s]."""
        if self.data is None:
            return can_estimate(size, stuffing, extended=self.extended) / self.nominal
        bits = fd_estimate(size, stuffing, extended=self.extended)
        return bits.seconds(self.nominal, self.data)

    def _packet_seconds(self, packet: bytes, stuffing: Stuffing) -> float:
        """Add the times of full frames and the last one.

        A START counts as if it were not a prompt frame.
        """
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
    """I²C, which both directions share.

    Parameters
    ----------
    clock_hz : float
        Clock [Hz].
    smbus : bool
        Whether packets are sent as SMBus block writes and reads.
    """

    clock_hz: float
    smbus: bool = False
    cap = 0.80

    def __post_init__(self) -> None:
        above_zero("I2C", self.clock_hz, "Hz")

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"{'SMBus' if self.smbus else 'I2C'} {_scaled(self.clock_hz, 'Hz')}"

    def seconds(self, packet: bytes) -> float:
        """Return the longest time that a packet takes on the wire.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        if self.smbus:
            return self._transfers(map(smbus_write_bits, _blocks(packet)))
        return self._transfers([i2c_bits(len(packet))])

    def answer_seconds(self, packet: bytes) -> float:
        """Return the time of the reads that fetch a packet of an amplifier.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        if self.smbus:
            return self._transfers(map(smbus_read_bits, _blocks(packet)))
        return self._transfers([i2c_bits(LENGTH.size + len(packet))])

    def _transfers(self, bits: Iterable[int]) -> float:
        """Return the time of transfers of these lengths [s]."""
        code = HIGH_SPEED_CODE if self.clock_hz > HIGH_SPEED else 0.0
        return sum(count / self.clock_hz + code for count in bits)

    def largest(self) -> int:
        """Return the largest packet that a target takes and one transfer carries in time.

        Returns
        -------
        int
            Size [bytes].
        """
        if self.smbus:
            return DEFAULT_LIMIT
        most = bisect_right(range(DEFAULT_LIMIT + 1), I2C_SECONDS * self.clock_hz, key=i2c_bits) - 1
        return max(most, LEAST_PACKET)


@dataclass(frozen=True)
class Unlimited(Link):
    """Link that is never full, such as memory or TCP."""

    cap = 1.0
    name = "no limit"

    def seconds(self, packet: bytes) -> float:
        """Return 0, since a packet takes no time.

        Parameters
        ----------
        packet : bytes
            Packet of the protocol, CRC-32 included.

        Returns
        -------
        float
            Time [s].
        """
        return 0.0
