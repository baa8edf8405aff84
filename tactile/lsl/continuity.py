"""Continuity of samples: how many are missing, and where their time jumps."""

from typing import NamedTuple

from tactile.client.wire import CommandedSamples

JUMP = 1e-3
"""Least step of time at which samples do not follow one another [s]. Estimates of clocks were seen
to step by 0.02 ms on one machine, and by up to 0.7 ms with the delays of a wireless network
(simulated); playback that was late leaves out more than 1 ms."""


class Interruption(NamedTuple):
    """What interrupts samples, and the time of the first sample after it.

    Attributes
    ----------
    text : str
        Description.
    time : float
        Time on the monotonic clock [s].
    """

    text: str
    time: float


class Continuity:
    """Numbers and times of the samples that came.

    Attributes
    ----------
    missing : int
        Number of samples that are missing so far.
    """

    def __init__(self) -> None:
        self.missing = 0
        self._next: int | None = None
        self._end: float | None = None

    def restart(self) -> None:
        """Take the next sample for the first of another sequence, as of a server that restarted."""
        self._next = None

    def take(self, samples: CommandedSamples) -> list[Interruption]:
        """Take samples of at least one block.

        Parameters
        ----------
        samples : CommandedSamples
            Samples; a lower number than expected means that numbering began anew.

        Returns
        -------
        list of Interruption
            What interrupts them, and the sequence before them.
        """
        length = samples.block_samples / samples.sample_rate
        missing = 0 if self._next is None else max(samples.first - self._next, 0)
        self._next = samples.first + len(samples.times) * samples.block_samples
        self.missing += missing
        first = samples.times[0]
        expected = first if self._end is None else self._end
        interruptions = []
        if missing:
            plural = "s" if missing > 1 else ""
            interruptions.append(Interruption(f"missing {missing} sample{plural}", first))
            expected = first
        for time in samples.times:
            if abs(time - expected) >= JUMP:
                step = 1e3 * (time - expected)
                interruptions.append(Interruption(f"time jumps by {step:.6g} ms", time))
            expected = time + length
        self._end = expected
        return interruptions
