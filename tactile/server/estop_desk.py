"""Supervision of the e-stop process by the server: it is started, and restarted if it dies."""

import asyncio
import logging
from collections.abc import Mapping

from tactile.estop.latch import Latch
from tactile.estop.process import EstopReady, EstopSetup
from tactile.server.children import Child
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.server")

READY_WITHIN = 20.0
"""Time within which the process must listen [s]."""
RETRY = 1.0
"""Interval between attempts to start the process [s]."""
ENDING = 1.0
"""Time that the process may take to end [s]."""


class EstopDesk:
    """The e-stop process of a server.

    Attributes
    ----------
    address : str
        Address of its socket; empty while it does not listen.
    """

    def __init__(self) -> None:
        self.address = ""
        self._child: Child | None = None
        self._supervisor: asyncio.Task[None] | None = None

    async def start(self, latches: Mapping[str, Latch]) -> None:
        """Listen for e-stops of displays, in place of those of an earlier call.

        Parameters
        ----------
        latches : mapping of str to Latch
            Latches by name of the display.
        """
        await self.close()
        ready = asyncio.Event()
        self._supervisor = start_task(self._supervise(dict(latches), ready))
        await ready.wait()

    async def _supervise(self, latches: dict[str, Latch], ready: asyncio.Event) -> None:
        """Start the process, and start it again whenever it ends."""
        try:
            while True:
                try:
                    ended = await self._start_process(latches)
                    ready.set()
                    await ended.wait()
                    log.error("the e-stop process ended; it is started again")
                except OSError as error:  # no descriptor or memory left, which may change
                    log.error("the e-stop process cannot be started: %s", error)
                    ready.set()
                self.address = ""
                await asyncio.sleep(RETRY)
        finally:
            ready.set()

    async def _start_process(self, latches: dict[str, Latch]) -> asyncio.Event:
        """Start the process, wait until it listens; return an event that is set when it ends."""
        answered, ended = asyncio.Event(), asyncio.Event()

        def receive(what: object) -> None:
            if isinstance(what, EstopReady):
                self.address = what.address
                if what.failure:
                    log.error("tactile estop does not reach this server: %s", what.failure)
            else:
                ended.set()
            answered.set()

        inherited = (latch.descriptor for latch in latches.values())
        self._child = Child(
            "tactile.estop.process", receive, tuple(fd for fd in inherited if fd is not None)
        )
        handles = {name: latch.handle for name, latch in latches.items()}
        self._child.send(EstopSetup(handles))
        try:
            async with asyncio.timeout(READY_WITHIN):
                await answered.wait()
        except TimeoutError:
            log.error("the e-stop process does not listen after %g s", READY_WITHIN)
            self._child.kill()
        return ended

    async def close(self) -> None:
        """End the process; may be called repeatedly."""
        if self._supervisor is not None:
            self._supervisor.cancel()
            await asyncio.gather(self._supervisor, return_exceptions=True)
        if self._child is not None:
            await self._child.end(ENDING)
        self.address, self._supervisor, self._child = "", None, None
