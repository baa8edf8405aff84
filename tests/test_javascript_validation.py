"""The JavaScript client checks what a server sends, and outlasts what is not as the API has it."""

import asyncio
import json
import random
import shutil
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from javascript_rig import examples
from node_rig import Node, NodeError, node, tool
from server_rig import until
from test_javascript_client import OPEN, READY, SETTLED

from benchmarks.hostile_server import HostileServer, hostile_server, plain, stats
from tactile.messages import Answer, EventMessage, TelemetryMessage
from tactile.server.page import FOLDER

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

ANSWERS = {kind.__name__ for kind in get_args(Answer)}
"""Names of the classes of all messages of a server."""
CHECK = """
import { readFileSync } from "node:fs";
import { decode } from "./client/msgpack.js";
import { faultOf } from "./client/validation.js";
const cases = decode(new Uint8Array(readFileSync(0)));
console.log(JSON.stringify(cases.map((message) => faultOf(message))));
"""
"""JavaScript that reads messages and prints what is wrong with each."""
Check = Callable[[list[Any]], list[str]]
"""Function from messages to what is wrong with each."""


@pytest.fixture
def check(tmp_path: Path) -> Check:
    """Check messages as the client does."""
    shutil.copytree(FOLDER / "client", tmp_path / "client")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "check.js").write_text(CHECK)

    def faults(messages: list[Any]) -> list[str]:
        command = [tool("node"), str(tmp_path / "check.js")]
        data = msgspec.msgpack.encode(messages)
        done = subprocess.run(command, input=data, capture_output=True, check=True, timeout=300)
        lines: list[str] = json.loads(done.stdout)
        return lines

    return faults


def test_every_message_of_a_server_is_taken(check: Check) -> None:
    """Take messages with all fields, without those that may be absent, and with unknown ones."""
    rng = random.Random("taken")
    messages = [value for name, value in examples(rng, 20) if name in ANSWERS]
    assert len(messages) == 20 * len(ANSWERS)
    assert set(check(messages)) == {""}
    assert set(check([value | {"unknown": 1} for value in messages])) == {""}


def test_a_field_that_is_missing_or_of_another_type_is_named(check: Check) -> None:
    """Delete each required field, and give each field a value that no field has."""
    messages = [value for name, value in examples(random.Random(1), 1) if name in ANSWERS]
    required = [value for name, value in examples(random.Random(1), 2) if name in ANSWERS][1::2]
    wrong = [
        ({k: v for k, v in value.items() if k != field}, field)
        for value in required
        for field in value
        if field not in ("type", "id", "put_out_share", "finger", "trace")
    ]
    wrong += [
        (value | {field: {"no": [b"such", [2]]}}, field)
        for value in messages
        for field in value
        if field != "type"
    ]
    for fault, (_, field) in zip(check([value for value, _ in wrong]), wrong, strict=True):
        assert fault.startswith(field)


@pytest.mark.parametrize(
    ("field", "value", "fault"),
    [
        ("latency_ms", float("nan"), "latency_ms is no number"),
        ("latency_ms", float("inf"), "latency_ms is no number"),
        ("estop", 0.5, "estop is no integer"),
        ("counters", {"blocks": "3"}, "counters[0] is no integer"),
        ("counters", [], "counters is no map"),
        ("type", "constructor", "its type is not known"),
        ("state", "of a later version", ""),
        ("estop", None, "estop is no integer"),
        ("put_out_share", None, ""),
    ],
)
def test_what_is_wrong_is_a_sentence(check: Check, field: str, value: Any, fault: str) -> None:
    assert check([plain(stats("armed")) | {field: value}]) == [fault]


# The connection


@pytest.fixture
async def javascript(tmp_path: Path) -> AsyncIterator[Node]:
    async with node(tmp_path) as running:
        yield running


@asynccontextmanager
async def scripted(javascript: Node) -> AsyncIterator[HostileServer]:
    """Connect the client to a server that sends what a test wants."""
    async with hostile_server(HostileServer(0)) as server:
        url = server.page.replace("http:", "ws:") + "v1"
        await javascript.run(OPEN, url=url, options={})
        await javascript.run(READY)
        yield server


async def send(server: HostileServer, data: bytes | str) -> None:
    link = await server.welcomed()
    await link.send(data)


def event(detail: str) -> bytes:
    return msgspec.msgpack.encode(EventMessage(display="right", kind="note", detail=detail))


async def test_telemetry_that_cannot_be_read_is_ignored(javascript: Node) -> None:
    """Give listeners what comes after it, over the same connection."""
    async with scripted(javascript) as server:
        await javascript.run("kept.got = []; kept.d.telemetry(30, (t) => kept.got.push(t.time_us))")
        await send(server, msgspec.msgpack.encode({"type": "telemetry", "display": "right"}))
        await send(server, msgspec.msgpack.encode({"type": "of a later version", "id": 4711}))
        telemetry = TelemetryMessage(
            display="right", time_us=7, state="armed", position_mm=(0.0, 0.0),
            velocity_mm_s=(0.0, 0.0), normal_force_n=0.0, shear_um=None, drive_v=(), counters={},
        )  # fmt: skip
        await send(server, msgspec.msgpack.encode(telemetry))
        await javascript.run(SETTLED.format("!kept.got.length"))
        assert await javascript.run("return [kept.got, kept.c.ignoredMessages]") == [[7], 2]
        assert server.connections == 1


@pytest.mark.parametrize(
    "data",
    [b"\xc1", b"", b"\x2a", b"\x81\xa4type", "99999999999", b"\x81\xa4type\xa4done"],
    ids=["no MessagePack", "empty", "a number", "cut off", "a text frame", "an answer without id"],
)
async def test_the_client_connects_anew_if_an_answer_may_be_lost(
    javascript: Node, data: bytes | str
) -> None:
    async with scripted(javascript) as server:
        await send(server, data)
        await until(lambda: server.connections == 2)
        await javascript.run(READY)
        await send(server, event("after it"))
        await javascript.run(SETTLED.format("!kept.events.length"))
        assert await javascript.run("return kept.events[0].detail") == "after it"


class FaultyServer(HostileServer):
    """A server whose answers to requests of one type are not as the API has them."""

    faulty = ""
    fields: dict[str, Any] = {}  # noqa: RUF012
    times = 1

    def answer_to(self, command: dict[str, Any]) -> dict[str, Any]:
        answer = super().answer_to(command)
        if command["type"] != self.faulty or self.times == 0:
            return answer
        self.times -= 1
        return answer | self.fields


@asynccontextmanager
async def faulty(javascript: Node, kind: str, fields: dict[str, Any]) -> AsyncIterator[Any]:
    """Connect to a server whose next answer to a type of request has wrong fields."""
    async with hostile_server(FaultyServer(0)) as server:
        server.faulty, server.fields = kind, fields
        url = server.page.replace("http:", "ws:") + "v1"
        await javascript.run(OPEN, url=url, options={})
        await javascript.run(READY)
        yield server


async def test_an_answer_that_cannot_be_read_fails_its_request(javascript: Node) -> None:
    async with faulty(javascript, "get_stats", {"state": 7}) as server:
        with pytest.raises(NodeError, match="stats of the server cannot be read: state") as caught:
            await javascript.run("await kept.d.stats()")
        assert caught.value.code == "internal"
        assert (await javascript.run("return await kept.d.stats()"))["state"] == "disarmed"
        assert server.connections == 1


async def test_an_answer_of_another_type_fails_its_request(javascript: Node) -> None:
    async with faulty(javascript, "get_stats", {"type": "done"}):
        with pytest.raises(NodeError, match="it is no answer to get_stats"):
            await javascript.run("await kept.d.stats()")


async def test_a_welcome_that_cannot_be_read_is_tried_again(javascript: Node) -> None:
    async with faulty(javascript, "hello", {"displays": None}) as server:
        assert server.requests["hello"] == 2


@pytest.mark.parametrize("fields", [{"estops": {"right": "5"}}, {"type": "pong"}, {"id": -1}])
async def test_an_estop_that_is_not_confirmed_is_sent_again(
    javascript: Node, fields: dict[str, Any]
) -> None:
    """Confirm it wrongly, as another request, or under a number that no request has."""
    async with faulty(javascript, "estop", fields) as server:
        stopping = asyncio.ensure_future(javascript.run("await kept.c.estop()"))
        await server.requested("estop", 2)
        with pytest.raises(NodeError, match="will be sent first"):
            await stopping
        await javascript.run(SETTLED.format("kept.d.estopped !== 5"))


async def test_a_display_that_is_gone_keeps_its_description(javascript: Node) -> None:
    """Connect anew to a server that has another display."""
    async with scripted(javascript) as server:
        server.display = "left"
        await (await server.welcomed()).close()
        await until(lambda: server.connections == 2)
        await javascript.run(READY.partition(" kept.d")[0])
        names, limit = await javascript.run(
            "return [kept.c.displays.map((d) => d.name), kept.d.info.voltage_limit_v]"
        )
        assert (names, limit) == (["left"], 100)
