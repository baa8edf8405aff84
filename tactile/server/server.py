"""Server: a WebSocket at ``/v1``; page, schema, health and metrics over HTTP; OSC besides.

At the end, nobody is admitted any more and all clients are told, then the displays fade and are
disarmed, and only then are connections cut. `serve` is the process, `running` the same inside
another program.
"""

import asyncio
import json
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from tactile import messages
from tactile.errors import InputError, TactileError
from tactile.playback.priority import shorten_collections
from tactile.server import watchdog
from tactile.server.config import Configuration, read_tokens
from tactile.server.connection import Site, talk
from tactile.server.host import Host
from tactile.server.listening import Listener, bound_sockets
from tactile.server.liveness import watch_clients
from tactile.server.logs import Logs
from tactile.server.metrics import Metrics
from tactile.server.osc import ROOM, OscProtocol
from tactile.server.page import PageFiles
from tactile.server.security import Door, Tokens
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.server")

LOOPBACK = "127.0.0.1"
"""Loopback address."""


@dataclass(frozen=True)
class Server:
    """Running server.

    Attributes
    ----------
    url : str
        URL for `tactile.connect`.
    page : str
        URL of the page for a browser.
    port : int
        TCP port.
    site : Site
        What its connections share, including the host.
    serving : asyncio.Task
        Task that ends if listening fails.
    """

    url: str
    page: str
    port: int
    site: Site
    serving: "asyncio.Task[None]"

    @property
    def host(self) -> Host:
        """All displays and their clients."""
        return self.site.host


def application(site: Site) -> ASGIApp:
    """Create the application with all routes, behind the door.

    Parameters
    ----------
    site : Site
        What all connections share.

    Returns
    -------
    ASGIApp
        Application for `Listener`.
    """
    schema_json = json.dumps(messages.schema()).encode()

    async def connect(socket: WebSocket) -> None:
        await talk(socket, site)

    async def health(request: Request) -> Response:
        good = site.host.healthy() and not site.ending
        names = [display.name for display in site.host.displays]
        content = {"status": "ok" if good else "failing", "displays": names}
        return JSONResponse(content, 200 if good else 503)

    async def figures(request: Request) -> Response:
        return Response(site.metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    async def shape(request: Request) -> Response:
        return Response(schema_json, media_type="application/schema+json")

    app = Starlette(
        routes=[
            WebSocketRoute(messages.PATH, connect),
            Route("/healthz", health),
            Route("/metrics", figures),
            Route(f"{messages.PATH}/schema", shape),
            Mount("/", PageFiles()),
        ]
    )
    app.router.redirect_slashes = False
    return Door(app, site.config, site.tokens)


@asynccontextmanager
async def _osc(config: Configuration, site: Site) -> AsyncIterator[None]:
    """Listen for OSC, if the configuration says so.

    Raises
    ------
    InputError
        If the port is taken.
    """
    if not config.osc.port:
        yield
        return
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        link.setblocking(False)
        try:
            link.bind((LOOPBACK, config.osc.port))
        except OSError as error:
            text = f"osc.port = {config.osc.port}: {error.strerror}; 0 is off"
            raise InputError(text) from error
        protocol = OscProtocol(link, site.host, site.metrics, config.server.messages_per_second)
        transport, _ = await loop.create_datagram_endpoint(lambda: protocol, sock=link)
        watching = start_task(protocol.forget_silent())
        try:
            yield
        finally:
            transport.close()
            watching.cancel()
            await protocol.finish()


def _version() -> str:
    try:
        return version("tactile-display")
    except PackageNotFoundError:
        return "0"


@asynccontextmanager
async def running(
    config: Configuration,
    *,
    host: Host | None = None,
    dropped_logs: Callable[[], float] = lambda: 0,
) -> AsyncIterator[Server]:
    """Run the server in this event loop; port 0 takes a free one.

    Parameters
    ----------
    config : Configuration
        Configuration, as returned by `load_config`.
    host : Host, optional
        What to serve; by default, the host of the configuration.
    dropped_logs : callable
        Function that returns the number of log lines that were not written.

    Yields
    ------
    Server
        The running server, which ends with the ``with`` block.

    Raises
    ------
    InputError
        If the server cannot listen.
    """
    tokens = Tokens(read_tokens(config))
    host = Host(config) if host is None else host
    with bound_sockets(config.server, guarded=bool(tokens)) as sockets:
        site = Site(host, config.server, Metrics(host, dropped_logs), tokens, _version())
        listener = Listener(application(site), site)
        try:
            await host.start()
            async with _osc(config, site), _watching_clients(site):
                serving = asyncio.create_task(listener.serve(sockets))
                try:
                    while not listener.started and not serving.done():
                        await asyncio.sleep(0.002)
                    place, port = _place(sockets[0]), sockets[0].getsockname()[1]
                    url, page = f"ws://{place}{messages.PATH}", f"http://{place}/"
                    yield Server(url, page, port, site, serving)
                finally:
                    site.end()
                    await host.close()
                    listener.should_exit = True
                    await serving
        finally:
            await host.close()


@asynccontextmanager
async def _watching_clients(site: Site) -> AsyncIterator[None]:
    """Watch whether the clients are alive; if that fails, all displays are disarmed."""
    task = start_task(watch_clients(lambda: site.places), site.host.degrade)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait({task})


def _place(listening: socket.socket) -> str:
    """Return host and port of a socket as in a URL."""
    address, port = listening.getsockname()[:2]
    name = {"0.0.0.0": LOOPBACK, "::": "::1"}.get(address, address)
    return f"{f'[{name}]' if ':' in name else name}:{port}"


def serve(config: Configuration, ready: Callable[[Server], None] | None = None) -> None:
    """Run the server until SIGINT or SIGTERM; SIGHUP reads textures and configuration again.

    Parameters
    ----------
    config : Configuration
        Configuration, as returned by `load_config`.
    ready : callable, optional
        Function that is called with the running `Server`.

    Raises
    ------
    TactileError
        If the server cannot start.
    KeyboardInterrupt
        If SIGINT arrived before the server was ready.
    """
    logs = Logs(config.log)
    received: set[int] = set()
    try:
        asyncio.run(_serve(config, logs, ready, received))
    except asyncio.CancelledError:  # by a signal, while displays were opened
        if signal.SIGINT in received:
            raise KeyboardInterrupt from None
    finally:
        logs.close()


async def _serve(
    config: Configuration,
    logs: Logs,
    ready: Callable[[Server], None] | None,
    received: set[int],
) -> None:
    """Run the server until a signal is received, which is added to those received."""
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    starting = asyncio.current_task()
    signals = (signal.SIGINT, signal.SIGTERM)

    def stop(number: int) -> None:
        received.add(number)
        end.set()
        for handled in signals:  # the next signal ends the server at once
            loop.remove_signal_handler(handled)
        if starting is not None:
            starting.cancel()

    with suppress(NotImplementedError):  # on systems without such signals
        for number in signals:
            loop.add_signal_handler(number, stop, number)
    async with running(config, dropped_logs=lambda: logs.dropped) as server:
        starting = None
        reloading = Reloading(server.host)
        with suppress(NotImplementedError, AttributeError):
            loop.add_signal_handler(signal.SIGHUP, reloading.begin)
        beating = start_task(watchdog.keep_alive(server.host.beat))
        shorten_collections()
        log.info("listening", extra={"fields": {"url": server.url, "osc": config.osc.port}})
        watchdog.notify("READY=1")
        if ready is not None:
            ready(server)
        ended = asyncio.create_task(end.wait())
        await asyncio.wait({ended, server.serving}, return_when=asyncio.FIRST_COMPLETED)
        watchdog.notify("STOPPING=1")
        log.info("shutting down")
        for task in (ended, beating, *reloading.tasks):
            task.cancel()


class Reloading:
    """Reloads of textures and configuration, one after the other; a mistake is only logged.

    Parameters
    ----------
    host : Host
        Host to reload.

    Attributes
    ----------
    tasks : set of asyncio.Task
        Reloads under way.
    """

    def __init__(self, host: Host) -> None:
        self.tasks: set[asyncio.Task[None]] = set()
        self._host, self._lock = host, asyncio.Lock()

    def begin(self) -> None:
        """Start a reload in the background."""
        start_task(self._reload(), among=self.tasks)

    async def _reload(self) -> None:
        async with self._lock:
            try:
                await self._host.reload()
                log.info("reloaded")
            except TactileError as error:
                log.error("not reloaded", extra={"fields": {"why": str(error)}})
            except Exception:
                log.exception("not reloaded")
