"""A display inside this program, without a server: the interface of `tactile.client`, no network.

>>> import tactile
>>> with tactile.open_display("reference-24", device="sim:") as display:  # doctest: +SKIP
...     display.select("wood-oak")
...     display.arm()
...     display.touch((0.0, 0.0), velocity=(0.08, 0.0), normal_force=0.5)

The host of a server runs in a thread. Playback and the preparation of textures run in processes of
their own, as in a server, so that nothing that the program does delays a block.
"""

import asyncio
import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

import msgspec

from tactile.client import Connection, RemoteDisplay
from tactile.client.base import TIMEOUT
from tactile.client.session import ClientSession
from tactile.messages import (
    ALL_ROLES,
    API_VERSION,
    Answer,
    ClientHello,
    Command,
    Streamed,
    Welcome,
    id_of,
)
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig
from tactile.server.host import Host
from tactile.server.metrics import Metrics, Traffic
from tactile.server.requests import Requests
from tactile.server.tasks import start_task

OPENING = 45.0
"""Time within which the device must open [s]."""
NAME = "default"
"""Name of the only display of the host."""


class LocalTransport:
    """Transport that carries messages to a host in a thread of this process.

    Parameters
    ----------
    config : Configuration
        Configuration of the host.
    """

    def __init__(self, config: Configuration) -> None:
        self._config = config
        self._started: Future[Host] = Future()
        self._closed: Future[None] = Future()
        self._closed.set_running_or_notify_cancel()  # a waiting caller cannot cancel it
        self._thread = threading.Thread(target=self._run, name="tactile-local", daemon=True)

    def start(self) -> None:
        """Start the thread and open the displays.

        Raises
        ------
        TactileError
            If a display cannot be opened.
        """
        self._thread.start()
        self._started.result(OPENING)

    def _run(self) -> None:
        try:
            asyncio.run(self._work())
        except BaseException as error:
            if not self._started.done():
                self._started.set_exception(error)
        finally:
            self._closed.set_result(None)

    async def _work(self) -> None:
        host = Host(self._config)
        await host.start()
        try:
            self._loop, self._ending = asyncio.get_running_loop(), asyncio.Event()
            self._host, self._client = host, host.connect("local", roles=ALL_ROLES)
            self._started.set_result(host)
            await self._ending.wait()
            self._client.close()
        finally:
            await host.close()

    @property
    def is_local(self) -> bool:
        """Whether the server is on this machine: it is in this process."""
        return True

    def open(self, session: ClientSession) -> None:
        """Open the connection to the host.

        Parameters
        ----------
        session : ClientSession
            Session that learns that the connection is open, and gets the answers.
        """
        self._session = session
        self._loop.call_soon_threadsafe(self._begin)

    def _begin(self) -> None:
        traffic = Traffic(Metrics(self._host), "local")
        self._requests = Requests(self._client, traffic, self._session.received)
        self._forwarding = start_task(self._forward_outbox(self._client))
        self._session.say_hello()

    async def _forward_outbox(self, client: Client) -> None:
        while True:
            self._session.received(await client.outbox.get())

    def send(self, command: Command) -> None:
        """Send a message; may be called from any thread.

        Parameters
        ----------
        command : Command
            Message to the host.
        """
        with suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(self._take, command, self._loop.time())

    def _take(self, command: Command, arrival: float) -> None:
        answer: Answer | None
        if isinstance(command, Streamed):
            answer = self._client.stream(command, arrival)
        elif isinstance(command, ClientHello):
            answer = Welcome(
                id=command.id, server="local", version=API_VERSION, session="local",
                displays=self._host.displays, may_arm=True, roles=tuple(sorted(ALL_ROLES)),
                time_us=int(self._loop.time() * 1e6),
            )  # fmt: skip
        else:
            answer = self._requests.offer(command)
        if answer is not None:
            self._session.received(msgspec.structs.replace(answer, id=id_of(command)))

    def close(self) -> "Future[None]":
        """Fade out, disarm, and end the thread.

        Returns
        -------
        Future of None
            Future that is done when the thread has ended.
        """
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._ending.set)
        return self._closed


def open_display(
    display: str = "reference-24",
    device: str = "sim:",
    *,
    sample_rate: float | None = None,
    worn: bool = False,
    accept_unsafe_hold: bool = False,
    timeout: float = TIMEOUT,
) -> RemoteDisplay:
    """Open a display in this program; use it in a ``with`` statement.

    Parameters
    ----------
    display : str
        "reference-24", "reference-64", or the path of a TOML file.
    device : str
        URL of the device, as in `tactile.open_bus`.
    sample_rate : float, optional
        Sample rate of the drive [Hz]; by default, the device chooses it.
    worn : bool
        Whether the finger stays on the display while it touches nothing.
    accept_unsafe_hold : bool
        As in `tactile.open_bus`.
    timeout : float
        Time to wait for an answer unless a call says otherwise [s].

    Returns
    -------
    RemoteDisplay
        The display. Closing it ends the host.

    Raises
    ------
    TactileError
        If the display or the device cannot be used.

    Examples
    --------
    >>> import tactile
    >>> with tactile.open_display("reference-24") as display:  # doctest: +SKIP
    ...     display.select("wood-oak")
    ...     display.arm()
    ...     display.touch((0.0, 0.0), velocity=(0.08, 0.0), normal_force=0.5)
    """
    options: dict[str, Any] = {} if sample_rate is None else {"sample_rate_hz": sample_rate}
    config = DisplayConfig(
        name=NAME, display=display, device=device, worn=worn,
        accept_unsafe_hold=accept_unsafe_hold, **options,
    )  # fmt: skip
    transport = LocalTransport(Configuration(display=(config,)))
    transport.start()
    connection = Connection(transport, timeout=timeout)
    return RemoteDisplay(connection, NAME, owns=True)
