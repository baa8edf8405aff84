"""Displays of a connection: `RemoteDisplay`, and `AsyncDisplay` for asyncio.

Each call is written once, as a coroutine of `AsyncDisplay`: it checks what the program gave, makes
the message and reads the reply. It works on either display, as its ``self`` says, so that
`RemoteDisplay` has it as an ordinary method; see `tactile.client.waiting`.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from tactile import messages
from tactile.client import wire
from tactile.client.base import BaseConnection
from tactile.client.events import Callback, as_callback
from tactile.client.frames import FrameWriter
from tactile.client.onsets import At
from tactile.client.taxels import to_grid
from tactile.client.telemetry import AsyncTelemetryStream, TelemetryStream
from tactile.client.waiting import AsyncClosing, Closing, blocking
from tactile.client.waveform import Waveform, pause_after
from tactile.errors import ClientTimeoutError, InputError, NotFoundError
from tactile.messages import Done, EffectInfo, Reply, Request, TextureInfo

if TYPE_CHECKING:
    from tactile.client.connection import AsyncConnection, Connection

R = TypeVar("R", bound=Reply)
Beginning = messages.Append | messages.PlayEffect | messages.PlayNamedEffect
"""Request for what may begin at a time."""
DECIDED = 0.05
"""Time in which it becomes known that a stimulus whose time has come is dropped [s]."""
NORMAL_FORCE = 0.5
"""Normal force where a program knows only that there is contact [N]. Assumed: light exploration."""


@dataclass(eq=False)
class _Play:
    """A waveform that `play` sends, for some contactors or, if there are none, for all."""

    contactors: frozenset[int]
    is_over: bool = False


class BaseDisplay:
    """One display of a connection, with one finger on it.

    Parameters
    ----------
    connection : BaseConnection
        Connection that the display is of.
    name : str
        Name of the display.
    owns : bool
        Whether the connection is closed together with the display.

    Attributes
    ----------
    name : str
        Name of the display.
    """

    def __init__(self, connection: BaseConnection, name: str, *, owns: bool = False) -> None:
        self.name = name
        self._connection, self._owns = connection, owns
        self._position = (0.0, 0.0)
        self._plays: set[_Play] = set()
        connection._displays.setdefault(name, self)

    @property
    def connected(self) -> bool:
        """Whether the server is there now."""
        return self._connection.connected

    @property
    def info(self) -> wire.DisplayInfo:
        """Contactors and limits of the display.

        Raises
        ------
        NotFoundError
            If the server, after a reconnection, has no such display any more.
        """
        for info in self._connection.welcome.displays:
            if info.name == self.name:
                return wire.from_message(wire.DisplayInfo, info)
        raise NotFoundError(f"no display {self.name!r} any more")

    @property
    def estopped(self) -> int:
        """Number of the e-stop that holds as far as the server last reported, 0 for none."""
        return self._connection._session.estops.numbers.get(self.name, 0)

    @property
    def dropped_contacts(self) -> int:
        """Number of contacts not sent: a newer one came first, or the server was not there."""
        return self._connection._session.dropped_contacts[self.name]

    def on_event(self, callback: Callback) -> Callback:
        """Call back with each `Event` of this display or of all; as `BaseConnection.on_event`.

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
        as_callback(callback)

        def called(event: wire.Event) -> Any:
            return callback(event) if event.display in ("", self.name) else None

        self._connection.on_event(called)
        return callback

    @contextmanager
    def _play(self, contactors: tuple[int, ...]) -> Iterator[_Play]:
        """Begin a `play`, and end those on the same contactors; none are all."""
        for other in list(self._plays):
            if not contactors or not other.contactors or other.contactors & set(contactors):
                other.is_over = True
        play = _Play(frozenset(contactors))
        self._plays.add(play)
        try:
            yield play
        finally:
            self._plays.discard(play)

    def _end_plays(self) -> None:
        """End each `play`, which sends no more then."""
        for play in list(self._plays):
            play.is_over = True

    def frames(
        self,
        rate: float,
        *,
        amplitude: float,
        latest: bool = False,
        grid: Sequence[int] | None = None,
        extent: Iterable[float] | None = None,
    ) -> FrameWriter:
        """Return a writer of tactile frames, the shear of every contactor at one instant each.

        They are added to the textures. If no frame is written for a tenth of a second, they have
        faded out. A program has one stream on a display: another one replaces it.

        Parameters
        ----------
        rate : float
            Rate at which frames are written, 100 Hz … 192 kHz [Hz].
        amplitude : float
            Shear of a value of 1 [m].
        latest : bool
            Whether the display moves to the newest frame as soon as it comes, in a straight line
            within 1 / rate. By default every frame is played, in a band-limited signal, which is
            four frames and 3 ms later.
        grid : (2,) sequence of int, optional
            Number of rows and columns of a grid of taxels. Each frame is an image of it then, from
            which a contactor gets the mean over the area that is nearest to it.
        extent : (4,) iterable of float, optional
            Left, bottom, right and top side of the grid [m]; by default around all contactors,
            wider by half of their smallest distance.

        Returns
        -------
        FrameWriter
            Writer, of which `FrameWriter.write` sends a frame and never waits.

        Raises
        ------
        InputError
            If an argument is out of range.

        Examples
        --------
        Stream the images of a sensor of 16 × 48 taxels, in step with it::

            frames = display.frames(1000.0, amplitude=20e-6, grid=(16, 48))
            for image in sensor:
                frames.write(image)
        """
        if grid is None and extent is not None:
            raise InputError("extent: it belongs to a grid; give its size as grid=(rows, columns)")
        contactors = self.info.contactors
        taxels = None if grid is None else to_grid(grid, contactors, extent)
        message = wire.to_frames(self.name, rate, amplitude, latest=latest)
        return FrameWriter(self._connection._session, message, len(contactors), taxels)

    async def _do(self, request: Request, timeout: float | None) -> None:
        """Send a request that is answered by `Done`."""
        await self._connection._request(request, Done, timeout)

    async def _request_at(
        self, message: Beginning, at: float | At | None, kind: type[R], timeout: float | None
    ) -> R:
        """Send a request for a stimulus that begins at a time, and return its reply."""
        onsets = self._connection._session.onsets
        begin = onsets.begin(at)
        try:
            timed: Any = msgspec.structs.replace(message, begin=begin)
            return await self._connection._request(timed, kind, timeout)
        except ClientTimeoutError:
            raise  # it may be played, and is reported then
        except Exception as error:
            onsets.refused(begin, error)
            raise

    def _touch(
        self,
        position: Sequence[float],
        normal_force: float,
        velocity: Sequence[float] | None,
        time: float | None,
    ) -> None:
        """Send a contact without waiting."""
        session = self._connection._session
        time_us = wire.to_microseconds(session.clock.now() if time is None else time)
        contact = wire.to_contact(self.name, position, normal_force, velocity, time_us)
        x, y = contact.position_mm
        self._position = (x * 1e-3, y * 1e-3)
        session.send_streamed(contact)


class AsyncDisplay(AsyncClosing, BaseDisplay):
    """One display of a connection from asyncio, with one finger on it. Get it from `aio.connect`.

    Every call but `touch` and `lift` waits for the server, and may be given a timeout [s]. It
    raises `DisconnectedError` at once if the server is not there, `ClientTimeoutError` if it does
    not answer, `RequestError` if it refuses, and `InputError` for values out of range.
    """

    _connection: "AsyncConnection"

    @property
    def connection(self) -> "AsyncConnection":
        """Connection that the display is of."""
        return self._connection

    async def touch(
        self: BaseDisplay,
        position: Sequence[float],
        *,
        velocity: Sequence[float] | None = None,
        normal_force: float = NORMAL_FORCE,
        time: float | None = None,
    ) -> None:
        """Say where the finger is; this never waits, whatever the network does.

        Only the newest contact is sent; those that it overtakes are counted, as are those while
        the server is not there (`dropped_contacts`).

        Parameters
        ----------
        position : (2,) sequence of float
            Position on the surface [m].
        velocity : (2,) sequence of float, optional
            Velocity [m/s]; by default the server derives it from the positions.
        normal_force : float
            Normal force [N]; 0 means that the finger is lifted.
        time : float, optional
            Time of the sample on the clock of `time.monotonic` [s]; by default now.

        Raises
        ------
        InputError
            If a value is not finite, or out of range.
        """
        self._touch(position, normal_force, velocity, time)

    async def lift(self: BaseDisplay, *, time: float | None = None) -> None:
        """Say that the finger has left the surface; this never waits.

        Parameters
        ----------
        time : float, optional
            Time of the sample on the clock of `time.monotonic` [s]; by default now.
        """
        self._touch(self._position, 0.0, None, time)

    async def select(
        self: BaseDisplay, layers: wire.Layers, *, timeout: float | None = None
    ) -> None:
        """Choose what the finger feels; the old and the new texture cross-fade.

        Parameters
        ----------
        layers : str, tuple, Layer, or sequence of these
            Name of a texture, pair of name and gain (0 … 1), `Layer`, or several of these, which
            are added up; ``()`` for nothing. With gain 1, which is the default, a texture comes
            near the limits of the display, unless the server's configuration says otherwise.
        timeout : float, optional
            Longest wait for the answer [s].
        """
        await self._do(messages.Select(display=self.name, layers=wire.to_layers(layers)), timeout)

    async def gain(self: BaseDisplay, gain: float, *, timeout: float | None = None) -> None:
        """Scale everything that this program plays.

        Parameters
        ----------
        gain : float
            Factor, 0 … 1.
        timeout : float, optional
            Longest wait for the answer [s].
        """
        number = wire.to_number(gain, "gain")
        await self._do(messages.SetGain(display=self.name, gain=number), timeout)

    async def stop(self: BaseDisplay, *, timeout: float | None = None) -> None:
        """Fade out: textures until `resume`, waveforms for good.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].
        """
        self._end_plays()
        await self._do(messages.StopPlaying(display=self.name), timeout)

    async def resume(self: BaseDisplay, *, timeout: float | None = None) -> None:
        """Let the textures play again after `stop`.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].
        """
        await self._do(messages.Resume(display=self.name), timeout)

    async def arm(self: BaseDisplay, *, timeout: float | None = None) -> None:
        """Switch high voltage on. A person should know of it.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].
        """
        await self._do(messages.ArmDisplay(display=self.name), timeout)

    async def disarm(self: BaseDisplay, *, timeout: float | None = None) -> None:
        """Fade out and switch high voltage off.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].
        """
        self._end_plays()
        await self._do(messages.DisarmDisplay(display=self.name), timeout)

    async def estop(self: BaseDisplay, *, timeout: float | None = None) -> int:
        """Set this display to 0 V at once, until `clear`; that of the connection sets all.

        The display is armed again only by `arm`, whatever becomes of this call. If the server is
        not there, or does not confirm, this raises, and the e-stop is sent first over the next
        connection.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        int
            Number of the e-stop, which `clear` takes.
        """
        self._end_plays()
        done = await self._connection._request(messages.EStop(display=self.name), Done, timeout)
        return done.estops.get(self.name, 0)

    async def clear(
        self: BaseDisplay, *, estop: int | None = None, timeout: float | None = None
    ) -> None:
        """End an e-stop, after a person has decided so; the display is disarmed then.

        Parameters
        ----------
        estop : int, optional
            Number of the e-stop, by default `estopped`; a newer e-stop still holds.
        timeout : float, optional
            Longest wait for each answer [s].
        """
        if estop is None:
            estop = self.estopped or (await AsyncDisplay.stats(self, timeout=timeout)).estop or None
        if estop is not None:
            await self._do(messages.ClearEstop(display=self.name, estop=estop), timeout)

    async def append(
        self: BaseDisplay,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        at: float | At | None = None,
        timeout: float | None = None,
    ) -> wire.Appended:
        """Send one message of a waveform, as XR_FB_haptic_pcm does.

        It plays after what waits for the same contactors, at the same time as what others play.

        Parameters
        ----------
        samples : iterable of float
            Samples −1 … 1, any sequence or buffer; those beyond 4000 are cut off.
        sample_rate : float
            Sample rate [Hz].
        amplitude : float
            Shear of a sample of 1 [m].
        contactors : iterable of int
            Contactors that play it, by default all.
        at : float or At, optional
            Time on the clock of `time.monotonic` at which it is to begin, at most 60 s ahead [s].
            An `At` also says what became of it.
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        Appended
            How many samples the server took; send the rest again.
        """
        waveform = Waveform(
            self.name, samples, sample_rate=sample_rate, amplitude=amplitude,
            contactors=contactors, append=True,
        )  # fmt: skip
        message = waveform.message()
        if message is None:
            return wire.Appended(0, 0.0)
        reply = await self._request_at(message, at, messages.AppendedReply, timeout)
        return wire.from_message(wire.Appended, reply)

    async def play(
        self: BaseDisplay,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        at: float | At | None = None,
        timeout: float | None = None,
    ) -> int:
        """Play a waveform in place of what waits for its contactors.

        It returns when the server has taken all of it. Waveforms that other threads or tasks play
        on other contactors go on.

        Parameters
        ----------
        samples : iterable of float
            Samples −1 … 1, any number of them; an iterator is read as it plays.
        sample_rate : float
            Sample rate [Hz].
        amplitude : float
            Shear of a sample of 1 [m].
        contactors : iterable of int
            Contactors that play it, by default all.
        at : float or At, optional
            Time on the clock of `time.monotonic` at which it is to begin, at most 60 s ahead [s].
            An `At` also says what became of it.
        timeout : float, optional
            Longest wait for each answer, and for the server to take any sample [s].

        Returns
        -------
        int
            Number of samples that were taken: fewer if another thread or task stopped it or played
            something else on one of its contactors.

        Raises
        ------
        ClientTimeoutError
            If the server takes no sample for the timeout.
        """
        waveform = Waveform(
            self.name, samples, sample_rate=sample_rate, amplitude=amplitude, contactors=contactors
        )
        connection = self._connection
        limit, clock = connection._patience(timeout), connection._session.clock
        count, progress, begun = 0, clock.now(), False
        begin = at if at is None or isinstance(at, At) else At(at)
        with self._play(waveform.contactors) as play:
            while not play.is_over and (message := waveform.message()) is not None:
                if begin is not None and count and not begun:
                    # the rest follows the first part, once that is known to have begun
                    await connection._sleep(max(begin.time - clock.now(), DECIDED))
                    progress, begun = clock.now(), True
                    if begin.dropped or play.is_over:
                        break
                first = None if count else begin
                reply = await self._request_at(message, first, messages.AppendedReply, timeout)
                appended = wire.from_message(wire.Appended, reply)
                waveform.consume(appended.samples_consumed)
                if appended.samples_consumed:
                    count += appended.samples_consumed
                    progress = clock.now()
                elif clock.now() - progress > limit:
                    text = f"play on {self.name}: no sample was taken in {limit:g} s"
                    raise ClientTimeoutError(text)
                await connection._sleep(pause_after(message, appended))
        return count

    async def effect(
        self: BaseDisplay,
        amplitude: float,
        *,
        amplitude_points: Iterable[tuple[float, float]] = (),
        frequency_points: Iterable[tuple[float, float]] = (),
        transients: Iterable[tuple[float, ...]] = (),
        stream: bool = False,
        at: float | At | None = None,
        timeout: float | None = None,
    ) -> None:
        """Play amplitude and frequency over time, as XR_EXT_haptic_parametric.

        Parameters
        ----------
        amplitude : float
            Shear of an amplitude of 1 [m].
        amplitude_points : iterable of (float, float)
            Pairs of time [s] and amplitude, 0 … 1, joined by straight lines.
        frequency_points : iterable of (float, float)
            Pairs of time [s] and frequency [Hz], joined by straight lines.
        transients : iterable of tuple of float
            Taps: time [s], amplitude, and frequency [Hz] if it is not 160 Hz.
        stream : bool
            Whether the effect continues the last one.
        at : float or At, optional
            Time on the clock of `time.monotonic` at which it is to begin, at most 60 s ahead [s].
            An `At` also says what became of it.
        timeout : float, optional
            Longest wait for the answer [s].
        """
        effect = wire.to_effect(
            self.name, amplitude, amplitude_points, frequency_points, transients, stream
        )
        await self._request_at(effect, at, Done, timeout)

    async def play_effect(
        self: BaseDisplay,
        name: str,
        *,
        gain: float = 1.0,
        at: float | At | None = None,
        timeout: float | None = None,
    ) -> None:
        """Play an effect of the server's folder, in place of the waveform that waits.

        Parameters
        ----------
        name : str
            Name of an effect, as in `effects`.
        gain : float
            Factor, 0 … 1.
        at : float or At, optional
            Time on the clock of `time.monotonic` at which it is to begin, at most 60 s ahead [s].
            An `At` also says what became of it.
        timeout : float, optional
            Longest wait for the answer [s].
        """
        number = wire.to_number(gain, "gain")
        message = messages.PlayNamedEffect(display=self.name, effect=name, gain=number)
        await self._request_at(message, at, Done, timeout)

    async def effects(self: BaseDisplay, *, timeout: float | None = None) -> tuple[EffectInfo, ...]:
        """Return the effects that may be played by name.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        tuple of EffectInfo
            Effects that the server has.
        """
        request = messages.ListEffects()
        return (await self._connection._request(request, messages.Effects, timeout)).effects

    async def transient(
        self: BaseDisplay,
        amplitude: float,
        *,
        frequency: float = 160.0,
        at: float | At | None = None,
        timeout: float | None = None,
    ) -> None:
        """Play one tap, by default now.

        Parameters
        ----------
        amplitude : float
            Shear of the tap [m].
        frequency : float
            Frequency [Hz].
        at : float or At, optional
            Time on the clock of `time.monotonic` at which it is to begin, at most 60 s ahead [s].
            An `At` also says what became of it.
        timeout : float, optional
            Longest wait for the answer [s].
        """
        tap = (0.0, 1.0, frequency)
        await AsyncDisplay.effect(self, amplitude, transients=[tap], at=at, timeout=timeout)

    async def stats(self: BaseDisplay, *, timeout: float | None = None) -> wire.Stats:
        """Return the state of the display.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for the answer [s].

        Returns
        -------
        Stats
            State, link, latency and counters.
        """
        request = messages.GetStats(display=self.name)
        reply = await self._connection._request(request, messages.StatsReply, timeout)
        return wire.from_message(wire.Stats, reply)

    async def textures(
        self: BaseDisplay, *, timeout: float | None = None
    ) -> tuple[TextureInfo, ...]:
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
        request = messages.ListTextures()
        return (await self._connection._request(request, messages.Textures, timeout)).textures

    def telemetry(
        self,
        rate: float = 30.0,
        *,
        contactor: int | None = None,
        samples: bool = False,
        timeout: float | None = None,
    ) -> AsyncTelemetryStream:
        """Return a stream of what the display does, for ``async for``.

        Parameters
        ----------
        rate : float
            Rate of the telemetry [Hz].
        contactor : int, optional
            Contactor whose commanded shear `Telemetry.trace` holds sample by sample. There is one
            for all streams of a display, the one that was given last.
        samples : bool
            Whether `Telemetry.samples` holds all that is played, sample by sample. More items come
            than ``rate`` says if the samples do not fit into a message. While such a stream is
            open, an `Event` "onset" tells what became of each stimulus of another program that was
            to begin at a time.
        timeout : float, optional
            Longest wait for each item, beyond its period [s].

        Returns
        -------
        AsyncTelemetryStream
            Stream that ends with the connection.
        """
        return AsyncTelemetryStream(self, rate, timeout, contactor, samples=samples)

    async def close(self: BaseDisplay) -> None:
        """Stop, and close the connection if `connect` made it for this display."""
        if self._owns:
            await self._connection._close()
        else:
            self._end_plays()
            await self._connection._stop([self.name])


class RemoteDisplay(Closing, BaseDisplay):
    """One display of a connection, with one finger on it. Get it from `connect`.

    Every call but `touch` and `lift` waits for the server, and may be given a timeout [s]. It
    raises `DisconnectedError` at once if the server is not there, `ClientTimeoutError` if it does
    not answer, `RequestError` if it refuses, and `InputError` for values out of range.
    """

    _connection: "Connection"

    @property
    def connection(self) -> "Connection":
        """Connection that the display is of."""
        return self._connection

    touch = blocking(AsyncDisplay.touch)
    lift = blocking(AsyncDisplay.lift)
    select = blocking(AsyncDisplay.select)
    gain = blocking(AsyncDisplay.gain)
    stop = blocking(AsyncDisplay.stop)
    resume = blocking(AsyncDisplay.resume)
    arm = blocking(AsyncDisplay.arm)
    disarm = blocking(AsyncDisplay.disarm)
    estop = blocking(AsyncDisplay.estop)
    clear = blocking(AsyncDisplay.clear)
    append = blocking(AsyncDisplay.append)
    play = blocking(AsyncDisplay.play)
    effect = blocking(AsyncDisplay.effect)
    play_effect = blocking(AsyncDisplay.play_effect)
    effects = blocking(AsyncDisplay.effects)
    transient = blocking(AsyncDisplay.transient)
    stats = blocking(AsyncDisplay.stats)
    textures = blocking(AsyncDisplay.textures)
    close = blocking(AsyncDisplay.close)

    def telemetry(
        self,
        rate: float = 30.0,
        *,
        contactor: int | None = None,
        samples: bool = False,
        timeout: float | None = None,
    ) -> TelemetryStream:
        """Return a stream of what the display does: an iterator without end.

        Parameters
        ----------
        rate : float
            Rate of the telemetry [Hz].
        contactor : int, optional
            Contactor whose commanded shear `Telemetry.trace` holds sample by sample. There is one
            for all streams of a display, the one that was given last.
        samples : bool
            Whether `Telemetry.samples` holds all that is played, sample by sample. More items come
            than ``rate`` says if the samples do not fit into a message. While such a stream is
            open, an `Event` "onset" tells what became of each stimulus of another program that was
            to begin at a time.
        timeout : float, optional
            Longest wait for each item, beyond its period [s].

        Returns
        -------
        TelemetryStream
            Stream that ends with the connection.
        """
        return TelemetryStream(self, rate, timeout, contactor, samples=samples)
