"""``.hjif``, MPEG-I Haptics as JSON (ISO/IEC 23090-31), read and written without loss.

The effect document has the same layers, so that a file is written as it was read: ids, effect
types, phases, base signals, keywords, gains, devices, and in ``other`` whatever has no meaning here
(avatars, targets on the body …). Wavelet streams are kept there too, besides their samples.
``effect_semantic_scheme`` is left out when writing, since the reference conformance check takes any
as an error. The binary form, .hmpg, is not read.
"""

import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from tactile.errors import InputError
from tactile.texture.formats import reading
from tactile.texture.formats.document import (
    MOST_KEYFRAMES,
    Band,
    BaseSignal,
    CurveType,
    DeviceType,
    Effect,
    EffectChannel,
    EffectType,
    Gain,
    Keyframe,
    KeyframeSegment,
    Perception,
    ReferenceDevice,
    Whole,
    channels_of,
    check_ascending,
)
from tactile.texture.formats.synthesis import without_control
from tactile.texture.formats.wavelets import decoded

KINDS = {
    "Curve": "curve", "VectorialWave": "wave", "WaveletWave": "wavelet", "Transient": "transient",
}  # fmt: skip
"""Kind of a band in the effect document by its ``band_type``."""
BANDS_AT_LEVEL_1, CHANNELS_AT_LEVEL_1 = 7, 128
"""Largest numbers of bands of a channel and of channels of a perception at level 1."""
MOST_WAVELET_SAMPLES = 2**20
"""Largest number of samples of a band of wavelets: two minutes at 8 kHz. Decoding takes some 10 µs
for each."""
LONGEST = 3600
"""Longest time that an effect may end at [s]."""
SCHEME = "effect_semantic_scheme"
"""Field that is left out when writing."""

Limit = Annotated[float, Meta(ge=0, le=1e6)]
"""Limit of a device or of a band, 0 to 1e6."""
Name = Annotated[str, Meta(max_length=10_000)]
"""Text of at most 10000 characters."""


class HjifKeyframe(Struct, frozen=True):
    """Object of ``keyframes``: one keyframe of an effect.

    Attributes
    ----------
    relative_position : int
        Time from the beginning of the effect, 0 to 2^32 − 1 [ticks].
    amplitude_modulation : float or None
        Amplitude, −1 to 1.
    frequency_modulation : float or None
        Frequency, 0 to 24000 [Hz].
    """

    relative_position: Whole
    amplitude_modulation: Annotated[float, Meta(ge=-1, le=1)] | None = None
    frequency_modulation: Annotated[float, Meta(ge=0, le=24_000)] | None = None


class HjifEffect(Struct, frozen=True):
    """Object of ``effects`` or ``effect_library``: keyframes from a time on.

    Attributes
    ----------
    effect_type : str
        "Basis", "Reference" or "Composite".
    position : int
        Beginning of the effect, 0 to 2^32 − 1, default 0 [ticks].
    id : int or None
        Number of the effect in the library.
    phase : float or None
        Phase at the beginning, −1000 to 1000 [rad].
    base_signal : str or None
        "Sine", "Square", "Triangle", "SawToothUp" or "SawToothDown".
    semantic_keywords : str or None
        Keywords, at most 10000 characters.
    keyframes : tuple of HjifKeyframe
        Keyframes in ascending order of time, default none.
    """

    effect_type: EffectType
    position: Whole = 0
    id: int | None = None
    phase: Annotated[float, Meta(ge=-1e3, le=1e3)] | None = None
    base_signal: BaseSignal | None = None
    semantic_keywords: Name | None = None
    keyframes: tuple[HjifKeyframe, ...] = ()

    def __post_init__(self) -> None:
        positions = (keyframe.relative_position for keyframe in self.keyframes)
        check_ascending("keyframes", "relative_position", positions)


class HjifBand(Struct, frozen=True):
    """Object of ``bands``: effects in one range of frequency.

    Attributes
    ----------
    band_type : str
        "Curve", "VectorialWave", "WaveletWave" or "Transient".
    lower_frequency_limit : float
        Lower end of the range, 0 to 1e6 [Hz].
    upper_frequency_limit : float
        Upper end of the range, 0 to 1e6 [Hz].
    effects : tuple of HjifEffect
        Effects.
    curve_type : str or None
        "Cubic", "Linear", "Akima", "Bezier", "Bspline" or "Unknown".
    """

    band_type: str
    lower_frequency_limit: Limit
    upper_frequency_limit: Limit
    effects: tuple[HjifEffect, ...]
    curve_type: CurveType | None = None

    def __post_init__(self) -> None:
        if self.band_type not in KINDS:
            raise ValueError(f"band_type = {self.band_type!r}: must be one of {', '.join(KINDS)}")


class HjifChannel(Struct, frozen=True):
    """Object of ``channels``: one signal.

    Attributes
    ----------
    id : int
        Number of the channel.
    description : str
        Description, at most 10000 characters.
    gain : float
        Factor of the signal, −1000 to 1000.
    mixing_coefficient : float
        Weight with which channels are mixed for one actuator, −1000 to 1000.
    body_part_mask : int
        Bits of the parts of the body, 0 to 2^32 − 1.
    bands : tuple of HjifBand
        Bands, which add up.
    reference_device_id : int or None
        Number of the device in ``reference_devices`` of the perception.
    """

    id: int
    description: Name
    gain: Gain
    mixing_coefficient: Gain
    body_part_mask: Whole
    bands: tuple[HjifBand, ...]
    reference_device_id: int | None = None


class HjifDevice(Struct, frozen=True):
    """Object of ``reference_devices``: actuator that an effect was made for.

    Attributes
    ----------
    id : int
        Number of the device.
    name : str
        Name of the device, at most 10000 characters.
    type : str
        "LRA", "VCA", "ERM", "Piezo" or "Unknown" (the default).
    minimum_frequency : float or None
        Lowest frequency, 0 to 1e6 [Hz].
    maximum_frequency : float or None
        Highest frequency, 0 to 1e6 [Hz].
    resonance_frequency : float or None
        Resonance frequency, 0 to 1e6 [Hz].
    maximum_voltage : float or None
        Highest voltage, 0 to 1e6 [V].
    maximum_displacement : float or None
        Largest displacement, 0 to 1e6, in the unit of length of the perception.
    """

    id: int
    name: Name
    type: DeviceType = "Unknown"
    minimum_frequency: Limit | None = None
    maximum_frequency: Limit | None = None
    resonance_frequency: Limit | None = None
    maximum_voltage: Limit | None = None
    maximum_displacement: Limit | None = None


class HjifPerception(Struct, frozen=True):
    """Object of ``perceptions``: channels that make up one impression.

    Attributes
    ----------
    id : int
        Number of the perception.
    avatar_id : int
        Number of its avatar.
    description : str
        Description, at most 10000 characters.
    perception_modality : str
        Modality, such as "Vibrotactile Texture".
    effect_library : tuple of HjifEffect
        Effects that others refer to.
    channels : tuple of HjifChannel
        Channels.
    reference_devices : tuple of HjifDevice
        Actuators that the channels were made for, default none.
    unit_exponent : int
        Unit of length as a power of ten of a meter, −12 to 12, default −3 (millimeters).
    """

    id: int
    avatar_id: int
    description: Name
    perception_modality: Name
    effect_library: tuple[HjifEffect, ...]
    channels: tuple[HjifChannel, ...]
    reference_devices: tuple[HjifDevice, ...] = ()
    unit_exponent: Annotated[int, Meta(ge=-12, le=12)] = -3

    def __post_init__(self) -> None:
        for k, effect in enumerate(self.effect_library):
            if effect.effect_type == "Reference":
                raise ValueError(
                    f"effect_library[{k}] = Reference to effect {effect.id}: refers to itself; "
                    "must be Basis or Composite"
                )


class HjifFile(Struct, frozen=True):
    """Contents of a .hjif file, all of which are required.

    Attributes
    ----------
    version : str
        Version of the format, such as "2023".
    profile : str
        "Main" or "Simple Parametric".
    level : int
        Level of the profile, 1 or 2.
    date : str
        Date of the file.
    description : str
        Description, at most 10000 characters.
    timescale : int
        Ticks per second, 1 to 48000 [1/s].
    avatars : tuple of dict
        Avatars, which are kept as they are.
    perceptions : tuple of HjifPerception
        Perceptions.
    syncs : tuple of dict
        Synchronization, which is kept as it is.
    """

    version: Annotated[str, Meta(pattern="^[0-9]{4}(-[0-9])?$")]
    profile: Annotated[str, Meta(pattern="^(Main|Simple Parametric)$")]
    level: Annotated[int, Meta(ge=1, le=2)]
    date: Name
    description: Name
    timescale: Annotated[int, Meta(ge=1, le=48_000)]
    avatars: tuple[dict[str, Any], ...]
    perceptions: tuple[HjifPerception, ...]
    syncs: tuple[dict[str, Any], ...]

    def __post_init__(self) -> None:
        for place, effect in _placed_effects(self.perceptions):
            last = max((k.relative_position for k in effect.keyframes), default=0)
            if (effect.position + last) / self.timescale > LONGEST:
                raise ValueError(f"{place}: ends after more than an hour")


def _placed_effects(perceptions: tuple[HjifPerception, ...]) -> Iterator[tuple[str, HjifEffect]]:
    """Yield all effects, each with its place in the file."""
    for i, p in enumerate(perceptions):
        for k, effect in enumerate(p.effect_library):
            yield f"perceptions[{i}].effect_library[{k}]", effect
        for j, c in enumerate(p.channels):
            for b, band in enumerate(c.bands):
                for k, effect in enumerate(band.effects):
                    yield f"perceptions[{i}].channels[{j}].bands[{b}].effects[{k}]", effect


def load_hjif(path: Path) -> tuple[Effect, list[str]]:
    """Read a .hjif file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    effect : Effect
        Effect with all of the layers of the file.
    notes : list of str
        Always empty, since nothing is changed.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid. The message is one line with the file, field, value and limit.
    """
    data = reading.parsed_json(path, null=False)
    file = reading.fitted(path, data, HjifFile)
    other_fields = {k: v for k, v in data.items()
            if k not in ("description", "timescale", "perceptions")}  # fmt: skip
    try:
        effect = Effect(
            description=file.description, origin="hjif", ticks_per_s=file.timescale,
            perceptions=tuple(
                _perception(p, raw, file.timescale)
                for p, raw in zip(file.perceptions, data["perceptions"], strict=True)
            ),
            other=other_fields,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return effect, []


def _other(raw: dict[str, Any], shape: type[Struct], *unsaid: str) -> dict[str, Any]:
    """Return the fields of an object that its Struct does not have, and further ones by name."""
    return {k: v for k, v in raw.items() if k not in shape.__struct_encode_fields__ or k in unsaid}


def _perception(p: HjifPerception, raw: dict[str, Any], timescale: int) -> Perception:
    """Return a perception of a file as one of the document."""
    millimeters = 10.0 ** (p.unit_exponent + 3)
    devices = zip(p.reference_devices, raw.get("reference_devices", ()), strict=True)
    return Perception(
        id=p.id, avatar_id=p.avatar_id, description=p.description, modality=p.perception_modality,
        reference_devices=tuple(_device(d, raw_device, millimeters) for d, raw_device in devices),
        library=_segments(p.effect_library, raw["effect_library"], timescale),
        channels=tuple(
            _channel(c, raw_channel, timescale)
            for c, raw_channel in zip(p.channels, raw["channels"], strict=True)
        ),
        other=_other(raw, HjifPerception, "unit_exponent"),
    )  # fmt: skip


def _device(d: HjifDevice, raw: dict[str, Any], millimeters: float) -> ReferenceDevice:
    """Return a device of a file as one of the document."""
    reach = d.maximum_displacement
    return ReferenceDevice(
        id=d.id, name=d.name, type=d.type, minimum_frequency_hz=d.minimum_frequency,
        maximum_frequency_hz=d.maximum_frequency, resonance_frequency_hz=d.resonance_frequency,
        maximum_voltage_v=d.maximum_voltage,
        maximum_displacement_mm=None if reach is None else reach * millimeters,
        other=_other(raw, HjifDevice),
    )  # fmt: skip


def _channel(c: HjifChannel, raw: dict[str, Any], timescale: int) -> EffectChannel:
    """Return a channel of a file as one of the document."""
    bands = tuple(
        _decoded(Band(
            kind=KINDS[band.band_type], curve_type=band.curve_type,  # type: ignore[arg-type]
            segments=_segments(band.effects, raw_band["effects"], timescale),
            lower_frequency_hz=band.lower_frequency_limit,
            upper_frequency_hz=band.upper_frequency_limit, other=_other(raw_band, HjifBand),
        ), timescale)
        for band, raw_band in zip(c.bands, raw["bands"], strict=True)
    )  # fmt: skip
    return EffectChannel(
        id=c.id, description=c.description, gain=c.gain, mixing_coefficient=c.mixing_coefficient,
        body_part_mask=c.body_part_mask, reference_device_id=c.reference_device_id,
        bands=bands, other=_other(raw, HjifChannel),
    )  # fmt: skip


def _decoded(band: Band, timescale: int) -> Band:
    """Return a band with the samples of its wavelet blocks, whose rate is its upper limit."""
    length, rate = band.other.get("block_length"), band.upper_frequency_hz
    if band.kind != "wavelet" or not isinstance(length, int):
        return band
    count = length * rate / timescale
    if len(band.segments) * count > MOST_WAVELET_SAMPLES:
        raise InputError(
            f"a band of wavelets has {len(band.segments) * count:g} samples: "
            f"{MOST_WAVELET_SAMPLES} at most"
        )
    if count != int(count):
        raise InputError(f"block_length = {length}: is {count:g} samples; must be a whole number")
    segments = tuple(
        msgspec.structs.replace(s, samples=decoded(stream, int(count)).astype("<f4").tobytes())
        if isinstance(stream := s.other.get("wavelet_stream"), str) else s
        for s in band.segments
    )  # fmt: skip
    return msgspec.structs.replace(band, sample_rate_hz=rate, segments=segments)


def _segments(
    effects: tuple[HjifEffect, ...], raw: list[dict[str, Any]], timescale: int
) -> tuple[KeyframeSegment, ...]:
    """Return effects of a file as segments of the document."""
    return tuple(
        KeyframeSegment(
            start_s=e.position / timescale, type=e.effect_type, id=e.id, phase_rad=e.phase,
            base_signal=e.base_signal, keywords=e.semantic_keywords,
            other=_other(raw_effect, HjifEffect),
            keyframes=tuple(
                Keyframe(time_s=k.relative_position / timescale, amplitude=k.amplitude_modulation,
                         frequency_hz=k.frequency_modulation)
                for k in e.keyframes
            ),
        )
        for e, raw_effect in zip(effects, raw, strict=True)
    )  # fmt: skip


# Writing of a file


class _Writer:
    """Notes and counts of rounded values that accumulate while an effect is written."""

    def __init__(self, effect: Effect) -> None:
        self.timescale, self.ours = effect.ticks_per_s, effect.origin == "hjif"
        self.rounded_hertz = self.rounded_times = 0
        self.lost: list[str] = []

    def ticks(self, seconds: float) -> int:
        """Return a time in whole ticks, and count it if it was rounded."""
        ticks = round(seconds * self.timescale)
        self.rounded_times += abs(ticks - seconds * self.timescale) > 1e-6
        return ticks

    def hertz(self, frequency: float) -> int:
        """Return a frequency in whole Hz, and count it if it was rounded."""
        hertz = round(max(frequency, 0.0))
        self.rounded_hertz += hertz != frequency
        return hertz

    def other(self, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of ``other`` to write, none for a document of another origin."""
        return {k: v for k, v in fields.items() if k != SCHEME} if self.ours else {}


def saved_hjif(effect: Effect) -> tuple[bytes, list[str]]:
    """Format an effect as a .hjif file.

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

    Raises
    ------
    InputError
        If there are too many samples to be written as keyframes.
    """
    effect = _with_ticks_for_samples(effect)
    writer = _Writer(effect)
    perceptions = [_perception_out(writer, p) for p in effect.perceptions]
    crowded = any(
        len(c.bands) > BANDS_AT_LEVEL_1 for _, c in channels_of(effect)
    ) or any(len(p.channels) > CHANNELS_AT_LEVEL_1 for p in effect.perceptions)  # fmt: skip
    content = {
        "version": "2023", "profile": "Main", "level": 2 if crowded else 1,
        "date": datetime.date.today().isoformat(), "avatars": [], "syncs": [],
        **writer.other(effect.other), "description": effect.description,
        "timescale": effect.ticks_per_s, "perceptions": perceptions,
    }  # fmt: skip
    if writer.rounded_hertz:
        writer.lost.append(f".hjif has whole Hz: {writer.rounded_hertz} frequencies rounded")
    if writer.rounded_times:
        writer.lost.append(f"{writer.rounded_times} times rounded to 1/{effect.ticks_per_s} s")
    return msgspec.json.format(msgspec.json.encode(content), indent=1), writer.lost


def _with_ticks_for_samples(effect: Effect) -> Effect:
    """Return an effect whose ticks are those of its samples, if it has any."""
    sampled = [
        (b.sample_rate_hz or 1.0, sum(len(s.samples) // 4 for s in b.segments))
        for _, c in channels_of(effect) for b in c.bands if b.kind == "samples"
    ]  # fmt: skip
    if not sampled:
        return effect
    if (count := sum(n for _, n in sampled)) > MOST_KEYFRAMES:
        raise InputError(
            f"{count} samples as keyframes of .hjif: {MOST_KEYFRAMES} at most; a shorter or slower "
            "file would do"
        )
    rate = max(rate for rate, _ in sampled)
    ticks_per_s = rate if rate == int(rate) and rate <= 48_000 else 48_000
    return msgspec.structs.replace(effect, ticks_per_s=int(ticks_per_s))


def _perception_out(writer: _Writer, p: Perception) -> dict[str, Any]:
    """Return a perception as an object of the file."""
    if writer.ours and SCHEME in p.other:
        writer.lost.append(f"perception {p.id}: {SCHEME} is left out: conformance checks refuse it")
    units = {"unit_exponent": -3, "perception_unit_exponent": 0}
    other = writer.other(p.other) if writer.ours else units
    unit = 10.0 ** (-3 - other.get("unit_exponent", -3))
    return {
        **other, "id": p.id, "avatar_id": p.avatar_id, "description": p.description,
        "perception_modality": p.modality,
        "reference_devices": [_device_out(writer, d, unit) for d in p.reference_devices],
        "effect_library": [_segment_out(writer, "wave", s) for s in p.library],
        "channels": [_channel_out(writer, p, c) for c in p.channels],
    }  # fmt: skip


def _device_out(writer: _Writer, d: ReferenceDevice, unit: float) -> dict[str, Any]:
    """Return a device as an object of the file."""
    reach = d.maximum_displacement_mm
    limits = {
        "minimum_frequency": d.minimum_frequency_hz, "maximum_frequency": d.maximum_frequency_hz,
        "resonance_frequency": d.resonance_frequency_hz, "maximum_voltage": d.maximum_voltage_v,
        "maximum_displacement": None if reach is None else reach * unit,
    }  # fmt: skip
    present = {k: v for k, v in limits.items() if v is not None}
    return {**writer.other(d.other), "id": d.id, "name": d.name, "type": d.type, **present}


def _channel_out(writer: _Writer, perception: Perception, channel: EffectChannel) -> dict[str, Any]:
    """Return a channel as an object of the file."""
    plain = without_control(perception, channel)
    if plain is not channel:
        writer.lost.append(f"channel {channel.id}: control curves are worked into its keyframes")
    device = plain.reference_device_id
    return {
        **writer.other(plain.other), "id": plain.id, "description": plain.description,
        "gain": plain.gain, "mixing_coefficient": plain.mixing_coefficient,
        "body_part_mask": plain.body_part_mask,
        **({} if device is None else {"reference_device_id": device}),
        "bands": [_band_out(writer, b) for b in plain.bands if b.kind != "control"],
    }  # fmt: skip


def _band_out(writer: _Writer, band: Band) -> dict[str, Any]:
    """Return a band as an object of the file."""
    names = {ours: theirs for theirs, ours in KINDS.items()}
    curve_type = "Linear" if band.kind == "samples" else band.curve_type
    return {
        **writer.other(band.other),
        "band_type": names.get(band.kind, "Curve"),
        **({} if curve_type is None else {"curve_type": curve_type}),
        "lower_frequency_limit": round(band.lower_frequency_hz),
        "upper_frequency_limit": round(band.upper_frequency_hz),
        "effects": [_segment_out(writer, band.kind, _as_keyframes(band, s)) for s in band.segments],
    }


def _as_keyframes(band: Band, segment: KeyframeSegment) -> KeyframeSegment:
    """Return samples as keyframes, with one more that holds the last sample for its interval."""
    if band.kind != "samples":
        return segment
    values = np.clip(np.frombuffer(segment.samples, "<f4").astype(np.float64), -1, 1).tolist()
    rate = band.sample_rate_hz or 1.0
    keyframes = tuple(
        Keyframe(time_s=i / rate, amplitude=v) for i, v in enumerate([*values, *values[-1:]])
    )
    return msgspec.structs.replace(segment, samples=b"", keyframes=keyframes)


def _segment_out(writer: _Writer, kind: str, s: KeyframeSegment) -> dict[str, Any]:
    """Return a segment as an object of the file."""
    optional = {
        "id": s.id, "phase": s.phase_rad, "base_signal": s.base_signal,
        "semantic_keywords": s.keywords,
    }  # fmt: skip
    if kind == "wave" and not writer.ours and s.type == "Basis":
        optional["phase"], optional["base_signal"] = s.phase_rad or 0.0, s.base_signal or "Sine"
    fields = {
        **writer.other(s.other), "effect_type": s.type, "position": writer.ticks(s.start_s),
        **{k: v for k, v in optional.items() if v is not None},
    }  # fmt: skip
    if s.keyframes or not (s.other or s.type == "Reference"):
        fields["keyframes"] = [_keyframe_out(writer, k) for k in s.keyframes]
    return fields


def _keyframe_out(writer: _Writer, k: Keyframe) -> dict[str, Any]:
    """Return a keyframe as an object of the file."""
    out: dict[str, Any] = {"relative_position": writer.ticks(k.time_s)}
    if k.amplitude is not None:
        out["amplitude_modulation"] = k.amplitude
    if k.frequency_hz is not None:
        out["frequency_modulation"] = writer.hertz(k.frequency_hz)
    return out
