"""Places of chips on I2C buses, multiplexers before them, and their share of the bus time."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from tactile.bus.linux_i2c import I2cAdapter, LinuxI2c, device_file, device_files
from tactile.bus.options import HEXADECIMAL, Options
from tactile.bus.registry import Address, FoundDevice
from tactile.errors import InputError

CLOCK = 400_000
"""Default clock of the bus: fast mode, the highest rate of a DRV2667 (TI SLOS751E) [Hz]."""
CLOCKS = (10_000, 3_400_000)
"""Lowest and highest clock of I2C buses [Hz]."""
CAP = 0.8
"""Largest share of the bus time that may be used.

The rest is reserved for retries and for delays of the kernel.
"""


class ChipOptions(Options, frozen=True, kw_only=True):
    """Options of a device URL whose displays are driven by chips without firmware.

    Attributes
    ----------
    address : tuple of int
        Addresses of the chips in the order of the channels, or the one behind all ports; the
        chip's own if empty. Each driver declares the addresses that its chip can have.
    mux : int or None
        Address of a TCA9548A multiplexer before the chips (TI SCPS207); by default there is none.
    ports : tuple of int
        Ports of the multiplexer in the order of the channels; by default port 0.
    clock_hz : int
        Clock of the bus [Hz]; an error if it is above the highest of the chip.
    """

    address: tuple[int, ...] = ()
    mux: Annotated[int, Meta(ge=0x70, le=0x77, extra=HEXADECIMAL)] | None = None
    ports: tuple[Annotated[int, Meta(ge=0, le=7)], ...] = ()
    clock_hz: Annotated[int, Meta(ge=CLOCKS[0], le=CLOCKS[1])] = CLOCK


def open_adapter(path: str) -> I2cAdapter:
    """Open the adapter at a path; tests replace this function by a model.

    Parameters
    ----------
    path : str
        Device file.

    Returns
    -------
    I2cAdapter
        The open adapter.
    """
    return LinuxI2c(path)


class Mux:
    """TCA9548A multiplexer; one byte with a bit for each port connects the ports (TI SCPS207).

    Parameters
    ----------
    i2c : I2cAdapter
        Bus of the multiplexer.
    address : int
        Address of the multiplexer.
    """

    def __init__(self, i2c: I2cAdapter, address: int) -> None:
        self._i2c, self._address = i2c, address
        self._port: int | None = None

    def select(self, port: int) -> None:
        """Connect one port and disconnect the others, if that is not so already.

        Parameters
        ----------
        port : int
            Number of the port, 0 to 7.
        """
        if port != self._port:
            self._port = None
            self._i2c.write(self._address, bytes([1 << port]))
            self._port = port

    def forget(self) -> None:
        """Select the port again next time, since the multiplexer may have lost its power."""
        self._port = None


class ChipTarget:
    """Chip as an I2C target, connected directly or to a port of a multiplexer.

    Parameters
    ----------
    i2c : I2cAdapter
        Bus of the chip.
    address : int
        Address of the chip.
    mux : Mux or None
        Multiplexer before the chip.
    port : int
        Port of the multiplexer.

    Attributes
    ----------
    name : str
        Address and port, for messages.
    """

    def __init__(
        self, i2c: I2cAdapter, address: int, mux: Mux | None = None, port: int = 0
    ) -> None:
        self._i2c, self._address, self._mux, self._port = i2c, address, mux, port
        self.name = f"0x{address:02x}" + (f" behind port {port}" if mux else "")

    def connect(self) -> None:
        """Connect the port, so that the next transfer begins without delay."""
        with self._connected():
            return

    def write(self, data: bytes) -> None:
        """Write bytes to the chip.

        Parameters
        ----------
        data : bytes
            Bytes to write.
        """
        with self._connected():
            self._i2c.write(self._address, data)

    def read(self, data: bytes, size: int) -> bytes:
        """Write bytes to the chip and read from it after a repeated start.

        Parameters
        ----------
        data : bytes
            Bytes to write; if empty, nothing is written.
        size : int
            Number of bytes to read.

        Returns
        -------
        bytes
            Bytes that were read.
        """
        with self._connected():
            return self._i2c.write_read(self._address, data, size)

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Connect the port; after an error select it again, in case the power was lost."""
        if self._mux is None:
            yield
            return
        try:
            self._mux.select(self._port)
            yield
        except OSError:
            self._mux.forget()
            raise


@dataclass(frozen=True)
class Place:
    """Location of chips on an I2C bus.

    Attributes
    ----------
    path : str
        Device file of the adapter.
    addresses : tuple of int
        Address of each chip in the order of the channels; behind a multiplexer all are the same.
    mux : int or None
        Address of the multiplexer, if there is one.
    ports : tuple of int
        Port of the multiplexer for each chip.
    clock : int
        Clock of the bus [Hz].
    """

    path: str
    addresses: tuple[int, ...]
    mux: int | None
    ports: tuple[int, ...]
    clock: int

    @classmethod
    def of(cls, url: Address[Any], default: int) -> "Place":
        """Return the location that a device URL names.

        Parameters
        ----------
        url : Address
            Address with `ChipOptions`.
        default : int
            Address of the chip if the URL names none.

        Returns
        -------
        Place
            Adapter, multiplexer and addresses.

        Raises
        ------
        InputError
            If the path is not a bus, ports are given without a multiplexer, there are several
            addresses behind one, or an address or port occurs twice.
        """
        options: ChipOptions = url.options
        addresses, ports = options.address or (default,), options.ports
        if ports and options.mux is None:
            raise InputError(f"{url.scheme}: ports: of which mux=?")
        if options.mux is not None:
            ports = ports or (0,)
            if len(addresses) > 1:
                raise InputError(f"{url.scheme}: one mux and one address behind all its ports")
        for name, values in (("address", addresses), ("ports", ports)):
            if len(set(values)) < len(values):
                raise InputError(f"{url.scheme}: {name}: one comes twice")
        return cls(
            adapter_path(url), addresses * max(len(ports), 1), options.mux, ports, options.clock_hz
        )

    def targets(self, i2c: I2cAdapter) -> list[ChipTarget]:
        """Return the chips of this location.

        Parameters
        ----------
        i2c : I2cAdapter
            The open adapter.

        Returns
        -------
        list of ChipTarget
            Chips in the order of the channels.
        """
        if self.mux is None:
            return [ChipTarget(i2c, address) for address in self.addresses]
        mux = Mux(i2c, self.mux)
        return [
            ChipTarget(i2c, a, mux, port)
            for a, port in zip(self.addresses, self.ports, strict=True)
        ]

    def check(self, scheme: str, channels: int, bits: float, fastest: int) -> None:
        """Check that each channel has a chip, and that the bus has enough time for all of them.

        Parameters
        ----------
        scheme : str
            Scheme of the URL, for messages.
        channels : int
            Number of channels of the display.
        bits : float
            Bits that each chip needs on the bus [1/s].
        fastest : int
            Highest clock that the chip supports [Hz].

        Raises
        ------
        InputError
            If there are too few or too many chips, or the clock is too fast or too slow for them.
        """
        if len(self.addresses) != channels:
            option = "ports=" if self.mux is not None or len(self.addresses) == 1 else "address="
            raise InputError(
                f"{scheme}: {len(self.addresses)} chips for {channels} channels; one chip drives "
                f"one channel, name as many with {option}"
            )
        if self.clock > fastest:
            raise InputError(
                f"{scheme}: clock_hz = {self.clock} exceeds what the chip takes, {fastest}"
            )
        use = bits / self.clock
        if channels * use > CAP:
            raise InputError(
                f"{scheme}: {channels} chips need {channels * use:.0%} of a {self.clock / 1e3:g} "
                f"kHz bus, {use:.0%} each, {CAP:.0%} may be used: {int(CAP / use)} chips fit"
            )


def adapter_path(url: Address[Any]) -> str:
    """Return the device file that the path of a URL denotes: a bus number or the file itself.

    Parameters
    ----------
    url : Address
        Address whose path is looked at.

    Returns
    -------
    str
        Device file, such as "/dev/i2c-1".

    Raises
    ------
    InputError
        If the path is neither.
    """
    if re.fullmatch(r"(/dev/i2c-)?\d+", url.path):
        return device_file(url.path)
    raise InputError(
        f"{url.scheme}: path {url.path!r}: give the number of an I2C bus or /dev/i2c-N"
    )


def find_on_adapters(
    probe: Callable[[str, I2cAdapter], Iterator[FoundDevice]],
) -> Iterator[FoundDevice]:
    """Yield what a probe finds on each adapter; adapters that cannot be used are skipped.

    Parameters
    ----------
    probe : callable
        Function of the bus number and the adapter that yields the devices on it. It handles the
        errors of targets that do not answer.

    Yields
    ------
    FoundDevice
        Device on one of the adapters.
    """
    for path in device_files():
        try:
            i2c = open_adapter(path)
        except OSError:
            continue
        try:
            yield from probe(path.removeprefix("/dev/i2c-"), i2c)
        finally:
            i2c.close()


def answer(i2c: I2cAdapter, address: int, data: bytes, size: int) -> bytes:
    """Read from a target that may be absent.

    Parameters
    ----------
    i2c : I2cAdapter
        Bus of the target.
    address : int
        Address of the target.
    data : bytes
        Bytes to write first; if empty, nothing is written.
    size : int
        Number of bytes to read.

    Returns
    -------
    bytes
        Answer of the target; empty if there is none.
    """
    try:
        return i2c.write_read(address, data, size)
    except OSError:
        return b""
