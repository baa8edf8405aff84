"""Figures of fits: the measurement as dots, the fit with its confidence band, and the start."""

from typing import TYPE_CHECKING

import numpy as np

from tactile.show.plots.style import BLUE, GRAY, RED, new_figure, plain
from tactile.study.adjusted import Comparison

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VERTICAL_AXES = {
    "displacement": ("tip per volt [µm/V]", 1e6),
    "velocity": ("tip per volt [mm/(s V)]", 1e3),
    "force": ("force per volt [mN/V]", 1e3),
    "admittance": ("admittance [µS]", 1e6),
}
"""Axis label of each kind of measurement, and the size of one SI unit in the label's unit."""


def adjusted_figure(comparisons: "Sequence[Comparison]", *, title: str = "") -> "Figure":
    """Draw magnitude, phase and misfit of each measurement and its fit.

    Parameters
    ----------
    comparisons : sequence of Comparison
        Measurements and fits, one for each column.
    title : str
        Title, such as whose finger it is.

    Returns
    -------
    matplotlib.figure.Figure
        Figure with one column for each comparison.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    figure = new_figure(6.5 * len(comparisons), 8.0)
    figure.suptitle(title, fontsize=11)
    grid = figure.subplots(
        3, len(comparisons), sharex="col", squeeze=False, height_ratios=(3, 2, 2)
    )
    for comparison, (size, phase, misfit) in zip(comparisons, grid.T, strict=True):
        _draw_response(size, phase, comparison)
        _draw_misfit(misfit, comparison)
        size.set_title(
            f"{comparison.measurement.name}: {comparison.rms_db:.2g} dB rms, "
            f"{comparison.worst_db:.2g} dB at worst",
            loc="left", fontsize=10,
        )  # fmt: skip
        for axes in (size, phase, misfit):
            plain(axes)
    return figure


def _draw_response(size: "Axes", phase: "Axes", c: Comparison) -> None:
    """Draw magnitude and phase of the start, the fit with its band, and the measurement."""
    frequency = c.measurement.frequency
    label, scale = VERTICAL_AXES[c.measurement.kind]
    lines = (
        (c.started, GRAY, "--", "before"),
        (c.predicted, BLUE, "-", "fit, with its 95 % band"),
    )
    unwrapped = np.degrees(np.unwrap(np.angle(c.predicted)))
    for value, color, style, name in lines:
        turn = unwrapped + np.degrees(np.angle(value / c.predicted))
        size.plot(frequency, np.abs(value) * scale, style, color=color, linewidth=1.6, label=name)
        phase.plot(frequency, turn, style, color=color, linewidth=1.6)
    around = np.abs(c.predicted) * scale * 10 ** (np.array([[-1], [1]]) * c.band_db / 20)
    size.fill_between(frequency, *around, color=BLUE, alpha=0.2, linewidth=0)
    phase.fill_between(
        frequency,
        unwrapped - c.band_deg,
        unwrapped + c.band_deg,
        color=BLUE,
        alpha=0.2,
        linewidth=0,
    )
    value = c.measurement.value
    turn = unwrapped + np.degrees(np.angle(value / c.predicted))
    size.plot(frequency, np.abs(value) * scale, ".", color=RED, markersize=5, label="measured")
    phase.plot(frequency, turn, ".", color=RED, markersize=5)
    size.set(xscale="log", yscale="log", ylabel=label)
    size.legend(frameon=False, fontsize=9)
    phase.set(ylabel="phase [°]")
    size.yaxis.set_major_formatter("{x:g}")


def _draw_misfit(axes: "Axes", c: Comparison) -> None:
    """Draw the misfit and the confidence band of the fit."""
    frequency = c.measurement.frequency
    axes.axhline(0, color="black", linewidth=0.8)
    axes.fill_between(frequency, -c.band_db, c.band_db, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(frequency, c.misfit_db, ".", color=RED, markersize=5)
    axes.set(ylabel="fit over measured [dB]", xlabel="frequency [Hz]")
    axes.xaxis.set_major_formatter("{x:g}")
