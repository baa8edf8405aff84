"""Messages between the server and the recorder of a session, and the header of what it writes."""

from dataclasses import dataclass
from typing import Annotated

import msgspec

from tactile.files import SourceFile
from tactile.playback.commands import DeviceOpened, News
from tactile.playback.session_orders import SessionOrder

FORMAT = 1
"""Number of the form of sessions; it grows when older programs cannot read a session."""


class SessionHeader(msgspec.Struct, frozen=True, kw_only=True):
    """What a session was played with; every part holds it.

    Attributes
    ----------
    format : int
        Number of the form of the session.
    name : str
        Name of the display for clients.
    device : str
        URL of the device.
    display : SourceFile
        Texts of the display's files.
    voltage_limit_v : float
        Voltage limit.
    how : DeviceOpened
        How the device plays.
    gain : float
        Gain of the display.
    worn : bool
        Whether the finger stays on the display.
    versions : dict of str to str
        Versions of the program, of Python and of the libraries that computed the drive.
    begun_s : float
        Time in the host's clock, in which all times are, when recording began.
    begun_utc : str
        The same time as a date, in UTC and the form of ISO 8601.
    """

    format: int = FORMAT
    name: str
    device: str
    display: SourceFile
    voltage_limit_v: Annotated[float, msgspec.Meta(gt=0)]
    how: DeviceOpened
    gain: float
    worn: bool
    versions: dict[str, str] = {}
    begun_s: float = 0.0
    begun_utc: str = ""


@dataclass(frozen=True)
class SessionSetup:
    """First message to the recorder.

    Attributes
    ----------
    folder : str
        Folder of all sessions.
    ring : str
        Handle of the ring that playback writes to.
    header : SessionHeader
        What the session is played with; the recorder adds the versions and the time.
    """

    folder: str
    ring: str
    header: SessionHeader


@dataclass(frozen=True)
class SessionMessage:
    """News of the display at a time.

    Attributes
    ----------
    time : float
        Time in the host's clock [s].
    news : News
        What happened.
    """

    time: float
    news: News


@dataclass(frozen=True)
class NumberedOrder:
    """Order with the number by which playback names it.

    Attributes
    ----------
    number : int
        Number of the order.
    order : SessionOrder
        The order.
    """

    number: int
    order: SessionOrder


@dataclass(frozen=True)
class RecorderAnswer:
    """Answer to `SessionSetup`, or news of the end of recording.

    Attributes
    ----------
    folder : str
        Folder of the session.
    failure : str
        Reason why nothing is recorded any more; empty if it is.
    """

    folder: str = ""
    failure: str = ""
