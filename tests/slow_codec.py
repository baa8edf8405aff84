"""Slow codec, written from SPEC.md, with which the fast ones are compared.

Bitwise (CRC-32), byte by byte (COBS, fragments) or in Python's integers (sample formats).
"""

from collections.abc import Callable, Iterator
from fractions import Fraction
from math import floor
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_protocol import generate
from firmware_protocol.messages import SampleFormat
from firmware_protocol.packet import Packet

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
    relaxed = settings(max_examples=examples)
    return lambda test: relaxed(draw(test))


# The slow codec


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
    """Divide a packet by section 3.2: the first carries the length, and two bytes less."""
    rest = len(packet).to_bytes(2, "little") + packet
    pieces = [rest[k : k + size - 1] for k in range(0, len(rest), size - 1)]
    heads = [transfer + 0x20 * (k % 2) for k in range(len(pieces))]
    heads[0] += 0x80
    heads[-1] += 0x40
    return [bytes([head]) + piece for head, piece in zip(heads, pieces, strict=True)]


def rounded(value: Fraction) -> int:
    """Round to the nearest integer, halves up (section 9)."""
    return floor(value + Fraction(1, 2))


def clamp(value: int, limit: int) -> int:
    return max(-limit, min(limit, value))


def slow_pcm12(codes: list[int]) -> bytes:
    """Encode PCM12 nibble by nibble, low one first."""
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
