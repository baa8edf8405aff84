"""Gains with which the guards of amplifiers have held channels down, by position.

Amplifiers report from which position on a gain changes, and change it by the law of the protocol
(SPEC.md, 17.4). `GuardGains` computes from the reports what was played of the drive that was sent.
Where a report was lost, the flags of the windows tell.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.guard import FULL, moved
from tactile.arrays import Floats

MOST_CHANGES = 64
"""Largest number of changes that are kept apart; the oldest are added to the state before them."""
LATEST = 200
"""Largest number of samples after which an amplifier knows the current of an instant: the most that
the reference amplifier in C can be built for."""
BEFORE_ALL = -(1 << 62)
"""Position before all others."""


@dataclass
class _State:
    """Gains of N channels before a position."""

    position: int
    gain: NDArray[np.int64]
    tripped: NDArray[np.bool_]


@dataclass(frozen=True)
class _Change:
    """Change of what the guards of some channels do, from a position on."""

    position: int
    channels: NDArray[np.bool_]
    tripped: NDArray[np.bool_]
    at_full: NDArray[np.bool_]
    """Whether the gain of each channel is full there, whatever it was before."""


class GuardGains:
    """Gains of N channels, as far as they are known.

    Parameters
    ----------
    channels : int
        Number of channels.
    sample_rate : int
        Sample rate [Hz].

    Attributes
    ----------
    tripped : (N,) array of bool
        Whether each channel is turned down by the latest report.
    trips : (N,) array of int
        Number of times that each one was.
    latest : (N,) array of int
        Position of the latest trip of each one, below all positions if there was none.
    """

    def __init__(self, channels: int, sample_rate: int) -> None:
        self._count, self._rate = channels, sample_rate
        self.trips = np.zeros(channels, np.intp)
        self.restart()

    def restart(self) -> None:
        """Begin with full gains, as amplifiers do when they start."""
        n = self._count
        self.tripped = np.zeros(n, np.bool_)
        self.latest = np.full(n, BEFORE_ALL)
        self._state = _State(BEFORE_ALL, np.full(n, FULL, np.int64), np.zeros(n, np.bool_))
        self._changes: deque[_Change] = deque()

    def report(
        self, position: int, channels: NDArray[np.bool_], tripped: NDArray[np.bool_]
    ) -> None:
        """Take what an amplifier reports.

        Parameters
        ----------
        position : int
            Position of the first sample with another gain.
        channels : (N,) array of bool
            Contactors that the report is of.
        tripped : (N,) array of bool
            Whether each of them is turned down.
        """
        self._add(_Change(position, channels, tripped, np.zeros(self._count, np.bool_)))

    def correct(self, position: int, samples: int, held: NDArray[np.bool_]) -> bool:
        """Compare the gains in a window with its flags, and correct them where a report was lost.

        A flag is of the instants at which the currents of the window were known, which may be up to
        `LATEST` samples after those of the window.

        Parameters
        ----------
        position : int
            Position of the first sample, not before that of the last call of `gains`.
        samples : int
            Number of samples.
        held : (N,) array of bool
            Whether the amplifier held each channel down in a part of the window.

        Returns
        -------
        bool
            Whether gains were corrected, from the beginning of the window on.
        """
        gains = self._between(position, position + samples + LATEST)
        never, always = (gains == FULL).all(axis=0), (gains < FULL).all(axis=0)
        wrong = np.where(held, never, always)
        if wrong.any():
            self._add(_Change(position, wrong, held, wrong & ~held))
        return bool(wrong.any())

    def _add(self, change: _Change) -> None:
        """Add a change in the order of positions; count the channels that it turns down."""
        new = change.channels & change.tripped & ~self.tripped
        self.trips = self.trips + new
        self.latest = np.where(new, change.position, self.latest)
        later = []
        while self._changes and self._changes[-1].position > change.position:
            later.append(self._changes.pop())
        self._changes.append(change)
        self._changes.extend(reversed(later))
        if len(self._changes) > MOST_CHANGES:
            self._apply(self._state, self._changes.popleft())
        self.tripped = self._state.tripped
        for each in self._changes:
            self.tripped = np.where(each.channels, each.tripped, self.tripped)

    def gains(self, position: int, samples: int) -> Floats | None:
        """Return the gains of samples, none of which is before those of the last call.

        Parameters
        ----------
        position : int
            Position of the first one.
        samples : int
            Number S of samples.

        Returns
        -------
        (S, N) array of float or None
            Gains, 0 … 1; None if all are 1.
        """
        while self._changes and self._changes[0].position <= position:
            self._apply(self._state, self._changes.popleft())
        self._advance(self._state, position)
        gains = self._between(position, position + samples)
        return None if (gains == FULL).all() else gains / FULL

    def _between(self, position: int, end: int) -> NDArray[np.int64]:
        """Return the gains (S, N) of samples from the position of the state on, or from later."""
        state, parts = replace(self._state), []
        for change in self._changes:
            if change.position < end:
                parts.append(self._advance(state, change.position))
                self._apply(state, change)
        parts.append(self._advance(state, end))
        return np.concatenate(parts)[-(end - position) :]

    def _advance(self, state: _State, position: int) -> NDArray[np.int64]:
        """Let a state advance to a position, and return the gains (S, N) until there.

        Of more than a second it returns one second: gains have settled by then.
        """
        count = min(max(position - state.position, 0), self._rate)
        state.position = max(state.position, position)
        if not count:
            return np.zeros((0, self._count), np.int64)
        gains = moved(state.gain, state.tripped, rate=self._rate, count=count)
        state.gain = gains[-1]
        return gains

    def _apply(self, state: _State, change: _Change) -> None:
        """Let a state be as a change makes it, from the position of the change on."""
        self._advance(state, change.position)
        state.tripped = np.where(change.channels, change.tripped, state.tripped)
        state.gain = np.where(change.at_full, FULL, state.gain)
