"""The command ``tactile lsl``."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.cli.bridges import choose_display, exit_if_interrupted, until_stopped
from tactile.cli.options import AsJson, emit
from tactile.cli.printing import plain_console, print_facts

if TYPE_CHECKING:
    from rich.console import Console

    from tactile.lsl import Bridge, BridgeSummary


def run(
    display: Annotated[
        str | None,
        typer.Argument(help="Name of the display, required if the server has several."),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(help="URL of the server; by default the server of this machine."),
    ] = None,
    streams: Annotated[
        str,
        typer.Option(
            help="Streams to offer, separated by commas: contacts, shear, drive and markers."
        ),
    ] = "contacts,shear,drive,markers",
    decimate: Annotated[
        int,
        typer.Option(
            help="Factor by which the rate of the drive is divided, 1 to 64. A filter keeps "
            "frequencies up to 0.4 of the new rate within 0.1 dB and attenuates those above 0.5 of "
            "it by 80 dB."
        ),
    ] = 1,
    start_from: Annotated[
        str | None,
        typer.Option(
            help="Name of an LSL stream of markers that start effects. A marker starts the effect "
            "of its name; others are ignored."
        ),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TEXT=EFFECT",
            help="Effect that a marker starts, if it has another name. May be given several times.",
        ),
    ] = None,
    delay_s: Annotated[
        float,
        typer.Option(
            help="Time from a marker to the effect that it starts. An effect that would begin "
            "later is dropped."
        ),
    ] = 0.1,
    as_json: AsJson = False,
) -> None:
    """Offer a display to the Lab Streaming Layer, for recorders.

    The streams are named after the display, such as "tactile left drive": contacts (the finger),
    shear (commanded shear), drive (commanded voltages) and markers (onsets, events of the display,
    and missing samples). Each sample has the time at which the amplifier puts it out, and each
    contact the time of the finger. The bridge runs until Ctrl-C, also while the server is not
    there, and then prints a summary.

    It needs the library pylsl: pip install 'tactile-display[lsl]'.

    Example: tactile lsl left --start-from triggers --start go=tap
    """
    from tactile.client import open_connection
    from tactile.lsl import Bridge, BridgeSettings
    from tactile.lsl.library import load_pylsl
    from tactile.lsl.settings import parse_starts, parse_streams

    settings = BridgeSettings(
        parse_streams(streams), decimate, start_from, parse_starts(start or []), delay_s
    )
    load_pylsl()  # what is missing is said before anything waits for the server
    console = plain_console(stderr=as_json)

    def tell(line: str) -> None:
        console.print(line, soft_wrap=True)

    with open_connection(url, client_name="tactile lsl") as connection:
        bridge = Bridge(choose_display(connection, display), settings, tell)
        with until_stopped() as (stop, received), _status(console, bridge):
            bridge.run(stop)
    summary = bridge.summary
    emit(summary.as_dict(), as_json, lambda _: _print(summary))
    exit_if_interrupted(received)


@contextmanager
def _status(console: "Console", bridge: "Bridge") -> Iterator[None]:
    """Show what a bridge has done so far in one line, if the console is a terminal."""
    if not console.is_terminal:
        yield
        return
    from rich.live import Live
    from rich.text import Text

    def line() -> Text:
        return Text(_describe(bridge.summary), no_wrap=True, overflow="ellipsis")

    with Live(console=console, get_renderable=line, refresh_per_second=4, transient=True):
        yield


def _describe(summary: "BridgeSummary") -> str:
    """Return what a bridge has done so far as one line."""
    counts = [f"{one.name.rpartition(' ')[2]} {one.samples}" for one in summary.streams]
    counts.append(f"missing samples {summary.missing}")
    if any((summary.begun, summary.dropped, summary.ignored)):
        counts.append(
            f"effects begun {summary.begun}, dropped {summary.dropped}, "
            f"markers ignored {summary.ignored}"
        )
    return ", ".join(counts)


def _print(summary: "BridgeSummary") -> None:
    """Print what a bridge has done."""
    rows = {
        one.name: f"{one.samples} {'samples' if one.rate else 'markers'}" for one in summary.streams
    }
    rows["missing samples"] = str(summary.missing)
    within = summary.uncertainty
    rows["time stamps"] = "of unknown uncertainty"
    if within is not None:
        rows["time stamps"] = f"within {1e6 * within:.0f} µs"
    rows["effects"] = f"{summary.begun} begun, {summary.dropped} dropped"
    rows["ignored markers"] = str(summary.ignored)
    print_facts(rows, f"Offered {summary.display}")
