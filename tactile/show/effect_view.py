"""Contents of a still picture of an effect: its shear over time, and its spectrum.

The spectrum is that of the whole effect, as the mean over its duration, in the third octaves of
`tactile.show.views`.
"""

from dataclasses import dataclass

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment

from tactile.arrays import Floats
from tactile.show.live import BADGE, LABEL, TITLE, Line, nice
from tactile.show.still import spectrum_lines
from tactile.show.trace import braille
from tactile.show.views import (
    BANDS,
    SAMPLE_RATE,
    StrokeSpectrum,
    band_figures,
    by_band,
    felt_levels,
)
from tactile.texture.formats.effect_shear import NamedEffect

TRACE_LINES, WIDEST = 6, 96
"""Height and largest width of the waveform [characters]."""
SPECTRUM_HEAD = "spectrum of the effect, µm peak per third octave"
"""Heading of the spectrum."""


@dataclass(frozen=True)
class EffectView:
    """Everything about an effect that is shown.

    Attributes
    ----------
    effect : NamedEffect
        Effect that is shown.
    shear : (S,) array of float
        Shear over time at 8 kHz [m].
    spectrum : StrokeSpectrum
        Third octaves of the shear, all of them in ``waves``.
    """

    effect: NamedEffect
    shear: Floats
    spectrum: StrokeSpectrum

    @property
    def time(self) -> Floats:
        """Times of the samples, (S,) [s]."""
        return np.arange(len(self.shear)) / SAMPLE_RATE

    @property
    def facts(self) -> list[str]:
        """Lines on duration, level, and what is assumed or left out."""
        micro = self.shear * 1e6
        level = f"{np.sqrt(np.mean(micro**2)):.2f} µm rms, {np.abs(micro).max():.2f} µm peak"
        return [f"{self.effect.seconds:.3g} s, {level}", *self.effect.notes]


def view_effect(effect: NamedEffect) -> EffectView:
    """Compute the view of an effect.

    Parameters
    ----------
    effect : NamedEffect
        Effect to show.

    Returns
    -------
    EffectView
        Shear and spectrum.

    Raises
    ------
    InputError
        If there is nothing to play.
    """
    shear = effect.shear(SAMPLE_RATE)
    peaks = 2 * np.abs(np.fft.rfft(shear))[1:] / len(shear)
    frequency = np.arange(1, len(peaks) + 1) * SAMPLE_RATE / len(shear)
    bands, level = by_band(frequency, peaks**2), felt_levels(frequency, peaks**2 / 2)
    none = np.zeros(0)
    spectrum = StrokeSpectrum(np.sqrt(bands), np.zeros(BANDS), none, none, level)
    return EffectView(effect, shear, spectrum)


def effect_figures(view: EffectView) -> dict[str, object]:
    """Return the contents of a view as plain figures, for programs.

    Parameters
    ----------
    view : EffectView
        View of the effect.

    Returns
    -------
    dict of str to object
        Figures, with the unit at the end of each name.
    """
    return {
        "name": view.effect.name,
        "description": view.effect.description,
        "seconds": view.effect.seconds,
        "rms_um": float(np.sqrt(np.mean(view.shear**2))) * 1e6,
        "peak_um": float(np.abs(view.shear).max()) * 1e6,
        **band_figures(view.spectrum),
        "notes": view.effect.notes,
    }


@dataclass(frozen=True)
class EffectScreen:
    """View of an effect, laid out for the console that it is printed on.

    Attributes
    ----------
    view : EffectView
        View to draw.
    """

    view: EffectView

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in effect_lines(self.view, options.max_width):
            yield from line
            yield Segment.line()


def effect_lines(view: EffectView, width: int) -> list[Line]:
    """Draw an effect.

    Parameters
    ----------
    view : EffectView
        View to draw.
    width : int
        Largest width [characters].

    Returns
    -------
    list of Line
        Lines of the picture.
    """
    columns = min(width, WIDEST)
    end = nice(max(float(np.abs(view.shear).max()) * 1e6, 1e-3))
    low, high = _envelope(view.shear * 1e6 / end, 2 * columns)
    lines: list[Line] = [
        [Segment(" tactile ", BADGE), Segment(f" {view.effect.name}", TITLE)],
        [Segment(view.effect.description)],
        [],
        [Segment(f"shear over {view.effect.seconds:.3g} s, −{end:g} … {end:g} µm", TITLE)],
        *([Segment(line)] for line in braille(low, high, TRACE_LINES)),
        [],
        *spectrum_lines(view.spectrum, SPECTRUM_HEAD, width),
        [],
        *([Segment(line, LABEL)] for line in view.facts),
    ]
    return [Segment.adjust_line_length(line, width, pad=False) for line in lines]


def _envelope(values: Floats, count: int) -> tuple[Floats, Floats]:
    """Return lowest and highest values (count,) in equal intervals, NaN where there is none."""
    number = np.arange(len(values)) * count // len(values)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, number, values)
    np.maximum.at(high, number, values)
    empty = np.isinf(low)
    low[empty] = high[empty] = np.nan
    return low, high
