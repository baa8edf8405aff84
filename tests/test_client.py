"""The SDK against a small daemon that answers by the contract, in both twins.

The daemon here is a real WebSocket server that reads and says real messages; what it does wrong
(refuse, be silent, go away, not read) it does on purpose. Waits have generous limits, and nothing
is asserted of how quick something is.
"""

import asyncio
import contextlib
import inspect
import itertools
import math
import socket
import struct
import subprocess
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from daemon_rig import Hands
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection, serve
from websockets.typing import Subprotocol

from tactile import client, local
from tactile.client import aio, base, websocket
from tactile.client.outbox import Outbox
from tactile.client.session import Clock, Session
from tactile.client.transport import Receiver
from tactile.client.waveform import Waveform
from tactile.client.wire import from_telemetry
from tactile.daemon import messages as m
from tactile.daemon.config import Config, OscConfig, ServerConfig
from tactile.daemon.server import running
from tactile.errors import (
    ClientError,
    ClientTimeoutError,
    DisconnectedError,
    InputError,
    NotFoundError,
    RequestError,
)

PATIENCE = 20.0
"""s for something that happens in milliseconds on an idle machine."""


def until(happened: Callable[[], Any]) -> Any:
    """Wait for something that is to come, and return it."""
    deadline = time.monotonic() + PATIENCE
    while not (result := happened()):
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.002)
    return result


def info(name: str) -> m.DisplayInfo:
    return m.DisplayInfo(
        name=name,
        contactors_mm=((-1.0, 2.0), (1.0, 2.0)),
        shear_direction_deg=(0.0, 90.0),
        sample_rate_hz=8000.0,
        voltage_limit_v=100.0,
        waveforms=True,
        latency_ms=4.0,
    )


def server_time_us() -> int:
    """Return the daemon's clock, which is not ours."""
    return time.monotonic_ns() // 1000 + 5_000_000


class Script:
    """What the daemon answers; `answers` may be replaced by type, with None for silence."""

    def __init__(self, *displays: str) -> None:
        self.displays = displays or ("left",)
        self.messages_per_second = 0
        self.answers: dict[type, Callable[[Any], m.Answer | None]] = {}

    def answer(self, said: Any) -> m.Answer | None:
        if type(said) in self.answers:
            return self.answers[type(said)](said)
        match said:
            case m.Hello():
                return m.Welcome(
                    id=said.id,
                    server="test",
                    version=1,
                    session="s",
                    displays=tuple(info(name) for name in self.displays),
                    may_arm=True,
                    time_us=server_time_us(),
                    messages_per_second=self.messages_per_second,
                )
            case m.Contact():
                return None
            case m.ListTextures():
                oak = m.TextureInfo(
                    name="wood-oak", category="wood", description="", provenance="assumed"
                )
                return m.Textures(id=said.id, textures=(oak,))
            case m.Append():
                return m.Appended(id=said.id, samples_consumed=count(said), buffered_ms=10.0)
            case m.GetStats():
                return stats(said)
            case m.Ping():
                return m.Pong(id=said.id, time_us=said.time_us, server_time_us=server_time_us())
            case _:
                return m.Done(id=said.id)


def count(said: m.Append) -> int:
    return len(said.samples) // 4 if isinstance(said.samples, bytes) else len(said.samples)


def stats(said: m.GetStats) -> m.Stats:
    return m.Stats(
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


def telemetry(number: int, display: str = "left") -> m.Telemetry:
    return m.Telemetry(
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


class Daemon:
    """A WebSocket server on a port of its own that reads by the contract and follows a script."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.heard: list[Any] = []
        self.connections: list[ServerConnection] = []
        self.reading = threading.Event()
        self.reading.set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        protocols = [Subprotocol(m.MSGPACK_PROTOCOL), Subprotocol(m.JSON_PROTOCOL)]
        self.server: Server = serve(
            self._handle, sock=self._listener, subprotocols=protocols, close_timeout=1
        )
        self.url = f"ws://127.0.0.1:{self._listener.getsockname()[1]}/v1"
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
        """Cut the connection without a word."""
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
        ours = isinstance(value, aio.Connection | aio.Display | aio.TelemetryStream)
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
    """One of the two, made to be used as the synchronous one is."""

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
            return client.Connection(transport)
        return Driven(self.run, self.run(aio.Connection(transport).open()))

    def close(self) -> None:
        if self.name == "asyncio":
            self.run(self._loop.shutdown_default_executor())
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()


@pytest.fixture(params=["thread", "asyncio"])
def twin(request: pytest.FixtureRequest) -> Iterator[Twin]:
    twin = Twin(request.param)
    yield twin
    twin.close()


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def daemon(script: Script) -> Iterator[Daemon]:
    daemon = Daemon(script)
    yield daemon
    daemon.close()


@pytest.fixture
def display(twin: Twin, daemon: Daemon) -> Iterator[Any]:
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        yield display


def samples_of(said: m.Append) -> tuple[float, ...]:
    assert isinstance(said.samples, bytes)
    return struct.unpack(f"<{count(said)}f", said.samples)


# Each call's message, in the units of the wire


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
    (lambda d: d.gain(0.5), m.Gain(display="left", gain=0.5)),
    (lambda d: d.stop(), m.Stop(display="left")),
    (lambda d: d.resume(), m.Play(display="left")),
    (lambda d: d.arm(), m.Arm(display="left")),
    (lambda d: d.disarm(), m.Disarm(display="left")),
    (lambda d: d.estop(), m.EStop(display="left")),
    (lambda d: d.connection.estop(), m.EStop()),
    (lambda d: d.clear(), m.Clear(display="left")),
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
        m.Effect(
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
        m.Effect(display="left", amplitude_um=5.0, transients=(m.Transient(0.0, 1.0, 100.0),)),
    ),
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


@pytest.mark.parametrize(("call", "message"), MESSAGES)
def test_each_call_says_its_message(
    display: Any, daemon: Daemon, call: Callable[[Any], Any], message: Any
) -> None:
    call(display)
    (said,) = until(lambda: daemon.of(type(message)))
    assert plain(said) == plain(message)


@pytest.mark.parametrize(("call", "message"), MESSAGES)
def test_in_json_it_is_the_same(daemon: Daemon, call: Callable[[Any], Any], message: Any) -> None:
    with client.connect(daemon.url, timeout=PATIENCE, encoding="json") as display:
        call(display)
        (said,) = until(lambda: daemon.of(type(message)))
    if isinstance(message, m.Append):
        message = msgspec.structs.replace(message, samples=samples_of(message))
    assert plain(said) == plain(message)


def test_hello_comes_first_and_says_who_it_is(twin: Twin, daemon: Daemon) -> None:
    with twin.connect(daemon.url, token="secret", client_name="game", timeout=PATIENCE):
        pass
    assert plain(daemon.heard[0]) == plain(m.Hello(client="game", token="secret"))


def test_lift_is_where_the_finger_was_last(display: Any, daemon: Daemon) -> None:
    display.touch((0.001, 0.002))
    until(lambda: daemon.of(m.Contact))
    display.lift()
    _, lifted = until(lambda: len(daemon.of(m.Contact)) == 2 and daemon.of(m.Contact))
    assert (lifted.position_mm, lifted.normal_force_n) == ((1.0, 2.0), 0.0)


def test_time_is_our_monotonic_clock_where_none_is_given(display: Any, daemon: Daemon) -> None:
    before = time.monotonic()
    display.touch((0.0, 0.0))
    after = time.monotonic()
    (said,) = until(lambda: daemon.of(m.Contact))
    assert before - 1e-3 <= said.time_us * 1e-6 <= after + 1e-3
    assert said.velocity_mm_s is None


def test_positions_may_be_arrays_of_numpy(display: Any, daemon: Daemon) -> None:
    display.touch(np.array([0.001, 0.002], np.float32), velocity=np.zeros(2))
    (said,) = until(lambda: daemon.of(m.Contact))
    assert list(said.position_mm) == pytest.approx([1.0, 2.0], rel=1e-6)  # of float32


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda d: d.touch((math.nan, 0.0)), r"position_mm\[0\]: nan: Expected `float`"),
        (lambda d: d.touch((0.0, 101.0)), r"position_mm\[1\]: 101000.0: .* <= 100000.0"),
        (lambda d: d.touch((0.0, 0.0), velocity=(0.0, math.inf)), r"velocity_mm_s\[1\]: inf"),
        (lambda d: d.touch((0.0, 0.0), normal_force=-0.1), "normal_force_n: -0.1: .* >= 0"),
        (lambda d: d.touch((0.0, 0.0), time=math.nan), "time: nan s is not finite"),
        (lambda d: d.gain(1.5), "gain: 1.5: .* <= 1"),
        (lambda d: d.select(["a", ("b", 2.0)]), r"layers\[1\].gain: 2.0: .* <= 1"),
        (lambda d: d.select([3]), "layers: 3 is no texture"),
        (lambda d: d.select(["a"] * 5), "layers: .*length <= 4"),
        (lambda d: d.effect(1.0), "amplitude_um: 1000000.0: .* <= 500"),
        (
            lambda d: d.append([0.0, 1.5], sample_rate=8000, amplitude=1e-6),
            r"samples\[1\]: 1.5 is outside −1 … 1",
        ),
        (
            lambda d: d.append([math.nan], sample_rate=8000, amplitude=1e-6),
            r"samples\[0\]: nan is outside",
        ),
        (lambda d: d.append(["a"], sample_rate=8000, amplitude=1e-6), "samples: must be real"),
        (lambda d: d.append([0.0], sample_rate=8, amplitude=1e-6), "sample_rate_hz: 8.0: "),
        (lambda d: d.telemetry(rate=0), "rate: 0 Hz is not above 0"),
    ],
)
def test_a_value_out_of_range_is_not_even_sent(
    display: Any, daemon: Daemon, call: Callable[[Any], Any], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        call(display)
    display.stats()
    assert [type(said) for said in daemon.heard if not isinstance(said, m.Ping)] == [
        m.Hello, m.GetStats,
    ]  # fmt: skip


# Answers


def test_what_the_daemon_tells_is_in_si(display: Any) -> None:
    told = display.info
    assert (told.name, told.waveforms, told.voltage_limit) == ("left", True, 100.0)
    assert told.contactors == ((-1e-3, 2e-3), (1e-3, 2e-3))
    assert told.shear_direction == pytest.approx((0.0, math.pi / 2))
    assert told.latency == pytest.approx(4e-3)
    stats = display.stats()
    assert (stats.state, stats.latency, stats.counters) == ("armed", 0.004, {"underruns": 2})
    appended = display.append([0.0] * 3, sample_rate=8000, amplitude=1e-6)
    assert (appended.samples_consumed, appended.buffered) == (3, 0.01)
    assert [texture.name for texture in display.textures()] == ["wood-oak"]


def test_answers_out_of_order_find_their_questions(
    twin: Twin, script: Script, daemon: Daemon
) -> None:
    """The daemon keeps the first answer back until it has given the second."""
    script.displays = ("left", "right")
    kept: list[m.GetStats] = []

    def second_first(said: m.GetStats) -> None:
        kept.append(said)
        if len(kept) == 2:
            for asked in reversed(kept):
                daemon.say(stats(asked))

    script.answers[m.GetStats] = second_first
    with twin.open_connection(daemon.url, timeout=PATIENCE) as connection:
        told: dict[str, str] = {}

        def ask(name: str) -> None:
            told[name] = connection.display(name).stats().display

        threads = [threading.Thread(target=ask, args=(name,)) for name in script.displays]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert told == {"left": "left", "right": "right"}


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("unknown_texture", LookupError),
        ("unknown_texture", NotFoundError),
        ("invalid_field", ValueError),
        ("not_armed", RequestError),
    ],
)
def test_a_refusal_is_an_exception_with_code_and_field(
    display: Any, script: Script, code: m.Code, kind: type[Exception]
) -> None:
    script.answers[m.Select] = lambda said: m.Failure(
        id=said.id,
        code=code,
        message="no 'oak'; did you mean 'wood-oak'?",
        field="layers[0].texture",
    )
    with pytest.raises(RequestError, match=r"layers\[0\].texture: no 'oak'; did") as caught:
        display.select("oak")
    assert isinstance(caught.value, kind)
    assert (caught.value.code, caught.value.field) == (code, "layers[0].texture")


def test_an_answer_of_another_kind_is_an_error(display: Any, script: Script) -> None:
    script.answers[m.GetStats] = lambda said: m.Done(id=said.id)
    with pytest.raises(ClientError, match="answered Done, not Stats"):
        display.stats()


def test_a_daemon_that_is_silent_is_a_timeout_and_may_answer_the_next(
    display: Any, script: Script, daemon: Daemon
) -> None:
    asked: list[m.GetStats] = []
    script.answers[m.GetStats] = asked.append
    with pytest.raises(ClientTimeoutError, match=r"getstats: no answer in 0.05 s"):
        display.stats(timeout=0.05)
    del script.answers[m.GetStats]
    until(lambda: asked)
    daemon.say(stats(asked[0]))  # late: nobody waits for it
    assert display.stats().display == "left"


def test_an_answer_of_a_later_version_fails_only_its_request(
    display: Any, script: Script, daemon: Daemon
) -> None:
    def later(said: m.GetStats) -> None:
        event = {"type": "event", "display": "left", "kind": "on fire", "detail": ""}
        daemon.last.send(msgspec.msgpack.encode({"type": "prophecy"}))
        daemon.last.send(msgspec.msgpack.encode(event))
        failure = {"type": "failure", "id": said.id, "code": "too_early", "message": "wait"}
        daemon.last.send(msgspec.msgpack.encode(failure))

    script.answers[m.GetStats] = later
    with pytest.raises(RequestError, match="wait") as caught:
        display.stats()
    assert caught.value.code == "too_early"
    display.gain(0.5)
    assert display.connection.counters["ignored_messages"] == 1, "an event may be of any kind"


# Connecting


@pytest.mark.parametrize(
    ("url", "made"),
    [
        (None, "ws://127.0.0.1:7411/v1"),
        ("ws://10.0.0.5", "ws://10.0.0.5:7411/v1"),
        ("ws://10.0.0.5:80/", "ws://10.0.0.5:80/v1"),
        ("ws://[::1]:9000/v1", "ws://[::1]:9000/v1"),
        ("wss://lab.example/tactile/v1", "wss://lab.example/tactile/v1"),
    ],
)
def test_what_an_address_leaves_open(
    url: str | None, made: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("TACTILE_URL", raising=False)
    assert base.endpoint(url) == made


@pytest.mark.parametrize("url", ["127.0.0.1:7411", "http://127.0.0.1", "ws://", "ws://a:b"])
def test_an_address_that_is_none(url: str) -> None:
    with pytest.raises(InputError, match="url "):
        client.connect(url)


def test_address_and_token_of_the_environment(
    twin: Twin, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TACTILE_URL", daemon.url)
    monkeypatch.setenv("TACTILE_TOKEN", "secret")
    with twin.connect(timeout=PATIENCE):
        pass
    assert daemon.heard[0].token == "secret"


def test_no_daemon_is_an_error_at_once(twin: Twin) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"ws://127.0.0.1:{taken.getsockname()[1]}"
    with pytest.raises(DisconnectedError, match=f"{url}/v1: nobody listens there"):
        twin.connect(url, timeout=PATIENCE)


def test_something_that_accepts_and_says_nothing_is_an_error_in_time(twin: Twin) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        url = f"ws://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(ClientError):
            twin.connect(url, timeout=0.1)


def test_a_daemon_that_does_not_answer_hello_is_an_error_in_time(
    twin: Twin, script: Script, daemon: Daemon
) -> None:
    script.answers[m.Hello] = lambda said: None
    with pytest.raises(DisconnectedError, match="no answer to hello"):
        twin.connect(daemon.url, timeout=1.0)


def test_a_daemon_that_does_not_let_us_in(twin: Twin, script: Script, daemon: Daemon) -> None:
    script.answers[m.Hello] = lambda said: m.Failure(
        id=said.id, code="unauthorized", message="token: none was given", field="token"
    )
    with pytest.raises(RequestError) as caught:
        twin.connect(daemon.url, timeout=PATIENCE)
    assert caught.value.code == "unauthorized"


def test_a_server_that_is_no_daemon(twin: Twin) -> None:
    def handle(connection: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            connection.recv()

    with serve(handle, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        url = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        with pytest.raises(DisconnectedError, match=r"no tactile daemon|subprotocol"):
            twin.connect(url, timeout=PATIENCE)
    thread.join()


def test_of_several_displays_one_is_named(twin: Twin, script: Script, daemon: Daemon) -> None:
    script.displays = ("left", "right")
    with pytest.raises(InputError, match=r"name one with display=; there are: left, right"):
        twin.connect(daemon.url, timeout=PATIENCE)
    with pytest.raises(NotFoundError, match=r"no display 'lift'.*did you mean 'left'"):
        twin.connect(daemon.url, display="lift", timeout=PATIENCE)
    with twin.connect(daemon.url, display="right", timeout=PATIENCE) as display:
        assert (display.name, display.info.name) == ("right", "right")


def test_two_hands_on_one_connection(twin: Twin, script: Script, daemon: Daemon) -> None:
    script.displays = ("left", "right")
    with twin.open_connection(daemon.url, timeout=PATIENCE) as connection:
        assert list(connection.displays) == ["left", "right"]
        left, right = connection.display("left"), connection.display("right")
        left.touch((0.001, 0.0))
        right.touch((0.002, 0.0))
        until(lambda: len(daemon.of(m.Contact)) == 2)
        with left:
            pass  # stops the one and leaves the connection open
        assert connection.connected
        assert [said.display for said in daemon.of(m.Stop)] == ["left"]
    assert [said.display for said in daemon.of(m.Stop)][1:] == ["left", "right"]
    assert len(daemon.connections) == 1


@pytest.mark.parametrize("error", [None, RuntimeError, KeyboardInterrupt])
def test_the_way_out_stops_and_closes(
    twin: Twin, daemon: Daemon, error: type[BaseException] | None
) -> None:
    expected = pytest.raises(error) if error else contextlib.nullcontext()
    with expected, twin.connect(daemon.url, timeout=PATIENCE) as display:
        if error is not None:
            raise error
    assert not display.connected
    assert [type(said) for said in daemon.heard[1:]] == [m.Stop]
    assert until(lambda: daemon.last.close_code) == 1000
    with pytest.raises(DisconnectedError, match="closed"):
        display.gain(0.5)
    display.touch((0.0, 0.0))
    assert display.dropped_contacts == 1
    display.close()  # once more does nothing


@pytest.mark.ci
def test_the_way_out_is_bounded_where_the_daemon_does_not_read(twin: Twin, daemon: Daemon) -> None:
    with twin.connect(daemon.url, timeout=1.0) as display:
        fill(daemon, display)
    assert not display.connected
    assert display.connection._transport._closed.done()


def test_who_gives_up_waiting_for_the_end_does_not_take_it_away() -> None:
    """A cancelled future would be the end of the thread that says that it has ended."""
    over_the_wire = websocket.ThreadTransport("ws://127.0.0.1:1/v1", timeout=1.0)
    assert not over_the_wire._closed.cancel()
    assert not local.LocalTransport(Config())._closed.cancel()


def test_who_is_cancelled_while_it_hangs_up_leaves_no_connection(daemon: Daemon) -> None:
    """The daemon refuses, the client hangs up of itself, and the program closes meanwhile."""

    async def hang_up() -> bool:
        transport = websocket.TaskTransport(daemon.url, timeout=PATIENCE)
        connection = await transport._connect()
        hanging_up = asyncio.create_task(transport._hang_up(connection))
        await asyncio.sleep(0)  # it has begun, and nothing can have been answered
        assert not hanging_up.done()
        hanging_up.cancel()
        await asyncio.gather(hanging_up, return_exceptions=True)
        return bool(connection.connection_lost_waiter.done())

    assert asyncio.run(hang_up())


LEAKS = """
import asyncio, contextlib, os, sys, threading, time
from tactile.client import aio, connect
from tactile.errors import ClientError

twin, url = sys.argv[1:]

def use():
    with connect(url, timeout=20.0) as display:
        display.on_event(lambda event: None)
        display.gain(0.5)

async def ause():
    async with aio.connect(url, timeout=20.0) as display:
        display.on_event(lambda event: None)
        await display.gain(0.5)

def held():
    return threading.active_count(), len(os.listdir("/proc/self/fd"))

def files():
    found = []
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            found.append(os.readlink(f"/proc/self/fd/{name}"))
    return found

async def main():
    before = held()
    for _ in range(4):
        with contextlib.suppress(ClientError):
            await ause() if twin == "asyncio" else use()
        deadline = time.monotonic() + 20
        while held() != before:
            assert time.monotonic() < deadline, (before, held(), threading.enumerate(), files())
            time.sleep(0.01)

asyncio.run(main())
"""


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="counts what /proc lists")
@pytest.mark.parametrize("ending", ["polite", "dropped", "refused"])
@pytest.mark.parametrize("name", ["thread", "asyncio"])
def test_no_thread_and_no_file_is_left(
    script: Script, daemon: Daemon, name: str, ending: str
) -> None:
    """In a process of its own, where the daemon's are not among them."""
    if ending == "refused":
        script.answers[m.Hello] = lambda said: m.Failure(id=said.id, code="busy", message="no")
    if ending == "dropped":
        script.answers[m.Gain] = lambda said: daemon.drop()
    subprocess.run([sys.executable, "-c", LEAKS, name, daemon.url], check=True, timeout=120)
    assert len(daemon.of(m.Hello)) >= 4


# Contacts


def fill(daemon: Daemon, display: Any) -> int:
    """Let the daemon not read, and touch until nothing is sent any more; return how often."""
    daemon.reading.clear()
    for said in itertools.count(50, 50):
        before = display.dropped_contacts
        for number in range(said - 49, said + 1):
            display.touch((number * 1e-6, 0.0))
            time.sleep(0.0002)
        if display.dropped_contacts - before == 50:
            return said
        assert said < 200_000, "the buffers never filled"
    raise AssertionError


def test_touch_does_not_wait_for_a_daemon_that_does_not_read(
    display: Any, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More is said than all buffers between the two could hold; the newest arrives in the end."""
    monkeypatch.setattr(websocket, "SILENCE", PATIENCE)
    said = fill(daemon, display)
    assert display.connected
    daemon.reading.set()
    newest = pytest.approx(said * 1e-3)
    until(lambda: (heard := daemon.of(m.Contact)) and heard[-1].position_mm[0] == newest)
    assert len(daemon.of(m.Contact)) + display.dropped_contacts == said
    assert display.stats().display == "left"  # and the connection has lived through it


def test_touch_from_several_threads(daemon: Daemon) -> None:
    count, each = 4, 500
    with client.connect(daemon.url, timeout=PATIENCE) as display:

        def touch(thread: int) -> None:
            for number in range(each):
                display.touch((thread * 1e-3, number * 1e-6), normal_force=0.1)

        running = [threading.Thread(target=touch, args=(n,)) for n in range(count)]
        for thread in running:
            thread.start()
        for thread in running:
            thread.join()
        until(lambda: len(daemon.of(m.Contact)) + display.dropped_contacts == count * each)
    for number in range(count):
        heard = [c.position_mm for c in daemon.of(m.Contact) if round(c.position_mm[0]) == number]
        assert heard == sorted(heard), "each thread's contacts stay in order"


def test_contacts_keep_to_the_rate_that_the_daemon_takes(
    twin: Twin, script: Script, daemon: Daemon
) -> None:
    script.messages_per_second = 50
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        begun = time.monotonic()
        for number in range(100):
            display.touch((number * 1e-6, 0.0))
            time.sleep(0.002)
        last = until(lambda: [c for c in daemon.of(m.Contact) if c.position_mm[0] > 0.0989])
        assert len(daemon.of(m.Contact)) <= 2 + 50 * (time.monotonic() - begun)
    assert len(last) == 1


def test_a_refused_contact_is_an_event_and_not_at_its_rate(
    display: Any, script: Script, daemon: Daemon
) -> None:
    script.answers[m.Contact] = lambda said: m.Failure(code="not_armed", message="arm it first")
    events: list[client.Event] = []
    display.on_event(events.append)
    for number in range(1, 4):
        display.touch((0.0, 0.0))
        until(lambda: display.connection.counters["refused_contacts"] == number)  # noqa: B023
    until(lambda: events)
    assert events[0] == client.Event("refused", "", "not_armed: arm it first")
    assert len(events) < 3


# Waveforms


@pytest.mark.parametrize(
    "made",
    [
        list, tuple, iter, lambda v: (x for x in v), lambda v: array("d", v),
        lambda v: memoryview(array("f", v)), np.array, lambda v: np.array(v, np.float32),
    ],
)  # fmt: skip
def test_samples_may_be_of_any_kind(daemon: Daemon, made: Callable[[list[float]], Any]) -> None:
    values = [0.0, 0.5, -0.25, 1.0, -1.0]
    with client.connect(daemon.url, timeout=PATIENCE) as display:
        display.append(made(values), sample_rate=8000, amplitude=1e-6)
    (said,) = daemon.of(m.Append)
    assert list(samples_of(said)) == values


def test_append_sends_one_message_and_cuts_what_is_beyond(display: Any, daemon: Daemon) -> None:
    appended = display.append([0.25] * 9000, sample_rate=8000, amplitude=1e-6)
    assert appended.samples_consumed == m.MOST_SAMPLES
    assert [count(said) for said in daemon.of(m.Append)] == [m.MOST_SAMPLES]
    assert display.append([], sample_rate=8000, amplitude=1e-6).samples_consumed == 0
    assert len(daemon.of(m.Append)) == 1


@pytest.mark.parametrize("most", [1000, 3999, 4000])
def test_play_hands_over_all_although_the_daemon_takes_only_part(
    display: Any, script: Script, most: int
) -> None:
    """Every third time it takes nothing at all."""
    taken: list[float] = []
    replaced: list[bool] = []
    turns = itertools.count()

    def some(said: m.Append) -> m.Appended:
        room = 0 if next(turns) % 3 == 0 else most
        replaced.append(not said.append)
        taken.extend(samples_of(said)[:room])
        return m.Appended(id=said.id, samples_consumed=min(room, count(said)), buffered_ms=1.0)

    script.answers[m.Append] = some
    samples = np.sin(np.arange(10_001)).astype(np.float32)
    assert display.play(samples, sample_rate=8000, amplitude=1e-6) == 10_001
    assert taken == samples.tolist()
    assert replaced[:3] == [True, True, False], "until something was taken"
    assert not any(replaced[2:])


@pytest.mark.parametrize(
    ("taken", "buffered_ms", "pause"),
    [(10, 500.0, 0.0), (0, 100.0, 0.05), (9, 100.0, 0.05), (0, 0.0, 0.005), (0, 5000.0, 0.1)],
)
def test_play_waits_for_half_of_what_is_buffered_before_it_sends_again(
    taken: int, buffered_ms: float, pause: float
) -> None:
    display = base.BaseDisplay("left", owns=False)
    waveform = Waveform("left", [0.0] * 10, sample_rate=8000, amplitude=1e-6)
    playback = base.Playback(display, waveform, timeout=PATIENCE)
    message = playback.message()
    assert message is not None
    reply = m.Appended(samples_consumed=taken, buffered_ms=buffered_ms)
    assert playback.taken(message, reply) == pytest.approx(pause)


def test_play_gives_up_where_nothing_is_taken(display: Any, script: Script) -> None:
    script.answers[m.Append] = lambda said: m.Appended(
        id=said.id, samples_consumed=0, buffered_ms=1.0
    )
    with pytest.raises(ClientTimeoutError, match=r"no sample was taken in 0.5 s"):
        display.play([0.0] * 10, sample_rate=8000, amplitude=1e-6, timeout=0.5)


def test_stop_ends_a_waveform_without_end(twin: Twin, daemon: Daemon) -> None:
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        played: list[int] = []

        def play() -> None:
            samples = itertools.cycle([0.5, -0.5])
            played.append(display.play(samples, sample_rate=8000, amplitude=1e-6))

        thread = threading.Thread(target=play)
        thread.start()
        until(lambda: len(daemon.of(m.Append)) > 2)
        display.stop()
        thread.join(PATIENCE)
        assert played[0] == sum(count(said) for said in daemon.of(m.Append))


# A connection that is lost


def connected_again(daemon: Daemon, hellos: int = 2) -> list[Any]:
    """Wait for another hello, and return what was said from then on."""
    until(lambda: len(daemon.of(m.Hello)) >= hellos)
    last = max(i for i, said in enumerate(daemon.heard) if isinstance(said, m.Hello))
    return daemon.heard[last:]


@pytest.mark.parametrize("rearm", [False, True])
def test_what_was_asked_is_restored_and_armed_only_where_that_was_asked(
    twin: Twin, daemon: Daemon, rearm: bool
) -> None:
    events: list[client.Event] = []
    with twin.connect(daemon.url, timeout=PATIENCE, rearm=rearm) as display:
        display.on_event(events.append)
        display.select([("wood-oak", 0.5)])
        display.gain(0.25)
        display.stop()
        display.arm()
        stream = iter(display.telemetry(rate=50))
        reader = threading.Thread(target=lambda: contextlib.suppress(ClientError) and next(stream))
        reader.start()
        until(lambda: daemon.of(m.Subscribe))
        daemon.drop()
        connected_again(daemon)
        until(lambda: [event.kind for event in events] == ["disconnected", "connected"])
        daemon.say(telemetry(1))
        reader.join()
        display.stats()
        said = [plain(each) for each in connected_again(daemon)[1:] if not isinstance(each, m.Ping)]
        assert display.connection.counters["reconnections"] == 1
    restored = [
        m.Subscribe(display="left", rate_hz=50.0),
        m.Gain(display="left", gain=0.25),
        m.Select(display="left", layers=(m.Layer(texture="wood-oak", gain=0.5),)),
        m.Stop(display="left"),
        *([m.Arm(display="left")] if rearm else []),
    ]
    assert said[: len(restored) + 1] == [
        *map(plain, restored), plain(m.GetStats(display="left")),
    ]  # fmt: skip


def test_what_was_taken_back_is_not_restored(twin: Twin, daemon: Daemon) -> None:
    """Resumed, and disarmed by somebody else."""
    events: list[client.Event] = []
    with twin.connect(daemon.url, timeout=PATIENCE, rearm=True) as display:
        display.on_event(events.append)
        display.arm()
        display.stop()
        display.resume()
        daemon.say(m.Event(display="left", kind="disarmed", detail="by hand"))
        until(lambda: events)
        daemon.drop()
        until(lambda: events[-1].kind == "connected")
        display.stats()
        kinds = [type(said) for said in connected_again(daemon)]
    assert kinds[:2] == [m.Hello, m.GetStats]


def test_what_cannot_be_restored_is_an_event(twin: Twin, script: Script, daemon: Daemon) -> None:
    events: list[client.Event] = []
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        display.on_event(events.append)
        display.select("wood-oak")
        script.answers[m.Select] = lambda said: m.Failure(
            id=said.id, code="unknown_texture", message="no 'wood-oak'"
        )
        daemon.drop()
        until(lambda: "refused" in [event.kind for event in events])
    assert "unknown_texture: no 'wood-oak'" in [event.detail for event in events]


def test_without_a_daemon_touch_is_counted_and_requests_fail_at_once(
    twin: Twin, daemon: Daemon
) -> None:
    with twin.connect(daemon.url, timeout=PATIENCE, reconnect=False) as display:
        daemon.drop()
        until(lambda: not display.connected)
        display.touch((0.0, 0.0))
        display.lift()
        assert display.dropped_contacts == 2
        for call in (display.stats, display.estop, display.arm):
            with pytest.raises(DisconnectedError):
                call()
        until(lambda: display.connection._transport._closed.done())
    assert len(daemon.of(m.Hello)) == 1, "and it was not connected again"


def test_a_request_that_waits_fails_when_the_connection_does(
    display: Any, script: Script, daemon: Daemon
) -> None:
    def gone(said: m.GetStats) -> None:
        daemon.drop()

    script.answers[m.GetStats] = gone
    with pytest.raises(DisconnectedError):
        display.stats()


def test_a_daemon_that_answers_no_ping_is_given_up(
    twin: Twin, script: Script, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL", 0.01)
    monkeypatch.setattr(websocket, "SILENCE", 0.2)
    script.answers[m.Ping] = lambda said: None
    with twin.connect(daemon.url, timeout=PATIENCE):
        connected_again(daemon, 3)


@pytest.mark.ci
def test_a_daemon_that_does_not_read_is_given_up_and_found_again(
    twin: Twin, daemon: Daemon
) -> None:
    events: list[str] = []
    with twin.connect(daemon.url, timeout=1.0) as display:
        display.on_event(lambda event: events.append(event.kind))
        fill(daemon, display)
        until(lambda: events == ["disconnected"])
        daemon.reading.set()
        until(lambda: events[-1] == "connected")
        display.stats(timeout=PATIENCE)


def test_pings_measure_the_clocks(
    twin: Twin, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL", 0.01)
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        until(lambda: len(daemon.of(m.Ping)) > 3)
        connection = display.connection
        assert abs(connection.clock_offset - 5.0) <= connection.round_trip / 2 + 1e-5


def test_the_quickest_exchange_tells_the_clocks_best() -> None:
    clock = Clock()
    clock.exchange(1.0, 11.9, 2.0)
    clock.exchange(3.0, 13.05, 3.1)
    clock.exchange(4.0, 14.9, 5.0)
    assert clock.offset == pytest.approx(10.0)
    assert clock.round_trip == pytest.approx(0.1)


# Telemetry and events


def then_one(daemon: "Daemon") -> Callable[[m.Subscribe], m.Answer]:
    """Return what answers a subscription, and gives the first telemetry at once."""

    def answer(said: m.Subscribe) -> m.Answer:
        daemon.say(m.Done(id=said.id))
        return telemetry(0)

    return answer


def test_telemetry_comes_in_si_and_on_our_clock(display: Any, daemon: Daemon) -> None:
    daemon.script.answers[m.Subscribe] = lambda said: m.Done(id=said.id)
    stream = display.telemetry(rate=20)
    numbers = iter(stream)

    def say_when_asked() -> None:
        until(lambda: daemon.of(m.Subscribe))
        daemon.say(telemetry(server_time_us()))

    until_asked = threading.Thread(target=say_when_asked)
    until_asked.start()
    told = next(numbers)
    until_asked.join()
    now = time.monotonic()
    assert abs(told.time - now) < PATIENCE
    assert list(told.position) == pytest.approx([1e-3, 2e-3])
    assert list(told.velocity) == pytest.approx([0.08, 0.0])
    assert list(told.shear) == pytest.approx([3e-6, -3e-6])
    assert (told.drive, told.normal_force) == ((50.0, -50.0), 0.5)
    stream.close()
    asked = until(lambda: len(daemon.of(m.Subscribe)) == 2 and daemon.of(m.Subscribe))
    assert [said.rate_hz for said in asked] == [20.0, 0.0]


def test_telemetry_that_nobody_reads_is_dropped_and_then_ended(daemon: Daemon) -> None:
    with client.connect(daemon.url, timeout=PATIENCE) as display:
        stream = display.telemetry(rate=20)
        daemon.script.answers[m.Subscribe] = then_one(daemon)
        next(stream)
        for number in range(1, 101):
            daemon.say(telemetry(number * 1_000_000))
        display.stats()  # all of it has come
        assert display.connection.counters["dropped_telemetry"] == 36
        offset = display.connection.clock_offset
        assert next(stream).time == pytest.approx(37 - offset, abs=1.0), "the newest 64"
        del stream
        daemon.script.answers.clear()
        daemon.say(telemetry(0))
        daemon.say(telemetry(0))
        until(lambda: [said.rate_hz for said in daemon.of(m.Subscribe)] == [20.0, 0.0])


def test_two_readers_get_the_higher_rate_until_one_leaves(daemon: Daemon) -> None:
    daemon.script.answers[m.Subscribe] = then_one(daemon)
    with client.connect(daemon.url, timeout=PATIENCE) as display:
        slow, fast = display.telemetry(rate=10), display.telemetry(rate=60)
        for stream in (slow, fast):
            assert next(stream).display == "left"
        fast.close()
        until(lambda: [said.rate_hz for said in daemon.of(m.Subscribe)] == [10.0, 60.0, 10.0])
        assert next(slow).display == "left"


def test_telemetry_that_does_not_come_is_a_timeout_and_may_be_waited_for_again(
    twin: Twin, daemon: Daemon
) -> None:
    with twin.connect(daemon.url, timeout=PATIENCE) as display:
        stream = display.telemetry(rate=100, timeout=PATIENCE)
        inner = getattr(stream, "_inner", stream)
        inner._timeout = PATIENCE
        daemon.script.answers[m.Subscribe] = lambda said: m.Done(id=said.id)

        def read() -> Any:
            return twin.run(inner.__anext__()) if twin.name == "asyncio" else next(inner)

        def soon() -> None:
            until(lambda: daemon.of(m.Subscribe))
            inner._timeout = 0.05
            daemon.say(telemetry(0))

        threading.Thread(target=soon).start()
        assert read().display == "left"
        with pytest.raises(ClientTimeoutError, match="telemetry: no answer in"):
            read()
        daemon.say(telemetry(1))
        inner._timeout = PATIENCE
        assert read().display == "left"


def test_telemetry_ends_with_the_connection(twin: Twin, daemon: Daemon) -> None:
    display = twin.connect(daemon.url, timeout=PATIENCE)
    daemon.script.answers[m.Subscribe] = then_one(daemon)
    got = []
    for told in display.telemetry(rate=50):
        got.append(told)
        display.close()
    assert len(got) == 1


def test_a_callback_may_ask_and_may_fail(
    display: Any, daemon: Daemon, twin: Twin, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[str] = []

    def fail(event: client.Event) -> None:
        raise RuntimeError("a mistake of the program")

    def answer(event: client.Event) -> None:
        seen.append(display.stats().state)

    async def aanswer(event: client.Event) -> None:
        seen.append((await display._inner.stats()).state)

    display.on_event(fail)
    display.on_event(aanswer if twin.name == "asyncio" else answer)
    for _ in range(2):
        daemon.say(m.Event(display="left", kind="fault", detail="channel 3 open"))
    until(lambda: seen == ["armed", "armed"])
    assert "a mistake of the program" in caplog.text


def test_events_go_to_the_display_that_they_are_of(
    twin: Twin, script: Script, daemon: Daemon
) -> None:
    script.displays = ("left", "right")
    left: list[client.Event] = []
    both: list[client.Event] = []
    with twin.open_connection(daemon.url, timeout=PATIENCE) as connection:
        connection.display("left").on_event(left.append)
        connection.on_event(both.append)
        for name in script.displays:
            daemon.say(m.Event(display=name, kind="underrun", detail="4 blocks"))
        until(lambda: len(both) == 2)
    assert left == [client.Event("underrun", "left", "4 blocks")]


def test_events_that_a_slow_callback_does_not_take_are_dropped(daemon: Daemon) -> None:
    go_on = threading.Event()
    with client.connect(daemon.url, timeout=PATIENCE) as display:
        display.on_event(lambda event: go_on.wait(PATIENCE))
        for _ in range(400):
            daemon.say(m.Event(display="left", kind="underrun"))
        display.stats()  # all of them have come
        assert 400 - 257 <= display.connection.counters["dropped_events"] < 400
        go_on.set()


# Inside one process


class LocalTransport:
    """A display of this process: objects in, objects out, nothing encoded."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.heard: list[Any] = []

    def open(self, receiver: Receiver) -> None:
        self._receiver = receiver
        receiver.opened()

    def send(self, command: m.Command) -> None:
        self.heard.append(command)
        if (answer := self.script.answer(command)) is not None:
            self._receiver.received(answer)

    def close(self) -> "Future[None]":
        future: Future[None] = Future()
        future.set_result(None)
        return future


@pytest.mark.parametrize(("call", "message"), MESSAGES)
def test_a_display_in_the_same_process_is_the_same(
    twin: Twin, script: Script, call: Callable[[Any], Any], message: Any
) -> None:
    transport = LocalTransport(script)
    with twin.over(transport) as connection:
        call(connection.display())
    assert plain(message) in map(plain, transport.heard)


class Nowhere:
    """A transport that keeps what it is to carry."""

    def __init__(self) -> None:
        self.kept: list[Any] = []

    def open(self, receiver: Receiver) -> None:
        receiver.opened()

    def send(self, command: m.Command) -> None:
        self.kept.append(command)

    def close(self) -> "Future[None]":
        return Future()


def test_an_arm_that_nobody_waits_for_is_not_sent_late_but_what_quiets_is() -> None:
    transport, script = Nowhere(), Script()
    session = Session(transport, m.Hello(client="test"), monotonic=time.monotonic)
    session.opened()
    welcome = script.answer(transport.kept.pop())
    assert welcome is not None
    session.received(welcome)
    for request in (m.Arm(display="left"), m.EStop(display="left"), m.Stop(display="left")):
        session.ask(request).cancel()
    assert [session.wanted(command) for command in transport.kept] == [False, True, True]
    waiting = session.ask(m.Arm(display="left"))
    assert session.wanted(transport.kept[-1])
    session.close()
    assert isinstance(waiting.exception(), DisconnectedError)


def test_requests_that_wait_have_a_limit() -> None:
    transport, script = Nowhere(), Script()
    session = Session(transport, m.Hello(client="test"), monotonic=time.monotonic)
    session.opened()
    session.received(script.answer(transport.kept.pop()))  # type: ignore[arg-type]
    for _ in range(256):
        session.ask(m.Play(display="left"))
    with pytest.raises(ClientError, match="256 requests wait"):
        session.ask(m.Play(display="left"))


def test_an_outbox_sends_estop_first_and_of_contacts_the_newest() -> None:
    dropped: list[str] = []
    outbox = Outbox(dropped.append)
    contacts = [
        m.Contact(display=name, position_mm=(x, 0.0), normal_force_n=0.5)
        for name, x in (("left", 1.0), ("right", 2.0), ("left", 3.0))
    ]
    gain, play, estop = m.Gain(display="left", gain=1.0), m.Play(display="left"), m.EStop()
    commands: list[m.Command] = [gain, play, *contacts, estop]
    assert [outbox.put(c) for c in commands] == [True, *[False] * 5]
    assert outbox.take() == [estop, contacts[2], contacts[1], gain]
    assert outbox.take() == [play]
    assert outbox.take() == []
    assert dropped == ["left"]
    assert outbox.put(contacts[0]), "the sender sleeps again"
    assert outbox.take(contacts=False) == []
    outbox.clear()
    assert outbox.take() == []
    assert dropped == ["left", "left"]


# The real server


class RealServer:
    """The daemon's own server, with a host in memory, in a thread."""

    def __init__(self, **options: Any) -> None:
        self.hands = Hands()
        self.config = Config(server=ServerConfig(port=0, **options), osc=OscConfig(port=0))
        self._loop = asyncio.new_event_loop()
        self._ready: Future[str] = Future()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),))
        self._thread.start()
        self.url = self._ready.result(PATIENCE)

    async def _run(self) -> None:
        self._end = asyncio.Event()
        async with running(self.config, host=self.hands) as server:
            self._ready.set_result(server.url)
            await self._end.wait()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()
        self._loop.close()


@pytest.fixture
def real() -> Iterator[RealServer]:
    server = RealServer()
    yield server
    if not server._end.is_set():
        server.close()


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_the_real_server_hears_each_call(
    twin: Twin, real: RealServer, encoding: base.Encoding
) -> None:
    def log() -> list[Any]:
        return [plain(said) for _, said in list(real.hands.log) if said is not None]

    options: Any = {"display": "left", "encoding": encoding, "timeout": PATIENCE}
    for call, message in MESSAGES:
        if isinstance(message, m.Append) and encoding == "json":
            message = msgspec.structs.replace(message, samples=samples_of(message))
        with twin.connect(real.url, **options) as display:
            call(display)
            until(lambda: plain(message) in log())  # noqa: B023
    with twin.connect(real.url, **options) as display:
        assert display.stats().latency == pytest.approx(0.009)
        assert next(iter(display.telemetry(rate=10))).state == "disarmed"
    until(lambda: real.hands.clients[-1].closed)
    assert log()[-1] == plain(m.Stop(display="left"))


def test_the_real_server_refuses_and_its_end_is_told(twin: Twin, real: RealServer) -> None:
    events: list[client.Event] = []
    with twin.connect(real.url, display="left", timeout=PATIENCE) as display:
        display.on_event(events.append)
        real.hands.codes[m.Select] = "unknown_texture"
        with pytest.raises(NotFoundError):
            display.select("oak")
        real.close()
        until(lambda: "disconnected" in [event.kind for event in events])
        with pytest.raises(DisconnectedError):
            display.estop()


def test_the_real_server_wants_its_token(twin: Twin, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text("a-token-nobody-guesses")
    path.chmod(0o600)
    server = RealServer(token_file=str(path))
    try:
        with pytest.raises(RequestError) as caught:
            twin.connect(server.url, display="left", token="another-token-it-is", timeout=PATIENCE)
        assert caught.value.code == "unauthorized"
        options: Any = {"display": "left", "timeout": PATIENCE}
        with twin.connect(server.url, token="a-token-nobody-guesses", **options) as display:
            assert display.connected
    finally:
        server.close()


def test_telemetry_of_the_wire_in_si() -> None:
    assert from_telemetry(telemetry(7_000_000), 5.0).time == pytest.approx(2.0)


def test_import_is_light() -> None:
    code = "import sys, tactile.client; print(*{n.partition('.')[0] for n in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    heavy = {
        "numpy",
        "scipy",
        "serial",
        "can",
        "sounddevice",
        "smbus2",
        "matplotlib",
        "rich",
        "typer",
    }
    assert set(run.stdout.split()) & heavy == set()
    assert "tactile" in run.stdout


def test_a_session_of_the_sdk_never_needs_numpy(daemon: Daemon) -> None:
    code = (
        "import sys\nfrom tactile import client\n"
        f"with client.connect({daemon.url!r}, timeout={PATIENCE}) as display:\n"
        "    display.play([0.0] * 5000, sample_rate=8000, amplitude=1e-6)\n"
        "    display.touch((0.0, 0.0))\n"
        "assert 'numpy' not in sys.modules and 'scipy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert sum(count(said) for said in daemon.of(m.Append)) == 5000
