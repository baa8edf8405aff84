"""uvicorn's protocols, bounded: how much is read at once, and for how long anyone may dawdle.

A flood of tiny frames must not keep the event loop for a block's time, and a peer that does not
read must not keep memory or a socket.
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

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


class BoundedHttp(H11Protocol):
    """HTTP, where a connection that does not ask is closed."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.loop.call_later(REQUEST_WITHIN, self._close_unless_asked)

    def _close_unless_asked(self) -> None:
        if self.cycle is None and self.transport.get_protocol() is self:
            self.transport.close()


class BoundedWebSocket(WebSocketsSansIOProtocol, asyncio.BufferedProtocol):
    """A WebSocket that reads little at once and does not wait for ever."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.close_timeout = LINGER
        self.conn.debug = False  # it would log each frame, a token among them
        self._chunk = bytearray(CHUNK)

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return where to read to."""
        return self._chunk

    def buffer_updated(self, nbytes: int) -> None:
        """Take what was read."""
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
