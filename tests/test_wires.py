"""An e-stop that a signal handler sends while the thread that it interrupts is sending.

A handler runs between two instructions of the thread, as a call from within its call to the kernel
does here; a lock that is not reentrant would hold up both for good.
"""

import socket
import threading
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol.can_link import CanDecoder, Frame
from firmware_protocol.messages import Estop, Hello
from firmware_protocol.packet import Packet
from firmware_protocol.serial_link import SerialDecoder
from tactile.bus.can_bus import CanChannel, CanWire
from tactile.bus.serial_bus import SerialLine, SerialWire
from tactile.bus.udp_bus import Udp, UdpWire
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Can, Usb
from tactile.clock import ModelClock

PATIENCE = 60.0
"""Time within which a call that nothing holds up returns [s]."""
ESTOP = Packet.of(Estop(1), node=1)
LATER = Packet(Hello.TYPE, bytes(40), node=1)


class Interrupted:
    """A kernel in whose first call, once armed, a signal handler runs; it takes what is written."""

    def __init__(self) -> None:
        self.handler: Callable[[], None] | None = None
        self.taken: list[Any] = []

    def take(self, data: Any) -> None:
        """Take something, and let the handler run before or after it."""
        self.taken.append(data)
        handler, self.handler = self.handler, None
        if handler is not None:
            handler()


class Line(SerialLine):
    """A serial line to that kernel."""

    def __init__(self, kernel: Interrupted) -> None:
        self._kernel = kernel

    def write(self, data: bytes) -> int:
        self._kernel.take(data)
        return len(data)

    def read(self) -> bytes:
        return b""

    def wait(self, until: float, *, writable: bool) -> None: ...

    def wake(self) -> None: ...

    def waiting(self) -> int:
        return 0

    def discard(self) -> None: ...

    def close(self) -> None: ...


class Channel(CanChannel):
    """A CAN channel to that kernel."""

    def __init__(self, kernel: Interrupted) -> None:
        self._kernel = kernel

    def send(self, frame: Frame) -> bool:
        self._kernel.take(frame)
        return True

    def send_urgent(self, frame: Frame) -> None:
        self._kernel.take(frame)

    def receive(self, until: float) -> list[Frame]:
        return []

    def wake(self) -> None: ...

    def close(self) -> None: ...


class Socket:
    """A UDP socket to that kernel, with what a selector asks of it."""

    def __init__(self, kernel: Interrupted) -> None:
        self._kernel = kernel

    def send(self, data: bytes) -> int:
        self._kernel.take(data)
        return len(data)

    def close(self) -> None: ...


def serial(kernel: Interrupted) -> Wire:
    return SerialWire(Line(kernel), Usb(), ModelClock())


def can(kernel: Interrupted) -> Wire:
    return CanWire(Channel(kernel), Can(1e6), ModelClock())


def udp(kernel: Interrupted) -> Wire:
    wire = UdpWire(
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM), Udp(10e6), ModelClock(), "nobody"
    )
    wire._socket.close()
    wire._socket = Socket(kernel)  # type: ignore[assignment]
    return wire


def packets(taken: list[Any]) -> list[Packet]:
    """Return the packets that an amplifier finds in what the kernel took."""
    if isinstance(taken[0], tuple):
        decoder = CanDecoder(from_amplifier=False, extended=False, tick_hz=1_000_000)
        return [p for identifier, data in taken for p in decoder.feed(identifier, data, 0)]
    return SerialDecoder().feed(b"".join(taken))


@pytest.mark.parametrize("kind", [serial, can, udp])
@pytest.mark.parametrize("interrupted", ["send", "send_urgent"])
def test_an_estop_of_a_signal_handler_goes_out_in_the_middle_of_a_send(
    kind: Callable[[Interrupted], Wire], interrupted: str
) -> None:
    kernel = Interrupted()
    wire = kind(kernel)
    kernel.handler = lambda: wire.send_urgent(ESTOP)
    thread = threading.Thread(target=getattr(wire, interrupted), args=(LATER,), daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert not thread.is_alive(), "each waits for the other"
    assert any(p.type == Estop.TYPE for p in packets(kernel.taken))
    assert not wire.busy
    before = len(kernel.taken)
    wire.send(LATER)
    assert packets(kernel.taken[before:])[-1].type == Hello.TYPE, "the wire works on"
    wire.close()
