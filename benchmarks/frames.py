"""Spectrum frames to the C amplifier over classic CAN, compared with the reference synthesizer.

The synthesizer receives the very frames that went over the wire. The amplifier's output must be the
same, except for samples that it faded.
"""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import numpy as np

from benchmarks.virtual import (
    Records,
    VirtualAmplifier,
    bus_figures,
    can_bus,
    real_time,
    to_and_fro,
    workshop,
)
from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.messages import State
from firmware_protocol.packet import Packet
from tactile.bench.figures import RATE, Figure, at_most
from tactile.bus.base import DriveFrame
from tactile.bus.can_bus import CanChannel, CanWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.wire_time import Can
from tactile.clock import Clock
from tactile.display.display import Display, load_display
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

Frames = deque[tuple[int, m.Spectrum]]
"""Spectrum frames that were sent, by wire position."""


class RecordingWire(CanWire):
    """Wire that records the spectrum frames that went over it."""

    def __init__(self, frames: Frames, channel: CanChannel, link: Can, clock: Clock) -> None:
        super().__init__(channel, link, clock)
        self._frames = frames

    def send(self, packet: Packet) -> float:
        """Send a packet, and record it if it is a spectrum frame."""
        if packet.type == m.Spectrum.TYPE and (frame := m.Spectrum.unpack(packet.payload)):
            self._frames.append((frame.position, frame))
        return super().send(packet)


class FrameLedger:
    """Comparison of the amplifier's output with the reference synthesizer's.

    Attributes
    ----------
    compared : int
        Number of compared samples.
    differing : int
        Number of samples that differ.
    largest : int
        Largest difference [codes].
    """

    def __init__(self, bus: LinkBus, increment: spectrum.Increments, channels: int) -> None:
        (self._peer,) = bus.peers
        self._increment, self._shape = increment, (channels, len(increment))
        self._at = self._peer.wire_end(0)
        zero = np.zeros(self._shape, np.int64)
        self._last = zero, zero
        self._output = np.zeros((0, channels), np.int32)
        self.compared = self.differing = self.largest = 0

    def take(self, records: Records) -> None:
        """Add the amplifier's output since START."""
        playing = (records.state == State.RUNNING) & (records.tick >= self._peer.begun)
        self._output = np.concatenate([self._output, records.codes[playing].astype(np.int32)])

    def play(self, frames: Frames) -> None:
        """Synthesize up to each complete frame, and compare."""
        while frames:
            at = frames[0][0]
            whole = [frame for position, frame in frames if position == at]
            if sum(frame.channels for frame in whole) < self._shape[0]:
                return
            count = (at - self._at) % 2**32
            if len(self._output) < count:
                return
            codes = np.zeros((*self._shape, 2), np.uint8)
            for frame in whole:
                part = np.frombuffer(frame.envelopes, np.uint8)
                codes[frame.first_channel :][: frame.channels] = part.reshape(
                    frame.channels, self._shape[1], 2
                )
                frames.popleft()
            after = spectrum.decode(codes)
            steps = [
                spectrum.ramp_step(a, b, count) for a, b in zip(self._last, after, strict=True)
            ]
            expected = spectrum.synthesize(
                *self._last, steps[0], steps[1], self._increment, self._at, count
            )
            off = np.abs(self._output[:count] - expected).max(axis=1)
            self.compared += count
            self.differing += int((off > 1).sum())
            self.largest = max(self.largest, int(off.max()))
            self._output, self._at, self._last = self._output[count:], at, after


def _play(bus: LinkBus, display: Display, seconds: float) -> FrameLedger:
    """Play a finger's path, and return an empty ledger of it."""
    assert bus.frames is not None
    renderer = SpectrumRenderer(
        display, load_texture("wood-oak"),
        carriers=bus.frames.carriers, frame_rate=bus.frames.rate, sample_rate=RATE,
    )  # fmt: skip
    way, spacing = to_and_fro(seconds), renderer.spacing
    bus.tune(renderer.carriers)
    bus.start()
    ledger = FrameLedger(bus, spectrum.increments(renderer.carriers, RATE), display.channels)
    renderer.sample = spacing
    for k in range(1, int(seconds * RATE / spacing)):
        place, force = way.at(k * spacing / RATE)
        volts = renderer.frame(place, way.velocity(k * spacing / RATE), float(force))
        bus.write_frame(DriveFrame(k * spacing, volts))
    bus.stop()
    return ledger


def stream_frames(name: str, seconds: float) -> Iterator[Figure]:
    """Stream oak as frames to the C amplifier, at the bit time of classic CAN."""
    display = load_display("reference-24")
    sent: Frames = deque()
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--can", str(folder / "can"))) as amplifier,
        can_bus(folder, display, Can(1e6), partial(RecordingWire, sent)) as bus,
    ):
        assert isinstance(bus, LinkBus)
        with real_time():
            ledger = _play(bus, display, seconds)
            time.sleep(0.1)
            for records in amplifier.chunks():
                ledger.take(records)
                ledger.play(sent)
        yield from bus_figures(name, bus, "frames", 1)
    yield Figure(f"{name}.compared", float(ledger.compared), "samples")
    differing = 100 * ledger.differing / max(ledger.compared, 1)
    yield at_most(f"{name}.differing_from_synthesizer", differing, "%", 0)
    yield Figure(f"{name}.largest_difference", float(ledger.largest), "LSB")
