"""Playback process that also records which contacts each of its blocks was rendered from."""

import os
from typing import Any

import numpy as np

from tactile.playback import process
from tactile.playback.loop import PlaybackLoop
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

FILE = "TACTILE_BENCHMARK_TRACE"
"""Environment variable with the path of the file that the trace is written to."""


class CountingTracker(ContactTracker):
    """Tracker of the finger that counts its samples."""

    count = 0
    """Number of samples that were added."""

    def add(self, sample: FingerSample) -> None:
        """Add a sample and count it."""
        self.count += 1
        super().add(sample)


class TracedLoop(PlaybackLoop):
    """Playback loop that writes its trace to `FILE` when it is disarmed.

    A row of the trace holds the position of a block [samples], the number of contacts that had
    come when it was rendered, and the time at which it is due in the host's clock [s].
    """

    def __init__(self, *words: Any, **options: Any) -> None:
        super().__init__(*words, **options)
        self.tracker = self._counting = CountingTracker()
        self._trace: list[tuple[float, float, float]] = []

    def step(self) -> None:
        """Play a block and record it."""
        blocks = self.report.blocks
        super().step()
        if self.report.blocks > blocks:
            position = self.position - self.rendering.spacing
            contacts = self._counting.count + self.memory.lost_contacts
            due = self.bus.due(position + self.rendering.first)
            self._trace.append((position, contacts, due))

    def disarm(self) -> None:
        """Stop, and write the trace."""
        super().disarm()
        np.save(os.environ[FILE], np.array(self._trace))


def main() -> None:
    """Play as the server orders on standard input, with a trace."""
    setattr(process, "PlaybackLoop", TracedLoop)  # noqa: B010
    process.main()
