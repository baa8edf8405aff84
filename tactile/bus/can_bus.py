"""``can:``, amplifiers on CAN or CAN FD, by any interface of python-can.

``can:socketcan/can0?fd=true``, ``can:slcan//dev/ttyACM0?bitrate=1000000``, ``can:virtual/name``.
All amplifiers that answer form one display, in the order of their nodes, or in that of
``nodes=3,1``. ``bitrate`` and ``data_bitrate`` (by default 1 and 5 Mbit/s) are the bit rates of the
bus: ``ip link`` sets those of socketcan, other interfaces are set to them.

Frames for which the kernel has no room are queued in the `CanWire`, and nothing more is sent until
they are gone. A bus on which nobody acknowledges for a tenth of a second counts as broken. With
socketcan an e-stop has a socket of its own, whose priority takes it past the frames that wait in
the kernel.
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
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.bus.wire import STALL, Waker, Wire, WireError
from tactile.bus.wire_time import Can
from tactile.clock import MONOTONIC, Clock

TICK_HZ = 1_000_000
"""Resolution of the time of reception, by which fragments time out [1/s]."""
NOMINAL, DATA = 1e6, 5e6
"""Default bit rates, nominal and of the data phase of CAN FD [bit/s]."""
PRIORITY = 7
"""Priority of the socket for e-stops, which puts it in the first band of the kernel's queue
(tc-prio, TC_PRIO_CONTROL)."""
MOST_READS = 64
"""Maximum number of frames, or answers of an adapter, that are read at a time."""
RETRY = 1e-3
"""Interval between attempts to send frames for which the kernel has no room [s]."""
FRAME = struct.Struct("=IBB2x")
"""Head of a frame before its data: identifier, length and flags (linux/can.h)."""
FD_FLAGS = 0x05
"""Flags of an FD frame whose data has the faster bit rate (CANFD_BRS and CANFD_FDF)."""
FULL = (errno.ENOBUFS, errno.EAGAIN)
"""Error numbers of a kernel that has no room for a frame."""
BUS_OFF, CONTROLLER = 0x40, 0x04
"""Classes of error frames (linux/can/error.h)."""
PASSIVE, ACTIVE = 0x30, 0x40
"""States of the controller in the second byte of an error frame (linux/can/error.h)."""
CHECK = "check wiring, termination and bit rate"
"""Advice in errors of the bus."""
INTERFACES = "/sys/class/net"
"""Directory in which the kernel has a directory for each network interface."""


class CanChannel(ABC):
    """Exchange of CAN frames, the driver below a `CanWire`.

    Its errors are OSErrors. Any thread may call `wake`, also while another one waits.

    Attributes
    ----------
    warning : str
        Warning of the controller, one line; empty if there is none.
    """

    warning = ""

    @abstractmethod
    def send(self, frame: Frame) -> bool:
        """Take a frame without waiting.

        Parameters
        ----------
        frame : tuple of int and bytes
            Identifier and data.

        Returns
        -------
        bool
            Whether there was room for the frame.
        """

    @abstractmethod
    def send_urgent(self, frame: Frame) -> None:
        """Send a frame ahead of those that wait.

        Parameters
        ----------
        frame : tuple of int and bytes
            Identifier and data.

        Raises
        ------
        OSError
            If there is no room for the frame.
        """

    @abstractmethod
    def receive(self, until: float) -> list[Frame]:
        """Wait for frames, but no longer than until `wake`.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of tuple of int and bytes
            Identifiers and data of the frames that have come.
        """

    @abstractmethod
    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Close the channel; it may be called any number of times."""


class CanWire(Wire):
    """Packets on CAN.

    A lock lets different threads call `send`, `send_urgent` and `receive`. It is reentrant, since a
    signal handler may call `send_urgent` while the thread that it interrupts sends.

    Parameters
    ----------
    channel : CanChannel
        Exchange of frames, which the wire closes.
    link : Can
        Medium, which says whether frames are FD and identifiers have 29 bits.
    clock : Clock
        Host time.
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
        self._queue: deque[Frame] = deque()
        """Frames for which the kernel had no room yet."""
        self._since = 0.0
        """Host time since which the kernel has taken none of them [s]."""
        self._lock = threading.RLock()

    @property
    def warning(self) -> str:
        """Warning of the controller, one line; empty if there is none."""
        return self._channel.warning

    @property
    def busy(self) -> bool:
        """Whether frames wait for room in the kernel."""
        return bool(self._queue)

    def send(self, packet: Packet) -> float:
        """Send the frames of a packet without waiting; those without room are queued.

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
            If the interface is gone or down.
        """
        with self._lock:
            if not self._queue:
                self._since = self._clock.now()
            self._queue += self._encoder.frames(packet)
            self._flush()
        return self.link.seconds(encode_packet(packet))

    def send_urgent(self, packet: Packet) -> None:
        """Send a packet in place of the frames that are queued, and past those in the kernel.

        Only socketcan has a second socket with priority; on other interfaces the packet follows the
        frames that their driver has taken already.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Raises
        ------
        WireError
            If there is no room for a frame, or the interface is gone or down.
        """
        with self._lock:
            self._queue.clear()
            for frame in self._encoder.frames(packet):
                self._channel.send_urgent(frame)

    def _flush(self) -> None:
        """Send queued frames as far as there is room; the lock is held."""
        for frame in list(self._queue):
            if not self._channel.send(frame):
                return
            if not self._queue:  # an e-stop of a signal handler dropped them meanwhile
                return
            self._queue.popleft()
            self._since = self._clock.now()

    def receive(self, until: float) -> list[Packet]:
        """Send what is queued, wait for frames, and return the packets that are complete.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of Packet
            Packets in the order in which they were completed.

        Raises
        ------
        WireError
            If nobody has acknowledged for `STALL`, or the interface is bus-off, gone or down.
        """
        with self._lock:
            self._flush()
        now = self._clock.now()
        if self._queue and now - self._since > STALL:
            raise WireError("the bus takes nothing more: no other node acknowledges")
        frames = self._channel.receive(min(until, now + RETRY) if self._queue else until)
        ticks = int(self._clock.now() * TICK_HZ)
        return [
            p for identifier, data in frames for p in self._decoder.feed(identifier, data, ticks)
        ]

    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""
        self._channel.wake()

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()


class PythonCan(CanChannel):
    """Channel of python-can.

    Parameters
    ----------
    bus : can.BusABC
        Open bus, which the channel closes.
    urgent : can.BusABC
        Another open bus on the same channel, for e-stops; or the same one.
    link : Can
        Medium, which says whether frames are FD and identifiers have 29 bits.
    """

    STEP = 1e-3
    """Interval between looks for `wake`, on interfaces without a file descriptor [s]."""

    def __init__(self, bus: Any, urgent: Any, link: Can) -> None:
        self._bus, self._urgent, self._link = bus, urgent, link
        self._waker = Waker()
        self._awake = False
        self._fd = _descriptor(bus)
        # Bit 0 of the identifier is the direction: only frames from amplifiers are received.
        bus.set_filters([{"can_id": 1, "can_mask": 1, "extended": link.extended}])

    def _message(self, frame: Frame) -> Any:
        """Return a frame as python-can has it."""
        import can

        identifier, data = frame
        return can.Message(
            arbitration_id=identifier, data=data, is_extended_id=self._link.extended,
            is_fd=self._link.data is not None, bitrate_switch=self._link.data is not None,
            check=False,
        )  # fmt: skip

    def send(self, frame: Frame) -> bool:
        """Send a frame without waiting.

        Parameters
        ----------
        frame : tuple of int and bytes
            Identifier and data.

        Returns
        -------
        bool
            Whether there was room for the frame.

        Raises
        ------
        WireError
            If the interface is gone or down.
        """
        return self._send_by(self._bus, frame)

    def send_urgent(self, frame: Frame) -> None:
        """Send a frame by the bus for e-stops.

        Parameters
        ----------
        frame : tuple of int and bytes
            Identifier and data.

        Raises
        ------
        WireError
            If there is no room for the frame, or the interface is gone or down.
        """
        if not self._send_by(self._urgent, frame):
            raise WireError("the bus has no room for an e-stop: no other node acknowledges")

    def _send_by(self, bus: Any, frame: Frame) -> bool:
        """Send a frame by a bus of python-can; return whether there was room."""
        import can

        try:
            bus.send(self._message(frame), timeout=0)
        except can.CanError as error:
            if _code(error) in FULL or "buffer full" in str(error).lower():
                return False
            raise WireError(_failure(error)) from error
        return True

    def receive(self, until: float) -> list[Frame]:
        """Wait for frames, and return at most as many as `MOST_READS` reads give.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of tuple of int and bytes
            Identifiers and data of the frames that have come.

        Raises
        ------
        WireError
            If the interface is bus-off, gone or down.
        """
        import can

        frames: list[Frame] = []
        try:
            message = self._first_message(until)
            for _ in range(MOST_READS):
                if message is None and not self._readable():
                    break
                if message is None:  # slcan: an answer of the adapter, which is no frame
                    pass
                elif message.is_error_frame:
                    self._handle_error_frame(message)
                elif message.is_extended_id == self._link.extended and not message.is_remote_frame:
                    frames.append((message.arbitration_id, bytes(message.data)))
                message = self._bus.recv(0)
        except can.CanError as error:
            raise WireError(_failure(error)) from error
        except ValueError:  # slcan: a line that is no frame
            self._awake = False
        return frames

    def _first_message(self, until: float) -> Any:
        """Return the first message; None if none came in time, or `wake` was called."""
        while (remaining := until - MONOTONIC.now()) > 0 and not self._awake:
            if self._fd is not None:
                if select.select([self._fd, self._waker.fileno()], [], [], remaining)[0]:
                    break
            elif (message := self._bus.recv(min(remaining, self.STEP))) is not None:
                return message
        self._awake = False
        self._waker.clear()
        return self._bus.recv(0)

    def _readable(self) -> bool:
        """Return whether there is something to read; False if the interface cannot tell."""
        return self._fd is not None and bool(select.select([self._fd], [], [], 0)[0])

    def _handle_error_frame(self, message: Any) -> None:
        """Update the warning by an error frame; raise WireError if the controller is bus-off."""
        if message.arbitration_id & BUS_OFF:
            raise WireError(f"bus-off: too many errors; {CHECK}")
        if message.arbitration_id & CONTROLLER and len(message.data) > 1:
            if message.data[1] & PASSIVE:
                self.warning = f"error-passive: many errors; {CHECK}"
            elif message.data[1] & ACTIVE:
                self.warning = ""

    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""
        self._awake = True
        self._waker.wake()

    def close(self) -> None:
        """Shut both buses down."""
        if self._bus is None:
            return
        for bus in {id(b): b for b in (self._bus, self._urgent)}.values():
            with suppress(Exception):
                bus.shutdown()
        self._bus = None
        self._waker.close()


class SocketCan(PythonCan):
    """Channel of Linux's CAN sockets, which sends by the sockets directly.

    python-can makes three system calls for each frame, this class makes one. The frames of a packet
    have to arrive within 20 ms (SPEC.md, 3.2), from a slow computer as well.
    """

    def _send_by(self, bus: Any, frame: Frame) -> bool:
        """Send a frame by the socket of a bus; return whether there was room."""
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
            raise WireError(_failure(error)) from error
        return True


def _descriptor(bus: Any) -> int | None:
    """Return the file descriptor of a bus to wait for; None if its interface has none."""
    try:
        number = bus.fileno()
    except NotImplementedError:
        return None
    return number if isinstance(number, int) and number >= 0 else None


def _code(error: Exception) -> int | None:
    """Return the error number of an error of python-can or the system; None if it has none."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    return number or getattr(error.__cause__, "errno", None)


def _failure(error: Exception) -> str:
    """Return a description of the failure of an interface."""
    known = {
        errno.ENETDOWN: "the interface is down: bus-off, or not set up (ip link set … up)",
        errno.ENODEV: "the interface is gone",
        errno.ENXIO: "the interface is gone",
    }
    return known.get(_code(error) or 0, str(error))


# Opening


class CanOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a URL ``can:INTERFACE/CHANNEL?option=value&…``.

    Attributes
    ----------
    bitrate : float
        Nominal bit rate [bit/s].
    fd : bool
        Whether frames are CAN FD; they also are if ``data_bitrate`` is given.
    data_bitrate : float or None
        Bit rate of the data phase of CAN FD [bit/s]; by default 5 Mbit/s if ``fd`` is true.
    extended : bool
        Whether identifiers have 29 bits.
    nodes : tuple of int
        Nodes of the amplifiers in the order of the channels; by default all that answer.
    """

    bitrate: Annotated[float, Meta(ge=10e3, le=1e6)] = NOMINAL
    fd: bool = False
    data_bitrate: Annotated[float, Meta(ge=10e3, le=10e6)] | None = None
    extended: bool = False
    nodes: tuple[Annotated[int, Meta(ge=1, le=127)], ...] = ()

    @property
    def medium(self) -> Can:
        """Bus of these bit rates."""
        fd = self.fd or self.data_bitrate is not None
        data = (self.data_bitrate or DATA) if fd else None
        return Can(self.bitrate, data, self.extended)


def connect(path: str, link: Can) -> CanWire:
    """Open a CAN bus.

    Parameters
    ----------
    path : str
        Interface of python-can and its channel, such as ``socketcan/can0``.
    link : Can
        Medium, whose bit rates are set on interfaces other than socketcan.

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
            _require_interface(channel)
            buses.append(can.Bus(**arguments))
            # The socket for e-stops is never read: let next to nothing pass its filter.
            buses[0].set_filters([{"can_id": 0, "can_mask": 0x7FF, "extended": False}])
            buses[0].socket.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, PRIORITY)
        buses.append(can.Bus(**arguments))
    except (can.CanError, OSError, ValueError, ImportError) as error:
        for bus in buses:
            bus.shutdown()
        raise WireError(f"can: {path}: {_reason(interface, channel, error)}") from error
    channel_of = SocketCan if interface == "socketcan" else PythonCan
    return CanWire(channel_of(buses[-1], buses[0], link), link, MONOTONIC)


def _require_interface(channel: str) -> None:
    """Raise OSError if the kernel has no CAN, or no such interface.

    python-can raises as well, but prints a line about it and leaves a socket open. The interfaces
    are not listed by `socket.if_nameindex`, since that holds the GIL while another process sets an
    interface down, and all threads of Python stand still.
    """
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW):
        if channel not in os.listdir(INTERFACES):
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))


def _reason(interface: str, channel: str, error: Exception) -> str:
    """Return why a bus does not open, and what to do about it."""
    import can

    code = _code(error)
    if code == errno.ENODEV:
        interfaces = ", ".join(device.url for device in find()) or "none is there"
        return f"no such interface; there are: {interfaces}"
    if code == errno.EAFNOSUPPORT:
        return "this kernel has no CAN"
    if code == errno.EACCES:
        return "permission denied"
    if interface not in can.VALID_INTERFACES:
        return f"python-can has no interface {interface!r}"
    return " ".join(str(error).split())


def find() -> Iterator[FoundDevice]:
    """Find the CAN interfaces of the kernel.

    Yields
    ------
    FoundDevice
        Interface of socketcan, whether it is up or down.
    """
    with suppress(OSError):
        for name in sorted(os.listdir(INTERFACES)):
            with (
                suppress(OSError),
                open(f"{INTERFACES}/{name}/type", encoding="ascii") as type_file,
            ):
                if type_file.read().strip() == "280":  # ARPHRD_CAN
                    yield FoundDevice(f"can:socketcan/{name}", "CAN interface")


def _open(address: Address[CanOptions], display: DisplayLike, sample_rate: float | None) -> LinkBus:
    path, options = address.path, address.options
    return open_link(
        options, display, sample_rate, lambda: connect(path, options.medium),
        nodes=options.nodes,
    )  # fmt: skip


def _wire(address: Address[CanOptions]) -> tuple[Wire, Clock]:
    return connect(address.path, address.options.medium), MONOTONIC


register_bus("can", _open, CanOptions, takes_path=True, find=find, wire=_wire)
