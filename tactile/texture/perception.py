"""What of a displacement is felt: detection thresholds, four channels of touch, levels in dB SL.

A sinusoid of just noticeable amplitude has the sensation level 0 dB SL; one of ten times that
amplitude 20 dB SL. Thresholds are those of vibration along the skin's normal under a large
contactor, times `TANGENTIAL`, since what these displays do is shear the skin. Both are uncertain by
several dB (`THRESHOLD_SPREAD_DB`, `TANGENTIAL_RANGE`): levels compare textures and displays better
than they foretell what one finger feels.

**Channels.** Four kinds of receptors answer, each in a range of its own, and the most sensitive one
at a frequency sets the threshold there (Bolanowski, Gescheider, Verrillo & Checkosky, J. Acoust.
Soc. Am. 84:1680, 1988). So three of the curves are the threshold itself where they are the lowest,
and straight lines in dB per octave beyond; the fourth is never the lowest. `TouchChannel.source`
says which parts are published and which assumed.

**Integration.** Within a band and within a channel *powers relative to threshold* add: a channel
has no narrower filters of its own (none found in P by Schwendicke & Altinsoy, Vibration 3, 2020),
and the roughness of fine surfaces goes with the power of skin vibration weighted by Pacinian
sensitivity (Bensmaïa & Hollins, Somatosens. Mot. Res. 20:33, 2003). Only bands above threshold are
counted, so that many inaudible ones do not make a felt one: cautious, as the energy of bands just
below may add up to something that is felt. Between channels nothing is added: the strongest stands
for the whole, as at threshold; above it the second strongest adds at most half as much again to
the perceived intensity (Hollins & Roy, Somatosens. Mot. Res. 13:273, 1996).

**Contact area.** P sums over space: its threshold falls by 3 dB per doubling of area from 0.02 to
2.9 cm² on the thenar, on the fingertip from 0.025 to 0.1 cm² and by less beyond (Verrillo 1963;
Gescheider, Bolanowski & Hardick 2002); the other channels do not. *Assumed*: the contactors of an
array under one finger act as one large contactor, so that nothing is subtracted. Where a single
small contactor plays, levels in P are too high, for 0.015 cm² by up to 20 dB.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.texture.bands import third_octaves

THRESHOLD = np.array(
    [
        (1.0, 25.1),
        (3.0, 22.4),
        (5.0, 15.8),
        (10.0, 8.91),
        (20.0, 5.01),
        (31.5, 3.35),
        (40.0, 2.82),
        (63.0, 1.5),
        (80.0, 0.891),
        (100.0, 0.562),
        (125.0, 0.355),
        (160.0, 0.2),
        (200.0, 0.126),
        (250.0, 0.1),
        (315.0, 0.1),
        (400.0, 0.158),
        (500.0, 0.316),
        (630.0, 0.668),
        (800.0, 1.58),
        (1000.0, 3.55),
    ]
)
"""Hz and µm peak at which a large contactor is just felt: shape of Verrillo and Bolanowski.

For motion along the normal. Between, straight in the logarithms; below 1 Hz held (NP III is flat
there), above 1 kHz on at the last slope, 22 dB per octave (assumed; 1–2 kHz is normally not felt:
Lamoré, Muijser & Keemink, J. Acoust. Soc. Am. 79:1082, 1986).
"""
THRESHOLD_SPREAD_DB = 5.0
TANGENTIAL = 0.45
"""Of the normal threshold, the tangential one at every frequency: the middle of `TANGENTIAL_RANGE`,
which adds −3.5 … +2.5 dB to the spread. It was measured for slow displacements of a 1 mm probe well
above threshold (Biggs & Srinivasan 2002); that it holds at threshold and to 1 kHz is assumed."""
TANGENTIAL_RANGE = (0.3, 0.6)
AMPLITUDE_JND_DB = (2.2, 2.5)
"""Just noticeable difference of amplitude (Israr & Tan 2006)."""
FREQUENCY_JND = (0.18, 0.25)
"""Just noticeable relative difference of frequency (Israr & Tan 2006)."""
MICRO = 1e-6
CENTERS = 10 ** (np.arange(32) / 10)
"""Hz: third octaves 1 … 1000 Hz and the one above, in which commanded shear ends (IEC 61260)."""
EDGES = third_octaves(CENTERS)


def _straight(frequency: Floats, knots: Floats) -> Floats:
    """Return knots (K, 2) of Hz and µm, on at their last slope and held below the first [m]."""
    log_f, log_size = np.log(knots).T
    at = np.log(np.maximum(frequency, knots[0, 0]))
    slope = (log_size[-1] - log_size[-2]) / (log_f[-1] - log_f[-2])
    beyond = np.maximum(at - log_f[-1], 0)
    return np.asarray(MICRO * np.exp(np.interp(at, log_f, log_size) + slope * beyond))


def detection_threshold(frequency: Floats, factor: float = TANGENTIAL) -> Floats:
    """Return the peak displacement [m] that is just felt.

    Parameters
    ----------
    frequency : any shape [Hz]
    factor : of the threshold for motion along the normal; 1 for that itself
    """
    return factor * _straight(np.asarray(frequency, np.float64), THRESHOLD)


def _taken(low: float, high: float) -> list[tuple[float, float]]:
    """Return the knots (Hz, µm) of the threshold from one frequency to another."""
    inside = [(f, s) for f, s in THRESHOLD.tolist() if low < f < high]
    ends = detection_threshold(np.array([low, high]), factor=1.0) / MICRO
    return [(low, float(ends[0])), *inside, (high, float(ends[1]))]


def _sloped(
    knot: tuple[float, float], frequency: float, db_per_octave: float
) -> tuple[float, float]:
    """Return the knot (Hz, µm) at a frequency on a straight line through another."""
    octaves = np.log2(frequency / knot[0])
    return frequency, float(knot[1] * 10 ** (db_per_octave * octaves / 20))


@dataclass(frozen=True)
class TouchChannel:
    """One of the four psychophysical channels of glabrous skin.

    Attributes
    ----------
    name : as in the literature
    receptor : whose end organ it is taken to be
    reaches : Hz, the range in which it takes part (Bolanowski 1988)
    knots : (K, 2) of its own threshold, Hz and µm peak along the normal; outside as in `THRESHOLD`
    source : of the curve's parts
    """

    name: str
    receptor: str
    reaches: tuple[float, float]
    knots: Floats
    source: str

    def threshold(self, frequency: Floats, factor: float = TANGENTIAL) -> Floats:
        """Return the peak displacement [m] that this channel just feels; as the whole's."""
        return factor * _straight(np.asarray(frequency, np.float64), self.knots)

    def selective_range_db(self, frequency: Floats) -> Floats:
        """Return how far above this channel's threshold the next one begins to feel [dB].

        Below zero it cannot be excited alone: another channel feels the frequency first.
        """
        others = [c.threshold(frequency) for c in TOUCH_CHANNELS.values() if c is not self]
        return np.asarray(20 * np.log10(np.min(others, axis=0) / self.threshold(frequency)))


def _channels() -> tuple[TouchChannel, ...]:
    """Return the four; see `TouchChannel.source`."""
    merkel, meissner, pacini = _taken(1.0, 4.0), _taken(4.0, 40.0), _taken(40.0, 1000.0)
    ruffini = (250.0, 3.16)
    return (
        TouchChannel(
            "NP III", "Merkel", (0.4, 4.0),
            np.array([*merkel, _sloped(merkel[-1], 100.0, 0.0)]),
            "threshold below 4 Hz; above held at its value there (assumed)",
        ),
        TouchChannel(
            "NP I", "Meissner", (4.0, 40.0),
            np.array([
                _sloped(meissner[0], 1.0, -5.0), *meissner,
                _sloped(meissner[-1], 100.0, 0.0), (200.0, 4 * meissner[-1][1]),
            ]),
            "threshold in 4–40 Hz, which falls by 5 dB per octave; below on at that slope, above "
            "held to 100 Hz, then rising by 12 dB per octave (both assumed; RA units are most "
            "easily excited at 8–64 Hz: Johansson, Landström & Lundström, Brain Res. 244:17, 1982)",
        ),
        TouchChannel(
            "P", "Pacini", (40.0, 1000.0),
            np.array([_sloped(pacini[0], 1.0, -12.0), *pacini]),
            "threshold from 40 Hz; below on at 12 dB per octave, the slope of the published curve "
            "between 40 and 250 Hz",
        ),
        TouchChannel(
            "NP II", "Ruffini", (15.0, 400.0),
            np.array([_sloped(ruffini, 1.0, -5.0), ruffini, _sloped(ruffini, 400.0, 6.0)]),
            "range as published, at high level; that its curve is 10 dB re 1 µm at 250 Hz, falling "
            "to it by 5 and rising from it by 6 dB per octave is assumed",
        ),
    )  # fmt: skip


TOUCH_CHANNELS: dict[str, TouchChannel] = {channel.name: channel for channel in _channels()}
"""By name, from low frequencies to high."""


def band_sensation(frequency: Floats, power: Floats, channel: TouchChannel | None = None) -> Floats:
    """Return the level of each third octave of a displacement spectrum.

    Parameters
    ----------
    frequency, power : (K,) [Hz] and mean square [m²] of lines; for a power spectral density, its
        value times its resolution
    channel : whose threshold to take; the whole's, if None

    Returns
    -------
    (32,) ndarray
        dB SL of the bands around `CENTERS`, −inf where nothing is. Each line is weighted at its own
        frequency: a sinusoid has 20 log10(peak/threshold), noise what a sinusoid of its power has.
    """
    limit = (detection_threshold if channel is None else channel.threshold)(frequency)
    felt = np.asarray(power) * 2 / limit**2
    total = np.bincount(band_of(frequency), felt, len(CENTERS) + 1)[: len(CENTERS)]
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(total))


def band_of(frequency: Floats) -> NDArray[np.intp]:
    """Return the index of each frequency's third octave; 32 for those in none."""
    band = np.digitize(frequency, EDGES) - 1
    return np.where(band < 0, len(CENTERS), band)


def felt_level(levels: Floats) -> float:
    """Return the level of bands together [dB SL]: the power sum of those above threshold.

    Where none is, that of the strongest, so that it is told how much is missing.
    """
    strongest = float(np.max(levels, initial=-np.inf))
    if not strongest > 0:
        return strongest
    return float(10 * np.log10(np.sum(10 ** (levels[levels > 0] / 10))))


def channel_sensation(frequency: Floats, power: Floats) -> dict[str, float]:
    """Return the level that each channel feels of a spectrum, as of `band_sensation` [dB SL]."""
    return {
        name: felt_level(band_sensation(frequency, power, channel))
        for name, channel in TOUCH_CHANNELS.items()
    }


def strongest_channel(levels: dict[str, float]) -> str:
    """Return the channel that feels most: its level is that of the whole."""
    return max(levels, key=lambda name: levels[name])
