"""Checks in user-mode Linux: CAN, by the kernel's virtual interface."""

import errno
import socket
from collections.abc import Iterator

import can
import pytest
import serial
from can.interfaces.socketcan import SocketcanBus
from guest_tools import WAIT, command, received, virtual_amplifier

from firmware_protocol.host import AmplifierHost
from firmware_protocol.messages import Hello
from firmware_protocol.packet import encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame

INTERFACE = "vcan0"
FD_MTU = 72

Pair = tuple[SocketcanBus, SocketcanBus]


@pytest.fixture(scope="module", autouse=True)
def interface() -> Iterator[None]:
    command("ip", "link", "add", INTERFACE, "type", "vcan")
    command("ip", "link", "set", INTERFACE, "mtu", str(FD_MTU), "up")
    yield
    command("ip", "link", "delete", INTERFACE)


@pytest.fixture
def pair() -> Iterator[Pair]:
    with SocketcanBus(INTERFACE, fd=True) as first, SocketcanBus(INTERFACE, fd=True) as second:
        yield first, second


def test_classic_frames(pair: Pair) -> None:
    first, second = pair
    for identifier, extended in ((0x123, False), (0x1D0B0402, True)):
        data = bytes(range(8))
        first.send(can.Message(arbitration_id=identifier, is_extended_id=extended, data=data))
        message = received(second)
        assert (message.arbitration_id, message.is_extended_id) == (identifier, extended)
        assert bytes(message.data) == data
        assert not message.is_fd


def test_fd_frames(pair: Pair) -> None:
    first, second = pair
    data = bytes(range(64))
    first.send(can.Message(arbitration_id=1, data=data, is_fd=True, bitrate_switch=True))
    message = received(second)
    assert bytes(message.data) == data
    assert message.is_fd
    assert message.bitrate_switch


def test_filters_of_the_kernel(pair: Pair) -> None:
    first, second = pair
    second.set_filters([{"can_id": 0x200, "can_mask": 0x700, "extended": False}])
    for identifier in (0x123, 0x234):
        first.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    assert received(second).arbitration_id == 0x234


def test_frames_stay_in_order(pair: Pair) -> None:
    first, second = pair
    for i in range(200):
        first.send(can.Message(arbitration_id=i, is_extended_id=False))
    assert [received(second).arbitration_id for _ in range(200)] == list(range(200))


def test_sockets_of_two_priorities(pair: Pair) -> None:
    first, second = pair
    with SocketcanBus(INTERFACE, fd=True) as urgent:
        for bus, priority in ((first, 0), (urgent, 6)):
            bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, priority)
            assert bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY) == priority
            bus.send(can.Message(arbitration_id=priority, is_extended_id=False))
            assert received(second).arbitration_id == priority


def test_an_interface_that_goes_down(pair: Pair) -> None:
    first, second = pair
    command("ip", "link", "set", INTERFACE, "down")
    for bus in pair:
        with pytest.raises(can.CanOperationError) as caught:
            bus.recv(WAIT)
        assert caught.value.error_code == errno.ENETDOWN
    with pytest.raises(can.CanOperationError) as caught:
        first.send(can.Message(arbitration_id=1))
    assert caught.value.error_code == errno.ENETDOWN
    command("ip", "link", "set", INTERFACE, "up")
    first.send(can.Message(arbitration_id=1))
    assert received(second).arbitration_id == 1


def test_the_amplifier_in_c_answers_on_a_terminal() -> None:
    host = AmplifierHost(session=0x1234, node=1)
    decoder = SerialDecoder()
    with virtual_amplifier("--pty") as amplifier:
        assert amplifier.stdout is not None
        with serial.Serial(amplifier.stdout.readline().strip(), timeout=WAIT) as port:
            port.write(b"\0" + encode_frame(encode_packet(host.request(Hello(host.session, 1)))))
            while host.caps is None:
                data = port.read(1)
                assert data, f"nothing came for {WAIT} s"
                for packet in decoder.feed(data):
                    host.receive(packet)
    assert host.caps.channels == 24
