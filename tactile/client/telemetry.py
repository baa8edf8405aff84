"""Streams of telemetry: `TelemetryStream`, and `AsyncTelemetryStream` for asyncio."""

from collections.abc import AsyncIterator, Iterator
from typing import TYPE_CHECKING

from tactile.client.telemetry_queue import TelemetryQueue
from tactile.client.waiting import AsyncClosing, Closing, blocking, finish
from tactile.client.wire import Telemetry

if TYPE_CHECKING:
    from tactile.client.display import BaseDisplay


class BaseTelemetryStream:
    """Stream of what a display does; the newest 64 items wait until they are read.

    Reading raises `ClientTimeoutError` if nothing comes, and may go on afterwards. The stream goes
    on after a reconnection, and ends when the connection is closed.

    Parameters
    ----------
    display : BaseDisplay
        Display that the telemetry is of.
    rate : float
        Rate of the telemetry [Hz].
    timeout : float, optional
        Longest wait for each item, beyond its period [s]; by default that of the connection.
    contactor : int, optional
        Contactor whose shear is wanted sample by sample.
    samples : bool
        Whether all that is played is wanted.
    """

    def __init__(
        self,
        display: "BaseDisplay",
        rate: float,
        timeout: float | None,
        contactor: int | None = None,
        *,
        samples: bool = False,
    ) -> None:
        self._connection = display._connection
        self._queue = TelemetryQueue(display.name, rate, contactor, samples=samples)
        self._timeout, self._subscribed = self._connection._patience(timeout), False


class AsyncTelemetryStream(AsyncClosing, BaseTelemetryStream, AsyncIterator[Telemetry]):
    """Stream of what a display does, for ``async for``. Get it from `AsyncDisplay.telemetry`."""

    async def __anext__(self: BaseTelemetryStream) -> Telemetry:
        connection, queue = self._connection, self._queue
        if not self._subscribed:
            await connection._wait(connection._session.subscribe(queue), self._timeout, "telemetry")
            self._subscribed = True
        patience = self._timeout + 1 / queue.rate
        telemetry = await connection._wait(queue.get(), patience, "telemetry")
        if telemetry is None:
            raise StopAsyncIteration
        return telemetry

    async def close(self: BaseTelemetryStream) -> None:
        """End the telemetry; this also happens when nobody holds the stream any more."""
        self._connection._session.unsubscribe(self._queue)


class TelemetryStream(Closing, BaseTelemetryStream, Iterator[Telemetry]):
    """Iterator over what a display does. Get it from `RemoteDisplay.telemetry`."""

    def __next__(self) -> Telemetry:
        try:
            return finish(AsyncTelemetryStream.__anext__(self))
        except StopAsyncIteration:
            raise StopIteration from None

    close = blocking(AsyncTelemetryStream.close)
