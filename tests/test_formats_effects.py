"""Effects of other people's formats: what is read, that it comes back, and how it sounds.

The samples are those of the formats' own makers; the reference rendering of the .hjif texture is by
MPEG's reference software, which shares no code with this project.
"""

import json
import math
import re
import wave
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest
from format_samples import sample
from numpy.typing import NDArray
from scipy.io import wavfile

import tactile
from tactile.errors import InputError
from tactile.texture.formats import load_effect, save_effect, synthesize
from tactile.texture.formats.conversion import convert_file
from tactile.texture.formats.document import (
    Band,
    Effect,
    EffectChannel,
    Keyframe,
    KeyframeSegment,
    Perception,
    single,
)
from tactile.texture.formats.synthesis import duration

LOAD = (
    "ahap/valid_fields.ahap", "ahap/valid_required.ahap", "ahap/studio_export.ahap",
    "haptic/valid_v1.haptic", "haptic/valid_required_v1.haptic",
    "haptic/v1_additional_fields.haptic",
    "hjif/texture_template.hjif", "hjif/synth2ch_8k_wav.hjif",
    "hjif/synth2ch_8k.wav", "hjif/texture_template_refsynth_8k.wav",
    "wav/tactile_pattern_confirm.wav", "wav/wav_float32.wav", "wav/wav_int16_3c.wav",
)  # fmt: skip
REFUSED = {
    "ahap/invalid_fields.ahap": "Pattern[1]: holds 'ParameterCurves'; "
    "did you mean 'ParameterCurve'?",
    "haptic/invalid_version_v1.haptic": "version.major = 2: must be 1",
    "haptic/validation_v1_sequence.haptic": "amplitude[2].time = 0.1: comes after 0.2",
}
HAPTIC = {
    "type": "object", "required": ["version", "signals"],
    "properties": {
        "version": {"properties": {"major": {"const": 1}, "minor": {"type": "integer"}}},
        "signals": {"properties": {"continuous": {"properties": {"envelopes": {
            "required": ["amplitude"],
            "properties": {
                "amplitude": {"minItems": 1, "items": {
                    "required": ["time", "amplitude"], "additionalProperties": False,
                    "properties": {
                        "time": {"type": "number", "minimum": 0},
                        "amplitude": {"type": "number", "minimum": 0, "maximum": 1},
                        "emphasis": {
                            "required": ["amplitude", "frequency"],
                            "properties": {
                                "amplitude": {"minimum": 0, "maximum": 1},
                                "frequency": {"minimum": 0, "maximum": 1}}}}}},
                "frequency": {"items": {
                    "required": ["time", "frequency"],
                    "properties": {"frequency": {"minimum": 0, "maximum": 1}}}},
            }}}}}},
    },
}  # fmt: skip
"""Schema of HAPTIC, written from the text of the format."""
AHAP = {
    "type": "object", "required": ["Version", "Pattern"],
    "properties": {"Pattern": {"items": {
        "minProperties": 1, "maxProperties": 1, "additionalProperties": False,
        "properties": {
            "Event": {
                "required": ["Time", "EventType", "EventParameters"],
                "properties": {
                    "EventType": {"enum": ["HapticTransient", "HapticContinuous"]},
                    "EventDuration": {"minimum": 0, "maximum": 30},
                    "EventParameters": {"items": {
                        "properties": {"ParameterValue": {"minimum": 0, "maximum": 1}}}}}},
            "ParameterCurve": {
                "required": ["ParameterID", "Time", "ParameterCurveControlPoints"],
                "properties": {
                    "ParameterID": {"enum": ["HapticIntensityControl", "HapticSharpnessControl"]},
                    "ParameterCurveControlPoints": {"minItems": 1, "maxItems": 16}}},
        }}}},
}  # fmt: skip
"""Schema of AHAP, written from Apple's text: 16 points in a curve, 30 s in an event."""
HJIF = {
    "type": "object",
    "required": ["version", "profile", "level", "date", "description", "timescale", "avatars",
                 "perceptions", "syncs"],
    "properties": {"perceptions": {"items": {
        "required": ["id", "avatar_id", "description", "perception_modality", "effect_library",
                     "reference_devices", "channels"],
        "not": {"required": ["effect_semantic_scheme"]},
        "properties": {"channels": {"items": {
            "required": ["id", "description", "gain", "mixing_coefficient", "body_part_mask",
                         "bands"],
            "properties": {"bands": {"items": {
                "required": ["band_type", "lower_frequency_limit", "upper_frequency_limit",
                             "effects"],
                "properties": {
                    "lower_frequency_limit": {"type": "integer"},
                    "band_type": {
                        "enum": ["Curve", "WaveletWave", "VectorialWave", "Transient"]},
                    "effects": {"items": {
                        "required": ["effect_type", "position"],
                        "properties": {
                            "position": {"type": "integer"},
                            "keyframes": {"items": {
                                "required": ["relative_position"],
                                "properties": {
                                    "relative_position": {"type": "integer"},
                                    "amplitude_modulation": {"minimum": -1, "maximum": 1},
                                    "frequency_modulation": {"type": "integer"}}}}}}}},
            }}}}}},
    }}},
}  # fmt: skip
"""Schema of HJIF, written from the text of the format."""


def through(effect: Effect, path: Path) -> Effect:
    save_effect(effect, path)
    return load_effect(path)


def content(path: Path) -> Any:
    return json.loads(path.read_text())


def level(signal: NDArray[np.float64], frequency: int, rate: int = 8000) -> float:
    """Return the amplitude of an oscillation, of a signal of 1 s."""
    assert len(signal) == rate
    return float(np.abs(np.fft.rfft(signal))[frequency] * 2 / rate)


# Reading


@pytest.mark.parametrize("name", LOAD)
def test_what_should_load_loads_and_sounds(name: str) -> None:
    effect = tactile.load_effect(sample(name))
    played = synthesize(effect, 8000)
    assert np.all(np.isfinite(played))
    assert len(played) == round(duration(effect) * 8000)
    assert played.shape[1] == sum(len(p.channels) for p in effect.perceptions) > 0


@pytest.mark.parametrize("name", REFUSED)
def test_what_must_be_rejected_is_with_one_line_that_says_why(name: str) -> None:
    with pytest.raises(InputError) as refused:
        load_effect(sample(name))
    assert REFUSED[name] in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_only_fault_of_the_invalid_pattern_is_the_key_that_is_named(tmp_path: Path) -> None:
    text = sample("ahap/invalid_fields.ahap").read_text()
    mended = tmp_path / "mended.ahap"
    mended.write_text(text.replace("ParameterCurves", "ParameterCurve"))
    assert load_effect(mended) == load_effect(sample("ahap/valid_fields.ahap"))


# Coming back


@pytest.mark.parametrize("name", LOAD)
def test_our_own_file_keeps_all_of_an_effect(name: str, tmp_path: Path) -> None:
    effect = load_effect(sample(name))
    assert through(effect, tmp_path / "same.toml") == effect


@pytest.mark.parametrize("name", ["texture_template.hjif", "synth2ch_8k_wav.hjif"])
def test_hjif_comes_back_as_it_was_by_way_of_our_own_file(name: str, tmp_path: Path) -> None:
    ours = tmp_path / "ours.toml"
    assert convert_file(str(sample(f"hjif/{name}")), ours).lost == ()
    back = tmp_path / "back.hjif"
    assert convert_file(str(ours), back).lost == ()
    assert content(back) == content(sample(f"hjif/{name}"))


def test_hjif_keeps_references_ids_and_what_it_alone_knows(tmp_path: Path) -> None:
    data = content(sample("hjif/texture_template.hjif"))
    perception = data["perceptions"][0]
    perception["effect_library"] = [
        {"effect_type": "Basis", "id": 7, "position": 0, "phase": 0.5, "base_signal": "Square",
         "keyframes": [{"relative_position": 0, "amplitude_modulation": -0.25},
                       {"relative_position": 50, "frequency_modulation": 80}]},
    ]  # fmt: skip
    perception["unit_exponent"] = -6
    perception["channels"][0]["bands"][0]["effects"] += [
        {"effect_type": "Reference", "id": 7, "position": 250},
        {"effect_type": "Composite", "position": 300, "timeline": [{"id": 7}]},
    ]
    source, back = tmp_path / "in.hjif", tmp_path / "out.hjif"
    source.write_text(json.dumps(data))
    assert save_effect(load_effect(source), back) == []
    assert content(back) == data


def test_the_scheme_that_conformance_refuses_is_left_out_and_told(tmp_path: Path) -> None:
    data = content(sample("hjif/texture_template.hjif"))
    data["perceptions"][0]["effect_semantic_scheme"] = "urn:mpeg:mpegi:haptics:effectsemantic:2023"
    source, back = tmp_path / "in.hjif", tmp_path / "out.hjif"
    source.write_text(json.dumps(data))
    assert any("effect_semantic_scheme" in line for line in save_effect(load_effect(source), back))
    jsonschema.validate(content(back), HJIF)


@pytest.mark.parametrize("name", ["valid_v1", "valid_required_v1"])
def test_a_clip_comes_back_with_its_envelopes_and_emphasis(name: str, tmp_path: Path) -> None:
    theirs, back = content(sample(f"haptic/{name}.haptic")), tmp_path / "back.haptic"
    assert save_effect(load_effect(sample(f"haptic/{name}.haptic")), back) == []
    ours = content(back)
    jsonschema.validate(ours, HAPTIC)
    assert ours["metadata"]["description"] == theirs.get("metadata", {}).get("description", "")
    for key in ("amplitude", "frequency"):
        want = theirs["signals"]["continuous"]["envelopes"].get(key, [])
        got = ours["signals"]["continuous"]["envelopes"].get(key, [])
        assert [p["time"] for p in got] == [p["time"] for p in want]
        assert [p[key] for p in got] == pytest.approx([p[key] for p in want])
        for p, q in zip(got, want, strict=True):
            assert p.get("emphasis") == pytest.approx(q.get("emphasis"))


@pytest.mark.parametrize("name", ["valid_fields", "valid_required", "studio_export"])
def test_a_pattern_comes_back_with_its_events_and_curves(name: str, tmp_path: Path) -> None:
    effect = load_effect(sample(f"ahap/{name}.ahap"))
    back = tmp_path / "back.ahap"
    assert save_effect(effect, back) == []
    ours, theirs = content(back), content(sample(f"ahap/{name}.ahap"))
    jsonschema.validate(ours, AHAP)
    assert ours["Metadata"] == theirs["Metadata"]
    for kind in ("HapticTransient", "HapticContinuous"):
        got, want = (
            [e["Event"] for e in file["Pattern"] if e.get("Event", {}).get("EventType") == kind]
            for file in (ours, theirs)
        )
        assert [e["Time"] for e in got] == [e["Time"] for e in want]
        assert [e.get("EventDuration") for e in got] == [e.get("EventDuration") for e in want]
        for e, f in zip(got, want, strict=True):
            values = [[p["ParameterValue"] for p in x["EventParameters"]] for x in (e, f)]
            assert values[0] == pytest.approx(values[1])
    absolute = name == "studio_export"
    for kind in ("HapticIntensityControl", "HapticSharpnessControl"):
        assert curve(ours, kind) == pytest.approx(curve(theirs, kind, absolute=absolute))


def curve(file: Any, kind: str, *, absolute: bool = False) -> NDArray[np.float64]:
    """Return time and value of all points of a kind of curve."""
    found = [c for e in file["Pattern"] if (c := e.get("ParameterCurve"))]
    return np.array([
        (p["Time"] + (0 if absolute else c["Time"]), p["ParameterValue"])
        for c in found if c["ParameterID"] == kind for p in c["ParameterCurveControlPoints"]
    ])  # fmt: skip


def test_lofelts_curves_count_from_the_beginning_of_the_pattern() -> None:
    """The last would end at 19 s in an event of 9.8 s if curves counted from their own start."""
    effect = load_effect(sample("ahap/studio_export.ahap"))
    bands = {band.kind: band for band in effect.perceptions[0].channels[0].bands}
    ends = [s.start_s + s.keyframes[-1].time_s for s in bands["control"].segments]
    assert max(ends) == pytest.approx(bands["wave"].segments[0].keyframes[-1].time_s, abs=1e-3)


@pytest.mark.parametrize("name", [name for name in LOAD if name.endswith(".wav")])
def test_wav_comes_back_sample_for_sample(name: str, tmp_path: Path) -> None:
    effect = load_effect(sample(name))
    again = through(effect, tmp_path / "back.wav")
    ours, theirs = (
        [s.samples for c in e.perceptions[0].channels for b in c.bands for s in b.segments]
        for e in (again, effect)
    )
    assert ours == theirs


# From one to another


@pytest.mark.parametrize(
    ("suffix", "schema"), [(".haptic", HAPTIC), (".ahap", AHAP), (".hjif", HJIF)]
)
@pytest.mark.parametrize("name", [name for name in LOAD if "_8k.wav" not in name])
def test_what_is_written_is_what_the_format_says(
    name: str, suffix: str, schema: dict[str, Any], tmp_path: Path
) -> None:
    target = tmp_path / f"out{suffix}"
    save_effect(load_effect(sample(name)), target)
    written = content(target)
    jsonschema.validate(written, schema)
    for entry in written.get("Pattern", ()):
        if found := entry.get("ParameterCurve"):
            assert found["ParameterCurveControlPoints"][0]["Time"] == 0, "from the curve's start"
    load_effect(target)


def test_a_clip_sounds_the_same_as_pattern_and_as_hjif(tmp_path: Path) -> None:
    """AHAP makes it one event under curves, .hjif keyframes in whole Hz: time is compared."""
    clip = load_effect(sample("haptic/valid_required_v1.haptic"))
    want = synthesize(clip, 8000)
    for suffix in (".ahap", ".hjif"):
        got = synthesize(through(clip, tmp_path / f"other{suffix}"), 8000)
        assert got == pytest.approx(want, abs=1e-6)


def test_a_pattern_sounds_the_same_as_a_clip(tmp_path: Path) -> None:
    """The sharpness stays in 0 … 1; that of a transient is limited there."""
    tap = {"Event": {"Time": 0.05, "EventType": "HapticTransient", "EventParameters": [
        {"ParameterID": "HapticIntensity", "ParameterValue": 0.9},
        {"ParameterID": "HapticSharpness", "ParameterValue": 0.3}]}}  # fmt: skip
    hum = {"Event": {"Time": 0.0, "EventDuration": 0.2, "EventType": "HapticContinuous",
                     "EventParameters": [
        {"ParameterID": "HapticIntensity", "ParameterValue": 0.5},
        {"ParameterID": "HapticSharpness", "ParameterValue": 0.2}]}}  # fmt: skip
    fall = {"ParameterCurve": {"ParameterID": "HapticIntensityControl", "Time": 0.0,
            "ParameterCurveControlPoints": [{"Time": 0.0, "ParameterValue": 1.0},
                                            {"Time": 0.2, "ParameterValue": 0.0}]}}  # fmt: skip
    source = tmp_path / "in.ahap"
    source.write_text(json.dumps({"Version": 1.0, "Pattern": [tap, hum, fall]}))
    pattern = load_effect(source)
    time = np.arange(1600) / 8000
    tapped = np.where((time >= 0.05) & (time < 0.05 + 3 / 135.5),
                      0.9 * 0.75 * np.sin(2 * np.pi * 135.5 * (time - 0.05)), 0.0)  # fmt: skip
    want = 0.5 * (1 - time / 0.2) * np.sin(2 * np.pi * 112 * time) + tapped
    assert synthesize(pattern, 8000)[:, 0] == pytest.approx(want, abs=1e-9)
    clip = through(pattern, tmp_path / "out.haptic")
    assert synthesize(clip, 8000)[:, 0] == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize("suffix", [None, ".haptic", ".hjif"])
def test_a_parameter_steps_where_it_is_set_and_stays(suffix: str | None, tmp_path: Path) -> None:
    hum = {"Event": {"Time": 0.05, "EventDuration": 0.2, "EventType": "HapticContinuous",
                     "EventParameters": [
        {"ParameterID": "HapticIntensity", "ParameterValue": 1.0},
        {"ParameterID": "HapticSharpness", "ParameterValue": 0.2}]}}  # fmt: skip
    soft = {"Parameter": {"ParameterID": "HapticIntensityControl", "Time": 0.1,
                          "ParameterValue": 0.25}}  # fmt: skip
    source = tmp_path / "in.ahap"
    source.write_text(json.dumps({"Version": 1.0, "Pattern": [hum, soft]}))
    effect = load_effect(source)
    played = effect if suffix is None else through(effect, tmp_path / f"out{suffix}")
    time = np.arange(2000) / 8000
    want = np.where(time < 0.1, 1.0, 0.25) * np.sin(2 * np.pi * 112 * (time - 0.05))
    got = synthesize(played, 8000)[:, 0]
    assert np.all(got[:400] == 0)
    if suffix == ".haptic":
        level_there = np.abs(got[400:2000]).reshape(-1, 200).max(axis=1)
        assert level_there == pytest.approx([1, 1, *[0.25] * 6], abs=0.01)
    else:
        assert np.delete(got, 800)[400:1990] == pytest.approx(np.delete(want, 800)[400:1990])


def test_core_haptics_limits_and_ignores_and_each_is_told(tmp_path: Path) -> None:
    source = tmp_path / "in.ahap"
    source.write_text(json.dumps({"Version": 1.0, "Colour": "red", "Pattern": [
        {"Event": {"Time": 0, "EventType": "HapticTransient", "Waveform": 3, "EventParameters": [
            {"ParameterID": "HapticIntensity", "ParameterValue": 7.0},
            {"ParameterID": "HapticSharpness", "ParameterValue": -2}]}},
        {"Event": {"Time": 0, "EventType": "AudioCustom"}},
    ]}))  # fmt: skip
    done = convert_file(str(source), tmp_path / "out.toml")
    assert done.lost == (
        "ignored: Colour", "ignored: Waveform", "left out: AudioCustom",
        "limited to its range: HapticIntensity 7", "limited to its range: HapticSharpness -2",
    )  # fmt: skip
    (tap,) = load_effect(tmp_path / "out.toml").perceptions[0].channels[0].bands[0].segments
    assert tap.keyframes == (Keyframe(time_s=0.0, amplitude=1.0, frequency_hz=65.0),)


@pytest.mark.parametrize("suffix", [".haptic", ".ahap", ".json"])
def test_each_thing_that_a_phone_cannot_say_is_told(suffix: str, tmp_path: Path) -> None:
    lost = save_effect(load_effect(sample("hjif/texture_template.hjif")), tmp_path / f"x{suffix}")
    told = "\n".join(lost)
    for word in ("one channel", "Texture/Wood", "reference devices", "actuator_target", "avatars"):
        assert word in told, word
    if suffix != ".json":
        assert "knows no frequency in Hz" in told
        assert "told by its envelope" in told


def test_wavelets_that_cannot_be_decoded_are_told_wherever_they_are_not_heard(
    tmp_path: Path,
) -> None:
    """A band of wavelets without the length of its blocks cannot be decoded."""
    path = tmp_path / "x.hjif"
    text = sample("hjif/synth2ch_8k_wav.hjif").read_text()
    path.write_text(re.sub(r'"block_length": ?128,', "", text))
    effect = load_effect(path)
    for suffix in (".haptic", ".ahap", ".wav", ".json"):
        lost = save_effect(effect, tmp_path / f"x{suffix}")
        assert any("8 wavelet blocks cannot be decoded" in line for line in lost), suffix


# Sounding


def test_wavelets_sound_as_the_wave_that_the_reference_software_encoded() -> None:
    """Levels agree within 1 dB, and the error of the lossy code is 10 dB below the wave.

    The encoder of MPEG's reference software wrote the file from this wave. With less than the
    present bit planes, without the trees or with the other sign the error is above the limit.
    """
    rate, coded = wavfile.read(sample("hjif/synth2ch_8k.wav"))
    encoded = coded / 2**15
    played = synthesize(load_effect(sample("hjif/synth2ch_8k_wav.hjif")), rate)[: len(encoded)]
    level = 20 * np.log10(np.std(played, axis=0) / np.std(encoded, axis=0))
    assert np.all(np.abs(level) < 1)
    error = 20 * np.log10(np.std(played - encoded, axis=0) / np.std(encoded, axis=0))
    assert np.all(error < -10)


def test_a_texture_sounds_as_the_reference_software_renders_it() -> None:
    effect = load_effect(sample("hjif/texture_template.hjif"))
    with wave.open(str(sample("hjif/texture_template_refsynth_8k.wav"))) as file:
        raw = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, 2)
    reference, ours = raw / 32767, synthesize(effect, 8000)
    for channel, frequency in ((0, 60), (0, 250), (1, 60), (1, 400)):
        want, got = (level(x[:, channel], frequency) for x in (reference, ours))
        assert abs(20 * math.log10(got / want)) < 0.01
    assert ours == pytest.approx(reference, abs=2 / 32767)


def test_the_curve_below_72_hz_is_what_the_reference_encoder_took_from_the_wave() -> None:
    """The power is within 0.5 dB, since a cubic between extremes is not quite a sine."""
    effect = load_effect(sample("hjif/synth2ch_8k_wav.hjif"))
    with wave.open(str(sample("hjif/synth2ch_8k.wav"))) as file:
        raw = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, 2)
    ours = synthesize(effect, 8000)
    for channel in (0, 1):
        low = [np.sum(np.abs(np.fft.rfft(x[:, channel]))[1:72] ** 2) for x in (raw / 32767, ours)]
        assert abs(10 * math.log10(low[1] / low[0])) < 0.5


def test_a_chirp_has_the_phase_of_its_integral() -> None:
    sweep = KeyframeSegment(phase_rad=0.3, keyframes=(
        Keyframe(time_s=0.0, amplitude=0.2, frequency_hz=50.0),
        Keyframe(time_s=0.5, amplitude=1.0),
        Keyframe(time_s=1.0, amplitude=1.0, frequency_hz=250.0),
    ))  # fmt: skip
    time = np.arange(8000) / 8000
    size = np.minimum(0.2 + 1.6 * time, 1.0)
    want = size * np.sin(2 * np.pi * (50 * time + 100 * time**2) + 0.3)
    got = synthesize(single((Band(kind="wave", segments=(sweep,)),)), 8000)[:, 0]
    assert got == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "quarters"),
    [("Sine", (0, 1, 0, -1)), ("Triangle", (0, 1, 0, -1)), ("Square", (1, 1, -1, -1)),
     ("SawToothUp", (0, 0.5, -1, -0.5)), ("SawToothDown", (0, -0.5, 1, 0.5))],
)  # fmt: skip
def test_a_base_signal_has_its_shape(shape: Any, quarters: tuple[float, ...]) -> None:
    keyframes = tuple(Keyframe(time_s=t, amplitude=1.0, frequency_hz=100.0) for t in (0.0, 0.1))
    band = Band(kind="wave", segments=(KeyframeSegment(base_signal=shape, keyframes=keyframes),))
    got = synthesize(single((band,)), 400)[:4, 0]
    assert got == pytest.approx(quarters, abs=1e-9)


def test_a_transient_is_two_periods_in_22_ms_and_one_with_a_frequency_whole_periods_of_it() -> None:
    taps = KeyframeSegment(keyframes=(
        Keyframe(time_s=0.0, amplitude=0.5),
        Keyframe(time_s=0.1, amplitude=1.0, frequency_hz=300.0),
    ))  # fmt: skip
    got = synthesize(single((Band(kind="transient", segments=(taps,)),)), 10_000)[:, 0]
    time = np.arange(220) / 10_000
    assert got[:220] == pytest.approx(0.5 * np.sin(2 * np.pi * time * 2 / 0.022), abs=1e-9)
    assert np.all(got[221:1000] == 0)
    crossings = np.count_nonzero(np.diff(np.sign(got[1001:])) != 0)
    assert crossings in (13, 14, 15), "seven periods: 6.6 would fit 22 ms"


def test_channels_are_limited_to_one_then_scaled_and_references_played() -> None:
    loud = KeyframeSegment(
        id=3, keyframes=tuple(Keyframe(time_s=t, amplitude=1.0) for t in (0.0, 0.01))
    )
    twice = Band(kind="curve", segments=(KeyframeSegment(type="Reference", id=3), loud))
    effect = Effect(perceptions=(Perception(
        library=(loud,), channels=(EffectChannel(gain=0.5, bands=(twice,)), EffectChannel(id=1)),
    ),))  # fmt: skip
    got = synthesize(effect, 1000)
    assert got.shape == (10, 2)
    assert np.all(got == [0.5, 0.0])


def test_a_reference_that_leads_nowhere_is_an_error() -> None:
    lost = Band(kind="wave", segments=(KeyframeSegment(type="Reference", id=3),))
    with pytest.raises(InputError, match="effect 3 is referenced, but not in the library"):
        synthesize(single((lost,)), 8000)


def test_what_is_too_long_to_render_is_an_error_not_memory() -> None:
    long = KeyframeSegment(keyframes=(Keyframe(time_s=0.0), Keyframe(time_s=3600.0)))
    with pytest.raises(InputError, match="32000000 at most; a lower sample rate would do"):
        synthesize(single((Band(kind="wave", segments=(long,)),)), 48_000)
    with pytest.raises(InputError, match="sample rate 10 Hz: must be 100"):
        synthesize(single(()), 10)
