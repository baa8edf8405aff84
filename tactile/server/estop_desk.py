"""The server's end of the e-stop process: it starts it, and starts it again where it dies."""

import asyncio
import logging
from collections.abc import Mapping

from tactile.estop.latch import Latch
from tactile.estop.process import EstopReady, EstopSetup
from tactile.server.children import Child
from tactile.server.tasks import watched

log = logging.getLogger("tactile.server")

READY_WITHIN = 20.0
"""s in which the process must listen."""
RETRY = 1.0
"""s between attempts to start it."""
ENDING = 1.0
"""s that its end may take."""


class EstopDesk:
    """The e-stop process of a daemon.

    Attributes
    ----------
    address : of its socket, empty while it does not listen
    """

    def __init__(self) -> None:
        self.address = ""
        self._child: Child | None = None
        self._keeper: asyncio.Task[None] | None = None

    async def start(self, latches: Mapping[str, Latch]) -> None:
        """Listen for e-stops of displays, in place of those of an earlier call.

        Parameters
        ----------
        latches : by the name of the display
        """
        await self.close()
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._keeper = watched(asyncio.create_task(self._keep(dict(latches), ready)))
        await ready

    async def _keep(self, latches: dict[str, Latch], ready: "asyncio.Future[None]") -> None:
        try:
            while True:
                try:
                    ended = await self._begin(latches)
                    if not ready.done():
                        ready.set_result(None)
                    await ended.wait()
                    log.error("the e-stop process ended; it is started again")
                except OSError as error:  # no descriptor or memory left: there may be some later
                    log.error("the e-stop process cannot be started: %s", error)
                    if not ready.done():
                        ready.set_result(None)
                self.address = ""
                await asyncio.sleep(RETRY)
        finally:
            if not ready.done():
                ready.set_result(None)

    async def _begin(self, latches: dict[str, Latch]) -> asyncio.Event:
        """Start the process; return an event that is set when it has ended."""
        answered, ended = asyncio.Event(), asyncio.Event()

        def receive(what: object) -> None:
            if isinstance(what, EstopReady):
                self.address = what.address
                if what.failure:
                    log.error("tactile estop does not reach this daemon: %s", what.failure)
            else:
                ended.set()
            answered.set()

        inherited = (latch.descriptor for latch in latches.values())
        self._child = Child(
            "tactile.estop.process", receive, tuple(fd for fd in inherited if fd is not None)
        )
        handles = {name: latch.handle for name, latch in latches.items()}
        self._child.tell(EstopSetup(handles))
        try:
            async with asyncio.timeout(READY_WITHIN):
                await answered.wait()
        except TimeoutError:
            log.error("the e-stop process does not listen after %g s", READY_WITHIN)
            self._child.kill()
        return ended

    async def close(self) -> None:
        """End the process; idempotent."""
        if self._keeper is not None:
            self._keeper.cancel()
            await asyncio.gather(self._keeper, return_exceptions=True)
        if self._child is not None:
            await self._child.end(ENDING)
        self.address, self._keeper, self._child = "", None, None
