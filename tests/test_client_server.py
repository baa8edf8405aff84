"""The SDK against the real server, and how little of Python it needs."""

import asyncio
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import pytest
from client_rig import (
    MESSAGES,
    PATIENCE,
    ScriptedServer,
    Twin,
    count,
    plain,
    samples_of,
    telemetry,
    until,
)
from server_rig import Hands

from tactile import client
from tactile import messages as m
from tactile.client.connection import Encoding
from tactile.client.wire import Telemetry, from_message
from tactile.errors import DisconnectedError, NotFoundError, RequestError
from tactile.server.config import Configuration, ServerConfig
from tactile.server.server import running

pytestmark = pytest.mark.usefixtures("patient", "patient_client")


class RealServer:
    """The real server, with a host in memory, in a thread."""

    def __init__(self, **options: Any) -> None:
        self.hands = Hands()
        self.config = Configuration(server=ServerConfig(port=0, socket="", **options))
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
def test_the_real_server_hears_each_call(twin: Twin, real: RealServer, encoding: Encoding) -> None:
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
    assert log()[-1] == plain(m.StopPlaying(display="left"))


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
    assert from_message(Telemetry, telemetry(7_000_000)).time == pytest.approx(7.0)


def test_a_session_of_the_sdk_never_needs_numpy(server: ScriptedServer) -> None:
    code = (
        "import sys\nfrom tactile import client\nfrom tactile.client import websocket\n"
        f"websocket.SILENCE = {PATIENCE}\n"
        f"with client.connect({server.url!r}, timeout={PATIENCE}) as display:\n"
        "    display.play([0.0] * 5000, sample_rate=8000, amplitude=1e-6)\n"
        "    display.touch((0.0, 0.0))\n"
        "assert 'numpy' not in sys.modules and 'scipy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=10 * PATIENCE)
    assert sum(count(said) for said in server.of(m.Append)) == 5000
