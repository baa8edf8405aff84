"""The codec in C and the one in Python give the same bytes for the same input, drawn at random.

`c/test/codec_pipe.c` is the C side: it decodes and encodes again what comes on stdin.
"""

import os
import random
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import firmware_protocol
from firmware_protocol import generate, samples
from firmware_protocol.fragments import Cutter, Reassembler
from firmware_protocol.messages import MESSAGES, SampleFormat
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame

C = Path(firmware_protocol.__file__).parent / "c"
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SCHEMA = {d["id"]: d for d in generate.load()["message"]}
FORMATS = (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)
NONE = 0xFFFFFFFF

Record = tuple[str, bytes]
Pipe = Callable[[Iterable[Record]], list[bytes | None]]


@pytest.fixture(scope="module")
def pipe(tmp_path_factory: pytest.TempPathFactory) -> Pipe:
    """Build codec_pipe, with sanitizers where the compiler has them."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        assert os.environ.get("CI") != "true", "CI has no C compiler"
        pytest.skip("no C compiler")
    program = tmp_path_factory.mktemp("agreement") / "codec_pipe"
    sources = [
        C / "test/codec_pipe.c",
        *(C / f"tactile_{n}.c" for n in ("packet", "fragment", "samples", "encode")),
    ]
    for options in (SANITIZED, ()):
        command = [compiler, "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", *options]
        built = subprocess.run(
            [*command, "-o", program, *sources], capture_output=True, check=False
        )
        if built.returncode == 0:
            break
    assert built.returncode == 0, built.stderr.decode()

    def ask(records: Iterable[Record]) -> list[bytes | None]:
        asked = b"".join(w.encode() + struct.pack("<I", len(d)) + d for w, d in records)
        done = subprocess.run([program], input=asked, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr.decode()
        found: list[bytes | None] = []
        at = 0
        while at < len(done.stdout):
            (size,) = struct.unpack_from("<I", done.stdout, at)
            at += 4
            found.append(None if size == NONE else done.stdout[at : at + size])
            at += 0 if size == NONE else size
        return found

    return ask


def number(rng: random.Random, bits: int) -> int:
    """Return a number, often one at an end."""
    return rng.choice((0, 1, (1 << bits) - 1, 1 << (bits - 1), rng.getrandbits(bits)))


def random_packet(rng: random.Random) -> bytes:
    """Return a packet of any message: whole, cut short, with a tail, or spoilt."""
    kind = rng.choice(list(MESSAGES))
    described = SCHEMA[kind]
    values: list[Any] = [
        rng.randbytes(16) if type_ == "char16" else number(rng, int(type_[1:]))
        for _, type_ in described["fields"]
    ]
    if "body" in described:
        values.append(rng.randbytes(rng.choice((0, 1, 7, 300))))
    payload = MESSAGES[kind](*values).pack()
    how = rng.random()
    if how < 0.2:
        payload = payload[: rng.randrange(len(payload) + 1)]
    elif how < 0.3:
        payload += rng.randbytes(rng.randrange(1, 9))
    kind = rng.randrange(256) if rng.random() < 0.02 else kind
    data = bytearray(encode_packet(Packet(kind, payload, *rng.randbytes(3))))
    if rng.random() < 0.02:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def again(data: bytes) -> bytes | None:
    """Return what codec_pipe should answer: the packet of the message of a packet."""
    packet = decode_packet(data)
    if packet is None or packet.type not in MESSAGES:
        return None
    message = MESSAGES[packet.type].unpack(packet.payload)
    if message is None:
        return None
    return encode_packet(Packet(packet.type, message.pack(), packet.flags, packet.node, packet.seq))


@pytest.mark.parametrize("count", [10_000, pytest.param(100_000, marks=pytest.mark.ci)])
def test_random_messages_are_read_and_written_alike(pipe: Pipe, count: int) -> None:
    rng = random.Random(count)
    packets = [random_packet(rng) for _ in range(count)]
    expected = [again(data) for data in packets]
    assert pipe(("P", data) for data in packets) == expected
    written = [data for data in expected if data is not None]
    assert {data[0] for data in written} == set(MESSAGES)
    assert count / 2 < len(written) < count


def test_random_bytes_are_coded_and_cut_alike(pipe: Pipe) -> None:
    rng = random.Random(2)
    records: list[Record] = []
    expected: list[bytes] = []
    for _ in range(2000):
        size = rng.choice((1, 8, 61, 254, 255, 300, 4096))
        data = rng.choice(
            (rng.randbytes(size), bytes(rng.choices(b"\0\1\xff", k=size)), b"\7" * size)
        )
        records.append(("C", data))
        expected.append(encode_frame(data)[:-1])
        room, transfer = rng.choice((8, 32, 64)), rng.randrange(32)
        cutter = Cutter(room)
        for _ in range(transfer):
            next(cutter.fragments(0, b""))
        records.append(("F", bytes([room, transfer]) + data))
        fragments = cutter.fragments(0, data)
        expected.append(b"".join(bytes([len(f)]) + f for f in fragments))
    assert pipe(records) == expected


def listed(packets: list[Packet], *counts: int) -> bytes:
    """Return packets, each after its size, and counters, as codec_pipe does."""
    coded = map(encode_packet, packets)
    return b"".join(struct.pack("<H", len(p)) + p for p in coded) + struct.pack(
        f"<{len(counts)}I", *counts
    )


def test_harmed_streams_give_the_same_packets_and_counts(pipe: Pipe) -> None:
    rng = random.Random(3)
    records: list[Record] = []
    expected: list[bytes] = []
    for _ in range(500):
        limit = rng.choice((64, 300, 4096))
        stream = bytearray()
        for _ in range(rng.randrange(1, 8)):
            packet = rng.choice((random_packet(rng), bytes(rng.randrange(20))))
            stream += encode_frame(packet) if rng.random() < 0.9 else rng.randbytes(20) + b"\0"
        for _ in range(rng.randrange(4)):
            at = rng.randrange(len(stream))
            stream[at : at + rng.randrange(2)] = rng.randbytes(rng.randrange(3))
        stream += b"\0"
        decoder = SerialDecoder(limit)
        found = decoder.feed(bytes(stream))
        records.append(("S", struct.pack("<H", limit) + stream))
        expected.append(listed(found, decoder.counters.malformed, decoder.counters.oversized))
    assert pipe(records) == expected


def harmed_fragments(rng: random.Random, size: int) -> list[tuple[int, int, bytes]]:
    """Return (identifier, µs, fragment) of interleaved transfers, some lost, repeated, spoilt."""
    cutter, waiting = Cutter(size), []
    for _ in range(rng.randrange(1, 7)):
        identifier = rng.choice((0x302, 0x402, 0x304))
        packet = rng.choice((random_packet(rng), rng.randbytes(rng.randrange(30))))
        waiting.append([(identifier, f) for f in cutter.fragments(identifier, packet)])
    found, now = [], 0
    while waiting := [fragments for fragments in waiting if fragments]:
        identifier, fragment = rng.choice(waiting).pop(0)
        now += rng.choice((0, 10, 100, 5000) if rng.random() < 0.1 else (10,))
        how = rng.random()
        if how < 0.03:
            continue
        if how < 0.06:
            at = rng.randrange(len(fragment))
            fragment = fragment[:at] + rng.randbytes(1) + fragment[at + 1 :]
        elif how < 0.09:
            fragment = (fragment + bytes(8))[: rng.randrange(size + 1)]
        found += [(identifier, now, fragment)] * (2 if how > 0.97 else 1)
    return found


def test_harmed_transfers_give_the_same_packets_and_counts(pipe: Pipe) -> None:
    rng = random.Random(4)
    records: list[Record] = []
    expected: list[bytes] = []
    for _ in range(2000):
        limit, counters = rng.choice((64, 300, 4096)), LinkCounters()
        reassembler, found = Reassembler(limit, counters), []
        record = struct.pack("<H", limit)
        for identifier, now, fragment in harmed_fragments(rng, rng.choice((8, 64))):
            record += struct.pack("<HIB", identifier, now, len(fragment)) + fragment
            packet = reassembler.feed(identifier, fragment, now, padded=len(fragment) > 8)
            found += [] if packet is None else [packet]
        records.append(("R", record))
        expected.append(listed(found, counters.fragments_dropped))
    assert pipe(records) == expected


def test_sample_formats_are_read_and_written_alike(pipe: Pipe) -> None:
    """Codes are loud, quiet and clamped; some bytes are such as no encoder makes."""
    rng = np.random.default_rng(5)
    records: list[Record] = []
    expected: list[bytes] = []
    for case in range(600):
        kind, count, channels = (
            FORMATS[case % 3],
            int(rng.integers(1, 256)),
            int(rng.integers(1, 9)),
        )
        head = bytes([kind, channels, count])
        loudness = int(rng.choice([1, 127, 128, 255, 5000, 32767]))
        codes = rng.integers(-loudness, loudness + 1, (count, channels)).astype(np.int16)
        codes[int(rng.integers(count)), 0] = rng.choice([-32767, 32767, 32640, -24, 8])
        records.append(("E", head + codes.astype("<i2").tobytes()))
        expected.append(samples.encode(kind, codes))
        data = rng.bytes(samples.size(kind, count, channels))
        records.append(("D", head + data))
        decoded = samples.decode(kind, data, count, channels)
        expected.append(decoded.astype("<i2").tobytes())
    assert pipe(records) == expected
