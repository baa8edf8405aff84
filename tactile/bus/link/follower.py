"""Resampling of one stream for amplifiers whose clocks drift apart; all follow the first one.

Every amplifier puts out its samples by its own crystal, so that after minutes amplifiers would put
out the same position at different times. A follower is therefore sent the stream resampled at its
own positions plus an `offset`, with a windowed sinc between samples (Smith & Gossett, ICASSP 1984).
While the clocks are less than `SLACK` apart, the offset stays at 0 and samples pass unchanged.
Beyond that it moves, by 0.8 samples per second at 100 ppm and 8 kHz. At 8 kHz the error of a
shifted tone is −85 dB or less up to 1 kHz. At 2.5 kHz, where 1 kHz is near half the sample rate, it
is −24 dB at 1 kHz and −80 dB at 500 Hz.
"""

import numpy as np

from tactile.arrays import Floats

HALF = 8
"""Number of samples on either side that a value is computed from; it has to wait for those after
it, which takes 1 ms at 8 kHz."""
SHAPE = 8.0
"""Shape parameter β of the Kaiser window."""
SLACK = 0.25
"""Difference of clocks that is left alone: 31 µs at 8 kHz, several times the error of the clock
estimate [samples]."""
SETTLING = 0.25
"""Time in which a difference beyond the slack decays to 1/e [s]."""

Piece = tuple[int, Floats]
"""Position, and the samples (S, C) from it on."""


def weights(fraction: Floats) -> Floats:
    """Return the weights of the samples around points between samples.

    Parameters
    ----------
    fraction : (S,) array of float
        Distance of each point from the sample before it, in [0, 1) [samples].

    Returns
    -------
    (S, 2 × `HALF`) array of float
        Weights of the `HALF` samples before and the `HALF` samples after each point.
    """
    distance = fraction[:, None] - np.arange(1 - HALF, HALF + 1)
    inside = np.clip(1 - (distance / HALF) ** 2, 0, None)
    return np.asarray(np.sinc(distance) * np.i0(SHAPE * np.sqrt(inside)) / np.i0(SHAPE))


class Follower:
    """Stream of samples as an amplifier with another clock has to play it.

    Parameters
    ----------
    rate : float
        Sample rate [Hz].

    Attributes
    ----------
    offset : float
        Offset at which the stream is read: the next position of this amplifier gets the value of
        that position plus the offset [samples].
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self.begin(0)

    def begin(self, position: int) -> None:
        """Begin a new stream, before which the drive is 0 V.

        Parameters
        ----------
        position : int
            First position of the stream.
        """
        self.offset = 0.0
        self._known: Floats = np.zeros((0, 0))
        self._known_from = self._next = position

    @property
    def _end(self) -> int:
        """Position after the samples that are known."""
        return self._known_from + len(self._known)

    def steer(self, apart: float, count: int) -> float:
        """Return how fast the offset has to move toward the difference of the clocks.

        Parameters
        ----------
        apart : float
            Lead of the first amplifier over this one [samples].
        count : int
            Number of samples for which the result holds.

        Returns
        -------
        float
            Change of the offset per sample; 0 while the difference is within `SLACK`.
        """
        error = apart - self.offset
        beyond = np.sign(error) * max(abs(error) - SLACK, 0.0)
        return float(beyond / max(SETTLING * self._rate, count))

    def feed(self, position: int, volts: Floats, apart: float) -> list[Piece]:
        """Take samples, and return those that are complete by now.

        Samples that do not continue the last ones begin anew: what waited is returned first, as by
        `flush`.

        Parameters
        ----------
        position : int
            Position of the first sample.
        volts : (S, C) array of float
            Drive voltage [V].
        apart : float
            Lead of the first amplifier over this one, at that position [samples].

        Returns
        -------
        list of tuple of int and array of float
            Positions, and the samples (S, C) from each on [V].
        """
        pieces = []
        if position != self._end or not len(self._known):
            pieces += self.flush()
            self._known_from = position - HALF
            before = self._known[-1:] if len(self._known) else np.zeros((1, volts.shape[1]))
            self._known, self._next = np.repeat(before, HALF, axis=0), position
        return [*pieces, *self._read(volts, self.steer(apart, len(volts)))]

    def flush(self) -> list[Piece]:
        """Return the samples that wait for later ones, as if the last sample were repeated.

        Returns
        -------
        list of tuple of int and array of float
            Positions, and the samples (S, C) from each on [V].
        """
        if not len(self._known):
            return []
        pieces = self._read(np.repeat(self._known[-1:], HALF, axis=0), 0.0)
        self._known = self._known[:-HALF]
        return pieces

    def _read(self, volts: Floats, slope: float) -> list[Piece]:
        """Append samples, and return the stream as far as they allow it to be resampled.

        ``slope`` is the change of the offset per sample.
        """
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
        # Forget samples that no later point is computed from.
        spare = int(whole[-1]) - 2 * HALF - self._known_from
        if spare > 0:
            self._known, self._known_from = self._known[spare:], self._known_from + spare
        return [piece]
