"""The WebSocket server as its clients see it: real sockets, a host in memory that notes all.

Figures are counts and orders, not times: what one client does must not show in what others get.
"""

import asyncio
import json
import signal
import socket
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import msgspec
import pytest
from daemon_rig import (
    BOTH,
    CONTACT,
    GOOD,
    LARGE,
    SELECT,
    Hands,
    daemon,
    free_port,
    get,
    run,
    talking,
    until,
)
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from tactile.daemon import connection, requests, server, sockets
from tactile.daemon.config import Config, OscConfig, ServerConfig
from tactile.daemon.messages import (
    JSON_PROTOCOL,
    LARGEST_MESSAGE,
    MSGPACK_PROTOCOL,
    Arm,
    Disarm,
    EStop,
    GetStats,
    Select,
)
from tactile.daemon.server import listen, running
from tactile.errors import InputError

each_encoding = pytest.mark.parametrize("protocol", BOTH)


# Both encodings, every kind of message


@each_encoding
def test_each_request_is_answered_with_its_id(protocol: str) -> None:
    async def story() -> None:
        async with daemon() as (there, _), talking(there, protocol) as talker:
            for number, (message, answer) in enumerate(GOOD.values()):
                found = await talker.ask(**message, id=number)
                assert (found["type"], found["id"]) == (answer, number)

    run(story)


@each_encoding
def test_ids_come_back_in_the_order_of_the_requests_whatever_they_are(protocol: str) -> None:
    async def story() -> None:
        async with daemon() as (there, _), talking(there, protocol) as talker:
            ids = [9, 3, 9, 2**53, 0]
            for number in ids:
                await talker.send(type="get_stats", display="right", id=number)
            await talker.send(type="get_stats", display="right")
            assert [(await talker.receive())["id"] for _ in ids] == ids
            assert "id" not in await talker.receive()

    run(story)


@each_encoding
def test_a_contact_reaches_the_host_and_is_not_answered(protocol: str) -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there, protocol) as talker:
            await talker.send(**CONTACT, unknown_field=1)
            assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
            (contact,) = hands.clients[0].contacts
            assert contact.position_mm == (1.0, 2.0)
            assert contact.velocity_mm_s == (80.0, 0.0)

    run(story)


def test_events_and_telemetry_come_between_answers() -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
            await talker.send(type="subscribe", display="left", rate_hz=10)
            found = [(await talker.receive())["type"] for _ in range(2)]
            assert sorted(found) == ["done", "telemetry"]
            hands.clients[0].outbox.put_nowait(LARGE)
            assert (await talker.receive())["kind"] == "fault"

    run(story)


def test_what_is_served_as_schema_fits_what_is_said_and_nothing_else() -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
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

    run(story)


# Bad input: a code and a field


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
]  # fmt: skip


@each_encoding
def test_what_is_wrong_is_told_with_code_field_and_id_and_the_stream_goes_on(protocol: str) -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there, protocol) as talker:
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

    run(story)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_json_that_is_no_number_is_refused(value: str) -> None:
    text = json.dumps(CONTACT).replace("0.5", value)

    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
            await talker.link.send(text)
            found = await talker.receive()
            assert found["code"] == ("invalid_field" if value == "1e999" else "malformed")
            assert hands.clients[0].contacts == []

    run(story)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("name", ["normal_force_n", "position_mm", "velocity_mm_s"])
def test_messagepack_that_is_no_number_is_refused(value: float, name: str) -> None:
    message = dict(CONTACT, **{name: value if name == "normal_force_n" else [0.0, value]})
    field = name if name == "normal_force_n" else f"{name}[1]"

    async def story() -> None:
        async with daemon() as (there, hands), talking(there, MSGPACK_PROTOCOL) as talker:
            found = await talker.ask(**message)
            assert (found["code"], found["field"]) == ("invalid_field", field)
            assert hands.clients[0].contacts == []

    run(story)


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
def test_what_is_no_message_is_malformed(name: str) -> None:
    protocol, data = MALFORMED[name]

    async def story() -> None:
        async with daemon() as (there, _), talking(there, protocol) as talker:
            await talker.link.send(data)
            assert (await talker.receive())["code"] == "malformed"
            assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"

    run(story)


@pytest.mark.parametrize("letter", ["x", "µ", "𝄞"])
def test_the_largest_message_is_taken_and_one_byte_more_is_too_large(letter: str) -> None:
    head, tail = '{"type":"ping","time_us":1,"x":"', '"}'
    room = LARGEST_MESSAGE - len(head) - len(tail)
    count = room // len(letter.encode())
    pad = "y" * (room - count * len(letter.encode()))

    async def story() -> None:
        async with daemon() as (there, _), talking(there) as talker:
            await talker.link.send(head + letter * count + pad + tail)
            assert (await talker.receive())["type"] == "pong"
            await talker.link.send(head + letter * count + pad + "y" + tail)
            assert (await talker.receive())["code"] == "too_large"
            assert (await talker.closed())[0] == 1009

    run(story)


def test_what_is_far_too_large_is_not_even_read() -> None:
    async def story() -> None:
        async with daemon() as (there, _), talking(there, MSGPACK_PROTOCOL) as talker:
            await talker.link.send(b"x" * (server.LARGEST_READ + 1))
            assert (await talker.closed())[0] == 1009

    run(story)


def test_the_hosts_failures_and_its_breaking_are_answers() -> None:
    """A code that the host gives comes back as it is; an exception is `internal`."""
    codes = ["not_armed", "estopped", "busy", "unavailable", "unknown_texture", "unsupported"]

    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
            for code in codes:
                hands.codes[Select] = code
                found = await talker.ask(**SELECT, id=4)
                assert (found["code"], found["id"], found["field"]) == (code, 4, "display")
            hands.broken = True
            assert (await talker.ask(**SELECT, id=4))["code"] == "internal"
            assert (await talker.ask(**CONTACT))["code"] == "internal"
            hands.broken = False
            assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"

    run(story)


def test_nothing_but_failures_ends_the_connection_and_one_good_message_does_not() -> None:
    async def story() -> None:
        async with daemon() as (there, _), talking(there) as talker:
            for _ in range(connection.MOST_FAILURES):
                await talker.ask(type="bogus")
            await talker.send(**CONTACT)
            for _ in range(connection.MOST_FAILURES):
                await talker.ask(type="bogus")
            await talker.send(type="bogus")
            assert await talker.closed() == tuple(connection.FLOOD)

    run(story)


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
def test_who_does_not_say_hello_first_is_told_and_sent_away(
    protocol: str, first: dict[str, Any], code: str, field: str, closed: int
) -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there, protocol, hello=False) as talker:
            found = await talker.ask(**first)
            assert (found["code"], found["field"], found.get("id")) == (
                code,
                field,
                first.get("id"),
            )
            assert (await talker.closed())[0] == closed
            assert hands.clients == []

    run(story)


def test_who_says_nothing_is_sent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "HELLO_WITHIN", 0.05)

    async def story() -> None:
        async with daemon() as (there, _), talking(there, hello=False) as talker:
            assert (await talker.receive())["code"] == "hello_first"
            assert (await talker.closed())[0] == 4408
            await until(lambda: there.site.strangers == 0)

    run(story)


@pytest.mark.parametrize("offered", [None, ["tactile.v2.json"], ["chat"]])
def test_without_a_subprotocol_that_we_speak_there_is_no_connection(
    offered: list[str] | None,
) -> None:
    async def story() -> None:
        async with daemon() as (there, _):
            offers = None if offered is None else [Subprotocol(one) for one in offered]
            async with connect(there.url, subprotocols=offers) as link:
                await link.wait_closed()
                assert link.close_code == 1002
                assert "tactile.v1.json" in str(link.close_reason)

    run(story)


def test_the_first_subprotocol_that_we_speak_is_taken() -> None:
    async def story() -> None:
        offers = [Subprotocol(p) for p in ("tactile.v9.json", MSGPACK_PROTOCOL, JSON_PROTOCOL)]
        async with daemon() as (there, _), connect(there.url, subprotocols=offers) as link:
            assert link.subprotocol == MSGPACK_PROTOCOL

    run(story)


def test_welcome_says_what_there_is() -> None:
    async def story() -> None:
        async with (
            daemon(messages_per_second=500) as (there, hands),
            talking(there, hello=False) as talker,
        ):
            welcome = await talker.ask(type="hello", client="µ", id=7, later_field=1)
            assert [d["name"] for d in welcome["displays"]] == hands.names
            assert (welcome["version"], welcome["id"], welcome["may_arm"]) == (1, 7, True)
            assert welcome["messages_per_second"] == 500
            assert hands.clients[0].name == "µ"
            assert hands.clients[0].may_arm

    run(story)


# Requests


def test_a_slow_request_holds_up_neither_contacts_nor_pings_nor_an_estop() -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
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

    run(story)


def test_more_requests_than_may_wait_are_refused_as_busy_and_an_estop_is_not() -> None:
    async def story() -> None:
        async with daemon() as (there, hands), talking(there) as talker:
            hands.gate.clear()
            for number in range(requests.MOST_REQUESTS + 1):
                await talker.send(**SELECT, id=number)
            found = await talker.receive()
            assert (found["code"], found["id"]) == ("busy", requests.MOST_REQUESTS)
            assert (await talker.ask(type="estop", id=99))["type"] == "done"
            hands.gate.set()
            answers = [(await talker.receive())["id"] for _ in range(requests.MOST_REQUESTS)]
            assert answers == list(range(requests.MOST_REQUESTS))

    run(story)


def test_what_makes_safe_is_carried_out_though_its_client_is_gone() -> None:
    """An e-stop and a disarm behind a slow request; an arm that waits behind them is not."""

    async def story() -> None:
        async with daemon() as (there, hands):
            async with talking(there) as talker:
                hands.gate.clear()
                await talker.send(**SELECT)
                await talker.send(type="disarm", display="right")
                await talker.send(type="arm", display="right")
                await talker.send(type="estop")
            await until(lambda: EStop in [type(c) for c in hands.clients[0].commands])
            assert hands.clients[0].closed == 0
            hands.gate.set()
            await until(lambda: hands.clients[0].closed == 1)
            done = [type(command) for command in hands.clients[0].commands]
            assert done == [EStop, Select, Disarm]
            assert Arm not in done

    run(story)


def test_a_client_that_is_gone_is_closed_once_and_its_slow_request_with_it() -> None:
    async def story() -> None:
        async with daemon() as (there, hands):
            async with talking(there) as talker:
                hands.gate.clear()
                await talker.send(**SELECT)
                await talker.ask(type="ping", time_us=1)
                talker.link.transport.abort()
            await until(lambda: hands.clients[0].closed == 1)
            assert hands.clients[0].commands == []
            assert there.site.clients == 0

    run(story)


# HTTP


def test_health_is_what_the_host_says() -> None:
    async def story() -> None:
        async with daemon() as (there, hands):
            good = await get(there, "/healthz")
            assert (good.status_code, good.json()["status"]) == (200, "ok")
            hands.alive = False
            bad = await get(there, "/healthz")
            assert (bad.status_code, bad.json()["status"]) == (503, "failing")
            assert "WebSocket at /v1" in (await get(there, "/")).text

    run(story)


def test_figures_are_read_by_prometheus_and_are_those_of_displays_and_clients() -> None:
    async def story() -> None:
        async with daemon() as (there, _), talking(there) as talker:
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

    run(story)


@pytest.mark.parametrize("path", ["/nope", "/v1/", "/v1/schema/x", "/../../etc/passwd"])
def test_what_is_not_there_is_404(path: str) -> None:
    async def story() -> None:
        async with daemon() as (there, _):
            assert (await get(there, path)).status_code == 404

    run(story)


def test_an_error_shows_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(self: Hands) -> bool:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(Hands, "healthy", break_down)

    async def story() -> None:
        async with daemon() as (there, _):
            found = await get(there, "/healthz")
            assert found.status_code == 500
            assert found.text == "Internal Server Error"

    run(story)


def test_a_connection_that_asks_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_WITHIN", 0.05)

    async def story() -> None:
        async with daemon() as (there, _):
            reader, writer = await asyncio.open_connection("127.0.0.1", there.port)
            writer.write(b"GET / HT")
            assert await reader.read() == b""
            writer.close()

    run(story)


# Beginning and end


def test_each_connection_has_no_delay_and_no_compression() -> None:
    async def story() -> None:
        (bound,) = listen(ServerConfig(port=0), guarded=False)
        assert bound.proto == socket.IPPROTO_TCP, "else asyncio does not set TCP_NODELAY"
        bound.close()
        async with daemon() as (there, _), talking(there) as talker:
            assert talker.link.protocol.extensions == []

    run(story)


def test_a_port_that_is_taken_is_one_line_before_anything_is_opened() -> None:
    async def story() -> None:
        async with daemon() as (there, _):
            hands = Hands()
            config = Config(server=ServerConfig(port=there.port), osc=OscConfig(port=0))
            with pytest.raises(InputError, match=rf"'127.0.0.1' port {there.port}: Address"):
                async with running(config, host=hands):
                    pass
            assert hands.started == 0

    run(story)


def test_at_the_end_clients_are_told_and_displays_are_closed_before_connections_are() -> None:
    async def story() -> None:
        async with daemon() as (there, hands):
            talker = await connect(there.url, subprotocols=[Subprotocol(JSON_PROTOCOL)])
            await talker.send('{"type":"hello","client":"a"}')
            await talker.recv()
            hands.armed = True
        with pytest.raises(ConnectionClosed):
            await talker.recv()
        assert (talker.close_code, talker.close_reason) == (1001, "the daemon ends")
        assert hands.closings >= 1
        assert not hands.armed
        assert hands.clients[0].closed == 1
        with pytest.raises(OSError, match="Connect call failed"):
            await connect(there.url)

    run(story)


def test_a_host_that_cannot_start_is_closed_and_the_port_is_free_again() -> None:
    class Broken(Hands):
        async def start(self) -> None:
            raise InputError("no such device")

    async def story() -> None:
        hands = Broken()
        port = free_port(socket.SOCK_STREAM)
        config = Config(server=ServerConfig(port=port), osc=OscConfig(port=0))
        with pytest.raises(InputError, match="no such device"):
            async with running(config, host=hands):
                pass
        assert hands.closings == 1
        async with running(config, host=Hands()):
            pass

    run(story)


PROCESS = """
    import sys
    sys.path.insert(0, {tests!r})
    import daemon_rig
    from tactile.daemon import server
    from tactile.daemon.config import Config, LogConfig, OscConfig, ServerConfig

    class Hands(daemon_rig.Hands):
        async def reload(self):
            print("reloaded", flush=True)
        async def close(self):
            if not self.closings:
                print("closed", flush=True)
            await super().close()

    server._host = lambda config: Hands()
    log = LogConfig(format="json")
    config = Config(server=ServerConfig(port=0), osc=OscConfig(port=0), log=log)
    server.serve(config, ready=lambda there: print(there.port, flush=True))
    print("ended", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reload_and_end_the_process(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "100000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        code = textwrap.dedent(PROCESS.format(tests=str(Path(__file__).parent)))
        with subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            assert int(process.stdout.readline()) > 0
            told = [systemd.recv(100) for _ in range(3)]
            assert sorted(set(told)) == [b"READY=1", b"WATCHDOG=1"]
            process.send_signal(signal.SIGHUP)
            assert process.stdout.readline() == "reloaded\n"
            process.send_signal(number)
            out, err = process.communicate(timeout=10)
            assert out == "closed\nended\n"
            assert process.returncode == 0
            assert [json.loads(line)["message"] for line in err.splitlines()] == [
                "listening", "reloaded", "ending",
            ]  # fmt: skip
            while told[-1] == b"WATCHDOG=1":
                told.append(systemd.recv(100))
            assert told[-1] == b"STOPPING=1"
