"""Detection of dead clients while something that they started sounds or holds high voltage.

Such a client is pinged every 50 ms, and anything that it sends is a sign of life. Silence counts
only while this event loop itself runs, so that a machine that stood still does not take its clients
for dead.
"""

import asyncio
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, NamedTuple

from tactile.clock import loop_time
from tactile.playback.silence import SilenceTimer

if TYPE_CHECKING:
    from tactile.server.connection import ServerConnection

TICK = 0.025
"""Interval between checks of all clients [s]."""
PING_EVERY = 0.05
"""Interval between pings to a client that has something at stake [s]."""
QUIET_AFTER = 0.15
"""Silence after which the waveforms and effects of a client are faded [s]."""
GIVE_UP_AFTER = 0.5
"""Silence after which a client loses its high voltage [s]."""


class Due(NamedTuple):
    """Actions that are due for a client.

    Attributes
    ----------
    ping : bool
        Whether to ping the client.
    quiet : bool
        Whether to fade its waveforms and effects.
    give_up : bool
        Whether to take its share of high voltage away.
    """

    ping: bool = False
    quiet: bool = False
    give_up: bool = False


class SignsOfLife:
    """Measurement of a client's silence; the time is passed in."""

    def __init__(self) -> None:
        self._silence = SilenceTimer(longest_step=2 * TICK)
        self._until_ping = 0.0
        self._received = -1

    def step(self, passed: float, received: int, *, at_stake: bool) -> Due:
        """Advance by some time and return what is due.

        Parameters
        ----------
        passed : float
            Time since the last step [s]; more than two ticks count as two.
        received : int
            How often anything was received from the client since it connected.
        at_stake : bool
            Whether the client sounds or holds high voltage.

        Returns
        -------
        Due
            Actions that are due now.
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


async def watch_clients(clients: Callable[[], Iterable["ServerConnection"]]) -> None:
    """Check all clients in each tick, until cancelled.

    Parameters
    ----------
    clients : callable
        Function that returns the clients at present.
    """
    before = loop_time()
    while True:
        await asyncio.sleep(TICK)
        now = loop_time()
        for client in tuple(clients()):
            client.check(now - before)
        before = now
