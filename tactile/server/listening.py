"""Listening sockets of the server: TCP, and on Linux a Unix socket that only its user can open."""

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
"""Interval of uvicorn's pings and time to answer one [s]."""
LARGEST_READ = 2 * LARGEST_MESSAGE
"""Largest message that is still answered by a failure [bytes]; a larger one is not read."""
MOST_STRANGERS = 256
"""Maximum number of connections that have not identified themselves."""
AT_ONCE, WAITING = 4, 128
"""Number of connections that are accepted in one turn of the event loop, and number that may
wait."""
CLOSE_WITHIN = 0.1
"""Time for connections to end, once all displays are at 0 V [s]."""

TURNS = 3
"""Number of turns of the event loop after which an accepted connection can be closed."""


class Listener(uvicorn.Server):
    """Server of uvicorn with limits and without signal handlers, as the program has its own.

    Parameters
    ----------
    app : ASGIApp
        Application to serve.
    site : Site
        What all connections share.
    """

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
        """Capture no signals.

        Yields
        ------
        None
            Nothing.
        """
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start accepting `AT_ONCE` connections in a turn; more than those may wait.

        Parameters
        ----------
        sockets : list of socket, optional
            Bound sockets.
        """
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(WAITING)  # asyncio has one parameter for both

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End all connections within a bounded time, whether or not the other side closes them.

        Parameters
        ----------
        sockets : list of socket, optional
            Bound sockets.
        """
        loop = asyncio.get_running_loop()
        for server in self.servers:
            for listening in server.sockets:
                with suppress(NotImplementedError):  # the event loop of Windows has no readers
                    loop.remove_reader(listening)
        for _ in range(TURNS):  # asyncio does not yet know a connection that it has just accepted
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
    """Bind each address of the host, all with one port, and the Unix socket; close them at the end.

    Parameters
    ----------
    config : ServerConfig
        Where to listen.
    guarded : bool
        Whether a token is required to connect.

    Yields
    ------
    list of socket
        Bound sockets, those of TCP first.

    Raises
    ------
    InputError
        If the host does not exist, the port or the socket is taken, or other machines could connect
        without a token.
    """
    with ExitStack() as stack:
        sockets = _bind_addresses(config, stack, guarded=guarded)
        local = stack.enter_context(_listening_locally(config))
        yield sockets if local is None else [*sockets, local]


def _bind_addresses(
    config: ServerConfig, stack: ExitStack, *, guarded: bool
) -> list[socket.socket]:
    """Bind a socket to each address of the host, all with one port; the stack closes them.

    Raises
    ------
    InputError
        If the host does not exist, the port is taken, or other machines could connect without a
        token.
    """
    port, sockets = config.port, list[socket.socket]()
    try:
        addresses = socket.getaddrinfo(config.host, port, type=socket.SOCK_STREAM)
        for family, kind, protocol, _, address in dict.fromkeys(addresses):
            if not guarded and not is_loopback(str(address[0])):
                raise InputError(
                    f"server.host = {config.host!r}: is {address[0]}, which others can reach: "
                    "server.token_file must be given, or a [[token]]"
                )
            bound = socket.socket(family, kind, protocol)  # with its protocol, for TCP_NODELAY
            sockets.append(stack.enter_context(bound))
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            bound.bind((address[0], port, *address[2:]))
            port = bound.getsockname()[1]
    except OSError as error:
        raise InputError(f"server: {config.host!r} port {port}: {error.strerror}") from error
    return sockets


@contextmanager
def _listening_locally(config: ServerConfig) -> Iterator[socket.socket | None]:
    """Listen at the Unix socket; at its usual place only if that is possible."""
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
    inode = path.lstat().st_ino
    try:
        yield local
    finally:
        local.close()
        with suppress(OSError):  # the socket was removed already
            if path.lstat().st_ino == inode:
                path.unlink()


def listen_locally(path: Path, group: str | None = None) -> socket.socket:
    """Bind a Unix socket that only this user may open, and a group if there is one.

    Parameters
    ----------
    path : Path
        Path of the socket; its folder is created if it does not exist.
    group : str, optional
        Group that may open the socket as well.

    Returns
    -------
    socket
        Bound socket.

    Raises
    ------
    InputError
        If somebody listens there already, something else is there, or the socket cannot be created.
    """
    field = f"server.socket = {str(path)!r}"
    with ExitStack() as failing:
        local = failing.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            _remove_stale(path, field)
            local.bind(str(path))  # nobody can connect yet: it does not listen
            path.chmod(0o600)
            if group is not None:
                shutil.chown(path, group=group)
                path.chmod(0o660)
        except LookupError as error:
            text = f"server.socket_group = {group!r}: there is no such group"
            raise InputError(text) from error
        except OSError as error:
            raise InputError(f"{field}: cannot be made: {error.strerror or error}") from error
        failing.pop_all()
    return local


def _remove_stale(path: Path, field: str) -> None:
    """Remove a socket at which nobody listens any more."""
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise InputError(f"{field}: exists and is not a socket: name another path")
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
        f"{field}: a server listens there: end it, or set another server.socket, or '' for none"
    )
