"""Base of connections: how a request is sent, and how its reply is waited for.

Coroutines of this module wait only by `BaseConnection._wait` and `BaseConnection._sleep`, see
`tactile.client.waiting`.
"""

import difflib
from abc import ABC, abstractmethod
from collections.abc import Iterable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeVar

from tactile.client import wire
from tactile.client.events import Callback, Dispatcher, as_callback
from tactile.client.session import QUIETER, ClientSession
from tactile.client.transport import Transport
from tactile.clock import MONOTONIC, Clock
from tactile.errors import ClientError, InputError, NotFoundError
from tactile.messages import (
    ArmDisplay,
    ClientHello,
    Reply,
    Request,
    Role,
    Select,
    StopPlaying,
    Welcome,
    kind_of,
)

TIMEOUT = 1.0
"""Default longest wait for an answer [s]."""
PATIENT = 20.0
"""Least default wait for preparing a texture or starting a device, which takes long [s]."""
LONGEST_TIMEOUT = 1e6
"""Longest wait for an answer that a program may ask for [s]."""
CLIENT_NAME = "python"
"""Default name under which the server lists a program."""

R = TypeVar("R", bound=Reply)
T = TypeVar("T")


class BaseConnection(ABC):
    """A conversation with one server, whichever way its messages go.

    Parameters
    ----------
    transport : Transport
        Way to the server.
    client_name : str
        Name under which the server lists this program.
    token : str
        Secret, if the server asks for one.
    timeout : float
        Longest wait for an answer, unless a call says otherwise [s].
    rearm : bool
        Whether to arm again, after a reconnection, what this program had armed.
    clock : Clock
        Clock of this program, for the time of contacts and for timeouts.

    Attributes
    ----------
    timeout : float
        Longest wait for an answer, unless a call says otherwise [s].
    """

    _dispatcher: Dispatcher

    def __init__(
        self,
        transport: Transport,
        *,
        client_name: str = CLIENT_NAME,
        token: str = "",
        timeout: float = TIMEOUT,
        rearm: bool = False,
        clock: Clock = MONOTONIC,
    ) -> None:
        self.timeout = TIMEOUT
        self.timeout = self._patience(timeout)
        self._transport = transport
        hello = wire.checked(ClientHello(client=client_name, token=token))
        self._session = ClientSession(transport, hello, clock=clock, rearm=rearm)
        self._displays: dict[str, Any] = {}  # those that the program uses, by name
        self._was_opened = False

    @abstractmethod
    async def _wait(self, future: "Future[T]", timeout: float, what: str) -> T:
        """Return the result of a future, or raise `ClientTimeoutError`."""

    @abstractmethod
    async def _sleep(self, seconds: float) -> None:
        """Let time pass."""

    async def _open(self) -> None:
        """Connect, unless this was opened before."""
        if self._was_opened:
            return
        self._was_opened = True
        self._session.notify = self._dispatcher.put
        self._transport.open(self._session)
        try:
            await self._wait(self._session.ready, 2 * self.timeout, "connect")
        except BaseException:
            await self._end()
            raise

    async def _close(self) -> None:
        """Stop the displays that were used, and close."""
        if not self._session.closed:
            await self._stop(list(self._displays))
            await self._end()

    async def _stop(self, names: Iterable[str]) -> None:
        """Fade displays out, and wait for at most half of the timeout until they are."""
        clock = self._session.clock
        deadline = clock.now() + self.timeout / 2
        stops = []
        for name in names:
            with suppress(ClientError):
                stops.append(self._session.request(StopPlaying(display=name)))
        for stop in stops:
            with suppress(ClientError):
                await self._wait(stop, max(0.0, deadline - clock.now()), "stop")

    async def _end(self) -> None:
        self._session.close()
        limit = max(self.timeout, 1.0)
        with suppress(ClientError):
            await self._wait(self._transport.close(), limit, "close")
        await self._dispatcher.close(limit)

    async def _request(self, request: Request, kind: type[R], timeout: float | None) -> R:
        """Send a request and return its reply, which is of a kind.

        What makes a display quieter is sent even if the timeout is wrong.
        """
        try:
            limit = self._limit(request, timeout)
        except InputError:
            if isinstance(request, QUIETER):
                self._session.request(request)
            raise
        future = self._session.request(wire.checked(request))
        reply = await self._wait(future, limit, kind_of(request))
        if not isinstance(reply, kind):
            raise ClientError(f"the server answered {type(reply).__name__}, not {kind.__name__}")
        return reply

    def _limit(self, request: Request, timeout: float | None) -> float:
        """Return the longest wait for an answer [s]."""
        patient = timeout is None and isinstance(request, Select | ArmDisplay)
        return max(self.timeout, PATIENT) if patient else self._patience(timeout)

    def _patience(self, timeout: float | None) -> float:
        """Return a timeout as given, or that of the connection [s]."""
        if timeout is None:
            return self.timeout
        seconds = wire.to_number(timeout, "timeout [s]")
        if not 0 <= seconds <= LONGEST_TIMEOUT:
            raise InputError(f"timeout: {seconds:g} s is not in 0 … {LONGEST_TIMEOUT:g} s")
        return seconds

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event`; this can also be used as a decorator.

        The synchronous SDK calls back in a thread of its own, where the callback may wait and use
        displays. Under asyncio it calls back in the event loop, and runs a coroutine function as a
        task. While 256 events wait for a slow callback, further ones are dropped and counted.

        Parameters
        ----------
        callback : Callable
            Function that takes an `Event`.

        Returns
        -------
        Callable
            The callback.

        Raises
        ------
        InputError
            If it cannot be called.
        """
        self._dispatcher.add(as_callback(callback))
        return callback

    @property
    def connected(self) -> bool:
        """Whether the server is there now."""
        return self._session.connected

    @property
    def welcome(self) -> Welcome:
        """Description that the server gave of itself when it was last connected to.

        Raises
        ------
        ClientError
            If there was no connection yet.
        """
        if self._session.welcome is None:
            raise ClientError("not connected yet")
        return self._session.welcome

    @property
    def displays(self) -> dict[str, wire.DisplayInfo]:
        """The displays that the server has, by name."""
        infos = (wire.from_message(wire.DisplayInfo, info) for info in self.welcome.displays)
        return {info.name: info for info in infos}

    @property
    def roles(self) -> frozenset[Role]:
        """Roles that the server gives this program: some of "watch", "play", "arm" and "stop"."""
        return frozenset(self.welcome.roles)

    @property
    def clock_offset(self) -> float:
        """The server's clock less this program's monotonic clock [s]."""
        return self._session.offset.seconds

    @property
    def round_trip(self) -> float:
        """Shortest time from a message to its answer among the last exchanges [s]."""
        return self._session.offset.round_trip

    @property
    def counters(self) -> dict[str, int]:
        """Counts of this side by name.

        ``dropped_contacts`` (a newer one came first, or the server was not there),
        ``dropped_frames`` (not sent in time, or the server was not there), ``refused_messages``
        (contacts and frames), ``dropped_events`` and ``dropped_telemetry`` (not read in time),
        ``ignored_messages`` (of a later version of the API), ``reconnections``.
        """
        return dict(self._session.counters)

    def _name(self, display: str | None) -> str:
        """Return the name of a display that the server has: as given, or of the only one."""
        names = [info.name for info in self.welcome.displays]
        if display in names:
            return str(display)
        listed = ", ".join(names) or "none"
        if display is not None:
            near = difflib.get_close_matches(str(display), names, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise NotFoundError(f"no display {display!r}; there are: {listed}{hint}")
        if len(names) != 1:
            raise InputError(f"which display? name one with display=; there are: {listed}")
        return names[0]
