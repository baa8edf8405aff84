"""Comparison of the amplifier's output, instant by instant, with what the host sent."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.virtual import VirtualAmplifier, largest_step
from firmware_protocol import samples
from firmware_protocol.messages import State
from tactile.bench.figures import Figure, at_most
from tactile.bus.budget import Plan
from tactile.bus.link.link_bus import LinkBus
from tactile.display.display import Display

ALIKE = 0.9
"""Share of samples that agree if the assumed cut into frames is right."""

Codes = NDArray[np.int16]
Indices = NDArray[np.int64] | NDArray[np.int32]
Marks = NDArray[np.bool_]


@dataclass
class Ledger:
    """Comparison of the amplifier's output with what was sent.

    Attributes
    ----------
    compared : int
        Number of compared samples.
    differing : int
        Number of samples that are not what the frames say.
    largest_step : int
        Largest step [codes].
    error : float
        Sum of squared differences from the renderer's drive [codes²].
    power : float
        Sum of squares of the renderer's drive [codes²].
    """

    compared: int = 0
    differing: int = 0
    largest_step: int = 0
    error: float = 0.0
    power: float = 0.0
    _cut: int = 0

    def compare(self, bus: LinkBus, amplifier: VirtualAmplifier, sent: Codes) -> None:
        """Compare the amplifier's output so far with codes (S, C), sent from position 0 on."""
        (peer,) = bus.peers
        last = None
        for records in amplifier.chunks():
            codes = records.codes.astype(np.int32)
            steps = np.abs(np.diff(codes, axis=0, prepend=codes[:1] if last is None else last))
            self.largest_step, last = max(self.largest_step, int(steps.max())), codes[-1:]
            playing = (records.state == State.RUNNING) & (records.tick >= peer.begun)
            position = records.position[playing].astype(np.int64) - peer.wire_end(0)
            inside = (position >= 0) & (position < len(sent))
            if inside.any():
                self._compare(bus.plan, position[inside], codes[playing][inside], sent)

    def _compare(self, plan: Plan, position: Indices, codes: Indices, sent: Codes) -> None:
        start = int(position[0])
        drive = np.asarray(sent[start : int(position[-1]) + 1]).astype(np.float64)
        right = self._right(plan, position, codes, sent)
        self.compared += len(position)
        self.differing += int((~right).sum())
        difference = codes[right] - drive[position - start][right]
        self.error += float(np.sum(difference**2))
        self.power += float(np.sum(drive[position - start][right] ** 2))

    def _right(self, plan: Plan, position: Indices, codes: Indices, sent: Codes) -> Marks:
        """Return which instants (N,) are what the frames say, for the cut that fits best.

        What was sent as a spectrum is given as the reference synthesizer plays it. BFP8 rounds the
        samples of a packet together, and after a lost link packets begin wherever the stroke was
        then.
        """
        if plan.sample_format is None:
            return np.asarray((codes == sent[position]).all(axis=1))
        agreeing = np.zeros(len(position), bool)
        for cut in [self._cut, *range(plan.packet_samples)]:
            right = (codes == _framed(plan, position, sent, cut)).all(axis=1)
            if right.sum() > agreeing.sum():
                agreeing, self._cut = right, cut
            if agreeing.mean() > ALIKE:
                break
        return agreeing

    def figures(self, name: str, bus: LinkBus, display: Display) -> Iterator[Figure]:
        """Yield the figures of the comparison."""
        yield Figure(f"{name}.compared", float(self.compared), "samples")
        differing = 100 * self.differing / max(self.compared, 1)
        yield at_most(f"{name}.differing_from_frames", differing, "%", 0)
        yield largest_step(name, self.largest_step, display, bus.wiring.sample_rate)
        ratio = 10 * np.log10(self.power / max(self.error, 1e-30))
        yield Figure(f"{name}.signal_to_error", float(ratio), "dB")


def _framed(plan: Plan, position: Indices, sent: Codes, cut: int) -> Codes:
    """Return the samples that frames give at positions, each frame from cut + k S to the next."""
    kind, size = plan.sample_format, plan.packet_samples
    assert kind is not None
    low = int(position[0]) - (int(position[0]) - cut) % size
    edges = range(low, int(position[-1]) + 1, size)
    parts = [np.asarray(sent[max(k, 0) : k + size]) for k in edges]
    decoded = [samples.decode(kind, samples.encode(kind, part), *part.shape) for part in parts]
    return np.concatenate(decoded)[position - max(low, 0)]
