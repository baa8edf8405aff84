"""Streams of tactile frames: the shear of all contactors at one instant, frame after frame.

The frames come from a source that lives as long as it is felt, such as the taxels of a robot's
hand, at a rate that differs a little from what it says, and not evenly. Two kinds of stream play
them:

- `QueuedFrames` plays every frame, at its place in a band-limited signal.
- `LatestFrames` moves to the newest frame, as soon as it comes.

When a source is late, the last frame is held. If no frame comes for `HOLD`, the stream fades out
within `FADE`, so that a source that stopped is not felt any more. A `FramePlayer` plays what one
client streams.
"""

import math
from abc import ABC, abstractmethod

import numpy as np

from tactile.arrays import Singles
from tactile.playback.ending import Ending
from tactile.playback.sinc_interpolation import SincInterpolation
from tactile.playback.waveforms import GRID_WORK, LONGEST, PRODUCTS, WEIGHTS_WORK, WaveformSegment
from tactile.rendering.renderer import Ramp

HOLD, FADE = 30e-3, 25e-3
"""Time for which the last frame is held, and in which it fades then [s]. A source that is killed is
silent after both, the frames that wait and the lead of the link: within a tenth of a second."""
ZEROS, SHAPE = 4, 4.55
"""Length of the interpolation window on either side, in zeros of the sinc, and its shape: 50 dB up
to 0.32 of the frame rate (Kaiser 1974: β = 0.1102 (50 − 8.7), with a transition of 0.37 of the
rate). It makes a stream wait for four frames; one of eight would reach 0.41 of the rate."""
MARGIN = 1e-3
"""Time that the least early of the frames should come before it is needed [s]. Assumed: the period
of a source of 1 kHz."""
WATCHED = 0.25
"""Time over which the least early frame is looked for [s]."""
SMALL = 2e-3
"""Difference from `MARGIN` up to which it tells of the clock of the source, not of its jitter
[s]."""
SETTLING, RECOVERY = 5.0, 1.0
"""Times in which the pace of reading removes a small and a larger difference [s]. Frames are
noticed when a block begins, so that their earliness varies by a period without any reason."""
LARGEST_DRIFT = 1e-3
"""Largest difference of the clock of the source that is learned; quartz differs by 1e-4."""
LARGEST_STRETCH = 0.02
"""Largest change of the pace of reading; people distinguish vibrations whose frequencies differ by
a fifth (Goff 1967)."""
LIVE = 0.25
"""Duration of frames that wait from which on they were sent in advance, and keep their pace; a
source that stood still sends fewer at once [s]. Assumed."""
MOST_VALUES = 1 << 18
"""Maximum number of values of the frames that wait: 1 MB, which is moved in a small part of a
block."""
BASE_WORK = 200
"""Work of `LatestFrames` in a block; in units of `tactile.playback.waves`."""


class FrameStream(ABC):
    """Frames of one rate, read block by block.

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    _overhead: int
    """Work of a block, the same for any small number of samples."""
    _reach = 0
    """Number of frames on either side that a sample depends on, besides the nearest."""
    _patience = 0.0
    """Number of samples without a frame in time from which on the source is late."""

    def __init__(self, frame_rate: float, drive_rate: float, contactors: int) -> None:
        self._rate, self._drive_rate = frame_rate, drive_rate
        self._contactors = contactors
        self._dry = 0
        """Number of samples for which no frame came in time."""
        self._sounds = Ramp(1 / (FADE * drive_rate), 1.0)
        self._fades = False

    @property
    def over(self) -> bool:
        """Whether the stream has faded out."""
        return self._sounds.silent

    @property
    def is_late(self) -> bool:
        """Whether the last frame is held because the next one has not come in time."""
        return self._dry > self._patience

    def add(self, frames: Singles) -> int:
        """Take frames.

        Parameters
        ----------
        frames : (F, N) array of float32
            Shear of each contactor [m].

        Returns
        -------
        int
            Number of frames, from the first, for which there was room.
        """
        taken = self._add(frames)
        if taken:
            self._dry = 0
        return taken

    def work(self, count: int) -> int:
        """Return the work of reading samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        int
            Work.
        """
        near = 2 * self._reach
        rows = near + math.ceil(count * self._rate / self._drive_rate)
        return self._overhead + count * (near + rows * self._contactors // PRODUCTS)

    @abstractmethod
    def _add(self, frames: Singles) -> int:
        """Take frames (F, N) [m], and return for how many there was room."""

    @abstractmethod
    def _read(self, count: int) -> Singles:
        """Return the next samples (S, N) without any fade, and update `_dry` [m]."""

    def take(self, count: int) -> Singles:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) array of float32
            Shear [m].
        """
        shear = self._read(count)
        stopped = self._dry > HOLD * self._drive_rate
        if stopped != self._fades:
            self._fades = stopped
            self._sounds.to(0.0 if stopped else 1.0)
        return self._sounds(shear)


class QueuedFrames(FrameStream):
    """Frames that are all played, in a band-limited signal.

    A frame is played once the frames after it on which the signal depends are there; it takes a
    block and `MARGIN` more, so that a frame may come a little late. Where a frame is missing, the
    last one is repeated, and the stream is later from then on. The pace of reading is varied a
    little, so that the least early frame of some time is `MARGIN` early: thereby the stream follows
    the clock of its source, and is no later than its jitter requires.

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    exactly : bool
        Whether the first frame is at the first sample that is read, and waits for no other.
    """

    _overhead = GRID_WORK + WEIGHTS_WORK

    def __init__(
        self, frame_rate: float, drive_rate: float, contactors: int, *, exactly: bool = False
    ) -> None:
        super().__init__(frame_rate, drive_rate, contactors)
        self._interpolation = SincInterpolation(frame_rate, drive_rate, zeros=ZEROS, shape=SHAPE)
        self._frames = WaveformSegment(np.arange(contactors), 0, contactors)
        self._last = np.zeros((1, contactors), np.float32)
        self._most = min(LONGEST * frame_rate, MOST_VALUES / contactors)
        self._reach = self._interpolation.reach
        self._begun = exactly
        self._at = 0.0 if exactly else -self._reach - MARGIN * frame_rate
        self._stretch = self._drift = 0.0
        self._least, self._watched = math.inf, 0

    def _add(self, frames: Singles) -> int:
        room = self._at + self._most - self._frames.end
        frames = frames[: max(int(room), 0)]
        if len(frames):
            self._frames.add(frames, math.floor(self._at) - self._reach)
            self._last = frames[-1:].copy()
        return len(frames)

    @property
    def _step(self) -> float:
        """Number of frames from one sample of the drive to the next."""
        return self._rate * (1 + self._stretch) / self._drive_rate

    def _missing(self, count: int) -> int:
        """Return the number of frames that the next samples need and that have not come."""
        last = math.floor(self._at + self._step * (count - 1))
        return last + self._reach + 1 - self._frames.end

    def _read(self, count: int) -> Singles:
        step = self._step
        if not self._begun:  # a block needs all its frames when it begins
            self._begun, self._at = True, self._at - step * count
        missing = self._missing(count)
        needed = self._at + step * count + self._reach + 1
        self._follow_clock(max(self._frames.end - needed, 0.0) / self._rate, count)
        self._dry = self._dry + count if missing > 0 else 0
        if missing > 0:
            self._frames.add(self._last.repeat(missing, axis=0), math.floor(self._at) - self._reach)
        first, weights = self._interpolation.weights(
            np.asarray(self._at + step * np.arange(count), np.float64)
        )
        window = np.zeros((weights.shape[1], self._contactors), np.float32)
        self._frames.add_to(window, first)
        self._at += step * count
        return np.asarray(weights @ window)

    def _follow_clock(self, early: float, count: int) -> None:
        """Adapt the pace to how early the frames were that a block of samples needed [s]."""
        self._least = min(self._least, early)
        self._watched += count
        if self._watched < WATCHED * self._drive_rate:
            return
        excess = 0.0 if self._least > LIVE else self._least - MARGIN
        if abs(excess) < SMALL:  # a loop of second order, critically damped
            drift = self._drift + excess * WATCHED / (4 * SETTLING**2)
            self._drift = min(max(drift, -LARGEST_DRIFT), LARGEST_DRIFT)
        stretch = self._drift + excess / (SETTLING if abs(excess) < SMALL else RECOVERY)
        self._stretch = min(max(stretch, -LARGEST_STRETCH), LARGEST_STRETCH)
        self._least, self._watched = math.inf, 0


class LatestFrames(FrameStream):
    """Newest frame, to which the signal moves in a straight line within the period of the frames.

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    _overhead = BASE_WORK

    def __init__(self, frame_rate: float, drive_rate: float, contactors: int) -> None:
        super().__init__(frame_rate, drive_rate, contactors)
        self._patience = HOLD * drive_rate
        self._from = self._value = self._to = np.zeros(contactors, np.float32)

    def _add(self, frames: Singles) -> int:
        if len(frames):
            self._from, self._to = self._value, frames[-1].copy()
        return len(frames)

    def _read(self, count: int) -> Singles:
        passed = self._dry + np.arange(1, count + 1)
        way = np.minimum(passed * (self._rate / self._drive_rate), 1.0).astype(np.float32)
        shear: Singles = self._from + (self._to - self._from) * way[:, None]
        self._dry += count
        self._value = shear[-1]
        return shear


class FramePlayer:
    """Player of the frames of one client.

    Parameters
    ----------
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    def __init__(self, drive_rate: float, contactors: int) -> None:
        self._drive_rate, self._contactors = drive_rate, contactors
        self._stream: FrameStream | None = None
        self._key = 0.0, False
        self._ending = Ending(drive_rate, contactors)

    def add(
        self, frames: Singles, frame_rate: float, *, latest: bool, exactly: bool = False
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

        Returns
        -------
        dropped : int
            Number of frames that are not played, for want of room.
        late : bool
            Whether the frame before them had to be held.
        """
        if self._stream is not None and (exactly or self._key != (frame_rate, latest)):
            self.end()
        if self._stream is None:
            if latest:
                self._stream = LatestFrames(frame_rate, self._drive_rate, self._contactors)
            else:
                self._stream = QueuedFrames(
                    frame_rate, self._drive_rate, self._contactors, exactly=exactly
                )
            self._key = frame_rate, latest
        late = self._stream.is_late
        return len(frames) - self._stream.add(frames), late

    def end(self) -> None:
        """Let what plays fade within `ENDING`."""
        self._stream = None
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
        ending = BASE_WORK if self._ending.sounds else 0
        return ending + (0 if self._stream is None else self._stream.work(count))

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
        if self._stream is None and not self._ending.sounds:
            self._ending.skip(count)
            return None
        out = np.zeros((count, self._contactors), np.float32)
        if self._stream is not None:
            out += self._stream.take(count)
            if self._stream.over:
                self._stream = None
        self._ending.add_to(out)
        return out

    def skip(self, count: int) -> None:
        """Advance without playing.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        if self._stream is not None:
            self._stream.take(count)
            if self._stream.over:
                self._stream = None
        self._ending.skip(count)
