"""Where textures are made ready: one after the other, in a process that nobody has to wait for.

Clients take turns, so that many drawings of one hold up another's by one at most for each client
that waits. A drawing that nobody waits for any more is left out at its turn.
"""

import asyncio
from collections import deque
from dataclasses import dataclass

from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.commands import DeviceOpened
from tactile.server import drawing
from tactile.server.children import Child

LONGEST = 40.0
"""s that a drawing may take; a large display's takes some."""
ENDING = 1.0
"""s that the process may take to end."""


@dataclass
class Job:
    """A drawing that waits or is made, and the clients that wait for it."""

    request: drawing.DrawingRequest
    clients: set[int]
    order: "asyncio.Future[bytes]"


class Workbench:
    """Makes textures ready, in a process of its own."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._waiting: dict[int, deque[Job]] = {}
        self._job: Job | None = None
        self._limit: asyncio.TimerHandle | None = None
        self._number = 0

    async def make(
        self, display: Display, texture: str, seed: int, how: DeviceOpened, clients: set[int]
    ) -> tuple[int, bytes]:
        """Return a texture's number, and the order for playback to keep it.

        Parameters
        ----------
        display, how : for what it is made, and how that plays
        texture, seed : its name, and the seed of its realization
        clients : who waits for it; where they have all left it is given up at its turn

        Raises
        ------
        BusError
            Where it cannot be made, or nobody waits for it any more.
        """
        self._number += 1
        request = drawing.DrawingRequest(
            self._number, display, texture, seed, how.sample_rate, how.carriers, how.frame_rate
        )
        job = Job(request, clients, asyncio.get_running_loop().create_future())
        self._waiting.setdefault(min(clients, default=0), deque()).append(job)
        self._hand_on()
        return request.number, await job.order

    def _hand_on(self) -> None:
        """Hand the next drawing to the process, if it has none: clients take turns."""
        while self._job is None and self._waiting:
            client = next(iter(self._waiting))
            jobs = self._waiting.pop(client)
            job = jobs.popleft()
            if jobs:
                self._waiting[client] = jobs  # at the end
            if job.order.done():
                continue
            if not job.clients:
                job.order.set_exception(BusError("nobody waits for the texture any more"))
                continue
            try:
                self.begin()
                assert self._child is not None
                self._child.tell(job.request)
            except (OSError, BusError) as error:  # no descriptor or memory left
                job.order.set_exception(BusError(f"no texture can be made ready: {error}"))
                continue
            self._job = job
            self._limit = asyncio.get_running_loop().call_later(LONGEST, self._give_up, job)

    def _heard(self, what: drawing.Made | None) -> None:
        """Take an answer, or that the process has ended."""
        if what is None:
            self._kill()
            self._finish("the process that makes textures ready has ended")
        elif self._job is not None and what.number == self._job.request.number:
            self._finish(what.failure, what.order)
        self._hand_on()

    def _finish(self, failure: str, order: bytes = b"") -> None:
        job, self._job = self._job, None
        if self._limit is not None:
            self._limit.cancel()
        if job is None or job.order.done():
            return
        if not failure and not job.clients:
            failure = "nobody waits for the texture any more"
        if failure:
            job.order.set_exception(BusError(failure))
        else:
            job.order.set_result(order)

    def _give_up(self, job: Job) -> None:
        """Give up a drawing whose process hangs."""
        self._kill()
        self._finish(f"texture {job.request.texture} was not ready after {LONGEST:g} s")
        self._hand_on()

    def _kill(self) -> None:
        """End the process, and leave no thread or pipe of it; the next drawing starts another."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()

    def begin(self) -> None:
        """Start the process, so that it is there when the first texture is wanted."""
        if self._child is not None:
            return

        def heard(what: drawing.Made | None) -> None:
            if self._child is child:  # and not one that was given up
                self._heard(what)

        child = self._child = Child("tactile.server.drawing", heard)

    async def close(self) -> None:
        """End it; what waits for a drawing fails."""
        child, self._child = self._child, None
        for jobs in self._waiting.values():
            for job in jobs:
                job.clients.clear()
        self._finish("the server ends")
        self._hand_on()
        if child is not None:
            await child.end(ENDING)
