"""The WebSocket server as its clients see it: real sockets, a host in memory that notes all.

Figures are counts and orders, not times: what one client does must not show in what others get.
"""

import asyncio
import struct
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import pytest
from server_rig import (
    BAD,
    CONTACT,
    FRAMES,
    GOOD,
    LARGE,
    PICTURE,
    SELECT,
    connect,
    each_encoding,
    get,
    serving,
    talking,
    until,
)
from websockets.typing import Subprotocol

from tactile.messages import (
    JSON_PROTOCOL,
    ArmDisplay,
    DisarmDisplay,
    DrawTexture,
    EStop,
    GetStats,
    Select,
    TactileFrames,
)
from tactile.server import connection

pytestmark = pytest.mark.usefixtures("patient")


MOST_REQUESTS = 32
"""Largest number of requests that may wait for one client; a client that sends more does not wait
for answers."""

# Both encodings, every kind of message


@each_encoding
async def test_each_request_is_answered_with_its_id(protocol: str) -> None:
    async with serving() as (there, _), talking(there, protocol) as talker:
        for number, (message, answer) in enumerate(GOOD.values()):
            found = await talker.ask(**message, id=number)
            assert (found["type"], found["id"]) == (answer, number)


@each_encoding
async def test_ids_come_back_in_the_order_of_the_requests_whatever_they_are(protocol: str) -> None:
    async with serving() as (there, _), talking(there, protocol) as talker:
        ids = [9, 3, 9, 2**53, 0]
        for number in ids:
            await talker.send(type="get_stats", display="right", id=number)
        await talker.send(type="get_stats", display="right")
        assert [(await talker.receive())["id"] for _ in ids] == ids
        assert "id" not in await talker.receive()


@each_encoding
async def test_a_contact_reaches_the_host_and_is_not_answered(protocol: str) -> None:
    async with serving() as (there, hands), talking(there, protocol) as talker:
        await talker.send(**CONTACT, unknown_field=1)
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
        (contact,) = hands.clients[0].contacts
        assert contact.position_mm == (1.0, 2.0)
        assert contact.velocity_mm_s == (80.0, 0.0)


@each_encoding
async def test_frames_reach_the_host_beside_requests_and_are_not_answered(protocol: str) -> None:
    values = [0.5, -1.0] if protocol == JSON_PROTOCOL else struct.pack("<2f", 0.5, -1.0)
    async with serving() as (there, hands), talking(there, protocol) as talker:
        hands.gate.clear()
        await talker.send(**SELECT, id=1)  # textures that are being prepared delay no stream
        await talker.send(**FRAMES | {"frames": values})
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
        (frames,) = [said for _, said in hands.log if isinstance(said, TactileFrames)]
        assert frames.frames == (tuple(values) if isinstance(values, list) else values)
        assert (frames.frame_rate_hz, frames.amplitude_um, frames.latest) == (1000.0, 5.0, True)
        hands.gate.set()
        assert (await talker.receive())["id"] == 1


async def test_events_and_telemetry_come_between_answers() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        await talker.send(type="subscribe", display="left", rate_hz=10)
        found = [(await talker.receive())["type"] for _ in range(2)]
        assert sorted(found) == ["done", "telemetry"]
        hands.clients[0].outbox.put_nowait(LARGE)
        assert (await talker.receive())["kind"] == "fault"


async def test_what_is_served_as_schema_fits_what_is_said_and_nothing_else() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        shape = (await get(there, "/v1/schema")).json()
        jsonschema.Draft202012Validator.check_schema(shape)
        sides = {
            side: jsonschema.Draft202012Validator({**shape[side], "$defs": shape["$defs"]})
            for side in ("client", "server")
        }
        for message, _ in [*GOOD.values(), (CONTACT, "")]:
            assert sides["client"].is_valid(message), message
        for bad in BAD:
            if bad.code in ("invalid_field", "unknown_type"):
                assert not sides["client"].is_valid(bad.content), bad
        for message, _ in GOOD.values():
            assert sides["server"].is_valid(await talker.ask(**message))
        assert sides["server"].is_valid(await talker.ask(type="bogus"))
        hands.clients[0].outbox.put_nowait(LARGE)
        assert sides["server"].is_valid(await talker.receive())


# Hello


@pytest.mark.parametrize(
    ("first", "code", "field", "closed"),
    [
        ({"type": "ping", "time_us": 1, "id": 7}, "hello_first", "type", 4400),
        (CONTACT, "hello_first", "type", 4400),
        ({"type": "estop", "id": 7}, "hello_first", "type", 4400),
        ({"type": "hello", "client": "", "id": 7}, "invalid_field", "client", 4400),
        ({"type": "hello", "client": "a", "token": "x" * 257}, "invalid_field", "token", 4400),
        ({"type": "hello", "client": "a", "version": 2, "id": 7}, "wrong_version", "version", 4406),
        ({"type": "helo", "id": 7}, "unknown_type", "type", 4400),
    ],
)
@each_encoding
async def test_who_does_not_say_hello_first_is_told_and_sent_away(
    protocol: str, first: dict[str, Any], code: str, field: str, closed: int
) -> None:
    async with serving() as (there, hands), talking(there, protocol, hello=False) as talker:
        found = await talker.ask(**first)
        assert (found["code"], found["field"], found.get("id")) == (
            code,
            field,
            first.get("id"),
        )
        assert (await talker.closed())[0] == closed
        assert hands.clients == []


async def test_who_says_nothing_is_sent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "HELLO_WITHIN", 0.05)
    async with serving() as (there, _), talking(there, hello=False) as talker:
        assert (await talker.receive())["code"] == "hello_first"
        assert (await talker.closed())[0] == 4408


@pytest.mark.parametrize("offered", [None, ["tactile.v2.json"], ["chat"]])
async def test_without_a_subprotocol_that_we_speak_there_is_no_connection(
    offered: list[str] | None,
) -> None:
    async with serving() as (there, _):
        offers = None if offered is None else [Subprotocol(one) for one in offered]
        async with connect(there.url, subprotocols=offers) as link:
            await link.wait_closed()
            assert link.close_code == 1002
            assert "tactile.v1.json" in str(link.close_reason)


async def test_the_first_subprotocol_that_we_speak_is_taken() -> None:
    names = "tactile.v9.json", "tactile.v1.msgpack", "tactile.v1.json"
    offers = [Subprotocol(name) for name in names]
    async with serving() as (there, _), connect(there.url, subprotocols=offers) as link:
        assert link.subprotocol == "tactile.v1.msgpack"


async def test_welcome_says_what_there_is() -> None:
    async with (
        serving(messages_per_second=500) as (there, hands),
        talking(there, hello=False) as talker,
    ):
        welcome = await talker.ask(type="hello", client="µ", id=7, later_field=1)
        assert [d["name"] for d in welcome["displays"]] == hands.names
        assert (welcome["version"], welcome["id"], welcome["may_arm"]) == (1, 7, True)
        assert welcome["messages_per_second"] == 500
        assert hands.clients[0].name == "µ"
        assert "arm" in hands.clients[0].roles


# Requests


async def test_a_slow_request_holds_up_neither_contacts_nor_pings_nor_an_estop() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        hands.gate.clear()
        await talker.send(**SELECT, id=1)
        await talker.send(type="get_stats", display="right", id=2)
        await talker.send(**CONTACT)
        assert (await talker.ask(type="ping", time_us=1, id=3))["id"] == 3
        assert len(hands.clients[0].contacts) == 1
        assert (await talker.ask(type="estop", id=4))["id"] == 4
        assert [type(c) for c in hands.clients[0].commands] == [EStop]
        hands.gate.set()
        assert [(await talker.receive())["id"] for _ in range(2)] == [1, 2]
        assert [type(c) for c in hands.clients[0].commands] == [EStop, Select, GetStats]


async def test_pictures_hold_up_no_request_and_more_than_may_wait_are_refused() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        hands.gate.clear()
        for number in range(MOST_REQUESTS + 1):
            await talker.send(**PICTURE, id=number)
        busy = await talker.receive()
        assert (busy["code"], busy["id"]) == ("busy", MOST_REQUESTS)
        disarmed = await talker.ask(type="disarm", display="right", id=99)
        assert (disarmed["type"], disarmed["id"]) == ("done", 99)
        hands.gate.set()
        answers = [await talker.receive() for _ in range(MOST_REQUESTS)]
        assert {answer["type"] for answer in answers} == {"texture_picture"}
        assert {answer["id"] for answer in answers} == set(range(MOST_REQUESTS))


async def test_a_client_that_is_gone_has_no_pictures_drawn() -> None:
    async with serving() as (there, hands):
        async with talking(there) as talker:
            hands.gate.clear()
            await talker.send(**PICTURE)
            await talker.ask(type="ping", time_us=1)
        await until(lambda: len(there.site.places) == 0)
        hands.gate.set()
        await asyncio.sleep(0)
        assert DrawTexture not in {type(command) for _, command in hands.log}


async def test_more_requests_than_may_wait_are_refused_as_busy_and_an_estop_is_not() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        hands.gate.clear()
        for number in range(MOST_REQUESTS + 1):
            await talker.send(**SELECT, id=number)
        found = await talker.receive()
        assert (found["code"], found["id"]) == ("busy", MOST_REQUESTS)
        assert (await talker.ask(type="estop", id=99))["type"] == "done"
        hands.gate.set()
        answers = [(await talker.receive())["id"] for _ in range(MOST_REQUESTS)]
        assert answers == list(range(MOST_REQUESTS))


async def test_what_makes_safe_is_carried_out_though_its_client_is_gone() -> None:
    """An e-stop, and a disarm behind a slow request; neither that nor an arm behind them is."""
    async with serving() as (there, hands):
        async with talking(there) as talker:
            hands.gate.clear()
            await talker.send(**SELECT)
            await talker.send(type="disarm", display="right")
            await talker.send(type="arm", display="right")
            await talker.send(type="estop")
        await until(lambda: len(there.site.places) == 0)
        done = [type(command) for _, command in hands.log]
        assert done == [EStop, type(None), DisarmDisplay], "the client was closed before the disarm"
        assert not {Select, ArmDisplay} & set(done)


async def test_a_client_that_is_gone_is_closed_once_and_its_slow_request_with_it() -> None:
    async with serving() as (there, hands):
        async with talking(there) as talker:
            hands.gate.clear()
            await talker.send(**SELECT)
            await talker.ask(type="ping", time_us=1)
            talker.link.transport.abort()
        await until(lambda: hands.clients[0].closed == 1)
        assert hands.clients[0].commands == []
        await until(lambda: len(there.site.places) == 0)
