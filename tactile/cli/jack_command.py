"""The command ``tactile jack``."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.cli.bridges import choose_display, exit_if_interrupted, until_stopped
from tactile.cli.options import AsJson, emit
from tactile.cli.printing import plain_console, print_facts

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from tactile.jack import SoundCard, SoundCardSummary

LOWEST_DB = -60.0
"""Level at which the bar of a meter is empty [dBFS]. Assumed: the range of usual meters."""
BAR = 20
"""Length of the bar of a meter [columns]."""


def run(
    display: Annotated[
        str | None,
        typer.Argument(help="Name of the display, required if the server has several."),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(help="URL of the server; by default the server of this machine."),
    ] = None,
    full_scale_um: Annotated[
        float,
        typer.Option(help="Shear of a sample of 1 in µm, up to 500. Larger samples are clipped."),
    ] = 10.0,
    headroom_ms: Annotated[
        float | None,
        typer.Option(
            help="Time in ms that is added to the latency of the display, up to 500. Frames that "
            "come later than that are dropped. By default 8, and raised when that happens, up to "
            "40."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Turn a display into a sound card of JACK.

    Each contactor becomes an input port of a JACK client named after the display, such as
    "tactile left:contactor 0", and plays what is connected to it as shear. The delay stays the
    same, if frames come in time. The display is armed at the beginning; after an e-stop, or when
    the server was gone, it plays again when it is armed, as by its page. Waves are 34 dB weaker
    while no finger touches the display, unless the server has it as worn. The command runs until
    Ctrl-C, also while JACK or the server are not there, and then prints a summary.

    It needs the library JACK-Client: pip install 'tactile-display[jack]'.

    Example: tactile jack left --full-scale-um 20
    """
    from tactile.client import open_connection
    from tactile.jack import SoundCard, SoundCardSettings
    from tactile.jack.library import load_jack

    headroom = None if headroom_ms is None else 1e-3 * headroom_ms
    settings = SoundCardSettings(1e-6 * full_scale_um, headroom)
    load_jack()  # what is missing is said before anything waits for the server
    console = plain_console(stderr=as_json)

    def tell(line: str) -> None:
        console.print(line, soft_wrap=True)

    card: SoundCard | None = None
    try:
        with open_connection(url, client_name="tactile jack") as connection:
            card = SoundCard(choose_display(connection, display), settings, tell)
            with until_stopped() as (stop, received), _live_meters(console, card):
                card.run(stop)
    finally:
        if card is not None:
            summary = card.summary
            emit(summary.as_dict(), as_json, lambda _: _print(summary))
    exit_if_interrupted(received)


@contextmanager
def _live_meters(console: "Console", card: "SoundCard") -> Iterator[None]:
    """Show the meters of a sound card, if the console is a terminal."""
    if not console.is_terminal:
        yield
        return
    from rich.live import Live

    def view() -> "RenderableType":
        return _view(card)

    with Live(console=console, get_renderable=view, refresh_per_second=8, transient=True):
        yield


def _view(card: "SoundCard") -> "RenderableType":
    """Return the state of a sound card, and below it a meter for each channel."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.text import Text

    summary, levels = card.summary, card.meters.levels.tolist()
    meters = [
        Text(meter_line(index, level, 1e6 * summary.full_scale, clipped), no_wrap=True)
        for index, (level, clipped) in enumerate(zip(levels, summary.clipped, strict=True))
    ]
    state = Text(_state_line(card.state, summary), no_wrap=True, overflow="ellipsis")
    return Group(state, Columns(meters, column_first=True, padding=(0, 3)))


def _state_line(state: str, summary: "SoundCardSummary") -> str:
    """Return what a sound card does, in one line."""
    return (
        f"{summary.display} {state or 'unknown'}, delay {1e3 * summary.delay:.1f} ms, "
        f"{summary.frames} frames, {summary.lost} lost, {summary.gaps} gaps, "
        f"xruns of JACK {summary.xruns}"
    )


def meter_line(index: int, level: float, full_scale_um: float, clipped: int) -> str:
    """Return the meter of a channel as a line.

    Parameters
    ----------
    index : number of the contactor
    level : its peak level, relative to full scale
    full_scale_um : shear of full scale [µm]
    clipped : number of its samples that were clipped

    Returns
    -------
    str
        Bar, level in dBFS and µm, and a mark if samples were clipped.
    """
    from tactile.jack.meters import to_decibels

    decibels = to_decibels(level)
    share = min(max(1 - decibels / LOWEST_DB, 0.0), 1.0)
    bar = "█" * round(BAR * share)
    loudness = f"{decibels:6.1f}" if decibels > LOWEST_DB else "     –"
    mark = " CLIP" if clipped else "     "
    return f"{index:3d} {bar:·<{BAR}} {loudness} dBFS {full_scale_um * level:6.2f} µm{mark}"


def _print(summary: "SoundCardSummary") -> None:
    """Print what a sound card has done."""
    rate = "nothing came from JACK"
    if summary.rate is not None:
        rate = f"{summary.rate:g} Hz, {summary.buffer} frames per cycle"
    largest = max(summary.peaks, default=0.0)
    clipped = sum(map(bool, summary.clipped))
    rows = {
        "JACK": rate,
        "delay": f"{1e3 * summary.delay:.1f} ms",
        "frames": str(summary.frames),
        "missing from JACK": str(summary.missing),
        "dropped, of all programs": str(summary.dropped),
        "gaps, of all programs": str(summary.gaps),
        "xruns of JACK": str(summary.xruns),
        "largest peak": f"{1e6 * largest:.2f} µm",
        "clipped": f"{sum(summary.clipped)} samples, on {clipped} channels",
        "not a number": f"{summary.invalid} samples",
    }
    print_facts(rows, f"Played on {summary.display}")
