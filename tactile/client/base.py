"""What the connections and displays of both twins have in common: names, addresses, messages."""

import difflib
import os
import socket
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from typing import Any, Literal, TypeVar
from urllib.parse import urlsplit

from tactile import paths
from tactile.client import wire
from tactile.client.events import Callback
from tactile.client.session import QUIETER, ClientSession
from tactile.client.telemetry import TelemetryQueue
from tactile.client.transport import Transport
from tactile.client.waveform import Waveform
from tactile.clock import MONOTONIC, Clock
from tactile.errors import ClientError, ClientTimeoutError, InputError, NotFoundError
from tactile.messages import (
    PATH,
    Append,
    ArmDisplay,
    ClientHello,
    Contact,
    Reply,
    Request,
    Role,
    Select,
    Welcome,
)

PORT = 7411
EXAMPLE_URL = f"ws://127.0.0.1:{PORT}{PATH}"
UNIX = "ws+unix://"
"""What the address of a Unix socket begins with; its path follows."""
TIMEOUT = 1.0
"""s for an answer, where nothing else is said."""
PATIENT = 20.0
"""s, at least, for what takes the daemon longer: to make a texture ready, to start a device."""
LONGEST_TIMEOUT = 1e6
"""s that a program may wait for an answer."""
CLIENT_NAME = "python"
NORMAL_FORCE = 0.5
"""N; where a program knows only that there is contact. Assumed: light exploration."""
SHORTEST_PAUSE, LONGEST_PAUSE = 0.005, 0.1
"""s to wait before what the daemon had no room for is sent again."""
Encoding = Literal["msgpack", "json"]
R = TypeVar("R", bound=Reply)


def default_url() -> str:
    """Return the address of the daemon on this machine: of its Unix socket where it has one."""
    found = paths.find_sockets()
    return f"{UNIX}{found[0]}" if found else EXAMPLE_URL


def endpoint(url: str | None) -> str:
    """Return the address of a daemon: as given, of ``TACTILE_URL``, or on this machine.

    Raises
    ------
    InputError
        Where it is no address of a WebSocket.
    """
    url = url or os.environ.get("TACTILE_URL") or default_url()
    if not isinstance(url, str):
        raise InputError(f"url {url!r} is not a text as {EXAMPLE_URL!r}")
    if url.startswith(UNIX):
        if not hasattr(socket, "AF_UNIX") or not url.startswith(f"{UNIX}/"):
            raise InputError(f"url {url!r}: not as {UNIX}/run/tactile/tactile.sock, on Linux")
        return url
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise InputError(f"url {url!r}: {error}") from None
    if parts.scheme not in ("ws", "wss") or not parts.hostname:
        raise InputError(f"url {url!r} is not as {EXAMPLE_URL}")
    where = parts.netloc if port or parts.scheme == "wss" else f"{parts.netloc}:{PORT}"
    path = parts.path if parts.path.strip("/") else PATH
    return parts._replace(netloc=where, path=path).geturl()


def secret(token: str | None) -> str:
    """Return the token as given, or of ``TACTILE_TOKEN``."""
    return token if token is not None else os.environ.get("TACTILE_TOKEN", "")


def as_callback(callback: Callback) -> Callback:
    """Return something that can be called.

    Raises
    ------
    InputError
        Where it cannot be.
    """
    if not callable(callback):
        raise InputError(f"callback: {wire.shown(callback)} is not a function")
    return callback


def as_kind(reply: Reply, kind: type[R]) -> R:
    """Return a reply that is of a kind.

    Raises
    ------
    ClientError
        Where it is another.
    """
    if not isinstance(reply, kind):
        raise ClientError(f"the daemon answered {type(reply).__name__}, not {kind.__name__}")
    return reply


class BaseConnection:
    """A conversation with one daemon, whatever it goes over.

    Parameters
    ----------
    transport : the way to the daemon
    client_name : under which the daemon lists this program
    token : where the daemon wants one
    timeout : for an answer, where a call says nothing else [s]
    rearm : whether to arm again after a reconnection what was armed before
    clock : of this program, for the time of contacts and for timeouts
    """

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

    def _begin(self, request: Request, timeout: float | None) -> "tuple[Future[Any], float]":
        """Send a request; return the future of its answer, and how long to wait for it [s].

        What makes a display quieter is sent also where the timeout is none.
        """
        try:
            limit = self._limit(request, timeout)
        except InputError:
            if isinstance(request, QUIETER):
                self._session.ask(request)
            raise
        return self._session.ask(wire.checked(request)), limit

    def _limit(self, request: Request, timeout: float | None) -> float:
        """Return how long to wait for an answer [s]."""
        patient = timeout is None and isinstance(request, Select | ArmDisplay)
        return max(self.timeout, PATIENT) if patient else self._patience(timeout)

    def _patience(self, timeout: float | None) -> float:
        """Return a timeout as given, or the connection's [s].

        Raises
        ------
        InputError
            Where it cannot be waited for.
        """
        if timeout is None:
            return self.timeout
        seconds = wire.to_number(timeout, "timeout [s]")
        if not 0 <= seconds <= LONGEST_TIMEOUT:
            raise InputError(f"timeout: {seconds:g} s is not in 0 … {LONGEST_TIMEOUT:g} s")
        return seconds

    @property
    def connected(self) -> bool:
        """Whether the daemon is there now."""
        return self._session.connected

    @property
    def welcome(self) -> Welcome:
        """What the daemon said of itself when it was last connected to.

        Raises
        ------
        ClientError
            Before that.
        """
        if self._session.welcome is None:
            raise ClientError("not connected yet")
        return self._session.welcome

    @property
    def displays(self) -> dict[str, wire.DisplayInfo]:
        """The displays that the daemon has, by name."""
        return {info.name: wire.from_info(info) for info in self.welcome.displays}

    @property
    def roles(self) -> frozenset[Role]:
        """What the daemon lets this program do: some of "watch", "play", "arm" and "stop"."""
        return frozenset(self.welcome.roles)

    @property
    def clock_offset(self) -> float:
        """The daemon's clock less this program's monotonic one [s]."""
        return self._session.offset.seconds

    @property
    def round_trip(self) -> float:
        """Of the quickest of the last messages [s]."""
        return self._session.offset.round_trip

    @property
    def counters(self) -> dict[str, int]:
        """What this side counts.

        ``dropped_contacts`` (a newer one came, or the daemon was not there), ``refused_contacts``,
        ``dropped_events`` and ``dropped_telemetry`` (not read in time), ``ignored_messages`` (of
        a later version), ``reconnections``.
        """
        return dict(self._session.counters)

    def _name(self, display: str | None) -> str:
        """Return the name of a display that is there, or of the only one."""
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


class BaseDisplay:
    """One display of a connection; it has one finger."""

    _connection: BaseConnection

    def __init__(self, name: str, owns: bool) -> None:
        self.name = name
        self._owns = owns
        self._position = (0.0, 0.0)
        self._playing = 0

    @property
    def connected(self) -> bool:
        """Whether the daemon is there now."""
        return self._connection.connected

    @property
    def info(self) -> wire.DisplayInfo:
        """Its contactors and limits.

        Raises
        ------
        NotFoundError
            Where the daemon, after a reconnection, has no such display any more.
        """
        for info in self._connection.welcome.displays:
            if info.name == self.name:
                return wire.from_info(info)
        raise NotFoundError(f"no display {self.name!r} any more")

    @property
    def estopped(self) -> int:
        """Number of the e-stop that holds as far as the daemon last reported; 0 for none."""
        return self._connection._session.estops.numbers.get(self.name, 0)

    @property
    def dropped_contacts(self) -> int:
        """How many were not sent: a newer one came first, or the daemon was not there."""
        return self._connection._session.dropped_contacts[self.name]

    def _touch(
        self,
        position: Sequence[float],
        normal_force: float,
        velocity: Sequence[float] | None,
        time_s: float | None,
    ) -> None:
        when = self._connection._session.clock.now() if time_s is None else time_s
        now = wire.to_microseconds(when)
        contact: Contact = wire.to_contact(self.name, position, normal_force, velocity, now)
        x, y = contact.position_mm
        self._position = (x * 1e-3, y * 1e-3)
        self._connection._session.tell(contact)

    def _append(
        self,
        samples: Iterable[float],
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int],
    ) -> Append | None:
        waveform = Waveform(
            self.name,
            samples,
            sample_rate=sample_rate,
            amplitude=amplitude,
            contactors=contactors,
            append=True,
        )
        return waveform.message()

    def _only_mine(self, callback: Callback) -> Callback:
        as_callback(callback)

        def called(event: wire.Event) -> Any:
            return callback(event) if event.display in ("", self.name) else None

        return called

    def _playback(self, waveform: Waveform, timeout: float | None) -> "Playback":
        self._playing += 1
        connection = self._connection
        return Playback(self, waveform, connection._patience(timeout), connection._session.clock)

    def _end_playback(self) -> None:
        """Let a `play` of another thread or task send no more."""
        self._playing += 1


class Playback:
    """A `play` in progress: what to send next, how long to wait, and when to give up."""

    def __init__(
        self, display: BaseDisplay, waveform: Waveform, timeout: float, clock: Clock
    ) -> None:
        self._display, self._waveform, self._timeout = display, waveform, timeout
        self._mine = display._playing
        self._clock = clock
        self._progress = clock.now()
        self.samples = 0

    def message(self) -> Append | None:
        """Return what to send next; None where all was taken or the display was stopped."""
        return self._waveform.message() if self._display._playing == self._mine else None

    def taken(self, message: Append, reply: Any) -> float:
        """Take the daemon's answer and return how long to wait [s].

        Raises
        ------
        ClientTimeoutError
            Where the daemon took nothing for the timeout.
        """
        appended, now = wire.from_appended(reply), self._clock.now()
        self._waveform.taken(appended.samples_consumed)
        self.samples += appended.samples_consumed
        if appended.samples_consumed:
            self._progress = now
        elif now - self._progress > self._timeout:
            raise ClientTimeoutError(
                f"play on {self._display.name}: no sample was taken in {self._timeout:g} s"
            )
        if appended.samples_consumed * 4 >= len(message.samples):
            return 0.0
        return min(max(appended.buffered / 2, SHORTEST_PAUSE), LONGEST_PAUSE)


class BaseTelemetryStream:
    """What a display does, as it comes.

    Parameters
    ----------
    display : whose it is
    rate : how often it is to come [Hz]
    timeout : for each, beyond its period; by default the connection's [s]
    """

    def __init__(self, display: BaseDisplay, rate: float, timeout: float | None) -> None:
        self._session = display._connection._session
        self._queue = TelemetryQueue(display.name, rate)
        self._timeout, self._asked = display._connection._patience(timeout), False
