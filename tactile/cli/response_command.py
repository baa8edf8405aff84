"""The command ``tactile response``."""

from enum import StrEnum
from functools import partial
from typing import Annotated, Any

import numpy as np
import typer

import tactile
from tactile.cli.options import AsJson, DisplayOption, PlotOption, emit
from tactile.cli.printing import print_table, right

UNITS = {"um_per_v": "µm/V", "mn_per_v": "mN/V", "um": "µm", "hz": "Hz", "db": "dB"}
"""Unit for a person, by the end of the name of a figure."""


class ShownFinger(StrEnum):
    """A finger whose load can be shown: that of the display, a preset, or none."""

    DISPLAY = "display"
    LOW = "low"
    HIGH = "high"
    AIR = "none"


def run(
    load: Annotated[
        list[ShownFinger] | None,
        typer.Option(
            help="Finger that loads the bimorph: that of the display file, a preset, or none. May "
            "be given several times; all by default."
        ),
    ] = None,
    display: DisplayOption = "reference-24",
    plot: PlotOption = None,
    as_json: AsJson = False,
) -> None:
    """Report the frequency response of the bimorph of a display.

    It is reported under the finger of the display file, which tactile adjust fits to a
    measurement, and under the presets.

    Example: tactile response --load display --load none --plot response.png
    """
    from tactile.study.figures import response_figures

    loaded = tactile.load_display(display)
    loads: dict[str, tactile.FingerLoad] = {}
    for finger in load or list(ShownFinger):
        if finger is ShownFinger.DISPLAY:
            loads |= _own_fingers(loaded)
        else:
            loads[finger.value] = getattr(tactile.FingerLoad, finger.value)()
    figures = response_figures(loaded.bimorph, loads, loaded.limits.voltage)
    if plot is not None:
        from tactile.show.plots import response_figure, save

        frequency = np.geomspace(1, 2000, 2000)
        curves = {
            name: tactile.tip_response(loaded.bimorph, finger, frequency)
            for name, finger in _distinct(loads).items()
        }
        title = f"Bimorph of {loaded.name}"
        save(response_figure(curves, voltage=loaded.limits.voltage, title=title), plot)
    emit(figures, as_json, partial(_print, loaded.name))
    if plot is not None and not as_json:
        print(f"drawn: {plot}")


def _distinct(loads: dict[str, tactile.FingerLoad]) -> dict[str, tactile.FingerLoad]:
    """Return fingers without those that equal an earlier one, which is named after both."""
    names: dict[tactile.FingerLoad, list[str]] = {}
    for name, load in loads.items():
        names.setdefault(load, []).append(name)
    return {" = ".join(alike): load for load, alike in names.items()}


def _own_fingers(display: tactile.Display) -> dict[str, tactile.FingerLoad]:
    """Return the load of the finger of a display, by name; of a table, one for each force."""
    if len(display.load_forces) == 1:
        return {"display": display.load_at(display.load_forces[0])}
    return {f"display, {force:g} N": display.load_at(force) for force in display.load_forces}


def _print(display: str, figures: dict[str, dict[str, Any]]) -> None:
    """Print the figures of the bimorph, a row for each finger."""
    headings = map(_heading, next(iter(figures.values())))
    rows = ((name, *(f"{v:.4g}" for v in row.values())) for name, row in figures.items())
    print_table(["finger", *right(*headings)], rows, f"Bimorph of {display}")


def _heading(name: str) -> str:
    """Return the name of a figure with its unit, for a person."""
    end = next((end for end in UNITS if name.endswith(f"_{end}")), None)
    words = name if end is None else f"{name.removesuffix(end)}{UNITS[end]}"
    return words.replace("_", " ")
