"""Waveforms that clients stream as shear, contactor by contactor, at any rate of samples.

A `WaveformQueue` holds the samples of one client. Each contactor plays its own samples in the order
of their arrival, at the same time as the others. Samples that do not fit are refused, and the
client learns how many were taken (``samplesConsumed`` of XR_FB_haptic_pcm). What is played passes
the limiter like everything else.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Singles
from tactile.playback.ending import Ending
from tactile.playback.sinc_interpolation import SincInterpolation

LONGEST = 1.0
"""Largest duration of samples that wait for one contactor of a client [s]."""
ZEROS, SHAPE = 8, 7.0
"""Length of the interpolation window on either side, in zeros of the sinc, and its shape: 70 dB
(Kaiser's β 7)."""
NEAR = 0.25
"""Largest time between the first sample that is to begin exactly and a sample of the drive, in
samples of the drive. For a drive at 8 kHz, samples at 1 kHz need no more than 8 grids, whenever
they begin, those at 11.025 kHz 2, and those at 16 kHz or more one."""
MOST_SEGMENTS = 128
"""Largest number of segments that wait in a queue, besides one for each contactor: within its
`LONGEST`, a change of rate or contactors every 8 ms."""
GRID_WORK, WEIGHTS_WORK, SEGMENT_WORK = 350, 650, 100
"""Work of a grid of samples in a block, of the weights of its interpolation unless they are
remembered, and of each segment on which the block depends, the same for any small number of
samples; in units of `tactile.playback.waves`."""
PRODUCTS = 200
"""Number of products of a kernel and a sample that take as much work as one evaluation of the
kernel."""

Contactors = NDArray[np.intp]
"""Indices of contactors, in ascending order."""


@functools.lru_cache(1024)
def _indices(contactors: tuple[int, ...]) -> Contactors:
    """Return indices of contactors in ascending order, each once."""
    return np.unique(np.array(contactors, np.intp))


class WaveformSegment:
    """Samples for some contactors without a gap.

    Parameters
    ----------
    contactors : (K,) array of int
        Contactors that play the samples.
    first : int
        Row of the grid in which the first sample is.
    columns : int
        Number of values in a sample: 1 for all contactors together, K for one each.

    Attributes
    ----------
    begin, end : int
        Rows of the grid of the first sample, and after the last one.
    places : slice or (K,) array of int
        Contactors that play the samples, as indices of columns of the grid.
    """

    def __init__(self, contactors: Contactors, first: int, columns: int = 1) -> None:
        self.contactors = contactors
        self.begin = self.end = first
        self._data = np.zeros((0, columns), np.float32)
        self._first = first

    @property
    def contactors(self) -> Contactors:
        """Contactors that play the samples, (K,)."""
        return self._contactors

    @contactors.setter
    def contactors(self, contactors: Contactors) -> None:
        self._contactors = contactors
        first, last = (int(contactors[0]), int(contactors[-1])) if len(contactors) else (0, -1)
        # a slice takes a third of the time of indices
        together = last - first + 1 == len(contactors)
        self.places: slice | Contactors = slice(first, last + 1) if together else contactors

    def add(self, samples: Singles, oldest: int) -> None:
        """Add samples at the end.

        Parameters
        ----------
        samples : (S, C) array of float32
            Samples [m].
        oldest : int
            First row of the grid that is still needed.
        """
        count, end = self.end - self._first, self.end - self._first + len(samples)
        if end > len(self._data):
            done = min(max(oldest - self._first, 0), count)
            left = self._data[done:count]
            room = 2 * (len(left) + len(samples)), self._data.shape[1]
            self._data = np.zeros(room, np.float32)
            self._data[: len(left)] = left
            self._first += done
            count, end = count - done, end - done
        self._data[count:end] = samples
        self.end += len(samples)

    def add_to(self, window: Singles, first: int) -> None:
        """Add the samples to rows of the grid.

        Parameters
        ----------
        window : (R, N) array of float32
            Rows of the grid [m].
        first : int
            Number of the first of these rows.
        """
        low, high = max(first, self._first), min(first + len(window), self.end)
        if low < high:
            part = self._data[low - self._first : high - self._first]
            window[low - first : high - first, self.places] += part

    def leave(self, contactors: Contactors) -> None:
        """Take the samples of some contactors away.

        Parameters
        ----------
        contactors : (K,) array of int
            Contactors that do not play the samples any more.
        """
        self.contactors = np.setdiff1d(self.contactors, contactors)


class WaveformGrid:
    """Samples of one rate, one row of all contactors after the other, read at the drive's rate.

    The interpolation is band-limited, as described in `SincInterpolation`. Samples that have not
    come yet are 0, so that nothing waits for them.

    Parameters
    ----------
    sample_rate : float
        Sample rate of what is added [Hz].
    drive_rate : float
        Sample rate of what is read [Hz].
    contactors : int
        Number of contactors, N.

    Attributes
    ----------
    rate : float
        Sample rate of what is added [Hz].
    segments : list of WaveformSegment
        Segments that are still to be read, at least in part.
    """

    def __init__(self, sample_rate: float, drive_rate: float, contactors: int) -> None:
        self.rate = sample_rate
        self.segments: list[WaveformSegment] = []
        self._ends = np.zeros(contactors, np.intp)
        self._last_end = 0
        self._ratio = sample_rate / drive_rate
        self._interpolation = SincInterpolation(sample_rate, drive_rate, zeros=ZEROS, shape=SHAPE)
        self._reach = self._interpolation.reach
        self._at = 0.0

    @property
    def begins_here(self) -> bool:
        """Whether a sample falls on the next sample of the drive, to within `NEAR`."""
        return abs(self._at - round(self._at)) <= NEAR * self._ratio + 1e-6

    @property
    def is_over(self) -> bool:
        """Whether all samples were read."""
        return self._last_end <= self._at

    def waiting(self, contactors: Contactors) -> float:
        """Return the time until all samples of some contactors were read [s]."""
        return max(float(self._ends[contactors].max()) - self._at, 0.0) / self.rate

    def add(
        self,
        samples: Singles,
        contactors: Contactors,
        after: float,
        segments: int,
        *,
        exactly: bool,
    ) -> bool:
        """Add samples for some contactors, once each of them has played all that waits for it.

        Parameters
        ----------
        samples : (S, 1) array of float32
            Samples [m].
        contactors : (K,) array of int
            Contactors that play them.
        after : float
            Time that they have to wait for samples of other rates [s].
        segments : int
            Number of segments that may be added.
        exactly : bool
            Whether they begin with the next sample of the drive, to within `NEAR`, which
            `begins_here` says is possible. If not, they begin with that sample or after it.

        Returns
        -------
        bool
            Whether they were added, as they are unless they need a segment more.
        """
        begin = self._at + after * self.rate
        row = round(begin) if exactly and not after else math.ceil(begin - 1e-6)
        first = max(int(self._ends[contactors].max()), row)
        for segment in self.segments:
            if segment.end == first and np.array_equal(segment.contactors, contactors):
                break
        else:
            if segments < 1:
                return False
            segment = WaveformSegment(contactors, first)
            self.segments.append(segment)
        segment.add(samples, int(self._at) - self._reach)
        self._ends[contactors] = segment.end
        self._last_end = max(self._last_end, segment.end)
        return True

    def leave(self, contactors: Contactors) -> None:
        """Drop the samples of some contactors."""
        for segment in self.segments:
            segment.leave(contactors)
        self.segments = [segment for segment in self.segments if len(segment.contactors)]
        self._ends[contactors] = 0
        self._last_end = int(self._ends.max())

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
        products = count * (near + int(count * self._ratio)) * len(self._ends)
        work = GRID_WORK + products // PRODUCTS
        if not self._interpolation.remembers(self._at, self._ratio, count):
            work += WEIGHTS_WORK + count * near
        return work + SEGMENT_WORK * len(self._near(count)) + len(self.segments)

    def _near(self, count: int) -> list[WaveformSegment]:
        """Return the segments on which the next samples depend."""
        last = self._at + self._ratio * count + self._reach
        return [segment for segment in self.segments if segment.begin <= last]

    def read(self, count: int) -> Singles:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) array of float32
            Samples [m].
        """
        first, weights = self._interpolation.equidistant_weights(self._at, self._ratio, count)
        window = np.zeros((weights.shape[1], len(self._ends)), np.float32)
        sounds = np.zeros((count, len(self._ends)), np.float32)
        for segment in self._near(count):
            segment.add_to(window, first)
            sounds[self._sample(segment.begin) : self._sample(segment.end), segment.places] = 1
        samples: Singles = weights @ window
        samples *= sounds  # a sinc would be heard before its first sample and after its last one
        self.skip(count)
        return samples

    def _sample(self, row: int) -> int:
        """Return the first sample of the drive, from now, that belongs to a row of the grid."""
        return max(math.ceil((row - self._at) / self._ratio - NEAR - 1e-6), 0)

    def skip(self, count: int) -> None:
        """Advance without reading.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        self._at += self._ratio * count
        oldest = self._at - self._reach
        self.segments = [segment for segment in self.segments if segment.end > oldest]


class WaveformQueue:
    """Samples of one client that wait to be played.

    Parameters
    ----------
    sample_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors, N.
    """

    def __init__(self, sample_rate: float, contactors: int) -> None:
        self._rate, self._all = sample_rate, np.arange(contactors)
        self._grids: list[WaveformGrid] = []
        self._ending = Ending(sample_rate, contactors)

    def waiting(self, contactors: tuple[int, ...] = ()) -> float:
        """Return the time until all samples of some contactors were played.

        Parameters
        ----------
        contactors : tuple of int
            Contactors; empty for all.

        Returns
        -------
        float
            Time [s].
        """
        chosen = self._chosen(contactors)
        return max((grid.waiting(chosen) for grid in self._grids), default=0.0)

    def _chosen(self, contactors: tuple[int, ...]) -> Contactors:
        return _indices(contactors) if contactors else self._all

    def append(
        self,
        samples: Singles,
        sample_rate: float,
        contactors: tuple[int, ...],
        longest: float = LONGEST,
        *,
        exactly: bool = False,
    ) -> int:
        """Add samples after those that wait for the same contactors, as far as there is room.

        Parameters
        ----------
        samples : (S,) array of float32
            Samples [m].
        sample_rate : float
            Sample rate [Hz].
        contactors : tuple of int
            Contactors that play them; empty for all.
        longest : float
            Largest duration of samples that may wait [s].
        exactly : bool
            Whether the first sample is played at the next sample of the drive, to within `NEAR`, if
            nothing waits for the contactors. If not, it may be a period of the samples later.

        Returns
        -------
        int
            Number of samples that were taken: none beyond ``longest``, and none that would need a
            segment more than `MOST_SEGMENTS`.
        """
        chosen = self._chosen(contactors)
        room = int(max(longest - self.waiting(contactors), 0.0) * sample_rate)
        rows = samples[:room, None]
        if not len(rows):
            return 0
        grid = self._grid_for(chosen, sample_rate, exactly=exactly)
        others = [other for other in self._grids if other is not grid]
        after = max((other.waiting(chosen) for other in others), default=0.0)
        used = sum(len(each.segments) for each in self._grids)
        segments = MOST_SEGMENTS + len(self._all) - used
        if not grid.add(rows, chosen, after, segments, exactly=exactly):
            return 0
        if grid not in self._grids:
            self._grids.append(grid)
        return len(rows)

    def _grid_for(self, chosen: Contactors, sample_rate: float, *, exactly: bool) -> WaveformGrid:
        """Return the grid that samples continue, or in which they may begin."""
        grids = [grid for grid in self._grids if grid.rate == sample_rate]
        grid = max(grids, key=lambda grid: grid.waiting(chosen), default=None)
        if grid is not None and grid.waiting(chosen) > 0:
            return grid
        grids = [grid for grid in grids if grid.begins_here or not exactly]
        return grids[0] if grids else WaveformGrid(sample_rate, self._rate, len(self._all))

    def clear(self, contactors: tuple[int, ...] = ()) -> None:
        """Drop what waits for some contactors, and let the last sample of theirs fade out.

        Parameters
        ----------
        contactors : tuple of int
            Contactors; empty for all.
        """
        chosen = self._chosen(contactors)
        for grid in self._grids:
            grid.leave(chosen)
        self._ending.begin(chosen)

    def work(self, count: int) -> int:
        """Return the work of the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        int
            Work; 0 if nothing waits.
        """
        work = SEGMENT_WORK if self._ending.sounds else 0
        for grid in self._grids:
            work += grid.work(count)
        return work

    def take(self, count: int) -> Singles | None:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, N) array of float32 or None
            Shear [m]; None if nothing waits.
        """
        if not self._grids and not self._ending.sounds:
            self._ending.skip(count)
            return None
        out = np.zeros((count, len(self._all)), np.float32)
        for grid in self._grids:
            out += grid.read(count)
        self._ending.add_to(out)
        self._drop_played()
        return out

    def skip(self, count: int) -> None:
        """Advance without playing.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        for grid in self._grids:
            grid.skip(count)
        self._ending.skip(count)
        self._drop_played()

    def _drop_played(self) -> None:
        """Drop grids of which nothing waits."""
        self._grids = [grid for grid in self._grids if not grid.is_over]
