"""The door through which buses are opened: kinds of devices by the scheme of their URL.

A driver registers its scheme when it is imported. An amplifier that would leave volts on a finger
when the host dies is refused here, before anything is opened, unless that is accepted by name.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from tactile.bus.base import Bus, DisplayLike, HostDeath
from tactile.bus.wire_time import Link
from tactile.errors import BusError, InputError
from tactile.files import nearest

UNSAFE: dict[HostDeath, str] = {
    "holds": "when the host dies it holds its last voltage on the finger;",
    "unknown": "what it does when the host dies nobody knows;",
}
ACCEPT = "accept that with --accept-unsafe-hold (accept_unsafe_hold=True)"


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


Factory = Callable[[Address, DisplayLike, float | None], Bus]


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
    """A kind of bus: how one is opened, what it does when the host dies, which there are.

    ``link`` tells how long packets take, of a kind that carries the protocol.
    """

    factory: Factory
    on_host_death: HostDeath
    find: Callable[[], Iterable[Found]]
    link: Callable[[Address], Link] | None = None


_drivers: dict[str, Driver] = {}


def register_bus(
    scheme: str,
    factory: Factory,
    *,
    on_host_death: HostDeath = "ramps",
    find: Callable[[], Iterable[Found]] = tuple,
    link: Callable[[Address], Link] | None = None,
) -> None:
    """Make ``scheme:`` open buses of a kind; an earlier one of that name is replaced."""
    _drivers[scheme] = Driver(factory, on_host_death, find, link)


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
    return link(address)


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
