"""``.haptic`` 1.x, of Meta Haptics Studio and Nice Vibrations: envelopes of one signal.

Amplitude and frequency over time, 0 … 1, straight between breakpoints; a breakpoint may be
emphasized, which is a transient. What the format's own validator rejects is rejected (breakpoints
out of order or range, no amplitude, an emphasis below its envelope); unknown fields are ignored, as
there. Frequencies are taken as 65 … 300 Hz (`document.hertz`), amplitudes as they are.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct

from tactile.errors import InputError
from tactile.texture.formats import outline, reading
from tactile.texture.formats.document import (
    HIGHEST,
    LOWEST,
    Band,
    Effect,
    Keyframe,
    KeyframeSegment,
    hertz,
    sharpness_of,
    single,
)

Fraction = Annotated[float, Meta(ge=0, le=1)]
Seconds = Annotated[float, Meta(ge=0, le=3600)]
FINE = 48_000
"""Ticks a second when a time of seconds goes to a format that counts: the most that MPEG takes."""


class Version(Struct, frozen=True):
    """Of the format."""

    major: int
    minor: int = 0
    patch: int = 0


class Metadata(Struct, frozen=True):
    """Of the clip."""

    editor: str = ""
    author: str = ""
    source: str = ""
    project: str = ""
    tags: tuple[str, ...] = ()
    description: str = ""


class Emphasis(Struct, frozen=True):
    """A transient."""

    amplitude: Fraction
    frequency: Fraction


class AmplitudePoint(Struct, frozen=True, omit_defaults=True):
    """A breakpoint."""

    time: Seconds
    amplitude: Fraction
    emphasis: Emphasis | None = None


class ClipFrequencyPoint(Struct, frozen=True):
    """A breakpoint."""

    time: Seconds
    frequency: Fraction


class Envelopes(Struct, frozen=True, omit_defaults=True):
    """Of the continuous signal."""

    amplitude: tuple[AmplitudePoint, ...]
    frequency: tuple[ClipFrequencyPoint, ...] | None = None


class Continuous(Struct, frozen=True):
    """The one signal."""

    envelopes: Envelopes


class Signals(Struct, frozen=True):
    """The one signal."""

    continuous: Continuous


class Clip(Struct, frozen=True):
    """The file."""

    version: Version
    signals: Signals
    metadata: Metadata = Metadata()


def load_clip(path: Path) -> tuple[Effect, list[str]]:
    """Return the effect of a file, and a line for each thing of it that is ignored.

    Raises
    ------
    InputError
        One line: file, field, value and limit.
    """
    data = reading.parsed_json(path)
    version = data.get("version")
    major = version.get("major") if isinstance(version, dict) else None
    if major != 1 or isinstance(major, bool):
        raise InputError(reading.one_line(
            f"{path}: version.major = {major}: must be 1; other versions of .haptic are not read"
        ))  # fmt: skip
    clip = reading.fitted(path, data, Clip)
    envelopes = clip.signals.continuous.envelopes
    _check(path, envelopes)
    ignored = reading.told("ignored:", reading.unknown(data, msgspec.inspect.type_info(Clip)))
    bands = [outline.wave_band(
        [(p.time, p.amplitude) for p in envelopes.amplitude],
        [(p.time, hertz(p.frequency)) for p in envelopes.frequency or ()],
    )]  # fmt: skip
    taps = tuple(
        Keyframe(time_s=p.time, amplitude=p.emphasis.amplitude,
                 frequency_hz=hertz(p.emphasis.frequency))
        for p in envelopes.amplitude if p.emphasis
    )  # fmt: skip
    if taps:
        bands.append(Band(kind="transient", lower_frequency_hz=LOWEST, upper_frequency_hz=HIGHEST,
                          segments=(KeyframeSegment(keyframes=taps),)))  # fmt: skip
    about = {**msgspec.to_builtins(clip.metadata), "tags": list(clip.metadata.tags)}
    other = {k: v for k, v in about.items() if v and k != "description"}
    effect = single(tuple(bands), origin="haptic", ticks_per_s=FINE, other=other,
                    description=clip.metadata.description)  # fmt: skip
    return effect, ignored


def _check(path: Path, envelopes: Envelopes) -> None:
    """See what types cannot say: order, and that an emphasis is above its envelope."""
    where = "signals.continuous.envelopes"
    if not envelopes.amplitude:
        raise InputError(f"{path}: {where}.amplitude: is empty; needs a breakpoint")
    for name in ("amplitude", "frequency"):
        before = 0.0
        for i, point in enumerate(getattr(envelopes, name) or ()):
            if point.time < before:
                raise InputError(
                    f"{path}: {where}.{name}[{i}].time = {point.time:g}: comes after {before:g}; "
                    "times must ascend"
                )
            before = point.time
    for i, p in enumerate(envelopes.amplitude):
        if p.emphasis and p.emphasis.amplitude < p.amplitude:
            raise InputError(
                f"{path}: {where}.amplitude[{i}].emphasis.amplitude = {p.emphasis.amplitude:g}: "
                f"must be at least the envelope's {p.amplitude:g}"
            )


def saved_clip(effect: Effect) -> tuple[bytes, list[str]]:
    """Return an effect as a file, and a line for each thing that it cannot say."""
    drawn, lost = outline.of_effect(effect, ".haptic")
    taps = sorted(drawn.transients)
    times = np.array([time for time, _ in drawn.amplitude])
    points = [AmplitudePoint(time=t, amplitude=a) for t, a in drawn.amplitude]
    raised = 0
    for time, amplitude, frequency in taps:
        under = float(np.interp(time, *np.array(drawn.amplitude).T))
        raised += amplitude < under
        point = AmplitudePoint(
            time=time, amplitude=under,
            emphasis=Emphasis(max(amplitude, under), _within(sharpness_of(frequency))),
        )  # fmt: skip
        at = [i for i in np.flatnonzero(times == time) if points[i].emphasis is None]
        if at and points[at[0]].amplitude <= point.emphasis.amplitude:  # type: ignore[union-attr]
            points[at[0]] = msgspec.structs.replace(points[at[0]], emphasis=point.emphasis)
        else:
            points.append(point)
    if raised:
        lost.append(f"{raised} transients are weaker than what lies under them: raised to it")
    lost += outline.beyond_range(drawn, ".haptic")
    clip = Clip(
        version=Version(1),
        metadata=_metadata(effect),
        signals=Signals(Continuous(Envelopes(
            amplitude=tuple(sorted(points, key=lambda p: p.time)),
            frequency=tuple(
                ClipFrequencyPoint(t, _within(sharpness_of(f))) for t, f in drawn.frequency
            ) or None,
        ))),
    )  # fmt: skip
    return msgspec.json.format(msgspec.json.encode(clip), indent=2), lost


def _metadata(effect: Effect) -> Metadata:
    other = effect.other if effect.origin == "haptic" else {}
    about = {**other, "description": effect.description}
    return reading.fitted(Path("effect.other"), about, Metadata)


def _within(value: float) -> float:
    return min(max(value, 0.0), 1.0)
