"""Command that measures the figures: ``python -m benchmarks [NAME …] [--long] [--json]``."""

import sys
from typing import Annotated

import typer

from benchmarks import BENCHMARKS, LONG
from tactile.bench import measure
from tactile.cli.printing import print_figures
from tactile.files import nearest


def main(
    only: Annotated[
        list[str] | None, typer.Argument(help="Names of benchmarks; by default all short ones.")
    ] = None,
    long: Annotated[
        bool,
        typer.Option("--long", help='Also run the long ones, minutes each and "hour" an hour.'),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures for machines.")] = False,
) -> None:
    """Measure every figure that the documentation promises, compared with other libraries.

    Example: python -m benchmarks speed clock --json
    """
    known = BENCHMARKS | LONG
    for name in only or []:
        if name not in known:
            print(f"no benchmark {name!r}; {nearest(name, list(known))}", file=sys.stderr)
            raise typer.Exit(2)
    names = only or [*BENCHMARKS, *(LONG if long else [])]
    figures = measure({name: known[name] for name in names})
    print_figures((figure.as_dict() for figure in figures), as_json=as_json)


if __name__ == "__main__":
    typer.run(main)
