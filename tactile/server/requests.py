"""What every transport does with messages: requests in order, e-stop first."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from typing import Protocol

from msgspec import structs

from tactile.clock import loop_time
from tactile.messages import (
    Answer,
    ApiMessage,
    Command,
    Contact,
    DisarmDisplay,
    DisplayDescription,
    EStop,
    EventMessage,
    Failure,
    Reply,
    Role,
    TelemetryMessage,
    kind_of,
)
from tactile.server.decoding import failed
from tactile.server.metrics import MetricsSource, Traffic
from tactile.server.tasks import watched

log = logging.getLogger("tactile.server")

FINISH_WITHIN = 1.0
"""s that what makes safe may take after its client is gone."""
MOST_REQUESTS = 32
"""Of a client, that wait."""


class ClientProtocol(Protocol):
    """A connection as the host knows it; `tactile.server.client.Client` is one."""

    outbox: "asyncio.Queue[EventMessage | TelemetryMessage]"

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


class HostProtocol(MetricsSource, Protocol):
    """All displays and who plays on them; `tactile.server.host.Host` is one."""

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
    def displays(self) -> tuple[DisplayDescription, ...]:
        """What there is to play on."""
        ...

    def connect(self, name: str, *, roles: frozenset[Role]) -> ClientProtocol:
        """Return a new client, which may do what its roles allow."""
        ...

    def beat(self) -> bool:
        """Return whether playback got on since the last call."""
        ...

    def degrade(self, error: BaseException) -> None:
        """Disarm all displays after a failure that nobody expected."""
        ...


def id_of(message: ApiMessage) -> int | None:
    """Return the id of a request; a `Contact` has none."""
    found: int | None = getattr(message, "id", None)
    return found


class Requests:
    """The requests of one client, carried out one after the other, beside its contacts.

    Parameters
    ----------
    client : who asks
    traffic : counts them
    answered : is given each answer
    broke : called where carrying out ends by an exception, so that no more can be done
    """

    def __init__(
        self,
        client: ClientProtocol,
        traffic: Traffic,
        answered: Callable[[Answer], None],
        broke: Callable[[BaseException], object] | None = None,
    ) -> None:
        self._client, self._traffic, self._answered = client, traffic, answered
        self._waiting: list[Command] = []
        """Those that wait and, first, the one that is carried out."""
        self._new = asyncio.Event()
        self._ended = False
        self._broke = broke
        self._urgent: set[asyncio.Task[None]] = set()
        self._worker = watched(asyncio.create_task(self._work()), broke)

    def offer(self, command: Command) -> Failure | None:
        """Take a request; an e-stop is carried out at once."""
        queue = self._urgent if isinstance(command, EStop) else self._waiting
        if len(queue) >= MOST_REQUESTS:
            return failed("busy", f"{MOST_REQUESTS} requests wait", to=id_of(command))
        if isinstance(command, EStop):
            task = watched(asyncio.create_task(self._carry_out(command)), self._broke)
            self._urgent.add(task)
            task.add_done_callback(self._urgent.discard)
        else:
            self._waiting.append(command)
            self._new.set()
        return None

    async def _work(self) -> None:
        while not self._ended:  # also where a cancellation was swallowed
            if self._waiting:
                await self._carry_out(self._waiting[0])
                del self._waiting[0]
            else:
                self._new.clear()
                await self._new.wait()

    async def _carry_out(self, command: Command) -> None:
        started = loop_time()
        try:
            answer = await self._client.request(command)
        except Exception:
            log.exception("a request failed")
            answer = failed("internal", "the daemon failed; its log says how")
        self._traffic.message(kind_of(command), loop_time() - started)
        if isinstance(answer, Reply) and answer.id != id_of(command):
            answer = structs.replace(answer, id=id_of(command))
        self._answered(answer)

    async def finish(self) -> None:
        """End within `FINISH_WITHIN`; each e-stop and each disarm is still carried out.

        All else is dropped, also what is being carried out: it must neither arm for a client that
        is gone nor keep a disarm waiting. What does not end by then is left to itself.
        """
        self._ended = True
        self._worker.cancel()
        self._new.set()
        disarms = [command for command in self._waiting if isinstance(command, DisarmDisplay)]
        tasks = {*self._urgent, watched(asyncio.create_task(self._carry_out_each(disarms)))}
        try:
            await asyncio.wait(tasks, timeout=FINISH_WITHIN)
        finally:
            late = sum(task.cancel() for task in tasks)
            if late:
                log.error("requests of a client that is gone did not end")

    async def _carry_out_each(self, commands: Sequence[Command]) -> None:
        for command in commands:
            await self._carry_out(command)
