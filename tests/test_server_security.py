"""Tests of who may connect, and that misuse by one client has no effect on the others.

Figures are counts and orders, not times: what one client does must not show in what others get.
"""

import asyncio
import json
import logging
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from server_rig import (
    CONTACT,
    GOOD,
    LARGE,
    PATIENCE,
    connect,
    figure,
    frame,
    get,
    serving,
    talking,
    unread,
    until,
)
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

from tactile.errors import InputError
from tactile.messages import ALL_ROLES, JSON_PROTOCOL, EStop, Role
from tactile.server import connection, listening, places, sockets
from tactile.server.config import ServerConfig
from tactile.server.listening import bound_sockets
from tactile.server.security import Tokens, host_name, refusal

pytestmark = pytest.mark.usefixtures("patient")


TOKEN = "correct horse battery staple"
APP = "https://app.example"


# Who may connect

HOSTS = [
    ("127.0.0.1:7411", True),
    ("localhost:7411", True),
    ("LocalHost", True),
    ("[::1]:7411", True),
    ("[::1]", True),
    ("box.local", True),  # as configured
    ("192.168.1.5:7411", True),  # where the request came to
    ("", False),
    ("evil.example", False),
    ("evil.example:7411", False),
    ("localhost.evil.example", False),
    ("127.0.0.1.nip.io", False),
    ("localhost:7411@evil.example", False),
    ("evil.example:localhost", False),
    ("127.0.0.1:7411:80", False),
    ("127.0.0.1, evil.example", False),
    ("192.168.1.6", False),
    ("2130706433", False),
    ("0.0.0.0:7411", False),
    ("localhost.", False),
    ("localhost:٧٤", False),
]


@pytest.mark.parametrize(("host", "allowed"), HOSTS)
def test_only_this_servers_names_are_taken_for_it(host: str, allowed: bool) -> None:
    config = ServerConfig(host="box.local", token_file="x")
    headers = [(b"host", host.encode())]
    assert (refusal(headers, config, "192.168.1.5") == "") is allowed


def test_all_addresses_are_a_place_to_listen_and_no_name() -> None:
    config = ServerConfig(host="0.0.0.0", token_file="x")
    assert refusal([(b"host", b"0.0.0.0")], config, "192.168.1.5")
    assert refusal([(b"host", b"192.168.1.5:80")], config, "192.168.1.5") == ""
    assert refusal([(b"host", b"192.168.1.5:80")], config, "::ffff:192.168.1.5") == ""
    assert refusal([(b"host", b"[fe80::1]:80")], config, "fe80::1") == ""


def test_one_host_must_be_named_and_not_two() -> None:
    assert refusal([], ServerConfig(), None)
    assert refusal([(b"host", b"localhost"), (b"host", b"localhost")], ServerConfig(), None)
    assert host_name("[::1]:7411") == "[::1]"


ORIGINS = [
    ({}, True),
    ({"origin": APP}, True),
    ({"origin": APP, "sec-fetch-site": "cross-site"}, True),
    ({"origin": APP + "/"}, False),
    ({"origin": APP.upper()}, False),
    ({"origin": APP + ":8443"}, False),
    ({"origin": "http://app.example"}, False),
    ({"origin": "https://app.example.evil.example"}, False),
    ({"origin": "null"}, False),
    ({"origin": ""}, False),
    ({"origin": "http://localhost:7411"}, False),
    ({"origin": "http://127.0.0.1:7411"}, False),
    ({"origin": "file://"}, False),
    ({"origin": "http://evil.example"}, False),
    ({"sec-fetch-site": "cross-site"}, False),
    ({"sec-fetch-site": "same-site"}, False),
    ({"sec-fetch-site": "same-origin"}, True),
    ({"sec-fetch-site": "none"}, True),
    ({"sec-fetch-site": ""}, False),
]


@pytest.mark.parametrize(("headers", "allowed"), ORIGINS)
async def test_a_page_is_refused_unless_it_was_invited_and_a_program_is_not(
    headers: dict[str, str], allowed: bool
) -> None:
    """The same for the WebSocket, before it is open, and for all that is served over HTTP."""
    async with serving(origins=(APP,)) as (there, hands):
        for path in ("/healthz", "/metrics", "/v1/schema", "/", "/nope"):
            found = await get(there, path, **headers)
            assert (found.status_code != 403) is allowed, path
        options: dict[str, Any] = {"additional_headers": headers}
        if allowed:
            async with talking(there, **options):
                pass
        else:
            with pytest.raises(InvalidStatus) as caught:
                await connect(there.url, subprotocols=[Subprotocol(JSON_PROTOCOL)], **options)
            assert caught.value.response.status_code == 403
        assert len(hands.clients) == int(allowed)


OWN = [
    ("localhost:7411", "http://localhost:7411", True),
    ("LocalHost:7411", "http://localhost:7411", True),  # a browser writes an origin in lower case
    ("[::1]:7411", "http://[::1]:7411", True),
    ("localhost", "http://localhost", True),
    ("localhost:7411", "http://localhost:8080", False),  # of another program on this machine
    ("localhost:7411", "http://localhost", False),
    ("localhost:7411", "https://localhost:7411", False),
    ("localhost:7411", "http://127.0.0.1:7411", False),
    ("localhost:7411", "http://evil.example:7411", False),
    ("localhost:7411", "null", False),
    ("evil.example:7411", "http://evil.example:7411", False),  # a name that was rebound
]


@pytest.mark.parametrize(("host", "origin", "allowed"), OWN)
def test_the_servers_own_page_is_admitted_and_no_other(
    host: str, origin: str, allowed: bool
) -> None:
    headers = [(b"host", host.encode()), (b"origin", origin.encode())]
    assert (refusal(headers, ServerConfig(), "127.0.0.1") == "") is allowed


def test_two_origins_are_one_too_many() -> None:
    config = ServerConfig(origins=(APP,))
    host = (b"host", b"localhost")
    one = (b"origin", APP.encode())
    assert refusal([host, one], config, None) == ""
    assert refusal([host, one, one], config, None)
    assert refusal([host, one, (b"origin", b"null")], config, None)


async def test_a_rebound_name_gets_nothing() -> None:
    """evil.example now is 127.0.0.1: the page is of the same origin, but the name stays."""
    async with serving() as (there, hands):
        name = f"evil.example:{there.port}"
        for path in ("/healthz", "/metrics", "/v1/schema"):
            found = await get(there, path, host=name)
            assert (found.status_code, found.text) == (403, "Host is not one of this server\n")
        for origin in (None, Origin(f"http://{name}")):
            with pytest.raises(InvalidStatus, match="403"):
                await connect(
                    f"ws://{name}/v1", host="127.0.0.1", port=there.port, origin=origin,
                    subprotocols=[Subprotocol(JSON_PROTOCOL)], proxy=None,
                )  # fmt: skip
        assert hands.clients == []


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
async def test_nothing_is_done_by_http(method: str) -> None:
    async with (
        serving() as (there, _),
        httpx.AsyncClient(trust_env=False, timeout=PATIENCE) as client,
    ):
        for path in ("/", "/healthz", "/metrics", "/v1/schema"):
            url = f"http://127.0.0.1:{there.port}{path}"
            assert (await client.request(method, url)).status_code == 405


# The token


@pytest.fixture
def token_file(tmp_path: Path) -> str:
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    return str(path)


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "PENALTY", 0.01)


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize(
    "said", ["", "wrong", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), TOKEN + "\n", "\0", "µ" * 50]
)
@pytest.mark.parametrize("version", [1, 2])
async def test_a_wrong_token_is_all_that_is_told(said: str, version: int, token_file: str) -> None:
    async with (
        serving(token_file=token_file) as (there, hands),
        talking(there, hello=False) as talker,
    ):
        hello = {"type": "hello", "client": "a", "version": version, "token": said}
        found = await talker.ask(**hello)
        wrong = "wrong token: must be" if said else "must not be empty:"
        assert found == {
            "type": "failure", "code": "unauthorized", "field": "token", "message":
            f"{wrong} one of server.token_file or [[token]] of the configuration",
        }  # fmt: skip
        assert await talker.closed() == (4401, "unauthorized")
        assert hands.clients == []


async def test_the_token_lets_in_and_is_never_logged(
    token_file: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    async with (
        serving(token_file=token_file) as (there, hands),
        talking(there, hello=False) as talker,
    ):
        logging.getLogger("uvicorn.error").setLevel(logging.DEBUG)
        welcome = await talker.ask(type="hello", client="a", token=TOKEN)
        assert welcome["type"] == "welcome"
        async with talking(there, hello=False) as second:
            await second.ask(type="hello", client="b", token=TOKEN)
        assert "arm" in hands.clients[0].roles
        assert (await get(there, "/metrics")).status_code == 401
        wrong = await get(there, "/metrics", authorization="Bearer wrong")
        assert wrong.status_code == 401
        right = await get(there, "/metrics", authorization=f"Bearer {TOKEN}")
        assert right.status_code == 200
        assert (await get(there, "/healthz")).status_code == 200
        assert TOKEN not in repr(there)
    said = [record for record in caplog.records if record.name.startswith(("tactile", "uvicorn"))]
    assert said
    assert all(TOKEN not in f"{record.getMessage()} {record.__dict__}" for record in said)


def test_each_token_has_its_roles_and_none_can_be_read_back() -> None:
    watch, every = frozenset[Role]({"watch"}), ALL_ROLES
    tokens = Tokens([(b"secret", every), (b"another", watch)])
    assert tokens.roles("secret") == every
    assert tokens.roles("another") == watch
    assert tokens.roles("") is None
    assert tokens.roles("secre") is None
    assert "secret" not in repr(vars(tokens))
    assert tokens
    assert not Tokens()


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_without_a_token_others_cannot_be_listened_to(host: str) -> None:
    """A name that seemed to be this machine may turn out to be more."""
    config = ServerConfig(host=host, port=0, token_file="x", socket="")
    message = r"which others can reach: server\.token_file must be given"
    with pytest.raises(InputError, match=message), bound_sockets(config, guarded=False):
        pass


# One client and the others


async def test_one_client_more_than_may_be_can_only_estop_and_a_place_becomes_free_again() -> None:
    async with serving(most_clients=2) as (there, hands):
        async with talking(there) as first, talking(there):
            async with talking(there, hello=False) as third:
                welcome = await third.ask(type="hello", client="panel", id=7)
                assert (welcome["id"], welcome.get("roles")) == (7, None)
                assert welcome["may_arm"] is False
                for message in (CONTACT, dict(GOOD["gain"][0], id=3)):
                    found = await third.ask(**message)
                    assert found["code"] == "too_many_clients"
                    assert "server.most_clients" in found["message"]
                assert (await third.ask(type="estop", id=8))["type"] == "done"
                assert [type(c) for c in hands.clients[2].commands] == [EStop]
                assert hands.clients[2].contacts == []
            assert (await first.ask(type="ping", time_us=1))["type"] == "pong"
        await until(lambda: len(there.site.places) == 0)
        async with talking(there):
            assert "arm" in hands.clients[3].roles
        await until(lambda: [hand.closed for hand in hands.clients] == [1] * 4)


async def test_the_oldest_that_may_only_estop_makes_room_once_it_had_its_chance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with AsyncExitStack() as stack:
        there, _ = await stack.enter_async_context(serving(most_clients=1))
        talkers = [await stack.enter_async_context(talking(there)) for _ in range(1 + 4)]
        monkeypatch.setattr(places, "CHANCE", 1e9)
        async with talking(there, hello=False) as late:
            found = await late.ask(type="hello", client="late", id=7)
            assert (found["code"], found["id"]) == ("too_many_clients", 7)
            assert (await late.closed())[0] == 4429
        monkeypatch.setattr(places, "CHANCE", 0.0)
        async with talking(there) as newer:
            assert (await talkers[1].closed())[0] == 4429
            for talker in (newer, talkers[2], talkers[-1]):
                assert (await talker.ask(type="estop"))["type"] == "done"
            assert (await talkers[0].ask(type="ping", time_us=1))["type"] == "pong"


async def test_strangers_make_room_for_newer_ones_and_never_for_longer_than_it_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """TCP connections and WebSockets that say nothing; clients stay, and new ones get in."""
    monkeypatch.setattr(listening, "MOST_STRANGERS", 4)
    async with serving() as (there, _), talking(there) as first:
        silent = [
            await asyncio.open_connection("127.0.0.1", there.port) for _ in range(3)
        ]  # fmt: skip
        monkeypatch.setattr(connection, "HELLO_WITHIN", 0.05)
        async with talking(there, hello=False) as stranger:
            silent += [
                await asyncio.open_connection("127.0.0.1", there.port) for _ in range(5)
            ]  # fmt: skip
            await stranger.closed()
        monkeypatch.setattr(connection, "HELLO_WITHIN", PATIENCE)
        for reader, _ in silent[:4]:
            with suppress(ConnectionError):
                assert await reader.read() == b""
        for _ in range(3):
            async with talking(there):
                pass
        assert figure(there, "tactile_dropped_connections_total") >= 5
        assert (await first.ask(type="ping", time_us=1))["type"] == "pong"
        assert (await get(there, "/healthz")).status_code == 200
        for _, writer in silent:
            writer.close()


class Line:
    """A transport that notes its end."""

    def __init__(self) -> None:
        self.aborted = 0

    def abort(self) -> None:
        self.aborted += 1


def test_the_oldest_stranger_goes_first_of_those_that_asked_for_nothing() -> None:
    dropped: list[None] = []
    lines: list[Any] = [Line() for _ in range(6)]
    strangers = sockets.Strangers(2, lambda: dropped.append(None))
    strangers.admit(lines[0], asking=False)
    strangers.admit(lines[1], asking=False)
    strangers.admit(lines[0], asking=True)
    strangers.admit(lines[2], asking=False)
    strangers.admit(lines[3], asking=True)
    assert [line.aborted for line in lines] == [0, 1, 1, 0, 0, 0]
    strangers.admit(lines[4], asking=False)
    assert [line.aborted for line in lines] == [1, 1, 1, 0, 0, 0], "where all of them ask"
    strangers.release(lines[4])
    strangers.admit(lines[5], asking=False)
    assert (len(strangers), len(dropped)) == (2, 3)


async def test_a_client_that_sends_too_fast_is_told_once_loses_messages_and_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 1000.0
    monkeypatch.setattr(connection, "loop_time", lambda: now)
    async with serving(messages_per_second=10) as (there, hands), talking(there) as talker:
        for _ in range(300):
            await talker.send(**CONTACT)
        found = await talker.receive()
        assert found["code"] == "too_fast"
        assert "at most 10 a second" in found["message"]
        await talker.send(type="estop", id=9)
        assert (await talker.receive())["id"] == 9, "an e-stop is never too much"
        assert len(hands.clients[0].contacts) == 10
        now += 0.2
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
        assert figure(there, "tactile_dropped_messages_total", reason="too_fast") == 290


async def test_a_burst_is_taken_in_small_portions_so_that_others_get_their_turn() -> None:
    """1500 contacts that lie in the socket's buffer at once; a chunk of 4 KiB holds 29."""
    text = json.dumps(CONTACT).encode()
    async with serving(messages_per_second=100_000) as (there, hands), talking(there) as calm:
        link = await unread(there)
        await until(lambda: len(hands.clients) == 2)
        sending = asyncio.create_task(
            asyncio.get_running_loop().sock_sendall(link, 1500 * frame(0x81, text))
        )
        most, seen, asked = 0, 0, 0
        while len(hands.clients[1].contacts) < 1500:
            if seen > 100 * asked:
                asked += 1
                assert (await calm.ask(type="ping", time_us=1, id=asked))["id"] == asked
            else:
                seen = len(hands.clients[1].contacts)
                await asyncio.sleep(0)
                most = max(most, len(hands.clients[1].contacts) - seen)
        await sending
        assert asked > 10
        assert most < 3 * 29
        link.close()


async def test_a_client_that_does_not_read_is_dropped_and_another_does_not_notice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "READ_WITHIN", 0.2)
    monkeypatch.setattr(sockets, "LINGER", 0.1)
    async with serving() as (there, hands):
        with await unread(there):
            await until(lambda: len(hands.clients) == 1)
            hand = hands.clients[0]
            async with talking(there) as other:
                for number in range(2000):
                    if hand.closed:
                        break
                    if not hand.outbox.full():
                        hand.outbox.put_nowait(LARGE)
                    assert (await other.ask(type="ping", time_us=1, id=number))["id"] == number
                await until(lambda: hand.closed == 1)
                await until(lambda: len(there.site.places) == 1)
                assert not hands.clients[1].closed


@pytest.mark.parametrize("flood", ["pings", "fragments"])
async def test_frames_that_carry_nothing_do_not_pile_up(
    flood: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sends pings whose pongs it does not read, another a message of fragments without end."""
    monkeypatch.setattr(sockets, "MOST_UNREAD", 4096)
    async with serving() as (there, hands):
        link = await unread(there)
        await until(lambda: len(hands.clients) == 1)
        loop = asyncio.get_running_loop()
        frames = frame(0x89, b"x" * 125) if flood == "pings" else frame(0x00, b"")
        if flood == "fragments":
            await loop.sock_sendall(link, frame(0x01, b""))

        async def pour_frames() -> None:
            with suppress(ConnectionError):
                while True:
                    await loop.sock_sendall(link, frames * 20)
                    await asyncio.sleep(0)

        pouring = asyncio.create_task(pour_frames())
        # long before the pong that is missing would end it
        await until(lambda: hands.clients[0].closed == 1)
        pouring.cancel()
        await asyncio.wait({pouring})
        link.close()
