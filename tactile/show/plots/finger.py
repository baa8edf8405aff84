"""Figure of a measured finger: the dynamic stiffness on each contactor, with its deviation."""

from typing import TYPE_CHECKING

import numpy as np

from tactile.display.display import Display
from tactile.sensing.population import load_stiffness
from tactile.sensing.resting_load import MeasuredLoads
from tactile.sensing.uncertainty import stiffness_deviation
from tactile.show.plots.style import BLUE, RED, new_figure, plain, tag

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FREQUENCY = np.geomspace(10.0, 1000.0, 81)
"""Frequencies of the curves [Hz]."""
BAND = 2
"""Half-width of the band [standard deviations]."""


def finger_figure(loads: MeasuredLoads, display: Display) -> "Figure":
    """Draw the loads of all contactors that a finger touches.

    Parameters
    ----------
    loads : MeasuredLoads
        Loads of the contactors.
    display : Display
        Display with its fixed finger, which is drawn too.

    Returns
    -------
    Figure
        Stiffness Re k and damping Im k/ω over frequency.
    """
    known = loads.touching & loads.explained
    logarithms, covariance = loads.logarithms[known], loads.covariance[known]
    stiffness = load_stiffness(logarithms, FREQUENCY)
    deviation = stiffness_deviation(logarithms, covariance, FREQUENCY)
    fixed = display.load_at(display.load_forces[len(display.load_forces) // 2])
    expected, omega = fixed.stiffness(FREQUENCY), 2 * np.pi * FREQUENCY
    figure = new_figure(8.0, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    panels = (
        (above, stiffness.real, deviation.real, expected.real),
        (below, stiffness.imag / omega, deviation.imag / omega, expected.imag / omega),
    )
    for axes, values, spreads, other in panels:
        for value, spread in zip(values, spreads, strict=True):
            low = np.maximum(value - BAND * spread, 0.02 * value)
            axes.fill_between(FREQUENCY, low, value + BAND * spread, color=BLUE, alpha=0.04, lw=0)
            axes.plot(FREQUENCY, value, color=BLUE, lw=0.7, alpha=0.8)
        axes.plot(FREQUENCY, other, color=RED, lw=1.4, ls="--")
        axes.set(xscale="log", yscale="log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        plain(axes)
    above.set_ylabel("stiffness Re k (N/m)")
    below.set_ylabel("damping Im k/ω (N s/m)")
    below.set_xlabel("frequency (Hz)")
    above.set_title(
        f"Finger on {int(known.sum())} of {len(known)} contactors of {display.name}", loc="left"
    )
    tag(above, 0.02, f"contactors, ± {BAND} standard deviations", BLUE)
    tag(above, 0.45, "finger of the display file", RED)
    return figure
