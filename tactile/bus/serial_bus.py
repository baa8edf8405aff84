"""``serial:``, amplifiers on a serial line: UART, USB CDC, or one far away by RFC 2217.

``serial:///dev/ttyACM0?baud=3000000`` or ``serial:rfc2217://host:port?baud=115200``. Without
``baud`` the line is taken for USB, which has no bit rate of its own. Written is never waited for:
what the kernel does not take stays here, and nothing more is sent until it is gone. A line that
takes nothing for a tenth of a second is broken (its reader has stalled), and is opened anew.
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
from tactile.bus.registry import Address, Found, register_bus
from tactile.bus.wire import STALL, Wire, WireError
from tactile.bus.wire_time import Link, Uart, Usb
from tactile.clock import MONOTONIC, Clock

LARGEST_READ = 65536
PURGE_OUTPUT = b"\x02"
"""Of RFC 2217's PURGE-DATA: what the server has not sent yet."""
NO_RATE = 115200
"""baud that is set where the line has none."""


class SerialLine(ABC):
    """Bytes both ways; the driver below a `SerialWire`. Its errors are OSErrors."""

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Take bytes without waiting; return how many."""

    @abstractmethod
    def read(self) -> bytes:
        """Return what has come."""

    @abstractmethod
    def wait(self, until: float, *, writable: bool) -> None:
        """Wait for bytes, until a host time [s], until woken or, if asked, until it takes more."""

    @abstractmethod
    def wake(self) -> None:
        """Let `wait` return."""

    @abstractmethod
    def waiting(self) -> int:
        """Return how many bytes were written and are not on the wire yet; 0 where unknown."""

    @abstractmethod
    def discard(self) -> None:
        """Drop what was written and is not on the wire yet."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""


class SerialWire(Wire):
    """Packets on a line.

    Parameters
    ----------
    line : of bytes
    link : how long they take
    clock : host time
    """

    def __init__(self, line: SerialLine, link: Link, clock: Clock) -> None:
        super().__init__(link)
        self._line, self._clock = line, clock
        self._decoder = SerialDecoder(counters=self.counters)
        self._rest = b""
        self._since = 0.0
        self._order = threading.Lock()
        self._written = 0
        self._times: deque[tuple[int, float]] = deque()
        self._write(DELIMITER)

    @property
    def busy(self) -> bool:
        """Whether the kernel has not taken all."""
        return bool(self._rest)

    def send(self, packet: Packet) -> float:
        """Write a packet; return how long it takes."""
        data = encode_packet(packet)
        self._write(encode_frame(data))
        return self.link.seconds(data)

    def urge(self, packet: Packet) -> None:
        """Drop what waits here and in the kernel, end the frame that was cut, and write."""
        with self._order:
            self._rest = b""
            self._line.discard()
            self._add(DELIMITER + encode_frame(encode_packet(packet)))

    def _write(self, data: bytes) -> None:
        with self._order:
            self._add(data)

    def _add(self, data: bytes) -> None:
        if not self._rest:
            self._since = self._clock.now()
        self._rest += data
        self._flush()

    def _flush(self) -> None:
        """Write what waits, by one thread at a time."""
        taken = self._line.write(self._rest)
        if taken:
            self._rest, self._since = self._rest[taken:], self._clock.now()
            self._written += taken
            self._times.append((self._written, self._since))

    def waited(self) -> float:
        """Tell for how long the oldest byte has waited that the kernel still has [s]."""
        gone = self._written - self._line.waiting()
        while self._times and self._times[0][0] <= gone:
            self._times.popleft()
        return self._clock.now() - self._times[0][1] if self._times else 0.0

    def receive(self, until: float) -> list[Packet]:
        """Return what came."""
        self._line.wait(until, writable=self.busy)
        with self._order:
            if self._rest:
                self._flush()
            if self._rest and self._clock.now() - self._since > STALL:
                raise WireError(f"the line takes nothing more; {len(self._rest)} bytes wait")
        return self._decoder.feed(self._line.read())

    def wake(self) -> None:
        """Let `receive` return."""
        self._line.wake()

    def close(self) -> None:
        """Close the line."""
        self._line.close()


class PosixLine(SerialLine):
    """A tty by its file descriptor."""

    def __init__(self, port: Any) -> None:
        self._port, self._fd = port, port.fileno()
        os.set_blocking(self._fd, False)
        self._woken, self._waker = os.pipe()
        os.set_blocking(self._woken, False)
        os.set_blocking(self._waker, False)
        self._poll = select.poll()
        self._poll.register(self._woken, select.POLLIN)
        self._poll.register(self._fd, select.POLLIN)

    def write(self, data: bytes) -> int:
        """Take bytes."""
        try:
            return os.write(self._fd, data) if data else 0
        except BlockingIOError:
            return 0

    def read(self) -> bytes:
        """Return what has come."""
        try:
            return os.read(self._fd, LARGEST_READ)
        except BlockingIOError:
            return b""

    def wait(self, until: float, *, writable: bool) -> None:
        """Wait, with the resolution of poll, rounded up."""
        self._poll.modify(self._fd, select.POLLIN | (select.POLLOUT if writable else 0))
        seconds = until - MONOTONIC.now()
        events = dict(self._poll.poll(max(0.0, seconds) * 1000))
        if self._woken in events:
            with suppress(BlockingIOError):
                os.read(self._woken, 4096)
        if events.get(self._fd, 0) & (select.POLLERR | select.POLLHUP | select.POLLNVAL):
            raise WireError("the port is gone")

    def wake(self) -> None:
        """Let `wait` return."""
        with suppress(OSError):
            os.write(self._waker, b"\0")

    def waiting(self) -> int:
        """Ask the kernel."""
        return int(self._port.out_waiting)

    def discard(self) -> None:
        """Drop the kernel's output buffer."""
        self._port.reset_output_buffer()

    def close(self) -> None:
        """Close everything."""
        if self._fd < 0:
            return
        self._fd = -1
        with suppress(OSError):
            self._port.close()
        woken, waker, self._woken, self._waker = self._woken, self._waker, -1, -1
        os.close(woken)
        os.close(waker)


class PortLine(SerialLine):
    """A port of pyserial that has no file descriptor: RFC 2217, or another system's."""

    STEP = 2e-3
    """s between looks at what has come."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._woken = False

    def write(self, data: bytes) -> int:
        """Take bytes."""
        return int(self._port.write(data) or 0) if data else 0

    def read(self) -> bytes:
        """Return what has come."""
        data = bytes(self._port.read(max(1, self._port.in_waiting)))
        while waiting := self._port.in_waiting:  # RFC 2217 reads byte by byte
            data += self._port.read(waiting)
        return data

    def wait(self, until: float, *, writable: bool) -> None:
        """Look now and then."""
        while not (self._woken or self._port.in_waiting or MONOTONIC.now() >= until):
            MONOTONIC.sleep(self.STEP)
        self._woken = False

    def wake(self) -> None:
        """Let `wait` return."""
        self._woken = True

    def waiting(self) -> int:
        """Return 0: not every port can tell."""
        return 0

    def discard(self) -> None:
        """Drop what waits; by RFC 2217 without the 50 ms that pyserial waits for the answer."""
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
    """Options of a ``serial:`` URL.

    Attributes
    ----------
    baud : float or None
        Bit rate of a UART [bit/s]; None for USB CDC, which has none.
    """

    baud: Annotated[float, Meta(ge=1200, le=100e6)] | None = None


def link_of(options: SerialOptions) -> Link:
    """Return how long packets take on the line.

    Parameters
    ----------
    options : SerialOptions
        Options of the device's URL.

    Returns
    -------
    Link
        A UART of that bit rate, or USB.
    """
    return Usb() if options.baud is None else Uart(options.baud)


def connect(path: str, link: Link, clock: Clock) -> SerialWire:
    """Open a serial line.

    Parameters
    ----------
    path : str
        Device of the port, or a URL of pyserial.
    link : Link
        How long packets take on the line.
    clock : Clock
        Clock by which the wire waits.

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
    local = "://" not in path  # RFC 2217 has neither a lock nor a limit to writing
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
        return SerialWire(line, link, clock)
    except OSError as error:
        line.close()
        raise WireError(f"serial: {path}: {_reason(path, error)}") from error


def _reason(path: str, error: Exception) -> str:
    """Return why a port does not open, and what would do."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return f"permission denied; {_group(path)}"
    if number == errno.ENOENT:
        ports = ", ".join(found.url for found in find()) or "none is there"
        return f"no such port; there are: {ports}"
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
        return "another program holds the port; close it"
    return str(error).removeprefix(f"could not open port {path}: ")


def _group(path: str) -> str:
    """Return how to be allowed to open a port."""
    import grp

    try:
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        return "ask the administrator"
    return f"sudo usermod -aG {group} $USER, then log in again"


def find() -> Iterator[Found]:
    """Yield the serial ports that are there, with what USB says of them."""
    from serial.tools import list_ports

    for port in sorted(list_ports.comports()):
        about = "serial port" if port.description in (None, "", "n/a") else port.description
        if port.vid is not None:
            about += f", USB {port.vid:04x}:{port.pid:04x}"
        if port.serial_number:
            about += f", serial {port.serial_number}"
        yield Found(f"serial://{port.device}", about)


def _open(
    address: Address[SerialOptions], display: DisplayLike, sample_rate: float | None
) -> LinkBus:
    path, options, link = address.path, address.options, link_of(address.options)
    return open_link(options, display, sample_rate, link, lambda: connect(path, link, MONOTONIC))


register_bus("serial", _open, SerialOptions, takes_path=True, find=find, link=link_of)
