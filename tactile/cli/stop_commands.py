"""Commands for an emergency: ``estop`` and ``clear``.

``estop`` must come at once, so nothing is imported here that it does not need.
"""

import json
import shlex
from dataclasses import asdict
from typing import Annotated

import typer

from tactile.cli.app import AcceptHold, AsJson, app
from tactile.estop.request import request_estop


@app.command("estop")
def stop_displays(
    display: Annotated[
        str | None, typer.Argument(help="The only display to stop; all where none is named.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Stop every display of this machine at once: 0 V, high voltage off, until it is cleared.

    It has a way of its own, which works also while a daemon is flooded or hangs. What tactile play
    or tactile check drives goes by the URL of its device. Exit code 1 says that nothing was
    stopped, or that a daemon did not answer.

    Example: tactile estop
    """
    answers = request_estop(display)
    latched = any(answer.estops for answer in answers)
    failed = [
        one for one in answers if one.failure and not (latched and (one.unknown or one.is_gone))
    ]
    code = 0 if latched and not failed else 1
    if as_json:
        typer.echo(json.dumps([asdict(answer) for answer in answers]))
        raise typer.Exit(code)
    for answer in answers:
        for name, number in answer.estops.items():  # a name with a colon is the URL of a device
            way = f"tactile clear --device {shlex.quote(name)}" if ":" in name else "tactile clear"
            typer.echo(f"{name}: e-stop {number} is latched; {way} ends it")
    for answer in failed:
        typer.echo(f"{answer.socket}: {answer.failure}", err=True)
    if not answers:
        typer.echo("nothing of tactile runs on this machine that could be stopped", err=True)
    raise typer.Exit(code)


@app.command("clear")
def clear_display(
    display: Annotated[
        str | None,
        typer.Argument(
            help="Name of the display, where several are e-stopped; with --device its name or "
            "TOML file, reference-24 by default."
        ),
    ] = None,
    estop: Annotated[
        int | None,
        typer.Option(min=1, help="Number of the e-stop to end; asked for where not given."),
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="Of the daemon; by default the one of this machine.")
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="URL of a device that no daemon has, in place of a display.")
    ] = None,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """End an e-stop, once a person has seen that it is safe; the display is disarmed then.

    Only the e-stop that is named ends: one that comes meanwhile holds.

    Example: tactile clear right --estop 3
    """
    from tactile.client import open_connection
    from tactile.errors import InputError

    if as_json and estop is None:
        raise InputError("clear --json: --estop must name the e-stop, as nobody is asked")
    if device is not None:
        if url is not None:
            raise InputError("clear: --device is one that no daemon has, so it excludes --url")
        cleared = _clear_device(device, display or "reference-24", estop, accept_unsafe_hold)
        _tell_cleared(device, cleared, as_json=as_json)
        return
    with open_connection(url, client_name="tactile clear", reconnect=False) as connection:
        holding = {one.name: one.estop for one in connection.welcome.displays if one.estop}
        chosen = [display] if display is not None else list(holding)
        if len(chosen) > 1:
            raise InputError(f"clear: {', '.join(chosen)} are e-stopped; name one of them")
        names = [one.name for one in connection.welcome.displays]
        if chosen and chosen[0] not in names:
            raise InputError(f"clear: no display {chosen[0]!r}; there are {', '.join(names)}")
        cleared = 0
        if chosen and (estop is not None or holding.get(chosen[0])):
            (name,) = chosen
            cleared = estop if estop is not None else holding[name]
            why = connection.display(name).stats().detail
            if estop is None:
                _confirm(name, cleared, why)
            connection.display(name).clear(estop=cleared)
    _tell_cleared(chosen[0] if chosen else None, cleared, as_json=as_json)


def _clear_device(device: str, display: str, estop: int | None, accept_unsafe_hold: bool) -> int:
    """End the e-stop of a device that no daemon has; return its number, 0 where none held."""
    from tactile import load_display
    from tactile.playback.estop_guard import clear_device

    def choose(number: int, reason: str) -> int:
        if estop is not None:
            return estop
        _confirm(device, number, reason)
        return number

    shown = load_display(display)
    return clear_device(device, shown, choose, accept_unsafe_hold=accept_unsafe_hold)


def _confirm(name: str, number: int, reason: str) -> None:
    """Ask whether an e-stop may be cleared; abort the command where it may not."""
    typer.confirm(f"{name}: e-stop {number} holds, {reason}. Is it safe to clear it?", abort=True)


def _tell_cleared(name: str | None, number: int, *, as_json: bool) -> None:
    """Print which e-stop was cleared; the number is 0 where none held."""
    if as_json:
        typer.echo(json.dumps({"display": name, "cleared": number}))
    elif number:
        typer.echo(f"{name}: e-stop {number} is cleared; it is disarmed")
    else:
        typer.echo("no e-stop holds")
