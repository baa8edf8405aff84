"""One WebSocket connection: `ClientHello`, then messages in and answers out.

Contacts are passed on as they come and never queue behind anything. Requests are carried out one
after the other, independently of them. An e-stop waits for no other request, and outlives the
connection that sent it. Whatever a client sends, or does not read, costs that client its
connection, and no other client a block.
"""

import asyncio
import logging
import secrets
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, NamedTuple

from starlette.websockets import WebSocket, WebSocketDisconnect

from tactile.clock import loop_time
from tactile.messages import (
    API_VERSION,
    Answer,
    ClientHello,
    Command,
    EStop,
    Failure,
    Ping,
    Pong,
    Role,
    Streamed,
    Welcome,
    id_of,
    kind_of,
)
from tactile.server.client import Client
from tactile.server.config import ServerConfig
from tactile.server.decoding import ENCODINGS, Encoding, failed, read, read_estop
from tactile.server.host import Host
from tactile.server.liveness import SignsOfLife
from tactile.server.metrics import Metrics
from tactile.server.peers import PeerCredentials, is_local, judge, local_peer
from tactile.server.places import Places
from tactile.server.rates import TokenBucket
from tactile.server.requests import Requests
from tactile.server.security import Tokens
from tactile.server.sockets import BoundedWebSocket
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.server")

HELLO_WITHIN = 2.0
"""Time within which a client must send `ClientHello` [s]."""
READ_WITHIN = 2.0
"""Time after which a client that does not read is disconnected [s]."""
PENALTY = 0.2
"""Time from a wrong token to the answer [s]."""
TOKENS = "one of server.token_file or [[token]] of the configuration"
"""Where tokens come from."""
WRONG_TOKEN, NO_TOKEN = f"wrong token: must be {TOKENS}", f"must not be empty: {TOKENS}"
"""Messages of the failures after a wrong token and without any."""
MOST_FAILURES = 100
"""Maximum number of failures in a row before a client is disconnected."""
MOST_ANSWERS = 256
"""Maximum number of answers that wait to be sent."""


class Close(NamedTuple):
    """Reason for which a connection ends.

    Attributes
    ----------
    code : int
        Close code of the WebSocket; 0 if the other side ended it.
    reason : str
        Reason in a few words.
    """

    code: int
    reason: str


GONE = Close(0, "gone")
"""End by the other side."""
SLOW = Close(4008, "does not read")
"""End because the client does not read."""
FLOOD = Close(4008, "nothing but failures")
"""End after too many failures in a row."""
TOO_LARGE = Close(1009, "too large")
"""End after a message that was too large."""
FULL = Close(4429, "too many clients")
"""End because there is no free place."""
ENDING = Close(1001, "the server ends")
"""End because the server ends."""
BROKEN = Close(1011, "the server failed")
"""End after an internal failure of the server."""


class Welcomed(NamedTuple):
    """Client that is admitted.

    Attributes
    ----------
    hello : ClientHello
        Its first message.
    roles : frozenset of Role
        What it may do.
    peer : PeerCredentials or None
        User that it runs as, if that is known.
    """

    hello: ClientHello
    roles: frozenset[Role]
    peer: PeerCredentials | None


class Site:
    """State that all connections share.

    Parameters
    ----------
    host : Host
        Displays of the server.
    config : ServerConfig
        Configuration of the server.
    metrics : Metrics
        Metrics of the server.
    tokens : Tokens
        Tokens that admit clients.
    version : str
        Version of this package.

    Attributes
    ----------
    places : Places
        Connections of admitted clients.
    ending : bool
        Whether the server ends.
    """

    def __init__(
        self,
        host: Host,
        config: ServerConfig,
        metrics: Metrics,
        tokens: Tokens,
        version: str,
    ) -> None:
        self.host, self.config, self.metrics = host, config, metrics
        self.tokens, self.version = tokens, version
        self.places = Places(config.most_clients)
        self.ending = False

    def end(self) -> None:
        """Disconnect all clients because the server ends, and admit no more."""
        self.ending = True
        for connection in self.places:
            connection.end(ENDING)


async def talk(socket: WebSocket, site: Site) -> None:
    """Serve a WebSocket until it ends.

    Parameters
    ----------
    socket : WebSocket
        WebSocket that is not accepted yet.
    site : Site
        What all connections share.
    """
    protocol = next((p for p in socket.scope["subprotocols"] if p in ENCODINGS), None)
    await socket.accept(protocol)
    if protocol is None:
        await socket.close(1002, f"no subprotocol of {', '.join(ENCODINGS)}")
        return
    connection = ServerConnection(socket, site, ENCODINGS[protocol])
    ended = await connection.run()
    if ended is not GONE:
        with suppress(TimeoutError, WebSocketDisconnect, RuntimeError):  # nobody would read it
            async with asyncio.timeout(READ_WITHIN):
                await connection.flush()
                await socket.close(*ended)


class ServerConnection:
    """WebSocket that speaks one of the subprotocols of this API.

    Parameters
    ----------
    socket : WebSocket
        WebSocket that was accepted.
    site : Site
        What all connections share.
    encoding : Encoding
        Encoding of the subprotocol.
    """

    def __init__(self, socket: WebSocket, site: Site, encoding: Encoding) -> None:
        self._socket, self._site, self._encoding = socket, site, encoding
        self._link: BoundedWebSocket = socket.scope["state"]["link"]
        self._traffic = site.metrics.of("websocket")
        self._answers: asyncio.Queue[Answer] = asyncio.Queue(MOST_ANSWERS)
        self._bucket = TokenBucket(site.config.messages_per_second)
        self._signs = SignsOfLife()
        self._failures = 0
        self._ended: asyncio.Future[Close] = asyncio.get_running_loop().create_future()
        self._parts: list[asyncio.Task[None]] = []
        self._client: Client
        self._requests: Requests

    async def run(self) -> Close:
        """Serve the connection until it ends.

        Its client is closed then, and its place is free.

        Returns
        -------
        Close
            Reason of the end.
        """
        if self._site.ending:
            return ENDING
        welcomed = await self._greet()
        if isinstance(welcomed, Close):
            return welcomed
        self._link.settle()
        self._traffic.clients.inc()
        try:
            return await self._serve_client(welcomed)
        finally:
            self._site.places.leave(self)
            self._traffic.clients.dec()
            self._link.unsettle()

    async def _serve_client(self, welcomed: Welcomed) -> Close:
        """Serve an admitted client until the host has nothing left to do for it."""
        hello = welcomed.hello
        session = secrets.token_hex(4)
        fields = {"session": session, "client": hello.client}
        user = {} if welcomed.peer is None else dict(welcomed.peer._asdict())
        log.info("client connected", extra={"fields": fields | user})
        self._client = self._site.host.connect(hello.client, roles=welcomed.roles)
        self._requests = Requests(self._client, self._traffic, self._answer, self._fail)
        try:
            self._start_part(self._receive())
            self._start_part(self._send_all(self._welcome(welcomed, session)))
            ended = await self._ended
        finally:
            try:
                self._client.close()  # first, because everything else could fail
            finally:
                await self._finish()
        reason = {"code": ended.code, "reason": ended.reason}
        log.info("client disconnected", extra={"fields": fields | reason})
        return ended

    async def _finish(self) -> None:
        """End everything that goes on for a client that was closed, within a bounded time."""
        for task in self._parts:
            task.cancel()
        await self._requests.finish()

    # Hello

    async def _greet(self) -> Welcomed | Close:
        """Receive `ClientHello` and admit the client, which has a place then."""
        try:
            async with asyncio.timeout(HELLO_WITHIN):
                message = await self._socket.receive()
        except TimeoutError:
            late = failed("hello_first", f"no hello within {HELLO_WITHIN:g} s")
            return self._refuse(Close(4408, "no hello"), late)
        if message["type"] != "websocket.receive":
            return GONE
        hello = read(self._data(message), self._encoding)
        if isinstance(hello, Failure):
            return self._refuse(Close(4400, "no hello"), hello)
        if not isinstance(hello, ClientHello):
            first = "the first message must be a hello"
            failure = failed("hello_first", first, field="type", to=id_of(hello))
            return self._refuse(Close(4400, "no hello"), failure)
        return await self._admit(hello)

    async def _admit(self, hello: ClientHello) -> Welcomed | Close:
        """Admit or refuse a client by its token, its version and the free places."""
        roles, peer = await self._roles(hello.token)
        if roles is None:
            await asyncio.sleep(PENALTY)
            text = WRONG_TOKEN if hello.token else NO_TOKEN
            failure = failed("unauthorized", text, field="token", to=hello.id)
            return self._refuse(Close(4401, "unauthorized"), failure)
        if hello.version != API_VERSION:
            text = f"version = {hello.version}: must be {API_VERSION}"
            failure = failed("wrong_version", text, field="version", to=hello.id)
            return self._refuse(Close(4406, "wrong version"), failure)
        if self._site.ending:
            return ENDING
        if not self._site.places.take(self, loop_time()):
            text = self._full_text()
            return self._refuse(FULL, failed("too_many_clients", text, to=hello.id))
        if self._site.places.is_reserved(self):
            roles = frozenset()
        return Welcomed(hello, roles, peer)

    async def _roles(self, token: str) -> tuple[frozenset[Role] | None, PeerCredentials | None]:
        """Return what a client may do by its token or user, None if it is refused, and its user."""
        tokens, socket = self._site.tokens, self._link.socket
        local = is_local(socket)
        if tokens and (token or not local):
            return tokens.roles(token), local_peer(socket) if local else None
        return await judge(socket)

    def _full_text(self) -> str:
        """Return the explanation that all places are taken."""
        most = self._site.config.most_clients
        return f"there are {most} clients, as many as server.most_clients allows"

    def _refuse(self, close: Close, failure: Failure) -> Close:
        """Queue the failure of a client that is not admitted; return the close reason."""
        self._traffic.failure(failure.code)
        self._queue(failure)
        return close

    def _welcome(self, welcomed: Welcomed, session: str) -> Welcome:
        return Welcome(
            id=welcomed.hello.id,
            server=f"tactile {self._site.version}",
            version=API_VERSION,
            session=session,
            displays=self._site.host.displays,
            may_arm="arm" in welcomed.roles,
            roles=tuple(sorted(welcomed.roles)),
            time_us=int(loop_time() * 1e6),
            messages_per_second=self._site.config.messages_per_second,
        )

    # Receiving

    def _start_part(self, work: Coroutine[Any, Any, Close]) -> None:
        """Start a part of the connection; the part that ends first ends the connection."""
        self._parts.append(start_task(self._run_part(work), self._fail))

    async def _run_part(self, work: Coroutine[Any, Any, Close]) -> None:
        try:
            self.end(await work)
        except TimeoutError:
            self.end(SLOW)
        except (WebSocketDisconnect, RuntimeError):
            self.end(GONE)

    def end(self, close: Close) -> None:
        """End the connection; the first reason counts.

        Parameters
        ----------
        close : Close
            Reason of the end.
        """
        if not self._ended.done():
            self._ended.set_result(close)

    def make_room(self) -> None:
        """End, because a newer client takes the place."""
        self.end(FULL)

    def _fail(self, error: BaseException) -> None:
        self.end(BROKEN)

    def check(self, passed: float) -> None:
        """Ask for a sign of life when it is due, and act if there was none for too long.

        Parameters
        ----------
        passed : float
            Time since the last call [s].
        """
        try:
            client = self._client
            at_stake = client.sounds or client.holds_voltage
            due = self._signs.step(passed, self._link.received, at_stake=at_stake)
            if due.ping:
                self._link.ping()
            if due.quiet:
                client.quiet()
            if due.give_up:
                client.give_up()
        except Exception as error:
            log.exception("a client could not be watched")
            self._fail(error)

    async def _receive(self) -> Close:
        while True:
            message = await self._socket.receive()
            if message["type"] != "websocket.receive":
                return GONE
            if self._ended.done():
                return self._ended.result()
            self._take(self._data(message), loop_time())

    @staticmethod
    def _data(message: Any) -> str | bytes:
        text: str | None = message.get("text")
        data: str | bytes = message["bytes"] if text is None else text
        return data

    def _take(self, data: str | bytes, arrival: float) -> None:
        """Handle a message without waiting for anything."""
        within = self._bucket.take(arrival)
        if not within and read_estop(data, self._encoding) is None:
            self._drop_too_fast(arrival)
            return
        try:
            failure = self._handle(read(data, self._encoding), arrival)
        except Exception:
            log.exception("a message failed")
            failure = failed("internal", "the server failed; its log says how")
        if failure is not None:
            self._answer(failure)

    def _handle(self, command: Command | Failure, arrival: float) -> Failure | None:
        """Handle a decoded message; return what is wrong with it."""
        if not isinstance(command, EStop | Failure) and self._site.places.is_reserved(self):
            text = f"{self._full_text()}; this connection may only e-stop"
            return failed("too_many_clients", text, to=id_of(command))
        if isinstance(command, Streamed):
            failure = self._client.stream(command, arrival)
            self._failures = self._failures if failure else 0
            self._traffic.message(kind_of(command), loop_time() - arrival)
            return failure
        if isinstance(command, Failure):
            if command.code == "too_large":
                self.end(TOO_LARGE)
            return command
        if isinstance(command, Ping):
            came = int(arrival * 1e6)
            self._answer(Pong(id=command.id, time_us=command.time_us, server_time_us=came))
            self._traffic.message("ping", loop_time() - arrival)
            return None
        if isinstance(command, ClientHello):
            return failed("unsupported", "hello was said already", field="type", to=command.id)
        return self._requests.offer(command)

    def _drop_too_fast(self, now: float) -> None:
        """Drop a message of a client that sends too many, and report that once per second."""
        self._traffic.drop("too_fast")
        if self._bucket.report_is_due(now):
            rate = self._site.config.messages_per_second
            text = f"{self._bucket.refused} messages dropped: at most {rate} a second"
            self._traffic.failure("too_fast")
            self._queue(failed("too_fast", text))

    # Sending

    def _answer(self, answer: Answer) -> None:
        """Queue an answer, and count failures in a row."""
        if isinstance(answer, Failure):
            self._traffic.failure(answer.code)
            self._failures += 1
            if self._failures > MOST_FAILURES:
                self.end(FLOOD)
        else:
            self._failures = 0
        self._queue(answer)

    def _queue(self, answer: Answer) -> None:
        """Queue an answer; end the connection if the client does not read its answers."""
        try:
            self._answers.put_nowait(answer)
        except asyncio.QueueFull:
            self._traffic.drop("unread")
            self.end(SLOW)

    async def _send_all(self, welcome: Welcome) -> Close:
        """Send the welcome, then answers, events and telemetry as they come."""
        await self._send(welcome)
        self._start_part(self._pump(self._client.outbox))
        return await self._pump(self._answers)

    async def flush(self) -> None:
        """Send the answers that wait."""
        while not self._answers.empty():
            await self._send(self._answers.get_nowait())

    async def _pump(self, queue: "asyncio.Queue[Any]") -> Close:
        """Send what is put in a queue."""
        while True:
            await self._send(await queue.get())

    async def _send(self, answer: Answer) -> None:
        """Send a message.

        Raises
        ------
        TimeoutError, WebSocketDisconnect, RuntimeError
            If the client does not read, or is gone.
        """
        data = self._encoding.encode(answer)
        async with asyncio.timeout(READ_WITHIN):
            if self._encoding.kind == "text":
                await self._socket.send({"type": "websocket.send", "text": data.decode()})
            else:
                await self._socket.send({"type": "websocket.send", "bytes": data})
