"""The transport over a WebSocket: an asyncio task, in the program's loop or in a thread of its own.

A connection is dropped, and made again if the program wants that, when the server closes it or does
not answer a ping within `SILENCE`.
"""

import asyncio
import logging
import random
import socket
import struct
import threading
from abc import ABC, abstractmethod
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

import msgspec
from websockets.asyncio.client import ClientConnection, connect, unix_connect
from websockets.exceptions import WebSocketException
from websockets.typing import Subprotocol

from tactile.client.address import UNIX, is_local
from tactile.client.outbox import Outbox
from tactile.client.session import ClientSession
from tactile.client.waiting import suspend
from tactile.errors import ClientError, ClientTimeoutError, InputError
from tactile.messages import (
    JSON_PROTOCOL,
    MSGPACK_PROTOCOL,
    PATH,
    Answer,
    Append,
    Command,
    Failure,
    Streamed,
    Welcome,
)

logger = logging.getLogger("tactile.client")

LARGEST_ANSWER = 2**20
"""Largest message that is read [byte]; the description of a display of 4096 contactors fits."""
PING_INTERVAL = 1.0
"""Interval between pings, each of which also measures the clocks [s]."""
SILENCE = 3.0
"""Time without an answer to a ping after which a connection is given up [s]."""
SEND_BUFFER = 32 * 1024
"""Size of the system's send buffer [byte]: less slows appends down, more lets contacts get old."""
FIRST_PAUSE, LONGEST_PAUSE = 0.1, 5.0
"""Limits of the pause before a reconnection [s]; it doubles each time, less a random half."""
SHARE_OF_STREAMS = 0.9
"""Share of the server's messages per second that streams may use; the rest is for requests."""


class _SilentError(ClientError):
    """Raised if the server does not answer in time."""


class _Codec:
    """Converter between messages and the data of WebSocket frames."""

    def __init__(self, protocol: str) -> None:
        self.text = protocol == JSON_PROTOCOL
        module = msgspec.json if self.text else msgspec.msgpack
        self._encoder = module.Encoder()
        self._decoder: Any = module.Decoder(Answer)
        self._fallback: Any = module.Decoder(_Unread)

    def encode(self, command: Command) -> bytes:
        """Return a message as data; JSON holds samples as a list."""
        if self.text and isinstance(command, Append) and isinstance(command.samples, bytes):
            samples = struct.unpack(f"<{len(command.samples) // 4}f", command.samples)
            command = msgspec.structs.replace(command, samples=samples)
        encoded: bytes = self._encoder.encode(command)
        return encoded

    def decode(self, data: bytes) -> Answer:
        """Return a message of the server; an answer that cannot be read is a failure.

        Raises
        ------
        msgspec.MsgspecError
            If it cannot be read and is no answer.
        """
        try:
            answer: Answer = self._decoder.decode(data)
        except msgspec.ValidationError as error:
            unread: _Unread = self._fallback.decode(data)
            if unread.id is None:
                raise
            code: Any = unread.code or "internal"
            text = unread.message or f"{unread.type} cannot be read: {error}"
            return Failure(id=unread.id, code=code, message=text)
        return answer


class _Unread(msgspec.Struct):
    """The part that is read of an answer of a later version of the API."""

    type: str = ""
    id: int | None = None
    code: str = ""
    message: str = ""


class WebSocketTransport(ABC):
    """A way to a server over a WebSocket; `ThreadTransport` and `TaskTransport` say where it runs.

    Parameters
    ----------
    url : str
        Address as ``ws://127.0.0.1:7411/v1`` or ``ws+unix:///run/tactile/tactile.sock``.
    timeout : float
        Longest time to open a connection, and to close one [s].
    reconnect : bool
        Whether to connect again, for as long as it takes.
    encoding : str
        "msgpack" or "json".

    Raises
    ------
    InputError
        If the encoding is neither.
    """

    def __init__(
        self, url: str, *, timeout: float, reconnect: bool = True, encoding: str = "msgpack"
    ) -> None:
        self._url, self._timeout, self._reconnect = url, timeout, reconnect
        if encoding not in ("msgpack", "json"):
            raise InputError(f"encoding: {encoding!r} is neither 'msgpack' nor 'json'")
        self._protocol = JSON_PROTOCOL if encoding == "json" else MSGPACK_PROTOCOL
        self._codec = _Codec(self._protocol)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._more, self._stop = asyncio.Event(), asyncio.Event()
        self._closing = False
        self._attempts = 0
        self._rate = 0
        self._next_streamed = 0.0
        self._closed: Future[None] = Future()
        self._closed.set_running_or_notify_cancel()  # a waiter that gives up does not cancel it

    @property
    def is_local(self) -> bool:
        """Whether the server is on this machine, as far as its address says."""
        return is_local(self._url)

    def open(self, session: ClientSession) -> None:
        """Begin to connect.

        Parameters
        ----------
        session : ClientSession
            Session that takes the messages of the server.
        """
        self._session = session
        self._outbox = Outbox(session.dropped)
        self._launch()

    @abstractmethod
    def _launch(self) -> None:
        """Run `_run` in an event loop."""

    def send(self, command: Command) -> None:
        """Hand over a message, from any thread.

        Parameters
        ----------
        command : Command
            Message to send; of contacts, only the newest is sent, and frames may be joined.
        """
        if self._outbox.put(command):
            self._set(self._more)

    def close(self) -> "Future[None]":
        """Begin to close; idempotent.

        Returns
        -------
        Future
            Future that is done when the thread or task and its sockets are closed.
        """
        self._closing = True
        self._set(self._stop)
        return self._closed

    def _set(self, event: asyncio.Event) -> None:
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop has ended: so has the connection
                self._loop.call_soon_threadsafe(event.set)

    # Inside the loop

    async def _run(self) -> None:
        self._loop = asyncio.get_running_loop()
        stop = asyncio.create_task(self._stop.wait())
        try:
            while not self._closing:
                attempt = asyncio.create_task(self._attempt())
                await asyncio.wait({attempt, stop}, return_when=asyncio.FIRST_COMPLETED)
                await _end(attempt)
                reason = "closed" if attempt.cancelled() else attempt.result()
                self._outbox.clear()
                self._session.lost(reason, final=self._closing or not self._reconnect)
                if not self._reconnect:
                    break
                await asyncio.wait({stop}, timeout=self._pause())
        finally:
            await _end(stop)

    def _pause(self) -> float:
        """Return how long to wait before the next attempt [s]."""
        longest = min(FIRST_PAUSE * 2.0**self._attempts, LONGEST_PAUSE)
        self._attempts = min(self._attempts + 1, 16)
        return longest * random.uniform(0.5, 1.0)

    async def _attempt(self) -> str:
        """Connect, carry messages, and return why the connection ended."""
        try:
            connection = await self._connect()
            try:
                await self._talk(connection)
            except _SilentError:
                connection.transport.abort()  # a silent server does not answer a close frame either
                raise
            finally:
                await self._hang_up(connection)
        except (ConnectionRefusedError, FileNotFoundError):
            return f"{self._url}: nobody listens there; is the server running (tactile serve)?"
        except (OSError, WebSocketException, ClientError, EOFError) as error:
            return f"{self._url}: {error or type(error).__name__}"
        except Exception as error:
            logger.exception("the connection to %s failed", self._url)
            return f"{self._url}: {error!r}"
        return f"{self._url}: closed by the server"

    async def _connect(self) -> ClientConnection:
        path = self._url.removeprefix(UNIX)
        unix = path != self._url
        connection = await (unix_connect if unix else connect)(
            *((path, f"ws://localhost{PATH}") if unix else (self._url,)),
            subprotocols=[Subprotocol(self._protocol)],
            compression=None,
            proxy=None,  # the server is on this machine or in its local network
            open_timeout=self._timeout,
            close_timeout=self._timeout / 2,
            ping_interval=None,  # those of `_keep` also measure the clocks
            max_size=LARGEST_ANSWER,
            write_limit=0,
        )
        if connection.subprotocol != self._protocol:
            await self._hang_up(connection)
            raise ClientError(f"no tactile server: it does not speak {self._protocol}")
        raw = connection.transport.get_extra_info("socket")
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        return connection

    async def _hang_up(self, connection: ClientConnection) -> None:
        """Close with a close frame; at once if the server does not read it, or if cancelled."""
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(self._timeout / 2):
                    await connection.close()
        finally:
            connection.transport.abort()
            await connection.wait_closed()

    async def _talk(self, connection: ClientConnection) -> None:
        self._outbox.clear()
        hello = self._session.say_hello()
        self._more.set()
        tasks = [
            asyncio.create_task(part)
            for part in (self._read(connection), self._write(connection), self._keep(hello))
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            await _end(*tasks)

    async def _read(self, connection: ClientConnection) -> None:
        async for data in connection:
            try:
                answer = self._codec.decode(data if isinstance(data, bytes) else data.encode())
            except msgspec.MsgspecError as error:
                self._session.ignored(str(error))
            else:
                self._session.received(answer)

    async def _write(self, connection: ClientConnection) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await self._more.wait()
            self._more.clear()
            while batch := self._outbox.take(streams=loop.time() >= self._next_streamed):
                for command in batch:
                    if self._session.is_pending(command):
                        self._spend(command, loop.time())
                        await connection.send(self._codec.encode(command), text=self._codec.text)
                await asyncio.sleep(0)  # sending need not suspend: other tasks must get their turn
            if self._outbox.streams:
                loop.call_at(self._next_streamed, self._more.set)

    def _spend(self, command: Command, now: float) -> None:
        """Set when streams may be sent again, by the rate that the server takes."""
        if self._rate and isinstance(command, Streamed):
            share = 1.0 / (SHARE_OF_STREAMS * self._rate)
            self._next_streamed = max(self._next_streamed, now) + share

    async def _keep(self, hello: "Future[Welcome]") -> None:
        welcome = await self._answer(hello, self._timeout, "hello")
        self._attempts, self._rate = 0, welcome.messages_per_second
        while True:
            await asyncio.sleep(PING_INTERVAL)
            await self._answer(self._session.ping(), SILENCE, "a ping")

    async def _answer(self, future: "Future[Any]", timeout: float, what: str) -> Any:
        try:
            return await suspend(future, timeout, what)
        except ClientTimeoutError:
            raise _SilentError(f"no answer to {what} in {timeout:g} s") from None


async def _end(*tasks: "asyncio.Task[Any]") -> None:
    """Cancel tasks and wait until they have ended."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


class ThreadTransport(WebSocketTransport):
    """A WebSocket in a thread of its own, so that a frame loop never waits for it."""

    def _launch(self) -> None:
        threading.Thread(target=self._main, name="tactile-client", daemon=True).start()

    def _main(self) -> None:
        try:
            asyncio.run(self._run())
        finally:
            self._closed.set_result(None)


class TaskTransport(WebSocketTransport):
    """A WebSocket in the event loop that opens it."""

    def _launch(self) -> None:
        self._task = asyncio.create_task(self._run(), name="tactile-client")
        self._task.add_done_callback(lambda _: self._closed.set_result(None))
