"""Ledger that checks that an amplifier puts out each sample once and in its place, or counts it.

Between faults the samples of a stream come as they were written, but for a gain that rises after
each START and each gap. A sample that differs after `SETTLED` right ones in a row wants a counter
of the amplifier that has changed; so does one that still differs when the gain has long risen.
"""

import math

from firmware_protocol.machine import AmplifierCounters, PlayedRun
from firmware_protocol.messages import State
from tactile.arrays import Floats
from tactile.bus.base import DriveBlock

KEPT, SETTLED = 2000, 64
"""Samples that a ledger keeps, and that must be right in a row before a wrong one counts."""
FADED = 500
"""Samples after which a gain has risen, after a START or a gap."""


class Ledger:
    """Record of what was written of a stream, and of what the first amplifier put out in its place.

    Attributes
    ----------
    exact : samples that came as they were written, in their place
    unexplained : times [s] from which others came though the amplifier had counted nothing
    """

    def __init__(self) -> None:
        self.exact = 0
        self.unexplained: list[float] = []
        self._written: dict[int, Floats] = {}
        self._first, self._origin = 0, math.nan
        self._settled, self._astray, self._read = 0, 0, 0.0
        self._counted = self._before = AmplifierCounters()

    def begin(self, position: int) -> None:
        """Take the position that the next START plays first."""
        self._first, self._origin = position, math.nan

    def write(self, block: DriveBlock) -> None:
        """Take what is written; what was written at a position before is over."""
        for position, volts in enumerate(block.volts, block.position):
            self._written.pop(position, None)
            self._written[position] = volts
        while len(self._written) > KEPT:
            del self._written[next(iter(self._written))]

    def withdraw(self) -> None:
        """Forget what was written and may not have been sent: the stream ends here."""
        self._written.clear()

    def put_out(self, run: PlayedRun, volts: Floats, times: Floats, rough: float) -> None:
        """Compare what is put out while the amplifier plays, within what its format rounds [V]."""
        if run.state != State.RUNNING:
            self._settled = 0
            return
        if math.isnan(self._origin):
            self._origin = run.position - self._first
        start = int(run.position - self._origin)
        places = range(start, start + len(volts))
        for position, sample, time in zip(places, volts, times, strict=True):
            written = self._written.get(position)
            if written is None:  # before the first, or after the last
                continue
            if all(abs(a - b) <= rough for a, b in zip(sample, written, strict=False)):
                self._settled += bool(sample.any())  # 0 V is also put out where nothing has come
                self._astray = 0
                self.exact += 1
                continue
            explained = self._counted != self._before
            self._astray = 0 if explained else self._astray + 1
            if self._astray > FADED or (self._settled >= SETTLED and not explained):
                self.unexplained.append(time)
            self._settled = 0

    def count(self, counters: AmplifierCounters, now: float) -> None:
        """Take what the amplifier has counted, when it has put out what comes next."""
        if now != self._read:
            self._before, self._read = self._counted, now
        self._counted = counters
