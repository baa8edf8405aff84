"""The command ``tactile response``."""

from functools import partial
from typing import Annotated, Any

import numpy as np
import typer

import tactile
from tactile.cli.options import AsJson, DisplayOption, Finger, PlotOption, emit
from tactile.cli.printing import print_table, right

UNITS = {"um_per_v": "µm/V", "mn_per_v": "mN/V", "um": "µm", "hz": "Hz", "db": "dB"}
"""Unit for a person, by the end of the name of a figure."""


def run(
    load: Annotated[
        list[Finger] | None,
        typer.Option(
            help="Finger that loads the bimorph. May be given several times; all by default."
        ),
    ] = None,
    display: DisplayOption = "reference-24",
    plot: PlotOption = None,
    as_json: AsJson = False,
) -> None:
    """Report the frequency response of the bimorph of a display.

    Example: tactile response --load low --load high --plot response.png
    """
    from tactile.study.figures import response_figures

    loaded = tactile.load_display(display)
    loads = {f.value: getattr(tactile.FingerLoad, f.value)() for f in load or list(Finger)}
    figures = response_figures(loaded.bimorph, loads, loaded.limits.voltage)
    if plot is not None:
        from tactile.show.plots import response_figure, save

        frequency = np.geomspace(1, 2000, 2000)
        curves = {
            name: tactile.tip_response(loaded.bimorph, finger, frequency)
            for name, finger in loads.items()
        }
        save(response_figure(curves, voltage=loaded.limits.voltage), plot)
    emit(figures, as_json, partial(_print, loaded.name))
    if plot is not None and not as_json:
        print(f"drawn: {plot}")


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
