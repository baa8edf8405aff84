"""Playback process that also records which tactile frame each of its blocks plays."""

import os
from typing import Any

import numpy as np

from benchmarks.traced_playback import FILE
from tactile.playback import commands, process
from tactile.playback.frame_stream import FrameStream, LatestFrames, QueuedFrames
from tactile.playback.loop import PlaybackLoop
from tactile.playback.mixer import MixerOrder

COUNT = 1 << 16
"""Number of frames that are numbered: the first contactor's value is the number over this."""
AMPLITUDE = 2e-6
"""Shear of a value of 1 in the frames [m]."""


class FrameTracingLoop(PlaybackLoop):
    """Playback loop that writes two traces to `FILE` when it is disarmed.

    A row of ``blocks`` holds the position of a block [samples], the time at which it is due in the
    host's clock [s], the number of the newest frame, and for a queue the place of its first sample
    among the frames, the distance of its samples [frames], and the number of the stream. A row of
    ``frames`` holds the number of a frame, its place among those of its stream, and that stream.
    """

    def __init__(self, *words: Any, **options: Any) -> None:
        super().__init__(*words, **options)
        self._blocks: list[tuple[float, ...]] = []
        self._frames: list[tuple[float, ...]] = []
        self._stream: FrameStream | None = None
        self._streams = self._newest = 0

    def apply(self, order: MixerOrder) -> tuple[float, ...]:
        """Execute an order, and record the frames in it."""
        result = super().apply(order)
        if isinstance(order, commands.AddFrames):
            self._record(order)
        return result

    def _record(self, order: commands.AddFrames) -> None:
        """Record the numbers of frames that were added, and their places in the stream."""
        stream = self.voice(order.client).frames._stream
        if stream is not self._stream:
            self._stream, self._streams = stream, self._streams + 1
        numbers = np.rint(order.frames[:, 0] / AMPLITUDE * COUNT).astype(int).tolist()
        self._newest = numbers[-1]
        if isinstance(stream, QueuedFrames):
            first = stream._frames.end - len(numbers)
            self._frames += [(n, first + k, self._streams) for k, n in enumerate(numbers)]

    def step(self) -> None:
        """Play a block and record it."""
        count, stream = self.report.blocks, self._stream
        distance = stream._step if isinstance(stream, QueuedFrames) else 0.0
        super().step()
        if self.report.blocks == count or stream is None:
            return
        position, place = self.position - self.rendering.spacing, 0.0
        if isinstance(stream, QueuedFrames):
            place = stream._at - distance * self.rendering.spacing
        due = self.bus.due(position)
        self._blocks.append((position, due, self._newest, place, distance, self._streams))

    def disarm(self) -> None:
        """Stop, and write the traces."""
        super().disarm()
        np.savez(
            os.environ[FILE],
            blocks=np.array(self._blocks).reshape(-1, 6),
            frames=np.array(self._frames).reshape(-1, 3),
            kind=isinstance(self._stream, LatestFrames),
        )


def main() -> None:
    """Play as the server orders on standard input, with traces."""
    setattr(process, "PlaybackLoop", FrameTracingLoop)  # noqa: B010
    process.main()
