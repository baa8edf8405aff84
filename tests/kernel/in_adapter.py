"""Checks in QEMU: our CAN bus on an adapter behind gs_usb, with an amplifier in C on its bus."""

import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import can
import pytest
from bus_tools import Record, assert_is, linked, opened, play, playing, wait_for_link
from can.interfaces.socketcan import SocketcanBus
from gs_usb_adapter import GsUsb
from guest_tools import command, virtual_amplifier, wait_for

from firmware_protocol.messages import State
from tactile.bus.can_bus import CanWire, find
from tactile.bus.link import link_bus
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.wire import STALL
from tactile.errors import BusError

CAN, BEHIND = "can0", "vcan1"
INTERFACE = Path("/sys/class/net", CAN)
BIT_RATE = 500_000
URL = f"can:socketcan/{CAN}?bitrate={BIT_RATE}&rearm=true"
RATE = 2500
ESTOP, STREAM = 0, 3
"""An identifier, and the class of others (SPEC.md, 3.2)."""


class Board:
    """An amplifier, and what leads from its bus to an adapter.

    Attributes
    ----------
    adapter : plugged in now
    frames : identifiers of what the host sent
    """

    def __init__(self, out: Path) -> None:
        self.adapter: GsUsb | None = None
        self.frames: list[int] = []
        self._out = out
        self._bus: SocketcanBus | None = SocketcanBus(BEHIND)
        self._thread = Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """Let go of the bus."""
        bus, self._bus = self._bus, None
        self._thread.join()
        if bus is not None:
            bus.shutdown()

    def plug(self) -> None:
        """Plug an adapter in, and set it up."""
        adapter = GsUsb(0, self._outward)
        wait_for(f"{CAN} appears", INTERFACE.exists)
        up()
        self.adapter = adapter

    def unplug(self) -> None:
        """Pull the cable of the adapter."""
        adapter, self.adapter = self.adapter, None
        if adapter is not None:
            adapter.unplug()
        wait_for(f"{CAN} is gone", lambda: not INTERFACE.exists())

    def _outward(self, identifier: int, data: bytes) -> None:
        self.frames.append(identifier)
        if (bus := self._bus) is not None:
            bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def _run(self) -> None:
        while (bus := self._bus) is not None:
            message, adapter = bus.recv(0.02), self.adapter
            if message is not None and adapter is not None:
                adapter.inject(message.arbitration_id, bytes(message.data))

    @property
    def record(self) -> Record:
        """Output of the amplifier so far."""
        return Record.read(self._out, 1)

    @property
    def sounds(self) -> bool:
        """Whether the amplifier is not at 0 V."""
        return bool(len(self.record.ticks)) and not self.record.at_rest[-20:].all()

    @property
    def safe(self) -> bool:
        """Whether the watchdog of the amplifier has taken it to 0 V."""
        return bool(self.record.states[-1] == State.SAFE and self.record.at_rest[-1])


def up() -> None:
    command("ip", "link", "set", CAN, "up", "type", "can", "bitrate", str(BIT_RATE))


def down() -> None:
    command("ip", "link", "set", CAN, "down")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    command("ip", "link", "add", BEHIND, "type", "vcan")
    command("ip", "link", "set", BEHIND, "up")
    out = tmp_path / "out"
    with virtual_amplifier("--socketcan", BEHIND, "--channels", "1", "--out", str(out)):
        wait_for("the amplifier is there", out.exists)
        board = Board(out)
        board.plug()
        yield board
        board.unplug()
        board.close()
    command("ip", "link", "delete", BEHIND)


@pytest.fixture
def bus(board: Board) -> Iterator[LinkBus]:
    with linked(URL, 1, RATE) as bus:
        yield bus


def adapter(board: Board) -> GsUsb:
    assert board.adapter is not None
    return board.adapter


def test_it_plays_what_it_is_given(board: Board, bus: LinkBus) -> None:
    volts = play(bus)
    bus.close()
    wait_for("high voltage is off", lambda: not board.record.high_voltage[-1])
    assert_is(board.record.played(bus, len(volts)), volts, bus.plan.sample_format)
    assert f"can:socketcan/{CAN}" in [found.url for found in find()]


def test_error_passive_is_told(board: Board, bus: LinkBus) -> None:
    adapter(board).error_passive()
    wait_for("it is told", lambda: bus.status.detail.startswith("error-passive"))
    assert bus.status.link == "up"
    play(bus, 0.1)


def test_bus_off_is_told_until_the_interface_was_down_and_up(board: Board, bus: LinkBus) -> None:
    with playing(bus):
        wait_for("it plays", lambda: board.sounds)
        adapter(board).bus_off()
        wait_for_link(bus, "down")
        assert bus.status.detail.startswith("bus-off")
        wait_for("it is safe", lambda: board.safe)
        for _ in range(10):
            assert bus.status.link == "down"
            assert bus.status.detail
            time.sleep(0.1)
        down()
        up()
        wait_for_link(bus, "up")
        wait_for("it plays on", lambda: board.sounds)
    assert (bus.counters.disconnects, bus.counters.reconnects) == (1, 1)


def test_an_adapter_that_is_unplugged_while_it_plays(board: Board, bus: LinkBus) -> None:
    with playing(bus):
        wait_for("it plays", lambda: board.sounds)
        board.unplug()
        wait_for_link(bus, "down")
        wait_for("it is told", lambda: "no such interface" in bus.status.detail)
        wait_for("it is counted", lambda: bus.counters.dropped_samples > 0)
        wait_for("it is safe", lambda: board.safe)
        board.plug()
        wait_for_link(bus, "up")
        wait_for("it plays on", lambda: board.sounds)
    assert (bus.counters.disconnects, bus.counters.reconnects) == (1, 1)


def stuck(bus: LinkBus) -> bool:
    """Whether the kernel has taken nothing for a while that is short of `STALL`."""
    wire = bus._wire
    assert isinstance(wire, CanWire)
    return wire.busy and time.monotonic() - wire._since > STALL / 4


def test_an_estop_passes_what_waits(board: Board, bus: LinkBus) -> None:
    with playing(bus):
        wait_for("it plays", lambda: board.sounds)
        adapter(board).hold()
        wait_for("the kernel's queue is full", lambda: stuck(bus), every=2e-3)
        board.frames.clear()
        bus.estop()
        adapter(board).release()
        wait_for("it is told", lambda: bool((board.record.states == State.ESTOP).any()))
    later = board.frames[board.frames.index(ESTOP) :]
    assert STREAM in [identifier >> 8 for identifier in later]  # what waited in the kernel
    wait_for("it is at 0 V", lambda: not board.sounds)
    assert bus.status.state == "estopped"
    wait_for_link(bus, "up")
    bus.clear()
    assert bus.state == "idle"


def test_where_nobody_acknowledges(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_bus, "OPENING", 0.5)
    adapter(board).hold()
    with pytest.raises(BusError, match=r"acknowledges|nothing answers") as caught:
        opened(URL, 1, RATE)
    assert "\n" not in str(caught.value)
