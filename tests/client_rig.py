"""A small server that answers by the contract, for the tests of the SDK in both twins.

It is a real WebSocket server that reads and says real messages; what it does wrong (refuse, be
silent, go away, not read) it does on purpose. Waits have generous limits, and nothing is
asserted of how quick something is.
"""

import asyncio
import contextlib
import inspect
import itertools
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import msgspec
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection, serve
from websockets.typing import Subprotocol

from tactile import client
from tactile import messages as m
from tactile.client import aio
from tactile.client.session import ClientSession
from tactile.clock import MONOTONIC

PATIENCE = 60.0
"""Longest wait for something that takes milliseconds on an idle machine [s]."""


def until(happened: Callable[[], Any]) -> Any:
    """Wait for something that is to come, and return it."""
    deadline = time.monotonic() + PATIENCE
    while not (result := happened()):
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.002)
    return result


def info(name: str, estop: int = 0, latest: int = 0) -> m.DisplayDescription:
    return m.DisplayDescription(
        name=name,
        contactors_mm=((-1.0, 2.0), (1.0, 2.0)),
        shear_direction_deg=(0.0, 90.0),
        sample_rate_hz=8000.0,
        voltage_limit_v=100.0,
        waveforms=True,
        latency_ms=4.0,
        estop=estop,
        latest_estop=max(estop, latest),
    )


def server_time_us() -> int:
    """Return the server's clock, which is not ours."""
    return time.monotonic_ns() // 1000 + 5_000_000


class Script:
    """Answers of the server; `answers` may be replaced by type, with None for silence."""

    def __init__(self, *displays: str) -> None:
        self.displays = displays or ("left",)
        self.messages_per_second = 0
        self.estop = self.latest = 0
        self.answers: dict[type, Callable[[Any], m.Answer | None]] = {}

    def answer(self, said: Any) -> m.Answer | None:
        if type(said) in self.answers:
            return self.answers[type(said)](said)
        match said:
            case m.ClientHello():
                return m.Welcome(
                    id=said.id,
                    server="test",
                    version=1,
                    session="s",
                    displays=tuple(info(name, self.estop, self.latest) for name in self.displays),
                    may_arm=True,
                    roles=("watch", "arm"),
                    time_us=server_time_us(),
                    messages_per_second=self.messages_per_second,
                )
            case m.Contact() | m.TactileFrames():
                return None
            case m.ListTextures():
                oak = m.TextureInfo(
                    name="wood-oak", category="wood", description="", provenance="assumed"
                )
                return m.Textures(id=said.id, textures=(oak,))
            case m.ListEffects():
                tap = m.EffectInfo(name="tap", description="", seconds=0.02)
                return m.Effects(id=said.id, effects=(tap,))
            case m.Append():
                return m.AppendedReply(id=said.id, samples_consumed=count(said), buffered_ms=10.0)
            case m.GetStats():
                return msgspec.structs.replace(stats(said), estop=self.estop)
            case m.EStop() if said.display:
                return m.Done(id=said.id, estops={said.display: 7})
            case m.Ping():
                return m.Pong(id=said.id, time_us=said.time_us, server_time_us=server_time_us())
            case _:
                return m.Done(id=said.id)


def count(said: m.Append) -> int:
    return len(said.samples) // 4 if isinstance(said.samples, bytes) else len(said.samples)


def stats(said: m.GetStats) -> m.StatsReply:
    return m.StatsReply(
        id=said.id,
        display=said.display,
        state="armed",
        link="up",
        detail="",
        touching=False,
        owner=True,
        latency_ms=4.0,
        counters={"underruns": 2},
    )


def telemetry(number: int, display: str = "left") -> m.TelemetryMessage:
    return m.TelemetryMessage(
        display=display,
        time_us=number,
        state="armed",
        position_mm=(1.0, 2.0),
        velocity_mm_s=(80.0, 0.0),
        normal_force_n=0.5,
        shear_um=(3.0, -3.0),
        drive_v=(50.0, -50.0),
        counters={},
    )


class ScriptedServer:
    """A WebSocket server on a port of its own that reads by the contract and follows a script."""

    def __init__(self, script: Script, listener: socket.socket | None = None) -> None:
        self.script = script
        self.heard: list[Any] = []  # all but pings, which come at any time
        self.pings = 0
        self.connections: list[ServerConnection] = []
        self.reading = threading.Event()
        self.reading.set()
        self._listener = listener or socket.create_server(("127.0.0.1", 0))
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        protocols = [Subprotocol(m.MSGPACK_PROTOCOL), Subprotocol(m.JSON_PROTOCOL)]
        self.server: Server = serve(
            self._handle, sock=self._listener, subprotocols=protocols, open_timeout=PATIENCE,
            close_timeout=1, ping_interval=None,
        )  # fmt: skip
        self.url = f"ws://127.0.0.1:{self._listener.getsockname()[1]}/v1" if not listener else ""
        self._thread = threading.Thread(target=self.server.serve_forever)
        self._thread.start()

    def _handle(self, connection: ServerConnection) -> None:
        module: Any = msgspec.json if self._json(connection) else msgspec.msgpack
        decoder = module.Decoder(m.Command)
        self.connections.append(connection)
        with contextlib.suppress(ConnectionClosed):
            while True:
                self.reading.wait()
                said = decoder.decode(connection.recv())
                if isinstance(said, m.Ping):
                    self.pings += 1
                else:
                    self.heard.append(said)
                self.say(self.script.answer(said), connection)

    def _json(self, connection: ServerConnection) -> bool:
        return connection.subprotocol == m.JSON_PROTOCOL

    def say(self, answer: m.Answer | None, connection: ServerConnection | None = None) -> None:
        if answer is not None:
            module: Any = msgspec.json if self._json(connection or self.last) else msgspec.msgpack
            data = module.encode(answer)
            (connection or self.last).send(data, text=module is msgspec.json)

    @property
    def last(self) -> ServerConnection:
        return self.connections[-1]

    def of(self, *kinds: type) -> list[Any]:
        return [said for said in list(self.heard) if isinstance(said, kinds)]

    def drop(self) -> None:
        """Cut the connection without a farewell."""
        with contextlib.suppress(OSError):
            self.last.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.reading.set()
        self.server.shutdown()
        for connection in self.connections:
            with contextlib.suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listener.close()


class Driven:
    """An object of the asyncio twin, whose calls wait as those of the other do."""

    def __init__(self, run: Callable[[Any], Any], inner: Any) -> None:
        self._run, self._inner = run, inner

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)
        if inspect.iscoroutinefunction(value):
            return lambda *args, **options: self._wrapped(self._run(value(*args, **options)))
        if callable(value):
            return lambda *args, **options: self._wrapped(self._run(soon(value, args, options)))
        return self._wrapped(value)

    def _wrapped(self, value: Any) -> Any:
        ours = isinstance(value, aio.AsyncConnection | aio.AsyncDisplay | aio.AsyncTelemetryStream)
        return Driven(self._run, value) if ours else value

    def __iter__(self) -> Iterator[Any]:
        while True:
            try:
                yield self._run(self._inner.__anext__())
            except StopAsyncIteration:
                return

    def __enter__(self) -> "Driven":
        return self

    def __exit__(self, *error: Any) -> None:
        self._run(self._inner.__aexit__(*error))


async def soon(function: Callable[..., Any], args: Any, options: Any) -> Any:
    return function(*args, **options)


class Twin:
    """One of the two clients, made to be used as the synchronous one is."""

    def __init__(self, name: str) -> None:
        self.name = name
        if name == "asyncio":
            self._loop = asyncio.new_event_loop()
            self._thread = threading.Thread(target=self._loop.run_forever)
            self._thread.start()

    def run(self, awaitable: Any) -> Any:
        async def awaited() -> Any:
            return await awaitable

        return asyncio.run_coroutine_threadsafe(awaited(), self._loop).result(PATIENCE)

    def connect(self, *args: Any, **options: Any) -> Any:
        if self.name == "thread":
            return client.connect(*args, **options)
        return Driven(self.run, self.run(aio.connect(*args, **options)))

    def open_connection(self, *args: Any, **options: Any) -> Any:
        if self.name == "thread":
            return client.open_connection(*args, **options)
        return Driven(self.run, self.run(aio.open_connection(*args, **options)))

    def over(self, transport: Any) -> Any:
        """Return a connection over a transport."""
        if self.name == "thread":
            return client.Connection(transport, timeout=PATIENCE)
        return Driven(self.run, self.run(aio.AsyncConnection(transport, timeout=PATIENCE).open()))

    def close(self) -> None:
        if self.name == "asyncio":
            self.run(self._loop.shutdown_default_executor())
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()


def opened_session() -> tuple[ClientSession, list[Any]]:
    """Return a session that is connected to nothing, and what it hands over."""
    kept: list[Any] = []

    class Nowhere:
        is_local = True
        open: Any = None
        close: Any = Future
        send = staticmethod(kept.append)

    session = ClientSession(Nowhere(), m.ClientHello(client="test"), clock=MONOTONIC)
    session.say_hello()
    session.received(Script().answer(kept.pop()))  # type: ignore[arg-type]
    return session, kept


def samples_of(said: m.Append) -> tuple[float, ...]:
    assert isinstance(said.samples, bytes)
    return struct.unpack(f"<{count(said)}f", said.samples)


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


MESSAGES: list[tuple[Callable[[Any], Any], Any]] = [
    (
        lambda d: d.touch((0.012, 0.003), velocity=(0.08, -0.01), normal_force=0.5, time=12.5),
        m.Contact(
            display="left",
            position_mm=(12.0, 3.0),
            normal_force_n=0.5,
            time_us=12_500_000,
            velocity_mm_s=(80.0, -10.0),
        ),
    ),
    (
        lambda d: d.lift(time=1.0),
        m.Contact(display="left", position_mm=(0.0, 0.0), normal_force_n=0.0, time_us=1_000_000),
    ),
    (
        lambda d: d.select("wood-oak"),
        m.Select(display="left", layers=(m.Layer(texture="wood-oak"),)),
    ),
    (
        lambda d: d.select(("wood-oak", 0.5)),
        m.Select(display="left", layers=(m.Layer(texture="wood-oak", gain=0.5),)),
    ),
    (
        lambda d: d.select(["a", ("b", 0.25), m.Layer(texture="c", seed=7)]),
        m.Select(
            display="left",
            layers=(
                m.Layer(texture="a"),
                m.Layer(texture="b", gain=0.25),
                m.Layer(texture="c", seed=7),
            ),
        ),
    ),
    (
        lambda d: d.select(("a", "b")),
        m.Select(display="left", layers=(m.Layer(texture="a"), m.Layer(texture="b"))),
    ),
    (lambda d: d.select(()), m.Select(display="left", layers=())),
    (lambda d: d.gain(0.5), m.SetGain(display="left", gain=0.5)),
    (lambda d: d.stop(), m.StopPlaying(display="left")),
    (lambda d: d.resume(), m.Resume(display="left")),
    (lambda d: d.arm(), m.ArmDisplay(display="left")),
    (lambda d: d.disarm(), m.DisarmDisplay(display="left")),
    (lambda d: d.estop(), m.EStop(display="left")),
    (lambda d: d.connection.estop(), m.EStop()),
    (lambda d: d.clear(estop=3), m.ClearEstop(display="left", estop=3)),
    (
        lambda d: d.append([0.5, -1.0], sample_rate=8000.0, amplitude=5e-6, contactors=[1]),
        m.Append(
            display="left",
            sample_rate_hz=8000.0,
            amplitude_um=5.0,
            samples=floats(0.5, -1.0),
            contactors=(1,),
        ),
    ),
    (
        lambda d: d.play([0.5], sample_rate=8000.0, amplitude=5e-6),
        m.Append(
            display="left",
            sample_rate_hz=8000.0,
            amplitude_um=5.0,
            samples=floats(0.5),
            append=False,
        ),
    ),
    (
        lambda d: d.effect(
            5e-6,
            amplitude_points=[(0.0, 1.0), (0.25, 0.0)],
            frequency_points=[(0.0, 200.0)],
            transients=[(0.125, 0.5, 80.0), (0.25, 1.0)],
            stream=True,
        ),
        m.PlayEffect(
            display="left",
            amplitude_um=5.0,
            amplitude=(m.Point(0.0, 1.0), m.Point(250.0, 0.0)),
            frequency=(m.FrequencyPoint(0.0, 200.0),),
            transients=(m.Transient(125.0, 0.5, 80.0), m.Transient(250.0, 1.0)),
            stream=True,
        ),
    ),
    (
        lambda d: d.transient(5e-6, frequency=100.0),
        m.PlayEffect(display="left", amplitude_um=5.0, transients=(m.Transient(0.0, 1.0, 100.0),)),
    ),
    (
        lambda d: d.play_effect("tap", gain=0.5),
        m.PlayNamedEffect(display="left", effect="tap", gain=0.5),
    ),
    (lambda d: d.effects(), m.ListEffects()),
    (lambda d: d.stats(), m.GetStats(display="left")),
    (lambda d: d.textures(), m.ListTextures()),
]  # fmt: skip


def plain(message: Any) -> Any:
    """Return a message without its id, rounded as units that are converted are."""

    def rounded(value: Any) -> Any:
        if isinstance(value, float):
            return round(value, 9)
        if isinstance(value, list):
            return [rounded(item) for item in value]
        if isinstance(value, dict):
            return {key: rounded(item) for key, item in value.items() if key != "id"}
        return value

    return rounded(msgspec.to_builtins(message, builtin_types=(bytes,)))


def fill(server: ScriptedServer, display: Any) -> int:
    """Let the server not read, and touch until nothing is sent any more; return how often."""
    server.reading.clear()
    for said in itertools.count(50, 50):
        before = display.dropped_contacts
        for number in range(said - 49, said + 1):
            display.touch((number * 1e-6, 0.0))
            time.sleep(0.0002)
        if display.dropped_contacts - before == 50:
            return said
        assert said < 200_000, "the buffers never filled"
    raise AssertionError
