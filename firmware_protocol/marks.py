"""Marker lines of an amplifier (section 18 of SPEC.md)."""

from firmware_protocol.messages import MARKS_MOST, Mark
from firmware_protocol.player import distance


class Marks:
    """Marks that are kept until their positions come, and the code on the marker lines.

    Attributes
    ----------
    lines : int
        Code on the lines at the instants of the latest run.
    """

    def __init__(self) -> None:
        self.lines = 0
        self._left = 0
        """Number of instants for which the code stays, after those of the latest run."""
        self._kept: dict[int, Mark] = {}

    def forget(self) -> None:
        """Forget the marks that are kept, as at START."""
        self._kept.clear()

    def keep(self, mark: Mark, position: int, fifo: int) -> None:
        """Keep a mark until its position comes, or drop it.

        Parameters
        ----------
        mark : Mark
            The mark.
        position : int
            Position that is put out next.
        fifo : int
            Depth of the sample buffer [samples].
        """
        room = len(self._kept) < MARKS_MOST or mark.position in self._kept
        if room and 0 <= distance(mark.position, position) < fifo:
            self._kept[mark.position] = mark

    def longest(self, count: int, position: int, *, running: bool) -> int:
        """Return the length of a run of instants in which the lines do not change.

        Parameters
        ----------
        count : int
            Largest number of instants.
        position : int
            Position of the first one.
        running : bool
            Whether marks are shown, as in RUNNING once START is no longer pending.

        Returns
        -------
        int
            Number of instants, 1 at the position of a mark.
        """
        if self._left:
            count = min(count, self._left)
        if running and self._kept:
            ahead = min(distance(at, position) for at in self._kept)
            count = min(count, ahead or 1)
        return count

    def advance(self, count: int, position: int, *, running: bool, playing: bool) -> Mark | None:
        """Go on by a run of instants that were put out.

        Parameters
        ----------
        count : int
            Number of instants, as `longest` allows it.
        position : int
            Position of the first one.
        running : bool
            Whether marks are shown, as in `longest`.
        playing : bool
            Whether the phase is PLAYING.

        Returns
        -------
        Mark or None
            Mark that was shown with the first instant; None if there was none.
        """
        mark = self._kept.pop(position, None) if running else None
        if mark is not None and playing:
            self.lines, self._left = mark.code, mark.samples
        elif not self._left:
            self.lines = 0
            return None
        self._left -= count
        return mark if playing else None
