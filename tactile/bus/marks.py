"""Marks on the marker lines of an amplifier, as its host passes them on and learns that they came.

A recorder of another maker takes the time of a stimulus from a line that rises with its first
sample (SPEC.md, 18). `AmplifierMarks` keeps the marks of one amplifier until the samples of their
positions go to it, so that nothing is marked that was never written. It has neither I/O nor a
clock. `MarkReport` is what an amplifier reports.
"""

from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol import messages as m
from firmware_protocol.messages import MARKS_MOST

MARK_LENGTH = 10e-3
"""Time for which a code is on the marker lines; a recorder that samples at 200 Hz sees it [s]."""
MOST_SENT = 64
"""Maximum number of marks whose report is waited for, the newest ones; one that was lost on the way
has none."""


@dataclass(frozen=True)
class MarkReport:
    """A code that the marker lines of an amplifier have taken.

    Attributes
    ----------
    position : int
        Position of the sample with which they took it, on the scale that `Bus.start` begins.
    code : int
        The code; line k is high where bit k is set.
    """

    position: int
    code: int


class AmplifierMarks:
    """Marks of one amplifier since a START.

    It has no lock; its owner calls it under its own.

    Parameters
    ----------
    rate : float
        Sample rate [Hz].
    """

    def __init__(self, rate: float) -> None:
        self._samples = max(1, round(MARK_LENGTH * rate))
        self._waiting: dict[int, int] = {}
        """Codes by the positions of marks whose samples have not been sent."""
        self._sent: dict[int, int] = {}
        """Positions of marks that were sent, by their positions on the wire."""

    def add(self, position: int, code: int) -> None:
        """Let a mark wait for its sample, in place of an earlier one for the same position.

        Where as many wait as an amplifier keeps, it is dropped.

        Parameters
        ----------
        position : int
            Position of the sample.
        code : int
            Code for the marker lines.
        """
        if position in self._waiting or len(self._waiting) < MARKS_MOST:
            self._waiting[position] = code

    def forget(self) -> None:
        """Drop all marks that wait."""
        self._waiting.clear()

    def take(self, start: int, end: int, session: int, wire: Callable[[int], int]) -> list[m.Mark]:
        """Remove the marks of samples that are about to be sent, and earlier ones.

        Parameters
        ----------
        start, end : int
            Position of the first sample, and the position after the last one.
        session : int
            Token of the session.
        wire : callable
            Function that returns the position on the wire, modulo 2³², for one of the owner.

        Returns
        -------
        list of Mark
            Messages to be sent ahead of the samples, without those of positions before the start,
            whose samples do not come any more.
        """
        messages = []
        for position in sorted(self._waiting):
            if position >= end:
                break
            code = self._waiting.pop(position, 0)  # an e-stop may have emptied it meanwhile
            if position >= start and code:
                at = wire(position)
                self._sent[at] = position
                messages.append(m.Mark(session, at, code, self._samples))
        for old in list(self._sent)[:-MOST_SENT]:
            self._sent.pop(old, None)
        return messages

    def report(self, message: m.Marked) -> MarkReport | None:
        """Return what the amplifier reports.

        Parameters
        ----------
        message : Marked
            Message of the amplifier.

        Returns
        -------
        MarkReport or None
            The report; None if it is of no mark that was sent since the START, or comes again.
        """
        position = self._sent.pop(message.position, None)
        return None if position is None else MarkReport(position, message.code)
