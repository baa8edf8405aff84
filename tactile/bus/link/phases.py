"""Phases of a session with amplifiers, and the states that it works toward."""

from enum import Enum, auto


class SessionPhase(Enum):
    """Phase of a session; the order of the values is compared."""

    DOWN = auto()
    """There is no wire."""
    SEARCH = auto()
    """HELLO is sent to all nodes, until amplifiers answer."""
    GREET = auto()
    """HELLO takes each amplifier for this session; before CLEAR with a new token."""
    CLOCK = auto()
    """Clocks are estimated, until all are known well enough."""
    HALT = auto()
    """Amplifiers that were found playing are stopped."""
    LIMIT = auto()
    """Limits of the display are put in force."""
    READY = auto()
    """Amplifiers are at 0 V, or latched in ESTOP or FAULT, and wait for another goal."""
    ARM = auto()
    """High voltage is switched on."""
    START = auto()
    """START is sent."""
    RUN = auto()
    """Amplifiers play."""
    END = auto()
    """STOP is sent, and the ramps to 0 V are awaited."""
    ESTOP = auto()
    """ESTOP is sent, again until all amplifiers report it; then the session rests here."""
    TRIPS = auto()
    """STATUS is asked for, since CLEAR_FAULT has to name its `trips`, those before GREET."""
    CLEAR = auto()
    """CLEAR_FAULT is sent."""
    DISARM = auto()
    """High voltage is switched off, and the ramps to 0 V are awaited."""
    ENDED = auto()
    """The session has ended."""


class Goal(Enum):
    """State that a session works toward."""

    READY = auto()
    """Idle, at 0 V."""
    RUN = auto()
    """Playing."""
    ESTOP = auto()
    """E-stopped, until it is cleared."""
    ENDED = auto()
    """Disarmed and ended."""
