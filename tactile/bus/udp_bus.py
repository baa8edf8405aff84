"""``udp:``, amplifiers on a local network, one datagram for each packet.

``udp:192.168.4.1:7412`` or ``udp:[fe80::1%eth0]:7412``. A datagram holds frames of the serial link
(SPEC.md, 3.4), so that a board with Ethernet or Wi-Fi reads it with the decoder of that link. The
link sends nothing again: a datagram that is lost, repeated or late is a packet that is lost,
repeated or late.
"""

import selectors
import socket
import threading
from collections import deque
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from msgspec import Meta

from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import (
    COBS_RUN,
    DELIMITER,
    SerialDecoder,
    coded_limit,
    encode_frame,
)
from tactile.bus.base import DisplayLike
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, open_link
from tactile.bus.registry import Address, register_bus
from tactile.bus.wire import STALL, Waker, Wire, WireError
from tactile.bus.wire_time import Link
from tactile.clock import MONOTONIC, Clock
from tactile.errors import InputError

HEADERS = 66
"""Size of what surrounds a datagram on Ethernet: preamble, MAC header, FCS and gap (IEEE 802.3,
38 bytes), IPv4 (RFC 791, 20) and UDP (RFC 768, 8) [bytes]."""
LARGEST_DATAGRAM = 1472
"""Size of the largest datagram that Ethernet carries in one piece: 1500 less the headers of IPv4
and UDP [bytes]."""
LARGEST_READ = 65536
"""Maximum size of one read; no datagram is longer [bytes]."""
MOST_READS = 64
"""Maximum number of datagrams that are read before queued ones are sent."""


@dataclass(frozen=True)
class Udp(Link):
    """Ethernet or Wi-Fi, full duplex.

    Attributes
    ----------
    bit_rate : float
        Bit rate in each direction [bit/s].
    cap : float
        Part of the bit rate that may be used.
    """

    bit_rate: float
    cap = 0.5

    @property
    def name(self) -> str:
        """Name of the link with its bit rate."""
        return f"UDP {self.bit_rate / 1e6:g} Mbit/s"

    def seconds(self, packet: bytes) -> float:
        """Return the time that a packet takes.

        Parameters
        ----------
        packet : bytes
            Bytes of the packet.

        Returns
        -------
        float
            Time of its datagram on Ethernet, with all headers [s].
        """
        return 8 * (HEADERS + coded_limit(len(packet)) + len(DELIMITER)) / self.bit_rate

    def largest(self) -> int:
        """Return the size of the largest packet whose datagram Ethernet carries in one piece.

        Returns
        -------
        int
            Size of the packet [bytes].
        """
        coded = LARGEST_DATAGRAM - len(DELIMITER) - 1
        return coded * COBS_RUN // (COBS_RUN + 1)


class UdpWire(Wire):
    """Packets in datagrams.

    A lock lets different threads call `send`, `send_urgent` and `receive`. It is reentrant, since a
    signal handler may call `send_urgent` while the thread that it interrupts sends.

    Parameters
    ----------
    connection : socket.socket
        UDP socket that is connected to the amplifier; the wire closes it.
    link : Link
        Medium, which knows how long packets take.
    clock : Clock
        Host time.
    name : str
        Host and port, for error messages.
    """

    def __init__(self, connection: socket.socket, link: Link, clock: Clock, name: str) -> None:
        super().__init__(link)
        self._name = name
        self._socket, self._clock = connection, clock
        self._decoder = SerialDecoder(counters=self.counters)
        self._queue: deque[tuple[bytes, float]] = deque()
        """Datagrams that the kernel has not taken, each with the host time of its sending [s]."""
        self._lock = threading.RLock()
        self._socket.setblocking(False)
        self._waker = Waker()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._waker, selectors.EVENT_READ)
        self._selector.register(self._socket, selectors.EVENT_READ)

    @property
    def busy(self) -> bool:
        """Whether the kernel has not taken all datagrams yet."""
        return bool(self._queue)

    def send(self, packet: Packet) -> float:
        """Send a packet without waiting; a datagram that the kernel does not take is queued.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Returns
        -------
        float
            Time that the packet takes on the link [s].

        Raises
        ------
        WireError
            If nothing listens at the other end, or the network is down.
        """
        data = encode_packet(packet)
        with self._lock:
            self._queue.append((encode_frame(data), self._clock.now()))
            self._flush()
        return self.link.seconds(data)

    def send_urgent(self, packet: Packet) -> None:
        """Send a packet in place of the datagrams that are queued.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Raises
        ------
        WireError
            If nothing listens at the other end, or the network is down.
        """
        with self._lock:
            self._queue.clear()
            self._queue.append((encode_frame(encode_packet(packet)), self._clock.now()))
            self._flush()

    def _flush(self) -> None:
        """Send queued datagrams as far as the kernel takes them; the lock is held."""
        try:
            for datagram, _ in list(self._queue):
                self._socket.send(datagram)
                if not self._queue:  # an e-stop of a signal handler took their place meanwhile
                    return
                self._queue.popleft()
        except BlockingIOError:
            return
        except OSError as error:
            raise WireError(f"udp: {self._name}: {_reason(error)}") from error

    def waited(self) -> float:
        """Return how long the oldest datagram that the kernel has not taken has been waiting.

        Returns
        -------
        float
            Time [s]; 0 if none waits.
        """
        with self._lock:
            return self._clock.now() - self._queue[0][1] if self._queue else 0.0

    def receive(self, until: float) -> list[Packet]:
        """Wait for datagrams, send those that are queued, and return the packets that have come.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of Packet
            Packets in the order in which they came; empty if none came, or `wake` was called.

        Raises
        ------
        WireError
            If nothing listens at the other end, the network is down, or the kernel has not taken a
            queued datagram for `STALL`.
        """
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if self.busy else 0)
        self._selector.modify(self._socket, events)
        ready = {key.fileobj for key, _ in self._selector.select(max(until - MONOTONIC.now(), 0.0))}
        if self._waker in ready:
            self._waker.clear()
        with self._lock:
            self._flush()
        if self.waited() > STALL:
            raise WireError(f"the network takes nothing more; {len(self._queue)} datagrams wait")
        packets: list[Packet] = []
        for _ in range(MOST_READS):
            try:
                datagram = self._socket.recv(LARGEST_READ)
            except BlockingIOError:
                break
            except OSError as error:
                raise WireError(f"udp: {self._name}: {_reason(error)}") from error
            packets += self._decoder.feed(DELIMITER + datagram)
        return packets

    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""
        self._waker.wake()

    def close(self) -> None:
        """Close the socket."""
        self._selector.close()
        self._socket.close()
        self._waker.close()


class UdpOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a URL ``udp:HOST:PORT?option=value&…``.

    Attributes
    ----------
    bit_rate : float
        Bit rate of the slowest part of the network path, by which packets are paced [bit/s].
    """

    bit_rate: Annotated[float, Meta(ge=1e5, le=1e10)] = 10e6

    @property
    def medium(self) -> Udp:
        """Network of that bit rate."""
        return Udp(self.bit_rate)


def connect(path: str, link: Link) -> UdpWire:
    """Open a socket to an amplifier.

    A host name is resolved first, which may take a while.

    Parameters
    ----------
    path : str
        Host and port, such as ``192.168.4.1:7412``.
    link : Link
        Medium, which knows how long packets take.

    Returns
    -------
    UdpWire
        The open wire. Whether an amplifier listens there is known only when it answers.

    Raises
    ------
    InputError
        If the path names no host and port.
    WireError
        If the host is not known or cannot be reached.
    """
    try:
        parts = urlsplit(f"//{path}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError(f"udp: {path}: {error}") from None
    if not host or not port or parts.path or parts.username:
        raise InputError(f"udp: {path!r}: give host and port, as udp:192.168.4.1:7412")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[
            0
        ]
        connection = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:  # UnicodeError: not a possible host name
        raise WireError(f"udp: {path}: {_reason(error)}") from error
    try:
        connection.connect(address)
        return UdpWire(connection, link, MONOTONIC, path)
    except OSError as error:
        connection.close()
        raise WireError(f"udp: {path}: {_reason(error)}") from error


def _reason(error: OSError | UnicodeError) -> str:
    """Return why the network does not carry a packet."""
    if isinstance(error, ConnectionRefusedError):
        return "nothing listens at that port"
    return str(getattr(error, "strerror", None) or error)


def _open(address: Address[UdpOptions], display: DisplayLike, sample_rate: float | None) -> LinkBus:
    path, options = address.path, address.options
    return open_link(options, display, sample_rate, lambda: connect(path, options.medium))


def _wire(address: Address[UdpOptions]) -> tuple[Wire, Clock]:
    return connect(address.path, address.options.medium), MONOTONIC


register_bus("udp", _open, UdpOptions, takes_path=True, wire=_wire)
