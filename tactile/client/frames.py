"""Tactile frames that a program streams: the shear of every contactor at one instant."""

import sys
from array import array
from typing import Any

import msgspec

from tactile.client.onsets import At
from tactile.client.session import ClientSession
from tactile.client.taxels import TaxelGrid, flattened
from tactile.client.wire import excerpt
from tactile.errors import InputError
from tactile.messages import TactileFrames


class FrameWriter:
    """Writer of tactile frames. Get it from `RemoteDisplay.frames` or `AsyncDisplay.frames`.

    Parameters
    ----------
    session : ClientSession
        Session that sends the frames.
    message : TactileFrames
        Message of each frame, but for its ``frames``.
    contactors : int
        Number of contactors of the display.
    grid : TaxelGrid, optional
        Grid of which each frame is an image; by default a frame has a value for each contactor.
    """

    def __init__(
        self,
        session: ClientSession,
        message: TactileFrames,
        contactors: int,
        grid: TaxelGrid | None,
    ) -> None:
        self._session, self._message, self._grid = session, message, grid
        self._values = contactors if grid is None else grid.taxels

    def write(self, frame: Any, *, at: float | At | None = None) -> None:
        """Send one frame; this never waits, whatever the network does.

        Frames that are not sent in time are counted as ``dropped_frames`` of the connection, those
        that reach the server and are not played as ``dropped_frames`` of the display.

        Parameters
        ----------
        frame : (N,) or (rows, columns) sequence of float
            Value from −1 to 1 of each contactor, or of each taxel of the grid, row by row from the
            largest y. Any sequence, or array of numbers, will do.
        at : float or At, optional
            Time on the clock of `time.monotonic` at which this frame is to be played, at most 60 s
            ahead, in a stream that replaces the one before [s]. An `At` also says what became of
            it.

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
        begin = self._session.onsets.begin(at)
        message = msgspec.structs.replace(self._message, frames=data.tobytes(), begin=begin)
        self._session.send_streamed(message)
