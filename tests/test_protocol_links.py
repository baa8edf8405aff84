"""Packets over serial, CAN and I²C: any cut, loss or harm costs packets and never makes one.

Whatever is drawn at random is drawn by hypothesis.
"""

import random
from itertools import pairwise

import pytest
from hypothesis import strategies as st
from slow_codec import (
    BODY,
    BYTE,
    FD_LENGTHS,
    PACKET,
    drawn,
    slow_cobs,
    slow_fragments,
    slow_packet,
    slow_uncobs,
)

from firmware_protocol import messages as m
from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame, padded
from firmware_protocol.i2c_link import I2cTarget, SmbusTarget, decode_read
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, coded_limit, encode_frame

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


def test_the_coded_limit_is_that_of_a_body_without_zeros_in_its_longer_form() -> None:
    """A body that ends with 254 bytes other than 0 may have a code for no bytes after them."""
    for size in range(8, 1100):
        longer_form = 1 if size % 254 == 0 else 0
        assert coded_limit(size) == len(slow_cobs(b"\1" * size)) + longer_form, size


@pytest.mark.parametrize("cut", [0, 20, 65])
def test_a_frame_as_long_as_the_limit_is_a_packet_and_a_longer_one_is_not(cut: int) -> None:
    """64 bytes take 65 coded ones, whether their 0x00 comes with them or later."""
    longest = Packet(0x10, b"\7" * 56, node=3)
    frame = encode_frame(encode_packet(longest))
    assert len(frame) == 66
    decoder = SerialDecoder(64)
    assert decoder.feed(frame[:cut]) + decoder.feed(frame[cut:]) == [longest]
    assert decoder.counters == LinkCounters(packets=1)
    beyond = encode_frame(encode_packet(Packet(0x10, b"\7" * 57, node=3)))
    assert decoder.feed(beyond[: cut + 1]) + decoder.feed(beyond[cut + 1 :]) == []
    assert decoder.counters == LinkCounters(packets=1, oversized=1)


def test_both_forms_of_a_packet_that_ends_with_254_bytes_other_than_0_are_taken() -> None:
    """One of the packets is as long as the limit."""
    candidates = (Packet(0x10, bytes([k]) * 246, 0x40, 1, 1) for k in range(1, 256))
    packet = next(p for p in candidates if 0 not in encode_packet(p))
    shorter = encode_frame(encode_packet(packet))
    assert len(shorter) == 254 + 1 + 1
    for form in (shorter, shorter[:-1] + b"\1\0"):
        assert SerialDecoder(254).feed(form) == [packet]


@drawn(st.lists(PACKET, max_size=4), st.data())
def test_any_cut_of_a_stream_gives_the_same_packets(
    sent: list[Packet], data: st.DataObject
) -> None:
    """Packets and counts are the same whatever stray zeros and rubbish lie between them."""
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
    """The slow COBS decodes frame by frame; nothing raises, everything is counted once."""
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
    """All of up to four at once arrive whole, in any order that keeps each one's own."""
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


@drawn(st.lists(PACKET, max_size=16))
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


def test_so_many_packets_wait_for_a_host_that_reads_no_transfer() -> None:
    raw = I2cTarget()
    assert all(raw.put(b"") for _ in range(16)), "four at least (SPEC.md, 3.3)"
    assert not raw.put(b"")
