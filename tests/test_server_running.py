"""The server over HTTP, and how it begins and ends: clients are told, displays are closed first."""

import asyncio
import contextlib
import gc
import json
import signal
import socket
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from server_rig import (
    CONTACT,
    PATIENCE,
    Hands,
    connect,
    free_port,
    get,
    handshake,
    run,
    serving,
    talking,
    until,
)
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from tactile.errors import InputError
from tactile.messages import JSON_PROTOCOL
from tactile.server import listening, sockets
from tactile.server.config import Configuration, OscConfig, ServerConfig
from tactile.server.listening import Listener, bound_sockets
from tactile.server.page import FOLDER, TYPES
from tactile.server.server import running

pytestmark = pytest.mark.usefixtures("patient")


# HTTP


async def test_health_is_what_the_host_says() -> None:
    async with serving() as (there, hands):
        good = await get(there, "/healthz")
        assert (good.status_code, good.json()["status"]) == (200, "ok")
        hands.alive = False
        bad = await get(there, "/healthz")
        assert (bad.status_code, bad.json()["status"]) == (503, "failing")


async def test_figures_are_read_by_prometheus_and_are_those_of_displays_and_clients() -> None:
    async with serving() as (there, _), talking(there) as talker:
        await talker.send(**CONTACT)
        await talker.ask(type="bogus")
        text = (await get(there, "/metrics")).text
        samples = {
            (sample.name, *sorted(sample.labels.values())): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }
        assert samples["tactile_underruns_total", "right"] == 3
        assert samples["tactile_latency_s", "left"] == 0.009
        assert samples["tactile_clients", "websocket"] == 1
        assert samples["tactile_messages_total", "contact", "websocket"] == 1
        assert samples["tactile_failures_total", "unknown_type", "websocket"] == 1
        assert samples["tactile_message_seconds_count", "contact", "websocket"] == 1
        assert samples["tactile_log_dropped_total",] == 0
        assert samples["tactile_healthy",] == 1


FILES = sorted(path.relative_to(FOLDER) for path in FOLDER.rglob("*") if path.is_file())


@pytest.mark.parametrize("file", FILES, ids=str)
async def test_the_page_is_served_with_a_policy_that_lets_it_load_nothing_else(file: Path) -> None:
    async with serving() as (there, _):
        answer = await get(there, f"/{file}")
        assert (answer.status_code, answer.content) == (200, (FOLDER / file).read_bytes())
        assert answer.headers["content-type"] == TYPES[file.suffix]
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; ")
        assert "frame-ancestors 'none'" in policy
        assert not any(word in policy for word in ("unsafe", "http", "*"))
        assert answer.headers["x-content-type-options"] == "nosniff"
        again = await get(there, f"/{file}", **{"if-none-match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")


async def test_the_page_is_at_the_root() -> None:
    async with serving() as (there, _):
        assert there.page == f"http://127.0.0.1:{there.port}/"
        root = await get(there, "/")
        assert root.content == (FOLDER / "index.html").read_bytes()


@pytest.mark.parametrize(
    "path",
    ["/nope", "/v1/", "/page/../../server.py", "/page/", "/v1/schema/x", "/../../etc/passwd"],
)
async def test_what_is_not_there_is_404(path: str) -> None:
    async with serving() as (there, _):
        assert (await get(there, path)).status_code == 404


async def test_an_error_shows_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(self: Hands) -> bool:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(Hands, "healthy", break_down)
    async with serving() as (there, _):
        found = await get(there, "/healthz")
        assert found.status_code == 500
        assert found.text == "Internal Server Error"


async def test_a_connection_that_asks_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_WITHIN", 0.05)
    async with serving() as (there, _):
        reader, writer = await asyncio.open_connection("127.0.0.1", there.port)
        writer.write(b"GET / HT")
        with contextlib.suppress(ConnectionError):
            assert await asyncio.wait_for(reader.read(), PATIENCE) == b""
        writer.close()


# Beginning and end


async def test_each_connection_has_no_delay_and_no_compression() -> None:
    with bound_sockets(ServerConfig(port=0, socket=""), guarded=False) as (bound,):
        assert bound.proto == socket.IPPROTO_TCP, "else asyncio does not set TCP_NODELAY"
    async with serving() as (there, _), talking(there) as talker:
        assert talker.link.protocol.extensions == []


async def test_a_port_that_is_taken_is_one_line_before_anything_is_opened() -> None:
    async with serving() as (there, _):
        hands = Hands()
        config = Configuration(
            server=ServerConfig(port=there.port, socket=""), osc=OscConfig(port=0)
        )
        with pytest.raises(InputError, match=rf"'127.0.0.1' port {there.port}: Address"):
            async with running(config, host=hands):
                pass
        assert hands.started == 0


async def test_at_the_end_clients_are_told_and_displays_are_closed_before_connections_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(listening, "CLOSE_WITHIN", PATIENCE)
    async with serving() as (there, hands):
        talker = await connect(there.url, subprotocols=[Subprotocol(JSON_PROTOCOL)])
        await talker.send('{"type":"hello","client":"a"}')
        await talker.recv()
        hands.armed = True
    with pytest.raises(ConnectionClosed):
        await talker.recv()
    assert (talker.close_code, talker.close_reason) == (1001, "the server ends")
    assert hands.closings >= 1
    assert not hands.armed
    assert hands.clients[0].closed == 1
    with pytest.raises(OSError, match="Connect call failed"):
        await connect(there.url)


def test_a_connection_that_comes_as_the_server_ends_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No task and no socket is left of it, whichever turn of the event loop it comes in."""
    links: list[socket.socket] = []
    shutdown = Listener.shutdown

    async def connect_before(self: Listener, sockets: list[socket.socket]) -> None:
        port = sockets[0].getsockname()[1]
        links.append(socket.create_connection(("127.0.0.1", port)))
        links[-1].sendall(handshake(port))
        for _ in range(len(links) - 1):
            await asyncio.sleep(0)
        await shutdown(self, sockets)

    async def test() -> None:
        async with serving():
            pass
        await until(lambda: asyncio.all_tasks() == {asyncio.current_task()})

    monkeypatch.setattr(Listener, "shutdown", connect_before)
    for _ in range(8):
        run(test)
    gc.collect()  # what is left open is a warning, hence an error
    for link in links:
        link.settimeout(PATIENCE)
        with contextlib.suppress(ConnectionResetError):
            while link.recv(4096):
                pass
        link.close()


async def test_a_host_that_cannot_start_is_closed_and_the_port_is_free_again() -> None:
    class Broken(Hands):
        async def start(self) -> None:
            raise InputError("no such device")

    hands = Broken()
    port = free_port(socket.SOCK_STREAM)
    config = Configuration(server=ServerConfig(port=port, socket=""), osc=OscConfig(port=0))
    with pytest.raises(InputError, match="no such device"):
        async with running(config, host=hands):
            pass
    assert hands.closings == 1
    async with running(config, host=Hands()):
        pass


PROCESS = """
    import gc
    import sys
    sys.path.insert(0, {tests!r})
    import server_rig
    from tactile.server import server
    from tactile.server.config import Configuration, LogConfig, OscConfig, ServerConfig

    class Hands(server_rig.Hands):
        def beat(self):
            self.beats += 1
            return self.beats <= 2
        async def reload(self):
            print("reloaded", flush=True)
        async def close(self):
            if not self.closings:
                print("closed", flush=True)
            await super().close()

    server.Host = lambda config: Hands()
    log = LogConfig(format="json")
    config = Configuration(server=ServerConfig(port=0, socket=""), log=log)
    server.serve(config, ready=lambda there: print(there.port, gc.get_freeze_count(), flush=True))
    print("ended", flush=True)
"""


OPENING = """
    import asyncio, os, sys
    sys.path.insert(0, {tests!r})
    import server_rig
    from tactile.server import server
    from tactile.server.config import Configuration, ServerConfig

    class Hands(server_rig.Hands):
        async def start(self):
            os.kill(os.getpid(), {number})
            await asyncio.Event().wait()
        async def close(self):
            if not self.closings:
                print("closed", flush=True)
            await super().close()

    server.Host = lambda config: Hands()
    try:
        server.serve(Configuration(server=ServerConfig(port=0, socket="")), ready=print)
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.parametrize(
    ("number", "output"),
    [(signal.SIGINT, "closed\ninterrupted\n"), (signal.SIGTERM, "closed\n")],
)
def test_a_signal_while_displays_are_opened_ends_the_process(
    number: signal.Signals, output: str
) -> None:
    code = textwrap.dedent(OPENING.format(tests=str(Path(__file__).parent), number=int(number)))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, output, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reload_and_end_the_process(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(PATIENCE)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "100000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        code = textwrap.dedent(PROCESS.format(tests=str(Path(__file__).parent)))
        with subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            port, spared = map(int, process.stdout.readline().split())
            told = [systemd.recv(100) for _ in range(3)]
            assert sorted(told) == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
            process.send_signal(signal.SIGHUP)
            assert process.stdout.readline() == "reloaded\n"
            process.send_signal(number)
            out, err = process.communicate(timeout=PATIENCE)
            assert out == "closed\nended\n"
            assert process.returncode == 0
            assert port > 0
            assert spared > 10_000, "objects that no collection goes through"
            assert [json.loads(line)["message"] for line in err.splitlines()] == [
                "listening", "reloaded", "shutting down",
            ]  # fmt: skip
            assert systemd.recv(100) == b"STOPPING=1"
