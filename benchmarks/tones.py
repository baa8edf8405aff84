"""Tones that a program plays through JACK, and what an amplifier's record says of them.

Each of 24 channels has four tones, whose phase is a function of the number of the frame of JACK, so
that the time of every value is known. The tones are searched in the record by least squares at
their frequencies, which shares no code with the renderer. The response of the loaded contactor,
by which a drive becomes shear, is that of the display.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats, Singles
from tactile.bench.figures import RATE
from tactile.display.display import Display

JACK_RATE = 48_000
"""Sample rate of JACK [Hz]."""
CHANNELS, TONES = 24, 4
"""Number of channels, and of the tones of each."""
LOWEST, HIGHEST = 20.0, 1000.0
"""Lowest and highest frequency of a tone [Hz]."""
TONE_LEVEL = 0.03
"""Amplitude of a tone [full scale]: 0.3 µm where 10 µm are full scale."""
LONGEST_CYCLE = 8192
"""Largest number of frames of a cycle of JACK."""
LARGEST_SLIP = 2e-4
"""Difference of a step of JACK's times from the usual one from which on the clock is broken [s]; in
a clock that runs they differ by some microseconds."""
LEAST_STRETCH = 10.0
"""Least duration between two breaks for which a straight line is drawn through JACK's times [s]."""
LEAST_SHARE = 0.99
"""Share of a second that must have been put out for a fit."""
FIRST_GUESS = 0.02
"""Delay from which the true one is searched [s]."""
SPAN, GRID = 0.1, 2e-5
"""Range in which a delay is searched, and step of the search, a fiftieth of a period of the highest
tone [s]."""


def tone_frequencies() -> Floats:
    """Return the frequency of each tone, whole numbers that are all different (24, 4) [Hz].

    Those of one channel lie a third of the band, or a factor of 2, apart.
    """
    rising = list[float]()
    for wanted in np.rint(np.geomspace(LOWEST, HIGHEST, CHANNELS * TONES)):
        rising.append(max(float(wanted), rising[-1] + 1 if rising else LOWEST))
    return np.array(rising).reshape(TONES, CHANNELS).T


def tone_phasors() -> Complex:
    """Return the phasor of each tone at frame 0, of random phase (24, 4) [full scale]."""
    phase = np.random.default_rng(22).uniform(0, 2 * np.pi, (CHANNELS, TONES))
    return np.asarray(TONE_LEVEL * np.exp(1j * phase))


def tone_values(frames: Floats) -> Floats:
    """Compute the values of all channels.

    Parameters
    ----------
    frames : (S,) array of float
        Numbers of frames of JACK, which need not be whole.

    Returns
    -------
    (S, 24) array of float
        Values [full scale].
    """
    turns = tone_frequencies()[None] * (frames[:, None, None] / JACK_RATE)
    waves = tone_phasors() * np.exp(2j * np.pi * turns)
    return np.asarray(waves.real.sum(axis=2))


def tone_table() -> Singles:
    """Return a second of all channels, after which they repeat, and a cycle more (24, S)."""
    frames = np.arange(JACK_RATE + LONGEST_CYCLE, dtype=np.float64)
    return np.ascontiguousarray(tone_values(frames).T, np.float32)


@dataclass(frozen=True)
class FrameClock:
    """Times at which the frames of JACK begin, as JACK tells them.

    Attributes
    ----------
    frames : (K,) array of float
        Number of the first frame of each cycle, ascending.
    times : (K,) array of float
        Time of each on the monotonic clock [s].
    """

    frames: Floats
    times: Floats

    @classmethod
    def of(cls, rows: Floats) -> "FrameClock":
        """Create the clock from what a client logs in each cycle.

        Parameters
        ----------
        rows : (K, 5) array of float
            Number of the first frame, its time on JACK's clock [µs], and three readings in a row:
            of the monotonic clock [s], JACK's [µs], and the monotonic clock [s].

        Returns
        -------
        FrameClock
            Clock.
        """
        frames, begun, before, now, after = rows.T
        offset = (before + after) / 2 - 1e-6 * now
        # of each second the quickest, as one that is held up between readings tells nothing
        seconds = (before - before[0]).astype(np.int64)
        order = np.lexsort((after - before, seconds))
        best = order[np.unique(seconds[order], return_index=True)[1]]
        times = 1e-6 * begun + np.interp(before, before[best], offset[best])
        return cls(np.unwrap(frames, period=2.0**32), times)

    def at(self, times: Floats) -> Floats:
        """Return the number of the frame that begins at each time [s], with its fraction."""
        return np.interp(times, np.maximum.accumulate(self.times), self.frames)

    def breaks(self) -> Floats:
        """Return the times at which the steps of frames or times are not the usual ones (K,) [s].

        JACK was late then: it left a cycle out, or its clock began anew.
        """
        frames, times = np.diff(self.frames), np.diff(self.times)
        broken = (frames != np.median(frames)) | (np.abs(times - np.median(times)) > LARGEST_SLIP)
        return np.asarray(self.times[1:][broken])

    def wander(self, begin: float, end: float) -> Floats:
        """Return by how much JACK's times are off straight lines, by the second (K,).

        Parameters
        ----------
        begin, end : float
            Begin and end of the span [s].

        Returns
        -------
        (K,) array of float
            Mean of the times of each second, less the line through all times between two breaks;
            none for what is shorter than 10 s [s].
        """
        edges, parts = [begin, *self.breaks(), end], list[Floats]()
        for first, last in pairwise(sorted(np.clip(edges, begin, end))):
            inside = (self.times >= first) & (self.times < last)
            if last - first < LEAST_STRETCH or not inside.any():
                continue
            frames, times = self.frames[inside], self.times[inside] - first
            off = times - np.polynomial.Polynomial.fit(frames, times, 1)(frames)
            seconds = times.astype(np.int64)
            parts.append(np.bincount(seconds, off) / np.maximum(np.bincount(seconds), 1))
        return np.concatenate(parts) if parts else np.empty(0)


@dataclass(frozen=True)
class ToneFit:
    """Fit of the tones to a window of a record.

    Attributes
    ----------
    ratio : (24, 4) array of complex
        Phasor of each tone over that of the source, if the record is late by `assumed`.
    assumed : float
        Delay that was assumed [s].
    noise : float
        Largest share of a channel's power that is no tone.
    begin : float
        Time of the first sample [s].
    """

    ratio: Complex
    assumed: float
    noise: float
    begin: float

    @property
    def delay(self) -> float:
        """Delay that explains the phases best [s]."""
        return self.assumed + delay_of(self.ratio)

    def without(self, delay: float) -> Complex:
        """Return the ratios if the record is late by a delay.

        Parameters
        ----------
        delay : float
            Delay [s].

        Returns
        -------
        (24, 4) array of complex
            Ratios.
        """
        turns = tone_frequencies() * (delay - self.assumed)
        return np.asarray(self.ratio * np.exp(2j * np.pi * turns))


def fit_tones(
    clock: FrameClock, times: Floats, values: NDArray[Any], wanted: Complex, assumed: float
) -> ToneFit:
    """Fit the tones to a window of a record.

    Parameters
    ----------
    clock : FrameClock
        Times of the frames of JACK.
    times : (S,) array of float
        Time of each sample [s].
    values : (S, 24) array
        Samples, in any unit.
    wanted : (24, 4) array of complex
        Phasor of each tone at frame 0 that a true record has, in the same unit.
    assumed : float
        Delay of the record, to 0.1 s [s].

    Returns
    -------
    ToneFit
        Fit.
    """
    ratio, noise = np.empty((CHANNELS, TONES), np.complex128), 0.0
    turn = 2 * np.pi / JACK_RATE * clock.at(times - assumed)
    for channel, frequency in enumerate(tone_frequencies()):
        angle = turn[:, None] * frequency
        waves = np.hstack([np.cos(angle), -np.sin(angle), np.ones((len(turn), 1))])
        samples = values[:, channel].astype(np.float64)
        fit = np.linalg.lstsq(waves, samples, rcond=None)[0]
        ratio[channel] = (fit[:TONES] + 1j * fit[TONES:-1]) / wanted[channel]
        power = max(float(np.mean(samples**2)), 1e-30)
        noise = max(noise, float(np.mean((samples - waves @ fit) ** 2)) / power)
    return ToneFit(ratio, assumed, noise, float(times[0]))


def fit_seconds(
    clock: FrameClock, times: Floats, values: NDArray[Any], wanted: Complex
) -> list[ToneFit]:
    """Fit the tones to each whole second of a record, by arguments as of `fit_tones`.

    Parameters
    ----------
    clock : FrameClock
        Times of the frames of JACK.
    times : (S,) array of float
        Time of each sample [s].
    values : (S, 24) array
        Samples, in any unit.
    wanted : (24, 4) array of complex
        Phasor of each tone.

    Returns
    -------
    list of ToneFit
        Fits of the seconds that were put out in full, with the delay of the first one assumed.
    """
    if not len(times):
        return []
    edges = np.searchsorted(times, np.arange(times[0], times[-1], 1.0))
    parts = [slice(*edge) for edge in pairwise(edges.tolist())]
    full = [part for part in parts if part.stop - part.start > LEAST_SHARE * RATE]

    def fit(part: slice, assumed: float) -> ToneFit:
        return fit_tones(clock, times[part], values[part], wanted, assumed)

    assumed = fit(full[0], FIRST_GUESS).delay if full else FIRST_GUESS
    return [fit(part, assumed) for part in full]


def delay_of(ratio: Complex, span: float = SPAN) -> float:
    """Find the delay with which tones were played.

    Parameters
    ----------
    ratio : (24, 4) array of complex
        Phasor of each tone over that of the source.
    span : float
        Largest magnitude of the delay [s].

    Returns
    -------
    float
        Delay that leaves the least error of phase, where tones of a higher frequency count more
        [s].
    """
    turn = 2 * np.pi * tone_frequencies().ravel()
    size, delay = ratio.ravel(), 0.0
    tried = np.arange(-span, span + GRID / 2, GRID)
    likeness = np.concatenate([
        np.real(np.exp(1j * np.outer(part, turn)) @ size)
        for part in np.array_split(tried, len(tried) // 256 + 1)
    ])  # fmt: skip
    delay = float(tried[likeness.argmax()])
    for _ in range(3):
        phase = np.angle(size * np.exp(1j * turn * delay))
        delay -= float(np.sum(turn * phase) / np.sum(turn**2))
    return delay


def wanted_drive(display: Display, full_scale: float) -> Complex:
    """Return the phasor of each tone in a drive that gives the source's shear (24, 4) [V].

    Parameters
    ----------
    display : Display
        Display whose contactors the channels play on.
    full_scale : float
        Shear of a value of 1 [m].
    """
    response = np.array([
        display.responses(frequency, RATE)[0, kind]
        for frequency, kind in zip(tone_frequencies(), display.kind, strict=True)
    ])  # fmt: skip
    return np.asarray(full_scale * tone_phasors() / response * display.polarity[:, None])
