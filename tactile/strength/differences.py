"""Differences between textures that a finger notices on a display, in just noticeable differences.

An `Impression` holds seven quantities of a steady stroke, in closed form from what the display
delivers below its limits. Each difference is divided by its just noticeable difference (JND):

| quantity | JND | source |
|---|---|---|
| level in P and in NP I, dB SL | `LEVEL_JND`, 2.5 dB | Israr, Tan & Reed 2006 |
| centroid of what is felt, Hz | `FREQUENCY_JND`, 25 % | Israr, Tan & Reed 2006 |
| swing of the level in P by the envelope, dB rms | `LEVEL_JND` | assumed |
| rate of that swing, Hz | 50 %, where both swings exceed `LEVEL_JND` | assumed |
| events that are felt, 1/s | counting error of 1 s and 25 %, at least one event | assumed |
| stretch by friction, dB SL | `LEVEL_JND` | assumed: a slow cycle is felt as a level |

**What is not felt makes no difference.** A level below threshold counts as threshold, also while it
swings, and so does stretch. What is below threshold has no centroid. Events are counted up to
`FASTEST_COUNT`.

**Stretch** stands for friction because a display plays friction as a small copy. A bare finger on a
glass plate with variable friction notices a change of the coefficient by about 18 % (Samur, Colgate
& Peshkin 2009), one on rubber with micropillars by as little as 20 % (Fehlberg et al. 2022). 2.5 dB
correspond to 33 %.

**Masking.** `LEVEL_JND` and `FREQUENCY_JND` hold for sinusoids at 20 dB SL that are felt alone. A
masked finger, beside other vibration, notices less: 3.63 dB and 60 % (`MASKED`). It probably also
notices less below 20 dB SL, where most shipped textures play at gain 1.

**Distance.** The distance is the largest single difference, not the Euclidean norm, which would
assume that a finger combines all seven. Two textures are distinct if it exceeds `DISTINCT` JND.
The spatial pattern under an array, the tone of a grating and bursts of single features are left
out, which makes the number smaller. Of the shipped textures at 80 mm/s and gain 1 on
`reference-24`, 13 are mutually distinct, 9 with the differences of a masked finger, and 13 or 18
with thresholds 5 dB higher or lower. With the largest gain of each, 17 are.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.special import ndtr

from tactile.display.display import Display
from tactile.strength.commanded import LineSpectrum, law_factor, random_lines
from tactile.strength.strength import Reach, SteadyStroke, reach
from tactile.texture import perception
from tactile.texture.descriptor import Events
from tactile.texture.perception import TouchChannel
from tactile.texture.surface import Texture

LEVEL_JND = 2.5
"""Just noticeable difference of a level [dB] (assumed, for about 20 dB SL: 1.82–2.98 dB at 20 dB SL
and 1.65–2.71 dB at 35 dB SL, for sinusoids without a masker; Israr, Tan & Reed, J. Acoust. Soc. Am.
120:2789, 2006)."""
FREQUENCY_JND = 0.25
"""Just noticeable relative difference of a frequency: the mean at 20 dB SL, of 0.13–0.38. At 35 dB
SL it is 0.18, of 0.14–0.28 (without a masker; Israr, Tan & Reed 2006)."""
RATE_FACTOR = 2.0
"""Ratio of the just noticeable difference of the rate of an envelope, which is random, to that of
the frequency of a tone (assumed)."""
FASTEST_SWING = 50.0
"""Corner frequency of the first-order low-pass with which a finger follows swings of a level [Hz]
(assumed)."""
SLOW = 1.0
"""Frequency of a stroke to and fro [Hz] (assumed): that of the cycle whose threshold stretch must
exceed, and of the slowest swing of a level that is noticed."""
COUNTED = 1.0
"""Time during which a finger counts events [s] (assumed)."""
FASTEST_COUNT = 8.0
"""Rate of events beyond which a finger counts no more of them [1/s] (assumed)."""
STANDS_OUT = 3.0
"""Peak of an event that is felt, in standard deviations of the rest (assumed): noise exceeds it in
0.3 % of the time."""
DISTINCT = 2.0
"""Distance beyond which two textures are distinct [JND]."""
DB = 20 / math.log(10)
"""Decibels per unit of the natural logarithm of an amplitude."""


@dataclass(frozen=True)
class Noticeable:
    """Just noticeable differences of a finger.

    Attributes
    ----------
    level : float
        Just noticeable difference of a level [dB].
    frequency : float
        Just noticeable relative difference of a frequency.
    """

    level: float = LEVEL_JND
    frequency: float = FREQUENCY_JND


ALONE = Noticeable()
"""Just noticeable differences of what is felt alone."""
MASKED = Noticeable(level=3.63, frequency=0.60)
"""Just noticeable differences beside one or two maskers: means at 20 dB SL (Israr, Tan & Reed
2006)."""


@dataclass(frozen=True)
class Impression:
    """Quantities by which a finger tells the stroke of a texture from that of another.

    Attributes
    ----------
    pacini : float
        Level in the Pacinian channel P, at least 0 [dB SL].
    meissner : float
        Level in the channel NP I, at least 0 [dB SL].
    centroid : float
        Geometric mean frequency of the bands above threshold, weighted by their power relative to
        threshold [Hz]; NaN if there is none.
    swing : float
        Standard deviation of the level in P, at least 0 dB SL at any time, that slow waves, bursts
        and ``[[modulation]]`` of the envelope cause, as far as a finger follows them [dB].
    swing_rate : float
        Mean frequency of these swings, weighted by their variance [Hz].
    events : float
        Rate of sparse events that are felt under a contactor, at most `FASTEST_COUNT` [1/s].
    stretch : float
        Level of the mean shear by friction against the motion, at least 0: that of a sinusoid of
        this peak and the frequency `SLOW` [dB SL].
    """

    pacini: float
    meissner: float
    centroid: float
    swing: float
    swing_rate: float
    events: float
    stretch: float


def impression(
    display: Display,
    texture: Texture,
    stroke: SteadyStroke | None = None,
    *,
    gain: float = 1.0,
    raised_db: float = 0.0,
) -> Impression:
    """Compute what a finger feels of a texture in a steady stroke.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.
    gain : float
        Gain of the texture. Friction has none.
    raised_db : float
        Amount by which all thresholds of the finger are higher than those of
        `tactile.texture.perception` [dB].

    Returns
    -------
    Impression
        Quantities of what is delivered below the limits of the display, friction's vibration left
        out.

    Examples
    --------
    >>> import tactile
    >>> from tactile.strength.differences import impression
    >>> display, oak = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> felt = impression(display, oak)
    >>> round(felt.pacini), felt.centroid > 150
    (19, True)
    """
    stroke, d = stroke or SteadyStroke(), texture.descriptor
    able = reach(display, stroke)
    # Only ratios to thresholds matter: raising these is reducing every displacement.
    reduced = 10 ** (-raised_db / 20)
    lines = able.delivered(stroke.lines(texture)).times(gain * reduced)
    smooth = replace(texture, descriptor=structs.replace(d, events=()))
    rest = able.delivered(stroke.lines(smooth)).times(gain * reduced)
    levels = perception.channel_sensation(lines.frequency, lines.power)
    factor = gain * reduced * law_factor(texture, stroke.speed, stroke.normal_force)
    events = sum(_felt_rate(kind, stroke.speed, factor, rest) for kind in d.events)
    swing, rate = _envelope(texture, stroke, able)
    stretch = reduced * stroke.friction(display, texture).drag
    least = float(perception.detection_threshold(np.array([SLOW]))[0])
    return Impression(
        pacini=max(levels["P"], 0.0),
        meissner=max(levels["NP I"], 0.0),
        centroid=_centroid(lines),
        swing=_felt_swing(levels["P"], swing),
        swing_rate=rate,
        events=min(events, FASTEST_COUNT),
        stretch=20 * math.log10(max(stretch / least, 1.0)),
    )


def _centroid(lines: LineSpectrum) -> float:
    """Return the geometric mean frequency of felt bands, weighted by power over threshold [Hz]."""
    levels = perception.band_sensation(lines.frequency, lines.power)
    weight = np.where(levels > 0, 10 ** (levels / 10), 0.0)
    if not weight.any():
        return math.nan
    return float(np.exp(weight @ np.log(perception.CENTERS) / weight.sum()))


def _felt_power(lines: LineSpectrum, channel: TouchChannel) -> float:
    """Return the power of lines relative to the threshold of a channel."""
    return float(np.sum(lines.power * 2 / channel.threshold(lines.frequency) ** 2))


def _envelope(texture: Texture, stroke: SteadyStroke, able: Reach) -> tuple[float, float]:
    """Return the swing of the level in P [dB] and its rate [Hz] that the envelope causes.

    A wave of amplitude a in the exponent of the envelope swings by 8.69 a/√2 dB rms, unless it is
    slower than `SLOW`, as one across the stroke is. Gratings and events do not swing; the part that
    they have in what is felt reduces it.
    """
    surface, velocity = texture.realize(), stroke.speed * stroke.direction
    rate = np.abs(surface.envelope.wave_vector @ velocity) / (2 * np.pi)
    noticed = (rate >= SLOW) / (1 + (rate / FASTEST_SWING) ** 2)
    variance = noticed * surface.envelope.amplitude**2 / 2
    if surface.density is None or not variance.any():
        return 0.0, 0.0
    factor = law_factor(texture, stroke.speed, stroke.normal_force)
    random = able.delivered(random_lines(surface.density, velocity)).times(factor)
    pacini = perception.TOUCH_CHANNELS["P"]
    whole = _felt_power(able.delivered(stroke.lines(texture)), pacini)
    share = min(_felt_power(random, pacini) / whole, 1.0) if whole else 0.0
    swing = DB * math.sqrt(variance.sum())
    return share * swing, float(variance @ rate / variance.sum())


def _felt_swing(level: float, swing: float) -> float:
    """Return the standard deviation of a swinging level where it counts as at least 0 dB SL [dB].

    The level x is taken as normal, as that of several waves nearly is. Its mean is less than
    ``level`` [dB SL], that of the mean power, by σ²/`DB` for the standard deviation σ, ``swing``.
    With a = mean/σ, E max(x, 0) = σ (a Φ(a) + φ(a)) and E max(x, 0)² = σ² ((a² + 1) Φ(a) + a φ(a)).
    """
    if swing == 0 or level == -math.inf:
        return 0.0
    a = (level - swing**2 / DB) / swing
    below, here = ndtr(a), math.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
    mean, square = a * below + here, (a**2 + 1) * below + a * here
    return swing * math.sqrt(max(square - mean**2, 0.0))


def _felt_rate(kind: Events, speed: float, factor: float, rest: LineSpectrum) -> float:
    """Return the rate of events of a kind that are felt under a contactor [1/s].

    An event passes under a contactor within half its width, and acts as a cycle of the frequency
    speed ÷ 2 width. It is felt if some channel feels it, above threshold and beyond `STANDS_OUT` of
    the rest, both in terms of the threshold of that channel; of log-normal amplitudes, the share
    above both limits counts.
    """
    width = kind.width_mm * 1e-3
    frequency = np.array([speed / (2 * width)])
    least = min(
        float(channel.threshold(frequency)[0])
        * max(1.0, STANDS_OUT * math.sqrt(_felt_power(rest, channel) / 2))
        for channel in perception.TOUCH_CHANNELS.values()
    )
    size = factor * kind.amplitude_um * 1e-6
    if size <= 0:
        return 0.0
    passing = kind.density_per_mm2 * 1e6 * width * speed
    if kind.amplitude_sd == 0:
        return passing * (size > least)
    return passing * math.erfc(math.log(least / size) / (kind.amplitude_sd * math.sqrt(2))) / 2


def quantity_differences(
    one: Impression, other: Impression, finger: Noticeable = ALONE
) -> dict[str, float]:
    """Compute by how much two textures differ in each quantity.

    Parameters
    ----------
    one, other : Impression
        Impressions of the same stroke on the same display.
    finger : Noticeable
        Just noticeable differences.

    Returns
    -------
    dict of str to float
        Difference by the name of the quantity, at least 0 [JND].
    """
    swings = min(one.swing, other.swing) > finger.level
    rate = _ratio(one.swing_rate, other.swing_rate, RATE_FACTOR * finger.frequency)
    total = (one.events + other.events) * COUNTED
    error = max(math.hypot(math.sqrt(total), finger.frequency * total / 2), 1.0)
    return {
        "pacini": abs(one.pacini - other.pacini) / finger.level,
        "meissner": abs(one.meissner - other.meissner) / finger.level,
        "centroid": _ratio(one.centroid, other.centroid, finger.frequency),
        "swing": abs(one.swing - other.swing) / finger.level,
        "swing_rate": rate if swings else 0.0,
        "events": abs(one.events - other.events) * COUNTED / error,
        "stretch": abs(one.stretch - other.stretch) / finger.level,
    }


def _ratio(one: float, other: float, jnd: float) -> float:
    """Return the number of relative JND between two values, 0 unless both are above 0."""
    return abs(math.log(one / other)) / math.log1p(jnd) if min(one, other) > 0 else 0.0


def distance(one: Impression, other: Impression, finger: Noticeable = ALONE) -> float:
    """Compute the distance between two textures, the largest of their `quantity_differences`.

    Parameters
    ----------
    one, other : Impression
        Impressions of the same stroke on the same display.
    finger : Noticeable
        Just noticeable differences.

    Returns
    -------
    float
        Distance [JND].
    """
    return max(quantity_differences(one, other, finger).values())


def most_distinct(felt: dict[str, Impression], finger: Noticeable = ALONE) -> list[str]:
    """Find a largest set of textures in which every two textures are distinct.

    Parameters
    ----------
    felt : dict of str to Impression
        Impression of the same stroke by the name of the texture.
    finger : Noticeable
        Just noticeable differences.

    Returns
    -------
    list of str
        Names of a largest set, of which there may be several.

    Examples
    --------
    >>> from tactile.strength.differences import Impression, most_distinct
    >>> felt = {str(db): Impression(db, 0, 200, 0, 0, 0, 0) for db in (0, 4, 8, 12)}
    >>> most_distinct(felt)
    ['0', '8']
    """
    names = sorted(felt)
    rows = [[distance(felt[a], felt[b], finger) for b in names] for a in names]
    return [names[i] for i in largest_clique(np.array(rows) > DISTINCT)]


def largest_clique(joined: NDArray[np.bool_]) -> list[int]:
    """Find a largest set of nodes that are all joined, by branch and bound with colors.

    Nodes of one color are not joined, so that a set has at most one of each (Tomita & Seki,
    "An Efficient Branch-and-Bound Algorithm for Finding a Maximum Clique", DMTCS 2003).

    Parameters
    ----------
    joined : (N, N) array of bool
        Symmetric matrix, false on its diagonal.

    Returns
    -------
    list of int
        Nodes in ascending order.
    """
    beside = [set(np.flatnonzero(row).tolist()) for row in joined]
    best: list[int] = []

    def grow(clique: list[int], left: set[int]) -> None:
        nonlocal best
        if len(clique) > len(best):
            best = clique
        for node, color in reversed(_colored(left, beside)):
            if len(clique) + color <= len(best):
                return
            grow([*clique, node], left & beside[node])
            left = left - {node}

    grow([], set(range(len(beside))))
    return sorted(best)


def _colored(nodes: set[int], beside: list[set[int]]) -> list[tuple[int, int]]:
    """Return nodes with colors from 1, ascending, none of a color joined to another of it."""
    order, color, left = [], 0, sorted(nodes, key=lambda node: -len(beside[node]))
    while left:
        color, free, rest = color + 1, set(nodes), []
        for node in left:
            if node in free:
                order.append((node, color))
                free -= beside[node]
            else:
                rest.append(node)
        left = rest
    return order
