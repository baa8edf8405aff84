"""Figures for files: what the bimorph can do, and what was played. The only room of matplotlib.

`response_figure` and `played_figure` draw, `plot_response` and `plot_played` also save. Colors are
those of Okabe and Ito, which the color-blind tell apart; lines are named where they are drawn.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.response import TipResponse
from tactile.display import Display
from tactile.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

SUFFIXES = (".png", ".svg", ".pdf")
DPI = 150
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito 2008, yellow left out since it fades on white."""
BLUE, RED, GRAY = COLORS[0], COLORS[1], "#666666"
BAND = (1.0, 2000.0)
"""Hz."""
THRESHOLD = np.array(
    [
        (1.0, 25.0),
        (10.0, 8.9),
        (20.0, 5.0),
        (40.0, 2.8),
        (63.0, 1.5),
        (100.0, 0.56),
        (160.0, 0.2),
        (250.0, 0.1),
        (400.0, 0.16),
        (500.0, 0.32),
        (630.0, 0.67),
        (800.0, 1.6),
        (1000.0, 3.5),
    ]
)
"""Hz and µm peak at which a large contactor is just felt: shape of Verrillo and Bolanowski."""
THRESHOLD_SPREAD_DB = 5.0
SNAPSHOTS = 4
WINDOW = 40e-3
"""Seconds of the traces."""
LEAD = 4e-3
"""Seconds of the traces before the first snapshot."""
ERROR_GAIN = 100.0


def plot_response(
    path: str | Path, responses: dict[str, TipResponse], *, voltage: float
) -> None:
    """Draw what the tip does per volt, and what it can reach, and save it.

    Parameters
    ----------
    path : of a .png, .svg or .pdf file
    responses : one (F,) response per finger, by its name
    voltage : limit of the drive [V]

    Raises
    ------
    InputError
        Where matplotlib is missing, or the file cannot be written.
    """
    _check(path)
    _save(response_figure(responses, voltage=voltage), path)


def response_figure(responses: dict[str, TipResponse], *, voltage: float) -> "Figure":
    """Return magnitude, phase, and attainable shear against the detection threshold.

    Parameters
    ----------
    responses : one (F,) response per finger, by its name
    voltage : limit of the drive [V]

    Raises
    ------
    InputError
        Where matplotlib is missing.

    Notes
    -----
    The threshold was measured against the normal of the skin; tangential motion is felt from
    0.3–0.6 times that (Biggs and Srinivasan 2002), so that the margin shown is a cautious one.
    """
    figure = _figure(7.0, 9.0)
    size, phase, reach = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 3))
    ends: list[list[tuple[float, str, str]]] = [[], [], []]
    for (name, r), color in zip(responses.items(), _colors(len(responses)), strict=True):
        micro = np.abs(r.displacement) * 1e6
        turn = np.degrees(np.unwrap(np.angle(r.displacement)))
        for axes, values, end in zip(
            (size, phase, reach), (micro, turn, micro * voltage), ends, strict=True
        ):
            inside = (r.frequency >= BAND[0]) & (r.frequency <= BAND[1])
            axes.plot(r.frequency[inside], values[inside], color=color, linewidth=1.8)
            end.append((float(values[inside][-1]), name, color))
    size.set(yscale="log", ylabel="tip per volt [µm/V]", xscale="log", xlim=BAND)
    phase.set(ylabel="phase [°]")
    phase.yaxis.set_major_locator(_multiples(90))
    reach.set(yscale="log", ylabel=f"peak shear at {voltage:g} V [µm]", xlabel="frequency [Hz]")
    _threshold(reach)
    for axes, end in zip((size, phase, reach), ends, strict=True):
        _style(axes)
        _name_ends(axes, end)
    return figure


def _threshold(axes: "Axes") -> None:
    frequency, micro = THRESHOLD.T
    spread = 10 ** (THRESHOLD_SPREAD_DB / 20)
    axes.fill_between(frequency, micro / spread, micro * spread, color="#dddddd", linewidth=0)
    axes.plot(frequency, micro, color=GRAY, linewidth=1.2, linestyle="--")
    axes.text(
        3.0,
        6.0,
        f"detection threshold, ± {THRESHOLD_SPREAD_DB:g} dB",
        color=GRAY,
        verticalalignment="top",
    )
