"""The codec of packets, samples and messages against slow implementations of its own rules.

Whatever is drawn at random is drawn by hypothesis.
"""

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from slow_codec import (
    BODY,
    FORMATS,
    PACKET,
    SCHEMA,
    Codes,
    drawn,
    slow_bfp8,
    slow_crc,
    slow_packet,
    slow_pcm12,
    slow_unbfp8,
    slow_unpcm12,
)

from firmware_protocol import generate, samples
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.host import codes_of, pcm
from firmware_protocol.messages import MESSAGES, Message, SampleFormat
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet

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


# Samples

CODE = st.integers(-32767, 32767) | st.sampled_from([-32767, -32760, -24, -8, 8, 24, 32759, 32767])


@st.composite
def code_arrays(draw: st.DrawFn) -> Codes:
    """Draw sample codes (S, C), loud and quiet ones."""
    shape = draw(st.integers(1, 70)), draw(st.integers(1, 5))
    loudness = draw(st.sampled_from([1, 100, 127, 128, 255, 4000, 32640, 32767]))
    seed = draw(st.integers(0, 2**32 - 1))
    codes = np.random.default_rng(seed).integers(-loudness, loudness + 1, shape).astype(np.int16)
    for _ in range(draw(st.integers(0, 3))):
        codes[draw(st.integers(0, shape[0] - 1)), 0] = draw(CODE)
    return codes


def test_every_code_is_packed_as_python_integers_say() -> None:
    """All 65535 codes are packed as PCM12, alone and in pairs."""
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
    """A body is the exception: it ends where the payload does."""
    rng = random.Random(1)
    for size in range(20):
        message = any_message(described, rng)
        kind, payload = type(message), message.pack()
        assert kind.unpack(payload) == message
        if kind not in BODIES:
            assert kind.unpack(payload + rng.randbytes(size)) == message


@each_message
def test_a_missing_tail_reads_as_0_and_a_missing_head_is_none(described: dict[str, Any]) -> None:
    """The missing bytes of a field that is cut are 0, wherever it is cut."""
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
    ReferenceAmplifier(AmplifierConfig(slew_limit_v_per_s=5006, rate_min_hz=8000, rate_max_hz=8000))
    with pytest.raises(ValueError, match=r"^slew_limit_v_per_s 5005, which must be 5006 … "):
        ReferenceAmplifier(
            AmplifierConfig(slew_limit_v_per_s=5005, rate_min_hz=8000, rate_max_hz=8000)
        )
