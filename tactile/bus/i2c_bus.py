"""``i2c:``, amplifiers with the protocol on I²C.

``i2c:1?address=0x42`` is address 0x42 of /dev/i2c-1; several addresses are one display, in their
order. The host reads what targets have to say: as often as they send PULSE, and at once where it
asked for an answer. A transfer that is not acknowledged is lost and counted, as on any link; where
none is for a tenth of a second, the link is broken. ``smbus=true`` for adapters that do no more
than SMBus.
"""

import errno
import glob
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta

from firmware_protocol.fragments import LENGTH, Cutter, Reassembler
from firmware_protocol.i2c_link import (
    NOTHING,
    READ_COMMAND,
    SMBUS_BLOCK,
    WRITE_COMMAND,
    decode_read,
)
from firmware_protocol.messages import FRAGMENT_TIMEOUT_MS, PACKET_MAX, Flag, Poll, Pulse, Time
from firmware_protocol.packet import SMALLEST, Packet, encode_packet
from tactile.bus.base import DisplayLike
from tactile.bus.budget import PULSE_INTERVAL
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, open_link
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, Found, register_bus
from tactile.bus.wire import STALL, Wire, WireError
from tactile.bus.wire_time import I2c
from tactile.clock import MONOTONIC, Clock
from tactile.errors import InputError

ADDRESS, CLOCK = 0x42, 400e3
"""Where nothing else is said; the bus's clock [Hz] is the adapter's to set."""
FIRST_READ = LENGTH.size + SMALLEST + Pulse.HEAD.size
"""Bytes of a read: a PULSE; what is longer is read again."""
ANSWER = 1e-3
"""s from a request to a look at the answer."""
ANSWERED = (Time.TYPE, Poll.TYPE)
"""Answered without being asked to."""
MOST_READS = 16
"""Packets that are read at a time: as many as a target lets wait."""
TICK_HZ = 1_000_000


class Adapter(ABC):
    """Transfers to an address; its errors are OSErrors, also where nobody acknowledges."""

    @abstractmethod
    def write(self, address: int, data: bytes) -> None:
        """Write a transfer."""

    @abstractmethod
    def read(self, address: int, size: int) -> bytes:
        """Read a transfer."""

    @abstractmethod
    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block."""

    @abstractmethod
    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""


class I2cEnd:
    """The host's end of what goes to one address, raw or in SMBus blocks."""

    def __init__(self, adapter: Adapter, address: int, *, smbus: bool) -> None:
        self.address = address
        self._adapter, self._smbus = adapter, smbus
        self._cutter = Cutter(SMBUS_BLOCK)

    def write(self, data: bytes) -> None:
        """Write a packet's bytes."""
        if not self._smbus:
            self._adapter.write(self.address, data)
            return
        for block in self._cutter.fragments(WRITE_COMMAND, data):
            self._adapter.write_block(self.address, WRITE_COMMAND, block)

    def read(self) -> bytes:
        """Return what a read transfer gives: length and packet, or a block."""
        if self._smbus:
            return self._adapter.read_block(self.address, READ_COMMAND)
        data = self._adapter.read(self.address, FIRST_READ)
        length = LENGTH.unpack_from(data)[0]
        if length > PACKET_MAX:
            raise OSError(errno.EPROTO, f"a packet of {length} bytes waits")
        if LENGTH.size + length > FIRST_READ:
            data = self._adapter.read(self.address, LENGTH.size + length)
        return data


class I2cWire(Wire):
    """Packets on I²C.

    Parameters
    ----------
    adapter : of transfers
    addresses : of the amplifiers
    link : `I2c`
    clock : host time
    """

    def __init__(self, adapter: Adapter, addresses: Sequence[int], link: I2c, clock: Clock) -> None:
        super().__init__(link)
        self._adapter, self._clock, self._smbus = adapter, clock, link.smbus
        self._targets = [I2cEnd(adapter, a, smbus=link.smbus) for a in addresses]
        self._nodes: dict[int, I2cEnd] = {}
        timeout = FRAGMENT_TIMEOUT_MS * TICK_HZ // 1000
        self._assemble = [Reassembler(PACKET_MAX, self.counters, timeout) for _ in addresses]
        self._good = clock.now()
        self._look = -1.0
        self._woken = threading.Event()

    def send(self, packet: Packet) -> float:
        """Write a packet to its target, or to all; return how long that takes."""
        data = encode_packet(packet)
        known = self._nodes.get(packet.node)
        for target in [known] if known is not None else self._targets:
            self._try(lambda target=target: target.write(data))
        now = self._clock.now()
        if packet.flags & Flag.ACK_REQUEST or packet.type in ANSWERED or not packet.node:
            self._look = min(self._look, now + ANSWER)
        return self.link.seconds(data)

    def urge(self, packet: Packet) -> None:
        """Write: nothing waits on I²C but the transfer under way."""
        self.send(packet)

    def _try(self, transfer: Any) -> Any:
        """Return what a transfer gives; None, counted, where it is not acknowledged."""
        try:
            found = transfer()
        except WireError:
            raise
        except OSError as error:
            self.counters.malformed += 1
            if error.errno in GONE or self._clock.now() - self._good > STALL:
                raise WireError(_said(error)) from error
            return None
        self._good = self._clock.now()
        return found

    def receive(self, until: float) -> list[Packet]:
        """Read what waits, when it is time to look."""
        now = self._clock.now()
        if now < self._look:
            self._pause(min(until, self._look) - now)
        if self._clock.now() < self._look:
            return []
        self._look = self._clock.now() + PULSE_INTERVAL
        return [
            packet for k, target in enumerate(self._targets) for packet in self._read(k, target)
        ]

    def _pause(self, seconds: float) -> None:
        """Let time pass, or less where woken."""
        self._clock.wait(self._woken, seconds)
        self._woken.clear()

    def _read(self, index: int, target: I2cEnd) -> Iterator[Packet]:
        """Yield the packets that a target has."""
        for _ in range(MOST_READS * (1 + 8 * self._smbus)):
            data = self._try(target.read)
            if data is None or (data[:1] == NOTHING and (self._smbus or data[:2] == b"\0\0")):
                return
            if self._smbus:
                ticks = int(self._clock.now() * TICK_HZ)
                packet = self._assemble[index].feed(READ_COMMAND, data, ticks)
            else:
                packet = decode_read(data, self.counters)
            if packet is not None:
                self._nodes.setdefault(packet.node, target)
                yield packet

    def wake(self) -> None:
        """Let `receive` return."""
        self._woken.set()

    def close(self) -> None:
        """Close the adapter."""
        self._adapter.close()


GONE = (errno.ENODEV, errno.EBADF)


def _said(error: OSError) -> str:
    if error.errno in GONE:
        return "the adapter is gone"
    return f"nothing acknowledges ({error.strerror or error})"


class LinuxAdapter(Adapter):
    """/dev/i2c-N by smbus2."""

    def __init__(self, path: str) -> None:
        import smbus2

        self._smbus2, self._bus = smbus2, smbus2.SMBus(path)

    def write(self, address: int, data: bytes) -> None:
        """Write a transfer."""
        self._bus.i2c_rdwr(self._smbus2.i2c_msg.write(address, data))

    def read(self, address: int, size: int) -> bytes:
        """Read a transfer."""
        message = self._smbus2.i2c_msg.read(address, size)
        self._bus.i2c_rdwr(message)
        return bytes(message)

    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block."""
        self._bus.write_block_data(address, command, list(block))

    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block."""
        return bytes(self._bus.read_block_data(address, command))

    def close(self) -> None:
        """Close the device."""
        with suppress(OSError):
            self._bus.close()


# Opening


class I2cOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of an ``i2c:`` URL.

    Attributes
    ----------
    address : tuple of int
        Addresses of the amplifiers in the order of the channels.
    clock : float
        Clock of the bus [Hz].
    smbus : bool
        Whether packets go in block writes and reads of SMBus, for adapters that have no others.
    """

    address: tuple[Annotated[int, Meta(ge=0x08, le=0x77, extra=HEXADECIMAL)], ...] = (ADDRESS,)
    clock: Annotated[float, Meta(ge=10e3, le=5e6)] = CLOCK
    smbus: bool = False


def link_of(options: I2cOptions) -> I2c:
    """Return how long packets take on the bus.

    Parameters
    ----------
    options : I2cOptions
        Options of the device's URL.

    Returns
    -------
    I2c
        The bus with its clock.
    """
    return I2c(options.clock, smbus=options.smbus)


def device(path: str) -> str:
    """Return the device of a bus's number or path."""
    return f"/dev/i2c-{path}" if path.isdigit() else path


def connect(path: str, addresses: Sequence[int], link: I2c, clock: Clock) -> I2cWire:
    """Open an I²C bus.

    Parameters
    ----------
    path : str
        Number of the bus, or its device.
    addresses : sequence of int
        Addresses of the amplifiers in the order of the channels.
    link : I2c
        How long packets take on the bus.
    clock : Clock
        Clock by which the wire waits.

    Returns
    -------
    I2cWire
        The open bus.

    Raises
    ------
    WireError
        If the bus cannot be opened or nothing acknowledges, with what to do about it.
    """
    path = device(path)
    try:
        adapter = LinuxAdapter(path)
    except ImportError as error:
        raise WireError("i2c: needs Linux and smbus2: pip install smbus2") from error
    except OSError as error:
        raise WireError(f"i2c: {path}: {_reason(error)}") from error
    try:
        for one in addresses:
            I2cEnd(adapter, one, smbus=link.smbus).read()
    except OSError as error:
        adapter.close()
        raise WireError(
            f"i2c: {path}: nothing acknowledges at address {one:#04x}; check power and address"
        ) from error
    return I2cWire(adapter, addresses, link, clock)


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOENT:
        there = ", ".join(sorted(glob.glob("/dev/i2c-*"))) or "none; modprobe i2c-dev"
        return f"no such bus; there are: {there}"
    if error.errno == errno.EACCES:
        return "permission denied; sudo usermod -aG i2c $USER, then log in again"
    return str(error.strerror or error)


def find() -> Iterator[Found]:
    """Yield the buses, and on each the addresses that answer HELLO's read as an amplifier does."""
    for path in sorted(glob.glob("/dev/i2c-*")):
        yield Found(f"i2c:{path.rpartition('-')[2]}?address={ADDRESS:#04x}", f"I²C bus {path}")


def _open(address: Address[I2cOptions], display: DisplayLike, sample_rate: float | None) -> LinkBus:
    if not address.path:
        raise InputError("i2c: names no bus; as i2c:1?address=0x42")
    path, options, link = address.path, address.options, link_of(address.options)
    return open_link(
        options, display, sample_rate, link,
        lambda: connect(path, options.address or (ADDRESS,), link, MONOTONIC),
    )  # fmt: skip


register_bus("i2c", _open, I2cOptions, takes_path=True, find=find, link=link_of)
