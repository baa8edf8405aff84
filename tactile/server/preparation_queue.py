"""Queue of textures to prepare and to draw, one after the other, in a process of its own.

Clients take turns, so that many textures of one client delay those of another by one at most for
each client that waits. Pictures wait until no texture is to be prepared. What nobody waits for any
more is skipped at its turn.
"""

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Any

from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.commands import DeviceOpened
from tactile.rendering.surface_picture import SurfacePicture, SurfaceSection
from tactile.server import preparing
from tactile.server.children import Child

LONGEST = 40.0
"""Maximum time to prepare or draw a texture [s]; preparing for large displays takes longest."""
ENDING = 1.0
"""Time that the process may take to end [s]."""


@dataclass
class Job:
    """Texture that waits or is being prepared or drawn, and the clients that wait for it.

    Attributes
    ----------
    request : PreparationRequest or DrawingRequest
        What to prepare or to draw.
    clients : set of int
        Numbers of the clients that wait.
    answer : asyncio.Future of Preparation or Drawing
        Answer of the process.
    """

    request: preparing.PreparationRequest | preparing.DrawingRequest
    clients: set[int]
    answer: "asyncio.Future[Any]"

    @property
    def done(self) -> str:
        """Verb of the job for messages, "prepared" or "drawn"."""
        return "drawn" if isinstance(self.request, preparing.DrawingRequest) else "prepared"


class Turns:
    """Jobs that wait, of which those of different clients take turns."""

    def __init__(self) -> None:
        self._waiting: dict[int, deque[Job]] = {}

    def add(self, job: Job) -> None:
        """Add a job behind the others of its client.

        Parameters
        ----------
        job : Job
            Job of one client or of several, of which the first counts.
        """
        self._waiting.setdefault(min(job.clients, default=0), deque()).append(job)

    def take(self) -> Job | None:
        """Remove the job whose turn it is.

        Returns
        -------
        Job or None
            Next job, None if none waits.
        """
        if not self._waiting:
            return None
        client = next(iter(self._waiting))
        jobs = self._waiting.pop(client)
        job = jobs.popleft()
        if jobs:
            self._waiting[client] = jobs  # the client is the last in turn now
        return job

    def abandon(self) -> None:
        """Let nobody wait for the jobs any more."""
        for jobs in self._waiting.values():
            for job in jobs:
                job.clients.clear()


class PreparationQueue:
    """Textures to prepare and to draw in a process of its own, one after the other."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._preparations, self._drawings = Turns(), Turns()
        self._job: Job | None = None
        self._timeout: asyncio.TimerHandle | None = None
        self._number = 0

    async def prepare(
        self,
        display: Display,
        texture: str,
        seed: int,
        how: DeviceOpened,
        clients: set[int],
        *,
        largest: bool,
    ) -> preparing.Preparation:
        """Prepare a texture.

        Parameters
        ----------
        display : Display
            Display that the texture is for.
        texture : str
            Name of the texture.
        seed : int
            Seed of its realization.
        how : DeviceOpened
            How the device of the display plays.
        clients : set of int
            Numbers of the clients that wait; if all have left, the texture is skipped at its turn.
        largest : bool
            Whether to give the texture the largest gain that the limits allow.

        Returns
        -------
        Preparation
            Prepared texture.

        Raises
        ------
        BusError
            If the texture cannot be prepared, or nobody waits for it any more.
        """
        self._number += 1
        request = preparing.PreparationRequest(self._number, display, texture, seed, how, largest)
        job = Job(request, clients, asyncio.get_running_loop().create_future())
        self._preparations.add(job)
        self._start_next()
        prepared: preparing.Preparation = await job.answer
        return prepared

    async def draw(
        self, client: int, texture: str, seed: int, section: SurfaceSection
    ) -> SurfacePicture:
        """Draw the surface of a texture; if cancelled, the drawing is skipped at its turn.

        Parameters
        ----------
        client : int
            Number of the client that waits.
        texture : str
            Name of the texture.
        seed : int
            Seed of the realization.
        section : SurfaceSection
            What to draw of the surface.

        Returns
        -------
        SurfacePicture
            The picture.

        Raises
        ------
        BusError
            If the texture cannot be drawn.
        """
        self._number += 1
        request = preparing.DrawingRequest(self._number, texture, seed, section)
        job = Job(request, {client}, asyncio.get_running_loop().create_future())
        self._drawings.add(job)
        self._start_next()
        drawing: preparing.Drawing = await job.answer
        assert drawing.picture is not None  # there is no failure
        return drawing.picture

    def _start_next(self) -> None:
        """Pass the next texture to the process if it is idle; clients take turns."""
        while self._job is None:
            job = self._preparations.take() or self._drawings.take()
            if job is None:
                return
            if job.answer.done():
                continue
            if not job.clients:
                job.answer.set_exception(BusError("nobody waits for the texture any more"))
                continue
            try:
                self.begin()
                assert self._child is not None
                self._child.send(job.request)
            except (OSError, BusError) as error:  # no descriptor or memory left
                job.answer.set_exception(BusError(f"no texture can be {job.done}: {error}"))
                continue
            self._job = job
            self._timeout = asyncio.get_running_loop().call_later(LONGEST, self._give_up, job)

    def _receive(self, what: preparing.Preparation | preparing.Drawing | None) -> None:
        """Take an answer of the process, or None if the process has ended."""
        if what is None:
            self._kill()
            self._finish("the process that prepares textures has ended")
        elif self._job is not None and what.number == self._job.request.number:
            self._finish(what.failure, what)
        self._start_next()

    def _finish(
        self, failure: str, answer: preparing.Preparation | preparing.Drawing | None = None
    ) -> None:
        """Complete the present job with an answer, or with a failure."""
        job, self._job = self._job, None
        if self._timeout is not None:
            self._timeout.cancel()
        if job is None or job.answer.done():
            return
        if not failure and not job.clients:
            failure = "nobody waits for the texture any more"
        if failure or answer is None:
            job.answer.set_exception(BusError(failure))
        else:
            job.answer.set_result(answer)

    def _give_up(self, job: Job) -> None:
        """Give up a texture whose process hangs."""
        self._kill()
        self._finish(f"texture {job.request.texture} was not {job.done} within {LONGEST:g} s")
        self._start_next()

    def _kill(self) -> None:
        """Kill the process with its threads and pipes; the next texture starts another."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()

    def begin(self) -> None:
        """Start the process, so that it is ready when the first texture is requested."""
        if self._child is not None:
            return

        def on_answer(what: preparing.Preparation | preparing.Drawing | None) -> None:
            if self._child is child:  # ignore a process that was given up
                self._receive(what)

        child = self._child = Child("tactile.server.preparing", on_answer)

    async def close(self) -> None:
        """End the process; requests that wait fail."""
        child, self._child = self._child, None
        self._preparations.abandon()
        self._drawings.abandon()
        self._finish("the server ends")
        self._start_next()
        if child is not None:
            await child.end(ENDING)
