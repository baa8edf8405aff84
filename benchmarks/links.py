"""Links: what reaches the C amplifier in real time, and the cost of it.

The drive is rendered as it is played and sent in blocks of 16, as far ahead as an amplifier has
room for, since the path of the finger is known beforehand. The amplifier's output is then compared
position by position with what the frames say, which must be the same to the last bit, and with the
renderer's drive. Where the amplifier bridged or faded, because the machine paused for longer,
samples differ; these are counted, and no step may exceed the slew limit. Bare loops run at the same
time and tell for how long the machine paused (`tactile.bench.metronome`).
"""

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from benchmarks.frames import stream_frames
from benchmarks.ledger import Ledger
from benchmarks.virtual import (
    NO_AMPLIFIER,
    VirtualAmplifier,
    bus_figures,
    can_be_built,
    can_bus,
    real_time,
    to_and_fro,
    workshop,
)
from firmware_protocol.host import codes_of
from tactile.bench.figures import RATE, Figure, at_most, beside_machine, not_measured
from tactile.bus.base import DriveBlock
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.stream import LONGEST_LEAD
from tactile.bus.registry import open_bus
from tactile.bus.wire_time import Can
from tactile.display.display import Display, load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import load_texture

BLOCK = 16
"""Number of samples of a block."""
RENDERED = 4 * BLOCK
"""Number of samples that are rendered at a time.

As the path is known beforehand, this takes less than half the work of single blocks.
"""
SHORT, LONG = 5.0, 600.0
"""Durations of a stream [s]."""


def _figures(
    name: str, bus: LinkBus, ledger: Ledger, duration: float, display: Display
) -> Iterator[Figure]:
    """Yield the figures of a stream."""
    status = bus.peers[0].host.status
    yield Figure(f"{name}.seconds", duration, "s")
    yield from bus_figures(name, bus, "blocks", BLOCK)
    if status is not None:
        yield Figure(f"{name}.lost_in_amplifier", float(status.lost_samples), "samples")
    yield from ledger.figures(name, bus, display)


def _play(
    bus: LinkBus, renderer: Renderer, display: Display, file: IO[bytes], way: Trajectory
) -> None:
    """Play a path, and store what was sent."""
    renderer.fade_in()
    sent = 0
    for position, force in way.blocks(bus.wiring.sample_rate, RENDERED):
        drive = display.to_channels(renderer.block(position, force)).astype(np.float64)
        if not sent:
            bus.start()
        file.write(codes_of(drive, display.limits.voltage).tobytes())
        for k in range(0, len(drive), BLOCK):
            block = drive[k : k + BLOCK]
            bus.write(DriveBlock(sent, block))
            sent += len(block)
    bus.stop()


def _stream(
    name: str, folder: Path, bus: LinkBus, amplifier: VirtualAmplifier, seconds: float
) -> Iterator[Figure]:
    display, rate = load_display("reference-24"), bus.wiring.sample_rate
    renderer = Renderer(display, load_texture("wood-oak"), sample_rate=rate)
    path, way = folder / "sent", to_and_fro(seconds)
    with path.open("wb") as file, real_time():
        _play(bus, renderer, display, file, way)
    time.sleep(0.1)
    ledger = Ledger()
    sent = np.memmap(path, np.int16, "r").reshape(-1, display.channels)
    ledger.compare(bus, amplifier, sent)
    yield from _figures(name, bus, ledger, len(sent) / rate, display)


def _serial(name: str, seconds: float, *, options: str) -> Iterator[Figure]:
    with workshop() as folder, closing(VirtualAmplifier(folder, "--pty")) as amplifier:
        url = f"serial://{amplifier.path}?{options}&rearm=true&lead_ms={1e3 * LONGEST_LEAD:g}"
        with open_bus(url, load_display("reference-24")) as bus:
            assert isinstance(bus, LinkBus)
            yield from _stream(name, folder, bus, amplifier, seconds)


def _can_fd(name: str, seconds: float) -> Iterator[Figure]:
    display = load_display("reference-24")
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--can", str(folder / "can"), "--fd")) as amplifier,
        can_bus(folder, display, Can(1e6, 5e6), rearm=True) as bus,
    ):
        assert isinstance(bus, LinkBus)
        yield from _stream(name, folder, bus, amplifier, seconds)


STREAMS: dict[str, Callable[[str, float], Iterator[Figure]]] = {
    "links.uart_3M.bfp8": partial(_serial, options="baud=3000000&format=bfp8"),
    "links.usb.pcm12": partial(_serial, options="format=pcm12"),
    "links.canfd_1_5": _can_fd,
    "links.can_1.spectrum": stream_frames,
}
"""Streams over each link, by name."""


def measure_streams(seconds: float = SHORT) -> Iterator[Figure]:
    """Stream oak to the C amplifier over each link at its bit time, while a metronome runs."""
    if not can_be_built():
        yield not_measured("links", NO_AMPLIFIER)
        return
    for name, stream in STREAMS.items():
        yield from beside_machine(name, stream(name, seconds))


def measure_cost() -> Iterator[Figure]:
    """Measure the load of a core by streaming 64 channels at 8 kHz over a pty, in blocks of 16."""
    if not can_be_built():
        yield not_measured("links.cost", NO_AMPLIFIER)
        return
    display = load_display("reference-64")
    stroke = Trajectory.line(speed=0.08, duration=1.0)
    renderer = Renderer(display, load_texture("wood-oak"))
    blocks = [display.to_channels(renderer.block(p, f)) for p, f in stroke.blocks(RATE, BLOCK)]
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--pty", channels=64)) as amplifier,
        open_bus(f"serial://{amplifier.path}", display) as bus,
    ):
        bus.start()
        share = _load(lambda k: bus.write(DriveBlock(k * BLOCK, blocks[k % len(blocks)])))
    yield at_most("links.cost.64_channels", 100 * share, "% of a core", 25)
    yield Figure("links.cost.pyserial_alone", 100 * _pyserial_load(), "% of a core")


def _load(write: Callable[[int], object]) -> float:
    """Return the share of a core that it takes to write each block by its number."""
    begun, used = time.monotonic(), time.process_time()
    for k in range(int(SHORT * RATE / BLOCK)):
        write(k)
    return (time.process_time() - used) / (time.monotonic() - begun)


def _pyserial_load() -> float:
    """Return the load of a core by pyserial alone, for as many bytes in as many writes."""
    import serial

    data = bytes(64 * BLOCK + 64 + 40)
    with (
        workshop() as folder,
        closing(VirtualAmplifier(folder, "--pty")) as amplifier,
        serial.Serial(amplifier.path, timeout=0) as port,
    ):
        begun = time.monotonic()

        def write(k: int) -> None:
            port.write(data)
            time.sleep(max(0.0, begun + (k + 1) * BLOCK / RATE - time.monotonic()))

        return _load(write)


def measure_links() -> Iterator[Figure]:
    """Measure cost and streams, briefly."""
    yield from measure_cost()
    yield from measure_streams()
