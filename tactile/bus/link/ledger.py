"""What one amplifier has put out since playing began, by its reports alone.

PULSE and STATUS say which position is put out next, and STATUS how many positions of RUNNING were
bridged or silent (SPEC.md, 8.2). What no report confirms was not put out: an amplifier without
power goes unnoticed for a quarter of a second, in which it takes samples like any other.
"""

from firmware_protocol import messages as m
from firmware_protocol.messages import Phase, State
from firmware_protocol.packet import TURN
from firmware_protocol.player import distance

NEXT_REPORT = 0.1
"""Longest time from a report of RUNNING to the next report for which the amplifier is taken to have
run up to that, ten times the interval of PULSE (assumed) [s]."""


class OutputLedger:
    """Count of the positions that one amplifier has put out since playing began.

    Attributes
    ----------
    running : bool
        Whether the amplifier runs, since no report after the latest START says that it stopped.
    passed : int
        Number of positions since the latest START of which reports say that they have passed.
    """

    def __init__(self) -> None:
        self.running, self.passed = False, 0
        self._begin = self._silent = self._lost = self._earlier = 0
        """Wire position of START; positions from there on that were waited for, and positions that
        were bridged or silent later; positions that were put out before START."""
        self._reported = 0.0
        """Host time of START, or of the latest report of RUNNING [s]."""
        self._lost_seen: int | None = None
        """Latest value of the amplifier's counter of lost samples."""

    def clear(self) -> None:
        """Forget what was put out, because playing begins anew."""
        self.running = False
        self.passed = self._silent = self._lost = self._earlier = 0

    def start(self, begin: int, time: float) -> None:
        """Take note of a START.

        Parameters
        ----------
        begin : int
            Position on the wire that is put out first.
        time : float
            Host time at which it is put out [s].
        """
        self._earlier = self.put_out(self.passed)
        self._begin, self._reported, self.running = begin, time, True
        self.passed = self._silent = self._lost = 0

    def count_lost(self, count: int) -> None:
        """Take the amplifier's counter of lost samples, which rises only after a START.

        Parameters
        ----------
        count : int
            `lost_samples` of STATUS.
        """
        self._lost += rise(count, self._lost_seen)
        self._lost_seen = count

    def report_running(self, now: float) -> None:
        """Take a report of RUNNING whose position is of no use.

        Parameters
        ----------
        now : float
            Host time of its reception [s].
        """
        if self.running:
            self._reported = max(now, self._reported)

    def report(self, message: m.Pulse | m.Status, position: int, now: float) -> None:
        """Take a report.

        Parameters
        ----------
        message : Pulse or Status
            Report of the amplifier.
        position : int
            Position that it says is put out next, modulo 2³²; one that can be that of this START.
        now : float
            Host time of its reception [s].
        """
        # It wraps, and playing may last for weeks.
        passed = self.passed + distance(position % TURN, (self._begin + self.passed) % TURN)
        runs = message.state == State.RUNNING
        # What is not RUNNING before the time of START may be a report from before it has come.
        if not self.running or passed < 0 or (now < self._reported and not runs):
            return
        self.running = runs
        if self.running or now - self._reported < NEXT_REPORT:
            self.passed = max(passed, self.passed)
        if self.running:
            self._reported = now
            if message.phase == Phase.WAITING:
                self._silent = self.passed

    def put_out(self, written: int, held: int = 0) -> int:
        """Return how many positions were put out as they were written, since playing began.

        Parameters
        ----------
        written : int
            Number of positions since the latest START that were written.
        held : int
            Number of positions after them that have something to play; those after that are lost
            for want of a STOP, and not of the stroke.

        Returns
        -------
        int
            Number of positions.
        """
        after = max(self.passed - written - held, 0)
        lost = self._silent + max(self._lost - after, 0)
        return self._earlier + max(min(self.passed, written) - lost, 0)


def rise(count: int, last: int | None) -> int:
    """Return how much a counter has risen since its last value; it may have begun anew at 0.

    Parameters
    ----------
    count : int
        Present value.
    last : int or None
        Last value; None if there was none.

    Returns
    -------
    int
        Rise, 0 if there was no last value.
    """
    if last is None:
        return 0
    return count - last if count >= last else count
