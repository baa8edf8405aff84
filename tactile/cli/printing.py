"""Tables and progress bars for a terminal."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.padding import Padding
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table


def plain_console(*, stderr: bool = False) -> Console:
    """Return a console that prints every text as it is, without markup.

    Parameters
    ----------
    stderr : whether it prints to standard error and not to standard output

    Returns
    -------
    Console
        The console.
    """
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


Heading = str | Column
NAME_WIDTH = 44
"""Width of the names of measured figures; longer ones are printed in full [columns]."""
COLUMN_GAP = 2
"""Number of spaces that rich puts between two columns of a table."""


def right(*headings: str) -> list[Heading]:
    """Return right-aligned columns for `print_table`.

    Parameters
    ----------
    *headings : heading of each column

    Returns
    -------
    list of Column
        A column for each heading.
    """
    return [Column(heading, justify="right") for heading in headings]


def unwrapped(heading: str) -> Heading:
    """Return a column for `print_table` whose cells are never broken into lines.

    Parameters
    ----------
    heading : heading of the column

    Returns
    -------
    Column
        The column.
    """
    return Column(heading, no_wrap=True)


def print_table(
    columns: Iterable[Heading],
    rows: Iterable[Iterable[str]],
    title: str = "",
    *,
    header: bool = True,
    stderr: bool = False,
) -> None:
    """Print a table without lines, or row by row if the terminal is too narrow for its words.

    Parameters
    ----------
    columns : headings of the columns, which are left-aligned, or results of `right`
    rows : cells of each row
    title : line above the table
    header : whether the headings are printed
    stderr : whether the table is printed to standard error
    """
    # A column of rich collects the cells of its table, so that each table needs columns of its own.
    own = (column.copy() if isinstance(column, Column) else column for column in columns)
    table = Table(
        *own, title=title or None, title_justify="left", show_header=header, box=None,
        pad_edge=False,
    )  # fmt: skip
    for row in rows:
        table.add_row(*row)
    console = plain_console(stderr=stderr)
    if header and not _fit(table, console.width):
        _print_records(console, table)
    else:
        console.print(table)


def _fit(table: Table, width: int) -> bool:
    """Set the widths of columns such that no word is broken; return whether that is possible.

    The first columns get all that they need, the others what is left of it: rich would break the
    words of one column in order not to wrap the lines of another.
    """
    texts = [(str(column.header), *map(str, column.cells)) for column in table.columns]
    most = [max(map(cell_len, column)) for column in texts]
    least = [
        m if column.no_wrap else max((cell_len(word) for word in " ".join(t).split()), default=0)
        for column, t, m in zip(table.columns, texts, most, strict=True)
    ]
    spare = width - sum(least) - COLUMN_GAP * (len(texts) - 1)
    if spare < 0:
        return False
    for column, narrow, wide in zip(table.columns, least, most, strict=True):
        column.width = min(wide, narrow + spare)
        spare -= column.width - narrow
    return True


def _print_records(console: Console, table: Table) -> None:
    """Print the rows of a table one below the other: the first cell, then a line for each other."""
    if table.title:
        console.print(table.title)
    names, *others = table.columns
    cells = zip(*(column.cells for column in others), strict=True)
    for name, values in zip(names.cells, cells, strict=True):
        console.print(name)
        lines = Table(show_header=False, box=None, pad_edge=False)
        for column, value in zip(others, values, strict=True):
            lines.add_row(column.header, value)
        console.print(Padding(lines, (0, 0, 0, 2)))


def print_facts(facts: Mapping[str, str], title: str) -> None:
    """Print names with their values.

    Parameters
    ----------
    facts : value by name
    title : line above them
    """
    print_table(("name", "value"), facts.items(), title, header=False)


def print_bands(frequency: Iterable[float], level: Iterable[float], error: Iterable[float]) -> None:
    """Print the spatial spectrum of a texture.

    Parameters
    ----------
    frequency : centers of the bands in cycles/mm
    level : power spectral density in dB re 1 µm²·mm
    error : level of the realized surface minus that of the descriptor, in dB
    """
    columns = right("cycles/mm", "level dB re 1 µm²·mm", "realized − descriptor dB")
    rows = (
        (f"{f:g}", f"{one:.1f}", f"{e:+.2f}")
        for f, one, e in zip(frequency, level, error, strict=True)
    )
    print_table(columns, rows, "Bands along a stroke")


def print_budget(
    rows: Iterable[Any], title: str, *, has_plan: bool = False, stderr: bool = False
) -> None:
    """Print which sample formats and rates fit on a link.

    Parameters
    ----------
    rows : rows of `tactile.bus.budget.table`
    title : line above the table
    has_plan : whether the first row that fits is the one that will be used
    stderr : whether the table is printed to standard error
    """
    cells = []
    for row in rows:
        verdict = "too much" if row.why_not.startswith("takes ") else row.why_not
        if row.fits:
            verdict, has_plan = "chosen" if has_plan else "fits", False
        cells.append((row.what, f"{row.sample_rate:g}", f"{row.use:.0%}", str(row.most), verdict))
    columns = ["sent as", *right("Hz", "of the wire", "channels that fit"), ""]
    print_table(columns, cells, title, stderr=stderr)


def print_figures(figures: Iterable[Mapping[str, Any]], *, as_json: bool = False) -> None:
    """Print measured figures beside their goals, each as soon as it is measured.

    Parameters
    ----------
    figures : name, value, unit, goal, reached and reason of each, as `Figure.as_dict` returns them
    as_json : whether to print a JSON array; it is closed even if the measurement is interrupted
    """
    if not as_json:
        for figure in figures:
            print(_figure_line(figure).rstrip(), flush=True)
        return
    separator = "["
    try:
        for figure in figures:
            print(separator, json.dumps(figure), sep="\n", end="", flush=True)
            separator = ","
    finally:
        print("]" if separator == "," else "[]", flush=True)


def _figure_line(figure: Mapping[str, Any]) -> str:
    """Return one measured figure as a line."""
    if figure["reason"]:
        return f"{figure['name']:<{NAME_WIDTH}}  not measured: {figure['reason']}"
    number = "none" if figure["value"] is None else f"{figure['value']:.4g}"
    value = f"{number} {figure['unit']}"
    mark = {None: "", True: "reached", False: "NOT REACHED"}[figure["reached"]]
    return f"{figure['name']:<{NAME_WIDTH}}  {value:>14}  {figure['goal']:<10}  {mark}"


def progress_bar(*, visible: bool) -> Progress:
    """Return a progress bar on standard error that counts steps.

    Parameters
    ----------
    visible : whether it may be shown; it never is if standard error is not a terminal

    Returns
    -------
    Progress
        The bar, which disappears when it is closed.
    """
    console = plain_console(stderr=True)
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=console, transient=True, disable=not (visible and console.is_terminal),
    )  # fmt: skip
