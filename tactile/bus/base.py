"""The contract that every bus keeps, and the door through which one is opened.

A bus is opened idle. `start` tells the sample position that playing begins with, `write` hands on
blocks that each carry their position, `stop` ramps to 0 V within the fade, `abort` goes there at
the slew limit. Both may be called at any time and any number of times; leaving a ``with`` block
calls one of them, so that no program ends with volts on a finger.

What arrives wrong is counted, not raised: a gap in positions, samples sent twice, volts beyond what
the amplifier allows. Only a call that its state forbids raises.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from types import TracebackType
from typing import ClassVar, Literal, Protocol
from urllib.parse import parse_qsl, urlsplit

import numpy as np
from numpy.typing import NDArray

from tactile.errors import BusError, BusStateError, InputError
from tactile.files import nearest

Floats = NDArray[np.float64]
HostDeath = Literal["ramps", "zero", "holds", "unknown"]


@dataclass(frozen=True)
class DriveBlock:
    """Drive samples for all channels.

    Attributes
    ----------
    position : of the first sample, counted from the start of playing
    volts : (S, C) [V], a column per channel
    """

    position: int
    volts: Floats


class RigLimits(Protocol):
    """What a display may never exceed, in SI units."""

    @property
    def voltage(self) -> float: ...  # noqa: D102
    @property
    def fade(self) -> float: ...  # noqa: D102


class Rig(Protocol):
    """What a bus asks of the display it is opened for."""

    @property
    def channels(self) -> int: ...  # noqa: D102
    @property
    def slew(self) -> float: ...  # noqa: D102
    @property
    def limits(self) -> RigLimits: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """What an amplifier must know of the display it drives.

    Parameters
    ----------
    channels : C, drive lines
    sample_rate : [Hz]
    voltage : largest magnitude [V]
    slew : largest rate [V/s]
    fade : length of the ordinary ramp [s]
    """

    channels: int
    sample_rate: float
    voltage: float
    slew: float
    fade: float

    @classmethod
    def of(cls, rig: Rig, sample_rate: float) -> "Wiring":
        """Return that of a display."""
        return cls(
            channels=rig.channels,
            sample_rate=sample_rate,
            voltage=rig.limits.voltage,
            slew=rig.slew,
            fade=rig.limits.fade,
        )


@dataclass
class Counters:
    """What a bus counts since it was opened.

    Attributes
    ----------
    blocks, samples : taken
    lost_samples : positions that no block carried; bridged by a straight line, or a fade out and in
    repeated_samples : positions that were sent before, dropped
    invalid_samples : values that were not finite, played as 0 V
    clipped_samples : values beyond the amplifier's own voltage limit
    underruns : times the amplifier had nothing to play, and faded
    """

    blocks: int = 0
    samples: int = 0
    lost_samples: int = 0
    repeated_samples: int = 0
    invalid_samples: int = 0
    clipped_samples: int = 0
    underruns: int = 0

    def faults(self) -> dict[str, int]:
        """Return the counters that should be zero and are not."""
        counted = {f.name: int(getattr(self, f.name)) for f in fields(self)}
        return {k: n for k, n in counted.items() if n and k not in ("blocks", "samples")}


class Bus(ABC):
    """A link to an amplifier; see the module's docstring for the contract.

    Attributes
    ----------
    wiring : the `Wiring` it was opened for
    counters : the `Counters`
    state : "idle", "running" or "closed"
    on_host_death : what the amplifier does when the host goes silent
    """

    on_host_death: ClassVar[HostDeath]

    def __init__(self, wiring: Wiring) -> None:
        self.wiring = wiring
        self.counters = Counters()
        self.state: Literal["idle", "running", "closed"] = "idle"

    def start(self, position: int = 0) -> None:
        """Begin playing with the sample at ``position``.

        Raises
        ------
        BusStateError
            Unless idle.
        """
        if self.state != "idle":
            raise BusStateError(f"start: the bus is {self.state}, not idle; stop it first")
        self._start(position)
        self.state = "running"

    def write(self, block: DriveBlock) -> None:
        """Play a block.

        Raises
        ------
        BusStateError
            Unless running.
        InputError
            Where the block does not have a column per channel.
        """
        if self.state != "running":
            raise BusStateError(f"write: the bus is {self.state}, not running; start it first")
        if block.volts.ndim != 2 or block.volts.shape[1] != self.wiring.channels:
            raise InputError(
                f"write: block of shape {block.volts.shape}, needs (S, {self.wiring.channels})"
            )
        self._write(block)

    def stop(self) -> None:
        """Ramp to 0 V within the fade and be idle; nothing to do unless running."""
        if self.state == "running":
            self.state = "idle"
            self._stop()

    def abort(self) -> None:
        """Go to 0 V at the slew limit and be idle; nothing to do unless running."""
        if self.state == "running":
            self.state = "idle"
            self._abort()

    def close(self) -> None:
        """Stop, and let go of the device; the bus cannot be used again."""
        if self.state != "closed":
            self.stop()
            self._close()
            self.state = "closed"

    def __enter__(self) -> "Bus":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is not None:
                self.abort()
        finally:
            self.close()

    @abstractmethod
    def _start(self, position: int) -> None: ...

    @abstractmethod
    def _write(self, block: DriveBlock) -> None: ...

    @abstractmethod
    def _stop(self) -> None: ...

    @abstractmethod
    def _abort(self) -> None: ...

    def _close(self) -> None:  # noqa: B027
        """Let go of the device."""


@dataclass(frozen=True)
class Address:
    """A device URL taken apart: ``scheme:path?option=value``.

    Attributes
    ----------
    scheme, path : the parts before and after the first colon
    options : by name
    """

    scheme: str
    path: str
    options: dict[str, str]

    def only(self, *known: str) -> None:
        """Raise InputError for a path, or an option that is not among the known ones."""
        if self.path:
            raise InputError(f"{self.scheme}: takes no path; what does {self.path!r} mean?")
        for name in self.options:
            if name not in known:
                raise InputError(
                    f"{self.scheme}: unknown option {name!r}; {nearest(name, list(known))}"
                )


Factory = Callable[[Address, Rig, float], Bus]
_factories: dict[str, Factory] = {}


def register_bus(scheme: str, factory: Factory) -> None:
    """Make ``scheme:`` open buses of a kind; an earlier factory of that name is replaced."""
    _factories[scheme] = factory


def open_bus(url: str, rig: Rig, *, sample_rate: float = 8000.0) -> Bus:
    """Open the device at a URL for a display.

    Parameters
    ----------
    url : ``mock:``, ``mock:?keep=all``, ``sim:``, ``sim:?format=bfp8``,
        ``sim:?plant=package.module:factory``
    rig : the display
    sample_rate : of the drive [Hz]

    Raises
    ------
    InputError
        For a scheme or option that does not exist, with the nearest one.
    BusError
        For a device that cannot be opened.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise InputError(f"device {url!r}: {error}") from error
    scheme = parts.scheme or url.partition(":")[0]
    if ":" not in url or scheme not in _factories:
        raise InputError(
            f"device {url!r}: no such kind; {nearest(scheme + ':', [f'{k}:' for k in _factories])}"
        )
    try:
        given = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise InputError(f"device {url!r}: {error}; options are name=value") from error
    address = Address(scheme, parts.netloc + parts.path, dict(given))
    try:
        return _factories[scheme](address, rig, sample_rate)
    except OSError as error:
        if isinstance(error, BusError):
            raise
        raise BusError(f"device {url!r}: {error}") from error
