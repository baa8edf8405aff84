"""Travel: the stage of the limiter that bounds how far a drive would swing free tips.

When the finger leaves, a drive that was made for a loaded tip swings the free one up. An amplifier
that measures no current cannot notice that. This stage therefore never puts out a drive that would
swing a free tip further than it survives (`free_tip`), whether there is a finger or not.

It computes the swing of each tip from the drive that is put out, and looks as far ahead as the
limiter does. One gain, common to all contactors, is lowered so far that the present swing plus what
follows within the look-ahead stays within the limit; it recovers with the time constant of the
limiter. Where nothing comes near the limit, nothing is changed.

The bound holds for any input. A step that the slew limit forbids cannot be taken back at once, so
that every sample must leave a way out: the drive that falls from there to 0 V as fast as the slew
limit allows, by the same factor each sample, must keep the limit as well. That drive is always at
hand for the next sample. The drive goes from there towards its target as far as the limit allows.

Guards in an amplifier, which measure the current, may watch some of the contactors instead. How far
these swing is then unknown here, since a finger holds them. When such a contactor is bounded again,
it is taken as at rest under the latest drive: the finger that was there until then held it closer.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.machine_code import compiled
from tactile.rendering.free_tip import FreeTip, share_of_one

SETTLED = 1e-6
"""Reduction of a gain that is taken for none."""
AT_ONCE = 4
"""Number of samples of a contactor that are computed before those of the next."""
ROUNDING = 5e-10
"""Relative distance that is kept from the largest travel; less than that of the limiter from its
limits, so that the highest voltage can be held where it gives the largest travel."""


class Bounded(NamedTuple):
    """Drive that keeps all limits.

    Attributes
    ----------
    drive : (S, N) array of float
        Drive [V].
    gain : (S,) array of float
        Gain of each sample.
    guarded : int
        Number of samples that went only part of the way to what their gain makes of them.
    """

    drive: Floats
    gain: Floats
    guarded: int


class WayOut(NamedTuple):
    """Way out from a sample, for compiled code.

    Attributes
    ----------
    largest : float
        Largest magnitude of a state [V].
    beside : float
        Largest of the states per volt that the way out alone adds.
    turns, out : (K,) array of complex
        Factors of the state before the sample, and states per volt of it, after each sample.
    """

    largest: float
    beside: float
    turns: Complex
    out: Complex


class TravelStage:
    """Bounds the swing of N free tips, and the step from sample to sample.

    Parameters
    ----------
    tip : FreeTip
        Model of the free tip.
    voltage, step : float
        Largest magnitude of a sample, which the drive keeps, and largest step [V].
    recovery : float
        Factor by which the reduction of the gain falls from sample to sample.
    ahead : int
        Number of samples that are known ahead of each.
    channels : int
        Number of contactors N.
    """

    def __init__(
        self,
        tip: FreeTip,
        voltage: float,
        step: float,
        *,
        recovery: float,
        ahead: int,
        channels: int,
    ) -> None:
        self._pole, self._largest = tip.pole, tip.largest * (1 - ROUNDING)
        self._voltage, self._step = voltage, step
        self._recovery, self._ahead = recovery, ahead
        self._state = np.zeros((2, channels))
        """States of the tips as rows of real and imaginary parts."""
        self._bounded_here = np.ones(channels)
        """1 for contactors that are bounded here, 0 for others."""
        self._reduction = 0.0
        self._fall = max(1 - step / voltage, 0.0)
        """Factor of the drive from sample to sample on the way out."""
        pole, count = tip.pole, self._way_out(voltage)
        self._turns = np.asarray(pole ** np.arange(1, count + 1))
        """Factors of the state after each sample of the way out."""
        alone = (1 - pole) * pole ** np.arange(count)
        self._out = np.convolve(alone, self._fall ** np.arange(count))[:count]
        """States per volt of the next sample, after it and those of the way out from there."""
        self._beside = float(np.abs(self._out - alone).max())
        """Largest of the states that the way out alone adds."""
        self._weights = np.asarray((1 - pole) * pole ** np.arange(ahead, -1, -1))
        """State after the look-ahead per volt of each of its samples."""

    def _way_out(self, voltage: float) -> int:
        """Return the number of samples of the way out after which the limit holds by itself.

        Then damping takes more from a state at the limit than the drive, which falls from the
        highest voltage, can add.
        """
        damping = (1 - abs(self._pole)) / abs(1 - self._pole)
        spare = damping * self._largest / voltage
        if self._fall == 0 or spare >= 1:
            return 1
        return 1 + math.ceil(math.log(spare) / math.log(self._fall))

    def leave(self, watched: NDArray[np.bool_], last: Floats) -> None:
        """Leave contactors to guards in an amplifier, from the next sample on, and no others.

        Parameters
        ----------
        watched : (N,) array of bool
            Contactors that guards watch.
        last : (N,) array of float
            Sample before [V].
        """
        back = (self._bounded_here == 0) & ~watched
        self._state[:, watched | back] = 0.0
        self._state[0, back] = last[back]
        self._bounded_here = (~watched).astype(np.float64)

    def passes(self, line: Floats, last: Floats) -> bool:
        """Follow a drive that keeps voltage and step, if no tip comes near its limit.

        Parameters
        ----------
        line : (S + ahead, N) array of float
            Drive, the look-ahead of the last sample included; may hold any values [V].
        last : (N,) array of float
            Sample before [V].

        Returns
        -------
        bool
            Whether it may be put out as it is; if not, nothing has changed.
        """
        return not self._reduction and _passes(
            line, last, self._state, self._bounded_here, self._ahead, self._pole,
            self._voltage, self._step, self._largest, self._beside,
        )  # fmt: skip

    def __call__(self, line: Floats, gain: Floats, last: Floats) -> Bounded:
        """Compute the drive that may be put out.

        Parameters
        ----------
        line : (S + ahead, N) array of float
            Drive, the look-ahead of the last sample included [V].
        gain : (S,) array of float
            Gain of each sample, with which it keeps the voltage.
        last : (N,) array of float
            Sample before [V].

        Returns
        -------
        Bounded
            Drive within the limits, with its gain.
        """
        gain, drive = gain.copy(), np.empty((len(gain), len(last)))
        self._reduction, guarded = _bound(
            line, last, gain, drive, self._state, self._bounded_here, self._reduction,
            self._recovery, self._step, self._largest, self._fall, self._beside,
            self._turns, self._out, self._weights,
        )  # fmt: skip
        return Bounded(drive, gain, guarded)


@compiled()
def _swung(x: float, y: float, volts: float, pole: complex) -> tuple[float, float]:
    """Return real and imaginary part of a state after a sample."""
    a, b = pole.real, pole.imag
    return a * x - b * y + (1 - a) * volts, b * x + a * y - b * volts


@compiled()
def _see_some(
    line: Floats, first: int, count: int, last: Floats, seen: Floats, bounded: Floats,
    pole: complex, voltage: float, step: float,
) -> None:  # fmt: skip
    """See some samples, in a loop over contactors that stays in registers."""
    for c in range(np.uint64(len(last))):
        x, y, beyond, farthest, highest = seen[0, c], seen[1, c], seen[2, c], seen[3, c], seen[4, c]
        before = last[c]
        for n in range(np.uint64(first), np.uint64(first + count)):
            volts = line[n, c]
            within = abs(volts) <= voltage and abs(volts - before) <= step
            beyond += 0.0 if within else 1.0
            before, volts = volts, volts * bounded[c]
            x, y = _swung(x, y, volts, pole)
            square, size = x * x + y * y, abs(volts)
            farthest = square if square > farthest else farthest
            highest = size if size > highest else highest
        seen[0, c], seen[1, c], seen[2, c], seen[3, c], seen[4, c] = x, y, beyond, farthest, highest


@compiled()
def _see(
    line: Floats, last: Floats, seen: Floats, bounded: Floats,
    pole: complex, voltage: float, step: float,
) -> None:  # fmt: skip
    """Follow the states and note what was seen on the way, most samples `AT_ONCE`.

    ``seen`` are rows: real and imaginary parts, number of samples beyond voltage or step, largest
    square of a state and largest magnitude of a sample.
    """
    whole = len(line) // AT_ONCE * AT_ONCE
    for n in range(0, whole, AT_ONCE):
        _see_some(line, n, AT_ONCE, last, seen, bounded, pole, voltage, step)
        last = line[n + AT_ONCE - 1]
    for n in range(whole, len(line)):
        _see_some(line, n, 1, last, seen, bounded, pole, voltage, step)
        last = line[n]


@compiled(
    "boolean(float64[:, ::1], float64[::1], float64[:, ::1], float64[::1], int64, complex128,"
    " float64, float64, float64, float64)"
)
def _passes(
    line: Floats, last: Floats, state: Floats, bounded: Floats, ahead: int, pole: complex,
    voltage: float, step: float, largest: float, beside: float,
) -> bool:  # fmt: skip
    """Return whether a drive passes; if so, the states become those before its look-ahead."""
    count, channels = len(line) - ahead, len(last)
    seen, after = np.zeros((5, channels)), np.empty((2, channels))
    for c in range(channels):
        seen[0, c], seen[1, c] = state[0, c], state[1, c]
    _see(line[:count], last, seen, bounded, pole, voltage, step)
    for c in range(channels):
        after[0, c], after[1, c] = seen[0, c], seen[1, c]
    _see(line[count:], line[count - 1] if count else last, seen, bounded, pole, voltage, step)
    for c in range(channels):
        near = math.sqrt(seen[3, c]) + beside * seen[4, c]
        if not (seen[2, c] == 0 and near <= largest):
            return False
    for c in range(channels):
        state[0, c], state[1, c] = after[0, c], after[1, c]
    return True


@compiled()
def _held(state: Floats, c: int) -> complex:
    """Return the state of a contactor."""
    return complex(state[0, c], state[1, c])


@compiled()
def _size(state: complex) -> float:
    """Return a magnitude, without the care of `abs` for numbers whose square is infinite."""
    return math.sqrt(state.real * state.real + state.imag * state.imag)


@compiled()
def _part(held: complex, added: complex, keep: float, largest: float) -> float:
    """Return how much may be added to a state; infinite if the part ``keep`` of it may."""
    if _size(held + keep * added) <= largest:
        return np.inf
    return share_of_one(held, added, largest)


@compiled()
def _part_out(held: complex, first: float, more: float, keep: float, way: WayOut) -> float:
    """Return how much may be added to a sample without a state beyond the limit on the way out.

    Infinite if the part ``keep`` of it may.
    """
    turns, out, largest = way.turns, way.out, way.largest
    volts = first + keep * more
    if _size(turns[0] * held + out[0] * volts) + way.beside * abs(volts) <= largest:
        return np.inf
    part = np.inf
    for k in range(len(out)):
        part = min(part, _part(turns[k] * held + out[k] * first, out[k] * more, keep, largest))
    return part


@compiled()
def _share(
    line: Floats, gain: float, keep: float, state: Floats, bounded: Floats,
    weights: Complex, way: WayOut,
) -> float:  # fmt: skip
    """Return how much of a sample may be put out; infinite if the part ``keep`` of it may."""
    share, turn = np.inf, way.turns[0] ** len(weights)
    for c in range(line.shape[1]):
        held, free, ahead = _held(state, c), gain * bounded[c], 0j
        for k in range(len(weights)):
            ahead += weights[k] * line[k, c]
        share = min(share, _part(turn * held, free * ahead, keep, way.largest))
        share = min(share, _part_out(held, 0.0, free * line[0, c], keep, way))
    return share


@compiled()
def _step_toward(
    drive: Floats, last: Floats, part: float, fall: float, state: Floats, bounded: Floats,
    way: WayOut,
) -> None:  # fmt: skip
    """Go only a part of the way from the sample before, as near to it as the travel allows.

    That part is within the step, and so is the first sample of the last way out, where it starts.
    """
    share = 1.0
    for c in range(len(drive)):
        start = fall * last[c]
        drive[c] = last[c] + part * (drive[c] - last[c])
        first, more = bounded[c] * start, bounded[c] * (drive[c] - start)
        share = min(share, _part_out(_held(state, c), first, more, 1.0, way))
    for c in range(len(drive)):
        start = fall * last[c]
        drive[c] = start + share * (drive[c] - start)


@compiled(
    "Tuple((float64, int64))"
    "(float64[:, ::1], float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1],"
    " float64, float64, float64, float64, float64, float64,"
    " complex128[::1], complex128[::1], complex128[::1])"
)
def _bound(
    line: Floats, last: Floats, gain: Floats, drive: Floats, state: Floats, bounded: Floats,
    reduction: float, recovery: float, step: float, largest: float, fall: float, beside: float,
    turns: Complex, out: Complex, weights: Complex,
) -> tuple[float, int]:  # fmt: skip
    """Fill in the drive, lower the gain, follow the states; return reduction and guarded count."""
    guarded, way = 0, WayOut(largest, beside, turns, out)
    for n in range(len(gain)):
        reduction = recovery * reduction if recovery * reduction >= SETTLED else 0.0
        seen = line[n : n + len(weights)]
        share = _share(seen, gain[n], 1 - reduction, state, bounded, weights, way)
        reduction = max(reduction, 1 - share)
        gain[n] *= 1 - reduction
        farthest = 0.0
        for c in range(len(last)):
            drive[n, c] = gain[n] * line[n, c]
            farthest = max(farthest, abs(drive[n, c] - last[c]))
        if farthest > step:
            _step_toward(drive[n], last, step / farthest, fall, state, bounded, way)
            guarded += 1
        for c in range(len(last)):
            x, y = _swung(state[0, c], state[1, c], bounded[c] * drive[n, c], turns[0])
            state[0, c], state[1, c] = x, y
        last = drive[n]
    return reduction, guarded
