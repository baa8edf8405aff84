"""Spectrum frames to the C amplifier over classic CAN, compared with the reference synthesizer.

The synthesizer receives the very frames that went over the wire. The amplifier's output must be the
same, except for samples that it faded.
"""

import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from itertools import groupby

import numpy as np

from benchmarks.ledger import Ledger
from benchmarks.virtual import (
    VirtualAmplifier,
    bus_figures,
    can_bus,
    real_time,
    to_and_fro,
    workshop,
)
from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.packet import Packet
from tactile.bench.figures import RATE, Figure
from tactile.bus.base import DriveFrame
from tactile.bus.can_bus import CanChannel, CanWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.wire_time import Can
from tactile.clock import Clock
from tactile.display.display import Display, load_display
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

Frames = list[m.Spectrum]
"""Spectrum frames in the order in which they were sent."""


class RecordingWire(CanWire):
    """Wire that records the spectrum frames that went over it."""

    def __init__(self, frames: Frames, channel: CanChannel, link: Can, clock: Clock) -> None:
        super().__init__(channel, link, clock)
        self._frames = frames

    def send(self, packet: Packet) -> float:
        """Send a packet, and record it if it is a spectrum frame."""
        if packet.type == m.Spectrum.TYPE and (frame := m.Spectrum.unpack(packet.payload)):
            self._frames.append(frame)
        return super().send(packet)


def synthesized(
    frames: Frames, increment: spectrum.Increments, channels: int, start: int
) -> Iterator[bytes]:
    """Yield the codes (S, C) that the reference synthesizer makes of frames, piece by piece.

    The first piece is from 0 V at a wire position on.
    """
    zero = np.zeros((channels, len(increment)), np.int64)
    before = zero, zero
    for position, frames_there in groupby(frames, lambda frame: frame.position):
        codes = np.zeros((*zero.shape, 2), np.uint8)
        for frame in frames_there:
            part = np.frombuffer(frame.envelopes, np.uint8)
            codes[frame.first_channel :][: frame.channels] = part.reshape(
                frame.channels, len(increment), 2
            )
        after, count = spectrum.decode(codes), (position - start) % 2**32
        steps = [spectrum.ramp_step(a, b, count) for a, b in zip(before, after, strict=True)]
        output = spectrum.synthesize(*before, steps[0], steps[1], increment, start, count)
        yield output.astype(np.int16).tobytes()
        start, before = position, after


def _play(bus: LinkBus, display: Display, seconds: float) -> spectrum.Increments:
    """Play a finger's path, and return the increments of the carriers."""
    assert bus.frames is not None
    renderer = SpectrumRenderer(
        display, load_texture("wood-oak"),
        carriers=bus.frames.carriers, frame_rate=bus.frames.rate, sample_rate=RATE,
    )  # fmt: skip
    way, spacing = to_and_fro(seconds), renderer.spacing
    bus.tune(renderer.carriers)
    bus.start()
    renderer.sample = spacing
    for k in range(1, int(seconds * RATE / spacing)):
        place, force = way.at(k * spacing / RATE)
        volts = renderer.frame(place, way.velocity(k * spacing / RATE), float(force))
        bus.write_frame(DriveFrame(k * spacing, volts))
    bus.stop()
    return spectrum.increments(renderer.carriers, RATE)


def stream_frames(name: str, seconds: float) -> Iterator[Figure]:
    """Stream oak as frames to the C amplifier, at the bit time of classic CAN."""
    display = load_display("reference-24")
    sent: Frames = []
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--can", str(folder / "can"))) as amplifier,
        can_bus(folder, display, Can(1e6), partial(RecordingWire, sent)) as bus,
    ):
        assert isinstance(bus, LinkBus)
        with real_time():
            increment = _play(bus, display, seconds)
        time.sleep(0.1)
        with (folder / "expected").open("wb") as file:
            start = bus.peers[0].wire_end(0)
            file.writelines(synthesized(sent, increment, display.channels, start))
        expected = np.memmap(folder / "expected", np.int16, "r").reshape(-1, display.channels)
        ledger = Ledger()
        ledger.compare(bus, amplifier, expected)
        yield from bus_figures(name, bus, "frames", 1)
        yield from ledger.figures(name, bus, display)
