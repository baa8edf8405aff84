"""Commands that measure: ``response`` of a bimorph, ``bench`` of the project itself."""

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, DisplayOption, app
from tactile.errors import InputError
from tactile.files import nearest


class Finger(StrEnum):
    """A finger that loads the contactor."""

    LOW = "low"
    HIGH = "high"
    AIR = "none"


@app.command("response")
def tell_response(
    load: Annotated[
        list[Finger] | None, typer.Option(help="Finger: low, high or none; may be repeated.")
    ] = None,
    display: DisplayOption = "reference-24",
    plot: Annotated[Path | None, typer.Option(help="Draw it to a PNG, SVG or PDF.")] = None,
    as_json: AsJson = False,
) -> None:
    """Tell how a display's bimorph moves under a finger.

    Example: tactile response --load low --load high --plot response.png
    """
    from tactile.study.figures import response_figures

    shown = tactile.load_display(display)
    loads = {f.value: getattr(tactile.FingerLoad, f.value)() for f in load or list(Finger)}
    figures = response_figures(shown.bimorph, loads, shown.limits.voltage)
    if plot is not None:
        from tactile.show.plots import plot_response

        curves = {
            name: tactile.tip_response(shown.bimorph, finger, _plot_frequencies())
            for name, finger in loads.items()
        }
        plot_response(plot, curves, voltage=shown.limits.voltage)
    if as_json:
        typer.echo(json.dumps(figures))
        return
    table = Table(title=f"Bimorph of {shown.name}", title_justify="left", box=None, pad_edge=False)
    table.add_column("finger")
    for heading in next(iter(figures.values())):
        table.add_column(heading.replace("_", " "), justify="right")
    for name, row in figures.items():
        table.add_row(name, *(f"{value:.4g}" for value in row.values()))
    Console().print(table)
    if plot is not None:
        typer.echo(f"drawn: {plot}")


def _plot_frequencies() -> Any:
    import numpy as np

    return np.geomspace(1, 2000, 2000)


@app.command("bench")
def run_benchmarks(
    only: Annotated[
        list[str] | None, typer.Argument(help="speed, memory or jitter; by default all of them.")
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="Measure the link of this device instead, by its URL.")
    ] = None,
    display: DisplayOption = "reference-24",
    as_json: AsJson = False,
) -> None:
    """Measure this machine: rendering speed, memory and jitter, or the round trip of a link.

    Example: tactile bench speed jitter
    """
    from tactile.bench import BENCHMARKS, measure, measure_link
    from tactile.cli.printing import print_figures

    for name in only or []:
        if name not in BENCHMARKS:
            raise InputError(f"no benchmark {name!r}; {nearest(name, list(BENCHMARKS))}")
    chosen = [BENCHMARKS[name] for name in only or ([] if device else BENCHMARKS)]
    if device is not None:
        shown = tactile.load_display(display)
        chosen.append(lambda: measure_link(device, shown))
    figures = [figure.as_dict() for figure in measure(chosen)]
    if as_json:
        typer.echo(json.dumps(figures, indent=1))
    else:
        print_figures(figures)
