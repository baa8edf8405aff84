"""What systemd is told: that the daemon is ready, that it lives, that it ends."""

import asyncio
import os
import socket
from collections.abc import Callable
from contextlib import suppress


def notify(state: str) -> None:
    """Tell systemd, as sd_notify(3); do nothing where nobody asks, never block and never raise."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path.startswith(("/", "@")):
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.setblocking(False)
        link.sendto(state.encode(), path.replace("@", "\0", 1) if path[0] == "@" else path)


def interval() -> float | None:
    """Return how often systemd is to be told that we live [s]: twice as often as it asks."""
    asked = os.environ.get("WATCHDOG_USEC", "")
    meant = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(asked) * 0.5e-6 if asked.isdecimal() and int(asked) and meant else None


async def keep_alive(beat: Callable[[], bool]) -> None:
    """Tell systemd that we live for as long as ``beat`` is true."""
    pause = interval()
    while pause is not None:
        if beat():
            notify("WATCHDOG=1")
        await asyncio.sleep(pause)
