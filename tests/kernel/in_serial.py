"""Checks in QEMU: our serial bus on a CDC ACM device, an amplifier in C behind it."""

import os
import select
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Self

import pytest
from bus_tools import Record, assert_is, linked, opened, play, playing, wait_for_link
from guest_tools import virtual_amplifier, wait_for
from serial_gadget import DEVICE, HOST, SerialGadget

from firmware_protocol.messages import State
from tactile.bus import serial_bus
from tactile.errors import BusError

CHANNELS = 3
URL = f"serial://{HOST}"
LARGEST = 4096


class Bridge:
    """Carries bytes between the amplifier's terminal and the device's end of the cable."""

    def __init__(self, terminal: str) -> None:
        self._terminal, self._ended = terminal, Event()
        self._thread = Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        with raw(self._terminal) as amplifier:
            while not self._ended.wait(0.02):
                with suppress(OSError), raw(str(DEVICE)) as device:
                    self._carry(amplifier, device)  # until the kernel hangs the device up

    def _carry(self, amplifier: int, device: int) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select([amplifier, device], [], [], 0.02)
            for source in ready:
                data = os.read(source, LARGEST)
                if not data:
                    return
                os.write(device if source == amplifier else amplifier, data)


@contextmanager
def raw(path: str) -> Iterator[int]:
    """Open a terminal that passes bytes as they are."""
    file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(file)
        yield file
    finally:
        os.close(file)


@pytest.fixture(scope="module")
def gadget() -> Iterator[SerialGadget]:
    gadget = SerialGadget()
    yield gadget
    gadget.remove()


@pytest.fixture
def out(gadget: SerialGadget, tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "out"
    words = ("--pty", "--channels", str(CHANNELS), "--out", str(path))
    with virtual_amplifier(*words) as amplifier:
        assert amplifier.stdout is not None
        with Bridge(amplifier.stdout.readline().strip()):
            yield path


def record(out: Path) -> Record:
    return Record.read(out, CHANNELS)


def test_it_plays_what_it_is_given(out: Path) -> None:
    with linked(URL, CHANNELS) as bus:
        volts = play(bus)
    wait_for("high voltage is off", lambda: not record(out).high_voltage[-1])
    assert_is(record(out).played(bus, len(volts)), volts, bus.plan.sample_format)
    assert record(out).at_rest[-1]


@pytest.mark.parametrize("rearm", [False, True])
def test_a_cable_that_is_pulled_while_it_plays(
    gadget: SerialGadget, out: Path, rearm: bool
) -> None:
    with linked(f"{URL}?rearm={str(rearm).lower()}", CHANNELS) as bus:
        with playing(bus):
            wait_for("it plays", lambda: not record(out).at_rest.all())
            gadget.unplug()
            wait_for_link(bus, "down")
            assert bus.state == "running"
            assert bus.status.detail
            wait_for("it is safe", lambda: record(out).states[-1] == State.SAFE)
            safe = record(out).ticks[-1]
            gadget.plug()
            wait_for_link(bus, "up")
            if rearm:
                wait_for(
                    "it plays on", lambda: not (r := record(out)).at_rest[r.ticks > safe].all()
                )
            else:
                wait_for("it is told", lambda: "not armed again" in bus.status.detail)
                assert record(out).at_rest[-1]
        assert (bus.counters.disconnects, bus.counters.reconnects) == (1, 1)
        assert bus.counters.dropped_samples
        bus.stop()
        play(bus, 0.1)


def test_an_estop_without_a_cable_holds_when_it_is_back(gadget: SerialGadget, out: Path) -> None:
    with linked(f"{URL}?rearm=true", CHANNELS) as bus:
        with playing(bus):
            wait_for("it plays", lambda: not record(out).at_rest.all())
            gadget.unplug()
            bus.estop()
        assert bus.state == "estopped"
        wait_for_link(bus, "down")
        bus.estop()
        gadget.plug()
        wait_for_link(bus, "up")
        wait_for("it is told", lambda: record(out).states[-1] == State.ESTOP)
        assert record(out).at_rest[-1]
        bus.clear()
        play(bus, 0.1)


def test_a_port_is_found_by_its_serial_number(gadget: SerialGadget) -> None:
    (found,) = [found for found in serial_bus.find() if found.url == URL]
    assert found.about.endswith("USB 1d6b:0104, serial 0001")


def test_what_does_not_open_is_one_line(gadget: SerialGadget, out: Path) -> None:
    with (
        linked(URL, CHANNELS),
        pytest.raises(BusError, match="another program holds the port") as caught,
    ):
        opened(URL, CHANNELS)
    assert "\n" not in str(caught.value)
    gadget.unplug()
    wait_for("the node is gone", lambda: not HOST.exists())
    with pytest.raises(BusError, match="no such port; there are:") as caught:
        opened(URL, CHANNELS)
    assert "\n" not in str(caught.value)
    gadget.plug()
