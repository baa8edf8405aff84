"""The door through which buses are opened: kinds of devices by the scheme of their URL.

A driver registers its scheme when it is imported. An amplifier that would leave volts on a finger
when the host dies is refused here, before anything is opened, unless that is accepted by name.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic
from urllib.parse import parse_qsl, urlencode, urlsplit

from tactile.bus.base import Bus, DisplayLike, HostDeath
from tactile.bus.options import O, decode, option_types
from tactile.bus.wire_time import Link
from tactile.errors import BusError, InputError
from tactile.files import nearest

UNSAFE: dict[HostDeath, str] = {
    "holds": "when the host dies it holds its last voltage on the finger;",
    "unknown": "what it does when the host dies nobody knows;",
}
ACCEPT = "accept that with --accept-unsafe-hold (accept_unsafe_hold=True)"


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
"""Function that opens a bus for a display, at a sample rate [Hz] or at its own."""


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
class Driver(Generic[O]):
    """A kind of bus.

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
        Function that returns the devices that are there.
    link : callable or None
        Function that returns how long packets take on the link of a URL with these options; None
        for a bus that does not carry the protocol.
    """

    factory: Factory[O]
    options: type[O]
    takes_path: bool = False
    on_host_death: HostDeath = "ramps"
    find: Callable[[], Iterable[Found]] = tuple
    link: Callable[[O], Link] | None = None


_drivers: dict[str, Driver[Any]] = {}


def register_bus(
    scheme: str,
    factory: Factory[O],
    options: type[O],
    *,
    takes_path: bool = False,
    on_host_death: HostDeath = "ramps",
    find: Callable[[], Iterable[Found]] = tuple,
    link: Callable[[O], Link] | None = None,
) -> None:
    """Make ``scheme:`` open buses of a kind; an earlier kind of that name is replaced.

    Parameters
    ----------
    scheme : str
        First part of the URLs.
    factory, options, takes_path, on_host_death, find, link
        Attributes of the `Driver`.
    """
    _drivers[scheme] = Driver(factory, options, takes_path, on_host_death, find, link)


def find_devices() -> Iterator[Found]:
    """Yield the devices that are there, of all kinds."""
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
        For a scheme that does not exist, with the nearest one, a path that the driver does not
        take, an option that it does not have, or a value that is not allowed.
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
    driver, path = _drivers[scheme], parts.netloc + parts.path
    if path and not driver.takes_path:
        raise InputError(f"{scheme}: takes no path; what does {path!r} mean?")
    return Address(scheme, path, decode(scheme, dict(given), driver.options))


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
    """Return how long packets take on the link of a device, without opening it.

    Raises
    ------
    InputError
        For a device that does not carry the protocol.
    """
    address = parse(url)
    link = _drivers[address.scheme].link
    if link is None:
        carrying = ", ".join(f"{name}:" for name, driver in _drivers.items() if driver.link)
        raise InputError(f"device {url!r}: carries no packets; {carrying} do")
    return link(address.options)


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
    url : such as ``mock:``, ``sim:?format=bfp8``, ``serial:///dev/ttyACM0``,
        ``can:socketcan/can0?fd=true``, ``i2c:1?address=0x42``, ``audio:NAME?channels=24``
    display : the display
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
        return driver.factory(address, display, sample_rate)
    except OSError as error:
        if isinstance(error, BusError):
            raise
        raise BusError(f"device {url!r}: {error}") from error
