"""Protocols of uvicorn with limits on how much is read at once and how long a peer may delay.

A flood of tiny frames must not occupy the event loop for the time of a block, and a peer that does
not read must not occupy memory or a socket.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from uvicorn._types import ASGISendEvent
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import Frame
from websockets.http11 import Request
from websockets.protocol import State

CHUNK = 4096
"""Maximum number of bytes that are read at once: at most 680 frames."""
MOST_FRAGMENTS = 256
"""Maximum number of fragments of a message."""
MOST_UNREAD = 256 * 1024
"""Maximum amount of data that waits for a peer that sends pings and does not read the pongs
[bytes]."""
LINGER = 1.0
"""Time after the end of a connection after which what the peer did not read is discarded [s]."""
REQUEST_WITHIN = 5.0
"""Time from a connection to its first request [s]."""


class Strangers:
    """Connections that have not identified themselves; the oldest makes room for a new one.

    Those that have asked for nothing are dropped first, so that a flood of them does not shut out a
    peer that has just opened a WebSocket.

    Parameters
    ----------
    most : int
        Maximum number of such connections.
    dropped : callable
        Function that is called for each connection that is dropped.
    """

    def __init__(self, most: int, dropped: Callable[[], object]) -> None:
        self._most, self._dropped = most, dropped
        self._silent: dict[asyncio.Transport, None] = {}
        self._asking: dict[asyncio.Transport, None] = {}

    def __len__(self) -> int:
        """Return the number of strangers."""
        return len(self._silent) + len(self._asking)

    def admit(self, transport: asyncio.Transport, *, asking: bool) -> None:
        """Add a connection that is new, or that has just asked for something.

        Parameters
        ----------
        transport : asyncio.Transport
            The connection.
        asking : bool
            Whether it has asked for something.
        """
        self.release(transport)
        if len(self) >= self._most:
            oldest = next(iter(self._silent or self._asking))
            self.release(oldest)
            oldest.abort()
            self._dropped()
        (self._asking if asking else self._silent)[transport] = None

    def release(self, transport: asyncio.Transport) -> None:
        """Remove a connection that has identified itself, or is closed.

        Parameters
        ----------
        transport : asyncio.Transport
            The connection.
        """
        self._silent.pop(transport, None)
        self._asking.pop(transport, None)


class BoundedState(ServerState):
    """State that uvicorn's connections share, with the strangers among them.

    Parameters
    ----------
    strangers : Strangers
        Connections that have not identified themselves.

    Attributes
    ----------
    strangers : Strangers
        Connections that have not identified themselves.
    """

    def __init__(self, strangers: Strangers) -> None:
        super().__init__()
        self.strangers = strangers


class BoundedHttp(H11Protocol):
    """HTTP protocol that closes a connection without a request."""

    server_state: BoundedState

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start waiting for a request.

        Parameters
        ----------
        transport : asyncio.Transport
            The connection.
        """
        super().connection_made(transport)
        self.server_state.strangers.admit(transport, asking=False)
        self._patience = self.loop.call_later(REQUEST_WITHIN, self._close_unless_asked)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection.

        Parameters
        ----------
        exc : Exception or None
            Reason of the loss.
        """
        self._patience.cancel()
        super().connection_lost(exc)
        self.server_state.strangers.release(self.transport)

    def data_received(self, data: bytes) -> None:
        """Process what was read; a connection with a request is no longer silent.

        Parameters
        ----------
        data : bytes
            What was read.
        """
        super().data_received(data)
        if self.cycle is not None and not self.transport.is_closing():
            self.server_state.strangers.admit(self.transport, asking=True)

    def _close_unless_asked(self) -> None:
        if self.cycle is None and self.transport.get_protocol() is self:
            self.transport.close()


class BoundedWebSocket(WebSocketsSansIOProtocol, asyncio.BufferedProtocol):
    """WebSocket protocol that reads little at once and does not wait forever.

    The application finds it in its scope, as ``scope["state"]["link"]``.

    Parameters
    ----------
    config : uvicorn.Config
        Configuration of uvicorn.
    server_state : BoundedState
        State that all connections share.
    app_state : dict of str to Any
        State of the application.

    Attributes
    ----------
    received : int
        How often anything was received.
    """

    def __init__(
        self, config: Config, server_state: BoundedState, app_state: dict[str, Any]
    ) -> None:
        super().__init__(config, server_state, app_state)
        self.close_timeout = LINGER
        self.conn.debug = False  # it would log each frame, a token among them
        self.received = 0
        self._chunk = bytearray(CHUNK)
        self._strangers = server_state.strangers

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the handshake.

        Parameters
        ----------
        transport : asyncio.BaseTransport
            The connection.
        """
        super().connection_made(transport)
        self._strangers.admit(self.transport, asking=True)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection.

        Parameters
        ----------
        exc : Exception or None
            Reason of the loss.
        """
        super().connection_lost(exc)
        self._strangers.release(self.transport)

    def handle_connect(self, event: Request) -> None:
        """Start serving the connection.

        Parameters
        ----------
        event : Request
            Request of the handshake.
        """
        super().handle_connect(event)
        if hasattr(self, "scope"):  # else the handshake was refused
            self.scope["state"]["link"] = self

    async def send(self, message: ASGISendEvent) -> None:
        """Send a message of the application.

        Parameters
        ----------
        message : ASGISendEvent
            Message of the application.
        """
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            # uvicorn 0.54 would log "returned without completing handshake" of a refusal
            self.handshake_complete = True

    @property
    def socket(self) -> socket.socket:
        """Socket of the connection, for finding out who is at its other end."""
        connection: socket.socket = self.transport.get_extra_info("socket")
        return connection

    def settle(self) -> None:
        """Stop treating the peer as a stranger, as it has identified itself."""
        self._strangers.release(self.transport)

    def unsettle(self) -> None:
        """Treat the peer as a stranger again, until the connection is closed."""
        if not self.disconnected:
            self._strangers.admit(self.transport, asking=False)

    def ping(self) -> None:
        """Send a ping to get a sign of life; never raise.

        The pong counts for uvicorn's own ping as well, because a peer may answer only the last one.
        """
        full = self.transport.get_write_buffer_size() > MOST_UNREAD
        if full or self.disconnected or self.transport.is_closing():
            return
        if self.conn.state is State.OPEN:
            self.conn.send_ping(self.pending_ping_payload or b"")
            self.transport.write(b"".join(self.conn.data_to_send()))

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return the buffer to read into.

        Parameters
        ----------
        sizehint : int
            Recommended size, which is ignored.

        Returns
        -------
        bytearray
            The buffer.
        """
        return self._chunk

    def buffer_updated(self, nbytes: int) -> None:
        """Process what was read.

        Parameters
        ----------
        nbytes : int
            Number of bytes in the buffer.
        """
        self.received += 1
        self.data_received(bytes(self._chunk[:nbytes]))

    def handle_ping(self) -> None:
        """Answer a ping, unless the peer does not read the answers."""
        super().handle_ping()
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()

    def handle_cont(self, event: Frame) -> None:
        """Take a fragment, unless there are too many.

        Parameters
        ----------
        event : Frame
            The fragment.
        """
        super().handle_cont(event)
        if len(self.frames) > MOST_FRAGMENTS:
            self.transport.abort()

    def keepalive_timeout(self) -> None:
        """Close the connection without waiting for the peer to read that."""
        super().keepalive_timeout()
        self.loop.call_later(LINGER, self.transport.abort)

    async def run_asgi(self) -> None:
        """Serve the connection without waiting for the peer to read everything."""
        try:
            await super().run_asgi()
        finally:
            self.loop.call_later(LINGER, self.transport.abort)
