"""A server of the page that sends what no server may send, mutated by a random generator.

It serves the files of the page with their headers, and speaks the API over a WebSocket. What it
sends is correct, or made from correct messages: fields are missing or odd, arrays have other
lengths, frames are cut off, and what is sent need not be MessagePack. All of it follows from a
seed, except how it is interleaved with what the page asks.
"""

import asyncio
import copy
import itertools
import math
import random
import struct
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from http import HTTPStatus
from typing import Any, TypeVar

import msgspec
import numpy as np
from starlette.exceptions import HTTPException
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from benchmarks.server import PATIENCE
from tactile import messages as m
from tactile.server.page import PageFiles

NAME = "right"
"""Name of the display."""
COLUMNS = 8
"""Number of columns of contactors, and of rows."""
RATE = 8000.0
"""Sample rate of the display [Hz]."""
MARKUP = (
    "<img src=x onerror=\"document.title='executed'\"><script>document.title='executed'</script>"
)
"""Text that changes the title of the page if it is taken for HTML."""
LONG = 100_000
"""Length of long texts and of long lists of numbers."""
MANY = 500
"""Length of long lists and maps of anything else."""
DEEP = 10_000
"""Depth of what is nested too deep."""
ODD_ANSWERS = 0.1
"""Share of the answers to requests that are mutated."""
DEEPER = 0.6
"""Probability with which a part of a part is mutated rather than the part."""
NUMBERS = (
    0, -1, 1, 4711, -(2**63), 2**64 - 1, 0.5, 1e6, 1e9, 1e308, -1e308, 5e-324, -0.0, math.nan,
    math.inf, -math.inf,
)  # fmt: skip
"""Odd numbers."""
TEXTS = (
    "", "0", "\0", "armed", "lost", "estopped", "__proto__", "constructor", "toString", MARKUP,
    "x" * LONG, "\u202e\U0001f600\u0301" * 50,
)  # fmt: skip
"""Odd texts."""
SAMPLES = (bytes(4), b"\xff" * 4, b"\0\0\x80\x7f", b"\xff\xff\x7f\x7f", b"\0\0\x80\x3f")
"""Samples of odd traces: zero, no number, infinity, the largest number, and one."""
ODD: tuple[Any, ...] = (
    None, True, False, *NUMBERS, *TEXTS, [], {}, [[]], [None], {"": 0}, {"length": 1e9},
    {"__proto__": {"type": "stats"}}, [0.0] * LONG, [math.nan] * COLUMNS**2, b"", b"\xff" * 7,
    bytes(4 * LONG),
)  # fmt: skip
"""Odd values of any type."""
NOT_MESSAGEPACK: tuple[bytes, ...] = (
    b"", b"\xc1", b"\xd4\x01\x00", b"\xdf\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xc0\xc0",
    b"\xdb\xff\xff\xff\xff", b"\x81\x01\x02", b"\xa2\xc3\x28", b"\x91" * DEEP + b"\xc0",
    b"\x81\xa1a" * DEEP + b"\xc0", b"\x2a", b"\xc0", b"\x90", b"\x80",
)  # fmt: skip
"""Data that is no message: wrong, cut off, nested too deep, or a value without a type."""
CODES = (1000, 1001, 1011, 1013, 3000, 4008, 4408, 4429)
"""Codes with which a connection is closed, and after which the client connects again."""

TRACES = (0, 133, 133, 5000)
"""Numbers of samples of a trace; the longest fills the window of a spectrum at once."""
KINDS = (
    "armed",
    "disarmed",
    "estopped",
    "cleared",
    "fault",
    "link",
    "lost",
    "textures",
    "underrun",
)
"""Kinds of events."""

Plain = dict[str, Any]
"""A message as plain data."""


def plain(message: m.Answer) -> Plain:
    """Return a message as plain data, with its type.

    Parameters
    ----------
    message : Answer
        Message of a server.

    Returns
    -------
    dict of str to Any
        The message by the names of its fields, bytes as they are.
    """
    data: Plain = msgspec.to_builtins(message, builtin_types=(bytes,))
    return data


def description(name: str = NAME) -> m.DisplayDescription:
    """Return the description of a display.

    Parameters
    ----------
    name : str
        Name of the display.

    Returns
    -------
    DisplayDescription
        Description with 8 kHz, 100 V and a threshold.
    """
    places = tuple((1.2 * (k % COLUMNS), 1.2 * (k // COLUMNS)) for k in range(COLUMNS**2))
    return m.DisplayDescription(
        name=name, contactors_mm=places, shear_direction_deg=(0.0,) * len(places),
        sample_rate_hz=RATE, voltage_limit_v=100.0, waveforms=True, latency_ms=9.0,
        threshold_um=((10.0, 5.0), (250.0, 0.2), (1000.0, 2.0)),
    )  # fmt: skip


# Correct messages


def trace(rng: random.Random, contactor: int) -> m.TelemetryTrace:
    """Return a correct trace of a contactor.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    contactor : int
        Index of the contactor.

    Returns
    -------
    TelemetryTrace
        Trace of one of `TRACES` lengths.
    """
    shear = [rng.gauss(0, 2) for _ in range(rng.choice(TRACES))]
    return m.TelemetryTrace(
        contactor=contactor, sample_rate_hz=RATE, first=rng.randrange(10**6),
        shear_um=struct.pack(f"<{len(shear)}f", *shear),
    )  # fmt: skip


def telemetry(rng: random.Random, state: str, contactor: int) -> Plain:
    """Return correct telemetry with a state, and with the trace of a contactor.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    state : str
        State of the display.
    contactor : int
        Index of the contactor.

    Returns
    -------
    dict of str to Any
        Message as plain data.
    """
    loads = COLUMNS**2
    return plain(
        m.TelemetryMessage(
            display=NAME, time_us=1, state=state, position_mm=(1.0, 2.0), velocity_mm_s=(80.0, 0.0),
            normal_force_n=0.5, shear_um=tuple(rng.gauss(0, 2) for _ in range(loads)),
            drive_v=tuple(rng.uniform(-90, 90) for _ in range(loads)), counters={"underruns": 1},
            put_out_share=0.99,
            finger=m.TelemetryFinger(
                touching=(True,) * loads, stiffness_n_m=(900.0,) * loads,
                equalizer_error_db=(0.5,) * loads, explained=(True,) * loads,
                guarded=(False,) * loads,
            ),
            trace=trace(rng, contactor),
            played=trace(rng, contactor),
        )
    )  # fmt: skip


def stats(state: Any, detail: str = "") -> m.StatsReply:
    """Return the correct answer to the question for a state.

    Parameters
    ----------
    state : str
        State of the display.
    detail : str
        Line of detail.

    Returns
    -------
    StatsReply
        Answer without an id.
    """
    return m.StatsReply(
        display=NAME, state=state, link="up", detail=detail, touching=True, owner=False,
        latency_ms=7.0, counters={"underruns": 3, "blocks": 4711}, put_out_share=0.995,
        estop=5 if state == "estopped" else 0, lead_ms=12.5,
    )  # fmt: skip


def textures() -> m.Textures:
    """Return a correct list of textures.

    Returns
    -------
    Textures
        Answer without an id.
    """
    names = ("wood-oak", "wood-beech", "leather-calf", "plastic-acrylic-ribbed")
    return m.Textures(
        textures=tuple(
            m.TextureInfo(
                name=name, category=name.partition("-")[0], description="A surface.",
                provenance="authored",
            )
            for name in names
        )
    )  # fmt: skip


def unasked(rng: random.Random, contactor: int) -> Plain:
    """Return a correct message of those that a server sends without a request, or an old answer.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    contactor : int
        Index of the contactor.

    Returns
    -------
    dict of str to Any
        Message as plain data.
    """
    kind = rng.choice(KINDS)
    makers: tuple[tuple[float, Callable[[], Plain]], ...] = (
        (6, lambda: telemetry(rng, rng.choice(("armed", "disarmed")), contactor)),
        (2, lambda: plain(m.EventMessage(display=NAME, kind=kind, detail="as it is"))),
        (1, lambda: plain(m.Failure(code="invalid_field", message="it is", field="gain"))),
        (1, lambda: plain(m.Failure(id=rng.randrange(1, 99), code="busy", message="late"))),
        (1, lambda: plain(msgspec.structs.replace(stats("armed"), id=rng.randrange(1, 99)))),
        (1, lambda: plain(msgspec.structs.replace(textures(), id=rng.randrange(1, 99)))),
    )
    (make,) = rng.choices([make for _, make in makers], [weight for weight, _ in makers])
    return make()


# Mutations


def mutated(rng: random.Random, message: Plain) -> Plain:
    """Return a message of which one to three parts are missing, odd, or of another length.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    message : dict of str to Any
        Correct message, which stays as it is.

    Returns
    -------
    dict of str to Any
        Mutated copy.
    """
    message = msgspec.msgpack.decode(msgspec.msgpack.encode(message))  # a copy with lists
    for _ in range(min(rng.choice((1, 1, 2, 3)), len(message))):
        mutate_at(rng, *place_in(rng, message))
    return message


def place_in(rng: random.Random, holder: Any) -> tuple[Any, Any]:
    """Return a container in a plain value, at random and not empty, and one of its keys.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    holder : dict or list
        Container to begin with, which is not empty.

    Returns
    -------
    holder : dict or list
        The container.
    key : str or int
        Key or index in it.
    """
    key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    inner = holder[key]
    is_deeper = isinstance(inner, dict | list) and inner and rng.random() < DEEPER
    return place_in(rng, inner) if is_deeper else (holder, key)


def mutate_at(rng: random.Random, holder: Any, key: Any) -> None:
    """Mutate what a container holds at a key.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    holder : dict or list
        Container, which is changed.
    key : str or int
        Key or index in it.
    """
    way = rng.random()
    if way < 0.5:
        holder[key] = similar(rng, holder[key])
    elif way < 0.7:
        del holder[key]
    elif way < 0.8 and isinstance(holder, dict):
        holder[f"{key}_"] = holder.pop(key)
    else:
        holder[key] = copy.deepcopy(rng.choice(ODD))


def similar(rng: random.Random, value: Any) -> Any:
    """Return an odd value of the same type, which is more likely to be taken for correct.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    value : Any
        Plain value.

    Returns
    -------
    Any
        Odd value.
    """
    match value:
        case bool() | None:
            return not value
        case int() | float():
            return rng.choice(NUMBERS)
        case str():
            return rng.choice(TEXTS)
        case bytes():
            samples = rng.choice(SAMPLES) * rng.choice((1, MANY, len(value) // 4))
            return samples[: len(samples) - rng.choice((0, 0, 1))]
        case list():
            size = rng.choice(
                (0, 1, len(value) + 1, LONG if value and isinstance(value[0], float) else MANY)
            )
            return list(itertools.islice(itertools.cycle(value), size))
    return value | {f"key {k}": rng.choice(NUMBERS) for k in range(MANY)}


def damaged(rng: random.Random, message: Plain) -> bytes | str:
    """Return data that is no MessagePack, or no longer that of a message.

    Parameters
    ----------
    rng : random.Random
        Source of what is chosen at random.
    message : dict of str to Any
        Correct message.

    Returns
    -------
    bytes or str
        Contents of a frame, binary or of text.
    """
    data = msgspec.msgpack.encode(message)
    match rng.randrange(5):
        case 0:
            return data[: rng.randrange(len(data))]
        case 1:
            at = rng.randrange(len(data))
            return data[:at] + rng.randbytes(rng.choice((1, 4))) + data[at + 1 :]
        case 2:
            return rng.choice((MARKUP, "1000000000", "99999999999999", "{}", '{"type":"stats"}'))
        case 3:
            return rng.randbytes(rng.randrange(200))
        case _:
            return rng.choice(NOT_MESSAGEPACK)


# The server


class HostileServer:
    """Server of one page, whose WebSocket sends what a random generator makes.

    Parameters
    ----------
    seed : int
        Seed of the generator.

    Attributes
    ----------
    is_hostile : bool
        Whether answers to requests, and welcomes after the first one, may be mutated.
    state : str
        State of the display that correct messages report.
    display : str
        Name of the display in a welcome.
    sent : int
        Number of mutated and damaged messages that were sent.
    connections : int
        Number of connections that were welcomed.
    requests : Counter of str
        Number of requests by type.
    page : str
        URL of the page.
    """

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._files = PageFiles()
        self._link: ServerConnection | None = None
        self._changed = asyncio.Condition()
        self._contactor = 0
        self.is_hostile, self.state, self.page = False, "disarmed", ""
        self.display = NAME
        self.sent = self.connections = 0
        self.requests: Counter[str] = Counter()

    async def welcomed(self) -> ServerConnection:
        """Wait for a page that was welcomed, and return its connection."""
        await self._wait_until(lambda: self._link is not None)
        assert self._link is not None
        return self._link

    async def requested(self, kind: str, times: int = 1) -> None:
        """Wait until pages have sent a request of a type a number of times.

        Parameters
        ----------
        kind : str
            Type of the request, such as "arm".
        times : int
            Number of times, counted from the start of the server.
        """
        await self._wait_until(lambda: self.requests[kind] >= times)

    async def _wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until something is so that changes with what pages do, for `PATIENCE` at most."""
        async with asyncio.timeout(PATIENCE), self._changed:
            await self._changed.wait_for(condition)

    async def send_batch(self, link: ServerConnection, size: int) -> None:
        """Send mutated messages, and at last one that is damaged, or end the connection.

        Parameters
        ----------
        link : ServerConnection
            Connection to a page.
        size : int
            Number of messages.
        """
        rng = self._rng
        for number in range(size):
            message = unasked(rng, self._contactor)
            if number < size - 1:
                await link.send(msgspec.msgpack.encode(mutated(rng, message)))
            elif rng.random() < 0.7:
                await link.send(damaged(rng, message))
            else:
                await self._break_off(link, msgspec.msgpack.encode(message))
            self.sent += 1

    async def _break_off(self, link: ServerConnection, data: bytes) -> None:
        """End a connection with a close code, within a frame, or by a frame that is none."""
        head = struct.pack(">BBH", 0x82, 126, len(data))
        match self._rng.randrange(4):
            case 0:
                await link.close(self._rng.choice(CODES), MARKUP[:100])
            case 1:
                link.transport.write(head + data[: len(data) // 2])
                link.transport.close()
            case 2:
                link.transport.write(b"\xf2" + head[1:] + data)  # reserved bits are set
            case _:
                link.transport.abort()

    async def send_correct(self, marker: str, kind: str = "note") -> None:
        """Send correct telemetry, and an event with a text.

        Parameters
        ----------
        marker : str
            Detail of the event.
        kind : str
            Kind of the event.
        """
        link = await self.welcomed()
        event = m.EventMessage(display=NAME, kind=kind, detail=marker)
        with suppress(ConnectionClosed):
            await link.send(
                msgspec.msgpack.encode(telemetry(self._rng, self.state, self._contactor))
            )
            await link.send(msgspec.msgpack.encode(event))

    async def talk(self, link: ServerConnection) -> None:
        """Answer the requests of a page until it is gone.

        Parameters
        ----------
        link : ServerConnection
            New connection to the page.
        """
        with suppress(ConnectionClosed):
            async for data in link:
                assert isinstance(data, bytes)
                command = msgspec.msgpack.decode(data)
                await self._answer(link, command)
                async with self._changed:
                    self.requests[command["type"]] += 1
                    self._changed.notify_all()
        if self._link is link:
            self._link = None

    async def _answer(self, link: ServerConnection, command: Plain) -> None:
        """Answer one request, correctly or not; contacts are not answered."""
        if command["type"] == "contact":
            return
        if command["type"] == "ping" and link is not self._link:
            await link.close()  # the page has taken a mutated welcome, with other displays
            return
        answer = self.answer_to(command)
        is_first = command["type"] == "hello" and self.connections == 0
        if self.is_hostile and not is_first and self._rng.random() < ODD_ANSWERS:
            self.sent += 1
            if command["type"] == "hello" and self._rng.random() < 0.5:
                answer["displays"] = self._rng.choice(([], [answer["displays"][0] | {"name": "b"}]))
            else:
                answer = mutated(self._rng, answer)
            await link.send(msgspec.msgpack.encode(answer))
            return
        await link.send(msgspec.msgpack.encode(answer))
        if command["type"] == "hello":
            async with self._changed:
                self._link, self.connections = link, self.connections + 1
                self._changed.notify_all()

    def answer_to(self, command: Plain) -> Plain:
        """Return the correct answer to a request, as plain data with its id.

        Parameters
        ----------
        command : dict of str to Any
            The request.

        Returns
        -------
        dict of str to Any
            The answer.
        """
        return plain(self._reply(command)) | {"id": command["id"]}

    def _reply(self, command: Plain) -> m.Answer:
        """Return the correct answer to a request."""
        match command["type"]:
            case "subscribe":
                self._contactor = command.get("contactor") or 0
            case "hello":
                return m.Welcome(
                    server="hostile", version=m.API_VERSION, session="s", may_arm=True, time_us=1,
                    displays=(description(self.display),), roles=("watch", "play", "arm", "stop"),
                )  # fmt: skip
            case "list_textures":
                return textures()
            case "get_stats":
                return stats(self.state)
            case "ping":
                return m.Pong(time_us=command["time_us"], server_time_us=2)
            case "draw_texture":
                slope = np.add.outer(np.arange(command["rows"]), np.arange(command["columns"]))
                pixels = (255 * slope / max(slope.max(), 1)).astype(np.uint8).tobytes()
                return m.TexturePicture(lowest_um=-5.0, highest_um=5.0, pixels=pixels)
            case "estop":
                self.state = "estopped"
                return m.Done(estops={NAME: 5})
            case "clear":
                self.state = "disarmed"
        return m.Done()

    async def file_or_socket(self, link: ServerConnection, request: Request) -> Response | None:
        """Return a file of the page, or None where the request is for the WebSocket.

        Parameters
        ----------
        link : ServerConnection
            Connection of the request.
        request : Request
            The request.

        Returns
        -------
        Response or None
            The file with the headers of the page, or status 404.
        """
        if request.path == m.PATH:
            return None
        head: Plain = {"status": HTTPStatus.NOT_FOUND, "headers": []}
        body = bytearray()

        async def take(message: Any) -> None:
            head.update(message)
            body.extend(message.get("body", b""))

        scope = {"type": "http", "method": "GET", "path": request.path, "headers": []}
        with suppress(HTTPException):
            await self._files(scope, asyncio.Event().wait, take)  # type: ignore[arg-type]
        headers = Headers([(name.decode(), value.decode()) for name, value in head["headers"]])
        return Response(head["status"], "", headers, bytes(body))


S = TypeVar("S", bound=HostileServer)


@asynccontextmanager
async def hostile_server(server: S) -> AsyncIterator[S]:
    """Run a server on a port of its own.

    Parameters
    ----------
    server : HostileServer
        Server to run.

    Yields
    ------
    HostileServer
        Running server.
    """
    async with serve(
        server.talk, "127.0.0.1", 0, process_request=server.file_or_socket, compression=None,
        subprotocols=[Subprotocol(m.MSGPACK_PROTOCOL)], ping_interval=None,
    ) as listening:  # fmt: skip
        port = next(iter(listening.sockets)).getsockname()[1]
        server.page = f"http://127.0.0.1:{port}/"
        yield server
