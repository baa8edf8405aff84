"""Connections to all displays of a server: `Connection`, and `AsyncConnection` for asyncio.

Each call is written once, as a coroutine of `AsyncConnection` that works on either connection; see
`tactile.client.waiting`.
"""

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, Literal, Self, TypeVar

from tactile import messages
from tactile.client.address import endpoint, secret
from tactile.client.base import CLIENT_NAME, TIMEOUT, BaseConnection
from tactile.client.display import AsyncDisplay, BaseDisplay, RemoteDisplay
from tactile.client.events import TaskDispatcher, ThreadDispatcher
from tactile.client.transport import Transport
from tactile.client.waiting import AsyncClosing, Closing, block, blocking, finish, suspend

Encoding = Literal["msgpack", "json"]
"""How messages are written: MessagePack, or JSON, which a person can read along."""

C = TypeVar("C", bound=BaseConnection)
D = TypeVar("D", bound=BaseDisplay)
T = TypeVar("T")


class AsyncConnection(AsyncClosing, BaseConnection):
    """A conversation with one server from asyncio; `open` it first.

    Parameters
    ----------
    transport : Transport
        Way to the server.
    **options
        Options as of `BaseConnection`.
    """

    def __init__(self, transport: Transport, **options: Any) -> None:
        super().__init__(transport, **options)
        self._dispatcher: TaskDispatcher = TaskDispatcher(self._session.counters)

    async def _wait(self, future: "Future[T]", timeout: float, what: str) -> T:
        return await suspend(future, timeout, what)

    async def _sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def _open(self) -> None:
        self._dispatcher.start()
        await super()._open()

    async def open(self) -> Self:
        """Connect, and return the connection.

        Returns
        -------
        AsyncConnection
            This connection.

        Raises
        ------
        DisconnectedError, ClientTimeoutError
            If there is no server.
        RequestError
            If it does not let this program in.
        """
        await self._open()
        return self

    def display(self, name: str | None = None) -> AsyncDisplay:
        """Return a display of this server.

        Parameters
        ----------
        name : str, optional
            Name of the display; it may be left out if the server has only one.

        Returns
        -------
        AsyncDisplay
            Display, the same at each call.

        Raises
        ------
        InputError
            If there are several and none is named, or none of that name (`NotFoundError`).
        """
        name = self._name(name)
        display: AsyncDisplay = self._displays.setdefault(name, AsyncDisplay(self, name))
        return display

    async def textures(
        self: BaseConnection, *, timeout: float | None = None
    ) -> tuple[messages.TextureInfo, ...]:
        """Return the textures that may be selected.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        tuple of TextureInfo
            Textures that the server has.
        """
        return (await self._request(messages.ListTextures(), messages.Textures, timeout)).textures

    async def estop(self: BaseConnection, *, timeout: float | None = None) -> dict[str, int]:
        """Set all displays to 0 V at once, until each is cleared.

        If the server is not there, or does not confirm, this raises, and the e-stop is sent first
        over the next connection.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        dict of str to int
            Number of each e-stop by the name of its display.
        """
        return (await self._request(messages.EStop(), messages.Done, timeout)).estops

    async def close(self: BaseConnection) -> None:
        """Stop the displays that were used, and close, within the timeout; idempotent."""
        await self._close()


class Connection(Closing, BaseConnection):
    """A conversation with one server; it and its displays may be used from several threads.

    Parameters
    ----------
    transport : Transport
        Way to the server.
    **options
        Options as of `BaseConnection`.
    """

    def __init__(self, transport: Transport, **options: Any) -> None:
        super().__init__(transport, **options)
        self._dispatcher = ThreadDispatcher(self._session.counters)
        finish(self._open())

    async def _wait(self, future: "Future[T]", timeout: float, what: str) -> T:
        return await block(future, timeout, what)

    async def _sleep(self, seconds: float) -> None:
        self._session.clock.sleep(seconds)

    def display(self, name: str | None = None) -> RemoteDisplay:
        """Return a display of this server.

        Parameters
        ----------
        name : str, optional
            Name of the display; it may be left out if the server has only one.

        Returns
        -------
        RemoteDisplay
            Display, the same at each call.

        Raises
        ------
        InputError
            If there are several and none is named, or none of that name (`NotFoundError`).
        """
        name = self._name(name)
        display: RemoteDisplay = self._displays.setdefault(name, RemoteDisplay(self, name))
        return display

    textures = blocking(AsyncConnection.textures)
    estop = blocking(AsyncConnection.estop)
    close = blocking(AsyncConnection.close)


@dataclass(frozen=True)
class Opener(Generic[C, D]):
    """Factory of either kind of connection.

    Attributes
    ----------
    connection : type
        Kind of the connections.
    display : type
        Kind of their displays.
    threaded : bool
        Whether the network has a thread of its own, or uses the running event loop.
    """

    connection: type[C]
    display: type[D]
    threaded: bool

    async def open_connection(
        self,
        url: str | None = None,
        *,
        token: str | None = None,
        timeout: float = TIMEOUT,
        client_name: str = CLIENT_NAME,
        reconnect: bool = True,
        rearm: bool = False,
        encoding: Encoding = "msgpack",
    ) -> C:
        """Connect to a server and all its displays; use the connection in a ``with``.

        Parameters
        ----------
        url : str, optional
            Address of the server; by default that of ``TACTILE_URL`` in the environment, otherwise
            that of the server on this machine.
        token : str, optional
            Secret, if the server asks for one; by default that of ``TACTILE_TOKEN`` in the
            environment.
        timeout : float
            Longest wait for the connection and, unless a call says otherwise, for each answer [s].
        client_name : str
            Name under which the server lists this program.
        reconnect : bool
            Whether to connect again in the background when the connection is lost.
        rearm : bool
            Whether to arm again then what this program had armed.
        encoding : str
            "msgpack", or "json" to read along.

        Returns
        -------
        Connection or AsyncConnection
            Connection that is open.

        Raises
        ------
        InputError
            If the address is none.
        DisconnectedError, ClientTimeoutError
            If there is no server.
        RequestError
            If it does not let this program in.
        """
        from tactile.client.websocket import TaskTransport, ThreadTransport

        kind = ThreadTransport if self.threaded else TaskTransport
        transport = kind(endpoint(url), timeout=timeout, reconnect=reconnect, encoding=encoding)
        connection = self.connection(
            transport, client_name=client_name, token=secret(token), timeout=timeout, rearm=rearm
        )
        await connection._open()
        return connection

    async def connect(
        self,
        url: str | None = None,
        *,
        display: str | None = None,
        token: str | None = None,
        timeout: float = TIMEOUT,
        client_name: str = CLIENT_NAME,
        reconnect: bool = True,
        rearm: bool = False,
        encoding: Encoding = "msgpack",
    ) -> D:
        """Connect to one display of a server; use the display in a ``with``.

        `open_connection` is for several displays.

        Parameters
        ----------
        url : str, optional
            Address of the server; by default that of ``TACTILE_URL`` in the environment, otherwise
            that of the server on this machine.
        display : str, optional
            Name of the display; it may be left out if the server has only one.
        token : str, optional
            Secret, if the server asks for one; by default that of ``TACTILE_TOKEN`` in the
            environment.
        timeout : float
            Longest wait for the connection and, unless a call says otherwise, for each answer [s].
        client_name : str
            Name under which the server lists this program.
        reconnect : bool
            Whether to connect again in the background when the connection is lost.
        rearm : bool
            Whether to arm again then what this program had armed.
        encoding : str
            "msgpack", or "json" to read along.

        Returns
        -------
        RemoteDisplay or AsyncDisplay
            Display, which closes its connection when it is closed.

        Raises
        ------
        InputError
            If the address is none, or there are several displays and none is named, or none of that
            name (`NotFoundError`).
        DisconnectedError, ClientTimeoutError
            If there is no server.
        RequestError
            If it does not let this program in.
        """
        connection = await self.open_connection(
            url,
            token=token,
            timeout=timeout,
            client_name=client_name,
            reconnect=reconnect,
            rearm=rearm,
            encoding=encoding,
        )
        try:
            return self.display(connection, connection._name(display), owns=True)
        except BaseException:
            await connection._close()
            raise


_opener = Opener(Connection, RemoteDisplay, threaded=True)
open_connection = blocking(_opener.open_connection)
connect = blocking(_opener.connect)
