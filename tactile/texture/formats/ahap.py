"""AHAP, the haptic patterns of Apple: events, and curves that modify all of them.

As in Core Haptics, values out of range are limited, unknown keys are ignored and missing ones take
their default; each of these is reported. An entry of the pattern that is not an event, parameter or
curve is an error, since nothing would play where something was meant to. Intensity is taken as
amplitude, and sharpness 0 … 1 as 65 … 300 Hz (from the encoder of MPEG for AHAP; Apple states
neither).

Times of the points of a curve count from the beginning of the curve. Lofelt Studio counted them
from the beginning of the pattern: a curve whose first point has the time of the curve itself, and
not 0, is read in this way.
"""

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from tactile import files
from tactile.errors import InputError
from tactile.texture.formats import outline, reading
from tactile.texture.formats.document import (
    HIGHEST,
    LOWEST,
    Band,
    Effect,
    EffectChannel,
    Keyframe,
    KeyframeSegment,
    Seconds,
    channels_of,
    check_ascending,
    hertz,
    sharpness_of,
    single,
)
from tactile.texture.formats.haptic_clip import FINE
from tactile.texture.formats.synthesis import PLAIN

MOST_POINTS = 16
"""Largest number of points of a curve (Core Haptics)."""
LONGEST_EVENT = 30.0
"""Longest duration of a continuous event (Core Haptics) [s]."""
DEFAULT = {"HapticIntensity": 1.0, "HapticSharpness": 0.5}
"""Values of an event that does not state them (assumed: Apple states none for sharpness)."""
KINDS = ("Event", "Parameter", "ParameterCurve")
"""Keys that an entry of the pattern may have."""

Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Number of limited magnitude, −1e6 to 1e6."""


class EventParameter(Struct, frozen=True, rename="pascal"):
    """Object of ``EventParameters``: one value of an event.

    Attributes
    ----------
    parameter_id : str
        "HapticIntensity" or "HapticSharpness". Others are kept for writing and have no effect.
    parameter_value : float
        Value, −1e6 to 1e6. Intensity and sharpness are limited to 0 to 1.
    """

    parameter_id: str = msgspec.field(name="ParameterID")
    parameter_value: Number


class AhapEvent(Struct, frozen=True, rename="pascal"):
    """Object ``Event``: a tap or an oscillation.

    Attributes
    ----------
    event_type : str
        "HapticTransient" for a tap or "HapticContinuous" for an oscillation. Events of other types
        are left out.
    time : float
        Beginning of the event, 0 to 3600, default 0 [s].
    event_duration : float
        Duration of an oscillation, 0 to 3600, default 0 [s].
    event_parameters : tuple of EventParameter
        Intensity and sharpness, by default those of `DEFAULT`.
    """

    event_type: str
    time: Seconds = 0.0
    event_duration: Seconds = 0.0
    event_parameters: tuple[EventParameter, ...] = ()


class ControlPoint(Struct, frozen=True, rename="pascal"):
    """Object of ``ParameterCurveControlPoints``: one point of a curve.

    Attributes
    ----------
    time : float
        Time from the beginning of the curve, 0 to 3600 [s].
    parameter_value : float
        Value, limited to 0 to 1 for an intensity and to −1 to 1 for a sharpness.
    """

    time: Seconds
    parameter_value: Number


class AhapParameter(Struct, frozen=True, rename="pascal"):
    """Object ``Parameter``: a value that applies to all events from a time on.

    Attributes
    ----------
    parameter_id : str
        "HapticIntensityControl", which multiplies intensities, or "HapticSharpnessControl", which
        is added to sharpnesses. Others are left out.
    parameter_value : float
        Value, limited to 0 to 1 for an intensity and to −1 to 1 for a sharpness.
    time : float
        Time from which on it applies, 0 to 3600, default 0 [s].
    """

    parameter_id: str = msgspec.field(name="ParameterID")
    parameter_value: Number
    time: Seconds = 0.0


class ParameterCurve(Struct, frozen=True, rename="pascal"):
    """Object ``ParameterCurve``: values that apply to all events over time.

    Attributes
    ----------
    parameter_id : str
        "HapticIntensityControl", which multiplies intensities, or "HapticSharpnessControl", which
        is added to sharpnesses. Others are left out.
    parameter_curve_control_points : tuple of ControlPoint
        Points of the curve in ascending order of time, at least one.
    time : float
        Beginning of the curve, 0 to 3600, default 0 [s].
    """

    parameter_id: str = msgspec.field(name="ParameterID")
    parameter_curve_control_points: tuple[ControlPoint, ...]
    time: Seconds = 0.0


class Entry(Struct, frozen=True, rename="pascal"):
    """Entry of ``Pattern``, which holds exactly one of these objects.

    Attributes
    ----------
    event : AhapEvent or None
        Tap or oscillation.
    parameter : AhapParameter or None
        Value for all events.
    parameter_curve : ParameterCurve or None
        Values for all events over time.
    """

    event: AhapEvent | None = None
    parameter: AhapParameter | None = None
    parameter_curve: ParameterCurve | None = None


class Pattern(Struct, frozen=True, rename="pascal"):
    """Contents of an AHAP file.

    Attributes
    ----------
    pattern : tuple of Entry
        Events, parameters and curves.
    version : float
        Version of the format, at least 1 and less than 2, default 1.
    metadata : dict
        Texts about the pattern, by name. Other values are ignored.
    """

    pattern: tuple[Entry, ...]
    version: Number = 1.0
    metadata: dict[str, Any] = {}


def load_ahap(path: Path) -> tuple[Effect, list[str]]:
    """Read an AHAP file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    effect : Effect
        Effect of one channel.
    notes : list of str
        One line for each thing that was ignored, left out or limited.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid. The message is one line with the file, field, value and limit.
    """
    data = reading.parsed_json(path)
    pattern = reading.fitted(path, data, Pattern)
    if not 1 <= pattern.version < 2:
        raise InputError(f"{path}: Version = {pattern.version:g}: must be 1")
    notes = reading.notes_on("ignored:", reading.unknown(data, msgspec.inspect.type_info(Pattern)))
    for i, raw in enumerate(data["Pattern"]):
        kinds = [kind for kind in KINDS if raw.get(kind) is not None]
        if len(kinds) != 1:
            key = next((k for k in raw if k not in KINDS), "nothing")
            reason = f"{' and '.join(kinds)} at once" if kinds else (
                f"{reading.one_line(str(key))!r}; {files.nearest(str(key), list(KINDS))}"
            )  # fmt: skip
            raise InputError(f"{path}: Pattern[{i}]: holds {reason}")
    notes += reading.notes_on("ignored: metadata", [
        k for k, v in pattern.metadata.items() if not isinstance(v, str)
    ])  # fmt: skip
    limited: list[str] = []
    events = [e.event for e in pattern.pattern if e.event]
    notes += reading.notes_on("left out:", [
        e.event_type for e in events if e.event_type not in ("HapticTransient", "HapticContinuous")
    ])  # fmt: skip
    bands = (
        _events("transient", [e for e in events if e.event_type == "HapticTransient"], limited),
        _events("wave", [e for e in events if e.event_type == "HapticContinuous"], limited),
        _controls(path, pattern, notes, limited),
    )
    effect = single(
        tuple(band for band in bands if band.segments), origin="ahap", ticks_per_s=FINE,
        description=str(pattern.metadata.get("Description", "")),
        other={
            k: v for k, v in pattern.metadata.items()
            if isinstance(v, str) and k != "Description"
        },
    )  # fmt: skip
    return effect, notes + reading.notes_on("limited to its range:", limited)


def _limit(name: str, value: float, low: float, limited: list[str]) -> float:
    """Return a value limited to at most 1 and at least ``low``; one out of range is noted."""
    if not low <= value <= 1:
        limited.append(f"{name} {value:g}")
    return min(max(value, low), 1.0)


def _events(kind: str, events: list[AhapEvent], limited: list[str]) -> Band:
    """Return events of one type as a band with a segment each. Unknown parameters are kept."""
    segments = []
    for event in events:
        settings = {p.parameter_id: p.parameter_value for p in event.event_parameters}
        intensity, sharpness = (
            _limit(name, settings.pop(name, DEFAULT[name]), 0.0, limited) for name in DEFAULT
        )
        times = [0.0] if kind == "transient" else [0.0, event.event_duration]
        segments.append(KeyframeSegment(
            start_s=event.time, other=dict(settings),
            keyframes=tuple(Keyframe(time_s=t, amplitude=intensity, frequency_hz=hertz(sharpness))
                            for t in times),
        ))  # fmt: skip
    return Band(kind=kind, lower_frequency_hz=LOWEST, upper_frequency_hz=HIGHEST,  # type: ignore[arg-type]
                segments=tuple(segments))  # fmt: skip


def _controls(path: Path, pattern: Pattern, notes: list[str], limited: list[str]) -> Band:
    """Return parameters and curves as a band with a segment each."""
    segments = []
    for i, entry in enumerate(pattern.pattern):
        parameter, curve = entry.parameter, entry.parameter_curve
        if parameter:
            curve = ParameterCurve(
                parameter.parameter_id,
                (ControlPoint(0.0, parameter.parameter_value),),
                parameter.time,
            )
        if curve is None:
            continue
        if curve.parameter_id not in ("HapticIntensityControl", "HapticSharpnessControl"):
            notes.append(f"left out: {reading.one_line(curve.parameter_id)}")
            continue
        where = f"{path}: Pattern[{i}].ParameterCurve.ParameterCurveControlPoints"
        segments.append(_control(where, curve, limited))
    return Band(kind="control", segments=tuple(segments))


def _control(where: str, curve: ParameterCurve, limited: list[str]) -> KeyframeSegment:
    """Return a curve as a segment, its sharpness as a shift of frequency [Hz]."""
    points = curve.parameter_curve_control_points
    if not points:
        raise InputError(f"{where}: is empty; needs a point")
    check_ascending(where, "Time", (p.time for p in points))
    offset = curve.time if points[0].time == curve.time else 0.0
    intensity = curve.parameter_id == "HapticIntensityControl"
    low, keyframes = 0.0 if intensity else -1.0, []
    for point in points:
        time = point.time - offset
        value = _limit(curve.parameter_id, point.parameter_value, low, limited)
        shift = value * (HIGHEST - LOWEST)
        keyframes.append(
            Keyframe(time_s=time, amplitude=value)
            if intensity
            else Keyframe(time_s=time, frequency_hz=shift)
        )
    return KeyframeSegment(start_s=curve.time, keyframes=tuple(keyframes))


def saved_ahap(effect: Effect) -> tuple[bytes, list[str]]:
    """Format an effect as an AHAP file.

    Parameters
    ----------
    effect : Effect
        Effect, of which the first channel is written.

    Returns
    -------
    content : bytes
        Contents of the file.
    lost : list of str
        One line for each thing that the format cannot express.

    Raises
    ------
    InputError
        If the effect has no channel, or nothing in it can be written.
    """
    channels = channels_of(effect)
    lost: list[str] = []
    if len(channels) == 1 and _is_pattern(channels[0][1]):
        entries = _direct_entries(channels[0][1])
    else:
        entries, lost = _outlined_entries(effect)
    other = effect.other if effect.origin == "ahap" else {}
    content = {
        "Version": 1.0,
        "Metadata": {**other, "Description": effect.description},
        "Pattern": entries,
    }
    return msgspec.json.format(msgspec.json.encode(content), indent=2), lost


def _is_pattern(channel: EffectChannel) -> bool:
    """Return whether events and curves can express a channel without loss."""
    parts = [(b.kind, s) for b in channel.bands for s in b.segments]
    kinds = {kind for kind, _ in parts}
    plain = all(
        s.type == "Basis" and s.base_signal in (None, "Sine") and not s.phase_rad and s.keyframes
        for _, s in parts
    )
    steady = all(
        len({(k.amplitude, k.frequency_hz) for k in s.keyframes}) == 1
        and s.keyframes[0].time_s == 0
        and 0 <= (s.keyframes[0].amplitude or 0) <= 1
        and LOWEST <= (s.keyframes[0].frequency_hz or 0) <= HIGHEST
        and s.keyframes[-1].time_s <= LONGEST_EVENT
        for kind, s in parts if kind != "control"
    )  # fmt: skip
    return kinds <= {"wave", "transient", "control"} and plain and steady and channel.gain == 1


def _direct_entries(channel: EffectChannel) -> list[dict[str, Any]]:
    """Return the entries of a channel that events and curves can express."""
    entries = []
    for band in channel.bands:
        for s in band.segments:
            first, last = s.keyframes[0], s.keyframes[-1]
            if band.kind == "control":
                for name in ("amplitude", "frequency_hz"):
                    pairs = [(k.time_s, v) for k in s.keyframes
                             if (v := getattr(k, name)) is not None]  # fmt: skip
                    entries += _curves(name, pairs, s.start_s)
                continue
            extra = {k: v for k, v in s.other.items() if isinstance(v, int | float)}
            duration = None if band.kind == "transient" else last.time_s
            sharpness = sharpness_of(first.frequency_hz or LOWEST)
            entries.append(_event(s.start_s, first.amplitude or 0.0, sharpness, duration, extra))
    return entries


def _outlined_entries(effect: Effect) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the outline of an effect as events of intensity 1 under curves, and what is lost."""
    shape, lost = outline.of_effect(effect, "AHAP")
    lost += outline.beyond_range(shape, "AHAP")
    end = shape.amplitude[-1][0]
    entries: list[dict[str, Any]] = [
        _event(t, 1.0, 0.0, min(end - t, LONGEST_EVENT), {})
        for t in np.arange(0.0, end, LONGEST_EVENT).tolist()
    ]
    pitch = [(t, min(max(f, LOWEST), HIGHEST) - LOWEST) for t, f in shape.frequency]
    if not pitch:
        pitch = [(0.0, PLAIN - LOWEST)]
    entries += _curves("amplitude", shape.amplitude, 0.0) + _curves("frequency_hz", pitch, 0.0)
    changed = 0
    for time, amplitude, frequency in shape.transients:
        under = float(np.interp(time, *np.array(shape.amplitude).T))
        shift = sharpness_of(LOWEST + float(np.interp(time, *np.array(pitch).T)))
        intensity = amplitude / under if under > 0 else 1.0
        sharpness = sharpness_of(frequency) - shift
        changed += under == 0 or intensity > 1 + 1e-9 or not -1e-9 <= sharpness <= 1 + 1e-9
        entries.append(_event(time, min(intensity, 1.0), min(max(sharpness, 0.0), 1.0), None, {}))
    if changed:
        lost.append(
            f"curves of AHAP change transients too: {changed} become weaker, or as dull or sharp "
            "as these leave them"
        )
    return entries, lost


def _event(
    time: float, intensity: float, sharpness: float, duration: float | None, extra: dict[str, float]
) -> dict[str, Any]:
    """Return the entry of an event, a transient one if it has no duration."""
    values = {"HapticIntensity": intensity, "HapticSharpness": sharpness, **extra}
    event: dict[str, Any] = {
        "Time": time,
        "EventType": "HapticTransient" if duration is None else "HapticContinuous",
        "EventParameters": [
            {"ParameterID": name, "ParameterValue": value} for name, value in values.items()
        ],
    }
    if duration is not None:
        event["EventDuration"] = duration
    return {"Event": event}


def _curves(name: str, pairs: list[tuple[float, float]], start: float) -> list[dict[str, Any]]:
    """Return points as curves of at most 16, each beginning at the last point of the previous."""
    parameter = "HapticIntensityControl" if name == "amplitude" else "HapticSharpnessControl"
    scale = 1.0 if name == "amplitude" else HIGHEST - LOWEST
    curves = []
    for i in range(0, max(len(pairs) - 1, min(len(pairs), 1)), MOST_POINTS - 1):
        part = pairs[i : i + MOST_POINTS]
        begin = part[0][0]
        points = [{"Time": t - begin, "ParameterValue": v / scale} for t, v in part]
        curves.append({"ParameterCurve": {"ParameterID": parameter, "Time": start + begin,
                                          "ParameterCurveControlPoints": points}})  # fmt: skip
    return curves
