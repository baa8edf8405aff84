"""Growth of the counters of a server since a sound card was made."""

from collections.abc import Mapping


class CounterGrowth:
    """Growth of a counter of a server, also over a restart of the server.

    Parameters
    ----------
    name : str
        Name of the counter.

    Attributes
    ----------
    count : int
        Growth so far.
    """

    def __init__(self, name: str) -> None:
        self._name, self.count = name, 0
        self._last: int | None = None

    def take(self, counters: Mapping[str, int], *, counts: bool) -> int:
        """Take the counters as they are now, and return by what they have grown if it counts.

        Parameters
        ----------
        counters : mapping of str to int
            Counters of the server; a lower count than before is that of another server.
        counts : bool
            Whether what it has grown by counts.

        Returns
        -------
        int
            Growth that was added to the count.
        """
        before, now = self._last, counters.get(self._name, 0)
        self._last = now
        if not counts or before is None:
            return 0
        growth = now - before if now >= before else now
        self.count += growth
        return growth
