"""The command ``tactile bench``."""

from functools import partial
from typing import Annotated

import typer

import tactile
from tactile.cli.options import AsJson, DisplayOption
from tactile.cli.printing import print_figures
from tactile.errors import InputError
from tactile.files import nearest


def run(
    only: Annotated[
        list[str] | None,
        typer.Argument(help="Benchmarks to run: speed, memory or jitter; all by default."),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            help="URL of a device. The round trip of its link is measured instead of the machine."
        ),
    ] = None,
    display: DisplayOption = "reference-24",
    as_json: AsJson = False,
) -> None:
    """Measure the performance of this machine or of a link.

    Of the machine, the rendering speed, the memory and the timing jitter are measured, within about
    a minute. Each figure is printed as soon as it is measured.

    Example: tactile bench speed jitter
    """
    from tactile.bench import BENCHMARKS, measure, measure_link

    for name in only or []:
        if name not in BENCHMARKS:
            raise InputError(f"no benchmark {name!r}; {nearest(name, list(BENCHMARKS))}")
    chosen = {name: BENCHMARKS[name] for name in only or ([] if device else BENCHMARKS)}
    if device is not None:
        loaded = tactile.load_display(display)
        chosen[device] = partial(measure_link, device, loaded)
    print_figures((figure.as_dict() for figure in measure(chosen)), as_json=as_json)
