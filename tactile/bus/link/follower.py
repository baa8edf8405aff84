"""One stream for amplifiers whose clocks run apart: those after the first follow it.

Every amplifier puts out its samples by its own crystal, so that after minutes the same position
would be put out at other times. What is sent to a follower is the stream read a little beside its
positions, at `offset`, between samples by a windowed sinc (Smith & Gossett, ICASSP 1984). While
clocks are less than `SLACK` apart the offset stays at 0 and samples pass as they are; beyond, it
moves, at 100 ppm by 0.8 samples a second. At 8 kHz a tone of up to 1 kHz is within −85 dB of
itself shifted; at 2.5 kHz, where 1 kHz is near half the rate, within −24 dB, 500 Hz within −80 dB.
"""

import numpy as np

from tactile.arrays import Floats

HALF = 8
"""Samples on either side that a value is made of; those after it are waited for, 1 ms at 8 kHz."""
SHAPE = 8.0
"""Of the Kaiser window."""
SLACK = 0.25
"""Samples by which clocks may be apart; 31 µs at 8 kHz, some times what an estimate is off by."""
SETTLING = 0.25
"""s in which what is beyond the slack goes down to 1/e."""

Piece = tuple[int, Floats]
"""A position and the samples from it on."""


def weights(fraction: Floats) -> Floats:
    """Return (S, 2 × `HALF`) weights of the samples around places (S,) within [0, 1) after one."""
    distance = fraction[:, None] - np.arange(1 - HALF, HALF + 1)
    inside = np.clip(1 - (distance / HALF) ** 2, 0, None)
    return np.asarray(np.sinc(distance) * np.i0(SHAPE * np.sqrt(inside)) / np.i0(SHAPE))


class Follower:
    """The stream as another clock is to play it.

    Parameters
    ----------
    rate : of the samples [Hz]

    Attributes
    ----------
    offset : by which it is read after its own position [samples]
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self.begin(0)

    def begin(self, position: int) -> None:
        """Begin anew, with silence before a position."""
        self.offset = 0.0
        self._known: Floats = np.zeros((0, 0))
        self._known_from = self._next = position

    @property
    def _end(self) -> int:
        return self._known_from + len(self._known)

    def steer(self, apart: float, count: int) -> float:
        """Return by how much the offset changes per sample, when clocks are ``apart`` [samples]."""
        error = apart - self.offset
        beyond = np.sign(error) * max(abs(error) - SLACK, 0.0)
        return float(beyond / max(SETTLING * self._rate, count))

    def feed(self, position: int, volts: Floats, apart: float) -> list[Piece]:
        """Take samples (S, C) from a position on; return those that can be sent by now.

        ``apart`` is by how many samples the first clock is ahead of this one's at a position.
        """
        pieces = []
        if position != self._end or not len(self._known):
            pieces += self.flush()
            self._known_from = position - HALF
            before = self._known[-1:] if len(self._known) else np.zeros((1, volts.shape[1]))
            self._known, self._next = np.repeat(before, HALF, axis=0), position
        return [*pieces, *self._read(volts, self.steer(apart, len(volts)))]

    def flush(self) -> list[Piece]:
        """Return the samples that wait for those after them, as if the last went on."""
        if not len(self._known):
            return []
        pieces = self._read(np.repeat(self._known[-1:], HALF, axis=0), 0.0)
        self._known = self._known[:-HALF]
        return pieces

    def _read(self, volts: Floats, slope: float) -> list[Piece]:
        """Take samples, and read as far as they reach."""
        self._known = np.concatenate([self._known, volts])
        last = self._end - 1 - HALF
        count = max(int(np.floor(last - self.offset)) + 1 - self._next, 0)
        if not count:
            return []
        step = np.arange(count, dtype=np.float64)
        place: Floats = self._next + self.offset + (1 + slope) * step
        whole = np.clip(np.floor(place).astype(np.int64), self._known_from + HALF - 1, last)
        at = (whole - self._known_from)[:, None] + np.arange(1 - HALF, HALF + 1)
        fraction: Floats = place - whole
        if not fraction.any():
            out = self._known[at[:, HALF - 1]]
        else:
            out = (weights(fraction)[:, :, None] * self._known[at]).sum(axis=1)
        piece = (self._next, out)
        self.offset += slope * count
        self._next += count
        spare = int(whole[-1]) - 2 * HALF - self._known_from
        if spare > 0:
            self._known, self._known_from = self._known[spare:], self._known_from + spare
        return [piece]
