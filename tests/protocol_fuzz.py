"""Targets for fuzzers: properties of the Python decoders and amplifier for any bytes.

Each target takes bytes, and raises only where something is wrong. `fuzz/fuzz_python.py` feeds them
from atheris, `test_protocol_fuzz.py` from a seeded generator.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Protocol

import numpy as np
from protocol_traces import Loads

from firmware_protocol import correlation, samples
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import FD_SIZES, CanDecoder, CanEncoder
from firmware_protocol.config import AmplifierConfig, LimitsInForce
from firmware_protocol.fragments import Cutter, Reassembler
from firmware_protocol.host import AmplifierHost, refusal
from firmware_protocol.i2c_link import (
    SMBUS_BLOCK,
    WRITE_COMMAND,
    I2cTarget,
    SmbusTarget,
    decode_read,
)
from firmware_protocol.messages import SampleFormat, State
from firmware_protocol.packet import Packet, decode_packet, encode_packet
from firmware_protocol.ports import CanPort, I2cPort, SerialPort
from firmware_protocol.serial_link import SerialDecoder, coded_limit, encode_frame

KINDS = tuple(m.MESSAGES.values())
CONFIG = AmplifierConfig(
    channels=3,
    carriers=4,
    packet_limit=512,
    fifo=1024,
    full_scale_uv=90_000_000,
    voltage_limit_uv=90_000_000,
    sense_ranges_ua=(2500, 300),
)
LARGEST_STEP = LimitsInForce.of(CONFIG).step(CONFIG.rate_min_hz)


class Source:
    """Takes values from the front of bytes; zeros once they are used up."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def __bool__(self) -> bool:
        return self.at < len(self.data)

    def take(self, count: int) -> bytes:
        """Return the next bytes, fewer at the end."""
        self.at += count
        return self.data[self.at - count : self.at]

    def number(self, size: int = 1) -> int:
        """Return the next number."""
        return int.from_bytes(self.take(size), "little")


# Decoders


def packets(data: bytes) -> None:
    """See that what is a packet is sent as the same bytes, and that a message's fields survive."""
    packet = decode_packet(data)
    if packet is not None:
        assert encode_packet(packet) == data
    for kind in KINDS:
        message = kind.unpack(data)
        if message is not None:
            assert kind.unpack(message.pack()) == message
    host = AmplifierHost(1, 1)
    if len(data) >= 4:
        found = host.receive(Packet(data[0], data[4:], data[1], data[2], data[3]))
        if isinstance(found, m.Nak):
            assert refusal(found)


def serial(data: bytes) -> None:
    """Decode a stream, cut anywhere; check the result, and that what is kept is bounded."""
    source = Source(data)
    limit = 8 + source.number() * 2
    whole, cut = SerialDecoder(limit), SerialDecoder(limit)
    step, stream = 1 + source.number() % 40, data[2:]
    one = whole.feed(stream)
    two = []
    for start in range(0, len(stream), step):
        two += cut.feed(stream[start : start + step])
        assert len(cut._rest) <= coded_limit(limit)
    assert one == two
    assert whole.counters == cut.counters


def can(data: bytes) -> None:
    """Decode frames of any identifier and content, at any times."""
    source, now = Source(data), 0
    amplifier = bool(source.number() & 1)
    decoder = CanDecoder(from_amplifier=amplifier, limit=200, node=source.number() & 1 or None)
    while source:
        prefix = m.CAN_PREFIX if source.number() & 1 else 0
        identifier, size = prefix + source.number(2), FD_SIZES[source.number() % 16]
        now += source.number(2)
        for packet in decoder.feed(identifier, source.take(size), now):
            assert len(packet.payload) <= 192
        _bounded(decoder._reassembler, 200)


def i2c(data: bytes) -> None:
    """Decode transfers and blocks of any content, and read as a host does."""
    source, now = Source(data), 0
    raw, smbus = I2cTarget(), SmbusTarget()
    while source:
        now += source.number(2)
        size = source.number() % 40
        raw.write(source.take(size))
        smbus.write(source.take(size), now)
        decode_read(source.take(size))
        _bounded(smbus._reassembler, 255)


def windows(data: bytes) -> None:
    """Decode a CORRELATION of any content, and one that an amplifier may have sent."""
    message = m.Correlation.unpack(data)
    if message is not None:
        _decoded(message)
        _decoded(replace(message, lags=16, channels=len(message.entries) // 36))
    source = Source(data)
    count, channels = 1 + source.number() % 40, 1 + source.number() % 5
    size = 2 * count * channels
    raw = np.frombuffer(source.take(2 * size).ljust(2 * size, b"\xfe"), "<i2").astype(np.int64)
    codes, currents = raw.reshape(2, count, channels)
    (window,) = correlation.Correlator(channels).add(0, np.maximum(codes, -32767), currents, count)
    for sent in correlation.messages_of(window, 1 + source.number(), 136):
        _decoded(sent)
        assert correlation.decode(sent) is not None


def _decoded(message: m.Correlation) -> None:
    """See that what is decoded is within what the exponents can tell."""
    entries = correlation.decode(message)
    if entries is not None:
        assert entries.sums.shape == (message.channels, 16)
        assert np.abs(entries.sums).max() <= 32768 << 32
        assert 0 <= entries.energy.min() <= entries.energy.max() < 1 << 48


def _bounded(reassembler: Reassembler, limit: int) -> None:
    """Nothing longer than a packet is kept, and the frame that may have ended it."""
    transfers = reassembler._transfers.values()
    assert len(transfers) <= 4  # SPEC.md, 3.2
    assert all(len(t.data) <= limit + 63 for t in transfers)


def formats(data: bytes) -> None:
    """See that what is decoded is a code, and that it is played the same when it is sent on."""
    source = Source(data)
    count, channels = source.number() % 70, source.number() % 9
    for kind in (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8):
        size = samples.size(kind, count, channels)
        if not size:
            continue
        codes = samples.decode(kind, data[:size].ljust(size, b"\x9c"), count, channels)
        assert codes.shape == (count, channels)
        assert codes.dtype == np.int16
        assert codes.min() >= -32767
        again = samples.decode(kind, samples.encode(kind, codes), count, channels)
        if kind == SampleFormat.BFP8:
            assert np.abs(again.astype(int) - codes).max() <= 255
        else:
            assert np.array_equal(again, codes)


# The amplifier


class Link(Protocol):
    """Carries packets and rubbish to an amplifier, and its answers back."""

    def send(self, packet: Packet, now: int) -> None:
        """Send a packet."""

    def rubbish(self, data: bytes, now: int) -> None:
        """Send bytes as they are."""

    def answers(self, now: int) -> list[Packet]:
        """Return what came back."""


class SerialWire:
    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.port, self.decoder = SerialPort(amplifier), SerialDecoder()

    def send(self, packet: Packet, now: int) -> None:
        self.port.feed(encode_frame(encode_packet(packet)), now)

    def rubbish(self, data: bytes, now: int) -> None:
        self.port.feed(data, now)

    def answers(self, now: int) -> list[Packet]:
        return self.decoder.feed(self.port.take())


class PacketWire:
    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier

    def send(self, packet: Packet, now: int) -> None:
        self.rubbish(encode_packet(packet), now)

    def rubbish(self, data: bytes, now: int) -> None:
        self.amplifier.run(now)
        counters, limit = self.amplifier.counters, self.amplifier.config.packet_limit
        if packet := decode_packet(data, counters, limit):
            self.amplifier.receive(packet, now)

    def answers(self, now: int) -> list[Packet]:
        found = [decode_packet(encode_packet(packet)) for packet in self.amplifier.take_sent()]
        assert None not in found
        return [packet for packet in found if packet is not None]


class CanWire:
    FD, EXTENDED = False, False

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.port = CanPort(amplifier, fd=self.FD, extended=self.EXTENDED)
        self.encoder = CanEncoder(from_amplifier=False, fd=self.FD, extended=self.EXTENDED)
        self.decoder = CanDecoder(from_amplifier=True, extended=self.EXTENDED)

    def send(self, packet: Packet, now: int) -> None:
        for identifier, data in self.encoder.frames(replace(packet, node=packet.node & 0x7F)):
            self.port.feed(identifier, data, now)

    def rubbish(self, data: bytes, now: int) -> None:
        source = Source(data)
        self.port.feed(source.number(2), source.take(64), now)

    def answers(self, now: int) -> list[Packet]:
        return [p for f in self.port.take() for p in self.decoder.feed(*f, now)]


class CanFdWire(CanWire):
    FD, EXTENDED = True, True


class I2cWire:
    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.port = I2cPort(amplifier)

    def send(self, packet: Packet, now: int) -> None:
        self.port.write(encode_packet(packet), now)

    def rubbish(self, data: bytes, now: int) -> None:
        self.port.write(data, now)

    def answers(self, now: int) -> list[Packet]:
        found = []
        while (packet := decode_read(self.port.read(600, now))) is not None:
            found.append(packet)
        return found


class SmbusWire:
    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.port, self.cutter = I2cPort(amplifier), Cutter(SMBUS_BLOCK)
        self.decoder = SmbusTarget()

    def send(self, packet: Packet, now: int) -> None:
        for block in self.cutter.fragments(WRITE_COMMAND, encode_packet(packet)):
            self.port.write_block(block, now)

    def rubbish(self, data: bytes, now: int) -> None:
        self.port.write_block(data, now)

    def answers(self, now: int) -> list[Packet]:
        found = []
        while (block := self.port.read_block(now)) != b"\0":
            found += self.decoder.write(block, now)
        return found


WIRES: dict[str, Callable[[ReferenceAmplifier], Link]] = {
    "packet": PacketWire,
    "serial": SerialWire,
    "can": CanWire,
    "can_fd": CanFdWire,
    "i2c": I2cWire,
    "smbus": SmbusWire,
}


class Session:
    """Acts on an amplifier as bytes say, and looks at what it puts out."""

    def __init__(self, wire: str) -> None:
        self.amplifier = ReferenceAmplifier(CONFIG, Loads(CONFIG))
        self.wire = WIRES[wire](self.amplifier)
        self.host, self.now = AmplifierHost(0x1234, 1), 0
        self.last = np.zeros(CONFIG.channels, int)

    def begin(self, how: int) -> None:
        """Say hello, arm and start in one of the modes, or less."""
        session, mode = self.host.session, how >> 2 & 1
        opening: tuple[m.Message, ...] = (
            m.Hello(session, m.MAJOR, m.MINOR, m.SCHEMA_CRC),
            m.Carriers(session, 2, bytes(range(8))),
            m.Arm(session, mode, 8000),
            m.Start(session, 0xFFFFFFF0 if how & 8 else 0, how >> 4, 0),
        )
        for message in opening[: (0, 2, 3, 4)[how & 3]]:
            self.wire.send(self.host.request(message), self.now)

    def act(self, source: Source) -> None:
        """Do one action."""
        what = source.number()
        if what < 100:
            self._message(source, owned=bool(what & 1))
        elif what < 160:
            self._stream(source)
        elif what < 180:
            self.wire.rubbish(source.take(source.number()), self.now)
        elif what < 190:
            self.amplifier.fault(source.number() % 5, self.now)
        elif what < 195:
            self.amplifier.estop_input(source.number() % 2 == 1, self.now)
        elif what < 200:
            self._own(m.ClearFault(self.amplifier.session, self.amplifier.counters.trips))
        else:
            self.now += source.number(2)
            self.amplifier.run(self.now)

    def _message(self, source: Source, *, owned: bool) -> None:
        kind = KINDS[source.number() % len(KINDS)]
        how = source.number()
        payload = source.take(how & 0x3F)
        message: Any = kind.unpack(payload)
        if owned and hasattr(message, "session"):
            payload = replace(message, session=self.amplifier.session).pack()
        flags = source.number() if how & 0x80 else 0x60
        node = source.number() if how & 0x40 else self.amplifier.node
        self.wire.send(Packet(kind.TYPE, payload, flags, node, how), self.now)

    def _stream(self, source: Source) -> None:
        amplifier = self.amplifier
        position = (amplifier.position + source.number() - 32) % (1 << 32)
        first, channels = source.number() % 4, source.number() % 4
        kind, count = source.number() % 4, source.number() % 40
        if kind == SampleFormat.SPECTRUM8:
            carriers = len(amplifier._increments)
            size = 2 * channels * carriers
            body = source.take(size).ljust(size, b"\xf0")
            head = position, amplifier.session, count * 4, first, channels, kind, carriers
            self._own(m.Spectrum(*head, body))
            return
        size = samples.size(kind, count, channels)
        body = source.take(size).ljust(size, b"\x77")
        self._own(m.Pcm(position, amplifier.session, first, channels, kind, count, body))

    def _own(self, message: m.Message) -> None:
        packet = Packet.of(message, node=self.amplifier.node, ask=True)
        self.wire.send(packet, self.now)

    def look(self) -> None:
        """Check that every answer is valid, and every code within the hardware's limits."""
        for packet in self.wire.answers(self.now):
            assert self.host.receive(packet) is not None
        for played in self.amplifier.take_played():
            codes = np.vstack([self.last, played.codes]).astype(int)
            assert np.abs(codes).max() <= 32767
            assert np.abs(np.diff(codes, axis=0)).max() <= LARGEST_STEP
            if played.state in (State.IDLE, State.ARMED, State.SAFE):
                assert not codes[-1].any()
            self.last = codes[-1]
        assert self.amplifier.state == State.ESTOP or not self.amplifier.input_open
        counters = self.amplifier.counters
        assert all(getattr(counters, f.name) >= 0 for f in fields(counters))


def amplifier(data: bytes) -> None:
    """Act on a whole amplifier behind each link."""
    source = Source(data)
    names = tuple(WIRES)
    session = Session(names[source.number() % len(names)])
    session.begin(source.number())
    session.look()
    while source:
        session.act(source)
        session.look()


TARGETS: dict[str, Callable[[bytes], None]] = {
    "packets": packets,
    "serial": serial,
    "can": can,
    "i2c": i2c,
    "formats": formats,
    "windows": windows,
    "amplifier": amplifier,
}
