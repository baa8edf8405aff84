"""Wire protocol: speed of the host's codec, efficiency of links, and loss of sample formats."""

from collections.abc import Callable, Iterator
from zlib import crc32

import numpy as np
from cobs import cobs
from cobs.cobs import _cobs_py
from numpy.typing import NDArray

from firmware_protocol import samples
from firmware_protocol.can_link import CanEncoder
from firmware_protocol.correlation import ENTRY, CompleteWindow, Correlator, messages_of
from firmware_protocol.fragments import Cutter
from firmware_protocol.host import codes_of, pcm
from firmware_protocol.i2c_link import SMBUS_BLOCK, WRITE_COMMAND
from firmware_protocol.messages import PACKET_MAX, Pcm, SampleFormat
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most, not_measured, seconds
from tactile.bus.wire_time import (
    FdTime,
    Stuffing,
    can_bits,
    can_estimate,
    fd_bits,
    fd_estimate,
    i2c_bits,
    smbus_write_bits,
    uart_bits,
)
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.texture.surface import load_texture, without_friction

Codes = NDArray[np.int16]

REPEATS, ROUNDS = 200, 100
"""Repetitions of a timed call, and rounds of such repetitions.

The rounds are short and alternate, so that a busy moment of the machine does not affect one call
alone.
"""
BLOCK_SAMPLES, BLOCK_CHANNELS = 16, 8
"""Samples and channels of a block: 256 bytes of PCM16."""
WINDOW = 200
"""Number of samples of a window: 25 ms."""
PACKETS = 200
"""Number of packets by which an efficiency is measured."""
NOMINAL, FAST = 1e6, 5e6
"""Bit rates of the two phases of CAN FD [bit/s]."""
QUIETER = 10 ** (-30 / 20)
"""Factor of a drive that is 30 dB down."""
LARGEST = 2047 * 16
"""Code that all formats can represent, except for the last half step of BFP8."""
HANDFUL = (
    "abrasive-p120",
    "foam-reticulated-30ppi",
    "glass-ribbed",
    "leather-calf",
    "metal-knurled-rge08",
    "paper-laid",
    "plastic-acrylic-ribbed",
    "rubber-crumb",
    "stone-granite-flamed",
    "textile-corduroy",
    "wood-oak",
)
"""Shipped textures that represent all: one of each category, some with gratings or events."""


def oak_drive() -> Floats:
    """Return the drive (S, C) of a stroke over oak on the display of 24 contactors [V]."""
    stroke = Trajectory.line(speed=0.08, duration=1.0)
    oak = without_friction(load_texture("wood-oak"))
    return render(load_display("reference-24"), oak, stroke).drive


def _of_peak(drive: Floats) -> Codes:
    """Return the codes of a drive that is scaled to full scale."""
    scale = LARGEST / float(np.abs(drive).max())
    return np.rint(drive * scale).astype(np.int16)


# Speed


def measure_codec() -> Iterator[Figure]:
    """Time the way of 64 channels × 32 samples of PCM12 to a serial frame and back.

    Other libraries are timed with parts of this work.
    """
    codes = np.resize(_of_peak(oak_drive()), (32, 64))
    decoder = SerialDecoder()
    (message,) = pcm(0, codes, session=1, sample_format=SampleFormat.PCM12, packet_limit=4096)
    packet = encode_packet(Packet.of(message, node=1))
    frame = encode_frame(packet)

    def encode() -> bytes:
        (one,) = pcm(0, codes, session=1, sample_format=SampleFormat.PCM12, packet_limit=4096)
        return encode_frame(encode_packet(Packet.of(one, node=1)))

    def decode() -> Codes:
        (one,) = decoder.feed(frame)
        message = Pcm.unpack(one.payload)
        assert message is not None
        return samples.decode(message.format, message.data, message.samples, message.channels)

    assert encode() == frame
    assert np.abs(decode() - codes.astype(int)).max() <= 8
    rounds = np.array([(seconds(encode, REPEATS), seconds(decode, REPEATS)) for _ in range(ROUNDS)])
    encoding, decoding = rounds.min(axis=0) * 1e6
    yield at_most("protocol.encode_3_kB", float(encoding), "µs", 40)
    yield at_most("protocol.decode_3_kB", float(decoding), "µs", 40)
    for name, work in _own_parts(packet, codes).items():
        yield Figure(f"protocol.3_kB.{name}", seconds(work, 200) * 1e6, "µs")
    yield from _others(packet, codes)


def _own_parts(packet: bytes, codes: Codes) -> dict[str, Callable[[], object]]:
    """Return the parts of the encoder that take the time."""
    return {
        "pcm12": lambda: samples.encode(SampleFormat.PCM12, codes),
        "crc32": lambda: crc32(packet),
        "cobs": lambda: cobs.encode(packet),
        "can_fragments": lambda: list(Cutter(8).fragments(0, packet)),
    }


def _others(packet: bytes, codes: Codes) -> Iterator[Figure]:
    """Time the same parts by other libraries, which none of the extras installs."""
    name = "protocol.3_kB.cobs.in_python"
    yield Figure(name, seconds(lambda: _cobs_py.encode(packet)) * 1e6, "µs")
    name = "protocol.3_kB.pcm12.construct"
    try:
        from construct import Array, BitsInteger, Bitwise
    except ImportError:
        yield not_measured(name, "needs construct: pip install construct")
    else:
        bits = Bitwise(Array(codes.size, BitsInteger(12, signed=True)))
        values = [int(v) for v in codes.ravel() // 16]
        yield Figure(name, seconds(lambda: bits.build(values)) * 1e6, "µs")
    name = "protocol.3_kB.crc32.crccheck"
    try:
        from crccheck.crc import Crc32
    except ImportError:
        yield not_measured(name, "needs crccheck: pip install crccheck")
    else:
        yield Figure(name, seconds(lambda: Crc32.calc(packet)) * 1e6, "µs")


# Links


def measure_links() -> Iterator[Figure]:
    """Compare 256 bytes of samples with all bits that are sent for them, in frames of our encoders.

    The typical case is the drive of oak in PCM16, stuffed as its own bits require. The worst case
    has no zeros for COBS, and the largest number of stuff bits.
    """
    codes = codes_of(oak_drive()[800:], 100.0)
    packets = []
    for k in range(PACKETS):
        part = codes[16 * k : 16 * (k + 1), 8 * (k % 3) :][:BLOCK_SAMPLES, :BLOCK_CHANNELS]
        (message,) = pcm(16 * k, part, session=4711, sample_format=0, packet_limit=4096)
        packets.append(Packet.of(message, node=1, seq=k))
    yield from _uart(packets)
    yield from _can(packets, fd=False)
    yield from _can(packets, fd=True)
    yield from _i2c(packets)


def _efficiency(bits: float, packets: int = PACKETS) -> float:
    """Return the share of the samples' bits in all bits [%]."""
    return 100 * 8 * 256 * packets / bits


def _uart(packets: list[Packet]) -> Iterator[Figure]:
    bits = sum(uart_bits(len(encode_frame(encode_packet(p)))) for p in packets)
    yield at_least("protocol.uart.efficiency", _efficiency(bits), "%", 74)
    longest = uart_bits(len(encode_frame(b"\1" * len(encode_packet(packets[0])))))
    yield Figure("protocol.uart.efficiency.worst", _efficiency(longest, 1), "%")


def _can(packets: list[Packet], *, fd: bool) -> Iterator[Figure]:
    """Yield the efficiency of CAN at 1 Mbit/s, or of CAN FD at 5 Mbit/s, in bits of that rate."""
    encoder = CanEncoder(from_amplifier=False, fd=fd)
    frames = [frame for p in packets for frame in encoder.frames(p)]

    def estimate(stuffing: Stuffing) -> float:
        sizes = [len(data) for _, data in frames]
        if fd:
            return sum(_fast_bits(fd_estimate(size, stuffing)) for size in sizes)
        return sum(can_estimate(size, stuffing) for size in sizes)

    own = sum(_fast_bits(fd_bits(*frame)) if fd else can_bits(*frame) for frame in frames)
    name, goal = ("protocol.can_fd", 62) if fd else ("protocol.can", 46)
    yield at_least(f"{name}.efficiency.unstuffed", _efficiency(estimate("none")), "%", goal)
    yield Figure(f"{name}.efficiency", _efficiency(own), "%")
    yield Figure(f"{name}.efficiency.worst", _efficiency(estimate("most")), "%")


def _fast_bits(time: FdTime) -> float:
    """Return the length of a CAN FD frame in bits of the data bit rate."""
    return FAST * time.seconds(NOMINAL, FAST)


def _i2c(packets: list[Packet]) -> Iterator[Figure]:
    bits = sum(i2c_bits(len(encode_packet(p))) for p in packets)
    yield at_least("protocol.i2c.efficiency", _efficiency(bits), "%", 81)
    cutter = Cutter(SMBUS_BLOCK)
    smbus = 0
    for packet in packets:
        for block in cutter.fragments(WRITE_COMMAND, encode_packet(packet)):
            smbus += smbus_write_bits(len(block))
    yield Figure("protocol.smbus.efficiency", _efficiency(smbus), "%")


# Sample formats


def signal_to_error_db(signal: Floats, kind: SampleFormat) -> float:
    """Return the signal-to-error ratio of a signal (S, C) in codes, sent in blocks of 32 [dB]."""
    error = power = 0.0
    for k in range(0, len(signal) - 31, 32):
        part = signal[k : k + 32]
        codes = np.rint(part).astype(np.int16)
        back = samples.decode(kind, samples.encode(kind, codes), *codes.shape)
        error += float(np.sum((back - part) ** 2))
        power += float(np.sum(part**2))
    return float(10 * np.log10(power / error))


def measure_formats() -> Iterator[Figure]:
    """Measure the worst signal-to-error ratio of several textures, at full scale and 30 dB down."""
    goals = {
        SampleFormat.PCM16: (80, 50),
        SampleFormat.PCM12: (60, 30),
        SampleFormat.BFP8: (43, 30),
    }
    results: dict[SampleFormat, list[tuple[float, float]]] = {kind: [] for kind in goals}
    for name in HANDFUL:
        stroke = Trajectory.line(speed=0.08, duration=1.0)
        drive = render(load_display("reference-24"), load_texture(name), stroke).drive
        full = drive[int(0.1 * RATE) :] * (LARGEST / np.abs(drive).max())
        for kind, ratios in results.items():
            pair = signal_to_error_db(full, kind), signal_to_error_db(full * QUIETER, kind)
            ratios.append(pair)
    for kind, ratios in results.items():
        for label, which in (("full_drive", 0), ("30_dB_down", 1)):
            name = f"protocol.{kind.name.lower()}.{label}"
            values = [pair[which] for pair in ratios]
            yield at_least(name, min(values), "dB", goals[kind][which])
            yield Figure(f"{name}.median", float(np.median(values)), "dB")


# Currents


def measure_windows() -> Iterator[Figure]:
    """Measure what CORRELATION of 24 channels takes each 25 ms, from frames of our encoders.

    The currents are those of capacitors of 12.8 nF at the drive of oak, in the direction of replies
    of a UART and, stuffed as its own bits require, on CAN FD. What a rounded sum loses is held
    against the noise that an ADC of 12 bits leaves in it.
    """
    codes = codes_of(oak_drive(), 100.0).astype(np.int64)
    steps = np.diff(codes, axis=0, prepend=np.zeros((1, codes.shape[1]), np.int64))
    full = 2.5e-3 / (12.8e-9 * RATE * 100.0)  # code of the current for a step of a code
    currents = np.rint(steps / full).astype(np.int64)
    windows = Correlator(24).add(0, codes, np.clip(currents, -32767, 32767), WINDOW)
    packets = [
        Packet.of(message, node=1, seq=k)
        for window in windows
        for k, message in enumerate(messages_of(window, 2500, PACKET_MAX))
    ]
    seconds_long = len(windows) * WINDOW / RATE
    uart = sum(uart_bits(len(encode_frame(encode_packet(p)))) for p in packets) / 3e6
    yield at_most("protocol.correlation.uart_3M", 100 * uart / seconds_long, "%", 12.5)
    encoder = CanEncoder(from_amplifier=True, fd=True)
    frames = [frame for p in packets for frame in encoder.frames(p)]
    fd = sum(fd_bits(*frame).seconds(NOMINAL, FAST) for frame in frames)
    yield at_most("protocol.correlation.can_fd", 100 * fd / seconds_long, "%", 10)
    yield Figure("protocol.correlation.frames", len(frames) / seconds_long, "1/s")
    yield at_most("protocol.correlation.rounding", _rounding_share(windows, steps), "%", 5)


def _rounding_share(windows: list[CompleteWindow], steps: NDArray[np.int64]) -> float:
    """Return the worst ratio of the rounding of the sums to the noise in them, in power [%]."""
    worst = 0.0
    for window in windows[1:]:
        entries = np.frombuffer(window.entries, ENTRY)
        rounding = 2.0 ** entries["exponent"] / np.sqrt(12) * (entries["exponent"] > 0)
        energy = np.sum(steps[window.position :][: window.samples] ** 2, axis=0)
        noise = 16 * np.sqrt(energy)  # of one step of 12 bits, rms
        worst = max(worst, float(np.max((rounding / np.maximum(noise, 1)) ** 2)))
    return 100 * worst


def measure_protocol() -> Iterator[Figure]:
    """Measure codec, links, sample formats and correlated currents."""
    yield from measure_codec()
    yield from measure_links()
    yield from measure_formats()
    yield from measure_windows()
