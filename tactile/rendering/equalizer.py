"""Equalizer: the drive voltage that makes the skin follow a given shear over time.

The design takes a frequency response, an array of shear per volt, and knows nothing of beam or
finger, so that a measured response works as well as a modeled one. The inverse is exact wherever
full drive gives at least the smallest shear that anyone can feel. Elsewhere its magnitude is
bounded to the value at that limit, with the phase unchanged. What full drive attains is |response|
× voltage limit.

The inverse is played as an FIR filter of 32 taps, 1 ms late. A resonance of the bimorph is a zero
of its inverse, so that few taps suffice: in the band, and for the loaded bimorph, the filter is
within 0.04 dB and 0.25° of the inverse. Because it is a filter, it is as exact for a finger that
starts, stops and turns, for modulated amplitudes and for events as it is for steady strokes.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats, Singles

SMALLEST_SHEAR = 0.1e-6
"""Lowest detection threshold over frequency (250 Hz; Verrillo and Bolanowski) [m peak]."""
PASS_BAND = 1000.0
"""Frequency up to which shear is commanded in full [Hz]."""
STOP_BAND = 1250.0
"""Frequency from which on no shear is commanded [Hz]."""
FREE_BAND = 2000.0
"""Frequency from which on the filter's gain is held down [Hz]. Between `STOP_BAND` and here the
filter is almost unconstrained."""
STOP_WEIGHT, FREE_WEIGHT = 3e-3, 1e-4
"""Weights of the fit's errors above and below `FREE_BAND`, relative to errors in the band."""
LOWEST_RATE = 2 * STOP_BAND
"""Lowest sample rate that carries all that is commanded [Hz]."""
FITTED = 0.45
"""Fraction of a low sample rate up to which a filter is fitted: a real filter has no free phase at
half the sample rate."""
GRID = 10.0
"""Spacing of the frequencies at which the filter is fitted [Hz]."""
TAPS = (32, 64, 256)
"""Filter lengths to try, in this order [samples]."""
DELAYS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 176)
"""Filter delays to try, in this order [samples]. The first suffices for a bimorph, later ones serve
a response that has a delay of its own."""
TOLERANCE = 6e-3
"""Largest relative error in 10 … 1000 Hz at which the search ends: 0.05 dB, 0.35°."""
PIECE = 8
"""Number of samples that a matrix of `FollowingEqualizer` computes."""
NEGLIGIBLE = 1e-4
"""Smallest singular value, relative to the largest, for which contactors that differ get a further
shared filter."""


def roll_off(frequency: Floats) -> Floats:
    """Compute the weight that is applied to commanded shear.

    The weight is 1 up to 1000 Hz, 0 from 1250 Hz on, and half a cosine between.

    Parameters
    ----------
    frequency : (...) array of float
        Frequencies of either sign [Hz].

    Returns
    -------
    (...) array of float
        Weights, 0 … 1.
    """
    beyond = np.clip((np.abs(frequency) - PASS_BAND) / (STOP_BAND - PASS_BAND), 0, 1)
    return np.asarray((1 + np.cos(np.pi * beyond)) / 2)


def attainable(response: Complex, voltage: float | Floats) -> Floats:
    """Compute the peak shear that a sinusoid at the limits of the drive gives.

    Parameters
    ----------
    response : (..., F) array of complex
        Shear per volt [m/V].
    voltage : float or (F,) array of float
        Amplitude of the drive [V].

    Returns
    -------
    (..., F) array of float
        Peak shear [m].
    """
    return np.asarray(np.abs(response) * voltage)


def inverse(response: Complex, voltage: float) -> Complex:
    """Compute the bounded inverse of a response.

    Parameters
    ----------
    response : (..., F) array of complex
        Shear per volt, time dependence exp(+jωt) [m/V].
    voltage : float
        Voltage limit of the drive [V].

    Returns
    -------
    (..., F) array of complex
        Drive per shear [V/m]: 1/H where |H| × voltage is at least `SMALLEST_SHEAR`; elsewhere the
        magnitude at that bound with the phase of 1/H.
    """
    size = np.abs(response)
    floor = SMALLEST_SHEAR / voltage
    phase = np.conj(response) / np.where(size > 0, size, 1)
    return np.asarray(phase / np.maximum(size, floor))


def _turns(frequency: Floats, sample_rate: float, taps: int) -> Complex:
    """Return the phasors exp(−2πj f n/rate) of each frequency (F,) and tap (taps,)."""
    return np.asarray(np.exp(-2j * np.pi / sample_rate * np.outer(frequency, np.arange(taps))))


def fit_taps(gain: Complex, sample_rate: float, taps: int, delay: int) -> tuple[Floats, float]:
    """Fit FIR filters to gains that are to be reached with a given delay.

    The fit is a weighted least-squares solution over 0 … half the sample rate.

    Parameters
    ----------
    gain : (K, F) array of complex
        Gains at 0, 10, … `STOP_BAND` Hz [V/m].
    sample_rate : float
        Sample rate [Hz].
    taps : int
        Length of the filters [samples].
    delay : int
        Delay of the filters [samples].

    Returns
    -------
    taps : (K, taps) array of float
        Filter coefficients [V/m].
    error : float
        Largest relative error, as defined by `largest_error`.
    """
    f = np.arange(0, sample_rate / 2, GRID)
    band = min(gain.shape[1], int(FITTED * sample_rate / GRID) + 1)
    gain = gain[:, :band]
    late = np.exp(-2j * np.pi / sample_rate * f[:band] * delay)
    target = np.zeros((len(f), len(gain)), np.complex128)
    target[:band] = (gain * late).T
    weight = np.where(f < FREE_BAND, FREE_WEIGHT, STOP_WEIGHT)
    weight[:band] = 1.0
    left, right = _turns(f, sample_rate, taps) * weight[:, None], target * weight[:, None]
    fitted = np.linalg.lstsq(
        np.concatenate([left.real, left.imag]),
        np.concatenate([right.real, right.imag]),
        rcond=1e-12,
    )[0].T
    return fitted, largest_error(fitted, gain, sample_rate, delay)


def largest_error(taps: Floats, gain: Complex, sample_rate: float, delay: int) -> float:
    """Compute the largest |filter/gain − 1| in 10 … 1000 Hz.

    Parameters
    ----------
    taps : (K, T) array of float
        Filter coefficients [V/m].
    gain : (K, F) array of complex
        Gains at 0, 10, … `STOP_BAND` Hz [V/m].
    sample_rate : float
        Sample rate [Hz].
    delay : int
        Delay of the filters [samples].

    Returns
    -------
    float
        Largest relative error over all filters.
    """
    f = np.arange(0, sample_rate / 2, GRID)[: gain.shape[1]]
    band = (f >= GRID) & (f <= PASS_BAND)
    f, gain = f[band], gain[:, : len(f)][:, band]
    late = np.exp(-2j * np.pi / sample_rate * f * delay)
    reached = taps @ _turns(f, sample_rate, taps.shape[1]).T / (gain * late)
    return float(np.abs(reached - 1).max())


@dataclass(frozen=True)
class InverseFilter:
    """FIR inverse of amplifier and loaded bimorph, for every kind of contactor and finger force.

    Contactors that differ share a few filters: the taps of kind c are Σ_r mix[c, r] taps[l, r].

    Attributes
    ----------
    taps : (L, R, T) array of float
        Shared filters for L normal forces [V/m].
    mix : (C, R) array of float
        Weight of each shared filter for each kind of contactor.
    delay : int
        Delay of the filter [samples].
    error : float
        Largest |filter × response − 1| in 10 … 1000 Hz over kinds and forces.
    """

    taps: Floats
    mix: Floats
    delay: int
    error: float


def design(response: Complex, voltage: float, sample_rate: float) -> InverseFilter:
    """Design the FIR inverse of a set of responses.

    Filters are tried in the order of `TAPS` and `DELAYS`. One replaces the best so far only if it
    more than halves its error, and the search ends as soon as the best is within `TOLERANCE`.

    Parameters
    ----------
    response : (L, C, F) array of complex
        Shear per volt at 0, 10, … `STOP_BAND` Hz, for L normal forces and C kinds of contactors
        [m/V].
    voltage : float
        Voltage limit of the drive [V].
    sample_rate : float
        Sample rate [Hz].

    Returns
    -------
    InverseFilter
        Filters for all forces and kinds.
    """
    loads, kinds, _ = response.shape
    gain = inverse(response, voltage).reshape(loads * kinds, -1)
    best: tuple[float, Floats, int] | None = None
    for taps, delay in ((t, d) for t in TAPS for d in DELAYS if d < t):
        fitted, error = fit_taps(gain, sample_rate, taps, delay)
        if best is None or error < best[0] / 2:
            best = error, fitted, delay
        if best[0] <= TOLERANCE:
            break
    assert best is not None
    error, fitted, delay = best
    if kinds == 1:
        return InverseFilter(fitted.reshape(loads, 1, -1), np.ones((1, 1)), delay, error)
    rows = np.moveaxis(fitted.reshape(loads, kinds, -1), 1, 0).reshape(kinds, -1)
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    u, s, vt = np.linalg.svd(rows / size, full_matrices=False)
    terms = max(1, int(np.count_nonzero(s > NEGLIGIBLE * s[0])))
    mix, shared = size * u[:, :terms], s[:terms, None] * vt[:terms]
    restored = np.moveaxis((mix @ shared).reshape(kinds, loads, -1), 0, 1).reshape(fitted.shape)
    error = largest_error(restored, gain, sample_rate, delay)
    by_load = np.moveaxis(shared.reshape(terms, loads, -1), 0, 1)
    return InverseFilter(by_load, mix, delay, error)


class EqualizerLike(Protocol):
    """Conversion of a stream of shear to volts.

    Attributes
    ----------
    delay : int
        Delay from shear to volts [samples].
    """

    delay: int

    def __call__(self, shear: Singles, normal_force: Floats) -> Singles:
        """Convert the next samples.

        Parameters
        ----------
        shear : (S, N) array of float
            Shear that contactors are to give [m].
        normal_force : (S,) array of float
            Normal force of the finger [N].

        Returns
        -------
        (S, N) array of float
            Volts for the shear of ``delay`` samples ago [V].
        """


class Equalizer:
    """Runs an `InverseFilter` over a stream: shear in, volts out, ``delay`` samples later.

    Parameters
    ----------
    filter : InverseFilter
        Filter to run.
    kind : (N,) array of int
        Kind of each contactor, an index of the filter's kinds.
    polarity : (N,) array of float
        Polarity of each contactor, 1 or −1.
    forces : tuple of L floats
        Normal forces of the filter's first axis [N].

    Attributes
    ----------
    delay : int
        Delay from shear to volts [samples].
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
        self.delay = filter.delay
        gain = (filter.mix[kind] * polarity[:, None]).T
        self._gain, self._plain = gain.astype(np.float32), bool(np.all(gain == 1))
        self._past: Singles | None = None
        self._maps: dict[int, Singles] = {}

    def _map(self, count: int) -> Singles:
        """Return the filters as matrices (L, R, S, S + T − 1) that act on a piece of the stream."""
        if count not in self._maps:
            taps = self._filter.taps
            length = taps.shape[-1]
            matrices = np.zeros((*taps.shape[:2], count, count + length - 1), np.float32)
            for k in range(count):
                matrices[:, :, k, k : k + length] = taps[..., ::-1]
            self._maps[count] = matrices
        return self._maps[count]

    def __call__(self, shear: Singles, normal_force: Floats) -> Singles:
        """Return the volts (S, N) for shear (S, N) [m] that was commanded ``delay`` samples ago.

        ``normal_force`` (S,) [N] is the present force of the finger. Before its first sample the
        stream is taken to have rested at that sample's value.
        """
        if not len(shear):
            return shear
        if self._past is None:
            self._past = np.repeat(shear[:1], self._filter.taps.shape[-1] - 1, axis=0)
        line = np.concatenate([self._past, shear])
        self._past = line[len(shear) :]
        maps = self._map(len(shear))
        if len(maps) == 1:
            return self._apply(maps[0], line)
        position = np.interp(normal_force, self._forces, np.arange(len(self._forces)))
        volts = np.zeros_like(shear)
        for load in range(int(position.min()), min(int(position.max()) + 2, len(maps))):
            share = np.maximum(1 - np.abs(position - load), 0).astype(np.float32)
            volts += self._apply(maps[load], line) * share[:, None]
        return volts

    def _apply(self, maps: Singles, line: Singles) -> Singles:
        """Return Σ_r of each shared filter's output times each contactor's weight of it."""
        volts = maps[0] @ line
        if self._plain:
            return np.asarray(volts)
        volts *= self._gain[0]
        for shared, gain in zip(maps[1:], self._gain[1:], strict=True):
            volts += (shared @ line) * gain
        return np.asarray(volts)


class FollowingEqualizer:
    """Runs a filter for each contactor over a stream; the filters may be replaced while it runs.

    Parameters
    ----------
    taps : (N, T) array of float
        Filter of each contactor, its polarity included [V/m].
    """

    def __init__(self, taps: Floats) -> None:
        self._taps = self._next = taps
        self._maps = self._maps_before = _piece_maps(taps)
        self._past: Singles | None = None
        self._done = self._length = 0

    def replace(self, taps: Floats, samples: int) -> None:
        """Cross-fade to other filters from the next sample on.

        A cross-fade that is not over yet goes on from where it is. A sudden change would be felt
        as a click: from the low finger to the high one it leaves 1.8 µm in 200–1000 Hz beside 10 µm
        at 100 Hz, and 0.014 µm over 200 samples.

        Parameters
        ----------
        taps : (N, T) array of float
            Filter of each contactor [V/m].
        samples : int
            Length of the cross-fade, at least 1 [samples].

        Raises
        ------
        ValueError
            If the filters differ in number or length from those before.
        """
        if taps.shape != self._taps.shape:
            raise ValueError(f"taps of shape {taps.shape}: must be {self._taps.shape} as before")
        share = _cross_fade(self._done / self._length) if self._length else 1.0
        self._taps = self._taps + share * (self._next - self._taps)
        self._next, self._done, self._length = taps, 0, samples
        self._maps, self._maps_before = _piece_maps(self._next), _piece_maps(self._taps)

    def __call__(self, shear: Singles, normal_force: Floats) -> Singles:
        """Return the volts (S, N) for shear (S, N) [m]; the normal force has no part in it."""
        del normal_force
        if not len(shear):
            return shear
        if self._past is None:
            self._past = np.repeat(shear[:1], self._taps.shape[1] - 1, axis=0)
        line = np.concatenate([self._past, shear])
        self._past = line[len(shear) :]
        volts = _filtered(line, self._maps, len(shear))
        if self._done < self._length:
            way = np.arange(self._done + 1, self._done + len(shear) + 1) / self._length
            share = _cross_fade(np.minimum(way, 1)).astype(np.float32)[:, None]
            before = _filtered(line, self._maps_before, len(shear))
            volts = before + share * (volts - before)
            self._done = min(self._done + len(shear), self._length)
        return volts


def _cross_fade(way: Floats | float) -> Floats:
    """Return the share of the new filters after a part of a cross-fade, half a cosine."""
    return np.asarray((1 - np.cos(np.pi * np.asarray(way))) / 2)


def _piece_maps(taps: Floats) -> Singles:
    """Return filters (N, T) as matrices (N, T − 1 + `PIECE`, `PIECE`) that act on a piece."""
    contactors, length = taps.shape
    maps = np.zeros((contactors, length - 1 + PIECE, PIECE), np.float32)
    for k in range(PIECE):
        maps[:, k : k + length, k] = taps[:, ::-1]
    return maps


def _filtered(line: Singles, maps: Singles, count: int) -> Singles:
    """Return the last ``count`` samples of lines (T − 1 + count, N) through `_piece_maps`.

    Whole pieces as matrix products are four times as fast as one product for each tap.
    """
    pieces, span = -(-count // PIECE), maps.shape[1]
    rows = np.zeros((line.shape[1], span + (pieces - 1) * PIECE), np.float32)
    rows[:, : len(line)] = line.T
    row, sample = rows.strides
    windows = as_strided(rows, (len(rows), pieces, span), (row, PIECE * sample, sample))
    return np.asarray((windows @ maps).reshape(len(rows), -1).T[:count])
