"""Streams of tactile frames: the shear of all contactors at one instant, frame after frame.

The frames come from a source that lives as long as it is felt, such as the taxels of a robot's
hand, at a rate that differs a little from what it says, and not evenly. Three kinds of stream play
them:

- `QueuedFrames` plays every frame, at its place in a band-limited signal.
- `TimedFrames` does the same, and plays each frame at the time that its source has set.
- `LatestFrames` moves to the newest frame, as soon as it comes.

When a source is late, the last frame is held. If no frame comes for `HOLD`, the stream fades out
within `FADE`, so that a source that stopped is not felt any more.
"""

import math
from abc import ABC, abstractmethod
from collections import deque

import numpy as np

from tactile.arrays import Singles
from tactile.playback.sinc_interpolation import SincInterpolation
from tactile.playback.waveforms import GRID_WORK, LONGEST, PRODUCTS, WEIGHTS_WORK
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
TOLERANCE, LEAP = 1e-3, 3e-3
"""Largest differences of the time of frames from that of a stream which they continue, and of the
time at which a stream is from that at which it should be [s]. Assumed: clocks that differ by 1e-3
and are compared every second remain within them."""
TIMED_SETTLING = 0.3
"""Time in which the pace of reading removes a difference from the times of frames [s]. Assumed: the
times of a sound card and of an amplifier are known to some 10 µs from block to block, which changes
the pace by 3e-5 then."""
LIVE = 0.25
"""Duration of frames that wait from which on they were sent in advance, and keep their pace; a
source that stood still sends fewer at once [s]. Assumed."""
MOST_VALUES = 1 << 22
"""Maximum number of values of the frames that wait: 16 MB, a second of frames of 64 contactors at
65 kHz."""
PART = 256
"""Number of frames of a part of those that wait. Assumed: more than a block depends on as a rule,
and few enough that another part is allocated quickly."""
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
            Number of frames that are played.
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
        """Take frames (F, N) [m], and return how many are played."""

    @abstractmethod
    def _read(self, count: int, time: float) -> Singles:
        """Return the samples (S, N) from a time on without any fade, and update `_dry` [m]."""

    def take(self, count: int, time: float = math.nan) -> Singles:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        time : float
            Time at which the first of them is put out, which only `TimedFrames` need [s].

        Returns
        -------
        (S, N) array of float32
            Shear [m].
        """
        shear = self._read(count, time)
        stopped = self._dry > HOLD * self._drive_rate
        if stopped != self._fades:
            self._fades = stopped
            self._sounds.to(0.0 if stopped else 1.0)
        return self._sounds(shear)


class Pace:
    """Change of the pace of reading, by which a stream follows the clock of its source.

    Attributes
    ----------
    stretch : float
        Change of the pace; 0 for the rate that the source says.
    """

    def __init__(self) -> None:
        self.stretch = self._drift = 0.0

    def follow(self, excess: float, passed: float, settling: float, *, learns: bool) -> None:
        """Change the pace so that a stream comes to where it should be.

        Parameters
        ----------
        excess : float
            Time by which the stream is behind [s].
        passed : float
            Time since the last call [s].
        settling : float
            Time in which the difference is to be removed [s].
        learns : bool
            Whether the difference tells of the clock of the source.
        """
        if learns:  # a loop of second order, critically damped
            drift = self._drift + excess * passed / (4 * settling**2)
            self._drift = min(max(drift, -LARGEST_DRIFT), LARGEST_DRIFT)
        stretch = self._drift + excess / settling
        self.stretch = min(max(stretch, -LARGEST_STRETCH), LARGEST_STRETCH)


class FrameBuffer:
    """Frames that wait to be read, in parts of one length, so that none is moved.

    Parameters
    ----------
    contactors : int
        Number of contactors, N.

    Attributes
    ----------
    end : int
        Number of the frame after the last one.
    """

    def __init__(self, contactors: int) -> None:
        self._contactors, self.end = contactors, 0
        self._parts: deque[Singles] = deque()
        self._first = 0
        """Number of parts that were forgotten."""

    def add(self, frames: Singles) -> None:
        """Add frames at the end.

        Parameters
        ----------
        frames : (F, N) array of float32
            Shear of each contactor [m].
        """
        while len(frames):
            row = self.end % PART
            if row == 0:
                self._parts.append(np.empty((PART, self._contactors), np.float32))
            some, frames = frames[: PART - row], frames[PART - row :]
            self._parts[-1][row : row + len(some)] = some
            self.end += len(some)

    def read(self, first: int, count: int) -> Singles:
        """Return frames, and forget those before them.

        Parameters
        ----------
        first : int
            Number of the first one.
        count : int
            Number of frames, F.

        Returns
        -------
        (F, N) array of float32
            Shear [m]; 0 before the first frame that came and after the last one.
        """
        while self._parts and (self._first + 1) * PART <= first:
            self._parts.popleft()
            self._first += 1
        window = np.zeros((count, self._contactors), np.float32)
        for number, part in enumerate(self._parts, self._first):
            begin = number * PART
            low, high = max(begin, first), min(begin + PART, first + count, self.end)
            if low >= high:
                break
            window[low - first : high - first] = part[low - begin : high - begin]
        return window


class InterpolatedFrames(FrameStream):
    """Frames that are all played, in a band-limited signal.

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    _overhead = GRID_WORK + WEIGHTS_WORK

    def __init__(self, frame_rate: float, drive_rate: float, contactors: int) -> None:
        super().__init__(frame_rate, drive_rate, contactors)
        self._interpolation = SincInterpolation(frame_rate, drive_rate, zeros=ZEROS, shape=SHAPE)
        self._frames = FrameBuffer(contactors)
        self._last = np.zeros((1, contactors), np.float32)
        self._most = min(LONGEST * frame_rate, MOST_VALUES / contactors)
        self._reach = self._interpolation.reach
        self._at = 0.0
        """Place of the next sample among the frames [frames]."""
        self._pace = Pace()

    def _add(self, frames: Singles) -> int:
        room = self._at + self._most - self._frames.end
        frames = frames[: max(int(room), 0)]
        if len(frames):
            self._frames.add(frames)
            self._last = frames[-1:].copy()
        return len(frames)

    @property
    def _step(self) -> float:
        """Number of frames from one sample of the drive to the next."""
        return self._rate * (1 + self._pace.stretch) / self._drive_rate

    def _resample(self, count: int) -> Singles:
        """Return the next samples (S, N), and repeat the last frame for those that are missing."""
        step = self._step
        last = math.floor(self._at + step * (count - 1))
        missing = last + self._reach + 1 - self._frames.end
        self._dry = self._dry + count if missing > 0 else 0
        if missing > 0:
            self._frames.add(self._last.repeat(missing, axis=0))
        first, weights = self._interpolation.weights(
            np.asarray(self._at + step * np.arange(count), np.float64)
        )
        self._at += step * count
        return np.asarray(weights @ self._frames.read(first, weights.shape[1]))


class QueuedFrames(InterpolatedFrames):
    """Frames that are played in the order in which they come, as early as that is even.

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

    def __init__(
        self, frame_rate: float, drive_rate: float, contactors: int, *, exactly: bool = False
    ) -> None:
        super().__init__(frame_rate, drive_rate, contactors)
        self._begun = exactly
        self._at = 0.0 if exactly else -self._reach - MARGIN * frame_rate
        self._least, self._watched = math.inf, 0

    def _read(self, count: int, time: float) -> Singles:
        step = self._step
        if not self._begun:  # a block needs all its frames when it begins
            self._begun, self._at = True, self._at - step * count
        needed = self._at + step * count + self._reach + 1
        early = max(self._frames.end - needed, 0.0) / self._rate
        shear = self._resample(count)
        self._follow_clock(early, count)
        return shear

    def _follow_clock(self, early: float, count: int) -> None:
        """Adapt the pace to how early the frames were that a block of samples needed [s]."""
        self._least = min(self._least, early)
        self._watched += count
        if self._watched < WATCHED * self._drive_rate:
            return
        excess = 0.0 if self._least > LIVE else self._least - MARGIN
        small = abs(excess) < SMALL
        self._pace.follow(excess, WATCHED, SETTLING if small else RECOVERY, learns=small)
        self._least, self._watched = math.inf, 0


class TimedFrames(InterpolatedFrames):
    """Frames that are played at times that their source has set.

    The delay from the source to the skin is constant thereby, however unevenly the frames come. The
    pace of reading follows the times, in which the clock of the source shows. A frame that comes
    after its time is dropped, as the one before it was held in its place. The signal rises within
    `FADE` from the first frame on.

    Parameters
    ----------
    frame_rate : float
        Rate of the frames [Hz].
    drive_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    time : float
        Time at which the first frame is to be put out [s].
    """

    def __init__(self, frame_rate: float, drive_rate: float, contactors: int, time: float) -> None:
        super().__init__(frame_rate, drive_rate, contactors)
        self._sounds = Ramp(1 / (FADE * drive_rate), 0.0)
        self._begun = self._rises = False
        self._end = 0
        """Number of frames that came, which is that of the next one."""
        self._mark = 0, time
        """Number of the first of the newest frames, and its time."""

    @property
    def over(self) -> bool:
        """Whether the stream has faded out."""
        return self._rises and super().over

    @property
    def waiting(self) -> int:
        """Number of frames that have not been played."""
        return max(self._end - max(math.ceil(self._at), 0), 0)

    def continues_at(self, time: float) -> bool:
        """Tell whether frames with a time continue the stream.

        Parameters
        ----------
        time : float
            Time at which the first of them is to be put out [s].

        Returns
        -------
        bool
            Whether that is where those before them end.
        """
        number, before = self._mark
        return abs(time - before - (self._end - number) / self._rate) <= TOLERANCE

    def set_time(self, time: float) -> None:
        """Set the time of the next frame that comes.

        Parameters
        ----------
        time : float
            Time at which it is to be put out [s].
        """
        self._mark = self._end, time

    def leaps(self, time: float) -> bool:
        """Tell whether a clock has leapt, so that the stream is not where it should be.

        Parameters
        ----------
        time : float
            Time at which the next sample is put out [s].

        Returns
        -------
        bool
            Whether the stream has to begin anew.
        """
        return self._begun and abs(self._place(time) - self._at) > LEAP * self._rate

    def _place(self, time: float) -> float:
        """Return the place among the frames that a time has [frames]."""
        number, marked = self._mark
        return number + (time - marked) * self._rate

    def _add(self, frames: Singles) -> int:
        late = min(max(self._frames.end - self._end, 0), len(frames))
        taken = super()._add(frames[late:])
        self._end += late + taken  # frames without room are a hole, after which a stream begins
        return taken

    def _read(self, count: int, time: float) -> Singles:
        if not self._begun:  # frames whose time passed before are not made up for
            self._begun, self._at = True, min(self._place(time), float(self._end))
        behind = (self._place(time) - self._at) / self._rate
        self._pace.follow(behind, count / self._drive_rate, TIMED_SETTLING, learns=True)
        if not self._rises and self._at + self._step * count > 0:
            self._rises = True
            self._sounds.to(1.0)
        return self._resample(count)


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

    def _read(self, count: int, time: float) -> Singles:
        passed = self._dry + np.arange(1, count + 1)
        way = np.minimum(passed * (self._rate / self._drive_rate), 1.0).astype(np.float32)
        shear: Singles = self._from + (self._to - self._from) * way[:, None]
        self._dry += count
        self._value = shear[-1]
        return shear
