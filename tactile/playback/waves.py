"""Parametric effects that clients add to the surface as shear, and the time that waves may take.

An `EffectPlayer` evaluates an effect block by block from its points (XR_EXT_haptic_parametric). It
passes the limiter like everything else.

All clients together may use `BLOCK_WORK` per block. Work is counted before it is done, in
evaluations of a kernel or of a transient at one sample, so that what is played never depends on the
load of the machine. Waves that do not fit are silent for the block while their time goes on.
"""

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tactile.arrays import Floats, Singles
from tactile.playback.ending import ENDING

HOLD = 50e-3
"""Time for which a streamed effect is held after its last point (XR_EXT_haptic_parametric) [s]."""
PLAIN = 160.0
"""Frequency of an effect that has none, that of most phones' actuators (assumed) [Hz]."""
PERIODS = 2.0
"""Duration of a transient [periods]."""
MOST_TRANSIENTS = 16
"""Largest number of transients of an effect that sound at once; more are dropped. At 160 Hz and two
periods each, these are 1280 taps a second, more than can be told from a tone (assumed). They take
as much work as the rest of the effect."""
BLOCK_WORK = 12_000
"""Work for the waves of all clients in a block: at most 0.5 ms of its 2 ms, at 18 to 44 ns a unit
as measured by `python -m benchmarks waves`."""
EFFECT_WORK = 1000
"""Work of an effect in a block without its transients, the same for any small number of samples."""
TRANSIENT_WORK = 4
"""Work of a transient at one sample: a sine and a cosine."""
TURN = 50
"""Number of blocks after which another client becomes the first whose waves are played: 0.1 s."""


@dataclass(frozen=True)
class Curve:
    """Parametric effect.

    Attributes
    ----------
    size : float
        Shear of an amplitude of 1 [m].
    amplitude : (P, 2) array of float
        Points of the amplitude: time from the beginning [s] and value.
    frequency : (P, 2) array of float
        Points of the frequency: time from the beginning [s] and value [Hz].
    transients : (T, 3) array of float
        Time [s], value and frequency [Hz] of each transient, in order of time.
    stream : bool
        Whether the effect continues the one that plays.
    dropped : int
        Number of transients that were left out because `MOST_TRANSIENTS` others sound when they
        begin.
    end : float
        Time at which the effect is over [s].
    """

    size: float
    amplitude: Floats
    frequency: Floats
    transients: Floats
    stream: bool
    dropped: int = field(init=False)
    end: float = field(init=False)

    def __post_init__(self) -> None:
        """Prepare the transients here, in the server, so that playback does not have to."""
        transients = _thinned(self.transients[np.argsort(self.transients[:, 0], kind="stable")])
        ends = [ENDING, *(transients[:, 0] + PERIODS / transients[:, 2])]
        if len(self.amplitude):
            ends.append(self.amplitude[-1, 0] + (HOLD if self.stream else 0.0) + ENDING)
        object.__setattr__(self, "dropped", len(self.transients) - len(transients))
        object.__setattr__(self, "transients", transients)
        object.__setattr__(self, "end", float(max(ends)))


def _thinned(transients: Floats) -> Floats:
    """Return the transients without those that begin while the largest number sounds."""
    ends: list[float] = []
    chosen = []
    for k, (begin, _, frequency) in enumerate(transients.tolist()):
        while ends and ends[0] <= begin:
            heapq.heappop(ends)
        if len(ends) < MOST_TRANSIENTS:
            heapq.heappush(ends, begin + PERIODS / frequency)
            chosen.append(k)
    return transients[chosen]


class EffectPlayer:
    """Player of one client's curves, of which the last replaces those before it.

    Parameters
    ----------
    sample_rate : float
        Sample rate of the drive [Hz].

    Attributes
    ----------
    dropped : int
        Number of transients that were left out of the curves so far; may be reset.
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate = sample_rate
        self._curve: Curve | None = None
        self._at = self._last = self._phase = 0.0
        self._from = 0.0
        self._sounding: list[int] = []
        self.dropped = 0

    def begin(self, curve: Curve | None) -> None:
        """Change over to another curve.

        Parameters
        ----------
        curve : Curve or None
            Curve to play; None ends what plays.
        """
        if curve is None:
            nothing = np.zeros((0, 2))
            curve = Curve(0.0, nothing, nothing, np.zeros((0, 3)), stream=False)
        self._from, self._curve, self._at = self._last, curve, 0.0
        self._amplitude = np.ascontiguousarray(curve.amplitude.T)
        self._frequency = np.ascontiguousarray(curve.frequency.T)
        self._begins = curve.transients[:, 0].tolist()
        self._ends = (curve.transients[:, 0] + PERIODS / curve.transients[:, 2]).tolist()
        self._transients = curve.transients * (1.0, curve.size / 2, 2 * np.pi)
        self._sounding, self._next = [], 0
        self.dropped += curve.dropped

    def work(self, count: int) -> int:
        """Return the work of the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        int
            Work; 0 at rest.
        """
        if self._curve is None:
            return 0
        end = self._at + count / self._rate
        while self._next < len(self._begins) and self._begins[self._next] < end:
            self._sounding.append(self._next)
            self._next += 1
        self._sounding = [k for k in self._sounding if self._ends[k] > self._at]
        return EFFECT_WORK + TRANSIENT_WORK * count * len(self._sounding)

    def take(self, count: int) -> Singles | None:
        """Return the next samples.

        Parameters
        ----------
        count : int
            Number of samples of the drive.

        Returns
        -------
        (S, 1) array of float32 or None
            Shear, the same for all contactors [m]; None at rest.
        """
        curve = self._curve
        if curve is None:
            return None
        self.work(count)  # also updates which transients sound
        time = self._at + np.arange(count) / self._rate
        size = self._size(curve, time)
        f = np.interp(time, *self._frequency) if self._frequency.size else np.full(count, PLAIN)
        turns = self._phase + np.cumsum(f) / self._rate
        wave = size * np.sin(2 * np.pi * turns)
        self._phase, self._last = float(turns[-1] % 1), float(size[-1])
        if self._sounding:
            wave += _taps(time, self._transients[self._sounding])
        self._advance(curve, count)
        return np.asarray(wave[:, None], np.float32)

    def skip(self, count: int) -> None:
        """Advance without playing.

        Parameters
        ----------
        count : int
            Number of samples of the drive.
        """
        if self._curve is not None:
            self._last = 0.0
            self._advance(self._curve, count)

    def _advance(self, curve: Curve, count: int) -> None:
        """Advance the time of a curve, and end it when it is over."""
        self._at += count / self._rate
        if self._at > curve.end:
            self._curve, self._last, self._phase = None, 0.0, 0.0

    def _size(self, curve: Curve, time: Floats) -> Floats:
        """Return the amplitude [m], with a transition from that of the last curve."""
        size = np.zeros(len(time))
        if self._amplitude.size:
            last = self._amplitude[0, -1] + (HOLD if curve.stream else 0.0)
            size = curve.size * np.interp(time, *self._amplitude)
            if time[-1] > last:
                size *= np.clip(1 - (time - last) / ENDING, 0, 1)
        if self._at < ENDING:
            new = np.clip(time / ENDING, 0, 1)
            size = self._from * (1 - new) + size * new
        return np.asarray(size)


def _taps(time: Floats, transients: Floats) -> Floats:
    """Return the sum of transients at times (S,) [s]: sines under the falling half of a cosine.

    The columns of ``transients`` (T, 3) are beginning [s], half their size [m] and angular
    frequency [rad/s].
    """
    phase = np.subtract.outer(transients[:, 0], time)
    phase *= -transients[:, 2:]
    np.minimum(np.maximum(phase, 0.0, out=phase), 2 * np.pi * PERIODS, out=phase)
    return np.asarray(transients[:, 1] @ ((1 + np.cos(phase / (2 * PERIODS))) * np.sin(phase)))


def affordable(work: Mapping[int, int], turn: int) -> set[int]:
    """Choose whose waves are played in a block: in order from one client on, all that fit.

    Parameters
    ----------
    work : mapping of int to int
        Work of each client that has waves, by its number.
    turn : int
        Which of these clients is the first; the others follow in order of their numbers.

    Returns
    -------
    set of int
        Clients whose waves are played.
    """
    clients, left = sorted(work), BLOCK_WORK
    first = turn % max(len(clients), 1)
    chosen = set()
    for client in clients[first:] + clients[:first]:
        if work[client] <= left:
            left -= work[client]
            chosen.add(client)
    return chosen
