"""Figure of a bimorph: its response under fingers, and its reach against the threshold."""

from typing import TYPE_CHECKING

import numpy as np

from tactile.actuator.response import TipResponse
from tactile.errors import InputError
from tactile.show.plots.style import (
    COLORS,
    GRAY,
    THRESHOLD_NAME,
    draw_threshold,
    name_ends,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAND = (1.0, 2000.0)
"""Range of frequencies that is drawn [Hz]."""
NAMED_AT = 1.0
"""Height of the threshold's label, below its low end [µm]."""


def response_figure(
    responses: dict[str, TipResponse], *, voltage: float, title: str = ""
) -> "Figure":
    """Draw magnitude, phase, and attainable shear against the detection threshold.

    Parameters
    ----------
    responses : dict of str to TipResponse
        Response (F,) for each finger, by its name.
    voltage : float
        Voltage limit of the drive [V].
    title : str
        Title, such as whose bimorph it is.

    Returns
    -------
    Figure
        Figure with three axes.

    Raises
    ------
    InputError
        If matplotlib is missing, or a response has no frequency in 1 … 2000 Hz.
    """
    figure = new_figure(7.0, 9.0)
    figure.suptitle(title, fontsize=11)
    size, phase, reach = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 3))
    ends: list[list[tuple[float, str, str]]] = [[], [], []]
    for k, (name, r) in enumerate(responses.items()):
        inside = (r.frequency >= BAND[0]) & (r.frequency <= BAND[1])
        if not inside.any():
            raise InputError(f"{name}: has no frequency in {BAND[0]:g} … {BAND[1]:g} Hz")
        micro = np.abs(r.displacement[inside]) * 1e6
        degrees = np.degrees(np.unwrap(np.angle(r.displacement[inside])))
        for axes, values, end in zip(
            (size, phase, reach), (micro, degrees, micro * voltage), ends, strict=True
        ):
            axes.plot(r.frequency[inside], values, color=COLORS[k % len(COLORS)], linewidth=1.8)
            end.append((float(values[-1]), name, COLORS[k % len(COLORS)]))
    size.set(yscale="log", ylabel="tip per volt [µm/V]", xscale="log", xlim=BAND)
    phase.set(ylabel="phase [°]")
    reach.set(yscale="log", ylabel=f"peak shear at {voltage:g} V [µm]", xlabel="frequency [Hz]")
    draw_threshold(reach)
    reach.text(1.2, NAMED_AT, THRESHOLD_NAME, color=GRAY, verticalalignment="top")
    _plain_ticks(size, phase, reach)
    for axes, end in zip((size, phase, reach), ends, strict=True):
        plain(axes)
        name_ends(axes, end)
    return figure


def _plain_ticks(size: "Axes", phase: "Axes", reach: "Axes") -> None:
    """Write 0.1, 1, 10 at logarithmic axes, and multiples of 90° at the phase."""
    from matplotlib.ticker import MultipleLocator

    phase.yaxis.set_major_locator(MultipleLocator(90))
    for axis in (size.yaxis, reach.yaxis, reach.xaxis):
        axis.set_major_formatter("{x:g}")
