"""Figures of the shear of a stroke, which every command gives alike.

The *vibration* is the root mean square of the shear over contactors and time, from 20 to 1000 Hz.
The *drag* is the mean of the shear along each contactor's axis against the motion of the finger,
which is what friction commands in a steady stroke. The *peak* is the largest magnitude of the shear
at any contactor. The *sensation level* is that of the third octave that is farthest above the
detection threshold, or least below it, from the mean spectrum of all contactors
(`tactile.texture.perception`). A finger at rest drags nothing.

Vibration, drag and sensation level hold for the steady part of a stroke. Its beginning is left out
until the finger has moved by `ONSET`, in which friction builds up, and so are the ramps at both
ends; the peak is that of the whole stroke. `StrokeMeter` measures the figures while a stroke is
played, `tactile.strength.strength` predicts them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import ellip, periodogram, sosfilt, sosfilt_zi

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.texture import perception

VIBRATION_BAND = (20.0, 1000.0)
"""Lowest and highest frequency of what counts as vibration [Hz]."""
ONSET = 5e-3
"""Way of the finger after which friction counts as steady [m]: five times the way in which the
stretch of a coefficient of 1 builds up (`tactile.rendering.skin_stretch.GIVE`)."""
ORDER, RIPPLE, REJECTION = 10, 0.01, 40.0
"""Order of each edge of the elliptic filter that measures vibration, its ripple and its rejection
[dB]: 15 Hz and 1050 Hz are 40 dB below what passes."""
SEGMENT = 0.5
"""Duration of the segments of which spectra are averaged, half overlapping [s]. Their lines are 2
Hz apart."""
SHORTEST = 0.02
"""Shortest steady part that is measured [s]; a tap of an effect lasts 22 ms."""
STILL = 1e-12
"""Way from sample to sample below which a finger is at rest [m]."""
ACROSS = 1e-6
"""Cosine below which a contactor's axis counts as across the motion."""
MICRO = 1e6
"""Micrometers per meter."""


@dataclass(frozen=True)
class ShearFigures:
    """Figures of commanded or of played shear.

    Attributes
    ----------
    vibration_um_rms : float
        Vibration, 20–1000 Hz [µm rms].
    drag_um : float
        Drag [µm].
    level_db_sl : float or None
        Sensation level of the strongest third octave [dB SL]; None if there is no vibration.
    level_hz : float or None
        Nominal center of that third octave [Hz].
    peak_um : float or None
        Peak of the shear [µm]; None if no stroke was rendered.
    """

    vibration_um_rms: float
    drag_um: float
    level_db_sl: float | None
    level_hz: float | None
    peak_um: float | None = None

    @property
    def sensation(self) -> str:
        """Whether the shear is felt, and how far it is from the detection threshold."""
        if self.level_db_sl is None:
            return "not felt: no vibration"
        where = "above" if self.level_db_sl > 0 else "below"
        felt = "felt" if self.level_db_sl > 0 else "not felt"
        return f"{felt}: {abs(self.level_db_sl):.0f} dB {where} threshold at {self.level_hz:g} Hz"


def shear_figures(
    frequency: Floats, power: Floats, *, drag: float, peak: float | None = None
) -> ShearFigures:
    """Compute the figures of a shear from its spectrum.

    Parameters
    ----------
    frequency : (K,) array of float
        Frequencies of the lines [Hz].
    power : (K,) array of float
        Mean square of each line, as a mean over contactors [m²].
    drag : float
        Drag [m].
    peak : float or None
        Peak [m].

    Returns
    -------
    ShearFigures
        Figures of the shear.
    """
    low, high = VIBRATION_BAND
    inside = (frequency >= low) & (frequency <= high)
    level = perception.band_sensation(frequency, power)
    strongest = int(np.argmax(level))
    felt = np.isfinite(level[strongest])
    return ShearFigures(
        vibration_um_rms=MICRO * float(np.sqrt(power[inside].sum())),
        drag_um=MICRO * drag,
        level_db_sl=float(level[strongest]) if felt else None,
        level_hz=float(perception.NOMINAL[strongest]) if felt else None,
        peak_um=None if peak is None else MICRO * peak,
    )


def figure_rows(commanded: ShearFigures, played: ShearFigures | None) -> dict[str, str]:
    """Describe the figures of a stroke.

    Parameters
    ----------
    commanded : ShearFigures
        Figures of the commanded shear.
    played : ShearFigures or None
        Figures of the played shear; None if it is not known.

    Returns
    -------
    dict of str to str
        Text by the name of the figure. The sensation level is that of the played shear if it is
        known.
    """

    def both(name: str, unit: str) -> str:
        text = f"{getattr(commanded, name):.2f} {unit} commanded"
        return text if played is None else f"{text}, {getattr(played, name):.2f} {unit} played"

    rows = {
        "vibration": f"{both('vibration_um_rms', 'µm rms')}, 20–1000 Hz",
        "drag": both("drag_um", "µm"),
        "peak": both("peak_um", "µm") if commanded.peak_um is not None else "",
        "sensation": (played or commanded).sensation,
    }
    return {name: text for name, text in rows.items() if text}


def drag_signs(motion: Floats, axes: Floats) -> Floats:
    """Return the sign that shear against the motion has along each contactor's axis.

    Parameters
    ----------
    motion : (S, 2) array of float
        Motion of the finger from sample to sample [m].
    axes : (N, 2) array of float
        Unit vectors of the contactors' axes.

    Returns
    -------
    (S, N) array of float
        Signs; 0 for an axis across the motion, and for a finger at rest.
    """
    along = motion @ axes.T
    least = np.maximum(ACROSS * np.hypot(*motion.T), STILL)[:, None]
    return np.where(np.abs(along) > least, -np.sign(along), 0.0)


class PowerSpectrum:
    """Running mean of the power spectrum of several channels (Welch's method).

    Parameters
    ----------
    sample_rate : float
        Sample rate [Hz].
    channels : int
        Number of channels N.
    """

    def __init__(self, sample_rate: float, channels: int) -> None:
        self._rate = sample_rate
        self._segment = np.empty((round(SEGMENT * sample_rate), channels))
        self._filled = self._segments = 0
        self._frequency, self._power = np.zeros(0), np.zeros(0)

    def add(self, shear: Floats) -> None:
        """Add samples.

        Parameters
        ----------
        shear : (S, N) array of float
            Shear [m].
        """
        size = len(self._segment)
        while len(shear):
            part = shear[: size - self._filled]
            self._segment[self._filled : self._filled + len(part)] = part
            self._filled += len(part)
            shear = shear[len(part) :]
            if self._filled == size:
                self._frequency, power = self._lines_of(self._segment)
                self._power = power + self._power if self._segments else power
                self._segments += 1
                self._filled = size - size // 2
                self._segment[: self._filled] = self._segment[size // 2 :].copy()

    def lines(self) -> tuple[Floats, Floats] | None:
        """Return the spectrum so far, as a mean over channels and without that of the mean shear.

        Samples that are fewer than a segment are one segment.

        Returns
        -------
        frequency : (K,) array of float
            Frequencies of the lines [Hz].
        power : (K,) array of float
            Mean square of each line [m²]. Both are missing (None) for less than `SHORTEST`.
        """
        if self._segments:
            return self._frequency, self._power / self._segments
        if self._filled < SHORTEST * self._rate:
            return None
        return self._lines_of(self._segment[: self._filled])

    def _lines_of(self, segment: Floats) -> tuple[Floats, Floats]:
        """Return frequencies [Hz] and powers [m²] of a segment, as a mean over channels."""
        frequency, density = periodogram(segment, self._rate, window="hann", axis=0)
        return frequency[1:], np.asarray(density[1:].mean(axis=1) * frequency[1])


class BandPower:
    """Running mean square of several channels in `VIBRATION_BAND`.

    A filter weighs all samples alike, which windowed spectra do not: a finger that swings for some
    seconds has most of its vibration at some places of them.

    Parameters
    ----------
    sample_rate : float
        Sample rate [Hz].
    """

    def __init__(self, sample_rate: float) -> None:
        self._filter = ellip(
            ORDER, RIPPLE, REJECTION, VIBRATION_BAND, "bandpass", fs=sample_rate, output="sos"
        )
        self._state: Floats | None = None
        self._sum, self._count = 0.0, 0

    def add(self, shear: Floats) -> None:
        """Add samples.

        Parameters
        ----------
        shear : (S, N) array of float
            Shear [m].
        """
        if not len(shear):
            return
        if self._state is None:  # as if the first shear had always been there
            self._state = sosfilt_zi(self._filter)[..., None] * shear[0]
        passed, self._state = sosfilt(self._filter, shear, axis=0, zi=self._state)
        self._sum += float(np.sum(passed**2))
        self._count += passed.size

    @property
    def mean_square(self) -> float:
        """Mean square over channels and time [m²]."""
        return self._sum / max(self._count, 1)


class _Measured:
    """Figures of one shear, so far."""

    def __init__(self, sample_rate: float, channels: int) -> None:
        self._spectrum = PowerSpectrum(sample_rate, channels)
        self._band = BandPower(sample_rate)
        self._peak = self._against = 0.0
        self._moving = 0

    def add(self, shear: Floats, steady: slice, against: Floats) -> None:
        """Add samples (S, N) [m], and the sign of the drag in each of the steady ones."""
        self._peak = max(self._peak, float(np.abs(shear).max(initial=0.0)))
        self._spectrum.add(shear[steady])
        self._band.add(shear[steady])
        self._against += float(np.sum(shear[steady] * against)) / shear.shape[1]
        self._moving += int(np.count_nonzero(against.any(axis=1)))

    @property
    def figures(self) -> ShearFigures | None:
        """Figures so far; None as long as there is no steady part."""
        lines = self._spectrum.lines()
        if lines is None:
            return None
        drag = self._against / max(self._moving, 1)
        result = shear_figures(*lines, drag=drag, peak=self._peak)
        return replace(result, vibration_um_rms=MICRO * math.sqrt(self._band.mean_square))


class StrokeMeter:
    """Measures the figures of a stroke as it is played, in constant memory.

    Parameters
    ----------
    display : Display
        Display that plays.
    sample_rate : float
        Sample rate of the shear [Hz].
    begin, end : float
        Times between which the stroke is not on a ramp [s].
    onset : float
        Way of the finger that is left out at the beginning; 0 for an effect on a finger at rest
        [m].
    """

    def __init__(
        self,
        display: Display,
        sample_rate: float,
        begin: float,
        end: float,
        *,
        onset: float = ONSET,
    ) -> None:
        self._axes = display.shear_axes
        self._span, self._onset = (begin, end), onset
        self._last: Floats | None = None
        self._way = 0.0
        channels = len(display.contactors)
        self._commanded = _Measured(sample_rate, channels)
        self._played = _Measured(sample_rate, channels)

    def add(
        self, time: Floats, position: Floats, commanded: Floats, played: Floats | None = None
    ) -> None:
        """Add samples.

        Parameters
        ----------
        time : (S,) array of float
            Times [s].
        position : (S, 2) array of float
            Position of the finger [m].
        commanded : (S, N) array of float
            Commanded shear [m].
        played : (S, N) array of float or None
            Shear of the skin [m]; None if it is not known.
        """
        if not len(time):
            return
        step = np.diff(position, axis=0, prepend=position[:1] if self._last is None else self._last)
        self._last = position[-1:]
        size = np.hypot(*step.T)
        way = self._way + np.cumsum(size)
        self._way = float(way[-1])
        first = int(np.searchsorted(way, self._onset))
        begin, end = np.searchsorted(time, self._span)
        steady = slice(max(first, int(begin)), int(end))
        against = drag_signs(step[steady], self._axes)
        self._commanded.add(commanded, steady, against)
        if played is not None:
            self._played.add(played, steady, against)

    @property
    def commanded(self) -> ShearFigures | None:
        """Figures of the commanded shear; None if the stroke has no steady part."""
        return self._commanded.figures

    @property
    def played(self) -> ShearFigures | None:
        """Figures of the played shear; None if it is not known or has no steady part."""
        return self._played.figures
