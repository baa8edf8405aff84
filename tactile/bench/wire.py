"""Bits on the wire: how long UART, CAN, CAN FD and I²C take for the frames that are sent.

Stuff bits are those of the frame's own bits, unless the most that there can be is asked for.
"""

from collections.abc import Iterable
from typing import NamedTuple

Bits = list[int]

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
STUFF_COUNT = 4
"""Bits of CAN FD's stuff count, parity included; before it and after each 4 bits a fixed one."""


class FdTime(NamedTuple):
    """Bits of a CAN FD frame at the two bit rates."""

    nominal: int
    data: int

    def seconds(self, nominal_rate: float, data_rate: float) -> float:
        """Return how long it takes."""
        return self.nominal / nominal_rate + self.data / data_rate


def _bits(value: int, count: int) -> Bits:
    return [value >> k & 1 for k in range(count - 1, -1, -1)]


def _data_bits(data: bytes) -> Bits:
    return [bit for byte in data for bit in _bits(byte, 8)]


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


def uart_bits(data: bytes) -> int:
    """Return the bits of bytes on a UART."""
    return UART_BITS * len(data)


def can_bits(identifier: int, data: bytes, *, stuffing: str = "own") -> int:
    """Return the bits of a classic frame with 11-bit identifier, 44 + 8 n + 3 and stuff bits.

    ``stuffing`` is "none", "own" or "most": ⌊(34 + 8 n − 1) / 4⌋ (Davis et al. 2007).
    """
    head = [0, *_bits(identifier, 11), 0, 0, 0, *_bits(len(data), 4)]
    body = head + _data_bits(data)
    body += _bits(can_crc(body), CAN_CRC)
    extra = {"none": 0, "own": sum(stuffed(body)), "most": (len(body) - 1) // 4}
    return len(body) + extra[stuffing] + CAN_TAIL


def fd_bits(identifier: int, data: bytes, *, stuffing: str = "own") -> FdTime:
    """Return the bits of an FD frame with 11-bit identifier and bit-rate switching.

    Nominal: SOF, identifier, RRS, IDE, FDF, res, BRS (17); CRC delimiter and what follows (13).
    Data: ESI, DLC, 8 n, stuff count 4, CRC 17 or 21, and one fixed stuff bit before and after each
    4 of those: 6 or 7. Up to the last data bit stuff bits are as in classic CAN; the DLC's value
    is taken as 15.
    """
    arbitration = [0, *_bits(identifier, 11), 0, 0, 1, 0, 1]
    body = [0, *_bits(15, 4), *_data_bits(data)]
    check = STUFF_COUNT + (FD_CRC_17 if len(data) <= FD_SHORT else FD_CRC_21)
    fixed = check // 4 + 1
    own = stuffed(arbitration + body)
    split = len(arbitration)
    slow, fast = {
        "none": (0, 0),
        "own": (sum(own[:split]), sum(own[split:])),
        "most": ((split - 1) // 4, len(body) // 4),
    }[stuffing]
    return FdTime(split + slow + CAN_TAIL, len(body) + fast + check + fixed)


def i2c_bits(data: bytes) -> int:
    """Return the bits of a transfer: start, address, bytes, stop."""
    return 1 + I2C_BITS * (1 + len(data)) + 1
