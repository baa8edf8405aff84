"""Child process of the server, with which it exchanges orders and answers.

Orders and answers are pickles on the standard streams of the child. One thread writes and another
reads, so that neither a large order nor a child that hangs delays the event loop. When the server
ends, for whatever reason, the input of the child ends, and the child with it.
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
"""Program of the child; it gets the server's path, so that it imports the same tactile."""
ORDERS = 4096
"""Maximum number of orders that wait to be written."""


class Child:
    """Child process.

    Parameters
    ----------
    module : str
        Module whose ``main`` the child runs.
    heard : callable
        Function that is called on the event loop with each answer, and with None when the answers
        end.
    inherited : tuple of int
        File descriptors that the child inherits.
    """

    def __init__(
        self, module: str, heard: Callable[[Any], None], inherited: tuple[int, ...] = ()
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._on_answer = heard
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
        """Process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def tell(self, order: object) -> None:
        """Send an order.

        Parameters
        ----------
        order : object
            Order, or bytes that are the pickle of one.

        Raises
        ------
        BusError
            If too many orders wait to be written.
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
            with suppress(RuntimeError):  # the event loop is closed
                self._loop.call_soon_threadsafe(self._on_answer, message)
            if message is None:
                return

    async def end(self, patience: float) -> None:
        """Close the child's input and wait for its end; kill it if it does not end in time.

        Parameters
        ----------
        patience : float
            Time to wait for the end [s].
        """
        with suppress(queue.Full):
            self._orders.put_nowait(None)
        deadline = self._loop.time() + patience
        while self.alive and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        self.kill()

    def kill(self) -> None:
        """Kill the process at once, and close its threads and pipes."""
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
