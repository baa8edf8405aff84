"""Limiter: the last stage before the drive, which no voltage bypasses.

It has three stages. The first looks eight samples ahead and applies one gain, common to all
contactors so that the tactile image keeps its shape. The gain falls before a sample that would
break a limit and recovers slowly after it: nothing is clipped, and nothing is changed where no
limit is near. The second lowers that gain further where the drive would swing a tip without a
finger further than it survives (`travel`). The third bounds the step from sample to sample
unconditionally, by going only part of the way in all contactors alike; a drive without jumps, whose
steps need no reduction, never makes it act. All stages count what they do.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.rendering.free_tip import FreeTip
from tactile.rendering.travel import TravelStage

LOOK_AHEAD = 8
"""Look-ahead, which is also the delay of the limiter [samples]: 1 ms at 8 kHz."""
RELEASE = 0.1
"""Time constant of the gain's recovery [s]."""
NONSENSE = 1e9
"""Magnitude from which on an input is taken as invalid [V]."""
LONGEST = 4096
"""Largest number of samples that is processed at a time."""
ROUNDING = 1e-9
"""Relative distance that is kept from each limit, for sums in double precision."""


class Limiter:
    """Bounds voltage and step of N channels; the input comes out ``delay`` samples later.

    Parameters
    ----------
    voltage : float
        Largest magnitude of a sample [V].
    step : float
        Largest change from one sample to the next [V].
    sample_rate : float
        Sample rate [Hz].
    channels : int
        Number of channels, N.
    tip : FreeTip, optional
        Model of each contactor without a finger, whose travel is then bounded as well.

    Attributes
    ----------
    delay : int
        Delay from input to output [samples].
    limited_samples : int
        Number of output samples whose gain was below 1.
    guarded_samples : int
        Number of output samples that went only part of the way.
    invalid_samples : int
        Number of input values that were not finite or out of range, taken as 0 V.
    """

    delay = LOOK_AHEAD

    def __init__(
        self,
        voltage: float,
        step: float,
        *,
        sample_rate: float,
        channels: int,
        tip: FreeTip | None = None,
    ) -> None:
        self._voltage = voltage * (1 - ROUNDING)
        self._step = step * (1 - ROUNDING)
        self._recovery = np.exp(-1 / (RELEASE * sample_rate))
        self._waiting = np.zeros((LOOK_AHEAD + 1, channels))
        self._own = np.ones(LOOK_AHEAD)
        self._held = np.ones(LOOK_AHEAD)
        self._last = np.zeros(channels)
        self._idle = True
        self._travel = None
        if tip is not None:
            self._travel = TravelStage(
                tip, self._voltage, self._step,
                recovery=float(self._recovery), ahead=LOOK_AHEAD, channels=channels,
            )  # fmt: skip
        self.limited_samples = 0
        self.guarded_samples = 0
        self.invalid_samples = 0

    def __call__(self, volts: NDArray[np.floating]) -> Floats:
        """Return the next samples, within the limits for any input.

        Parameters
        ----------
        volts : (S, N) array of float
            Drive to limit; may hold any values, NaN and infinity included [V].

        Returns
        -------
        (S, N) array of float
            Input of ``delay`` samples ago, limited [V].
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
        within = self._idle and highest <= self._voltage and 2 * highest <= self._step
        if within and (self._travel is None or self._travel.passes(line[1:], highest)):
            self._last = self._waiting[0]
            return out.copy()
        out = self._limited(line)
        self._rest()
        return out

    def leave_travel(self, watched: NDArray[np.bool_]) -> None:
        """Leave the travel of contactors to guards in an amplifier, from the next sample on.

        Parameters
        ----------
        watched : (N,) array of bool
            Contactors that guards watch; the travel of all others is bounded.
        """
        if self._travel is not None:
            self._travel.leave(watched, self._last)

    def _limited(self, line: Floats) -> Floats:
        """Return the drive (S, N) that all stages make of the input, and count what they do."""
        gain = self._gain(line)
        if self._travel is None:
            out = self._guard(line[1 : len(gain) + 1] * gain[:, None])
        else:
            out, gain, guarded = self._travel(line[1:], gain, self._last)
            self._last = out[-1].copy()
            self.guarded_samples += guarded
        self.limited_samples += int(np.count_nonzero(gain < 1 - 1e-6))
        return out

    def _cleaned(self, volts: Floats) -> Floats:
        """Return the input with invalid values replaced by 0 V, and count them."""
        good = np.abs(volts) < NONSENSE
        self.invalid_samples += volts.size - int(np.count_nonzero(good))
        return np.where(good, volts, 0.0)

    def _rest(self) -> None:
        """Note whether gain and guard have recovered, so that the drive may pass unchanged."""
        at_rest = self._own.min() == 1 and self._held.min() > 1 - 1e-6
        if at_rest and np.array_equal(self._last, self._waiting[0]):
            self._held[:] = 1.0
            self._idle = True
        else:
            self._idle = False

    def _gain(self, line: Floats) -> Floats:
        """Return the gain of each output sample, from how far each input exceeds its limits.

        The gain that a sample alone needs is min(1, voltage/|u|, step/|Δu|). Its minimum over the
        look-ahead, released exponentially and then averaged over the look-ahead, is never above it.
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
        released = 1 - _decaying_maximum(reduction, self._recovery)[1:]
        held = np.concatenate([self._held, np.minimum(lowest, released)])
        self._held = held[len(over) :]
        gain = sliding_window_view(held, LOOK_AHEAD + 1).mean(axis=1)
        return np.asarray(gain)

    def _guard(self, target: Floats) -> Floats:
        """Move from sample to sample by at most the step, towards a target."""
        change = np.abs(np.diff(target, axis=0, prepend=self._last[None]))
        if change.max(initial=0.0) > self._step:
            for k, row in enumerate(target):
                move = row - (target[k - 1] if k else self._last)
                largest = float(np.abs(move).max())
                if largest > self._step:
                    row += move * (self._step / largest - 1)
                    self.guarded_samples += 1
        self._last = target[-1].copy()
        return target


def _decaying_maximum(values: Floats, decay: float) -> Floats:
    """Return the running maximum of values (K,) that shrinks by the factor ``decay`` per step.

    y[n] = max over k ≤ n of values[k] decay^(n−k), computed without a loop.
    """
    weight = decay ** np.arange(len(values))
    return np.asarray(np.maximum.accumulate(values / weight) * weight)
