"""Playback of an amplifier: phases, gain and last stage (sections 8 and 11 of SPEC.md).

The player knows sample instants and positions, but neither time nor messages. `advance` puts out a
run of instants as arrays. A change within a run (the data ends, a bridge is over, the gain has
reached 0) ends the run and begins the next one.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.guard import FULL, ChannelGuards
from firmware_protocol.messages import Phase
from firmware_protocol.packet import TURN
from firmware_protocol.sources import Ints, Source
from firmware_protocol.spectrum import truncated

NOT_OVER = np.zeros((1, 1), np.bool_)
"""Mask of samples beyond the limit when there are none."""


def distance(position: int, other: int) -> int:
    """Compute the signed distance between two positions that wrap.

    Parameters
    ----------
    position, other : int
        Positions, modulo 2³².

    Returns
    -------
    int
        position − other, −2³¹ … 2³¹ − 1.
    """
    return ((position - other + TURN // 2) % TURN) - TURN // 2


class SamplePlayer:
    """Player that puts out one sample instant after the other.

    Parameters
    ----------
    source : Source
        Source of what is played.

    Attributes
    ----------
    source : Source
        The parameter of the same name.
    guard : ChannelGuards
        Guards of the channels.
    position : int
        Position that is put out next.
    output : (C,) array of int
        Sample codes that were put out last.
    held : (S, C) array of bool or None
        Whether a guard held each channel down, at the instants of the last run; None if none was
        active.
    limit : int
        Largest sample code.
    step : int
        Largest change of a sample code from one instant to the next.
    fade : int
        Length of a full fade [instants].
    phase : Phase
        Phase of RUNNING, else STILL.
    ramping : bool
        Whether RAMPDOWN is under way.
    lost_samples, underruns, limited_samples : int
        Counters, as in STATUS.
    """

    def __init__(self, source: Source) -> None:
        self.source, self.guard = source, ChannelGuards(source.channels)
        self.position = self._first = 0
        self.output = np.zeros(source.channels, np.int64)
        self.limit, self.step, self.fade = 0, 0, 1
        self.phase = Phase.STILL
        self.ramping = False
        self._quick = self._holds = False
        self._gain = 0
        self._exceeded = NOT_OVER
        self.held: NDArray[np.bool_] | None = None
        self.lost_samples = self.underruns = self.limited_samples = 0

    def start(self, source: Source, position: int) -> None:
        """Start playing from a position.

        Parameters
        ----------
        source : Source
            Source of what is played.
        position : int
            Position of the first sample.
        """
        self.source, self.position, self._first = source, position, position
        source.newest = position
        self.phase, self._gain = Phase.WAITING, 0

    def ramp(self, *, quick: bool) -> None:
        """Begin RAMPDOWN, or continue it quickly.

        Parameters
        ----------
        quick : bool
            Whether to ramp at the slew limit instead of fading.
        """
        if not self.ramping:
            self.ramping, self._quick = True, quick
            self._holds = self.phase != Phase.PLAYING
            self.phase = Phase.STILL
        self._quick |= quick

    def go_to_rest(self) -> None:
        """Go to 0 V at the slew limit and stay there."""
        self.phase, self.ramping = Phase.STILL, False

    @property
    def silent(self) -> bool:
        """Whether all outputs are at 0 V."""
        return not self.output.any()

    @property
    def fill(self) -> int:
        """Number of positions up to the newest one in the buffer."""
        if self.phase == Phase.STILL and not self.ramping:
            return 0
        return max(0, self.source.newest - self.position)

    def advance(self, count: int, *, pending: bool = False) -> Ints:
        """Put out a run of sample instants; the run stops where RAMPDOWN ends.

        Parameters
        ----------
        count : int
            Largest number of instants.
        pending : bool
            Whether the tick of START has not come yet; the output is then 0 V and the position
            stays.

        Returns
        -------
        (S, C) array of int
            Sample codes that were put out.
        """
        self.held = None
        if pending:
            return self._last_stage(np.zeros((count, self.source.channels), np.int64))
        parts, done = [], 0
        while done < count:
            part = self._requested(count - done)
            part = self._last_stage(self._guarded(part) if self.guard.active else part)
            parts.append(part)
            done += len(part)
            if self.ramping and not self._gain and self.silent:
                self.ramping = False
                break
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _requested(self, count: int) -> Ints:
        """Return the codes that source and gain request for a run of instants."""
        n = self.position
        if self.phase == Phase.WAITING:
            out = self._waiting(n, count)
        elif self.phase == Phase.PLAYING:
            out = self._playing(n, count)
        elif self.phase == Phase.STARVED:
            out = self._starved(n, count)
        elif self.ramping:
            out = self._ramping(n, count)
        else:
            out = np.zeros((count, self.source.channels), np.int64)
        if self.phase != Phase.STILL or self.ramping:
            self.source.forget(n, len(out))
        self.position = n + len(out)
        return out

    def _waiting(self, n: int, count: int) -> Ints:
        """Return silence, or begin to play once all active channels are ready."""
        silence = self.source.ready(n, count)
        if silence:
            return np.zeros((silence, self.source.channels), np.int64)
        self.phase = Phase.PLAYING
        if n == self._first:
            self._gain = self.fade
        return self._playing(n, count)

    def _playing(self, n: int, count: int) -> Ints:
        """Play a run, or begin to fade out at an underrun."""
        if not self.source.begin(n):
            self.phase = Phase.STARVED
            self.underruns += 1
            self.source.give_up(n)
            return self._falling(n, count)
        out, bridged = self.source.run(n, count)
        if bridged:
            self.lost_samples += len(out)
        gains = np.minimum(self.fade, self._gain + 1 + np.arange(len(out)))
        return self._scaled(out, gains)

    def _starved(self, n: int, count: int) -> Ints:
        """Fade out, then return silence until all active channels are ready."""
        if self._gain:
            return self._falling(n, count)
        silence = self.source.ready(n, count)
        if silence:
            self.lost_samples += silence
            return np.zeros((silence, self.source.channels), np.int64)
        self.phase = Phase.PLAYING
        self.source.resume(n)
        return self._playing(n, count)

    def _falling(self, n: int, count: int) -> Ints:
        """Hold the values of the source while the gain falls to 0."""
        count = max(1, min(count, self._gain))
        if self.phase == Phase.STARVED:
            self.lost_samples += count
        return self._scaled(self.source.hold(n, count), self._gain - 1 - np.arange(count))

    def _ramping(self, n: int, count: int) -> Ints:
        """Fade out in RAMPDOWN, which plays on or holds."""
        if self._quick:
            self._gain = 0
        if not self._gain:
            return np.zeros((1, self.source.channels), np.int64)
        if self._holds:
            return self._falling(n, count)
        if not self.source.begin(n):
            self.source.patch(n)
        out, _ = self.source.run(n, min(count, self._gain))
        return self._scaled(out, self._gain - 1 - np.arange(len(out)))

    def _scaled(self, codes: Ints, gains: Ints) -> Ints:
        """Return codes times the gain.

        The codes are limited first, so that a fade reduces the output over its whole length.
        """
        self._gain = max(int(gains[-1]), 0)
        within = np.clip(codes, -self.limit, self.limit)
        self._exceeded = (within != codes) & (gains > 0)[:, None]
        if gains[0] == gains[-1] == self.fade:
            return within
        return truncated(within * np.maximum(gains, 0)[:, None], self.fade)

    def _guarded(self, codes: Ints) -> Ints:
        """Return codes times the gains of the guards, and note which are held down."""
        if self.phase == Phase.STILL and not self.ramping:
            return codes
        gains = self.guard.move(len(codes), ramping=self.ramping)
        self.held = gains < FULL if self.held is None else np.vstack([self.held, gains < FULL])
        return truncated(codes * gains, FULL)

    def _last_stage(self, targets: Ints) -> Ints:
        """Return the codes to put out, within the limit and with no step larger than allowed."""
        out = np.clip(targets, -self.limit, self.limit)
        steps = np.diff(out, axis=0, prepend=self.output[None])
        if max(steps.max(initial=0), -steps.min(initial=0)) > self.step:
            last = self.output
            for k, target in enumerate(out):
                last = out[k] = last + np.clip(target - last, -self.step, self.step)
        if self.phase != Phase.STILL or self.ramping:
            self.limited_samples += int(np.count_nonzero((out != targets) | self._exceeded))
        self._exceeded = NOT_OVER
        self.output = out[-1].copy()
        return out
