"""Limiter: the last stage before the drive, which no voltage bypasses.

It has three stages. The first looks eight samples ahead and applies one gain, common to all
contactors so that the tactile image keeps its shape. The gain falls before a sample that would
break a limit and recovers slowly after it: nothing is clipped, and nothing is changed where no
limit is near. The second lowers that gain further where the drive would swing a tip without a
finger further than it survives, and the third bounds the step from sample to sample
unconditionally, by going only part of the way in all contactors alike (`travel`); a drive without
jumps, whose steps need no reduction, never makes it act. All stages count what they do.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.machine_code import compiled
from tactile.rendering.free_tip import FreeTip
from tactile.rendering.travel import SETTLED, TravelStage

LOOK_AHEAD = 8
"""Look-ahead, which is also the delay of the limiter [samples]: 1 ms at 8 kHz."""
RELEASE = 0.1
"""Time constant of the gain's recovery [s]."""
NONSENSE = 1e9
"""Magnitude from which on an input is taken as invalid [V]."""
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
        self._recovery = math.exp(-1 / (RELEASE * sample_rate))
        self._waiting = np.zeros((LOOK_AHEAD + 1, channels))
        self._needed, self._held = np.ones(LOOK_AHEAD), np.ones(LOOK_AHEAD)
        self._last = np.zeros(channels)
        self._idle = True
        self._travel = TravelStage(
            tip or FreeTip(0j, math.inf), self._voltage, self._step,
            recovery=self._recovery, ahead=LOOK_AHEAD, channels=channels,
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
        count = len(volts)
        line = np.concatenate([self._waiting, volts], dtype=np.float64)
        passes = self._idle and self._travel.passes(line[1:], line[0])
        if not passes:
            self._clean(line)
        self._waiting = line[count:].copy()
        if not passes:
            return self._limited(line)
        self._last = self._waiting[0]
        return line[1 : count + 1]

    def leave_travel(self, watched: NDArray[np.bool_]) -> None:
        """Leave the travel of contactors to guards in an amplifier, from the next sample on.

        Parameters
        ----------
        watched : (N,) array of bool
            Contactors that guards watch; the travel of all others is bounded.
        """
        self._travel.leave(watched, self._last)

    def _clean(self, line: Floats) -> None:
        """Replace invalid values by 0 V, and count them."""
        invalid = ~(np.abs(line) < NONSENSE)
        self.invalid_samples += int(np.count_nonzero(invalid))
        line[invalid] = 0.0

    def _limited(self, line: Floats) -> Floats:
        """Return the drive (S, N) that all stages make of the input, and count what they do."""
        needed = np.concatenate([self._needed, np.ones(len(line) - LOOK_AHEAD - 1)])
        held = np.concatenate([self._held, np.ones(len(line) - LOOK_AHEAD - 1)])
        gain = _gain(line, needed, held, self._voltage, self._step, self._recovery)
        out, gain, guarded = self._travel(line[1:], gain, self._last)
        self._needed, self._held = needed[-LOOK_AHEAD:], held[-LOOK_AHEAD:]
        self._last = np.concatenate([self._last[None], out])[-1]
        unchanged = np.array_equal(self._last, self._waiting[0])
        self._idle = unchanged and self._needed.min() == self._held.min() == 1
        self.guarded_samples += guarded
        self.limited_samples += int(np.count_nonzero(gain < 1 - SETTLED))
        return out


@compiled("float64[::1](float64[:, ::1], float64[::1], float64[::1], float64, float64, float64)")
def _gain(
    line: Floats, needed: Floats, held: Floats, voltage: float, step: float, recovery: float
) -> Floats:
    """Return the gain of each output sample, from how far each input exceeds its limits.

    The gain that a sample alone needs is min(1, voltage/|u|, step/|Δu|). Its minimum over the
    look-ahead, released exponentially and then averaged over the look-ahead, is never above it.
    Both, needed and held, begin with those of the look-ahead before.
    """
    gain = np.empty(len(line) - LOOK_AHEAD - 1)
    for n in range(len(gain)):
        new, old = line[n + LOOK_AHEAD + 1], line[n + LOOK_AHEAD]
        over = max(np.abs(new).max() / voltage, np.abs(new - old).max() / step)
        needed[n + LOOK_AHEAD] = 1 / max(over, 1.0)
        left = recovery * (1 - held[n + LOOK_AHEAD - 1])
        released = 1 - left if left >= SETTLED else 1.0
        held[n + LOOK_AHEAD] = min(needed[n : n + LOOK_AHEAD + 1].min(), released)
        gain[n] = held[n : n + LOOK_AHEAD + 1].sum() / (LOOK_AHEAD + 1)
    return gain
