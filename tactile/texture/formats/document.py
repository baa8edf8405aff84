"""Effect document: haptic effects over time, into which every other format is read.

It has the layers of MPEG-I Haptics (ISO/IEC 23090-31), whose files it keeps completely. An effect
has perceptions, these have channels (one signal each), these have bands, which add up, and a band
has segments, which are keyframes from some time on. The kind of a band determines what the
amplitude and the frequency of a keyframe mean:

- ``wave``: amplitude and frequency of an oscillation with continuous phase;
- ``curve``: the signal itself; ``samples``: the signal itself, at an even rate;
- ``transient``: a tap of 22 ms at each keyframe;
- ``wavelet``: samples that were decoded from the blocks of a .hjif file, which stay in ``other``;
- ``control``: factor (amplitude) and shift (frequency) of everything else in the channel, held
  between and after its segments. MPEG has none; the parameter curves of Apple become this.

An amplitude of 1 is the maximum of the device. ``other`` holds fields of the format that the
document came from (``origin``) which have no meaning here and are written only to that format. As a
file, a document is TOML with the table ``[effect]``; a texture is one with ``[texture]``.
"""

import itertools
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from tactile.errors import InputError

LOWEST, HIGHEST = 65.0, 300.0
"""Frequencies that a sharpness (AHAP) or frequency (.haptic) of 0 and 1 stand for [Hz], from the
reference encoder of MPEG for AHAP."""
MOST_KEYFRAMES = 200_000
"""Largest number of keyframes of a document."""

Seconds = Annotated[float, Meta(ge=0, le=3600)]
"""Time, 0 to 3600 [s]."""
Amplitude = Annotated[float, Meta(ge=-1, le=1)]
"""Amplitude, −1 to 1, where 1 is the maximum of the device."""
Hertz = Annotated[float, Meta(ge=-24_000, le=24_000)]
"""Frequency, or shift of a frequency, −24000 to 24000 [Hz]."""
Whole = Annotated[int, Meta(ge=0, le=2**32 - 1)]
"""Unsigned integer of 32 bits."""
Gain = Annotated[float, Meta(ge=-1000, le=1000)]
"""Factor, −1000 to 1000."""

Kind = Literal["wave", "curve", "samples", "transient", "wavelet", "control"]
"""Kind of a band, as in the docstring of this module."""
CurveType = Literal["Unknown", "Cubic", "Linear", "Akima", "Bezier", "Bspline"]
"""Interpolation between the keyframes of a curve."""
BaseSignal = Literal["Sine", "Square", "Triangle", "SawToothUp", "SawToothDown"]
"""Waveform of an oscillation."""
EffectType = Literal["Basis", "Reference", "Composite"]
"""Type of a segment."""
DeviceType = Literal["LRA", "VCA", "ERM", "Piezo", "Unknown"]
"""Type of an actuator: linear resonant, voice coil, eccentric rotating mass, piezoelectric."""


class FileTable(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base class of the tables of an effect file, in which unknown keys are errors."""


class Keyframe(FileTable, frozen=True, kw_only=True):
    """Values at a time after the beginning of a segment, linear between keyframes.

    Attributes
    ----------
    time_s : float
        Time after the beginning of the segment, 0 to 3600 [s].
    amplitude : float or None
        Amplitude, −1 to 1, where 1 is the maximum of the device. None does not set it: the value is
        interpolated between the other keyframes, and is 1 if none sets it.
    frequency_hz : float or None
        Frequency, or its shift in a band of kind "control", −24000 to 24000 [Hz]. None does not set
        it: the value is interpolated between the other keyframes, and is 160 Hz (no shift in a band
        of kind "control") if none sets it.
    """

    time_s: Seconds
    amplitude: Amplitude | None = None
    frequency_hz: Hertz | None = None


class KeyframeSegment(FileTable, frozen=True, kw_only=True):
    """Keyframes from a time on, or samples.

    Attributes
    ----------
    start_s : float
        Beginning of the segment, 0 to 3600, default 0 [s].
    type : str
        "Basis" (the default) for a segment with its own keyframes, "Reference" for one that plays
        the segment of the library of the perception with the same ``id``, or "Composite", which is
        kept and not played.
    id : int or None
        Number of the segment in the library.
    phase_rad : float or None
        Phase of an oscillation at its beginning, −1000 to 1000 [rad]. None is 0.
    base_signal : str or None
        Waveform of an oscillation: "Sine", "Square", "Triangle", "SawToothUp" or "SawToothDown".
        None is "Sine".
    keywords : str or None
        Semantic keywords, such as "Texture/Wood".
    keyframes : tuple of Keyframe
        Keyframes in ascending order of time, default none.
    samples : bytes
        Samples of a band of kind "samples" or "wavelet": float32, little-endian, −1 to 1, as base64
        in a file, default none.
    other : dict
        Further fields of the original format.
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
        check_ascending("keyframes", "time_s", (keyframe.time_s for keyframe in self.keyframes))
        if len(self.samples) % 4:
            raise ValueError(f"samples has {len(self.samples)} bytes: must be 4 for each")


class Band(FileTable, frozen=True, kw_only=True):
    """Segments of one kind, which add up where they overlap.

    Attributes
    ----------
    kind : str
        "wave", "curve", "samples", "transient", "wavelet" or "control", which determines the
        meaning of keyframes.
    curve_type : str or None
        Interpolation of a band of kind "curve": "Cubic", "Linear", "Akima", "Bezier", "Bspline" or
        "Unknown". None is "Cubic".
    lower_frequency_hz : float
        Lower end of the frequency range, 0 to 1e6, default 0 [Hz].
    upper_frequency_hz : float
        Upper end of the frequency range, 0 to 1e6, default 1000 [Hz].
    sample_rate_hz : float or None
        Sample rate, 1 to 400000, required for a band of kind "samples" [Hz].
    segments : tuple of KeyframeSegment
        Segments, default none.
    other : dict
        Further fields of the original format.
    """

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
    """One signal, which is the sum of its bands times a gain.

    Attributes
    ----------
    id : int
        Number of the channel, default 0.
    description : str
        Description for people.
    gain : float
        Factor of the signal, −1000 to 1000, default 1.
    mixing_coefficient : float
        Weight with which several channels are mixed for one actuator, −1000 to 1000, default 1.
    body_part_mask : int
        Bits of the parts of the body, 0 to 2^32 − 1, default 0.
    reference_device_id : int or None
        Number of the device in the list of the perception.
    bands : tuple of Band
        Bands, default none.
    other : dict
        Further fields of the original format.
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
    """Actuator that an effect was made for.

    Attributes
    ----------
    id : int
        Number of the device.
    name : str
        Name of the device.
    type : str
        "LRA", "VCA", "ERM", "Piezo" or "Unknown" (the default).
    minimum_frequency_hz : float or None
        Lowest frequency, 0 to 1e6 [Hz].
    maximum_frequency_hz : float or None
        Highest frequency, 0 to 1e6 [Hz].
    resonance_frequency_hz : float or None
        Resonance frequency, 0 to 1e6 [Hz].
    maximum_voltage_v : float or None
        Highest voltage, 0 to 1e6 [V].
    maximum_displacement_mm : float or None
        Largest displacement, that of an amplitude of 1, 0 to 1e6 [mm].
    other : dict
        Further fields of the original format.
    """

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
    """Channels that make up one impression, such as "Vibrotactile Texture".

    Attributes
    ----------
    id : int
        Number of the perception, default 0.
    avatar_id : int
        Number of the avatar in ``other`` of the effect, default 0.
    description : str
        Description for people.
    modality : str
        Modality by its name in MPEG-I Haptics, default "Vibrotactile".
    reference_devices : tuple of ReferenceDevice
        Actuators that the channels were made for, default none.
    library : tuple of KeyframeSegment
        Segments that others refer to by their ``id``, default none.
    channels : tuple of EffectChannel
        Channels, default none.
    other : dict
        Further fields of the original format.
    """

    id: int = 0
    avatar_id: int = 0
    description: str = ""
    modality: str = "Vibrotactile"
    reference_devices: tuple[ReferenceDevice, ...] = ()
    library: tuple[KeyframeSegment, ...] = ()
    channels: tuple[EffectChannel, ...] = ()
    other: dict[str, Any] = {}


class Effect(FileTable, frozen=True, kw_only=True):
    """Table ``[effect]``: haptic effects over time.

    Attributes
    ----------
    description : str
        Description for people.
    origin : str
        Format that the document was read from: "hjif", "haptic", "ahap", "wav", "texture" or
        "tactile" (the default).
    ticks_per_s : int
        Resolution of time in formats that count ticks, 1 to 48000, default 1000 [1/s].
    perceptions : tuple of Perception
        Perceptions, with 200000 keyframes in all at most, default none.
    other : dict
        Further fields of the original format.
    """

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
    """Contents of an effect file.

    Attributes
    ----------
    effect : Effect
        The only table.
    """

    effect: Effect


def check_ascending(points: str, field: str, times: Iterable[float]) -> None:
    """Check that times ascend.

    Parameters
    ----------
    points : str
        Field of the list of points in the file.
    field : str
        Field of the time in a point.
    times : iterable of float
        Times in the order of the file.

    Raises
    ------
    InputError
        If a time is before that of its predecessor.
    """
    for i, (before, after) in enumerate(itertools.pairwise(times), 1):
        if after < before:
            raise InputError(
                f"{points}[{i}].{field} = {after:.10g}: comes after {before:.10g}; must ascend"
            )


def segments_of(perception: Perception) -> list[KeyframeSegment]:
    """Collect the segments of all bands of all channels.

    Parameters
    ----------
    perception : Perception
        Perception whose channels are searched. Its library does not count.

    Returns
    -------
    list of KeyframeSegment
        Segments in order.
    """
    bands = [band for channel in perception.channels for band in channel.bands]
    return [segment for band in bands for segment in band.segments]


def channels_of(effect: Effect) -> list[tuple[Perception, EffectChannel]]:
    """Collect all channels, each with its perception.

    Parameters
    ----------
    effect : Effect
        Effect whose perceptions are searched.

    Returns
    -------
    list of (Perception, EffectChannel)
        Channels in order.
    """
    return [(perception, channel) for perception in effect.perceptions
            for channel in perception.channels]  # fmt: skip


def single(effect_bands: tuple[Band, ...], **fields: Any) -> Effect:
    """Make an effect of one perception with one channel.

    Parameters
    ----------
    effect_bands : tuple of Band
        Bands of the channel.
    **fields : object
        Further fields of `Effect`.

    Returns
    -------
    Effect
        The effect.
    """
    return Effect(
        perceptions=(Perception(channels=(EffectChannel(bands=effect_bands),)),), **fields
    )


def hertz(sharpness: float) -> float:
    """Convert a sharpness to a frequency.

    Parameters
    ----------
    sharpness : float
        Sharpness, 0 to 1.

    Returns
    -------
    float
        Frequency, 65 to 300 [Hz].
    """
    return LOWEST + (HIGHEST - LOWEST) * sharpness


def sharpness_of(frequency: float) -> float:
    """Convert a frequency to a sharpness.

    Parameters
    ----------
    frequency : float
        Frequency [Hz].

    Returns
    -------
    float
        Sharpness, below 0 or above 1 outside of 65 to 300 Hz.
    """
    return (frequency - LOWEST) / (HIGHEST - LOWEST)
