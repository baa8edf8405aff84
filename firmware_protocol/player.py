"""What an amplifier plays: phases, gain and the last stage (sections 8 and 11 of SPEC.md).

The player knows instants and positions, no time and no messages. `advance` puts out a run of
instants in arrays; what changes within a run (data ends, a bridge is over, the gain has fallen)
ends it and the next begins.
"""

import numpy as np

from firmware_protocol.messages import Phase
from firmware_protocol.packet import TURN
from firmware_protocol.sources import Ints, Source, truncated

NOT_OVER = np.zeros((1, 1), np.bool_)


def distance(position: int, other: int) -> int:
    """Return position − other of two that wrap."""
    return ((position - other + TURN // 2) % TURN) - TURN // 2


class SamplePlayer:
    """Puts out one instant after the other.

    Parameters
    ----------
    source : of what is played
    limit, step : largest code, and largest change of it in an instant
    fade : instants of a full fade

    Attributes
    ----------
    output : (C,) last codes put out
    phase : `Phase`, STILL unless RUNNING
    ramping : in RAMPDOWN
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        self.position = self._first = 0
        self.output = np.zeros(source.channels, np.int64)
        self.limit, self.step, self.fade = 0, 0, 1
        self.phase = Phase.STILL
        self.ramping = False
        self._quick = self._held = False
        self._gain = 0
        self._over = NOT_OVER
        self.lost_samples = self.underruns = self.limited_samples = 0

    def start(self, source: Source, position: int) -> None:
        """Play from a position on."""
        self.source, self.position, self._first = source, position, position
        source.newest = position
        self.phase, self._gain = Phase.WAITING, 0

    def ramp(self, *, quick: bool) -> None:
        """Begin RAMPDOWN, or go on quickly with it."""
        if not self.ramping:
            self.ramping, self._quick = True, quick
            self._held = self.phase != Phase.PLAYING
            self.phase = Phase.STILL
        self._quick |= quick

    def still(self) -> None:
        """Go to 0 V at the slew limit and stay there."""
        self.phase, self.ramping = Phase.STILL, False

    @property
    def silent(self) -> bool:
        """Whether all outputs are at 0 V."""
        return not self.output.any()

    @property
    def fill(self) -> int:
        """Positions to the newest that is kept."""
        if self.phase == Phase.STILL and not self.ramping:
            return 0
        return max(0, self.source.newest - self.position)

    def advance(self, count: int, *, pending: bool = False) -> Ints:
        """Return the codes (S, C) of up to ``count`` instants; it stops where RAMPDOWN ends.

        ``pending`` while the tick of START has not come: 0 V, and the position stays.
        """
        if pending:
            return self._last_stage(np.zeros((count, self.source.channels), np.int64))
        parts, done = [], 0
        while done < count:
            part = self._last_stage(self._wanted(count - done))
            parts.append(part)
            done += len(part)
            if self.ramping and not self._gain and self.silent:
                self.ramping = False
                break
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _wanted(self, count: int) -> Ints:
        """Return what source and gain want of a run of instants."""
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
        silence = self.source.ready(n, count)
        if silence:
            return np.zeros((silence, self.source.channels), np.int64)
        self.phase = Phase.PLAYING
        if n == self._first:
            self._gain = self.fade
        return self._playing(n, count)

    def _playing(self, n: int, count: int) -> Ints:
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
        """Hold while the gain falls to nothing."""
        count = max(1, min(count, self._gain))
        if self.phase == Phase.STARVED:
            self.lost_samples += count
        return self._scaled(self.source.hold(n, count), self._gain - 1 - np.arange(count))

    def _ramping(self, n: int, count: int) -> Ints:
        if self._quick:
            self._gain = 0
        if not self._gain:
            return np.zeros((1, self.source.channels), np.int64)
        if self._held:
            return self._falling(n, count)
        if not self.source.begin(n):
            self.source.patch(n)
        out, _ = self.source.run(n, min(count, self._gain))
        return self._scaled(out, self._gain - 1 - np.arange(len(out)))

    def _scaled(self, codes: Ints, gains: Ints) -> Ints:
        """Return codes times the gain, the limit before it, so that a fade falls all the way."""
        self._gain = max(int(gains[-1]), 0)
        within = np.clip(codes, -self.limit, self.limit)
        self._over = (within != codes) & (gains > 0)[:, None]
        if gains[0] == gains[-1] == self.fade:
            return within
        return truncated(within * np.maximum(gains, 0)[:, None], self.fade)

    def _last_stage(self, wanted: Ints) -> Ints:
        """Return what is put out: within the limit, and no step larger than allowed."""
        out = np.clip(wanted, -self.limit, self.limit)
        steps = np.diff(out, axis=0, prepend=self.output[None])
        if max(steps.max(initial=0), -steps.min(initial=0)) > self.step:
            last = self.output
            for k, want in enumerate(out):
                last = out[k] = last + np.clip(want - last, -self.step, self.step)
        if self.phase != Phase.STILL or self.ramping:
            self.limited_samples += int(np.count_nonzero((out != wanted) | self._over))
        self._over = NOT_OVER
        self.output = out[-1].copy()
        return out
