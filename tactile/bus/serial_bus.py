"""``serial:``, amplifiers on a serial line: a UART, USB CDC, or a remote port by RFC 2217.

``serial:///dev/ttyACM0?baud=3000000`` or ``serial:rfc2217://host:port?baud=115200``. Without
``baud`` the line is assumed to be USB, which has no bit rate of its own.

Writing never waits: bytes that the kernel does not take are queued in the `SerialWire`, and nothing
more is sent until they are gone. A line that takes nothing for a tenth of a second counts as broken
(its reader has stalled) and is opened again.
"""

import errno
import os
import select
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta

from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import DELIMITER, SerialDecoder, encode_frame
from tactile.bus.base import DisplayLike
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, open_link
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.bus.wire import STALL, Waker, Wire, WireError
from tactile.bus.wire_time import Link, Uart, Usb
from tactile.clock import MONOTONIC, Clock

LARGEST_READ = 65536
"""Maximum number of bytes of one read."""
PURGE_OUTPUT = b"\x02"
"""Argument of RFC 2217's PURGE-DATA that purges what the server has not sent yet."""
NO_RATE = 115200
"""Bit rate that is set if the line has none of its own [bit/s]."""


class SerialLine(ABC):
    """Byte stream in both directions, the driver below a `SerialWire`.

    Its errors are OSErrors. Any thread may call `wake`, also while another one waits.
    """

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Take bytes without waiting.

        Parameters
        ----------
        data : bytes
            Bytes to write; may be empty.

        Returns
        -------
        int
            Number of bytes that were taken.
        """

    @abstractmethod
    def read(self) -> bytes:
        """Return the bytes that have come, without waiting.

        Returns
        -------
        bytes
            Bytes that were received; may be empty.
        """

    @abstractmethod
    def wait(self, until: float, *, writable: bool) -> None:
        """Wait for received bytes, but no longer than until `wake`.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].
        writable : bool
            Whether to return as well when the line takes more bytes.
        """

    @abstractmethod
    def wake(self) -> None:
        """Make `wait` return; it may be called from any thread."""

    @abstractmethod
    def waiting(self) -> int:
        """Return the number of bytes that were written and are not on the wire yet.

        Returns
        -------
        int
            Number of bytes; 0 if unknown.
        """

    @abstractmethod
    def discard(self) -> None:
        """Drop the bytes that were written and are not on the wire yet."""

    @abstractmethod
    def close(self) -> None:
        """Close the line; it may be called any number of times."""


class SerialWire(Wire):
    """Packets on a serial line.

    A lock lets different threads call `send`, `send_urgent` and `receive`. It is reentrant, since a
    signal handler may call `send_urgent` while the thread that it interrupts sends.

    Parameters
    ----------
    line : SerialLine
        Byte stream, which the wire closes.
    link : Link
        Medium, which knows how long packets take.
    clock : Clock
        Host time.
    """

    def __init__(self, line: SerialLine, link: Link, clock: Clock) -> None:
        super().__init__(link)
        self._line, self._clock = line, clock
        self._decoder = SerialDecoder(counters=self.counters)
        self._queue = b""
        """Bytes that the kernel has not taken yet."""
        self._since = 0.0
        """Host time since which the kernel has taken none of them [s]."""
        self._lock = threading.RLock()
        self._written = 0
        """Number of bytes that the kernel has taken."""
        self._times: deque[tuple[int, float]] = deque()
        """Values of that number and the host times at which they were reached [s]."""
        self._write(DELIMITER)

    @property
    def busy(self) -> bool:
        """Whether the kernel has not taken all bytes yet."""
        return bool(self._queue)

    def send(self, packet: Packet) -> float:
        """Write a packet without waiting; bytes that the kernel does not take are queued.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Returns
        -------
        float
            Time that the packet takes on the line [s].

        Raises
        ------
        OSError
            If the port fails.
        """
        data = encode_packet(packet)
        self._write(encode_frame(data))
        return self.link.seconds(data)

    def send_urgent(self, packet: Packet) -> None:
        """Write a packet in place of everything that waits here and in the kernel.

        A delimiter goes first, which ends the frame that was cut off.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Raises
        ------
        OSError
            If the port fails.
        """
        with self._lock:
            self._queue = b""
            self._line.discard()
            self._write(DELIMITER + encode_frame(encode_packet(packet)))

    def _write(self, data: bytes) -> None:
        """Queue bytes and write what the kernel takes."""
        with self._lock:
            if not self._queue:
                self._since = self._clock.now()
            self._queue += data
            self._flush()

    def _flush(self) -> None:
        """Write what is queued, as far as the kernel takes it; the lock is held."""
        queue = self._queue
        written = self._line.write(queue)
        if written:
            if self._queue is queue:  # no e-stop of a signal handler took its place meanwhile
                self._queue, self._since = queue[written:], self._clock.now()
            self._written += written
            self._times.append((self._written, self._since))

    def waited(self) -> float:
        """Return how long the oldest byte that the kernel still has has been waiting.

        Returns
        -------
        float
            Time [s]; 0 if nothing waits, or the line cannot tell.
        """
        sent = self._written - self._line.waiting()
        while self._times and self._times[0][0] <= sent:
            self._times.popleft()
        return self._clock.now() - self._times[0][1] if self._times else 0.0

    def receive(self, until: float) -> list[Packet]:
        """Wait for bytes, write what is queued, and return the packets that are complete.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of Packet
            Packets in the order in which they came.

        Raises
        ------
        WireError
            If the port is gone, or the kernel has taken nothing of what is queued for `STALL`.
        OSError
            If the port fails otherwise.
        """
        self._line.wait(until, writable=self.busy)
        with self._lock:
            if self._queue:
                self._flush()
            if self._queue and self._clock.now() - self._since > STALL:
                raise WireError(f"the line takes nothing more; {len(self._queue)} bytes wait")
        return self._decoder.feed(self._line.read())

    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""
        self._line.wake()

    def close(self) -> None:
        """Close the line."""
        self._line.close()


class PosixLine(SerialLine):
    """Terminal device by its file descriptor.

    Parameters
    ----------
    port : serial.Serial
        Open port of pyserial that has a file descriptor.
    """

    def __init__(self, port: Any) -> None:
        self._port, self._fd = port, port.fileno()
        os.set_blocking(self._fd, False)
        self._waker = Waker()
        self._poll = select.poll()
        self._poll.register(self._waker, select.POLLIN)
        self._poll.register(self._fd, select.POLLIN)

    def write(self, data: bytes) -> int:
        """Write bytes to the kernel without waiting.

        Parameters
        ----------
        data : bytes
            Bytes to write.

        Returns
        -------
        int
            Number of bytes that the kernel has taken.
        """
        try:
            return os.write(self._fd, data) if data else 0
        except BlockingIOError:
            return 0

    def read(self) -> bytes:
        """Return the bytes that have come.

        Returns
        -------
        bytes
            At most `LARGEST_READ` bytes.
        """
        try:
            return os.read(self._fd, LARGEST_READ)
        except BlockingIOError:
            return b""

    def wait(self, until: float, *, writable: bool) -> None:
        """Wait for received bytes; poll rounds the time up to milliseconds.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].
        writable : bool
            Whether to return as well when the kernel takes more bytes.

        Raises
        ------
        WireError
            If the port is gone.
        """
        self._poll.modify(self._fd, select.POLLIN | (select.POLLOUT if writable else 0))
        seconds = until - MONOTONIC.now()
        events = dict(self._poll.poll(max(0.0, seconds) * 1000))
        if self._waker.fileno() in events:
            self._waker.clear()
        if events.get(self._fd, 0) & (select.POLLERR | select.POLLHUP | select.POLLNVAL):
            raise WireError("the port is gone")

    def wake(self) -> None:
        """Make `wait` return; it may be called from any thread."""
        self._waker.wake()

    def waiting(self) -> int:
        """Return the number of bytes in the kernel's output buffer.

        Returns
        -------
        int
            Number of bytes.
        """
        return int(self._port.out_waiting)

    def discard(self) -> None:
        """Drop the bytes in the kernel's output buffer."""
        self._port.reset_output_buffer()

    def close(self) -> None:
        """Close the port."""
        if self._fd < 0:
            return
        self._fd = -1
        with suppress(OSError):
            self._port.close()
        self._waker.close()


class PortLine(SerialLine):
    """Port of pyserial without a file descriptor: by RFC 2217, or on a system other than POSIX.

    Parameters
    ----------
    port : serial.SerialBase
        Open port of pyserial.
    """

    STEP = 2e-3
    """Interval between looks at what has come [s]."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._woken = False

    def write(self, data: bytes) -> int:
        """Write bytes by pyserial; by RFC 2217 it waits while the connection is blocked.

        Parameters
        ----------
        data : bytes
            Bytes to write.

        Returns
        -------
        int
            Number of bytes that were taken.
        """
        return int(self._port.write(data) or 0) if data else 0

    def read(self) -> bytes:
        """Return the bytes that have come.

        Returns
        -------
        bytes
            Bytes that were received; may be empty.
        """
        data = bytes(self._port.read(max(1, self._port.in_waiting)))
        while waiting := self._port.in_waiting:  # RFC 2217 reads one byte at a time
            data += self._port.read(waiting)
        return data

    def wait(self, until: float, *, writable: bool) -> None:
        """Wait for received bytes, by looking each `STEP`.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].
        writable : bool
            Not used: whether the port takes more bytes cannot be waited for.
        """
        while not (self._woken or self._port.in_waiting or MONOTONIC.now() >= until):
            MONOTONIC.sleep(self.STEP)
        self._woken = False

    def wake(self) -> None:
        """Make `wait` return; it may be called from any thread."""
        self._woken = True

    def waiting(self) -> int:
        """Return 0, since not every port knows how many bytes wait.

        Returns
        -------
        int
            Always 0.
        """
        return 0

    def discard(self) -> None:
        """Drop the bytes that wait to be sent.

        On RFC 2217 the purge is requested without the 50 ms for which pyserial waits for its
        answer.
        """
        purge = getattr(self._port, "_rfc2217_options", {}).get("purge")
        if purge is None:
            self._port.reset_output_buffer()
        else:
            purge.set(PURGE_OUTPUT)

    def close(self) -> None:
        """Close the port."""
        with suppress(OSError):
            self._port.close()


# Opening


class SerialOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a URL ``serial:PORT?option=value&…``, where PORT may be a URL of pyserial.

    Attributes
    ----------
    baud : float or None
        Bit rate of a UART [bit/s]; by default the line is USB CDC, which has none.
    """

    baud: Annotated[float, Meta(ge=1200, le=100e6)] | None = None

    @property
    def medium(self) -> Link:
        """UART of that bit rate, or USB."""
        return Usb() if self.baud is None else Uart(self.baud)


def connect(path: str, link: Link) -> SerialWire:
    """Open a serial line.

    Parameters
    ----------
    path : str
        Device of the port, or a URL of pyserial.
    link : Link
        Medium of the line; a `Uart` has the bit rate that is set.

    Returns
    -------
    SerialWire
        The open line.

    Raises
    ------
    WireError
        If the port cannot be opened, with what to do about it.
    """
    import serial

    rate = round(link.bit_rate) if isinstance(link, Uart) else NO_RATE
    local = "://" not in path  # RFC 2217 has neither a lock nor a time-out of writing
    own: dict[str, Any] = {"exclusive": True, "write_timeout": STALL} if local else {}
    try:
        port = serial.serial_for_url(path, baudrate=rate, timeout=0, **own)
    except (OSError, ValueError) as error:
        raise WireError(f"serial: {path}: {_reason(path, error)}") from error
    with suppress(Exception):
        port.set_low_latency_mode(True)
    line: SerialLine = (
        PosixLine(port) if os.name == "posix" and hasattr(port, "fd") else PortLine(port)
    )
    try:
        return SerialWire(line, link, MONOTONIC)
    except OSError as error:
        line.close()
        raise WireError(f"serial: {path}: {_reason(path, error)}") from error


def _reason(path: str, error: Exception) -> str:
    """Return why a port does not open, and what to do about it."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return f"permission denied; {_permission_advice(path)}"
    if number == errno.ENOENT:
        ports = ", ".join(port.url for port in find()) or "none is there"
        return f"no such port; there are: {ports}"
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
        return "another program holds the port; close it"
    return str(error).removeprefix(f"could not open port {path}: ")


def _permission_advice(path: str) -> str:
    """Return what a user has to do to be permitted to open a port."""
    import grp

    try:
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        return "ask the administrator"
    return f"sudo usermod -aG {group} $USER, then log in again"


def find() -> Iterator[FoundDevice]:
    """Find the serial ports of this computer.

    Yields
    ------
    FoundDevice
        Port, described by its USB ids and serial number if it has them.
    """
    from serial.tools import list_ports

    for port in sorted(list_ports.comports()):
        about = "serial port" if port.description in (None, "", "n/a") else port.description
        if port.vid is not None:
            about += f", USB {port.vid:04x}:{port.pid:04x}"
        if port.serial_number:
            about += f", serial {port.serial_number}"
        yield FoundDevice(f"serial://{port.device}", about)


def _open(
    address: Address[SerialOptions], display: DisplayLike, sample_rate: float | None
) -> LinkBus:
    path, options = address.path, address.options
    return open_link(options, display, sample_rate, lambda: connect(path, options.medium))


def _wire(address: Address[SerialOptions]) -> tuple[Wire, Clock]:
    return connect(address.path, address.options.medium), MONOTONIC


register_bus("serial", _open, SerialOptions, takes_path=True, find=find, wire=_wire)
