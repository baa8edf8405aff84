"""Targets of an emulated I²C bus."""

import os
import time
from collections import deque
from errno import ENXIO
from typing import Protocol

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.i2c_link import READ_COMMAND, WRITE_COMMAND
from firmware_protocol.ports import I2cPort


class Target(Protocol):
    """Target at an address; an OSError is what the caller of the driver gets."""

    def write(self, data: bytes) -> None:
        """Take what is written from a start to the next start or stop."""

    def read(self, size: int) -> bytes:
        """Return what is read."""


class I2cBus:
    """Targets by address; no other address is acknowledged."""

    def __init__(self, targets: dict[int, Target]) -> None:
        self.targets = targets
        self.refusals: deque[int] = deque()
        """Error codes of the transfers to come, which reach no target."""

    def write(self, address: int, data: bytes) -> None:
        """Write to a target."""
        self._target(address).write(data)

    def read(self, address: int, size: int) -> bytes:
        """Read from a target."""
        return self._target(address).read(size)

    def _target(self, address: int) -> Target:
        code = self.refusals.popleft() if self.refusals else 0
        if not code and address not in self.targets:
            code = ENXIO
        if code:
            raise OSError(code, os.strerror(code))
        return self.targets[address]


class AmplifierTarget:
    """An amplifier of ours, in real time from its construction on."""

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier
        self._port = I2cPort(amplifier)
        self._begin = time.monotonic()
        self._block = False

    def write(self, data: bytes) -> None:
        """Take a packet, an SMBus block or the command of a block read."""
        self._block = data == bytes([READ_COMMAND])
        if not data or self._block:
            return
        if data[0] == WRITE_COMMAND:
            self._port.write_block(data[2:], self._now())
        else:
            self._port.write(data, self._now())

    def read(self, size: int) -> bytes:
        """Return a packet after its length, or the block asked for after its length."""
        if not self._block:
            return self._port.read(size, self._now())
        self._block = False
        block = self._port.read_block(self._now())
        return (bytes([len(block)]) + block).ljust(size, b"\xff")[:size]

    def _now(self) -> int:
        return int((time.monotonic() - self._begin) * self.amplifier.config.tick_hz)


class Registers:
    """A chip of 256 registers; the first byte of a write points to the one that comes next."""

    def __init__(self) -> None:
        self.values = bytearray(256)
        self._next = 0

    def write(self, data: bytes) -> None:
        """Set the pointer, and registers from there on."""
        if data:
            self._next = data[0]
        for value in data[1:]:
            self.values[self._next] = value
            self._next = (self._next + 1) % 256

    def read(self, size: int) -> bytes:
        """Return registers from the pointer on."""
        data = bytes(self.values[(self._next + i) % 256] for i in range(size))
        self._next = (self._next + size) % 256
        return data
