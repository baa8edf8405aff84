"""The textures of one display that are ready in its playback, and those that are made ready.

Those that are selected stay; of the others those go first that nobody has selected for longest.
"""

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.commands import DeviceOpened
from tactile.server.workbench import Workbench

MOST_TEXTURES = 16
"""That are kept ready for one display; more only where they are selected."""
LARGEST_TEXTURES = 512
"""MiB of textures that are ready for one display, at 16 each: playback's memory, and locked."""
MOST_DRAWINGS = 4
"""Textures that a client waits for at a time: as many as it may select."""

Key = tuple[str, int]
"""A texture's name, and the seed of its realization."""


class TooManyDrawingsError(BusError):
    """A client waits for as many textures as it may."""


class Ready(NamedTuple):
    """A texture that is ready: its number, and its size [bytes]."""

    number: int
    size: int


@dataclass
class Making:
    """A texture that is made ready: the clients that wait for it, and the task."""

    clients: set[int]
    task: asyncio.Task[int]


class Shelf:
    """The textures of a display.

    Parameters
    ----------
    display : for which they are
    workbench : where they are made ready
    keep : called with the order for playback to keep one, which it may refuse with a `BusError`
    drop : called with the number of one that is to go
    selected : called for the numbers of those that clients have selected
    """

    def __init__(
        self,
        display: Display,
        workbench: Workbench,
        *,
        keep: Callable[[bytes], None],
        drop: Callable[[int], Awaitable[None]],
        selected: Callable[[], set[int]],
    ) -> None:
        self._display, self._workbench = display, workbench
        self._keep, self._drop, self._selected = keep, drop, selected
        self._making: dict[Key, Making] = {}
        self._held: dict[object, set[int]] = {}
        self.ready: dict[Key, Ready] = {}

    @contextmanager
    def held(self) -> Iterator[set[int]]:
        """Hold textures whose numbers are added, until they have been selected."""
        token, numbers = object(), set[int]()
        self._held[token] = numbers
        try:
            yield numbers
        finally:
            del self._held[token]

    async def texture(self, client: int, key: Key, how: DeviceOpened) -> int:
        """Return the number of a texture that is ready, for a display that plays so.

        Raises
        ------
        TooManyDrawingsError
            Where the client waits for as many as it may.
        BusError
            Where it cannot be made ready, or there is no room for it.
        """
        if key in self.ready:
            self.ready[key] = self.ready.pop(key)  # the latest is the last to go
            return self.ready[key].number
        making = self._making.get(key)
        if making is None or not making.clients:
            making = self._begin(client, key, how)
        making.clients.add(client)
        number = await asyncio.shield(making.task)
        if client not in making.clients:
            raise BusError("the client has left")
        return number

    def _begin(self, client: int, key: Key, how: DeviceOpened) -> Making:
        """Have a texture made ready, once for all who wait for it."""
        waits = sum(client in making.clients for making in self._making.values())
        if waits >= MOST_DRAWINGS:
            raise TooManyDrawingsError(
                f"{waits} textures of this client are being made ready, {MOST_DRAWINGS} may be; "
                "select again when they are"
            )
        clients = {client}
        task = asyncio.create_task(self._made(key, how, clients))
        task.add_done_callback(_take_exception)
        self._making[key] = Making(clients, task)
        return self._making[key]

    async def _made(self, key: Key, how: DeviceOpened, clients: set[int]) -> int:
        """Return the number of a texture made ready, as long as there are clients that wait."""
        try:
            number, order = await self._workbench.make(self._display, *key, how, clients)
            await self._make_room(key[0], len(order))
            self._keep(order)
            self.ready[key] = Ready(number, len(order))
        finally:
            making = self._making.get(key)
            if making is not None and making.clients is clients:
                del self._making[key]
        return number

    def leave(self, client: int) -> None:
        """Let a client that has left wait for nothing; what others wait for is still made."""
        for making in self._making.values():
            making.clients.discard(client)

    async def _make_room(self, name: str, size: int) -> None:
        """Let textures go, until there is room for one more.

        Raises
        ------
        BusError
            Where those that are selected leave none.
        """
        used, largest = self._selected().union(*self._held.values()), LARGEST_TEXTURES * 2**20
        spare = [key for key, ready in self.ready.items() if ready.number not in used]
        total = size + sum(ready.size for ready in self.ready.values())
        if total - sum(self.ready[key].size for key in spare) > largest:
            raise BusError(
                f"texture {name!r} takes {size / 2**20:.0f} MiB, and with those that are selected "
                f"the display would hold more than {LARGEST_TEXTURES} MiB of textures; select one "
                "that somebody has selected already, or take others away first"
            )
        while spare and (total > largest or len(self.ready) >= MOST_TEXTURES):
            gone = self.ready.pop(spare.pop(0))
            total -= gone.size
            await self._drop(gone.number)


def _take_exception(task: asyncio.Task[int]) -> None:
    """Take what a task failed of, also where all who waited for it have left."""
    if not task.cancelled():
        task.exception()
