"""Bridges from a host's driver to the amplifier in C: a port server, a CAN bus, an adapter.

Each is a context that serves until it is left. Run as a program, ``bus_bridges.py KIND PATH``, this
is one in a process of its own, so that host and bridge do not take turns in one Python; its first
line is what it yields, and it ends with its standard input.
"""

import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import IO, Any, cast

import can
import serial
from serial import rfc2217

STEP = 50e-3
"""Interval at which a thread checks whether it has to end [s]."""
FRAME = struct.Struct("<IBB2x64s")
"""Linux' struct canfd_frame."""
FD, EXTENDED = 0x04, 0x80000000
NUMBERS = count()


@contextmanager
def threads(*works: Callable[[], None]) -> Iterator[None]:
    """Run what is done again and again, each in a thread of its own."""
    ended = threading.Event()

    def run(work: Callable[[], None]) -> None:
        while not ended.is_set():
            try:
                work()
            except OSError:
                return

    running = [threading.Thread(target=run, args=(work,), daemon=True) for work in works]
    for thread in running:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in running:
            thread.join()


def ready(*files: Any) -> list[Any]:
    """Return which of some files have something to read, after a while at most."""
    return select.select(files, [], [], STEP)[0]


# RFC 2217


class Port(serial.Serial):
    """A pseudo-terminal, which has no modem lines."""

    cts = dsr = ri = cd = property(lambda self: False)

    def _update_rts_state(self) -> None: ...

    def _update_dtr_state(self) -> None: ...


class Connection:
    """A client of a port server: what `rfc2217.PortManager` writes to."""

    def __init__(self, stream: socket.socket) -> None:
        self._stream, self._lock = stream, threading.Lock()

    def write(self, data: bytes) -> None:
        """Send bytes."""
        with self._lock:
            self._stream.sendall(data)


def received(stream: socket.socket) -> bytes:
    """Return what a client sent; nothing where it has left, also by a reset."""
    try:
        return stream.recv(4096)
    except OSError:
        return b""


@contextmanager
def rfc2217_server(path: str) -> Iterator[int]:
    """Serve a terminal by RFC 2217; yield the TCP port."""
    listener = socket.create_server(("127.0.0.1", 0))
    port = Port(path, timeout=0)
    clients: list[tuple[socket.socket, Connection, Any]] = []

    def accept() -> None:
        if ready(listener):
            stream = listener.accept()[0]
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection = Connection(stream)
            manager = rfc2217.PortManager(cast(Any, port), cast(Any, connection))
            clients.append((stream, connection, manager))

    def inward() -> None:
        if not clients:
            select.select([], [], [], 1e-3)
            return
        stream, _, manager = clients[-1]
        if ready(stream):
            data = received(stream)
            if data:
                port.write(b"".join(manager.filter(data)))
            else:
                clients.clear()
                stream.close()

    def outward() -> None:
        data = port.read(4096) if ready(port) else b""  # dropped, where nobody listens
        for _, connection, manager in clients[-1:]:
            with suppress(OSError):
                connection.write(b"".join(manager.escape(data)))

    try:
        with threads(accept, inward, outward):
            yield listener.getsockname()[1]
    finally:
        for stream, _, _ in clients:
            stream.close()
        listener.close()
        port.close()


# UDP


@contextmanager
def udp_port(path: str) -> Iterator[int]:
    """Serve a terminal over UDP, whole frames in each datagram; yield the port."""
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", 0))
    port = Port(path, timeout=0)
    hosts: list[Any] = []
    rest = b""

    def inward() -> None:
        if ready(server):
            data, host = server.recvfrom(65536)
            hosts[:] = [host]
            port.write(data)

    def outward() -> None:
        nonlocal rest
        *frames, rest = (rest + (port.read(4096) if ready(port) else b"")).split(b"\0")
        for frame in frames:
            for host in hosts:
                server.sendto(frame + b"\0", host)

    try:
        with threads(inward, outward):
            yield server.getsockname()[1]
    finally:
        server.close()
        port.close()


# CAN


@contextmanager
def datagrams(path: str) -> Iterator[socket.socket]:
    """Yield a socket that talks to the amplifier's."""
    with tempfile.TemporaryDirectory() as directory:
        own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        own.bind(str(Path(directory) / "host"))
        own.connect(path)
        try:
            yield own
        finally:
            own.close()


@contextmanager
def virtual_can(path: str, *, fd: bool) -> Iterator[str]:
    """Put an amplifier on a virtual bus of python-can; yield the bus's name."""
    name = f"contract{next(NUMBERS)}"
    bus = can.Bus(name, interface="virtual")

    def inward() -> None:
        message = bus.recv(STEP)
        if message is not None:
            flags = FD if message.is_fd else 0
            identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
            own.send(FRAME.pack(identifier, len(message.data), flags, bytes(message.data)))

    def outward() -> None:
        if ready(own):
            identifier, size, flags, data = FRAME.unpack(own.recv(FRAME.size))
            bus.send(
                can.Message(
                    arbitration_id=identifier & ~EXTENDED, data=data[:size],
                    is_extended_id=bool(identifier & EXTENDED), is_fd=bool(flags & FD),
                    bitrate_switch=fd,
                )
            )  # fmt: skip

    try:
        with datagrams(path) as own, threads(inward, outward):
            yield name
    finally:
        bus.shutdown()


@contextmanager
def slcan_adapter(path: str) -> Iterator[str]:
    """Put an amplifier behind an adapter that speaks LAWICEL's protocol; yield its terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    rest = bytearray()

    def answer(line: bytes) -> bytes:
        if line[:1] != b"t":
            return b"\r"
        data = bytes.fromhex(line[5:].decode())
        own.send(FRAME.pack(int(line[1:4], 16), len(data), 0, data))
        return b"z\r"

    def inward() -> None:
        nonlocal rest
        if ready(master):
            rest += os.read(master, 65536)
            *lines, rest = rest.split(b"\r")
            os.write(master, b"".join(answer(bytes(line)) for line in lines if line))

    def outward() -> None:
        if ready(own):
            identifier, size, _, data = FRAME.unpack(own.recv(FRAME.size))
            os.write(master, f"t{identifier:03X}{size}{data[:size].hex().upper()}\r".encode())

    try:
        with datagrams(path) as own, threads(inward, outward):
            yield os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


# Each in a process of its own

KINDS = {"rfc2217": rfc2217_server, "slcan": slcan_adapter, "udp": udp_port}


@contextmanager
def bridge(kind: str, path: str) -> Iterator[str]:
    """Run one of `KINDS`; yield what it yields, as text."""
    process = subprocess.Popen(
        [sys.executable, __file__, kind, path],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    output = cast(IO[str], process.stdout)
    try:
        yield output.readline().strip()
    finally:
        process.communicate()


if __name__ == "__main__":
    with KINDS[sys.argv[1]](sys.argv[2]) as reached:
        print(reached, flush=True)
        sys.stdin.read()
