"""Coding of samples on the wire: PCM16, PCM12 and BFP8 (section 9 of SPEC.md).

Sample codes are int16 arrays (S, C) with one row per position; ±32767 is full scale.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import FULL_SCALE_CODE, SampleFormat

Codes = NDArray[np.int16]
"""Array of sample codes."""

BLOCK = 32
"""Number of samples that share an exponent."""
LARGEST_EXPONENT = 8
"""Largest exponent of a BFP8 block."""
REACH = 255 << np.arange(LARGEST_EXPONENT + 1)
"""Twice the largest magnitude whose mantissa stays within ±127 after rounding, by exponent."""
HALF = np.array([(1 << exponent) >> 1 for exponent in range(LARGEST_EXPONENT + 1)], np.int16)
"""Half of the rounding step, by exponent."""
UNROUNDED = np.int16(FULL_SCALE_CODE - HALF[-1])
"""Largest code to which the rounding offset can be added within 16 bits; the mantissa of any
larger code is 127 in any case."""


def size(sample_format: int, samples: int, channels: int) -> int:
    """Compute the length of coded samples.

    Parameters
    ----------
    sample_format : int
        Sample format.
    samples : int
        Number of samples per channel.
    channels : int
        Number of channels.

    Returns
    -------
    int
        Length [bytes]; −1 for an unknown format.
    """
    count = samples * channels
    if sample_format == SampleFormat.PCM16:
        return 2 * count
    if sample_format == SampleFormat.PCM12:
        return (3 * count + 1) // 2
    if sample_format == SampleFormat.BFP8:
        return channels * (samples - samples // -BLOCK)
    return -1


def encode(sample_format: int, codes: Codes) -> bytes:
    """Encode sample codes.

    Parameters
    ----------
    sample_format : int
        Sample format: PCM12, BFP8, or else PCM16.
    codes : (S, C) array of int
        Sample codes.

    Returns
    -------
    bytes
        Coded samples.
    """
    if sample_format == SampleFormat.PCM12:
        return encode_pcm12(codes)
    return encode_bfp8(codes) if sample_format == SampleFormat.BFP8 else encode_pcm16(codes)


def decode(sample_format: int, data: bytes, samples: int, channels: int) -> Codes:
    """Decode samples.

    Parameters
    ----------
    sample_format : int
        Sample format: PCM12, BFP8, or else PCM16.
    data : bytes
        Coded samples, of the length that `size` gives.
    samples : int
        Number of samples per channel.
    channels : int
        Number of channels.

    Returns
    -------
    (S, C) array of int
        Sample codes.
    """
    if sample_format == SampleFormat.PCM12:
        return decode_pcm12(data, samples, channels)
    if sample_format == SampleFormat.BFP8:
        return decode_bfp8(data, samples, channels)
    codes = np.maximum(np.frombuffer(data, "<i2"), -FULL_SCALE_CODE)
    return np.asarray(codes, np.int16).reshape(samples, channels)


def encode_pcm16(codes: Codes) -> bytes:
    """Encode sample codes as 16-bit integers.

    Parameters
    ----------
    codes : (S, C) array of int
        Sample codes.

    Returns
    -------
    bytes
        Coded samples.
    """
    return np.ascontiguousarray(codes, "<i2").tobytes()


def encode_pcm12(codes: Codes) -> bytes:
    """Encode sample codes divided by 16 and rounded, two in three bytes.

    Parameters
    ----------
    codes : (S, C) array of int
        Sample codes.

    Returns
    -------
    bytes
        Coded samples.
    """
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
    """Decode samples that `encode_pcm12` encoded.

    Parameters
    ----------
    data : bytes
        Coded samples.
    samples : int
        Number of samples per channel.
    channels : int
        Number of channels.

    Returns
    -------
    (S, C) array of int
        Sample codes, multiples of 16.
    """
    count = samples * channels
    padded = data.ljust((count + 1) // 2 * 3, b"\0")
    raw = np.frombuffer(padded, np.uint8).reshape(-1, 3).astype(np.int16)
    codes = np.empty((len(raw), 2), np.int16)
    codes[:, 0] = raw[:, 1] << 12 | raw[:, 0] << 4
    codes[:, 1] = raw[:, 2] << 8 | (raw[:, 1] & 0xF0)
    return np.maximum(codes.ravel()[:count], -2047 * 16).reshape(samples, channels)


def encode_bfp8(codes: Codes) -> bytes:
    """Encode sample codes as 8-bit mantissas with an exponent for each 32 samples of a channel.

    Parameters
    ----------
    codes : (S, C) array of int
        Sample codes.

    Returns
    -------
    bytes
        Coded samples.
    """
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
    """Decode samples that `encode_bfp8` encoded.

    Parameters
    ----------
    data : bytes
        Coded samples.
    samples : int
        Number of samples per channel.
    channels : int
        Number of channels.

    Returns
    -------
    (S, C) array of int
        Sample codes.
    """
    blocks = -(samples // -BLOCK)
    padded = np.zeros((channels, blocks * (BLOCK + 1)), np.int8)
    padded[:, : samples + blocks] = np.frombuffer(data, np.int8).reshape(channels, -1)
    raw = padded.reshape(channels, blocks, BLOCK + 1)
    exponent = np.minimum(raw[..., :1].view(np.uint8), LARGEST_EXPONENT)
    codes = raw[..., 1:].astype(np.int32) << exponent
    np.clip(codes, -FULL_SCALE_CODE, FULL_SCALE_CODE, out=codes)
    return codes.reshape(channels, -1)[:, :samples].T.astype(np.int16)
