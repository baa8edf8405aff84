"""The application that commands are added to, and the options that several of them take."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tactile.errors import InputError

app = typer.Typer(
    help="Textures on tactile displays made of piezoelectric bimorphs.\n\n"
    "Example: tactile play wood-oak --speed-mm-s 80 --seconds 5",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

DisplayOption = Annotated[
    str, typer.Option("--display", help="reference-24, reference-64, or a TOML file.")
]
AcceptHold = Annotated[
    bool,
    typer.Option(
        "--accept-unsafe-hold",
        help="Also on an amplifier that holds its last voltage when the host dies, or does nobody "
        "knows what.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures for machines.")]


def print_table(rows: dict[str, str], title: str) -> None:
    """Print names with their values."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    for name, value in rows.items():
        table.add_row(name, value)
    Console().print(table)


def within(name: str, value: float | None, low: float, high: float, default: float) -> float:
    """Return an option's value, or its default where it was not given.

    Raises
    ------
    InputError
        Where it is not within its limits.
    """
    if value is None:
        return default
    if not low <= value <= high:
        raise InputError(f"{name} {value:g}: must be {low:g} … {high:g}")
    return value
