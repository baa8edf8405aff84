"""Commands of the server to a playback process, and the answers to them.

Both are pickled and sent over the standard streams of the child process. Each order has a number
that comes back with its answer; the loop executes orders between two blocks. An e-stop is not an
order: playback watches the latch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.display.display import Display
from tactile.messages import ArmDisplay, ClearEstop, DisarmDisplay
from tactile.playback.voice import ClientState
from tactile.playback.waveforms import LONGEST
from tactile.playback.waves import Curve
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.spectrum import SpectrumRenderer

PreparedTexture = RealizedLayer | SpectrumRenderer
"""Texture realized for a display, on a link that takes samples or one that takes frames."""


@dataclass(frozen=True)
class PlaybackSetup:
    """First message to a playback process: the display to play, and on which device.

    Attributes
    ----------
    display : Display
        Display to play.
    device : str
        URL of the bus.
    rearm : bool
        Whether the link may arm again by itself, if it can and the URL does not say.
    sample_rate : float or None
        Sample rate of the drive; None for the choice of the device [Hz].
    accept_unsafe_hold : bool
        As in `open_bus`.
    gain : float
        Gain of the display, on top of that of each client.
    worn : bool
        Whether the finger stays on the display although it touches nothing.
    memory : str
        Handle of the shared memory.
    latch : str
        Handle of the display's e-stop latch.
    session : str
        Handle of the ring for a recorder of the session; empty without one.
    calibration : str
        File with what the display's contactors draw in air, if playback is to follow the finger;
        empty if not.
    """

    display: Display
    device: str
    rearm: bool
    sample_rate: float | None
    accept_unsafe_hold: bool
    gain: float
    worn: bool
    memory: str
    latch: str
    session: str = ""
    calibration: str = ""


@dataclass(frozen=True)
class DeviceOpened:
    """Reply to `PlaybackSetup`: how the device plays, or why it could not be opened.

    Attributes
    ----------
    sample_rate : float
        Sample rate of the drive [Hz].
    carriers : int
        Number of carriers; 0 for a link that takes samples.
    frame_rate : float
        Frame rate; 0 for a link that takes samples [Hz].
    ahead : float
        Time before it is due at which the bus wants a block [s].
    real_time : tuple of str
        Real-time privileges that the system refused.
    why_not : str
        Reason why the device could not be opened; empty if it was.
    follows : bool
        Whether playback follows the finger.
    marker_lines : int
        Number of marker lines of the amplifier; 0 for none.
    """

    sample_rate: float = 0.0
    carriers: int = 0
    frame_rate: float = 0.0
    ahead: float = 0.0
    real_time: tuple[str, ...] = ()
    why_not: str = ""
    follows: bool = False
    marker_lines: int = 0


@dataclass(frozen=True)
class KeepTexture:
    """Order to keep a texture ready under a number.

    Attributes
    ----------
    number : int
        Number of the texture.
    texture : RealizedLayer or SpectrumRenderer
        Texture realized for the display.
    """

    number: int
    texture: PreparedTexture


@dataclass(frozen=True)
class DropTexture:
    """Order to drop a texture that no client selects any more.

    Attributes
    ----------
    number : int
        Number of the texture.
    """

    number: int


@dataclass(frozen=True)
class SetState:
    """Order to set what a client plays besides its waves.

    Attributes
    ----------
    client : int
        Number of the client.
    state : ClientState
        Textures and gain of the client.
    """

    client: int
    state: ClientState


@dataclass(frozen=True)
class AppendSamples:
    """Order to play samples of a client.

    The answer is the number of samples that were taken, and the duration of those that wait [s].

    Attributes
    ----------
    client : int
        Number of the client.
    samples : (S,) array of float32
        Shear [m].
    sample_rate : float
        Sample rate [Hz].
    contactors : tuple of int
        Contactors that play them; empty for all.
    append : bool
        Whether they follow the samples that wait, or replace them.
    longest : float
        Largest duration of samples that may wait [s].
    """

    client: int
    samples: NDArray[np.float32]
    sample_rate: float
    contactors: tuple[int, ...]
    append: bool
    longest: float = LONGEST


@dataclass(frozen=True)
class AddFrames:
    """Order to play tactile frames of a client: the shear of all contactors at one instant each.

    Attributes
    ----------
    client : int
        Number of the client.
    frames : (F, N) array of float32
        Shear of each contactor [m].
    frame_rate : float
        Rate of the frames [Hz].
    latest : bool
        Whether only the newest frame counts; otherwise all are played, one after the other.
    time : float or None
        Time at which the first of them is to be put out, in the host's clock; None for frames that
        are played as they come [s].
    """

    client: int
    frames: NDArray[np.float32]
    frame_rate: float
    latest: bool
    time: float | None = None


@dataclass(frozen=True)
class BeginEffect:
    """Order to play a parametric effect of a client.

    Attributes
    ----------
    client : int
        Number of the client.
    curve : Curve
        Effect to play.
    """

    client: int
    curve: Curve


@dataclass(frozen=True)
class PlayAt:
    """Order to play what another order of the same client says, at a time.

    The answer is that of the other order. What became of it, an `OnsetReport` says.

    Attributes
    ----------
    number : int
        Number of the stimulus, which the report repeats.
    client : int
        Number of the client.
    time : float
        Time at which its first sample is to be put out, in the host's clock [s].
    drop_late : bool
        Whether it is dropped if that is not possible any more; otherwise it is played at once.
    order : AppendSamples or BeginEffect or AddFrames
        What is to be played.
    marker : int
        Code that the marker lines take with its first sample; 0 for none.
    """

    number: int
    client: int
    time: float
    drop_late: bool
    order: AppendSamples | BeginEffect | AddFrames
    marker: int = 0


@dataclass(frozen=True)
class EndWaves:
    """Order to end the waveforms and effects of a client.

    Attributes
    ----------
    client : int
        Number of the client.
    """

    client: int


@dataclass(frozen=True)
class ForgetClient:
    """Order to forget a client that has left.

    Attributes
    ----------
    client : int
        Number of the client.
    """

    client: int


@dataclass(frozen=True)
class OrderAnswer:
    """Answer to the order with the same number.

    Attributes
    ----------
    number : int
        Number of the order.
    value : tuple of float
        Result of the order.
    failure : str
        Reason why it failed; empty if it did not.
    """

    number: int
    value: tuple[float, ...] = ()
    failure: str = ""


@dataclass(frozen=True)
class News:
    """Event on the display.

    Attributes
    ----------
    kind : str
        Kind of an `EventMessage`.
    detail : str
        One line about it.
    contactors : tuple of int
        Contactors that it is about; empty if it is about the display.
    """

    kind: str
    detail: str
    contactors: tuple[int, ...] = ()


@dataclass(frozen=True)
class OnsetReport:
    """News of what became of a `PlayAt`.

    Attributes
    ----------
    number : int
        Number of the stimulus.
    client : int
        Number of the client.
    time : float
        Time at which its first sample was put out, in the host's clock; NaN if it was not [s].
    uncertainty : float
        Half of the interval around that time that holds the true one; NaN if it is not known [s].
    reason : str
        Reason why it was not played, or not at its time, or without its marker; empty if all was as
        it should be.
    marker : int
        Code that the marker lines have shown with its first sample, as far as the amplifier has
        confirmed that; 0 for none.
    """

    number: int
    client: int
    time: float
    uncertainty: float
    reason: str = ""
    marker: int = 0


Order = (
    KeepTexture | DropTexture | SetState | AppendSamples | AddFrames | BeginEffect | PlayAt
    | EndWaves | ForgetClient | ArmDisplay | DisarmDisplay | ClearEstop
)  # fmt: skip
"""Any order to a playback process. What needs no preparation is the client's own request."""
