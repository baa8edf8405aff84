"""Outline of a channel as one envelope of amplitude, one of frequency, and transients.

This is what the formats of phones can express. A channel that has this form already is converted
point for point. Everything else (sums of waves, curves, samples) is synthesized and measured in
windows of 10 ms: the amplitude is the largest value, the frequency half the number of zero
crossings over time.
"""

from dataclasses import dataclass, field

import msgspec
import numpy as np

from tactile.errors import InputError
from tactile.texture.formats.document import (
    HIGHEST,
    LOWEST,
    Band,
    Effect,
    EffectChannel,
    Keyframe,
    KeyframeSegment,
    Perception,
    channels_of,
)
from tactile.texture.formats.synthesis import (
    PLAIN,
    TRANSIENT,
    points,
    resolved,
    synthesize,
    unplayed,
    without_control,
)

WINDOW = 10e-3
"""Length of a window [s]: two periods of 200 Hz. Shorter ones cannot tell a frequency (assumed)."""
RATE = 8000.0
"""Sample rate at which a channel without envelopes is synthesized [Hz]."""

Pair = tuple[float, float]
"""Time [s] and value of a point of an envelope."""


@dataclass(frozen=True)
class Outline:
    """Envelopes and transients of one signal.

    Attributes
    ----------
    amplitude : list of (float, float)
        Time [s] and amplitude, 0 to 1, of each point.
    frequency : list of (float, float)
        Time [s] and frequency [Hz] of each point.
    transients : list of (float, float, float)
        Time [s], amplitude, 0 to 1, and frequency [Hz] of each transient.
    lost : list of str
        One line for each thing that the outline does not contain.
    """

    amplitude: list[Pair]
    frequency: list[Pair]
    transients: list[tuple[float, float, float]]
    lost: list[str] = field(default_factory=list)


def wave_band(amplitude: list[Pair], frequency: list[Pair]) -> Band:
    """Make a band of kind "wave" of two envelopes.

    Points of both envelopes at the same time become one keyframe.

    Parameters
    ----------
    amplitude : list of (float, float)
        Time [s] and amplitude of each point.
    frequency : list of (float, float)
        Time [s] and frequency [Hz] of each point.

    Returns
    -------
    Band
        Band with one segment.
    """
    keyframe_values: dict[tuple[float, int], dict[str, float]] = {}
    for name, pairs in (("amplitude", amplitude), ("frequency_hz", frequency)):
        for i, (time, value) in enumerate(pairs):
            twin = i
            while twin and pairs[twin - 1][0] == time:
                twin -= 1
            keyframe_values.setdefault((time, i - twin), {})[name] = value
    keyframes = tuple(
        Keyframe(time_s=t, **values) for (t, _), values in sorted(keyframe_values.items())
    )
    return Band(kind="wave", lower_frequency_hz=LOWEST, upper_frequency_hz=HIGHEST,
                segments=(KeyframeSegment(keyframes=keyframes),))  # fmt: skip


def of_effect(effect: Effect, suffix: str) -> tuple[Outline, list[str]]:
    """Compute the outline of the first channel of an effect.

    Parameters
    ----------
    effect : Effect
        Effect to outline.
    suffix : str
        Name of the format, for the notes.

    Returns
    -------
    outline : Outline
        Outline with at least one point of amplitude.
    lost : list of str
        One line for each thing that is lost.

    Raises
    ------
    InputError
        If the effect has no channel, or its first channel has nothing that can be outlined.
    """
    channels = channels_of(effect)
    if not channels:
        raise InputError(f"the effect has no channel: nothing to write to {suffix}")
    perception, channel = channels[0]
    lost = []
    if len(channels) > 1:
        lost.append(f"{suffix} has one channel: {len(channels) - 1} of {len(channels)} left out")
    alone = msgspec.structs.replace(perception, channels=(channel,))
    lost += unplayed(Effect(perceptions=(alone,)))
    outline = of_channel(perception, channel)
    if not outline.amplitude and not outline.transients:
        raise InputError(f"channel {channel.id} holds nothing that {suffix} can express")
    ends = [time for time, _ in outline.amplitude]
    if not ends:
        outline = Outline([(0.0, 0.0), (max(outline.transients)[0], 0.0)], [], outline.transients,
                        outline.lost)  # fmt: skip
    return outline, lost + outline.lost


def of_channel(perception: Perception, channel: EffectChannel) -> Outline:
    """Compute the outline of a channel, with its gain and control curves applied.

    Parameters
    ----------
    perception : Perception
        Perception that the channel belongs to.
    channel : EffectChannel
        Channel to outline.

    Returns
    -------
    Outline
        Outline, which may be empty.
    """
    uncontrolled, lost = without_control(perception, channel), []
    if uncontrolled is not channel:
        lost.append("control curves are worked into the envelopes")
    bands = [
        msgspec.structs.replace(b, segments=tuple(resolved(perception, s) for s in b.segments))
        for b in uncontrolled.bands
    ]
    waves = sorted((s for b in bands if b.kind == "wave" for s in b.segments if s.keyframes),
                   key=lambda s: s.start_s)  # fmt: skip
    amplitude: list[Pair] = []
    frequency: list[Pair] = []
    rest = [b for b in bands if b.kind != "transient" and b.segments]
    taps = [
        (s.start_s + k.time_s, abs(k.amplitude or 0.0) * abs(channel.gain),
         k.frequency_hz or 2 / TRANSIENT)
        for b in bands if b.kind == "transient" for s in b.segments for k in s.keyframes
    ]  # fmt: skip
    if all(b.kind == "wave" for b in rest) and _are_consecutive_sines(waves):
        amplitude, frequency = _joined_envelopes(waves, abs(channel.gain))
        has_signs_or_phases = any(
            s.phase_rad or any((k.amplitude or 0) < 0 for k in s.keyframes) for s in waves
        )
        if has_signs_or_phases:
            lost.append("phases, and the sign of amplitudes, have no place in an envelope")
    elif rest:
        lost.append("what is more than one wave is told by its envelope in windows of 10 ms")
        amplitude, frequency = _measured_envelopes(perception, channel, rest)
    if any(a > 1 for _, a in amplitude) or any(a > 1 for _, a, _ in taps):
        lost.append("amplitudes above 1 are limited to it")
    return Outline([(t, min(a, 1.0)) for t, a in amplitude], frequency,
                   [(t, min(a, 1.0), f) for t, a, f in taps], lost)  # fmt: skip


def _are_consecutive_sines(waves: list[KeyframeSegment]) -> bool:
    """Return whether waves are sines that do not overlap in time."""
    ends = [s.start_s + s.keyframes[-1].time_s for s in waves]
    after = all(s.start_s >= end for s, end in zip(waves[1:], ends, strict=False))
    return after and all(s.base_signal in (None, "Sine") for s in waves)


def _joined_envelopes(waves: list[KeyframeSegment], gain: float) -> tuple[list[Pair], list[Pair]]:
    """Return the envelopes of waves that follow each other, with an amplitude of 0 between them."""
    amplitude: list[Pair] = []
    frequency: list[Pair] = []
    before = 0.0
    for s in waves:
        end = s.keyframes[-1].time_s
        size, pitch = (
            points(s.keyframes, name).T.tolist() for name in ("amplitude", "frequency_hz")
        )
        size = size or [[0.0, 1.0], [end, 1.0]]
        if size[-1][0] < end:
            size.append([end, size[-1][1]])
        if s.start_s > before:
            amplitude += [(before, 0.0), (s.start_s, 0.0)]
        amplitude += [(s.start_s + t, abs(a) * gain) for t, a in size]
        frequency += [(s.start_s + t, f) for t, f in pitch]
        before = s.start_s + end
        if s is not waves[-1]:
            amplitude.append((before, 0.0))
    return _single_steps(amplitude), frequency


def _single_steps(pairs: list[Pair]) -> list[Pair]:
    """Return points without those that repeat the one before."""
    return [p for i, p in enumerate(pairs) if not i or p != pairs[i - 1]]


def _measured_envelopes(
    perception: Perception, channel: EffectChannel, bands: list[Band]
) -> tuple[list[Pair], list[Pair]]:
    """Return the envelopes of a synthesized channel."""
    only = msgspec.structs.replace(channel, bands=tuple(bands))
    alone = msgspec.structs.replace(perception, channels=(only,))
    x = synthesize(Effect(perceptions=(alone,)), RATE)[:, 0]
    size = round(WINDOW * RATE)
    x = np.pad(x, (0, -len(x) % size)).reshape(-1, size)
    middle_time = (np.arange(len(x)) + 0.5) * WINDOW
    crossings = np.count_nonzero(np.diff(np.signbit(x), axis=1), axis=1)
    pitch = np.where(crossings > 0, crossings / 2 / (WINDOW - 1 / RATE), PLAIN)
    peak = np.abs(x).max(axis=1)
    times = [0.0, *middle_time.tolist(), len(x) * WINDOW]
    amplitude = list(zip(times, [peak[0], *peak, peak[-1]], strict=True)) if len(x) else []
    return [(t, float(a)) for t, a in amplitude], list(
        zip(middle_time.tolist(), pitch.tolist(), strict=True)
    )


def beyond_range(drawn: Outline, suffix: str) -> list[str]:
    """Count the frequencies outside of the range that sharpness 0 … 1 stands for.

    Parameters
    ----------
    drawn : Outline
        Outline that is written.
    suffix : str
        Name of the format, for the note.

    Returns
    -------
    list of str
        One line with the number of frequencies that are limited, or none.
    """
    pitches = [f for _, f in drawn.frequency] + [f for _, _, f in drawn.transients]
    beyond = sum(not LOWEST - 1e-6 <= f <= HIGHEST + 1e-6 for f in pitches)
    if not beyond:
        return []
    return [
        f"{suffix} knows no frequency in Hz, 0 … 1 is taken as {LOWEST:g} … {HIGHEST:g} Hz: "
        f"{beyond} beyond it are limited"
    ]
