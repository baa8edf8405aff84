"""The limiter: the only door through which volts leave.

Two stages. The first looks eight samples ahead and turns one gain, common to all contactors so
that the tactile image keeps its shape, down before a sample that would break a limit and slowly up
after it: nothing is clipped, and where no limit is near nothing is changed. The second holds the
step from sample to sample whatever came before, by going only part of the way in all contactors
alike; on a drive that has no jumps and needs no turning down for its steps it never acts. Both
count what they do.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Floats

LOOK_AHEAD = 8
"""Samples: 1 ms at 8 kHz."""
RELEASE = 0.1
"""Time constant of the gain's recovery [s]."""
NONSENSE = 1e9
"""Volts from which on an input is taken as invalid."""
LONGEST = 4096
"""Samples taken at a time."""
ROUNDING = 1e-9
"""Relative distance kept from each limit, for sums in double precision."""


class Limiter:
    """Holds voltage and step of N channels; what goes in comes out ``delay`` samples later.

    Parameters
    ----------
    voltage : largest magnitude [V]
    step : largest change from one sample to the next [V]
    sample_rate : [Hz]
    channels : N

    Attributes
    ----------
    limited_samples : output samples whose gain was below one
    guarded_samples : output samples that went only part of the way
    invalid_samples : input values that were not finite or beyond reason, taken as 0 V
    """

    delay = LOOK_AHEAD

    def __init__(self, voltage: float, step: float, *, sample_rate: float, channels: int) -> None:
        self._voltage = voltage * (1 - ROUNDING)
        self._step = step * (1 - ROUNDING)
        self._recovery = np.exp(-1 / (RELEASE * sample_rate))
        self._waiting = np.zeros((LOOK_AHEAD + 1, channels))
        self._own = np.ones(LOOK_AHEAD)
        self._held = np.ones(LOOK_AHEAD)
        self._last = np.zeros(channels)
        self._idle = True
        self.limited_samples = 0
        self.guarded_samples = 0
        self.invalid_samples = 0

    def __call__(self, volts: NDArray[np.floating]) -> Floats:
        """Return the next samples, within the limits whatever is asked.

        Parameters
        ----------
        volts : (S, N) [V]; may hold anything, NaN and infinity included

        Returns
        -------
        (S, N) ndarray
            The input ``delay`` samples ago, limited [V].
        """
        if len(volts) > LONGEST:
            parts = range(0, len(volts), LONGEST)
            return np.concatenate([self(volts[k : k + LONGEST]) for k in parts])
        if not len(volts):
            return np.zeros((0, len(self._last)))
        line = np.concatenate([self._waiting, volts])
        highest = np.abs(line).max()
        if not highest < NONSENSE:
            line = self._cleaned(line)
            highest = np.abs(line).max()
        count = len(volts)
        self._waiting, out = line[count:], line[1 : count + 1]
        if self._idle and highest <= self._voltage and 2 * highest <= self._step:
            self._last = self._waiting[0]
            return out.copy()
        out = self._guard(out * self._gain(line)[:, None])
        self._rest()
        return out

    def _cleaned(self, volts: Floats) -> Floats:
        good = np.abs(volts) < NONSENSE
        self.invalid_samples += volts.size - int(np.count_nonzero(good))
        return np.where(good, volts, 0.0)

    def _rest(self) -> None:
        """See whether gain and guard are done, so that drive may pass as it is."""
        settled = self._own.min() == 1 and self._held.min() > 1 - 1e-6
        if settled and np.array_equal(self._last, self._waiting[0]):
            self._held[:] = 1.0
            self._idle = True
        else:
            self._idle = False

    def _gain(self, line: Floats) -> Floats:
        """Return the gain of each output sample, from how far each input goes over its limits.

        A sample's own gain is min(1, voltage/|u|, step/|Δu|). The lowest of it over the look-ahead,
        let go exponentially, then averaged over the look-ahead, is never above it.
        """
        new, old = line[LOOK_AHEAD + 1 :], line[LOOK_AHEAD:-1]
        over = np.maximum(
            np.abs(new).max(axis=1, initial=0.0) / self._voltage,
            np.abs(new - old).max(axis=1) / self._step,
        )
        own = np.concatenate([self._own, 1 / np.maximum(over, 1.0)])
        self._own = own[len(over) :]
        lowest = sliding_window_view(own, LOOK_AHEAD + 1).min(axis=1)
        reduction = np.concatenate([[1 - self._held[-1]], 1 - lowest])
        let_go = 1 - _decaying_maximum(reduction, self._recovery)[1:]
        held = np.concatenate([self._held, np.minimum(lowest, let_go)])
        self._held = held[len(over) :]
        gain = sliding_window_view(held, LOOK_AHEAD + 1).mean(axis=1)
        self.limited_samples += int(np.count_nonzero(gain < 1 - 1e-6))
        return np.asarray(gain)

    def _guard(self, wanted: Floats) -> Floats:
        """Go from sample to sample by no more than the step, in the direction of what is asked."""
        change = np.abs(np.diff(wanted, axis=0, prepend=self._last[None]))
        if change.max(initial=0.0) > self._step:
            for k, row in enumerate(wanted):
                move = row - (wanted[k - 1] if k else self._last)
                far = float(np.abs(move).max())
                if far > self._step:
                    row += move * (self._step / far - 1)
                    self.guarded_samples += 1
        self._last = wanted[-1].copy()
        return wanted


def _decaying_maximum(values: Floats, decay: float) -> Floats:
    """Return the running maximum of values (K,) that shrinks by ``decay`` per step.

    y[n] = max over k ≤ n of values[k] decay^(n−k), without a loop.
    """
    weight = decay ** np.arange(len(values))
    return np.asarray(np.maximum.accumulate(values / weight) * weight)
