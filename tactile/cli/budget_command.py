"""The command ``tactile budget``."""

from contextlib import suppress
from dataclasses import asdict
from typing import Annotated

import typer

import tactile
from tactile.cli.options import AsJson, emit
from tactile.cli.printing import print_budget


def run(
    display: Annotated[
        str,
        typer.Argument(help="Name of a shipped display, or path of a display file (TOML)."),
    ],
    url: Annotated[
        str, typer.Argument(help="URL of the device that the link leads to; it is not opened.")
    ],
    band_hz: Annotated[
        float, typer.Option(help="Highest frequency in Hz that the display must play.")
    ] = 1000.0,
    as_json: AsJson = False,
) -> None:
    """List the sample formats and rates that fit on a link.

    Formats are listed from the best to the smallest; the one that will be used is marked.

    With correlation_ms in the URL, windows of currents (CORRELATION) count as well, and what guards
    of the amplifiers are sent while the finger is followed (GUARD). The amplifiers are assumed to
    have guards.

    Example: tactile budget reference-24 "can:socketcan/can0?fd=true&correlation_ms=25"
    """
    from tactile.bus.budget import Ability, BudgetError, guard_use, plan, reply_use, table
    from tactile.bus.registry import parse
    from tactile.devices import link_at

    loaded, link = tactile.load_display(display), link_at(url)
    window: int = getattr(parse(url).options, "correlation_ms", None) or 0
    chosen = None
    with suppress(BudgetError):
        chosen = plan(link, loaded.channels, band=band_hz, correlation_ms=window)
    rows = table(link, loaded.channels, band=band_hz, correlation_ms=window)
    title = f"{loaded.channels} channels on {link.name}, of which {link.cap:.0%} may be used"
    windows, replies = reply_use(link, loaded.channels, Ability(), window)
    guards = guard_use(link, loaded.channels, Ability(), window)
    if window:
        title += f"\nWindows of {window} ms of currents take {windows:.1%} of the way back"
        title += f"\nGuards, which follow the finger, take {guards:.1%} of the way out"
    facts = {
        "link": link.name,
        "channels": loaded.channels,
        "cap": link.cap,
        "correlation_use": windows,
        "guard_use": guards,
        "reply_use": replies,
        "plan": None if chosen is None else asdict(chosen),
        "rows": [asdict(row) | {"fits": row.fits} for row in rows],
    }
    emit(facts, as_json, lambda _: print_budget(rows, title, has_plan=chosen is not None))
