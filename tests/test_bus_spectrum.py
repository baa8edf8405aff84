"""Spectrum frames over a bus: what the amplifier puts out is what the reference makes of them."""

from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from link_rig import LEVEL, RATE, Bench, overheard
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.arrays import Complex, Floats
from tactile.bus.base import DriveBlock, DriveFrame
from tactile.bus.board import config_of
from tactile.bus.link.stream import LinkBusCounters
from tactile.bus.simulated import modeled_bus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusStateError, InputError
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

FRAMES = 16
TURN = 2**32


def opened(url: str, display: Display) -> ModeledBus:
    bus = open_bus(url, display)
    assert isinstance(bus, ModeledBus)
    assert bus.frames is not None
    return bus


def rendered(bus: ModeledBus, display: Display) -> tuple[Floats, int, list[Complex]]:
    """Return carriers, spacing and frames (C, P) of a stroke that sets out at 60 mm/s."""
    assert bus.frames is not None
    renderer = SpectrumRenderer(
        display, load_texture("plastic-abs-vdi27"), carriers=bus.frames.carriers,
        frame_rate=bus.frames.rate, sample_rate=bus.wiring.sample_rate,
    )  # fmt: skip
    frames = []
    for k in range(FRAMES):
        frame = renderer.frame([1.2e-3 * k, 0.0], [0.06, 0.0], 0.8)
        volts = np.zeros((display.channels, frame.shape[1]), complex)
        volts[display.channel] = frame
        frames.append(volts)
    return renderer.carriers, renderer.spacing, frames


def reference(
    frames: list[Complex], carriers: Floats, spacing: int, origin: int, volts: float, rate: float
) -> NDArray[np.int64]:
    """Return the codes that the reference synthesizer makes of frames, the first of them 0 V.

    On the wire position 0 of the stream is ``origin``: phases are told by what carriers are there.
    """
    increment = spectrum.increments(carriers, rate)
    turns = increment.astype(object) * origin % TURN / TURN
    back = np.exp(-2j * np.pi * turns.astype(np.float64))
    zero = np.zeros(frames[0].shape, np.int64)
    start, pieces = (zero, zero), []
    for k, frame in enumerate(frames[1:]):
        end = spectrum.decode(spectrum.encode(frame * back / volts))
        step_i, step_q = (spectrum.ramp_step(start[q], end[q], spacing) for q in (0, 1))
        at = (origin + k * spacing) % TURN
        pieces.append(spectrum.synthesize(*start, step_i, step_q, increment, at, spacing))
        start = end
    return np.concatenate(pieces)


@pytest.mark.parametrize("extra", ["", "&lead_ms=100&fifo_ms=128"])
@pytest.mark.parametrize(("carriers_at_most", "frame_rate"), [(16, 50), (8, 100)])
def test_over_can_the_amplifier_plays_what_the_reference_synthesizer_does(
    display: Display,
    monkeypatch: pytest.MonkeyPatch,
    carriers_at_most: int,
    frame_rate: float,
    extra: str,
) -> None:
    """The lead may be as long as one likes: an amplifier keeps four frames (SPEC.md, 10.3)."""

    def config(*args: object, **named: object) -> AmplifierConfig:
        return replace(config_of(*args, **named), carriers=carriers_at_most)  # type: ignore[arg-type]

    monkeypatch.setattr(modeled_bus, "config_of", config)
    with closing(opened("mock:?link=can&keep=all" + extra, display)) as bus:
        assert bus.frames is not None
        assert bus.frames.rate == frame_rate
        carriers, spacing, frames = rendered(bus, display)
        bus.tune(carriers)
        bus.start()
        for k, frame in enumerate(frames):
            bus.write_frame(DriveFrame(k * spacing, frame))
        (peer,) = bus.peers
        origin = peer.wire_end(0)
        bus.stop()
        volts = display.limits.voltage
        expected = reference(frames, carriers, spacing, origin, volts, bus.wiring.sample_rate)
        codes = np.rint(bus.output[: len(expected)] * (FULL_SCALE_CODE / volts)).astype(int)
        assert bus.counters.faults() == {}
    assert np.abs(expected).max() > 1000
    assert len(codes) == len(expected) == (FRAMES - 1) * spacing
    assert np.abs(codes - expected).max() <= 1


def test_over_can_the_drive_is_the_sum_of_carriers_within_what_8_bits_round(
    display: Display,
) -> None:
    """Amplitudes are rounded by 0.125 dB, 1.5 %, phases by 1/512 turn, 1.2 %: 1.9 % of Σ|Z|."""
    with closing(opened("mock:?link=can&keep=all", display)) as bus:
        carriers, spacing, frames = rendered(bus, display)
        bus.tune(carriers)
        bus.start(12345)
        for k, frame in enumerate(frames):
            # positions begin at 12345, and so do the phases that the renderer has turned back
            turned = frame * np.exp(-2j * np.pi * carriers * 12345 / bus.wiring.sample_rate)
            bus.write_frame(DriveFrame(12345 + k * spacing, turned))
        bus.stop()
        out = bus.output[: (FRAMES - 1) * spacing]
        time = np.arange(len(out)) / bus.wiring.sample_rate
    values = np.array([np.zeros_like(frames[0]), *frames[1:]])
    part = (np.arange(spacing) / spacing)[:, None, None]
    envelope = np.concatenate([a + (b - a) * part for a, b in pairwise(values)])
    exact = (envelope * np.exp(2j * np.pi * np.outer(time, carriers))[:, None]).real.sum(axis=2)
    assert np.all(np.abs(out - exact) <= 0.02 * np.abs(values).sum(axis=2).max() + 5e-3)


def test_each_frame_reaches_the_amplifier_or_is_counted_as_dropped(
    display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    with closing(opened("mock:?link=can&rearm=true", display)) as bus:
        assert bus.frames is not None
        spacing = round(bus.wiring.sample_rate / bus.frames.rate)
        bus.tune(np.array([100.0, 200.0]))
        bus.start()
        frame = np.full((display.channels, 2), 1 + 0j)
        for k in range(30):
            if k == 10:
                bus.model.stall(0.14)
            bus.write_frame(DriveFrame(k * spacing, frame))
        bus.stop()
        packets = [packet.payload for packet, _ in heard if packet.type == m.Spectrum.TYPE]
        sent = {payload[:4] for payload in packets}
        validities = {int.from_bytes(payload[6:8], "little") for payload in packets}
        counters = bus.counters
    assert counters.blocks == counters.samples == 30
    assert counters.dropped_samples == 29 - len(sent) > 0, "the first is that of the start"
    assert counters.late_blocks >= counters.dropped_samples
    assert spacing < min(validities), "a frame may come a little late"
    assert max(validities) <= bus.wiring.sample_rate // 20, "SPEC.md, 10.2"


@pytest.mark.parametrize("url", ["mock:?link=can", "mock:?link=serial&format=spectrum"])
def test_a_bus_that_takes_frames_takes_no_blocks_and_is_tuned_first(
    display: Display, url: str
) -> None:
    with closing(opened(url, display)) as bus:
        block = DriveBlock(0, np.zeros((8, display.channels)))
        frame = DriveFrame(0, np.zeros((display.channels, 2), complex))
        with pytest.raises(BusStateError, match="takes frames; tune it"):
            bus.start()
        assert bus.state == "idle"
        with pytest.raises(BusStateError, match="write_frame: the bus is idle"):
            bus.write_frame(frame)
        with pytest.raises(InputError, match="tune: 17 carriers; 1 … 16"):
            bus.tune(np.arange(17.0))
        bus.tune(np.array([100.0, 200.0]))
        bus.start()
        with pytest.raises(BusStateError, match="write: the bus takes frames"):
            bus.write(block)
        with pytest.raises(BusStateError, match="tune: the bus is running"):
            bus.tune(np.array([100.0]))
        assert bus.counters == LinkBusCounters()
        with pytest.raises(InputError, match="write_frame: 3 carriers, not 2"):
            bus.write_frame(DriveFrame(0, np.zeros((display.channels, 3), complex)))
        with pytest.raises(InputError, match=r"write_frame: shape \(2, 2\), needs \(24, P\)"):
            bus.write_frame(DriveFrame(0, np.zeros((2, 2), complex)))
        bus.write_frame(frame)
        bus.stop()
        assert not bus.output.any()
        assert bus.counters.faults() == {}


@pytest.mark.ci
@pytest.mark.parametrize("drift", [1000, -1000])
def test_boards_whose_crystals_differ_play_frames_together(drift: int) -> None:
    """The boards would be 8 ms apart after 8 s by themselves, most of a period of the carrier.

    Frames begin at whole samples, and so within half of one.
    """
    bench = Bench(f"mock:?link=canfd&boards=2&drift_ppm={drift}&format=spectrum")
    with closing(bench.bus) as bus:
        assert bus.frames is not None
        spacing = round(RATE / bus.frames.rate)
        bus.tune(np.array([100.0]))
        bench.start()
        for k in range(round(8 * bus.frames.rate)):
            bus.write_frame(DriveFrame(k * spacing, np.full((2, 1), LEVEL, np.complex128)))
        assert bus.counters.faults() == {}
        bench.model.report_output()
        (times, codes, _), (other_times, other, _) = (heard[-1].together() for heard in bench.heard)
    late = (times > times[-1] - 0.5) & (times < other_times[-1])
    apart = codes[late, 0] - np.interp(times[late], other_times, other[:, 0])
    sample = 2 * np.pi * 100.0 / RATE
    assert np.abs(apart).max() < sample * np.abs(codes).max()
