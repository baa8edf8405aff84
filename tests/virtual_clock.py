"""A clock that passes as far as the next thing that any process does, and the processes on it."""

import asyncio
import heapq
import itertools
import logging
import os
import pickle
import selectors
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from virtual_daemon import World

T = TypeVar("T")
PIPE = 0.3e-3
"""s from a process to another."""


class Clock:
    """Time of all processes [s], and what they will do when."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.interrupted = False
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()

    def __call__(self) -> float:
        return self.now

    def after(self, seconds: float, work: Callable[[], None]) -> None:
        """Have something done later."""
        heapq.heappush(self._events, (self.now + seconds, next(self._numbers), work))

    def advance(self, seconds: float, *, interruptible: bool = False) -> None:
        """Let time pass, until the event loop is given something where it is interruptible."""
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            when, _, work = heapq.heappop(self._events)
            self.now = max(self.now, when)
            work()
            if interruptible and self.interrupted:
                return
        self.now = max(self.now, end)


class VirtualSelector(selectors.SelectSelector):
    """Waits on the virtual clock; there are no files to wait for."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None or timeout > 0:
            self._clock.advance(60.0 if timeout is None else timeout, interruptible=True)
        self._clock.interrupted = False
        return []


class Errors(logging.Handler):
    """Collects each exception that anything of a daemon logs, or leaves."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.all: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info:
            self.all.append(f"{record.getMessage()}: {record.exc_info[1]!r}")

    def of_loop(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self.all.append(f"{context['message']}: {context.get('exception')!r}")


class Process:
    """In place of `tactile.daemon.children.Child`: the server's end of a process, and the process.

    Parameters
    ----------
    world : that it is in
    module, heard, inherited : as of `Child`
    """

    def __init__(
        self, world: "World", module: str, heard: Callable[[Any], None],
        inherited: tuple[int, ...] = (),
    ) -> None:  # fmt: skip
        self.world, self.clock, self._heard = world, world.clock, heard
        self._loop = asyncio.get_running_loop()
        self._files = {file: os.dup(file) for file in inherited}
        self.pid = next(world.numbers)
        self.alive, self.ending, self.hung = True, False, False
        world.processes.append(self)

    # The server's end

    def tell(self, order: object) -> None:
        """Send an order, or bytes that are the pickle of one."""
        data = order if isinstance(order, bytes) else pickle.dumps(order, protocol=5)
        self.clock.after(PIPE, lambda: self._deliver(data))

    async def end(self, patience: float) -> None:
        """Close its input and wait for its end; kill it after a while."""
        self.hang_up()
        deadline = self._loop.time() + patience
        while self.alive and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        self.kill()

    def hang_up(self) -> None:
        """Close its input."""
        self.clock.after(PIPE, self._deliver_end)

    def kill(self) -> None:
        """End it at once."""
        if self.alive:
            self.alive = False
            self.let_go()
            for file in self._files.values():
                os.close(file)
            self.world.processes.remove(self)
            self._post(None)

    # The process

    def handle(self, of_server: str) -> str:
        """Return the handle of a file for a mapping of this process's own."""
        return f"fd:{self._files[int(of_server.partition(':')[2])]}"

    def answer(self, what: object) -> None:
        """Send an answer."""
        self._post(pickle.dumps(what, protocol=5))

    def _post(self, data: bytes | None) -> None:
        def arrive() -> None:
            if self._loop is self.world.loop:
                self._loop.call_soon(self._heard, None if data is None else pickle.loads(data))
                self.clock.interrupted = True

        self.clock.after(PIPE, arrive)

    def _deliver(self, data: bytes) -> None:
        if self.alive:
            self.receive(pickle.loads(data))

    def _deliver_end(self) -> None:
        self.ending = True
        if self.alive and not self.hung:
            self.finish()

    def receive(self, order: Any) -> None:
        """Take an order."""
        raise NotImplementedError

    def finish(self) -> None:
        """End in good order."""
        self.kill()

    def let_go(self) -> None:
        """Unmap what it shares."""
