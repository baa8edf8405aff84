"""What every transport does with messages: so many a second, requests in order, e-stop first."""

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

from msgspec import structs

from tactile.daemon.decoding import failed
from tactile.daemon.messages import (
    Answer,
    Command,
    Contact,
    Disarm,
    DisplayInfo,
    EStop,
    Event,
    Failure,
    Message,
    Reply,
    Role,
    Telemetry,
)
from tactile.daemon.metrics import Source, Traffic

log = logging.getLogger("tactile.server")

FINISH_WITHIN = 2.0
"""s that what makes safe may take after its client is gone."""
MOST_REQUESTS = 32
"""Of a client, that wait."""


class Client(Protocol):
    """A connection as the host knows it; `tactile.daemon.host.Client` is one."""

    outbox: "asyncio.Queue[Event | Telemetry]"

    @property
    def sounds(self) -> bool:
        """Whether it has waveforms or effects that may still sound."""
        ...

    @property
    def holds_voltage(self) -> bool:
        """Whether it armed a display whose high voltage is on."""
        ...

    def contact(self, message: Contact, arrival: float) -> Failure | None:
        """Take where the finger is; ``arrival`` is on the monotonic clock [s]."""
        ...

    async def request(self, command: Command) -> Answer:
        """Carry out a command; what is wrong with it is the answer."""
        ...

    def quiet(self) -> None:
        """Fade its waveforms and effects, since it gives no sign of life."""
        ...

    def give_up(self) -> None:
        """Give up its share of high voltage, since it gives no sign of life."""
        ...

    def close(self) -> None:
        """Lift the finger, fade what sounds. Idempotent."""
        ...


class Host(Source, Protocol):
    """All displays and who plays on them; `tactile.daemon.host.Host` is one."""

    async def start(self) -> None:
        """Open what plays."""
        ...

    async def close(self) -> None:
        """Fade, disarm, end. Idempotent."""
        ...

    async def reload(self) -> None:
        """Read textures and configuration again."""
        ...

    @property
    def displays(self) -> tuple[DisplayInfo, ...]:
        """What there is to play on."""
        ...

    def connect(self, name: str, *, roles: frozenset[Role]) -> Client:
        """Return a new client, which may do what its roles allow."""
        ...

    def beat(self) -> bool:
        """Return whether playback got on since the last call."""
        ...


def kind_of(message: Message) -> str:
    """Return what a message says as its ``type``."""
    return str(type(message).__struct_config__.tag)


def id_of(message: Message) -> int | None:
    """Return the id of a request; a `Contact` has none."""
    found: int | None = getattr(message, "id", None)
    return found


class TokenBucket:
    """Lets so many messages through in a second, and as many at once."""

    def __init__(self, rate: float) -> None:
        self._rate, self._left, self._time = rate, rate, 0.0
        self._told = -1.0
        self.refused = 0

    def take(self, now: float) -> bool:
        """Return whether one more may pass."""
        self._left = min(self._rate, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < 1:
            self.refused += 1
            return False
        self._left -= 1
        return True

    def is_to_be_told(self, now: float) -> bool:
        """Return whether it is time to say that messages are refused: once a second."""
        if now - self._told < 1:
            return False
        self._told = now
        return True


class Requests:
    """The requests of one client, carried out one after the other, beside its contacts."""

    def __init__(
        self,
        client: Client,
        traffic: Traffic,
        answered: Callable[[Answer], None],
    ) -> None:
        self._client, self._traffic, self._answered = client, traffic, answered
        self._waiting: list[Command] = []
        """Those that wait and, first, the one that is carried out."""
        self._new = asyncio.Event()
        self._urgent: set[asyncio.Task[None]] = set()
        self._worker = asyncio.create_task(self._work())

    def offer(self, command: Command) -> Failure | None:
        """Take a request; an e-stop is carried out at once."""
        queue = self._urgent if isinstance(command, EStop) else self._waiting
        if len(queue) >= MOST_REQUESTS:
            return failed("busy", f"{MOST_REQUESTS} requests wait", to=id_of(command))
        if isinstance(command, EStop):
            task = asyncio.create_task(self._carry_out(command))
            self._urgent.add(task)
            task.add_done_callback(self._urgent.discard)
        else:
            self._waiting.append(command)
            self._new.set()
        return None

    async def _work(self) -> None:
        while True:
            while self._waiting:
                await self._carry_out(self._waiting[0])
                del self._waiting[0]
            self._new.clear()
            await self._new.wait()

    async def _carry_out(self, command: Command) -> None:
        started = time.monotonic()
        try:
            answer = await self._client.request(command)
        except Exception:
            log.exception("a request failed")
            answer = failed("internal", "the daemon failed; its log says how")
        self._traffic.message(kind_of(command), time.monotonic() - started)
        if isinstance(answer, Reply) and answer.id != id_of(command):
            answer = structs.replace(answer, id=id_of(command))
        self._answered(answer)

    async def finish(self) -> None:
        """End, but first carry out what makes safe: each e-stop, and all up to the last disarm."""
        last = [i for i, command in enumerate(self._waiting) if isinstance(command, Disarm)]
        del self._waiting[last[-1] + 1 if last else 1 :]
        tasks = set(self._urgent)
        if last:
            tasks.add(asyncio.create_task(self._empty()))
        if tasks:
            await asyncio.wait(tasks, timeout=FINISH_WITHIN)
        rest = [self._worker, *tasks]
        for task in rest:
            task.cancel()
        await asyncio.gather(*rest, return_exceptions=True)

    async def _empty(self) -> None:
        while self._waiting:
            await asyncio.sleep(0.01)
