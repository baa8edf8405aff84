"""Links: what gets through to the C amplifier in real time, and what that costs.

The drive is rendered as it is played, in blocks of 16, and what the amplifier puts out is compared
with it position by position: with what the frames say, which must be the same to the last bit, and
with the renderer's drive. Where the amplifier bridged or faded, because the machine stood still,
samples differ; they are counted, and no step may exceed the slew limit.
"""

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from firmware_protocol import samples
from firmware_protocol.host import codes_of
from firmware_protocol.messages import FULL_SCALE_CODE, State
from tactile.bench.figures import RATE, Figure, Floats, at_most
from tactile.bench.frames import stream_frames
from tactile.bench.virtual import (
    Records,
    SocketCan,
    VirtualAmplifier,
    can_be_built,
    real_time,
    to_and_fro,
    workshop,
)
from tactile.bus.base import DriveBlock, Wiring
from tactile.bus.budget import Ability, plan
from tactile.bus.can_bus import CanWire
from tactile.bus.link_bus import LinkBus, Monotonic
from tactile.bus.registry import open_bus
from tactile.bus.wire_time import Can
from tactile.display import Display, load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import load_texture

BLOCK = 16
SHORT, LONG = 5.0, 600.0
"""s of a stream."""


@dataclass
class Ledger:
    """What was sent and what was put out, compared as it comes.

    Parameters
    ----------
    bus : that plays; it knows which position is which
    full_scale, slew_step : of the amplifier [V], and the largest step allowed [codes]
    """

    bus: LinkBus
    full_scale: float
    slew_step: float
    compared: int = 0
    differing: int = 0
    largest_step: int = 0
    error: float = 0.0
    power: float = 0.0
    _sent: deque[tuple[int, Floats]] = field(default_factory=deque)
    _last: np.ndarray | None = None

    def send(self, position: int, drive: Floats) -> None:
        """Take note of what is to be put out."""
        self._sent.append((position, drive.copy()))

    def take(self, records: Records) -> None:
        """Compare what was put out."""
        if not len(records.codes):
            return
        codes = records.codes.astype(np.int32)
        before = codes[:1] if self._last is None else self._last
        steps = np.abs(np.diff(codes, axis=0, prepend=before))
        self.largest_step = max(self.largest_step, int(steps.max()))
        self._last = codes[-1:]
        playing = records.state == State.RUNNING
        (peer,) = self.bus.peers
        playing &= records.tick >= peer.begun
        start = peer.wire_end(0)
        position = (records.position[playing].astype(np.int64) - start) % 2**32
        self._compare(position, codes[playing])

    def _compare(self, position: np.ndarray, codes: np.ndarray) -> None:
        kind, size = self.bus.plan.sample_format, self.bus.plan.packet_samples
        assert kind is not None
        while self._sent and len(position):
            first, drive = self._sent[0]
            if position[-1] < first + len(drive) - 1:
                return
            self._sent.popleft()
            here = (position >= first) & (position < first + len(drive))
            wanted = np.concatenate(
                [
                    samples.decode(kind, samples.encode(kind, part), *part.shape)
                    for k in range(0, len(drive), size)
                    for part in [codes_of(drive[k : k + size], self.full_scale)]
                ]
            )
            at = position[here] - first
            self.compared += len(at)
            wrong = (codes[here] != wanted[at]).any(axis=1)
            self.differing += int(wrong.sum())
            volts = codes[here][~wrong] * (self.full_scale / FULL_SCALE_CODE)
            self.error += float(np.sum((volts - drive[at][~wrong]) ** 2))
            self.power += float(np.sum(drive[at][~wrong] ** 2))


def _figures(name: str, bus: LinkBus, ledger: Ledger, duration: float) -> Iterator[Figure]:
    c, status = bus.counters, bus.peers[0].host.status
    blocks = max(c.blocks, 1)
    yield Figure(f"{name}.seconds", duration, "s")
    yield Figure(f"{name}.wire", 100 * bus.plan.use, "%")
    yield at_most(f"{name}.lost_blocks", float(c.dropped_samples / BLOCK), "blocks", 0)
    yield at_most(f"{name}.late_blocks", 1e4 * c.late_blocks / blocks, "of 10 000", 1)
    yield Figure(f"{name}.underruns", float(c.underruns), "")
    if status is not None:
        yield Figure(f"{name}.lost_in_amplifier", float(status.lost_samples), "samples")
    yield Figure(f"{name}.compared", float(ledger.compared), "samples")
    differing = 100 * ledger.differing / max(ledger.compared, 1)
    yield at_most(f"{name}.differing_from_frames", differing, "%", 0)
    yield at_most(
        f"{name}.largest_step", ledger.largest_step / max(ledger.slew_step, 1e-9), "of slew", 1
    )
    ratio = 10 * np.log10(ledger.power / max(ledger.error, 1e-30))
    yield Figure(f"{name}.signal_to_error", float(ratio), "dB")


def _slew_step(display: Display, rate: float) -> float:
    full = display.limits.voltage
    return min(display.slew / rate / full, 2.0) * FULL_SCALE_CODE


def _stream(
    name: str, bus: LinkBus, amplifier: VirtualAmplifier, seconds: float
) -> Iterator[Figure]:
    display, rate = load_display("reference-24"), bus.wiring.sample_rate
    renderer = Renderer(display, load_texture("wood-oak"), sample_rate=rate)
    ledger = Ledger(bus, display.limits.voltage, _slew_step(display, rate))
    sent = looked = 0
    renderer.fade_in()
    bus.start()
    for position, force in to_and_fro(seconds).blocks(rate, BLOCK):
        drive = display.to_channels(renderer.block(position, force)).astype(np.float64)
        ledger.send(sent, drive)
        bus.write(DriveBlock(sent, drive))
        sent += len(drive)
        if sent - looked >= rate / 20:
            ledger.take(amplifier.take())
            looked = sent
    bus.stop()
    time.sleep(0.1)
    ledger.take(amplifier.take())
    yield from _figures(name, bus, ledger, sent / rate)


def _serial(name: str, options: str, seconds: float) -> Iterator[Figure]:
    with workshop() as folder, real_time():
        amplifier = VirtualAmplifier(folder, "--pty")
        url = f"serial://{amplifier.path}?{options}"
        with open_bus(url, load_display("reference-24")) as bus:
            assert isinstance(bus, LinkBus)
            yield from _stream(name, bus, amplifier, seconds)
        amplifier.close()


def _can_bus(folder: Path, display: Display, link: Can) -> LinkBus:
    """Return a bus to the amplifier that serves CAN frames on a socket in a folder."""
    clock = Monotonic()
    return LinkBus(
        Wiring.of(display, RATE),
        lambda: CanWire(SocketCan(folder, fd=link.data is not None), link, clock),
        lambda caps: plan(link, display.channels, Ability.of(caps)),
        nodes=[1],
    )


def _can_fd(name: str, seconds: float) -> Iterator[Figure]:
    with workshop() as folder, real_time():
        amplifier = VirtualAmplifier(folder, "--can", str(folder / "can"), "--fd")
        with _can_bus(folder, load_display("reference-24"), Can(1e6, 5e6)) as bus:
            assert isinstance(bus, LinkBus)
            yield from _stream(name, bus, amplifier, seconds)
        amplifier.close()


def measure_streams(seconds: float = SHORT) -> Iterator[Figure]:
    """Stream oak to the C amplifier over each link at its bit time."""
    if not can_be_built():
        return
    yield from _serial("links.uart_3M.bfp8", "baud=3000000&format=bfp8", seconds)
    yield from _serial("links.usb.pcm12", "format=pcm12", seconds)
    yield from _can_fd("links.canfd_1_5", seconds)
    yield from stream_frames("links.can_1.spectrum", seconds)


def measure_streams_long() -> Iterator[Figure]:
    """Stream for ten minutes each."""
    yield from measure_streams(LONG)


def measure_cost() -> Iterator[Figure]:
    """Measure what streaming takes of a core: 64 channels at 8 kHz over a pty, blocks of 16."""
    if not can_be_built():
        return
    display = load_display("reference-64")
    stroke = Trajectory.line(speed=0.08, duration=1.0)
    renderer = Renderer(display, load_texture("wood-oak"))
    blocks = [display.to_channels(renderer.block(p, f)) for p, f in stroke.blocks(8000.0, BLOCK)]
    with workshop() as folder:
        amplifier = VirtualAmplifier(folder, "--pty", channels=64)
        with open_bus(f"serial://{amplifier.path}", display) as bus:
            bus.start()
            begun, used = time.monotonic(), time.process_time()
            for k in range(int(SHORT * 8000 / BLOCK)):
                bus.write(DriveBlock(k * BLOCK, blocks[k % len(blocks)]))
            share = (time.process_time() - used) / (time.monotonic() - begun)
        amplifier.close()
    yield at_most("links.cost.64_channels", 100 * share, "% of a core", 25)
    yield Figure("links.cost.pyserial_alone", 100 * _pyserial_alone(), "% of a core")


def _pyserial_alone() -> float:
    """Return the share that pyserial takes for as many bytes in as many writes, nothing else."""
    import serial

    data = bytes(64 * BLOCK + 64 + 40)
    with workshop() as folder:
        amplifier = VirtualAmplifier(folder, "--pty")
        port = serial.Serial(amplifier.path, timeout=0)
        begun, used = time.monotonic(), time.process_time()
        for k in range(int(SHORT * 8000 / BLOCK)):
            port.write(data)
            time.sleep(max(0.0, begun + (k + 1) * BLOCK / 8000 - time.monotonic()))
        share = (time.process_time() - used) / (time.monotonic() - begun)
        port.close()
        amplifier.close()
    return share


def measure_links() -> Iterator[Figure]:
    """Measure all of it, briefly."""
    yield from measure_cost()
    yield from measure_streams()
