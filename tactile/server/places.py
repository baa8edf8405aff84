"""Who is in: as many clients as may be, and besides them a few that may do nothing but e-stop.

So a program that has only that to do gets in, however many others are there.
"""

from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar

RESERVED = 4
"""Places of clients that may only e-stop."""
CHANCE = 0.2
"""s that such a client has for its e-stop before a newer one may take its place."""


class Guest(Protocol):
    """Who takes a place; `tactile.server.connection.Connection` is one."""

    def make_room(self) -> None:
        """End, since a newer one takes the place."""
        ...


G = TypeVar("G", bound=Guest)


class Places(Generic[G]):
    """The places of a daemon.

    Parameters
    ----------
    most : clients, besides the reserved places
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._full: set[G] = set()
        self._reserved: dict[G, float] = {}

    def __len__(self) -> int:
        """Return how many places are taken."""
        return len(self._full) + len(self._reserved)

    def __iter__(self) -> Iterator[G]:
        """Return all that are in."""
        yield from self._full
        yield from self._reserved

    def is_reserved(self, guest: G) -> bool:
        """Return whether a guest has one of the reserved places."""
        return guest in self._reserved

    def take(self, guest: G, now: float) -> bool:
        """Give a guest a place at a time [s]; return whether there was one."""
        if len(self._full) < self.most:
            self._full.add(guest)
            return True
        if len(self._reserved) >= RESERVED:
            oldest = next(iter(self._reserved))
            if now - self._reserved[oldest] < CHANCE:
                return False
            del self._reserved[oldest]
            oldest.make_room()
        self._reserved[guest] = now
        return True

    def leave(self, guest: G) -> None:
        """Free the place of a guest; one that has none is ignored."""
        self._full.discard(guest)
        self._reserved.pop(guest, None)
