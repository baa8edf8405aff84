"""Notifications to systemd: that the server is ready, that it is alive, and that it ends."""

import asyncio
import os
import socket
from collections.abc import Callable
from contextlib import suppress


def notify(state: str) -> None:
    """Notify systemd as sd_notify(3) does; never block and never raise.

    Nothing happens if systemd did not start the server.

    Parameters
    ----------
    state : str
        Assignment such as "READY=1".
    """
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path.startswith(("/", "@")):
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.setblocking(False)
        link.sendto(state.encode(), path.replace("@", "\0", 1) if path[0] == "@" else path)


def interval() -> float | None:
    """Return the interval at which systemd is to be told that the server is alive.

    Returns
    -------
    float or None
        Half the interval that systemd demands [s]; None if it demands nothing of this process.
    """
    micros = os.environ.get("WATCHDOG_USEC", "")
    addressed = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(micros) * 0.5e-6 if micros.isdecimal() and int(micros) and addressed else None


async def keep_alive(beat: Callable[[], bool]) -> None:
    """Tell systemd that the server is alive, for as long as it is.

    Parameters
    ----------
    beat : callable
        Function that returns whether the server has made progress since its last call.
    """
    pause = interval()
    while pause is not None:
        if beat():
            notify("WATCHDOG=1")
        await asyncio.sleep(pause)
