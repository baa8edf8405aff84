"""Numbers that JACK gives its frames: how many frames are missing between two cycles."""

CYCLE = 1 << 32
"""Number after which JACK's numbers of frames begin anew."""


def frames_between(first: int, last: int) -> int:
    """Return how many frames are between two numbers that begin anew after 32 bits.

    Parameters
    ----------
    first, last : int
        Numbers of two frames.

    Returns
    -------
    int
        Number of frames from the first to the last; negative if that one is earlier.
    """
    return (last - first + CYCLE // 2) % CYCLE - CYCLE // 2


class FrameNumbers:
    """Numbers of the frames that came.

    Attributes
    ----------
    missing : int
        Number of frames that are missing so far.
    """

    def __init__(self) -> None:
        self.missing = 0
        self._next: int | None = None

    def restart(self) -> None:
        """Take the next frame for the first of another sequence, as of a server that restarted."""
        self._next = None

    def take(self, number: int, count: int) -> int:
        """Take the frames of a cycle, and count those that are missing before it.

        Parameters
        ----------
        number : int
            Number of the first frame; an earlier one than expected begins another sequence.
        count : int
            Number of frames.

        Returns
        -------
        int
            Number of frames that are missing before the cycle.
        """
        missing = 0 if self._next is None else max(frames_between(self._next, number), 0)
        self.missing += missing
        self._next = (number + count) % CYCLE
        return missing
