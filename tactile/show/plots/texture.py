"""Figure of a texture on a display: surface, spectrum against the threshold, and a stroke.

`texture_figure` draws a `tactile.show.views.View`: one figure shows what of the texture reaches the
skin, and whether it is felt.
"""

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from tactile.arrays import Floats
from tactile.rendering.equalizer import PASS_BAND
from tactile.show.plots.style import (
    BLUE,
    COLORS,
    GRAY,
    RED,
    THRESHOLD_NAME,
    axes_at,
    draw_threshold,
    new_figure,
    plain,
)
from tactile.show.views import BANDS, CENTER, EDGES, SIDE, StrokeSpectrum, Sweep, View, facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


DIVERGING = "RdBu_r"
"""Color map of displacement."""
GREEN = COLORS[2]
"""Color of sparse events."""
LEVELS = (0.01, 200.0)
"""Lower and upper end of a spectrum [µm], unless something is stronger."""
LOWEST = 20.0
"""Lower end of the frequency axis, unless the texture has something below [Hz]."""
TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Ticks of the frequency axis [Hz]."""
WIDE = 4.0
"""Lower end of the frequency axis below which only decades have ticks [Hz]."""
MOST_NAMED = 12
"""Largest number of contactors of a row whose places are labeled."""
SIZE = (10.0, 9.4)
"""Width and height of the figure [inch]."""


def texture_figure(view: View) -> "Figure":
    """Draw surface, spectrum and a stroke of a texture, below a few lines of facts.

    Parameters
    ----------
    view : View
        View to draw.

    Returns
    -------
    Figure
        Figure with three axes.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    figure = new_figure(*SIZE)
    figure.set_layout_engine("none")
    about = view.texture.descriptor.texture
    for inch, text, size in (
        (0.40, f"{view.texture.name} on {view.conditions}", 15),
        (0.70, textwrap.shorten(about.description, 110, placeholder=" …"), 11),
        (1.27, "\n".join(facts(view, 115)), 9),
    ):
        written = figure.text(0.08, 1 - inch / SIZE[1], text, fontsize=size, linespacing=1.4)
        written.set(weight="bold" if size == 15 else "normal", color=GRAY if size == 9 else "black")
    peak = max(color_end(view.surface), color_end(view.sweep.shear)) * 1e6
    _surface(axes_at(figure, 0.8, 4.4, 3.4, 3.4), view, peak)
    spectrum = axes_at(figure, 6.0, 4.4, 3.8, 3.4)
    draw_spectrum(spectrum, view.spectrum)
    _attainable(spectrum, view)
    _name_parts(spectrum, view)
    _sweep(axes_at(figure, 0.8, 0.6, 8.2, 2.85), view, peak)
    return figure


def _surface(axes: "Axes", view: View, peak: float) -> None:
    """Draw the displacement over a square, and the stroke as an arrow."""
    half = SIDE * 1e3 / 2
    image = axes.imshow(
        view.surface * 1e6, DIVERGING, vmin=-peak, vmax=peak, origin="lower",
        extent=(-half, half, -half, half),
    )  # fmt: skip
    _color_bar(axes, image, "tangential displacement [µm]", 0.03)
    y = float(np.clip(view.sweep.place[0, 1] * 1e3, -0.9 * half, 0.8 * half))
    arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.6}
    axes.annotate("", (0.94 * half, y), (-0.94 * half, y), arrowprops=arrow)
    name = axes.text(-0.9 * half, y + 0.08 * half, f"stroke, {view.speed * 1e3:g} mm/s", fontsize=9)
    name.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5})
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    _head(axes, f"surface, {SIDE * 1e3:g} × {SIDE * 1e3:g} mm")
    axes.locator_params(nbins=5)


def _color_bar(axes: "Axes", image: "AxesImage", name: str, gap: float) -> None:
    """Draw the color scale beside the axes, 0.12 inch wide."""
    beside = axes.inset_axes(
        (1 + gap, 0.0, 0.12 / axes.get_window_extent().width * axes.figure.dpi, 1.0)
    )
    axes.figure.colorbar(image, cax=beside, extend="both", label=name)


def _head(axes: "Axes", text: str) -> None:
    """Write the heading of axes."""
    axes.set_title(text, fontsize=10, loc="left")


def color_end(values: Floats) -> float:
    """Compute the end of a symmetric color scale, exceeded only by the strongest 0.5 %.

    Parameters
    ----------
    values : array of float
        Values to color.

    Returns
    -------
    float
        End of the scale, above 0, in the unit of the values.
    """
    return float(np.quantile(np.abs(values), 0.995)) or 1e-6


def draw_spectrum(axes: "Axes", spectrum: StrokeSpectrum, *, bold: float = 1.0) -> None:
    """Draw third octaves [µm peak], gratings and the detection threshold over frequency [Hz].

    What lies beyond 1 kHz is pale.

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    spectrum : StrokeSpectrum
        Spectrum to draw.
    bold : float
        Factor on the widths of lines.
    """
    draw_threshold(axes, bold=bold)
    inside = np.arange(BANDS) < np.searchsorted(CENTER, PASS_BAND * 1.01)
    for values, color, strength in ((spectrum.waves, BLUE, 0.35), (spectrum.events, GREEN, 0.0)):
        micro = np.maximum(values * 1e6, 1e-6)
        if values.max() > 0:
            axes.stairs(np.where(inside, micro, np.nan), EDGES, color=color, linewidth=1.4 * bold)
            axes.stairs(np.where(inside, np.nan, micro), EDGES, color=color, alpha=0.4, lw=bold)
            axes.stairs(micro, EDGES, fill=True, color=color, alpha=strength, linewidth=0)
    for f, peak in zip(spectrum.grating_frequency, spectrum.grating_peak * 1e6, strict=True):
        played = 1.0 if f <= PASS_BAND else 0.4
        axes.plot([f, f], [1e-6, peak], color=RED, linewidth=1.6 * bold, alpha=played)
        axes.plot(f, peak, "o", color=RED, markersize=4 * bold, alpha=played)
    axes.set(xscale="log", yscale="log")


def name_ticks(axes: "Axes", left: float) -> None:
    """Write the ticks of a logarithmic spectrum as plain numbers.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes of the spectrum.
    left : float
        Lowest frequency that is shown [Hz].
    """
    ticks = [f for f in TICKS[:: 3 if left < WIDE else 1] if f >= left]
    axes.set_xticks(ticks, [f"{f:g}" for f in ticks])
    axes.set_xticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")


def _attainable(axes: "Axes", view: View) -> None:
    """Draw what full drive attains and the end of the band, and set the limits of the axes."""
    s = view.spectrum
    known = (view.frequency > 0) & (view.frequency <= PASS_BAND)
    frequency = np.concatenate([CENTER[:1], view.frequency[known]])
    micro = np.interp(frequency, view.frequency, view.attainable) * 1e6
    axes.plot(frequency, micro, color="black", linewidth=1.6)
    beyond = axes.axvspan(PASS_BAND, EDGES[-1], facecolor="#f4f4f4", edgecolor="#d0d0d0")
    beyond.set(hatch="///", linewidth=0.0)
    strong = np.flatnonzero(s.total >= 0.1 * s.total.max())
    left = min(LOWEST, EDGES[strong[0]]) / 1.26
    axes.set(xlim=(left, EDGES[-1]), ylim=(LEVELS[0], max(LEVELS[1], 2e6 * float(s.total.max()))))
    axes.set(xlabel="frequency [Hz]", ylabel="peak per third octave [µm]")
    name_ticks(axes, left)
    _head(axes, f"spectrum at {view.speed * 1e3:g} mm/s")
    plain(axes)
    text = axes.text(np.sqrt(PASS_BAND * EDGES[-1]), LEVELS[0] * 1.5, "not played", rotation=90)
    text.set(color=GRAY, fontsize=9, ha="center")


def _name_parts(axes: "Axes", view: View) -> None:
    """Label what is drawn, each part in its color, where the threshold leaves room."""
    s = view.spectrum
    parts = ((s.waves, "surface", BLUE), (s.grating_peak, "gratings", RED),
             (s.events, "sparse events, in the mean", GREEN))  # fmt: skip
    names = [(THRESHOLD_NAME, GRAY)]
    names += [(name, color) for values, name, color in parts if values.max(initial=0.0) > 0]
    level = np.log10(view.attainable[view.frequency <= PASS_BAND].min() * 1e6 / LEVELS[0])
    low, high = np.log10(axes.get_ylim())
    place = level / (high - low)
    limit = f"attained at {view.display.limits.voltage:g} V"
    axes.text(0.02, place + 0.03, limit, transform=axes.transAxes, fontsize=9)
    right = np.log(PASS_BAND / axes.get_xlim()[0]) / np.log(EDGES[-1] / axes.get_xlim()[0])
    for k, (name, color) in enumerate(names):
        at = right - 0.02, place - 0.07 - 0.06 * k
        axes.text(*at, name, transform=axes.transAxes, color=color, fontsize=9, ha="right")


def _sweep(axes: "Axes", view: View, peak: float) -> None:
    """Draw the shear of a row of contactors over time, and one place of the surface that passes."""
    sweep, time = view.sweep, view.sweep.time * 1e3
    x = sweep.place[:, 0] * 1e3
    height = 0.8 * float(np.diff(x).min()) if len(x) > 1 else 1.0
    for at, row in zip(x, sweep.shear * 1e6, strict=True):
        drawn = axes.imshow(
            row[None], DIVERGING, vmin=-peak, vmax=peak, aspect="auto", interpolation="antialiased",
            extent=(time[0], time[-1], at - height / 2, at + height / 2),
        )  # fmt: skip
    passes = (followed_place(sweep) - sweep.position) * 1e3
    axes.plot(time, passes, color="black", linewidth=1.2, linestyle=(0, (4, 3)))
    y = f"{sweep.place[0, 1] * 1e3:g}".replace("-", "−")
    axes.set(xlim=(time[0], time[-1]), ylim=(x[0] - 0.7 * height, x[-1] + 0.7 * height))
    axes.set(xlabel="time [ms]", ylabel="contactor at x [mm]")
    labeled = x[:: -(-len(x) // MOST_NAMED)]
    axes.set_yticks(labeled, [f"{at:.3g}".replace("-", "−") for at in labeled])
    _head(axes, f"commanded to the contactors at y = {y} mm; dashed: one place of the surface")
    _color_bar(axes, drawn, "shear [µm]", 0.015)
    plain(axes, grid=False)


def followed_place(sweep: Sweep) -> float:
    """Find the place with most shear among those that pass under all contactors.

    Parameters
    ----------
    sweep : Sweep
        Stroke over a row of contactors.

    Returns
    -------
    float
        Place along x on the surface [m].
    """
    along = sweep.place[-1, 0] + sweep.position
    seen = along <= sweep.place[0, 0] + sweep.position[-1]
    return float(along[seen][np.argmax(np.abs(sweep.shear[-1, seen]))])
