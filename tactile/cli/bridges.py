"""Parts of commands that are programs on a server and run until they are ended."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from tactile.errors import InputError

if TYPE_CHECKING:
    from tactile.client import Connection, RemoteDisplay

INTERRUPTED = 130
"""Exit code after Ctrl-C, as of a shell (128 + SIGINT)."""


def choose_display(connection: "Connection", name: str | None) -> "RemoteDisplay":
    """Return the display of a name, or the only one.

    Parameters
    ----------
    connection : connection to the server
    name : name that the user gave, or None

    Returns
    -------
    RemoteDisplay
        The display.

    Raises
    ------
    InputError
        If there is none of that name, or there are several and none is named.
    """
    names = list(connection.displays)
    if name is None and len(names) > 1:
        raise InputError(f"which display? the server has {', '.join(names)}; name one of them")
    return connection.display(name)


@contextmanager
def until_stopped() -> Iterator[tuple[threading.Event, set[int]]]:
    """Yield an event that SIGINT and SIGTERM set, and the set of those that were received.

    Yields
    ------
    (threading.Event, set of int)
        The event and the signals.
    """
    stop, received = threading.Event(), set[int]()

    def end(number: int, _: object) -> None:
        received.add(number)  # once more changes nothing: the program ends soon, with its summary
        stop.set()

    before: dict[int, Any] = {
        number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop, received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def exit_if_interrupted(received: set[int]) -> None:
    """End the command as a shell expects it after Ctrl-C.

    Parameters
    ----------
    received : signals that ended the command

    Raises
    ------
    typer.Exit
        If Ctrl-C was among them.
    """
    if signal.SIGINT in received:
        print("tactile: interrupted", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
