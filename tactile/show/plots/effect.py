"""Figure of an effect: its shear over time, and its spectrum against the threshold."""

import textwrap
from typing import TYPE_CHECKING

from tactile.rendering.equalizer import PASS_BAND
from tactile.show.effect_view import SPECTRUM_HEAD, EffectView
from tactile.show.plots.style import BLUE, GRAY, axes_at, new_figure, plain
from tactile.show.plots.texture import LEVELS, LOWEST, draw_spectrum, name_ticks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE = (10.0, 7.4)
"""Width and height of the figure [inch]."""
MOST_LINES = 4
"""Maximum number of lines about the effect; `tactile play` and the terminal name all."""


def effect_figure(view: EffectView) -> "Figure":
    """Draw the waveform and the spectrum of an effect.

    Parameters
    ----------
    view : EffectView
        View to draw.

    Returns
    -------
    Figure
        Figure with two axes.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    figure = new_figure(*SIZE)
    figure.set_layout_engine("none")
    figure.text(0.08, 1 - 0.4 / SIZE[1], view.effect.name, fontsize=15, weight="bold")
    about = [] if view.effect.description == view.effect.name else [view.effect.description]
    for k, line in enumerate([*about, *view.facts][:MOST_LINES]):
        text = textwrap.shorten(line, 120, placeholder=" …")
        figure.text(0.08, 1 - (0.65 + 0.2 * k) / SIZE[1], text, fontsize=9, color=GRAY)
    waveform = axes_at(figure, 0.8, 4.1, 8.6, 1.7)
    waveform.plot(view.time * 1e3, view.shear * 1e6, color=BLUE, linewidth=1.0)
    waveform.set(xlabel="time [ms]", ylabel="shear [µm]")
    waveform.set_title("shear of all contactors", fontsize=10, loc="left")
    plain(waveform)
    spectrum = axes_at(figure, 0.8, 0.6, 8.6, 2.6)
    draw_spectrum(spectrum, view.spectrum)
    spectrum.set(xlim=(LOWEST, PASS_BAND * 1.12), ylim=LEVELS)
    spectrum.set(xlabel="frequency [Hz]", ylabel="peak [µm]")
    spectrum.set_title(SPECTRUM_HEAD, fontsize=10, loc="left")
    name_ticks(spectrum, LOWEST)
    plain(spectrum)
    return figure
