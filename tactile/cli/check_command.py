"""The command ``tactile check``."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import AcceptHold, AsJson, DisplayOption, Force, emit
from tactile.cli.printing import print_table, progress_bar, right

COLUMNS = {
    "channel": "channel",
    "contactor": "contactor",
    "capacitance_nf": "capacitance nF",
    "error_percent": "error ±%",
    "loss": "loss",
    "voltage_v": "voltage V",
    "verdict": "verdict",
    "moved": "moved",
    "along": "along",
}
"""Heading of each result that is printed of a channel, if any channel has it."""


def run(
    url: Annotated[str, typer.Argument(help="URL of the device that drives the display.")],
    display: DisplayOption = "reference-24",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Display file to write, with the contactor and the polarity of each channel as "
            "observed during the check.",
        ),
    ] = None,
    force: Force = False,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Check the amplifier, the wiring and the channels of a display.

    The drive is at most 5 V. In a terminal, it asks which contactor each channel moves. The exit
    code is 1 if faults were found.

    Example: tactile check sim:
    """
    from tactile.bringup.bringup import bring_up

    with progress_bar(visible=not as_json) as bar:
        task = bar.add_task("channels", total=None)

        def ask(question: str) -> str:
            bar.stop()
            return input(question)

        report = bring_up(
            url, display, write=out, force=force, accept_unsafe_hold=accept_unsafe_hold,
            ask=ask if sys.stdin.isatty() and not as_json else None,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    emit(report.as_dict(), as_json, _print)
    raise typer.Exit(1 if report.faults else 0)


def _print(r: dict[str, Any]) -> None:
    """Print the amplifiers, the channels and the faults of a report."""
    for one in r["amplifiers"]:
        print(_amplifier(one))
    names = [name for name in COLUMNS if any(one[name] is not None for one in r["channels"])]
    rows = ([_cell(one[name]) for name in names] for one in r["channels"])
    title = f"{r['display']} at {r['device']}, checked with {r['voltage_v']:g} V at most"
    print_table(right(*(COLUMNS[name] for name in names)), rows, title)
    for kind in ("note", "fault"):
        for line in r[f"{kind}s"]:
            print(f"{kind}: {line}")
    if r["written"]:
        print(f"written: {r['written']}")
    if not r["faults"]:
        whole = all(one["verdict"] == "good" for one in r["channels"])
        print("all channels are good" if whole else "no faults found; not all values were measured")


def _cell(value: Any) -> str:
    """Return a result as text; one that is not known is empty."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def _amplifier(a: dict[str, Any]) -> str:
    """Return a description of an amplifier."""
    low, high = a["rates_hz"]
    first = a["first_channel"]
    return (
        f"node {a['node']}: {a['name']!r}, firmware {a['firmware']:#010x}, channels {first} … "
        f"{first + a['channels'] - 1}, {a['voltage_limit_v']:g} V, "
        f"{a['slew_limit_v_per_us']:g} V/µs, {low} … {high} Hz, {', '.join(a['formats'])}, "
        f"{'measures' if a['measures'] else 'does not measure'}, "
        f"marker lines: {a['marker_lines'] or 'none'}, "
        f"clock {a['drift_ppm']:+.1f} ppm"
    )
