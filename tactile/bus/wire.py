"""Wire: the transport of packets between the host and the amplifiers of one link.

The owner of a wire sends only while it is not `busy`, waits in `receive`, and lets an e-stop
overtake other packets with `send_urgent`. A broken wire raises `WireError`; its owner closes it and
connects a new one.
"""

import math
import socket
from abc import ABC, abstractmethod
from collections import deque
from contextlib import suppress

from firmware_protocol.packet import LinkCounters, Packet
from tactile.bus.wire_time import Link
from tactile.errors import BusError

REORDERED, REORDERED_IN = 10, 1.0
"""Number of dropped fragments that gives a warning, and the time within which they have to be
dropped [s] (SPEC.md, 3.2)."""
STALL = 0.1
"""Time in which a wire takes nothing of what waits, after which it counts as broken [s]."""


class WireError(BusError):
    """Error of a wire that broke or could not be opened."""


class Waker:
    """End to the wait of another thread for a file, in `select` and the like.

    Any thread may call `wake`, and so may a signal handler.
    """

    def __init__(self) -> None:
        self._ends = socket.socketpair()
        for end in self._ends:
            end.setblocking(False)

    def fileno(self) -> int:
        """Return the descriptor to wait for, which `wake` makes readable.

        Returns
        -------
        int
            File descriptor; -1 after `close`.
        """
        return self._ends[0].fileno()

    def wake(self) -> None:
        """Make the descriptor readable; do nothing after `close`."""
        with suppress(OSError):
            self._ends[1].send(b"\0")

    def clear(self) -> None:
        """Make the descriptor unreadable until the next `wake`."""
        with suppress(BlockingIOError):
            self._ends[0].recv(4096)

    def close(self) -> None:
        """Close the descriptor; it may be called any number of times."""
        for end in self._ends:
            end.close()


class FragmentWatch:
    """Watch for dropped fragments; a bus without a fault drops none.

    Attributes
    ----------
    warning : str
        Latest warning, one line; empty if there was none.
    """

    def __init__(self) -> None:
        self.warning = ""
        self._counts: deque[tuple[float, int]] = deque([(-math.inf, 0)])

    def update(self, dropped: int, now: float) -> None:
        """Update the warning.

        Parameters
        ----------
        dropped : int
            Number of fragments that both ends have dropped so far.
        now : float
            Host time [s].
        """
        counts = self._counts
        if dropped != counts[-1][1]:
            counts.append((now, dropped))
        while len(counts) > 1 and counts[1][0] < now - REORDERED_IN:
            counts.popleft()
        if dropped - counts[0][1] >= REORDERED:
            self.warning = (
                f"{dropped - counts[0][1]} fragments of packets came out of order, or not at all, "
                f"within {REORDERED_IN:g} s: the adapter reorders or loses frames"
            )


class Wire(ABC):
    """Host's end of a link, open from its construction on.

    One thread at a time calls `receive` and `close`. Others may call `send` and `send_urgent`
    meanwhile, which `LinkBus` does under its own lock, and `wake` at any time.

    Parameters
    ----------
    link : Link
        Medium, which knows how long packets take.

    Attributes
    ----------
    link : Link
        Medium, which knows how long packets take.
    counters : LinkCounters
        Counts of received data that was no packet.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.counters = LinkCounters()

    @abstractmethod
    def send(self, packet: Packet) -> float:
        """Send a packet without waiting; what the wire cannot take yet is queued.

        Parameters
        ----------
        packet : Packet
            Packet to send.

        Returns
        -------
        float
            Time that the packet takes on the link [s].

        Raises
        ------
        WireError
            If the wire is broken.
        """

    @abstractmethod
    def send_urgent(self, packet: Packet) -> None:
        """Send a packet ahead of everything that is queued, which may be dropped.

        Parameters
        ----------
        packet : Packet
            Packet to send, such as an e-stop.

        Raises
        ------
        WireError
            If the wire is broken.
        """

    @abstractmethod
    def receive(self, until: float) -> list[Packet]:
        """Wait for packets, until a host time or until `wake`, and send what is queued.

        Parameters
        ----------
        until : float
            Host time up to which to wait [s].

        Returns
        -------
        list of Packet
            Packets in the order in which they came; empty if none came.

        Raises
        ------
        WireError
            If the wire is broken, or has taken nothing of what is queued for `STALL`.
        """

    @abstractmethod
    def wake(self) -> None:
        """Make `receive` return; it may be called from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Close the wire; it may be called any number of times."""

    def waited(self) -> float:
        """Return how long the oldest data that was sent and has not left has been waiting.

        Returns
        -------
        float
            Time [s]; 0 if nothing waits, or the wire cannot know.
        """
        return 0.0

    @property
    def warning(self) -> str:
        """Problem of a wire that still works, one line; empty if there is none."""
        return ""

    @property
    def busy(self) -> bool:
        """Whether something is queued that the wire has not taken yet."""
        return False
