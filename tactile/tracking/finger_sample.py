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


TIME_PLACES, POSITION_PLACES, FORCE_PLACES, SPEED_PLACES = 6, 8, 4, 5
"""Decimal places of times [s], positions [m], forces [N] and speeds [m/s]: 1 µs, 10 nm, 0.1 mN and
10 µm/s, far below what a tracker resolves and a finger feels (assumed)."""


def rounded(sample: FingerSample) -> FingerSample:
    """Return a sample with as many decimal places as are played and recorded.

    Parameters
    ----------
    sample : FingerSample
        Sample of a finger; its numbers may be any.

    Returns
    -------
    FingerSample
        The sample, rounded.
    """
    time, arrival, x, y, force, velocity = sample
    if velocity is not None:
        velocity = round(velocity[0], SPEED_PLACES) + 0.0, round(velocity[1], SPEED_PLACES) + 0.0
    return FingerSample(
        round(time, TIME_PLACES),
        round(arrival, TIME_PLACES),
        round(x, POSITION_PLACES) + 0.0,  # no negative zero, which integers do not have
        round(y, POSITION_PLACES) + 0.0,
        round(force, FORCE_PLACES) + 0.0,
        velocity,
    )
