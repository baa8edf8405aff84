"""Requests of a client, as every transport handles them: in order, e-stops first.

Pictures are drawn beside the others, which must not wait for them.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence

from msgspec import structs

from tactile.clock import loop_time
from tactile.messages import (
    Answer,
    Command,
    DisarmDisplay,
    DrawTexture,
    EStop,
    Failure,
    Reply,
    id_of,
    kind_of,
)
from tactile.server.client import Client
from tactile.server.decoding import failed
from tactile.server.metrics import Traffic
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.server")

FINISH_WITHIN = 1.0
"""Time in which what makes displays safe must be done after its client has left [s]."""
MOST_REQUESTS = 32
"""Maximum number of requests, of e-stops and of pictures, each, for which a client may wait."""


class Requests:
    """Requests of one client, carried out independently of its contacts.

    E-stops and pictures are begun at once, all others one after the other.

    Parameters
    ----------
    client : Client
        Client that sends the requests.
    traffic : Traffic
        Counters of the transport.
    on_answer : callable
        Function that is called with each answer.
    on_failure : callable, optional
        Function that is called if an exception ends the processing, so that nothing more can be
        done.
    """

    def __init__(
        self,
        client: Client,
        traffic: Traffic,
        on_answer: Callable[[Answer], None],
        on_failure: Callable[[BaseException], object] | None = None,
    ) -> None:
        self._client, self._traffic, self._on_answer = client, traffic, on_answer
        self._waiting: list[Command] = []
        # The first is the request that is being carried out, the others wait.
        self._arrived = asyncio.Event()
        self._ended = False
        self._on_failure = on_failure
        self._urgent: set[asyncio.Task[None]] = set()
        self._drawings: set[asyncio.Task[None]] = set()
        self._worker = start_task(self._work(), on_failure)

    def offer(self, command: Command) -> Failure | None:
        """Queue a request; an e-stop and a drawing are begun at once.

        Parameters
        ----------
        command : Command
            Message of the client.

        Returns
        -------
        Failure or None
            A `Failure` if too many requests are queued.
        """
        tasks = self._tasks_beside(command)
        waiting = self._waiting if tasks is None else tasks
        if len(waiting) >= MOST_REQUESTS:
            return failed("busy", f"{MOST_REQUESTS} requests wait", to=id_of(command))
        if tasks is not None:
            start_task(self._carry_out(command), self._on_failure, among=tasks)
        else:
            self._waiting.append(command)
            self._arrived.set()
        return None

    def _tasks_beside(self, command: Command) -> set[asyncio.Task[None]] | None:
        """Return the tasks of requests like this one, None for a request that waits its turn."""
        if isinstance(command, EStop):
            return self._urgent
        return self._drawings if isinstance(command, DrawTexture) else None

    async def _work(self) -> None:
        while not self._ended:  # ends the loop even if a request swallowed the cancellation
            if self._waiting:
                await self._carry_out(self._waiting[0])
                del self._waiting[0]
            else:
                self._arrived.clear()
                await self._arrived.wait()

    async def _carry_out(self, command: Command) -> None:
        """Carry out a request and pass on its answer."""
        started = loop_time()
        try:
            answer = await self._client.request(command)
        except Exception:
            log.exception("a request failed")
            answer = failed("internal", "the server failed; its log says how")
        self._traffic.message(kind_of(command), loop_time() - started)
        if isinstance(answer, Reply) and answer.id != id_of(command):
            answer = structs.replace(answer, id=id_of(command))
        self._on_answer(answer)

    async def finish(self) -> None:
        """End within `FINISH_WITHIN`; each e-stop and each disarm is still carried out.

        Everything else is dropped, including the request that is being carried out: it must neither
        arm for a client that has left nor delay a disarm. What has not ended by then is abandoned.
        """
        self._ended = True
        for task in (self._worker, *self._drawings):
            task.cancel()
        self._arrived.set()
        disarms = [command for command in self._waiting if isinstance(command, DisarmDisplay)]
        tasks = {*self._urgent, start_task(self._carry_out_each(disarms))}
        try:
            await asyncio.wait(tasks, timeout=FINISH_WITHIN)
        finally:
            late = sum(task.cancel() for task in tasks)
            if late:
                log.error("requests of a client that is gone did not end")

    async def _carry_out_each(self, commands: Sequence[Command]) -> None:
        for command in commands:
            await self._carry_out(command)
