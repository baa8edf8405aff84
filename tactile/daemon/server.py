"""The daemon: a WebSocket at ``/v1``, its schema, health and figures over HTTP, OSC beside it.

Order at the end: nobody is let in and everybody is told, the displays fade and are disarmed, and
only then are connections cut. `serve` is the process, `running` the same inside another program.
"""

import asyncio
import json
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from tactile.daemon import messages, watchdog
from tactile.daemon.config import Config, ServerConfig, is_loopback, read_token
from tactile.daemon.connection import Site, talk
from tactile.daemon.logs import Logs
from tactile.daemon.metrics import Metrics
from tactile.daemon.osc import OscProtocol
from tactile.daemon.requests import Host
from tactile.daemon.security import Door
from tactile.daemon.sockets import BoundedHttp, BoundedWebSocket
from tactile.errors import InputError, TactileError

log = logging.getLogger("tactile.server")

LOOPBACK = "127.0.0.1"
PING_EVERY, PONG_WITHIN = 5.0, 5.0
LARGEST_READ = 2 * messages.LARGEST_MESSAGE
"""Bytes of a message that is still answered with what is wrong; a larger one is not read."""
MOST_ASIDE = 64
"""HTTP connections besides the clients."""
CLOSE_WITHIN = 2
"""s for connections to end."""


@dataclass(frozen=True)
class Server:
    """A daemon that runs.

    Attributes
    ----------
    url : for `tactile.connect`
    port : TCP port
    site : what its connections share, the host among it
    serving : ends where listening failed
    """

    url: str
    port: int
    site: Site
    serving: "asyncio.Task[None]"

    @property
    def host(self) -> Host:
        """All displays and who plays on them."""
        return self.site.host

    @property
    def metrics(self) -> Metrics:
        """All that is counted."""
        return self.site.metrics


class Listener(uvicorn.Server):
    """uvicorn without its signal handlers: whoever runs us has theirs."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


def application(site: Site) -> ASGIApp:
    """Return all that is served, behind the door."""
    described = json.dumps(messages.schema()).encode()

    async def connect(socket: WebSocket) -> None:
        await talk(socket, site)

    async def about(request: Request) -> Response:
        return PlainTextResponse(f"tactile {site.version}: WebSocket at {messages.PATH}\n")

    async def health(request: Request) -> Response:
        good = site.host.healthy() and not site.ending.is_set()
        names = [display.name for display in site.host.displays]
        content = {"status": "ok" if good else "failing", "displays": names}
        return JSONResponse(content, 200 if good else 503)

    async def figures(request: Request) -> Response:
        return Response(site.metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    async def shape(request: Request) -> Response:
        return Response(described, media_type="application/schema+json")

    app = Starlette(
        routes=[
            WebSocketRoute(messages.PATH, connect),
            Route("/", about),
            Route("/healthz", health),
            Route("/metrics", figures),
            Route(f"{messages.PATH}/schema", shape),
        ]
    )
    app.router.redirect_slashes = False
    return Door(app, site.config, site.token)


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
                    "server.token_file must be given"
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


def _listener(site: Site) -> Listener:
    return Listener(
        uvicorn.Config(
            application(site),
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
            limit_concurrency=site.config.most_clients + MOST_ASIDE,
            h11_max_incomplete_event_size=16 * 1024,
            timeout_graceful_shutdown=CLOSE_WITHIN,
        )
    )


@asynccontextmanager
async def _osc(config: Config, site: Site) -> AsyncIterator[None]:
    """Listen for OSC, where it is wanted.

    Raises
    ------
    InputError
        Where the port is taken.
    """
    if not config.osc.port:
        yield
        return
    protocol = OscProtocol(site.host, site.metrics, config.server.messages_per_second)
    loop = asyncio.get_running_loop()
    try:
        transport, _ = await loop.create_datagram_endpoint(
            lambda: protocol, local_addr=(LOOPBACK, config.osc.port)
        )
    except OSError as error:
        text = f"osc.port = {config.osc.port}: {error.strerror}; 0 is off"
        raise InputError(text) from error
    watching = asyncio.create_task(protocol.forget_silent())
    try:
        yield
    finally:
        transport.close()
        watching.cancel()
        await protocol.finish()


def _host(config: Config) -> Host:
    from tactile.daemon.host import Host as Displays

    return Displays(config)


def _version() -> str:
    try:
        return version("tactile-display")
    except PackageNotFoundError:
        return "0"


@asynccontextmanager
async def running(
    config: Config,
    *,
    host: Host | None = None,
    dropped_logs: Callable[[], float] = lambda: 0,
) -> AsyncIterator[Server]:
    """Run the daemon in this event loop; port 0 takes one that is free.

    Parameters
    ----------
    config : as of `load_config`
    host : what to serve; that of the configuration, unless given
    dropped_logs : how many lines of the log were not written

    Raises
    ------
    InputError
        Where it cannot listen.
    """
    token = read_token(config.server)
    sockets = listen(config.server, guarded=token is not None)
    host = _host(config) if host is None else host
    site = Site(host, config.server, Metrics(host, dropped_logs), token, _version())
    listener = _listener(site)
    try:
        await host.start()
        async with _osc(config, site):
            serving = asyncio.create_task(listener.serve(sockets))
            try:
                while not listener.started and not serving.done():
                    await asyncio.sleep(0.002)
                yield Server(_url(sockets[0]), sockets[0].getsockname()[1], site, serving)
            finally:
                site.ending.set()
                await host.close()
                listener.should_exit = True
                await serving
    finally:
        await host.close()
        for one in sockets:
            one.close()


def _url(listening: socket.socket) -> str:
    address, port = listening.getsockname()[:2]
    name = {"0.0.0.0": LOOPBACK, "::": "::1"}.get(address, address)
    return f"ws://{f'[{name}]' if ':' in name else name}:{port}{messages.PATH}"


def serve(config: Config, ready: Callable[[Server], None] | None = None) -> None:
    """Run the daemon until SIGINT or SIGTERM; SIGHUP reads textures and configuration again.

    Raises
    ------
    TactileError
        Where it cannot begin.
    """
    logs = Logs(config.log)
    try:
        asyncio.run(_serve(config, logs, ready))
    finally:
        logs.close()


async def _serve(config: Config, logs: Logs, ready: Callable[[Server], None] | None) -> None:
    loop, end = asyncio.get_running_loop(), asyncio.Event()

    def stop() -> None:
        end.set()
        for number in (signal.SIGINT, signal.SIGTERM):  # the next one ends it at once
            loop.remove_signal_handler(number)

    with suppress(NotImplementedError):  # where there are no such signals
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop)
    async with running(config, dropped_logs=lambda: logs.dropped) as server:
        reloading = Reloading(server.host)
        with suppress(NotImplementedError, AttributeError):
            loop.add_signal_handler(signal.SIGHUP, reloading.begin)
        beating = asyncio.create_task(watchdog.keep_alive(server.host.beat))
        log.info("listening", extra={"fields": {"url": server.url, "osc": config.osc.port}})
        watchdog.notify("READY=1")
        if ready is not None:
            ready(server)
        ended = asyncio.create_task(end.wait())
        await asyncio.wait({ended, server.serving}, return_when=asyncio.FIRST_COMPLETED)
        watchdog.notify("STOPPING=1")
        log.info("ending")
        for task in (ended, beating, *reloading.tasks):
            task.cancel()


class Reloading:
    """Reads textures and configuration again, one after the other; a mistake is logged."""

    def __init__(self, host: Host) -> None:
        self.tasks: set[asyncio.Task[None]] = set()
        self._host, self._lock = host, asyncio.Lock()

    def begin(self) -> None:
        """Begin to reload."""
        task = asyncio.create_task(self._reload())
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _reload(self) -> None:
        async with self._lock:
            try:
                await self._host.reload()
                log.info("reloaded")
            except TactileError as error:
                log.error("not reloaded", extra={"fields": {"why": str(error)}})
            except Exception:
                log.exception("not reloaded")
