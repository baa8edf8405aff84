"""The contract that every bus keeps, and the door through which one is opened.

A bus is opened idle. `start` tells the sample position that playing begins with, `write` hands on
blocks that each carry their position, `stop` ramps to 0 V within the fade, `abort` goes there at
the slew limit. Both may be called at any time and any number of times; leaving a ``with`` block
calls one of them, so that no program ends with volts on a finger. `estop` overtakes whatever is
queued, takes high voltage away and holds until a person decides to `clear` it.

What arrives wrong is counted, not raised: a gap in positions, samples sent twice, volts beyond what
the amplifier allows. Only a call that its state forbids raises. A link that fails does not raise
either: `status` tells the truth about it, what could not be sent is counted, and the driver
connects again.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
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
BusState = Literal["idle", "running", "estopped", "closed"]

UNSAFE: dict[HostDeath, str] = {
    "holds": "when the host dies it holds its last voltage on the finger;",
    "unknown": "what it does when the host dies nobody knows;",
}
ACCEPT = "accept that with --accept-unsafe-hold (accept_unsafe_hold=True)"
RATE = 8000.0
"""Hz, of the drive where neither caller nor link asks for another."""


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
    late_blocks : not all of which came before it was due
    dropped_samples : not sent, for they were late already or the link was down
    disconnects, reconnects : of the link
    """

    blocks: int = 0
    samples: int = 0
    lost_samples: int = 0
    repeated_samples: int = 0
    invalid_samples: int = 0
    clipped_samples: int = 0
    underruns: int = 0
    late_blocks: int = 0
    dropped_samples: int = 0
    disconnects: int = 0
    reconnects: int = 0

    def faults(self) -> dict[str, int]:
        """Return the counters that should be zero and are not."""
        counted = {f.name: int(getattr(self, f.name)) for f in fields(self)}
        return {k: n for k, n in counted.items() if n and k not in ("blocks", "samples")}


@dataclass(frozen=True)
class Status:
    """How it stands.

    Attributes
    ----------
    state : of the bus
    link : whether the amplifier can be reached
    detail : one line on what is wrong; empty where nothing is
    """

    state: BusState
    link: Literal["up", "down"] = "up"
    detail: str = ""


class Bus(ABC):
    """A link to an amplifier; see the module's docstring for the contract.

    Attributes
    ----------
    wiring : the `Wiring` it was opened for
    counters : the `Counters`
    state : "idle", "running", "estopped" or "closed"
    on_host_death : what the amplifier does when the host goes silent
    """

    on_host_death: ClassVar[HostDeath]

    def __init__(self, wiring: Wiring) -> None:
        self.wiring = wiring
        self.counters = Counters()
        self.state: BusState = "idle"
        self._next = 0

    @property
    def status(self) -> Status:
        """How it stands now."""
        return Status(self.state)

    def start(self, position: int = 0) -> None:
        """Begin playing with the sample at ``position``.

        Raises
        ------
        BusStateError
            Unless idle.
        """
        if self.state != "idle":
            way = "clear" if self.state == "estopped" else "stop"
            raise BusStateError(f"start: the bus is {self.state}, not idle; {way} it first")
        self._next = position
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
        gap = block.position - self._next
        volts = block.volts
        if gap < 0:
            self.counters.repeated_samples += min(-gap, len(volts))
            volts, gap = volts[-gap:], 0
        self.counters.lost_samples += gap
        self.counters.blocks += 1
        self.counters.samples += len(volts)
        self._next += gap + len(volts)
        if len(volts):
            self._write(DriveBlock(self._next - len(volts), self._allowed(volts)))

    def _allowed(self, volts: Floats) -> Floats:
        limit = self.wiring.voltage
        if np.abs(volts).max(initial=0.0) <= limit:
            return volts
        bad = ~np.isfinite(volts)
        volts = np.where(bad, 0.0, volts)
        self.counters.invalid_samples += int(bad.sum())
        self.counters.clipped_samples += int(np.count_nonzero(np.abs(volts) > limit))
        return np.clip(volts, -limit, limit)

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

    def estop(self) -> None:
        """Go to 0 V at the slew limit before anything that is queued, high voltage off, and stay.

        May be called from any thread, in any state; only `clear` ends it.
        """
        if self.state != "closed":
            self.state = "estopped"
            self._estop()

    def clear(self) -> None:
        """End an e-stop and be idle, where a person has decided so; else nothing to do.

        Raises
        ------
        BusError
            Where the amplifier refuses it.
        """
        if self.state == "estopped":
            self._clear()
            self.state = "idle"

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
    def _write(self, block: DriveBlock) -> None:
        """Play a block that begins where the last ended or later, and is within the limit."""

    @abstractmethod
    def _stop(self) -> None: ...

    @abstractmethod
    def _abort(self) -> None: ...

    @abstractmethod
    def _estop(self) -> None: ...

    @abstractmethod
    def _clear(self) -> None: ...

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

    def only(self, *known: str, path: bool = False) -> None:
        """Raise InputError for an option that is none of the known, or an unwanted path."""
        if self.path and not path:
            raise InputError(f"{self.scheme}: takes no path; what does {self.path!r} mean?")
        for name in self.options:
            if name not in known:
                raise InputError(
                    f"{self.scheme}: unknown option {name!r}; {nearest(name, list(known))}"
                )


Factory = Callable[[Address, Rig, float | None], Bus]


@dataclass(frozen=True)
class Found:
    """A device that is there.

    Attributes
    ----------
    url : that opens it
    about : what it is, one line
    """

    url: str
    about: str


@dataclass(frozen=True)
class Driver:
    """A kind of bus: how one is opened, what it does when the host dies, which there are."""

    factory: Factory
    on_host_death: HostDeath
    find: Callable[[], Iterable[Found]]


_drivers: dict[str, Driver] = {}


def register_bus(
    scheme: str,
    factory: Factory,
    *,
    on_host_death: HostDeath = "ramps",
    find: Callable[[], Iterable[Found]] = tuple,
) -> None:
    """Make ``scheme:`` open buses of a kind; an earlier one of that name is replaced."""
    _drivers[scheme] = Driver(factory, on_host_death, find)


def find_devices() -> Iterator[Found]:
    """Yield the devices that are there, of all kinds."""
    for driver in _drivers.values():
        yield from driver.find()


def parse(url: str) -> Address:
    """Take a device URL apart.

    Raises
    ------
    InputError
        For a scheme that does not exist, with the nearest one, or options that are none.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise InputError(f"device {url!r}: {error}") from error
    scheme = parts.scheme or url.partition(":")[0]
    if ":" not in url or scheme not in _drivers:
        raise InputError(
            f"device {url!r}: no such kind; {nearest(scheme + ':', [f'{k}:' for k in _drivers])}"
        )
    try:
        given = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise InputError(f"device {url!r}: {error}; options are name=value") from error
    return Address(scheme, parts.netloc + parts.path, dict(given))


def open_bus(
    url: str, rig: Rig, *, sample_rate: float | None = None, accept_unsafe_hold: bool = False
) -> Bus:
    """Open the device at a URL for a display.

    Parameters
    ----------
    url : such as ``mock:``, ``sim:?format=bfp8``, ``serial:///dev/ttyACM0``,
        ``can:socketcan/can0?fd=true``, ``i2c:1?address=0x42``, ``audio:NAME?channels=24``
    rig : the display
    sample_rate : of the drive [Hz]; by default the bus's choice, told by its `wiring`
    accept_unsafe_hold : open also what holds its last voltage, or does nobody knows what, when
        the host dies

    Raises
    ------
    InputError
        For a scheme or option that does not exist, with the nearest one; for an amplifier that
        does not go to 0 V by itself, unless that is accepted.
    BusError
        For a device that cannot be opened.
    """
    address = parse(url)
    driver = _drivers[address.scheme]
    if driver.on_host_death in UNSAFE and not accept_unsafe_hold:
        raise InputError(f"device {url!r}: {UNSAFE[driver.on_host_death]} {ACCEPT}")
    try:
        return driver.factory(address, rig, sample_rate)
    except OSError as error:
        if isinstance(error, BusError):
            raise
        raise BusError(f"device {url!r}: {error}") from error
