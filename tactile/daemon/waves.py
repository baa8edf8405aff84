"""What clients add to the surface: streamed waveforms and parametric effects, as shear in time.

A `Queue` plays samples as they come, resampled to the drive's rate, one client's after each other;
what does not fit is not taken, and the client told (XR_FB_haptic_pcm's ``samplesConsumed``). An
`Effect` is evaluated block by block from its points (XR_EXT_haptic_parametric). Both are within
what the limiter lets through like all else.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

LONGEST = 1.0
"""s of samples that wait for one client at most."""
ENDING = 5e-3
"""s in which what is replaced or ends early falls to nothing."""
ZEROS, SHAPE = 8, 7.0
"""Of the window between samples: 70 dB (Kaiser's β 7)."""
_APART = np.linspace(0, ZEROS, 512 * ZEROS + 1)
KERNEL = (
    _APART,
    np.sinc(_APART) * np.i0(SHAPE * np.sqrt(1 - (_APART / ZEROS) ** 2)) / np.i0(SHAPE),
)
"""The window times the sinc over distance in zeros; read in straight lines, to 4e-6."""
SHORT = 1024
"""Samples that are kept though they have been read."""
HOLD = 50e-3
"""s for which a streamed effect is held after its last point (XR_EXT_haptic_parametric)."""
PLAIN = 160.0
"""Hz of an effect without a frequency: that of most phones' actuators (assumed)."""
PERIODS = 2.0
"""Of a transient."""


class Segment:
    """Samples at one rate for some contactors, read at the drive's rate.

    Between samples it is band-limited: y(t) = Σ x[k] c sinc(c (t − k)) w(t − k), with c the lower
    of both rates over its own, and w Kaiser's window over `ZEROS` zeros of the sinc either way.
    Samples that have not come yet are 0, so that nothing waits for them. (soxr, a library that does
    it better, holds 12 to 140 ms back where it streams.)

    Parameters
    ----------
    sample_rate, drive_rate : of what is added and what is read [Hz]
    plays : (N,) 1 for each contactor that plays it, else 0
    """

    def __init__(self, sample_rate: float, drive_rate: float, plays: Singles) -> None:
        self.rate, self.plays = sample_rate, plays
        self._ratio = sample_rate / drive_rate
        self._cut = min(1.0, 1 / self._ratio)
        self._reach = math.ceil(ZEROS / self._cut)
        self._data = np.zeros(self._reach)
        self._at = float(self._reach)

    def add(self, samples: Singles) -> None:
        """Add samples."""
        self._data = np.concatenate([self._data, samples])

    @property
    def left(self) -> float:
        """What is still to be read [s]."""
        return max(len(self._data) - self._at, 0.0) / self.rate

    def read(self, count: int) -> Floats:
        """Return the next samples, as many as there are up to a count."""
        count = min(count, math.ceil((len(self._data) - self._at) / self._ratio))
        time = self._at + self._ratio * np.arange(count)
        low = int(self._at) + 1 - self._reach
        near = self._data[low : int(self._at + self._ratio * count) + self._reach + 1]
        index = time.astype(np.intp)[:, None] + np.arange(1 - self._reach, self._reach + 1)
        near = np.pad(near, (0, max(int(index[-1, -1]) - low + 1 - len(near), 0)) if count else 0)
        kernel = np.interp(np.abs(time[:, None] - index) * self._cut, *KERNEL)
        read = np.sum(near[index - low] * kernel, axis=1) * self._cut
        self._at += self._ratio * count
        done = int(self._at) - self._reach
        if done > len(self._data) // 2 > SHORT:
            self._data, self._at = self._data[done:], self._at - done
        return np.asarray(read)


class Queue:
    """Samples of one client that wait to be played.

    Parameters
    ----------
    sample_rate : of the drive [Hz]
    contactors : N
    """

    def __init__(self, sample_rate: float, contactors: int) -> None:
        self._rate, self._contactors = sample_rate, contactors
        self._segments: deque[Segment] = deque()
        self._ending = np.zeros((0, contactors), np.float32)

    @property
    def waiting(self) -> float:
        """What is still to be played [s]."""
        return sum(segment.left for segment in self._segments)

    def append(self, samples: Singles, sample_rate: float, contactors: tuple[int, ...]) -> int:
        """Take samples [m] at a rate [Hz] for some contactors, all where none is named.

        Returns
        -------
        int
            How many were taken.
        """
        room = int(max(LONGEST - self.waiting, 0.0) * sample_rate)
        plays = np.full(self._contactors, not contactors, np.float32)
        plays[list(contactors)] = 1
        last = self._segments[-1] if self._segments else None
        if last is None or last.rate != sample_rate or not np.array_equal(last.plays, plays):
            if not min(room, len(samples)):
                return 0
            last = Segment(sample_rate, self._rate, plays)
            self._segments.append(last)
        last.add(samples[:room])
        return min(room, len(samples))

    def clear(self) -> None:
        """Drop what waits, but for the next few samples, which fade out."""
        count = int(ENDING * self._rate)
        ending = self.take(count)
        self._segments.clear()
        if ending is not None:
            ramp = np.linspace(1, 0, count, endpoint=False, dtype=np.float32)
            self._ending = ending * ramp[:, None]

    def take(self, count: int) -> Singles | None:
        """Return the next samples (S, N) [m]; None where nothing waits."""
        if not self._segments and not len(self._ending):
            return None
        out, at = np.zeros((count, self._contactors), np.float32), 0
        while self._segments and at < count:
            segment = self._segments[0]
            part = segment.read(count - at)
            out[at : at + len(part)] = np.outer(part, segment.plays)
            at += len(part)
            if at < count:
                self._segments.popleft()
        ending, self._ending = self._ending[:count], self._ending[count:]
        out[: len(ending)] += ending
        return out


@dataclass(frozen=True)
class Curve:
    """A parametric effect.

    Attributes
    ----------
    size : [m] of an amplitude of 1
    amplitude, frequency : (P, 2) of time from its beginning [s] and value, or [Hz]
    transients : (T, 3) of time [s], value and frequency [Hz]
    stream : whether it goes on from what plays
    """

    size: float
    amplitude: Floats
    frequency: Floats
    transients: Floats
    stream: bool


class Effect:
    """Plays a client's curves; the last one replaces those before it.

    Parameters
    ----------
    sample_rate : [Hz]
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate = sample_rate
        self._curve: Curve | None = None
        self._at = self._last = self._phase = 0.0
        self._from = 0.0

    def begin(self, curve: Curve | None) -> None:
        """Go over to a curve; None ends what plays."""
        if curve is None:
            nothing = np.zeros((0, 2))
            curve = Curve(0.0, nothing, nothing, np.zeros((0, 3)), stream=False)
        self._from, self._curve, self._at = self._last, curve, 0.0

    def take(self, count: int) -> Singles | None:
        """Return the next samples (S, 1) [m], the same for all contactors; None at rest."""
        curve = self._curve
        if curve is None:
            return None
        time = self._at + np.arange(count) / self._rate
        size = self._amplitude(curve, time)
        plain = np.full(count, PLAIN)
        f = np.interp(time, *curve.frequency.T) if len(curve.frequency) else plain
        turns = self._phase + np.cumsum(f) / self._rate
        wave = size * np.sin(2 * np.pi * turns)
        self._phase, self._last = float(turns[-1] % 1), float(size[-1])
        for when, value, frequency in curve.transients:
            wave += curve.size * value * _tap(time - when, frequency)
        self._at += count / self._rate
        if self._at > end_of(curve):
            self._curve, self._last, self._phase = None, 0.0, 0.0
        return np.asarray(wave[:, None], np.float32)

    def _amplitude(self, curve: Curve, time: Floats) -> Floats:
        """Return the amplitude [m], going over from the last curve's."""
        size = np.zeros(len(time))
        if len(curve.amplitude):
            last = curve.amplitude[-1, 0] + (HOLD if curve.stream else 0.0)
            size = curve.size * np.interp(time, *curve.amplitude.T)
            size *= np.clip(1 - (time - last) / ENDING, 0, 1)
        new = np.clip(time / ENDING, 0, 1)
        return np.asarray(self._from * (1 - new) + size * new)


def end_of(curve: Curve) -> float:
    """Return when a curve is over [s]."""
    ends = [ENDING]
    if len(curve.amplitude):
        ends.append(curve.amplitude[-1, 0] + (HOLD if curve.stream else 0.0) + ENDING)
    ends += [when + PERIODS / frequency for when, _, frequency in curve.transients]
    return max(ends)


def _tap(time: Floats, frequency: float) -> Floats:
    """Return a transient at times [s] after its beginning: sines under half a cosine, falling."""
    way = time * frequency / PERIODS
    size = np.where((way >= 0) & (way < 1), (1 + np.cos(np.pi * way)) / 2, 0.0)
    return np.asarray(size * np.sin(2 * np.pi * frequency * time))
