"""The codec against slow implementations of its own rules, written here from SPEC.md.

What is compared with is bitwise (CRC-32), byte by byte (COBS, fragments) or in Python's integers
(sample formats); whatever is drawn at random is drawn by hypothesis.
"""

import random
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import pairwise
from math import floor
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_protocol import generate, samples
from firmware_protocol import messages as m
from firmware_protocol.amplifier import Amplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame, padded
from firmware_protocol.config import Config
from firmware_protocol.host import codes_of, pcm
from firmware_protocol.i2c_link import (
    WAITING,
    I2cTarget,
    SmbusTarget,
    decode_read,
)
from firmware_protocol.messages import MESSAGES, Message, SampleFormat
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, coded_limit, encode_frame

Codes = NDArray[np.int16]
FORMATS = (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)
FD_LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
"""ISO 11898-1, table of data length codes."""
SCHEMA = generate.load()

BYTE = st.integers(0, 255)
BODY = st.binary(max_size=600) | st.lists(st.sampled_from([0, 1, 255]), max_size=600).map(bytes)
"""Bytes of any value, and some with many zeros and runs."""
PACKET = st.builds(Packet, BYTE, BODY, BYTE, BYTE, BYTE)


def drawn(*values: Any, examples: int = 100, **named: Any) -> Callable[[Callable[..., None]], Any]:
    """Return hypothesis's ``given``, without a deadline: the machine may be busy."""
    draw: Any = given(*values, **named)
    relaxed = settings(deadline=None, max_examples=examples)
    return lambda test: relaxed(draw(test))


# What is compared with


def slow_crc(data: bytes) -> int:
    """CRC-32 bit by bit, as section 2 gives its polynomial."""
    crc = 0xFFFFFFFF
    for byte in data:
        for bit in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if (crc ^ byte >> bit) & 1 else 0)
    return crc ^ 0xFFFFFFFF


def slow_packet(packet: Packet) -> bytes:
    head = bytes([packet.type, packet.flags, packet.node, packet.seq]) + packet.payload
    return head + slow_crc(head).to_bytes(4, "little")


def slow_cobs(data: bytes) -> bytes:
    """Cheshire & Baker: up to 254 bytes without a zero after a code one larger than their number.

    Code 255 stands for no zero; a zero is thought to follow the data.
    """
    out = b""
    rest = data + b"\0"
    while rest:
        run = rest.index(0)
        if run >= 254:
            out += b"\xff" + rest[:254]
            rest = rest[254:]
            if rest == b"\0":
                break
        else:
            out += bytes([run + 1]) + rest[:run]
            rest = rest[run + 1 :]
    return out


def slow_uncobs(coded: bytes) -> bytes | None:
    out, at = b"", 0
    while at < len(coded):
        code = coded[at]
        block = coded[at + 1 : at + code]
        if len(block) < code - 1 or 0 in block:
            return None
        out += block + (b"\0" if code < 255 else b"")
        at += code
    return out[:-1] if coded and code < 255 else out


def slow_fragments(packet: bytes, size: int, transfer: int) -> list[bytes]:
    """Section 3.2: the first carries the length, and two bytes less."""
    rest = len(packet).to_bytes(2, "little") + packet
    pieces = [rest[k : k + size - 1] for k in range(0, len(rest), size - 1)]
    heads = [transfer + 0x20 * (k % 2) for k in range(len(pieces))]
    heads[0] += 0x80
    heads[-1] += 0x40
    return [bytes([head]) + piece for head, piece in zip(heads, pieces, strict=True)]


def rounded(value: Fraction) -> int:
    """To the nearest, halves up (section 9)."""
    return floor(value + Fraction(1, 2))


def clamp(value: int, limit: int) -> int:
    return max(-limit, min(limit, value))


def slow_pcm12(codes: list[int]) -> bytes:
    """Nibble by nibble, low one first."""
    nibbles: list[int] = []
    for code in codes:
        v = clamp(rounded(Fraction(code, 16)), 2047) % 4096
        nibbles += [v % 16, v // 16 % 16, v // 256]
    nibbles += [0] * (len(nibbles) % 2)
    return bytes(low + 16 * high for low, high in zip(nibbles[::2], nibbles[1::2], strict=True))


def slow_unpcm12(data: bytes, count: int) -> list[int]:
    nibbles = [n for byte in data for n in (byte % 16, byte // 16)]
    three = [nibbles[k : k + 3] for k in range(0, 3 * count, 3)]
    values = [low + 16 * middle + 256 * high for low, middle, high in three]
    return [16 * clamp(v - 4096 if v >= 2048 else v, 2047) for v in values]


def exponent_of(block: list[int]) -> int:
    """Return the least up to 8 for which all mantissas lie within ±127."""
    for e in range(8):
        if all(abs(rounded(Fraction(c, 2**e))) <= 127 for c in block):
            return e
    return 8


def blocks_of(codes: list[list[int]]) -> Iterator[list[int]]:
    """Blocks of up to 32 samples, channel by channel."""
    for channel in zip(*codes, strict=True):
        for k in range(0, len(channel), 32):
            yield list(channel[k : k + 32])


def slow_bfp8(codes: list[list[int]]) -> bytes:
    out = b""
    for block in blocks_of(codes):
        e = exponent_of(block)
        out += bytes([e, *(clamp(rounded(Fraction(c, 2**e)), 127) % 256 for c in block)])
    return out


def slow_unbfp8(data: bytes, count: int, channels: int) -> list[list[int]]:
    columns: list[list[int]] = []
    rest = list(data)
    for _ in range(channels):
        column: list[int] = []
        while len(column) < count:
            e = min(rest.pop(0), 8)
            for _ in range(min(32, count - len(column))):
                byte = rest.pop(0)
                column.append(clamp((byte - 256 if byte > 127 else byte) * 2**e, 32767))
        columns.append(column)
    return [list(row) for row in zip(*columns, strict=True)]


# Packets


@drawn(BODY)
def test_the_crc_is_the_one_of_the_bitwise_rule(body: bytes) -> None:
    assert slow_crc(b"123456789") == 0xCBF43926
    packet = Packet(1, body, 2, 3, 4)
    assert encode_packet(packet) == slow_packet(packet)


@drawn(PACKET)
def test_a_packet_is_decoded_as_it_was_encoded(packet: Packet) -> None:
    counters = LinkCounters()
    assert decode_packet(encode_packet(packet), counters) == packet
    assert counters == LinkCounters(packets=1)


@drawn(PACKET, st.data())
def test_up_to_three_wrong_bits_and_a_burst_of_32_are_seen(
    packet: Packet, data: st.DataObject
) -> None:
    """CRC-32 has distance 4 up to 91607 bits (Koopman 2002) and sees every burst of 32 bits."""
    sent = encode_packet(packet)
    value, size = int.from_bytes(sent, "little"), 8 * len(sent)
    few = data.draw(st.sets(st.integers(0, size - 1), min_size=1, max_size=3))
    burst = data.draw(st.integers(1, 2**32 - 1)) << data.draw(st.integers(0, size - 32))
    for error in (sum(1 << bit for bit in few), burst):
        counters = LinkCounters()
        assert decode_packet((value ^ error).to_bytes(len(sent), "little"), counters) is None
        assert counters == LinkCounters(crc_errors=1)


@pytest.mark.parametrize(
    ("size", "limit", "counted"),
    [(0, 64, "malformed"), (7, 64, "malformed"), (8, 64, "packets"), (64, 64, "packets"),
     (65, 64, "oversized"), (4096, 4096, "packets"), (4097, 4096, "oversized")],
)  # fmt: skip
def test_a_packet_has_8_bytes_to_the_limit(size: int, limit: int, counted: str) -> None:
    data = encode_packet(Packet(1, bytes(size - 8))) if size >= 8 else bytes(size)
    counters = LinkCounters()
    decode_packet(data, counters, limit)
    assert counters == LinkCounters(**{counted: 1})


# Serial


@drawn(BODY)
def test_cobs_is_as_published(body: bytes) -> None:
    coded = encode_frame(body)
    assert coded == slow_cobs(body) + b"\0"
    assert slow_uncobs(coded[:-1]) == body
    assert len(coded) - 1 <= coded_limit(len(body))


def test_the_coded_limit_is_that_of_the_longest_packet() -> None:
    assert coded_limit(4096) == 4096 + 17
    assert len(encode_frame(b"\1" * 4096)) == 4096 + 17 + 1


@drawn(st.lists(PACKET, max_size=4), st.data())
def test_any_cut_of_a_stream_gives_the_same_packets(
    sent: list[Packet], data: st.DataObject
) -> None:
    """Whatever stray zeros and rubbish lie between them, packets and counts are the same."""
    noise = st.binary(max_size=20).map(lambda b: b + b"\0") | st.just(b"\0\0")
    stream = b"".join(data.draw(noise) + encode_frame(encode_packet(p)) for p in sent)
    whole = SerialDecoder()
    assert [p for p in whole.feed(stream) if p in sent] == sent
    cuts = sorted(data.draw(st.sets(st.integers(0, len(stream)), max_size=12)))
    cut = SerialDecoder()
    for a, b in pairwise([0, *cuts, len(stream)]):
        cut.feed(stream[a:b])
    one = SerialDecoder()
    found = [p for k in range(len(stream)) for p in one.feed(stream[k : k + 1])]
    assert [p for p in found if p in sent] == sent
    assert cut.counters == whole.counters == one.counters


@drawn(
    st.binary(max_size=300) | st.lists(st.sampled_from([0, 1, 2, 9, 255]), max_size=300).map(bytes)
)
def test_any_stream_is_counted_as_the_rules_say(stream: bytes) -> None:
    """Frame by frame with the slow COBS: nothing raises, nothing is counted twice or not at all."""
    limit = 40
    expected = LinkCounters()
    for frame in stream.split(b"\0")[:-1]:
        if len(frame) > coded_limit(limit):
            expected.oversized += 1
        elif frame:
            decoded = slow_uncobs(frame)
            decode_packet(b"" if decoded is None else decoded, expected, limit)
    decoder = SerialDecoder(limit)
    decoder.feed(stream)
    rest = stream.split(b"\0")[-1]
    expected.oversized += len(rest) > coded_limit(limit)
    assert decoder.counters == expected


def test_an_endless_frame_takes_no_memory_and_is_counted_once() -> None:
    decoder = SerialDecoder(64)
    for _ in range(10_000):
        assert decoder.feed(b"\7" * 10) == []
        assert len(decoder._rest) <= coded_limit(64)
    good = Packet(0x0F, b"", node=1)
    assert decoder.feed(b"\0" + encode_frame(encode_packet(good))) == [good]
    assert decoder.counters == LinkCounters(packets=1, oversized=1)


def test_a_zero_first_saves_the_packet_after_an_abandoned_frame() -> None:
    good = encode_frame(encode_packet(Packet(0x08, b"\1")))
    abandoned = good[:5]
    decoder = SerialDecoder()
    assert decoder.feed(abandoned + good) == []
    assert len(decoder.feed(abandoned + b"\0" + good)) == 1


# CAN

STREAMED = st.builds(
    Packet, st.just(0x10), st.binary(max_size=250), st.just(0x40), st.integers(0, 127), BYTE
)


def can_pair(*, fd: bool, extended: bool = False) -> tuple[CanEncoder, CanDecoder]:
    encoder = CanEncoder(from_amplifier=False, fd=fd, extended=extended)
    return encoder, CanDecoder(from_amplifier=False, extended=extended)


def feed(decoder: CanDecoder, frames: list[Frame], step_us: int = 1) -> list[Packet]:
    return [p for k, f in enumerate(frames) for p in decoder.feed(*f, k * step_us)]


@pytest.mark.parametrize("fd", [False, True])
@drawn(packets=st.lists(STREAMED, max_size=4))
def test_can_frames_are_those_of_the_slow_rule(fd: bool, packets: list[Packet]) -> None:
    encoder, _ = can_pair(fd=fd)
    for count, packet in enumerate(packets):
        before = sum(p.node == packet.node for p in packets[:count])
        slow = slow_fragments(slow_packet(packet), 64 if fd else 8, before % 32)
        frames = encoder.frames(packet)
        assert {identifier for identifier, _ in frames} == {3 << 8 | packet.node << 1}
        assert len(frames) == len(slow)
        for (_, data), expected in zip(frames, slow, strict=True):
            assert data[: len(expected)] == expected
            assert not any(data[len(expected) :])
            assert len(data) == min(n for n in FD_LENGTHS if n >= len(expected))


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("fd", [False, True])
@drawn(packets=st.lists(STREAMED, max_size=4), data=st.data())
def test_interleaved_transfers_of_nodes_arrive(
    fd: bool, extended: bool, packets: list[Packet], data: st.DataObject
) -> None:
    """Up to four at once, in any order that keeps each one's own: all come, whole."""
    encoder, decoder = can_pair(fd=fd, extended=extended)
    waiting = [frames for p in packets if (frames := encoder.frames(p))]
    mixed: list[Frame] = []
    while waiting:
        turn = data.draw(st.integers(0, len(waiting) - 1))
        mixed.append(waiting[turn].pop(0))
        waiting = [frames for frames in waiting if frames]
    assert all(i >> 11 == (0x1D0B0000 >> 11 if extended else 0) for i, _ in mixed)
    found = feed(decoder, mixed)
    assert sorted(map(encode_packet, found)) == sorted(map(encode_packet, packets))
    assert decoder.counters == LinkCounters(packets=len(packets))


def harm(rng: random.Random, frames: list[Frame]) -> list[Frame]:
    """Lose, repeat, exchange or spoil one frame."""
    frames, at = list(frames), rng.randrange(len(frames))
    how = rng.choice(("lose", "repeat", "exchange", "spoil"))
    if how == "lose":
        del frames[at]
    elif how == "repeat":
        frames.insert(at, frames[at])
    elif how == "exchange":
        frames.insert(rng.randrange(len(frames)), frames.pop(at))
    else:
        identifier, data = frames[at]
        place = rng.randrange(len(data))
        spoilt = data[:place] + bytes([data[place] ^ rng.randrange(1, 256)]) + data[place + 1 :]
        frames[at] = identifier, spoilt
    return frames


@pytest.mark.parametrize("fd", [False, True])
@drawn(packets=st.lists(STREAMED, min_size=1, max_size=6), seed=st.integers(0, 10**6))
def test_harmed_frames_cost_packets_and_never_make_one(
    fd: bool, packets: list[Packet], seed: int
) -> None:
    """One frame lost, repeated, exchanged or spoilt costs the packets that it touches.

    At most two: its own, and where its first byte turned into another's, that.
    """
    encoder, decoder = can_pair(fd=fd)
    packets = [Packet(p.type, p.payload, p.flags, p.node, k) for k, p in enumerate(packets)]
    frames = [f for p in packets for f in encoder.frames(p)]
    found = feed(decoder, harm(random.Random(seed), frames))
    assert all(packet in packets for packet in found)
    assert sum(packet not in found for packet in packets) <= 2


@drawn(st.lists(st.tuples(st.integers(0, 2**29 - 1), st.binary(max_size=64), st.integers(0, 9999))))
def test_no_can_frames_raise_and_four_transfers_are_kept(
    frames: list[tuple[int, bytes, int]],
) -> None:
    for from_amplifier in (False, True):
        decoder, now = CanDecoder(from_amplifier=from_amplifier, limit=64), 0
        for identifier, data, later in frames:
            now += later
            for prefix in (0, 0x1D0B0000):
                decoder.feed(prefix + identifier % 2048, data, now)
            decoder.feed(identifier, data, now)
            transfers = decoder._reassembler._transfers.values()
            assert len(transfers) <= 4
            assert all(len(t.data) <= 64 + 63 for t in transfers)


def test_a_fifth_transfer_drops_the_oldest() -> None:
    """Section 3.2: four are kept; what comes of the oldest later belongs to none."""
    encoder, decoder = can_pair(fd=False)
    packets = [Packet(0x0F, bytes(6), 0x60, node, 0) for node in range(1, 6)]
    starts, rests = zip(*((f[0], f[1:]) for f in map(encoder.frames, packets)), strict=True)
    found = feed(decoder, [*starts, *(frame for rest in rests for frame in rest)])
    assert found == packets[1:]
    assert decoder.counters == LinkCounters(packets=4, fragments_dropped=1 + len(rests[0]))


def test_a_lost_frame_drops_its_transfer_at_the_next() -> None:
    """By its toggle, before the end comes: the two after it belong to none."""
    encoder, decoder = can_pair(fd=False)
    frames = encoder.frames(Packet(0x0F, bytes(20), 0x60, 1, 0))
    assert len(frames) == 5
    assert feed(decoder, [frames[0], *frames[2:]]) == []
    assert decoder.counters == LinkCounters(fragments_dropped=3)


def test_an_end_that_comes_too_early_drops_its_transfer() -> None:
    """Two frames in a row lost: the toggle fits, the length does not."""
    encoder, decoder = can_pair(fd=False)
    first, _, _, *rest = encoder.frames(Packet(0x0F, bytes(20), 0x60, 1, 0))
    assert feed(decoder, [first, *rest]) == []
    assert decoder.counters == LinkCounters(fragments_dropped=1)


@pytest.mark.parametrize(("last_us", "taken"), [(19_999, True), (20_000, False)])
def test_a_transfer_has_20_ms(last_us: int, taken: bool) -> None:
    packet = Packet(0x0F, b"", 0x60, 1, 0)
    encoder, decoder = can_pair(fd=False)
    first, last = encoder.frames(packet)
    decoder.feed(*first, 0)
    assert decoder.feed(*last, last_us) == [packet] * taken
    assert decoder.counters.fragments_dropped == (0 if taken else 2)


def test_an_identifier_says_class_node_and_direction() -> None:
    for message, kind in ((m.Estop(1), 0), (m.Sync(2), 1), (m.Heartbeat(3), 1), (m.Poll(), 4)):
        for node in (0, 1, 127):
            encoder, decoder = can_pair(fd=False)
            frames = encoder.frames(Packet.of(message, node=node))
            assert {i for i, _ in frames} == {kind * 256 + node * 2}
            (packet,) = feed(decoder, frames)
            assert (packet.type, packet.node) == (message.TYPE, node)
            assert type(message).unpack(packet.payload) == message
    amplifier = CanEncoder(from_amplifier=True, fd=False)
    for answer, kind in ((m.Pulse(), 2), (m.Ack(), 5), (m.Log(), 6)):
        assert {i for i, _ in amplifier.frames(Packet.of(answer, node=5))} == {kind * 256 + 11}


def test_prompt_frames_are_bare_payloads() -> None:
    """No header, no CRC-32; those of class 1 begin with their type."""
    host = CanEncoder(from_amplifier=False, fd=False)
    amplifier = CanEncoder(from_amplifier=True, fd=False)
    pulse = m.Pulse(0x01020304, 2, 2, 0, 9)
    assert amplifier.frames(Packet.of(pulse, node=1)) == [(0x203, pulse.pack())]
    assert host.frames(Packet.of(m.Estop(3), node=1)) == [(2, b"\3")]
    assert host.frames(Packet.of(m.Heartbeat(0x1234), node=1)) == [(0x102, b"\x0a\x34\x12")]


def test_prompt_frames_that_are_none_are_counted() -> None:
    decoder = CanDecoder(from_amplifier=False, node=1)
    for identifier, data in (
        (0x102, b""),
        (0x102, b"\x06\1"),
        (0x104, b""),
        (0x103, b""),
        (0x202, b""),
    ):
        assert decoder.feed(identifier, data, 0) == []
    assert decoder.counters == LinkCounters(malformed=1, unknown_type=1)


def test_every_size_is_padded_to_the_next_that_can_fd_has() -> None:
    assert [len(padded(bytes(size))) for size in range(65)] == [
        min(n for n in FD_LENGTHS if n >= size) for size in range(65)
    ]


@drawn(st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1), BYTE, st.integers(0, 2**64 - 1))
def test_start_is_prompt_without_a_time_only(
    session: int, position: int, delay_ms: int, time: int
) -> None:
    encoder, decoder = can_pair(fd=False)
    start = m.Start(session, position, delay_ms, time)
    frames = encoder.frames(Packet.of(start, node=1))
    assert frames[0][0] >> 8 == (4 if time else 1)
    assert [m.Start.unpack(p.payload) for p in feed(decoder, frames)] == [start]


def test_the_time_of_a_prompt_start_reads_as_0_however_long_the_frame() -> None:
    """An FD frame has room for the time; a prompt START ends after delay_ms nevertheless."""
    payload = m.Start(7, 8, 9, 0xAABBCCDD).pack()
    (packet,) = CanDecoder(from_amplifier=False).feed(0x102, b"\x04" + payload + b"\1", 0)
    assert m.Start.unpack(packet.payload) == m.Start(7, 8, 9, 0)


@pytest.mark.parametrize(("size", "taken"), [(8, False), (16, True)])
def test_only_fd_frames_have_padding(size: int, taken: bool) -> None:
    """More than the length in a frame of 8 bytes is too much; FD has all lengths up to 8."""
    encoder, decoder = can_pair(fd=size > 8)
    *frames, (identifier, last) = encoder.frames(Packet(0x0C, b"\2\0", 0x60, 1, 0))
    found = feed(decoder, [*frames, (identifier, last.ljust(size, b"\0"))])
    assert len(found) == taken
    assert decoder.counters.fragments_dropped == (not taken)


def test_identifiers_of_11_and_29_bits_are_two() -> None:
    """A transfer that begins with one and goes on with the other is none."""
    packet = Packet(0x0F, bytes(8), 0x60, 1, 0)
    short, long = (can_pair(fd=False, extended=e)[0].frames(packet) for e in (False, True))
    decoder = CanDecoder(from_amplifier=False)
    assert feed(decoder, [short[0], *long[1:]]) == []
    assert feed(decoder, [short[0], *short[1:]]) == [packet]


# I²C


@drawn(st.lists(PACKET, max_size=WAITING))
def test_raw_transfers_carry_packets_both_ways(packets: list[Packet]) -> None:
    """One byte too few leaves the packet where it is; further ones are zeros."""
    target = I2cTarget(limit=4096)
    for packet in packets:
        data = encode_packet(packet)
        assert target.write(data) == [packet]
        assert target.put(data)
    for packet in packets:
        size = len(packet.payload) + 10
        assert decode_read(target.read(size - 1)) is None
        read = target.read(size + 7)
        assert read[size:] == bytes(7)
        assert decode_read(read) == packet
    assert target.read(5) == bytes(5)
    assert target.counters == LinkCounters(packets=len(packets))


def test_smbus_blocks_are_those_of_the_slow_rule() -> None:
    """One block, two, and the most: 29 and 30 bytes are where the second begins."""
    target, host = SmbusTarget(), SmbusTarget()
    for count, size in enumerate((0, 20, 21, 22, 23, 52, 53, 54, 247)):
        packet = Packet(0x48, bytes(range(size)), 0x40, 1, count)
        blocks = slow_fragments(slow_packet(packet), 32, count % 32)
        assert max(map(len, blocks)) <= 32
        assert [p for b in blocks for p in target.write(b, 0)] == [packet]
        assert target.put(encode_packet(packet))
        assert [target.read() for _ in blocks] == blocks
        assert target.read() == b"\0"
        assert [p for b in blocks for p in host.write(b, 0)] == [packet]
    assert target.counters == host.counters == LinkCounters(packets=9)


@drawn(st.lists(st.binary(max_size=300), max_size=20))
def test_no_transfer_raises(transfers: list[bytes]) -> None:
    raw, smbus = I2cTarget(), SmbusTarget()
    for data in transfers:
        raw.write(data)
        smbus.write(data, 0)
        smbus.write(data[:32], 0)
        decode_read(data)
    assert all(raw.put(b"") for _ in range(WAITING))
    assert not raw.put(b"")


# Samples

CODE = st.integers(-32767, 32767) | st.sampled_from([-32767, -32760, -24, -8, 8, 24, 32759, 32767])


@st.composite
def code_arrays(draw: st.DrawFn) -> Codes:
    """Codes (S, C), loud and quiet ones."""
    shape = draw(st.integers(1, 70)), draw(st.integers(1, 5))
    loudness = draw(st.sampled_from([1, 100, 127, 128, 255, 4000, 32640, 32767]))
    seed = draw(st.integers(0, 2**32 - 1))
    codes = np.random.default_rng(seed).integers(-loudness, loudness + 1, shape).astype(np.int16)
    for _ in range(draw(st.integers(0, 3))):
        codes[draw(st.integers(0, shape[0] - 1)), 0] = draw(CODE)
    return codes


def test_every_code_is_packed_as_python_integers_say() -> None:
    """PCM12, all 65535 of them, alone and as pairs."""
    codes = np.arange(-32767, 32768, dtype=np.int16)
    expected = slow_pcm12(codes.tolist())
    assert samples.encode(SampleFormat.PCM12, codes[:, None]) == expected
    decoded = samples.decode(SampleFormat.PCM12, expected, len(codes), 1)
    assert decoded[:, 0].tolist() == slow_unpcm12(expected, len(codes))


@drawn(code_arrays())
def test_sample_formats_are_those_of_python_integers(codes: Codes) -> None:
    rows, (count, channels) = codes.tolist(), codes.shape
    slow = {
        SampleFormat.PCM16: b"".join(c.to_bytes(2, "little", signed=True) for r in rows for c in r),
        SampleFormat.PCM12: slow_pcm12([c for row in rows for c in row]),
        SampleFormat.BFP8: slow_bfp8(rows),
    }
    for kind, expected in slow.items():
        assert samples.encode(kind, codes) == expected
        assert samples.size(kind, count, channels) == len(expected)


@drawn(st.integers(1, 70), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_any_bytes_of_the_right_size_are_decoded_as_python_integers(
    count: int, channels: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    for kind in FORMATS:
        data = rng.bytes(samples.size(kind, count, channels))
        if kind == SampleFormat.PCM16:
            words = [data[k : k + 2] for k in range(0, len(data), 2)]
            flat = [max(int.from_bytes(w, "little", signed=True), -32767) for w in words]
        elif kind == SampleFormat.PCM12:
            flat = slow_unpcm12(data, count * channels)
        else:
            flat = [code for row in slow_unbfp8(data, count, channels) for code in row]
        assert samples.decode(kind, data, count, channels).ravel().tolist() == flat


@drawn(code_arrays())
def test_errors_are_within_their_closed_forms(codes: Codes) -> None:
    """PCM12: half of 16, and 15 at the ends, where ±2048 is clamped; BFP8: half a step.

    A block of peak p took exponent e > 0 as e − 1 did not do, so that p ≥ 127.5 × 2^(e−1): half
    a step is at most p / 127.5, and nothing below 128. From 32640 on 127 × 2⁸ is the most.
    """
    exact = samples.decode(0, samples.encode(0, codes), *codes.shape)
    assert np.array_equal(exact, codes)
    size = np.abs(codes.astype(int))
    error = np.abs(samples.decode(1, samples.encode(1, codes), *codes.shape) - codes.astype(int))
    assert np.all(error <= np.where(size <= 32760, 8, size - 2047 * 16))
    error = np.abs(samples.decode(2, samples.encode(2, codes), *codes.shape) - codes.astype(int))
    for k in range(0, len(codes), 32):
        peak = size[k : k + 32].max(axis=0)
        bound = np.where(peak < 128, 0, np.minimum(peak / 127.5, 128))
        clamped = np.maximum(bound, size[k : k + 32] - 127 * 256)
        assert np.all(error[k : k + 32] <= clamped)


@pytest.mark.parametrize("kind", [SampleFormat.PCM16, SampleFormat.PCM12])
@drawn(codes=code_arrays())
def test_codes_that_were_sent_once_are_sent_on_unchanged(kind: SampleFormat, codes: Codes) -> None:
    once = samples.decode(kind, samples.encode(kind, codes), *codes.shape)
    assert np.array_equal(samples.decode(kind, samples.encode(kind, once), *codes.shape), once)


def test_what_no_encoder_makes_reads_as_the_largest() -> None:
    """−32768 as −32767, −2048 as −2047; −128 × 2⁸ is clamped, exponents above 8 read as 8."""
    assert samples.decode(SampleFormat.PCM16, b"\x00\x80", 1, 1).tolist() == [[-32767]]
    assert samples.decode(SampleFormat.PCM12, b"\x00\x08", 1, 1).tolist() == [[-2047 * 16]]
    assert samples.decode(SampleFormat.BFP8, b"\x08\x80", 1, 1).tolist() == [[-32767]]
    assert samples.decode(SampleFormat.BFP8, b"\xff\x03", 1, 1).tolist() == [[3 * 256]]


def test_a_format_that_is_none_has_no_size() -> None:
    assert [samples.size(kind, 3, 3) for kind in (3, 4, 255)] == [-1, -1, -1]


# Blocks of the host


@drawn(
    st.sampled_from(FORMATS), st.integers(1, 400), st.integers(1, 255), st.integers(64, 4096),
    st.integers(0, 2**32 - 1), examples=60,
)  # fmt: skip
def test_a_block_is_split_into_packets_that_fit_and_cover_it(
    kind: SampleFormat, count: int, channels: int, limit: int, position: int
) -> None:
    """Every sample of every channel is in exactly one message; no message exceeds the limit."""
    codes = (np.arange(count)[:, None] * 16 + np.arange(channels) * 16 * 37).astype(np.int16) >> 1
    there = np.zeros(codes.shape, int)
    options = {"session": 9, "sample_format": int(kind), "packet_limit": limit}
    messages = list(pcm(position, codes, **options))
    for message in messages:
        assert len(encode_packet(Packet.of(message))) <= limit
        assert message.samples >= 1
        assert message.session == 9
        start = (message.position - position) % 2**32
        rows = slice(start, start + message.samples)
        columns = slice(message.first_channel, message.first_channel + message.channels)
        there[rows, columns] += 1
        assert message.data == samples.encode(kind, codes[rows, columns])
    assert np.all(there == 1)


def test_a_block_that_fits_is_one_packet() -> None:
    """64 × 32 of PCM12: 3072 bytes, the header 10, the packet's 8."""
    codes = np.zeros((32, 64), np.int16)
    (message,) = pcm(0, codes, session=1, sample_format=SampleFormat.PCM12, packet_limit=4096)
    assert len(encode_packet(Packet.of(message))) == 3072 + 10 + 8
    assert len(list(pcm(0, codes, session=1, sample_format=1, packet_limit=3090))) == 1
    assert len(list(pcm(0, codes, session=1, sample_format=1, packet_limit=3089))) == 2


def test_a_message_has_at_most_255_samples_and_positions_wrap() -> None:
    codes = np.zeros((300, 1), np.int16)
    found = list(pcm(2**32 - 255, codes, session=1, sample_format=0, packet_limit=4096))
    assert [(p.position, p.samples) for p in found] == [(2**32 - 255, 255), (0, 45)]


@drawn(st.lists(st.floats(-100, 100), min_size=1))
def test_volts_become_the_nearest_code(volts: list[float]) -> None:
    codes = codes_of(np.array(volts), 100.0)
    assert np.abs(codes * (100 / 32767) - np.array(volts)).max() <= 100 / 32767 / 2 * (1 + 1e-9)


# Messages


BODIES = {MESSAGES[d["id"]] for d in SCHEMA["message"] if "body" in d}

each_message = pytest.mark.parametrize("described", SCHEMA["message"], ids=lambda d: str(d["name"]))


def any_message(described: dict[str, Any], rng: random.Random) -> Message:
    """Return a message with any fields, none of them 0."""
    values: list[object] = [
        rng.randbytes(16) if kind == "char16" else rng.randrange(1, 2 ** int(kind[1:]))
        for _, kind in described["fields"]
    ]
    if "body" in described:
        values.append(rng.randbytes(rng.randrange(40)))
    return MESSAGES[described["id"]](*values)


@each_message
def test_an_unknown_tail_is_ignored(described: dict[str, Any]) -> None:
    """But for a body, which ends where the payload does."""
    rng = random.Random(1)
    for size in range(20):
        message = any_message(described, rng)
        kind, payload = type(message), message.pack()
        assert kind.unpack(payload) == message
        if kind not in BODIES:
            assert kind.unpack(payload + rng.randbytes(size)) == message


@each_message
def test_a_missing_tail_reads_as_0_and_a_missing_head_is_none(described: dict[str, Any]) -> None:
    """Wherever it is cut: of a field that is cut, the missing bytes are 0."""
    message = any_message(described, random.Random(2))
    kind, payload = type(message), message.pack()
    for kept in range(kind.HEAD.size):
        cut = kind.unpack(payload[:kept])
        if kind in BODIES:
            assert cut is None
        else:
            assert cut is not None
            assert cut.pack() == payload[:kept].ljust(kind.HEAD.size, b"\0")


def test_fields_lie_in_their_order_little_endian() -> None:
    """Each field's bytes are where the schema's order puts them."""
    for described in SCHEMA["message"]:
        kind = MESSAGES[described["id"]]
        at = 0
        for name, type_ in described["fields"]:
            size = 16 if type_ == "char16" else int(type_[1:]) // 8
            mark = bytes(range(1, size + 1))
            value = mark if type_ == "char16" else int.from_bytes(mark, "little")
            alone = kind(**{name: value})
            assert alone.pack().strip(b"\0") == mark
            assert alone.pack().index(mark) == at
            at += size
        assert kind.HEAD.size == at


def test_generated_files_are_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0, capsys.readouterr().err


def test_an_amplifier_whose_own_limits_break_the_promise_is_none() -> None:
    """100 V at 5000 V/s are 204 codes in an instant at 8 kHz, of which 160 do not reach 32767."""
    Amplifier(Config(slew_limit_v_per_s=5006, rate_min_hz=8000, rate_max_hz=8000))
    with pytest.raises(ValueError, match="slew_limit_v_per_s 5005: does not reach 0 V"):
        Amplifier(Config(slew_limit_v_per_s=5005, rate_min_hz=8000, rate_max_hz=8000))
