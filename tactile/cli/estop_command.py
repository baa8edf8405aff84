"""The command ``tactile estop``.

It must act at once, so this module imports nothing that it does not need.
"""

import shlex
import sys
from dataclasses import asdict
from typing import Annotated

import typer

from tactile.cli.options import AsJson, emit
from tactile.estop.request import EstopAnswer, request_estop


def run(
    display: Annotated[
        str | None,
        typer.Argument(help="Name of the only display to stop. Without it, all are stopped."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Stop all displays of this machine immediately.

    The outputs go to 0 V and the high voltage is switched off until the e-stop is cleared. The
    request does not go through the network connection of the server, so that it also works while
    the server is overloaded or hangs. A display that is driven by tactile play or tactile check has
    the URL of its device as its name. The exit code is 1 if nothing was stopped or a server did not
    answer.

    Example: tactile estop
    """
    answers = request_estop(display)
    latched = any(answer.estops for answer in answers)
    failed = [
        one for one in answers if one.failure and not (latched and (one.unknown or one.is_gone))
    ]
    emit([asdict(answer) for answer in answers], as_json, lambda _: _print(answers, failed))
    raise typer.Exit(0 if latched and not failed else 1)


def _print(answers: list[EstopAnswer], failed: list[EstopAnswer]) -> None:
    """Print what was stopped, and on standard error what was not."""
    for answer in answers:
        for name, number in answer.estops.items():  # a name with a colon is the URL of a device
            way = f"tactile clear --device {shlex.quote(name)}" if ":" in name else "tactile clear"
            print(f"{name}: e-stop {number} is latched; {way} ends it")
    for answer in failed:
        print(f"{answer.socket}: {answer.failure}", file=sys.stderr)
    if not answers:
        print("no tactile program that can be stopped is running on this machine", file=sys.stderr)
