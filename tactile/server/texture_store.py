"""Textures of one display: those ready in its playback, and those that are being prepared.

Textures that are selected stay. Of the others, those go first that have not been selected for
longest.
"""

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.commands import DeviceOpened
from tactile.server.preparation_queue import PreparationQueue
from tactile.server.preparing import Preparation

MOST_TEXTURES = 16
"""Maximum number of textures kept ready for one display; exceeded only by those that are
selected."""
LARGEST_TEXTURES = 512
"""Maximum total size of the textures that are ready for one display [MiB], as playback holds them
in locked memory; one takes 26 MiB, with a map up to 48 MiB, and with sparse events 16 MiB more."""
MOST_PREPARATIONS = 4
"""Maximum number of textures that a client waits for at a time: as many as it may select."""

Key = tuple[str, int]
"""Name of a texture and seed of its realization."""


class TooManyPreparationsError(BusError):
    """A client already waits for as many textures as it may."""


class StoredTexture(NamedTuple):
    """Texture that is ready in playback.

    Attributes
    ----------
    number : int
        Number of the texture.
    size : int
        Size of the texture [bytes].
    """

    number: int
    size: int


@dataclass
class RunningPreparation:
    """Preparation of a texture that clients wait for.

    Attributes
    ----------
    clients : set of int
        Numbers of the clients that wait for it.
    task : asyncio.Task of int
        Task that returns the number of the texture.
    """

    clients: set[int]
    task: asyncio.Task[int]


class TextureStore:
    """Textures of a display.

    Parameters
    ----------
    display : Display
        Display that the textures are for.
    queue : PreparationQueue
        Queue that prepares textures.
    keep : callable
        Function that passes a prepared texture to playback, which it may refuse by a `BusError`.
    drop : callable
        Coroutine function that drops the texture with a number from playback.
    selected : callable
        Function that returns the numbers of the textures that clients have selected.
    largest : bool
        Whether textures have the largest gain that the limits of the display allow.

    Attributes
    ----------
    ready : dict of Key to StoredTexture
        Textures that are ready, those selected last at the end.
    """

    def __init__(
        self,
        display: Display,
        queue: PreparationQueue,
        *,
        keep: Callable[[Preparation], None],
        drop: Callable[[int], Awaitable[None]],
        selected: Callable[[], set[int]],
        largest: bool,
    ) -> None:
        self._display, self._queue, self._largest = display, queue, largest
        self._keep, self._drop, self._selected = keep, drop, selected
        self._running: dict[Key, RunningPreparation] = {}
        self._held: dict[object, set[int]] = {}
        self.ready: dict[Key, StoredTexture] = {}

    @contextmanager
    def held(self) -> Iterator[set[int]]:
        """Hold textures from being dropped until they have been selected.

        Yields
        ------
        set of int
            Set to which the numbers of the textures are to be added.
        """
        token, numbers = object(), set[int]()
        self._held[token] = numbers
        try:
            yield numbers
        finally:
            del self._held[token]

    async def texture(self, client: int, key: Key, how: DeviceOpened) -> int:
        """Return the number of a texture, once it is ready.

        Parameters
        ----------
        client : int
            Number of the client that waits.
        key : Key
            Name and seed of the texture.
        how : DeviceOpened
            How the device of the display plays.

        Returns
        -------
        int
            Number of the texture in playback.

        Raises
        ------
        TooManyPreparationsError
            If the client waits for as many textures as it may.
        BusError
            If the texture cannot be prepared, or there is no room for it.
        """
        if key in self.ready:
            self.ready[key] = self.ready.pop(key)  # used last, dropped last
            return self.ready[key].number
        running = self._running.get(key)
        if running is None or not running.clients:
            running = self._begin(client, key, how)
        running.clients.add(client)
        number = await asyncio.shield(running.task)
        if client not in running.clients:
            raise BusError("the client has left")
        return number

    def _begin(self, client: int, key: Key, how: DeviceOpened) -> RunningPreparation:
        """Start preparing a texture, once for all clients that wait for it."""
        waits = sum(client in running.clients for running in self._running.values())
        if waits >= MOST_PREPARATIONS:
            raise TooManyPreparationsError(
                f"{waits} textures of this client are being prepared, the most at a time; "
                "select again when they are ready"
            )
        clients = {client}
        task = asyncio.create_task(self._prepare(key, how, clients))
        task.add_done_callback(_take_exception)
        self._running[key] = RunningPreparation(clients, task)
        return self._running[key]

    async def _prepare(self, key: Key, how: DeviceOpened, clients: set[int]) -> int:
        """Prepare a texture for as long as clients wait for it; return its number."""
        try:
            prepared = await self._queue.prepare(
                self._display, *key, how, clients, largest=self._largest
            )
            await self._make_room(key[0], len(prepared.order))
            self._keep(prepared)
            self.ready[key] = StoredTexture(prepared.number, len(prepared.order))
        finally:
            running = self._running.get(key)
            if running is not None and running.clients is clients:
                del self._running[key]
        return prepared.number

    def leave(self, client: int) -> None:
        """Remove a client that has left from all waits; what others wait for is still prepared.

        Parameters
        ----------
        client : int
            Number of the client.
        """
        for running in self._running.values():
            running.clients.discard(client)

    async def _make_room(self, name: str, size: int) -> None:
        """Drop textures until there is room for one more.

        Raises
        ------
        BusError
            If the selected textures leave no room.
        """
        used, largest = self._selected().union(*self._held.values()), LARGEST_TEXTURES * 2**20
        spare = [key for key, ready in self.ready.items() if ready.number not in used]
        total = size + sum(ready.size for ready in self.ready.values())
        if total - sum(self.ready[key].size for key in spare) > largest:
            raise BusError(
                f"texture {name!r} takes {size / 2**20:.0f} MiB, and with those that are selected "
                f"the display would hold more than {LARGEST_TEXTURES} MiB of textures; select one "
                "that is selected already, or deselect others first"
            )
        while spare and (total > largest or len(self.ready) >= MOST_TEXTURES):
            dropped = self.ready.pop(spare.pop(0))
            total -= dropped.size
            await self._drop(dropped.number)


def _take_exception(task: asyncio.Task[int]) -> None:
    """Retrieve the exception of a task, even if all who waited for it have left."""
    if not task.cancelled():
        task.exception()
