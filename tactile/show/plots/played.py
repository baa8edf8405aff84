"""Figure of a playback: tactile images that follow the finger, shear and drive of one contactor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.show.plots.style import (
    BLUE,
    COLORS,
    GRAY,
    RED,
    new_figure,
    plain,
    tag,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle


SNAPSHOTS = 4
"""Number of tactile images."""
WINDOW = 40e-3
"""Duration of the traces [s]."""
LEAD = 4e-3
"""Part of the traces before the first snapshot [s]."""
ERROR_GAIN = 100.0
"""Factor by which the error is magnified."""


@dataclass(frozen=True)
class Played:
    """Commanded shear and the resulting motion of the skin.

    Parameters
    ----------
    display : Display
        Display that played.
    time : (S,) array of float
        Times [s].
    target : (S, N) array of float
        Commanded shear [m].
    played : (S, N) array of float
        Shear of the skin [m].
    drive : (S, N) array of float
        Drive [V].
    position : (S, 2) array of float or None
        Position of the finger [m], if it is known.

    Raises
    ------
    InputError
        If the shapes differ, or there are too few samples.
    """

    display: Display
    time: Floats
    target: Floats
    played: Floats
    drive: Floats
    position: Floats | None = None

    def __post_init__(self) -> None:
        samples, contactors = len(self.time), len(self.display.contactors)
        shapes = dict.fromkeys(("target", "played", "drive"), (samples, contactors))
        if self.position is not None:
            shapes["position"] = (samples, 2)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"{name} is {getattr(self, name).shape}: must be {shape}")
        if samples < 2 * SNAPSHOTS:
            raise InputError(f"{samples} samples: needs at least {2 * SNAPSHOTS}")


def played_figure(play: Played, *, title: str) -> "Figure":
    """Draw tactile images, the shear of one contactor with its error, and its drive.

    The images show the played shear. If the finger's position is known, it moves by one pitch from
    each image to the next, and frames follow one place of the surface from contactor to contactor;
    the traces are those of the first of these contactors. Otherwise the images are evenly spaced
    over the traces, which are those of the contactor that moves most in the first image.

    Parameters
    ----------
    play : Played
        Data to draw.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Figure with images above traces.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    instants, followed = _snapshots(play)
    wide, high = np.ptp(play.display.contactors, axis=0) + 2 * max(play.display.opening)
    top = float(np.clip(1.7 * high / wide, 0.8, 3.0)) + 0.8
    figure = new_figure(9.0, top + 6.4)
    figure.suptitle(title, fontweight="bold")
    rows = figure.add_gridspec(4, SNAPSHOTS, height_ratios=(top, 2.2, 1.6, 2.0))
    images = [figure.add_subplot(rows[0, k]) for k in range(SNAPSHOTS)]
    _images(images, play, instants, followed)
    start, contactor = play.time[instants[0]] - LEAD, followed[0]
    window = (play.time >= start) & (play.time <= start + WINDOW), contactor
    time = play.time[window[0]] * 1e3
    shear = figure.add_subplot(rows[1, :])
    error, drive = (figure.add_subplot(rows[k, :], sharex=shear) for k in (2, 3))
    _shear(shear, error, time, play.target[window] * 1e6, play.played[window] * 1e6)
    tag(shear, 0.01, f"contactor {contactor}, framed in image 1:", "black")
    _drive(drive, time, play.drive[window], play.display.limits.voltage)
    for number, instant in enumerate(instants):
        _mark(shear, play.time[instant] * 1e3, f"image {number + 1}")
    return figure


def _snapshots(play: Played) -> tuple[list[int], list[int]]:
    """Return the samples of the images, and the contactor to frame in each (−1 for none)."""
    time, position, places = play.time, play.position, play.display.contactors
    if position is not None:
        way = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
        step = _shift(places, position[-1] - position[0])
        start = (way[-1] - (SNAPSHOTS - 1) * step) / 2
        if start > 0:
            distances = start + step * np.arange(SNAPSHOTS)
            instants = [int(np.argmin(np.abs(way - w))) for w in distances]
            return instants, _follow(places, position[instants], play.played[instants[0]], step)
    first = int(np.searchsorted(time, (time[0] + time[-1]) / 2))
    last = min(int(np.searchsorted(time, time[first] + WINDOW - 2 * LEAD)), len(time) - 1)
    instants = np.linspace(first, last, SNAPSHOTS).astype(int).tolist()
    return instants, [int(np.argmax(np.abs(play.played[first]))), *[-1] * (SNAPSHOTS - 1)]


def _shift(places: Floats, direction: Floats) -> float:
    """Return the least displacement [m] along a direction that moves a contactor onto another."""
    along = direction / max(float(np.linalg.norm(direction)), 1e-12)
    gap = (places[:, None] - places).reshape(-1, 2)
    ahead = gap @ along
    across = np.abs(gap @ np.array([-along[1], along[0]]))
    beside = (ahead > 1e-6) & (across < 0.1 * ahead)
    length = np.linalg.norm(gap, axis=1)
    return float(ahead[beside].min() if beside.any() else length[length > 0].min(initial=np.inf))


def _follow(places: Floats, position: Floats, shear: Floats, step: float) -> list[int]:
    """Return the contactor at one place of the surface, per position (K, 2) of the finger.

    Of the places that stay under the array longest, it is the one that moves most at first.
    """
    reach = places + (position[0] - position)[:, None, :]
    gap = np.linalg.norm(reach[:, :, None] - places, axis=-1)
    present = gap.min(axis=2) < 0.2 * step
    stay = present.sum(axis=0)
    best = int(np.argmax(np.where(stay == stay.max(), np.abs(shear), -1.0)))
    return [int(np.argmin(gap[k, best])) if present[k, best] else -1 for k in range(len(position))]


def _images(
    images: "Sequence[Axes]", play: Played, instants: list[int], followed: list[int]
) -> None:
    """Draw the contactors' openings in the color of their shear."""
    from matplotlib.collections import PatchCollection

    micro, places = play.played[instants] * 1e6, play.display.contactors * 1e3
    openings, margin = _openings(play.display), max(play.display.opening) * 1e3
    (left, bottom), (right, top) = places.min(axis=0) - margin, places.max(axis=0) + margin
    peak = float(np.abs(micro).max()) or 1.0
    for number, (axes, sample, framed) in enumerate(zip(images, instants, followed, strict=True)):
        drawn = PatchCollection(openings, cmap="RdBu_r", edgecolor="#bbbbbb", linewidth=0.4)
        drawn.set_array(micro[number])
        drawn.set_clim(-peak, peak)
        axes.add_collection(drawn)
        if framed >= 0:
            frame = PatchCollection([openings[framed]], facecolor="none", edgecolor="black")
            frame.set_linewidth(2.0)
            axes.add_collection(frame)
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x [mm]")
        text = f"image {number + 1}: {play.time[sample] * 1e3:.1f} ms"
        if play.position is not None:
            text += "\nfinger at {:.1f}, {:.1f} mm".format(*play.position[sample] * 1e3)
        axes.set_title(text, fontsize=9)
        axes.tick_params(labelleft=not number)
        plain(axes, grid=False)
    images[0].set_ylabel("y [mm]")
    scale = images[-1].inset_axes((1.08, 0.0, 0.07, 1.0))
    images[0].figure.colorbar(drawn, cax=scale, label="shear [µm]")


def _openings(display: Display) -> "list[Rectangle]":
    """Return the openings of the contactors [mm], rotated to their directions of shear."""
    from matplotlib.patches import Rectangle

    width, height = (side * 1e3 for side in display.opening)
    return [
        Rectangle((x - width / 2, y - height / 2), width, height, angle=a, rotation_point="center")
        for (x, y), a in zip(
            display.contactors * 1e3, np.degrees(display.shear_direction), strict=True
        )
    ]


def _shear(above: "Axes", below: "Axes", time: Floats, target: Floats, played: Floats) -> None:
    """Draw commanded and played shear [µm], and their difference."""
    above.plot(time, target, color="#9ecae1", linewidth=4.5)
    above.plot(time, played, color=RED, linewidth=1.2)
    tag(above, 0.35, "commanded", BLUE)
    tag(above, 0.48, "played", RED)
    error = played - target
    below.plot(time, error * ERROR_GAIN, color="black", linewidth=1.0)
    level = float(np.sqrt(np.mean(error**2) / max(float(np.mean(target**2)), 1e-30)))
    tag(below, 0.01, f"error rms {level:.2%} of the commanded shear", "black")
    peak = 1.35 * float(max(np.abs(target).max(), np.abs(error).max() * ERROR_GAIN, 1e-6))
    above.set(ylabel="shear [µm]", ylim=(-peak, peak))
    below.set(ylabel=f"error × {ERROR_GAIN:g} [µm]", ylim=(-peak, peak))
    for axes in (above, below):
        plain(axes)
        axes.tick_params(labelbottom=False)


def _drive(axes: "Axes", time: Floats, volts: Floats, limit: float) -> None:
    """Draw the drive [V], and beside it the part that it takes of the range between the limits."""
    axes.plot(time, volts, color=COLORS[2], linewidth=1.4)
    peak = float(np.abs(volts).max())
    full = peak > 0.4 * limit
    if full:
        for side in (-limit, limit):
            axes.axhline(side, color=GRAY, linewidth=1.0, linestyle="--")
    top = 1.35 * limit if full else 1.35 * max(peak, 1e-3 * limit)
    axes.set(xlabel="time [ms]", ylabel="drive [V]", ylim=(-top, top), xlim=(time[0], time[-1]))
    tag(axes, 0.01, f"drive: at most {peak:.1f} V of ± {limit:g} V", "black")
    gauge = axes.inset_axes((1.02, 0.0, 0.025, 1.0))
    gauge.bar(0, np.ptp(volts), bottom=volts.min(), color=COLORS[2], width=1.0)
    gauge.set(ylim=(-limit, limit), xlim=(-0.5, 0.5), xticks=[], yticks=[-limit, 0, limit])
    gauge.yaxis.tick_right()
    gauge.set_yticklabels([f"−{limit:g} V limit", "0", f"{limit:g} V limit"], fontsize=8)
    plain(axes)


def _mark(axes: "Axes", time: float, name: str) -> None:
    """Mark an instant [ms], if it is within the axes."""
    low, high = axes.get_xlim()
    if low <= time <= high:
        axes.axvline(time, color=GRAY, linewidth=0.8, linestyle=":")
        text = axes.text(time, 0.02, f" {name}", transform=axes.get_xaxis_transform(), fontsize=8)
        text.set_color(GRAY)
