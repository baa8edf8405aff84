"""How far a session with amplifiers is, and what it is to come to."""

from enum import Enum, auto


class SessionPhase(Enum):
    """How far a session is."""

    DOWN = auto()
    SEARCH = auto()
    GREET = auto()
    CLOCK = auto()
    HALT = auto()
    LIMIT = auto()
    READY = auto()
    ARM = auto()
    START = auto()
    RUN = auto()
    END = auto()
    ESTOP = auto()
    TRIPS = auto()
    CLEAR = auto()
    DISARM = auto()
    GONE = auto()


class Want(Enum):
    """What a session is to come to."""

    READY = auto()
    RUN = auto()
    ESTOP = auto()
    GONE = auto()
