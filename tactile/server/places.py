"""Admission of clients: a maximum number of them, and a few more that may do nothing but e-stop.

A program that only wants to trigger an e-stop is therefore admitted, however many others are there.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tactile.server.connection import ServerConnection

RESERVED = 4
"""Number of additional places for clients that may only e-stop."""
CHANCE = 0.2
"""Time that such a client has for its e-stop before a newer one may take its place [s]."""


class Places:
    """Places of a server.

    Parameters
    ----------
    most : int
        Maximum number of clients besides the reserved places.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._full: set[ServerConnection] = set()
        self._reserved: dict[ServerConnection, float] = {}

    def __len__(self) -> int:
        """Return the number of places that are taken."""
        return len(self._full) + len(self._reserved)

    def __iter__(self) -> Iterator["ServerConnection"]:
        """Iterate over all connections that have a place."""
        yield from self._full
        yield from self._reserved

    def is_reserved(self, connection: "ServerConnection") -> bool:
        """Check whether a connection has one of the reserved places.

        Parameters
        ----------
        connection : ServerConnection
            Any connection.

        Returns
        -------
        bool
            Whether it may only e-stop.
        """
        return connection in self._reserved

    def take(self, connection: "ServerConnection", now: float) -> bool:
        """Give a connection a place, a reserved one if all others are taken.

        Parameters
        ----------
        connection : ServerConnection
            New connection.
        now : float
            Time [s].

        Returns
        -------
        bool
            Whether there was a place.
        """
        if len(self._full) < self._most:
            self._full.add(connection)
            return True
        if len(self._reserved) >= RESERVED:
            oldest = next(iter(self._reserved))
            if now - self._reserved[oldest] < CHANCE:
                return False
            del self._reserved[oldest]
            oldest.make_room()
        self._reserved[connection] = now
        return True

    def leave(self, connection: "ServerConnection") -> None:
        """Free the place of a connection; one that has none is ignored.

        Parameters
        ----------
        connection : ServerConnection
            Connection that ends.
        """
        self._full.discard(connection)
        self._reserved.pop(connection, None)
