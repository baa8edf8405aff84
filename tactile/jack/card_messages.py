"""Messages between a sound card and its process, the client of JACK."""

from dataclasses import dataclass

PortSources = tuple[frozenset[str], ...]
"""Full names of the ports that are connected to each port of a sound card."""


@dataclass(frozen=True)
class CardOrder:
    """Order to become a client of JACK, the first and only message to the process.

    Attributes
    ----------
    name : str
        Name of the client.
    sources : tuple of frozenset of str
        Ports to connect to each port, as soon as they are there; as many as there are ports.
    """

    name: str
    sources: PortSources


@dataclass(frozen=True)
class CardWaits:
    """Report that the process waits for a JACK server.

    Attributes
    ----------
    reason : str
        Reason why there is no client yet, in one line.
    """

    reason: str


@dataclass(frozen=True)
class CardOpened:
    """Report that cycles follow whose frames do not continue those before.

    Attributes
    ----------
    client : str
        Name that JACK has given the client.
    rate : float
        Sample rate [Hz].
    buffer : int
        Number of frames of a cycle.
    """

    client: str
    rate: float
    buffer: int


@dataclass(frozen=True)
class CardSources:
    """Report that other ports are connected than before.

    Attributes
    ----------
    sources : tuple of frozenset of str
        Ports that are, or were until they vanished, connected to each port.
    """

    sources: PortSources


@dataclass(frozen=True)
class JackCycle:
    """Frames that came into the ports in one cycle of JACK.

    Attributes
    ----------
    time : float
        Begin of the cycle on the monotonic clock [s].
    number : int
        Number that JACK gives its first frame, of 32 bits.
    rate : float
        Sample rate [Hz].
    data : bytes
        Frames, of which each has a float32 for each port.
    xruns : int
        Number of times that JACK has been late since the client was opened.
    """

    time: float
    number: int
    rate: float
    data: bytes
    xruns: int


@dataclass(frozen=True)
class CardLost:
    """Report that the JACK server has ended, and the process ends with it.

    Attributes
    ----------
    reason : str
        Reason as JACK gives it.
    """

    reason: str


@dataclass(frozen=True)
class CardFailed:
    """Report that there cannot be such a client, and the process ends.

    Attributes
    ----------
    reason : str
        Reason in one line.
    """

    reason: str
