"""Commands about devices and links: ``devices``, ``budget`` and ``check``."""

import json
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AcceptHold, AsJson, DisplayOption, app
from tactile.cli.printing import print_budget, print_check


@app.command("devices")
def list_devices(as_json: AsJson = False) -> None:
    """List the devices that are there, each with the URL that opens it.

    Example: tactile devices
    """
    from tactile.devices import find_devices

    found = list(find_devices())
    if as_json:
        typer.echo(json.dumps([{"url": one.url, "about": one.about} for one in found]))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("device", no_wrap=True)
    table.add_column("what it is")
    for one in found:
        table.add_row(one.url, one.about)
    if found:
        Console().print(table)
    else:
        typer.echo("no device found; sim: and mock: are always there")


@app.command("budget")
def tell_budget(
    display: Annotated[str, typer.Argument(help="reference-24, reference-64, or a TOML file.")],
    url: Annotated[str, typer.Argument(help="Of the device; it is not opened.")],
    band_hz: Annotated[float, typer.Option(help="Highest frequency that is needed.")] = 1000.0,
    as_json: AsJson = False,
) -> None:
    """Tell what fits the link to a device: format, sample rate, spectrum frames.

    Example: tactile budget reference-24 "can:socketcan/can0?fd=true"
    """
    from tactile.bus.budget import BudgetError, plan, table
    from tactile.devices import link_at

    shown, link = tactile.load_display(display), link_at(url)
    chosen = None
    with suppress(BudgetError):
        chosen = plan(link, shown.channels, band=band_hz)
    rows = table(link, shown.channels, band=band_hz)
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "link": link.name,
                    "channels": shown.channels,
                    "cap": link.cap,
                    "plan": None if chosen is None else asdict(chosen),
                    "rows": [asdict(row) | {"fits": row.fits} for row in rows],
                }
            )
        )
        return
    title = f"{shown.channels} channels on {link.name}, {link.cap:.0%} of which may be used"
    print_budget(rows, title, first=chosen is not None)


@app.command("check")
def check_display(
    url: Annotated[str, typer.Argument(help="Of the device.")],
    display: DisplayOption = "reference-24",
    write: Annotated[
        Path | None, typer.Option(help="Write the display file with the map that was told.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite that file.")] = False,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Bring up a display, at 5 V at most: who is there, is each line good, what does it move.

    Asks at a terminal which contactor each channel moves. Exit code 1 where faults were found.

    Example: tactile check sim:
    """
    from rich.progress import Progress

    from tactile.bringup.bringup import bring_up

    console = Console(stderr=True)
    with Progress(
        console=console, transient=True, disable=as_json or not console.is_terminal
    ) as bar:
        task = bar.add_task("channels", total=None)

        def ask(question: str) -> str:
            bar.stop()
            return input(question)

        report = bring_up(
            url, display, write=write, force=force, accept_unsafe_hold=accept_unsafe_hold,
            ask=ask if sys.stdin.isatty() and not as_json else None,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(report.as_dict()))
    else:
        print_check(report.as_dict())
    raise typer.Exit(1 if report.faults else 0)
