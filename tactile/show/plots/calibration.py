"""Figure of a calibration: the capacitance of each contactor over frequency, and what is fitted."""

from typing import TYPE_CHECKING

import numpy as np

from tactile.sensing.baseline_file import Calibration
from tactile.show.plots.style import BLUE, GRAY, RED, new_figure, plain, tag

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figure(calibration: Calibration) -> "Figure":
    """Draw what contactors draw in air.

    Parameters
    ----------
    calibration : Calibration
        Calibration of a display.

    Returns
    -------
    Figure
        Charge per volt of each contactor, as measured and as fitted, and the error of the fit.
    """
    baseline, measured = calibration.baseline, calibration.measured
    frequency = measured.frequency
    charge = measured.value / (2j * np.pi * frequency)
    force, stiffness = baseline.tip(frequency)
    fitted = baseline.charge(frequency)
    fitted = fitted + force**2 / stiffness * baseline.measuring(frequency)
    figure = new_figure(8.0, 6.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    for k, fault in enumerate(baseline.faults):
        color = RED if fault else BLUE
        above.plot(frequency, 1e9 * charge[k].real, ".", color=color, ms=3, alpha=0.6)
        if not fault:
            above.plot(frequency, 1e9 * fitted[k].real, color=GRAY, lw=0.6, alpha=0.6)
            error = 100 * np.abs(charge[k] - fitted[k]) / baseline.bender.capacitance
            below.plot(frequency, np.maximum(error, 1e-3), color=BLUE, lw=0.8, alpha=0.5)
    above.set_ylabel("charge per volt (nF)")
    above.set_title(f"{calibration.display} in air, {calibration.date}", loc="left")
    tag(above, 0.02, "measured", BLUE)
    tag(above, 0.16, "fitted", GRAY)
    if any(baseline.faults):
        tag(above, 0.27, "with a fault", RED)
    below.set_ylabel("error (%)")
    below.set_yscale("log")
    below.set_xlabel("frequency (Hz)")
    for axes in (above, below):
        axes.set_xscale("log")
        plain(axes)
    return figure
