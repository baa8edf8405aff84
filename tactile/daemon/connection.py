"""One WebSocket's life: `Hello`, then messages in and answers out, until either side has enough.

Contacts are handed on as they come, never behind anything. Requests are carried out one after the
other beside them; an e-stop waits for none of them, and outlives the connection that asked for it.
Whatever a client sends, or does not read, costs that client its connection and nobody else a block.
"""

import asyncio
import logging
import secrets
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from starlette.websockets import WebSocket, WebSocketDisconnect

from tactile.daemon.config import ServerConfig
from tactile.daemon.decoding import ENCODINGS, Encoding, failed, read
from tactile.daemon.messages import (
    ALL_ROLES,
    API_VERSION,
    Answer,
    Command,
    Contact,
    Failure,
    Hello,
    Ping,
    Pong,
    Welcome,
)
from tactile.daemon.metrics import Metrics
from tactile.daemon.requests import Client, Host, Requests, TokenBucket, id_of
from tactile.daemon.security import is_token

log = logging.getLogger("tactile.server")

HELLO_WITHIN = 2.0
READ_WITHIN = 2.0
"""s after which a client that does not read is dropped."""
PENALTY = 0.2
"""s between a wrong token and the answer."""
MOST_FAILURES = 100
"""In a row."""
MOST_ANSWERS = 256
"""That wait."""


class Close(NamedTuple):
    """Why a connection ends; code 0 where the other side ended it."""

    code: int
    reason: str


GONE = Close(0, "gone")
SLOW = Close(4008, "does not read")
FLOOD = Close(4008, "nothing but failures")
TOO_LARGE = Close(1009, "too large")
FULL = Close(4429, "too many clients")
ENDING = Close(1001, "the daemon ends")


@dataclass
class Site:
    """What all connections share."""

    host: Host
    config: ServerConfig
    metrics: Metrics
    token: bytes | None = field(repr=False)
    version: str
    ending: asyncio.Event = field(default_factory=asyncio.Event)
    strangers: int = 0
    clients: int = 0


async def talk(socket: WebSocket, site: Site) -> None:
    """Serve a WebSocket until it ends."""
    protocol = next((p for p in socket.scope["subprotocols"] if p in ENCODINGS), None)
    await socket.accept(protocol)
    if protocol is None:
        await socket.close(1002, f"no subprotocol of {', '.join(ENCODINGS)}")
        return
    connection = Connection(socket, site, ENCODINGS[protocol])
    with suppress(TimeoutError, WebSocketDisconnect, RuntimeError):  # nobody would read it
        ended = await connection.run()
        if ended is not GONE:
            async with asyncio.timeout(READ_WITHIN):
                await socket.close(*ended)


class Connection:
    """A WebSocket that speaks one of our subprotocols."""

    def __init__(self, socket: WebSocket, site: Site, encoding: Encoding) -> None:
        self._socket, self._site, self._encoding = socket, site, encoding
        self._traffic = site.metrics.of("websocket")
        self._answers: asyncio.Queue[Answer] = asyncio.Queue(MOST_ANSWERS)
        self._bucket = TokenBucket(site.config.messages_per_second)
        self._failures = 0
        self._ended: asyncio.Future[Close] = asyncio.get_running_loop().create_future()
        self._client: Client
        self._requests: Requests

    async def run(self) -> Close:
        """Return why it ended; its client is closed then."""
        site = self._site
        if site.ending.is_set():
            return ENDING
        hello = await self._greeted()
        if isinstance(hello, Close):
            return hello
        self._client = site.host.connect(hello.client, roles=ALL_ROLES)
        session = secrets.token_hex(4)
        about = {"session": session, "client": hello.client}
        log.info("a client came", extra={"fields": about})
        site.clients += 1
        self._traffic.clients.inc()
        ended = GONE
        try:
            await self._send(self._welcome(hello, session))
            ended = await self._serve()
        except TimeoutError:
            ended = SLOW
        except (WebSocketDisconnect, RuntimeError):
            ended = GONE
        finally:
            site.clients -= 1
            self._traffic.clients.dec()
            self._client.close()
            reason = {"code": ended.code, "reason": ended.reason}
            log.info("a client went", extra={"fields": about | reason})
        return ended

    # Hello

    async def _greeted(self) -> Hello | Close:
        """Return the `Hello`, where it is one and welcome."""
        site = self._site
        if site.strangers >= site.config.most_clients:
            return await self._refuse(FULL, failed("too_many_clients", "many wait already"))
        site.strangers += 1
        try:
            async with asyncio.timeout(HELLO_WITHIN):
                message = await self._socket.receive()
            if message["type"] != "websocket.receive":
                return GONE
            return await self._hello(self._data(message))
        except TimeoutError:
            late = failed("hello_first", f"no hello within {HELLO_WITHIN:g} s")
            return await self._refuse(Close(4408, "no hello"), late)
        finally:
            site.strangers -= 1

    async def _hello(self, data: str | bytes) -> Hello | Close:
        config = self._site.config
        hello = read(data, self._encoding)
        if isinstance(hello, Failure):
            return await self._refuse(Close(4400, "no hello"), hello)
        to = id_of(hello)
        if not isinstance(hello, Hello):
            first = failed("hello_first", "the first message must be a hello", field="type", to=to)
            return await self._refuse(Close(4400, "no hello"), first)
        if not is_token(hello.token, self._site.token):
            await asyncio.sleep(PENALTY)
            wrong = failed("unauthorized", "wrong token", field="token", to=to)
            return await self._refuse(Close(4401, "unauthorized"), wrong)
        if hello.version != API_VERSION:
            text = f"version = {hello.version}: must be {API_VERSION}"
            wrong = failed("wrong_version", text, field="version", to=to)
            return await self._refuse(Close(4406, "wrong version"), wrong)
        if self._site.clients >= config.most_clients:
            text = f"there are {config.most_clients} clients, as many as may be"
            return await self._refuse(FULL, failed("too_many_clients", text, to=to))
        return hello

    async def _refuse(self, close: Close, failure: Failure) -> Close:
        self._traffic.failure(failure.code)
        await self._send(failure)
        return close

    def _welcome(self, hello: Hello, session: str) -> Welcome:
        return Welcome(
            id=hello.id,
            server=f"tactile {self._site.version}",
            version=API_VERSION,
            session=session,
            displays=self._site.host.displays,
            may_arm=True,
            roles=tuple(sorted(ALL_ROLES)),
            time_us=time.monotonic_ns() // 1000,
            messages_per_second=self._site.config.messages_per_second,
        )

    # In

    async def _serve(self) -> Close:
        """Return why the first of what goes on here came to an end."""
        self._requests = Requests(self._client, self._traffic, self._answer)
        going_on = [
            self._ended,
            *(
                asyncio.create_task(work)
                for work in (
                    self._receive(),
                    self._pump(self._answers),
                    self._pump(self._client.outbox),
                    self._end_with_site(),
                )
            ),
        ]
        try:
            done, _ = await asyncio.wait(going_on, return_when=asyncio.FIRST_COMPLETED)
            ended = next(iter(done)).result()
        finally:
            for task in going_on:
                task.cancel()
            await asyncio.gather(*going_on, return_exceptions=True)
            await self._requests.finish()
        if ended is not GONE:
            while not self._answers.empty():
                await self._send(self._answers.get_nowait())
        return ended

    async def _end_with_site(self) -> Close:
        await self._site.ending.wait()
        return ENDING

    def _end(self, close: Close) -> None:
        if not self._ended.done():
            self._ended.set_result(close)

    async def _receive(self) -> Close:
        while True:
            message = await self._socket.receive()
            if message["type"] != "websocket.receive":
                return GONE
            if self._ended.done():
                return self._ended.result()
            self._take(self._data(message), time.monotonic())

    @staticmethod
    def _data(message: Any) -> str | bytes:
        text: str | None = message.get("text")
        data: str | bytes = message["bytes"] if text is None else text
        return data

    def _take(self, data: str | bytes, arrival: float) -> None:
        """Handle a message without waiting for anything."""
        if not self._bucket.take(arrival) and not _may_be_estop(data):
            self._refuse_to_hurry(arrival)
            return
        try:
            failure = self._handle(read(data, self._encoding), arrival)
        except Exception:
            log.exception("a message failed")
            failure = failed("internal", "the daemon failed; its log says how")
        if failure is not None:
            self._answer(failure)

    def _handle(self, command: Command | Failure, arrival: float) -> Failure | None:
        if type(command) is Contact:
            failure = self._client.contact(command, arrival)
            self._failures = self._failures if failure else 0
            self._traffic.message("contact", time.monotonic() - arrival)
            return failure
        if isinstance(command, Failure):
            if command.code == "too_large":
                self._end(TOO_LARGE)
            return command
        if isinstance(command, Ping):
            came = int(arrival * 1e6)
            self._answer(Pong(id=command.id, time_us=command.time_us, server_time_us=came))
            self._traffic.message("ping", time.monotonic() - arrival)
            return None
        if isinstance(command, Hello):
            return failed("unsupported", "hello was said already", field="type", to=command.id)
        return self._requests.offer(command)

    def _refuse_to_hurry(self, now: float) -> None:
        """Drop a message of a client that sends too many, and say so once a second."""
        self._traffic.drop("too_fast")
        if self._bucket.is_to_be_told(now):
            rate = self._site.config.messages_per_second
            text = f"{self._bucket.refused} messages dropped: at most {rate} a second"
            self._traffic.failure("too_fast")
            self._queue(failed("too_fast", text))

    # Out

    def _answer(self, answer: Answer) -> None:
        if isinstance(answer, Failure):
            self._traffic.failure(answer.code)
            self._failures += 1
            if self._failures > MOST_FAILURES:
                self._end(FLOOD)
        else:
            self._failures = 0
        self._queue(answer)

    def _queue(self, answer: Answer) -> None:
        try:
            self._answers.put_nowait(answer)
        except asyncio.QueueFull:
            self._traffic.drop("unread")
            self._end(SLOW)

    async def _pump(self, queue: "asyncio.Queue[Any]") -> Close:
        while True:
            await self._send(await queue.get())

    async def _send(self, answer: Answer) -> None:
        """Send a message.

        Raises
        ------
        TimeoutError, WebSocketDisconnect, RuntimeError
            Where the client does not read, or is gone.
        """
        data = self._encoding.encode(answer)
        async with asyncio.timeout(READ_WITHIN):
            if self._encoding.kind == "text":
                await self._socket.send({"type": "websocket.send", "text": data.decode()})
            else:
                await self._socket.send({"type": "websocket.send", "bytes": data})


def _may_be_estop(data: str | bytes) -> bool:
    """Return whether a message is to be looked at even if there are too many."""
    return "estop" in data if isinstance(data, str) else b"estop" in data
