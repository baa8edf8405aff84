"""A wire: packets of the protocol out to the amplifiers of one link, and back.

Whoever holds one sends no more than the wire takes (`busy`), waits in `receive`, and lets an e-stop
overtake with `urge`. A wire that breaks raises WireError; whoever holds it connects a new one.
"""

from abc import ABC, abstractmethod
from typing import Protocol

from firmware_protocol.packet import LinkCounters, Packet
from tactile.bus.wire_time import Link
from tactile.errors import BusError

STALL = 0.1
"""s in which a wire takes nothing of what waits, after which it counts as broken."""


class WireError(BusError):
    """A wire that broke, or never was."""


class Clock(Protocol):
    """Host time: real, or that of a model."""

    def now(self) -> float:
        """Return the time [s]; it never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...


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

    @property
    def busy(self) -> bool:
        """Whether something waits that the wire has not taken."""
        return False
