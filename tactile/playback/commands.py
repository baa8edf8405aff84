"""What the server tells a playback process, and what it is answered.

Both go as pickles over the child's standard streams, each order with a number that comes back with
its answer; the loop obeys at a block's edge. An e-stop is no order: playback watches the latch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.display.display import Display
from tactile.playback.waves import Curve
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.spectrum import SpectrumRenderer

Texture = RealizedLayer | SpectrumRenderer
"""A texture made ready for a display: for a link that takes samples, or frames."""


@dataclass(frozen=True)
class Setup:
    """The first that a playback process is told: what it plays, on what."""

    display: Display
    device: str
    rearm: bool
    sample_rate: float | None
    accept_unsafe_hold: bool
    gain: float
    worn: bool
    memory: str
    latch: str


@dataclass(frozen=True)
class DeviceOpened:
    """What came of that: how the device plays; or why there is none.

    ``carriers`` and ``frame_rate`` are 0 for a link that takes samples.
    """

    sample_rate: float = 0.0
    carriers: int = 0
    frame_rate: float = 0.0
    latency: float = 0.0
    real_time: tuple[str, ...] = ()
    why_not: str = ""


@dataclass(frozen=True)
class Keep:
    """Have a texture ready under a number."""

    number: int
    texture: Texture


@dataclass(frozen=True)
class Drop:
    """A texture that nobody selects any more."""

    number: int


@dataclass(frozen=True)
class SelectTextures:
    """The textures of a client, each with its gain."""

    client: int
    layers: tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class Scale:
    """The gain of all that is a client's, and whether its textures sound."""

    client: int
    gain: float
    sounds: bool


@dataclass(frozen=True)
class Wave:
    """Samples [m] of a client; answered by how many were taken and how many seconds wait."""

    client: int
    samples: NDArray[np.float32]
    sample_rate: float
    contactors: tuple[int, ...]
    append: bool


@dataclass(frozen=True)
class Shape:
    """A parametric effect of a client."""

    client: int
    curve: Curve


@dataclass(frozen=True)
class Silence:
    """No more waveforms of a client."""

    client: int


@dataclass(frozen=True)
class Forget:
    """A client is gone."""

    client: int


@dataclass(frozen=True)
class StartBus:
    """Start the bus."""


@dataclass(frozen=True)
class StopBus:
    """Fade out and stop it."""


@dataclass(frozen=True)
class ClearDevice:
    """End the e-stop with a number at the device; the server writes it to the latch then."""

    estop: int


@dataclass(frozen=True)
class Answer:
    """Of the order with the same number: what it gave, or what it failed of."""

    number: int
    value: tuple[float, ...] = ()
    failure: str = ""


@dataclass(frozen=True)
class News:
    """Something happened: the kind of a `messages.Event`, and one line."""

    kind: str
    detail: str


Order = (
    Keep | Drop | SelectTextures | Scale | Wave | Shape | Silence | Forget | StartBus | StopBus
    | ClearDevice
)  # fmt: skip
