"""The command ``tactile serve``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.errors import BusError

if TYPE_CHECKING:
    from tactile.server.server import Server


def run(
    config: Annotated[
        Path | None,
        typer.Option(
            help="Configuration file of the server (TOML); without it, one simulated display is "
            "served."
        ),
    ] = None,
) -> None:
    """Serve displays to other programs by WebSocket and OSC.

    A browser shows the displays at the address that is printed. The server runs until it is
    interrupted. The exit code is 1 if a device cannot be opened.

    Example: tactile serve --config tactile.toml
    """
    from tactile.server.config import load_config
    from tactile.server.server import serve

    settings = load_config(config)
    names = ", ".join(f"{one.name} ({one.device})" for one in settings.display)

    def announce(server: "Server") -> None:
        line = f"{server.url} plays {names}; open {server.page} to see it; Ctrl-C ends it\n"
        print(line, end="", flush=True)  # whole, also into a pipe where a program waits for it

    try:
        serve(settings, announce)
    except BusError as error:  # not 2: a device may be there when systemd tries again
        print(f"tactile: {error}", file=sys.stderr)
        raise typer.Exit(1) from error
