"""Synthesis of an effect as samples: the sum of bands, each channel limited to ± 1 and scaled.

The rules are those of the reference software of MPEG-I Haptics (ISO/IEC 23090-31), restated.
Amplitude and frequency are linear between keyframes, and the phase is the integral of the
frequency. Curves are Cubic (flat at each keyframe) unless they state otherwise. A transient is two
periods of a sine in 22 ms. A transient with its own frequency, which MPEG does not have, is the
number of whole periods of it that comes nearest to 22 ms. Composite effects are left out, which
`unplayed` reports.
"""

from collections.abc import Callable

import msgspec
import numpy as np
from scipy.interpolate import Akima1DInterpolator

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.formats.document import (
    Band,
    BaseSignal,
    Effect,
    EffectChannel,
    Keyframe,
    KeyframeSegment,
    Perception,
    channels_of,
)

TRANSIENT = 22e-3
"""Duration of a transient (MPEG) [s]."""
PLAIN = 160.0
"""Frequency of a wave that does not state one: that of the actuators of most phones (assumed)
[Hz]."""
MOST_SAMPLES = 32_000_000
"""Largest number of samples of all channels together."""
LOWEST_RATE, HIGHEST_RATE = 100.0, 192_000.0
"""Lowest and highest sample rate [Hz]."""

SHAPES: dict[str, Callable[[Floats], Floats]] = {
    "Sine": lambda turns: np.sin(2 * np.pi * turns),
    "Square": lambda turns: np.where(turns % 1 < 0.5, 1.0, -1.0),
    "Triangle": lambda turns: 1 - 4 * np.abs((turns - 0.25) - np.round(turns - 0.25)),
    "SawToothUp": lambda turns: 2 * (turns - np.floor(turns + 0.5)),
    "SawToothDown": lambda turns: 2 * (np.floor(turns + 0.5) - turns),
}
"""Waveforms as functions of the phase in turns."""


def duration(effect: Effect) -> float:
    """Compute the duration of an effect.

    Parameters
    ----------
    effect : Effect
        The effect.

    Returns
    -------
    float
        Time at which its last segment ends [s].
    """
    ends = [
        end_of(band, resolved(perception, segment))
        for perception, channel in channels_of(effect)
        for band in channel.bands
        for segment in band.segments
    ]
    return max(ends, default=0.0)


def end_of(band: Band, segment: KeyframeSegment) -> float:
    """Compute the end of a segment.

    Parameters
    ----------
    band : Band
        Band that the segment belongs to.
    segment : KeyframeSegment
        The segment.

    Returns
    -------
    float
        Time at which it ends, 0 for a segment of a control band [s].
    """
    end = segment.start_s + (segment.keyframes[-1].time_s if segment.keyframes else 0.0)
    if band.kind == "transient":
        taps = [(k.time_s, *_tap_shape(k)) for k in segment.keyframes]
        end = segment.start_s + max((t + n / f for t, n, f in taps), default=0.0)
    if segment.samples and band.sample_rate_hz:
        end += len(segment.samples) / 4 / band.sample_rate_hz
    return end if band.kind != "control" else 0.0


def resolved(perception: Perception, segment: KeyframeSegment) -> KeyframeSegment:
    """Replace a reference by the segment that it refers to.

    Parameters
    ----------
    perception : Perception
        Perception with the library.
    segment : KeyframeSegment
        A segment of any type.

    Returns
    -------
    KeyframeSegment
        Segment of the library at the time of the reference, or the segment itself if it is not a
        reference.

    Raises
    ------
    InputError
        If the library does not have it.
    """
    if segment.type != "Reference":
        return segment
    for entry in perception.library:
        if entry.id == segment.id:
            return msgspec.structs.replace(entry, start_s=segment.start_s, keywords=None)
    raise InputError(
        f"perception {perception.id}: effect {segment.id} is referenced, but not in the library"
    )


def synthesize(effect: Effect, sample_rate: float) -> Floats:
    """Render an effect as samples.

    Parameters
    ----------
    effect : Effect
        Effect to render.
    sample_rate : float
        Sample rate, 100 to 192000 [Hz]. Oscillations above half of it are left out.

    Returns
    -------
    (S, C) array of float
        One column per channel, those of all perceptions in order. 1 is the maximum of the device.

    Raises
    ------
    InputError
        If the rate is out of range, the result too long, or a reference is not in the library.
    """
    if not LOWEST_RATE <= sample_rate <= HIGHEST_RATE:
        raise InputError(
            f"sample rate {sample_rate:g} Hz: must be {LOWEST_RATE:g} … {HIGHEST_RATE:g}"
        )
    channels = channels_of(effect)
    count = round(duration(effect) * sample_rate)
    if count * len(channels) > MOST_SAMPLES:
        raise InputError(
            f"{count} samples of {len(channels)} channels: {MOST_SAMPLES} at most; "
            "a lower sample rate would do"
        )
    columns = [_signal(perception, c, count, sample_rate) for perception, c in channels]
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def _signal(perception: Perception, channel: EffectChannel, count: int, rate: float) -> Floats:
    """Return the samples (S,) of a channel."""
    uncontrolled, samples = without_control(perception, channel), np.zeros(count)
    for band in uncontrolled.bands:
        for segment in band.segments:
            played = resolved(perception, segment)
            first = min(int(np.ceil(played.start_s * rate - 1e-9)), count)
            last = min(int(np.floor(end_of(band, played) * rate + 1e-9)) + 1, count)
            time = np.arange(first, max(last, first)) / rate - played.start_s
            if len(time) and (played.keyframes or played.samples):
                samples[first : first + len(time)] += _segment_samples(band, played, time, rate)
    return np.asarray(np.clip(samples, -1, 1) * channel.gain)


def _segment_samples(band: Band, segment: KeyframeSegment, time: Floats, rate: float) -> Floats:
    """Return the samples of a segment at times after its beginning [s]."""
    if band.kind == "wave":
        return _wave(segment, time, rate)
    if band.kind == "curve":
        return _curve(segment, band.curve_type or "Unknown", time)
    if segment.samples:
        values = np.frombuffer(segment.samples, "<f4").astype(np.float64)
        at = np.arange(len(values)) / (band.sample_rate_hz or 1.0)
        return np.asarray(np.interp(time, at, values, right=0.0))
    if band.kind == "transient":
        return np.asarray(sum((_tap(k, time) for k in segment.keyframes), np.zeros(len(time))))
    return np.zeros(len(time))


def points(keyframes: tuple[Keyframe, ...], name: str) -> Floats:
    """Collect the keyframes that have a value of a given name.

    Parameters
    ----------
    keyframes : tuple of Keyframe
        Keyframes of a segment.
    name : str
        "amplitude" or "frequency_hz".

    Returns
    -------
    (2, P) array of float
        Times [s] and values.
    """
    pairs = [(k.time_s, v) for k in keyframes if (v := getattr(k, name)) is not None]
    return np.array(pairs, np.float64).reshape(-1, 2).T


def _wave(segment: KeyframeSegment, time: Floats, rate: float) -> Floats:
    """Return the samples of an oscillation at times after its beginning [s]."""
    amplitude, frequency = (points(segment.keyframes, n) for n in ("amplitude", "frequency_hz"))
    size = np.interp(time, *amplitude) if amplitude.size else np.ones(len(time))
    if not frequency.size:
        frequency = np.array([[0.0], [PLAIN]])
    turns = _turns(time, *frequency) + (segment.phase_rad or 0.0) / (2 * np.pi)
    audible = np.abs(np.interp(time, *frequency)) <= rate / 2
    shape: BaseSignal = segment.base_signal or "Sine"
    return np.asarray(size * audible * SHAPES[shape](turns))


def _turns(time: Floats, at: Floats, frequency: Floats) -> Floats:
    """Return the integral from 0 of a frequency, linear between points and held beyond them."""
    if at[0] > 0:
        at, frequency = np.append(0.0, at), np.append(frequency[0], frequency)
    step = np.diff(at)
    turns_at_points = np.append(0.0, np.cumsum(step * (frequency[1:] + frequency[:-1]) / 2))
    slope = np.append(np.diff(frequency) / np.where(step > 0, step, np.inf), 0.0)
    k = np.maximum(np.searchsorted(at, time, side="right") - 1, 0)
    elapsed = time - at[k]
    return np.asarray(turns_at_points[k] + elapsed * (frequency[k] + slope[k] * elapsed / 2))


def _curve(segment: KeyframeSegment, curve_type: str, time: Floats) -> Floats:
    """Return the samples of a curve at times after its beginning [s]."""
    at, value = points(segment.keyframes, "amplitude")
    if not len(at):
        return np.zeros(len(time))
    if curve_type == "Linear" or len(at) < 3:
        return np.asarray(np.interp(time, at, value))
    if curve_type == "Akima" and np.all(np.diff(at) > 0):
        inside = np.clip(time, at[0], at[-1])
        return np.asarray(Akima1DInterpolator(at, value)(inside))
    k = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 2)
    step = at[k + 1] - at[k]
    way = np.clip((time - at[k]) / np.where(step > 0, step, np.inf), 0, 1)
    return np.asarray(value[k] + (value[k + 1] - value[k]) * way**2 * (3 - 2 * way))


def _tap(keyframe: Keyframe, time: Floats) -> Floats:
    """Return the samples of a transient at times after the beginning of its segment [s]."""
    periods, frequency = _tap_shape(keyframe)
    way = (time - keyframe.time_s) * frequency
    size = 1.0 if keyframe.amplitude is None else keyframe.amplitude
    return np.where((way >= 0) & (way < periods), size * np.sin(2 * np.pi * way), 0.0)


def _tap_shape(keyframe: Keyframe) -> tuple[int, float]:
    """Return the number of periods and the frequency [Hz] of a transient."""
    frequency = abs(keyframe.frequency_hz or 0.0) or 2 / TRANSIENT
    return max(1, round(frequency * TRANSIENT)), max(frequency, 1.0)


# Control curves


def control(channel: EffectChannel, name: str) -> Floats | None:
    """Merge the control bands of a channel to one curve.

    The curve has its neutral value before the first point, and holds the last value between and
    after segments.

    Parameters
    ----------
    channel : EffectChannel
        Channel with any bands.
    name : str
        "amplitude" for a factor, whose neutral value is 1, or "frequency_hz" for a shift, whose
        neutral value is 0.

    Returns
    -------
    (2, P) array of float or None
        Times [s] and values, or None if no control band has any.
    """
    parts = [s for band in channel.bands if band.kind == "control" for s in band.segments]
    values = [(0.0, 1.0 if name == "amplitude" else 0.0)]
    for segment in sorted(parts, key=lambda s: s.start_s):
        time, value = points(segment.keyframes, name)
        if len(time):
            begin = segment.start_s + time[0]
            while len(values) > 1 and values[-1][0] > begin:
                values.pop()
            values += [(begin, values[-1][1]), *zip(segment.start_s + time, value, strict=True)]
    return np.array(values).T if len(values) > 1 else None


def without_control(perception: Perception, channel: EffectChannel) -> EffectChannel:
    """Apply the control bands of a channel to its waves and transients.

    Parameters
    ----------
    perception : Perception
        Perception with the library.
    channel : EffectChannel
        Channel with any bands.

    Returns
    -------
    EffectChannel
        Channel without control bands, or the channel itself if it has none.
    """
    amplitude, frequency = control(channel, "amplitude"), control(channel, "frequency_hz")
    if amplitude is None and frequency is None:
        return channel
    bands = []
    for band in channel.bands:
        if band.kind in ("wave", "transient"):
            segments = [
                _controlled(band, resolved(perception, s), amplitude, frequency)
                for s in band.segments
            ]
            bands.append(msgspec.structs.replace(band, segments=tuple(segments)))
        elif band.kind != "control":
            bands.append(band)
    return msgspec.structs.replace(channel, bands=tuple(bands))


def _controlled(
    band: Band, segment: KeyframeSegment, amplitude: Floats | None, frequency: Floats | None
) -> KeyframeSegment:
    """Return a segment multiplied and shifted, with keyframes at the points of all three curves."""
    a, f = (points(segment.keyframes, name) for name in ("amplitude", "frequency_hz"))
    at = np.array([k.time_s for k in segment.keyframes])
    factor = np.array([[0.0], [1.0]]) if amplitude is None else amplitude
    shift = np.array([[0.0], [0.0]]) if frequency is None else frequency
    if band.kind == "wave" and len(at):
        extra = np.concatenate([factor[0], shift[0]]) - segment.start_s
        at = _with_steps(np.concatenate([at, extra[(extra > at[0]) & (extra < at[-1])]]))
    size = _curve_values(at, a, 1.0) * _curve_values(at + segment.start_s, factor, 1.0)
    pitch = _curve_values(at, f, PLAIN) + _curve_values(at + segment.start_s, shift, 0.0)
    keyframes = tuple(
        Keyframe(time_s=float(t), amplitude=float(s), frequency_hz=float(max(p, 0.0)))
        for t, s, p in zip(at, np.clip(size, -1, 1), pitch, strict=True)
    )
    return msgspec.structs.replace(segment, type="Basis", keyframes=keyframes)


def _with_steps(at: Floats) -> Floats:
    """Return times in order, each of them once, or twice where a curve may have a step."""
    value, count = np.unique(at, return_counts=True)
    return np.asarray(np.repeat(value, np.minimum(count, 2)))


def _curve_values(at: Floats, pairs: Floats, empty: float) -> Floats:
    """Return a curve at ascending times; a time that occurs twice is either side of a step."""
    if not pairs.size:
        return np.full(len(at), empty)
    value = np.interp(at, *pairs)
    before = np.append(np.diff(at) == 0, False)
    index = np.searchsorted(pairs[0], at[before], side="left")
    stepped = (index < pairs.shape[1]) & (pairs[0][np.minimum(index, pairs.shape[1] - 1)]
                                          == at[before])  # fmt: skip
    value[before] = np.where(
        stepped, pairs[1][np.minimum(index, pairs.shape[1] - 1)], value[before]
    )
    return np.asarray(value)


def unplayed(effect: Effect) -> list[str]:
    """List what `synthesize` leaves out or renders in another way.

    Parameters
    ----------
    effect : Effect
        Effect to render.

    Returns
    -------
    list of str
        One line for each thing.
    """
    lines = []
    for perception, channel in channels_of(effect):
        where = f"perception {perception.id}, channel {channel.id}"
        for band in channel.bands:
            parts = [resolved(perception, s) for s in band.segments]
            opaque = sum(not s.samples for s in parts) if band.kind == "wavelet" else 0
            if opaque:
                lines.append(f"{where}: {opaque} wavelet blocks cannot be decoded and are left out")
            if band.kind == "curve" and band.curve_type in ("Bezier", "Bspline"):
                lines.append(f"{where}: a {band.curve_type} curve is drawn as Cubic")
            if composite := sum(s.type == "Composite" for s in parts):
                lines.append(f"{where}: composite effects are not played, {composite} left out")
    return lines
