"""Tests of bad input: its sender is told, with a code and a field, and the stream goes on."""

import json
from typing import Any

import msgspec
import pytest
from server_rig import BAD, CONTACT, SELECT, each_encoding, figure, serving, talking
from websockets.exceptions import ConnectionClosedError

from tactile.clock import ModelClock
from tactile.messages import JSON_PROTOCOL, MSGPACK_PROTOCOL, Select
from tactile.server import decoding
from tactile.server.decoding import ENCODINGS, hint, read_estop
from tactile.server.rates import TokenBucket

LARGEST_MESSAGE = 64 * 1024
"""Largest message [bytes]; for up to twice as many the answer says what is wrong."""

pytestmark = pytest.mark.usefixtures("patient")


@each_encoding
async def test_what_is_wrong_is_told_with_code_field_and_id_and_the_stream_goes_on(
    protocol: str,
) -> None:
    async with serving() as (there, hands), talking(there, protocol) as talker:
        for bad in BAD:
            data: Any = json.dumps(bad.content)
            if protocol == MSGPACK_PROTOCOL:
                data = msgspec.msgpack.encode(bad.content)
            await talker.link.send(data)
            found = await talker.receive()
            assert (found["type"], found["code"]) == ("failure", bad.code), bad
            assert found.get("field", "") == bad.field, bad
            asked = bad.content.get("id") if isinstance(bad.content, dict) else None
            assert found.get("id") == (asked if asked == 7 else None), bad
            assert len(found["message"]) <= 200
            assert "\n" not in found["message"]
        await talker.send(**CONTACT)
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
        assert len(hands.clients[0].contacts) == 1
        assert hands.clients[0].commands == []


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999"])
async def test_json_that_is_no_number_is_refused(value: str) -> None:
    text = json.dumps(CONTACT).replace("0.5", value)
    async with serving() as (there, hands), talking(there) as talker:
        await talker.link.send(text)
        found = await talker.receive()
        assert found["code"] == ("invalid_field" if value == "1e999" else "malformed")
        assert hands.clients[0].contacts == []


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("name", ["normal_force_n", "position_mm", "velocity_mm_s"])
async def test_messagepack_that_is_no_number_is_refused(value: float, name: str) -> None:
    message = dict(CONTACT, **{name: value if name == "normal_force_n" else [0.0, value]})
    field = name if name == "normal_force_n" else f"{name}[1]"
    async with serving() as (there, hands), talking(there, MSGPACK_PROTOCOL) as talker:
        found = await talker.ask(**message)
        assert (found["code"], found["field"]) == ("invalid_field", field)
        assert hands.clients[0].contacts == []


MALFORMED: dict[str, tuple[str, str | bytes]] = {
    "no JSON": (JSON_PROTOCOL, "{"),
    "nothing": (JSON_PROTOCOL, ""),
    "two": (JSON_PROTOCOL, "{}{}"),
    "too deep": (JSON_PROTOCOL, '{"type":"play","display":"a","x":' + "[" * 30000),
    "half a surrogate": (JSON_PROTOCOL, '{"type":"hello","client":"\\ud800\\u0041"}'),
    "binary": (JSON_PROTOCOL, json.dumps(CONTACT).encode()),
    "text": (MSGPACK_PROTOCOL, "hello"),
    "no MessagePack": (MSGPACK_PROTOCOL, b"\xc1"),
    "cut": (MSGPACK_PROTOCOL, msgspec.msgpack.encode(CONTACT)[:-3]),
    "trailing": (MSGPACK_PROTOCOL, msgspec.msgpack.encode(CONTACT) + b"\x01"),
    "no UTF-8": (MSGPACK_PROTOCOL, b"\x82\xa4type\xa4play\xa7display\xa1\xff"),
    "deep": (MSGPACK_PROTOCOL, b"\x83\xa4type\xa4play\xa7display\xa1a\xa1x" + b"\x91" * 60000),
}


@pytest.mark.parametrize("name", MALFORMED)
async def test_what_is_no_message_is_malformed(name: str) -> None:
    protocol, data = MALFORMED[name]
    async with serving() as (there, _), talking(there, protocol) as talker:
        await talker.link.send(data)
        assert (await talker.receive())["code"] == "malformed"
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"


@pytest.mark.parametrize("letter", ["x", "µ", "𝄞"])
async def test_the_largest_message_is_taken_and_one_byte_more_is_too_large(letter: str) -> None:
    head, tail = '{"type":"ping","time_us":1,"x":"', '"}'
    room = LARGEST_MESSAGE - len(head) - len(tail)
    count = room // len(letter.encode())
    pad = "y" * (room - count * len(letter.encode()))
    async with serving() as (there, _), talking(there) as talker:
        await talker.link.send(head + letter * count + pad + tail)
        assert (await talker.receive())["type"] == "pong"
        await talker.link.send(head + letter * count + pad + "y" + tail)
        assert (await talker.receive())["code"] == "too_large"
        assert (await talker.closed())[0] == 1009


async def test_what_is_far_too_large_is_not_even_read() -> None:
    async with serving() as (there, _), talking(there, MSGPACK_PROTOCOL) as talker:
        await talker.link.send(b"x" * (2 * LARGEST_MESSAGE + 1))
        with pytest.raises(ConnectionClosedError):
            await talker.receive()
        assert (await talker.closed())[0] == 1009


async def test_the_hosts_failures_and_its_breaking_are_answers() -> None:
    """A code that the host gives comes back as it is; an exception is `internal`."""
    codes = ["not_armed", "estopped", "busy", "unavailable", "unknown_texture", "unsupported"]
    async with serving() as (there, hands), talking(there) as talker:
        for code in codes:
            hands.codes[Select] = code
            found = await talker.ask(**SELECT, id=4)
            assert (found["code"], found["id"], found["field"]) == (code, 4, "display")
        hands.broken = True
        assert (await talker.ask(**SELECT, id=4))["code"] == "internal"
        assert (await talker.ask(**CONTACT))["code"] == "internal"
        hands.broken = False
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"


ESTOP = {"type": "estop", "id": 7}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (ESTOP, True),
        ({"display": "left", "x": [1, {"y": 2}], "type": "estop"}, True),
        (dict(CONTACT, x="estop"), False),
        (dict(CONTACT, estop=ESTOP), False),
        ({"type": "estop", "display": "../x"}, False),
        ([ESTOP], False),
        ("estop", False),
        ({"type": "estop", "x": "y" * LARGEST_MESSAGE}, False),
    ],
)
@each_encoding
def test_an_estop_is_known_by_its_type_and_by_nothing_else(
    protocol: str, content: Any, expected: bool
) -> None:
    data = msgspec.msgpack.encode(content) if protocol == MSGPACK_PROTOCOL else json.dumps(content)
    assert (read_estop(data, ENCODINGS[protocol]) is not None) is expected
    assert read_estop(b"" if isinstance(data, str) else "", ENCODINGS[protocol]) is None


async def test_of_messages_that_are_too_many_only_an_estop_is_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with serving() as (there, hands), talking(there) as talker:
        monkeypatch.setattr(TokenBucket, "take", lambda *_: False)
        for _ in range(20):
            await talker.send(**CONTACT, x="estop")
            await talker.send(type="bogus", x="estop")
        await talker.send(**ESTOP)
        while (found := await talker.receive())["type"] != "done":
            assert found["code"] == "too_fast"
        assert found["id"] == 7
        assert hands.clients[0].contacts == []
        reason = {"transport": "websocket", "reason": "too_fast"}
        assert figure(there, "tactile_dropped_messages_total", **reason) == 40


def test_similar_names_are_looked_for_so_often_and_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(decoding, "HINTS", TokenBucket(20))
    monkeypatch.setattr(decoding, "MONOTONIC", ModelClock())
    found = [hint("estp", ["estop", "ping"]) for _ in range(25)]
    assert found[:20] == ["did you mean 'estop'?"] * 20
    assert set(found[20:]) == {"similar names are looked for 20 times a second at most"}


async def test_nothing_but_failures_ends_the_connection_and_one_good_message_does_not() -> None:
    async with serving() as (there, _), talking(there) as talker:
        for _ in range(100):
            await talker.ask(type="bogus")
        await talker.send(**CONTACT)
        for _ in range(100):
            await talker.ask(type="bogus")
        await talker.send(type="bogus")
        assert await talker.closed() == (4008, "nothing but failures")
