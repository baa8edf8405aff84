"""Figure of a texture's fit: recordings, the texture fitted to them, and its error on others."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tactile.arrays import Floats
from tactile.show.plots.style import BLUE, COLORS, GRAY, RED, new_figure, plain
from tactile.texture.fitting import Fit
from tactile.texture.judging import Verdict

HERTZ = (10, 20, 50, 100, 200, 500, 1000)
"""Ticks of the axis of frequency [Hz]."""

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def fit_figure(fit: Fit, verdict: Verdict) -> "Figure":
    """Draw the bands of recordings and texture, and the errors of the fit on the held-out half.

    Parameters
    ----------
    fit : Fit
        Fit from `tactile.texture.judging.fit_texture`.
    verdict : Verdict
        Its verdict from the same function.

    Returns
    -------
    Figure
        Figure with two axes.
    """
    figure = new_figure(8.0, 7.0)
    bands, errors = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _bands(bands, fit)
    _errors(errors, verdict)
    named = errors.get_legend_handles_labels()
    figure.legend(*named, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    about = fit.descriptor.texture
    count = f"{len(fit.names)} recording{'s' if len(fit.names) > 1 else ''}"
    figure.suptitle(f"{about.id}: {about.description}, from {count}", fontsize=11)
    return figure


def _bands(axes: "Axes", fit: Fit) -> None:
    """Draw the levels of recordings and texture over spatial frequency."""
    stochastic, reference = fit.descriptor.stochastic, fit.descriptor.reference
    assert stochastic is not None
    k, level = fit.center * 1e-3, np.asarray(stochastic.level_db)
    law = fit.level - np.nanmean(fit.level - level, axis=1, keepdims=True)
    for row in law:
        axes.plot(k, row, color="#b8b8b8", linewidth=1.0)
    axes.plot([], [], color="#b8b8b8", linewidth=1.0, label="recordings, brought to its level")
    name = "texture"
    if stochastic.level_sd_db:
        name += ", ± its spread"
        sd = np.asarray(stochastic.level_sd_db)
        axes.fill_between(k, level - sd, level + sd, color=BLUE, alpha=0.15, linewidth=0)
    axes.plot(k, level, "o-", color=BLUE, linewidth=2.0, markersize=4, label=name)
    for grating in fit.descriptor.periodic:
        orders = np.flatnonzero(grating.harmonics_um) + 1
        top = level.max() + 3
        axes.vlines(orders / grating.wavelength_mm, level.min() - 3, top, RED, linewidth=1.0)
        axes.text(
            1 / grating.wavelength_mm, top, f"{grating.wavelength_mm:g} mm", color=RED, ha="center"
        )
    axes.set(xscale="log", ylabel="level [dB re 1 µm² mm]")
    speed = reference.speed_mm_s

    def to_hz(per_mm: ArrayLike) -> Floats:
        return np.asarray(per_mm, np.float64) * speed

    def to_place(hz: ArrayLike) -> Floats:
        return np.asarray(hz, np.float64) / speed

    top = axes.secondary_xaxis("top", functions=(to_hz, to_place))
    top.set_xlabel(f"frequency at {speed:g} mm/s [Hz]")
    top.set_xticks(HERTZ, labels=[f"{hz:g}" for hz in HERTZ])
    top.tick_params(axis="x", which="minor", labeltop=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.legend(frameon=False, loc="lower left")
    plain(axes)


def _errors(axes: "Axes", verdict: Verdict) -> None:
    """Draw the difference of models from the held-out half, over spatial frequency."""
    k = verdict.center * 1e-3
    sides = (
        ("recordings themselves", verdict.ceiling, GRAY, "--"),
        ("this texture", verdict.rendering, BLUE, "-"),
        ("autoregressive, order 8", verdict.autoregressive, COLORS[2], "-."),
        ("white noise", verdict.white, COLORS[4], ":"),
    )
    axes.axhline(0, color="black", linewidth=0.8)
    for name, side, color, line in sides:
        axes.plot(
            k, side.level - verdict.held_out, line, color=color, linewidth=1.8,
            label=f"{name}, {side.rms_db:.2f} dB rms",
        )  # fmt: skip
    errors = [s.level - verdict.held_out for _, s, _, _ in sides[:3]]
    most = 1.1 * float(np.nanmax(np.abs(errors))) + 1
    axes.set(
        xscale="log", ylim=(-most, most), xlabel="spatial frequency [cycles/mm]",
        ylabel="above what was held out [dB]",
    )  # fmt: skip
    axes.xaxis.set_major_formatter("{x:g}")
    plain(axes)
