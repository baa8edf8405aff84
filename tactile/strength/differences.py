"""Differences between textures that a finger notices on a display, in just noticeable differences.

An `Impression` holds seven quantities of a steady stroke, in closed form from what the display
delivers below its limits. Each difference is divided by its just noticeable difference (JND):

| quantity | JND | source |
|---|---|---|
| level in P and in NP I, dB SL | `LEVEL_JND`, 2.35 dB | 2.2–2.5 dB (Israr & Tan 2006) |
| centroid of what is felt, Hz | `FREQUENCY_JND`, 25 % | 18–25 % (Israr & Tan 2006) |
| swing of the level in P by the envelope, dB rms | `LEVEL_JND` | assumed: less is no change |
| rate of that swing, Hz | `RATE_JND`, 50 % | assumed: twice that of a tone, as it is noise |
| events that are felt, 1/s | counting error of 1 s and 25 % | assumed, as `FREQUENCY_JND` |
| stretch by friction, m | `LEVEL_JND` | assumed: a step of shear, felt as its size |

The amplitude of stretch stands for friction because a display plays friction as a small copy. Under
a finger on a real surface, 18 % of the coefficient are noticed (Samur, Colgate & Peshkin 2009),
less than the 31 % that 2.35 dB are. A level below threshold counts as threshold, and what cannot be
felt has no centroid, swing or rate, so that only what is felt makes a difference.

**Distance.** The distance is the largest single difference, not the Euclidean norm, which would
count on a finger that combines all seven. Two textures are distinct if it exceeds `DISTINCT` JND.
Thresholds are uncertain by ± 5 dB and depend on the finger; they shift all levels alike, which
moves the number of distinct textures less than the levels. The spatial pattern under an array, the
tone of a grating and bursts of single features are left out, which makes the number smaller.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from tactile.display.display import Display
from tactile.strength.commanded import LineSpectrum, law_factor, random_lines
from tactile.strength.strength import Reach, SteadyStroke, reach
from tactile.texture import perception
from tactile.texture.descriptor import Events
from tactile.texture.perception import TouchChannel
from tactile.texture.surface import Texture

LEVEL_JND = 2.35
"""Just noticeable difference of a level [dB]: the middle of 2.2–2.5 dB (Israr & Tan 2006)."""
FREQUENCY_JND = 0.25
"""Just noticeable relative difference of a frequency: the upper end of 0.18–0.25 (Israr & Tan
2006)."""
RATE_JND = 0.5
"""Just noticeable relative difference of the rate of an envelope, which is random (assumed)."""
FASTEST_SWING = 50.0
"""Rate from which on a finger follows swings of a level less and less, as a low-pass of first order
does [Hz] (assumed)."""
COUNTED = 1.0
"""Time during which a finger counts events [s] (assumed)."""
STANDS_OUT = 3.0
"""Peak of an event that is felt, in standard deviations of the rest (assumed): noise exceeds it in
0.3 % of the time."""
DISTINCT = 2.0
"""Distance beyond which two textures are distinct [JND]."""


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
        Standard deviation of the level in P that slow waves, bursts and ``[[modulation]]`` of the
        envelope cause, as far as a finger follows them [dB].
    swing_rate : float
        Mean frequency of these swings, weighted by their variance [Hz].
    events : float
        Rate of sparse events that are felt under a contactor [1/s].
    stretch : float
        Mean shear by friction against the motion [m].
    """

    pacini: float
    meissner: float
    centroid: float
    swing: float
    swing_rate: float
    events: float
    stretch: float


def impression(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None, *, gain: float = 1.0
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
    lines = able.delivered(stroke.lines(texture)).times(gain)
    smooth = replace(texture, descriptor=structs.replace(d, events=()))
    rest = able.delivered(stroke.lines(smooth)).times(gain)
    levels = perception.channel_sensation(lines.frequency, lines.power)
    factor = gain * law_factor(texture, stroke.speed, stroke.normal_force)
    swing, rate = _envelope(texture, stroke, able)
    return Impression(
        pacini=max(levels["P"], 0.0),
        meissner=max(levels["NP I"], 0.0),
        centroid=_centroid(lines),
        swing=swing if levels["P"] > 0 else 0.0,
        swing_rate=rate,
        events=sum(_felt_rate(kind, stroke.speed, factor, rest) for kind in d.events),
        stretch=stroke.friction(display, texture).drag,
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

    A wave of amplitude a in the exponent of the envelope swings by 8.69 a/√2 dB rms. Gratings and
    events do not swing; the part that they have in what is felt reduces it.
    """
    surface, velocity = texture.realize(), stroke.speed * stroke.direction
    rate = np.abs(surface.envelope.wave_vector @ velocity) / (2 * np.pi)
    variance = surface.envelope.amplitude**2 / 2 / (1 + (rate / FASTEST_SWING) ** 2)
    if surface.density is None or not variance.any():
        return 0.0, 0.0
    factor = law_factor(texture, stroke.speed, stroke.normal_force)
    random = able.delivered(random_lines(surface.density, velocity)).times(factor)
    pacini = perception.TOUCH_CHANNELS["P"]
    whole = _felt_power(able.delivered(stroke.lines(texture)), pacini)
    share = min(_felt_power(random, pacini) / whole, 1.0) if whole else 0.0
    swing = 20 / math.log(10) * math.sqrt(variance.sum())
    return share * swing, float(variance @ rate / variance.sum())


def _felt_rate(kind: Events, speed: float, factor: float, rest: LineSpectrum) -> float:
    """Return the rate of events of a kind that are felt under a contactor [1/s].

    An event passes under a contactor within half its width, and acts as a cycle of the frequency
    speed ÷ 2 width. It is felt if some channel feels it, above threshold and beyond `STANDS_OUT` of
    the rest, both in terms of the threshold of that channel; log-normal amplitudes are so to a
    share.
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


def quantity_differences(one: Impression, other: Impression) -> dict[str, float]:
    """Compute by how much two textures differ in each quantity.

    Parameters
    ----------
    one, other : Impression
        Impressions of the same stroke on the same display.

    Returns
    -------
    dict of str to float
        Difference by the name of the quantity, at least 0 [JND].
    """
    swings = min(one.swing, other.swing) > LEVEL_JND
    total, weber = one.events + other.events, FREQUENCY_JND * (one.events + other.events) / 2
    count = abs(one.events - other.events) * COUNTED
    return {
        "pacini": abs(one.pacini - other.pacini) / LEVEL_JND,
        "meissner": abs(one.meissner - other.meissner) / LEVEL_JND,
        "centroid": _ratio(one.centroid, other.centroid, FREQUENCY_JND),
        "swing": abs(one.swing - other.swing) / LEVEL_JND,
        "swing_rate": _ratio(one.swing_rate, other.swing_rate, RATE_JND) if swings else 0.0,
        "events": count / max(math.hypot(math.sqrt(total * COUNTED), weber * COUNTED), 1.0),
        "stretch": _ratio(one.stretch, other.stretch, 10 ** (LEVEL_JND / 20) - 1),
    }


def _ratio(one: float, other: float, jnd: float) -> float:
    """Return the number of relative JND between two values, 0 unless both are above 0."""
    return abs(math.log(one / other)) / math.log1p(jnd) if min(one, other) > 0 else 0.0


def distance(one: Impression, other: Impression) -> float:
    """Compute the distance between two textures, the largest of their `quantity_differences`.

    Parameters
    ----------
    one, other : Impression
        Impressions of the same stroke on the same display.

    Returns
    -------
    float
        Distance [JND].
    """
    return max(quantity_differences(one, other).values())


def most_distinct(felt: dict[str, Impression]) -> list[str]:
    """Find a largest set of textures each two of which are distinct.

    Parameters
    ----------
    felt : dict of str to Impression
        Impression of the same stroke by the name of the texture.

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
    apart = np.array([[distance(felt[a], felt[b]) > DISTINCT for b in names] for a in names])
    return [names[i] for i in largest_clique(apart)]


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
