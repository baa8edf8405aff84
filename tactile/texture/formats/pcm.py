"""Samples: WAV files of any number of channels, and the buffers of XR_FB_haptic_pcm of OpenXR.

WAV is read as int16, int24, int32, uint8, float32 or float64 and written as float32. A float file
that exceeds ± 1 keeps its waveform, and the gain of the channel carries the excess. OpenXR plays
float32 of one channel in buffers of 4000 samples (XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB), the first with
``append`` false and the others with true. The JSON form is our own; its names are those of the
specification.
"""

import io
import struct
import warnings
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.formats import reading
from tactile.texture.formats.document import (
    Band,
    Effect,
    EffectChannel,
    KeyframeSegment,
    Perception,
    channels_of,
    segments_of,
)
from tactile.texture.formats.synthesis import synthesize, unplayed

LARGEST_WAV = 64 * 1024 * 1024
"""Largest size of a file [bytes]. A minute of 24 channels at 8 kHz takes 44 MiB."""
MOST_CHANNELS = 1024
"""Largest number of channels."""
BUFFER = 4000
"""Largest number of samples of a buffer, XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB."""
RATE = 8000.0
"""Sample rate of effects without samples, which is that of the displays [Hz]."""
BROKEN = (ValueError, TypeError, KeyError, IndexError, EOFError, ZeroDivisionError, OverflowError,
          AttributeError, UnboundLocalError, MemoryError, struct.error)  # fmt: skip
"""Errors that the reader of scipy raises for an invalid file."""


def read_wav(path: Path) -> tuple[float, Floats]:
    """Read the samples of a WAV file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    rate : float
        Sample rate [Hz].
    samples : (S, C) array of float
        Samples of each channel, relative to full scale.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is not a WAV file, is truncated, or holds a value that is not finite.
    """
    data = reading.contents(path, LARGEST_WAV)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            rate, samples = wavfile.read(io.BytesIO(data))
        except BROKEN as error:
            raise InputError(
                reading.one_line(f"{path}: not a readable WAV file: {error}")
            ) from error
    if not samples.size:
        raise InputError(f"{path}: has no samples")
    if any("EOF" in str(warning.message) for warning in caught):
        raise InputError(f"{path}: is truncated: its header announces more samples")
    if samples.dtype not in (np.uint8, np.int16, np.int32, np.float32, np.float64):
        raise InputError(f"{path}: samples are {samples.dtype}: must be 8 to 32 bits or float")
    samples = samples[:, None] if samples.ndim == 1 else samples
    if not 1 <= rate <= 400_000 or not 1 <= samples.shape[1] <= MOST_CHANNELS:
        raise InputError(
            f"{path}: {samples.shape[1]} channels at {rate} Hz: must be 1 … {MOST_CHANNELS} at "
            "1 … 400000 Hz"
        )
    if not np.all(np.isfinite(samples)):
        raise InputError(f"{path}: has samples that are not finite numbers")
    return float(rate), _full_scale(samples)


def _full_scale(samples: NDArray[np.generic]) -> Floats:
    """Return samples relative to full scale."""
    if samples.dtype == np.uint8:
        return np.asarray((samples.astype(np.float64) - 128) / 128)
    bits = 8 * samples.dtype.itemsize
    scale = 2.0 ** (bits - 1) if np.issubdtype(samples.dtype, np.integer) else 1.0
    return np.asarray(samples.astype(np.float64) / scale)


def load_wav(path: Path) -> tuple[Effect, list[str]]:
    """Read a WAV file as an effect with one channel of samples for each of its channels.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    effect : Effect
        The effect.
    lost : list of str
        A line if samples were rounded.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid, as in `read_wav`, or exceeds 1000 times full scale.
    """
    rate, samples = read_wav(path)
    peaks = np.maximum(np.abs(samples).max(axis=0, initial=0.0), 1.0)
    if np.any(peaks > 1000):
        raise InputError(f"{path}: goes to {peaks.max():g} of full scale: 1000 at most")
    single = (samples / peaks).astype("<f4")
    lost = []
    if not np.array_equal(single.astype(np.float64), samples / peaks):
        lost.append("samples are rounded to float32, 24 bits")
    channels = tuple(
        EffectChannel(id=i, gain=float(peaks[i]), bands=(Band(
            kind="samples", sample_rate_hz=rate, upper_frequency_hz=rate / 2,
            segments=(KeyframeSegment(samples=column.tobytes()),),
        ),))
        for i, column in enumerate(single.T)
    )  # fmt: skip
    return Effect(origin="wav", perceptions=(Perception(channels=channels),)), lost


def rate_of(effect: Effect) -> float:
    """Determine the sample rate that an effect is written with.

    Parameters
    ----------
    effect : Effect
        Effect to write.

    Returns
    -------
    float
        Highest rate of its samples up to 192 kHz, or 8000 without samples [Hz].
    """
    rates = {b.sample_rate_hz for _, c in channels_of(effect) for b in c.bands
             if b.kind in ("samples", "wavelet") and b.sample_rate_hz}  # fmt: skip
    return max([r for r in rates if r <= 192_000], default=RATE)


def saved_wav(effect: Effect) -> tuple[bytes, list[str]]:
    """Format an effect as a float32 WAV file.

    Parameters
    ----------
    effect : Effect
        Effect to write.

    Returns
    -------
    content : bytes
        Contents of the file.
    lost : list of str
        One line for each thing that the format cannot express.
    """
    rate, file = round(rate_of(effect)), io.BytesIO()
    lost = _flattened(effect, "WAV")
    wavfile.write(file, rate, synthesize(effect, rate).astype(np.float32))
    return file.getvalue(), lost


def saved_openxr(effect: Effect) -> tuple[bytes, list[str]]:
    """Format the first channel of an effect as buffers of OpenXR.

    Parameters
    ----------
    effect : Effect
        Effect to write.

    Returns
    -------
    content : bytes
        Contents of a JSON file.
    lost : list of str
        One line for each thing that the format cannot express.
    """
    rate, lost = rate_of(effect), _flattened(effect, "OpenXR")
    played = synthesize(effect, rate)
    if played.shape[1] > 1:
        lost.append(
            f"OpenXR plays one channel: {played.shape[1] - 1} of {played.shape[1]} left out"
        )
    x = played[:, 0] if played.shape[1] else np.zeros(0)
    if np.any(np.abs(x) > 1):
        lost.append("samples above 1 are limited to it")
    single = np.clip(x, -1, 1).astype(np.float32).astype(np.float64)
    buffers = [
        {"bufferSize": len(part), "append": i > 0, "buffer": part.tolist()}
        for i, part in ((i, single[i : i + BUFFER]) for i in range(0, len(single), BUFFER))
    ]
    content = {"extension": "XR_FB_haptic_pcm", "sampleRate": rate, "buffers": buffers}
    return msgspec.json.encode(content), lost


def _flattened(effect: Effect, name: str) -> list[str]:
    """Return what is lost if only samples are left of an effect."""
    lost = unplayed(effect)
    if any(b.kind != "samples" for _, c in channels_of(effect) for b in c.bands):
        lost.append(f"{name} has samples only: keyframes are rendered at {rate_of(effect):g} Hz")
    pitches = [k.frequency_hz or 0.0 for p in effect.perceptions
               for s in [*p.library, *segments_of(p)] for k in s.keyframes]  # fmt: skip
    if max(pitches, default=0.0) > rate_of(effect) / 2:
        lost.append(f"what is above {rate_of(effect) / 2:g} Hz is left out")
    return lost
