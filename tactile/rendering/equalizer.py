"""The equalizer: what drive makes the skin follow a shear that is given in time.

It takes a response, an array of shear per volt over frequency, and knows neither beam nor finger,
so that a measured response works as well. The inverse is exact wherever full drive can give at
least the smallest shear that anyone feels; beyond, its magnitude is bounded there and keeps its
phase. What full drive attains is |response| × voltage limit.

The inverse is played as a FIR filter of 32 taps, 1 ms late. A resonance of the bimorph is a zero
of its inverse, so that few taps hold it: in the band it is within 0.04 dB and 0.25° of the
inverse, loaded. Being a filter it is as exact for a finger that starts, stops and turns, for
modulated amplitudes and for events as it is for steady strokes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats, Singles

SMALLEST_SHEAR = 0.1e-6
"""m peak: the lowest detection threshold over frequency (250 Hz; Verrillo and Bolanowski)."""
PASS_BAND = 1000.0
STOP_BAND = 1250.0
"""Hz; shear is commanded in full up to the first and not at all from the second on."""
FREE_BAND = 2000.0
"""Hz from which on the filter is held down; between, it may do as it likes."""
STOP_WEIGHT, FREE_WEIGHT = 3e-3, 1e-4
"""Of errors beyond `FREE_BAND` and below it, against one in the band."""
LOWEST_RATE = 2 * STOP_BAND
"""Hz: the lowest sample rate that carries what is commanded."""
FITTED = 0.45
"""Of a low sample rate, to which a filter is fitted: a real one has no phase at half of it."""
GRID = 10.0
"""Hz between the frequencies at which the filter is fitted."""
TAPS = (32, 64, 256)
DELAYS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 176)
"""Samples: the first is enough for a bimorph, later ones for a response with a delay of its own."""
TOLERANCE = 6e-3
"""Largest relative error in 10 … 1000 Hz for which the next delay is not tried: 0.05 dB, 0.35°."""
NEGLIGIBLE = 1e-4
"""Of the taps of contactors that differ: what a further shared filter must gain at least."""


def roll_off(frequency: Floats) -> Floats:
    """Return the weight of commanded shear at frequencies [Hz] of either sign.

    One to 1000 Hz, zero from 1250 Hz, half a cosine between.
    """
    beyond = np.clip((np.abs(frequency) - PASS_BAND) / (STOP_BAND - PASS_BAND), 0, 1)
    return np.asarray((1 + np.cos(np.pi * beyond)) / 2)


def attainable(response: Complex, voltage: float) -> Floats:
    """Return the peak shear [m] that a sinusoid of ``voltage`` [V] gives, per frequency."""
    return np.asarray(np.abs(response) * voltage)


def inverse(response: Complex, voltage: float) -> Complex:
    """Return the bounded inverse of a response.

    Parameters
    ----------
    response : (..., F) shear per volt [m/V], exp(+jωt)
    voltage : the drive's limit [V]

    Returns
    -------
    (..., F) complex ndarray
        Volts per meter, 1/H where |H| × voltage is at least `SMALLEST_SHEAR`, elsewhere of that
        bound's magnitude and the phase of 1/H.
    """
    size = np.abs(response)
    floor = SMALLEST_SHEAR / voltage
    phase = np.conj(response) / np.where(size > 0, size, 1)
    return np.asarray(phase / np.maximum(size, floor))


def _turns(frequency: Floats, sample_rate: float, taps: int) -> Complex:
    return np.asarray(np.exp(-2j * np.pi / sample_rate * np.outer(frequency, np.arange(taps))))


def fit_taps(gain: Complex, sample_rate: float, taps: int, delay: int) -> tuple[Floats, float]:
    """Return the FIR filter whose response is a gain, some samples late, and its largest error.

    Parameters
    ----------
    gain : (K, F) at 0, 10, … `STOP_BAND` Hz
    sample_rate : [Hz]
    taps, delay : of the filter [samples]

    Returns
    -------
    taps : (K, taps) ndarray
        Weighted least squares over 0 … half the sample rate.
    error : float
        As `largest_error`.
    """
    f = np.arange(0, sample_rate / 2, GRID)
    band = min(gain.shape[1], int(FITTED * sample_rate / GRID) + 1)
    gain = gain[:, :band]
    late = np.exp(-2j * np.pi / sample_rate * f[:band] * delay)
    wanted = np.zeros((len(f), len(gain)), np.complex128)
    wanted[:band] = (gain * late).T
    weight = np.where(f < FREE_BAND, FREE_WEIGHT, STOP_WEIGHT)
    weight[:band] = 1.0
    left, right = _turns(f, sample_rate, taps) * weight[:, None], wanted * weight[:, None]
    found = np.linalg.lstsq(
        np.concatenate([left.real, left.imag]),
        np.concatenate([right.real, right.imag]),
        rcond=1e-12,
    )[0].T
    return found, largest_error(found, gain, sample_rate, delay)


def largest_error(taps: Floats, gain: Complex, sample_rate: float, delay: int) -> float:
    """Return the largest |filter/gain − 1| in 10 … 1000 Hz of filters (K, T), gains (K, F)."""
    f = np.arange(0, sample_rate / 2, GRID)[: gain.shape[1]]
    gain = gain[:, : len(f)]
    late = np.exp(-2j * np.pi / sample_rate * f * delay)
    reached = taps @ _turns(f, sample_rate, taps.shape[1]).T / (gain * late)
    return float(np.abs(reached[:, (f >= GRID) & (f <= PASS_BAND)] - 1).max())


@dataclass(frozen=True)
class InverseFilter:
    """The FIR inverse of amplifier and loaded bimorph, for every contactor and finger force.

    Contactors that differ share a few filters: taps of kind c are Σ_r mix[c, r] taps[l, r].

    Attributes
    ----------
    taps : (L, R, T) [V/m], for L normal forces
    mix : (C, R)
    delay : [samples]
    error : largest |filter × response − 1| in 10 … 1000 Hz over kinds and forces
    """

    taps: Floats
    mix: Floats
    delay: int
    error: float


def design(response: Complex, voltage: float, sample_rate: float) -> InverseFilter:
    """Return the FIR inverse of responses.

    Parameters
    ----------
    response : (L, C, F) shear per volt [m/V] at 0, 10, … `STOP_BAND` Hz, for L normal forces and
        C kinds of contactors
    voltage : the drive's limit [V]
    sample_rate : [Hz]

    Returns
    -------
    InverseFilter
        The shortest and earliest within `TOLERANCE`; where there is none, a later one only where it
        halves the error.
    """
    loads, kinds, _ = response.shape
    gain = inverse(response, voltage).reshape(loads * kinds, -1)
    best: tuple[float, Floats, int] | None = None
    for taps, delay in ((t, d) for t in TAPS for d in DELAYS if d < t):
        found, error = fit_taps(gain, sample_rate, taps, delay)
        if best is None or error < best[0] / 2:
            best = error, found, delay
        if best[0] <= TOLERANCE:
            break
    assert best is not None
    error, found, delay = best
    if kinds == 1:
        return InverseFilter(found.reshape(loads, 1, -1), np.ones((1, 1)), delay, error)
    rows = np.moveaxis(found.reshape(loads, kinds, -1), 1, 0).reshape(kinds, -1)
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    u, s, vt = np.linalg.svd(rows / size, full_matrices=False)
    terms = max(1, int(np.count_nonzero(s > NEGLIGIBLE * s[0])))
    mix, shared = size * u[:, :terms], s[:terms, None] * vt[:terms]
    kept = np.moveaxis((mix @ shared).reshape(kinds, loads, -1), 0, 1).reshape(found.shape)
    error = largest_error(kept, gain, sample_rate, delay)
    by_load = np.moveaxis(shared.reshape(terms, loads, -1), 0, 1)
    return InverseFilter(by_load, mix, delay, error)


class Equalizer:
    """Runs an `InverseFilter` over a stream: shear in, volts out, ``delay`` samples later.

    Parameters
    ----------
    filter : what to run
    kind : (N,) which of the filter's kinds each contactor is
    polarity : (N,) 1 or −1
    forces : (L,) normal forces [N] of the filter's first axis
    """

    def __init__(
        self,
        filter: InverseFilter,  # noqa: A002
        *,
        kind: NDArray[np.intp],
        polarity: Floats,
        forces: tuple[float, ...],
    ) -> None:
        self._filter, self._forces = filter, np.asarray(forces)
        gain = (filter.mix[kind] * polarity[:, None]).T
        self._gain, self._plain = gain.astype(np.float32), bool(np.all(gain == 1))
        self._past: Singles | None = None
        self._maps: dict[int, Singles] = {}

    def _map(self, count: int) -> Singles:
        """Return the filters as matrices (L, R, S, S + T − 1) over the stream."""
        if count not in self._maps:
            taps = self._filter.taps
            length = taps.shape[-1]
            found = np.zeros((*taps.shape[:2], count, count + length - 1), np.float32)
            for k in range(count):
                found[:, :, k, k : k + length] = taps[..., ::-1]
            self._maps[count] = found
        return self._maps[count]

    def __call__(self, shear: Singles, normal_force: Floats) -> Singles:
        """Return volts (S, N) for the shear (S, N) [m] ``delay`` samples ago.

        ``normal_force`` (S,) [N] is that of the finger now. Before its first sample the stream is
        taken to have rested there.
        """
        if not len(shear):
            return shear
        if self._past is None:
            self._past = np.repeat(shear[:1], self._filter.taps.shape[-1] - 1, axis=0)
        line = np.concatenate([self._past, shear])
        self._past = line[len(shear) :]
        maps = self._map(len(shear))
        if len(maps) == 1:
            return self._played(maps[0], line)
        place = np.interp(normal_force, self._forces, np.arange(len(self._forces)))
        volts = np.zeros_like(shear)
        for load in range(int(place.min()), min(int(place.max()) + 2, len(maps))):
            share = np.maximum(1 - np.abs(place - load), 0).astype(np.float32)
            volts += self._played(maps[load], line) * share[:, None]
        return volts

    def _played(self, maps: Singles, line: Singles) -> Singles:
        """Return Σ_r of each shared filter's output times the contactors' share of it."""
        volts = maps[0] @ line
        if self._plain:
            return np.asarray(volts)
        volts *= self._gain[0]
        for shared, gain in zip(maps[1:], self._gain[1:], strict=True):
            volts += (shared @ line) * gain
        return np.asarray(volts)
