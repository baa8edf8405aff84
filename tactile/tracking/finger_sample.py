"""Sample of a finger, in the units and the clock of the host.

A client sends it as a `tactile.messages.Contact`, in its own units and clock. The server converts
that to a `FingerSample`, which passes the shared memory and the tracker as it is.
"""

from typing import NamedTuple


class FingerSample(NamedTuple):
    """Sample of a finger.

    Attributes
    ----------
    time : float
        Time at which the sample was taken, in the host's clock [s].
    arrival : float
        Time at which the sample arrived, in the host's clock [s].
    x, y : float
        Position of the finger on the surface [m].
    normal_force : float
        Normal force; 0 for a lifted finger [N].
    velocity : tuple of 2 floats or None
        Velocity of the finger, if the client knows it [m/s].
    """

    time: float
    arrival: float
    x: float
    y: float
    normal_force: float
    velocity: tuple[float, float] | None = None
