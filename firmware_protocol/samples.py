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
    flat = codes.ravel()
    short = (flat >> 4) + (flat >> 3 & 1)
    np.clip(short, -2047, 2047, out=short)
    pairs = np.zeros(len(short) + len(short) % 2, np.int32)
    pairs[: len(short)] = short
    words = (pairs[0::2] & 0xFFF) | pairs[1::2] << 12
    data = words.astype("<i4", copy=False).view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    return data[: (3 * len(short) + 1) // 2]


def decode_pcm12(data: bytes, samples: int, channels: int) -> Codes:
    """Return 16 times what `encode_pcm12` packed."""
    count = samples * channels
    words = np.zeros((count + 1) // 2, "<i4")
    raw = np.frombuffer(data.ljust(3 * len(words), b"\0"), np.uint8)
    words.view(np.uint8).reshape(-1, 4)[:, :3] = raw.reshape(-1, 3)
    codes = np.empty(2 * len(words), np.int16)
    codes[0::2] = words << 4 & 0xFFFF
    codes[1::2] = words >> 8 & 0xFFF0
    codes = np.maximum(codes[:count], -2047 * 16)
    return codes.reshape(samples, channels)


def encode_bfp8(codes: Codes) -> bytes:
    """Return codes as mantissas of 8 bits, an exponent for each 32 of a channel."""
    samples, channels = codes.shape
    blocks = -(samples // -BLOCK)
    padded = np.zeros((channels, blocks * BLOCK), np.int32)
    padded[:, :samples] = codes.T
    padded = padded.reshape(channels, blocks, BLOCK)
    need = np.maximum(2 * padded.max(axis=2) + 1, -2 * padded.min(axis=2))
    exponent = np.minimum(np.searchsorted(REACH, need), LARGEST_EXPONENT)
    half = (1 << exponent) >> 1
    mantissa = (padded + half[..., None]) >> exponent[..., None]
    out = np.empty((channels, blocks, BLOCK + 1), np.int8)
    out[..., 0] = exponent
    out[..., 1:] = np.clip(mantissa, -127, 127)
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
