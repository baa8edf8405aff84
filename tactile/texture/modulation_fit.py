"""Periodic envelopes of recordings: what ribs and dots do to fine vibration, and their removal.

Strokes are whitened over their bands, so that the envelope is that of all of them and not that of
the strongest one. Ribs are a line in the spectrum of the envelope over place, which recordings at
different speeds must share at one spatial frequency, as the lines of gratings (`lines`): a machine
that shakes the finger modulates it at one frequency in time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import median_filter
from scipy.signal import detrend, find_peaks, hilbert
from scipy.special import i0

from tactile.arrays import Floats
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import FEWEST_BANDS, Modulation
from tactile.texture.lines import (
    HARMONIC,
    PADDING,
    differ,
    fitted_harmonics,
    shared_lines,
    vertices,
)
from tactile.texture.measures import band_spectrum
from tactile.texture.surface import exponent_of_depth

CLEAR = 9.0
"""Smallest ratio of the power of a line of an envelope to the median power around it, over ln 2. A
share of 1e-4 of all bins of noise rises that far (e^−9), and two strokes with 400 bins each share
such a line once in 10⁴ times."""
HIGHEST = 800.0
"""Frequency up to which bands are used, the highest one of which a recording must be true (see
`CORE` of the fit) [Hz]."""
PERIODS = 10
"""Smallest number of periods of an envelope in a stroke (assumed)."""
FINEST = 1 / 8
"""Highest spatial frequency of an envelope, relative to the top of the bands in the fastest stroke.
An envelope must be slow beside the vibration that it modulates: at 0.11, a depth of 0.8 is measured
0.07 too small."""
LINE, AROUND = 3, 24
"""Half the width of a line, a little more than that under a Hann window, and half the width of its
surroundings [1/length of the stroke]."""
LONGEST, SHORTEST = 100e-3, 0.2e-3
"""Limits of the wavelength in a texture file [m]."""
SHALLOWEST = 0.2
"""Smallest depth that is written (assumed). Waves of a random envelope are shallower, as it is
rendered for an excess kurtosis of up to 3."""
COMPARABLE, MOST = 0.5, 2
"""Depth relative to that of the deepest line from which on a line counts, and largest number of
such lines. Ribs have one and dots may have two; the waves of a random envelope are many and alike.
"""


@dataclass(frozen=True)
class EnvelopeLine:
    """A periodic envelope that most strokes have.

    Attributes
    ----------
    frequency : float
        Spatial frequency [cycles/m].
    depths : (R,) array of float
        Amplitude of the envelope's fundamental ÷ its mean in each stroke.
    """

    frequency: float
    depths: Floats

    @property
    def modulation(self) -> Modulation:
        """Table of a texture file with the rms depth of the strokes, of 1 at most."""
        depth = float(np.sqrt(np.mean(self.depths**2)))
        return Modulation(
            wavelength_mm=float(f"{1e3 / self.frequency:.4g}"),
            depth=round(float(np.clip(depth, 0.01, 1.0)), 2),
        )


def whitened_envelope(stroke: Floats, step: float, speed: float, center: Floats) -> Floats:
    """Compute the envelope of a stroke whose bands are brought to one spectral density.

    Parameters
    ----------
    stroke : (S,) array of float
        Displacement at even steps of place, without lines and clicks [m].
    step : float
        Distance between samples [m].
    speed : float
        Mean speed [m/s].
    center : (B,) array of float
        Band centers [cycles/m]. Nothing is left outside of the bands, and above 800 Hz.

    Returns
    -------
    (S,) array of float
        Magnitude of the analytic signal over its mean, less 1. The mean is that under a Hann
        window, as which a spectrum under this window sees it.

    Raises
    ------
    InputError
        If the stroke cannot be measured, as in `band_spectrum`.
    """
    center = center[: max(np.count_nonzero(center * speed <= HIGHEST), FEWEST_BANDS)]
    level = band_spectrum(stroke, step, center=center)
    frequency, edges = np.fft.rfftfreq(len(stroke), step), third_octaves(center)
    inside = (frequency >= edges[0]) & (frequency <= edges[-1])
    log = np.log(np.where(inside, frequency, 1.0))
    gain = np.where(inside, 10 ** (-np.interp(log, np.log(center), level) / 20), 0)
    magnitude = np.abs(hilbert(np.fft.irfft(np.fft.rfft(detrend(stroke)) * gain, len(stroke))))
    return np.asarray(magnitude / np.average(magnitude, weights=np.hanning(len(stroke))) - 1)


def _relative_power(
    envelope: Floats, step: float, low: float, high: float
) -> tuple[Floats, Floats]:
    """Return frequencies [cycles/m], and the power of an envelope there relative to that around.

    Half as many frequencies as are searched lie beyond either end. The median of a periodogram of
    noise is ln 2 times its mean.
    """
    count = next_fast_len(PADDING * len(envelope), real=True)
    frequency = np.asarray(np.fft.rfftfreq(count, step), np.float64)
    inside = (frequency >= low / 2) & (frequency <= 1.5 * max(low, high))
    power = np.abs(np.fft.rfft(envelope * np.hanning(len(envelope)), count)[inside]) ** 2
    near, far = (round(width * count / len(envelope)) for width in (LINE, AROUND))
    around = np.abs(np.arange(-far, far + 1)) > near
    noise = median_filter(power, footprint=around, mode="reflect") / np.log(2)
    return frequency[inside], np.asarray(power / noise)


def find_modulations(
    strokes: Sequence[Floats], step: float, speed: Floats, center: Floats
) -> list[EnvelopeLine]:
    """Find the periodic envelopes that most strokes have.

    Parameters
    ----------
    strokes : sequence of (S,) array of float
        Displacement of R strokes over one surface, without lines and clicks [m].
    step : float
        Distance between samples [m].
    speed : (R,) array of float
        Speed of each stroke [m/s].
    center : (B,) array of float
        Band centers [cycles/m].

    Returns
    -------
    list of EnvelopeLine
        Periodic envelopes, deepest first, without their harmonics. The power of the noise around a
        line is subtracted. At a single speed there are none, because nothing tells ribs from a
        machine.
    """
    if not differ(speed):
        return []
    envelopes = [whitened_envelope(u, step, v, center) for u, v in zip(strokes, speed, strict=True)]
    lows = np.array([max(PERIODS / (len(u) * step), 1 / LONGEST) for u in strokes])
    high = min(FINEST * HIGHEST / float(speed.max()), 1 / SHORTEST)
    spectra = [_relative_power(e, step, low, high) for e, low in zip(envelopes, lows, strict=True)]
    places = []
    for low, (frequency, ratio) in zip(lows, spectra, strict=True):
        peaks, _ = find_peaks(ratio, height=CLEAR)
        peaks = peaks[(frequency[peaks] >= low) & (frequency[peaks] <= high)]
        places.append(vertices(frequency, ratio, peaks))

    def fitted(frequency: float) -> EnvelopeLine:
        tuned = [fitted_harmonics(e, step, frequency, (1,)) for e in envelopes]
        waves = np.array([np.abs(waves[0]) for _, waves in tuned])
        above = [np.interp(own, f, r) for (own, _), (f, r) in zip(tuned, spectra, strict=True)]
        depths = waves * np.sqrt(np.maximum(1 - 1 / np.array(above), 0))
        return EnvelopeLine(float(np.average([own for own, _ in tuned], weights=waves**2)), depths)

    lines = shared_lines(places, lows, speed)
    return _deepest(
        [fitted(n.frequency) for n in lines if differ(speed[list(n.strokes)]) and not n.is_hum]
    )


def _deepest(lines: list[EnvelopeLine]) -> list[EnvelopeLine]:
    """Return the lines that are not harmonics of deeper ones, unless they are a random envelope."""
    kept: list[EnvelopeLine] = []
    for line in sorted(lines, key=lambda line: -line.modulation.depth):
        order = [line.frequency / deeper.frequency for deeper in kept]
        if not any(r > 1.5 and abs(r / round(r) - 1) <= HARMONIC for r in order):
            kept.append(line)
    alike = [m for m in kept if m.modulation.depth >= COMPARABLE * kept[0].modulation.depth]
    return [m for m in alike if m.modulation.depth >= SHALLOWEST] if len(alike) <= MOST else []


def without_modulations(
    stroke: Floats,
    step: float,
    speed: float,
    center: Floats,
    modulations: Sequence[EnvelopeLine],
) -> Floats:
    """Divide a stroke by periodic envelopes, each at the place that fits this stroke best.

    Parameters
    ----------
    stroke : (S,) array of float
        Displacement at even steps of place [m].
    step : float
        Distance between samples [m].
    speed : float
        Mean speed [m/s].
    center : (B,) array of float
        Band centers [cycles/m].
    modulations : sequence of EnvelopeLine
        Periodic envelopes, by `find_modulations`.

    Returns
    -------
    (S,) array of float
        Displacement without the envelopes, which have a mean square of one as in a `Modulation`
        [m].
    """
    envelope = whitened_envelope(stroke, step, speed, center)
    place = 2 * np.pi * step * np.arange(len(stroke))
    rest = stroke
    for line in modulations:
        own, (wave,) = fitted_harmonics(envelope, step, line.frequency, (1,))
        turn = np.cos(own * place + np.angle(wave))
        amplitude = exponent_of_depth(line.modulation.depth)
        rest = rest * np.sqrt(i0(2 * amplitude)) * np.exp(-amplitude * turn)
    return rest
