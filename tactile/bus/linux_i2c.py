"""I²C adapters of Linux, /dev/i2c-N, by smbus2.

The drivers know them by protocols only, so that a model in memory can take their place.
"""

import errno
import threading
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from tactile.errors import BusError


class I2cAdapter(Protocol):
    """Transfers to and from addresses on an I²C bus.

    A call returns when its transfer has ended. Errors are OSErrors, a transfer that nobody
    acknowledges among them.
    """

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to a target.

        Parameters
        ----------
        address : int
            Address of the target.
        data : bytes
            Bytes to write.
        """
        ...

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Write bytes to a target and read from it after a repeated start.

        Parameters
        ----------
        address : int
            Address of the target.
        data : bytes
            Bytes to write; if empty, nothing is written.
        size : int
            Number of bytes to read.

        Returns
        -------
        bytes
            Bytes that were read.
        """
        ...

    def close(self) -> None:
        """Close the adapter; it may be called any number of times."""
        ...


class SmbusAdapter(I2cAdapter, Protocol):
    """I²C adapter that also has the blocks of SMBus."""

    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block.

        Parameters
        ----------
        address : int
            Address of the target.
        command : int
            Command code.
        block : bytes
            At most 32 bytes.
        """
        ...

    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block.

        Parameters
        ----------
        address : int
            Address of the target.
        command : int
            Command code.

        Returns
        -------
        bytes
            Bytes that the target sent, at most 32.
        """
        ...


class LinuxI2c(SmbusAdapter):
    """I²C adapter of Linux.

    Parameters
    ----------
    path : str
        Device file, such as "/dev/i2c-1".

    Raises
    ------
    BusError
        If there is no such adapter, its use is not permitted, or smbus2 is missing.
    """

    def __init__(self, path: str) -> None:
        try:
            import smbus2

            self._message, self._bus = smbus2.i2c_msg, smbus2.SMBus(path)
        except ImportError as error:
            raise BusError("i2c: needs Linux and smbus2: pip install smbus2") from error
        except OSError as error:
            raise BusError(f"i2c: {path}: {_reason(error)}") from error
        self._lock = threading.RLock()
        """Held while a block is exchanged, since smbus2 selects the target by a call of its own;
        reentrant, since a signal handler may send an e-stop."""

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to a target.

        Parameters
        ----------
        address : int
            Address of the target.
        data : bytes
            Bytes to write.
        """
        self._bus.i2c_rdwr(self._message.write(address, data))

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Write bytes to a target and read from it after a repeated start.

        Parameters
        ----------
        address : int
            Address of the target.
        data : bytes
            Bytes to write; if empty, nothing is written.
        size : int
            Number of bytes to read.

        Returns
        -------
        bytes
            Bytes that were read.
        """
        read = self._message.read(address, size)
        self._bus.i2c_rdwr(*([self._message.write(address, data)] if data else []), read)
        return bytes(read)

    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block.

        Parameters
        ----------
        address : int
            Address of the target.
        command : int
            Command code.
        block : bytes
            At most 32 bytes.
        """
        with self._lock:
            self._bus.write_block_data(address, command, list(block))

    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block.

        Parameters
        ----------
        address : int
            Address of the target.
        command : int
            Command code.

        Returns
        -------
        bytes
            Bytes that the target sent, at most 32.
        """
        with self._lock:
            return bytes(self._bus.read_block_data(address, command))

    def close(self) -> None:
        """Close the adapter; it may be called any number of times."""
        with suppress(OSError):
            self._bus.close()


def _reason(error: OSError) -> str:
    """Return why an adapter cannot be opened, and what to do about it."""
    if error.errno == errno.ENOENT:
        return f"no such bus; there are: {', '.join(device_files()) or 'none; modprobe i2c-dev'}"
    if error.errno == errno.EACCES:
        return "permission denied; sudo usermod -aG i2c $USER, then log in again"
    return str(error.strerror or error)


def device_file(path: str) -> str:
    """Return the device file of a bus.

    Parameters
    ----------
    path : str
        Number of the bus, or its device file.

    Returns
    -------
    str
        Path of the device file.

    Examples
    --------
    >>> device_file("1")
    '/dev/i2c-1'
    """
    return f"/dev/i2c-{path}" if path.isdigit() else path


def device_files() -> list[str]:
    """Return the device files of the adapters of this computer.

    Returns
    -------
    list of str
        Paths, such as "/dev/i2c-1".
    """
    return sorted(str(path) for path in Path("/dev").glob("i2c-*"))
