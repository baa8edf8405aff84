"""uvicorn's protocols, bounded: how much is read at once, and for how long anyone may dawdle.

A flood of tiny frames must not keep the event loop for a block's time, and a peer that does not
read must not keep memory or a socket.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import Frame
from websockets.http11 import Request
from websockets.protocol import State

CHUNK = 4096
"""Bytes that are read at once: at most 680 frames."""
MOST_FRAGMENTS = 256
"""Of a message."""
MOST_UNREAD = 256 * 1024
"""Bytes that may wait for a peer that sends pings and does not read our pongs."""
LINGER = 1.0
"""s after the end of a connection until what the peer did not read is thrown away."""
REQUEST_WITHIN = 5.0
"""s from a connection to its first request."""


class Strangers:
    """Connections that did not say who they are; the oldest makes room for a new one.

    Those that asked for nothing go first, so that a flood of them keeps nobody out who has just
    asked to speak.

    Parameters
    ----------
    most : of them
    dropped : called for each that is dropped
    """

    def __init__(self, most: int, dropped: Callable[[], object]) -> None:
        self._most, self._dropped = most, dropped
        self._silent: dict[asyncio.Transport, None] = {}
        self._asking: dict[asyncio.Transport, None] = {}

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._silent) + len(self._asking)

    def admit(self, transport: asyncio.Transport, *, asking: bool) -> None:
        """Take one that is new, or that just asked for something."""
        self.release(transport)
        if len(self) >= self._most:
            oldest = next(iter(self._silent or self._asking))
            self.release(oldest)
            oldest.abort()
            self._dropped()
        (self._asking if asking else self._silent)[transport] = None

    def release(self, transport: asyncio.Transport) -> None:
        """Forget one that said who it is, or is gone."""
        self._silent.pop(transport, None)
        self._asking.pop(transport, None)


class BoundedState(ServerState):
    """What uvicorn's connections share, and the strangers among them."""

    def __init__(self, strangers: Strangers) -> None:
        super().__init__()
        self.strangers = strangers


class BoundedHttp(H11Protocol):
    """HTTP, where a connection that does not ask is closed."""

    server_state: BoundedState

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.server_state.strangers.admit(transport, asking=False)
        self._patience = self.loop.call_later(REQUEST_WITHIN, self._close_unless_asked)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._patience.cancel()
        super().connection_lost(exc)
        self.server_state.strangers.release(self.transport)

    def data_received(self, data: bytes) -> None:
        """Take what was read; who asks for something is no longer silent."""
        super().data_received(data)
        if self.cycle is not None and not self.transport.is_closing():
            self.server_state.strangers.admit(self.transport, asking=True)

    def _close_unless_asked(self) -> None:
        if self.cycle is None and self.transport.get_protocol() is self:
            self.transport.close()


class BoundedWebSocket(WebSocketsSansIOProtocol, asyncio.BufferedProtocol):
    """A WebSocket that reads little at once and does not wait for ever.

    The application finds it in its scope, as ``scope["state"]["link"]``.

    Attributes
    ----------
    received : how often anything was received
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
        """Begin with the handshake."""
        super().connection_made(transport)
        self._strangers.admit(self.transport, asking=True)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        super().connection_lost(exc)
        self._strangers.release(self.transport)

    def handle_connect(self, event: Request) -> None:
        """Begin to serve it."""
        super().handle_connect(event)
        if hasattr(self, "scope"):  # else the handshake was refused
            self.scope["state"]["link"] = self

    @property
    def socket(self) -> socket.socket:
        """The socket, to see who is at the other end."""
        found: socket.socket = self.transport.get_extra_info("socket")
        return found

    def settle(self) -> None:
        """Take the peer for no stranger any more."""
        self._strangers.release(self.transport)

    def unsettle(self) -> None:
        """Take the peer for a stranger again, until the connection is closed."""
        if not self.disconnected:
            self._strangers.admit(self.transport, asking=False)

    def ping(self) -> None:
        """Ask for a sign of life; never raises.

        The pong counts for uvicorn's own ping as well: a peer may answer the last one only.
        """
        full = self.transport.get_write_buffer_size() > MOST_UNREAD
        if full or self.disconnected or self.transport.is_closing():
            return
        if self.conn.state is State.OPEN:
            self.conn.send_ping(self.pending_ping_payload or b"")
            self.transport.write(b"".join(self.conn.data_to_send()))

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return where to read to."""
        return self._chunk

    def buffer_updated(self, nbytes: int) -> None:
        """Take what was read."""
        self.received += 1
        self.data_received(bytes(self._chunk[:nbytes]))

    def handle_ping(self) -> None:
        """Answer, unless the peer reads no answers."""
        super().handle_ping()
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()

    def handle_cont(self, event: Frame) -> None:
        """Take a fragment, unless there are too many."""
        super().handle_cont(event)
        if len(self.frames) > MOST_FRAGMENTS:
            self.transport.abort()

    def keepalive_timeout(self) -> None:
        """Close, and do not wait for the peer to read that."""
        super().keepalive_timeout()
        self.loop.call_later(LINGER, self.transport.abort)

    async def run_asgi(self) -> None:
        """Serve the connection, and do not wait for the peer to read all of it."""
        try:
            await super().run_asgi()
        finally:
            self.loop.call_later(LINGER, self.transport.abort)
