"""``.haptic`` 1.x, of Meta Haptics Studio and Nice Vibrations: envelopes of one signal.

Amplitude and frequency are functions of time from 0 to 1, linear between breakpoints. A breakpoint
may have an emphasis, which is a transient. What the validator of the format rejects is rejected
here as well (breakpoints out of order or range, no amplitude, an emphasis below its envelope).
Unknown fields are ignored, as there. Frequencies are taken as 65 … 300 Hz (`document.hertz`),
amplitudes as they are.
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
    Seconds,
    check_ascending,
    hertz,
    sharpness_of,
    single,
)

Fraction = Annotated[float, Meta(ge=0, le=1)]
"""Fraction, 0 to 1."""
FINE = 48_000
"""Resolution of a document whose times were given in seconds, for formats that count ticks [1/s].
It is the highest that MPEG allows."""


class Version(Struct, frozen=True):
    """Object ``version``: version of the format.

    Attributes
    ----------
    major : int
        Major version, which must be 1.
    minor : int
        Minor version, default 0.
    patch : int
        Patch version, default 0.
    """

    major: int
    minor: int = 0
    patch: int = 0


class Metadata(Struct, frozen=True):
    """Object ``metadata``: information about the clip, all of it optional.

    Attributes
    ----------
    editor : str
        Program that wrote the file.
    author : str
        Author of the clip.
    source : str
        Source of the clip, such as an audio file.
    project : str
        Name of the project.
    tags : tuple of str
        Tags.
    description : str
        Description for people.
    """

    editor: str = ""
    author: str = ""
    source: str = ""
    project: str = ""
    tags: tuple[str, ...] = ()
    description: str = ""


class Emphasis(Struct, frozen=True):
    """Object ``emphasis``: a transient at a breakpoint.

    Attributes
    ----------
    amplitude : float
        Amplitude, 0 to 1, at least that of the breakpoint.
    frequency : float
        Frequency, 0 to 1, taken as 65 to 300 Hz.
    """

    amplitude: Fraction
    frequency: Fraction


class AmplitudePoint(Struct, frozen=True, omit_defaults=True):
    """Breakpoint of the envelope of amplitude.

    Attributes
    ----------
    time : float
        Time, 0 to 3600 [s].
    amplitude : float
        Amplitude, 0 to 1.
    emphasis : Emphasis or None
        Transient at this time.
    """

    time: Seconds
    amplitude: Fraction
    emphasis: Emphasis | None = None


class ClipFrequencyPoint(Struct, frozen=True):
    """Breakpoint of the envelope of frequency.

    Attributes
    ----------
    time : float
        Time, 0 to 3600 [s].
    frequency : float
        Frequency, 0 to 1, taken as 65 to 300 Hz.
    """

    time: Seconds
    frequency: Fraction


class Envelopes(Struct, frozen=True, omit_defaults=True):
    """Object ``envelopes``: amplitude and frequency over time.

    Attributes
    ----------
    amplitude : tuple of AmplitudePoint
        Breakpoints in ascending order of time, at least one.
    frequency : tuple of ClipFrequencyPoint or None
        Breakpoints in ascending order of time.
    """

    amplitude: tuple[AmplitudePoint, ...]
    frequency: tuple[ClipFrequencyPoint, ...] | None = None

    def __post_init__(self) -> None:
        if not self.amplitude:
            raise ValueError("amplitude: is empty; needs a breakpoint")
        check_ascending("amplitude", "time", (p.time for p in self.amplitude))
        check_ascending("frequency", "time", (p.time for p in self.frequency or ()))
        for i, p in enumerate(self.amplitude):
            if p.emphasis and p.emphasis.amplitude < p.amplitude:
                raise ValueError(
                    f"amplitude[{i}].emphasis.amplitude = {p.emphasis.amplitude:g}: must be at "
                    f"least the envelope's {p.amplitude:g}"
                )


class Continuous(Struct, frozen=True):
    """Object ``continuous``: the signal of the clip.

    Attributes
    ----------
    envelopes : Envelopes
        Amplitude and frequency.
    """

    envelopes: Envelopes


class Signals(Struct, frozen=True):
    """Object ``signals``: signals of the clip, of which there is one.

    Attributes
    ----------
    continuous : Continuous
        The signal.
    """

    continuous: Continuous


class Clip(Struct, frozen=True):
    """Contents of a .haptic file.

    Attributes
    ----------
    version : Version
        Version of the format.
    signals : Signals
        The signal.
    metadata : Metadata
        Information about the clip.
    """

    version: Version
    signals: Signals
    metadata: Metadata = Metadata()


def load_clip(path: Path) -> tuple[Effect, list[str]]:
    """Read a .haptic file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    effect : Effect
        Effect of one channel, with a wave and its transients.
    notes : list of str
        One line for each thing that was ignored.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid. The message is one line with the file, field, value and limit.
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
    ignored = reading.notes_on("ignored:", reading.unknown(data, msgspec.inspect.type_info(Clip)))
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
    metadata = {**msgspec.to_builtins(clip.metadata), "tags": list(clip.metadata.tags)}
    other = {k: v for k, v in metadata.items() if v and k != "description"}
    effect = single(tuple(bands), origin="haptic", ticks_per_s=FINE, other=other,
                    description=clip.metadata.description)  # fmt: skip
    return effect, ignored


def saved_clip(effect: Effect) -> tuple[bytes, list[str]]:
    """Format an effect as a .haptic file.

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
    shape, lost = outline.of_effect(effect, ".haptic")
    taps = sorted(shape.transients)
    times = np.array([time for time, _ in shape.amplitude])
    points = [AmplitudePoint(time=t, amplitude=a) for t, a in shape.amplitude]
    raised = 0
    for time, amplitude, frequency in taps:
        under = float(np.interp(time, *np.array(shape.amplitude).T))
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
    lost += outline.beyond_range(shape, ".haptic")
    clip = Clip(
        version=Version(1),
        metadata=_metadata(effect),
        signals=Signals(Continuous(Envelopes(
            amplitude=tuple(sorted(points, key=lambda p: p.time)),
            frequency=tuple(
                ClipFrequencyPoint(t, _within(sharpness_of(f))) for t, f in shape.frequency
            ) or None,
        ))),
    )  # fmt: skip
    return msgspec.json.format(msgspec.json.encode(clip), indent=2), lost


def _metadata(effect: Effect) -> Metadata:
    """Return the metadata of an effect, those of its own file included."""
    other = effect.other if effect.origin == "haptic" else {}
    fields = {**other, "description": effect.description}
    return reading.fitted(Path("effect.other"), fields, Metadata)


def _within(value: float) -> float:
    """Return a value limited to 0 … 1."""
    return min(max(value, 0.0), 1.0)
