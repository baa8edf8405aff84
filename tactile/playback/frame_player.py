"""Player of the tactile frames that one client streams."""

import math

import numpy as np

from tactile.arrays import Singles
from tactile.playback.ending import Ending
from tactile.playback.frame_stream import (
    BASE_WORK,
    FrameStream,
    LatestFrames,
    QueuedFrames,
    TimedFrames,
)


class FramePlayer:
    """Player of the frames of one client.

    Parameters
    ----------
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.

    Attributes
    ----------
    dropped : int
        Number of frames that waited and are not played, because a clock or their times leapt;
        whoever counts them sets it to 0.
    next_time : float
        Time at which the next sample is put out [s]. It advances with the samples, and is to be set
        for each block.
    """

    def __init__(self, drive_rate: float, contactors: int) -> None:
        self._drive_rate, self._contactors = drive_rate, contactors
        self._stream: FrameStream | None = None
        self._key = 0.0, False, False
        self._ending = Ending(drive_rate, contactors)
        self._leaving: TimedFrames | None = None
        """Stream that plays until the one that takes its place begins."""
        self._begins = math.nan
        """Time at which that one begins [s]."""
        self._leapt = False
        self.dropped = 0
        self.next_time = math.nan

    def add(
        self,
        frames: Singles,
        frame_rate: float,
        *,
        latest: bool,
        exactly: bool = False,
        time: float | None = None,
    ) -> tuple[int, bool]:
        """Take frames. Those of another rate or kind end the stream that plays.

        Parameters
        ----------
        frames : (F, N) array of float32
            Shear of each contactor [m].
        frame_rate : float
            Rate of the frames [Hz].
        latest : bool
            Whether only the newest frame counts.
        exactly : bool
            Whether the first of them is played at the next sample of the drive, in a stream of its
            own.
        time : float, optional
            Time at which the first of them is to be put out, in a stream that keeps to the times of
            its frames [s].

        Returns
        -------
        dropped : int
            Number of frames that are not played, because there is no room or their time has passed.
        late : bool
            Whether the frame before them had to be held, or the stream interrupted.
        """
        if self._stream is not None and (
            exactly or self._key != (frame_rate, latest, time is not None)
        ):
            self.end()
        if time is not None:
            return self._add_timed(frames, frame_rate, time)
        if self._stream is None:
            if latest:
                self._stream = LatestFrames(frame_rate, self._drive_rate, self._contactors)
            else:
                self._stream = QueuedFrames(
                    frame_rate, self._drive_rate, self._contactors, exactly=exactly
                )
            self._key = frame_rate, latest, False
        late = self._stream.is_late
        return len(frames) - self._stream.add(frames), late

    def _add_timed(self, frames: Singles, frame_rate: float, time: float) -> tuple[int, bool]:
        """Take frames that have a time, as `add` does."""
        count, stream, leapt = len(frames), self._stream, self._leapt
        if isinstance(stream, TimedFrames) and not stream.continues_at(time):
            self._leave(stream, time)
            leapt, stream = True, None
        if not isinstance(stream, TimedFrames):
            passed = (self.next_time - time) * frame_rate
            if passed > 0:
                late = min(math.ceil(passed), count)
                frames, time, leapt = frames[late:], time + late / frame_rate, True
            stream = TimedFrames(frame_rate, self._drive_rate, self._contactors, time)
            self._stream, self._key = stream, (frame_rate, False, True)
        late, self._leapt = stream.is_late or leapt, False
        stream.set_time(time)
        return count - stream.add(frames), late

    def _leave(self, stream: TimedFrames, begins: float) -> None:
        """Let a stream play until the one that takes its place begins."""
        if self._leaving is None:
            self._leaving = stream
        else:  # one that has not begun has nothing to end
            self.dropped += stream.waiting
        self._begins = begins

    def end(self) -> None:
        """Let what plays fade within `ENDING`."""
        self._stream = self._leaving = None
        self._ending.begin()

    def work(self, count: int) -> int:
        """Return the work of the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        int
            Work; 0 if nothing plays.
        """
        streams = [one for one in (self._stream, self._leaving) if one is not None]
        ending = BASE_WORK if self._ending.sounds else 0
        return ending + sum(stream.work(count) for stream in streams)

    def take(self, count: int) -> Singles | None:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) array of float32 or None
            Shear [m]; None if nothing plays.
        """
        shear = self._advance(count)
        if shear is None:
            if not self._ending.sounds:
                self._ending.skip(count)
                return None
            shear = np.zeros((count, self._contactors), np.float32)
        self._ending.add_to(shear)
        return shear

    def _advance(self, count: int) -> Singles | None:
        """Return the next samples of the stream (S, N) [m]; None if there is none."""
        time, stream, leaving = self.next_time, self._stream, self._leaving
        self.next_time += count / self._drive_rate
        if isinstance(stream, TimedFrames) and stream.leaps(time):
            self.dropped += stream.waiting
            self.end()
            self._leapt = True
        if leaving is not None and not time < self._begins:
            self.dropped += leaving.waiting
            self._leaving = None
            self._ending.begin()
        shear: Singles | None = None
        for one in (self._stream, self._leaving):
            if one is not None:
                part = one.take(count, time)
                shear = part if shear is None else shear + part
        if self._stream is not None and self._stream.over:
            self._stream = None
        return shear

    def skip(self, count: int) -> None:
        """Advance without playing.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        self._advance(count)
        self._ending.skip(count)
