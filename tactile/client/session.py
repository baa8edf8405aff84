"""Requests and their answers, and what is restored after a reconnection; without input or output.

A `ClientSession` stands between a connection, which asks, and a `Transport`, which carries
messages. Everything here may be called from any thread, and nothing waits.
"""

import threading
import weakref
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import msgspec

from tactile.client import wire
from tactile.client.desired_state import DesiredState, EStops
from tactile.client.onsets import Onsets
from tactile.client.telemetry_queue import TelemetryQueue
from tactile.client.transport import Transport
from tactile.clock import Clock
from tactile.errors import (
    ClientError,
    DisconnectedError,
    RefusedInputError,
    RequestError,
    UnknownNameError,
)
from tactile.messages import (
    Answer,
    ArmDisplay,
    ClearEstop,
    ClientHello,
    Command,
    DisarmDisplay,
    DisplayRequest,
    EStop,
    EventMessage,
    Failure,
    OnsetMessage,
    Ping,
    Pong,
    Reply,
    Request,
    Resume,
    StopPlaying,
    Streamed,
    Subscribe,
    TactileFrames,
    TelemetryMessage,
    Welcome,
    id_of,
    kind_of,
)  # fmt: skip

MOST_WAITING = 256
"""Maximum number of requests that wait for an answer at a time."""
MICROSECOND = 1e-6
"""Resolution of times in messages [s]."""
DRIFT = 100e-6
"""Largest difference of the rates of two machines' clocks (assumed: ±50 ppm of each crystal)."""
QUIETER = StopPlaying | DisarmDisplay | EStop
"""Requests that are never too many, and are sent even if nobody waits for the answer any more."""
RAISING = ArmDisplay | ClearEstop | Resume
"""Requests that an e-stop withdraws while they wait; disarming withdraws only `ArmDisplay`."""
DISARMED_BY = {"disarmed", "estopped", "lost"}
"""Kinds of events after which a display is not armed."""
REFUSALS: dict[str, type[RequestError]] = {
    "unknown_texture": UnknownNameError,
    "unknown_display": UnknownNameError,
    "invalid_field": RefusedInputError,
    "too_large": RefusedInputError,
}
"""Exceptions by the code of a failure; others are a `RequestError`."""


def refusal(failure: Failure) -> RequestError:
    """Return the exception for a failure.

    Parameters
    ----------
    failure : Failure
        Answer of the server.

    Returns
    -------
    RequestError
        Exception with the code, field and text of the failure.
    """
    where = f"{failure.field}: " if failure.field else ""
    kind = REFUSALS.get(failure.code, RequestError)
    return kind(f"{where}{failure.message}", code=failure.code, field=failure.field)


@dataclass
class ClockOffset:
    """Offset between two clocks, from the best of the last exchanges.

    Parameters
    ----------
    same_machine : bool
        Whether both are on one machine, as far as is known. They are then the same clock, unless an
        exchange proves the opposite, as it does if the address leads through a tunnel to another
        machine.

    Attributes
    ----------
    seconds : float
        Their clock less ours [s].
    round_trip : float
        Duration of the quickest exchange [s].
    """

    same_machine: bool = False
    seconds: float = 0.0
    round_trip: float = 0.0
    _exchanges: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=8))

    def exchange(self, sent: float, theirs: float, received: float) -> None:
        """Take one exchange.

        Parameters
        ----------
        sent : float
            Time of the question on our clock [s].
        theirs : float
            Time of the answer on their clock [s].
        received : float
            Time at which the answer came on our clock [s].
        """
        self._exchanges.append((received, received - sent, theirs - (sent + received) / 2))
        self.round_trip = min(trip for _, trip, _ in self._exchanges)
        self.same_machine &= abs(self._exchanges[-1][2]) <= (received - sent) / 2 + MICROSECOND
        best = min(self._exchanges, key=lambda exchange: self._uncertainty_of(exchange, received))
        self.seconds = 0.0 if self.same_machine else best[2]

    @staticmethod
    def _uncertainty_of(exchange: tuple[float, float, float], now: float) -> float:
        """Return how far the offset of an exchange may be wrong at a later time [s]."""
        received, trip, _ = exchange
        return trip / 2 + DRIFT * (now - received)

    def uncertainty(self, now: float) -> float:
        """Return half of the interval around `seconds` that holds the true offset.

        Parameters
        ----------
        now : float
            Time on our clock [s].

        Returns
        -------
        float
            Half of the interval; 0 before the first exchange [s].
        """
        if self.same_machine:
            return MICROSECOND
        return min((self._uncertainty_of(one, now) for one in self._exchanges), default=0.0)


class ClientSession:
    """One program's conversation with one server, over any number of connections.

    Parameters
    ----------
    transport : Transport
        Way to the server, which the connection opens and closes.
    hello : ClientHello
        First message over each connection.
    clock : Clock
        Clock of the program.
    rearm : bool
        Whether to arm again after a reconnection what was armed before.

    Attributes
    ----------
    clock : Clock
        Clock of the program.
    estops : EStops
        E-stops that are not confirmed, and those that hold.
    notify : Callable
        Function that takes each `Event`.
    welcome : Welcome or None
        What the server said about itself when it was last connected to.
    ready : Future
        Future of the first `Welcome`.
    connected : bool
        Whether the server is there now.
    closed : bool
        Whether the program has closed the session.
    reason : str
        Why there is no connection.
    offset : ClockOffset
        Offset of the server's clock from the program's.
    onsets : Onsets
        Stimuli whose onsets are not known yet.
    counters : Counter
        Counts by name, as in `BaseConnection.counters`.
    dropped_contacts : Counter
        Number of contacts not sent by the name of their display.
    """

    def __init__(
        self,
        transport: Transport,
        hello: ClientHello,
        *,
        clock: Clock,
        rearm: bool = False,
    ) -> None:
        self._transport, self._hello, self._rearm = transport, hello, rearm
        self.clock = clock
        self._lock = threading.RLock()  # a transport may answer before `send` returns
        self._last_id = 0
        self._waiting: dict[int, tuple[Request, Future[Any], float]] = {}
        self._desired: dict[str, DesiredState] = {}
        # queues by display, in the order in which they subscribed
        self._queues: dict[str, weakref.WeakKeyDictionary[TelemetryQueue, None]] = {}
        self._last_refusal = ("", 0.0)
        self.estops = EStops()
        self.notify: Callable[[wire.Event], None] = lambda event: None
        self.welcome: Welcome | None = None
        self.ready: Future[Welcome] = Future()
        self.connected = self.closed = self._final = False
        self.reason = "not connected yet"
        self.offset = ClockOffset(same_machine=transport.is_local)
        self.onsets = Onsets(clock, self._clock_offset)
        self.counters: Counter[str] = Counter(
            dict.fromkeys(
                ("dropped_contacts", "dropped_events", "dropped_frames", "dropped_telemetry",
                 "ignored_messages", "reconnections", "refused_messages"), 0,
            )
        )  # fmt: skip
        self.dropped_contacts: Counter[str] = Counter()

    def _clock_offset(self) -> tuple[float, float]:
        """Return the server's clock less the program's, and the uncertainty of that [s]."""
        return self.offset.seconds, self.offset.uncertainty(self.clock.now())

    # Called by a connection

    def request(self, command: Request) -> "Future[Any]":
        """Send a request.

        After an `EStop` or a `DisarmDisplay` a display is not armed again, whatever becomes of the
        request. An `EStop` that cannot be sent, or is not confirmed, is sent first over the next
        connection.

        Parameters
        ----------
        command : Request
            Request, which gets an id here.

        Returns
        -------
        Future
            Future of the answer; cancel it to stop waiting.

        Raises
        ------
        DisconnectedError
            If there is no connection.
        ClientError
            If too many requests wait already, unless the request makes a display quieter.
        """
        if isinstance(command, EStop | DisarmDisplay):
            self._withdraw(command)
        with self._lock:
            if not self.connected:
                raise self._disconnected(command, f"not connected: {self.reason}")
            if len(self._waiting) >= MOST_WAITING and not isinstance(command, QUIETER):
                raise ClientError(f"{MOST_WAITING} requests are already waiting for an answer")
            return self._send(command)

    def _withdraw(self, command: EStop | DisarmDisplay) -> None:
        """Arm no more, and fail requests that would raise voltage: none is sent."""
        stopping = isinstance(command, EStop)
        with self._lock:
            if stopping:
                self.estops.request(command.display)
            for display, desired in self._desired.items():
                if command.display in (None, display):
                    desired.disarm()
            waiting = list(self._waiting.values())
        for request, future, _ in waiting:
            raising = isinstance(request, RAISING if stopping else ArmDisplay)
            if raising and command.display in (None, getattr(request, "display", None)):
                what, by = kind_of(request), kind_of(command)
                with suppress(InvalidStateError):
                    future.set_exception(ClientError(f"{what}: withdrawn by {by}() meanwhile"))

    def _disconnected(self, command: Request, text: str) -> DisconnectedError:
        if isinstance(command, EStop) and not self._final:
            text += "; the e-stop is kept and will be sent first when the server is back"
        return DisconnectedError(text)

    def _send(self, command: Request) -> "Future[Any]":
        """Send a request; under the lock, so that requests go out in the order of the calls."""
        future: Future[Any] = Future()
        with self._lock:
            self._last_id = number = self._last_id + 1
            command = msgspec.structs.replace(command, id=number)
            self._waiting[number] = (command, future, self.clock.now())
            future.add_done_callback(lambda _: self._waiting.pop(number, None))
            if isinstance(command, EStop):
                self.estops.request(command.display, number)
            elif isinstance(command, ArmDisplay):
                self._desired_state(command.display).arming = number
            self._transport.send(command)  # type: ignore[arg-type]
        return future

    def send_streamed(self, message: Streamed) -> None:
        """Send a message of a stream, or count it if there is no connection.

        Parameters
        ----------
        message : Contact or TactileFrames
            Newest contact, or frames.
        """
        if self.connected:
            self._transport.send(message)
        else:
            self.dropped(message)

    def is_pending(self, command: Command) -> bool:
        """Return whether a message that was handed over is still to be sent.

        Parameters
        ----------
        command : Command
            Message that a transport is about to send.

        Returns
        -------
        bool
            False for a request whose answer nobody waits for, unless it makes a display quieter.
        """
        number = id_of(command)
        return number is None or number in self._waiting or isinstance(command, QUIETER)

    def subscribe(self, queue: TelemetryQueue) -> "Future[Any]":
        """Fill a queue with telemetry for as long as the program holds it.

        Parameters
        ----------
        queue : TelemetryQueue
            Queue with the name of a display and a rate.

        Returns
        -------
        Future
            Future of the server's answer.

        Raises
        ------
        InputError
            If the server gives no telemetry at that rate.
        DisconnectedError
            If there is no connection.
        """
        wire.checked(
            Subscribe(
                display=queue.display, rate_hz=queue.rate, contactor=queue.contactor,
                samples=queue.samples,
            )
        )  # fmt: skip
        with self._lock:
            self._queues.setdefault(queue.display, weakref.WeakKeyDictionary())[queue] = None
        return self.request(self._subscription(queue.display))

    def unsubscribe(self, queue: TelemetryQueue) -> None:
        """Stop filling a queue.

        Parameters
        ----------
        queue : TelemetryQueue
            Queue as given to `subscribe`.
        """
        with self._lock:
            self._queues.get(queue.display, weakref.WeakKeyDictionary()).pop(queue, None)
        queue.close()
        if self.connected:
            self._transport.send(self._subscription(queue.display))

    def _subscription(self, display: str) -> Subscribe:
        with self._lock:
            queues = list(self._queues.get(display, ()))
        rate = max((queue.rate for queue in queues), default=0.0)
        contactors = [queue.contactor for queue in queues if queue.contactor is not None]
        last = contactors[-1] if contactors else None
        samples = any(queue.samples for queue in queues)
        return Subscribe(display=display, rate_hz=rate, contactor=last, samples=samples)

    def close(self) -> None:
        """End the session: no request is answered any more."""
        self.closed = True
        self.lost("closed", final=True)
        with self._lock:
            queues = [queue for group in self._queues.values() for queue in group]
            self._queues.clear()
        for queue in queues:
            queue.close()

    # Called by a transport, from any thread

    def say_hello(self) -> "Future[Welcome]":
        """Say hello over a new connection.

        Returns
        -------
        Future
            Future that is done when the server has answered.
        """
        future = self._send(self._hello)
        future.add_done_callback(self._set_ready)
        return future

    def _set_ready(self, hello: "Future[Welcome]") -> None:
        with suppress(InvalidStateError):
            if hello.cancelled():
                return
            if (error := hello.exception()) is not None:
                self.ready.set_exception(error)
            else:
                self.ready.set_result(hello.result())

    def lost(self, reason: str, *, final: bool = False) -> None:
        """Fail requests that wait; further ones fail until the next connection.

        Parameters
        ----------
        reason : str
            Why there is no connection.
        final : bool
            Whether no other connection follows.
        """
        with self._lock:
            was, self.connected, self.reason = self.connected, False, reason
            self._final = final
            waiting = list(self._waiting.values())
            self.estops.disconnect()
        for command, future, _ in waiting:
            with suppress(InvalidStateError):
                future.set_exception(self._disconnected(command, reason))
        self.onsets.lost(reason)
        with suppress(InvalidStateError):
            self.ready.set_exception(DisconnectedError(reason))
        if was and not self.closed:
            self.notify(wire.Event("disconnected", detail=reason))

    def dropped(self, message: Streamed) -> None:
        """Count a message of a stream that was not sent.

        Parameters
        ----------
        message : Contact or TactileFrames
            Message.
        """
        if isinstance(message, TactileFrames):
            self.onsets.refused(message.begin, ClientError("the frame was not sent in time"))
        with self._lock:
            if isinstance(message, TactileFrames):
                self.counters["dropped_frames"] += self._frame_count(message)
            else:
                self.counters["dropped_contacts"] += 1
                self.dropped_contacts[message.display] += 1

    def _frame_count(self, message: TactileFrames) -> int:
        """Return the number of frames in a message."""
        displays = self.welcome.displays if self.welcome is not None else ()
        values = len(message.frames) // (4 if isinstance(message.frames, bytes) else 1)
        contactors = [len(d.contactors_mm) for d in displays if d.name == message.display]
        return values // contactors[0] if contactors else 0

    def ignored(self, message: str) -> None:
        """Count a message of the server that cannot be read.

        Parameters
        ----------
        message : str
            What is wrong with it.
        """
        with self._lock:
            self.counters["ignored_messages"] += 1

    def ping(self) -> "Future[Pong]":
        """Ask for the time of the server.

        Returns
        -------
        Future
            Future of its answer.
        """
        return self._send(Ping(time_us=wire.to_microseconds(self.clock.now())))

    def received(self, answer: Answer) -> None:
        """Take a message of the server.

        Parameters
        ----------
        answer : Answer
            Answer, event or telemetry.
        """
        if isinstance(answer, TelemetryMessage):
            self._fill(answer)
            return
        with self._lock:
            self.estops.report(answer)
        match answer:
            case EventMessage():
                if answer.kind in DISARMED_BY:
                    self._desired_state(answer.display).disarm()
                self.notify(
                    wire.Event(
                        answer.kind, answer.display, answer.detail, answer.estop, answer.contactors
                    )
                )
            case OnsetMessage(client=None):
                self.onsets.received(answer)
            case OnsetMessage():
                onset = wire.to_onset(answer, *self._clock_offset())
                self.notify(wire.Event("onset", answer.display, answer.reason, onset=onset))
            case _:
                self._answered(answer)

    def _desired_state(self, display: str) -> DesiredState:
        with self._lock:
            return self._desired.setdefault(display, DesiredState())

    def _fill(self, telemetry: TelemetryMessage) -> None:
        with self._lock:
            queues = list(self._queues.get(telemetry.display, ()))
            known = telemetry.display in self._queues
            if not queues:
                self._queues.pop(telemetry.display, None)
        if not queues and known:
            self._transport.send(Subscribe(display=telemetry.display, rate_hz=0))
        offset, uncertainty = self._clock_offset()
        item = wire.to_telemetry(telemetry, offset, uncertainty)
        lost = sum(queue.put(item) for queue in queues)
        if lost:
            with self._lock:
                self.counters["dropped_telemetry"] += lost

    def _answered(self, reply: Reply) -> None:
        command, future, sent = self._waiting.get(reply.id or 0, (None, None, 0.0))
        if command is None or future is None:
            if isinstance(reply, Failure) and reply.id is None:
                self._refuse(reply)
            return
        if isinstance(reply, Welcome):
            self._welcomed(reply, sent)
        elif isinstance(reply, Pong):
            self.offset.exchange(sent, reply.server_time_us * 1e-6, self.clock.now())
        elif not isinstance(reply, Failure):
            self._confirmed(command)
        elif isinstance(command, ArmDisplay) and reply.code == "estopped":
            self._desired_state(command.display).disarm()
        with suppress(InvalidStateError):
            if isinstance(reply, Failure):
                future.set_exception(refusal(reply))
            else:
                future.set_result(reply)

    def _confirmed(self, command: Request) -> None:
        if isinstance(command, DisplayRequest):
            with self._lock:
                self._desired_state(command.display).confirm(command)

    def _refuse(self, failure: Failure) -> None:
        """Count a message of a stream that was refused; notify of it once a second."""
        now = self.clock.now()
        with self._lock:
            self.counters["refused_messages"] += 1
            code, notified = self._last_refusal
            if code == failure.code and now - notified < 1.0:
                return
            self._last_refusal = (failure.code, now)
        self.notify(wire.Event("refused", detail=f"{failure.code}: {refusal(failure)}"))

    def _welcomed(self, welcome: Welcome, sent: float) -> None:
        self.offset = ClockOffset(same_machine=self._transport.is_local)
        self.offset.exchange(sent, welcome.time_us * 1e-6, self.clock.now())
        with self._lock:  # no other request comes between those that restore
            reconnected = self.welcome is not None
            self.welcome = welcome
            for estop in self.estops.unsent():
                self._send(estop).add_done_callback(self._report)
            if reconnected:
                self._restore(welcome)
            self.connected = not self.closed
            self.counters["reconnections"] += reconnected
        if reconnected:
            self.notify(wire.Event("connected", detail=welcome.server))

    def _restore(self, welcome: Welcome) -> None:
        for info in welcome.displays:
            if info.estop or info.name in self.estops.missed:
                self._desired_state(info.name).disarm()
        commands: list[Request] = [self._subscription(display) for display in self._queues]
        for desired in self._desired.values():
            commands += desired.restored(self._rearm)
        if not self._rearm:
            for desired in self._desired.values():
                desired.disarm()
        for command in commands:
            self._send(command).add_done_callback(self._report)

    def _report(self, restored: "Future[Any]") -> None:
        """Notify of a request that restores and was refused."""
        error = None if restored.cancelled() else restored.exception()
        if isinstance(error, RequestError):
            self.notify(wire.Event("refused", detail=f"{error.code}: {error}"))
