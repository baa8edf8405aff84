"""``udp:``: packets in datagrams on the loopback interface, and what may go wrong on a network."""

import socket
import threading
from collections.abc import Iterator

import pytest

from firmware_protocol.messages import Estop, Hello
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.bus.udp_bus import LARGEST_DATAGRAM, Udp, UdpWire, connect
from tactile.bus.wire import WireError
from tactile.clock import MONOTONIC
from tactile.devices import link_at, open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError

PATIENCE = 60.0
"""Time that a datagram may take between two sockets of this machine [s]."""
LINK = Udp(10e6)


@pytest.fixture
def amplifier() -> Iterator[socket.socket]:
    """Yield the socket of an amplifier."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(PATIENCE)
        yield server


@pytest.fixture
def wire(amplifier: socket.socket) -> Iterator[UdpWire]:
    """Yield the host's end."""
    wire = connect(f"127.0.0.1:{amplifier.getsockname()[1]}", LINK)
    yield wire
    wire.close()


def numbered(number: int, size: int = 4) -> Packet:
    """Return a packet that its sequence number tells from others."""
    return Packet(Hello.TYPE, bytes(size), seq=number)


def received(wire: UdpWire, count: int) -> list[Packet]:
    """Return the next packets that come to the host."""
    packets: list[Packet] = []
    end = MONOTONIC.now() + PATIENCE
    while len(packets) < count and MONOTONIC.now() < end:
        packets += wire.receive(end)
    return packets


def test_a_datagram_holds_one_packet_as_on_a_serial_line(
    wire: UdpWire, amplifier: socket.socket
) -> None:
    seconds = [wire.send(numbered(k, 100 * k)) for k in range(3)]
    decoder = SerialDecoder()
    for k in range(3):
        datagram = amplifier.recv(2000)
        assert datagram.endswith(b"\0")
        assert decoder.feed(datagram) == [numbered(k, 100 * k)]
        # 66 bytes around it, and its own, at 10 Mbit/s
        assert seconds[k] == pytest.approx(8 * (66 + len(datagram)) / 10e6, rel=0.02)
    assert not wire.busy


def test_packets_come_back_however_many_a_datagram_holds(
    wire: UdpWire, amplifier: socket.socket
) -> None:
    wire.send(numbered(0))
    host = amplifier.recvfrom(2000)[1]
    frames = [encode_frame(encode_packet(numbered(k))) for k in range(4)]
    for datagram in (frames[0], frames[1] + frames[2], frames[3]):
        amplifier.sendto(datagram, host)
    assert received(wire, 4) == [numbered(k) for k in range(4)]


def test_what_a_datagram_leaves_unfinished_costs_nothing_of_the_next(
    wire: UdpWire, amplifier: socket.socket
) -> None:
    wire.send(numbered(0))
    host = amplifier.recvfrom(2000)[1]
    whole = encode_frame(encode_packet(numbered(1)))
    for datagram in (whole[:7], b"", whole):
        amplifier.sendto(datagram, host)
    assert received(wire, 1) == [numbered(1)]
    assert wire.counters.malformed + wire.counters.crc_errors == 1


def test_an_estop_goes_before_what_waits(wire: UdpWire, amplifier: socket.socket) -> None:
    real, full = wire._socket, FullSocket()
    wire._socket = full  # type: ignore[assignment]
    for k in range(5):
        wire.send(numbered(k))
    assert wire.busy
    assert wire.waited() >= 0
    estop = Packet.of(Estop(1))
    wire._socket = real
    wire.send_urgent(estop)
    assert SerialDecoder().feed(amplifier.recv(2000)) == [estop]
    assert not wire.busy
    wire.send(numbered(9))
    assert SerialDecoder().feed(amplifier.recv(2000)) == [numbered(9)], "nothing else was sent"


class FullSocket:
    """A socket whose buffer is full."""

    def send(self, data: bytes) -> int:
        """Take nothing."""
        raise BlockingIOError


def test_a_port_that_nobody_listens_at_is_a_broken_wire(
    wire: UdpWire, amplifier: socket.socket
) -> None:
    amplifier.close()
    wire.send(numbered(0))  # answered by the kernel with ICMP
    with pytest.raises(WireError, match=r"^udp: 127\.0\.0\.1:\d+: nothing listens at that port$"):
        received(wire, 1)


def test_another_thread_wakes_what_waits(wire: UdpWire) -> None:
    waker = threading.Timer(0.0, wire.wake)
    waker.start()
    assert wire.receive(MONOTONIC.now() + PATIENCE) == []
    waker.join()


def test_a_closed_wire_may_be_closed_and_woken_again(wire: UdpWire) -> None:
    wire.close()
    wire.close()
    wire.wake()


@pytest.mark.parametrize(
    ("url", "mistake"),
    [
        ("udp:", "give host and port"),
        ("udp:127.0.0.1", "give host and port"),
        ("udp:127.0.0.1:0", "give host and port"),
        ("udp:127.0.0.1:99999", "Port out of range"),
        ("udp:127.0.0.1:9/x", "give host and port"),
        ("udp:127.0.0.1:9?bit_rate=1", "udp: bit_rate = '1': must be 100000 … 1e\\+10"),
        ("udp:127.0.0.1:9?baud=1", "udp: unknown option 'baud'"),
    ],
)
def test_a_url_that_names_no_amplifier_is_one_line(three: Display, url: str, mistake: str) -> None:
    with pytest.raises(InputError, match=mistake) as caught:
        open_bus(url, three)
    assert "\n" not in str(caught.value)


def test_a_name_that_no_host_can_have_is_one_line(three: Display) -> None:
    with pytest.raises(BusError, match=r"udp: a\.\.b:9: .") as caught:
        open_bus("udp:a..b:9", three)
    assert "\n" not in str(caught.value)


def test_no_packet_is_cut_on_ethernet() -> None:
    link = link_at("udp:127.0.0.1:9")
    largest = encode_frame(bytes([1]) * link.largest())
    assert len(largest) <= LARGEST_DATAGRAM
    assert link.largest() > 1400
    assert link.name == "UDP 10 Mbit/s"
