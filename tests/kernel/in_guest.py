"""Checks in QEMU with Debian's kernel: a CAN adapter, a serial gadget and a sound card."""

import errno
import importlib
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import numpy as np
import pytest
import serial
from can.interfaces.socketcan import SocketcanBus
from gs_usb_adapter import CLOCK_HZ, GsUsb
from guest_tools import WAIT, command, received, wait_for
from numpy.typing import NDArray
from serial_gadget import DEVICE, HOST, SerialGadget

CAN = "can0"
BIT_RATE = 500_000
Line = tuple[serial.Serial, serial.Serial]
"""The host's end and the device's."""


class Adapter(GsUsb):
    """An adapter that keeps what is on its bus."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes]] = []
        super().__init__(0, lambda identifier, data: self.frames.append((identifier, data)))


def can_state() -> str:
    """Return what the kernel takes the state of the CAN interface for."""
    words = command("ip", "-details", "link", "show", CAN).split()
    return words[words.index("state", words.index("can")) + 1]


def up() -> None:
    command("ip", "link", "set", CAN, "up", "type", "can", "bitrate", str(BIT_RATE))


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    adapter = Adapter()
    interface = Path("/sys/class/net", CAN)
    wait_for(f"{CAN} appears", interface.exists)
    up()
    yield adapter
    if interface.exists():
        adapter.unplug()
    wait_for(f"{CAN} is gone", lambda: not interface.exists())


@pytest.fixture
def bus(adapter: Adapter) -> Iterator[SocketcanBus]:
    with SocketcanBus(CAN) as bus:
        yield bus


def test_frames_both_ways(adapter: Adapter, bus: SocketcanBus) -> None:
    prescaler = adapter.bit_timing[4]
    assert CLOCK_HZ / prescaler / (1 + sum(adapter.bit_timing[:3])) == BIT_RATE
    bus.send(can.Message(arbitration_id=0x402, is_extended_id=False, data=b"12345678"))
    wait_for("the frame is on the bus", lambda: bool(adapter.frames))
    assert adapter.frames == [(0x402, b"12345678")]
    adapter.inject(0x203, b"abc")
    message = received(bus)
    assert (message.arbitration_id, bytes(message.data)) == (0x203, b"abc")


def test_a_socket_with_priority_overtakes(adapter: Adapter, bus: SocketcanBus) -> None:
    with SocketcanBus(CAN) as urgent:
        urgent.socket.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, 6)
        adapter.hold()
        for i in range(20):
            bus.send(can.Message(arbitration_id=0x402, is_extended_id=False, data=[i]))
        urgent.send(can.Message(arbitration_id=0, is_extended_id=False))
        adapter.release()
        wait_for("all frames are on the bus", lambda: len(adapter.frames) == 21)
    assert [data[0] for identifier, data in adapter.frames if identifier] == list(range(20))
    assert adapter.frames.index((0, b"")) < 20


def test_error_passive(adapter: Adapter, bus: SocketcanBus) -> None:
    assert can_state() == "ERROR-ACTIVE"
    adapter.error_passive()
    message = received(bus)
    assert message.is_error_frame
    assert message.data[1] == 0x30
    assert can_state() == "ERROR-PASSIVE"


def test_bus_off(adapter: Adapter, bus: SocketcanBus) -> None:
    adapter.bus_off()
    message = received(bus)
    assert message.is_error_frame
    assert message.arbitration_id & 0x40
    assert can_state() == "BUS-OFF"
    bus.send(can.Message(arbitration_id=1, is_extended_id=False))  # raises nothing
    for restart in (["restart"], ["restart-ms", "100"]):
        with pytest.raises(AssertionError, match="doesn't support restart"):
            command("ip", "link", "set", CAN, "type", "can", *restart)
    command("ip", "link", "set", CAN, "down")
    up()
    assert can_state() == "ERROR-ACTIVE"


def test_an_adapter_that_returns_from_bus_off(adapter: Adapter, bus: SocketcanBus) -> None:
    adapter.bus_off()
    received(bus)
    adapter.restarted()
    message = received(bus)
    assert message.is_error_frame
    assert message.arbitration_id & 0x100
    assert can_state() == "ERROR-ACTIVE"


def test_unplugged_adapter(adapter: Adapter, bus: SocketcanBus) -> None:
    adapter.unplug()
    with pytest.raises(can.CanOperationError) as caught:
        bus.recv(WAIT)
    assert caught.value.error_code in (errno.ENETDOWN, errno.ENODEV)
    with pytest.raises(can.CanOperationError) as caught:
        bus.send(can.Message(arbitration_id=1))
    assert caught.value.error_code == errno.ENXIO


@pytest.fixture(scope="module")
def gadget() -> Iterator[SerialGadget]:
    gadget = SerialGadget()
    yield gadget
    gadget.remove()


@contextmanager
def opened() -> Iterator[Line]:
    with (
        serial.Serial(str(HOST), timeout=WAIT) as host,
        serial.Serial(str(DEVICE), timeout=WAIT) as device,
    ):
        yield host, device


@pytest.fixture
def line(gadget: SerialGadget) -> Iterator[Line]:
    with opened() as line:
        yield line


def exchange(line: Line) -> None:
    data = bytes(range(256)) * 64
    for source, sink in (line, line[::-1]):
        writer = threading.Thread(target=source.write, args=(data,))
        writer.start()
        assert sink.read(len(data)) == data
        writer.join()


def test_serial_bytes_both_ways(line: Line) -> None:
    exchange(line)


def test_serial_device_unplugged_and_plugged_in_again(gadget: SerialGadget, line: Line) -> None:
    host, device = line
    gadget.unplug()
    with pytest.raises(serial.SerialException):
        host.read(1)
    with pytest.raises(serial.SerialException):
        host.write(b"x")
    wait_for("the node is gone", lambda: not HOST.exists())
    host.close()
    device.close()  # the kernel hung it up
    gadget.plug()
    with opened() as again:
        exchange(again)


CHANNELS, RATE = 24, 48000
BLOCK = RATE // 10


class Loop:
    """Loopback card: player of one end and recorder of the other."""

    def __init__(self, played: NDArray[np.int16]) -> None:
        self.heard: list[NDArray[np.int16]] = []
        self.gaps: list[str] = []
        """Losses that PortAudio reports."""
        silence = [np.zeros((BLOCK, CHANNELS), np.int16)] * 10
        self._waiting = iter([*silence, *np.split(played, len(played) // BLOCK), *silence])
        self._done = threading.Event()

    def run(self) -> NDArray[np.int16]:
        """Play it all, and return all that was heard."""
        sd = importlib.import_module("sounddevice")
        devices = {d["name"]: d["index"] for d in sd.query_devices()}
        played, heard = (devices[f"Loopback: PCM (hw:0,{i})"] for i in range(2))
        common = {"samplerate": RATE, "blocksize": BLOCK, "channels": CHANNELS, "latency": 0.8}
        with (
            sd.InputStream(device=heard, callback=self._take, dtype="int16", **common),
            sd.OutputStream(device=played, callback=self._give, dtype="int16", **common),
        ):
            assert self._done.wait(WAIT)
        return np.concatenate(self.heard)

    def _take(self, block: NDArray[np.int16], _frames: int, _time: object, gap: object) -> None:
        self.heard.append(block.copy())
        self.gaps += [str(gap)] * bool(gap)

    def _give(self, block: NDArray[np.int16], _frames: int, _time: object, gap: object) -> None:
        self.gaps += [str(gap)] * bool(gap)
        following = next(self._waiting, None)
        block[:] = 0 if following is None else following
        if following is None:
            self._done.set()


def test_24_channels_of_sound_are_exact() -> None:
    played = np.random.default_rng(1).integers(1, 2**15, (RATE, CHANNELS), dtype=np.int16)
    for _ in range(3):  # an emulated machine may be too slow
        loop = Loop(played)
        heard = loop.run()
        print("gaps:", loop.gaps)
        if not loop.gaps:
            break
    first = int(np.flatnonzero(heard.any(axis=1))[0])
    assert np.array_equal(heard[first : first + RATE], played)
