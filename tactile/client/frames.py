"""Tactile frames that a program streams: the shear of every contactor at one instant."""

import sys
from array import array
from typing import Any

import msgspec

from tactile.client.onsets import At
from tactile.client.session import ClientSession
from tactile.client.taxels import TaxelGrid, flattened
from tactile.client.wire import excerpt, to_microseconds, to_number
from tactile.errors import InputError
from tactile.messages import MOST_FRAME_VALUES, TactileFrames


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

    def write_block(self, frames: Any, *, time: float | None = None) -> None:
        """Send several frames at once; this never waits, whatever the network does.

        Blocks with a time are played at a constant delay, such as those of a sound card: each frame
        at its time, however unevenly the blocks come. A block has to come earlier than its time by
        the latency of the display (`Stats.latency`) and 3 ms, and what the way to the server takes:
        frames that come too late are counted as ``dropped_frames`` of the display, and the frame
        before them is held. Where the time of a block is not that at which the block before ends,
        to within 1 ms, the signal fades out and in.

        Parameters
        ----------
        frames : (F, N) buffer of float32
            Values from −1 to 1 of each contactor, frame by frame, such as an array of numpy; those
            outside are refused by the server.
        time : float, optional
            Time on the clock of `time.monotonic` at which the first frame is to be put out, at most
            a second ahead [s]. By default frames are played as they come.

        Raises
        ------
        InputError
            If the buffer is not one of whole frames, the time is not a finite number, or the writer
            is one of the newest frame or of a grid.
        """
        if self._grid is not None:
            raise InputError("frames: a block has a value for each contactor, not images of a grid")
        if time is not None and self._message.latest:
            raise InputError("time [s]: is for frames that are all played; make a writer of those")
        data = _float32(frames)
        if len(data) % self._values:
            raise InputError(f"frames: {len(data)} values are no frames of {self._values} each")
        offset = self._session.offset.seconds
        begins = None if time is None else to_number(time, "time [s]") + offset
        most = MOST_FRAME_VALUES // self._values
        for first in range(0, len(data) // self._values, most):
            part = data[first * self._values : (first + most) * self._values].tobytes()
            when = None if begins is None else begins + first / self._message.frame_rate_hz
            time_us = None if when is None else to_microseconds(when)
            self._session.send_streamed(
                msgspec.structs.replace(self._message, frames=part, time_us=time_us)
            )


def _float32(frames: Any) -> "array[float]":
    """Return the values of a buffer of float32 in the byte order of messages.

    Raises
    ------
    InputError
        If it is not one.
    """
    try:
        view = memoryview(frames)
    except TypeError:
        raise InputError(f"frames: {excerpt(frames)} is not a buffer of float32") from None
    if view.format != "f" or not view.c_contiguous:
        raise InputError(
            f"frames: is a buffer of format {view.format!r}, not of contiguous float32; "
            "see numpy.ascontiguousarray"
        )
    data = array("f", view.tobytes())
    if sys.byteorder == "big":
        data.byteswap()
    return data
