"""``can:``, amplifiers on CAN or CAN FD, by any interface of python-can.

``can:socketcan/can0?fd=true``, ``can:slcan//dev/ttyACM0?bitrate=1000000``, ``can:virtual/name``.
All amplifiers that answer are one display, in the order of their nodes, or of ``nodes=3,1``.
``bitrate`` and ``data_bitrate`` (by default 1 and 5 Mbit/s) say how fast the bus is: socketcan's is
set by ``ip link``, other interfaces are told. What the kernel has no room for waits here, and
nothing more is sent until it is gone: a bus on which nobody acknowledges is broken. With socketcan
an e-stop has a socket of its own, whose priority takes it past what waits in the kernel.
"""

import errno
import os
import select
import socket
import struct
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta

from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame
from firmware_protocol.packet import Packet, encode_packet
from tactile.bus.base import DisplayLike
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, open_link
from tactile.bus.registry import Address, Found, register_bus
from tactile.bus.wire import STALL, Wire, WireError
from tactile.bus.wire_time import Can
from tactile.clock import MONOTONIC, Clock

TICK_HZ = 1_000_000
"""Of the time of reception, for the time-out of fragments."""
NOMINAL, DATA = 1e6, 5e6
"""bit/s, where nothing else is said."""
PRIORITY = 7
"""Of the socket for e-stops: the first band of the kernel's queue (tc-prio, TC_PRIO_CONTROL)."""
MOST_READS = 64
"""Frames, or an adapter's answers, that are read at a time."""
RETRY = 1e-3
"""s between tries to send what the kernel has no room for."""
FRAME = struct.Struct("=IBB2x")
"""Before the data: identifier, length, flags (linux/can.h)."""
FD_FLAGS = 0x05
"""An FD frame, its data at the faster bit rate."""
FULL = (errno.ENOBUFS, errno.EAGAIN)
BUS_OFF, CONTROLLER = 0x40, 0x04
PASSIVE, ACTIVE = 0x30, 0x40
"""Of error frames: classes, and states of the controller in the second byte (linux/can/error.h)."""
CHECK = "check wiring, termination and bit rate"
INTERFACES = "/sys/class/net"
"""Of the kernel, a directory each."""


class CanChannel(ABC):
    """CAN frames both ways; the driver below a `CanWire`. Its errors are OSErrors.

    Attributes
    ----------
    warning : of the controller, one line; empty where there is none
    """

    warning = ""

    @abstractmethod
    def send(self, frame: Frame) -> bool:
        """Take a frame without waiting; False where there is no room."""

    @abstractmethod
    def urge(self, frame: Frame) -> None:
        """Send a frame before those that wait."""

    @abstractmethod
    def receive(self, until: float) -> list[Frame]:
        """Return what came; wait for it until a host time [s] or until woken."""

    @abstractmethod
    def wake(self) -> None:
        """Let `receive` return."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""


class CanWire(Wire):
    """Packets on CAN.

    Parameters
    ----------
    channel : of frames
    link : `Can`
    clock : host time
    """

    def __init__(self, channel: CanChannel, link: Can, clock: Clock) -> None:
        super().__init__(link)
        self._channel, self._clock = channel, clock
        self._encoder = CanEncoder(
            from_amplifier=False, fd=link.data is not None, extended=link.extended
        )
        self._decoder = CanDecoder(
            from_amplifier=True, extended=link.extended, counters=self.counters, tick_hz=TICK_HZ
        )
        self._rest: deque[Frame] = deque()
        self._since = 0.0
        self._order = threading.Lock()

    @property
    def warning(self) -> str:
        """What the controller warns of."""
        return self._channel.warning

    @property
    def busy(self) -> bool:
        """Whether frames wait for room."""
        return bool(self._rest)

    def send(self, packet: Packet) -> float:
        """Send a packet's frames; return how long they take."""
        with self._order:
            if not self._rest:
                self._since = self._clock.now()
            self._rest += self._encoder.frames(packet)
            self._flush()
        return self.link.seconds(encode_packet(packet))

    def urge(self, packet: Packet) -> None:
        """Drop what waits here, and pass what waits in the kernel."""
        with self._order:
            self._rest.clear()
            for frame in self._encoder.frames(packet):
                self._channel.urge(frame)

    def _flush(self) -> None:
        """Send what waits, by one thread at a time."""
        while self._rest and self._channel.send(self._rest[0]):
            self._rest.popleft()
            self._since = self._clock.now()

    def receive(self, until: float) -> list[Packet]:
        """Return what came."""
        with self._order:
            self._flush()
        now = self._clock.now()
        if self._rest and now - self._since > STALL:
            raise WireError("the bus takes nothing more: no other node acknowledges")
        frames = self._channel.receive(min(until, now + RETRY) if self._rest else until)
        ticks = int(self._clock.now() * TICK_HZ)
        return [
            p for identifier, data in frames for p in self._decoder.feed(identifier, data, ticks)
        ]

    def wake(self) -> None:
        """Let `receive` return."""
        self._channel.wake()

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()


class PythonCan(CanChannel):
    """A bus of python-can.

    Parameters
    ----------
    bus : opened
    urgent : another one of the same channel, for e-stops; or the same
    link : whether frames are FD and identifiers have 29 bits
    """

    STEP = 1e-3
    """s between looks at what was asked, of interfaces without a file descriptor."""

    def __init__(self, bus: Any, urgent: Any, link: Can) -> None:
        self._bus, self._urgent, self._link = bus, urgent, link
        self._woken, self._waker = os.pipe()
        os.set_blocking(self._woken, False)
        os.set_blocking(self._waker, False)
        self._awake = False
        self._file = _descriptor(bus)
        bus.set_filters([{"can_id": 1, "can_mask": 1, "extended": link.extended}])

    def _message(self, frame: Frame) -> Any:
        import can

        identifier, data = frame
        return can.Message(
            arbitration_id=identifier, data=data, is_extended_id=self._link.extended,
            is_fd=self._link.data is not None, bitrate_switch=self._link.data is not None,
            check=False,
        )  # fmt: skip

    def send(self, frame: Frame) -> bool:
        """Take a frame."""
        return self._put(self._bus, frame)

    def urge(self, frame: Frame) -> None:
        """Send by the socket with priority."""
        if not self._put(self._urgent, frame):
            raise WireError("the bus has no room for an e-stop: no other node acknowledges")

    def _put(self, bus: Any, frame: Frame) -> bool:
        import can

        try:
            bus.send(self._message(frame), timeout=0)
        except can.CanError as error:
            code = error.error_code or getattr(error.__cause__, "errno", None)
            if code in FULL or "buffer full" in str(error).lower():
                return False
            raise WireError(_gone(code, error)) from error
        return True

    def receive(self, until: float) -> list[Frame]:
        """Return what came, but no more than lets others go on."""
        import can

        found: list[Frame] = []
        try:
            message = self._first(until)
            for _ in range(MOST_READS):
                if message is None and not self._more():
                    break
                if message is None:  # slcan: an adapter's answer
                    pass
                elif message.is_error_frame:
                    self._look(message)
                elif message.is_extended_id == self._link.extended and not message.is_remote_frame:
                    found.append((message.arbitration_id, bytes(message.data)))
                message = self._bus.recv(0)
        except can.CanError as error:
            code = error.error_code or getattr(error.__cause__, "errno", None)
            raise WireError(_gone(code, error)) from error
        except ValueError:  # slcan: a line that is no frame
            self._awake = False
        return found

    def _first(self, until: float) -> Any:
        """Return the first message, None where none came in time."""
        while (left := until - MONOTONIC.now()) > 0 and not self._awake:
            if self._file is not None:
                ready, _, _ = select.select([self._file, self._woken], [], [], left)
                if ready:
                    break
            elif (message := self._bus.recv(min(left, self.STEP))) is not None:
                return message
        self._awake = False
        with suppress(BlockingIOError):
            os.read(self._woken, 4096)
        return self._bus.recv(0)

    def _more(self) -> bool:
        """Tell whether there is something to read, as far as that can be asked."""
        return self._file is not None and bool(select.select([self._file], [], [], 0)[0])

    def _look(self, message: Any) -> None:
        """Keep an error frame's warning; raise WireError for one that ends all traffic."""
        if message.arbitration_id & BUS_OFF:
            raise WireError(f"bus-off: too many errors; {CHECK}")
        if message.arbitration_id & CONTROLLER and len(message.data) > 1:
            if message.data[1] & PASSIVE:
                self.warning = f"error-passive: many errors; {CHECK}"
            elif message.data[1] & ACTIVE:
                self.warning = ""

    def wake(self) -> None:
        """Let `receive` return."""
        self._awake = True
        with suppress(OSError):
            os.write(self._waker, b"\0")

    def close(self) -> None:
        """Shut the bus down."""
        if self._bus is None:
            return
        for bus in {id(b): b for b in (self._bus, self._urgent)}.values():
            with suppress(Exception):
                bus.shutdown()
        self._bus = None
        woken, waker, self._woken, self._waker = self._woken, self._waker, -1, -1
        os.close(woken)
        os.close(waker)


class SocketCan(PythonCan):
    """Linux's own sockets, written to directly: python-can makes three system calls of one.

    A packet's frames have to come within 20 ms (SPEC.md, 3.2), also from a slow computer.
    """

    def _put(self, bus: Any, frame: Frame) -> bool:
        identifier, data = frame
        link, size = self._link, 64 if self._link.data is not None else 8
        identifier |= socket.CAN_EFF_FLAG if link.extended else 0
        flags = FD_FLAGS if link.data is not None else 0
        try:
            bus.socket.send(
                FRAME.pack(identifier, len(data), flags) + data.ljust(size, b"\0"),
                socket.MSG_DONTWAIT,
            )
        except OSError as error:
            if error.errno in FULL:
                return False
            raise WireError(_gone(error.errno, error)) from error
        return True


def _descriptor(bus: Any) -> int | None:
    """Return what can be waited for, None where python-can has none for this interface."""
    try:
        number = bus.fileno()
    except NotImplementedError:
        return None
    return number if isinstance(number, int) and number >= 0 else None


def _gone(code: int | None, error: Exception) -> str:
    """Return what became of an interface."""
    known = {
        errno.ENETDOWN: "the interface is down: bus-off, or not set up (ip link set … up)",
        errno.ENODEV: "the interface is gone",
        errno.ENXIO: "the interface is gone",
    }
    return known.get(code or 0, str(error))


# Opening


class CanOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a ``can:`` URL.

    Attributes
    ----------
    bitrate : float
        Nominal bit rate [bit/s].
    fd : bool
        Whether CAN FD is spoken; so it is if ``data_bitrate`` is given.
    data_bitrate : float or None
        Bit rate of the data phase of CAN FD [bit/s].
    extended : bool
        Whether identifiers have 29 bits.
    nodes : tuple of int
        Nodes of the amplifiers in the order of the channels; all that answer if empty.
    """

    bitrate: Annotated[float, Meta(ge=10e3, le=1e6)] = NOMINAL
    fd: bool = False
    data_bitrate: Annotated[float, Meta(ge=10e3, le=10e6)] | None = None
    extended: bool = False
    nodes: tuple[Annotated[int, Meta(ge=1, le=127)], ...] = ()


def link_of(options: CanOptions) -> Can:
    """Return how long packets take on the bus.

    Parameters
    ----------
    options : CanOptions
        Options of the device's URL.

    Returns
    -------
    Can
        The bus with its bit rates.
    """
    fd = options.fd or options.data_bitrate is not None
    data = (options.data_bitrate or DATA) if fd else None
    return Can(options.bitrate, data, options.extended)


def connect(path: str, link: Can, clock: Clock) -> CanWire:
    """Open a CAN bus.

    Parameters
    ----------
    path : str
        Interface of python-can and its channel, such as ``socketcan/can0``.
    link : Can
        How long packets take on the bus.
    clock : Clock
        Clock by which the wire waits.

    Returns
    -------
    CanWire
        The open bus.

    Raises
    ------
    WireError
        If the bus cannot be opened, with what to do about it.
    """
    import can

    interface, _, channel = path.partition("/")
    arguments: dict[str, Any] = {"interface": interface, "channel": channel or None}
    if link.data is not None:
        arguments["fd"] = True
    if interface not in ("socketcan", "virtual", "udp_multicast"):
        arguments["bitrate"] = round(link.nominal)
        if link.data is not None:
            arguments["data_bitrate"] = round(link.data)
    if interface == "slcan":
        arguments["timeout"] = 0  # of each read; 1 ms by default, also where there is nothing
    buses: list[Any] = []
    try:
        if interface == "socketcan":
            _look_for(channel)
            buses.append(can.Bus(**arguments))
            buses[0].set_filters([{"can_id": 0, "can_mask": 0x7FF, "extended": False}])
            buses[0].socket.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, PRIORITY)
        buses.append(can.Bus(**arguments))
    except (can.CanError, OSError, ValueError, ImportError) as error:
        for bus in buses:
            bus.shutdown()
        raise WireError(f"can: {path}: {_reason(interface, channel, error)}") from error
    channel_of = SocketCan if interface == "socketcan" else PythonCan
    return CanWire(channel_of(buses[-1], buses[0], link), link, clock)


def _look_for(channel: str) -> None:
    """Raise OSError where there is no CAN, or no such interface.

    python-can does as well, but prints a line about it and leaves a socket open. Nor is this asked
    by `socket.if_nameindex`: it keeps the GIL while it waits for whoever sets an interface down,
    and all of Python stands still.
    """
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW):
        if channel not in os.listdir(INTERFACES):
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))


def _reason(interface: str, channel: str, error: Exception) -> str:
    """Return why a bus does not open, and what would do."""
    import can

    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if code == errno.ENODEV:
        there = ", ".join(found.url for found in find()) or "none is there"
        return f"no such interface; there are: {there}"
    if code == errno.EAFNOSUPPORT:
        return "this kernel has no CAN"
    if code == errno.EACCES:
        return "permission denied"
    if interface not in can.VALID_INTERFACES:
        return f"python-can has no interface {interface!r}"
    return " ".join(str(error).split())


def find() -> Iterator[Found]:
    """Yield the CAN interfaces of the kernel."""
    with suppress(OSError):
        for name in sorted(os.listdir(INTERFACES)):
            with suppress(OSError), open(f"{INTERFACES}/{name}/type", encoding="ascii") as kind:
                if kind.read().strip() == "280":  # ARPHRD_CAN
                    yield Found(f"can:socketcan/{name}", "CAN interface")


def _open(address: Address[CanOptions], display: DisplayLike, sample_rate: float | None) -> LinkBus:
    path, options, link = address.path, address.options, link_of(address.options)
    return open_link(
        options, display, sample_rate, link, lambda: connect(path, link, MONOTONIC),
        nodes=options.nodes,
    )  # fmt: skip


register_bus("can", _open, CanOptions, takes_path=True, find=find, link=link_of)
