"""Where the daemon listens: TCP, and on Linux a Unix socket that only its user can open."""

import asyncio
import logging
import os
import shutil
import socket
import stat
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp

from tactile.errors import InputError
from tactile.messages import LARGEST_MESSAGE
from tactile.paths import API_SOCKET, runtime_folder
from tactile.server.config import ServerConfig, is_loopback
from tactile.server.connection import Site
from tactile.server.sockets import BoundedHttp, BoundedState, BoundedWebSocket, Strangers

log = logging.getLogger("tactile.server")

PING_EVERY, PONG_WITHIN = 5.0, 5.0
LARGEST_READ = 2 * LARGEST_MESSAGE
"""Bytes of a message that is still answered with what is wrong; a larger one is not read."""
MOST_STRANGERS = 256
"""Connections that did not say who they are."""
AT_ONCE, WAITING = 4, 128
"""Connections that are accepted before anything else gets its turn, and that wait for that."""
CLOSE_WITHIN = 0.1
"""s for connections to end, once all displays are at 0 V."""

TURNS = 3
"""Turns of the event loop until a connection that was accepted is one that can be closed."""


class Listener(uvicorn.Server):
    """uvicorn with bounds, without its signal handlers: whoever runs us has theirs."""

    def __init__(self, app: ASGIApp, site: Site) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=BoundedHttp,
                ws=BoundedWebSocket,
                ws_max_size=LARGEST_READ,
                ws_ping_interval=PING_EVERY,
                ws_ping_timeout=PONG_WITHIN,
                ws_per_message_deflate=False,
                lifespan="off",
                log_config=None,
                log_level="warning",
                access_log=False,
                proxy_headers=False,
                server_header=False,
                backlog=AT_ONCE,
                h11_max_incomplete_event_size=16 * 1024,
            )
        )
        strangers = Strangers(MOST_STRANGERS, site.metrics.strangers.inc)
        self.server_state: BoundedState = BoundedState(strangers)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to accept `AT_ONCE` connections in a turn; more than those may wait."""
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(WAITING)  # asyncio has one number for both

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End all connections within a bounded time, whether or not the other side closes them."""
        loop = asyncio.get_running_loop()
        for server in self.servers:
            for one in server.sockets:
                with suppress(NotImplementedError):  # the event loop of Windows has no readers
                    loop.remove_reader(one)
        for _ in range(TURNS):  # asyncio forgets a connection that it has just accepted
            await asyncio.sleep(0)
        for server in self.servers:
            server.close()
        connections, tasks = self.server_state.connections, self.server_state.tasks
        for connection in list(connections):
            if isinstance(connection, BoundedHttp):
                connection.shutdown()
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_WITHIN):
                while connections:
                    await asyncio.sleep(0.005)
        for connection in list(connections):
            connection.transport.abort()
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=CLOSE_WITHIN)


@contextmanager
def bound_sockets(config: ServerConfig, *, guarded: bool) -> Iterator[list[socket.socket]]:
    """Bind each address of the host, all with one port, and the Unix socket; close them at last.

    Raises
    ------
    InputError
        Where the host is none, the port or the socket is taken, or others could connect and need
        no token.
    """
    with ExitStack() as stack:
        sockets = listen(config, guarded=guarded)
        for one in sockets:
            stack.callback(one.close)
        local = stack.enter_context(_listening_locally(config))
        yield sockets if local is None else [*sockets, local]


def listen(config: ServerConfig, *, guarded: bool) -> list[socket.socket]:
    """Return a bound socket for each address of the host; all have one port.

    Raises
    ------
    InputError
        Where the host is none, the port is taken, or others could connect and need no token.
    """
    port, sockets = config.port, list[socket.socket]()
    try:
        found = socket.getaddrinfo(config.host, port, type=socket.SOCK_STREAM)
        for family, kind, protocol, _, address in dict.fromkeys(found):
            if not guarded and not is_loopback(str(address[0])):
                raise InputError(
                    f"server.host = {config.host!r}: is {address[0]}, which others can reach: "
                    "server.token_file must be given, or a [[token]]"
                )
            one = socket.socket(family, kind, protocol)  # with its protocol, for TCP_NODELAY
            sockets.append(one)
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            one.bind((address[0], port, *address[2:]))
            port = one.getsockname()[1]
    except (OSError, InputError) as error:
        for one in sockets:
            one.close()
        if isinstance(error, InputError):
            raise
        raise InputError(f"server: {config.host!r} port {port}: {error.strerror}") from error
    return sockets


@contextmanager
def _listening_locally(config: ServerConfig) -> Iterator[socket.socket | None]:
    """Listen at the Unix socket; at its usual place only where that is possible."""
    if config.socket == "" or (config.socket is None and sys.platform != "linux"):
        yield None
        return
    try:
        path = Path(config.socket or runtime_folder() / API_SOCKET)
        local = listen_locally(path, config.socket_group)
    except (InputError, OSError) as error:
        if config.socket is not None or config.socket_group is not None:
            raise InputError(str(error)) from error
        log.warning("no Unix socket; TCP only", extra={"fields": {"why": str(error)}})
        yield None
        return
    made = path.lstat().st_ino
    try:
        yield local
    finally:
        local.close()
        with suppress(OSError):  # it is gone already
            if path.lstat().st_ino == made:
                path.unlink()


def listen_locally(path: Path, group: str | None = None) -> socket.socket:
    """Return a bound Unix socket that only this user may open, or a group as well.

    Raises
    ------
    InputError
        Where somebody listens there already, something else is there, or it cannot be made.
    """
    field = f"server.socket = {str(path)!r}"
    local = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _remove_stale(path, field)
        local.bind(str(path))  # nobody can connect yet: it does not listen
        path.chmod(0o600)
        if group is not None:
            shutil.chown(path, group=group)
            path.chmod(0o660)
    except LookupError as error:
        local.close()
        raise InputError(f"server.socket_group = {group!r}: there is no such group") from error
    except OSError as error:
        local.close()
        raise InputError(f"{field}: cannot be made: {error.strerror or error}") from error
    except InputError:
        local.close()
        raise
    return local


def _remove_stale(path: Path, field: str) -> None:
    """Remove a socket at which nobody listens any more."""
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise InputError(f"{field}: is there, and no socket: name another path")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:  # its backlog is full
            pass
    raise InputError(
        f"{field}: a daemon listens there: end it, or set another server.socket, or '' for none"
    )
