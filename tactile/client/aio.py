"""The SDK for asyncio: the calls of `tactile.client.sync`, awaited; no thread.

>>> from tactile.client import aio
>>> async def main():
...     async with aio.connect() as display:
...         await display.select("wood-oak")
...         await display.touch((0.012, 0.003), velocity=(0.08, 0.0), normal_force=0.5)

The event loop also answers the daemon's pings: where a program blocks it for 150 ms, the daemon
takes it as gone, and fades its waveforms.
"""

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Iterable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from tactile import messages
from tactile.client import wire
from tactile.client.base import (
    CLIENT_NAME,
    NORMAL_FORCE,
    TIMEOUT,
    BaseConnection,
    BaseDisplay,
    BaseTelemetryStream,
    Encoding,
    as_callback,
    as_kind,
    endpoint,
    secret,
)
from tactile.client.events import LONGEST, Callback
from tactile.client.transport import Transport
from tactile.client.waveform import Waveform
from tactile.errors import ClientError, ClientTimeoutError
from tactile.messages import Done, Reply, Request, TextureInfo, kind_of

logger = logging.getLogger("tactile.client")

T = TypeVar("T")
R = TypeVar("R", bound=Reply)
C = TypeVar("C", bound="AsyncConnection | AsyncDisplay")


async def _wait(future: "Future[T]", timeout: float, what: str) -> T:
    """Return a future's result; stop waiting for it where it does not come."""
    try:
        async with asyncio.timeout(timeout):
            return await asyncio.wrap_future(future)
    except TimeoutError:
        raise ClientTimeoutError(f"{what}: no answer in {timeout:g} s") from None


class Opening(Generic[C]):
    """What is being opened: ``await`` it, or ``async with`` it, which also closes it."""

    def __init__(self, opened: Callable[[], Awaitable[C]]) -> None:
        self._opened = opened

    def __await__(self) -> Generator[Any, None, C]:
        return self._opened().__await__()

    async def __aenter__(self) -> C:
        self._object = await self._opened()
        return self._object

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self._object.close()


def open_connection(
    url: str | None = None,
    *,
    token: str | None = None,
    timeout: float = TIMEOUT,
    client_name: str = CLIENT_NAME,
    reconnect: bool = True,
    rearm: bool = False,
    encoding: Encoding = "msgpack",
) -> "Opening[AsyncConnection]":
    """Connect to a daemon and all its displays, as `tactile.client.sync.open_connection`."""

    async def opened() -> AsyncConnection:
        from tactile.client.websocket import TaskTransport

        transport = TaskTransport(
            endpoint(url), timeout=timeout, reconnect=reconnect, encoding=encoding
        )
        connection = AsyncConnection(
            transport, client_name=client_name, token=secret(token), timeout=timeout, rearm=rearm
        )
        return await connection.open()

    return Opening(opened)


def connect(
    url: str | None = None,
    *,
    display: str | None = None,
    token: str | None = None,
    timeout: float = TIMEOUT,
    client_name: str = CLIENT_NAME,
    reconnect: bool = True,
    rearm: bool = False,
    encoding: Encoding = "msgpack",
) -> "Opening[AsyncDisplay]":
    """Connect to one display of a daemon, as `tactile.client.sync.connect`."""

    async def opened() -> AsyncDisplay:
        connection = await open_connection(
            url,
            token=token,
            timeout=timeout,
            client_name=client_name,
            reconnect=reconnect,
            rearm=rearm,
            encoding=encoding,
        )
        try:
            return AsyncDisplay(connection, connection._name(display), owns=True)
        except BaseException:
            await connection.close()
            raise

    return Opening(opened)


class AsyncConnection(BaseConnection):
    """A conversation with one daemon, as `tactile.client.sync.Connection`; `open` it first.

    Parameters
    ----------
    transport : the way to the daemon
    options : as in `BaseConnection`
    """

    def __init__(self, transport: Transport, **options: Any) -> None:
        super().__init__(transport, **options)
        self._handed_out: dict[str, AsyncDisplay] = {}
        self._callbacks: tuple[Callback, ...] = ()
        self._tasks: set[asyncio.Future[Any]] = set()

    async def open(self) -> Self:
        """Connect, and return itself.

        Raises
        ------
        DisconnectedError, ClientTimeoutError
            Where there is no daemon.
        RequestError
            Where it does not let this program in.
        """
        self._loop = asyncio.get_running_loop()
        self._session.notify = self._notify
        self._transport.open(self._session)
        try:
            await _wait(self._session.ready, 2 * self.timeout, "connect")
        except BaseException:
            await self._end()
            raise
        return self

    def display(self, name: str | None = None) -> "AsyncDisplay":
        """Return a display: the only one, or the named one.

        Raises
        ------
        InputError
            Where there are several and none is named, or none of that name (`NotFoundError`).
        """
        name = self._name(name)
        return self._handed_out.setdefault(name, AsyncDisplay(self, name))

    async def textures(self, *, timeout: float | None = None) -> tuple[TextureInfo, ...]:
        """Return the textures that may be selected."""
        return (await self._ask(messages.ListTextures(), messages.Textures, timeout)).textures

    async def estop(self, *, timeout: float | None = None) -> dict[str, int]:
        """Set all displays to 0 V at once; return the number of each e-stop by display."""
        return (await self._ask(messages.EStop(), Done, timeout)).estops

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event`; what a coroutine function returns is run as a task."""
        if as_callback(callback) not in self._callbacks:
            self._callbacks = (*self._callbacks, callback)
        return callback

    def _notify(self, event: wire.Event) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._call_back, event)

    def _call_back(self, event: wire.Event) -> None:
        for callback in self._callbacks:
            if len(self._tasks) >= LONGEST:
                self._session.counters["dropped_events"] += 1
                continue
            task = asyncio.ensure_future(_called(callback, event))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Stop the displays that were used, and close; within the timeout. Idempotent."""
        if not self._session.closed:
            await self._stop(self._handed_out)
            await self._end()

    async def _stop(self, names: Iterable[str]) -> None:
        """Ask to fade out, and wait for at most half of the timeout."""
        with suppress(ClientError):
            stops = [self._session.ask(messages.StopPlaying(display=name)) for name in names]
            waits = [_wait(stop, self.timeout / 2, "stop") for stop in stops]
            await asyncio.gather(*waits, return_exceptions=True)

    async def _end(self) -> None:
        self._session.close()
        with suppress(ClientError):
            await _wait(self._transport.close(), max(self.timeout, 1.0), "close")
        busy = self._tasks - {asyncio.current_task()}
        for task in busy:
            task.cancel()
        await asyncio.gather(*busy, return_exceptions=True)

    async def _ask(self, request: Request, kind: type[R], timeout: float | None) -> R:
        future, limit = self._begin(request, timeout)
        return as_kind(await _wait(future, limit, kind_of(request)), kind)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()


async def _called(callback: Callback, event: wire.Event) -> None:
    try:
        result = callback(event)
        if inspect.isawaitable(result):
            await result
    except Exception:
        logger.exception("callback for %s", event)


class AsyncDisplay(BaseDisplay):
    """One display of a connection, with one finger on it: `RemoteDisplay` for asyncio."""

    _connection: AsyncConnection

    def __init__(self, connection: AsyncConnection, name: str, *, owns: bool = False) -> None:
        super().__init__(name, owns)
        self._connection = connection
        connection._handed_out.setdefault(name, self)

    @property
    def connection(self) -> AsyncConnection:
        """The connection that it is of."""
        return self._connection

    async def touch(
        self,
        position: Sequence[float],
        *,
        velocity: Sequence[float] | None = None,
        normal_force: float = NORMAL_FORCE,
        time: float | None = None,
    ) -> None:
        """Say where the finger is [m], [m/s], [N], [s]; never waits, only the newest is sent."""
        self._touch(position, normal_force, velocity, time)

    async def lift(self, *, time: float | None = None) -> None:
        """Say that the finger has left the surface; never waits."""
        self._touch(self._position, 0.0, None, time)

    async def select(self, layers: wire.Layers, *, timeout: float | None = None) -> None:
        """Choose what the finger feels: a name, (name, gain), `Layer`, or several of these."""
        chosen = wire.to_layers(layers)
        await self._ask(messages.Select(display=self.name, layers=chosen), timeout)

    async def gain(self, gain: float, *, timeout: float | None = None) -> None:
        """Scale all that is this program's: 0 … 1."""
        number = wire.to_number(gain, "gain")
        await self._ask(messages.SetGain(display=self.name, gain=number), timeout)

    async def stop(self, *, timeout: float | None = None) -> None:
        """Fade out: textures until `resume`, waveforms for good."""
        self._end_playback()
        await self._ask(messages.StopPlaying(display=self.name), timeout)

    async def resume(self, *, timeout: float | None = None) -> None:
        """Let the textures sound again after `stop`."""
        await self._ask(messages.Play(display=self.name), timeout)

    async def arm(self, *, timeout: float | None = None) -> None:
        """Switch high voltage on. A person is to know of it."""
        await self._ask(messages.ArmDisplay(display=self.name), timeout)

    async def disarm(self, *, timeout: float | None = None) -> None:
        """Fade out and switch high voltage off."""
        self._end_playback()
        await self._ask(messages.DisarmDisplay(display=self.name), timeout)

    async def estop(self, *, timeout: float | None = None) -> int:
        """Set this display to 0 V at once, as `tactile.client.sync.RemoteDisplay.estop`."""
        self._end_playback()
        request = messages.EStop(display=self.name)
        return (await self._connection._ask(request, Done, timeout)).estops.get(self.name, 0)

    async def clear(self, *, estop: int | None = None, timeout: float | None = None) -> None:
        """End an e-stop that a person has decided to end, as `RemoteDisplay.clear` does."""
        if estop is None:
            estop = self.estopped or (await self.stats(timeout=timeout)).estop or None
        if estop is not None:
            await self._ask(messages.ClearEstop(display=self.name, estop=estop), timeout)

    async def append(
        self,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        timeout: float | None = None,
    ) -> wire.Appended:
        """Send one message of a waveform, to play after what waits; −1 … 1, [Hz], [m]."""
        message = self._append(samples, sample_rate, amplitude, contactors)
        if message is None:
            return wire.Appended(0, 0.0)
        return wire.from_appended(
            await self._connection._ask(message, messages.AppendedReply, timeout)
        )

    async def play(
        self,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        timeout: float | None = None,
    ) -> int:
        """Play a waveform in place of what waits; returns when the daemon has taken all of it."""
        waveform = Waveform(
            self.name,
            samples,
            sample_rate=sample_rate,
            amplitude=amplitude,
            contactors=contactors,
        )
        playback = self._playback(waveform, timeout)
        while (message := playback.message()) is not None:
            reply = await self._connection._ask(message, messages.AppendedReply, timeout)
            await asyncio.sleep(playback.taken(message, reply))
        return playback.samples

    async def effect(
        self,
        amplitude: float,
        *,
        amplitude_points: Iterable[tuple[float, float]] = (),
        frequency_points: Iterable[tuple[float, float]] = (),
        transients: Iterable[tuple[float, ...]] = (),
        stream: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Play amplitude [m] and frequency [Hz] over time [s], as XR_EXT_haptic_parametric."""
        made = wire.to_effect(
            self.name, amplitude, amplitude_points, frequency_points, transients, stream
        )
        await self._ask(made, timeout)

    async def transient(
        self, amplitude: float, *, frequency: float = 160.0, timeout: float | None = None
    ) -> None:
        """Play one tap now: amplitude [m], frequency [Hz]."""
        await self.effect(amplitude, transients=[(0.0, 1.0, frequency)], timeout=timeout)

    async def stats(self, *, timeout: float | None = None) -> wire.Stats:
        """Return how the display stands."""
        request = messages.GetStats(display=self.name)
        return wire.from_stats(await self._connection._ask(request, messages.StatsReply, timeout))

    async def textures(self, *, timeout: float | None = None) -> tuple[TextureInfo, ...]:
        """Return the textures that may be selected."""
        return await self._connection.textures(timeout=timeout)

    def telemetry(
        self, rate: float = 30.0, *, timeout: float | None = None
    ) -> "AsyncTelemetryStream":
        """Return what the display does, as often as that [Hz]: for ``async for``."""
        return AsyncTelemetryStream(self, rate, timeout)

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event` of this display or of all; as `AsyncConnection.on_event`."""
        self._connection.on_event(self._only_mine(callback))
        return callback

    async def close(self) -> None:
        """Stop, and close the connection if `connect` made it for this display."""
        if self._owns:
            await self._connection.close()
        else:
            self._end_playback()
            await self._connection._stop([self.name])

    async def _ask(self, request: Request, timeout: float | None) -> None:
        await self._connection._ask(request, Done, timeout)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()


class AsyncTelemetryStream(BaseTelemetryStream, AsyncIterator[wire.Telemetry]):
    """What a display does, as it comes, as `tactile.client.sync.TelemetryStream`."""

    async def __anext__(self) -> wire.Telemetry:
        if not self._asked:
            await _wait(self._session.listen(self._queue), self._timeout, "telemetry")
            self._asked = True
        patience = self._timeout + 1 / self._queue.rate
        telemetry = await _wait(self._queue.get(), patience, "telemetry")
        if telemetry is None:
            raise StopAsyncIteration
        return telemetry

    async def close(self) -> None:
        """Ask for no more; so it is also when nobody holds this any more."""
        self._session.leave(self._queue)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()
