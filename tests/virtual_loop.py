"""Processes of one event loop each, on a virtual clock: their time is virtual, their sockets real.

A socket's other end is in another loop of the same process of the system. It has at once what is
sent, as over a Unix socket, and its loop runs in its turn.
"""

import asyncio
import logging
import os
import selectors
import socket
from collections.abc import Coroutine, Iterable
from concurrent.futures import Future
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any, TypeVar

from virtual_clock import LONGEST, VirtualClock

T = TypeVar("T")


class VirtualSelector(selectors.DefaultSelector):
    """Selector that waits on the virtual clock, until a file is ready."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = super().select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready

        def look() -> bool:
            ready[:] = super(VirtualSelector, self).select(0)
            return bool(ready)

        self._clock.wait_for(look, LONGEST if timeout is None else timeout)
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is a virtual clock's; its sockets are real ones."""

    _transports: Any  # of asyncio, by file

    def __init__(self, clock: VirtualClock) -> None:
        self._virtual = clock
        self._files = VirtualSelector(clock)
        super().__init__(self._files)
        self._own = frozenset(self._files.get_map())

    def time(self) -> float:
        return self._virtual.now()

    @property
    def files(self) -> set[int]:
        """Numbers of the open sockets of the selector."""
        connected = {file for file, one in self._transports.items() if not one.is_closing()}
        return {*self._files.get_map(), *connected} - self._own


class Datagrams(socket.socket):
    """A socket in place of a UDP one on the loopback interface: what is sent has arrived at once.

    Parameters
    ----------
    folder : folder of all sockets that reach each other
    """

    def __init__(self, folder: Path, family: int = -1, kind: int = socket.SOCK_DGRAM) -> None:
        super().__init__(socket.AF_UNIX, kind)
        self.setblocking(False)
        self._folder = folder

    def bind(self, address: Any) -> None:
        path = self._path(address)
        path.unlink(missing_ok=True)
        super().bind(str(path))

    def recvfrom(self, *words: int) -> tuple[bytes, Any]:
        data, path = super().recvfrom(*words)
        return data, ("127.0.0.1", int(path.rpartition("-")[2]))

    def send_to(self, data: bytes, port: int) -> bool:
        """Send a packet; return whether there is anybody with room for it."""
        with suppress(OSError):
            return bool(super().sendto(data, str(self._path(("", port)))))
        return False

    def _path(self, address: tuple[str, int]) -> Path:
        return self._folder / f"udp-{address[1]}"


def lose(files: Iterable[int]) -> None:
    """Close files as the kernel does where a process is killed; their numbers stay taken."""
    null = os.open(os.devnull, os.O_RDWR)
    for file in files:
        os.dup2(null, file)
    os.close(null)


class Errors(logging.Handler):
    """Collector of each exception that anything of a server logs, or leaves."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.all: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info:
            self.all.append(f"{record.getMessage()}: {record.exc_info[1]!r}")

    def of_loop(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self.all.append(f"{context['message']}: {context.get('exception')!r}")


class LoopProcess:
    """A process that runs an event loop.

    Parameters
    ----------
    clock : clock of all processes
    errors : takes what fails in the loop

    Attributes
    ----------
    opened : resources that it closes when it ends in good order
    """

    def __init__(self, clock: VirtualClock, errors: Errors) -> None:
        self.loop, self._clock = VirtualLoop(clock), clock
        self.opened = AsyncExitStack()
        self.loop.set_exception_handler(errors.of_loop)
        self._thread = clock.start(self.loop.run_forever)

    @property
    def hung(self) -> bool:
        """Whether the process stands still."""
        return self._thread.held

    def begin(self, work: Coroutine[Any, Any, T]) -> "Future[T]":
        """Have the loop do something; it is done when time has passed."""
        return asyncio.run_coroutine_threadsafe(work, self.loop)

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Let time pass until the loop has done something."""
        future = self.begin(work)
        while not future.done():
            self._clock.wait_for(future.done, LONGEST)
        return future.result()

    def hang(self, seconds: float) -> None:
        """Stand still for a while."""
        self._clock.hold(self._thread)
        self._clock.after(seconds, lambda: self._clock.release(self._thread))

    def end(self) -> None:
        """End in good order."""
        self.run(self.opened.aclose())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._clock.advance(0.0)
        self.loop.close()

    def kill(self) -> None:
        """End at once."""
        self._clock.kill(self._thread)
        lose(self.loop.files)

    def bury(self) -> None:
        """Let a killed process end its tasks, once that has no effect on others."""
        self.loop.set_exception_handler(lambda loop, context: None)
        tasks = asyncio.all_tasks(self.loop)
        for task in tasks:
            task.cancel()

        async def end() -> None:
            if tasks:
                await asyncio.wait(tasks, timeout=LONGEST)
            with suppress(Exception, asyncio.CancelledError):  # of what was lost or called off
                await self.opened.aclose()

        logging.disable()
        try:
            self.loop.run_until_complete(end())
        finally:
            logging.disable(logging.NOTSET)
            self.loop.close()
