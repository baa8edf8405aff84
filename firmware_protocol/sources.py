"""Sources of what the channels of an amplifier play (sections 8 and 10 of SPEC.md).

A source returns runs of sample instants as arrays: samples from a ring buffer, with straight lines
across missing ones, or carriers with ramped envelopes. Positions are kept without wrapping; those
on the wire are taken as distances from the position that is put out next. `SamplePlayer` calls, in
this order, `ready` while nothing plays, `begin` at each run, then `run` or `hold`, and `forget`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import spectrum
from firmware_protocol.messages import FADE_MS, VALID_MS
from firmware_protocol.packet import TURN
from firmware_protocol.spectrum import truncated

Ints = NDArray[np.int64]
"""Array of 64-bit integers."""
Mask = NDArray[np.bool_]
"""Array of bools."""


class Source(ABC):
    """Source of what the channels play, before gain and limits.

    Parameters
    ----------
    channels : int
        Number of channels C.
    fifo : int
        Number of positions that are kept.
    rate : int
        Sample rate [Hz].

    Attributes
    ----------
    channels, fifo : int
        The parameters of the same names.
    window : int
        Number of positions within which a missing sample can be bridged (20 ms).
    active : (C,) array of bool
        Channels for which anything was kept since START.
    late, future : int
        Number of positions (or frames) that were dropped as too late or too far ahead.
    newest : int
        Position after the newest one that was kept.
    """

    def __init__(self, channels: int, fifo: int, rate: int) -> None:
        self.channels, self.fifo = channels, fifo
        self.window = rate * FADE_MS // 1000
        self.active = np.zeros(channels, np.bool_)
        self.late = self.future = self.newest = 0

    @abstractmethod
    def ready(self, n: int, longest: int) -> int:
        """Return the number of instants until all active channels are ready.

        Parameters
        ----------
        n : int
            Position that is put out next.
        longest : int
            Largest number to return.

        Returns
        -------
        int
            Number of instants; 0 if all are ready now.
        """

    @abstractmethod
    def begin(self, n: int) -> bool:
        """Begin a run at a position.

        Parameters
        ----------
        n : int
            Position that is put out next.

        Returns
        -------
        bool
            Whether all active channels can continue.
        """

    @abstractmethod
    def patch(self, n: int) -> None:
        """Let those channels continue that can after `begin` returned False; the others hold.

        Parameters
        ----------
        n : int
            Position that is put out next.
        """

    @abstractmethod
    def run(self, n: int, longest: int) -> tuple[Ints, bool]:
        """Return the codes of a run.

        Parameters
        ----------
        n : int
            Position that is put out next.
        longest : int
            Largest number of instants.

        Returns
        -------
        codes : (S, C) array of int
            Sample codes of at least one instant.
        bridged : bool
            Whether missing samples are bridged.
        """

    @abstractmethod
    def hold(self, n: int, count: int) -> Ints:
        """Return the codes while all channels hold their values.

        Parameters
        ----------
        n : int
            Position that is put out next.
        count : int
            Number of instants.

        Returns
        -------
        (count, C) array of int
            Sample codes.
        """

    @abstractmethod
    def give_up(self, n: int) -> None:
        """Stop bridges and ramps where they are.

        Parameters
        ----------
        n : int
            Position that is put out next.
        """

    @abstractmethod
    def forget(self, n: int, count: int) -> None:
        """Drop the content of positions that have been put out.

        Parameters
        ----------
        n : int
            First of the positions.
        count : int
            Number of positions.
        """

    @abstractmethod
    def resume(self, n: int) -> None:
        """Prepare to continue from silence.

        Parameters
        ----------
        n : int
            Position that is put out next.
        """


class PcmSource(Source):
    """Source of PCM samples: a ring buffer, with straight lines that bridge missing samples.

    Parameters and attributes are those of `Source`.
    """

    def __init__(self, channels: int, fifo: int, rate: int) -> None:
        super().__init__(channels, fifo, rate)
        self._ring = np.zeros((fifo, channels), np.int64)
        self._written = np.zeros((fifo, channels), np.bool_)
        self._last = np.zeros(channels, np.int64)
        self._left = np.zeros(channels, np.int64)
        self._length = np.ones(channels, np.int64)
        self._from, self._to = np.zeros((2, channels), np.int64)
        self._bridgeable = np.zeros(0, np.intp)

    def write(self, n: int, ahead: int, first: int, codes: NDArray[np.int16]) -> None:
        """Write samples into the ring buffer.

        Parameters
        ----------
        n : int
            Position that is put out next.
        ahead : int
            Distance of the first sample from that position.
        first : int
            First channel.
        codes : (S, K) array of int
            Sample codes of K channels.
        """
        count = len(codes)
        early = min(max(-ahead, 0), count)
        beyond = min(max(ahead + count - self.fifo, 0), count - early)
        turned = max(ahead + count - TURN // 2, 0)
        self.late += early + turned
        self.future += beyond - turned
        accepted = codes[early : count - beyond]
        channels = slice(first, first + codes.shape[1])
        if not len(accepted):
            return
        self.active[channels] = True
        at = n + ahead + early
        self.newest = max(self.newest, at + len(accepted))
        start = at % self.fifo
        split = min(len(accepted), self.fifo - start)
        for place, part in ((start, accepted[:split]), (0, accepted[split:])):
            self._ring[place : place + len(part), channels] = part
            self._written[place : place + len(part), channels] = True

    def _slots(self, n: int, count: int) -> Ints | slice:
        """Return the index of positions in the ring buffer."""
        start = n % self.fifo
        if start + count <= self.fifo:
            return slice(start, start + count)
        return (n + np.arange(count)) % self.fifo

    def _there(self, n: int, count: int) -> Mask:
        """Return for which of ``count`` positions all active channels have a sample."""
        return np.asarray((self._written[self._slots(n, count)] | ~self.active).all(axis=1))

    def ready(self, n: int, longest: int) -> int:
        if not self.active.any():
            return longest
        count = min(longest, self.fifo)
        there = self._there(n, count)
        first = int(there.argmax())
        return first if there[first] else longest

    def begin(self, n: int) -> bool:
        missing = self.active & ~self._written[n % self.fifo] & (self._left == 0)
        if not missing.any():
            return True
        ahead = self._written[self._slots(n + 1, min(self.window, self.fifo - 1))][:, missing]
        reached = ahead.any(axis=0) if len(ahead) else np.zeros(missing.sum(), np.bool_)
        bridgeable = np.flatnonzero(missing)[reached]
        if len(bridgeable) < np.count_nonzero(missing):
            self._bridgeable = bridgeable
            return False
        self._bridge(n, bridgeable)
        return True

    def _bridge(self, n: int, channels: Ints) -> None:
        """Begin straight lines of channels from their last value to their next sample."""
        if not len(channels):
            return
        ahead = self._written[self._slots(n + 1, min(self.window, self.fifo - 1))][:, channels]
        gap = ahead.argmax(axis=0) + 1
        self._left[channels], self._length[channels] = gap, gap + 1
        self._from[channels] = self._last[channels]
        self._to[channels] = self._ring[(n + gap) % self.fifo, channels]

    def patch(self, n: int) -> None:
        self._bridge(n, self._bridgeable)

    def run(self, n: int, longest: int) -> tuple[Ints, bool]:
        bridged = self._left > 0
        count = min(longest, self.fifo)
        if bridged.any():
            count = min(count, int(self._left[bridged].min()))
        written = self._written[self._slots(n, count)]
        there = np.asarray((written | ~self.active | bridged).all(axis=1))
        if not there.all():
            count = max(int(there.argmin()), 1)
        slots = self._slots(n, count)
        out = self._ring[slots]
        if not there[0] or bridged.any() or not self.active.all():
            out = np.where(self._written[slots], out, self._last)
        if bridged.any():
            out = np.where(bridged, self._line(count), out)
            self._left[bridged] -= count
        self._last = out[-1].copy()
        return out, bool(bridged.any())

    def _line(self, count: int) -> Ints:
        """Return the next values (count, C) of the bridges."""
        step = (self._length - self._left)[None, :] + np.arange(count)[:, None]
        return self._from + truncated((self._to - self._from) * step, self._length)

    def hold(self, n: int, count: int) -> Ints:
        return np.broadcast_to(self._last, (count, self.channels))

    def give_up(self, n: int) -> None:
        self._left[:] = 0

    def forget(self, n: int, count: int) -> None:
        self._written[self._slots(n, min(count, self.fifo))] = False

    def resume(self, n: int) -> None:
        pass


@dataclass(frozen=True)
class _Frame:
    """Spectrum frame of one channel."""

    position: int
    valid: int
    envelope: Ints


class SpectrumSource(Source):
    """Source of spectrum frames: carriers with envelopes that ramp from frame to frame.

    Attributes are those of `Source`.

    Parameters
    ----------
    channels : int
        Number of channels C.
    fifo : int
        Number of positions that frames may be ahead.
    rate : int
        Sample rate [Hz].
    increments : (P,) array of int
        Phase increments of the carriers [turns per sample × 2³²].
    """

    def __init__(self, channels: int, fifo: int, rate: int, increments: NDArray[np.uint32]) -> None:
        super().__init__(channels, fifo, rate)
        self._increments = increments
        self._longest_valid = rate * VALID_MS // 1000
        shape = (channels, 2, len(increments))
        self._envelope, self._step, self._target = np.zeros((3, *shape), np.int64)
        self._start, self._end, self._valid = np.zeros((3, channels), np.int64)
        self._until = np.full(channels, -1, np.int64)
        self._ramping = np.zeros(channels, np.bool_)
        self._queues: list[list[_Frame]] = [[] for _ in range(channels)]

    def write(self, n: int, ahead: int, valid: int, first: int, envelopes: Ints) -> None:
        """Queue a frame of some channels.

        Parameters
        ----------
        n : int
            Position that is put out next.
        ahead : int
            Distance of the frame from that position.
        valid : int
            Number of positions for which the frame is in force.
        first : int
            First channel.
        envelopes : (K, 2, P) array of int
            In-phase and quadrature envelopes of K channels [1/256 sample code].
        """
        valid = min(valid, self._longest_valid)
        for c, envelope in enumerate(envelopes, first):
            self._queue(c, n, _Frame(n + ahead, valid, envelope))

    def _queue(self, c: int, n: int, frame: _Frame) -> None:
        """Queue a frame of one channel, or drop and count it (section 10.3)."""
        queue = self._queues[c]
        if frame.position <= (self._end[c] if self._ramping[c] else n):
            self.late += 1
        elif frame.position - n >= self.fifo:
            self.future += 1
        elif all(frame.position != other.position for other in queue):
            self.active[c] = True
            queue.append(frame)
            queue.sort(key=lambda other: other.position)
            self.newest = max(self.newest, queue[min(len(queue), spectrum.QUEUE) - 1].position + 1)
            if len(queue) > spectrum.QUEUE:
                del queue[spectrum.QUEUE :]
                self.future += 1

    def ready(self, n: int, longest: int) -> int:
        self._pass_over(n)
        waiting = [bool(self._queues[c]) for c in np.flatnonzero(self.active)]
        return 0 if waiting and all(waiting) else longest

    def _pass_over(self, n: int) -> None:
        """Drop queued frames whose position has come."""
        for queue in self._queues:
            while queue and queue[0].position <= n:
                del queue[0]

    def begin(self, n: int) -> bool:
        for c in np.flatnonzero(self._ramping & (self._end == n)):
            self._envelope[c] = self._target[c]
            self._until[c], self._ramping[c] = n + self._valid[c], False
        for c in np.flatnonzero(~self._ramping):
            if self._queues[c]:
                self._ramp(int(c), n, self._queues[c].pop(0))
        return bool((self._ramping | (n < self._until) | ~self.active).all())

    def _ramp(self, c: int, n: int, frame: _Frame) -> None:
        """Begin a ramp of a channel from its envelope at position n to a frame."""
        self._start[c], self._end[c], self._valid[c] = n, frame.position, frame.valid
        self._target[c], self._ramping[c] = frame.envelope, True
        self._step[c] = spectrum.ramp_step(self._envelope[c], frame.envelope, frame.position - n)

    def patch(self, n: int) -> None:
        pass

    def run(self, n: int, longest: int) -> tuple[Ints, bool]:
        ends = np.where(
            self._ramping, self._end, np.where(self._until > n, self._until, n + longest)
        )
        count = max(1, min(longest, int(ends.min()) - n))
        return self._played(n, count), False

    def hold(self, n: int, count: int) -> Ints:
        return self._played(n, count)

    def _played(self, n: int, count: int) -> Ints:
        """Return the codes of a piece in which no ramp begins or ends."""
        step = np.where(self._ramping[:, None, None], self._step, 0)
        now = self._now(n)
        return spectrum.synthesize(
            now[:, 0], now[:, 1], step[:, 0], step[:, 1], self._increments, n % TURN, count
        )

    def _now(self, n: int) -> Ints:
        """Return the envelopes at position n."""
        since = np.where(self._ramping, n - self._start, 0)
        return self._envelope + self._step * since[:, None, None]

    def give_up(self, n: int) -> None:
        self._envelope = self._now(n)
        self._ramping[:] = False

    def forget(self, n: int, count: int) -> None:
        self._pass_over(n + count - 1)

    def resume(self, n: int) -> None:
        self._envelope[:] = 0
        self._ramping[:] = False
        self._until[:] = -1
