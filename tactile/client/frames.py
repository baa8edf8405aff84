"""Tactile frames that a program streams: the shear of every contactor at one instant."""

import sys
from array import array
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec

from tactile.client.taxels import flattened, to_grid
from tactile.client.wire import Pair, checked, excerpt, to_number
from tactile.errors import InputError
from tactile.messages import TactileFrames


class FrameWriter:
    """Writer of tactile frames. Get it from `RemoteDisplay.frames` or `AsyncDisplay.frames`.

    Parameters
    ----------
    send : Callable
        Function that sends a message without waiting.
    display : str
        Name of the display.
    contactors : (N, 2) sequence of float
        Positions of its contactors [m].
    rate : float
        Rate of the frames [Hz].
    amplitude : float
        Shear of a value of 1 [m].
    latest : bool
        Whether only the newest frame counts.
    grid : (2,) sequence of int, optional
        Number of rows and columns of a grid of taxels, of which each frame is an image.
    extent : (4,) iterable of float, optional
        Left, bottom, right and top side of the grid [m].

    Raises
    ------
    InputError
        If an argument is not of that kind.
    """

    def __init__(
        self,
        send: Callable[[TactileFrames], None],
        display: str,
        contactors: Sequence[Pair],
        *,
        rate: float,
        amplitude: float,
        latest: bool,
        grid: Sequence[int] | None,
        extent: Iterable[float] | None,
    ) -> None:
        self._send = send
        if grid is None and extent is not None:
            raise InputError("extent: it belongs to a grid; give its size as grid=(rows, columns)")
        self._grid = None if grid is None else to_grid(grid, contactors, extent)
        self._values = len(contactors) if self._grid is None else self._grid.taxels
        self._message = checked(
            TactileFrames(
                display=display,
                frame_rate_hz=to_number(rate, "rate [Hz]"),
                amplitude_um=to_number(amplitude, "amplitude [m]") * 1e6,
                frames=b"",
                latest=latest,
            )
        )

    def write(self, frame: Any) -> None:
        """Send one frame; this never waits, whatever the network does.

        Frames that are not sent in time are counted as ``dropped_frames`` of the connection, those
        that reach the server and are not played as ``dropped_frames`` of the display.

        Parameters
        ----------
        frame : (N,) or (rows, columns) sequence of float
            Value from −1 to 1 of each contactor, or of each taxel of the grid, row by row from the
            largest y. Any sequence, or array of numbers, will do.

        Raises
        ------
        InputError
            If it has another size, or a value is outside −1 … 1 or not a number.
        """
        values = flattened(frame)
        if len(values) != self._values:
            raise InputError(f"frame: {len(values)} values, but the display takes {self._values}")
        try:
            wrong = [k for k, value in enumerate(values) if not -1.0 <= value <= 1.0]
        except TypeError:
            raise InputError(f"frame: {excerpt(frame)} is not an image of numbers") from None
        if wrong:
            raise InputError(f"frame[{wrong[0]}]: {values[wrong[0]]} is outside −1 … 1")
        data = array("f", values if self._grid is None else self._grid.frame(values))
        if sys.byteorder == "big":
            data.byteswap()
        self._send(msgspec.structs.replace(self._message, frames=data.tobytes()))
