"""``i2c:``, amplifiers with the protocol on I²C.

``i2c:1?address=0x42`` is address 0x42 on /dev/i2c-1; the amplifiers at several addresses form one
display, in the order of their nodes. ``smbus=true`` is for adapters that have no transfers other
than those of SMBus.

The host reads what the targets have to send: as often as they send PULSE, and soon after each
request. A transfer that is not acknowledged is lost and counted, as on any link. If none is
acknowledged for a tenth of a second, the link is broken.
"""

import errno
import threading
from collections.abc import Iterator, Sequence
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
from firmware_protocol.messages import PACKET_MAX, Flag, Poll, Pulse, Time
from firmware_protocol.packet import SMALLEST, Packet, encode_packet
from tactile.bus.base import DisplayLike
from tactile.bus.budget import PULSE_INTERVAL
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, open_link
from tactile.bus.linux_i2c import LinuxI2c, SmbusAdapter, device_file, device_files
from tactile.bus.options import HEXADECIMAL
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.bus.wire import STALL, Wire, WireError
from tactile.bus.wire_time import I2c
from tactile.clock import MONOTONIC, Clock
from tactile.errors import InputError

ADDRESS, CLOCK = 0x42, 400e3
"""Default address, and default clock [Hz]; the adapter is set to its clock elsewhere."""
FIRST_READ = LENGTH.size + SMALLEST + Pulse.HEAD.size
"""Size of the first read of a packet, enough for a PULSE; a longer packet is read again [bytes]."""
ANSWER = 1e-3
"""Time from a request to the read of its answer [s]."""
ANSWERED = (Time.TYPE, Poll.TYPE)
"""Types of messages that are answered without ACK_REQUEST."""
MOST_READS = 16
"""Maximum number of packets that are read from a target at a time, which is as many as wait in it
at most."""
TICK_HZ = 1_000_000
"""Resolution of the time of reception, by which fragments time out [1/s]."""


class I2cEnd:
    """Host's end of the exchange with one address, raw or in SMBus blocks.

    Parameters
    ----------
    adapter : SmbusAdapter
        Adapter of the bus.
    address : int
        Address of the target.
    smbus : bool
        Whether packets go in SMBus blocks.

    Attributes
    ----------
    address : int
        Address of the target.
    """

    def __init__(self, adapter: SmbusAdapter, address: int, *, smbus: bool) -> None:
        self.address = address
        self._adapter, self._smbus = adapter, smbus
        self._cutter = Cutter(SMBUS_BLOCK)

    def write(self, data: bytes) -> None:
        """Write the bytes of a packet.

        Parameters
        ----------
        data : bytes
            Bytes of the packet.
        """
        if not self._smbus:
            self._adapter.write(self.address, data)
            return
        for block in self._cutter.fragments(WRITE_COMMAND, data):
            self._adapter.write_block(self.address, WRITE_COMMAND, block)

    def read(self) -> bytes:
        """Return the bytes that a read gives.

        Returns
        -------
        bytes
            Length and packet, or one SMBus block.

        Raises
        ------
        OSError
            If nobody acknowledges, or the length is larger than that of any packet.
        """
        if self._smbus:
            return self._adapter.read_block(self.address, READ_COMMAND)
        data = self._adapter.write_read(self.address, b"", FIRST_READ)
        length = LENGTH.unpack_from(data)[0]
        if length > PACKET_MAX:
            raise OSError(errno.EPROTO, f"a packet of {length} bytes waits")
        if LENGTH.size + length > FIRST_READ:
            data = self._adapter.write_read(self.address, b"", LENGTH.size + length)
        return data


class I2cWire(Wire):
    """Packets on I²C.

    `send` and `send_urgent` wait until the transfer has ended. Different threads may call them and
    `receive`: a transfer is one call of the kernel, or has the lock of `LinuxI2c`.

    Parameters
    ----------
    adapter : SmbusAdapter
        Adapter of the bus, which the wire closes.
    addresses : sequence of int
        Addresses of the amplifiers.
    link : I2c
        Medium, which says whether packets go in SMBus blocks.
    clock : Clock
        Host time.
    """

    def __init__(
        self, adapter: SmbusAdapter, addresses: Sequence[int], link: I2c, clock: Clock
    ) -> None:
        super().__init__(link)
        self._adapter, self._clock, self._smbus = adapter, clock, link.smbus
        self._targets = [I2cEnd(adapter, a, smbus=link.smbus) for a in addresses]
        self._nodes: dict[int, I2cEnd] = {}
        """Targets by their nodes, as received packets show them."""
        self._reassemblers = [Reassembler(PACKET_MAX, self.counters, TICK_HZ) for _ in addresses]
        self._last_success = clock.now()
        """Host time of the last transfer that was acknowledged [s]."""
        self._next_read = -1.0
        """Host time at which the targets are read next [s]."""
        self._woken = threading.Event()

    def send(self, packet: Packet) -> float:
        """Write a packet to its target, or to all of them; wait until it is written.

        Until a node is known by what it sent, its packets go to all targets; the others ignore
        them.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Returns
        -------
        float
            Time that the packet takes on the bus [s].

        Raises
        ------
        WireError
            If the adapter is gone, or nothing has been acknowledged for `STALL`.
        """
        data = encode_packet(packet)
        known = self._nodes.get(packet.node)
        for target in [known] if known is not None else self._targets:
            self._attempt(lambda target=target: target.write(data))
        now = self._clock.now()
        if packet.flags & Flag.ACK_REQUEST or packet.type in ANSWERED or not packet.node:
            self._next_read = min(self._next_read, now + ANSWER)
        return self.link.seconds(data)

    def send_urgent(self, packet: Packet) -> None:
        """Write a packet; on I²C nothing but the transfer under way is ahead of it.

        Parameters
        ----------
        packet : Packet
            Packet to send.
        """
        self.send(packet)

    def _attempt(self, transfer: Any) -> Any:
        """Return what a transfer gives; count one that is not acknowledged and return None."""
        try:
            data = transfer()
        except WireError:
            raise
        except OSError as error:
            self.counters.malformed += 1
            if error.errno in DISCONNECTED or self._clock.now() - self._last_success > STALL:
                raise WireError(_failure(error)) from error
            return None
        self._last_success = self._clock.now()
        return data

    def receive(self, until: float) -> list[Packet]:
        """Wait until the next read is due, and read all packets that wait in the targets.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of Packet
            Packets, one target after the other; empty if no read was due, or `wake` was called.

        Raises
        ------
        WireError
            If the adapter is gone, or nothing has been acknowledged for `STALL`.
        """
        now = self._clock.now()
        if now < self._next_read:
            self._pause(min(until, self._next_read) - now)
        if self._clock.now() < self._next_read:
            return []
        self._next_read = self._clock.now() + PULSE_INTERVAL
        return [
            packet for k, target in enumerate(self._targets) for packet in self._read(k, target)
        ]

    def _pause(self, seconds: float) -> None:
        """Wait for some time, but no longer than until `wake`."""
        self._clock.wait(self._woken, seconds)
        self._woken.clear()

    def _read(self, index: int, target: I2cEnd) -> Iterator[Packet]:
        """Yield the packets that wait in a target."""
        for _ in range(MOST_READS * (1 + 8 * self._smbus)):
            data = self._attempt(target.read)
            if data is None or (data[:1] == NOTHING and (self._smbus or data[:2] == b"\0\0")):
                return
            if self._smbus:
                ticks = int(self._clock.now() * TICK_HZ)
                packet = self._reassemblers[index].feed(READ_COMMAND, data, ticks)
            else:
                packet = decode_read(data, self.counters)
            if packet is not None:
                self._nodes.setdefault(packet.node, target)
                yield packet

    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""
        self._woken.set()

    def close(self) -> None:
        """Close the adapter."""
        self._adapter.close()


DISCONNECTED = (errno.ENODEV, errno.EBADF)
"""Error numbers of an adapter that is gone."""


def _failure(error: OSError) -> str:
    """Return a description of why transfers fail."""
    if error.errno in DISCONNECTED:
        return "the adapter is gone"
    return f"nothing acknowledges ({error.strerror or error})"


# Opening


class I2cOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a URL ``i2c:BUS?option=value&…``, where BUS is the number of the I2C bus.

    Attributes
    ----------
    address : tuple of int
        Addresses of the amplifiers. Channels are in the order of nodes, not of addresses.
    clock : float
        Clock of the bus, which has to be that of the adapter [Hz].
    smbus : bool
        Whether packets go in block writes and reads of SMBus, for adapters that have no others.
    """

    address: tuple[Annotated[int, Meta(ge=0x08, le=0x77, extra=HEXADECIMAL)], ...] = (ADDRESS,)
    clock: Annotated[float, Meta(ge=10e3, le=5e6)] = CLOCK
    smbus: bool = False

    @property
    def medium(self) -> I2c:
        """Bus of that clock."""
        return I2c(self.clock, smbus=self.smbus)


def connect(path: str, addresses: Sequence[int], link: I2c) -> I2cWire:
    """Open an I²C bus.

    Parameters
    ----------
    path : str
        Number of the bus, or its device.
    addresses : sequence of int
        Addresses of the amplifiers, each of which is read once.
    link : I2c
        Medium, which says whether packets go in SMBus blocks.

    Returns
    -------
    I2cWire
        The open bus.

    Raises
    ------
    BusError
        If the bus cannot be opened, or an address is not acknowledged, with what to do about it.
    """
    path = device_file(path)
    adapter = LinuxI2c(path)
    try:
        for address in addresses:
            I2cEnd(adapter, address, smbus=link.smbus).read()
    except OSError as error:
        adapter.close()
        raise WireError(
            f"i2c: {path}: nothing acknowledges at address {address:#04x}; check power and address"
        ) from error
    return I2cWire(adapter, addresses, link, MONOTONIC)


def find() -> Iterator[FoundDevice]:
    """Find the I²C buses of this computer; their addresses are not searched.

    Yields
    ------
    FoundDevice
        Bus, with the default address.
    """
    for path in device_files():
        yield FoundDevice(
            f"i2c:{path.rpartition('-')[2]}?address={ADDRESS:#04x}", f"I²C bus {path}"
        )


def _open(address: Address[I2cOptions], display: DisplayLike, sample_rate: float | None) -> LinkBus:
    _require_bus(address)
    options = address.options
    return open_link(options, display, sample_rate, lambda: _wire(address)[0])


def _require_bus(address: Address[I2cOptions]) -> None:
    """Raise InputError if a URL names no bus."""
    if not address.path:
        raise InputError("i2c: names no bus; as i2c:1?address=0x42")


def _wire(address: Address[I2cOptions]) -> tuple[Wire, Clock]:
    _require_bus(address)
    options = address.options
    return connect(address.path, options.address or (ADDRESS,), options.medium), MONOTONIC


register_bus("i2c", _open, I2cOptions, takes_path=True, find=find, wire=_wire)
