"""A program that the server runs beside itself: started, told, listened to, and ended for sure.

Orders and answers are pickles over its standard streams. A thread writes and another reads, so
that neither a large order nor a child that hangs holds up the event loop. Whatever becomes of the
server, the child's input ends, and with it the child.
"""

import asyncio
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, cast

from tactile.errors import BusError

PROGRAM = "import sys; sys.path[:] = {!r}; from {} import main; main()"
"""With the server's path, so that the same tactile is found."""
ORDERS = 4096
"""That wait to be written at most."""


class Child:
    """A child process.

    Parameters
    ----------
    module : whose ``main`` it runs
    heard : called on the event loop with each answer, and with None when there are no more
    inherited : descriptors that it is to have
    """

    def __init__(
        self, module: str, heard: Callable[[Any], None], inherited: tuple[int, ...] = ()
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._heard = heard
        extra: dict[str, Any] = {"pass_fds": inherited} if os.name == "posix" else {}
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(sys.path, module)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, **extra,
        )  # fmt: skip
        self._orders: queue.Queue[bytes | None] = queue.Queue(ORDERS)
        self._threads = [
            threading.Thread(target=run, name=f"{module}:{run.__name__}", daemon=True)
            for run in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def tell(self, order: object) -> None:
        """Send an order, or bytes that are the pickle of one.

        Raises
        ------
        BusError
            Where it takes none any more.
        """
        data = order if isinstance(order, bytes) else pickle.dumps(order, protocol=5)
        try:
            self._orders.put_nowait(data)
        except queue.Full:
            raise BusError("playback takes no orders") from None

    def _write(self) -> None:
        pipe = cast(Any, self._process.stdin)
        with suppress(OSError, ValueError):
            while (data := self._orders.get()) is not None:
                pipe.write(data)
                pipe.flush()
        with suppress(OSError, ValueError):
            pipe.close()

    def _read(self) -> None:
        stream = cast(Any, self._process.stdout)
        message: object = None
        while True:
            try:
                message = pickle.load(stream)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                message = None
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._heard, message)
            if message is None:
                return

    async def end(self, patience: float) -> None:
        """Close its input and wait for its end; kill it after a while."""
        with suppress(queue.Full):
            self._orders.put_nowait(None)
        deadline = self._loop.time() + patience
        while self.alive and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        self.kill()

    def kill(self) -> None:
        """End it at once, and leave nothing of it."""
        with suppress(OSError):
            self._process.kill()
        self._process.wait()
        with suppress(queue.Full):
            self._orders.put_nowait(None)
        for thread in self._threads:
            thread.join(1.0)
        for stream in (self._process.stdin, self._process.stdout):
            with suppress(OSError, ValueError):
                cast(Any, stream).close()
