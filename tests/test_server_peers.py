"""Tests of who connects, by which way, and what that allows: users, sockets, tokens, roles."""

import logging
import os
import socket
import stat
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from server_rig import PATIENCE, Hands, Talker, connect, get, serving, talking, unix_connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

from tactile.errors import InputError
from tactile.messages import JSON_PROTOCOL, Role
from tactile.paths import API_SOCKET
from tactile.server import connection, peers
from tactile.server.config import Configuration, ServerConfig, TokenConfig
from tactile.server.listening import listen_locally
from tactile.server.peers import PeerCredentials, local_peer, roles_of_user, tcp_peer, user_in
from tactile.server.server import running

pytestmark = [
    pytest.mark.usefixtures("patient"),
    pytest.mark.skipif(sys.platform != "linux", reason="users of peers are told by Linux"),
]
PROTOCOL = Subprotocol(JSON_PROTOCOL)
ALL_ROLES: frozenset[Role] = frozenset({"watch", "play", "arm", "stop"})
"""All roles that docs/guide/server.md names."""

# Users

HEAD = b"  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout"
TABLE = HEAD + b" inode\n" + b"".join(
    b"   %d: %s 00000000:00000000 00:00000000 00000000 %5d        0 %d 1 0000000000000000\n" % row
    for row in [
        (0, b"0100007F:1CF3 00000000:0000 0A", 0, 11),
        (1, b"0100007F:1CF3 0100007F:C350 01", 0, 12),
        (2, b"0100007F:C350 0100007F:1CF3 01", 1000, 13),
        (3, b"0100007F:C351 0100007F:1CF3 06", 0, 0),
        (4, b"0100007F:C352 0100007F:1CF3 05", 0, 0),
        (5, b"0100007F:C353 0100007F:1CF3 01", 0, 0),
        (6, b"0100007F:C354 0100007F:1CF3 01", 0, 14),
        (7, b"0100007F:C355 0100007F:1CF4 01", 0, 15),
        (8, b"0100007F:C356 0100007F:1CF3 05", 0, 16),
    ]
)  # fmt: skip
"""Table of TCP connections in the form that proc(5) describes, on a little-endian machine."""


@pytest.mark.skipif(sys.byteorder != "little", reason="the table is of a little-endian machine")
@pytest.mark.parametrize(
    ("port", "user"),
    [
        (50000, 1000),
        (50001, None),  # TIME_WAIT, which has no user and says 0
        (50002, None),  # its end is closed: what it sent before is nobody's
        (50003, None),  # no socket any more
        (50004, 0),
        (50005, None),  # connected to another port
        (50006, None),  # says no more, as its end is half closed
        (50007, None),
    ],
)
def test_the_user_is_that_of_the_peers_end_as_long_as_it_is_open(
    port: int, user: int | None
) -> None:
    assert user_in(TABLE, ("127.0.0.1", port), ("127.0.0.1", 0x1CF3)) == user


@pytest.mark.parametrize("address", ["127.0.0.1", "::1"])
def test_the_kernel_knows_the_user_of_a_tcp_peer(address: str) -> None:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family) as server:
        try:
            server.bind((address, 0))
        except OSError:
            pytest.skip(f"no {address} here")
        server.listen()
        with socket.create_connection(server.getsockname()[:2]) as peer:
            ours, _ = server.accept()
            with ours:
                assert tcp_peer(ours) == PeerCredentials(os.geteuid())
                peer.close()
                assert tcp_peer(ours) is None


def test_the_kernel_knows_user_and_process_of_a_local_peer() -> None:
    ours, peer = socket.socketpair(socket.AF_UNIX)
    with ours, peer:
        assert local_peer(ours) == PeerCredentials(os.geteuid(), os.getpid())


def test_this_user_and_root_may_do_all_and_others_watch_and_stop() -> None:
    assert roles_of_user(PeerCredentials(os.geteuid())) == ALL_ROLES
    assert roles_of_user(PeerCredentials(0)) == ALL_ROLES
    assert roles_of_user(PeerCredentials(os.geteuid() + 1)) == {"watch", "stop"}
    assert roles_of_user(None) == {"watch", "stop"}


async def test_another_user_who_comes_by_tcp_may_watch_and_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(peers, "tcp_peer", lambda _: PeerCredentials(os.geteuid() + 1))
    async with serving() as (there, hands), talking(there, hello=False) as talker:
        welcome = await talker.ask(type="hello", client="other")
        assert welcome["roles"] == ["stop", "watch"]
        assert welcome["may_arm"] is False
        assert hands.clients[0].roles == {"watch", "stop"}


# Tokens


def token(folder: Path, name: str, *roles: Any) -> TokenConfig:
    path = folder / name
    path.write_text(f"{name}-nobody-guesses")
    path.chmod(0o600)
    return TokenConfig(file=str(path), roles=roles or tuple(sorted(ALL_ROLES)))


async def test_a_token_gives_its_roles_and_figures_are_for_those_who_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "PENALTY", 0.0)
    kinds: list[tuple[str, ...]] = [("all",), ("game", "play"), ("w", "watch")]
    tokens = tuple(token(tmp_path, *kind) for kind in kinds)
    async with serving(token=tokens) as (there, _):
        for name, roles in [
            ("all", ["arm", "play", "stop", "watch"]), ("game", ["play"]), ("w", ["watch"]),
        ]:  # fmt: skip
            said = f"{name}-nobody-guesses"
            async with talking(there, hello=False) as talker:
                welcome = await talker.ask(type="hello", client="a", token=said)
                assert welcome["roles"] == roles
                assert welcome["may_arm"] is ("arm" in roles)
            found = await get(there, "/metrics", authorization=f"Bearer {said}")
            assert found.status_code == (200 if "watch" in roles else 401)
        async with talking(there, hello=False) as talker:
            refused = await talker.ask(type="hello", client="a")
            assert "server.token_file or [[token]]" in refused["message"]


# The Unix socket


@asynccontextmanager
async def talking_locally(path: Path) -> AsyncIterator[Talker]:
    async with unix_connect(str(path), "ws://localhost/v1", subprotocols=[PROTOCOL]) as link:
        yield Talker(link, JSON_PROTOCOL)


async def test_who_may_open_the_socket_may_do_all_without_a_token(tmp_path: Path) -> None:
    path = tmp_path / "new" / "socket"
    options: Any = {"token": (token(tmp_path, "t", "watch"),), "socket": str(path)}
    async with serving(**options) as (there, hands):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        async with talking_locally(path) as talker:
            welcome = await talker.ask(type="hello", client="local")
            assert set(welcome["roles"]) == ALL_ROLES
            assert (await talker.ask(type="estop"))["type"] == "done"
        async with talking_locally(path) as talker:  # a token that is said decides
            welcome = await talker.ask(type="hello", client="a", token="t-nobody-guesses")
            assert welcome["roles"] == ["watch"]
        async with talking_locally(path) as talker:
            refused = await talker.ask(type="hello", client="a", token="wrong")
            assert refused["code"] == "unauthorized"
        transport = httpx.AsyncHTTPTransport(uds=str(path))
        async with httpx.AsyncClient(transport=transport, timeout=PATIENCE) as client:
            assert (await client.get("http://localhost/metrics")).status_code == 200
            evil = await client.get("http://localhost/metrics", headers={"host": "evil.example"})
            assert evil.status_code == 403
        assert (await get(there, "/metrics")).status_code == 401
        assert len(hands.clients) == 2
    assert not path.exists()


def test_a_group_may_be_let_in(tmp_path: Path) -> None:
    import grp

    group = grp.getgrgid(os.getegid()).gr_name
    with listen_locally(tmp_path / "socket", group):
        found = (tmp_path / "socket").stat()
        assert (stat.S_IMODE(found.st_mode), found.st_gid) == (0o660, os.getegid())
    with pytest.raises(InputError, match=r"server\.socket_group = 'no such one': there is no such"):
        listen_locally(tmp_path / "another", "no such one")


def test_a_socket_that_nobody_listens_at_is_replaced_and_one_in_use_is_not(tmp_path: Path) -> None:
    path = tmp_path / "socket"
    listen_locally(path).close()
    assert path.is_socket(), "as a server leaves it that was killed"
    with listen_locally(path) as local:
        local.listen()
        with pytest.raises(InputError, match=r"a server listens there: end it, or set another"):
            listen_locally(path)
    path.unlink()
    path.write_text("")
    with pytest.raises(InputError, match="exists and is not a socket"):
        listen_locally(path)
    with pytest.raises(InputError, match="cannot be made: "):
        listen_locally(tmp_path / ("x" * 200))


async def test_a_second_server_goes_on_without_the_usual_socket_and_leaves_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    config = Configuration(server=ServerConfig(port=0))
    async with running(config, host=Hands()):
        assert "no Unix socket" not in caplog.text
        async with running(config, host=Hands()) as second, talking(second):
            assert "no Unix socket; TCP only" in caplog.text
        async with talking_locally(tmp_path / API_SOCKET) as talker:
            assert (await talker.ask(type="hello", client="a"))["type"] == "welcome"
        named = Configuration(server=ServerConfig(port=0, socket=str(tmp_path / API_SOCKET)))
        with pytest.raises(InputError, match="a server listens there"):
            async with running(named, host=Hands()):
                pass
    assert not (tmp_path / API_SOCKET).exists()


# Pages that are not invited


async def test_an_origin_that_is_refused_is_logged_once_with_the_line_that_invites_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.WARNING)
    async with serving(origins=("https://a.example",)) as (there, _):
        for origin in 3 * ["https://b.example"] + ["null"]:
            with pytest.raises(InvalidStatus, match="403"):
                await connect(there.url, subprotocols=[PROTOCOL], origin=Origin(origin))
    found = [r.__dict__["fields"] for r in caplog.records]
    line = '[server] origins = ["https://a.example", "https://b.example"]'
    assert found == [{"origin": "https://b.example", "invite": line}, {"origin": "null"}]
