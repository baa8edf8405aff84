"""Rig of the server's tests: real sockets and protocols, and a host in memory that logs calls.

`Hands` is a host without displays' processes: it does at once what the tests need, or as slowly as
they say, and breaks on demand. What the real one does with a command has tests of its own.
"""

import asyncio
import json
import random
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Any, TypeVar

import httpx
import msgspec
import pytest
from websockets.asyncio import client
from websockets.typing import Subprotocol

from tactile.messages import (
    JSON_PROTOCOL,
    MOST_PIXELS,
    MSGPACK_PROTOCOL,
    Answer,
    Append,
    AppendedReply,
    ArmDisplay,
    Command,
    Contact,
    DisarmDisplay,
    DisplayDescription,
    Done,
    DrawTexture,
    EffectInfo,
    Effects,
    EStop,
    EventMessage,
    Failure,
    GetStats,
    ListEffects,
    ListTextures,
    Role,
    Select,
    StatsReply,
    Streamed,
    Subscribe,
    TelemetryMessage,
    TextureInfo,
    TexturePicture,
    Textures,
)
from tactile.server.client import Client, Posted
from tactile.server.config import Configuration, OscConfig, ServerConfig, TokenConfig
from tactile.server.host import Host
from tactile.server.server import Server, running

T = TypeVar("T")
PATIENCE = 60.0
"""Longest wait for something that takes milliseconds on an idle machine [s]."""
PATIENT: dict[str, Any] = {
    "open_timeout": PATIENCE, "close_timeout": PATIENCE, "ping_interval": None,
}  # fmt: skip
connect: Any = partial(client.connect, **PATIENT)
unix_connect: Any = partial(client.unix_connect, **PATIENT)
TEXTURE = "wood-oak"
LARGE = EventMessage(display="right", kind="fault", detail="x" * 20_000)


def display(name: str) -> DisplayDescription:
    return DisplayDescription(
        name=name,
        contactors_mm=((0.0, 0.0), (1.2, 0.0)),
        shear_direction_deg=(0.0, 0.0),
        sample_rate_hz=8000.0,
        voltage_limit_v=100.0,
        waveforms=True,
        latency_ms=9.0,
    )


class Hand(Client):
    """A client that notes."""

    sounds: bool = False
    holds_voltage: bool = False

    def __init__(self, hands: "Hands", name: str, roles: frozenset[Role]) -> None:
        self.hands, self.name, self.roles = hands, name, roles
        self.quieted = self.gave_up = 0
        self.outbox: asyncio.Queue[Posted] = asyncio.Queue(256)
        self.contacts: list[Contact] = []
        self.commands: list[Command] = []
        self.closed = 0

    def stream(self, message: Streamed, arrival: float) -> Failure | None:
        if self.hands.broken:
            raise ZeroDivisionError
        if message.display not in self.hands.names:
            return Failure(code="unknown_display", message="no display", field="display")
        if isinstance(message, Contact):
            self.contacts.append(message)
        self.hands.log.append((self.name, message))
        return None

    async def request(self, command: Command) -> Answer:
        if self.hands.broken:
            raise ZeroDivisionError
        if isinstance(command, Select | DrawTexture):
            await self.hands.gate.wait()
        await self.hands.pause()
        self.commands.append(command)
        self.hands.log.append((self.name, command))
        return self._reply(command)

    def _reply(self, command: Any) -> Answer:
        code = self.hands.codes.get(type(command))
        if code is not None:
            return Failure(code=code, message="as told", field="display")
        if isinstance(command, ArmDisplay):
            if "arm" not in self.roles:
                return Failure(code="unauthorized", message="may not arm")
            self.hands.armed = True
        elif isinstance(command, DisarmDisplay | EStop):
            self.hands.armed = False
        elif isinstance(command, ListTextures):
            info = TextureInfo(name=TEXTURE, category="wood", description="", provenance="authored")
            return Textures(textures=(info,))
        elif isinstance(command, DrawTexture):
            count = command.columns * command.rows
            if count > MOST_PIXELS:
                return Failure(code="invalid_field", message="too many pixels", field="columns")
            pixels = (bytes(range(256)) * (count // 256 + 1))[:count]
            return TexturePicture(lowest_um=-1.0, highest_um=2.0, pixels=pixels)
        elif isinstance(command, ListEffects):
            return Effects(effects=(EffectInfo(name="tap", description="", seconds=0.02),))
        elif isinstance(command, Append):
            taken = len(command.samples)
            return AppendedReply(samples_consumed=taken, buffered_ms=1.0)
        elif isinstance(command, GetStats):
            return StatsReply(
                display=command.display, state="disarmed", link="up", detail="",
                touching=False, owner=False, latency_ms=9.0, counters={"underruns": 0},
            )  # fmt: skip
        elif isinstance(command, Subscribe):
            self.outbox.put_nowait(self._sample(command.display))
        return Done()

    @staticmethod
    def _sample(name: str) -> TelemetryMessage:
        return TelemetryMessage(
            display=name, time_us=1, state="disarmed", position_mm=(0.0, 0.0),
            velocity_mm_s=(0.0, 0.0), normal_force_n=0.0, shear_um=(0.0,), drive_v=(0.0,),
            counters={},
        )  # fmt: skip

    def quiet(self) -> None:
        self.quieted += 1
        self.sounds = False

    def give_up(self) -> None:
        self.gave_up += 1
        self.holds_voltage = False

    def close(self) -> None:
        self.closed += 1
        self.hands.log.append((self.name, None))


async def no_pause() -> None:
    """Carry out a request at once."""


class Hands(Host):
    """The host: notes what its clients do, in `log` in the order in which it came.

    `pause` is awaited before each request but a contact, and makes the host as slow as it is.
    """

    def __init__(self) -> None:
        self.names = ["right", "left"]
        self.log: list[tuple[str, Command | None]] = []
        self.clients: list[Hand] = []
        self.codes: dict[type, Any] = {}
        self.gate = asyncio.Event()
        self.gate.set()
        self.pause: Callable[[], Awaitable[object]] = no_pause
        self.armed = self.broken = False
        self.alive = True
        self.started = self.closings = self.reloads = self.beats = 0

    async def start(self) -> None:
        self.started += 1

    async def close(self) -> None:
        self.closings += 1
        self.armed = False

    async def reload(self) -> None:
        self.reloads += 1

    def degrade(self, error: BaseException) -> None:
        self.armed = False

    @property
    def displays(self) -> tuple[DisplayDescription, ...]:
        return tuple(display(name) for name in self.names)

    def state(self, display: str) -> str:
        return "armed" if self.armed else "disarmed"

    def connect(self, name: str, *, roles: frozenset[Role]) -> Hand:
        self.clients.append(Hand(self, name, roles))
        return self.clients[-1]

    def healthy(self) -> bool:
        return self.alive

    def beat(self) -> bool:
        self.beats += 1
        return self.alive

    def figures(self) -> dict[str, dict[str, float]]:
        return {name: {"underruns_total": 3.0, "latency_s": 0.009} for name in self.names}


class Talker:
    """A connection that speaks one of the subprotocols, in plain data."""

    def __init__(self, link: client.ClientConnection, protocol: str) -> None:
        self.link, self.protocol = link, protocol

    async def send(self, **message: Any) -> None:
        if self.protocol == JSON_PROTOCOL:
            await self.link.send(json.dumps(message))
        else:
            await self.link.send(msgspec.msgpack.encode(message))

    async def receive(self) -> dict[str, Any]:
        data = await asyncio.wait_for(self.link.recv(), PATIENCE)
        assert isinstance(data, str) is (self.protocol == JSON_PROTOCOL)
        found = json.loads(data) if isinstance(data, str) else msgspec.msgpack.decode(data)
        assert isinstance(found, dict)
        return found

    async def ask(self, **message: Any) -> dict[str, Any]:
        await self.send(**message)
        return await self.receive()

    async def asked(self, **message: Any) -> dict[str, Any]:
        """Return the answer, past the events that come before it."""
        await self.send(**message, id=4711)
        while (found := await self.receive()).get("id") != 4711:
            assert found["type"] == "event"
        return found

    async def closed(self) -> tuple[int | None, str | None]:
        await asyncio.wait_for(self.link.wait_closed(), PATIENCE)
        return self.link.close_code, self.link.close_reason


@asynccontextmanager
async def talking(
    server: Server, protocol: str = JSON_PROTOCOL, *, hello: bool = True, **options: Any
) -> AsyncIterator[Talker]:
    """Connect, and say `Hello` unless told not to; answers that nobody reads do not pile up."""
    options = {"subprotocols": [Subprotocol(protocol)], "max_queue": None, **options}
    async with connect(server.url, **options) as link:
        talker = Talker(link, protocol)
        if hello:
            welcome = await talker.ask(type="hello", client="test", id=0)
            assert welcome["type"] == "welcome"
        yield talker


@asynccontextmanager
async def serving(
    osc: int = 0,
    token: tuple[TokenConfig, ...] = (),
    hands: Hands | None = None,
    **options: Any,
) -> AsyncIterator[tuple[Server, Hands]]:
    """Run a server on a port of its own, its host in memory."""
    hands = Hands() if hands is None else hands
    options = {"port": 0, "socket": "", **options}
    config = Configuration(server=ServerConfig(**options), token=token, osc=OscConfig(port=osc))
    async with running(config, host=hands) as server:
        yield server, hands


def run(test: Callable[[], Awaitable[T]], within: float = 10 * PATIENCE) -> T:
    """Run a test's coroutine; one that hangs fails."""

    async def bounded() -> T:
        async with asyncio.timeout(within):
            return await test()

    return asyncio.run(bounded())


async def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.005)


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """Return a port that no process uses, and that the system gives to none that asks for any."""
    while True:
        port = random.randrange(20_000, 32_000)
        with socket.socket(socket.AF_INET, kind) as one, suppress(OSError):
            one.bind(("127.0.0.1", port))
            return port


async def get(there: Server, path: str, **headers: str) -> httpx.Response:
    url = f"http://127.0.0.1:{there.port}{path}"
    async with httpx.AsyncClient(trust_env=False, timeout=PATIENCE) as asking:
        return await asking.get(url, headers=headers)


def figure(there: Server, name: str, **labels: str) -> float:
    """Return the sum of a metric over the labels that are not given."""
    return sum(
        sample.value
        for family in there.site.metrics.registry.collect()
        for sample in family.samples
        if sample.name == name and labels.items() <= sample.labels.items()
    )


BOTH = [JSON_PROTOCOL, MSGPACK_PROTOCOL]
each_encoding = pytest.mark.parametrize("protocol", BOTH)

CONTACT = {
    "type": "contact", "display": "right", "position_mm": [1.0, 2.0], "normal_force_n": 0.5,
    "time_us": 5, "velocity_mm_s": [80.0, 0.0],
}  # fmt: skip
FRAMES = {
    "type": "frames", "display": "right", "frame_rate_hz": 1000, "amplitude_um": 5,
    "frames": [0.5, -1], "latest": True,
}  # fmt: skip
SELECT = {"type": "select", "display": "right", "layers": [{"texture": "wood-oak"}]}
PICTURE = {
    "type": "draw_texture", "texture": TEXTURE, "left_mm": 0, "bottom_mm": 0, "pixel_mm": 1,
    "columns": 4, "rows": 3,
}  # fmt: skip
"""Request for a small picture."""

GOOD: dict[str, tuple[dict[str, Any], str]] = {
    "list_textures": ({"type": "list_textures"}, "textures"),
    "draw_texture": (PICTURE, "texture_picture"),
    "select": (SELECT, "done"),
    "play": ({"type": "play", "display": "right"}, "done"),
    "stop": ({"type": "stop", "display": "right"}, "done"),
    "gain": ({"type": "gain", "display": "right", "gain": 0.5}, "done"),
    "append": (
        {"type": "append", "display": "right", "sample_rate_hz": 8000, "amplitude_um": 5,
         "samples": [0, 0.5, -1], "begin": {"at_us": 5, "drop_late": True, "mark": 9}},
        "appended",
    ),
    "effect": (
        {"type": "effect", "display": "right", "amplitude_um": 5, "amplitude": [[0, 1], [9, 0]],
         "frequency": [[0, 100]], "transients": [[0, 1, 160]]},
        "done",
    ),
    "list_effects": ({"type": "list_effects"}, "effects"),
    "play_effect": ({"type": "play_effect", "display": "right", "effect": "tap"}, "done"),
    "arm": ({"type": "arm", "display": "right"}, "done"),
    "disarm": ({"type": "disarm", "display": "right"}, "done"),
    "estop": ({"type": "estop"}, "done"),
    "clear": ({"type": "clear", "display": "right", "estop": 1}, "done"),
    "get_stats": ({"type": "get_stats", "display": "right"}, "stats"),
    "ping": ({"type": "ping", "time_us": 77}, "pong"),
}  # fmt: skip


def handshake(port: int) -> bytes:
    """Return the request by which a client opens a WebSocket."""
    return (
        f"GET /v1 HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {JSON_PROTOCOL}\r\n\r\n"
    ).encode()


async def unread(there: Server) -> socket.socket:
    """Return a socket that said `Hello`, and reads no further."""
    loop = asyncio.get_running_loop()
    link = socket.socket()
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link.setblocking(False)
    await loop.sock_connect(link, ("127.0.0.1", there.port))
    await loop.sock_sendall(link, handshake(there.port))
    assert (await loop.sock_recv(link, 4096)).startswith(b"HTTP/1.1 101")
    await loop.sock_sendall(link, frame(0x81, b'{"type":"hello","client":"deaf"}'))
    return link


def frame(head: int, payload: bytes) -> bytes:
    """Return a frame of a client, masked with zeros."""
    length = bytes([0x80 | len(payload)])
    if len(payload) > 125:
        length = bytes([0x80 | 126]) + len(payload).to_bytes(2)
    return bytes([head]) + length + bytes(4) + payload


class Bad(msgspec.Struct, frozen=True):
    """A message, what is wrong with it, and where."""

    content: Any
    code: str
    field: str = ""


BAD = [
    Bad({"type": "bogus", "id": 7}, "unknown_type", "type"),
    Bad({"type": 5, "id": 7}, "unknown_type", "type"),
    Bad({"id": 7}, "invalid_field", "type"),
    Bad([], "invalid_field"),
    Bad(7, "invalid_field"),
    Bad("estop", "invalid_field"),
    Bad(dict(CONTACT, position_mm=[0, 1e9]), "invalid_field", "position_mm[1]"),
    Bad(dict(CONTACT, position_mm=[0]), "invalid_field", "position_mm"),
    Bad(dict(CONTACT, position_mm=["0", 0]), "invalid_field", "position_mm[0]"),
    Bad(dict(CONTACT, normal_force_n=-0.1), "invalid_field", "normal_force_n"),
    Bad(dict(CONTACT, normal_force_n=50.1), "invalid_field", "normal_force_n"),
    Bad(dict(CONTACT, velocity_mm_s=[0, 2e4]), "invalid_field", "velocity_mm_s[1]"),
    Bad(dict(CONTACT, time_us=1.5), "invalid_field", "time_us"),
    Bad({"type": "contact", "display": "right"}, "invalid_field", "position_mm"),
    Bad({"type": "play", "display": "../../etc/passwd"}, "invalid_field", "display"),
    Bad({"type": "play", "display": "x" * 65}, "invalid_field", "display"),
    Bad({"type": "play", "id": 7}, "invalid_field", "display"),
    Bad({"type": "play", "display": "right", "id": -1}, "invalid_field", "id"),
    Bad({"type": "gain", "display": "right", "gain": 2, "id": 7}, "invalid_field", "gain"),
    Bad(
        dict(SELECT, layers=[{"texture": "a"}, {"texture": "b", "gain": 9}], id=7),
        "invalid_field", "layers[1].gain",
    ),
    Bad(dict(SELECT, layers=[{"gain": 1}], id=7), "invalid_field", "layers[0].texture"),
    Bad(dict(SELECT, layers=[{"texture": "a"}] * 5, id=7), "invalid_field", "layers"),
    Bad(
        dict(GOOD["append"][0], samples=[0] * 3999 + [1.01], id=7),
        "invalid_field", "samples[3999]",
    ),
    Bad(dict(GOOD["append"][0], samples=[0] * 4001, id=7), "invalid_field", "samples"),
    Bad(dict(GOOD["effect"][0], amplitude=[[0, 2]], id=7), "invalid_field", "amplitude[0][1]"),
    Bad({"type": "subscribe", "display": "right", "rate_hz": 1e9}, "invalid_field", "rate_hz"),
    Bad({"type": "hello", "client": "again", "id": 7}, "unsupported", "type"),
    Bad(dict(CONTACT, display="middle"), "unknown_display", "display"),
    Bad(dict(FRAMES, frames=[0, 1.01]), "invalid_field", "frames[1]"),
    Bad(dict(FRAMES, frame_rate_hz=99), "invalid_field", "frame_rate_hz"),
    Bad(dict(FRAMES, amplitude_um=501), "invalid_field", "amplitude_um"),
    Bad(dict(FRAMES, latest="newest"), "invalid_field", "latest"),
    Bad(dict(FRAMES, begin={"drop_late": True}), "invalid_field", "begin.at_us"),
    Bad(dict(FRAMES, begin=5), "invalid_field", "begin"),
    Bad(
        dict(GOOD["effect"][0], begin={"at_us": 2**63}, id=7), "invalid_field", "begin.at_us"
    ),
    Bad(
        dict(GOOD["append"][0], begin={"at_us": 0, "number": -1}, id=7),
        "invalid_field", "begin.number",
    ),
    Bad(
        dict(GOOD["append"][0], begin={"at_us": 0, "marker": 256}, id=7),
        "invalid_field", "begin.marker",
    ),
]  # fmt: skip
