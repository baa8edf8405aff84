"""I2C adapters of Linux, multiplexers before chips, and what of a bus's time chips use.

A chip is reached by two calls, a write and a write followed by a read, so that a model in memory
can stand in for ``/dev/i2c-N``.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

from msgspec import Meta

from tactile.bus.options import HEXADECIMAL, Options
from tactile.bus.registry import Address, Found
from tactile.errors import BusError, InputError

CLOCK = 400_000
"""Hz of the bus where nobody says otherwise: fast mode, the most of a DRV2667 (TI SLOS751E)."""
CLOCKS = (10_000, 3_400_000)
"""Hz, the range of I2C buses."""
CAP = 0.8
"""Of a bus's time that may be used; the rest is for retries and the kernel."""


class ChipOptions(Options, frozen=True, kw_only=True):
    """Options of a device URL whose displays are driven by chips without firmware.

    Attributes
    ----------
    address : tuple of int
        Addresses of the chips in the order of the channels, or the one behind all ports; the
        chip's own if empty. Each driver declares the addresses that its chip can have.
    mux : int or None
        Address of a TCA9548A multiplexer before the chips (TI SCPS207).
    ports : tuple of int
        Ports of the multiplexer in the order of the channels; port 0 if empty.
    clock_hz : int
        Clock of the bus [Hz].
    """

    address: tuple[int, ...] = ()
    mux: Annotated[int, Meta(ge=0x70, le=0x77, extra=HEXADECIMAL)] | None = None
    ports: tuple[Annotated[int, Meta(ge=0, le=7)], ...] = ()
    clock_hz: Annotated[int, Meta(ge=CLOCKS[0], le=CLOCKS[1])] = CLOCK


class I2cAdapter(Protocol):
    """An I2C bus; every call raises OSError where a target does not acknowledge."""

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to a target."""
        ...

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Write bytes (none: no write at all), then read from the same target."""
        ...

    def close(self) -> None:
        """Let go of the bus."""
        ...


class LinuxI2c:
    """An adapter of Linux by its device file.

    Parameters
    ----------
    path : such as "/dev/i2c-1"

    Raises
    ------
    BusError
        Where there is no adapter, it may not be used, or smbus2 is missing.
    """

    def __init__(self, path: str) -> None:
        try:
            import smbus2
        except ImportError as error:
            raise BusError(
                f"{path}: I2C needs Linux and the package smbus2 (pip install smbus2): {error}"
            ) from error
        self._message: Any = smbus2.i2c_msg
        try:
            self._bus = smbus2.SMBus(path)
        except FileNotFoundError as error:
            raise BusError(
                f"{path}: there is no such I2C adapter; is the module i2c-dev loaded "
                "(modprobe i2c-dev) and the bus switched on?"
            ) from error
        except PermissionError as error:
            raise BusError(
                f"{path}: permission denied; be in the group i2c (usermod -aG i2c $USER)"
            ) from error
        except OSError as error:
            raise BusError(f"{path}: {error.strerror or error}") from error

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to a target."""
        self._bus.i2c_rdwr(self._message.write(address, data))

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Write bytes (none: no write at all), then read from the same target."""
        read = self._message.read(address, size)
        self._bus.i2c_rdwr(*([self._message.write(address, data)] if data else []), read)
        return bytes(read)

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()


def open_adapter(path: str) -> I2cAdapter:
    """Open the adapter at a path; what tests put a model in the place of."""
    return LinuxI2c(path)


class Mux:
    """A TCA9548A: one byte with a bit per port connects them (TI SCPS207)."""

    def __init__(self, i2c: I2cAdapter, address: int) -> None:
        self._i2c, self._address = i2c, address
        self._port: int | None = None

    def select(self, port: int) -> None:
        """Connect one port alone."""
        if port != self._port:
            self._port = None
            self._i2c.write(self._address, bytes([1 << port]))
            self._port = port

    def forget(self) -> None:
        """Select anew next time: it may have lost its power."""
        self._port = None


class ChipTarget:
    """A chip as it is reached, behind a port of a multiplexer or directly."""

    def __init__(
        self, i2c: I2cAdapter, address: int, mux: Mux | None = None, port: int = 0
    ) -> None:
        self._i2c, self._address, self._mux, self._port = i2c, address, mux, port
        self.name = f"0x{address:02x}" + (f" behind port {port}" if mux else "")

    def connect(self) -> None:
        """Connect the port, so that what is written next is under way at once."""
        with self._connected():
            return

    def write(self, data: bytes) -> None:
        """Write bytes."""
        with self._connected():
            self._i2c.write(self._address, data)

    def read(self, data: bytes, size: int) -> bytes:
        """Write bytes (none: no write at all), then read."""
        with self._connected():
            return self._i2c.write_read(self._address, data, size)

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Connect the port; after an error anew, for the multiplexer may have lost its power."""
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
    """Where chips are: adapter, addresses in the order of the channels, multiplexer, bus clock.

    Attributes
    ----------
    path : of the adapter
    addresses : a chip's each; with a multiplexer the same for all
    mux : its address; None where there is none
    ports : of the multiplexer, a chip's each
    clock : of the bus [Hz]
    """

    path: str
    addresses: tuple[int, ...]
    mux: int | None
    ports: tuple[int, ...]
    clock: int

    @classmethod
    def of(cls, url: Address[Any], default: int) -> "Place":
        """Return the place that a device URL names.

        Parameters
        ----------
        url : Address
            Address with `ChipOptions`.
        default : int
            Address of the chip, where the URL names none.

        Returns
        -------
        Place
            Adapter, multiplexer and addresses.

        Raises
        ------
        InputError
            For a path that is no bus, ports without a multiplexer, several addresses behind one,
            or an address or port that comes twice.
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
        """Return the chips on an adapter."""
        if self.mux is None:
            return [ChipTarget(i2c, address) for address in self.addresses]
        mux = Mux(i2c, self.mux)
        return [
            ChipTarget(i2c, a, mux, port)
            for a, port in zip(self.addresses, self.ports, strict=True)
        ]

    def check(self, scheme: str, channels: int, bits: float, fastest: int) -> None:
        """See that a chip is there for each channel, and the bus has time for all.

        Parameters
        ----------
        scheme : of the URL, for messages
        channels : of the display
        bits : that a chip needs [1/s]
        fastest : clock that the chip takes [Hz]

        Raises
        ------
        InputError
            Where one of it is not so.
        """
        if len(self.addresses) != channels:
            how = "ports=" if self.mux is not None or len(self.addresses) == 1 else "address="
            raise InputError(
                f"{scheme}: {len(self.addresses)} chips for {channels} channels; one chip drives "
                f"one channel, name as many with {how}"
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
    """Return the device file that a URL's path means: a bus number or the file itself.

    Raises
    ------
    InputError
        For anything else.
    """
    if re.fullmatch(r"\d+", url.path):
        return f"/dev/i2c-{int(url.path)}"
    if re.fullmatch(r"/dev/i2c-\d+", url.path):
        return url.path
    raise InputError(
        f"{url.scheme}: path {url.path!r}: give the number of an I2C bus or /dev/i2c-N"
    )


def transfer_bits(written: int, read: int = 0) -> int:
    """Return the bits of a transfer on the wire: addresses, acknowledges, start and stop counted.

    Nine bits a byte (I2C specification UM10204, 3.1.5), a start and a stop; a read after a write
    adds its own address and repeated start.
    """
    return (9 * (1 + written) + 1 if written or not read else 0) + (
        9 * (1 + read) + 1 if read else 0
    ) + 1  # fmt: skip


def found_on_adapters(probe: Callable[[str, I2cAdapter], Iterator[Found]]) -> Iterator[Found]:
    """Yield what a probe finds on each adapter that there is; silent about what cannot be used.

    Parameters
    ----------
    probe : given the number and the adapter; its OSErrors mean that nothing is there
    """
    for path in sorted(Path("/dev").glob("i2c-*")):
        try:
            i2c = open_adapter(str(path))
        except OSError:
            continue
        try:
            yield from probe(path.name.removeprefix("i2c-"), i2c)
        finally:
            i2c.close()


def answer(i2c: I2cAdapter, address: int, data: bytes, size: int) -> bytes:
    """Return what a target answers, nothing where there is none."""
    try:
        return i2c.write_read(address, data, size)
    except OSError:
        return b""
