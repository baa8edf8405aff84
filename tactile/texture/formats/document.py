"""The effect document: haptic effects over time, what every other format is read into.

It has the layers of MPEG-I Haptics (ISO/IEC 23090-31), whose files it keeps whole: an effect has
perceptions, these have channels (one signal each), these have bands, which add up, and a band has
segments: keyframes from one time on. What a keyframe's amplitude and frequency mean is the kind of
its band:

- ``wave``: amplitude and frequency of an oscillation, its phase running on;
- ``curve``: the signal itself; ``samples``: too, at an even rate;
- ``transient``: a tap of 22 ms at each keyframe;
- ``wavelet``: as the .hjif file has it, kept and not decoded;
- ``control``: what all else in the channel is multiplied by (amplitude) and shifted by (frequency);
  held between and after its segments. MPEG has none; Apple's parameter curves are this.

An amplitude of 1 is what the device can do. ``other`` holds fields of the format that the document
came from (``origin``) which mean nothing here, and which only that format is given back. As a file
it is TOML with the table ``[effect]``, and a texture's is one with ``[texture]``.
"""

import itertools
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

LOWEST, HIGHEST = 65.0, 300.0
"""Hz of a sharpness (AHAP) or frequency (.haptic) of 0 and 1: MPEG's reference encoder for AHAP."""
MOST_KEYFRAMES = 200_000
"""Of a document."""

Seconds = Annotated[float, Meta(ge=0, le=3600)]
Amplitude = Annotated[float, Meta(ge=-1, le=1)]
Hertz = Annotated[float, Meta(ge=-24_000, le=24_000)]
Whole = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Gain = Annotated[float, Meta(ge=-1000, le=1000)]

Kind = Literal["wave", "curve", "samples", "transient", "wavelet", "control"]
CurveType = Literal["Unknown", "Cubic", "Linear", "Akima", "Bezier", "Bspline"]
BaseSignal = Literal["Sine", "Square", "Triangle", "SawToothUp", "SawToothDown"]
EffectType = Literal["Basis", "Reference", "Composite"]
DeviceType = Literal["LRA", "VCA", "ERM", "Piezo", "Unknown"]


class FileTable(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """A table of the file."""


class Keyframe(FileTable, frozen=True, kw_only=True):
    """Values at a time after the beginning of its segment; straight between keyframes."""

    time_s: Seconds
    amplitude: Amplitude | None = None
    frequency_hz: Hertz | None = None


class KeyframeSegment(FileTable, frozen=True, kw_only=True):
    """Keyframes from a time on.

    A "Reference" plays the segment of the perception's library that has its ``id``. ``samples`` are
    float32, little-endian, in a file as base64.
    """

    start_s: Seconds = 0.0
    type: EffectType = "Basis"
    id: int | None = None
    phase_rad: Annotated[float, Meta(ge=-1e3, le=1e3)] | None = None
    base_signal: BaseSignal | None = None
    keywords: str | None = None
    keyframes: tuple[Keyframe, ...] = ()
    samples: bytes = b""
    other: dict[str, Any] = {}

    def __post_init__(self) -> None:
        times = [keyframe.time_s for keyframe in self.keyframes]
        for i, (before, after) in enumerate(itertools.pairwise(times)):
            if after < before:
                raise ValueError(
                    f"keyframes[{i + 1}] at {after:g} s comes after {before:g} s: must ascend"
                )
        if len(self.samples) % 4:
            raise ValueError(f"samples has {len(self.samples)} bytes: must be 4 for each")


class Band(FileTable, frozen=True, kw_only=True):
    """Segments of one kind; where they overlap they add up."""

    kind: Kind
    curve_type: CurveType | None = None
    lower_frequency_hz: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    upper_frequency_hz: Annotated[float, Meta(ge=0, le=1e6)] = 1000.0
    sample_rate_hz: Annotated[float, Meta(ge=1, le=400_000)] | None = None
    segments: tuple[KeyframeSegment, ...] = ()
    other: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if self.kind == "samples" and self.sample_rate_hz is None:
            raise ValueError("a band of samples needs sample_rate_hz")


class EffectChannel(FileTable, frozen=True, kw_only=True):
    """One signal, scaled by ``gain``.

    Who plays several on one actuator weighs them by ``mixing_coefficient``.
    """

    id: int = 0
    description: str = ""
    gain: Gain = 1.0
    mixing_coefficient: Gain = 1.0
    body_part_mask: Whole = 0
    reference_device_id: int | None = None
    bands: tuple[Band, ...] = ()
    other: dict[str, Any] = {}


class ReferenceDevice(FileTable, frozen=True, kw_only=True):
    """What the effect was made for."""

    id: int
    name: str
    type: DeviceType = "Unknown"
    minimum_frequency_hz: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    maximum_frequency_hz: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    resonance_frequency_hz: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    maximum_voltage_v: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    maximum_displacement_mm: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    other: dict[str, Any] = {}


class Perception(FileTable, frozen=True, kw_only=True):
    """Channels that make up one impression, such as "Vibrotactile Texture"."""

    id: int = 0
    avatar_id: int = 0
    description: str = ""
    modality: str = "Vibrotactile"
    reference_devices: tuple[ReferenceDevice, ...] = ()
    library: tuple[KeyframeSegment, ...] = ()
    channels: tuple[EffectChannel, ...] = ()
    other: dict[str, Any] = {}


class Effect(FileTable, frozen=True, kw_only=True):
    """Haptic effects over time."""

    description: str = ""
    origin: Literal["hjif", "haptic", "ahap", "wav", "texture", "tactile"] = "tactile"
    ticks_per_s: Annotated[int, Meta(ge=1, le=48_000)] = 1000
    perceptions: tuple[Perception, ...] = ()
    other: dict[str, Any] = {}

    def __post_init__(self) -> None:
        count = sum(
            len(segment.keyframes)
            for perception in self.perceptions
            for segment in [*perception.library, *segments_of(perception)]
        )
        if count > MOST_KEYFRAMES:
            raise ValueError(f"has {count} keyframes: {MOST_KEYFRAMES} at most")


class EffectFile(FileTable, frozen=True, kw_only=True):
    """The file: one table."""

    effect: Effect


def segments_of(perception: Perception) -> list[KeyframeSegment]:
    """Return the segments of all bands of all channels."""
    bands = [band for channel in perception.channels for band in channel.bands]
    return [segment for band in bands for segment in band.segments]


def channels_of(effect: Effect) -> list[tuple[Perception, EffectChannel]]:
    """Return all channels in order, each with its perception."""
    return [(perception, channel) for perception in effect.perceptions
            for channel in perception.channels]  # fmt: skip


def single(effect_bands: tuple[Band, ...], **fields: Any) -> Effect:
    """Return an effect of one perception with one channel."""
    return Effect(
        perceptions=(Perception(channels=(EffectChannel(bands=effect_bands),)),), **fields
    )


def hertz(sharpness: float) -> float:
    """Return the frequency [Hz] of a sharpness 0 … 1."""
    return LOWEST + (HIGHEST - LOWEST) * sharpness


def sharpness_of(frequency: float) -> float:
    """Return the sharpness of a frequency [Hz]; below 0 or above 1 outside 65 … 300 Hz."""
    return (frequency - LOWEST) / (HIGHEST - LOWEST)
