"""Whether a client lives, while something that it began sounds or holds high voltage.

It is pinged every 50 ms then, and anything that it sends is a sign of life. Silence counts only
while this event loop itself runs: a machine that stood still does not take its clients for dead.
"""

import asyncio
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

from tactile.clock import loop_time
from tactile.playback.silence import SilenceTimer

TICK = 0.025
"""s between two looks at all clients."""
PING_EVERY = 0.05
"""s between pings to a client that has something at stake."""
QUIET_AFTER = 0.15
"""s of silence after which what a client plays fades."""
GIVE_UP_AFTER = 0.5
"""s of silence after which a client's high voltage is given up."""


class Due(NamedTuple):
    """What is to be done about a client now."""

    ping: bool = False
    quiet: bool = False
    give_up: bool = False


class SignsOfLife:
    """Counts a client's silence, with the time passed in."""

    def __init__(self) -> None:
        self._silence = SilenceTimer(longest_step=2 * TICK)
        self._until_ping = 0.0
        self._received = -1

    def step(self, passed: float, received: int, *, at_stake: bool) -> Due:
        """Return what is due after some time.

        Parameters
        ----------
        passed : s since the last step; more than two ticks count as two
        received : how often anything was received from the client, since it came
        at_stake : whether it sounds or holds high voltage
        """
        before = self._silence.seconds
        now = self._silence.look(passed, sign=received != self._received or not at_stake)
        self._received = received
        self._until_ping -= passed
        if not at_stake:
            self._until_ping = 0.0
            return Due()
        ping = self._until_ping <= 0
        if ping:
            self._until_ping = PING_EVERY
        return Due(
            ping,
            quiet=before < QUIET_AFTER <= now,
            give_up=before < GIVE_UP_AFTER <= now,
        )


class Watched(Protocol):
    """Who is looked at, as `tactile.server.connection.ServerConnection`."""

    def look(self, passed: float) -> None:
        """Do what is due after some time [s]; never raises."""
        ...


async def look_after(clients: Callable[[], Iterable[Watched]]) -> None:
    """Look at all clients in each tick, for as long as this runs."""
    before = loop_time()
    while True:
        await asyncio.sleep(TICK)
        now = loop_time()
        for client in tuple(clients()):
            client.look(now - before)
        before = now
