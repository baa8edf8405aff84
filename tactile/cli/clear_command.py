"""The command ``tactile clear``."""

from typing import Annotated

import typer

from tactile.cli.options import AcceptHold, AsJson, emit
from tactile.errors import InputError


def run(
    display: Annotated[
        str | None,
        typer.Argument(
            help="Name of the display, required if several displays are e-stopped. With --device: "
            "name or TOML file of the display at that device, reference-24 by default."
        ),
    ] = None,
    estop: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of the e-stop to clear. Without it, the command asks for confirmation.",
        ),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(help="URL of the server; by default the server of this machine."),
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="URL of a device that is not driven by a server.")
    ] = None,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Clear an e-stop after a person has checked that it is safe.

    The display is disarmed afterwards. Only the e-stop with the given number is cleared: a later
    one stays in effect.

    Example: tactile clear right --estop 3
    """
    if as_json and estop is None:
        raise InputError("--json: give the number of the e-stop with --estop, as nobody is asked")
    if device is None:
        name, cleared = _clear_of_server(url, display, estop)
    elif url is not None:
        raise InputError("--url cannot be used with --device, which has no server")
    else:
        name = device
        cleared = _clear_device(device, display or "reference-24", estop, accept_unsafe_hold)
    emit({"display": name, "cleared": cleared}, as_json, lambda _: _print(name, cleared))


def _clear_of_server(
    url: str | None, display: str | None, estop: int | None
) -> tuple[str | None, int]:
    """Clear the e-stop of a display of a server; return the display and the e-stop, or None, 0."""
    from tactile.client import open_connection

    with open_connection(url, client_name="tactile clear", reconnect=False) as connection:
        holding = {one.name: one.estop for one in connection.welcome.displays if one.estop}
        chosen = [display] if display is not None else list(holding)
        if len(chosen) > 1:
            raise InputError(f"{', '.join(chosen)} are e-stopped; name one of them")
        if not chosen:
            return None, 0
        (name,) = chosen
        names = [one.name for one in connection.welcome.displays]
        if name not in names:
            raise InputError(f"no display {name!r}; there are {', '.join(names)}")
        if estop is None and name not in holding:
            return name, 0
        if estop is None:
            estop = holding[name]
            _confirm(name, estop, connection.display(name).stats().detail)
        connection.display(name).clear(estop=estop)
        return name, estop


def _clear_device(device: str, display: str, estop: int | None, accept_unsafe_hold: bool) -> int:
    """Clear the e-stop of a device without a server; return its number, or 0 if there is none."""
    from tactile import load_display
    from tactile.playback.estop_guard import clear_device

    def choose(number: int, reason: str) -> int:
        if estop is not None:
            return estop
        _confirm(device, number, reason)
        return number

    loaded = load_display(display)
    return clear_device(device, loaded, choose, accept_unsafe_hold=accept_unsafe_hold)


def _confirm(name: str, number: int, reason: str) -> None:
    """Ask whether an e-stop may be cleared, and abort the command if not."""
    typer.confirm(f"{name}: e-stop {number} holds, {reason}. Is it safe to clear it?", abort=True)


def _print(name: str | None, number: int) -> None:
    """Print which e-stop was cleared; the number 0 means that there was none."""
    if number:
        print(f"{name}: e-stop {number} is cleared; the display is disarmed")
    else:
        print("no e-stop holds")
