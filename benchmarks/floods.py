"""Loads on a server: crowds and floods, each from their own processes.

All traffic stays on this machine's loopback interface, goes to one server, is bounded in rate and
time, and ends by itself.
"""

import asyncio
import math
import multiprocessing
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from benchmarks.app import RATE, TEXTURE
from benchmarks.server import NAME, PATIENCE, frame, wait_for
from tactile.messages import JSON_PROTOCOL

BATCH = 0.01
"""Interval between batches of a flood [s]."""
MOST_AT_ONCE = 0.05
"""Largest duration of a flood that is sent at once if its process was held up [s]."""
OPEN = 200
"""Number of connections that one process keeps open at a time."""
HOST = "127.0.0.1"
"""Address of the loopback interface."""


class Load:
    """Processes that put a load on a server while they are permitted to.

    Attributes
    ----------
    sent : multiprocessing.Value
        Shared number of what they sent.
    permitted : multiprocessing.Event
        Shared event, set while they are to send.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("forkserver")
        self.sent: Any = context.Value("q")
        self.permitted: Any = context.Event()
        self._seconds = 0.0

    def count(self, number: int) -> None:
        """Add to the number of what was sent."""
        with self.sent.get_lock():
            self.sent.value += number

    @contextmanager
    def on(self) -> Iterator[None]:
        """Permit the processes to send meanwhile; begin when they have."""
        begun, before = time.monotonic(), self.sent.value
        self.permitted.set()
        try:
            wait_for("a load", lambda: self.sent.value > before)
            yield
        finally:
            self.permitted.clear()
            self._seconds += time.monotonic() - begun

    def rate(self) -> float:
        """Return the mean rate of what was sent while it was permitted [1/s]."""
        return float(self.sent.value) / self._seconds if self._seconds else 0.0


@contextmanager
def loaded(flood: Callable[..., None], *options: object, processes: int = 1) -> Iterator[Load]:
    """Run a flood in processes of its own meanwhile.

    Parameters
    ----------
    flood : callable
        Function that takes the `Load`, then the options.
    options : object
        Options of the flood.
    processes : int
        Number of processes, each of which sends the whole flood.
    """
    load = Load()
    context = multiprocessing.get_context("forkserver")
    started = [
        context.Process(target=flood, args=(load, *options), daemon=True) for _ in range(processes)
    ]
    for process in started:
        process.start()
    try:
        yield load
    finally:
        for process in started:
            process.kill()
            process.join()


def paced(load: Load, rate: float, seconds: float) -> Iterator[int]:
    """Yield how many to send, repeatedly, while a load is permitted, and count them.

    Parameters
    ----------
    load : Load
        Load that permits them to be sent.
    rate : float
        Rate [1/s].
    seconds : float
        Duration after which it ends in any case [s].
    """
    end = last = time.monotonic()
    end += seconds
    while (now := time.monotonic()) < end:
        if not load.permitted.is_set():
            load.permitted.wait(end - now)
            last = time.monotonic()
            continue
        if due := int(rate * min(now - last, MOST_AT_ONCE)):
            yield due
            load.count(due)
            last = now
        time.sleep(BATCH)


def touch_together(load: Load, url: str, clients: int, seconds: float) -> None:
    """Run a number of programs, each of which touches at `RATE`."""
    asyncio.run(_touch_together(load, url, clients, seconds))


async def _touch_together(load: Load, url: str, clients: int, seconds: float) -> None:
    from tactile.client import aio

    async def one(number: int) -> None:
        async with aio.connect(url, display=NAME, timeout=PATIENCE) as display:
            await display.select(TEXTURE, timeout=PATIENCE)
            begun = time.monotonic() + number / clients / RATE
            for k in range(int(seconds * RATE)):
                await asyncio.sleep(max(0.0, begun + k / RATE - time.monotonic()))
                await display.touch((0.04 * math.sin(2 * k / RATE), 0.0), normal_force=0.5)
                load.count(load.permitted.is_set())

    await asyncio.gather(*(one(number) for number in range(clients)))


def send_messages(load: Load, port: int, rate: float, seconds: float) -> None:
    """Send contacts over a WebSocket, and open another one if the server closes it."""
    contact = {"type": "contact", "display": NAME, "position_mm": [1, 0], "normal_force_n": 0.5}
    one = frame(contact)
    link = None
    for count in paced(load, rate, seconds):
        try:
            link = link or open_websocket(port)
            link.sendall(count * one)
            drain(link)
        except OSError:
            if link is not None:
                link.close()
            link = None


def open_websocket(port: int) -> socket.socket:
    """Return a socket that has sent `Hello`."""
    link = socket.create_connection((HOST, port), timeout=2.0)
    request = (
        f"GET /v1 HTTP/1.1\r\nHost: {HOST}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {JSON_PROTOCOL}\r\n\r\n"
    )
    link.sendall(request.encode())
    link.recv(4096)
    link.sendall(frame({"type": "hello", "client": "flood"}))
    return link


def drain(link: socket.socket) -> None:
    """Read all received data.

    Raises
    ------
    ConnectionError
        If the other side has closed.
    """
    while select.select([link], [], [], 0)[0]:
        if not link.recv(1 << 16):
            raise ConnectionError


def open_connections(load: Load, port: int, rate: float, seconds: float) -> None:
    """Open connections that send nothing; only the last few of them stay open."""
    links: deque[socket.socket] = deque()
    at_once = struct.pack("ii", 1, 0)  # Closing by a reset keeps no port in TIME_WAIT.
    for count in paced(load, rate, seconds):
        for _ in range(count):
            link = socket.socket()
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
            link.setblocking(False)
            link.connect_ex((HOST, port))
            links.append(link)
            if len(links) > OPEN:
                links.popleft().close()


def contact_packet() -> bytes:
    """Return a contact as an OSC packet."""
    address = f"/tactile/{NAME}/contact\0".encode()
    padded = address.ljust(-(-len(address) // 4) * 4, b"\0")
    return padded + b",fff\0\0\0\0" + struct.pack(">fff", 1.0, 0.0, 0.5)


def flood_osc(load: Load, port: int, rate: float, seconds: float) -> None:
    """Send contacts as OSC packets."""
    packet = contact_packet()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect((HOST, port))
        for count in paced(load, rate, seconds):
            for _ in range(count):
                with suppress(OSError):
                    link.send(packet)
