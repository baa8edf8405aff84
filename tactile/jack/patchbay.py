"""Connections of a sound card: which ports are to be connected to its ports."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from tactile.jack.card_messages import PortSources

Pairs = set[tuple[int, str]]
"""Pairs of the index of a port and the full name of the port that is connected to it."""


class Patchbay:
    """Memory of connections, by which a source that comes back is connected again.

    A connection is forgotten when it is missing twice in a row although its source has been there
    all the time, since somebody has cut it then. A program that ends cuts its connections just
    before its ports vanish.

    Parameters
    ----------
    sources : sequence of set of str
        Sources that each port had before.
    """

    def __init__(self, sources: Sequence[AbstractSet[str]]) -> None:
        self._ports = len(sources)
        self._wanted: Pairs = {(k, name) for k, names in enumerate(sources) for name in names}
        self._made: Pairs = set()
        self._cut: Pairs = set()

    @property
    def sources(self) -> PortSources:
        """Sources that each port has, or had until they vanished."""
        return tuple(
            frozenset(name for index, name in self._wanted if index == k)
            for k in range(self._ports)
        )

    def look(
        self,
        connected: Sequence[AbstractSet[str]],
        existing: AbstractSet[str],
        registered: AbstractSet[str] = frozenset(),
    ) -> list[tuple[int, str]]:
        """Take what is connected now, and return what is to be connected.

        Parameters
        ----------
        connected : sequence of set of str
            Sources that each port has.
        existing : set of str
            All ports that there are.
        registered : set of str
            Ports that have come since the look before.

        Returns
        -------
        list of (int, str)
            Index of a port, and the source that it is to have again.
        """
        now = {(k, name) for k, names in enumerate(connected) for name in names}
        missing = {pair for pair in self._wanted - now if pair[1] in existing}
        stayed = {pair for pair in missing if pair[1] not in registered}
        cut = stayed & self._made
        self._wanted = (self._wanted | now) - (cut & self._cut)
        self._made = now | (cut - self._cut)
        self._cut = cut - self._cut
        return sorted(missing - cut)
