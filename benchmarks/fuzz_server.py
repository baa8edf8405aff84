"""Random messages, legal and illegal, from several clients of a server that hang up at any moment.

The amplifier's record is the oracle for voltages. Playback must be the same process at the end, a
program that strokes at the same time must keep its blocks, and clients that hung up must leave
nothing behind.
"""

import random
import re
import signal
import socket
import struct
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

from benchmarks.app import start_app
from benchmarks.floods import Load, drain, loaded, open_websocket
from benchmarks.server import (
    NAME,
    PATIENCE,
    OutputRecorder,
    ServerProcess,
    amplifier_and_folder,
    block_figures,
    connected,
    counters_of,
    frame,
    growth,
    observe,
    send_signal,
)
from benchmarks.virtual import beside_amplifier
from tactile.bench.figures import Figure, at_least, at_most

SECONDS = 600.0
"""Duration of the random messages [s]."""
CLIENTS = 4
"""Number of clients that send random messages."""
PLACES = 64
"""Number of clients that a server accepts by default."""
HANG_UPS = 2000
"""Smallest permitted number of hang-ups, in all."""
SEED = 14
ODD: list[Any] = [
    None, True, -1, 0, 2**63, 1e308, "", "right", "../x", "\0", [], {}, [[]], [0] * 500,
    "estop", -0.0,
]  # fmt: skip
"""Odd values that a field may hold instead."""
LEGAL: dict[str, Callable[[random.Random], dict[str, Any]]] = {
    "arm": lambda rng: {},
    "disarm": lambda rng: {},
    "estop": lambda rng: {},
    "clear": lambda rng: {"estop": rng.randrange(1, 300)},
    "gain": lambda rng: {"gain": rng.random()},
    "stop": lambda rng: {},
    "play": lambda rng: {},
    "get_stats": lambda rng: {},
    "subscribe": lambda rng: {"rate_hz": rng.choice([0, 10, 100])},
    "select": lambda rng: {"layers": [{"texture": "wood-oak", "seed": rng.randrange(2)}]},
    "contact": lambda rng: {
        "position_mm": [rng.uniform(-50, 50), 0],
        "normal_force_n": rng.choice([0, 0.5, 50]),
    },
    "append": lambda rng: {
        "sample_rate_hz": rng.choice([100, 8000, 48_000]),
        "amplitude_um": 500,
        "samples": [rng.choice([-1, 1]) for _ in range(rng.randrange(400))],
        "append": rng.random() < 0.5,
    },
    "effect": lambda rng: {
        "amplitude_um": rng.choice([0, 500]),
        "amplitude": [[0, 1], [rng.uniform(0, 60_000), 1]],
        "frequency": [[0, rng.uniform(0, 1000)]],
        "transients": [[rng.uniform(0, 60_000), 1, 160] for _ in range(rng.choice([0, 500]))],
    },
}
"""Contents of a request besides its type, display and number, by type."""


RARE = {"estop": 0.02, "disarm": 0.02}
"""Relative frequency of the requests that silence the display; all others have 1."""


def random_message(rng: random.Random) -> bytes:
    """Return a frame with a message: legal, with an odd field, or with a wrong byte."""
    (kind,) = rng.choices(list(LEGAL), [RARE.get(kind, 1.0) for kind in LEGAL])
    message: dict[str, Any] = {"type": kind, "display": NAME, **LEGAL[kind](rng)}
    if kind != "contact":
        message["id"] = rng.randrange(1000)
    if rng.random() < 0.3:
        message[rng.choice(list(message))] = rng.choice(ODD)
    data = bytearray(frame(message))
    if rng.random() < 0.05:
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def hang_up(link: socket.socket) -> None:
    """Close a connection without a closing handshake, as a process that dies does."""
    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    link.close()


def disturb(load: Load, port: int, seed: int, seconds: float) -> None:
    """Act as a client that sends random messages and hangs up, repeatedly; count the hang-ups."""
    rng, end = random.Random(f"{seed} {time.monotonic_ns()}"), time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            link = open_websocket(port)
        except OSError:
            time.sleep(0.1)
            continue
        try:
            for _ in range(rng.randrange(1, 40)):
                link.sendall(random_message(rng))
                drain(link)
                time.sleep(rng.choice([0, 0, 0.002, 0.01]))
        except OSError:
            pass  # The server has closed the connection.
        hang_up(link)
        load.count(1)


def clients_of(server: ServerProcess) -> float:
    """Return the number of clients that a server counts."""
    with urllib.request.urlopen(
        f"http://127.0.0.1:{server.port}/metrics", timeout=PATIENCE
    ) as page:
        text = page.read().decode()
    match = re.search(r'^tactile_clients\{transport="websocket"\} (\S+)', text, re.MULTILINE)
    return float(match[1]) if match else 0.0


def free_places(server: ServerProcess, most: int = PLACES) -> int:
    """Return the number of clients that are accepted at once."""
    with ExitStack() as stack:
        links = [stack.enter_context(open_websocket(server.port)) for _ in range(most)]
        return sum(b'"welcome"' in link.recv(1 << 16) for link in links)


def measure_fuzz_server(seconds: float = SECONDS) -> Iterator[Figure]:
    """Measure the state of a server after a while of random messages."""
    yield from beside_amplifier("fuzz-server", _measured(seconds))


def _measured(seconds: float) -> Iterator[Figure]:
    with amplifier_and_folder() as (amplifier, folder):
        recorder = OutputRecorder(amplifier)
        with closing(ServerProcess(folder, amplifier.path)) as server:
            playback, before = server.playback(), counters_of(server)
            victim = start_app(server.url, "stroke", lasts=seconds + PATIENCE)
            with (
                connected(server) as keeper,
                loaded(disturb, server.port, SEED, seconds, processes=CLIENTS) as load,
            ):
                memory = [size for size, _ in observe(server, recorder, keeper, seconds)]
                hang_ups = load.sent.value
            after = counters_of(server)
            send_signal(victim.pid or 0, signal.SIGKILL)
            victim.join()
            yield at_least("fuzz-server.hang_ups", float(hang_ups), "", HANG_UPS)
            yield at_most("fuzz-server.playback_died", server.playback() != playback, "", 0)
            yield from recorder.figures("fuzz-server")
            yield from block_figures("fuzz-server", before, after, 10)
            yield from _leftovers(server, memory)


def _leftovers(server: ServerProcess, memory: list[float]) -> Iterator[Figure]:
    """Yield the clients, free places and memory that are left over."""
    deadline = time.monotonic() + 5.0
    while (ghosts := clients_of(server)) and time.monotonic() < deadline:
        time.sleep(0.1)
    yield at_most("fuzz-server.ghosts", ghosts, "", 0)
    yield at_least("fuzz-server.free_places", float(free_places(server)), "", PLACES)
    yield growth("fuzz-server.server", memory)
