"""Admission of clients: a maximum number of them, and a few more that may do nothing but e-stop.

A program that only wants to trigger an e-stop is therefore admitted, however many others are there.
"""

from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar

RESERVED = 4
"""Number of additional places for clients that may only e-stop."""
CHANCE = 0.2
"""Time that such a client has for its e-stop before a newer one may take its place [s]."""


class Guest(Protocol):
    """Object that takes a place; `tactile.server.connection.ServerConnection` is one."""

    def make_room(self) -> None:
        """End, because a newer guest takes the place."""
        ...


G = TypeVar("G", bound=Guest)


class Places(Generic[G]):
    """Places of a daemon.

    Parameters
    ----------
    most : int
        Maximum number of clients besides the reserved places.

    Attributes
    ----------
    most : int
        Maximum number of clients besides the reserved places.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._full: set[G] = set()
        self._reserved: dict[G, float] = {}

    def __len__(self) -> int:
        """Return the number of places that are taken."""
        return len(self._full) + len(self._reserved)

    def __iter__(self) -> Iterator[G]:
        """Iterate over all guests."""
        yield from self._full
        yield from self._reserved

    def is_reserved(self, guest: G) -> bool:
        """Check whether a guest has one of the reserved places.

        Parameters
        ----------
        guest : Guest
            Any guest.

        Returns
        -------
        bool
            Whether the guest may only e-stop.
        """
        return guest in self._reserved

    def take(self, guest: G, now: float) -> bool:
        """Give a guest a place, a reserved one if all others are taken.

        Parameters
        ----------
        guest : Guest
            New guest.
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether there was a place.
        """
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
        """Free the place of a guest; one that has none is ignored.

        Parameters
        ----------
        guest : Guest
            Guest that leaves.
        """
        self._full.discard(guest)
        self._reserved.pop(guest, None)
