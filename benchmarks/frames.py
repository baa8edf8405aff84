"""Spectrum frames to the C amplifier over classic CAN, compared with the reference synthesizer.

The synthesizer receives the very frames that went over the wire. The amplifier's output must be the
same, except for samples that it faded.
"""

import time
from collections import deque
from collections.abc import Iterator

import numpy as np

from benchmarks.virtual import (
    Records,
    VirtualAmplifier,
    VirtualSocketCan,
    real_time,
    to_and_fro,
    workshop,
)
from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.messages import State
from firmware_protocol.packet import Packet
from tactile.bench.figures import RATE, Figure, at_most
from tactile.bus.base import DriveFrame, Wiring
from tactile.bus.budget import Ability, plan
from tactile.bus.can_bus import CanWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.stream import LONGEST_LEAD
from tactile.bus.wire_time import Can
from tactile.clock import MONOTONIC
from tactile.display.display import Display, load_display
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

CHUNK = 1 << 22
"""Number of bytes of records that are compared at a time."""


class Listening(CanWire):
    """Wire that records the spectrum frames that went over it, by wire position."""

    frames: deque[tuple[int, m.Spectrum]]

    def send(self, packet: Packet) -> float:
        """Send a packet, and record it if it is a spectrum frame."""
        if packet.type == m.Spectrum.TYPE and (frame := m.Spectrum.unpack(packet.payload)):
            self.frames.append((frame.position, frame))
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
        self._heard = np.zeros((0, channels), np.int32)
        self._heard_from = self._at
        self.compared = self.differing = self.largest = 0

    def take(self, records: Records) -> None:
        """Add the amplifier's output since START."""
        playing = (records.state == State.RUNNING) & (records.tick >= self._peer.begun)
        self._heard = np.concatenate([self._heard, records.codes[playing].astype(np.int32)])

    def play(self, frames: deque[tuple[int, m.Spectrum]]) -> None:
        """Synthesize up to each complete frame, and compare."""
        while frames:
            at = frames[0][0]
            whole = [frame for position, frame in frames if position == at]
            if sum(frame.channels for frame in whole) < self._shape[0]:
                return
            count = (at - self._at) % 2**32
            if len(self._heard) < count:
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
            off = np.abs(self._heard[:count] - expected).max(axis=1)
            self.compared += count
            self.differing += int((off > 1).sum())
            self.largest = max(self.largest, int(off.max()))
            self._heard, self._at, self._last = self._heard[count:], at, after


def _played(
    bus: LinkBus,
    display: Display,
    amplifier: VirtualAmplifier,
    sent: deque[tuple[int, m.Spectrum]],
    seconds: float,
) -> FrameLedger:
    """Play a finger's path, and compare the output as it is played."""
    assert bus.frames is not None
    renderer = SpectrumRenderer(
        display, load_texture("wood-oak"),
        carriers=bus.frames.carriers, frame_rate=bus.frames.rate, sample_rate=RATE,
    )  # fmt: skip
    with real_time():
        return _streamed(bus, renderer, display, amplifier, sent, seconds)


def _streamed(
    bus: LinkBus,
    renderer: SpectrumRenderer,
    display: Display,
    amplifier: VirtualAmplifier,
    sent: deque[tuple[int, m.Spectrum]],
    seconds: float,
) -> FrameLedger:
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
    time.sleep(0.1)
    while len((records := amplifier.take(CHUNK)).codes):
        ledger.take(records)
        ledger.play(sent)
    return ledger


def stream_frames(name: str, seconds: float) -> Iterator[Figure]:
    """Stream oak as frames to the C amplifier, at the bit time of classic CAN."""
    display, link = load_display("reference-24"), Can(1e6)
    sent: deque[tuple[int, m.Spectrum]] = deque()

    def connect() -> CanWire:
        wire = Listening(VirtualSocketCan(folder, fd=False), link, MONOTONIC)
        wire.frames = sent
        return wire

    with workshop() as folder:
        amplifier = VirtualAmplifier(folder, "--can", str(folder / "can"))
        with LinkBus(
            Wiring.of(display, RATE), connect,
            lambda caps: plan(link, display.channels, Ability.of(caps)),
            nodes=[1], lead=LONGEST_LEAD,
        ) as bus:  # fmt: skip
            assert isinstance(bus, LinkBus)
            ledger = _played(bus, display, amplifier, sent, seconds)
            yield Figure(f"{name}.wire", 100 * bus.plan.use, "%")
            yield at_most(f"{name}.lost_frames", float(bus.counters.dropped_samples), "", 0)
            late = 1e4 * bus.counters.late_blocks / max(bus.counters.blocks, 1)
            yield at_most(f"{name}.late_frames", late, "of 10 000", 1)
            yield at_most(f"{name}.disconnects", float(bus.counters.disconnects), "", 0)
            yield Figure(f"{name}.underruns", float(bus.counters.underruns), "")
        amplifier.close()
    yield Figure(f"{name}.compared", float(ledger.compared), "samples")
    differing = 100 * ledger.differing / max(ledger.compared, 1)
    yield at_most(f"{name}.differing_from_synthesizer", differing, "%", 0)
    yield Figure(f"{name}.largest_difference", float(ledger.largest), "LSB")
