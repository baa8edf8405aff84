"""Child process of the server, with which it exchanges orders and answers.

One thread writes and another reads, so that neither a large order nor a child that hangs delays the
event loop.
"""

import asyncio
import pickle
import queue
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tactile.errors import BusError
from tactile.processes import ChildProcess

ORDERS = 4096
"""Maximum number of orders that wait to be written."""


class Child(ChildProcess):
    """Child process of the server.

    Parameters
    ----------
    module : str
        Module whose ``main`` the child runs.
    on_answer : callable
        Function that is called on the event loop with each answer, and with None when the answers
        end.
    inherited : tuple of int
        File descriptors that the child inherits.
    """

    def __init__(
        self, module: str, on_answer: Callable[[Any], None], inherited: tuple[int, ...] = ()
    ) -> None:
        loop = self._loop = asyncio.get_running_loop()

        def on_message(message: object) -> None:
            with suppress(RuntimeError):  # the event loop is closed
                loop.call_soon_threadsafe(on_answer, message)

        super().__init__(module, on_message, inherited)
        self._orders: queue.Queue[bytes | None] = queue.Queue(ORDERS)
        self._begin_thread(self._write, f"{module}:write")

    def send(self, order: object) -> None:
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
            raise BusError("playback does not respond: too many commands wait for it") from None

    def _write(self) -> None:
        """Write orders until one is None."""
        with suppress(OSError, ValueError):
            while (order := self._orders.get()) is not None:
                data = memoryview(order)
                while data:
                    data = data[self._pipe.write(data) :]
        with suppress(OSError):
            self._pipe.close()

    async def end(self, patience: float) -> None:
        """Close the child's input and wait for its end; kill it if it does not end in time.

        Parameters
        ----------
        patience : float
            Time to wait for the end [s].
        """
        self._end_orders()
        deadline = self._loop.time() + patience
        while self.alive and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        await asyncio.to_thread(self.kill)  # which waits long for a process that a disk holds up

    def _end_orders(self) -> None:
        """Let the thread that writes end after the orders that wait."""
        with suppress(queue.Full):
            self._orders.put_nowait(None)

    def kill(self) -> None:
        """Kill the process at once, and close its threads and pipes."""
        self._end_orders()
        super().kill()
