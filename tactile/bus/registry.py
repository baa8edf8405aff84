"""Registry of drivers by URL scheme, and the functions that open a device by its URL.

A driver registers its scheme when it is imported. `open_bus` refuses an amplifier that would leave
voltage on a finger when the host dies, before anything is opened, unless the caller accepts that
explicitly.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic
from urllib.parse import parse_qsl, urlencode, urlsplit

from tactile.bus.base import Bus, DisplayLike, HostDeath
from tactile.bus.options import O, decode, option_types
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Link
from tactile.clock import Clock
from tactile.errors import BusError, InputError
from tactile.files import nearest

UNSAFE: dict[HostDeath, str] = {
    "holds": "when the host dies it holds its last voltage on the finger;",
    "unknown": "what it does when the host dies nobody knows;",
}
"""Behaviors when the host dies that have to be accepted, with the first part of the error."""
ACCEPT = "accept that with --accept-unsafe-hold (accept_unsafe_hold=True)"
"""Second part of that error."""


@dataclass(frozen=True)
class Address(Generic[O]):
    """A device URL taken apart: ``scheme:path?option=value``.

    Attributes
    ----------
    scheme : str
        Part before the first colon, which names the driver.
    path : str
        Part after it, which names the device.
    options : Options
        Values of the options, as the driver declares them.
    """

    scheme: str
    path: str
    options: O


Factory = Callable[[Address[O], DisplayLike, float | None], Bus]
"""Function that opens a bus for a display, at a sample rate [Hz] or, for None, at its own."""
Opener = Callable[[Address[O]], tuple[Wire, Clock]]
"""Function that opens the wire to the amplifiers of a device, and returns it with its clock."""


@dataclass(frozen=True)
class FoundDevice:
    """Device that was found.

    Attributes
    ----------
    url : str
        URL that opens it.
    about : str
        Description, one line.
    """

    url: str
    about: str


@dataclass(frozen=True)
class Driver(Generic[O]):
    """Kind of bus.

    Attributes
    ----------
    factory : callable
        Function that opens a bus.
    options : type of Options
        Struct that declares the options of its URLs.
    takes_path : bool
        Whether its URLs name a device by a path.
    on_host_death : HostDeath
        What its amplifiers do when the host dies.
    find : callable
        Function that returns the devices that are present.
    wire : callable or None
        Function that opens the wire alone, without a session on it; None if the device carries no
        packets of the protocol.
    """

    factory: Factory[O]
    options: type[O]
    takes_path: bool = False
    on_host_death: HostDeath = "ramps"
    find: Callable[[], Iterable[FoundDevice]] = tuple
    wire: Opener[O] | None = None


_drivers: dict[str, Driver[Any]] = {}
"""Registered drivers by their schemes."""


def register_bus(
    scheme: str,
    factory: Factory[O],
    options: type[O],
    *,
    takes_path: bool = False,
    on_host_death: HostDeath = "ramps",
    find: Callable[[], Iterable[FoundDevice]] = tuple,
    wire: Opener[O] | None = None,
) -> None:
    """Register a driver under a scheme; an earlier driver of that scheme is replaced.

    Parameters
    ----------
    scheme : str
        First part of the URLs, without the colon.
    factory, options, takes_path, on_host_death, find, wire
        Attributes of the `Driver`.
    """
    _drivers[scheme] = Driver(factory, options, takes_path, on_host_death, find, wire)


def find_devices() -> Iterator[FoundDevice]:
    """Find the devices of all registered drivers.

    Yields
    ------
    FoundDevice
        Device that is present.
    """
    for driver in _drivers.values():
        yield from driver.find()


def parse(url: str) -> Address[Any]:
    """Take a device URL apart and decode its options.

    Parameters
    ----------
    url : str
        URL of a device.

    Returns
    -------
    Address
        Its scheme, its path and the values of its options.

    Raises
    ------
    InputError
        If the scheme does not exist (the error names the nearest one), the driver takes no path
        and there is one, or it does not have an option or allow its value.
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
        query = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise InputError(f"device {url!r}: {error}; options are name=value") from error
    driver, path = _drivers[scheme], parts.netloc + parts.path
    if path and not driver.takes_path:
        raise InputError(f"{scheme}: takes no path; what does {path!r} mean?")
    return Address(scheme, path, decode(scheme, dict(query), driver.options))


def with_default_option(url: str, name: str, value: str) -> str:
    """Return a device URL with an option, unless it names that option or its driver has none.

    Parameters
    ----------
    url : str
        URL of a device.
    name, value : str
        Name and text of the option.

    Returns
    -------
    str
        The URL, with the option where that makes a difference.

    Raises
    ------
    InputError
        As `parse` does.
    """
    driver, query = _drivers[parse(url).scheme], urlsplit(url).query
    if name not in option_types(driver.options) or name in dict(parse_qsl(query)):
        return url
    return f"{url}{'&' if query else '?'}{urlencode({name: value})}"


def link_at(url: str) -> Link:
    """Return the link of a device without opening the device.

    Parameters
    ----------
    url : str
        URL of a device.

    Returns
    -------
    Link
        Medium, which knows how long packets take.

    Raises
    ------
    InputError
        If the device does not carry the protocol, or as `parse` does.
    """
    link: Link | None = parse(url).options.medium
    if link is None:
        carrying = [f"{name}:" for name, driver in _drivers.items() if driver.options().medium]
        raise InputError(f"device {url!r}: carries no packets; {', '.join(carrying)} do")
    return link


def open_wire(url: str) -> tuple[Wire, Clock]:
    """Open the wire of a device without a session on it, such as to test its amplifier.

    Parameters
    ----------
    url : str
        URL of a device that carries the protocol.

    Returns
    -------
    wire : Wire
        Open wire, which the caller closes.
    clock : Clock
        Clock by which it waits.

    Raises
    ------
    InputError
        If the device does not carry the protocol, or as `parse` does.
    BusError
        If the device cannot be opened.
    """
    address = parse(url)
    wire = _drivers[address.scheme].wire
    if wire is None:
        carrying = [f"{name}:" for name, driver in _drivers.items() if driver.wire]
        raise InputError(f"device {url!r}: carries no packets; {', '.join(carrying)} do")
    try:
        return wire(address)
    except OSError as error:
        if isinstance(error, BusError):
            raise
        raise BusError(f"device {url!r}: {error}") from error


def open_bus(
    url: str,
    display: DisplayLike,
    *,
    sample_rate: float | None = None,
    accept_unsafe_hold: bool = False,
) -> Bus:
    """Open the device at a URL for a display.

    Parameters
    ----------
    url : str
        URL such as ``mock:``, ``sim:?format=bfp8``, ``serial:///dev/ttyACM0``,
        ``can:socketcan/can0?fd=true``, ``i2c:1?address=0x42`` or ``audio:NAME?channels=24``.
    display : DisplayLike
        Display that the amplifier drives.
    sample_rate : float, optional
        Sample rate of the drive [Hz]; by default the bus chooses it, and its `wiring` has it.
    accept_unsafe_hold : bool
        Whether to open also an amplifier that holds its last voltage when the host dies, or of
        which nobody knows what it does then.

    Returns
    -------
    Bus
        Bus that is open and idle.

    Raises
    ------
    InputError
        As `parse` does; or if the amplifier does not go to 0 V by itself when the host dies and
        that is not accepted; or if the device cannot do what the display needs.
    BusError
        If the device cannot be opened.

    Examples
    --------
    >>> import numpy as np
    >>> import tactile
    >>> display = tactile.load_display("reference-24")
    >>> with tactile.open_bus("mock:", display) as bus:
    ...     bus.start()
    ...     bus.write(tactile.DriveBlock(0, np.zeros((80, display.channels))))
    >>> bus.counters.samples, bus.state
    (80, 'closed')
    """
    address = parse(url)
    driver = _drivers[address.scheme]
    if driver.on_host_death in UNSAFE and not accept_unsafe_hold:
        raise InputError(f"device {url!r}: {UNSAFE[driver.on_host_death]} {ACCEPT}")
    try:
        return driver.factory(address, display, sample_rate)
    except OSError as error:
        if isinstance(error, BusError):
            raise
        raise BusError(f"device {url!r}: {error}") from error
