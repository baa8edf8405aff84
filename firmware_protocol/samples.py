"""Samples on the wire: PCM16, PCM12 and BFP8 (section 9 of SPEC.md).

Codes are int16 arrays (S, C), a row per position; ±32767 is full scale.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import FULL_SCALE_CODE, SampleFormat

Codes = NDArray[np.int16]

BLOCK = 32
"""Samples that share an exponent."""
LARGEST_EXPONENT = 8
REACH = 255 << np.arange(LARGEST_EXPONENT + 1)
"""Twice the magnitude that an exponent reaches without leaving ±127 by rounding."""
HALF = np.array([(1 << exponent) >> 1 for exponent in range(LARGEST_EXPONENT + 1)], np.int16)
UNROUNDED = np.int16(FULL_SCALE_CODE - HALF[-1])
"""Largest code that does not leave 16 bits by rounding; those beyond it are 127 as it is."""


def size(sample_format: int, samples: int, channels: int) -> int:
    """Return the bytes that samples take, -1 for a format that is none."""
    count = samples * channels
    if sample_format == SampleFormat.PCM16:
        return 2 * count
    if sample_format == SampleFormat.PCM12:
        return (3 * count + 1) // 2
    if sample_format == SampleFormat.BFP8:
        return channels * (samples - samples // -BLOCK)
    return -1


def encode(sample_format: int, codes: Codes) -> bytes:
    """Return codes (S, C) as bytes."""
    if sample_format == SampleFormat.PCM12:
        return encode_pcm12(codes)
    return encode_bfp8(codes) if sample_format == SampleFormat.BFP8 else encode_pcm16(codes)


def decode(sample_format: int, data: bytes, samples: int, channels: int) -> Codes:
    """Return the codes (S, C) of bytes of the right `size`."""
    if sample_format == SampleFormat.PCM12:
        return decode_pcm12(data, samples, channels)
    if sample_format == SampleFormat.BFP8:
        return decode_bfp8(data, samples, channels)
    codes = np.maximum(np.frombuffer(data, "<i2"), -FULL_SCALE_CODE)
    return np.asarray(codes, np.int16).reshape(samples, channels)


def encode_pcm16(codes: Codes) -> bytes:
    """Return codes as they are."""
    return np.ascontiguousarray(codes, "<i2").tobytes()


def encode_pcm12(codes: Codes) -> bytes:
    """Return codes / 16, rounded, two in three bytes."""
    short = ((codes.ravel() >> 3) + np.int16(1)) >> 1
    np.maximum(short, -2047, out=short)
    np.minimum(short, 2047, out=short)
    if len(short) % 2:
        short = np.append(short, np.int16(0))
    first, second = short[0::2], short[1::2]
    data = np.empty((len(first), 3), np.uint8)
    data[:, 0] = first
    data[:, 1] = (first >> 8 & 0x0F) | second << 4
    data[:, 2] = second >> 4
    return data.tobytes()[: size(SampleFormat.PCM12, *codes.shape)]


def decode_pcm12(data: bytes, samples: int, channels: int) -> Codes:
    """Return 16 times what `encode_pcm12` packed."""
    count = samples * channels
    padded = data.ljust((count + 1) // 2 * 3, b"\0")
    raw = np.frombuffer(padded, np.uint8).reshape(-1, 3).astype(np.int16)
    codes = np.empty((len(raw), 2), np.int16)
    codes[:, 0] = raw[:, 1] << 12 | raw[:, 0] << 4
    codes[:, 1] = raw[:, 2] << 8 | (raw[:, 1] & 0xF0)
    return np.maximum(codes.ravel()[:count], -2047 * 16).reshape(samples, channels)


def encode_bfp8(codes: Codes) -> bytes:
    """Return codes as mantissas of 8 bits, an exponent for each 32 of a channel."""
    samples, channels = codes.shape
    blocks, width = -(samples // -BLOCK), min(max(samples, 1), BLOCK)
    rows = np.zeros((blocks * width, channels), np.int16)
    np.minimum(codes, UNROUNDED, out=rows[:samples])
    rows = rows.reshape(blocks, width, channels)
    high = np.maximum.reduce(rows, axis=1).astype(np.int32)
    low = np.minimum.reduce(rows, axis=1).astype(np.int32)
    exponent = REACH.searchsorted(np.maximum(2 * high + 1, -2 * low)).astype(np.int16)
    np.minimum(exponent, LARGEST_EXPONENT, out=exponent)
    rows += HALF[exponent][:, None]
    rows >>= exponent[:, None]
    out = np.empty((channels, blocks, width + 1), np.int8)
    out[..., 0] = exponent.T
    out[..., 1:] = np.maximum(rows, -127, out=rows).transpose(2, 0, 1)
    return out.reshape(channels, -1)[:, : samples + blocks].tobytes()


def decode_bfp8(data: bytes, samples: int, channels: int) -> Codes:
    """Return mantissas shifted by their exponents."""
    blocks = -(samples // -BLOCK)
    padded = np.zeros((channels, blocks * (BLOCK + 1)), np.int8)
    padded[:, : samples + blocks] = np.frombuffer(data, np.int8).reshape(channels, -1)
    raw = padded.reshape(channels, blocks, BLOCK + 1)
    exponent = np.minimum(raw[..., :1].view(np.uint8), LARGEST_EXPONENT)
    codes = raw[..., 1:].astype(np.int32) << exponent
    np.clip(codes, -FULL_SCALE_CODE, FULL_SCALE_CODE, out=codes)
    return codes.reshape(channels, -1)[:, :samples].T.astype(np.int16)
