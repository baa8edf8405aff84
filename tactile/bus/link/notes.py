"""Lines for the log of the program that come from the link, ten a second at most.

The session adds them under the lock of the bus, and `LinkBus` writes them without it.
"""

import logging
from collections import deque
from collections.abc import Iterable

from firmware_protocol import messages as m

logger = logging.getLogger("tactile.bus")

MOST = 10
"""Maximum number of lines in any second; an amplifier may send LOG as fast as the wire carries."""
LEVELS = (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR)
"""Levels of the program's log by those of LOG."""


class LinkNotes:
    """Lines that wait to be written to the log."""

    def __init__(self) -> None:
        self._times: deque[float] = deque([float("-inf")] * MOST, maxlen=MOST)
        """Host times of the latest lines, the oldest first [s]."""
        self._waiting: deque[tuple[int, str]] = deque(maxlen=MOST)
        self._left_out = 0
        self._strangers: set[int] = set()
        """Nodes that were noted as none of the bus."""

    def add(self, level: int, line: str, now: float) -> None:
        """Add a line, unless there were `MOST` in the last second; those are only counted.

        Parameters
        ----------
        level : int
            Level of `logging`.
        line : str
            Text without a line break.
        now : float
            Host time [s].
        """
        if not logger.isEnabledFor(level):
            return
        if now < self._times[0] + 1.0:
            self._left_out += 1
            return
        if self._left_out:
            line, self._left_out = f"{line} (after {self._left_out} lines that are left out)", 0
        self._times.append(now)
        self._waiting.append((level, line))

    def add_log(self, node: int, message: m.Log, now: float) -> None:
        """Add the text of a LOG, as far as it can be printed.

        Parameters
        ----------
        node : int
            Address of the amplifier.
        message : Log
            Message of the amplifier.
        now : float
            Host time [s].
        """
        text = message.text.decode("utf-8", "replace")
        text = "".join(c if c.isprintable() else " " for c in text)
        level = LEVELS[min(message.level, len(LEVELS) - 1)]
        self.add(level, f"node {node} says: {' '.join(text.split())}", now)

    def add_stranger(self, node: int, nodes: Iterable[int], now: float) -> None:
        """Add one line, once, on an amplifier that reports and is none of the bus.

        Parameters
        ----------
        node : int
            Its address.
        nodes : iterable of int
            Addresses of the amplifiers of the bus.
        now : float
            Host time [s].
        """
        if node not in self._strangers:
            self._strangers.add(node)
            own = ", ".join(map(str, nodes))
            line = f"node {node} reports as well, and is no amplifier of this bus, which has {own}"
            self.add(logging.WARNING, line, now)

    def write(self) -> None:
        """Write the lines that wait; the caller holds no lock."""
        while self._waiting:
            level, line = self._waiting.popleft()
            logger.log(level, "%s", line)
