"""The SDK finds a server, is let in or told why not, and leaves nothing behind, in both twins."""

import asyncio
import contextlib
import socket
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from client_rig import PATIENCE, Script, ScriptedServer, Twin, fill, until
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from tactile import client, local, paths
from tactile import messages as m
from tactile.client import address, websocket
from tactile.errors import ClientError, DisconnectedError, InputError, NotFoundError, RequestError
from tactile.server.config import Configuration


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
    monkeypatch.setattr(paths, "find_sockets", list)
    assert address.endpoint(url) == made


@pytest.mark.skipif(sys.platform != "linux", reason="Unix sockets of Linux")
def test_the_servers_unix_socket_comes_first(
    twin: Twin, script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tactile.sock"
    monkeypatch.delenv("TACTILE_URL", raising=False)
    monkeypatch.setattr(paths, "find_sockets", lambda: [path])
    assert address.default_url() == f"ws+unix://{path}"
    with pytest.raises(DisconnectedError, match=f"{path}: nobody listens there"):
        twin.connect(timeout=PATIENCE)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    server = ScriptedServer(script, listener)
    try:
        with twin.connect(timeout=PATIENCE) as display:
            assert display.stats().display == "left"
    finally:
        server.close()


@pytest.mark.parametrize(
    ("url", "local"),
    [
        ("ws+unix:///run/tactile.socket", True),
        ("ws://localhost:7411/v1", True),
        ("ws://[::1]:7411/v1", True),
        ("ws://192.168.0.7:7411/v1", False),
        ("wss://localhost.example.org/v1", False),
    ],
)
def test_an_address_says_whether_it_is_of_this_machine(url: str, local: bool) -> None:
    assert address.is_local(address.endpoint(url)) == local


@pytest.mark.parametrize("url", ["127.0.0.1:7411", "http://127.0.0.1", "ws://", "ws://a:b"])
def test_an_address_that_is_none(url: str) -> None:
    with pytest.raises(InputError, match="url "):
        client.connect(url)


def test_address_and_token_of_the_environment(
    twin: Twin, server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TACTILE_URL", server.url)
    monkeypatch.setenv("TACTILE_TOKEN", "secret")
    with twin.connect(timeout=PATIENCE):
        pass
    assert server.heard[0].token == "secret"


def test_no_server_is_an_error_at_once(twin: Twin) -> None:
    with socket.socket() as taken:  # so that nobody else begins to listen there
        taken.bind(("127.0.0.1", 0))
        url = f"ws://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(DisconnectedError, match=f"{url}/v1: nobody listens there"):
            twin.connect(url, timeout=PATIENCE)


def test_something_that_accepts_and_says_nothing_is_an_error_in_time(twin: Twin) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        url = f"ws://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(ClientError):
            twin.connect(url, timeout=0.1)


def test_a_server_that_does_not_answer_hello_is_an_error_in_time(
    twin: Twin, script: Script, server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wait for the answer gets the whole timeout, which is shortened here for it alone."""
    answer = websocket.WebSocketTransport._answer
    waits: list[tuple[float, str]] = []

    async def shorter(self: Any, future: "Future[Any]", timeout: float, what: str) -> Any:
        waits.append((timeout, what))
        return await answer(self, future, 0.01, what)

    monkeypatch.setattr(websocket.WebSocketTransport, "_answer", shorter)
    script.answers[m.ClientHello] = lambda said: None
    with pytest.raises(DisconnectedError, match="no answer to hello"):
        twin.connect(server.url, timeout=PATIENCE)
    assert set(waits) == {(PATIENCE, "hello")}


def test_a_server_that_does_not_let_us_in(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    script.answers[m.ClientHello] = lambda said: m.Failure(
        id=said.id, code="unauthorized", message="token: none was given", field="token"
    )
    with pytest.raises(RequestError) as caught:
        twin.connect(server.url, timeout=PATIENCE)
    assert caught.value.code == "unauthorized"


def test_a_server_of_something_else(twin: Twin) -> None:
    def handle(connection: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            connection.recv()

    with serve(handle, "127.0.0.1", 0, open_timeout=PATIENCE, ping_interval=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        url = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        with pytest.raises(DisconnectedError, match=r"no tactile server|subprotocol"):
            twin.connect(url, timeout=PATIENCE)
    thread.join()


def test_of_several_displays_one_is_named(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    script.displays = ("left", "right")
    with pytest.raises(InputError, match=r"name one with display=; there are: left, right"):
        twin.connect(server.url, timeout=PATIENCE)
    with pytest.raises(NotFoundError, match=r"no display 'lift'.*did you mean 'left'"):
        twin.connect(server.url, display="lift", timeout=PATIENCE)
    with twin.connect(server.url, display="right", timeout=PATIENCE) as display:
        assert (display.name, display.info.name) == ("right", "right")


def test_two_hands_on_one_connection(twin: Twin, script: Script, server: ScriptedServer) -> None:
    script.displays = ("left", "right")
    with twin.open_connection(server.url, timeout=PATIENCE) as connection:
        assert list(connection.displays) == ["left", "right"]
        left, right = connection.display("left"), connection.display("right")
        left.touch((0.001, 0.0))
        right.touch((0.002, 0.0))
        until(lambda: len(server.of(m.Contact)) == 2)
        with left:
            pass  # stops the one and leaves the connection open
        assert connection.connected
        assert [said.display for said in server.of(m.StopPlaying)] == ["left"]
    assert [said.display for said in server.of(m.StopPlaying)][1:] == ["left", "right"]
    assert len(server.connections) == 1


@pytest.mark.parametrize("error", [None, RuntimeError, KeyboardInterrupt])
def test_the_way_out_stops_and_closes(
    twin: Twin, server: ScriptedServer, error: type[BaseException] | None
) -> None:
    expected = pytest.raises(error) if error else contextlib.nullcontext()
    with expected, twin.connect(server.url, timeout=PATIENCE) as display:
        if error is not None:
            raise error
    assert not display.connected
    assert [type(said) for said in server.heard[1:]] == [m.StopPlaying]
    assert until(lambda: server.last.close_code) == 1000
    with pytest.raises(DisconnectedError, match="closed"):
        display.gain(0.5)
    display.touch((0.0, 0.0))
    assert display.dropped_contacts == 1
    display.close()  # once more does nothing


@pytest.mark.ci
def test_the_way_out_is_bounded_where_the_server_does_not_read(
    twin: Twin, server: ScriptedServer
) -> None:
    """Closing takes the timeout, which is short only once all is connected."""
    display = twin.connect(server.url, timeout=10 * PATIENCE)
    fill(server, display)
    connection = getattr(display.connection, "_inner", display.connection)
    connection.timeout = connection._transport._timeout = 1.0
    closing = threading.Thread(target=display.close)
    closing.start()
    closing.join(PATIENCE)
    assert not closing.is_alive()
    assert not display.connected
    until(connection._transport._closed.done)


def test_who_gives_up_waiting_for_the_end_does_not_take_it_away() -> None:
    """A cancelled future would be the end of the thread that says that it has ended."""
    over_the_wire = websocket.ThreadTransport("ws://127.0.0.1:1/v1", timeout=1.0)
    assert not over_the_wire.close().cancel()
    assert not local.LocalTransport(Configuration())._closed.cancel()


def test_who_is_cancelled_while_it_hangs_up_leaves_no_connection(server: ScriptedServer) -> None:
    """The server refuses, the client hangs up of itself, and the program closes meanwhile."""

    async def hang_up() -> bool:
        transport = websocket.TaskTransport(server.url, timeout=PATIENCE)
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
    with connect(url, timeout=60.0) as display:
        display.on_event(lambda event: None)
        display.gain(0.5)

async def ause():
    async with aio.connect(url, timeout=60.0) as display:
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
        deadline = time.monotonic() + 60
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
    script: Script, server: ScriptedServer, name: str, ending: str
) -> None:
    """The client has a process of its own, so that nothing of the server's is counted."""
    if ending == "refused":
        script.answers[m.ClientHello] = lambda said: m.Failure(
            id=said.id, code="busy", message="no"
        )
    if ending == "dropped":
        script.answers[m.SetGain] = lambda said: server.drop()
    code = [sys.executable, "-c", LEAKS, name, server.url]
    subprocess.run(code, check=True, timeout=10 * PATIENCE)
    assert len(server.of(m.ClientHello)) >= 4
