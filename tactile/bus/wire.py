"""A wire: packets of the protocol out to the amplifiers of one link, and back.

Whoever holds one sends no more than the wire takes (`busy`), waits in `receive`, and lets an e-stop
overtake with `urge`. A wire that breaks raises WireError; whoever holds it connects a new one.
"""

import math
from abc import ABC, abstractmethod
from collections import deque

from firmware_protocol.packet import LinkCounters, Packet
from tactile.bus.wire_time import Link
from tactile.errors import BusError

REORDERED, REORDERED_IN = 10, 1.0
"""Fragments dropped, within so many seconds, from which on it is said (SPEC.md, 3.2)."""
STALL = 0.1
"""s in which a wire takes nothing of what waits, after which it counts as broken."""


class WireError(BusError):
    """A wire that broke, or never was."""


class FragmentWatch:
    """Tells of fragments that are dropped, as on a bus without fault none is.

    Attributes
    ----------
    warning : one line; empty where there is nothing to say
    """

    def __init__(self) -> None:
        self.warning = ""
        self._counts: deque[tuple[float, int]] = deque([(-math.inf, 0)])

    def look(self, dropped: int, now: float) -> None:
        """Take the number of fragments dropped so far, at both ends."""
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
    """One end of a link; open from its construction on.

    Attributes
    ----------
    link : how long packets take on it
    counters : what came that was no packet
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.counters = LinkCounters()

    @abstractmethod
    def send(self, packet: Packet) -> float:
        """Hand a packet to the wire, without waiting; return the time that it takes there [s].

        Raises WireError where the wire is broken.
        """

    @abstractmethod
    def urge(self, packet: Packet) -> None:
        """Send a packet before anything that waits, at the cost of what waits."""

    @abstractmethod
    def receive(self, until: float) -> list[Packet]:
        """Return what came; wait for it until a host time [s], or until woken.

        Raises WireError where the wire is broken, or has taken nothing for `STALL`.
        """

    @abstractmethod
    def wake(self) -> None:
        """Let `receive` return; may be called from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it; any number of times."""

    def waited(self) -> float:
        """Tell for how long the oldest has waited of what was sent and has not left [s]."""
        return 0.0

    @property
    def warning(self) -> str:
        """What is amiss though it works, one line; empty where nothing is."""
        return ""

    @property
    def busy(self) -> bool:
        """Whether something waits that the wire has not taken."""
        return False
