"""An I²C bus whose targets are Python objects, as /dev/i2c-N by way of the kernel's CUSE.

The messages are those of linux/fuse.h, the ioctls those of linux/i2c-dev.h.
"""

import errno
import os
import select
import struct
import threading
import time
import traceback
from pathlib import Path
from typing import Self

from i2c_targets import I2cBus

REQUEST = struct.Struct("<IIQQIIII")  # length, operation, unique, node, uid, gid, pid, -
REPLY = struct.Struct("<IiQ")  # length, error, unique
INIT = struct.Struct("<8I40x")  # version, -, flags, sizes of reads and writes, device number
IOCTL_IN = struct.Struct("<QIIQII")  # file, flags, command, argument, sizes in and out
IOCTL_OUT = struct.Struct("<iIII")  # result, flags, pieces in and out
FORGET, OPEN, RELEASE, INTERRUPT, IOCTL, CUSE_INIT = 2, 14, 18, 36, 39, 4096
UNRESTRICTED, RETRY = 1, 4
LARGEST = 1 << 16

I2C_SLAVE, I2C_FUNCS, I2C_SLAVE_FORCE, I2C_RDWR, I2C_SMBUS = 0x703, 0x705, 0x706, 0x707, 0x720
FUNCTIONS = 0x0F7F0001  # raw transfers, and SMBus but for process calls and PEC
RDWR = struct.Struct("<QI4x")  # where the messages are, and how many
MESSAGE = struct.Struct("<HHH2xQ")  # address, flags, size, where its data are
MOST_MESSAGES, LONGEST_MESSAGE = 42, 8192
SMBUS = struct.Struct("<BB2xIQ")  # direction, command, kind, where its data are
READ = 1  # flag of a message, and direction of an SMBus transfer
QUICK, BYTE, BYTE_DATA, WORD_DATA, BLOCK_DATA, I2C_BLOCK = 0, 1, 2, 3, 5, 8
WIDTHS = {QUICK: 0, BYTE: 1, BYTE_DATA: 1, WORD_DATA: 2, BLOCK_DATA: 34, I2C_BLOCK: 34}
SMBUS_BLOCK = 32

Pieces = list[tuple[int, int]]
"""Addresses and sizes of memory of the caller of an ioctl."""


class CuseI2c:
    """A context in which a bus is /dev/i2c-N."""

    def __init__(self, number: int, bus: I2cBus) -> None:
        self.path = Path(f"/dev/i2c-{number}")
        self.bus = bus
        self._addresses: dict[int, int] = {}
        self._files = 0
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._wake = os.eventfd(0)
        self._device = os.open("/dev/cuse", os.O_RDWR)
        self._thread.start()
        deadline = time.monotonic() + 10
        while not self.path.exists():
            if time.monotonic() > deadline:
                raise TimeoutError(f"no {self.path} after 10 s")
            time.sleep(0.01)
        return self

    def __exit__(self, *_: object) -> None:
        os.eventfd_write(self._wake, 1)
        self._thread.join()
        os.close(self._device)
        os.close(self._wake)

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._device, self._wake], [], [])
            if self._wake in ready:
                return
            request = os.read(self._device, 2 * LARGEST)
            _, operation, unique, *_ = REQUEST.unpack_from(request)
            if operation in (FORGET, INTERRUPT):
                continue
            error, answer = 0, b""
            try:
                answer = self._answer(operation, request[REQUEST.size :])
            except OSError as e:
                error = e.errno or errno.EIO
            except Exception:
                traceback.print_exc()
                error = errno.EIO
            os.write(self._device, REPLY.pack(REPLY.size + len(answer), -error, unique) + answer)

    def _answer(self, operation: int, body: bytes) -> bytes:
        if operation == CUSE_INIT:
            name = b"DEVNAME=" + self.path.name.encode() + b"\0"
            return INIT.pack(7, 31, 0, UNRESTRICTED, LARGEST, LARGEST, 0, 0) + name
        if operation == OPEN:
            self._files += 1
            return struct.pack("<QII", self._files, 0, 0)
        if operation == RELEASE:
            self._addresses.pop(struct.unpack_from("<Q", body)[0], None)
            return b""
        if operation == IOCTL:
            return self._ioctl(body)
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    def _ioctl(self, body: bytes) -> bytes:
        file, _, command, argument, size_in, size_out = IOCTL_IN.unpack_from(body)
        data = body[IOCTL_IN.size : IOCTL_IN.size + size_in]
        inward, outward = wanted(command, argument, data)
        if (size_in, size_out) != (total(inward), total(outward)):
            pieces = b"".join(struct.pack("<QQ", *piece) for piece in inward + outward)
            return IOCTL_OUT.pack(0, RETRY, len(inward), len(outward)) + pieces
        result, read = 0, b""
        if command in (I2C_SLAVE, I2C_SLAVE_FORCE):
            self._addresses[file] = argument
        elif command == I2C_FUNCS:
            read = struct.pack("<Q", FUNCTIONS)
        elif command == I2C_SMBUS:
            read = self._smbus(self._addresses.get(file, 0), data).ljust(size_out, b"\0")
        elif command == I2C_RDWR:
            result, read = self._messages(data)
        return IOCTL_OUT.pack(result, 0, 0, 0) + read

    def _messages(self, data: bytes) -> tuple[int, bytes]:
        messages = messages_of(data)
        at = RDWR.size + MESSAGE.size * len(messages)
        read = b""
        for address, flags, size, _ in messages:
            if flags & READ:
                read += self.bus.read(address, size)
            else:
                self.bus.write(address, data[at : at + size])
                at += size
        return len(messages), read

    def _smbus(self, address: int, data: bytes) -> bytes:
        direction, command, kind, _ = SMBUS.unpack_from(data)
        data = data[SMBUS.size :]
        if kind == QUICK:
            self.bus.write(address, b"")
            return b""
        if direction != READ:
            self.bus.write(address, bytes([command]) + payload(kind, data))
            return b""
        if kind != BYTE:
            self.bus.write(address, bytes([command]))
        if kind == I2C_BLOCK:
            return data[:1] + self.bus.read(address, block_size(data, errno.EINVAL))
        if kind == BLOCK_DATA:
            block = self.bus.read(address, 1 + SMBUS_BLOCK)
            return block[: 1 + block_size(block, errno.EPROTO)]
        return self.bus.read(address, WIDTHS[kind])


def payload(kind: int, data: bytes) -> bytes:
    """Return what follows the command of an SMBus write."""
    if kind == BLOCK_DATA:
        return data[: 1 + block_size(data, errno.EINVAL)]
    if kind == I2C_BLOCK:
        return data[1 : 1 + block_size(data, errno.EINVAL)]
    return data


def block_size(data: bytes, error: int) -> int:
    """Return the size in a block's first byte, or raise."""
    if not 1 <= data[0] <= SMBUS_BLOCK:
        raise OSError(error, os.strerror(error))
    return data[0]


def messages_of(data: bytes) -> list[tuple[int, ...]]:
    """Return address, flags, size and memory of the messages of I2C_RDWR."""
    _, count = RDWR.unpack_from(data)
    return list(MESSAGE.iter_unpack(data[RDWR.size : RDWR.size + MESSAGE.size * count]))


def total(pieces: Pieces) -> int:
    """Return how many bytes there are."""
    return sum(size for _, size in pieces)


def wanted(command: int, argument: int, data: bytes) -> tuple[Pieces, Pieces]:
    """Return the memory that an ioctl reads and writes, as far as the bytes read so far say."""
    if command == I2C_FUNCS:
        return [], [(argument, 8)]
    if command == I2C_RDWR:
        return wanted_messages(argument, data)
    if command == I2C_SMBUS:
        return wanted_smbus(argument, data)
    if command in (I2C_SLAVE, I2C_SLAVE_FORCE):
        return [], []
    raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))


def wanted_messages(argument: int, data: bytes) -> tuple[Pieces, Pieces]:
    """Return what I2C_RDWR wants."""
    inward = [(argument, RDWR.size)]
    if len(data) < RDWR.size:
        return inward, []
    where, count = RDWR.unpack_from(data)
    inward.append((where, MESSAGE.size * count))
    if len(data) < total(inward):
        return inward, []
    messages = messages_of(data)
    if count > MOST_MESSAGES or any(size > LONGEST_MESSAGE for _, _, size, _ in messages):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
    inward += [(where, size) for _, flags, size, where in messages if size and not flags & READ]
    return inward, [(where, size) for _, flags, size, where in messages if size and flags & READ]


def wanted_smbus(argument: int, data: bytes) -> tuple[Pieces, Pieces]:
    """Return what I2C_SMBUS wants."""
    inward: Pieces = [(argument, SMBUS.size)]
    if len(data) < SMBUS.size:
        return inward, []
    direction, _, kind, where = SMBUS.unpack_from(data)
    if kind not in WIDTHS:
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))
    memory = [(where, WIDTHS[kind])] if WIDTHS[kind] else []
    if direction == READ:
        return inward + memory * (kind == I2C_BLOCK), memory
    return inward + memory * (kind != BYTE), []
