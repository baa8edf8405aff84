"""The SDK for programs with a frame loop.

Calls wait for the daemon, except `RemoteDisplay.touch`, which never does.

>>> import tactile
>>> with tactile.connect() as display:  # doctest: +SKIP
...     display.select("wood-oak")
...     display.arm()
...     display.touch((0.012, 0.003), velocity=(0.08, 0.0), normal_force=0.5)
"""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from types import TracebackType
from typing import Any, Self, TypeVar

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
from tactile.client.events import Callback, Dispatcher
from tactile.client.transport import Transport
from tactile.client.waveform import Waveform
from tactile.errors import ClientError, ClientTimeoutError
from tactile.messages import Done, Reply, Request, TextureInfo, kind_of

T = TypeVar("T")
R = TypeVar("R", bound=Reply)


def _wait(future: "Future[T]", timeout: float, what: str) -> T:
    """Return a future's result; stop waiting for it where it does not come."""
    try:
        return future.result(timeout)
    except BaseException as error:
        late = isinstance(error, TimeoutError) and not future.done()
        if not future.cancel() and late and future.done():
            return future.result()  # it came meanwhile
        if late:
            raise ClientTimeoutError(f"{what}: no answer in {timeout:g} s") from None
        raise


def open_connection(
    url: str | None = None,
    *,
    token: str | None = None,
    timeout: float = TIMEOUT,
    client_name: str = CLIENT_NAME,
    reconnect: bool = True,
    rearm: bool = False,
    encoding: Encoding = "msgpack",
) -> "Connection":
    """Connect to a daemon and all its displays; use it in a ``with``.

    Parameters
    ----------
    url : of the daemon; else the environment's TACTILE_URL, else of the one on this machine
    token : where the daemon wants one; else the environment's TACTILE_TOKEN
    timeout : for the connection and, where a call says nothing else, for each answer [s]
    client_name : under which the daemon lists this program
    reconnect : whether to connect again in the background when the connection is lost
    rearm : whether to arm again then what this program had armed
    encoding : "msgpack", or "json" to read along

    Raises
    ------
    InputError
        Where the address is none.
    DisconnectedError, ClientTimeoutError
        Where there is no daemon.
    RequestError
        Where it does not let this program in.
    """
    from tactile.client.websocket import ThreadTransport

    transport = ThreadTransport(
        endpoint(url), timeout=timeout, reconnect=reconnect, encoding=encoding
    )
    return Connection(
        transport, client_name=client_name, token=secret(token), timeout=timeout, rearm=rearm
    )


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
) -> "RemoteDisplay":
    """Connect to one display of a daemon: the only one, or the named one; use it in a ``with``.

    Parameters and exceptions are those of `open_connection`, which is for several displays, and:

    Parameters
    ----------
    display : its name, where the daemon has several

    Raises
    ------
    InputError
        Where there are several and none is named, or none of that name (then `NotFoundError`).
    """
    connection = open_connection(
        url,
        token=token,
        timeout=timeout,
        client_name=client_name,
        reconnect=reconnect,
        rearm=rearm,
        encoding=encoding,
    )
    try:
        return RemoteDisplay(connection, connection._name(display), owns=True)
    except BaseException:
        connection.close()
        raise


class Connection(BaseConnection):
    """A conversation with one daemon; `display` gives its displays. All may be used from threads.

    Parameters
    ----------
    transport : the way to the daemon
    options : as in `BaseConnection`
    """

    def __init__(self, transport: Transport, **options: Any) -> None:
        super().__init__(transport, **options)
        self._handed_out: dict[str, RemoteDisplay] = {}
        self._dispatcher = Dispatcher(self._session.counters)
        self._session.notify = self._dispatcher.put
        transport.open(self._session)
        try:
            _wait(self._session.ready, 2 * self.timeout, "connect")
        except BaseException:
            self._end()
            raise

    def display(self, name: str | None = None) -> "RemoteDisplay":
        """Return a display: the only one, or the named one.

        Raises
        ------
        InputError
            Where there are several and none is named, or none of that name (`NotFoundError`).
        """
        name = self._name(name)
        return self._handed_out.setdefault(name, RemoteDisplay(self, name))

    def textures(self, *, timeout: float | None = None) -> tuple[TextureInfo, ...]:
        """Return the textures that may be selected."""
        return self._ask(messages.ListTextures(), messages.Textures, timeout).textures

    def estop(self, *, timeout: float | None = None) -> dict[str, int]:
        """Set all displays to 0 V at once; return the number of each e-stop by display."""
        return self._ask(messages.EStop(), Done, timeout).estops

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event`, in a thread for that; also as a decorator.

        The callback may use the displays. Events are dropped and counted while it is slow.
        """
        self._dispatcher.add(as_callback(callback))
        return callback

    def close(self) -> None:
        """Stop the displays that were used, and close; within the timeout. Idempotent."""
        if not self._session.closed:
            self._stop(self._handed_out)
            self._end()

    def _stop(self, names: Iterable[str]) -> None:
        """Ask to fade out, and wait for at most half of the timeout."""
        deadline = self._session.clock.now() + self.timeout / 2
        with suppress(ClientError):
            stops = [self._session.ask(messages.StopPlaying(display=name)) for name in names]
            for stop in stops:
                _wait(stop, max(0.0, deadline - self._session.clock.now()), "stop")

    def _end(self) -> None:
        self._session.close()
        with suppress(ClientError):
            _wait(self._transport.close(), max(self.timeout, 1.0), "close")
        self._dispatcher.close(max(self.timeout, 1.0))

    def _ask(self, request: Request, kind: type[R], timeout: float | None) -> R:
        future, limit = self._begin(request, timeout)
        return as_kind(_wait(future, limit, kind_of(request)), kind)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class RemoteDisplay(BaseDisplay):
    """One display of a connection, with one finger on it. Get it from `connect`.

    Every call but `touch` and `lift` waits for the daemon, and may be given a timeout [s]. It
    raises `DisconnectedError` at once where the daemon is not there, `ClientTimeoutError` where it
    does not answer, `RequestError` where it refuses, and `InputError` for values out of range.
    """

    _connection: Connection

    def __init__(self, connection: Connection, name: str, *, owns: bool = False) -> None:
        super().__init__(name, owns)
        self._connection = connection
        connection._handed_out.setdefault(name, self)

    @property
    def connection(self) -> Connection:
        """The connection that it is of."""
        return self._connection

    def touch(
        self,
        position: Sequence[float],
        *,
        velocity: Sequence[float] | None = None,
        normal_force: float = NORMAL_FORCE,
        time: float | None = None,
    ) -> None:
        """Say where the finger is; never waits, whatever the network does.

        Only the newest contact is sent; those that it overtakes are counted, as are those while
        the daemon is not there (`dropped_contacts`).

        Parameters
        ----------
        position : on the surface [m]
        velocity : where it is known; else the daemon takes it from the positions [m/s]
        normal_force : how hard; 0 is lifted [N]
        time : of the sample, on the clock of `time.monotonic`; else now [s]

        Raises
        ------
        InputError
            Where a value is not finite, or out of range.
        """
        self._touch(position, normal_force, velocity, time)

    def lift(self, *, time: float | None = None) -> None:
        """Say that the finger has left the surface; never waits."""
        self._touch(self._position, 0.0, None, time)

    def select(self, layers: wire.Layers, *, timeout: float | None = None) -> None:
        """Choose what the finger feels; old and new cross-fade.

        Parameters
        ----------
        layers : a texture's name, a pair of name and gain (0 … 1), a `Layer`, or several of these,
            which lie on each other; ``()`` for nothing
        timeout : for the answer [s]
        """
        chosen = wire.to_layers(layers)
        self._ask(messages.Select(display=self.name, layers=chosen), timeout)

    def gain(self, gain: float, *, timeout: float | None = None) -> None:
        """Scale all that is this program's: 0 … 1."""
        self._ask(messages.SetGain(display=self.name, gain=wire.to_number(gain, "gain")), timeout)

    def stop(self, *, timeout: float | None = None) -> None:
        """Fade out: textures until `resume`, waveforms for good."""
        self._end_playback()
        self._ask(messages.StopPlaying(display=self.name), timeout)

    def resume(self, *, timeout: float | None = None) -> None:
        """Let the textures sound again after `stop`."""
        self._ask(messages.Play(display=self.name), timeout)

    def arm(self, *, timeout: float | None = None) -> None:
        """Switch high voltage on. A person is to know of it."""
        self._ask(messages.ArmDisplay(display=self.name), timeout)

    def disarm(self, *, timeout: float | None = None) -> None:
        """Fade out and switch high voltage off."""
        self._end_playback()
        self._ask(messages.DisarmDisplay(display=self.name), timeout)

    def estop(self, *, timeout: float | None = None) -> int:
        """Set this display to 0 V at once, until `clear`; `Connection.estop` sets all.

        It is armed again only by `arm`, whatever becomes of this call. Where the daemon is not
        there, or does not confirm, this raises, and it is sent first over the next connection.

        Returns
        -------
        int
            Number of the e-stop, which `clear` takes.
        """
        self._end_playback()
        request = messages.EStop(display=self.name)
        return self._connection._ask(request, Done, timeout).estops.get(self.name, 0)

    def clear(self, *, estop: int | None = None, timeout: float | None = None) -> None:
        """End an e-stop, where a person has decided so; the display is disarmed then.

        Parameters
        ----------
        estop : its number, by default `estopped`; a newer e-stop goes on
        timeout : for the answer [s]
        """
        if estop is None:
            estop = self.estopped or self.stats(timeout=timeout).estop or None
        if estop is not None:
            self._ask(messages.ClearEstop(display=self.name, estop=estop), timeout)

    def append(
        self,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        timeout: float | None = None,
    ) -> wire.Appended:
        """Send one message of a waveform, to play after what waits, as XR_FB_haptic_pcm does.

        Parameters
        ----------
        samples : −1 … 1, any sequence or buffer; what is beyond 4000 is cut
        sample_rate : of the samples [Hz]
        amplitude : shear at 1 [m]
        contactors : those that play it, all where none is named
        timeout : for the answer [s]

        Returns
        -------
        Appended
            How many samples the daemon took; send the rest again.
        """
        message = self._append(samples, sample_rate, amplitude, contactors)
        if message is None:
            return wire.Appended(0, 0.0)
        return wire.from_appended(self._connection._ask(message, messages.AppendedReply, timeout))

    def play(
        self,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        timeout: float | None = None,
    ) -> int:
        """Play a waveform in place of what waits; returns when the daemon has taken all of it.

        Parameters
        ----------
        samples : −1 … 1, of any length: also an iterator, which is read as it plays
        sample_rate, amplitude, contactors : as in `append`
        timeout : for each answer, and for how long the daemon may take nothing [s]

        Returns
        -------
        int
            How many samples were taken: fewer where another thread stopped it or played another.
        """
        waveform = Waveform(
            self.name,
            samples,
            sample_rate=sample_rate,
            amplitude=amplitude,
            contactors=contactors,
        )
        playback = self._playback(waveform, timeout)
        while (message := playback.message()) is not None:
            reply = self._connection._ask(message, messages.AppendedReply, timeout)
            self._connection._session.clock.sleep(playback.taken(message, reply))
        return playback.samples

    def effect(
        self,
        amplitude: float,
        *,
        amplitude_points: Iterable[tuple[float, float]] = (),
        frequency_points: Iterable[tuple[float, float]] = (),
        transients: Iterable[tuple[float, ...]] = (),
        stream: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Play amplitude and frequency over time, as XR_EXT_haptic_parametric.

        Parameters
        ----------
        amplitude : shear at 1 [m]
        amplitude_points : pairs of time [s] and value, 0 … 1, straight between them
        frequency_points : pairs of time [s] and frequency [Hz]
        transients : taps: time [s], value, and frequency [Hz] where it is not 160
        stream : whether it goes on from the last one
        timeout : for the answer [s]
        """
        made = wire.to_effect(
            self.name, amplitude, amplitude_points, frequency_points, transients, stream
        )
        self._ask(made, timeout)

    def transient(
        self, amplitude: float, *, frequency: float = 160.0, timeout: float | None = None
    ) -> None:
        """Play one tap now: amplitude [m], frequency [Hz]."""
        self.effect(amplitude, transients=[(0.0, 1.0, frequency)], timeout=timeout)

    def stats(self, *, timeout: float | None = None) -> wire.Stats:
        """Return how the display stands."""
        request = messages.GetStats(display=self.name)
        return wire.from_stats(self._connection._ask(request, messages.StatsReply, timeout))

    def textures(self, *, timeout: float | None = None) -> tuple[TextureInfo, ...]:
        """Return the textures that may be selected."""
        return self._connection.textures(timeout=timeout)

    def telemetry(self, rate: float = 30.0, *, timeout: float | None = None) -> "TelemetryStream":
        """Return what the display does, as often as that [Hz]: an iterator without end."""
        return TelemetryStream(self, rate, timeout)

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event` of this display or of all; as `Connection.on_event`."""
        self._connection.on_event(self._only_mine(callback))
        return callback

    def close(self) -> None:
        """Stop, and close the connection if `connect` made it for this display."""
        if self._owns:
            self._connection.close()
        else:
            self._end_playback()
            self._connection._stop([self.name])

    def _ask(self, request: Request, timeout: float | None) -> None:
        self._connection._ask(request, Done, timeout)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class TelemetryStream(BaseTelemetryStream, Iterator[wire.Telemetry]):
    """What a display does, as it comes; the newest 64 wait until they are read.

    Reading raises `ClientTimeoutError` where nothing comes; reading on is fine then. It goes on
    after a reconnection, and ends when the connection is closed. Get it from
    `RemoteDisplay.telemetry`.
    """

    def __next__(self) -> wire.Telemetry:
        if not self._asked:
            _wait(self._session.listen(self._queue), self._timeout, "telemetry")
            self._asked = True
        telemetry = _wait(self._queue.get(), self._timeout + 1 / self._queue.rate, "telemetry")
        if telemetry is None:
            raise StopIteration
        return telemetry

    def close(self) -> None:
        """Ask for no more; so it is also when nobody holds this any more."""
        self._session.leave(self._queue)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
