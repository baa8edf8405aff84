"""What both twins share: requests and their answers, and what is to be restored; no I/O, no clock.

A `Session` stands between a twin (`sync`, `aio`), which asks, and a `Transport`, which carries.
Everything here may be called from any thread, and nothing waits.
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
from tactile.client.telemetry import TelemetryQueue
from tactile.client.transport import Transport
from tactile.daemon.messages import (
    Answer,
    Arm,
    Command,
    Contact,
    Disarm,
    EStop,
    Event,
    Failure,
    Gain,
    Hello,
    Ping,
    Play,
    Pong,
    Reply,
    Request,
    Select,
    Stop,
    Subscribe,
    Telemetry,
    Welcome,
)  # fmt: skip
from tactile.errors import (
    ClientError,
    DisconnectedError,
    RefusedInputError,
    RequestError,
    UnknownNameError,
)

MOST_WAITING = 256
"""Requests at a time."""
QUIETER = Stop | Disarm | EStop
"""Requests that are sent also where nobody waits for the answer any more."""
DISARMED_BY = {"disarmed", "estopped", "lost"}
"""Events after which a display is not armed."""
REFUSALS: dict[str, type[RequestError]] = {
    "unknown_texture": UnknownNameError,
    "unknown_display": UnknownNameError,
    "invalid_field": RefusedInputError,
    "too_large": RefusedInputError,
}


def refusal(failure: Failure) -> RequestError:
    """Return the exception for a failure."""
    where = f"{failure.field}: " if failure.field else ""
    made = REFUSALS.get(failure.code, RequestError)
    return made(f"{where}{failure.message}", code=failure.code, field=failure.field)


@dataclass
class Clock:
    """What lies between two clocks: the quickest of the last exchanges tells it best."""

    offset: float = 0.0
    round_trip: float = 0.0
    _seen: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=8))

    def exchange(self, asked: float, theirs: float, answered: float) -> None:
        """Take one exchange: our time at either end, and theirs between [s]."""
        self._seen.append((answered - asked, theirs - (asked + answered) / 2))
        self.round_trip, self.offset = min(self._seen)


@dataclass
class Wishes:
    """What a program has of one display, as far as the daemon confirmed it."""

    layers: Select | None = None
    gain: Gain | None = None
    stop: Stop | None = None
    armed: Arm | None = None

    def granted(self, command: Command) -> None:
        """Remember what was done."""
        match command:
            case Select():
                self.layers = command
            case Gain():
                self.gain = command
            case Stop():
                self.stop = command
            case Play():
                self.stop = None
            case Arm():
                self.armed = command
            case Disarm():
                self.armed = None

    def restored(self, rearm: bool) -> list[Request]:
        """Return what to ask of a daemon that knows nothing of us; high voltage comes last."""
        wished = [self.gain, self.layers, self.stop, self.armed if rearm else None]
        return [command for command in wished if command is not None]


class Session:
    """One program's conversation with one daemon, over any number of connections.

    Parameters
    ----------
    transport : carries the messages; opened and closed by the twin
    hello : what to say first
    monotonic : the program's clock [s]
    rearm : whether to arm again after a reconnection what was armed before
    """

    def __init__(
        self,
        transport: Transport,
        hello: Hello,
        *,
        monotonic: Callable[[], float],
        rearm: bool = False,
    ) -> None:
        self._transport, self._hello, self._rearm = transport, hello, rearm
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self._last_id = 0
        self._waiting: dict[int, tuple[Request, Future[Any], float]] = {}
        self._wishes: dict[str, Wishes] = {}
        self._queues: dict[str, weakref.WeakSet[TelemetryQueue]] = {}
        self._refused: tuple[str, float] = ("", 0.0)
        self.notify: Callable[[wire.Event], None] = lambda event: None
        self.welcome: Welcome | None = None
        self.ready: Future[Welcome] = Future()
        self.connected = self.closed = False
        self.reason = "not connected yet"
        self.clock = Clock()
        self.counters: Counter[str] = Counter(
            dict.fromkeys(
                ("dropped_contacts", "dropped_events", "dropped_telemetry", "ignored_messages",
                 "reconnections", "refused_contacts"), 0,
            )
        )  # fmt: skip
        self.dropped_contacts: Counter[str] = Counter()

    # What a twin asks

    def ask(self, command: Request) -> "Future[Any]":
        """Send a request and return the future of its answer; cancel it to stop waiting.

        Raises
        ------
        DisconnectedError
            Where there is no connection.
        ClientError
            Where too many requests wait already.
        """
        if not self.connected:
            raise DisconnectedError(f"not connected: {self.reason}")
        if len(self._waiting) >= MOST_WAITING:
            raise ClientError(f"{MOST_WAITING} requests wait for an answer already")
        return self._ask(command)

    def _ask(self, command: Request) -> "Future[Any]":
        future: Future[Any] = Future()
        with self._lock:
            self._last_id = number = self._last_id + 1
            command = msgspec.structs.replace(command, id=number)
            self._waiting[number] = (command, future, self._monotonic())
        future.add_done_callback(lambda _: self._waiting.pop(number, None))
        self._transport.send(command)  # type: ignore[arg-type]
        return future

    def tell(self, contact: Contact) -> None:
        """Send a contact, or count it where there is no connection."""
        if self.connected:
            self._transport.send(contact)
        else:
            self.dropped(contact.display)

    def wanted(self, command: Command) -> bool:
        """Tell whether a message that was handed over is still to be sent."""
        number = getattr(command, "id", None)
        return number is None or number in self._waiting or isinstance(command, QUIETER)

    def listen(self, queue: TelemetryQueue) -> "Future[Any]":
        """Fill a queue with telemetry for as long as anyone holds it."""
        wire.checked(Subscribe(display=queue.display, rate_hz=queue.rate))
        with self._lock:
            self._queues.setdefault(queue.display, weakref.WeakSet()).add(queue)
        return self.ask(self._subscription(queue.display))

    def leave(self, queue: TelemetryQueue) -> None:
        """Fill a queue no longer."""
        with self._lock:
            self._queues.get(queue.display, weakref.WeakSet()).discard(queue)
        queue.close()
        if self.connected:
            self._transport.send(self._subscription(queue.display))

    def _subscription(self, display: str) -> Subscribe:
        with self._lock:
            rates = [queue.rate for queue in self._queues.get(display, ())]
        return Subscribe(display=display, rate_hz=max(rates, default=0.0))

    def close(self) -> None:
        """End it: nothing is answered any more."""
        self.closed = True
        self.lost("closed")
        with self._lock:
            queues = [queue for group in self._queues.values() for queue in group]
            self._queues.clear()
        for queue in queues:
            queue.close()

    # What a transport tells

    def opened(self) -> "Future[Welcome]":
        """Say hello; the future is done when the daemon has answered."""
        future = self._ask(self._hello)
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

    def lost(self, reason: str) -> None:
        """Fail what waits; until the next `opened` nothing can be asked."""
        with self._lock:
            was, self.connected, self.reason = self.connected, False, reason
            waiting = [future for _, future, _ in self._waiting.values()]
        for future in [*waiting, self.ready]:
            with suppress(InvalidStateError):
                future.set_exception(DisconnectedError(reason))
        if was and not self.closed:
            self.notify(wire.Event("disconnected", detail=reason))

    def dropped(self, display: str) -> None:
        """Count a contact that was not sent."""
        with self._lock:
            self.counters["dropped_contacts"] += 1
            self.dropped_contacts[display] += 1

    def ignored(self, message: str) -> None:
        """Count an answer that cannot be read."""
        with self._lock:
            self.counters["ignored_messages"] += 1

    def ping(self) -> "Future[Pong]":
        """Ask what time it is there."""
        return self._ask(Ping(time_us=wire.to_microseconds(self._monotonic())))

    def received(self, answer: Answer) -> None:
        """Take what the daemon says."""
        match answer:
            case Telemetry():
                self._fill(answer)
            case Event():
                if answer.kind in DISARMED_BY:
                    self._of(answer.display).armed = None
                self.notify(wire.Event(answer.kind, answer.display, answer.detail))
            case _:
                self._answered(answer)

    def _of(self, display: str) -> Wishes:
        with self._lock:
            return self._wishes.setdefault(display, Wishes())

    def _fill(self, telemetry: Telemetry) -> None:
        with self._lock:
            queues = list(self._queues.get(telemetry.display, ()))
            known = telemetry.display in self._queues
            if not queues:
                self._queues.pop(telemetry.display, None)
        if not queues and known:
            self._transport.send(Subscribe(display=telemetry.display, rate_hz=0))
        made = wire.from_telemetry(telemetry, self.clock.offset)
        lost = sum(queue.put(made) for queue in queues)
        if lost:
            with self._lock:
                self.counters["dropped_telemetry"] += lost

    def _answered(self, reply: Reply) -> None:
        command, future, asked = self._waiting.get(reply.id or 0, (None, None, 0.0))
        if command is None or future is None:
            if isinstance(reply, Failure) and reply.id is None:
                self._refuse(reply)
            return
        if isinstance(reply, Welcome):
            self._welcomed(reply, asked)
        elif isinstance(reply, Pong):
            self.clock.exchange(asked, reply.server_time_us * 1e-6, self._monotonic())
        elif not isinstance(reply, Failure):
            self._granted(command)
        with suppress(InvalidStateError):
            if isinstance(reply, Failure):
                future.set_exception(refusal(reply))
            else:
                future.set_result(reply)

    def _granted(self, command: Request) -> None:
        if isinstance(command, EStop):
            names = [command.display] if command.display else list(self._wishes)
            for name in names:
                self._of(name).armed = None
        elif (display := getattr(command, "display", None)) is not None:
            self._of(display).granted(command)  # type: ignore[arg-type]

    def _refuse(self, failure: Failure) -> None:
        """Tell once a second what is wrong with a stream, rather than at its rate."""
        now = self._monotonic()
        with self._lock:
            self.counters["refused_contacts"] += 1
            code, told = self._refused
            if code == failure.code and now - told < 1.0:
                return
            self._refused = (failure.code, now)
        self.notify(wire.Event("refused", detail=f"{failure.code}: {refusal(failure)}"))

    def _welcomed(self, welcome: Welcome, asked: float) -> None:
        self.clock = Clock()
        self.clock.exchange(asked, welcome.time_us * 1e-6, self._monotonic())
        again = self.welcome is not None
        self.welcome = welcome
        if again:
            self._restore()
        with self._lock:
            self.connected = not self.closed
            self.counters["reconnections"] += again
        if again:
            self.notify(wire.Event("connected", detail=welcome.server))

    def _restore(self) -> None:
        with self._lock:
            wishes, displays = dict(self._wishes), list(self._queues)
        commands = [self._subscription(display) for display in displays]
        for command in [
            *commands, *(c for wish in wishes.values() for c in wish.restored(self._rearm))
        ]:  # fmt: skip
            self._ask(command).add_done_callback(self._told)
        if not self._rearm:
            for wish in wishes.values():
                wish.armed = None

    def _told(self, restored: "Future[Any]") -> None:
        error = None if restored.cancelled() else restored.exception()
        if isinstance(error, RequestError):
            self.notify(wire.Event("refused", detail=f"{error.code}: {error}"))
