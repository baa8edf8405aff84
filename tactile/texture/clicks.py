"""Clicks in recordings: short events that stand out of the noise around them, and their removal.

Clicks are sought by matched filters for noise with the spectrum of the recording. What counts is
the height of a click over the noise within a few widths: an envelope that raises the noise raises
both. The width and shape are taken without whose clicks the least kurtosis remains.

A straight stroke that passes an event of peak A at a distance r meets the height A exp(−r²/2σ²).
Over a length, Σ heightᵏ/L is therefore λ⟨Aᵏ⟩ σ √(2π/k) for a density λ of events (Campbell's
theorem, as in `event_power`). The second power, the fourth, which makes the kurtosis, and the
number of clicks above the threshold determine the density and the log-normal peaks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import find_peaks
from scipy.special import ndtri

from tactile.arrays import Floats
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import Events
from tactile.texture.event_power import FWHM
from tactile.texture.measures import excess_kurtosis

Shape = Literal["pulse", "edge"]
"""Shape of an event in a texture file."""
WIDTHS = 0.1e-3 * 1.5 ** np.arange(6)
"""Full widths at half maximum that are tried, from the least of a texture file on [m]."""
PROMINENT = 6.0
"""Smallest height of a click over the standard deviation of the noise around it (see the tests for
its rate of false alarms)."""
AROUND = 12
"""Length in which the noise around a click is estimated, in widths."""
APART = 2
"""Smallest distance between two clicks that are removed at once, in widths."""
PASSES = 5
"""Number of times that clicks are sought in what is left after the stronger ones."""
FEWEST = 5
"""Smallest number of clicks from which their statistics are written (assumed)."""
SMALLEST, REMAINING = 0.5, 0.3
"""Smallest median excess kurtosis of strokes that have clicks, and largest share of it that may
remain without them. The highest peaks of noise under an envelope hold less than 0.7 of its kurtosis
(0.56–0.66 where the envelope is as fast as clicks are wide)."""
WIDEST = 0.5
"""Largest width of a click, in periods of the lowest band."""
ROUNDS = 2
"""Number of searches, each with the spectrum of the noise without the clicks of the one before. The
one that leaves the least kurtosis counts."""
SHAPES: tuple[Shape, ...] = ("pulse", "edge")
"""Shapes that are tried."""
SPREADS = np.linspace(0, 1, 41)
"""Standard deviations of the logarithm of the peaks that are tried (assumed)."""
NORMAL = ndtri((np.arange(400) + 0.5) / 400)
"""Quantiles of a standard normal distribution, to average over log-normal peaks."""


@dataclass(frozen=True)
class Clicks:
    """Clicks of strokes over one surface.

    Attributes
    ----------
    shape : str
        Shape, "pulse" or "edge".
    width : float
        Full width at half maximum [m].
    heights : tuple of (K,) array of float
        Peak displacements of the clicks of each of the R strokes, of either sign [m].
    least : (R,) array of float
        Height from which on clicks are seen in each stroke [m].
    length : (R,) array of float
        Length of each stroke [m].
    """

    shape: Shape
    width: float
    heights: tuple[Floats, ...]
    least: Floats
    length: Floats

    def part(self, rows: Sequence[int] | NDArray[np.intp]) -> "Clicks":
        """Select some of the strokes.

        Parameters
        ----------
        rows : sequence of int
            Indices of the strokes.

        Returns
        -------
        Clicks
            Their clicks.
        """
        heights = tuple(self.heights[k] for k in rows)
        return Clicks(self.shape, self.width, heights, self.least[rows], self.length[rows])

    def events(self, gain: Floats) -> Events | None:
        """Determine the events of a surface on which strokes meet such clicks.

        Parameters
        ----------
        gain : (R,) array of float
            Factor that brings each stroke to the reference speed and force.

        Returns
        -------
        Events or None
            Table of the texture file; None for fewer than `FEWEST` clicks.
        """
        heights = np.concatenate([h * g for h, g in zip(self.heights, gain, strict=True)])
        if len(heights) < FEWEST:
            return None
        sigma, length = self.width / FWHM, float(self.length.sum())
        second, fourth = np.sum(heights**2) / length, np.sum(heights**4) / length
        median = np.sqrt(np.sqrt(2) * fourth / second) * np.exp(-3 * SPREADS**2)
        density = second / (np.sqrt(np.pi) * sigma * median**2 * np.exp(2 * SPREADS**2))
        peaks = median[:, None] * np.exp(np.outer(SPREADS, NORMAL))
        reach = np.sqrt(2 * np.log(np.maximum(peaks / np.median(self.least * gain), 1)))
        count = density * length * 2 * sigma * reach.mean(axis=1)
        # More spread means smaller and more events. From some spread on, few of them are seen.
        best = int(np.argmax(count >= min(len(heights), count.max())))
        return Events(
            density_per_mm2=float(f"{min(density[best] * 1e-6, 4.0):.3g}"),
            amplitude_um=float(f"{min(median[best] * 1e6, 500.0):.3g}"),
            amplitude_sd=round(float(SPREADS[best]), 2),
            width_mm=round(self.width * 1e3, 3),
            shape=self.shape,
        )


def find_clicks(
    strokes: Sequence[Floats], step: float, center: Floats, groups: Sequence[Sequence[int]]
) -> tuple[Clicks | None, list[Floats]]:
    """Find the clicks of strokes, and remove them.

    Parameters
    ----------
    strokes : sequence of (S,) array of float
        Displacement of R strokes over one surface, without lines [m].
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].
    groups : sequence of sequence of int
        Indices of the strokes of each recording, which have one spectrum of noise.

    Returns
    -------
    clicks : Clicks or None
        Clicks of the shape and width without which the least kurtosis remains. None if there are
        fewer than `FEWEST`, or if more than `REMAINING` of the kurtosis remains.
    rest : list of (S,) array of float
        Strokes without them [m].
    """
    best: tuple[Clicks | None, list[Floats]] = None, list(strokes)
    peaked, rest = _kurtosis(strokes, step, center), best[1]
    widths = WIDTHS[WIDTHS * center[0] <= WIDEST]
    if peaked < SMALLEST or not len(widths):
        return best
    least = REMAINING * peaked
    for _ in range(ROUNDS):
        level = np.zeros((len(strokes), len(center)))
        for group in groups:
            level[group] = quiet_levels([rest[k] for k in group], step, center)
        clicks, rest = min(
            (
                _removed(strokes, step, center, level, shape, width)
                for shape in SHAPES
                for width in widths
            ),
            key=lambda removed: _kurtosis(removed[1], step, center),
        )
        remaining = _kurtosis(rest, step, center)
        if remaining <= least and sum(map(len, clicks.heights)) >= FEWEST:
            best, least = (clicks, rest), remaining
    return best


def _kurtosis(strokes: Sequence[Floats], step: float, center: Floats) -> float:
    """Return the median excess kurtosis of strokes; one that keeps a click would be the mean."""
    return float(np.median([excess_kurtosis(u, step, center=center) for u in strokes]))


def _removed(
    strokes: Sequence[Floats],
    step: float,
    center: Floats,
    level: Floats,
    shape: Shape,
    width: float,
) -> tuple[Clicks, list[Floats]]:
    """Return the clicks of one shape and width, and the strokes without them."""
    parts = [
        Matched(len(u), step, center, noise, shape, width).without_clicks(u)
        for u, noise in zip(strokes, level, strict=True)
    ]
    heights, seen, rest = zip(*parts, strict=True)
    length = np.array([len(u) * step for u in strokes])
    return Clicks(shape, width, heights, np.array(seen), length), list(rest)


def quiet_levels(strokes: Sequence[Floats], step: float, center: Floats) -> Floats:
    """Compute the levels of what lies between the clicks of strokes.

    The median of the squared magnitude of an analytic signal stands for its mean, of which it is
    ln 2 for normal noise; a few clicks hardly change it.

    Parameters
    ----------
    strokes : sequence of (S,) array of float
        Displacement of strokes with one spectrum [m].
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    (B,) array of float
        Levels of the noise [dB re 1 µm²·mm].
    """
    edges = third_octaves(center)
    power = np.zeros((len(strokes), len(center)))
    for row, stroke in zip(power, strokes, strict=True):
        spectrum, frequency = np.fft.rfft(stroke), np.fft.rfftfreq(len(stroke), step)
        for k in range(len(center)):
            inside = (frequency >= edges[k]) & (frequency < edges[k + 1])
            band = np.fft.ifft(np.where(inside, spectrum, 0), len(stroke))
            row[k] = 2 * np.median(np.abs(band) ** 2) / np.log(2)
    density = power.mean(axis=0) / np.diff(edges) * 1e15
    return np.asarray(10 * np.log10(np.maximum(density, 1e-30)))


class Matched:
    """Matched filter for clicks of one shape and width in noise of a known spectrum.

    Parameters
    ----------
    size : int
        Number of samples of the stroke.
    step : float
        Distance between samples [m].
    center : (B,) array of float
        Band centers [cycles/m].
    level : (B,) array of float
        Levels of the noise [dB re 1 µm²·mm].
    shape : str
        Shape, "pulse" or "edge".
    width : float
        Full width at half maximum [m].
    """

    def __init__(
        self, size: int, step: float, center: Floats, level: Floats, shape: Shape, width: float
    ) -> None:
        frequency = np.fft.rfftfreq(size, step)
        edges = third_octaves(center)
        inside = (frequency >= edges[0]) & (frequency <= edges[-1])
        log = np.log(np.where(inside, frequency, 1.0))
        noise = 10 ** (np.interp(log, np.log(center), level) / 10)
        place = (np.arange(size) - size // 2) * step * FWHM / width
        click = np.exp(-(place**2) / 2)
        if shape == "edge":
            click *= math.sqrt(math.e) * place
        self.click = np.roll(click, -(size // 2))
        spectrum = np.fft.rfft(self.click)
        weight = np.where(inside, spectrum.conj() / noise, 0)
        self._filter = weight * size / (2 * np.sum((weight * spectrum).real))
        self._spaced = max(round(width / 2 / step), 1)
        self._apart = round(APART * width / step)
        self._ends = round(AROUND * width / step / 2)

    def _heights(self, stroke: Floats) -> tuple[Floats, Floats]:
        """Return the height of a click at each place, and its standard deviation by noise [m]."""
        height = np.fft.irfft(self._filter * np.fft.rfft(stroke), len(stroke))
        sparse = np.abs(height[:: self._spaced])
        # The median of the magnitude of normal noise is 0.6745 of its standard deviation.
        local = median_filter(sparse, 2 * AROUND + 1, mode="reflect") / 0.6745
        place = np.arange(len(stroke))
        return height, np.interp(place, place[:: self._spaced], local)

    def _peaks(self, ratio: Floats) -> NDArray[np.intp]:
        """Return the places of clicks, away from the ends, where filters wrap around."""
        peaks, _ = find_peaks(ratio, height=PROMINENT, distance=self._apart)
        return peaks[(peaks >= self._ends) & (peaks < len(ratio) - self._ends)]

    def without_clicks(self, stroke: Floats) -> tuple[Floats, float, Floats]:
        """Find clicks and remove them.

        Parameters
        ----------
        stroke : (S,) array of float
            Displacement [m].

        Returns
        -------
        heights : (K,) array of float
            Peak displacements of the clicks [m].
        least : float
            Height from which on clicks are seen [m].
        rest : (S,) array of float
            Displacement without them [m].
        """
        heights, rest = [np.zeros(0)], stroke
        for _ in range(PASSES):
            height, noise = self._heights(rest)
            ratio = np.abs(height / noise)
            places = self._peaks(ratio)
            if not len(places):
                break
            train = np.zeros(len(stroke))
            train[places] = height[places]
            clicks = np.fft.rfft(train) * np.fft.rfft(self.click)
            rest = rest - np.fft.irfft(clicks, len(stroke))
            heights.append(height[places])
        return np.concatenate(heights), PROMINENT * float(np.median(noise)), rest
