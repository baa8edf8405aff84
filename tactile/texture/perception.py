"""Detection thresholds of vibration, four channels of touch, and sensation levels in dB SL.

A sinusoid at the detection threshold has the sensation level 0 dB SL, one of ten times that
amplitude 20 dB SL. The thresholds are those of vibration normal to the skin under a large
contactor, multiplied by `TANGENTIAL` since these displays shear the skin. Both are uncertain by
several decibels (`THRESHOLD_SPREAD_DB`, `TANGENTIAL`), so that levels compare textures and
displays better than they predict what one finger feels.

**Channels.** Four kinds of receptors respond, each in its own range, and the most sensitive one at
a frequency sets the threshold there (Bolanowski, Gescheider, Verrillo & Checkosky, J. Acoust. Soc.
Am. 84:1680, 1988). Three of the curves are therefore equal to the threshold where they are the
lowest, and are straight lines in dB per octave beyond. The fourth is never the lowest.
`TouchChannel.source` says which parts are published and which are assumed.

**Integration.** Within a band and within a channel, *powers relative to threshold* add up. A
channel has no narrower filters of its own (Schwendicke & Altinsoy, Vibration 3, 2020, found none in
P), and the roughness of fine surfaces goes with the power of skin vibration weighted by Pacinian
sensitivity (Bensmaïa & Hollins, Somatosens. Mot. Res. 20:33, 2003). Only bands above threshold are
counted, so that many imperceptible ones do not make a perceptible one. This is cautious, as the
energy of bands just below threshold may add up to something that is felt. Nothing is added between
channels: the strongest one represents the whole, as at threshold. Above threshold the second
strongest adds at most half as much again to the perceived intensity (Hollins & Roy, Somatosens.
Mot. Res. 13:273, 1996).

**Contact area.** P sums over space: its threshold falls by 3 dB per doubling of area from 0.02 to
2.9 cm² on the thenar, on the fingertip from 0.025 to 0.1 cm² and by less beyond (Verrillo 1963;
Gescheider, Bolanowski & Hardick 2002). The other channels do not. It is *assumed* that the
contactors of an array under one finger act as one large contactor, so that nothing is subtracted.
Where a single small contactor plays, levels in P are too high, by up to 20 dB for 0.015 cm².
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.texture.bands import nominal_centers, third_octaves

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
"""Detection threshold of motion normal to the skin under a large contactor [Hz, µm peak], with the
shape of Verrillo and Bolanowski.

It is interpolated linearly in the logarithms. Below 1 Hz it is held (NP III is flat there). Above
1 kHz it continues at its last slope, 22 dB per octave (assumed; 1–2 kHz is normally not felt:
Lamoré, Muijser & Keemink, J. Acoust. Soc. Am. 79:1082, 1986)."""
THRESHOLD_SPREAD_DB = 5.0
"""Uncertainty (±) of the detection threshold [dB]."""
TANGENTIAL = 0.45
"""Ratio of the tangential to the normal threshold at every frequency: the middle of 0.3 … 0.6,
which adds −3.5 … +2.5 dB to the spread. It was measured for slow displacements of a 1 mm probe well
above threshold (Biggs & Srinivasan 2002). That it holds at threshold and up to 1 kHz is assumed."""
MICRO = 1e-6
"""Meters per micrometer."""
CENTERS = 10 ** (np.arange(32) / 10)
"""Centers of the third octaves 1 … 1000 Hz and of the one above, in which commanded shear ends (IEC
61260) [Hz]."""
NOMINAL = nominal_centers(CENTERS)
"""Nominal centers of these third octaves, by which they are named [Hz]."""
EDGES = third_octaves(CENTERS)
"""Edges of the bands around `CENTERS` [Hz]."""


def _interpolated(frequency: Floats, knots: Floats) -> Floats:
    """Interpolate knots (K, 2) of Hz and µm in the logarithms and return the amplitude [m].

    Below the first knot the amplitude is held. Above the last one it continues at the last slope.
    """
    log_f, log_size = np.log(knots).T
    at = np.log(np.maximum(frequency, knots[0, 0]))
    slope = (log_size[-1] - log_size[-2]) / (log_f[-1] - log_f[-2])
    beyond = np.maximum(at - log_f[-1], 0)
    return np.asarray(MICRO * np.exp(np.interp(at, log_f, log_size) + slope * beyond))


def detection_threshold(frequency: Floats, factor: float = TANGENTIAL) -> Floats:
    """Compute the peak displacement that is just felt.

    Parameters
    ----------
    frequency : array of float
        Frequencies of any shape [Hz].
    factor : float
        Ratio to the threshold of motion normal to the skin. Use 1 for that threshold itself.

    Returns
    -------
    array of float
        Peak displacement at threshold, of the same shape [m].

    Examples
    --------
    Skin is most sensitive near 250 Hz, here in µm for motion normal to it:

    >>> import numpy as np
    >>> import tactile
    >>> threshold = tactile.detection_threshold(np.array([10.0, 250.0]), factor=1.0)
    >>> (threshold * 1e6).round(2).tolist()
    [8.91, 0.1]
    """
    return factor * _interpolated(np.asarray(frequency, np.float64), THRESHOLD)


def _threshold_knots(low: float, high: float) -> list[tuple[float, float]]:
    """Return the knots (Hz, µm) of the normal threshold from one frequency to another."""
    inside = [(f, s) for f, s in THRESHOLD.tolist() if low < f < high]
    ends = detection_threshold(np.array([low, high]), factor=1.0) / MICRO
    return [(low, float(ends[0])), *inside, (high, float(ends[1]))]


def _slope_knot(
    knot: tuple[float, float], frequency: float, db_per_octave: float
) -> tuple[float, float]:
    """Return the knot (Hz, µm) at a frequency on a straight line through another knot."""
    octaves = np.log2(frequency / knot[0])
    return frequency, float(knot[1] * 10 ** (db_per_octave * octaves / 20))


@dataclass(frozen=True)
class TouchChannel:
    """One of the four psychophysical channels of glabrous skin.

    Attributes
    ----------
    name : str
        Name of the channel in the literature.
    receptor : str
        Name of the end organ that the channel is attributed to.
    reaches : tuple of float
        Lowest and highest frequency at which the channel contributes (Bolanowski 1988) [Hz].
    knots : (K, 2) array of float
        Knots of the threshold of this channel for motion normal to the skin [Hz, µm peak],
        interpolated and continued as `THRESHOLD` is.
    source : str
        Sources of the parts of the curve, and which of them are assumed.
    """

    name: str
    receptor: str
    reaches: tuple[float, float]
    knots: Floats
    source: str

    def threshold(self, frequency: Floats, factor: float = TANGENTIAL) -> Floats:
        """Compute the peak displacement that this channel just feels.

        Parameters
        ----------
        frequency : array of float
            Frequencies of any shape [Hz].
        factor : float
            Ratio to the threshold of motion normal to the skin, as in `detection_threshold`.

        Returns
        -------
        array of float
            Peak displacement at threshold, of the same shape [m].
        """
        return factor * _interpolated(np.asarray(frequency, np.float64), self.knots)

    def selective_range_db(self, frequency: Floats) -> Floats:
        """Compute how far above the threshold of this channel the next one begins to respond.

        Below zero this channel cannot be excited alone, since another one feels the frequency
        first.

        Parameters
        ----------
        frequency : array of float
            Frequencies of any shape [Hz].

        Returns
        -------
        array of float
            Ratio of the lowest threshold of the other channels to that of this one [dB].
        """
        others = [c.threshold(frequency) for c in TOUCH_CHANNELS.values() if c is not self]
        return np.asarray(20 * np.log10(np.min(others, axis=0) / self.threshold(frequency)))


def _channels() -> tuple[TouchChannel, ...]:
    """Return the four channels. `TouchChannel.source` says where their curves come from."""
    merkel, meissner, pacini = (
        _threshold_knots(1.0, 4.0),
        _threshold_knots(4.0, 40.0),
        _threshold_knots(40.0, 1000.0),
    )
    ruffini = (250.0, 3.16)
    return (
        TouchChannel(
            "NP III", "Merkel", (0.4, 4.0),
            np.array([*merkel, _slope_knot(merkel[-1], 100.0, 0.0)]),
            "threshold below 4 Hz; above held at its value there (assumed)",
        ),
        TouchChannel(
            "NP I", "Meissner", (4.0, 40.0),
            np.array([
                _slope_knot(meissner[0], 1.0, -5.0), *meissner,
                _slope_knot(meissner[-1], 100.0, 0.0), (200.0, 4 * meissner[-1][1]),
            ]),
            "threshold in 4–40 Hz, which falls by 5 dB per octave; below on at that slope, above "
            "held to 100 Hz, then rising by 12 dB per octave (both assumed; RA units are most "
            "easily excited at 8–64 Hz: Johansson, Landström & Lundström, Brain Res. 244:17, 1982)",
        ),
        TouchChannel(
            "P", "Pacini", (40.0, 1000.0),
            np.array([_slope_knot(pacini[0], 1.0, -12.0), *pacini]),
            "threshold from 40 Hz; below on at 12 dB per octave, the slope of the published curve "
            "between 40 and 250 Hz",
        ),
        TouchChannel(
            "NP II", "Ruffini", (15.0, 400.0),
            np.array([_slope_knot(ruffini, 1.0, -5.0), ruffini, _slope_knot(ruffini, 400.0, 6.0)]),
            "range as published, at high level; that its curve is 10 dB re 1 µm at 250 Hz, falling "
            "to it by 5 and rising from it by 6 dB per octave is assumed",
        ),
    )  # fmt: skip


TOUCH_CHANNELS: dict[str, TouchChannel] = {channel.name: channel for channel in _channels()}
"""Channels by name, ordered from low to high frequencies except for NP II, which is the last."""


def band_sensation(frequency: Floats, power: Floats, channel: TouchChannel | None = None) -> Floats:
    """Compute the sensation level of each third octave of a displacement spectrum.

    Each line is weighted by the threshold at its own frequency. A sinusoid has the level 20
    log10(peak/threshold), and noise that of a sinusoid of the same power.

    Parameters
    ----------
    frequency : (K,) array of float
        Frequencies of the lines [Hz].
    power : (K,) array of float
        Mean square displacement of each line [m²]. For a power spectral density, this is its value
        times its resolution.
    channel : TouchChannel or None
        Channel whose threshold is used. None uses that of all channels together.

    Returns
    -------
    (32,) array of float
        Sensation level of the bands around `CENTERS` [dB SL], −inf for an empty band.
    """
    threshold = (detection_threshold if channel is None else channel.threshold)(frequency)
    relative_power = np.asarray(power) * 2 / threshold**2
    total = np.bincount(band_of(frequency), relative_power, len(CENTERS) + 1)[: len(CENTERS)]
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(total))


def band_of(frequency: Floats) -> NDArray[np.intp]:
    """Compute the index of the third octave that each frequency belongs to.

    Parameters
    ----------
    frequency : array of float
        Frequencies of any shape [Hz].

    Returns
    -------
    array of int
        Indices into `CENTERS`, of the same shape, and 32 for frequencies outside of all bands.
    """
    band = np.digitize(frequency, EDGES) - 1
    return np.where(band < 0, len(CENTERS), band)


def felt_level(levels: Floats) -> float:
    """Compute the sensation level of several bands together.

    Parameters
    ----------
    levels : array of float
        Sensation level of each band [dB SL].

    Returns
    -------
    float
        Power sum of the bands above threshold [dB SL]. If there is none, the level of the strongest
        band, which tells how much is missing.
    """
    strongest = float(np.max(levels, initial=-np.inf))
    if not strongest > 0:
        return strongest
    return float(10 * np.log10(np.sum(10 ** (levels[levels > 0] / 10))))


def channel_sensation(frequency: Floats, power: Floats) -> dict[str, float]:
    """Compute the sensation level of a displacement spectrum in each channel.

    Parameters
    ----------
    frequency : (K,) array of float
        Frequencies of the lines [Hz].
    power : (K,) array of float
        Mean square displacement of each line [m²], as in `band_sensation`.

    Returns
    -------
    dict of str to float
        Level by the name of the channel [dB SL].
    """
    return {
        name: felt_level(band_sensation(frequency, power, channel))
        for name, channel in TOUCH_CHANNELS.items()
    }


def strongest_channel(levels: dict[str, float]) -> str:
    """Return the channel with the highest level, which is the level of the whole.

    Parameters
    ----------
    levels : dict of str to float
        Level by the name of the channel [dB SL], as returned by `channel_sensation`.

    Returns
    -------
    str
        Name of the channel.
    """
    return max(levels, key=lambda name: levels[name])
